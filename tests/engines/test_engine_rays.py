"""Rays from bases and links, against closed forms; their own robot is not in their way."""

from __future__ import annotations

import random
from itertools import product
from math import asin, cos, pi, radians, sin, sqrt

import pytest

from deepbots_cli import frames
from deepbots_cli.frames import quaternion
from deepbots_cli.program.world import ObjectBody, RobotBody, WorldModel
from deepbots_cli.robots.model import (
    Box,
    Capsule,
    Cylinder,
    Geometry,
    Inertial,
    Joint,
    Link,
    Pose,
    RobotModel,
    Sphere,
)


def towards(yaw: float, pitch: float = 0.0, at: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> frames.Frame:
    return at, quaternion(0.0, pitch, yaw)


def scout() -> RobotModel:
    """A crooked base within a shell, with a head on a joint, within a shell of its own."""
    shell = (Geometry(Sphere(0.2)),)
    links = (
        Link(
            "base",
            Inertial(
                1.0, Pose((0.05, -0.02, 0.01), (0.3, 0.2, -0.4)), 0.01, 0.002, 0.001, 0.02, -0.001, 0.025
            ),
            shell,
            shell,
        ),
        Link(
            "head",
            Inertial(0.2, Pose((0.02, 0.03, 0.0), (0.1, 0.0, 0.5)), 0.001, 0.0, 0.0, 0.002, 0.0, 0.0015),
            shell,
            shell,
        ),
    )
    return RobotModel(
        "scout",
        links,
        (Joint("neck", "continuous", "base", "head", Pose((0, 0, 0.5)), (0, 0, 1)),),
        root="base",
    )


def world(*objects: ObjectBody, robots: int = 1, fixed: bool = True) -> WorldModel:
    places = (Pose((0, 0, 1)), Pose((4, 0, 1)))
    gravity = (0.0, 0.0, 0.0)
    crew = tuple(
        RobotBody(name, scout(), fixed, place)
        for name, place in zip(("scout", "other")[:robots], places, strict=False)
    )
    return WorldModel(0.02, 1, gravity, robots=crew, objects=objects)


@pytest.mark.parametrize(("link", "height"), [(None, 1.0), ("head", 1.5)])
def test_rays_meet_the_ground_where_geometry_says(engine_name, link, height, build):
    engine = build(engine_name, world())
    pitches = [radians(angle) for angle in (5, 20, 45, 89)]
    read = engine.rays(("scout", link), [towards(2.0, pitch) for pitch in pitches], 30.0)
    assert read() == pytest.approx([height / sin(pitch) for pitch in pitches], abs=1e-6)
    assert engine.rays(("scout", link), [towards(0.0, -0.3)], 30.0)() == [30.0]
    assert engine.rays(("scout", link), [towards(0.0, pi / 2)], 0.4)() == [0.4]


@pytest.mark.parametrize("link", [None, "head"])
def test_rays_turn_and_move_with_their_link(engine_name, link, build):
    engine = build(
        engine_name, world(ObjectBody("wall", Box((0.2, 40, 40)), Pose((5.1, 0, 1)), fixed=True), fixed=False)
    )
    engine.place("scout", (1.0, 0.5, 2.0), quaternion(0.0, 0.0, 0.3))
    turned = 0.3
    if link:
        engine.set_joint("scout", "neck", 0.4, 0.0)
        turned = 0.7
    read = engine.rays(
        ("scout", link), [towards(angle, 0.0, (0.1, 0.05, 0.0)) for angle in (-0.2, 0.0, 0.5)], 30.0
    )
    x = 1.0 + 0.1 * cos(turned) - 0.05 * sin(turned)
    assert read() == pytest.approx([(5.0 - x) / cos(turned + angle) for angle in (-0.2, 0.0, 0.5)], abs=1e-6)


ROUND = {
    "sphere": (Sphere(0.5), Pose((3, 0, 1))),
    "cylinder": (Cylinder(0.5, 8.0), Pose((3, 0, 1))),
    "capsule": (Capsule(0.5, 8.0), Pose((3, 0, 1))),
}


@pytest.mark.parametrize("kind", ROUND)
@pytest.mark.parametrize("reach", [3.0, 100.0])
def test_rays_meet_round_bodies_where_geometry_says(engine_name, kind, reach, build):
    shape, place = ROUND[kind]
    engine = build(engine_name, world(ObjectBody("thing", shape, place, fixed=True)))
    yaws = [asin(0.5 / 3) * share for share in (-1.01, -0.99, -0.6, 0.0, 0.3, 0.999)]
    read = engine.rays(("scout", None), [towards(yaw) for yaw in yaws], reach)
    expected = [
        3 * cos(yaw) - sqrt(max(0.25 - (3 * sin(yaw)) ** 2, 0.0)) if abs(3 * sin(yaw)) < 0.5 else reach
        for yaw in yaws
    ]
    assert read() == pytest.approx(expected, abs=1e-6)


def test_the_ends_of_a_capsule_are_round_and_those_of_a_cylinder_flat(engine_name, build):
    lying = (0.0, pi / 2, 0.0)
    engine = build(
        engine_name,
        world(
            ObjectBody("capsule", Capsule(0.5, 1.0), Pose((3, 0, 1), lying), fixed=True),
            ObjectBody("cylinder", Cylinder(0.5, 1.0), Pose((-3, 0, 1), lying), fixed=True),
        ),
    )
    yaws = (0.0, 0.1, 0.14)
    read = engine.rays(
        ("scout", None), [towards(yaw) for yaw in yaws] + [towards(pi - yaw) for yaw in yaws], 10.0
    )
    ball = [2.5 * cos(yaw) - sqrt(0.25 - (2.5 * sin(yaw)) ** 2) for yaw in yaws]
    assert read() == pytest.approx([*ball, *(2.5 / cos(yaw) for yaw in yaws)], abs=1e-6)


def test_a_ray_into_a_turned_box_is_met_at_its_face(engine_name, build):
    sides = []
    for axis, sign in product(range(3), (-1, 1)):
        size, at = [9.0] * 3, [0.0] * 3
        size[axis] = 0.5
        at[axis] = sign * 4.25
        sides.append(ObjectBody(f"side_{axis}_{sign}", Box(tuple(size)), Pose(tuple(at)), fixed=True))
    engine = build(
        engine_name,
        WorldModel(0.02, 1, (0, 0, 0), None, robots=(RobotBody("scout", scout()),), objects=tuple(sides)),
    )
    read = engine.rays(("scout", None), [towards(0.0)], 20.0)
    rng = random.Random(1)
    for _ in range(300):
        at = tuple(rng.uniform(-0.5, 0.5) for _ in range(3))
        turned = quaternion(rng.uniform(-3, 3), rng.uniform(-1.5, 1.5), rng.uniform(-3, 3))
        engine.place("scout", at, turned)
        direction = frames.rotate(turned, (1.0, 0.0, 0.0))
        met = min(
            (4.0 - s * x) / (s * d)
            for x, d in zip(at, direction, strict=True)
            for s in (-1, 1)
            if s * d > 1e-9
        )
        assert read()[0] == pytest.approx(met, abs=1e-6)


def test_robots_see_each_other_but_not_themselves(engine_name, build):
    engine = build(engine_name, world(robots=2))
    ahead = (
        engine.rays(("scout", None), [towards(0.0)], 10.0),
        engine.rays(("other", None), [towards(pi)], 10.0),
    )
    assert [read() for read in ahead] == [pytest.approx([3.8], abs=1e-6)] * 2
    assert engine.rays(("scout", "head"), [towards(0.0, pi / 2)], 10.0)() == pytest.approx([1.5], abs=1e-6)


def test_rays_do_not_see_marks_and_change_no_collisions(engine_name, worlds, build):
    seeing, blind = build(engine_name, worlds.arena()), build(engine_name, worlds.arena())
    read = seeing.rays(("robot", None), [towards(pi / 2), towards(0.0, 0.0, (0.0, 0.0, 0.02))], 3.0)
    assert read() == pytest.approx(
        [0.5, 0.3 - sqrt(0.05**2 - 0.02**2 - 0.01**2)], abs=1e-6
    )  # the ball is in front, the mark beside
    for engine in (seeing, blind):
        engine.reset()
        engine.velocity_motor("robot", [f"wheel_{i}" for i in range(4)], [10.0] * 4)([20.0] * 4)
        for _ in range(
            40
        ):  # over the ball and the crate; the order of later contacts may differ between two worlds, and motion is chaotic
            engine.step(4)
            read()
    assert seeing.pose("robot")()[0] == pytest.approx(blind.pose("robot")()[0], abs=1e-6)
    assert seeing.pose("robot")()[0][0] > 0.1


def test_rays_see_what_was_placed_before_any_step_and_what_moved_since(engine_name, build):
    engine = build(
        engine_name,
        world(
            ObjectBody("ball", Sphere(0.1), Pose((2, 0, 1)), 1.0),
            ObjectBody("far", Sphere(0.1), mass=1.0, pooled=True),
        ),
    )
    read = engine.rays(("scout", None), [towards(0.0), towards(pi / 2)], 10.0)
    assert read() == pytest.approx([1.9, 10.0], abs=1e-6)
    engine.place("ball", (3, 0, 1), frames.IDENTITY_ROTATION, (1.0, 0, 0))
    engine.place("far", (0, 5, 1), frames.IDENTITY_ROTATION)
    assert read() == pytest.approx([2.9, 4.9], abs=1e-6)
    for _ in range(50):
        engine.step(1)
        assert read()[0] == pytest.approx(engine.pose("ball")()[0][0] - 0.1, abs=1e-6)
    engine.reset()
    assert read() == pytest.approx([1.9, 10.0], abs=1e-6)


def test_rays_see_a_robot_that_drives_where_it_is(engine_name, worlds, build):
    """Links of robots are seen where they are, not where they were an engine step ago."""
    arena = worlds.arena(timestep=0.04, substeps=2)
    watcher = RobotBody("scout", scout(), True, Pose((-2, 0, 0.04)))
    engine = build(engine_name, WorldModel(0.04, 2, robots=(*arena.robots, watcher)))
    read = engine.rays(("scout", None), [towards(0.0, 0.0, (0.0, 0.05, 0.0))], 5.0)
    pose = engine.pose("robot", "wheel_2")
    engine.velocity_motor("robot", [f"wheel_{i}" for i in range(4)], [10.0] * 4)([10.0] * 4)
    for _ in range(30):
        engine.step(2)
        (x, _, z), _ = pose()
        assert read()[0] == pytest.approx(x + 2.0 - sqrt(0.04**2 - (z - 0.04) ** 2), abs=1e-3)
    assert x > 0.2
