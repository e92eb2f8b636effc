"""Joints and links, in every engine.

* The force and the torque in a joint, against closed forms, in every engine.
* Joints that follow others (<mimic>), against their closed form: position = multiplier * position of the
  leader + offset.
* Inverse kinematics, by putting the joints where it says and looking where the link is.
* The angular momentum of a robot about its center of mass, against closed forms, in every engine.
"""

from __future__ import annotations

import random
from dataclasses import replace
from math import acos, cos, dist, hypot, pi, sin

import numpy as np
import pytest

from deepbots_cli import frames
from deepbots_cli.engines import create, create_batch
from deepbots_cli.engines.mechanics import Chain
from deepbots_cli.errors import EngineError
from deepbots_cli.frames import IDENTITY_FRAME, quaternion
from deepbots_cli.program.world import RobotBody, WorldModel
from deepbots_cli.robots.kinematics import link_frames
from deepbots_cli.robots.model import Box, Geometry, Inertial, Joint, Limit, Link, Mimic, Pose, RobotModel

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


WEIGHTLESS = (0.0, 0.0, 0.0)
LAWS = [(1.0, 0.0), (-1.0, 0.0), (0.5, 0.1), (-2.0, 0.05)]
RESTING, MOVING = 0.01, 0.03  # of the range of the follower


def block(name: str, mass: float) -> Link:
    return Link(name, Inertial(mass, ixx=1e-3 * mass, iyy=1e-3 * mass, izz=1e-3 * mass))


def pair(
    multiplier: float = 1.0,
    offset: float = 0.0,
    kinds: tuple[str, str] = ("prismatic", "prismatic"),
    masses: tuple[float, float] = (0.1, 0.1),
) -> RobotModel:
    """A joint with a range of 1 m or rad, one that follows it, and one that follows the follower with the
    opposite sign."""
    lead, follow = kinds
    ends = sorted((offset - 0.5 * multiplier, offset + 0.5 * multiplier))
    return RobotModel(
        "pair",
        (block("base", 1.0), block("a", masses[0]), block("b", masses[1]), block("c", 1e-3)),
        (
            Joint(
                "second", follow, "base", "c", axis=(0, 0, 1), limit=Limit(-3, 3), mimic=Mimic("first", -1.0)
            ),
            Joint("lead", lead, "base", "a", Pose((0, 0.2, 0)), (0, 0, 1), Limit(-0.5, 0.5)),
            Joint(
                "first",
                follow,
                "base",
                "b",
                Pose((0, -0.2, 0)),
                (0, 0, 1),
                Limit(*ends),
                mimic=Mimic("lead", multiplier, offset),
            ),
        ),
        root="base",
    )


def world(
    model: RobotModel, gravity: tuple[float, float, float] = (0.0, 0.0, -9.81), substeps: int = 4
) -> WorldModel:
    return WorldModel(0.02, substeps, gravity, None, robots=(RobotBody("robot", model, fixed_base=True),))


@pytest.mark.parametrize(("multiplier", "offset"), LAWS)
@pytest.mark.parametrize(
    "kinds", [("prismatic", "prismatic"), ("revolute", "revolute"), ("revolute", "prismatic")], ids="-".join
)
def test_a_motor_on_the_leader_moves_the_follower(engine_name, build, kinds, multiplier, offset):
    multiplier = 0.05 * multiplier if kinds[0] != kinds[1] else multiplier  # m per rad
    engine = build(engine_name, world(pair(multiplier, offset, kinds)))
    aim = engine.position_motor("robot", ["lead"], [20.0], None, None)
    read = engine.joint_states("robot", ["lead", "first", "second"])
    for target in (0.3, -0.4):
        for _ in range(60):
            aim([target])
            engine.step(4)
            (lead, *_), (first, *_), (second, *_) = read()
            assert first == pytest.approx(multiplier * lead + offset, abs=MOVING * abs(multiplier))
        assert lead == pytest.approx(target, abs=0.01)
        assert first == pytest.approx(multiplier * lead + offset, abs=RESTING * abs(multiplier))
        assert second == pytest.approx(-first, abs=RESTING * abs(multiplier))


@pytest.mark.parametrize(("multiplier", "offset"), LAWS)
@pytest.mark.parametrize("pushed", ["lead", "first"])
def test_a_passive_follower_and_its_leader_move_together_whichever_is_pushed(
    engine_name, build, pushed, multiplier, offset
):
    """A force on one side moves both as a gear does: the mass that it moves is that of the leader +
    multiplier^2 * that of the follower."""
    masses = (0.2, 0.3)
    engine = build(engine_name, world(pair(multiplier, offset, masses=masses), WEIGHTLESS, substeps=20))
    push = engine.torque_motor("robot", [pushed], [100.0])
    read = engine.joint_states("robot", ["lead", "first"])
    mass = masses[0] + multiplier**2 * (masses[1] + 1e-3)
    force = 1.0 if pushed == "lead" else multiplier
    for _ in range(10):
        push([1.0])
        engine.step(20)
    (lead, speed, *_), (first, *_) = read()
    assert lead == pytest.approx(0.5 * force / mass * 0.2**2, rel=0.02)
    assert speed == pytest.approx(force / mass * 0.2, rel=0.02)
    assert first == pytest.approx(multiplier * lead + offset, abs=MOVING * abs(multiplier))


def test_a_follower_with_the_multiplier_0_stays_at_its_offset(engine_name, build):
    model = pair(0.0, 0.1)
    free = tuple(replace(joint, limit=Limit()) if joint.name == "first" else joint for joint in model.joints)
    engine = build(engine_name, world(replace(model, joints=free)))
    aim = engine.position_motor("robot", ["lead"], [20.0], None, None)
    read = engine.joint_states("robot", ["lead", "first"])
    for _ in range(40):
        aim([0.3])
        engine.step(4)
    assert [state[0] for state in read()] == pytest.approx([0.3, 0.1], abs=1e-3)


def test_a_heavy_follower_keeps_up(engine_name, build):
    engine = build(engine_name, world(pair(-1.0, masses=(0.1, 1.0))))
    aim = engine.position_motor("robot", ["lead"], [50.0], None, None)
    read = engine.joint_states("robot", ["lead", "first"])
    for tick in range(100):
        aim([0.3 if tick % 50 < 25 else -0.3])
        engine.step(4)
        (lead, *_), (first, *_) = read()
        assert first == pytest.approx(-lead, abs=MOVING)


def test_a_start_of_the_leader_is_one_of_its_followers_too(engine_name, build):
    engine = build(engine_name, world(pair(-2.0, 0.1)))
    read = engine.joint_states("robot", ["lead", "first", "second"])
    assert [state[0] for state in read()] == [0.0, 0.1, -0.1]
    engine.set_joint("robot", "lead", 0.2, 0.5)
    assert [state[0] for state in read()] == pytest.approx([0.2, -0.3, 0.3])
    assert [state[1] for state in read()] == pytest.approx([0.5, -1.0, 1.0])
    engine.reset()
    assert [state[0] for state in read()] == [0.0, 0.1, -0.1]


def test_frames_of_links_without_an_engine_follow_too():
    where = link_frames(pair(-2.0, 0.1), {"lead": 0.2})
    assert [where[link][0][2] for link in "abc"] == pytest.approx([0.2, -0.3, 0.3])


def test_inverse_kinematics_moves_a_follower_with_its_leader():
    """A lift of two stages, of which the upper one follows the lower."""
    model = RobotModel(
        "lift",
        tuple(block(name, 1.0) for name in ("base", "lower", "upper")),
        (
            Joint("stage", "prismatic", "base", "lower", axis=(0, 0, 1), limit=Limit(0.0, 0.5)),
            Joint(
                "top",
                "prismatic",
                "lower",
                "upper",
                axis=(0, 0, 1),
                limit=Limit(0.0, 1.0),
                mimic=Mimic("stage", 2.0, 0.1),
            ),
        ),
        root="base",
    )
    (position,) = Chain(model, "upper", ["stage"]).solve(IDENTITY_FRAME, [0.0, 0.1], (0.0, 0.0, 0.7), None)
    assert position == pytest.approx(0.2, abs=1e-6)


BULK = Inertial(1.0, ixx=0.01, iyy=0.01, izz=0.01)


def planar() -> RobotModel:
    """Two links of 0.5 m in the plane, on a slide across, with a finger that is none of the arm's."""
    links = tuple(Link(name, BULK) for name in ("base", "sled", "upper", "lower", "tip", "finger"))
    joints = (
        Joint("slide", "prismatic", "base", "sled", axis=(0, 1, 0)),
        Joint("shoulder", "continuous", "sled", "upper", axis=(0, 0, 1)),
        Joint("elbow", "revolute", "upper", "lower", Pose((0.5, 0, 0)), (0, 0, 1), Limit(0.0, 2.5)),
        Joint("end", "fixed", "lower", "tip", Pose((0.5, 0, 0))),
        Joint("finger", "prismatic", "tip", "finger", Pose((0.1, 0, 0)), (1, 0, 0)),
    )
    return RobotModel("planar", links, joints, root="base")


def six_joints() -> RobotModel:
    """Seven joints whose axes alternate, 1.4 m long."""
    axes = ((0, 0, 1), (0, 1, 0), (0, 0, 1), (0, -1, 0), (0, 0, 1), (0, -1, 0), (0, 0, 1))
    links = (Link("l0"), *(Link(f"l{i}", BULK) for i in range(1, 8)), Link("tool"))
    joints = [
        Joint(
            f"j{i}", "revolute", f"l{i}", f"l{i + 1}", Pose((0.03 * (i % 2), 0, 0.2)), axis, Limit(-2.8, 2.8)
        )
        for i, axis in enumerate(axes)
    ]
    return RobotModel(
        "arm",
        links,
        (*joints, Joint("grip", "fixed", "l7", "tool", Pose((0.05, 0, 0.1), (0.2, 0.1, 0.4)))),
        root="l0",
    )


@pytest.mark.parametrize(("x", "y"), [(0.6, 0.3), (0.2, -0.5), (-0.7, 0.1)])
def test_two_links_in_a_plane_bend_as_the_law_of_cosines_says(x, y):
    chain = Chain(planar(), "tip", ["shoulder", "elbow"])
    assert chain.moving_joints == ("slide", "shoulder", "elbow")
    shoulder, elbow = chain.solve(IDENTITY_FRAME, [0.1, 0.3, 0.8], (x, y, 0.0), None)
    assert elbow == pytest.approx(acos((x * x + (y - 0.1) ** 2 - 0.5) / 0.5), abs=1e-6)
    assert 0.5 * cos(shoulder) + 0.5 * cos(shoulder + elbow) == pytest.approx(x, abs=1e-6)
    assert 0.5 * sin(shoulder) + 0.5 * sin(shoulder + elbow) + 0.1 == pytest.approx(y, abs=1e-6)


def test_ranges_of_joints_are_kept_and_what_is_out_of_reach_is_approached():
    chain = Chain(planar(), "tip", ["shoulder", "elbow"])
    _, elbow = chain.solve(IDENTITY_FRAME, [0.0, 0.3, 0.8], (0.05, 0.0, 0.0), None)
    assert elbow == 2.5
    shoulder, elbow = chain.solve(IDENTITY_FRAME, [0.0, 0.3, 0.8], (3.0, 4.0, 0.0), None)
    assert hypot(
        cos(shoulder) + cos(shoulder + elbow), sin(shoulder) + sin(shoulder + elbow)
    ) == pytest.approx(2.0, abs=1e-3)
    slide = Chain(planar(), "tip", ["slide"]).solve(IDENTITY_FRAME, [0.0, 0.0, 0.0], (1.0, 0.4, 0.0), None)
    assert slide == pytest.approx([0.4], abs=1e-6)


def test_a_joint_that_does_not_move_the_link_is_refused_by_name():
    with pytest.raises(EngineError, match="joint 'finger' does not move link 'tip'"):
        Chain(planar(), "tip", ["shoulder", "finger"])


@pytest.mark.parametrize("with_attitude", [False, True])
def test_an_arm_of_seven_joints_goes_where_it_is_sent_from_where_it_stands(engine_name, with_attitude, build):
    names = [f"j{i}" for i in range(7)]
    place = Pose((0.3, -0.2, 0.4), (0.1, 0.2, 0.3))
    engine = build(
        engine_name,
        WorldModel(0.01, 1, ground=None, robots=(RobotBody("arm", six_joints(), True, place),)),
    )
    pose = engine.pose("arm", "tool")
    solve = engine.inverse_kinematics(("arm", "tool"), names)
    rng = random.Random(4)
    reached = 0
    for _ in range(40):
        start = [rng.uniform(-1.5, 1.5) for _ in names]
        for name, angle in zip(names, start, strict=True):
            engine.set_joint("arm", name, angle + rng.uniform(-0.4, 0.4), 0.0)
        target, attitude = pose()
        for name, angle in zip(names, start, strict=True):
            engine.set_joint("arm", name, angle, 0.0)
        wanted = attitude if with_attitude else None
        solution = solve(target, wanted)
        assert solution == solve(target, wanted)
        for name, angle in zip(names, solution, strict=True):
            engine.set_joint("arm", name, angle, 0.0)
        position, turned = pose()
        turn = abs(sum(a * b for a, b in zip(turned, attitude, strict=True)))
        reached += dist(position, target) < 1e-5 and (not with_attitude or turn > 1 - 1e-6)
    assert reached >= 39


def test_the_same_call_gives_the_same_bits_whatever_was_asked_before():
    chain = Chain(six_joints(), "tool", [f"j{i}" for i in range(7)])
    at = [0.1, 0.4, -0.2, 1.1, 0.3, 0.7, 0.0]
    root = ((0.1, 0.0, 0.2), quaternion(0.1, 0.0, 0.4))
    first = chain.solve(root, at, (0.4, 0.2, 0.9), frames.IDENTITY_ROTATION)
    chain.solve(root, [0.0] * 7, (0.2, -0.4, 1.0), None)
    assert chain.solve(root, at, (0.4, 0.2, 0.9), frames.IDENTITY_ROTATION) == first


def test_an_attitude_nearly_half_a_turn_away_is_reached():
    chain = Chain(six_joints(), "tool", [f"j{i}" for i in range(7)])
    start = [0.1, 0.8, 0.2, 1.4, 0.1, 0.6, -1.4]
    target, attitude = tool_frame([*start[:6], start[6] + pi - 0.3])
    position, turned = tool_frame(chain.solve(IDENTITY_FRAME, start, target, attitude))
    assert position == pytest.approx(target, abs=1e-6)
    assert abs(sum(a * b for a, b in zip(turned, attitude, strict=True))) == pytest.approx(1.0, abs=1e-9)


def tool_frame(angles: list[float]) -> frames.Frame:
    """The tool of the arm at these angles."""
    at = IDENTITY_FRAME
    for joint, angle in zip(six_joints().joints, [*angles, 0.0], strict=True):
        at = frames.compose(at, frames.frame(joint.origin))
        at = at[0], frames.multiply(at[1], frames.from_axis_angle(joint.axis, angle))
    return at


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
