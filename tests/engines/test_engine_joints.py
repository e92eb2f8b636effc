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

import pytest

from deepbots_cli import frames
from deepbots_cli.compiler.robots import joint_moves_link
from deepbots_cli.engines.mechanics import Chain
from deepbots_cli.errors import EngineError
from deepbots_cli.frames import IDENTITY_FRAME, quaternion
from deepbots_cli.program.world import RobotBody, WorldModel
from deepbots_cli.robots.kinematics import link_frames
from deepbots_cli.robots.model import Inertial, Joint, Limit, Link, Mimic, Pose, RobotModel

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


def test_a_heavy_follower_keeps_up(engine_name, build):
    engine = build(engine_name, world(pair(-1.0, masses=(0.1, 1.0))))
    aim = engine.position_motor("robot", ["lead"], [50.0], None, None)
    read = engine.joint_states("robot", ["lead", "first"])
    for tick in range(100):
        aim([0.3 if tick % 50 < 25 else -0.3])
        engine.step(4)
        (lead, *_), (first, *_) = read()
        assert first == pytest.approx(-lead, abs=MOVING)


def test_frames_of_links_without_an_engine_follow_too():
    where = link_frames(pair(-2.0, 0.1), {"lead": 0.2})
    assert [where[link][0][2] for link in "abc"] == pytest.approx([0.2, -0.3, 0.3])


@pytest.mark.parametrize(("below", "expected"), [("lower", 0.2), ("base", 0.3)])
def test_inverse_kinematics_moves_a_follower_with_its_leader_on_the_way_or_beside_it(below, expected):
    """A lift of two stages, of which the upper one follows the lower."""
    model = RobotModel(
        "lift",
        tuple(block(name, 1.0) for name in ("base", "lower", "upper")),
        (
            Joint("stage", "prismatic", "base", "lower", axis=(0, 0, 1), limit=Limit(0.0, 0.5)),
            Joint(
                "top",
                "prismatic",
                below,
                "upper",
                axis=(0, 0, 1),
                limit=Limit(0.0, 1.0),
                mimic=Mimic("stage", 2.0, 0.1),
            ),
        ),
        root="base",
    )
    (position,) = Chain(model, "upper", ["stage"]).solve(IDENTITY_FRAME, [0.0, 0.1], (0.0, 0.0, 0.7), None)
    assert position == pytest.approx(expected, abs=1e-6)
    assert joint_moves_link(model, model.joint("stage"), "upper")


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


def test_a_stretched_arm_reaches_behind_itself_although_its_joints_meet_their_limits_on_the_way() -> None:
    limited = [replace(joint, type="revolute", limit=Limit(-3.0, 3.0)) for joint in planar().joints[1:3]]
    model = replace(planar(), joints=(*limited, planar().joints[3]), root="sled")
    shoulder, elbow = Chain(model, "tip", ["shoulder", "elbow"]).solve(
        IDENTITY_FRAME, [0.0, 0.0], (-0.845, -0.089, 0.0), None
    )
    assert cos(shoulder) + cos(shoulder + elbow) == pytest.approx(-1.69, abs=1e-6)
    assert sin(shoulder) + sin(shoulder + elbow) == pytest.approx(-0.178, abs=1e-6)


def test_ranges_of_joints_are_kept_and_what_is_out_of_reach_is_approached():
    chain = Chain(planar(), "tip", ["shoulder", "elbow"])
    _, elbow = chain.solve(IDENTITY_FRAME, [0.0, 0.3, 0.8], (0.05, 0.0, 0.0), None)
    assert elbow == 2.5
    reached = (0.5 * (cos(0.3) + cos(2.9)), 0.5 * (sin(0.3) + sin(2.9)), 0.0)
    _, elbow = chain.solve(IDENTITY_FRAME, [0.0, 0.3, 2.6], reached, None)
    assert elbow <= 2.5
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
