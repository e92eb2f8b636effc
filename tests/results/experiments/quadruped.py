"""Walk and turn as told."""

from tests.results.experiment import RANDOM, Ahead, Bar, Baseline, Experiment, Training, seeds

EXPERIMENTS = (
    Experiment(
        scenario="quadruped",
        title="A1Velocity",
        prose="A quadruped of twelve joints is told every 5 s how fast to walk and to turn, and is pushed. PPO. The training here is a "
        "fiftieth of the 20 million steps that the scenario is meant for, enough to tell it from chance. Standing is to beat.",
        trainings=(Training(seeds(1), timesteps=400_000, words="400 000 steps"),),
        baselines=(RANDOM, Baseline("standing", ("--policy", "zero"), words="every joint where it stands")),
        bars=(Bar(Ahead("random"), at_least=0), Bar(Ahead("standing"), at_least=0, stretch=True)),
    ),
)
