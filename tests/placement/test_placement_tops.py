"""Bodies that stand on the top of an object: `on: table`."""

from __future__ import annotations

import math

import pytest

from deepbots_cli.runtime import Supervisor
from deepbots_cli.runtime.overview import extent
from tests.worlds import Make

HALF = (0.3, 0.2)
TABLE = """
deepbots: 1
name: Table
summary: Blocks on a raised table.
world: {timestep: 32 ms, substeps: 8, arena: {size: 4 4 m}}
objects:
  block: {shape: box, size: 4 4 4 cm, mass: 0.1 kg}
  mug:   {shape: cylinder, radius: 3 cm, height: 10 cm, mass: 0.2 kg}
  coin:  {count: 3, shape: cylinder, radius: 1 cm, height: 1 cm, mass: 10 g}
  table: {shape: box, size: 60 40 40 cm, fixed: true}
  crate: {shape: box, size: 10 10 10 cm, mass: 0.3 kg}
robots:
  cart: {urdf: cartpole, pose: {x: -1.5 m}}
action: {idle: -1 .. 1}
augment: {height: position(block).z}
observation: {height: 0 .. 1 m}
reward: {idle: idle}
truncation: {max_steps: 50}
reset:
  place:
    block: {on: table, clearance: 2 cm, yaw: any}
    mug:   {on: table, region: {x: 0.5 .. 3 m, y: -3 .. 3 m}, clearance: 1 cm}
    coin:  {on: crate}
    table: {x: 0.5 m, y: -0.2 m, yaw: 30 deg}
    crate: {on: table, yaw: any}
"""


def on_the_table(environment: Supervisor, body: str) -> tuple[float, float, float]:
    """Where a body is in the axes of the table's top, m."""
    (tx, ty, tz), (_, _, qz, qw) = environment.engine.pose("table")()
    (x, y, z), _ = environment.engine.pose(body)()
    yaw = 2 * math.atan2(qz, qw)
    dx, dy = x - tx, y - ty
    return math.cos(yaw) * dx + math.sin(yaw) * dy, math.cos(yaw) * dy - math.sin(yaw) * dx, z - tz - 0.2


def test_a_block_on_a_raised_table_finds_a_place_and_rests_there(make: Make) -> None:
    environment = make(TABLE)
    environment.reset(seed=0)
    for _ in range(20):
        environment.reset()
        x, y, z = on_the_table(environment, "block")
        assert z == pytest.approx(0.02, abs=1e-9)
        assert abs(x) <= HALF[0] - 0.02 - 0.02 + 1e-6
        assert abs(y) <= HALF[1] - 0.02 - 0.02 + 1e-6
    begun = environment.engine.pose("block")()[0]
    for _ in range(30):
        environment.step([0.0])
    assert environment.engine.pose("block")()[0] == pytest.approx(begun, abs=2e-3)


def test_every_part_of_the_top_is_found(make: Make) -> None:
    environment = make(TABLE)
    environment.reset(seed=1)
    quarters = set()
    for _ in range(40):
        environment.reset()
        x, y, _ = on_the_table(environment, "block")
        quarters.add((x > 0.1, x < -0.1, y > 0))
    assert len(quarters) == 6


def test_a_region_is_cut_to_the_top(make: Make) -> None:
    environment = make(TABLE)
    environment.reset(seed=2)
    for _ in range(20):
        environment.reset()
        x, y, z = on_the_table(environment, "mug")
        assert environment.engine.pose("mug")()[0][0] >= 0.5
        assert abs(x) <= HALF[0] - 0.04 + 1e-6
        assert abs(y) <= HALF[1] - 0.04 + 1e-6
        assert z == pytest.approx(0.05, abs=1e-9)


def test_a_table_that_is_drawn_is_placed_first_and_takes_what_stands_on_it_along(
    make: Make,
) -> None:
    environment = make(
        TABLE,
        "reset.place.table={region: {x: -1 .. 1 m, y: -1 .. 1 m}, yaw: any}",
        "reset.place.mug={on: table}",
    )
    environment.reset(seed=3)
    where = set()
    for _ in range(10):
        environment.reset()
        where.add(round(environment.engine.pose("table")()[0][0], 1))
        for body in ("block", "mug", "crate"):
            x, y, z = on_the_table(environment, body)
            assert z > 0.0
            assert abs(x) <= HALF[0]
            assert abs(y) <= HALF[1]
    assert len(where) > 4


def test_bodies_stack_on_what_stands_on_a_table(make: Make) -> None:
    environment = make(TABLE)
    environment.reset(seed=4)
    (x, y, z), _ = environment.engine.pose("crate")()
    for copy in ("coin#1", "coin#2", "coin#3"):
        (cx, cy, cz), _ = environment.engine.pose(copy)()
        assert cz == pytest.approx(z + 0.05 + 0.005, abs=1e-9)
        assert math.hypot(cx - x, cy - y) < 0.05 * math.sqrt(2)


def test_a_height_counts_from_the_top(make: Make) -> None:
    environment = make(TABLE, "reset.place.block={on: table, z: 0.3 m}")
    environment.reset(seed=5)
    assert on_the_table(environment, "block")[2] == pytest.approx(0.3, abs=1e-9)


def test_a_body_on_a_table_keeps_clear_of_what_rises_beside_it_and_not_of_what_lies_below(
    make: Make,
) -> None:
    """The crate stands on the ground beside the table, where a body as high as the table would be in nobody's
    way."""
    environment = make(
        TABLE, "reset.place.crate={x: 0.5 m, y: -0.2 m, z: 0.05 m}", "reset.place.coin={on: table}"
    )
    environment.reset(seed=6)
    spots = []
    for _ in range(40):
        environment.reset()
        spots.append(on_the_table(environment, "block")[:2])
        mug = on_the_table(environment, "mug")[:2]
        assert math.dist(spots[-1], mug) >= 0.02 + 0.02 + 0.03 - 1e-6  # half the block, clearance, the mug
    assert min(math.hypot(*spot) for spot in spots) < 0.08


def test_the_same_seed_gives_the_same_places_on_a_top(make: Make) -> None:
    environment = make(TABLE)
    environment.reset(seed=7)
    first = [environment.engine.pose(body)() for body in ("block", "mug", "crate", "coin#2")]
    environment.reset(seed=8)
    environment.reset(seed=7)
    assert [environment.engine.pose(body)() for body in ("block", "mug", "crate", "coin#2")] == first


def test_a_picture_contains_the_bodies_on_a_table(make: Make) -> None:
    """The scene reaches up to the top of the mug."""
    scene = extent(make(TABLE, "objects.mug.height=2 m").scenario)
    assert max(high[2] for _, high in scene) == pytest.approx(0.4 + 2.0, abs=0.01)
