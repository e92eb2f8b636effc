"""Carts on a rail whose messages are late or lost as a test sets it; the exact engine moves them."""

from __future__ import annotations

import pytest

from deepbots_cli.runtime import Supervisor
from tests.worlds import Make

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
def cart(make: Make) -> Make:
    """Makes the cart, or another `source`, with settings, `more` sections and the section of a `rival`."""

    def make_cart(
        *overrides: str, more: str = "", source: str = CART, rival: str = "", engine: str = "exact"
    ) -> Supervisor:
        text = source.replace("observation:", f"{rival}observation:") + more
        return make(text, *overrides, engine=engine)

    return make_cart
