"""Changes of a world and of the actions in it, which may explain a difference."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deepbots_cli.document import MappingNode
from deepbots_cli.document.nodes import entries_at
from deepbots_cli.learning.robustness import (
    DELAY,
    Change,
    Plan,
    delayed,
    friction,
    written,
)
from deepbots_cli.program import Program
from deepbots_cli.program.robots import Thrust

_LONGEST = 0.35
"""The longest time that is tried, in s, unless it has fewer than three timesteps. Amounts are doubled,
starting from one timestep."""
_MAX_MOTORS = 12
"""The largest number of motors whose order is tried."""
Array = NDArray[np.float64]
Act = Callable[[Any], Any]
"""A function that changes an action."""


def doubled_times(timestep: float) -> tuple[float, ...]:
    """Return times in ms, from one timestep on; each is twice the previous one."""
    count = max(3, 1 + int(np.log2(_LONGEST / timestep)))
    return tuple(1000 * timestep * 2**power for power in range(count))


def friction_plans(root: MappingNode, program: Program) -> Iterator[Plan]:
    """Yield another friction of each object that can move."""
    for name in (
        body.name
        for body in program.world.objects
        if not body.fixed and body.name in entries_at(root, "objects")
    ):
        yield Plan("friction", partial(_friction_of, root, name), subject=name)


def _friction_of(root: MappingNode, name: str, factor: float) -> Change:
    return {"objects": {name: friction(root, ("objects", name), factor)}}


def latency_plans(root: MappingNode, program: Program) -> Iterator[Plan]:
    """Yield a larger latency of each sensor."""
    for robot in program.robots:
        for sensor in entries_at(root, "robots", robot.name, "sensors"):
            path = ("robots", robot.name, "sensors", sensor, "latency")
            subject = f"the sensor {robot.name}.{sensor}"
            yield Plan("latency", partial(_later, root, [path]), form=DELAY, subject=subject)


def command_plans(root: MappingNode, program: Program) -> Iterator[Plan]:
    """Yield, for each actuator and for all together, another gain of the command, a delay, and a larger time
    constant."""
    motors = [
        (robot.name, name)
        for robot in program.robots
        for name in entries_at(root, "robots", robot.name, "actuators")
    ]
    groups = {f"{robot}.{name}": [(robot, name)] for robot, name in motors[:_MAX_MOTORS]}
    if len(motors) > 1:
        groups["all actuators"] = motors
    for words, actuators in groups.items():
        paths = [("robots", robot, "apply", name) for robot, name in actuators]
        if commands := [path for path in paths if written(root, *path)]:
            yield Plan("command", partial(_scaled_texts, root, commands), subject=words)
        for key in ("time_constant", "delay"):
            keys = [("robots", robot, "actuators", name, key) for robot, name in actuators]
            yield Plan(key.replace("_", " "), partial(_later, root, keys), form=DELAY, subject=words)


def torque_limits(program: Program) -> Iterator[tuple[Plan, float]]:
    """Yield a lower limit of the torque or force of each motor, and its largest limit in N m or N."""
    models = {robot.name: robot.model for robot in program.world.robots}
    for robot in program.robots:
        for motor in robot.actuators:
            if isinstance(motor, Thrust) or not (limits := [limit for limit in motor.max_torque if limit]):
                continue
            path = ("robots", robot.name, "actuators", motor.name, "max_torque")
            form = "{:g} N" if models[robot.name].joint(motor.joints[0]).type == "prismatic" else "{:g} N*m"
            subject = f"{robot.name}.{motor.name}"
            plan = Plan("torque limit", partial(_limit, path, form), form=form, subject=subject)
            yield plan, max(limits)


def _limit(path: tuple[str, ...], form: str, limit: float) -> Change:
    return _together({path: form.format(limit)})


def _later(root: MappingNode, paths: Sequence[tuple[str, ...]], delay: float) -> Change:
    return _together({path: delayed(delay, written(root, *path)) for path in paths})


def _scaled_texts(root: MappingNode, paths: Sequence[tuple[str, ...]], factor: float) -> Change:
    """Return written values times a factor."""
    return _together({path: f"{factor:g} * ({written(root, *path)})" for path in paths})


def _together(values: Mapping[tuple[str, ...], str]) -> Change:
    """Return a change of the values at several paths."""
    change: Change = {}
    for path, value in values.items():
        section = change
        for key in path[:-1]:
            section = section.setdefault(key, {})
        section[path[-1]] = value
    return change


def changed_actions(program: Program) -> Iterator[tuple[str, str, Act]]:
    """Yield ranges with another sign or order, or options of one choice: the family, the change in words, and
    a function that changes an action."""
    names, choices = program.agent.range_names, program.agent.choices
    if len(choices) == 1 and not names:
        options = choices[0].options
        for first, second in combinations(range(len(options)), 2):
            text = f"the options {options[first].name} and {options[second].name} are swapped"
            yield "order of options", text, _swapped_options(first, second)
    if choices:
        return
    for name, is_part in _parts(program).items():
        yield (
            "sign of actions",
            f"the action {name} has the other sign",
            _negated(np.where(is_part, -1.0, 1.0)),
        )
    for first, second in combinations(range(len(names)), 2) if len(names) <= _MAX_MOTORS else ():
        order = np.arange(len(names))
        order[[first, second]] = second, first
        yield (
            "order of actions",
            f"the actions {names[first]} and {names[second]} are swapped",
            _ordered(order),
        )


def action_gains(program: Program) -> Iterator[tuple[str, Callable[[float], Act]]]:
    """Yield actions of ranges with another gain."""
    if program.agent.choices:
        return
    # The value of an action is its middle plus a share of its half width, so a gain also moves the share
    # where the middle is not 0.
    middles = np.array(
        [
            (interval.high + interval.low) / (interval.high - interval.low)
            for interval in program.agent.ranges
            for _ in interval.names
        ]
    )
    for name, is_part in _parts(program).items():
        yield f"the action {name}", partial(_scaled, is_part, middles)


def _parts(program: Program) -> dict[str, NDArray[np.bool_]]:
    """Return, by name, each range, and each component of a vector unless there are many, as a mask over the
    numbers of an action."""
    names = program.agent.range_names
    parts = {
        interval.name: np.array([name in interval.names for name in names])
        for interval in program.agent.ranges
    }
    components = {name: np.array([name == other for other in names]) for name in names}
    return parts | components if len(names) <= _MAX_MOTORS else parts


def always(act: Act, _: float) -> Act:
    return act


def _swapped_options(first: int, second: int) -> Callable[[Any], Any]:
    return lambda action: {first: second, second: first}.get(int(action), action)


def _negated(signs: Array) -> Callable[[Any], Any]:
    return lambda action: np.asarray(action * signs, action.dtype)


def _scaled(is_part: NDArray[np.bool_], middles: Array, factor: float) -> Callable[[Any], Any]:
    factors = np.where(is_part, factor, 1.0)
    return lambda action: np.asarray(
        np.clip(factors * action + (factors - 1.0) * middles, -1.0, 1.0), action.dtype
    )


def _ordered(order: Any) -> Callable[[Any], Any]:
    return lambda action: action[order]
