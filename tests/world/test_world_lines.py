"""Painted lines: places beside and along them, their reflected light, and their use in a scenario.

`height(x, y)` in expressions: the surface that both engines collide with, alone and in a batch.
"""

from __future__ import annotations

import math
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from deepbots_cli import api
from deepbots_cli.compiler import check
from deepbots_cli.document.load import load
from deepbots_cli.engine_kinds import Diagonal, diagonal_of
from deepbots_cli.geometry import HeightGrid, ground_height, ground_heights
from deepbots_cli.program.world import Line, ObjectBody, Pit, Terrain, TerrainShape, Tile, Tiles, WorldModel
from deepbots_cli.robots.model import Pose, Sphere
from deepbots_cli.runtime.paths import Follower

SQUARE = Line(
    "square", ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)), closed=True, width=0.02, reflectance=0.1
)
ROAD = Line("road", ((0.0, 0.0), (1.0, 0.0)), closed=False, width=0.02)


def circle(corners: int, radius: float = 1.0) -> Line:
    angles = [2 * math.pi * n / corners for n in range(corners)]
    return Line(
        "circle", tuple((radius * math.cos(a), radius * math.sin(a)) for a in angles), closed=True, width=0.02
    )


def test_the_way_along_a_line_counts_from_where_the_episode_begins() -> None:
    follow = Follower(ROAD)
    follow((0.3, 0.0))
    assert (follow((0.8, 0.0))[1], follow((0.2, 0.0))[1]) == (pytest.approx(0.5), pytest.approx(-0.1))
    follow.reset()
    assert follow((0.9, 0.0))[1] == 0.0


def test_laps_of_a_closed_line_add_up_and_driving_back_takes_them_away() -> None:
    line = circle(90)
    follow = Follower(line)
    for degree in range(3 * 360 + 1):
        _, driven = follow((math.cos(math.radians(degree)), math.sin(math.radians(degree))))
    assert driven == pytest.approx(3 * line.length, rel=1e-6)
    for degree in range(3 * 360, -361, -1):
        _, driven = follow((math.cos(math.radians(degree)), math.sin(math.radians(degree))))
    assert driven == pytest.approx(-line.length, rel=1e-6)


def test_asking_twice_at_one_place_changes_nothing() -> None:
    follow = Follower(SQUARE)
    follow((0.9, 0.0))
    assert follow((1.0, 0.1)) == follow((1.0, 0.1))


def test_a_line_that_crosses_itself_is_followed_straight_on() -> None:
    eight = Line("eight", ((-1.0, -1.0), (1.0, 1.0), (1.0, -1.0), (-1.0, 1.0)), closed=True, width=0.02)
    follow = Follower(eight)
    for step in range(-80, 81):
        beside, driven = follow((step / 100, step / 100 + 0.001))
    assert driven == pytest.approx(1.6 * math.sqrt(2))
    assert beside == pytest.approx(0.001 / math.sqrt(2))


def test_lanes_beside_each_other_are_distinguished() -> None:
    hairpin = Line("hairpin", ((0.0, 0.0), (2.0, 0.0), (2.0, 0.05), (0.0, 0.05)), closed=False, width=0.01)
    follow = Follower(hairpin)
    for step in range(101):
        beside, _ = follow((step / 100, 0.02))
    assert beside == pytest.approx(0.02)
    beside, _ = follow((1.01, 0.03))  # nearer to the way back, which is two meters on
    assert beside == pytest.approx(0.03)


GROUND = Path(__file__).parents[1] / "data" / "scenarios" / "ground.yaml"
RAMP = Path(__file__).parents[1] / "data" / "hosts" / "terrain_mesh.yaml"
STAIRS = Tiles(
    (Tile("stairs", (("height", 0.02, 0.16), ("tread", 0.3, 0.3), ("inverted", 0.0, 0.0))),),
    2,
    4.0,
    0.0,
    1.0,
    0.05,
    0,
)
ROUGH = Tiles((Tile("rough", (("height", 0.0, 0.3), ("grain", 0.2, 0.2))),), 2, 4.0, 1.0, 1.0, 0.1, 0)
PIT = Pit(3.2, 2.0)
SHAPES = [
    pytest.param(shape, id=name) for name, shape in (("stairs", STAIRS), ("rough", ROUGH), ("pit", PIT))
]


def world(shape: TerrainShape) -> WorldModel:
    ball = ObjectBody("ball", Sphere(0.01), Pose((0.0, 0.0, 5.0)), mass=1.0)
    return WorldModel(timestep=0.01, substeps=1, terrain=Terrain(shape), objects=(ball,))


@pytest.mark.parametrize("diagonal", ["falling", "rising"])
@pytest.mark.parametrize("shape", SHAPES)
def test_columns_have_the_heights_of_single_points_to_the_bit(
    shape: TerrainShape, diagonal: Diagonal
) -> None:
    numbers = np.random.default_rng(1)
    x, y = numbers.uniform(-6.0, 6.0, (2, 3000))  # beyond the terrain, too
    x[:200] = np.round(x[:200] / 0.05) * 0.05  # on the lines of the grid
    y[:100] = np.round(y[:100] / 0.05) * 0.05
    at = ground_height(Terrain(shape), diagonal)
    over = ground_heights(Terrain(shape), diagonal)
    assert over(x, y).tolist() == [at(*place) for place in zip(x.tolist(), y.tolist(), strict=True)]


@pytest.mark.parametrize(
    ("diagonal", "inside"), [("falling", [1.5, 0.75, 5.25]), ("rising", [4.5, 2.25, 6.75])]
)
def test_each_cell_is_two_triangles(diagonal: Diagonal, inside: list[float]) -> None:
    grid = HeightGrid(np.array([[0.0, 1.0], [2.0, 9.0]]), (2.0, 2.0), diagonal)
    places = [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (0.0, 0.0), (-0.5, -0.5), (0.5, 0.5)]
    x, y = np.transpose(places)
    assert grid.heights_function()(x, y) == pytest.approx([0.0, 1.0, 2.0, 9.0, *inside])


@pytest.fixture(scope="module")
def ramp() -> Terrain:
    """A mesh from -4 to 4 m, which rises from 0 to 0.2 m along y."""
    program = api.compile(RAMP).program
    assert program.world.terrain is not None
    return program.world.terrain


@pytest.mark.parametrize(
    ("x", "y", "height"),
    [(0.0, 4.1, 0.2), (0.0, -50.0, 0.0), (4.5, 2.0, 0.15), (-9.0, 9.0, 0.2), (math.inf, 0.0, 0.1)],
)
def test_beyond_a_mesh_the_ground_has_the_height_of_its_nearest_edge(
    ramp: Terrain, x: float, y: float, height: float
) -> None:
    assert ground_height(ramp)(x, y) == pytest.approx(height)


@pytest.mark.parametrize("kind", ["pit", "mesh", "plane"])
def test_only_a_place_that_is_not_a_number_has_no_height_in_a_column(ramp: Terrain, kind: str) -> None:
    over = ground_heights({"pit": Terrain(PIT), "mesh": ramp, "plane": None}[kind])
    heights = over(np.array([math.nan, 0.0, math.inf]), np.array([0.0, 0.0, 0.0]))
    assert np.isnan(heights).tolist() == [True, False, False]


def test_a_plane_has_the_height_0() -> None:
    assert (ground_height(None)(3.0, 4.0), ground_heights(None)(np.ones(3), np.ones(1)).tolist()) == (
        0.0,
        [0.0, 0.0, 0.0],
    )


@pytest.mark.parametrize("engine", ["mujoco", "pybullet"])
def test_the_feet_of_a_robot_on_stairs_stand_on_the_ground(engine: str) -> None:
    pytest.importorskip(engine)
    with closing(api.make(GROUND, engine=engine)) as environment:
        for level in (0, 1):
            environment.reset(seed=3, options={"kind": 1, "level": level})
            poses = [environment.engine.pose("dog", f"{leg}_toe")()[0] for leg in ("FR", "FL", "RR", "RL")]
            at = ground_height(environment.world.terrain, diagonal_of(engine))
            expected = [z - at(x, y) for x, y, z in poses]
            observed = environment.get_observations()[-5:-1]
            assert -0.1 + 0.2 * (observed + 1.0) == pytest.approx(expected, abs=1e-6)
            assert np.mean(expected) == pytest.approx(0.02, abs=0.01)  # the radius of a foot


@pytest.mark.parametrize(
    ("expression", "code", "headline"),
    [
        ("height(1, 2) / m", "DB502", "expected a length (m)"),
        ("height(position(dog).x) / m", "DB401", "`height` takes 2 arguments, not 1"),
        ("height(dog, dog) / m", "DB203", "robot"),
        ("height(yaw(dog), 1 m) / m", "DB503", "must be a length"),
        ("height(position(dog.toes).x, position(dog.toes).y) / m", "DB404", "single value"),
    ],
)
def test_a_wrong_argument_is_found(expression: str, code: str, headline: str) -> None:
    findings = check(load(GROUND, overrides=[f'reward={{"high": "{expression}"}}'])).findings.errors
    assert {finding.code for finding in findings} == {code}
    assert headline in findings[0].headline
