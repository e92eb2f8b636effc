"""Fly to a point and stay there."""

from tools.results.experiment import RANDOM, Ahead, Bar, Baseline, Experiment, Held, Trained, Training, seeds

EXPERIMENTS = (
    Experiment(
        scenario="quadrotor",
        title="Hover",
        prose="Success: the drone stays within 30 cm of the point for the last 5 of 8 seconds.",
        trainings=(Training(seeds(3)),),
        baselines=(RANDOM, Baseline("zero", ("--driver", "zero"), words="hovering thrust on every rotor")),
        bars=(
            Bar(Ahead("random"), at_least=0),
            Bar(Held("success_rate"), at_least=0.9),
            Bar(Trained("cpu_seconds"), at_most=360),
        ),
        curve="success",
    ),
)
