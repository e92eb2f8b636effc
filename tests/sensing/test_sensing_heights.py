"""Height scans and grids of rays, against the height of the ground and of bodies on it."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deepbots_cli import api, frames
from deepbots_cli.geometry import ground_height

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
@pytest.mark.parametrize("seed", [3, 4])
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
