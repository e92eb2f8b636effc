"""Terrain of tiles, against closed forms of each kind."""

from __future__ import annotations

import math
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from deepbots_cli import api
from deepbots_cli.compiler import check
from deepbots_cli.document.load import load
from deepbots_cli.geometry import ground_height, tile_heights, tile_terrain_heights
from deepbots_cli.program.world import TILE_MARGIN_M, Tile, Tiles

SIDE, PLATFORM, CELL, LEVELS = 8.0, 1.6, 0.1, 5


def tiles(kind: str, seed: int = 0, **measures: tuple[float, float]) -> Tiles:
    tile = Tile(kind, tuple((name, *ends) for name, ends in measures.items()))
    return Tiles((tile,), LEVELS, SIDE, 2.0, PLATFORM, CELL, seed)


def along_x(terrain: Tiles, level: int) -> np.ndarray:
    """Heights along the middle of a tile, from its edge to the middle of its platform."""
    whole = tile_heights(terrain, 0, level)
    return whole[len(whole) // 2, : len(whole) // 2 + 1]


KINDS = {
    "slope": {"angle": (0.0, 0.4), "inverted": (0.0, 0.0)},
    "stairs": {"height": (0.02, 0.16), "tread": (0.3, 0.3), "inverted": (0.0, 0.0)},
    "waves": {"height": (0.0, 0.1), "length": (2.0, 2.0)},
    "rough": {"height": (0.0, 0.08), "grain": (0.2, 0.2)},
    "blocks": {"height": (0.02, 0.16), "side": (0.5, 0.5)},
    "stepping_stones": {"side": (0.8, 0.3), "gap": (0.1, 0.2), "depth": (1.0, 1.0)},
    "gaps": {"width": (0.1, 0.3), "spacing": (1.0, 1.0), "depth": (1.0, 1.0)},
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("level", range(LEVELS))
def test_a_tile_is_level_along_its_edge_and_on_its_platform_unless_the_ground_is_rough(
    kind: str, level: int
) -> None:
    whole = tile_heights(tiles(kind, **KINDS[kind]), 0, level)
    assert whole.shape == (81, 81)
    assert not np.any([whole[0], whole[-1], whole[:, 0], whole[:, -1]])
    platform = whole[33:48, 33:48]
    is_uneven = kind in ("waves", "rough") and level > 0
    assert (np.ptp(platform) > 0.0) == is_uneven


@pytest.mark.parametrize("inverted", [0.0, 1.0])
def test_stairs_climb_a_step_for_each_tread(inverted: float) -> None:
    terrain = tiles("stairs", height=(0.02, 0.16), tread=(0.3, 0.3), inverted=(inverted, inverted))
    for level, step in enumerate(np.linspace(0.02, 0.16, LEVELS)):
        line = along_x(terrain, level) * (-1.0 if inverted else 1.0)
        count = math.floor((SIDE - PLATFORM) / 2 / 0.3)
        assert line[-1] == pytest.approx(count * step)
        assert np.unique(line.round(9)) == pytest.approx(step * np.arange(count + 1))
        assert np.all(np.diff(line) >= 0.0)


def test_a_slope_has_its_angle() -> None:
    terrain = tiles("slope", angle=(0.0, 0.4), inverted=(0.0, 0.0))
    for level, angle in enumerate(np.linspace(0.0, 0.4, LEVELS)):
        line = along_x(terrain, level)
        rising = np.diff(line)[: round((SIDE - PLATFORM) / 2 / CELL)]
        assert rising == pytest.approx(math.tan(angle) * CELL, abs=1e-12)


def test_waves_go_up_to_their_height_with_their_length() -> None:
    whole = tile_heights(tiles("waves", **KINDS["waves"]), 0, LEVELS - 1)
    x = np.linspace(-SIDE / 2, SIDE / 2, len(whole))
    inner = np.abs(x) <= SIDE / 2 - TILE_MARGIN_M
    wave = 0.1 * (np.cos(math.pi * x[:, None]) + np.cos(math.pi * x[None, :]) + 2.0) / 4.0
    assert whole[np.ix_(inner, inner)] == pytest.approx(wave[np.ix_(inner, inner)])
    assert whole.max() == pytest.approx(0.1)


@pytest.mark.parametrize("kind", ["rough", "blocks"])
def test_random_heights_are_within_their_range_and_those_of_their_seed(kind: str) -> None:
    measures = KINDS[kind]
    first, again, another_seed = (tile_heights(tiles(kind, seed, **measures), 0, 4) for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, another_seed)
    highest = measures["height"][1]
    assert 0.8 * highest < first.max() <= highest
    assert first.min() >= 0.0


def test_stones_and_gaps_have_their_widths() -> None:
    stones = along_x(tiles("stepping_stones", **KINDS["stepping_stones"]), LEVELS - 1)
    assert set(np.unique(stones)) == {-1.0, 0.0}
    # From the edge to the platform: stones of 0.3 m with gaps of 0.2 m between.
    assert np.flatnonzero(stones < 0.0).tolist() == [7, 8, 12, 13, 17, 18, 22, 23, 27, 28]
    trenches = along_x(tiles("gaps", **KINDS["gaps"]), LEVELS - 1)
    # Outward from the platform: 1 m of ground, then a trench of 0.3 m, twice, and ground up to the edge.
    outward = trenches[::-1][round(PLATFORM / 2 / CELL) :]
    assert np.flatnonzero(outward < 0.0).tolist() == [11, 12, 13, 24, 25, 26]


def test_kinds_stand_along_x_and_levels_along_y() -> None:
    kinds = tuple(Tile(kind, tuple((name, *ends) for name, ends in KINDS[kind].items())) for kind in KINDS)
    terrain = Tiles(kinds, LEVELS, SIDE, 2.0, PLATFORM, CELL, 3)
    whole = tile_terrain_heights(terrain)
    assert whole.shape == (5 * 80 + 41, 7 * 80 + 41)
    assert terrain.size == (60.0, 44.0)
    assert np.array_equal(whole[20 + 160 : 20 + 241, 20 + 80 : 20 + 161], tile_heights(terrain, 1, 2))


SCENARIO = """\
deepbots: 1
extends: quadruped
name: Climb
parameters: {kind: 1, level: 2}
world:
  terrain:
    type: tiles
    levels: 3
    tiles: {waves: {type: waves, height: 0 .. 10 cm}, up: {type: stairs, height: 2 .. 16 cm}}
reset: {place: {dog: {x: (kind - 0.5) * 8 m, y: (level - 1) * 8 m}}}
remove: [reset.place.dog.z]
evaluation: {cases: {}}
tests: {}
"""


@pytest.mark.parametrize("engine", ["mujoco", "pybullet"])
def test_a_robot_begins_on_the_platform_of_its_tile(tmp_path: Path, engine: str) -> None:
    pytest.importorskip(engine)
    (tmp_path / "climb.yaml").write_text(SCENARIO)
    compiled = api.compile(tmp_path / "climb.yaml")
    top = 0.16 * math.floor((8.0 - 1.5) / 2 / 0.3)
    assert ground_height(compiled.program.world.terrain)(4.0, 8.0) == pytest.approx(top)
    with closing(api.make(compiled, engine=engine)) as environment:
        environment.reset(seed=1)
        x, y, z = environment.engine.pose("dog")()[0]
        assert (x, y) == pytest.approx((4.0, 8.0), abs=0.05)
        assert 0.15 < z - top < 0.6
        toes = [environment.engine.pose("dog", f"{leg}_toe")()[0][2] for leg in ("FR", "FL", "RR", "RL")]
        assert np.mean(toes) - top == pytest.approx(0.02, abs=0.01)  # the radius of a foot


@pytest.mark.parametrize(
    ("terrain", "code"),
    [
        ("tiles: {up: {type: stairs, height: 2 .. 16 cm, tread: 8 m}}", "DB105"),
        ("tiles: {up: {type: stairs, height: 2 .. 16 cm}}, platform: 8 m", "DB105"),
        ("tiles: {up: {type: stairs, height: -2 .. 16 cm}}", "DB105"),
        ("tiles: {up: {type: stairs, height: 2 .. 16 s}}", "DB503"),
        ("tiles: {up: {type: slope, angle: 0 .. 100 deg}}", "DB105"),
        ("tiles: {over: {type: stepping_stones, side: 50 .. 0 cm, gap: 0 .. 10 cm}}", "DB105"),
        ("tiles: {up: {type: ladder, height: 2 .. 16 cm}}", "DB104"),
        ("tiles: {over: {type: gaps, width: 5 .. 30 cm}}", "DB105"),  # finer than the cell
        ("tiles: {up: {type: stairs, height: 2 .. 16 cm}}, side: 8.05 m", "DB308"),
        ("tiles: {up: {type: stairs, height: 2 .. 16 cm}}, cell: 1 cm", "DB005"),
        ("tiles: {}", "DB107"),
    ],
)
def test_tiles_that_do_not_fit_are_one_finding(tmp_path: Path, terrain: str, code: str) -> None:
    (tmp_path / "climb.yaml").write_text(
        f"deepbots: 1\nextends: quadruped\nname: Climb\nworld: {{terrain: {{type: tiles, {terrain}}}}}\n"
    )
    errors = [finding for finding in api.lint(tmp_path / "climb.yaml") if finding.severity == "error"]
    assert [finding.code for finding in errors] == [code], [finding.headline for finding in errors]


@pytest.mark.parametrize("kind", KINDS)
def test_no_height_of_a_tile_is_larger_than_the_largest_one(kind: str) -> None:
    terrain = tiles(kind, **KINDS[kind])
    highest = max(np.abs(tile_heights(terrain, 0, level)).max() for level in range(LEVELS))
    assert highest <= terrain.largest_height(0) + 1e-9
    assert highest >= 0.8 * terrain.largest_height(0)


@pytest.mark.parametrize(
    ("terrain", "place"),
    [
        ("{type: pit, height: 100 km}", "100 km"),
        ("{type: tiles, levels: 2, tiles: {up: {type: stairs, height: 2 .. 16 km}}}", "2 .. 16 km"),
        ("{type: tiles, levels: 2, tiles: {up: {type: gaps, width: 10 .. 20 cm, depth: 20 km}}}", "20 km"),
    ],
)
def test_ground_beyond_10_km_is_a_finding(terrain: str, place: str) -> None:
    overrides = [f"world.terrain={terrain}"]
    errors = check(
        load(Path(__file__).parents[2] / "scenarios" / "quadruped.yaml", overrides=overrides)
    ).findings.errors
    assert [(finding.code, finding.span.text) for finding in errors] == [("DB105", place)]
    assert "10 km" in (errors[0].help or "")
