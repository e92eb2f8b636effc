"""Rules about names."""

from __future__ import annotations

from collections.abc import Iterator

from deepbots_cli.compiler import Checked
from deepbots_cli.compiler.namespace import Namespace, Origin
from deepbots_cli.diagnostics import Finding
from deepbots_cli.document.layout import removing
from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions.types import Invocation, Kind, Reference, Typed, children
from deepbots_cli.program import Program
from deepbots_cli.program.values import Expression

_COUNTED = (Origin.PARAMETER, Origin.ACTION, Origin.FIELD, Origin.AUGMENT, Origin.SIGNAL)


def unused_definition(checked: Checked) -> Iterator[Finding]:
    """DB205: something is defined and never used: a parameter, action variable, field, signal, sensor or actuator, or sent in vain.

    Most often it is a misspelling elsewhere, or what remains of an earlier version. A sensor is of use if it is sent or used on
    board. An actuator without a command is left alone: the joint swings as if there were no motor. What an included robot file
    offers besides may stay unused: it describes the robot, not the task. What a file writes and removes has no effect either.

    Example::

        signals: {away: abs(x)}
        robots: {cart: {sensors: {rolling: {type: joint_velocity, joints: [wheel_*]}}}}

    Instead::

        signals: {away: abs(x)}
        reward: {centred: -away / m}
        robots:
          cart:
            sensors: {rolling: {type: joint_velocity, joints: [wheel_*]}}
            emit: [pole_angle, rolling]
        observation: {cart.rolling: -10 .. 10 rad/s}
    """
    if checked.namespace is None:
        return
    yield from _unused_names(checked, checked.namespace)
    if checked.program is not None:
        yield from _unused_parts(checked, checked.program)


def _unused_names(checked: Checked, namespace: Namespace) -> Iterator[Finding]:
    used = {name for each in checked.variants if each.namespace for name, known in each.namespace.definitions.items() if known.uses}
    for name, definition in namespace.definitions.items():
        if definition.origin in _COUNTED and definition.uses == 0 and name not in used:
            values, headline = namespace.values, f"`{name}` is {definition.origin.value} that nothing uses"
            fix = removing(values.root, definition.path)
            yield Finding("DB205", values.key_span(definition.path), headline, help="use it or take it out", fix=fix)


def _unused_parts(checked: Checked, program: Program) -> Iterator[Finding]:
    """Sensors and actuators of a robot, and what it is sent."""
    looking = {part for value in _judged(program) for part in _sensors(value.typed)}
    for robot in program.robots:
        used = {name for value in (*robot.emit, *(command.target for command in robot.commands)) for name in _names(value.typed)}
        driven = {command.actuator.name for command in robot.commands}
        for sensor in robot.sensors:
            if sensor.name not in used and f"{robot.name}.{sensor.name}" not in looking:
                what, help = "a sensor that nothing reads", "send it under `emit`, or take it out"
                yield from _idle(checked, ("robots", robot.name, "sensors", sensor.name), what, help)
        for value in robot.receive:
            if value.name not in used:
                what, help = "sent to a robot that does not use it", "use it under `apply`, or take it out"
                yield from _idle(checked, ("robots", robot.name, "receive", value.name), what, help)
        for actuator in robot.actuators:
            if actuator.name not in driven:
                what, help = "an actuator that nothing drives", "give it a command under `apply`, or take it out"
                yield from _idle(checked, ("robots", robot.name, "actuators", actuator.name), what, help)


def _idle(checked: Checked, path: Path, what: str, help: str) -> Iterator[Finding]:
    """The finding, where the part is written in the scenario's own file."""
    assert checked.namespace is not None  # there is a task
    values = checked.namespace.values
    span = values.key_span(path)
    if span.source is checked.document.source:
        yield Finding("DB205", span, f"`{path[-1]}` is {what}", help=help, fix=removing(values.root, path))


def _judged(program: Program) -> Iterator[Expression]:
    """What the supervisor computes."""
    yield from program.signals
    yield from program.reward
    if program.goal is not None:
        yield from (program.goal.achieved, program.goal.desired)
    yield from (ending.value for ending in program.endings)
    for script in program.scripts:
        for part in script.parts:
            yield from part.values
    for robot in program.robots:
        yield from robot.receive


def _sensors(value: Typed) -> Iterator[str]:
    """The sensors that functions are asked about."""
    if isinstance(value, Invocation):
        yield from (subject.name for subject in value.subjects if subject.kind in (Kind.SENSOR, Kind.CAMERA))
    for part in children(value):
        yield from _sensors(part)


def _names(value: Typed) -> Iterator[str]:
    if isinstance(value, Reference):
        yield value.symbol.name
    for part in children(value):
        yield from _names(part)


RULES = (unused_definition,)
