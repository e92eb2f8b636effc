"""Pictures show what matters: all of it is in the frame, and the frame is filled.

Every shipped scenario lints clean and runs, however it is driven.
"""

from __future__ import annotations

import math
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from deepbots_cli import api
from deepbots_cli.cli.arguments import open_robot
from deepbots_cli.document import shipped
from deepbots_cli.frames import add, cross, dot, scaled, subtract
from deepbots_cli.port import View
from deepbots_cli.runtime import Supervisor
from deepbots_cli.runtime.overview import extent, overview, shift_beside, view_around
from tests.few import every, few
from tests.worlds import Make


def place_in_picture(view: View, point: tuple[float, float, float]) -> tuple[float, float]:
    """Where a point is in the picture: -1 to 1 from left to right and from bottom to top."""
    ahead = subtract(view.target, view.eye)
    ahead = scaled(ahead, 1 / math.sqrt(dot(ahead, ahead)))
    right = cross(ahead, (0.0, 0.0, 1.0))
    right = scaled(right, 1 / math.sqrt(dot(right, right)))
    offset = subtract(point, view.eye)
    depth = dot(offset, ahead)
    tall = math.tan(view.fov / 2)
    assert depth > 0
    return dot(offset, right) / depth / tall * view.height / view.width, dot(
        offset, cross(right, ahead)
    ) / depth / tall


COPIES = Path(__file__).parents[1] / "channel" / "copies.yaml"
BOXES = [
    ((-0.04, -0.04, 0.0), (0.04, 0.04, 0.05)),
    ((-5.0, -5.0, 0.0), (5.0, 5.0, 0.1)),
    ((0.0, 0.0, 0.0), (0.1, 0.1, 3.0)),
    ((9.0, -3.0, 1.0), (11.0, -2.0, 2.0)),
]


@pytest.mark.parametrize("box", BOXES)
def test_a_view_contains_a_box_and_hardly_more(box) -> None:
    view = view_around([box])
    corners = [
        place_in_picture(view, (x, y, z))
        for x in (box[0][0], box[1][0])
        for y in (box[0][1], box[1][1])
        for z in (box[0][2], box[1][2])
    ]
    greatest = max(abs(part) for corner in corners for part in corner)
    assert greatest == pytest.approx(1 / 1.08) or (
        max(box[1][2] - box[0][2], box[1][0] - box[0][0]) < 0.1 and greatest < 1.0
    )


def test_scenes_stand_side_by_side_and_long_ones_lie_across() -> None:
    boxes = [((-5.0, -5.0, 0.0), (5.0, 5.0, 0.1))]
    view = view_around(boxes)
    assert place_in_picture(view, add(view.target, shift_beside(boxes, boxes)))[0] > 1.0
    row = view_around([((-0.5, -4.0, 0.0), (0.5, 4.0, 0.2))])
    ends = [place_in_picture(row, (0.0, y, 0.0)) for y in (-4.0, 4.0)]
    assert abs(ends[1][0] - ends[0][0]) > 1.5


def test_a_scene_stands_clear_of_another_wherever_each_is() -> None:
    left = ((-1.0, -1.0, 0.0), (0.0, 0.0, 1.0))
    view = view_around([left])
    right = cross(subtract(view.target, view.eye), (0.0, 0.0, 1.0))
    for x in (-20.0, 0.0, 10.0):
        other = ((x, -1.0, 0.0), (x + 1.0, 0.0, 1.0))
        shift = shift_beside([left], [other])
        ends = [dot((a, b, 0.0), right) for a in (-1.0, 0.0) for b in (-1.0, 0.0)]
        others = [dot(add((a, b, 0.0), shift), right) for a in (x, x + 1.0) for b in (-1.0, 0.0)]
        assert min(others) > max(ends)


HILL = """
deepbots: 1
name: Hill
summary: A box and a cart on high ground.
world: {timestep: 32 ms, substeps: 8, terrain: TERRAIN}
objects: {block: {shape: box, size: 10 10 10 cm, mass: 1 kg}}
robots: {cart: {urdf: cartpole}}
action: {idle: -1 .. 1}
augment: {height: position(block).z}
observation: {height: 0 .. 10 m}
reward: {idle: idle}
truncation: {max_steps: 50}
reset: {place: {cart: {}, block: {region: {x: -1 .. 1 m, y: -1 .. 1 m}}}}
"""
TILES = "{type: tiles, levels: 1, side: 8 m, tiles: {up: {type: stairs, height: 0.5 .. 0.6 m, tread: 0.5 m}}}"


@pytest.mark.parametrize("kind", ["formula", "tiles", "mesh"])
def test_bodies_that_begin_on_high_ground_are_in_the_picture(kind: str, make: Make, tmp_path: Path) -> None:
    corners = [(-4, -4, 3), (4, -4, 3), (4, 4, 3), (-4, 4, 3)]
    faces = "".join(f"v {x} {y} {z}\n" for x, y, z in corners) + "f 1 2 3\nf 1 3 4\n"
    (tmp_path / "plateau.obj").write_text(faces)
    terrain = {
        "formula": "{type: formula, heights: 3 m, size: 8 8 m}",
        "tiles": TILES,
        "mesh": "{type: mesh, file: plateau.obj}",
    }[kind]
    environment = make(HILL.replace("TERRAIN", terrain))
    environment.reset(seed=0)
    view = overview(environment.scenario)
    for body in ("cart", "block"):
        place = environment.engine.pose(body)()[0]
        assert place[2] > 1.0
        assert max(map(abs, place_in_picture(view, place))) < 1.0
    assert view.eye[2] > 3.0
    highest = max(high[2] for _, high in extent(environment.scenario))
    assert highest > environment.engine.pose("cart")()[0][2]


def test_a_fixed_object_beyond_the_walls_is_in_the_picture(make: Make) -> None:
    arena = HILL.replace("terrain: TERRAIN", "arena: {size: 4 4 m}").replace("mass: 1 kg", "fixed: true")
    boxes = extent(make(arena, "reset.place={cart: {}, block: {x: 5 m}}").scenario)
    assert all(low < high for box in boxes for low, high in zip(*box, strict=True))
    assert max(high[0] for _, high in boxes) == pytest.approx(5.05)


@pytest.mark.parametrize("name", few(shipped.scenario_names()))
def test_every_robot_of_a_shipped_scenario_begins_in_the_picture(name: str) -> None:
    with closing(api.make(name)) as environment:
        view = overview(environment.scenario)
        for seed in range(5):
            environment.reset(seed=seed)
            for name in robot_bodies(environment):
                x, y = place_in_picture(view, environment.engine.pose(name)()[0])
                assert abs(x) < 1.0
                assert abs(y) < 1.0


def robot_bodies(environment: Supervisor) -> list[str]:
    """The bodies of the robots in the engine; with copies of a robot, those of every copy."""
    return [robot.name for robot in environment.world.robots]


def test_every_copy_of_a_row_begins_in_the_picture() -> None:
    with closing(
        api.make(COPIES, overrides=["robots.cart.count=9", "robots.cart.spacing=0 4 0 m"])
    ) as environment:
        view = overview(environment.scenario)
        environment.reset(seed=0)
        for number in range(1, 10):
            place = environment.engine.pose(f"cart#{number}")()[0]
            assert max(map(abs, place_in_picture(view, place))) < 1.0


def test_the_view_follows_a_robot_that_leaves_and_stays_where_there_is_an_arena() -> None:
    with closing(api.make("quadruped", engine="pybullet", render_mode="rgb_array")) as environment:
        environment.reset(seed=0)
        first = environment.render()
        (x, y, z), turn = environment.engine.pose("dog")()
        environment.engine.place("dog", (x + 8.0, y, z), turn)
        body = np.abs(environment.render().astype(int) - first.astype(int)).sum(axis=2) > 60
        assert body.mean() < 0.05  # the floor under it has the same tiles, and the robot is where it was


@pytest.mark.parametrize("name", shipped.scenario_names())
def test_a_shipped_scenario_has_no_findings(name: str) -> None:
    assert [f"{finding.span.location}: {finding.headline}" for finding in api.lint(name, preview=True)] == []


# Robots of an installed package


ROBOTS = {
    "franka_panda/panda.urdf": "fixed",
    "a1/a1.urdf": "free",
    "laikago/laikago_toes.urdf": "free",
    "husky/husky.urdf": "free",
    "r2d2.urdf": "free",
    "quadruped/minitaur.urdf": "free",
    "kuka_iiwa/model.urdf": "fixed",
}

SCENARIO = """
deepbots: 1
name: Tour
world: {{timestep: 20 ms, substeps: 5}}
robots:
  robot:
    urdf: package://pybullet_data/{file}
    base: {base}
    pose: {{z: 0.6 m}}
    groups: {{all: [{links}]}}
    sensors:
      place: {{type: position, link: {last}}}
      speed: {{type: velocity, link: {last}}}
      gyro:  {{type: gyro, link: {last}}}
      accel: {{type: accelerometer, link: {last}}}
      feel:  {{type: touch, links: all}}
      angle: {{type: joint_position, joint: {joint}, noise: 1 %}}
    actuators:
      motor: {{type: velocity_motor, joint: {joint}, max_torque: 1 {torque}}}
    emit: [place, speed, gyro, accel, feel, angle]
    apply: {{motor: push * 1 {rate}}}
action: {{push: -1 .. 1}}
observation:
  robot.place: -5 .. 5 m
  robot.speed: -5 .. 5 m/s
  robot.gyro:  -9 .. 9 rad/s
  robot.accel: -20 .. 20 m/s^2
  robot.feel:  auto
  robot.angle: -7 .. 7 {unit}
reward: {{r: push}}
truncation: {{max_steps: 1000}}
"""


@pytest.mark.parametrize("file", every(7, ROBOTS))
def test_a_robot_of_a_package_runs_with_sensors_on_any_link(tmp_path: Path, file: str) -> None:
    robot, findings = open_robot(f"package://pybullet_data/{file}")
    assert {finding.severity for finding in findings} <= {"warning"}
    joint = robot.model.moving_joints[0]
    slides = joint.type == "prismatic"
    text = SCENARIO.format(
        file=file,
        base=ROBOTS[file],
        links=", ".join(f'"{link.name}"' for link in robot.model.links if link.collisions),
        last=robot.model.links[-1].name,
        joint=joint.name,
        torque="N" if slides else "N*m",
        rate="m/s" if slides else "rad/s",
        unit="m" if slides else "rad",
    )
    path = tmp_path / "tour.yaml"
    path.write_text(text, encoding="utf-8")
    findings = api.lint(path)
    assert [finding.headline for finding in findings if finding.severity == "error"] == []
    assert [finding for finding in findings if finding.span.source.name.endswith(".urdf")] == []
    with closing(api.make(path)) as environment:
        environment.action_space.seed(0)
        environment.reset(seed=0)
        for _ in range(1000):
            observation, *_ = environment.step(environment.action_space.sample())
        assert np.isfinite(observation).all()
