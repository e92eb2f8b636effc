"""Catch a scripted prey."""

from tools.results.experiment import RANDOM, Ahead, Bar, Baseline, Experiment, Held, Training, seeds

EXPERIMENTS = (
    Experiment(
        scenario="tag_scripted",
        title="TagScripted",
        prose="`chase` is a rule by hand: it turns towards the prey, then drives at it. Without the crates,"
        " PPO and `chase` were "
        "equally good.",
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
