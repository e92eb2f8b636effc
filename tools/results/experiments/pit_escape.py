"""The paper's second task: a ball rocks itself out of a pit."""

from tools.results.experiment import (
    NEW_STARTS,
    RANDOM,
    Bar,
    Baseline,
    Beside,
    Crossed,
    Evaluation,
    Experiment,
    Held,
    Mark,
    Solved,
    Trained,
    Training,
    Tried,
    seeds,
)

_ELSEWHERE = tuple(
    Evaluation(name=name, episodes=20, scenario=f"tests/pits/pit_escape_{name}.yaml", words=words)
    for name, words in (
        ("heightfield", "a pit from a picture of heights, with other lumps"),
        ("mesh", "a smooth pit of larger triangles"),
        ("half_step", "physics steps of 2 ms instead of 4"),
    )
)

FRESH = seeds(20, first=5001)
"""Named before they were trained."""

LONG = seeds(5, first=111)

EXPERIMENTS = (
    Experiment(
        scenario="pit_escape",
        title="PitEscape",
        prose="Solved: 100 or 200 new starts confirm a mean return of at least 0.89, without exploration."
        " Two of the seeds failed their "
        "first confirmation, with 0.877 on 40 starts and 0.889 on 200. A confirmation is as long as the"
        " whole training before it, and "
        "the next one follows when those that failed are a tenth of the training, so these seeds train for"
        " longer; the policy of seed "
        "5019 is good at the end, but was not confirmed before. In a pit 2.8 m high, seed 101 passed a mean"
        " return of 0.8 after 2.98 h, "
        "and seed 102 never; the pit is now 2.5 m high.",
        trainings=(
            Training(FRESH, evaluations=(NEW_STARTS, *_ELSEWHERE)),
            Training(LONG, name="long", full=True, words="three simulated hours, whether solved or not"),
        ),
        baselines=(
            RANDOM,
            Baseline("forward", ("--driver", "forward_only"), episodes=200),
            Baseline("rocking", ("--driver", "rocking"), episodes=200),
        ),
        bars=(
            Bar(Solved("simulated_hours"), at_most=1),
            Bar(Solved("simulated_hours"), at_most=0.7, over="median"),
            Bar(Crossed(0.8, "simulated_hours", training="long"), at_most=1.3),
            Bar(Trained("cpu_seconds"), at_most=60),
            Bar(Held("mean_return"), at_least=0.89),
            Bar(Held("success_rate"), at_least=1),
            Bar(Tried("forward", "successes"), at_most=0),
            Bar(Tried("rocking", "success_rate"), at_least=0.95),
            Bar(Crossed(0.9, "simulated_hours", training="long"), at_most=3, stretch=True),
            *(
                bar
                for evaluation in ("heightfield", "mesh", "half_step")
                for bar in (
                    Bar(Held("mean_return", evaluation), at_least=0.89, stretch=True),
                    Bar(Held("success_rate", evaluation), at_least=1.0, stretch=True),
                )
            ),
        ),
        paper="The paper's agent, PPO with the same networks, passed a mean of 0.6 near episode 90 and 0.8"
        " from about episode 150 on; "
        "its training took about 3 simulated hours (500 episodes).",
        beside=(
            Beside("simulated hours until solved", "about 3, of the training", Solved("simulated_hours")),
            Beside("success, held out", "not given", Held("success_rate")),
        ),
        marks=(Mark("the paper: 0.8", value=0.8), Mark("the paper: 3 h", hours=3)),
    ),
    Experiment(
        scenario="pit_escape_as_printed",
        title="PitEscapeAsPrinted",
        prose="The printed sign of the reward makes progress a cost. Standing still is the best policy.",
        trainings=(Training(seeds(2)),),
        bars=(Bar(Held("successes"), at_most=0),),
        paper="The paper prints the reward as the old value minus the new one; its curve rises, so its agent"
        " was paid for progress.",
    ),
)
