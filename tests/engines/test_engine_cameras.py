"""Images of a camera on a link: distances, bodies and colors, against closed forms."""

from __future__ import annotations

from dataclasses import replace
from math import pi, tan

import numpy as np
import pytest

from deepbots_cli import frames
from deepbots_cli.frames import quaternion
from deepbots_cli.port import CAMERA_RANGE_M, View
from deepbots_cli.program.world import Ground, Line, ObjectBody, RobotBody, WorldModel
from deepbots_cli.robots.model import Box, Cylinder, Geometry, Inertial, Joint, Link, Pose, RobotModel, Sphere

RED, GREEN = (1.0, 0.0, 0.0, 1.0), (0.0, 1.0, 0.0, 1.0)
FOV, WIDE, HIGH = 0.9, 120, 84
PIXEL = 2 * tan(FOV / 2) / HIGH


def scout() -> RobotModel:
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


def world(*objects: ObjectBody) -> WorldModel:
    return WorldModel(
        0.02,
        1,
        (0.0, 0.0, 0.0),
        robots=(RobotBody("scout", scout(), True, Pose((0, 0, 1))),),
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
    engine = build(engine_name, world(wall(2.0)))
    look = engine.camera(("scout", None), frames.IDENTITY_FRAME, WIDE, HIGH, FOV)
    image = look()
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
    engine = build(engine_name, world(wall(2.0)))
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
    engine = build(engine_name, world(ObjectBody("ball", Sphere(0.1), Pose((2, 0, 1.4)), color=GREEN)))
    for roll, row, column in ((0.0, -1, None), (pi, 1, None), (pi / 2, None, -1)):
        image = engine.camera(("scout", None), ((0, 0, 0), quaternion(roll, 0.0, 0.0)), WIDE, HIGH, FOV)()
        rows, columns = np.where(image.bodies == image.body_names.index("ball"))
        assert row is None or abs(rows.mean() - HIGH / 2 - row * 18) < 3
        assert column is None or abs(columns.mean() - WIDE / 2 - column * 18) < 3


def test_what_is_painted_gets_another_color_and_what_is_absent_is_not_seen(engine_name, build):
    ghost = ObjectBody("mark", Box((0.2, 1.0, 1.0)), color=GREEN, solid=False, pooled=True)
    engine = build(engine_name, world(ghost))
    look = engine.camera(("scout", None), frames.IDENTITY_FRAME, 40, 40, FOV)
    assert "mark" not in {look().body_names[place] for place in np.unique(look().bodies) if place >= 0}
    engine.place("mark", (2.1, 0, 1), frames.IDENTITY_ROTATION)
    middle = (19, 20)
    assert look().body_names[look().bodies[middle]] == "mark"
    assert look().depth[middle] == pytest.approx(2.0, rel=1e-4)
    assert look().colors[middle].argmax() == 1
    engine.set_parameter("color", ("mark", ""), *RED)
    assert look().colors[middle].argmax() == 0
    engine.set_parameter("light", (), 0.5)
    assert look().colors[middle][0] < 200
    engine.reset()
    assert look().bodies[middle] == -1


def test_a_flat_disc_is_not_shaded_as_a_cone(engine_name, build):
    disc = ObjectBody("disc", Cylinder(0.3, 0.002), Pose((0, 0, 0.001)), color=GREEN, fixed=True)
    engine = build(engine_name, world(disc))
    engine.place("scout", (0.0, 0.0, 1.0), frames.IDENTITY_ROTATION)
    image = engine.camera(
        ("scout", "head"), ((0.0, 0.0, -0.5), quaternion(0.0, pi / 2, 0.0)), HIGH, HIGH, 1.2
    )()
    colors = image.colors[image.bodies == image.body_names.index("disc")]
    assert len(colors) > 500
    assert (colors.max(axis=0) - colors.min(axis=0)).max() < 3


def test_looking_changes_nothing(engine_name, build):
    observed, unobserved = build(engine_name, world(wall(2.0))), build(engine_name, world(wall(2.0)))
    look = observed.camera(("scout", "head"), frames.IDENTITY_FRAME, 16, 16, FOV)
    for engine in (observed, unobserved):
        engine.set_joint("scout", "neck", 0.1, 2.0)
        for _ in range(20):
            engine.step(1)
            if engine is observed:
                look()
    assert (
        observed.joint_states("scout", ["neck"])()[0][:2]
        == unobserved.joint_states("scout", ["neck"])()[0][:2]
    )
    assert (look().colors == look().colors).all()


def test_lines_are_seen_painted_on_a_floor_of_its_own_color(engine_name, build):
    """From 1 m above, looking straight down: a square of 1 m with a stroke of 0.1 m, closed, and a speck
    beside it."""
    square = Line("track", ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)), True, 0.1, color=RED)
    speck = Line("speck", ((0.0, 0.0), (0.0, 0.0)), False, 0.2, color=(0, 0, 0, 1))
    engine = build(engine_name, replace(world(), ground=Ground(color=GREEN), lines=(square, speck)))
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


def test_the_floor_gets_another_color_until_the_next_reset(engine_name, build):
    engine = build(engine_name, replace(world(), light=0.8))
    view = View((1.0, 1.0, 1.5), (0.0, 0.0, 0.5), 60, 40)
    look = engine.camera(("scout", None), frames.IDENTITY_FRAME, WIDE, HIGH, FOV)
    usual = engine.render(view)
    colors = look().colors
    engine.set_parameter("color", ("ground", ""), *RED)
    assert engine.render(view)[-1, 0].argmax() == look().colors[-1, 0].argmax() == 0
    engine.set_parameter("light", (), 0.4)
    assert look().colors[0, 0, 2] < 0.6 * colors[0, 0, 2]
    engine.reset()
    assert (engine.render(view) == usual).all()
    assert (look().colors == colors).all()


def test_a_side_in_the_plane_of_the_eye_does_not_hold_up_the_picture(engine_name, build):
    """The pixels of its corners lie beyond all integers, through which the renderer once went one by one."""
    plank = ObjectBody("plank", Box((0.2, 1.0, 0.1)), Pose((0.1 + 1e-8, 0, 1.3)), fixed=True)
    engine = build(engine_name, world(plank, wall(2.0)))
    look = engine.camera(("scout", None), frames.IDENTITY_FRAME, WIDE, HIGH, FOV)
    assert "wall" in {look().body_names[number] for number in np.unique(look().bodies)}
