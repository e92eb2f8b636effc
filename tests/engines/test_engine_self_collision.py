"""Links of one robot that touch each other, in every engine that supports it."""

from __future__ import annotations

from math import asin, atan2, hypot, pi, radians

import numpy as np
import pytest

from deepbots_cli.engines import create, create_batch
from deepbots_cli.engines.mechanics import self_collision_pairs
from deepbots_cli.port import Engine
from deepbots_cli.program.world import RobotBody, WorldModel
from deepbots_cli.robots.model import Box, Geometry, Inertial, Joint, Link, Pose, RobotModel

REACH, THICK = 0.5, 0.06


def pincers(self_collision: bool = True, gravity: tuple[float, float, float] = (0, 0, 0)) -> WorldModel:
    """Two fingers that turn about vertical hinges 0.4 m apart, each with a tip that a fixed joint holds, on a
    base between them that overlaps both."""

    def part(name: str, size: tuple[float, float, float], x: float, mass: float) -> Link:
        shape = (Geometry(Box(size), Pose((x, 0, 0))),)
        return Link(name, Inertial(mass, Pose((x, 0, 0)), ixx=0.01, iyy=0.01, izz=0.01), shape, shape)

    links = [part("base", (THICK, 0.5, THICK), 0.0, 5.0)]
    joints = []
    for side, y in (("left", 0.2), ("right", -0.2)):
        links += [part(side, (REACH, THICK, THICK), REACH / 2, 0.5)]
        links += [part(f"{side}_tip", (THICK, THICK, THICK), 0.0, 0.1)]
        joints += [Joint(f"{side}_hinge", "revolute", "base", side, Pose((0, y, 0)), (0, 0, 1))]
        joints += [Joint(f"{side}_end", "fixed", side, f"{side}_tip", Pose((REACH, 0, 0)))]
    model = RobotModel("pincers", tuple(links), tuple(joints), root="base")
    robot = RobotBody("robot", model, True, Pose((0, 0, 1)), self_collision)
    return WorldModel(0.02, 4, gravity, ground=None, robots=(robot,))


def close(engine: Engine, ticks: int = 60) -> list[float]:
    """Press the fingers together with 2 N m each, and return their angles."""
    engine.torque_motor("robot", ["left_hinge", "right_hinge"], [10.0, 10.0])([-2.0, 2.0])
    for _ in range(ticks):
        engine.step(4)
    return [state[0] for state in engine.joint_states("robot", ["left_hinge", "right_hinge"])()]


def test_links_of_a_robot_pass_through_each_other_by_default(engine_name, build):
    engine = build(engine_name, pincers(self_collision=False))
    left, right = close(engine, 30)
    assert left < radians(-60)
    assert right > radians(60)


def test_links_stop_each_other_and_report_the_contact(engine_name, build):
    engine = build(engine_name, pincers())
    tips = ("robot", "left_tip"), ("robot", "right_tip")
    contact, other_way = engine.contact(tips[0], [tips[1]]), engine.contact(tips[1], [tips[0]])
    anything, collided = engine.contact(tips[1]), engine.contact(("robot", None), ground=False)
    base = engine.contact(("robot", "base"))
    engine.step(4)
    assert not any(read() for read in (contact, other_way, anything, collided, base))
    engine.reset()
    left, right = close(engine)
    half = THICK / 2  # the inner corners of the tips meet between the hinges
    angle = asin(0.2 / hypot(REACH + half, half)) - atan2(half, REACH + half)
    assert (right - left) / 2 == pytest.approx(angle, abs=0.01)
    assert all(read() for read in (contact, other_way, anything, collided))
    assert not base()


def test_the_forces_of_two_links_on_each_other_are_opposite_and_known(engine_name, build):
    """The tips push each other apart at the distance of the hinge, against 2 N m."""
    engine = build(engine_name, pincers())
    names = ("left", "left_tip", "right", "right_tip", None)
    vectors = {name: engine.contact_force_vector(("robot", name)) for name in names}
    sums = {name: engine.contact_force(("robot", name)) for name in names}
    left, _ = close(engine, 150)
    of_left, of_right = (np.add(vectors[side](), vectors[f"{side}_tip"]()) for side in ("left", "right"))
    np.testing.assert_allclose(of_left, -of_right, atol=1e-9)
    np.testing.assert_allclose(vectors[None](), 0.0, atol=1e-9)
    assert of_left[1] == pytest.approx(2.0 / (REACH * np.cos(left)), rel=0.2)
    assert sums[None]() == pytest.approx(sums["left"]() + sums["left_tip"](), rel=1e-9)


def test_links_that_a_joint_joins_never_touch():
    model = pincers().robots[0].model
    pairs = {frozenset(pair) for pair in self_collision_pairs(model)}
    assert pairs == {
        frozenset((one, other)) for one in ("left", "left_tip") for other in ("right", "right_tip")
    }


def test_a_batch_collides_as_single_worlds_do():
    pytest.importorskip("mujoco")
    batch = create_batch("mujoco", pincers(), 2)
    single = create("mujoco", pincers())
    left, right, whole = ("robot", "left_tip"), ("robot", "right_tip"), ("robot", None)
    readers = [
        (
            engine.contact(left, [right]),
            engine.contact(left),
            engine.contact(whole, ground=False),
            engine.contact_force(left),
            engine.contact_force(whole),
            *(engine.contact_force_vector(part) for part in (left, whole)),
        )
        for engine in (batch, single)
    ]
    for engine in (single, *batch.members):
        engine.reset()
        engine.torque_motor("robot", ["left_hinge", "right_hinge"], [10.0, 10.0])([-2.0, 2.0])
    batch.begin_episodes()
    touched = 0
    for _ in range(60):
        batch.step(4)
        single.step(4)
        for together, alone in zip(*readers, strict=True):
            np.testing.assert_allclose(np.asarray(together())[..., 1], alone(), rtol=1e-9, atol=1e-9)
        touched += readers[1][0]()
    assert touched > 20


def test_overlapping_links_are_reported(engine_name, build):
    engine = build(engine_name, pincers())
    assert not engine.overlaps()
    engine.set_joint("robot", "left_hinge", -pi / 8, 0.0)
    engine.set_joint("robot", "right_hinge", pi / 6, 0.0)
    (overlap,) = engine.overlaps()
    assert {overlap.one[0], overlap.other[0]} == {"robot"}
    assert {overlap.one[1].partition("_")[0], overlap.other[1].partition("_")[0]} == {"left", "right"}
