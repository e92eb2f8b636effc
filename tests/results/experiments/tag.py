"""Catch a scripted prey."""

from tests.results.experiment import RANDOM, Ahead, Bar, Baseline, Experiment, Held, Training, seeds

EXPERIMENTS = (
    Experiment(
        scenario="tag",
        title="Tag",
        prose="A hunter with infrared sensors catches a prey that flees by a script, between four crates that every episode places anew. "
        "Every step costs 0.05, so a quick catch is worth more. `chase` is a rule by hand: turn towards the prey, then drive at it; it "
        "drives into the crates. Without them, PPO and `chase` were equally good. PPO, 400 000 steps.",
        trainings=(Training(seeds(1)),),
        baselines=(RANDOM, Baseline("chase", ("--driver", "chase"))),
        bars=(
            Bar(Ahead("random"), at_least=0),
            Bar(Ahead("chase"), at_least=0),
            Bar(Held("success_rate"), at_least=0.95),
        ),
        curve="success",
    ),
)
