"""The outputs of an exported policy: the command of each actuator with its limits and its safe posture."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from deepbots_cli.arrays import evaluate
from deepbots_cli.errors import DeepbotsError
from deepbots_cli.expressions.scalar import Name, Scalar
from deepbots_cli.insight.export.readings import finite, unit_text
from deepbots_cli.program import Program
from deepbots_cli.program.robots import Actuator, Cartesian, Command, CustomActuator, Motor, Robot, Thrust
from deepbots_cli.robots.model import Joint
from deepbots_robot.model import Output

_KINDS = {"velocity_motor": "velocity", "position_motor": "position", "torque_motor": "effort"}
_UNITS = {"velocity": ("rad/s", "m/s"), "position": ("rad", "m"), "effort": ("N*m", "N")}
"""The units for revolute and for prismatic joints."""
_ROUNDING = 1e-9

Array = NDArray[np.float64]


def output(program: Program, robot: Robot, command: Command) -> Output:
    """Return the command of an actuator."""
    actuator = command.actuator
    model = next(body.model for body in program.world.robots if body.name == robot.name)
    joints = [
        joint for name in getattr(actuator, "joints", ()) for joint in model.joints if joint.name == name
    ]
    kind = _KINDS[actuator.kind] if isinstance(actuator, Motor) else _kind(actuator)
    count = len(command.components)
    limits = _limits(actuator, kind, joints, count)
    low, high = (tuple(finite(end) for end in ends) for ends in zip(*_within(command, limits), strict=True))
    return Output(
        name=f"{robot.name}.{command.name}",
        robot=robot.name,
        actuator=command.name,
        kind=kind,
        joints=tuple(joint.name for joint in joints),
        links=_links(actuator),
        shape=(count,),
        dtype="float64",
        components=tuple(command.components),
        unit=_unit(command, kind, joints),
        frame="world" if kind == "cartesian" else None,
        range=(low, high),
        max_rate=_rates(actuator, count),
        max_effort=() if isinstance(actuator, Thrust) else tuple(map(finite, actuator.max_torque)),
        stiffness=actuator.stiffness if isinstance(actuator, Motor) else None,
        damping=actuator.damping if isinstance(actuator, Motor) else None,
        attitude=actuator.rpy if isinstance(actuator, Cartesian) else None,
        safe=tuple(_safe(kind, *ends) for ends in zip(low, high, strict=True)),
    )


def _links(actuator: Actuator) -> tuple[str, ...]:
    if isinstance(actuator, Thrust):
        return actuator.links
    return (actuator.link,) if isinstance(actuator, Cartesian) else ()


def _kind(actuator: Actuator) -> str:
    if isinstance(actuator, Thrust):
        return "thrust"
    if isinstance(actuator, Cartesian):
        return "cartesian"
    return getattr(actuator, "kind", "")


def _unit(command: Command, kind: str, joints: Sequence[Joint]) -> str:
    match kind:
        case "thrust":
            return "N"
        case "cartesian":
            return "m"
        case "velocity" | "position" | "effort":
            return _UNITS[kind][joints[0].type == "prismatic"]
    return unit_text(command.target.typed.type.dimension)


def _limits(actuator: Actuator, kind: str, joints: Sequence[Joint], count: int) -> list[tuple[float, float]]:
    """Return the limits of the actuator for each component."""
    match actuator:
        case Motor() if kind == "position":
            return [(_or(joint.limit.lower, -math.inf), _or(joint.limit.upper, math.inf)) for joint in joints]
        case Motor():
            ends = actuator.max_velocity if kind == "velocity" else actuator.max_torque
            return [(-_or(end, math.inf), _or(end, math.inf)) for end in ends]
        case Thrust(low=low, high=high):
            return [(low, high)] * count
        case CustomActuator(low=low, high=high):
            return [(_or(low, -math.inf), _or(high, math.inf))] * count
    return [(-math.inf, math.inf)] * count


def _or(number: float | None, default: float) -> float:
    return default if number is None else number


def _within(command: Command, limits: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return the limits of each component. For a component without a limit, this is the largest command of
    the scenario."""
    target_type = command.target.typed.type
    components = target_type.components or (None,) * len(limits)
    intervals = []
    for (low, high), component in zip(limits, components, strict=False):
        reach = target_type.interval_of(component)
        ends = sorted(command.opening) if command.opening else (reach.low, reach.high)
        intervals.append(
            (
                low if math.isfinite(low) else min(ends[0], high),
                high if math.isfinite(high) else max(ends[1], low),
            )
        )
    return intervals


def _rates(actuator: Actuator, count: int) -> tuple[float | None, ...]:
    match actuator:
        case Motor(kind="velocity_motor"):
            return (actuator.max_acceleration,) * count
        case Motor(kind="position_motor"):
            return tuple(map(finite, actuator.max_velocity))
    return (None,) * count


def _safe(kind: str, low: float | None, high: float | None) -> float | None:
    """Return the command that stands still: no speed, torque or thrust; joints and links stay where they were
    commanded."""
    if kind not in ("velocity", "effort", "thrust"):
        return None
    return min(max(0.0, 0.0 if low is None else low), math.inf if high is None else high)


def linear(program: Program, targets: Sequence[Scalar]) -> tuple[Array, Array] | None:
    """Return a matrix (targets, numbers of the action) and an offset if each target is matrix @ action +
    offset, with the action in [-1, 1]; else None."""
    parts = [
        (interval, component)
        for interval in program.agent.ranges
        for component in interval.components or (None,)
    ]
    count = len(parts)
    # Zeros and unit vectors give offset and matrix; random actions then show a clamp or a product.
    dice = np.random.default_rng(0).uniform(-1.0, 1.0, (20, count))
    actions = np.concatenate([np.zeros((1, count)), np.eye(count), dice])
    values = _evaluated(
        targets,
        {
            Name(interval.name, component): (interval.high + interval.low) / 2
            + (interval.high - interval.low) / 2 * column
            for (interval, component), column in zip(parts, actions.T, strict=True)
        },
    )
    if values is None:
        return None
    offset, matrix = values[0], (values[1 : count + 1] - values[0]).T
    fits = np.allclose(values, actions @ matrix.T + offset, rtol=0.0, atol=_ROUNDING)
    return (matrix, offset) if fits else None


def tabulated(program: Program, targets: Sequence[Scalar]) -> Array | None:
    """Return the targets of each combination of options, the last choice changing first: (combinations,
    targets); None if they need more."""
    combinations = [*product(*(choice.options for choice in program.agent.choices))]
    variables = [name for choice in program.agent.choices for name in choice.variables]
    rows = np.array(
        [[value for option in options for value in option.values] for options in combinations], float
    )
    return _evaluated(targets, {Name(name): column for name, column in zip(variables, rows.T, strict=True)})


def _evaluated(targets: Sequence[Scalar], names: Mapping[Name, Array]) -> Array | None:
    """Return the targets for rows of values; None for a target that reads sensors, or has a memory."""
    count = len(next(iter(names.values())))
    try:
        return np.stack([np.broadcast_to(evaluate(tree, names), count) for tree in targets], axis=1)
    except DeepbotsError:
        return None
