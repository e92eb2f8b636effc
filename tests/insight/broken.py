"""The trainings of `broken.yaml`, and the causes that `diagnose` names."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import yaml

from deepbots_cli import api
from deepbots_cli.errors import DeepbotsError
from deepbots_cli.insight.causes import diagnose
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
