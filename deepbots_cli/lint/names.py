"""Names and expressions: places that are left to the author (DB109), definitions that nothing uses (DB205),
equality of measurements (DB411), angles that jump (DB506)."""

from __future__ import annotations

import re
from collections.abc import Iterator
from math import pi

from deepbots_cli.analysis import Analysis
from deepbots_cli.compiler.namespace import Origin
from deepbots_cli.compiler.texts import SourceText
from deepbots_cli.diagnostics import Finding, Fix, Span
from deepbots_cli.diagnostics.findings import FILL_IN
from deepbots_cli.document.layout import removal_fix
from deepbots_cli.document.load import setting_path, settings_in
from deepbots_cli.document.nodes import NodePath, node_at
from deepbots_cli.expressions.dimensions import ANGLE
from deepbots_cli.expressions.scalar import EngineRead, Op, Scalar
from deepbots_cli.expressions.types import (
    Constant,
    Invocation,
    Kind,
    Known,
    Operation,
    Reference,
    TypedNode,
    children,
    referenced_names,
    walk,
)
from deepbots_cli.lint.context import RuleContext, rule
from deepbots_cli.program import Program
from deepbots_cli.program.robots import Robot
from deepbots_cli.program.values import Expression

_PLACE = re.compile(rf"^[ \t]*({FILL_IN}\b[^\n]*)", re.MULTILINE)


@rule("DB109", versions="base")
def place_left(context: RuleContext) -> Iterator[Finding]:
    """Report the places that a command left to the author of the scenario."""
    for source in context.checked.document.sources:
        for match in _PLACE.finditer(source.text):
            yield Finding(
                "DB109",
                Span(source, match.start(1), match.end(1)),
                "this place is left to you",
                "write this part of the scenario, or leave it as it is, and remove the comment",
            )


# Unused definitions

_COUNTED_ORIGINS = (Origin.PARAMETER, Origin.ACTION, Origin.FIELD, Origin.AUGMENT, Origin.SIGNAL)


@rule("DB205", versions="every")
def unused_definition(context: RuleContext) -> Iterator[Finding]:
    """Report a definition, a sensor, an actuator or a message value that nothing uses."""
    # With a `role`, the variants are the agents.
    used = {
        name
        for variant in context.checked.variants
        if variant.namespace
        for name, names in variant.namespace.definitions.items()
        if names.uses
    }
    for name, definition in context.namespace.definitions.items():
        is_sensor = definition.path[2:3] == ("sensors",)  # of a robot without `emit`
        if (
            definition.origin in _COUNTED_ORIGINS
            and definition.uses == 0
            and name not in used
            and not is_sensor
        ):
            headline = f"`{name}` is {definition.origin.value} that nothing uses"
            yield Finding(
                "DB205",
                context.values.key_span(definition.path),
                headline,
                "use it, or remove it",
                fix=_removal(context, definition.path),
            )
    yield from _unused_parts(context)


def _removal(context: RuleContext, path: NodePath) -> Fix | None:
    """Return the fix that removes an entry; None where a case, a stage or `tune` sets it or a part of it, and
    for an action beside scripts, which set each action, or with choices, which have other variables."""
    root = context.values.root
    *agent, section, _ = path
    others = node_at(root, *agent, "scripts") or node_at(root, *path, "choices")
    if section == "action" and others:
        return None
    set_paths = (setting_path(root, str(setting[-1])) for setting in settings_in(root))
    return None if any(at[: len(path)] == path for at in set_paths) else removal_fix(root, path)


def _unused_parts(context: RuleContext) -> Iterator[Finding]:
    """Report unused sensors, actuators and received values of a robot."""
    # With a `role`, only the program of an agent, which is a variant, commands its robots.
    variants = (variant.program for variant in context.checked.variants)
    programs = [context.program, *(program for program in variants if program is not None)]
    subjects = {
        subject.name
        for program in programs
        for value in program.computed_expressions
        for node in walk(value.typed)
        if isinstance(node, Invocation)
        for subject in node.subjects
        if subject.kind in (Kind.SENSOR, Kind.CAMERA)
    }
    for robot in context.program.robots:
        same = [other for program in programs for other in program.robots if other.name == robot.name]
        commands = [command for other in same for command in other.commands]
        emitted = (value for other in same for value in other.emit)
        used = {
            name
            for value in (*emitted, *(command.target for command in commands))
            for name in referenced_names(value.typed)
        }
        driven = {command.actuator.name for command in commands}
        unused = [
            (("sensors", sensor.name), "a sensor that nothing uses", "use it, or remove it")
            for sensor in robot.sensors
            if sensor.name not in used and f"{robot.name}.{sensor.name}" not in subjects
        ]
        unused += [
            (
                ("receive", value.name),
                "sent to a robot that does not use it",
                "use it under `apply`, or remove it",
            )
            for value in robot.receive
            if value.name not in used
        ]
        unused += [
            (
                ("actuators", actuator.name),
                "an actuator without a command",
                "write a command for it under `apply`, or remove it",
            )
            for actuator in robot.actuators
            if actuator.name not in driven
        ]
        for key_path, problem, help in unused:
            path = ("robots", robot.name, *key_path)
            span = context.values.key_span(path)
            # An included robot file may offer more than the task needs.
            if span.source is context.checked.document.source:
                yield Finding(
                    "DB205",
                    span,
                    f"`{path[-1]}` is {problem}",
                    help,
                    fix=_removal(context, path),
                )


# Equality of measurements

_MEASUREMENT_FUNCTIONS = frozenset(
    {
        "position",
        "velocity",
        "angular_velocity",
        "orientation",
        "joint_position",
        "joint_velocity",
        "cross_track_error",
        "arc_length",
    }
)
_SMOOTH_OPERATIONS = frozenset(
    {
        "add",
        "sub",
        "mul",
        "div",
        "neg",
        "abs",
        "hypot",
        "sqrt",
        "pow",
        "sin",
        "cos",
        "tan",
        "atan2",
        "exp",
        "log",
    }
)
"""The operations on a measurement that give a measurement; `clamp`, `min` and `where` give values that can be
met exactly."""


@rule("DB411")
def equality_of_measures(context: RuleContext) -> Iterator[Finding]:
    """Report a condition that requires a measurement to be equal to a number."""
    for value, robot in _written(context):
        for node in walk(value.typed):
            if (
                not isinstance(node, Operation)
                or node.operator not in ("equal", "not_equal")
                or node.args[0].type.boolean
            ):
                continue
            pair = next(
                (
                    pair
                    for pair in (node.args, node.args[::-1])
                    if _equal_by_chance(context.analysis.ideal, value, robot, *pair)
                ),
                None,
            )
            if pair is not None:
                text = _text(context, value, robot)
                measure, constant, comparison = (text.text[part.start : part.end] for part in (*pair, node))
                outcome, sign = (
                    ("is almost never true", "<")
                    if node.operator == "equal"
                    else ("is almost always true", ">")
                )
                is_zero = isinstance(pair[1], Constant) and not any(pair[1].values)
                difference = measure if is_zero else f"{measure} - {_operand(pair[1], constant)}"
                help = f"compare with a tolerance, as in `abs({difference}) {sign} ...`"
                yield Finding("DB411", text.part(node.start, node.end), f"`{comparison}` {outcome}", help)


def _operand(node: TypedNode, text: str) -> str:
    """Return the text of a node as an operand: an operation without parentheses gets some."""
    if not isinstance(node, Operation):
        return text
    is_enclosed = text[0] == "(" and min(part.start for part in node.args) > node.start
    return text if is_enclosed else f"({text})"


def _written(context: RuleContext) -> Iterator[tuple[Expression, Robot | None]]:
    """Yield the expressions of the scenario that are not functions of Python, and the robot of those that a
    robot controller evaluates."""
    program = context.program
    values = dict.fromkeys(value for value in program.computed_expressions if value.foreign is None)
    yield from ((value, None) for value in values)
    for robot in program.robots:
        for value in (*robot.emit, *(command.target for command in robot.commands)):
            yield value, robot


def _text(context: RuleContext, value: Expression, robot: Robot | None) -> SourceText:
    return context.text(f"robots.{value.owner}" if robot else value.owner)


def _equal_by_chance(
    analysis: Analysis, value: Expression, robot: Robot | None, measure: TypedNode, constant: TypedNode
) -> bool:
    if constant.type.known is Known.STEP:
        return False
    if robot is not None:
        parts = analysis.value_on_robot(measure, value.owner, robot.name)
    else:
        parts = analysis.lowered(measure, value.owner)
    owner = robot.name if robot else ""
    names = {f"{owner}.{name}".lstrip(".") for name in referenced_names(measure)}.union(
        *map(analysis.dependencies, parts)
    )
    return names.isdisjoint(_rounded(analysis.program)) and all(
        _is_measurement(analysis, part, {}) for part in parts
    )


def _rounded(program: Program) -> frozenset[str]:
    """Return the readings whose values are met exactly, for a resolution or a range, and the values that
    robots emit from them."""
    names = set()
    for robot in program.robots:
        rounded = {
            sensor.name
            for sensor in robot.sensors
            if sensor.faults is not None
            and (sensor.faults.resolution or sensor.faults.low or sensor.faults.high)
        }
        emitted = {
            value.name for value in robot.emit if not rounded.isdisjoint(referenced_names(value.typed))
        }
        names |= {f"{robot.name}.{name}" for name in rounded | emitted}
    return frozenset(names)


def _is_measurement(analysis: Analysis, node: Scalar, results: dict[int, bool]) -> bool:
    """Return whether a value is a measurement; `results` has the results for quantities that were checked
    before."""
    number = analysis.identity(node)
    if number not in results:
        match analysis.resolve_aliases(node):
            case EngineRead(function, subjects):
                fixed = {body.name for body in analysis.program.world.objects if body.fixed}
                results[number] = function in _MEASUREMENT_FUNCTIONS and fixed.isdisjoint(
                    subject.partition("#")[0] for subject in subjects
                )
            case Op(op, args):
                results[number] = op in _SMOOTH_OPERATIONS and any(
                    _is_measurement(analysis, arg, results) for arg in args
                )
            case _:
                results[number] = False
    return results[number]


# Angles that jump

_WRAPPING_FUNCTIONS = frozenset({"yaw", "bearing", "path_bearing", "atan2", "wrap"})
"""The functions that go from 180 deg to -180 deg within a step."""
_PERIODIC_FUNCTIONS = frozenset({"wrap", "sin", "cos", "tan"})
"""The functions for which a full turn makes no difference."""


@rule("DB506")
def angle_jumps(context: RuleContext) -> Iterator[Finding]:
    """Report the change of a heading, or the difference of two headings, that jumps by a full turn at 180
    deg."""
    jumping: dict[str, bool] = {}
    for value, on in _written(context):
        for node in _AngleWrapping(context.analysis, on, jumping).jumps(value.typed):
            text = _text(context, value, on)
            angle_text = text.text[node.start : node.end]
            span = text.part(node.start, node.end)
            yield Finding(
                "DB506",
                span,
                f"`{angle_text}` jumps by a full turn at 180 deg",
                f"take the shorter way round: `wrap({angle_text})`",
            )


class _AngleWrapping:
    """Finds the angles that wrap around at 180 deg, in expressions of the supervisor or of a robot
    controller.

    `known` has the results for names of the supervisor.
    """

    def __init__(self, analysis: Analysis, robot: Robot | None, wraps_by_name: dict[str, bool]) -> None:
        self._analysis = analysis
        self._robot = robot
        self._known = wraps_by_name

    def jumps(self, node: TypedNode) -> Iterator[TypedNode]:
        """Yield the parts of an expression that jump."""
        match node:
            case Invocation(function=function) if function in _PERIODIC_FUNCTIONS:
                return
            case Invocation(function="delta", args=(inner, *_)) if self._wraps(inner):
                yield node
                return
            case Operation(operator="sub", args=(a, b)) if self._differ(a, b) or self._differ(b, a):
                yield node
                return
        for part in children(node):
            yield from self.jumps(part)

    def _differ(self, heading: TypedNode, second: TypedNode) -> bool:
        """Return whether two angles can lie on both sides of 180 deg; a constant near 0 cannot."""
        interval = second.type.interval
        return self._wraps(heading) and (
            self._wraps(second) or (interval.is_finite and max(-interval.low, interval.high) > pi / 2 + 1e-9)
        )

    def _wraps(self, node: TypedNode) -> bool:
        if node.type.dimension != ANGLE or node.type.known is not Known.STEP:
            return False
        match node:
            case Invocation(function=function):
                return function in _WRAPPING_FUNCTIONS
            case Operation(operator="add" | "sub" | "neg", args=args):
                return any(self._wraps(arg) for arg in args)
            case Reference(symbol=symbol) if self._robot is not None:
                return any(
                    sensor.name == symbol.name and sensor.kind == "compass" for sensor in self._robot.sensors
                )
            case Reference(symbol=symbol):
                return self._name_wraps(symbol.name)
            case _:
                return False

    def _name_wraps(self, name: str) -> bool:
        if name not in self._known:
            robot = next(
                (robot for robot in self._analysis.program.robots if name.startswith(f"{robot.name}.")), None
            )
            definition = self._analysis.expression_named(name)
            inner = _AngleWrapping(self._analysis, robot, self._known)
            self._known[name] = (
                definition is not None and definition.foreign is None and inner._wraps(definition.typed)
            )
        return self._known[name]
