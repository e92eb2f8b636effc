"""Terrain: the same surface for engine, placing and pictures; pictures, formulas and meshes as ground; what
is refused.

Terrain of tiles, against closed forms of each kind.

Walls and the arena as bodies with names: what expressions, sensors and cameras know of them.

Rotations as roll, pitch and yaw.

Painted lines: places beside and along them, their reflected light, and their use in a scenario.

`height(x, y)` in expressions: the surface that both engines collide with, alone and in a batch.
"""

from __future__ import annotations

import math
import struct
import zlib
from contextlib import closing, suppress
from dataclasses import replace
from math import pi
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepbots_cli import api, engines, frames, pictures
from deepbots_cli.compiler import check
from deepbots_cli.compiler.inventory import definition, names_at
from deepbots_cli.document.load import load
from deepbots_cli.engine_kinds import Diagonal, diagonal_of
from deepbots_cli.errors import EngineError
from deepbots_cli.expressions.scalar import Const, Name, Op
from deepbots_cli.frames import IDENTITY_ROTATION
from deepbots_cli.geometry import (
    RIM_RADIUS_PER_SIGMA,
    HeightGrid,
    ground_height,
    ground_heights,
    height_grid,
    picture_pixels,
    tile_heights,
    tile_terrain_heights,
)
from deepbots_cli.program.world import (
    TILE_MARGIN_M,
    Formula,
    Line,
    ObjectBody,
    Pit,
    Terrain,
    TerrainShape,
    Tile,
    Tiles,
    WorldModel,
)
from deepbots_cli.robots.model import Sphere
from deepbots_cli.runtime import Supervisor
from deepbots_cli.runtime.paths import Follower
from tests.worlds import Make, begun


def gray_png(rows: list[list[int]], depth: int = 1, filtering: int = 0) -> bytes:
    """A PNG whose rows are all filtered in one way."""
    packed = b""
    above = bytes(len(rows[0]) * depth)
    for row in rows:
        raw = b"".join(value.to_bytes(depth, "big") for value in row)
        left, corner = bytes(depth) + raw[:-depth], bytes(depth) + above[:-depth]
        near = {
            0: bytes(len(raw)),
            1: left,
            2: above,
            3: bytes((a + b) // 2 for a, b in zip(left, above, strict=True)),
            4: bytes(
                min((a, b, c), key=lambda n: abs(a + b - c - n))
                for a, b, c in zip(left, above, corner, strict=True)
            ),
        }[filtering]
        packed += bytes([filtering]) + bytes(
            (byte - guess) & 255 for byte, guess in zip(raw, near, strict=True)
        )
        above = raw
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in (
            (b"IHDR", struct.pack(">IIBBBBB", len(rows[0]), len(rows), 8 * depth, 0, 0, 0, 0)),
            (b"IDAT", zlib.compress(packed)),
            (b"IEND", b""),
        )
    )


def stl(triangles: list[list[tuple[float, float, float]]]) -> bytes:
    body = b"".join(
        struct.pack("<12fH", 0, 0, 1, *(number for corner in triangle for number in corner), 0)
        for triangle in triangles
    )
    return bytes(80) + struct.pack("<I", len(triangles)) + body


def world(relief: TerrainShape, **more: object) -> WorldModel:
    ball = ObjectBody("ball", Sphere(0.25), mass=5.0)
    return WorldModel(0.032, 8, ground=None, objects=(ball,), terrain=Terrain(relief), **more)


@pytest.mark.parametrize(
    ("radius", "expected"), [(0.5, 0.0569), (1.0, 0.2106), (1.5, 0.4168), (2.0, 0.6199), (2.7, 0.8115)]
)
def test_a_pit_has_the_profile_of_its_formula(radius: float, expected: float) -> None:
    at = ground_height(Terrain(Pit(0.85 * 4.0, 2.7 * RIM_RADIUS_PER_SIGMA)))
    for angle in (0.0, 1.0, 2.5):
        assert at(radius * math.cos(angle), radius * math.sin(angle)) == pytest.approx(expected, abs=2e-3)


def test_the_rim_of_a_pit_is_where_its_radius_says_and_a_quarter_of_its_height_high() -> None:
    for radius in (1.0, 3.0):
        at = ground_height(Terrain(Pit(2.0, radius)))
        assert at(radius, 0.0) == pytest.approx(0.5, rel=1e-3)
        assert at(0.9 * radius, 0.0) < at(radius, 0.0) > at(1.1 * radius, 0.0)
        assert at(0.0, 0.0) == pytest.approx(0.0, abs=1e-9)


def test_lumps_take_away_up_to_their_share_and_are_the_same_in_every_world() -> None:
    plain, rough = height_grid(Pit(3.2, 3.0)).heights, height_grid(Pit(3.2, 3.0, 0.15)).heights
    assert np.all(rough <= plain + 1e-12)
    assert np.all(rough >= 0.85 * plain - 1e-12)
    assert np.ptp(rough[plain > 0.1] / plain[plain > 0.1]) > 0.1
    assert np.array_equal(rough, height_grid(Pit(3.2, 3.0, 0.15)).heights)


def test_a_ball_comes_to_rest_on_the_bottom_of_a_pit_and_touches_the_ground_there() -> None:
    with closing(engines.create("pybullet", world(Pit(3.2, 2.0)))) as engine:
        engine.place("ball", (0.1, 0.0, 0.3), IDENTITY_ROTATION)
        touches = engine.contact(("ball", None), [("ground", None)])
        engine.set_parameter("lateral_friction", ("ground", ""), 0.5)
        for _ in range(100):
            engine.step(8)
        assert touches()
        assert engine.pose("ball")()[0] == pytest.approx((0.0, 0.0, 0.25), abs=0.11)


@given(st.data(), st.sampled_from([1, 2]), st.integers(0, 4), st.integers(2, 7), st.integers(2, 7))
def test_a_gray_picture_is_read_as_it_was_written(
    data, depth: int, filtering: int, width: int, tall: int
) -> None:
    rows = [[data.draw(st.integers(0, 256**depth - 1)) for _ in range(width)] for _ in range(tall)]
    written = gray_png(rows, depth, filtering)
    assert pictures.picture_problem(written) is None
    assert picture_pixels(written).tolist() == rows


@given(st.binary(max_size=60), st.integers(0, 90), st.binary(max_size=4))
def test_a_damaged_picture_is_refused_or_read_and_nothing_worse(tail: bytes, at: int, patch: bytes) -> None:
    whole = gray_png([[1, 2, 3], [4, 5, 6]])
    for damaged in (whole[:at] + patch + whole[at + len(patch) :], whole[:at] + tail):
        if pictures.picture_problem(damaged) is None:
            with suppress(EngineError):
                picture_pixels(damaged)


HOSTILE = {
    "not a PNG": b"GIF89a",
    "1000000 x 1000000 pixels": b"\x89PNG\r\n\x1a\n"
    + struct.pack(">I4sIIBBBBB", 13, b"IHDR", 10**6, 10**6, 8, 0, 0, 0, 0)
    + bytes(20),
    "not gray": b"\x89PNG\r\n\x1a\n"
    + struct.pack(">I4sIIBBBBB", 13, b"IHDR", 4, 4, 8, 2, 0, 0, 0)
    + bytes(20),
    "fewer or more pixels than it says": gray_png([[1, 2], [3, 4]])[:33] + gray_png([[1, 2]])[33:],
}


@pytest.mark.parametrize("words", HOSTILE)
def test_a_picture_that_cannot_be_heights_is_refused_by_its_header(words: str) -> None:
    assert words in str(pictures.picture_problem(HOSTILE[words]))


SCENARIO = """
deepbots: 1
name: Hills
world:
  timestep: 32 ms
  substeps: 8
  terrain: {{{terrain}}}
objects:
  ball: {{shape: sphere, radius: 0.1 m, mass: 1 kg, pose: {{x: 1 m, y: 0.5 m, z: 2 m}}}}
robots:
  cart:
    urdf: cartpole_rail
    base: fixed
    pose: {{z: 5 m}}
    actuators: {{motor: {{type: torque_motor, joint: slider}}}}
    apply: {{motor: push * 1 N}}
action: {{push: -1 .. 1}}
augment: {{place: position(ball)}}
observation: {{place: -10 .. 10 m}}
reward: {{r: push}}
truncation: {{max_steps: 100}}
"""


def compiled(folder: Path, terrain: str) -> api.Compiled:
    (folder / "hills.yaml").write_text(SCENARIO.format(terrain=terrain), encoding="utf-8")
    return api.compile(folder / "hills.yaml")


def height_after_rolling(scenario: api.Compiled) -> float:
    """Where a ball that rolls for 3 s gets to, above the ground there."""
    at = ground_height(scenario.program.world.terrain)
    with closing(api.make(scenario)) as environment:
        environment.reset(seed=0)
        for _ in range(99):
            environment.step([0.0])
        x, y, z = environment.engine.pose("ball")()[0]
    return z - at(x, y)


def test_hills_may_be_written_as_a_formula_of_place(tmp_path: Path) -> None:
    scenario = compiled(
        tmp_path, "type: formula, heights: 0.2 m * sin(x / m * 90 deg) + 0.1 * y, size: 40 40 m"
    )
    at = ground_height(scenario.program.world.terrain)
    assert (at(1.0, 2.0), at(-1.0, 0.0)) == (pytest.approx(0.4, abs=1e-3), pytest.approx(-0.2, abs=1e-3))
    assert height_after_rolling(scenario) == pytest.approx(0.1, abs=0.02)


def test_hills_may_come_from_a_picture_whose_first_row_is_farthest_to_the_left(tmp_path: Path) -> None:
    (tmp_path / "hills.png").write_bytes(gray_png([[255] * 5, *[[0] * 5] * 4]))
    scenario = compiled(tmp_path, "type: heightfield, file: hills.png, size: 8 8 m, height: 2 m")
    at = ground_height(scenario.program.world.terrain)
    assert (at(0.0, 4.0), at(0.0, 3.0), at(0.0, -1.0)) == (2.0, 1.0, 0.0)
    assert height_after_rolling(scenario) == pytest.approx(0.1, abs=0.02)
    assert "hills.png" in scenario.inputs
    assert "file: inputs/hills.png" in scenario.resolved


def test_a_picture_that_changed_after_compiling_is_refused(tmp_path: Path) -> None:
    (tmp_path / "hills.png").write_bytes(gray_png([[255] * 5] * 5))
    scenario = compiled(tmp_path, "type: heightfield, file: hills.png, size: 8 8 m, height: 2 m")
    (tmp_path / "hills.png").write_bytes(gray_png([[0] * 5] * 5))
    with pytest.raises(EngineError, match="has changed"):
        api.make(scenario)


def test_the_ground_may_be_a_mesh(tmp_path: Path) -> None:
    corners = [(-10.0, -10.0, 0.0), (10.0, -10.0, 0.0), (10.0, 10.0, 2.0), (-10.0, 10.0, 2.0)]
    (tmp_path / "ramp.stl").write_bytes(
        stl([[corners[0], corners[1], corners[2]], [corners[0], corners[2], corners[3]]])
    )
    text = "\n".join([*(f"v {x} {y} {z}" for x, y, z in corners), "f 1 2 3 4"])
    (tmp_path / "ramp.obj").write_text(text, encoding="utf-8")
    for file in ("ramp.stl", "ramp.obj"):
        scenario = compiled(tmp_path, f"type: mesh, file: {file}, scale: 1 1 0.5")
        at = ground_height(scenario.program.world.terrain)
        assert (at(3.0, 0.0), at(3.0, -5.0), at(30.0, 0.0)) == (
            pytest.approx(0.5),
            pytest.approx(0.25),
            pytest.approx(0.5),
        )
        assert height_after_rolling(scenario) == pytest.approx(0.1, abs=0.02)


REFUSED = {
    "type: formula, heights: 1 m / 0, size: 4 4 m": "DB105",
    "type: formula, heights: sqrt(x / m) * 1 m, size: 4 4 m": "DB105",
    "type: formula, heights: 0.1 * z, size: 4 4 m": "DB402",
    "type: formula, heights: 0.1 rad, size: 4 4 m": "DB503",
    "type: formula, heights: 1e6 m, size: 4 4 m": "DB105",
    "type: heightfield, file: none.png, size: 4 4 m, height: 1 m": "DB204",
    "type: heightfield, file: hills.yaml, size: 4 4 m, height: 1 m": "DB103",
    "type: mesh, file: lies.stl": "DB301",
    "type: mesh, file: crate.dae": "DB104",
    "type: pit, height: -1 m": "DB105",
    "type: pit, height: 1 m, noise: uniform(0 .. 1)": "DB407",
}


@pytest.mark.parametrize("terrain", REFUSED)
def test_ground_that_cannot_be_is_a_finding_before_an_engine_sees_it(tmp_path: Path, terrain: str) -> None:
    (tmp_path / "lies.stl").write_bytes(bytes(80) + struct.pack("<I", 10**9) + bytes(900))
    (tmp_path / "hills.yaml").write_text(SCENARIO.format(terrain=terrain), encoding="utf-8")
    errors = [finding for finding in api.lint(tmp_path / "hills.yaml") if finding.severity == "error"]
    assert [finding.code for finding in errors] == [REFUSED[terrain]]


def test_a_compiled_scenario_with_another_formula_than_of_place_has_no_heights() -> None:
    with pytest.raises(EngineError, match="cannot be computed"):
        height_grid(Formula(Name("secret"), (1.0, 1.0)))
    with pytest.raises(EngineError, match="the height is undefined"):
        height_grid(Formula(Op("div", (Const(1.0), Const(0.0))), (1.0, 1.0)))


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


@given(
    st.sampled_from(sorted(KINDS)),
    st.integers(0, LEVELS - 1),
    st.integers(0, 99),
    st.sampled_from([4.0, 6.0, SIDE, 10.2]),
    st.floats(0.2, 3.6),
)
@settings(max_examples=100, deadline=None, derandomize=True)
def test_a_robot_finds_a_level_platform_in_the_middle_of_each_tile(
    kind: str, level: int, seed: int, side: float, platform: float
) -> None:
    terrain = replace(tiles(kind, seed, **KINDS[kind]), side=side, platform=platform)
    whole = tile_heights(terrain, 0, level)
    count = round(side / CELL) + 1
    assert whole.shape == (count, count)
    assert not np.any([whole[0], whole[-1], whole[:, 0], whole[:, -1]])
    in_platform = np.abs(np.linspace(-side / 2, side / 2, count)) < platform / 2
    assert not in_platform.any() or np.ptp(whole[np.ix_(in_platform, in_platform)]) == 0.0


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
        rising = np.diff(along_x(terrain, level))[: round((SIDE - PLATFORM) / 2 / CELL)]
        assert rising == pytest.approx(math.tan(angle) * CELL, abs=1e-12)


def test_waves_go_up_to_their_height_with_their_length() -> None:
    whole = tile_heights(tiles("waves", **KINDS["waves"]), 0, LEVELS - 1)
    x = np.linspace(-SIDE / 2, SIDE / 2, len(whole))
    outward = np.maximum(np.abs(x[:, None]), np.abs(x[None, :]))
    between = (outward <= SIDE / 2 - TILE_MARGIN_M) & (outward >= PLATFORM / 2 + TILE_MARGIN_M)
    wave = 0.1 * (np.cos(math.pi * x[:, None]) + np.cos(math.pi * x[None, :]) + 2.0) / 4.0
    assert whole[between] == pytest.approx(wave[between])
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
    assert (whole.shape, terrain.size) == ((5 * 80 + 41, 7 * 80 + 41), (60.0, 44.0))
    assert np.array_equal(whole[20 + 160 : 20 + 241, 20 + 80 : 20 + 161], tile_heights(terrain, 1, 2))


TILED = """\
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
    (tmp_path / "climb.yaml").write_text(TILED)
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


# The puck is 4 cm high and 2 cm in radius; the faces of `bay` are at x = 0.39 and 0.41 m, those of the arena
# at 1 m.
YARD = """
deepbots: 1
name: Yard
summary: A puck between walls.
world:
  timestep: 32 ms
  arena: {size: 2 2 m}
  walls:
    bay:  {points: [0.4 -0.3 m, 0.4 0.3 m], thickness: 2 cm, height: 20 cm}
    nook: {points: [-0.4 -0.3 m, -0.4 0.3 m, -0.1 0.3 m], thickness: 2 cm}
objects:
  puck: {shape: cylinder, radius: 2 cm, height: 4 cm, mass: 0.1 kg, friction: 0}
robots:
  stand:
    urdf: cartpole_rail
    base: fixed
    pose: {x: 5 m}
action: {idle: -1 .. 1}
augment:
  to_bay:   clearance(puck, bay)
  to_nook:  clearance(nook, puck)
  to_arena: clearance(puck, arena)
  middle:   position(bay)
  touched:  contact(puck, bay)
  bumped:   collided(bay)
  fenced:   contact(arena, puck)
observation: {to_bay: 0 .. 2 m, to_nook: 0 .. 2 m, to_arena: 0 .. 2 m, middle: -1 .. 1 m, touched: auto, bumped: auto, fenced: auto}
reward: {idle: idle}
truncation: {max_steps: 50}
reset: {place: {puck: {x: 0.2 m, y: 0.25 m}}}
"""


def observed_values(environment: Supervisor) -> dict[str, float]:
    """The values of the observation, in m and as truth values."""
    entries = environment.scenario.agent.numbers
    observation = environment.get_observations()
    return {
        f"{entry.name}{f'.{entry.component}' if entry.component else ''}": entry.low
        + (value + 1) / 2 * (entry.high - entry.low)
        for entry, value in zip(entries, observation.tolist(), strict=True)
    }


def test_a_wall_and_the_arena_can_be_named_in_gap_and_the_least_distance_counts(
    make: Make,
) -> None:
    environment = begun(make(YARD))
    values = observed_values(environment)
    assert values["to_bay"] == pytest.approx(0.39 - 0.22, abs=2e-3)
    assert values["to_nook"] == pytest.approx(
        math.hypot(0.29, 0.04) - 0.02, abs=2e-3
    )  # to the corner of the nearer of its two pieces
    assert values["to_arena"] == pytest.approx(1 - 0.27, abs=2e-3)  # the left wall
    assert [values[f"middle.{axis}"] for axis in "xyz"] == pytest.approx([0.4, 0.0, 0.1], abs=1e-6)


@pytest.mark.parametrize(
    ("velocity", "wall"), [("2 0 0 m/s", "touched"), ("0 4 0 m/s", "fenced")], ids=["a wall", "the arena"]
)
def test_contact_and_collided_tell_walls_and_the_arena_apart(make: Make, velocity: str, wall: str) -> None:
    environment = begun(make(YARD, f"reset.place.puck.velocity={velocity}"))
    felt = set()
    for _ in range(15):
        environment.step([0.0])
        values = observed_values(environment)
        assert values["touched"] == values["bumped"]
        felt |= {name for name in ("touched", "fenced") if values[name] > 0.5}
    assert felt == {wall}


def test_a_touch_sensor_feels_a_wall_that_is_named(tmp_path: Path) -> None:
    file = tmp_path / "yard.yaml"
    sensors = "    sensors: {bump: {type: touch, link: pole, against: [nook, arena]}}\n    emit: [bump]\n"
    file.write_text(
        YARD.replace("    pose: {x: 5 m}\n", f"    pose: {{x: 5 m}}\n{sensors}"), encoding="utf-8"
    )
    (sensor,) = api.compile(file).program.robots[0].sensors
    assert sensor.against == ("nook 1", "nook 2", "front wall", "back wall", "left wall", "right wall")


def test_editors_offer_walls_and_the_arena_and_lead_to_where_they_stand(tmp_path: Path) -> None:
    file = tmp_path / "yard.yaml"
    file.write_text(YARD, encoding="utf-8")
    checked = api.load(file)
    felt = [
        entry.name
        for entry in names_at(checked, "bodies or links", ("robots", "stand", "sensors", "bump", "against"))
    ]
    assert {"bay", "nook", "arena"} <= set(felt)
    assert not {"bay", "arena"} & {entry.name for entry in names_at(checked, "body", ("reset", "place"))}
    for name in ("bay", "arena"):
        target = definition(checked, name)
        assert target is not None
        assert target.span is not None
        assert target.span.text == name


ANGLES = (-2.9, -0.4, 0.0, 1.3, 3.0)


@pytest.mark.parametrize("pitch", [-pi / 2, pi / 2])
@pytest.mark.parametrize("noise", [0.0, 1e-12, -1e-12])
def test_a_vertical_pitch_keeps_the_rotation(pitch: float, noise: float) -> None:
    """Only the difference of roll and yaw counts there, and the roll is 0."""
    for roll in ANGLES:
        for yaw in ANGLES:
            turned = frames.quaternion(roll, pitch + noise, yaw)
            angles = frames.roll_pitch_yaw(turned)
            assert angles[:2] == (0.0, pitch)
            again = frames.quaternion(*angles)
            assert abs(sum(map(float.__mul__, turned, again))) == pytest.approx(1.0, abs=1e-9)


def test_other_angles_come_back() -> None:
    for roll in ANGLES:
        for pitch in (-1.57, -0.3, 0.0, 1.2, 1.57):
            for yaw in ANGLES:
                angles = frames.roll_pitch_yaw(frames.quaternion(roll, pitch, yaw))
                assert angles == pytest.approx((roll, pitch, yaw), abs=1e-9)


# Painted lines: places beside and along them, their reflected light, and their use in a scenario


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


@pytest.mark.parametrize(("closed", "mirror"), [(True, 1.0), (True, -1.0), (False, 1.0)])
def test_outside_of_a_sharp_corner_the_side_stays(closed: bool, mirror: float) -> None:
    """On an arc around a corner of a triangle, which turns by 120 deg; mirrored, the other side is left."""
    corners = tuple((math.cos(a), mirror * math.sin(a)) for a in (0.0, 2 * math.pi / 3, 4 * math.pi / 3))
    follow = Follower(Line("triangle", (*corners[2:], *corners[:2]), closed=closed, width=0.02))
    for degree in range(-59, 60):
        angle = math.radians(degree)
        beside, _ = follow((1.0 + 0.3 * math.cos(angle), 0.3 * math.sin(angle)))
        assert beside == pytest.approx(-0.3 * mirror)


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


@pytest.mark.parametrize("diagonal", ["falling", "rising"])
@pytest.mark.parametrize("shape", SHAPES)
def test_columns_have_the_heights_of_single_points_to_the_bit(
    shape: TerrainShape, diagonal: Diagonal
) -> None:
    x, y = np.random.default_rng(1).uniform(-6.0, 6.0, (2, 3000))  # beyond the terrain, too
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
