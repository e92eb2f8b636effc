"""Laws of two engines: what is the same world in both."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

import numpy as np

from deepbots_cli.errors import ScenarioError
from deepbots_cli.geometry import height_grid
from deepbots_cli.program import Program
from deepbots_cli.runtime import Supervisor
from tests.laws.frames import FACTOR, TOLERANCES, difference, disturbed, name_of, scale_of
from tests.laws.law import Case, law, reference
from tests.laws.readings import (
    Array,
    Readings,
    Source,
    beginning,
    contact_reader,
    lively,
    opened,
    prepared,
    readings,
)
from tests.laws.scenarios import ALONE, PLAIN
from tests.laws.sensors import RAYS, Truth, second_value

STEPS = 10


CLEARANCE = 2e-3
"""m: PyBullet rounds the corners of boxes (docs/engines.md); between a box and a wall, 1.3 mm were met, and of
rays to the end of a wall, 2 cm wide, 0.8 mm."""
SLANTED = 1e-2
"""m: what a slanted ray adds to the difference of two grounds below it."""
LEFT_OUT = {
    "path_distance": "both engines have the same paths, along a grid that jumps with rounding",
    "path_bearing": "as `path_distance`",
    "reachable": "as `path_distance`",
    "cross_track_error": "beside a corner of a line, its sign jumps with rounding",
    "arc_length": "beside a corner of a line, it jumps with rounding",
    "visible": "a body that is smaller than a pixel may be seen or not",
}


def differences(
    sources: Mapping[str, Source], one: Readings, other: Readings, keep: Mapping[str, Array] = {}
) -> Iterator[tuple[str, float, float]]:
    """Yield each reading with its difference, and the scale of its tolerance."""
    for name, source in sources.items():
        parts = keep.get(name, np.ones(len(one[name]), bool))
        yield name, difference(source, other[name][parts], one[name][parts]), scale_of(name, source, one)


def ground_tolerance(program: Program) -> dict[str, float]:
    """Return by how much the readings of the ground may differ, in m, by their names.

    The engines divide the cells of a terrain along different diagonals (docs/world.md), so their grounds
    differ most in the middle of a cell: by 1.7 cm on rough ground of 8 cm. Bodies have the same poses in both.
    """
    if program.world.terrain is None:
        return {}
    grid = height_grid(program.world.terrain.shape)
    assert grid is not None  # `_with_ground_of_heights`
    z = grid.heights
    most = float(np.abs(z[1:, 1:] + z[:-1, :-1] - z[1:, :-1] - z[:-1, 1:]).max()) / 2
    return {"height": most, **dict.fromkeys(RAYS, most + SLANTED)}


@law(cost=330, profile=replace(PLAIN, engines=("pybullet",)))
def two_engines_begin_alike(case: Case) -> None:
    """A scenario states the start of a world, and what is read at a start is geometry: it does not depend on
    how an engine moves bodies.

    Readings agree to 2e-6, the precision with which PyBullet reads links, or to 20 times what a start changes
    that is off by 1e-6 m. Rays that begin within a body are left out: engines may see it from inside.
    """
    program, sources, start = prepared(case, tuple(LEFT_OUT), _with_ground_of_heights)
    start = lively(case, program, start)
    of_ground = ground_tolerance(program)
    with ExitStack() as stack:
        starts = (start, start, disturbed(start, 1.0), disturbed(start, -1.0))
        engines = ("pybullet", "mujoco", "mujoco", "mujoco")
        worlds = [
            stack.enter_context(opened(beginning(program, begin), engine))
            for begin, engine in zip(starts, engines, strict=True)
        ]
        for world in worlds:
            world.reset(seed=0)
        one, other, *beside = (readings(world, sources) for world in worlds)
        truth = Truth(program, start, np.array(worlds[0].engine.gravity))
        rays = {name: source for name, source in sources.items() if name_of(source) in RAYS}
        clear = {name: ~np.isnan(second_value(truth, source)) for name, source in rays.items()}
        for name, error, scale in differences(sources, one, other, clear):
            spread = max(difference(sources[name], values[name], other[name]) for values in beside)
            allowed = TOLERANCES["pybullet"][0] * scale + FACTOR * spread
            allowed += CLEARANCE if name_of(sources[name]) in ("clearance", *RAYS) else 0.0
            allowed += of_ground.get(name_of(sources[name]), 0.0)
            assert error <= allowed, (name, sources[name], one[name], other[name], allowed)


def _with_ground_of_heights(data: dict[str, Any]) -> None:
    """Remove a ground of triangles, which MuJoCo does not have."""
    if data["world"].get("terrain", {}).get("type") == "mesh":
        del data["world"]["terrain"]


def _driven_by_forces(data: dict[str, Any]) -> None:
    """Remove motors that follow a velocity or a position with the servo of the engine."""
    _with_ground_of_heights(data)
    for robot in data["robots"].values():
        for name, actuator in list(robot.get("actuators", {}).items()):
            is_spring = actuator["type"] == "position_motor" and "stiffness" in actuator
            if actuator["type"] not in ("torque_motor", "thrust") and not is_spring:
                del robot["actuators"][name], robot["apply"][name]
        robot.get("joints", {}).clear()


def without_friction(program: Program) -> Program:
    """Return the program without dry friction in joints, which a motor of PyBullet replaces."""
    robots = []
    for robot in program.world.robots:
        joints = tuple(replace(joint, friction=0.0) for joint in robot.model.joints)
        robots.append(replace(robot, model=replace(robot.model, joints=joints)))
    return replace(program, world=replace(program.world, robots=tuple(robots)))


UNEQUAL_IN_MOTION = {
    "reaction_force": "PyBullet adds about m v x w of each carried link (docs/engines.md)",
    "reaction_torque": "as `reaction_force`",
    **dict.fromkeys(RAYS, "a ray may begin within a body, or graze an edge; starts are compared"),
}
"""Sensors that are not compared in motion, and the reason."""
LONGEST_STEP = 0.002
"""s"""
MAX_TURN = 0.5
"""rad in a physics step; PyBullet turns a body by at most a quarter of pi."""
LIMIT_SHARE = 0.05
"""Of the range of a joint, from each of its ends: there, a limit may act."""


def is_free(world: Supervisor) -> bool:
    """Return whether no joint is near a limit, and no link turns too fast for steps of this size."""
    model = world.scenario.world
    for robot in model.robots:
        joints = robot.model.moving_joints
        states = world.engine.joint_states(robot.name, [joint.name for joint in joints])() if joints else ()
        for joint, state in zip(joints, states, strict=True):
            low, high = joint.ends(1e9)
            if not low < state[0] - LIMIT_SHARE * (high - low) < high - 2 * LIMIT_SHARE * (high - low):
                return False
        for link in robot.model.links:
            turning = world.engine.velocity(robot.name, link.name)()[1]
            if np.linalg.norm(turning) * model.timestep / model.substeps > MAX_TURN:
                return False
    return True


def with_steps(program: Program, longest: float, factor: int = 1) -> Program:
    """Return the program with physics steps of at most this length, in s, of which each is divided."""
    substeps = max(program.world.substeps, int(np.ceil(program.world.timestep / longest)))
    return replace(program, world=replace(program.world, substeps=factor * substeps))


@law(cost=330, profile=replace(PLAIN, engines=("pybullet",)))
def free_motion_is_the_same_in_two_engines(case: Case) -> None:
    """Bodies that touch nothing move by the same equations.

    Both engines take steps, here of at most 2 ms, so they differ by as much as each differs from itself with
    steps of half the size, three times over; and by a thousandth. Friction in joints, limits and servos are
    those of the engine (docs/engines.md).
    """
    program, sources, start = prepared(case, (*LEFT_OUT, *UNEQUAL_IN_MOTION), _driven_by_forces)
    of_ground = ground_tolerance(program)
    program = without_friction(beginning(program, lively(case, program, start, percent=100)))
    with ExitStack() as stack:
        worlds = [
            stack.enter_context(opened(of_steps, engine))
            for of_steps in (with_steps(program, LONGEST_STEP), with_steps(program, LONGEST_STEP, 2))
            for engine in ("pybullet", "mujoco")
        ]
        touched = [contact_reader(world) for world in worlds]
        for world in worlds:
            world.reset(seed=0)
        worlds[0].action_space.seed(0)
        for step in range(STEPS):
            action = worlds[0].action_space.sample()
            for world in worlds:
                world.step(action)
            if any(reader() for reader in touched) or not all(map(is_free, worlds)):
                return
            one, other, half_one, half_other = (readings(world, sources) for world in worlds)
            for name, error, scale in differences(sources, one, other):
                source = sources[name]
                halved = ((one, half_one), (other, half_other))
                spread = sum(difference(source, half[name], whole[name]) for whole, half in halved)
                allowed = 1e-3 * scale + 3 * spread + of_ground.get(name_of(source), 0.0)
                assert error <= allowed, (
                    step,
                    name,
                    source,
                    one[name],
                    other[name],
                    half_one[name],
                    half_other[name],
                )


@law(cost=120, profile=ALONE)
def what_has_no_friction_keeps_its_speed(case: Case) -> None:
    """The friction of a contact is the product of the coefficients of its bodies: a box without friction
    slides on, whatever the ground is made of."""
    case.compile()
    data = copy.deepcopy(case.drawn.data)
    for key in ("terrain", "arena", "walls", "gravity"):
        data["world"].pop(key, None)
    box = {"shape": "box", "size": "10 10 10 cm", "mass": "1 kg", "friction": 0}
    data.setdefault("objects", {})["slider"] = box
    data["reset"] = {"place": {"slider": {"y": "50 m", "z": "5 cm", "velocity": "1 0 0 m/s"}}}
    for engine in ("pybullet", "mujoco"):
        data["world"]["engine"] = engine
        try:
            compiled = case.compile(case.write(data, f"{engine}.yaml"))
        except ScenarioError:
            continue
        with case.environment(compiled) as environment, reference():
            environment.reset(seed=0)
            for _ in range(5):
                _, _, terminated, truncated, _ = environment.step(environment.action_space.sample())
                speed = environment.engine.motion("slider")()[1][0][0]
                assert abs(speed - 1.0) < 1e-3, (engine, speed)
                if terminated or truncated:
                    break
