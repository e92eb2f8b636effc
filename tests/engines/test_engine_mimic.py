"""Joints that follow others (<mimic>), against their closed form: position = multiplier * position of the
leader + offset."""

from __future__ import annotations

import struct
from dataclasses import replace

import pytest

from deepbots_cli.engines.mechanics import Chain
from deepbots_cli.frames import IDENTITY_FRAME
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


def stroke(engine, target: float, ticks: int) -> bytes:
    aim = engine.position_motor("robot", ["lead"], [20.0], None, None)
    read = engine.joint_states("robot", ["lead", "first", "second"])
    engine.set_joint("robot", "lead", 0.1, 0.0)
    figures: list[float] = []
    for _ in range(ticks):
        aim([target])
        engine.step(4)
        figures += [value for state in read() for value in state[:2]]
    return struct.pack(f"{len(figures)}d", *figures)


def test_a_reset_world_with_followers_equals_a_fresh_one(engine_name, build):
    engine = build(engine_name, world(pair(-2.0, 0.1)))
    fresh = stroke(engine, 0.3, 40)
    for ticks in (0, 1, 7, 33):
        engine.reset()
        stroke(engine, -0.4, ticks)
        engine.reset()
        assert stroke(engine, 0.3, 40) == fresh
    assert stroke(build(engine_name, world(pair(-2.0, 0.1))), 0.3, 40) == fresh


def test_a_restored_world_with_followers_goes_on_to_the_bit(engine_name, build):
    engine = build(engine_name, world(pair(-2.0, 0.1)))
    if "snapshot" not in engine.capabilities:
        pytest.skip("it has no snapshots")
    aim = engine.position_motor("robot", ["lead"], [20.0], None, None)
    read = engine.joint_states("robot", ["lead", "first", "second"])

    def follow() -> list[object]:
        states: list[object] = []
        for _ in range(10):
            aim([0.3])
            engine.step(4)
            states.append(read())
        return states

    follow()
    snapshot = engine.snapshot()
    expected = follow()
    engine.reset()
    engine.restore(snapshot)
    assert follow() == expected


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
