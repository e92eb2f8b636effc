"""Terrain: the same surface for engine, placing and pictures; pictures, formulas and meshes as ground; what
is refused."""

import math
import random
import struct
import zlib
from contextlib import closing, suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepbots_cli import api, engines, pictures
from deepbots_cli.errors import EngineError
from deepbots_cli.expressions.scalar import Const, Name, Op
from deepbots_cli.frames import IDENTITY_ROTATION, from_axis_angle
from deepbots_cli.geometry import RIM_RADIUS_PER_SIGMA, ground_height, height_grid, picture_pixels
from deepbots_cli.program.world import Formula, ObjectBody, Pit, Terrain, TerrainShape, WorldModel
from deepbots_cli.robots.model import Sphere

PIT = Pit(3.2, 2.7 * RIM_RADIUS_PER_SIGMA, 0.15)
SLOPE = Formula(Op("mul", (Const(0.2), Name("x"))), (10.0, 6.0))


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


@pytest.mark.parametrize("relief", [PIT, SLOPE], ids=["pit", "slope"])
def test_the_engine_has_the_ground_where_placing_thinks_it_is(relief: TerrainShape) -> None:
    at = ground_height(Terrain(relief))
    rng = random.Random(0)
    with closing(engines.create("pybullet", world(relief))) as engine:
        down = [((0.0, 0.0, 0.0), from_axis_angle((0.0, 1.0, 0.0), math.pi / 2))]
        read = engine.rays(("ball", None), down, 10.0)
        for _ in range(50):
            x, y = rng.uniform(-2.9, 2.9), rng.uniform(-2.9, 2.9)
            engine.reset()
            engine.place("ball", (x, y, 5.0), IDENTITY_ROTATION)
            assert 5.0 - read()[0] == pytest.approx(at(x, y), abs=1e-5)


def test_a_ball_comes_to_rest_on_the_bottom_of_a_pit_and_touches_the_ground_there() -> None:
    with closing(engines.create("pybullet", world(Pit(3.2, 2.0)))) as engine:
        engine.place("ball", (0.1, 0.0, 0.3), IDENTITY_ROTATION)
        touches = engine.contact(("ball", None), [("ground", None)])
        engine.set_parameter("lateral_friction", ("ground", ""), 0.5)
        for _ in range(100):
            engine.step(8)
        assert touches()
        assert engine.pose("ball")()[0] == pytest.approx((0.0, 0.0, 0.25), abs=0.11)


def test_an_episode_on_terrain_after_a_reset_is_that_of_a_fresh_world() -> None:
    def roll(engine) -> list[object]:
        engine.place("ball", (1.0, 0.5, 1.2), IDENTITY_ROTATION)
        read = engine.pose("ball")
        places = []
        for _ in range(60):
            engine.step(8)
            places.append(read())
        return places

    with (
        closing(engines.create("pybullet", world(PIT))) as first,
        closing(engines.create("pybullet", world(PIT))) as second,
    ):
        fresh = roll(first)
        for steps in (1, 17, 100):
            second.place("ball", (-1.0, 0.2, 1.0), IDENTITY_ROTATION)
            for _ in range(steps):
                second.step(8)
            second.reset()
            assert roll(second) == fresh
            second.reset()


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
    assert at(1.0, 2.0) == pytest.approx(0.4, abs=1e-3)
    assert at(-1.0, 0.0) == pytest.approx(-0.2, abs=1e-3)
    assert height_after_rolling(scenario) == pytest.approx(0.1, abs=0.02)


def test_hills_may_come_from_a_picture_whose_first_row_is_farthest_to_the_left(tmp_path: Path) -> None:
    (tmp_path / "hills.png").write_bytes(gray_png([[255] * 5, *[[0] * 5] * 4]))
    scenario = compiled(tmp_path, "type: heightfield, file: hills.png, size: 8 8 m, height: 2 m")
    at = ground_height(scenario.program.world.terrain)
    assert at(0.0, 4.0) == 2.0
    assert at(0.0, 3.0) == 1.0
    assert at(0.0, -1.0) == 0.0
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
        assert at(3.0, 0.0) == pytest.approx(0.5)
        assert at(3.0, -5.0) == pytest.approx(0.25)
        assert at(30.0, 0.0) == pytest.approx(0.5)
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
