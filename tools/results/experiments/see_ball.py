"""Find a ball by camera alone."""

from tools.results.experiment import RANDOM, Ahead, Bar, Baseline, Experiment, Training, seeds

EXPERIMENTS = (
    Experiment(
        scenario="see_ball",
        title="SeeBall",
        prose="",
        trainings=(Training(seeds(1)),),
        baselines=(RANDOM, Baseline("zero", ("--driver", "zero"))),
        bars=(Bar(Ahead("random"), at_least=0), Bar(Ahead("zero"), at_least=0)),
        curve="success",
    ),
)
