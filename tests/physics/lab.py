"""Small scenarios whose motion has a closed form: from text to what the policy sees, so that a figure is what
a user gets."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deepbots_cli import api
from deepbots_cli.runtime import Supervisor

TEXT = """\
deepbots: 1
name: Trial
world: {{timestep: {timestep}, substeps: {substeps}{world}}}
objects: {{{objects}}}
robots: {{{robots}}}
action: {{push: -1 .. 1}}
augment: {{{augment}}}
observation: {{{observation}}}
reward: {{one: 1}}
truncation: {{max_steps: 1_000_000}}
reset: {{{reset}}}
disturbances: {{{disturbances}}}
"""
ENGINE = ContextVar("engine", default="pybullet")
"""The engine of all trials."""
BYSTANDER = (
    "bystander: {urdf: cartpole_rail, base: fixed, pose: {x: 50 m, z: 50 m},"
    " actuators: {motor: {type: torque_motor, joint: slider}}, apply: {motor: push * 0 N}}"
)
"""The one that acts where nobody else does: a scenario has an action."""


@dataclass(frozen=True)
class Trial:
    """A scenario that is running; its rows are in the units that the scenario names, one column for each
    thing seen."""

    environment: Supervisor
    timestep: float

    def run(self, ticks: int, push: float = 0.0, seed: int = 0) -> np.ndarray[Any, Any]:
        """The observations after the reset and after each of some ticks, float64[ticks + 1, columns]."""
        action = np.array([push], np.float32)
        rows = [self.environment.reset(seed=seed)[0]]
        rows += [self.environment.step(action)[0] for _ in range(ticks)]
        return np.array(rows, np.float64)

    def times(self, ticks: int) -> np.ndarray[Any, Any]:
        return self.timestep * np.arange(ticks + 1)


def flow(entries: dict[str, str]) -> str:
    return ", ".join(f"{name}: {value}" for name, value in entries.items())


def off(measured: float, expected: float, scale: float | None = None) -> float:
    """By how many percent of `scale`, or else of what is expected, a figure is off."""
    return float(100 * abs(measured - expected) / abs(expected if scale is None else scale))


@contextmanager
def trial(
    see: dict[str, tuple[str, str]],
    *,
    timestep: float = 0.02,
    substeps: int = 4,
    world: str = "",
    objects: str = "",
    robot: str = "",
    reset: str = "",
    disturbances: str = "",
    files: dict[str, str] | None = None,
) -> Iterator[Trial]:
    """Opens a scenario with a robot `subject`, or without one.

    `see` gives each thing that is seen its expression and unit; one whose name has a dot is a field of a
    message.
    """
    text = TEXT.format(
        timestep=f"{timestep!r} s",
        substeps=substeps,
        world=world and f", {world}",
        objects=objects,
        robots=", ".join(
            [*([f"subject: {{{robot}}}"] if robot else []), *([] if "apply:" in robot else [BYSTANDER])]
        ),
        augment=flow({name: f"'{expression}'" for name, (expression, _) in see.items() if "." not in name}),
        observation=flow(
            {name: f"{{range: -1 .. 1{unit and ' ' + unit}, clip: false}}" for name, (_, unit) in see.items()}
        ),
        reset=reset,
        disturbances=disturbances,
    )
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "pyproject.toml").touch()
        for file, content in {"trial.yaml": text, **(files or {})}.items():
            (folder / file).write_text(content, encoding="utf-8")
        with closing(api.make(folder / "trial.yaml", engine=ENGINE.get())) as environment:
            yield Trial(environment, timestep)
