"""Stand on two wheels."""

from tools.results.experiment import RANDOM, Ahead, Bar, Baseline, Experiment, Training, seeds

EXPERIMENTS = (
    Experiment(
        scenario="balancer",
        title="Balancer",
        prose="`lean` is a rule by hand.",
        trainings=(Training(seeds(3)),),
        baselines=(RANDOM, Baseline("lean", ("--driver", "lean"))),
        bars=(Bar(Ahead("random"), at_least=0),),
    ),
)
