"""Push a block to a mark."""

from tools.results.experiment import RANDOM, Ahead, Bar, Baseline, Experiment, Held, Training, seeds

EXPERIMENTS = (
    Experiment(
        scenario="panda_push",
        title="PandaPush",
        prose="",
        trainings=(Training(seeds(1)),),
        baselines=(
            RANDOM,
            Baseline("by_hand", ("--driver", "by_hand"), words="gets behind the block and pushes"),
        ),
        bars=(
            Bar(Ahead("random"), at_least=0),
            Bar(Held("success_rate"), at_least=0.9),
        ),
        curve="success",
    ),
)
