"""The paper's first task, with a choice and with a range of wheel speeds, with a longer pole and over a bad
radio."""

from tools.results.experiment import (
    NEW_STARTS,
    RANDOM,
    Ahead,
    Bar,
    Beside,
    Experiment,
    Held,
    Mark,
    Solved,
    Trained,
    Training,
    seeds,
)

FRESH = seeds(20, first=5001)
"""Named before they were trained."""

BARS = (
    Bar(Solved("simulated_hours"), at_most=0.33),
    Bar(Solved("simulated_hours"), at_most=0.24, over="median"),
    Bar(Trained("cpu_seconds"), at_most=30),
    Bar(Held("mean_return"), at_least=199),
)
MARKS = (Mark("solved: 195", value=195), Mark("the paper: 2.5 h", hours=2.5))
PAPER = (
    "The paper's agent, PPO with the same networks, needed about 2.5 simulated hours (some 281 000 steps)."
)

EXPERIMENTS = (
    Experiment(
        scenario="cartpole",
        title="CartPole",
        prose="Solved: 100 new starts confirm a mean return of at least 195 of 200, without exploration."
        " Before deepbots confirmed it, "
        "the mean of 100 training episodes, with exploration, had to reach 195; seeds 201 to 205 needed"
        " 0.224 to 0.274 h for that, and "
        "24 other seeds 0.226 to 0.351 h.",
        trainings=(Training(FRESH, evaluations=(NEW_STARTS,)),),
        baselines=(RANDOM,),
        bars=BARS,
        paper=PAPER,
        beside=(
            Beside("simulated hours until solved", "about 2.5", Solved("simulated_hours")),
            Beside("mean return of 200, held out", "not given", Held("mean_return")),
        ),
        marks=MARKS,
    ),
    Experiment(
        scenario="cartpole_continuous",
        title="CartPoleContinuous",
        prose="Trained before the engine ignored contacts without force.",
        trainings=(Training(seeds(5)),),
        baselines=(RANDOM,),
        bars=BARS,
        paper="The original trains its continuous variant for up to 10 000 episodes of DDPG; it does not say"
        " when it was solved.",
        marks=MARKS[:1],
    ),
    Experiment(
        scenario="cartpole_long",
        title="CartPoleLong",
        prose="The settings are those of CartPole; nothing was tuned for the longer pole.",
        trainings=(Training(seeds(3)),),
        baselines=(RANDOM,),
        bars=(Bar(Ahead("random"), at_least=0),),
        marks=MARKS[:1],
    ),
    Experiment(
        scenario="cartpole_wireless",
        title="CartPoleWireless",
        prose="The settings are those of CartPole; nothing was tuned for the radio.",
        trainings=(Training(seeds(1)),),
        baselines=(RANDOM,),
        bars=(Bar(Ahead("random"), at_least=0),),
        marks=MARKS[:1],
    ),
)
