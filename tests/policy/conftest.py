"""A small world on a rail, written per test; the exact engine moves it, so that every figure can be worked
out by hand."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from deepbots_cli import api
from deepbots_cli.runtime import Supervisor

WORLD = """\
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


@pytest.fixture
def small(tmp_path: Path) -> Iterator[Callable[..., Supervisor]]:
    """Makes an environment of that world with further sections and assignments, and closes it after the
    test."""
    opened: list[Supervisor] = []

    def make(sections: str, *overrides: str, engine: str = "exact") -> Supervisor:
        file = tmp_path / "small.yaml"
        file.write_text(WORLD + sections)
        opened.append(api.make(file, overrides=overrides, engine=engine))
        return opened[-1]

    yield make
    for environment in opened:
        environment.close()
