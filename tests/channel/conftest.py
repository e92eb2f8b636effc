"""Carts on a rail whose messages meet what a test says; the exact engine moves them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from deepbots_cli import api
from deepbots_cli.runtime import Supervisor

CART = """\
deepbots: 1
name: Cart
world: {timestep: 20 ms, substeps: 2}
robots:
  cart:
    urdf: cartpole_rail
    joints: {slider: {max_torque: 1000 N}}
    base: fixed
    sensors:
      place: {type: joint_position, joint: slider}
      rate:  {type: joint_velocity, joint: slider}
    actuators:
      motor: {type: velocity_motor, joint: slider, max_torque: 1000 N}
    emit: [place, rate]
    apply: {motor: drive * 0.1 m/s}
observation: {cart.place: -2.4 .. 2.4 m}
action: {drive: -1 .. 1}
truncation: {max_steps: 1000}
reward: {sent: cart.rate / (0.1 m/s), truth: joint_velocity(cart.slider) / (0.1 m/s)}
"""


@pytest.fixture
def make(tmp_path: Path) -> Iterator[Callable[..., Supervisor]]:
    """As in `make("messages.to_robot={latency: 20 ms}")`, with `more` sections, a further robot, or of
    another `text`."""
    opened: list[Supervisor] = []

    def make_one(
        *overrides: str, more: str = "", text: str = CART, rival: str = "", engine: str = "exact"
    ) -> Supervisor:
        file = tmp_path / f"cart_{len(opened)}.yaml"
        file.write_text(text.replace("observation:", f"{rival}observation:") + more)
        opened.append(api.make(file, overrides=overrides, engine=engine))
        return opened[-1]

    yield make_one
    for environment in opened:
        environment.close()
