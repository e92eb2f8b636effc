"""The trainings of `broken.yaml`: train them, and compare the first cause that `diagnose` names with the
planted one.

python -m tests.insight.broken 951 952          # all, with these seeds, in a temporary folder
python -m tests.insight.broken 951 --runs DIR   # and keep the runs
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import torch
import yaml

from deepbots_cli import api
from deepbots_cli.errors import DeepbotsError
from deepbots_cli.insight.diagnosis import diagnose
from deepbots_cli.insight.training import read_training, run_probes
from deepbots_cli.learning import train
from deepbots_cli.learning.runs.run import Run

LIST = Path(__file__).with_name("broken.yaml")
BROKEN = yaml.safe_load(LIST.read_text("utf-8"))


def causes(entry: dict, seed: int, run: Path) -> list[str]:
    """Train one of the list, if that was not done, and name the causes of its failure, the most likely
    first."""
    scenario = LIST.with_name(entry["scenario"]) if entry["scenario"].endswith(".yaml") else entry["scenario"]
    if not run.exists():
        compiled = api.compile(api.load(scenario, overrides=entry["set"]))
        try:
            train(compiled, total_timesteps=entry["timesteps"], seed=seed, run=run)
        except DeepbotsError:
            if not entry.get("fails"):
                raise
    training = read_training(Run.open(run))
    run_probes(training)
    return [statement.cause for statement in diagnose(training)] or ["none"]


def all_causes(seed: int, folder: Path) -> Iterator[tuple[dict, list[str]]]:
    for entry in BROKEN:
        yield entry, causes(entry, seed, folder / f"{entry['name']}-{seed}")


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("seeds", type=int, nargs="+")
    parser.add_argument("--runs", type=Path)
    options = parser.parse_args(arguments)
    torch.set_num_threads(1)
    with TemporaryDirectory() as temporary:
        for seed in options.seeds:
            right = 0
            for entry, ranked in all_causes(seed, options.runs or Path(temporary)):
                right += ranked[0] == entry["cause"]
                mark = "" if ranked[0] == entry["cause"] else f"  planted: {entry['cause']}"
                print(f"{seed}  {entry['name']:16} {', '.join(ranked)}{mark}", flush=True)
            print(
                f"{seed}  {right} of {len(BROKEN)}, CPU time so far {time.process_time():.0f} s", flush=True
            )


if __name__ == "__main__":
    main()
