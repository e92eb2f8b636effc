"""Facts about surfaces for the supervisor: gaps, contacts, collisions."""

from __future__ import annotations

import numpy as np
import pytest

from deepbots_cli.runtime import Supervisor
from tests.worlds import Make

WORLD = """\
deepbots: 1
name: Facts
world: {timestep: 20 ms, substeps: 4, arena: {size: 2 2 m, wall_height: 0.1 m}}
objects:
  ball: {shape: sphere, radius: 7 cm, mass: 0.1 kg}
  block: {shape: box, size: 10 20 30 cm, fixed: true}
robots:
  cart:
    urdf: epuck
    groups: {feet: [caster_*]}
    actuators: {wheels: {type: velocity_motor, joints: [left_wheel, right_wheel], max_torque: 0.05 N*m}}
    apply: {wheels: gas * 6 rad/s}
action: {gas: -1 .. 1}
augment:
  apart: clearance(cart, ball)
  between: clearance(block, ball)
observation: {apart: 0 .. 2 m, between: 0 .. 2 m}
reward:
  touches: 1 when contact(cart, block)
  wheels: 1 when contact(cart, ground) and not any(contact(cart.feet, block))
  bumped: 1 when collided(cart)
  landed: 1 when contact(ball, ground)
truncation: {max_steps: 100}
reset: {place: {cart: {x: -0.3 m, y: 0 m}, ball: {x: 0.5 m, y: 0.6 m, z: 0.2 m}, block: {x: 0 m, y: 0 m}}}
"""


@pytest.fixture
def environment(make: Make) -> Supervisor:
    return make(WORLD)


def test_gaps_are_between_surfaces(environment: Supervisor) -> None:
    observation, _ = environment.reset(seed=0)
    apart, between = (observation + 1.0) / 2.0 * 2.0
    x = 0.5 - 0.05
    y = 0.6 - 0.1
    z = 0.05  # from the nearest edge of the block to the middle of the ball
    assert between == pytest.approx(
        (x * x + y * y) ** 0.5 - 0.07, abs=1e-3
    )  # the engine rounds the edges of a box
    assert (
        (0.8**2 + 0.6**2 + (0.2 - z) ** 2) ** 0.5 - 0.07 - 0.045
        < apart
        < (0.8**2 + 0.6**2 + 0.2**2) ** 0.5 - 0.07 - 0.02
    )


def test_contact_terms_name_what_touches_what(environment: Supervisor) -> None:
    environment.reset(seed=0)
    steps = []
    for _ in range(100):
        terms = environment.step(np.array([1.0]))[4]["reward_terms"]
        steps.append(terms)
        assert terms["bumped"] == terms["touches"], "the block is all that the cart can bump into"
    landed = next(index for index, terms in enumerate(steps) if terms["landed"])
    assert landed == pytest.approx((2 * (0.2 - 0.07) / 9.81) ** 0.5 / 0.02, abs=1.5)
    assert steps[0]["wheels"] == 1.0
    assert not steps[0]["touches"]
    reached = next(index for index, terms in enumerate(steps) if terms["touches"])
    assert reached == pytest.approx((0.3 - 0.05 - 0.037) / (6 * 0.02) / 0.02, rel=0.15)
