"""Sensors along rays.

* Sensors along rays, against closed forms, and their lookup tables.
* Height scans and grids of rays, against the height of the ground and of bodies on it.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from itertools import pairwise
from math import asin, cos, pi, sin, sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deepbots_cli import api, frames
from deepbots_cli.geometry import ground_height
from deepbots_cli.program.robots import CalibrationTable, RayConfig, Sensor
from deepbots_cli.program.world import Line, ObjectBody
from deepbots_cli.robots.model import Box, Pose, Sphere
from deepbots_cli.runtime.readers import LookupTable
from deepbots_cli.runtime.streams import Streams
from tests.sensing.conftest import DEGREE, Scene, brick

Build = Callable[..., Scene]

HERE = Pose()


def ranger(
    *turns: float,
    reach: float = 5.0,
    combined: str = "each",
    mount: Pose = HERE,
    lookup: CalibrationTable | None = None,
) -> Sensor:
    """Rays at these yaw angles (deg)."""
    rays = tuple(Pose(rpy=(0, 0, turn * DEGREE)) for turn in turns)
    names = tuple(f"r{index}" for index in range(len(turns))) if combined == "each" else ()
    return Sensor("s", "sonar", ("brick",), names, "m", mount, None, RayConfig(rays, reach, combined, lookup))  # type: ignore[arg-type]


@pytest.mark.parametrize("angle", [0, 20, 45])
def test_the_distance_to_a_wall_grows_with_the_angle(scene: Build, angle: float) -> None:
    wall = ObjectBody("wall", Box((0.2, 20, 20)), Pose((2.1, 0, 0)), fixed=True)
    world = scene(brick(), gravity=(0, 0, 0), objects=(wall,))
    sensor = world.sensor(ranger(angle, -angle))
    world.begin()
    assert sensor.reading == pytest.approx([2.0 / cos(angle * DEGREE)] * 2, abs=1e-6)


@pytest.mark.parametrize("angle", [0, 5, 10])
def test_the_distance_to_a_ball_is_that_of_the_circle(scene: Build, angle: float) -> None:
    ball, away = 0.5, 2.0
    thing = ObjectBody("ball", Sphere(ball), Pose((away, 0, 1)), fixed=True)
    world = scene(brick(), gravity=(0, 0, 0), objects=(thing,))
    sensor = world.sensor(ranger(angle))
    world.begin()
    t = angle * DEGREE
    assert abs(t) < asin(ball / away)
    assert sensor.reading == pytest.approx([away * cos(t) - sqrt(ball**2 - (away * sin(t)) ** 2)], abs=1e-6)


def test_rays_turn_and_move_with_the_robot_and_end_at_their_reach(scene: Build) -> None:
    wall = ObjectBody("wall", Box((0.2, 20, 20)), Pose((2.1, 0, 0)), fixed=True)
    world = scene(brick(), pose=Pose((0.5, 0, 1), (0, 0, pi / 2)), gravity=(0, 0, 0), objects=(wall,))
    sensor = world.sensor(ranger(0, 180, mount=Pose((0.0, -0.25, 0.0), (0, 0, -pi / 2)), reach=3.0))
    world.begin()
    assert sensor.reading == pytest.approx([1.25, 3.0], abs=1e-6)


def test_several_rays_may_give_one_figure(scene: Build) -> None:
    wall = ObjectBody("wall", Box((0.2, 20, 20)), Pose((2.1, 0, 0)), fixed=True)
    world = scene(brick(), gravity=(0, 0, 0), objects=(wall,))
    nearest = world.sensor(ranger(60, 0, combined="nearest"))
    mean = world.sensor(ranger(60, 0, combined="mean"))
    world.begin()
    assert (nearest.reading, mean.reading) == (pytest.approx([2.0], abs=1e-6), pytest.approx([3.0], abs=1e-6))


TABLE = CalibrationTable((0.01, 0.02, 0.05, 0.07), (1000.0, 400.0, 100.0, 50.0))


def test_a_lookup_is_straight_between_its_rows_and_flat_beyond_them() -> None:
    distances = [0.0, 0.005, *np.linspace(0.01, 0.07, 61), 0.08, 1.0]
    assert LookupTable(TABLE, len(distances))(distances) == pytest.approx(
        np.interp(distances, TABLE.distance, TABLE.value)
    )


def test_the_noise_of_a_lookup_is_a_share_of_the_reading_interpolated_between_rows() -> None:
    noisy = CalibrationTable(TABLE.distance, TABLE.value, (0.002, 0.04, 0.01, 0.03))
    distances = [0.0, 0.01, 0.015, 0.03, 0.07, 0.2]
    table = LookupTable(noisy, len(distances))
    table.restart(Streams(3)["lookup"])
    sample = np.array([table(distances) for _ in range(20_000)])
    values = np.interp(distances, noisy.distance, noisy.value)
    shares = np.interp(distances, noisy.distance, noisy.noise)
    assert sample.mean(axis=0) == pytest.approx(values, rel=2e-3)
    assert (sample.std(axis=0) / values) == pytest.approx(shares, rel=0.03)


def test_a_ray_sensor_reports_what_its_table_makes_of_the_distance(scene: Build) -> None:
    wall = ObjectBody("wall", Box((0.2, 20, 20)), Pose((0.24, 0, 0)), fixed=True)
    world = scene(brick(), gravity=(0, 0, 0), objects=(wall,))
    sensor = world.sensor(ranger(0, 180, reach=0.07, mount=Pose((0.1, 0, 0)), lookup=TABLE))
    world.begin()
    assert sensor.reading == pytest.approx([200.0, 50.0], rel=1e-4)


def test_readings_fall_with_the_distance(scene: Build) -> None:
    world = scene(
        brick(),
        gravity=(0, 0, 0),
        objects=(ObjectBody("wall", Box((0.2, 2, 2)), Pose((0.9, 0, 1)), fixed=True),),
    )
    sensor = world.sensor(ranger(0, reach=0.07, mount=Pose((0.1, 0, 0)), lookup=TABLE))
    readings = []
    for step in range(8):
        world.engine.reset()
        world.engine.place("robot", (0.7 - 0.01 * step, 0, 1), (0, 0, 0, 1))
        world.begin()
        readings.append(sensor.reading[0])
    assert all(near > far for near, far in pairwise(readings[1:7]))


# What touch and force sensors feel
STONE = ObjectBody("stone", Box((0.1, 0.1, 0.1)), Pose((0.5, 0, 0.05)), mass=0.5)


def touch(against: tuple[str, ...] | None = None) -> Sensor:
    return Sensor("touch", "touch", ("brick",), (), "", against=against)


def test_a_force_sensor_feels_the_weight_of_what_it_carries(scene: Build) -> None:
    world = scene(brick(), pose=Pose((0, 0, 0.1)), ground=True)
    force = world.sensor(Sensor("force", "force", ("brick",), (), "N"))
    world.begin()
    assert force.reading == pytest.approx([0.0])
    world.tick(100)
    assert force.reading[0] == pytest.approx(9.81, rel=0.01)


def test_touch_begins_with_the_tick_of_the_impact(scene: Build) -> None:
    height = 0.2
    world = scene(brick(), pose=Pose((0, 0, 0.1 + height)), ground=True)
    sensor = world.sensor(touch())
    world.begin()
    assert list(sensor.reading) == [False]
    falling = (2 * height / 9.81) ** 0.5
    ticks = 0
    while not sensor.reading[0]:
        world.tick()
        ticks += 1
    assert ticks * world.world.timestep == pytest.approx(falling, abs=1.5 * world.world.timestep)


AGAINST = [
    (None, True, True),
    (("ground",), True, False),
    (("stone",), False, True),
    (("stone", "ground"), True, True),
    (("stone.stone",), False, True),
]


@pytest.mark.parametrize(("against", "on_ground", "on_stone"), AGAINST)
def test_touch_may_feel_only_some_bodies(
    scene: Build, against: tuple[str, ...] | None, on_ground: bool, on_stone: bool
) -> None:
    world = scene(brick(), pose=Pose((0, 0, 0.1)), ground=True, objects=(STONE,))
    sensor = world.sensor(touch(against))
    world.begin()
    world.tick(5)
    assert list(sensor.reading) == [on_ground]
    world.engine.reset()
    world.engine.place("robot", (0.5, 0, 0.2), (0, 0, 0, 1))
    world.begin()
    assert list(sensor.reading) == [False]
    world.tick(5)
    assert list(sensor.reading) == [on_stone]


# Sensors that look at lines on the ground
TRACK = Line("track", ((-2.0, 0.0), (2.0, 0.0)), False, 0.02, 0.1)
SPOT = 0.004


def watched(
    scene: Build, *places: tuple[float, float], turn: tuple[float, float, float] = (0, 0, 0)
) -> Scene:
    """A cube above the line, with eyes at these places of it, 0.1 m below its middle."""
    world = scene(brick(), pose=Pose((0, 0, 0.3), turn), gravity=(0, 0, 0))
    world.world = replace(world.world, lines=(TRACK,))
    rays = tuple(Pose((x, y, -0.1)) for x, y in places)
    world.sensor(
        Sensor(
            "s",
            "reflectance",
            ("brick",),
            tuple(f"r{index}" for index in range(len(rays))),
            "1",
            beams=RayConfig(rays, 0.0),
            parameters=(("spot", SPOT),),
        )
    )
    world.begin()
    return world


def test_the_line_is_dark_and_the_ground_is_white(scene: Build) -> None:
    world = watched(scene, (0, 0), (0, 0.03), (0.05, -0.007), (0, -0.2))
    assert world.devices[0].reading == pytest.approx([0.1, 1.0, 0.1, 1.0])


def test_at_the_edge_of_the_line_the_reading_is_the_mean_of_both(scene: Build) -> None:
    world = watched(scene, (0, 0.01), (0, 0.01 - SPOT / 4), (0, 0.01 + SPOT / 4))
    on_edge, mostly_dark, mostly_light = world.devices[0].reading
    assert on_edge == pytest.approx(0.55)
    assert 0.1 < mostly_dark < on_edge < mostly_light < 1.0


def test_an_eye_looks_along_its_own_axis(scene: Build) -> None:
    """Leaning by 45 deg about x, an eye 0.1 m below the middle stands 0.0707 m aside and looks as far again
    as it is high."""
    world = watched(scene, (0, 0), turn=(45 * DEGREE, 0, 0))
    aside = 0.1 * 2**-0.5
    height = 0.3 - aside
    hit = aside + height  # -z of the leaning eye points to the left
    world.engine.reset()
    world.engine.place("robot", (0, -hit, 0.3), world.engine.pose("robot")()[1])
    world.begin()
    assert world.devices[0].reading == pytest.approx([0.1])


def test_an_eye_that_looks_up_sees_nothing(scene: Build) -> None:
    assert watched(scene, (0, 0), turn=(180 * DEGREE, 0, 0)).devices[0].reading == [0.0]


WAVES = "{type: formula, heights: 3 cm * (sin(x / m * 300 deg) + sin(y / m * 400 deg)), size: 20 20 m}"
ROUGH = f"""\
deepbots: 1
extends: quadruped
name: Rough
world: {{terrain: {WAVES}}}
robots:
  dog:
    sensors: {{scan: {{type: height_scan, link: trunk, grid: 4 3, spacing: 20 cm, range: -1 .. 1 m}}}}
    emit: {{scan: scan}}
observation: {{dog.scan: -1 .. 1 m}}
evaluation: {{cases: {{}}}}
tests: {{}}
"""


def scenario(folder: Path, text: str) -> api.Compiled:
    file = folder / "rough.yaml"
    file.write_text(text)
    return api.compile(file)


def points(environment: Any, *, level: bool = True) -> list[tuple[float, float, float]]:
    """The points of the grid in the world, in the order of the components."""
    position, turned = environment.engine.pose("dog", "trunk")()
    frame = position, frames.yaw_only(turned) if level else turned
    grid = [(0.2 * (i - 1.5), 0.2 * (j - 1.0), 0.0) for i in range(4) for j in range(3)]
    return [frames.compose(frame, (point, frames.IDENTITY_ROTATION))[0] for point in grid]


@pytest.mark.parametrize("engine", ["mujoco", "pybullet"])
@pytest.mark.parametrize("seed", [3, pytest.param(4, marks=pytest.mark.slow)])
def test_a_scan_is_the_height_above_the_ground_at_each_point(tmp_path: Path, engine: str, seed: int) -> None:
    pytest.importorskip(engine)
    compiled = scenario(tmp_path, ROUGH)
    height = ground_height(compiled.program.world.terrain)
    with closing(api.make(compiled, engine=engine)) as environment:
        environment.reset(seed=seed)
        expected = [z - height(x, y) for x, y, z in points(environment)]
        assert environment.robot_dog.sense_scan.reading == pytest.approx(expected, abs=1e-6)
        assert compiled.program.robots[0].sensors[-1].components[:4] == ("r0_0", "r0_1", "r0_2", "r1_0")


@pytest.mark.parametrize("engine", ["mujoco", "pybullet"])
def test_a_scan_sees_what_lies_on_the_ground_and_what_is_higher_than_the_link(
    tmp_path: Path, engine: str
) -> None:
    pytest.importorskip(engine)
    walls = "objects: {block: {shape: box, size: 20 20 0.1 m, pose: {z: 5 cm}, fixed: true}}\n"
    tall = "objects: {block: {shape: box, size: 20 20 0.6 m, pose: {y: 10.1 m, z: 30 cm}, fixed: true}}\n"
    flat = ROUGH.replace(f"{{terrain: {WAVES}}}", "{gravity: 0 0 0 m/s^2}")
    placed = "reset: {place: {dog: {x: 0 m, y: 0 m, z: 50 cm, yaw: 0 deg}}, settle: 0 s}\n"
    for bodies, tops in ((walls, [0.1] * 3), (tall, [0.0, 0.0, 0.6])):
        with closing(api.make(scenario(tmp_path, flat + bodies + placed), engine=engine)) as environment:
            environment.reset(seed=1)
            expected = [z - top for (_, _, z), top in zip(points(environment), tops * 4, strict=True)]
            assert environment.robot_dog.sense_scan.reading == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize("align", ["yaw", "link"])
def test_rays_stay_level_or_turn_with_the_link(tmp_path: Path, align: str) -> None:
    """Above a plane, a ray along the link's -z from a point p is free for p.z over the cosine of the tilt."""
    text = ROUGH.replace(f"{{terrain: {WAVES}}}", "{gravity: 0 0 0 m/s^2}").replace(
        "range: -1 .. 1 m", f"range: 0 .. 2 m, align: {align}"
    )
    placed = "reset: {place: {dog: {x: 0 m, y: 0 m, z: 1 m, roll: 20 deg, yaw: 30 deg}}, settle: 0 s}\n"
    with closing(api.make(scenario(tmp_path, text + placed), engine="mujoco")) as environment:
        environment.reset(seed=1)
        down = 1.0 if align == "yaw" else np.cos(np.radians(20.0))
        expected = [z / down for _, _, z in points(environment, level=align == "yaw")]
        assert environment.robot_dog.sense_scan.reading == pytest.approx(expected, abs=1e-6)


def test_a_batch_reads_what_single_worlds_read(tmp_path: Path) -> None:
    compiled = scenario(
        tmp_path, ROUGH.replace("range: -1 .. 1 m", "range: -1 .. 1 m, noise: 1 cm, latency: 40 ms")
    )
    with (
        closing(api.make(compiled, engine="mujoco")) as single,
        closing(api.make_vec(compiled, 2)) as batch,
    ):
        observations, _ = batch.reset(seed=[5, 6])
        np.testing.assert_array_equal(observations[0], single.reset(seed=5)[0])
        batch.action_space.seed(1)
        for _ in range(25):
            actions = batch.action_space.sample()
            observations = batch.step(actions)[0]
            np.testing.assert_array_equal(observations[0], single.step(actions[0])[0])


def test_a_grid_of_other_rays_lies_across_their_direction(tmp_path: Path) -> None:
    """A wall 2 m ahead is met by all rays of a grid at the same distance."""
    text = ROUGH.replace(f"{{terrain: {WAVES}}}", "{gravity: 0 0 0 m/s^2}").replace(
        "type: height_scan, link: trunk, grid: 4 3, spacing: 20 cm, range: -1 .. 1 m",
        "type: laser, link: trunk, grid: 4 3, spacing: 20 cm, range: 0 .. 5 m",
    )
    wall = "objects: {wall: {shape: box, size: 2 20 20 m, pose: {x: 3 m}, fixed: true}}\n"
    placed = "reset: {place: {dog: {x: 0 m, y: 0 m, z: 1 m, yaw: 0 deg}}, settle: 0 s}\n"
    compiled = scenario(tmp_path, text.replace("-1 .. 1 m}", "0 .. 5 m}") + wall + placed)
    with closing(api.make(compiled, engine="mujoco")) as environment:
        environment.reset(seed=1)
        assert environment.robot_dog.sense_scan.reading == pytest.approx([2.0] * 12, abs=1e-6)


@pytest.mark.parametrize(
    ("sensor", "code"),
    [
        ("type: height_scan, link: trunk, grid: 4 3", "DB102"),  # no range
        ("type: height_scan, link: trunk, grid: 4 3, range: -1 .. 0 m", "DB105"),
        ("type: height_scan, link: trunk, grid: 4 3, rays: 5, range: 0 .. 1 m", "DB101"),
        ("type: height_scan, link: trunk, grid: 4 0, range: 0 .. 1 m", "DB105"),
        ("type: laser, link: trunk, grid: 4 3, spacing: 0 m, range: 0 .. 1 m", "DB105"),
        ("type: laser, link: trunk, grid: 4 3, spacing: 1 s, range: 0 .. 1 m", "DB503"),
    ],
)
def test_a_wrong_scan_is_a_finding_at_its_place(tmp_path: Path, sensor: str, code: str) -> None:
    file = tmp_path / "rough.yaml"
    scan = "type: height_scan, link: trunk, grid: 4 3, spacing: 20 cm, range: -1 .. 1 m"
    file.write_text(ROUGH.replace(scan, sensor))
    findings = [finding for finding in api.lint(file) if finding.severity == "error"]
    assert [finding.code for finding in findings] == [code]
