"""Contacts, rays and images, in every engine.

* What touches what, how hard, and how far apart surfaces are, against closed forms.
* Links of one robot that touch each other, in every engine that supports it.
* Rays from bases and links, against closed forms; their own robot is not in their way.
* Images of a camera on a link: distances, bodies and colors, against closed forms.
"""

from __future__ import annotations

from dataclasses import replace
from math import asin, atan2, hypot, pi, radians, sqrt, tan

import numpy as np
import pytest

from deepbots_cli import frames
from deepbots_cli.frames import quaternion
from deepbots_cli.port import CAMERA_RANGE_M, Engine, View
from deepbots_cli.program.world import Ground, Line, ObjectBody, RobotBody, WorldModel
from deepbots_cli.robots.kinematics import self_collision_pairs
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

STAYS = {"fixed": True}


def things(
    *objects: ObjectBody, gravity: tuple[float, float, float] = (0, 0, -9.81), substeps: int = 4
) -> WorldModel:
    return WorldModel(0.02, substeps, gravity, objects=objects)


def ball(name: str, at: tuple[float, float, float], mass: float = 0.2, radius: float = 0.05) -> ObjectBody:
    return ObjectBody(name, Sphere(radius), Pose(at), mass)


def test_a_ball_touches_the_ground_from_its_landing_on(engine_name, build):
    engine = build(engine_name, things(ball("ball", (0, 0, 0.2))))
    on_ground = engine.contact(("ball", None), [("ground", None)])
    anything = engine.contact(("ball", None))
    but_ground = engine.contact(("ball", None), ground=False)
    landed = 0
    for tick in range(40):
        engine.step(4)
        if tick * 0.02 < sqrt(2 * 0.15 / 9.81) - 0.04:
            assert not on_ground()
        landed += on_ground()
        assert on_ground() is anything()
        assert not but_ground()
    assert landed >= 30
    engine.reset()
    assert not on_ground()


def test_a_contact_in_a_single_engine_step_counts_for_the_whole_tick(engine_name, build):
    """A ball that bounces off a wall within a tick touches nothing when the tick ends."""
    wall = ObjectBody("wall", Box((0.1, 1, 1)), Pose((0.35, 0, 0.5)), **STAYS)
    world = replace(things(ball("ball", (0, 0, 0.5)), wall, gravity=(0, 0, 0)), timestep=0.1, substeps=50)
    engine = build(engine_name, world)
    engine.set_parameter("restitution", ("wall", ""), 1.0)
    engine.set_parameter("restitution", ("ball", ""), 1.0)
    touched = engine.contact(("wall", None), [("ball", None)])
    force = engine.contact_force(("wall", None))
    engine.place("ball", (0, 0, 0.5), (0, 0, 0, 1), (5.0, 0, 0))
    engine.step(50)
    assert touched()
    # The mean force on the ball of 0.2 kg, in a tick of 0.1 s, is the change of its momentum.
    change = 5.0 - engine.velocity("ball")()[0][0]
    assert force() == pytest.approx(0.2 * change / 0.1, rel=0.01)
    assert engine.pose("ball")()[0][0] < 0.2
    engine.step(50)
    assert not touched()
    assert force() == 0.0


def test_what_is_touched_late_in_a_tick_counts_beside_what_was_touched_all_along(engine_name, build):
    """Once the crate is known to stand on the ground, the ball that falls on it is still looked for."""
    crate = ObjectBody("crate", Box((0.2, 0.2, 0.1)), Pose((0, 0, 0.05)), 3.0)
    world = replace(things(crate, ball("ball", (0, 0, 0.4))), timestep=0.05, substeps=50)
    engine = build(engine_name, world)
    on_ground = engine.contact(("crate", None), [("ground", None)])
    hit = engine.contact(("crate", None), ground=False)
    readings = []
    for _ in range(6):
        engine.step(50)
        readings.append((on_ground(), hit()))
    falls = sqrt(2 * 0.25 / 9.81)  # s
    assert [hits for _, hits in readings].index(True) == int(falls / 0.05)
    assert all(stands for stands, _ in readings[1:])


def test_links_of_a_robot_have_contacts_of_their_own(engine_name, worlds, build):
    engine = build(engine_name, worlds.arena())
    wheels = [engine.contact(("robot", f"wheel_{i}"), [("ground", None)]) for i in range(4)]
    body, pole = engine.contact(("robot", "body")), engine.contact(("robot", "pole"))
    crate = engine.contact(("robot", None), [("crate", None), ("drum", None)])
    all_but_ground = engine.contact(("robot", None), ground=False)
    for _ in range(10):
        engine.step(4)
    assert [wheel() for wheel in wheels] == [True] * 4
    assert not any(read() for read in (body, pole, crate, all_but_ground))
    engine.place("crate", (-0.14, 0, 0.05), (0, 0, 0, 1))
    engine.step(4)
    assert crate()
    assert all_but_ground()
    assert body()


# What lies within something else
def test_bodies_within_each_other_are_listed_with_their_depth_deepest_first(engine_name, build):
    post = ObjectBody("post", Sphere(0.05), Pose((0, 0, 0.05)), **STAYS)
    engine = build(
        engine_name,
        things(ball("near", (0.08, 0, 0.055)), ball("sunk", (1, 0, 0.03)), ball("clear", (2, 0, 0.06)), post),
    )
    first, second = engine.overlaps()
    depths = {frozenset((overlap.one[0], overlap.other[0])): overlap.depth for overlap in (first, second)}
    assert depths[frozenset(("near", "post"))] == pytest.approx(0.1 - sqrt(0.08**2 + 0.005**2), abs=1e-3)
    assert depths[frozenset(("sunk", "ground"))] == pytest.approx(0.02, abs=1e-3)
    assert first.depth >= second.depth


def test_two_bodies_that_never_move_do_not_overlap(engine_name, build):
    first, second = (ObjectBody(name, Sphere(0.05), Pose((0, 0, 0.02)), **STAYS) for name in ("one", "other"))
    assert list(build(engine_name, things(first, second)).overlaps()) == []


def test_links_of_a_robot_that_overlap_are_named(engine_name, build, worlds):
    engine = build(engine_name, worlds.arena())
    engine.place("robot", (0, 0, 0.02), (0, 0, 0, 1))
    (overlap,) = engine.overlaps()
    assert overlap.depth == pytest.approx(0.02, abs=1.5e-3)
    assert {part[0] for part in (overlap.one, overlap.other)} == {"robot", "ground"}
    assert any((part[1] or "").startswith("wheel_") for part in (overlap.one, overlap.other))


def test_two_bodies_that_overlap_with_several_shapes_are_listed_once(engine_name, build):
    ball, box = (Geometry(Sphere(0.05)),), (Geometry(Box((0.1, 0.1, 0.1))),)
    inertial = Inertial(0.1, ixx=1e-4, iyy=1e-4, izz=1e-4)
    model = RobotModel(
        "cart",
        (Link("ball", inertial, ball, ball), Link("box", inertial, box, box)),
        (Joint("rise", "fixed", "ball", "box", Pose((-0.01, 0, 0.2))),),
        root="ball",
    )
    pill = ObjectBody("pill", Cylinder(0.05, 1.0), Pose((0, 0, 0.5)), **STAYS)
    world = replace(things(pill), robots=(RobotBody("cart", model, pose=Pose((0.09, 0, 0.4))),))
    (overlap,) = build(engine_name, world).overlaps()
    assert ("cart", "box") in overlap
    assert overlap.depth == pytest.approx(0.02, abs=1.5e-3)


def test_looking_for_overlaps_leaves_no_trace_beyond_a_reset(engine_name, build):
    world = things(ball("ball", (0, 0, 0.2)))

    def fall(engine) -> list[object]:
        engine.reset()
        engine.step(40)
        return [engine.pose("ball")(), engine.velocity("ball")()]

    fresh, looked_at = build(engine_name, world), build(engine_name, world)
    looked_at.overlaps()
    assert fall(looked_at) == fall(fresh)


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
    left, right = close(build(engine_name, pincers(self_collision=False)), 30)
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
    assert {frozenset(pair) for pair in self_collision_pairs(model)} == {
        frozenset((one, other)) for one in ("left", "left_tip") for other in ("right", "right_tip")
    }


def test_overlapping_links_are_reported(engine_name, build):
    engine = build(engine_name, pincers())
    assert not engine.overlaps()
    engine.set_joint("robot", "left_hinge", -pi / 8, 0.0)
    engine.set_joint("robot", "right_hinge", pi / 6, 0.0)
    (overlap,) = engine.overlaps()
    assert {overlap.one[0], overlap.other[0]} == {"robot"}
    assert {overlap.one[1].partition("_")[0], overlap.other[1].partition("_")[0]} == {"left", "right"}


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


ROUND = {
    "sphere": (Sphere(0.5), Pose((3, 0, 1))),
    "cylinder": (Cylinder(0.5, 8.0), Pose((3, 0, 1))),
    "capsule": (Capsule(0.5, 8.0), Pose((3, 0, 1))),
}


@pytest.mark.parametrize("kind", ROUND)
def test_a_ray_that_begins_within_a_round_body_has_no_negative_length(engine_name, kind, build):
    engine = build(engine_name, world(ObjectBody("thing", ROUND[kind][0], Pose((0, 0, 1)), fixed=True)))
    starts = [towards(yaw, 0.0, (-0.48, 0.0, 0.0)) for yaw in (0.0, pi / 2, pi)]
    assert min(engine.rays(("scout", None), starts, 10.0)()) >= 0.0


def test_robots_see_each_other_but_not_themselves(engine_name, build):
    engine = build(engine_name, world(robots=2))
    ahead = (
        engine.rays(("scout", None), [towards(0.0)], 10.0),
        engine.rays(("other", None), [towards(pi)], 10.0),
    )
    assert [read() for read in ahead] == [pytest.approx([3.8], abs=1e-6)] * 2
    assert engine.rays(("scout", "head"), [towards(0.0, pi / 2)], 10.0)() == pytest.approx([1.5], abs=1e-6)


def test_a_fixed_robot_with_rays_does_not_touch_the_ground(engine_name, build):
    scout = RobotBody("scout", gray_scout(), True, Pose((0, 0, 0.1)))
    engine = build(engine_name, WorldModel(0.02, 1, robots=(scout,)))
    touches = engine.contact(("scout", None), [("ground", None)])
    engine.rays(("scout", None), [towards(0.0)], 10.0)
    engine.step(2)
    assert not touches()


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


RED, GREEN = (1.0, 0.0, 0.0, 1.0), (0.0, 1.0, 0.0, 1.0)
FOV, WIDE, HIGH = 0.9, 120, 84
PIXEL = 2 * tan(FOV / 2) / HIGH


def gray_scout() -> RobotModel:
    shell = (Geometry(Sphere(0.2), color=(0.2, 0.2, 0.2, 1)),)
    links = (
        Link(
            "base",
            Inertial(
                1.0, Pose((0.05, -0.02, 0.01), (0.3, 0.2, -0.4)), 0.01, 0.002, 0.001, 0.02, -0.001, 0.025
            ),
            shell,
            shell,
        ),
        Link("head", Inertial(0.2, Pose((0.02, 0.03, 0.0)), 0.001, 0.0, 0.0, 0.002, 0.0, 0.0015)),
    )
    return RobotModel(
        "scout",
        links,
        (Joint("neck", "continuous", "base", "head", Pose((0, 0, 0.5)), (0, 0, 1)),),
        root="base",
    )


def seen_world(*objects: ObjectBody) -> WorldModel:
    return WorldModel(
        0.02,
        1,
        (0.0, 0.0, 0.0),
        robots=(RobotBody("scout", gray_scout(), True, Pose((0, 0, 1))),),
        objects=objects,
    )


def wall(x: float, color=RED, **figures: object) -> ObjectBody:
    return ObjectBody("wall", Box((0.2, 1.0, 1.0)), Pose((x + 0.1, 0, 1)), color=color, fixed=True, **figures)


def rays() -> tuple[np.ndarray, np.ndarray]:
    """Tangents to the left and up of the centers of pixels."""
    left = PIXEL * (WIDE / 2 - np.arange(WIDE) - 0.5)
    up = PIXEL * (HIGH / 2 - np.arange(HIGH) - 0.5)
    return left[None, :], up[:, None]


def test_a_camera_measures_distances_bodies_and_colors_pixel_by_pixel(engine_name, build):
    engine = build(engine_name, seen_world(wall(2.0)))
    image = engine.camera(("scout", None), frames.IDENTITY_FRAME, WIDE, HIGH, FOV)()
    assert (image.colors.shape, image.colors.dtype) == ((HIGH, WIDE, 3), np.uint8)
    assert (image.depth.shape, image.depth.dtype) == ((HIGH, WIDE), np.float32)
    assert (image.bodies.shape, image.bodies.dtype) == ((HIGH, WIDE), np.int32)
    left, up = rays()
    on_wall = (np.abs(2 * left) <= 0.5) & (np.abs(2 * up) <= 0.5)
    assert ((image.bodies == image.body_names.index("wall")) == on_wall).all()
    assert image.depth[on_wall] == pytest.approx(2.0, rel=1e-5)
    floor = ~on_wall & (up < 0) & (left < 9)
    assert (image.bodies[floor] == image.body_names.index("ground")).all()
    assert image.depth[floor] == pytest.approx(
        np.broadcast_to(np.minimum(1 / np.maximum(-up, 1e-9), CAMERA_RANGE_M), floor.shape)[floor], rel=1e-4
    )
    sky = ~on_wall & ~floor
    assert (image.bodies[sky] == -1).all()
    assert (image.depth[sky] == CAMERA_RANGE_M).all()
    assert (image.colors[on_wall][:, 0] > 2 * image.colors[on_wall][:, 1].astype(int)).all()
    assert image.colors[floor].std() > 1.0  # tiles, by which motion is seen


def test_a_camera_looks_along_its_mount_on_a_link_that_turns(engine_name, build):
    engine = build(engine_name, seen_world(wall(2.0)))
    mount = ((0.0, 0.0, 0.0), quaternion(0.0, 0.0, -1.2))
    look = engine.camera(("scout", "head"), mount, WIDE, HIGH, FOV)
    engine.place("scout", (0.0, 0.0, 0.5), frames.IDENTITY_ROTATION)
    assert (look().bodies != look().body_names.index("wall")).all()
    engine.set_joint("scout", "neck", 1.2, 0.0)
    center = look().depth[HIGH // 2 - 5 : HIGH // 2 + 5, WIDE // 2 - 5 : WIDE // 2 + 5]
    assert center == pytest.approx(2.0, rel=1e-4)
    engine.set_joint("scout", "neck", 1.2 + 0.2, 0.0)
    columns = np.where((look().bodies == look().body_names.index("wall")).any(axis=0))[0]
    assert PIXEL * (columns.mean() + 0.5 - WIDE / 2) == pytest.approx(
        (tan(0.2 + 0.245) + tan(0.2 - 0.245)) / 2, abs=0.05
    )


def test_up_in_a_picture_is_up_in_the_mount(engine_name, build):
    engine = build(engine_name, seen_world(ObjectBody("ball", Sphere(0.1), Pose((2, 0, 1.4)), color=GREEN)))
    for roll, row, column in ((0.0, -1, None), (pi, 1, None), (pi / 2, None, -1)):
        image = engine.camera(("scout", None), ((0, 0, 0), quaternion(roll, 0.0, 0.0)), WIDE, HIGH, FOV)()
        rows, columns = np.where(image.bodies == image.body_names.index("ball"))
        assert row is None or abs(rows.mean() - HIGH / 2 - row * 18) < 3
        assert column is None or abs(columns.mean() - WIDE / 2 - column * 18) < 3


def test_what_is_painted_gets_another_color_and_what_is_absent_is_not_seen(engine_name, build):
    ghost = ObjectBody("mark", Box((0.2, 1.0, 1.0)), color=GREEN, solid=False, pooled=True)
    engine = build(engine_name, seen_world(ghost))
    look = engine.camera(("scout", None), frames.IDENTITY_FRAME, 40, 40, FOV)
    assert "mark" not in {look().body_names[place] for place in np.unique(look().bodies) if place >= 0}
    engine.place("mark", (2.1, 0, 1), frames.IDENTITY_ROTATION)
    middle = (19, 20)
    assert look().body_names[look().bodies[middle]] == "mark"
    assert (look().depth[middle], look().colors[middle].argmax()) == (pytest.approx(2.0, rel=1e-4), 1)
    engine.set_parameter("color", ("mark", ""), *RED)
    assert look().colors[middle].argmax() == 0
    engine.set_parameter("light", (), 0.5)
    assert look().colors[middle][0] < 200
    engine.reset()
    assert look().bodies[middle] == -1


def test_a_flat_disc_is_not_shaded_as_a_cone(engine_name, build):
    disc = ObjectBody("disc", Cylinder(0.3, 0.002), Pose((0, 0, 0.001)), color=GREEN, fixed=True)
    engine = build(engine_name, seen_world(disc))
    engine.place("scout", (0.0, 0.0, 1.0), frames.IDENTITY_ROTATION)
    image = engine.camera(
        ("scout", "head"), ((0.0, 0.0, -0.5), quaternion(0.0, pi / 2, 0.0)), HIGH, HIGH, 1.2
    )()
    colors = image.colors[image.bodies == image.body_names.index("disc")]
    assert len(colors) > 500
    assert (colors.max(axis=0) - colors.min(axis=0)).max() < 3


def test_lines_are_seen_painted_on_a_floor_of_its_own_color(engine_name, build):
    """From 1 m above, looking straight down: a square of 1 m with a stroke of 0.1 m, closed, and a speck
    beside it."""
    square = Line("track", ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)), True, 0.1, color=RED)
    speck = Line("speck", ((0.0, 0.0), (0.0, 0.0)), False, 0.2, color=(0, 0, 0, 1))
    engine = build(engine_name, replace(seen_world(), ground=Ground(color=GREEN), lines=(square, speck)))
    look = engine.camera(("scout", "head"), ((0.0, 0.0, -0.5), quaternion(0.0, pi / 2, 0.0)), HIGH, HIGH, 2.4)
    engine.place("scout", (0.0, 0.0, 1.0), frames.IDENTITY_ROTATION)
    engine.set_parameter("color", ("scout", ""), 0, 0, 1, 1)
    image = look()
    pixel = 2 * tan(1.2) / HIGH
    x = -pixel * (np.arange(HIGH) + 0.5 - HIGH / 2)[:, None]  # the first row is ahead
    y = -pixel * (np.arange(HIGH) + 0.5 - HIGH / 2)[None, :]
    bare = image.bodies == image.body_names.index("ground")
    largest = np.maximum(abs(x), abs(y))
    track = bare & (abs(largest - 0.5) < 0.04)
    assert track.sum() > 50
    assert (image.colors[track].argmax(axis=-1) == 0).all()
    beside = bare & (abs(largest - 0.5) > 0.06) & (np.hypot(x, y) > 0.12)
    assert (image.colors[beside].argmax(axis=-1) == 1).all()


def test_a_later_line_covers_an_earlier_one_where_they_cross(engine_name, build):
    along = Line("along", ((-1.0, 0.0), (1.0, 0.0)), False, 0.3, color=RED)
    across = Line("across", ((0.0, -1.0), (0.0, 1.0)), False, 0.3, color=GREEN)
    view = View((0.0, 0.0, 2.0), (0.0, 0.0, 0.0), 40, 40)
    for lines, channel in (((along, across), 1), ((across, along), 0)):
        engine = build(engine_name, WorldModel(timestep=0.01, substeps=1, lines=lines))
        assert (engine.render(view)[18:22, 18:22].argmax(axis=-1) == channel).all()


def test_a_side_in_the_plane_of_the_eye_does_not_hold_up_the_picture(engine_name, build):
    """The pixels of its corners lie beyond all integers, through which the renderer once went one by one."""
    plank = ObjectBody("plank", Box((0.2, 1.0, 0.1)), Pose((0.1 + 1e-8, 0, 1.3)), fixed=True)
    engine = build(engine_name, seen_world(plank, wall(2.0)))
    look = engine.camera(("scout", None), frames.IDENTITY_FRAME, WIDE, HIGH, FOV)
    assert "wall" in {look().body_names[number] for number in np.unique(look().bodies)}
