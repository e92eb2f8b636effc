"""Stand on two wheels."""

from tests.results.experiment import RANDOM, Ahead, Bar, Baseline, Experiment, Training, seeds

EXPERIMENTS = (
    Experiment(
        scenario="balancer",
        title="Balancer",
        prose="A robot on two wheels stands upright for ten seconds by a noisy inertial sensor alone. PPO; `lean` is a rule by hand.",
        trainings=(Training(seeds(3)),),
        baselines=(RANDOM, Baseline("lean", ("--driver", "lean"))),
        bars=(Bar(Ahead("random"), at_least=0),),
    ),
)
