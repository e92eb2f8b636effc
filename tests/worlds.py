"""Environments of small scenarios, which tests write in a few lines of YAML."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

from deepbots_cli import api

SCENARIOS = Path(__file__).parent / "data" / "scenarios"
RAIL = SCENARIOS / "rail.yaml"
CART = """\
deepbots: 1
name: Small
world: {timestep: 20 ms, substeps: 4}
robots:
  cart:
    urdf: cartpole_rail
    base: fixed
    sensors:
      place: {type: joint_position, joint: slider}
      rate:  {type: joint_velocity, joint: slider}
      lean:  {type: joint_position, joint: hinge}
    actuators:
      motor: {type: velocity_motor, joint: slider, max_torque: 10 N}
    emit: [place, rate, lean]
    apply: {motor: drive * 0.02 m/s}
observation: {cart.place: -2.4 .. 2.4 m}
action: {drive: -1 .. 1}
truncation: {max_steps: 1000}
"""
"""A cart on a rail, without a reward. The engine `exact` moves it, so that a test can compute every
number."""


Make = Callable[..., Any]
"""Makes environments of a scenario, as a fixture."""


def begun(environment: Any, seed: int = 0) -> Any:
    """Begin an episode, and return the environment."""
    environment.reset(seed=seed)
    return environment


class Maker:
    """Makes environments, and closes all of them with `close`."""

    def __init__(self, folder: Path) -> None:
        self.file = folder / "scenario.yaml"
        self._opened = ExitStack()

    def __call__(self, source: Any, *overrides: str, **options: Any) -> Any:
        """An environment of a text of several lines, or of what `api.make` takes.

        Args:
            source: The text, which is written to `file`; a path; the name of a shipped scenario.
            overrides: Settings, as in `world.substeps=2`.
            options: Further arguments of `api.make`, as in `engine="exact"`.
        """
        environment = api.make(self.written(source), overrides=overrides, **options)
        return self._opened.enter_context(closing(environment))

    def written(self, source: Any) -> Any:
        """Write a text to `file` and return its path; return any other source as it is."""
        if not isinstance(source, str) or "\n" not in source:
            return source
        self.file.write_text(source, encoding="utf-8")
        return self.file

    def close(self) -> None:
        self._opened.close()

    def small(self, sections: str, *overrides: str, robot: str = "", engine: str = "exact") -> Any:
        """The cart on a rail with further sections, as in `small("reward: {a: 1}", "world.substeps=2")`;
        `robot` replaces its section `robots`.
        """
        head, rest = CART.split("robots:\n")
        text = f"{head}{robot}{rest[rest.index('observation:') :]}" if robot else CART
        return self(text + sections, *overrides, engine=engine)
