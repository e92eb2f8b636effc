"""Changes of a world and of the actions in it, which may explain a difference."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
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
    joined,
    movable_objects,
    scaled,
    written,
)
from deepbots_cli.program import Program
from deepbots_cli.program.robots import Thrust

_LONGEST = 0.35
"""The longest time that is tried, in s. Three times are always tried: those of 1, 2 and 4 timesteps. Further
ones are twice as long as the one before."""
_MAX_SINGLE = 12
"""The largest number of actuators, or of numbers of an action, that are changed one by one."""
Array = NDArray[np.float64]
Act = Callable[[Any], Any]
"""A function that changes an action."""


def doubled_times(timestep: float) -> tuple[float, ...]:
    """Return times in ms, from one timestep on; each is twice the previous one."""
    count = max(3, 1 + int(np.log2(_LONGEST / timestep)))
    return tuple(1000 * timestep * 2**power for power in range(count))


def friction_plans(root: MappingNode, program: Program) -> Iterator[Plan]:
    """Yield, for each object that can move, a plan that multiplies its friction."""
    for name in movable_objects(root, program):
        yield Plan("friction", partial(_friction_of, root, name), subject=name)


def _friction_of(root: MappingNode, name: str, factor: float) -> Change:
    return {"objects": {name: friction(root, ("objects", name), factor)}}


def latency_plans(root: MappingNode, program: Program) -> Iterator[Plan]:
    """Yield, for each sensor, a plan that adds to its latency."""
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
    groups = {f"{robot}.{name}": [(robot, name)] for robot, name in motors[:_MAX_SINGLE]}
    if len(motors) > 1:
        groups["all actuators"] = motors
    for words, actuators in groups.items():
        apply_paths = [("robots", robot, "apply", name) for robot, name in actuators]
        if commands := [path for path in apply_paths if written(root, *path)]:
            yield Plan("command", partial(_scaled_texts, root, commands), subject=words)
        for key in ("time_constant", "delay"):
            paths = [("robots", robot, "actuators", name, key) for robot, name in actuators]
            yield Plan(key.replace("_", " "), partial(_later, root, paths), form=DELAY, subject=words)


def torque_limits(program: Program) -> Iterator[tuple[Plan, float]]:
    """Yield, for each motor, a plan that sets its limit of torque or force, and its largest present limit in
    N m or N."""
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
    return joined({path: form.format(limit)})


def _later(root: MappingNode, paths: Sequence[tuple[str, ...]], delay: float) -> Change:
    return joined({path: delayed(delay, written(root, *path)) for path in paths})


def _scaled_texts(root: MappingNode, paths: Sequence[tuple[str, ...]], factor: float) -> Change:
    """Return written values times a factor."""
    return joined({path: scaled(factor, written(root, *path) or "") for path in paths})


def changed_actions(program: Program) -> Iterator[tuple[str, Act]]:
    """Yield ranges with another sign or order, or options of one choice: the change in words, and
    a function that changes an action."""
    names, choices = program.agent.range_names, program.agent.choices
    if len(choices) == 1 and not names:
        options = choices[0].options
        for first, second in combinations(range(len(options)), 2):
            text = f"the options {options[first].name} and {options[second].name} are swapped"
            yield text, _swapped_options(first, second)
    if choices:
        return
    for name, is_part in _parts(program).items():
        yield (
            f"the action {name} has the other sign",
            _negated(np.where(is_part, -1.0, 1.0)),
        )
    for first, second in combinations(range(len(names)), 2) if len(names) <= _MAX_SINGLE else ():
        order = np.arange(len(names))
        order[[first, second]] = second, first
        yield (
            f"the actions {names[first]} and {names[second]} are swapped",
            _ordered(order),
        )


def action_gains(program: Program) -> Iterator[tuple[str, Callable[[float], Act]]]:
    """Yield, for each part of an action of ranges, its name and a function that returns the change of the
    action by a gain."""
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
    return parts | components if len(names) <= _MAX_SINGLE else parts


def without_amount(act: Act, _: float) -> Act:
    """Return the change of an action for any amount."""
    return act


def _swapped_options(first: int, second: int) -> Act:
    return lambda action: {first: second, second: first}.get(int(action), action)


def _negated(signs: Array) -> Act:
    return lambda action: np.asarray(action * signs, action.dtype)


def _scaled(is_part: NDArray[np.bool_], middles: Array, factor: float) -> Act:
    factors = np.where(is_part, factor, 1.0)
    return lambda action: np.asarray(
        np.clip(factors * action + (factors - 1.0) * middles, -1.0, 1.0), action.dtype
    )


def _ordered(order: Any) -> Act:
    return lambda action: action[order]
