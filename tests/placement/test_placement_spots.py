"""Bodies that search for a place: uniform over the free area, clear of the rest, the same for the same
seed."""

from __future__ import annotations

import math

import numpy as np
import pytest

from deepbots_cli.errors import EvaluationError
from deepbots_cli.footprint import Footprint, Patch, contact_points, patch_distance
from deepbots_cli.frames import Triple
from deepbots_cli.robots.model import Capsule, Geometry, Link, Pose, RobotModel
from deepbots_cli.runtime import Supervisor
from tests.worlds import SCENARIOS, Make

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
    environment = make(PLACED)
    clearances = {"ball": 0.04, "plank": 0.0, "hunter": 0.05, "prey": 0.05, "mark": 0.0}
    environment.reset(seed=3)
    for _ in range(40):
        environment.reset()
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


def test_objects_without_a_height_rest_on_the_ground_and_robots_stand_on_it(
    make: Make,
) -> None:
    environment = make(PLACED)
    environment.reset(seed=0)
    heights = [position[2] for position, _ in poses_of(environment, "ball", "plank", "mark", "hunter")]
    assert heights == pytest.approx([0.07, 0.15, 0.005, 0.0], abs=1e-9)


def test_a_grid_gives_the_middles_of_its_cells(make: Make) -> None:
    environment = make(PLACED)
    environment.reset(seed=0)
    for _ in range(20):
        environment.reset()
        (x, y, _), _ = poses_of(environment, "mark")[0]
        assert round((x + 0.6) / 0.2, 6) in range(7)
        assert round((y + 0.5) / 0.2, 6) in range(6)


def test_what_is_required_holds_in_every_episode(make: Make) -> None:
    environment = make(PLACED)
    environment.reset(seed=1)
    for _ in range(50):
        environment.reset()
        (hunter, _), (prey, _) = poses_of(environment, "hunter", "prey")
        assert math.dist(hunter[:2], prey[:2]) > 0.5


def test_the_same_seed_gives_the_same_places_and_another_seed_others(make: Make) -> None:
    fresh, used = make(PLACED), make(PLACED)
    bodies = ("ball", "plank", "hunter", "prey", "mark")
    fresh.reset(seed=5)
    used.reset(seed=4)
    first = poses_of(fresh, *bodies)
    assert poses_of(used, *bodies) != first
    for _ in range(3):
        used.step(np.array([1.0]))
    used.reset(seed=5)
    assert poses_of(used, *bodies) == first


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
    environment = make(ALONE)
    environment.reset(seed=0)
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
    environment = make(PLACED, "reset.place.hunter={x: 0.3 m, y: 0 m}", "reset.require=true")
    environment.reset(seed=0)
    for _ in range(30):
        environment.reset()
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


@pytest.mark.parametrize("pitch", [0.6, math.pi - 0.6])
def test_a_tilted_capsule_touches_the_ground_with_its_lower_end(pitch: float) -> None:
    leg = Geometry(Capsule(0.05, 0.4), Pose((0.0, 0.0, 0.3), (0.0, pitch, 0.0)))
    model = RobotModel("robot", (Link("leg", collisions=(leg,)),), (), "leg")
    ((x, y),) = contact_points(model, 0.01)
    assert x == pytest.approx(-math.copysign(0.2 * math.sin(0.6), math.cos(pitch)))
    assert y == pytest.approx(0.0)
