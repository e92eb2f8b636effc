"""Reach a mark behind up to 25 obstacles, taught in six stages."""

from tests.results.experiment import RANDOM, Bar, Experiment, Mark, Training, seeds
from tests.results.figures import Held, Trained

EXPERIMENTS = (
    Experiment(
        scenario="find_and_avoid",
        title="FindAndAvoid",
        prose="A robot with thirteen sonars and two bumpers drives to a mark in an arena or a corridor with up to 25 obstacles, some "
        "of which can be pushed. It is taught in six stages, and examined in the last one's maps. MaskablePPO; one seed.",
        trainings=(Training(seeds(1)),),
        baselines=(RANDOM,),
        bars=(
            Bar(Trained("steps"), at_most=3_400_000),
            Bar(Held("success_rate", case="full"), at_least=0.9),
            Bar(Held("success_rate", case="full"), at_least=0.987, stretch=True),
        ),
        paper="The original world (2023) reports that 98.7 % of the last training episodes succeeded after 3.4 million steps, with "
        "masked actions.",
        marks=(Mark("the original, at its end: 98.7 %", value=0.987),),
        curve="success",
    ),
)
