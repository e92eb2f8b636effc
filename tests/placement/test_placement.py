"""Facts about surfaces for the supervisor: gaps, contacts, collisions.

Groups and layouts: copies come and go, and stand where the layout of the episode puts them.

Bodies that search for a place: uniform over the free area, clear of the rest, the same for the same
seed.

Bodies that stand on the top of an object: `on: table`.

Ways around obstacles: their lengths against closed forms, and what happens where there is none.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
import yaml
from scipy.spatial.transform import Rotation
from shapely import MultiPoint

from deepbots_cli.errors import EvaluationError
from deepbots_cli.footprint import Footprint, Patch, patch_distance
from deepbots_cli.frames import Triple, quaternion
from deepbots_cli.runtime import Supervisor
from deepbots_cli.runtime.overview import extent
from deepbots_cli.runtime.paths import DistanceField
from tests.worlds import SCENARIOS, Make, begun

WORLD = """\
deepbots: 1
name: Facts
world: {timestep: 20 ms, substeps: 4, arena: {size: 2 2 m, wall_height: 0.1 m}}
objects:
  ball: {shape: sphere, radius: 7 cm, mass: 0.1 kg}
  block: {shape: box, size: 10 20 30 cm, fixed: true}
robots:
  cart:
    urdf: epuck
    groups: {feet: [caster_*]}
    actuators: {wheels: {type: velocity_motor, joints: [left_wheel, right_wheel], max_torque: 0.05 N*m}}
    apply: {wheels: gas * 6 rad/s}
action: {gas: -1 .. 1}
augment:
  apart: clearance(cart, ball)
  between: clearance(block, ball)
observation: {apart: 0 .. 2 m, between: 0 .. 2 m}
reward:
  touches: 1 when contact(cart, block)
  wheels: 1 when contact(cart, ground) and not any(contact(cart.feet, block))
  bumped: 1 when collided(cart)
  landed: 1 when contact(ball, ground)
truncation: {max_steps: 100}
reset: {place: {cart: {x: -0.3 m, y: 0 m}, ball: {x: 0.5 m, y: 0.6 m, z: 0.2 m}, block: {x: 0 m, y: 0 m}}}
"""


def starts(environment: Supervisor, seed: int, count: int) -> Iterator[Supervisor]:
    """The world at the starts of some episodes that follow one with a seed."""
    environment.reset(seed=seed)
    for _ in range(count):
        environment.reset()
        yield environment


def test_contact_terms_name_what_touches_what(make: Make) -> None:
    environment = begun(make(WORLD))
    steps = []
    for _ in range(100):
        terms = environment.step(np.array([1.0]))[4]["reward_terms"]
        steps.append(terms)
        assert terms["bumped"] == terms["touches"], "the block is all that the cart can bump into"
    landed = next(index for index, terms in enumerate(steps) if terms["landed"])
    assert (landed, steps[0]["wheels"]) == (
        pytest.approx((2 * (0.2 - 0.07) / 9.81) ** 0.5 / 0.02, abs=1.5),
        1.0,
    )
    assert not steps[0]["touches"]
    reached = next(index for index, terms in enumerate(steps) if terms["touches"])
    assert reached == pytest.approx((0.3 - 0.05 - 0.037) / (6 * 0.02) / 0.02, rel=0.15)


GROUPED = Path(__file__).with_name("grouped.yaml")
NAMES = ("turned", "crates", "things", "nearest", "room", "some", "every")


def in_units(observation: Any) -> dict[str, float]:
    """The observation in the units of the scenario."""
    scale = {"crates": 5.0, "things": 5.0, "nearest": 5.0, "room": 5.0}
    return {
        name: (value + 1.0) * scale[name] if name in scale else value
        for name, value in zip(NAMES, observation.tolist(), strict=True)
    }


def place(environment: Supervisor, body: str) -> tuple[float, float, float]:
    return environment.engine.pose(body)()[0]


def test_reductions_go_over_the_copies_that_are_there(make: Make) -> None:
    counts = Counter()
    for environment in starts(make(GROUPED, "reset.layout=scattered"), 0, 60):
        there = in_units(environment.get_observations())
        number = round(there["crates"])
        cart = place(environment, "cart")
        away = [math.dist(cart, place(environment, f"crate#{index + 1}")) for index in range(number)]
        assert there["nearest"] == pytest.approx(min(away, default=9.0), abs=1e-5)
        assert there["some"] == bool(number)
        assert (there["every"], round(there["things"])) == (not number, 2)
        counts[number] += 1
    assert set(counts) == {0, 1, 2, 3, 4}


def test_absent_copies_touch_nothing_and_are_not_a_gap(make: Make) -> None:
    environment = make(GROUPED, "reset.layout=row", "parameters.crates=2")
    observation, _ = environment.reset(seed=0)
    assert in_units(observation)["things"] == pytest.approx(0.0, abs=1e-6)
    assert environment.engine.clearance(("cart", None), ("thing#1", None))() == math.inf
    assert [place(environment, f"crate#{number}")[:2] for number in (1, 2)] == [
        pytest.approx((0.1, -0.5)),
        pytest.approx((0.3, -0.5)),
    ]


@pytest.mark.slow
def test_layouts_are_drawn_in_their_shares(make: Make) -> None:
    environment = begun(make(GROUPED), seed=1)
    drawn: Counter[str] = Counter()
    draw = environment.bodies.layout

    def counted(*arguments: Any) -> str:
        drawn[name := draw(*arguments)] += 1
        return name

    environment.bodies.layout = counted
    for _ in range(2000):
        environment._begin()
    total = drawn.total()
    for name, share in {"scattered": 0.5, "row": 0.2, "drawn": 0.3}.items():
        assert abs(drawn[name] - share * total) < 4 * math.sqrt(share * (1 - share) * total)


def test_a_map_puts_each_letter_on_its_cell_and_draws_which_where_there_are_more(
    make: Make,
) -> None:
    cells = {(-0.8, 0.8), (0.4, 0.0), (0.8, 0.0), (0.4, -0.4), (0.4, -0.8)}
    used = set()
    for environment in starts(make(GROUPED, "reset.layout=drawn", "parameters.crates=2"), 0, 40):
        assert place(environment, "cart") == pytest.approx((-0.4, -0.8, 0.0), abs=1e-9)
        assert place(environment, "flag") == pytest.approx((0.0, 0.8, 0.1), abs=1e-9)
        crates = [
            tuple(round(at, 6) for at in place(environment, f"crate#{number}")[:2]) for number in (1, 2)
        ]
        assert crates[0] != crates[1]
        used.update(crates)
        walls = {
            tuple(round(at, 6) + 0.0 for at in place(environment, f"drawn wall#{number}")[:2])
            for number in (1, 2, 3)
        }
        assert walls == {(-0.8, 0.4), (-0.8, 0.0), (-0.4, 0.0)}
    assert used == cells


def test_walls_of_a_map_are_there_only_in_its_layout(make: Make) -> None:
    environment = make(GROUPED)
    gap = environment.engine.clearance(("cart", None), ("drawn wall#1", None))
    finite = []
    for _ in starts(environment, 0, 30):
        finite.append((math.isfinite(gap()), environment.bodies.present["drawn wall"]))
    assert set(finite) == {(True, 3), (False, 0)}


def test_every_copy_draws_its_own_mass_and_kind(make: Make) -> None:
    environment = make(GROUPED, "reset.layout=scattered", "parameters.crates=4")
    masses: list[tuple[float, ...]] = []
    set_parameter = environment.engine.set_parameter
    drawn_masses: list[float] = []
    environment.engine.set_parameter = lambda parameter, owner, mass: (
        drawn_masses.append(mass),
        set_parameter(parameter, owner, mass),
    )
    kinds: Counter[str] = Counter()
    environment.reset(seed=0)
    for _ in range(50):
        drawn_masses.clear()
        environment.reset()
        masses.append(tuple(drawn_masses[-4:]))
        kinds.update(variant.name for variant in environment.bodies.forms.chosen.values())
    figures = np.array(masses)
    assert len({*figures.ravel().tolist()}) == figures.size
    assert np.abs(np.corrcoef(figures.T) - np.eye(4)).max() < 0.5
    assert 0.1 <= figures.min() < figures.max() <= 0.4
    assert 30 < kinds["ball"] < 70


PLACED = SCENARIOS / "placed.yaml"
RADIUS = {"ball": 0.07, "mark": 0.05}
HALF = (0.75, 0.6)


def poses_of(environment: Supervisor, *bodies: str) -> list[tuple[Triple, float]]:
    """Position and yaw of each body, as the engine has them."""
    poses = []
    for body in bodies:
        position, (x, y, z, w) = environment.engine.pose(body)()
        poses.append((position, math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))))
    return poses


def patches(environment: Supervisor) -> dict[str, Patch]:
    laid = {}
    for name in ("ball", "plank", "hunter", "prey", "mark"):
        ((x, y, _), yaw) = poses_of(environment, name)[0]
        radius = RADIUS.get(name, 0.037)
        laid[name] = (
            Footprint((0, 0), math.hypot(0.05, 0.25), (0.05, 0.25))
            if name == "plank"
            else Footprint((0, 0), radius)
        ).at(x, y, yaw)
    return laid


def test_bodies_keep_their_clearance_from_each_other_and_those_that_move_from_walls(
    make: Make,
) -> None:
    clearances = {"ball": 0.04, "plank": 0.0, "hunter": 0.05, "prey": 0.05, "mark": 0.0}
    for environment in starts(make(PLACED), 3, 40):
        laid = patches(environment)
        for name, patch in laid.items():
            for other_name, clearance in clearances.items():
                if name < other_name:
                    assert (
                        patch_distance(patch, laid[other_name]) >= max(clearance, clearances[name]) - 1e-6
                    ), (
                        name,
                        other_name,
                    )
            for at, reach, half in zip((patch.x, patch.y), patch.half_extents, HALF, strict=True):
                assert (
                    abs(at) + reach + (clearances[name] if name in ("hunter", "prey") else 0.0) <= half + 1e-6
                ), name


@pytest.mark.parametrize("seed", range(8))
def test_boxes_and_meshes_do_not_overlap_wherever_the_origin_of_a_mesh_is(
    make: Make, tmp_path: Path, seed: int
) -> None:
    """The second implementation is shapely: the hulls of the vertices, seen from above."""
    generator, solids = np.random.default_rng(seed), {}
    world: dict[str, Any] = {"reset": {"attempts": 200, "place": {}}, "objects": {}}
    for name in ("first", "second", "third", "fourth"):
        sides = generator.uniform(0.1, 0.3, 3).round(6)
        solids[name] = trimesh.creation.box(sides)
        world["objects"][name] = {"shape": "box", "size": "{} {} {} m".format(*sides), "fixed": True}
        if name in ("first", "second"):
            points = generator.uniform(-0.15, 0.15, (9, 3)) + generator.uniform(-0.3, 0.3, 3)
            points[:, 2] -= points[:, 2].min() * (name == "first")  # its origin is at its base
            solids[name] = trimesh.convex.convex_hull(points)
            solids[name].export(tmp_path / f"{name}.stl")
            world["objects"][name] = {"shape": "mesh", "file": f"{name}.stl", "fixed": True}
        tilt = {} if name == "first" else {"roll": "uniform(-3 .. 3 rad)", "pitch": "uniform(-1 .. 1 rad)"}
        region = {"x": "-0.6 .. 0.6 m", "y": "-0.6 .. 0.6 m"}
        world["reset"]["place"][name] = {"region": region, "yaw": "any", **tilt}
    rest = yaml.safe_load(WORLD) | {"augment": {}, "observation": {"time": "0 .. 1 s"}, "reward": {"a": 1}}
    environment = make(yaml.safe_dump(rest | world))
    for episode in range(10):
        environment.reset(seed=episode)
        outlines = []
        for name, solid in solids.items():
            position, turn = environment.engine.pose(name)()
            vertices = Rotation.from_quat(turn).apply(solid.vertices) + position
            assert vertices[:, 2].min() == pytest.approx(0.0, abs=1e-6)
            outlines.append(MultiPoint(vertices[:, :2]).convex_hull)
        assert all(a.intersection(b).area < 1e-9 for a, b in combinations(outlines, 2))


def test_objects_without_a_height_rest_on_the_ground_and_robots_stand_on_it(
    make: Make,
) -> None:
    environment = begun(make(PLACED))
    heights = [position[2] for position, _ in poses_of(environment, "ball", "plank", "mark", "hunter")]
    assert heights == pytest.approx([0.07, 0.15, 0.005, 0.0], abs=1e-9)


def test_a_grid_gives_the_middles_of_its_cells(make: Make) -> None:
    for environment in starts(make(PLACED), 0, 20):
        (x, y, _), _ = poses_of(environment, "mark")[0]
        assert round((x + 0.6) / 0.2, 6) in range(7)
        assert round((y + 0.5) / 0.2, 6) in range(6)


def test_what_is_required_holds_in_every_episode(make: Make) -> None:
    for environment in starts(make(PLACED), 1, 50):
        (hunter, _), (prey, _) = poses_of(environment, "hunter", "prey")
        assert math.dist(hunter[:2], prey[:2]) > 0.5


ALONE = """\
deepbots: 1
name: Alone
world: {timestep: 64 ms, arena: {size: 2 2 m}}
objects: {disc: {shape: cylinder, radius: 10 cm, height: 10 cm, fixed: true}, post: {shape: box, size: 40 40 40 cm, fixed: true}}
robots: {cart: {urdf: epuck}}
action: {idle: -1 .. 1}
observation: {idle: -1 .. 1}
reward: {a: idle}
truncation: {max_steps: 5}
reset: {place: {post: {x: 0 m, y: 0 m}, cart: {x: 0.9 m, y: 0.9 m}, disc: {region: arena}}}
"""


def test_spots_are_uniform_over_what_is_free(make: Make) -> None:
    """Counts in 16 cells of equal size against the free area of each, known in closed form by symmetry."""
    environment = begun(make(ALONE))
    count = 4000
    cells = np.zeros((4, 4))
    place = environment._begin
    for _ in range(count):
        place()
        (x, y, _), _ = poses_of(environment, "disc")[0]
        cells[int((x + 0.9) // 0.45), int((y + 0.9) // 0.45)] += 1
    # The disc's middle keeps out of the post grown by a radius: of each inner cell a quarter of that, its
    # corner being round.
    cell = 0.45**2
    grown = 0.2 * 0.2 + 2 * 0.2 * 0.1 + math.pi * 0.1**2 / 4
    free = np.full((4, 4), cell)
    free[1:3, 1:3] -= grown
    corner = cells[3, 3]
    cells[3, 3] = free[3, 3] = 0.0  # where the robot is
    expected = free / free.sum() * (count - corner)
    mask = free > 0
    chi = float((((cells - expected) ** 2)[mask] / expected[mask]).sum())
    assert chi < 36.1, "beyond the 0.1 % point of chi-square with 14 degrees of freedom"


def test_a_body_at_coordinates_is_placed_before_those_that_look_for_a_place(
    make: Make,
) -> None:
    for environment in starts(
        make(PLACED, "reset.place.hunter={x: 0.3 m, y: 0 m}", "reset.require=true"), 0, 30
    ):
        laid = patches(environment)
        assert min(patch_distance(laid["hunter"], laid[other]) for other in ("ball", "prey")) >= 0.04 - 1e-6


def test_a_start_that_is_never_found_names_the_body_and_the_seed(make: Make) -> None:
    environment = make(PLACED, "reset.place.plank.clearance=90 cm", "reset.attempts=3")
    with pytest.raises(
        EvaluationError, match=r"3 attempts \(seed 7\): there is no free position for '(hunter|prey|plank)'"
    ):
        environment.reset(seed=7)
    environment = make(PLACED, "reset.require=ground_distance(hunter, prey) > 5 m", "reset.attempts=3")
    with pytest.raises(EvaluationError, match=r"no start met `reset.require`"):
        environment.reset(seed=7)


TABLE_HALF = (0.3, 0.2)
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
    for environment in starts(make(TABLE), 0, 20):
        x, y, z = on_the_table(environment, "block")
        assert z == pytest.approx(0.02, abs=1e-9)
        assert abs(x) <= TABLE_HALF[0] - 0.02 - 0.02 + 1e-6
        assert abs(y) <= TABLE_HALF[1] - 0.02 - 0.02 + 1e-6
    begun = environment.engine.pose("block")()[0]
    for _ in range(30):
        environment.step([0.0])
    assert environment.engine.pose("block")()[0] == pytest.approx(begun, abs=2e-3)


def test_every_part_of_the_top_is_found(make: Make) -> None:
    quarters = set()
    for environment in starts(make(TABLE), 1, 40):
        x, y, _ = on_the_table(environment, "block")
        quarters.add((x > 0.1, x < -0.1, y > 0))
    assert len(quarters) == 6


def test_a_region_is_cut_to_the_top(make: Make) -> None:
    for environment in starts(make(TABLE), 2, 20):
        x, y, z = on_the_table(environment, "mug")
        assert environment.engine.pose("mug")()[0][0] >= 0.5
        assert abs(x) <= TABLE_HALF[0] - 0.04 + 1e-6
        assert abs(y) <= TABLE_HALF[1] - 0.04 + 1e-6
        assert z == pytest.approx(0.05, abs=1e-9)


def test_a_table_that_is_drawn_is_placed_first_and_takes_what_stands_on_it_along(
    make: Make,
) -> None:
    environment = make(
        TABLE,
        "reset.place.table={region: {x: -1 .. 1 m, y: -1 .. 1 m}, yaw: any}",
        "reset.place.mug={on: table}",
    )
    where = set()
    for _ in starts(environment, 3, 10):
        where.add(round(environment.engine.pose("table")()[0][0], 1))
        for body in ("block", "mug", "crate"):
            x, y, z = on_the_table(environment, body)
            assert z > 0.0
            assert abs(x) <= TABLE_HALF[0]
            assert abs(y) <= TABLE_HALF[1]
    assert len(where) > 4


def test_bodies_stack_on_what_stands_on_a_table(make: Make) -> None:
    environment = begun(make(TABLE), seed=4)
    (x, y, z), _ = environment.engine.pose("crate")()
    for copy in ("coin#1", "coin#2", "coin#3"):
        (cx, cy, cz), _ = environment.engine.pose(copy)()
        assert cz == pytest.approx(z + 0.05 + 0.005, abs=1e-9)
        assert math.hypot(cx - x, cy - y) < 0.05 * math.sqrt(2)


def test_a_height_counts_from_the_top(make: Make) -> None:
    environment = begun(make(TABLE, "reset.place.block={on: table, z: 0.3 m}"), seed=5)
    assert on_the_table(environment, "block")[2] == pytest.approx(0.3, abs=1e-9)


def test_a_body_on_a_table_keeps_clear_of_what_rises_beside_it_and_not_of_what_lies_below(
    make: Make,
) -> None:
    """The crate stands on the ground beside the table, where a body as high as the table would be in nobody's
    way."""
    spots = []
    for environment in starts(
        make(TABLE, "reset.place.crate={x: 0.5 m, y: -0.2 m, z: 0.05 m}", "reset.place.coin={on: table}"),
        6,
        40,
    ):
        spots.append(on_the_table(environment, "block")[:2])
        mug = on_the_table(environment, "mug")[:2]
        assert math.dist(spots[-1], mug) >= 0.02 + 0.02 + 0.03 - 1e-6  # half the block, clearance, the mug
    assert min(math.hypot(*spot) for spot in spots) < 0.08


def test_a_picture_contains_the_bodies_on_a_table(make: Make) -> None:
    """The scene reaches up to the top of the mug."""
    scene = extent(make(TABLE, "objects.mug.height=2 m").scenario)
    assert max(high[2] for _, high in scene) == pytest.approx(0.4 + 2.0, abs=0.01)


ARENA = (-0.5, -0.5, 0.5, 0.5)
BODY_RADIUS = 0.04


def box(x: float, y: float, a: float, b: float, yaw: float = 0.0) -> Footprint:
    return Footprint((0.0, 0.0), math.hypot(a, b) / 2, (a / 2, b / 2)).at(x, y, yaw)


def test_where_nothing_is_in_the_way_it_is_the_straight_line() -> None:
    field = DistanceField(ARENA, BODY_RADIUS, [], (0.3, -0.2), 0.05)
    generator = np.random.default_rng(0)
    for x, y in generator.uniform(-0.45, 0.45, (2000, 2)):
        straight = math.dist((x, y), (0.3, -0.2))
        assert field.length(x, y) == pytest.approx(straight, rel=0.02, abs=0.003)
        assert field.reaches(x, y)


def length_around(
    start: tuple[float, float], end: tuple[float, float], corner: tuple[float, float], radius: float
) -> float:
    """The length of a taut string from `start` to `end` around a disc at `corner`, above which it goes."""

    def tangent(point: tuple[float, float]) -> tuple[float, float]:
        away = math.dist(point, corner)
        bearing = abs(math.atan2(point[0] - corner[0], point[1] - corner[1]))
        return math.sqrt(away**2 - radius**2), bearing - math.acos(radius / away)

    (first, one), (second, other) = tangent(start), tangent(end)
    return first + second + radius * (one + other)


@pytest.mark.parametrize("size", [1e3, 1e5])
def test_lengths_in_a_world_of_kilometers_are_finite(size: float) -> None:
    field = DistanceField((-size, -size, size, size), BODY_RADIUS, [], (0.0, 0.0), 0.05)
    assert field.length(0.6 * size, 0.0) == pytest.approx(0.6 * size, rel=0.02)


def test_around_a_disc_it_is_a_taut_string() -> None:
    disc = Footprint((0.0, 0.0), 0.15).at(0.0, 0.0, 0.0)
    field = DistanceField(ARENA, BODY_RADIUS, [disc], (0.4, 0.0), 0.0)
    for x in (-0.45, -0.4, -0.3, -0.25):
        assert field.length(x, 0.0) == pytest.approx(
            length_around((x, 0.0), (0.4, 0.0), (0.0, 0.0), 0.15 + BODY_RADIUS), rel=0.03
        )


def test_the_points_of_a_path_go_around_a_disc_and_add_up_to_its_length() -> None:
    disc = Footprint((0.0, 0.0), 0.15).at(0.0, 0.0, 0.0)
    field = DistanceField(ARENA, BODY_RADIUS, [disc], (0.4, 0.0), 0.0)
    points = field.path(-0.4, 0.0)
    assert points[-1] == (0.4, 0.0)
    assert min(math.hypot(x, y) for x, y in points) > 0.15 + BODY_RADIUS - 0.01
    length = sum(math.dist(point, next_point) for point, next_point in pairwise(points))
    assert length == pytest.approx(field.length(-0.4, 0.0), rel=0.03)
    assert field.path(0.0, 0.0) == [(0.0, 0.0)]


@pytest.mark.parametrize("yaw", [0.0, 0.5, math.pi / 2])
def test_around_a_box_it_is_a_taut_string_about_its_rounded_corners(yaw: float) -> None:
    """A wall from the lower edge upwards, turned about its upper end, so that there is one way: over that
    end."""
    half = 0.4
    solid = box(half * math.sin(yaw), -half * math.cos(yaw), 1e-3, 2 * half, yaw)
    field = DistanceField(ARENA, BODY_RADIUS, [solid], (0.35, 0.1 - 0.4 * math.cos(yaw)), 0.0)
    if yaw == 0.0:
        assert field.length(-0.35, -0.3) == pytest.approx(
            length_around((-0.35, -0.3), (0.35, -0.3), (0.0, 0.0), BODY_RADIUS), rel=0.03
        )
    for x, y in np.random.default_rng(1).uniform(-0.45, 0.45, (300, 2)):
        assert field.length(x, y) >= 0.98 * math.dist((x, y), (0.35, 0.1 - 0.4 * math.cos(yaw))) - 0.003


@pytest.mark.slow
def test_lengths_do_not_jump_beside_a_node_that_no_way_reaches() -> None:
    """A mean with such a node is nearly right where its weight is small: a place 0.4 % of a cell beside one
    was 40 m away."""
    solid = box(0.0, 0.0, 0.1, 0.1, 0.3)
    at_the_goal = DistanceField(ARENA, BODY_RADIUS, [solid], (0.3, 0.0), 0.05)
    for angle in np.linspace(0.0, 2 * math.pi, 60):
        field = DistanceField(
            ARENA, BODY_RADIUS, [solid], (0.3, 0.0), 0.05
        )  # a new one: what is not known is filled in once
        way = [field.length(r * math.cos(angle), r * math.sin(angle)) for r in np.arange(0.2, 0.07, -1e-4)]
        assert max(map(abs, np.diff(way))) < 0.01
        assert max(way) < at_the_goal.length(-0.2, 0.0) + 0.1


def test_a_gap_is_a_way_if_the_disc_fits_through() -> None:
    for width, fits in ((2 * BODY_RADIUS + 0.03, True), (2 * BODY_RADIUS - 0.005, False)):
        walls = [box(0.0, sign * (0.25 + width / 4), 0.02, 0.5 - width / 2) for sign in (1, -1)]
        field = DistanceField(ARENA, BODY_RADIUS, walls, (0.3, 0.0), 0.05)
        assert field.reaches(-0.3, 0.0) is fits
        assert field.reaches(0.2, 0.2)


def test_where_there_is_no_way_the_length_is_finite() -> None:
    cage = [
        box(-0.25, 0.0, 0.02, 0.4),
        box(0.0, -0.2, 0.5, 0.02),
        box(0.0, 0.2, 0.5, 0.02),
        box(0.25, 0.0, 0.02, 0.4),
    ]
    field = DistanceField(ARENA, BODY_RADIUS, cage, (0.4, 0.4), 0.05)
    assert not field.reaches(0.0, 0.0)
    assert all(0.0 < field.length(x, 0.0) < 2.0 for x in np.linspace(-0.5, 0.5, 1001))


def test_a_robot_that_touches_a_wall_is_as_far_as_one_beside_it() -> None:
    """The goal is beyond the wall; what touches the wall from this side has not come through."""
    field = DistanceField(ARENA, BODY_RADIUS, [box(0.0, -0.1, 0.02, 0.8)], (0.3, -0.3), 0.05)
    line = [field.length(x, -0.3) for x in np.linspace(-0.4, -0.025, 200)]
    assert np.abs(np.diff(line)).max() < 0.004
    assert min(line) > 1.0


def test_a_goal_that_is_shut_in_is_as_far_as_the_crow_flies() -> None:
    field = DistanceField(ARENA, BODY_RADIUS, [box(0.0, 0.0, 0.4, 0.4)], (0.0, 0.0), 0.01)
    assert not field.reaches(0.4, 0.4)
    assert field.length(0.3, 0.4) == pytest.approx(0.5, abs=0.01)


def test_what_is_ahead_on_a_way_leads_around_the_obstacle() -> None:
    field = DistanceField(ARENA, BODY_RADIUS, [box(0.0, 0.0, 0.02, 0.6)], (0.4, 0.0), 0.05)
    x, y, walked = -0.4, 0.01, 0.0
    while math.hypot(0.4 - x, y) > 0.06 and walked < 3.0:
        ahead = field.ahead(x, y)
        away = math.hypot(ahead[0] - x, ahead[1] - y)
        x, y, walked = x + 0.01 * (ahead[0] - x) / away, y + 0.01 * (ahead[1] - y) / away, walked + 0.01
        assert abs(x) > 0.01 + BODY_RADIUS - 2 * field.cell or abs(y) > 0.3 + BODY_RADIUS - 2 * field.cell
    assert walked + 0.06 == pytest.approx(field.length(-0.4, 0.01), rel=0.03)
    assert field.ahead(-0.03, 0.0)[0] < -0.03  # from a place at the wall, back to where a way begins


MAZE = """\
deepbots: 1
name: Way
world: {timestep: 20 ms, substeps: 4, arena: {size: 2 2 m}}
objects:
  goal: {shape: sphere, radius: 5 cm, fixed: true}
  wall: {shape: box, size: 2 60 20 cm, fixed: true}
  jar: {shape: cylinder, radius: 5 cm, height: 10 cm, mass: 1 kg}
robots:
  cart:
    urdf: epuck
    actuators: {wheels: {type: velocity_motor, joints: [left_wheel, right_wheel], max_torque: 0.05 N*m}}
    apply: {wheels: gas * 6 rad/s}
action: {gas: -1 .. 1}
augment:
  path: path_distance(cart, goal)
  open: reachable(cart, goal)
observation: {path: 0 .. 10 m, open: auto}
reward: {a: 1}
truncation: {max_steps: 100}
reset: {place: {cart: {x: -0.5 m, y: 0 m}, goal: {x: 0.5 m, y: 0 m}, wall: {x: 0 m, y: 0 m}, jar: {x: 0.8 m, y: 0.8 m}}}
"""


def path(observation: np.ndarray) -> float:
    return float((observation[0] + 1.0) * 5.0)


def test_a_scenario_measures_ways_between_bodies(make: Make) -> None:
    environment = make(MAZE)
    observation, _ = environment.reset(seed=0)
    # About a robot of 4.5 cm: up to the corner of the wall, along its thickness and down again.
    corner = math.hypot(0.49, 0.3)
    assert 2 * corner + 0.02 < path(observation) < 2 * math.hypot(0.49, 0.36) + 0.06
    assert observation[1] == 1.0
    before = path(observation)
    for _ in range(20):
        observation, *_ = environment.step(np.array([-1.0]))
    assert path(observation) > before


@pytest.mark.parametrize("origin", [0.0, 0.1], ids=["in its middle", "at its base"])
def test_a_way_leads_around_a_mesh_wherever_its_origin_is(make: Make, tmp_path: Path, origin: float) -> None:
    raised = trimesh.transformations.translation_matrix((0.0, 0.0, origin))
    trimesh.creation.box((0.02, 0.6, 0.2), raised).export(tmp_path / "wall.stl")
    of_box = path(make(MAZE).reset(seed=0)[0])
    text = MAZE.replace("{shape: box, size: 2 60 20 cm,", "{shape: mesh, file: wall.stl,")
    assert path(make(text).reset(seed=0)[0]) == pytest.approx(of_box, rel=1e-6)


def test_what_moves_changes_the_ways(make: Make) -> None:
    """A gap beside the wall that a jar shuts."""
    environment = make(
        MAZE,
        "objects.wall.size=2 180 20 cm",
        "reset.place.jar={x: 0.02 m, y: -0.9 m}",
        "reset.place.wall={x: 0 m, y: 10 cm}",
    )
    observation, _ = environment.reset(seed=0)
    assert observation[1] == 0.0
    assert math.isfinite(path(observation))
    environment.engine.place("jar", (0.8, 0.8, 0.05), (0.0, 0.0, 0.0, 1.0))
    observation, *_ = environment.step(np.array([0.0]))
    assert observation[1] == 1.0


def test_what_turns_in_place_changes_the_ways(make: Make) -> None:
    """A free wall across the way, which then lies along it."""
    environment = make(MAZE, "objects.wall={shape: box, size: 2 60 20 cm, mass: 5 kg}")
    observation, _ = environment.reset(seed=0)
    around = path(observation)
    environment.engine.place("wall", (0.0, 0.0, 0.1), quaternion(0.0, 0.0, math.pi / 2))
    observation, *_ = environment.step(np.array([0.0]))
    assert path(observation) < around - 0.05


def test_a_start_may_be_required_to_have_a_way(make: Make) -> None:
    for environment in starts(
        make(
            MAZE,
            "reset.place.wall={x: 0 m, y: uniform(-0.7 .. 0.7 m)}",
            "objects.wall.size=2 140 20 cm",
            "reset.require=reachable(cart, goal)",
        ),
        0,
        10,
    ):
        assert environment.get_observations()[1] == 1.0
