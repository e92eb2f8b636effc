"""How often the interval that `train` prints for its best model includes the mean return of many fresh
episodes.

Trainings of CartPole end after 5,000 steps, a fifth of what a solved one took, so the best of their
evaluations is chosen among policies of very different quality. `python -m tools.results.best_model_bias 7001
7100` trains one for each of these seeds. Every best model then plays 2,000 fresh episodes.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch

from deepbots_cli.learning import evaluate, evaluate_trained, train
from deepbots_cli.learning.runs.run import Run

STEPS, FRESH_EPISODES = 5_000, 2_000


def measure(seed: int, folder: Path) -> tuple[float, float, tuple[float, float], float]:
    """The mean return that chose the best model, the printed one with its interval, and that of fresh
    episodes."""
    result = train(
        "cartpole", seed=seed, total_timesteps=STEPS, run=folder / f"cartpole-{seed}", engine="mujoco"
    )
    run = Run.open(result.run)
    printed = evaluate_trained(run)
    fresh = evaluate(run, episodes=FRESH_EPISODES, seed=next(n for n in count(900_000) if n != printed.seed))
    assert result.best is not None
    assert result.best.mean_return is not None
    assert printed.return_interval is not None
    return result.best.mean_return, printed.mean_return, printed.return_interval, fresh.mean_return


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("first", type=int)
    parser.add_argument("last", type=int)
    options = parser.parse_args(arguments)
    torch.set_num_threads(1)
    chosen, printed, held = [], [], 0
    with TemporaryDirectory() as folder:
        for seed in range(options.first, options.last + 1):
            by, mean, (low, high), fresh = measure(seed, Path(folder))
            chosen.append(by - fresh)
            printed.append(mean - fresh)
            held += low <= fresh <= high
            print(
                f"{seed}: chosen by {by:.1f}, printed {mean:.1f} ({low:.1f} .. {high:.1f}), fresh"
                f" {fresh:.1f}",
                flush=True,
            )
    for name, bias in (("episodes that chose the model", chosen), ("printed result", printed)):
        error = np.std(bias, ddof=1) / np.sqrt(len(bias))
        print(f"bias of the {name}: {np.mean(bias):+.2f} +- {error:.2f} (standard error)")
    print(f"{held} of {len(printed)} intervals include the mean of {FRESH_EPISODES:,} fresh episodes")


if __name__ == "__main__":
    main()
