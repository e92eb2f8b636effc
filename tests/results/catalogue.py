"""All experiments: those of the modules in experiments/, found by themselves."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from pathlib import Path

from tests.results.experiment import Experiment
from tests.results.experiments.not_measured import REASONS

FIRST = (
    "cartpole",
    "cartpole_continuous",
    "multi_cartpole",
    "pit_escape",
    "find_ball",
    "find_ball_random",
    "find_and_avoid",
    "find_and_avoid_unmasked",
    "panda_reach",
    "panda_push",
)
"""The order on the page; the others follow by name."""


@cache
def experiments() -> dict[str, Experiment]:
    """By name, in the order of the page."""
    found = {}
    for path in sorted((Path(__file__).parent / "experiments").glob("*.py")):
        if path.stem != "not_measured":
            for experiment in import_module(f"tests.results.experiments.{path.stem}").EXPERIMENTS:
                found[experiment.name] = experiment
    order = [*(name for name in FIRST if name in found), *sorted(set(found) - set(FIRST))]
    return {name: found[name] for name in order}


def reasons() -> dict[str, str]:
    """Why a shipped scenario has no experiment."""
    return REASONS
