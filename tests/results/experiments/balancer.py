"""Stand on two wheels."""

from tests.results.experiment import RANDOM, Bar, Experiment, Training, seeds
from tests.results.figures import Ahead

EXPERIMENTS = (
    Experiment(
        scenario="balancer",
        title="Balancer",
        prose="A robot on two wheels stands upright for ten seconds by a noisy inertial sensor alone. SAC.",
        trainings=(Training(seeds(3)),),
        baselines=(RANDOM,),
        bars=(Bar(Ahead("random"), at_least=0),),
    ),
)
