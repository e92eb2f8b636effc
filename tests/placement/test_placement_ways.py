"""Ways around obstacles: their lengths against closed forms, and what happens where there is none."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from deepbots_cli.footprint import Footprint
from deepbots_cli.runtime.paths import DistanceField
from tests.worlds import Make

ARENA = (-0.5, -0.5, 0.5, 0.5)
RADIUS = 0.04


def box(x: float, y: float, a: float, b: float, yaw: float = 0.0) -> Footprint:
    return Footprint((0.0, 0.0), math.hypot(a, b) / 2, (a / 2, b / 2)).at(x, y, yaw)


def test_where_nothing_is_in_the_way_it_is_the_straight_line() -> None:
    field = DistanceField(ARENA, RADIUS, [], (0.3, -0.2), 0.05)
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
    field = DistanceField((-size, -size, size, size), RADIUS, [], (0.0, 0.0), 0.05)
    assert field.length(0.6 * size, 0.0) == pytest.approx(0.6 * size, rel=0.02)


def test_around_a_disc_it_is_a_taut_string() -> None:
    disc = Footprint((0.0, 0.0), 0.15).at(0.0, 0.0, 0.0)
    field = DistanceField(ARENA, RADIUS, [disc], (0.4, 0.0), 0.0)
    for x in (-0.45, -0.4, -0.3, -0.25):
        assert field.length(x, 0.0) == pytest.approx(
            length_around((x, 0.0), (0.4, 0.0), (0.0, 0.0), 0.15 + RADIUS), rel=0.03
        )


def test_the_points_of_a_path_go_around_a_disc_and_add_up_to_its_length() -> None:
    disc = Footprint((0.0, 0.0), 0.15).at(0.0, 0.0, 0.0)
    field = DistanceField(ARENA, RADIUS, [disc], (0.4, 0.0), 0.0)
    points = field.path(-0.4, 0.0)
    assert points[-1] == (0.4, 0.0)
    assert min(math.hypot(x, y) for x, y in points) > 0.15 + RADIUS - 0.01
    length = sum(math.dist(point, next_point) for point, next_point in pairwise(points))
    assert length == pytest.approx(field.length(-0.4, 0.0), rel=0.03)
    assert field.path(0.0, 0.0) == [(0.0, 0.0)]


@pytest.mark.parametrize("yaw", [0.0, 0.5, math.pi / 2])
def test_around_a_box_it_is_a_taut_string_about_its_rounded_corners(yaw: float) -> None:
    """A wall from the lower edge upwards, turned about its upper end, so that there is one way: over that
    end."""
    half = 0.4
    solid = box(half * math.sin(yaw), -half * math.cos(yaw), 1e-3, 2 * half, yaw)
    field = DistanceField(ARENA, RADIUS, [solid], (0.35, 0.1 - 0.4 * math.cos(yaw)), 0.0)
    if yaw == 0.0:
        assert field.length(-0.35, -0.3) == pytest.approx(
            length_around((-0.35, -0.3), (0.35, -0.3), (0.0, 0.0), RADIUS), rel=0.03
        )
    for x, y in np.random.default_rng(1).uniform(-0.45, 0.45, (300, 2)):
        assert field.length(x, y) >= 0.98 * math.dist((x, y), (0.35, 0.1 - 0.4 * math.cos(yaw))) - 0.003


@pytest.mark.slow
def test_lengths_do_not_jump_beside_a_node_that_no_way_reaches() -> None:
    """A mean with such a node is nearly right where its weight is small: a place 0.4 % of a cell beside one
    was 40 m away."""
    solid = box(0.0, 0.0, 0.1, 0.1, 0.3)
    at_the_goal = DistanceField(ARENA, RADIUS, [solid], (0.3, 0.0), 0.05)
    for angle in np.linspace(0.0, 2 * math.pi, 60):
        field = DistanceField(
            ARENA, RADIUS, [solid], (0.3, 0.0), 0.05
        )  # a new one: what is not known is filled in once
        way = [field.length(r * math.cos(angle), r * math.sin(angle)) for r in np.arange(0.2, 0.07, -1e-4)]
        assert max(map(abs, np.diff(way))) < 0.01
        assert max(way) < at_the_goal.length(-0.2, 0.0) + 0.1


def test_a_gap_is_a_way_if_the_disc_fits_through() -> None:
    for width, fits in ((2 * RADIUS + 0.03, True), (2 * RADIUS - 0.005, False)):
        walls = [box(0.0, sign * (0.25 + width / 4), 0.02, 0.5 - width / 2) for sign in (1, -1)]
        field = DistanceField(ARENA, RADIUS, walls, (0.3, 0.0), 0.05)
        assert field.reaches(-0.3, 0.0) is fits
        assert field.reaches(0.2, 0.2)


def test_where_there_is_no_way_the_length_is_finite() -> None:
    cage = [
        box(-0.25, 0.0, 0.02, 0.4),
        box(0.0, -0.2, 0.5, 0.02),
        box(0.0, 0.2, 0.5, 0.02),
        box(0.25, 0.0, 0.02, 0.4),
    ]
    field = DistanceField(ARENA, RADIUS, cage, (0.4, 0.4), 0.05)
    assert not field.reaches(0.0, 0.0)
    assert all(0.0 < field.length(x, 0.0) < 2.0 for x in np.linspace(-0.5, 0.5, 1001))


def test_a_robot_that_touches_a_wall_is_as_far_as_one_beside_it() -> None:
    """The goal is beyond the wall; what touches the wall from this side has not come through."""
    field = DistanceField(ARENA, RADIUS, [box(0.0, -0.1, 0.02, 0.8)], (0.3, -0.3), 0.05)
    line = [field.length(x, -0.3) for x in np.linspace(-0.4, -0.025, 200)]
    assert np.abs(np.diff(line)).max() < 0.004
    assert min(line) > 1.0


def test_a_goal_that_is_shut_in_is_as_far_as_the_crow_flies() -> None:
    field = DistanceField(ARENA, RADIUS, [box(0.0, 0.0, 0.4, 0.4)], (0.0, 0.0), 0.01)
    assert not field.reaches(0.4, 0.4)
    assert field.length(0.3, 0.4) == pytest.approx(0.5, abs=0.01)


def test_what_is_ahead_on_a_way_leads_around_the_obstacle() -> None:
    wall = [box(0.0, 0.0, 0.02, 0.6)]
    field = DistanceField(ARENA, RADIUS, wall, (0.4, 0.0), 0.05)
    x, y, walked = -0.4, 0.01, 0.0
    while math.hypot(0.4 - x, y) > 0.06 and walked < 3.0:
        ahead = field.ahead(x, y)
        away = math.hypot(ahead[0] - x, ahead[1] - y)
        x, y, walked = x + 0.01 * (ahead[0] - x) / away, y + 0.01 * (ahead[1] - y) / away, walked + 0.01
        assert abs(x) > 0.01 + RADIUS - 2 * field.cell or abs(y) > 0.3 + RADIUS - 2 * field.cell
    assert walked + 0.06 == pytest.approx(field.length(-0.4, 0.01), rel=0.03)
    assert field.ahead(-0.03, 0.0)[0] < -0.03  # from a place at the wall, back to where a way begins


WORLD = """\
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
    environment = make(WORLD)
    observation, _ = environment.reset(seed=0)
    # About a robot of 4.5 cm: up to the corner of the wall, along its thickness and down again.
    corner = math.hypot(0.49, 0.3)
    assert 2 * corner + 0.02 < path(observation) < 2 * math.hypot(0.49, 0.36) + 0.06
    assert observation[1] == 1.0
    before = path(observation)
    for _ in range(20):
        observation, *_ = environment.step(np.array([-1.0]))
    assert path(observation) > before


def test_what_moves_changes_the_ways(make: Make) -> None:
    """A gap beside the wall that a jar shuts."""
    environment = make(
        WORLD,
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


def test_a_start_may_be_required_to_have_a_way(make: Make) -> None:
    environment = make(
        WORLD,
        "reset.place.wall={x: 0 m, y: uniform(-0.7 .. 0.7 m)}",
        "objects.wall.size=2 140 20 cm",
        "reset.require=reachable(cart, goal)",
    )
    observation, _ = environment.reset(seed=0)
    for _ in range(10):
        assert observation[1] == 1.0
        observation, _ = environment.reset()


def test_an_episode_has_the_ways_of_its_own_world_whatever_the_one_before_had(
    make: Make,
) -> None:
    """The wall is in one of three places; the field of an episode may only be kept for one that has it in the
    same."""
    draws = ("reset.place.wall={x: 0 m, y: choice(0 cm | 5 cm | 10 cm)}",)
    environment = make(WORLD, *draws)
    lengths = [path(environment.reset(seed=seed)[0]) for seed in range(12)]
    assert len(set(lengths)) == 3
    for seed in (0, 5, 11):
        assert path(make(WORLD, *draws).reset(seed=seed)[0]) == lengths[seed]
