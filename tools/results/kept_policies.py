"""Whether the policy that a training keeps is as good as the best of all models that the run has.

`python -m tools.results.kept_policies 11 14` trains the A1 of `stair.yaml` from these seeds, with each of
three rewards, and saves models at equal intervals. Every model of a run then plays the same 100 new starts.
The kept policy passes if its success rate is within Wilson's 95 % interval of the best one.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import torch

from deepbots_cli import api
from deepbots_cli.learning import evaluate, train
from deepbots_cli.learning.runs.run import ModelRef, Run, has_model, steps_of
from deepbots_cli.learning.runs.statistics import wilson

SCENARIO = Path(__file__).with_name("stair.yaml")
STEPS, CHECKPOINTS, EPISODES, SEED = 500_000, 5, 100, 31
REWARDS = {
    "bonus": [],
    "hovering": ["reward.climbed=10 when on_top"],  # waiting in front of the stair pays more
    "progress": ["reward.climbed=100 when on_top", "reward.forward=60 * delta(position(dog).x) / m"],
}


def success_rates(run: Run) -> dict[int, float]:
    """The success rates of all models of a run on the same starts, by their steps."""
    rates: dict[int, float] = {}
    for path in sorted(run.model("best").parent.glob("*.zip")):
        name, steps = path.stem, steps_of(path)
        if steps in rates or not has_model(run.path, name):
            continue  # two models with the same steps are the same model
        result = evaluate(ModelRef(run, name, is_named=True), episodes=EPISODES, seed=SEED)
        assert result.success_rate is not None
        rates[steps] = result.success_rate
    return rates


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("first", type=int)
    parser.add_argument("last", type=int)
    parser.add_argument("--rewards", nargs="*", default=list(REWARDS))
    options = parser.parse_args(arguments)
    torch.set_num_threads(1)
    passed, count = 0, 0
    with TemporaryDirectory() as folder:
        for seed in range(options.first, options.last + 1):
            for name in options.rewards:
                compiled = api.compile(api.load(str(SCENARIO), overrides=REWARDS[name]))
                path = Path(folder) / f"{name}-{seed}"
                result = train(
                    compiled, total_timesteps=STEPS, seed=seed, run=path, keep_checkpoints=CHECKPOINTS
                )
                rates = success_rates(Run.open(path))
                assert result.best is not None
                kept_steps = result.best.steps
                assert kept_steps is not None
                kept, best = rates[kept_steps], max(rates.values())
                low, high = wilson(round(best * EPISODES), EPISODES)
                passed, count = passed + (kept >= low), count + 1
                at = next(steps for steps, rate in rates.items() if rate == best)
                print(
                    f"{name} {seed}: kept the model of {kept_steps:,} steps, {kept:.1%}; "
                    f"best of {len(rates)} models that of {at:,} steps, {best:.1%} ({low:.1%} .. {high:.1%})",
                    flush=True,
                )
    print(f"{passed} of {count} kept policies are within the interval of the best one")


if __name__ == "__main__":
    main()
