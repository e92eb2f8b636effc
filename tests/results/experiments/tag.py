"""Catch a scripted prey."""

from tests.results.experiment import RANDOM, Bar, Experiment, Training, seeds
from tests.results.figures import Ahead

EXPERIMENTS = (
    Experiment(
        scenario="tag",
        title="Tag",
        prose="A hunter with infrared sensors catches a prey that flees by a script. PPO.",
        trainings=(Training(seeds(1)),),
        baselines=(RANDOM,),
        bars=(Bar(Ahead("random"), at_least=0),),
        curve="success",
    ),
)
