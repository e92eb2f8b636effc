"""What may be printed: a compiled scenario from elsewhere is checked before a line of Python is made of it.

The compiler checks what users write. A run directory may come from anyone, though, and its compiled
scenario is printed and run when the policy is evaluated. So every word that would stand in the code
outside of quotes must be an identifier of the language or an entry of a table.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import fields, is_dataclass
from graphlib import CycleError, TopologicalSorter

from deepbots_cli.canonical import CanonicalError
from deepbots_cli.compiler.emit.text import action_variables, flat
from deepbots_cli.compiler.sensors import SENSOR_KINDS
from deepbots_cli.ir import MOST_BODIES, MOST_SETTLING_STEPS, MOST_SUBSTEPS, Choices, CompiledScenario, Ending
from deepbots_cli.lang.emit import PYTHON
from deepbots_cli.lang.scalar import Draw, Name, Op, State, World
from deepbots_cli.lang.state import RULES

_NAME = re.compile(r"[a-z_][a-z0-9_]*", re.ASCII)
_DRAWS = frozenset({"uniform", "integer", "normal", "choice"})
_BUILT_IN = tuple((name, None) for name in ("time", "step", "terminated", "truncated", "ended"))
_MOST_TICKS = 1e12  # centuries
# The least and the greatest number of arguments; what is not here takes one or more.
_ARGUMENTS: dict[str, tuple[int, float]] = {
    **dict.fromkeys(("neg", "not", "abs", "wrap", "sqrt", "exp", "log", "sin", "cos", "tan"), (1, 1)),
    **dict.fromkeys(("running_max", "running_min", "integral", "duration", "rising"), (1, 1)),
    **dict.fromkeys(("delta", "previous"), (1, 2)),
    **dict.fromkeys(("sub", "mul", "div", "pow", "atan2", "hold", "smooth", "uniform", "integer", "normal"), (2, 2)),
    **dict.fromkeys(("less", "less_equal", "greater", "greater_equal", "equal", "not_equal"), (2, 2)),
    **dict.fromkeys(("min", "max"), (2, math.inf)),
    **dict.fromkeys(("where", "clamp"), (3, 3)),
    "accumulate": (4, 4),
}
_FACTS: dict[str, tuple[str | None, ...]] = {
    **dict.fromkeys(("position", "velocity", "angular_velocity"), ("x", "y", "z")),
    "orientation": ("x", "y", "z", "w"),
    **dict.fromkeys(("joint_position", "joint_velocity", "joint_torque"), (None,)),
}


def check_printable(scenario: CompiledScenario) -> None:
    """Refuse what the compiler would never have written.

    Raises:
        CanonicalError: A name is no identifier or defined nowhere, an operation, draw, fact or sensor is not in its
            table, or a figure that the code is made with is out of all bounds.
    """
    for name in _defined_names(scenario):
        if not _NAME.fullmatch(name):
            raise CanonicalError(f"{name[:40]!r} is no name that a scenario may define")
    for node in _nodes(scenario):
        _require_arguments(node)
        match node:
            case Op(op=word) if word != "pow" and word not in PYTHON:
                raise CanonicalError(f"{word[:40]!r} is no operation")
            case State(function=word) if word not in RULES:
                raise CanonicalError(f"{word[:40]!r} is no stateful function")
            case Draw(distribution=word) if word not in _DRAWS:
                raise CanonicalError(f"{word[:40]!r} is no distribution")
            case World(function=word, subjects=subjects, component=component):
                joint = word.startswith("joint_")
                if component not in _FACTS.get(word, ()) or len(subjects) != 1 or (joint and "." not in subjects[0]):
                    raise CanonicalError(f"{word[:40]!r} of {str(subjects)[:60]} is nothing that an engine can tell")

    _require_figures(scenario)
    _require_counts(scenario)
    _require_known_names(scenario)
    _require_order(scenario.endings)


def _require_arguments(node: Op | State | Draw | World | Name) -> None:
    """As many arguments as the operation, stateful function or draw takes; an unknown one is refused by its name."""
    match node:
        case Op(op=word, args=args) | State(function=word, args=args) | Draw(distribution=word, args=args):
            least, most = _ARGUMENTS.get(word, (1, math.inf))
            if not least <= len(args) <= most:
                raise CanonicalError(f"{word[:40]!r} of {len(args)} arguments")


def _require_counts(scenario: CompiledScenario) -> None:
    """A value for each component, variable, joint and field of a message; at least one option and one reward; stamps of 32 bits."""
    robots = scenario.robots
    named = [*scenario.parameters, *scenario.signals, *(entry for robot in robots for entry in (*robot.emit, *robot.receive))]
    pairs = [(entry.name, len(entry.values), len(entry.components or (None,))) for entry in named]
    pairs.append(("reward", len(scenario.reward), max(1, len(scenario.reward))))
    for part in scenario.action:
        if isinstance(part, Choices):
            pairs += [(option.name, len(option.values), len(part.variables)) for option in part.options]
            pairs.append((part.name, len(part.options), max(1, len(part.options))))
    for robot in robots:
        driven = {actuator.name: len(actuator.joints) for actuator in robot.actuators}
        pairs += [(entry.name, len(entry.values), driven.get(entry.name, 0)) for entry in robot.apply]
        pairs += [(a.name, len(limits), len(a.joints)) for a in robot.actuators for limits in (a.max_torque, a.max_velocity)]
        if not all(0 <= layout.stamp < 2**32 for layout in (robot.to_robot, robot.from_robot)):
            raise CanonicalError(f"a stamp in messages of '{robot.name}' that is not of 32 bits")
        told = ((robot.to_robot, robot.receive), (robot.from_robot, robot.emit))
        pairs += [(robot.name, len(flat(values)), len(layout.fields)) for layout, values in told]
    for name, given, wanted in pairs:
        if given != wanted:
            raise CanonicalError(f"'{name[:40]}' has {given} values where {wanted} are wanted")


def _require_figures(scenario: CompiledScenario) -> None:
    """What is divided by, or counted in, while the code is printed."""
    timestep = scenario.world.timestep
    spans = [(scenario.reset.settle, "settle"), (scenario.truncation.max_time or 0.0, "max_time")]
    if not 1e-9 < timestep < 1e6:
        raise CanonicalError(f"a timestep of {timestep} s")
    for seconds, what in spans:
        if not 0.0 <= seconds / timestep < _MOST_TICKS:
            raise CanonicalError(f"{what} of {seconds} s")
    if not 1 <= scenario.world.substeps <= MOST_SUBSTEPS:
        raise CanonicalError(f"{scenario.world.substeps} substeps")
    if scenario.reset.settle / timestep * scenario.world.substeps > MOST_SETTLING_STEPS * (1 + 1e-9):
        raise CanonicalError(f"settle of {scenario.reset.settle} s")
    if len(scenario.world.robots) + len(scenario.world.objects) > MOST_BODIES:
        raise CanonicalError(f"more than {MOST_BODIES} bodies")
    if scenario.truncation.max_steps is None and scenario.truncation.max_time is None:
        raise CanonicalError("episodes without a limit")
    for entry in scenario.observation:
        if not 1e-300 < entry.high - entry.low < 1e300:
            raise CanonicalError(f"'{entry.name[:40]}' is observed from {entry.low} to {entry.high}")


def _require_known_names(scenario: CompiledScenario) -> None:
    """Each name in an expression is one that the scenario defines, in the scope of the expression."""
    sent = [(f"{robot.name}.{name}", component) for robot in scenario.robots for name, component in flat(robot.emit)]
    acted = [pair for part in scenario.action for pair in action_variables(part)]
    endings = [(ending.name, None) for ending in scenario.endings]
    known = {*flat(scenario.parameters), *flat(scenario.signals), *sent, *acted, *endings, *_BUILT_IN}
    supervisor = [scenario.parameters, scenario.signals, scenario.observation, scenario.reward, scenario.endings, scenario.reset]
    _require_in([*supervisor, *(robot.receive for robot in scenario.robots)], known)
    for robot in scenario.robots:
        for sensor in robot.sensors:
            if sensor.kind not in SENSOR_KINDS or not sensor.subjects:
                raise CanonicalError(f"{sensor.kind[:40]!r} is no sensor kind")
        sensed = [(sensor.name, component) for sensor in robot.sensors for component in (sensor.components or (None,))]
        _require_in([robot.emit], set(sensed))
        _require_in([robot.apply], {*sensed, *flat(robot.receive)})


def _require_order(endings: tuple[Ending, ...]) -> None:
    """Endings may name each other, but not in a circle."""
    names = {ending.name for ending in endings}
    used = {ending.name: {node.name for node in _nodes(ending.condition) if isinstance(node, Name)} & names for ending in endings}
    try:
        TopologicalSorter(used).prepare()
    except CycleError:
        raise CanonicalError("endings that wait for each other") from None


def _require_in(expressions: Iterable[object], known: set[tuple[str, str | None]]) -> None:
    for node in (node for value in expressions for node in _nodes(value)):
        if isinstance(node, Name) and (node.name, node.component) not in known:
            raise CanonicalError(f"{node.name[:40]!r} is not defined")


def _defined_names(scenario: CompiledScenario) -> Iterator[str]:
    for robot in scenario.robots:
        yield robot.name
        for entries in (robot.sensors, robot.actuators, robot.receive, robot.emit, robot.apply):
            yield from (entry.name for entry in entries)
    for named in (scenario.parameters, scenario.signals, scenario.reward, scenario.endings, scenario.action):
        yield from (entry.name for entry in named)
    for part in scenario.action:
        if isinstance(part, Choices):
            yield from part.variables
            yield from (option.name for option in part.options)


def _nodes(value: object) -> Iterator[Op | State | Draw | World | Name]:
    """Every node of every expression, wherever it stands."""
    waiting = [value]
    while waiting:
        here = waiting.pop()
        if isinstance(here, (Op, State, Draw, World, Name)):
            yield here
        if isinstance(here, tuple):
            waiting.extend(here)
        elif is_dataclass(here) and not isinstance(here, type):
            waiting.extend(getattr(here, field.name) for field in fields(here))
