"""The force and the torque in a joint, against closed forms, in every engine."""

from __future__ import annotations

from dataclasses import replace
from math import cos, pi, sin

import numpy as np
import pytest

from deepbots_cli.engines import create, create_batch
from deepbots_cli.program.world import RobotBody, WorldModel
from deepbots_cli.robots.model import Box, Geometry, Inertial, Joint, Link, Pose, RobotModel

ARM = ("robot", "arm")
MASS, AHEAD, ASIDE = 2.0, 0.3, 0.1
"""The mass of the arm, kg, and its center in its frame, m."""


def arm(kind: str, axis: tuple[float, float, float], turned: tuple[float, float, float] = (0, 0, 0)):
    """A weight beside the axis of a joint on a fixed base."""
    link = Link("arm", Inertial(MASS, Pose((AHEAD, ASIDE, 0), (0.3, 0.2, 0.1)), 0.02, iyy=0.03, izz=0.04))
    base = Link("base", Inertial(1.0, ixx=0.01, iyy=0.01, izz=0.01))
    joint = Joint("joint", kind, "base", "arm", Pose((0.2, 0, 0), turned), axis)
    model = RobotModel("arm", (base, link), (joint,), root="base")
    return WorldModel(0.02, 4, ground=None, robots=(RobotBody("robot", model, fixed_base=True),))


def test_a_joint_that_holds_a_weight_exerts_its_force_and_torque(engine_name, build):
    engine = build(engine_name, arm("fixed", (0, 0, 1), (0, pi / 2, 0)))  # x of the arm points down
    read = engine.joint_wrench(ARM)
    assert read() == ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    engine.step(4)
    force, torque = read()
    weight = MASS * 9.81
    assert force == pytest.approx((-weight, 0.0, 0.0), abs=1e-6)
    assert torque == pytest.approx((0.0, 0.0, ASIDE * weight), abs=1e-6)
    engine.reset()
    assert read() == ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


@pytest.mark.parametrize("motor", ["velocity_motor", "torque_motor", "position_motor"])
@pytest.mark.parametrize(("kind", "axis"), [("revolute", (0, 1, 0)), ("prismatic", (0, 0, 1))])
def test_the_wrench_includes_what_the_motor_exerts(engine_name, kind, axis, motor, build):
    engine = build(engine_name, arm(kind, axis))
    read = engine.joint_wrench(ARM)
    state = engine.joint_states("robot", ["joint"])
    weight = MASS * 9.81
    load = weight if kind == "prismatic" else -AHEAD * weight
    more = ([2000.0], [200.0]) if motor == "position_motor" else ()
    drive = getattr(engine, motor)("robot", ["joint"], [1000.0], *more)
    engine.set_joint("robot", "joint", load / 2000.0 if motor == "position_motor" else 0.0, 0.0)
    drive([load / 2000.0 + load / 2000.0 if motor == "position_motor" else load * (motor == "torque_motor")])
    engine.step(4)
    turn = state()[0][0] if kind == "revolute" else 0.0
    force, torque = read()
    assert force == pytest.approx((-weight * sin(turn), 0.0, weight * cos(turn)), rel=0.01, abs=0.3)
    expected = (ASIDE * weight * cos(turn), -AHEAD * weight * cos(turn), ASIDE * weight * sin(turn))
    assert torque == pytest.approx(expected, rel=0.01, abs=0.1)


def test_a_joint_holds_a_weight_on_a_circle(engine_name, build):
    engine = build(engine_name, replace(arm("continuous", (0, 0, 1)), gravity=(0, 0, 0)))
    read = engine.joint_wrench(ARM)
    speed = 5.0
    engine.set_joint("robot", "joint", 0.7, speed)
    engine.step(4)
    force, torque = read()
    pull = -MASS * speed**2
    assert force == pytest.approx((pull * AHEAD, pull * ASIDE, 0.0), rel=0.01, abs=0.05)
    assert torque[2] == pytest.approx(0.0, abs=0.05)


def stand(drop: float = 0.0) -> WorldModel:
    """A trunk of 5 kg on a leg of 1 kg, on the ground."""
    foot = (Geometry(Box((0.2, 0.2, 0.1))),)
    leg = Link("leg", Inertial(1.0, ixx=0.01, iyy=0.01, izz=0.01), foot, foot)
    trunk = Link("trunk", Inertial(5.0, ixx=0.1, iyy=0.1, izz=0.1))
    joint = Joint("knee", "revolute", "trunk", "leg", Pose((0, 0, -0.1)), (0, 1, 0))
    model = RobotModel("stand", (trunk, leg), (joint,), root="trunk")
    return WorldModel(0.02, 4, robots=(RobotBody("robot", model, pose=Pose((0, 0, 0.15 + drop))),))


def test_a_leg_carries_what_is_above_its_joint(engine_name, build):
    engine = build(engine_name, stand())
    hold = engine.velocity_motor("robot", ["knee"], [100.0])
    read = engine.joint_wrench(("robot", "leg"))
    hold([0.0])
    for _ in range(50):
        engine.step(4)
    force, _ = read()
    assert force == pytest.approx((0.0, 0.0, -5.0 * 9.81), rel=0.01, abs=0.1)


def test_measuring_a_wrench_changes_nothing(engine_name, build):
    poses = []
    for measured in (True, False):
        engine = build(engine_name, stand(0.1))
        if measured:
            engine.joint_wrench(("robot", "leg"))
        engine.velocity_motor("robot", ["knee"], [100.0])([0.4])
        for _ in range(30):
            engine.step(4)
        poses.append((engine.pose("robot")(), engine.pose("robot", "leg")()))
    assert poses[0] == poses[1]


@pytest.mark.parametrize("watched", [False, True])
def test_wrenches_of_a_batch_are_those_of_single_worlds(watched):
    pytest.importorskip("mujoco")
    batch = create_batch("mujoco", stand(0.1), 3)
    single = create("mujoco", stand(0.1))
    readers = [engine.joint_wrench(("robot", "leg")) for engine in (batch, single)]
    of_member = batch.members[2].joint_wrench(("robot", "leg"))
    if watched:
        batch.contact(("robot", "leg"), [("ground", None)])
    for engine in (single, *batch.members):
        engine.reset()
        engine.velocity_motor("robot", ["knee"], [100.0])([0.4])
    batch.begin_episodes()
    assert not np.any(readers[0]())
    for _ in range(30):
        batch.step(4)
        single.step(4)
        together, alone = (read() for read in readers)
        np.testing.assert_allclose(np.array(together)[..., 1], alone, rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(of_member(), np.array(together)[..., 2])
    assert np.abs(alone[0]).max() > 1.0


def test_a_waiting_world_keeps_its_wrench_when_another_sensor_is_added():
    pytest.importorskip("mujoco")
    batch = create_batch("mujoco", stand(0.1), 2)
    read = batch.joint_wrench(("robot", "leg"))
    for engine in batch.members:
        engine.reset()
        engine.velocity_motor("robot", ["knee"], [100.0])([0.4])
    batch.begin_episodes()
    for _ in range(5):
        batch.step(4)
    before = np.array(read())[..., 1].copy()
    batch.contact(("robot", "leg"), [("ground", None)])
    batch.step(1, np.array([True, False]))
    assert np.any(before)
    np.testing.assert_array_equal(np.array(read())[..., 1], before)


def test_a_reading_of_a_batch_of_one_stays_as_it_was():
    pytest.importorskip("mujoco")
    batch = create_batch("mujoco", stand(0.1), 1)
    read = batch.joint_states("robot", ["knee"])
    (member,) = batch.members
    member.reset()
    member.velocity_motor("robot", ["knee"], [100.0])([0.4])
    batch.begin_episodes()
    batch.step(4)
    positions = read()
    first = np.array(positions)
    batch.step(4)
    np.testing.assert_array_equal(positions, first)
    assert np.any(np.array(read()) != first)
