"""Sensors along rays.

* Sensors along rays, against closed forms, and their lookup tables.
* Height scans and grids of rays, against the height of the ground and of bodies on it.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from deepbots_cli import api
from deepbots_cli.program.robots import CalibrationTable, RayConfig, Sensor
from deepbots_cli.program.world import ObjectBody
from deepbots_cli.robots.model import Box, Pose
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
