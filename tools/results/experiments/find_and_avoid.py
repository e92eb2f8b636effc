"""Around up to 25 obstacles to a mark, with the choices masked as in the collection, and without."""

from tools.results.experiment import (
    RANDOM,
    Bar,
    Crossed,
    Evaluation,
    Experiment,
    Held,
    Mark,
    Trained,
    Training,
)

PAPER = (
    "The collection reports 98.7 % of the last training episodes after 3.4 million steps of an agent with"
    " masked actions, at 307 steps "
    "a second. Its maps are drawn in another way, so the two rates cannot be compared directly."
)
MARKS = (Mark("asked for: 90 %", value=0.9), Mark("the collection: 98.7 %", value=0.987))

FRESH = (111,)
"""101 was trained with less memory, and by it that was found wanting."""

EXPERIMENTS = (
    Experiment(
        scenario="find_and_avoid",
        title="FindAndAvoid",
        prose="Held out are 100 maps with 25 obstacles. Seed 101, with less memory, succeeded on 88 of 100"
        " maps, and the "
        "scenario was changed. The result of seed 111 is equal to the bar; its interval reaches below the"
        " bar. Why not "
        "98.7 %: the failures come with the 25 obstacles, not with what the policy does not see. Where it"
        " also observed "
        "the length of the shortest way (seed 112, `--set augment.way='path_distance(rover, target)' --set "
        "observation.way='0 .. 12 m'`), it reached the target on 87 of 100 maps, and on 99 of 100 with 10"
        " obstacles. 8 of "
        "the 13 failures end `stuck`: the rover touches obstacles for 5 s.",
        trainings=(Training(FRESH, full=True, evaluations=(Evaluation(last=True),)),),
        baselines=(RANDOM,),
        bars=(
            Bar(Held("success_rate"), at_least=0.9),
            Bar(Trained("steps"), at_most=3_400_000),
            Bar(Crossed(0.987, "steps", "success"), at_most=3_400_000, stretch=True),
            Bar(Held("success_rate"), at_least=0.987, stretch=True),
        ),
        paper=PAPER,
        marks=MARKS,
        curve="success",
    ),
    Experiment(
        scenario="find_and_avoid_unmasked",
        title="FindAndAvoidUnmasked",
        prose="Plain PPO: no action is masked.",
        trainings=(Training(FRESH, full=True, evaluations=(Evaluation(last=True),)),),
        baselines=(),
        bars=(
            Bar(Held("success_rate"), at_least=0.9, stretch=True),
            Bar(Crossed(0.987, "steps", "success"), at_most=3_400_000, stretch=True),
            Bar(Held("success_rate"), at_least=0.987, stretch=True),
        ),
        paper=PAPER,
        marks=MARKS,
        curve="success",
    ),
)
