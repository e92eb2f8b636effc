"""The angular momentum of a robot about its center of mass, against closed forms, in every engine."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from deepbots_cli import frames
from deepbots_cli.engines import create, create_batch
from deepbots_cli.program.world import RobotBody, WorldModel
from deepbots_cli.robots.model import Inertial, Joint, Link, Pose, RobotModel

HULL, WEIGHT, APART, MOMENT = 3.0, 2.0, 0.5, 0.04


def dumbbell(*, fixed: bool = False) -> WorldModel:
    """A hull with a weight that a hinge along its x axis holds, beside it."""
    links = (
        Link("hull", Inertial(HULL, ixx=0.1, iyy=0.2, izz=0.3)),
        Link("weight", Inertial(WEIGHT, Pose((0, APART, 0)), ixx=MOMENT, iyy=MOMENT, izz=MOMENT)),
    )
    hinge = Joint("hinge", "continuous", "hull", "weight", axis=(1, 0, 0))
    model = RobotModel("dumbbell", links, (hinge,), root="hull")
    return WorldModel(0.02, 4, (0, 0, 0), None, robots=(RobotBody("robot", model, fixed),))


@pytest.mark.parametrize("speed", [(0, 0, 0), (3, -2, 1)])
def test_a_turning_body_has_its_inertia_times_its_angular_velocity_wherever_it_flies(
    engine_name, speed, build
):
    engine = build(engine_name, dumbbell())
    read = engine.angular_momentum("robot")
    turned = frames.quaternion(0.4, -0.3, 1.1)
    spin = (0.5, 0.8, -1.2)  # in the frame of the hull
    engine.place("robot", (5, -7, 3), turned, speed, frames.rotate(turned, spin))
    reduced = HULL * WEIGHT / (HULL + WEIGHT) * APART**2
    inertia = np.array([0.1 + MOMENT + reduced, 0.2 + MOMENT, 0.3 + MOMENT + reduced])
    expected = frames.rotate(turned, tuple(inertia * spin))
    assert read() == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("fixed", [False, True])
def test_a_joint_that_turns_adds_the_momentum_of_what_it_carries(engine_name, fixed, build):
    engine = build(engine_name, dumbbell(fixed=fixed))
    read = engine.angular_momentum("robot")
    assert read() == (0.0, 0.0, 0.0)
    engine.set_joint("robot", "hinge", 0.0, 2.0)
    reduced = HULL * WEIGHT / (HULL + WEIGHT) * APART**2
    assert read() == pytest.approx(((MOMENT + reduced) * 2.0, 0.0, 0.0), rel=1e-9, abs=1e-12)


def test_nothing_outside_changes_it_and_a_drawn_mass_does(engine_name, build):
    engine = build(engine_name, dumbbell())
    read = engine.angular_momentum("robot")
    engine.place("robot", (0, 0, 1), (0, 0, 0, 1), (0, 0, 0), (0.3, 0.2, 0.5))
    before = read()
    engine.torque_motor("robot", ["hinge"], [1.0])([0.2])
    for _ in range(10):
        engine.step(4)
    assert read() == pytest.approx(before, abs=0.01)
    engine.reset()
    engine.set_parameter("mass", ("robot", "weight"), 2 * WEIGHT)
    engine.place("robot", (0, 0, 1), (0, 0, 0, 1), (0, 0, 0), (1.0, 0, 0))
    reduced = HULL * 2 * WEIGHT / (HULL + 2 * WEIGHT) * APART**2
    assert read()[0] == pytest.approx(0.1 + 2 * MOMENT + reduced, rel=1e-9)


def test_momenta_of_a_batch_are_those_of_single_worlds():
    pytest.importorskip("mujoco")
    world = replace(dumbbell(), gravity=(0, 0, -9.81))
    batch = create_batch("mujoco", world, 3)
    single = create("mujoco", world)
    readers = [engine.angular_momentum("robot") for engine in (batch, single)]
    of_member = batch.members[2].angular_momentum("robot")
    for engine in (single, *batch.members):
        engine.reset()
        engine.set_parameter("mass", ("robot", "weight"), 1.5 * WEIGHT)
        engine.place("robot", (0, 0, 1), (0, 0, 0, 1), (0, 1, 0), (0.3, 0.2, 0.5))
        engine.torque_motor("robot", ["hinge"], [1.0])([0.4])
    batch.begin_episodes()
    for _ in range(10):
        np.testing.assert_allclose(readers[0]()[:, 1], readers[1](), rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(of_member(), readers[1](), rtol=1e-9, atol=1e-12)
        batch.step(4)
        single.step(4)
