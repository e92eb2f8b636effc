"""Fly to a point and stay there."""

from tests.results.experiment import RANDOM, Bar, Experiment, Training, seeds
from tests.results.figures import Ahead

EXPERIMENTS = (
    Experiment(
        scenario="quadrotor",
        title="Hover",
        prose="A quadrotor flies to a point and stays there in a gusty wind. SAC.",
        trainings=(Training(seeds(1)),),
        baselines=(RANDOM,),
        bars=(Bar(Ahead("random"), at_least=0),),
    ),
)
