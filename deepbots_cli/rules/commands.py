"""Rules about what robots are told to do, and what their actuators can, in the family DB3."""

from __future__ import annotations

from collections.abc import Iterator

from deepbots_cli import ir
from deepbots_cli.compiler import Checked
from deepbots_cli.compiler.values import Values
from deepbots_cli.diagnostics import Finding, Label, Span
from deepbots_cli.lang.intervals import Interval, hull
from deepbots_cli.lang.scalar import Const, Name, Op, Scalar
from deepbots_cli.rules.meaning import Book, book_of
from deepbots_cli.rules.reach import reach_of
from deepbots_cli.rules.wording import span_of
from deepbots_cli.task import Command, TaskRobot
from deepbots_cli.urdf.model import RobotModel

_LITTLE = 0.25
"""Of what the agent can ask for, the share that an actuator has to be able to do."""


def command_cut_off(checked: Checked) -> Iterator[Finding]:
    """DB312: an actuator cuts off most of what the agent can ask it for, so that most actions do the same.

    A speed beyond the limit of the motor, a thrust beyond its range, a position beyond the stop of the joint: all of them are brought to
    the limit. Where less than a quarter of what an action can mean lies within, the agent has to find the few actions that make a
    difference, and the noise of its exploration makes none. Commands that depend on what the robot senses are not meant.

    Example::

        parameters: {wheel_speed: 500 rad/s}
        action: {drive: -1 .. 1}

    Instead::

        parameters: {wheel_speed: 10 rad/s}
        action: {drive: -1 .. 1}
    """
    if checked.task is None:
        return
    book = book_of(checked.task)
    models = {robot.name: robot.model for robot in checked.task.world.robots}
    for robot in checked.task.robots:
        for command in robot.commands:
            yield from _cut_off(book, robot, models[robot.name], command)


def _cut_off(book: Book, robot: TaskRobot, model: RobotModel, command: Command) -> Iterator[Finding]:
    trees = book.on_board(command.target, robot.name)
    limits = Interval(0.0, 1.0) if command.opening else _limits(command.actuator, model)
    if limits is None or not all(_is_decided(book, tree, robot) for tree in trees):
        return
    asked = hull([reach_of(book).of(tree) for tree in trees])
    done = min(asked.high, limits.high) - max(asked.low, limits.low)
    if asked.finite and not asked.single and done < _LITTLE * (asked.high - asked.low):
        dimension = command.target.typed.type.dimension
        headline = f"`{command.actuator.name}` is asked for {span_of(asked, dimension)}, and can do {span_of(limits, dimension)}"
        yield Finding("DB312", command.target.span, headline, help="let the action, or what multiplies it, go as far as the actuator does")


def _limits(actuator: ir.Actuator, model: RobotModel) -> Interval | None:
    """What all its joints or links can do; None where that has no end."""
    match actuator:
        case ir.Thrust(low=low, high=high):
            return Interval(low, high)
        case ir.Motor(kind="position_motor", joints=joints):
            stops = [model.joint(joint).limit for joint in joints]
            return _within([(stop.lower, stop.upper) for stop in stops])
        case ir.Motor(kind=kind, max_torque=torques, max_velocity=speeds):
            return _within([(None if most is None else -most, most) for most in (torques if kind == "torque_motor" else speeds)])
        case _:
            return None


def _within(ends: list[tuple[float | None, float | None]]) -> Interval | None:
    known = [Interval(low, high) for low, high in ends if low is not None and high is not None and low < high]
    return hull(known) if len(known) == len(ends) else None


def _is_decided(book: Book, target: Scalar, robot: TaskRobot) -> bool:
    """Whether a command follows from the action alone, and from fixed figures."""
    received = {value.name for value in robot.receive}
    for node in book.unfold(target):
        match node:
            case Const() | Op():
                continue
            case Name(name) if book.sensor(node) is None and name.partition(":")[2] not in received:
                continue
            case _:
                return False
    return True


def joint_driven_twice(checked: Checked) -> Iterator[Finding]:
    """DB313: two actuators hold the same joint at a speed or a position, so that what the first is told is lost.

    A joint has one motor, and the last command counts. Most often a line was copied, and the joint on the other side moves by nothing. A
    torque or a spring (`stiffness`) beside a motor adds to it, and is not meant.

    Example::

        robots:
          cart:
            actuators:
              wheels: {type: velocity_motor, joints: ["*_left"], max_torque: 10 N*m}
              right:  {type: velocity_motor, joints: ["*_left"], max_torque: 10 N*m}
            apply: {right: drive * wheel_speed}

    Instead::

        robots:
          cart:
            actuators:
              wheels: {type: velocity_motor, joints: ["*_left"], max_torque: 10 N*m}
              right:  {type: velocity_motor, joints: ["*_right"], max_torque: 10 N*m}
            apply: {right: drive * wheel_speed}
    """
    if checked.task is None or checked.namespace is None:
        return
    values = checked.namespace.values
    for robot in checked.task.robots:
        holding: dict[str, str] = {}
        for command in robot.commands:
            name = command.actuator.name
            shared = next((joint for joint in _held(command.actuator) if joint in holding), None)
            if shared is not None:
                first, second = (_joints_span(values, robot.name, called) for called in (holding[shared], name))
                headline = f"`{name}` drives the joint `{shared}`, which `{holding[shared]}` drives already"
                yield Finding("DB313", second, headline, help="give each joint one motor", also=(Label(first, "driven here"),))
            holding |= dict.fromkeys(_held(command.actuator), name)


def _held(actuator: ir.Actuator) -> tuple[str, ...]:
    """The joints that the motors of the engine hold for it."""
    match actuator:
        case ir.Motor(kind="velocity_motor" | "position_motor", stiffness=None) | ir.Cartesian():
            return actuator.joints
        case _:
            return ()


def _joints_span(values: Values, robot: str, actuator: str) -> Span:
    place = ("robots", robot, "actuators", actuator)
    key = next((key for key in ("joint", "joints") if values.stands((*place, key))), None)
    return values.span((*place, key)) if key else values.key_span(place)


RULES = (command_cut_off, joint_driven_twice)
