"""Small worlds on a rail, written per test; the exact engine moves them so that every figure can be worked
out by hand."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from deepbots_cli import api
from deepbots_cli.runtime import Supervisor

DATA = Path(__file__).parents[1] / "data" / "scenarios"

HEAD = """\
deepbots: 1
name: Small
world: {timestep: 20 ms, substeps: 4}
observation: {cart.place: -2.4 .. 2.4 m}
action: {drive: -1 .. 1}
messages: {format: struct}
truncation: {max_steps: 1000}
"""
ROBOT = """\
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
"""


@pytest.fixture
def make() -> Iterator[Callable[..., Supervisor]]:
    """Makes environments, and closes them after the test."""
    opened: list[Supervisor] = []

    def make_one(source: str | Path, *overrides: str, engine: str = "exact") -> Supervisor:
        opened.append(api.make(source, overrides=overrides, engine=engine))
        return opened[-1]

    yield make_one
    for environment in opened:
        environment.close()


@pytest.fixture
def small(tmp_path: Path, make: Callable[..., Supervisor]) -> Callable[..., Supervisor]:
    """Makes an environment of a cart on a rail with further sections: `small("reward: {a: 1}")`."""

    def make_small(sections: str, *overrides: str, robot: str = ROBOT, engine: str = "exact") -> Supervisor:
        file = tmp_path / "small.yaml"
        file.write_text(HEAD + robot + sections)
        return make(file, *overrides, engine=engine)

    return make_small


@pytest.fixture
def rail() -> Path:
    return DATA / "rail.yaml"
