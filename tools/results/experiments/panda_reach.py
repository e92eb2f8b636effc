"""Bring the fingertips of an arm to a place in space."""

from tools.results.experiment import RANDOM, Bar, Experiment, Held, Mark, Trained, Training

FRESH = (111, 112, 113)
"""101 to 103 were trained with longer steps, and by them those were found wanting."""

EXPERIMENTS = (
    Experiment(
        scenario="panda_reach",
        title="PandaReach",
        prose="Success: the fingertips are within 1 cm of the target in the last step; in the case `fine`,"
        " within 5 mm. The case "
        "`nine` has the nine targets of the original. Seeds 101 to 103, with steps of 0.05 rad, had 90, 79"
        " and 97 % (bar: 95 "
        "%), and the settings were changed.",
        trainings=(
            Training(FRESH, full=True),
            Training(FRESH, name="long", timesteps=30_000, full=True, words="30 000 steps"),
        ),
        baselines=(RANDOM,),
        bars=(
            Bar(Held("success_rate"), at_least=0.95),
            Bar(Trained("steps"), at_most=15_000),
            Bar(Held("success_rate", case="fine", training="long"), at_least=0.99, stretch=True),
        ),
        paper="The original needed about 32 000 episodes of at most 300 steps for its nine targets, up to 85"
        " simulated hours; its "
        "reward paid more for hovering near the target than for arriving.",
        marks=(Mark("95 %", value=0.95),),
        curve="success",
    ),
)
