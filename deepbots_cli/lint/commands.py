"""Rules about what robots are told to do, and what their actuators can, in the family DB3."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import ceil, inf, radians
from typing import TypeGuard

from deepbots_cli import frames
from deepbots_cli.compiler import Checked
from deepbots_cli.compiler.robots import carries, joint_dimension
from deepbots_cli.compiler.values import Values
from deepbots_cli.diagnostics import Finding, Label, Span
from deepbots_cli.expressions.dimensions import TIME
from deepbots_cli.expressions.intervals import Interval, hull
from deepbots_cli.expressions.scalar import Const, Name, Op, Scalar
from deepbots_cli.footprint import link_frames
from deepbots_cli.frames import Frame, Triple
from deepbots_cli.lint.meaning import Book, book_of
from deepbots_cli.lint.reach import NEVER, reach_of
from deepbots_cli.lint.start import AtStart
from deepbots_cli.lint.wording import figure, span_of
from deepbots_cli.program.robots import Actuator, Cartesian, Command, Motor, Robot, Thrust
from deepbots_cli.program.world import RobotBody
from deepbots_cli.robots.inertia import matrix
from deepbots_cli.robots.model import Joint, RobotModel

_VAGUE = 0.2  # rad or m; where a joint begins is known if it is drawn from no more

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
    if checked.program is None:
        return
    book = book_of(checked.program)
    models = {robot.name: robot.model for robot in checked.program.world.robots}
    for robot in checked.program.robots:
        for command in robot.commands:
            yield from _cut_off(book, robot, models[robot.name], command)


def _cut_off(book: Book, robot: Robot, model: RobotModel, command: Command) -> Iterator[Finding]:
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


def _limits(actuator: Actuator, model: RobotModel) -> Interval | None:
    """What all its joints or links can do; None where that has no end."""
    match actuator:
        case Thrust(low=low, high=high):
            return Interval(low, high)
        case Motor(kind="position_motor", joints=joints):
            stops = [model.joint(joint).limit for joint in joints]
            return _within([(stop.lower, stop.upper) for stop in stops])
        case Motor(kind=kind, max_torque=torques, max_velocity=speeds):
            return _within([(None if most is None else -most, most) for most in (torques if kind == "torque_motor" else speeds)])
        case _:
            return None


def _within(ends: list[tuple[float | None, float | None]]) -> Interval | None:
    known = [Interval(low, high) for low, high in ends if low is not None and high is not None and low < high]
    return hull(known) if len(known) == len(ends) else None


def _is_decided(book: Book, target: Scalar, robot: Robot) -> bool:
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
    if checked.program is None or checked.namespace is None:
        return
    values = checked.namespace.values
    for robot in checked.program.robots:
        holding: dict[str, str] = {}
        for command in robot.commands:
            name = command.actuator.name
            shared = next((joint for joint in _held(command.actuator) if joint in holding), None)
            if shared is not None:
                first, second = (_joints_span(values, robot.name, called) for called in (holding[shared], name))
                headline = f"`{name}` drives the joint `{shared}`, which `{holding[shared]}` drives already"
                yield Finding("DB313", second, headline, help="give each joint one motor", also=(Label(first, "driven here"),))
            holding |= dict.fromkeys(_held(command.actuator), name)


def _held(actuator: Actuator) -> tuple[str, ...]:
    """The joints that the motors of the engine hold for it."""
    match actuator:
        case Motor(kind="velocity_motor" | "position_motor", stiffness=None) | Cartesian():
            return actuator.joints
        case _:
            return ()


def _joints_span(values: Values, robot: str, actuator: str) -> Span:
    place = ("robots", robot, "actuators", actuator)
    key = next((key for key in ("joint", "joints") if values.stands((*place, key))), None)
    return values.span((*place, key)) if key else values.key_span(place)


def limp_at_start(checked: Checked) -> Iterator[Finding]:
    """DB314: an arm sinks at the start of an episode, since the first command reaches its torque motors late.

    Until then a torque motor exerts nothing, while motors that are commanded a position or a speed hold. Told of joints of robots on a
    fixed base that gravity moves by more than 2 deg or 5 mm in this time, against no more torque than the motor could hold them with.

    Example::

        messages: {to_robot: {latency: 100 ms}}
        robots:
          arm:
            urdf: package://pybullet_data/kuka_iiwa/model.urdf
            base: fixed
            pose: {y: 2 m}
            actuators: {shoulder: {type: torque_motor, joint: lbr_iiwa_joint_2}}
            emit: []
            apply: {shoulder: -60 N*m}
        reset: {set: {arm.lbr_iiwa_joint_2: 60 deg}}

    Instead::

        messages: {to_robot: {latency: 100 ms}}
        robots:
          arm:
            urdf: package://pybullet_data/kuka_iiwa/model.urdf
            base: fixed
            pose: {y: 2 m}
            actuators: {shoulder: {type: position_motor, joint: lbr_iiwa_joint_2}}
            emit: []
            apply: {shoulder: 60 deg}
        reset: {set: {arm.lbr_iiwa_joint_2: 60 deg}}
    """
    program = checked.program
    if (
        program is None
        or checked.namespace is None
        or program.reset.settle
        or any(varied.what == "gravity" for varied in program.reset.variations)
    ):
        return
    book, values = book_of(program), checked.namespace.values
    bodies = {body.name: body for body in program.world.robots}
    for robot in program.robots:
        held = {joint for command in robot.commands if not _is_limp(command.actuator) for joint in getattr(command.actuator, "joints", ())}
        limp = [command.actuator for command in robot.commands if _is_limp(command.actuator)]
        positions = _start_positions(book, bodies[robot.name]) if limp else None
        ticks = int(program.timing == "paper")
        if robot.to_route.latency is not None:
            latency = reach_of(book).of(book.scalars(robot.to_route.latency)[0]).low
            ticks += ceil(latency / program.world.timestep - 1e-9) if latency > 0.0 else 0
        for motor in limp:
            wait = ticks * program.world.timestep + motor.response.delay
            joints = {joint: most for joint, most in zip(motor.joints, motor.max_torque, strict=True) if joint not in held}
            if positions is None or wait <= program.world.timestep:
                continue
            sunk = _sunk(bodies[robot.name], positions, joints, program.world.gravity, wait)
            if sunk is not None:
                by = figure(sunk[1], joint_dimension(sunk[0]))
                headline = f"`{motor.name}` exerts nothing for the first {figure(wait, TIME)}, and `{sunk[0].name}` sinks by about {by}"
                help = "hold the joint with a `position_motor`, or let the first command come sooner"
                late = ("messages", "to_robot", "latency")
                also = (Label(values.span(late), "what it waits for"),) if values.stands(late) else ()
                yield Finding("DB314", values.key_span(("robots", robot.name, "actuators", motor.name)), headline, help=help, also=also)


def _is_limp(actuator: Actuator) -> TypeGuard[Motor]:
    """Whether it exerts nothing until its first command."""
    return isinstance(actuator, Motor) and (actuator.kind == "torque_motor" or actuator.stiffness == 0.0)


def _start_positions(book: Book, body: RobotBody) -> dict[str, float] | None:
    """Where the joints of a robot on a fixed base begin, as far as the text tells; None for one that stands or begins anyhow."""
    start = AtStart(book)
    tilts = any(place.body == body.name and place.coordinates.keys() & {"roll", "pitch"} for place in book.program.reset.placements)
    if not body.fixed_base or tilts:
        return None
    found = {joint.name: start.joint(f"{body.name}.{joint.name}") or NEVER for joint in body.model.moving_joints}
    if any(interval.high - interval.low > _VAGUE for interval in found.values()):
        return None
    return {name: (interval.low + interval.high) / 2 for name, interval in found.items()}


def _sunk(
    body: RobotBody, positions: Mapping[str, float], joints: Mapping[str, float | None], gravity: Triple, time: float
) -> tuple[Joint, float] | None:
    """The one of some joints (with the most that their motors exert) that gravity moves farthest in a time, and how far (rad or m)."""
    where = link_frames(body.model, positions)
    pull = frames.rotate_back(frames.frame(body.pose)[1], gravity)
    moved = {name: _moved(body.model, where, body.model.joint(name), most, pull, time) for name, most in joints.items()}
    name = max(moved, key=lambda joint: moved[joint], default="")
    if not name:
        return None
    joint = body.model.joint(name)
    return (joint, moved[name]) if moved[name] > (0.005 if joint.type == "prismatic" else radians(2.0)) else None


def _moved(model: RobotModel, where: Mapping[str, Frame], joint: Joint, most: float | None, pull: Triple, time: float) -> float:
    """How far gravity moves a joint, while the others keep still; 0 where its motor could not hold it."""
    pivot, turned = where[joint.child]
    axis = frames.rotate(turned, joint.axis)
    load = inertia = 0.0
    for link in model.links:
        if link.inertial is None or not carries(model, joint, link.name):
            continue
        mass = link.inertial.mass
        centre, own = frames.inside(where[link.name], frames.frame(link.inertial.origin))
        if joint.type == "prismatic":
            load, inertia = load + mass * frames.dot(axis, pull), inertia + mass
            continue
        arm = frames.cross(axis, frames.subtract(centre, pivot))
        local = frames.rotate_back(own, axis)
        spin = sum(local[i] * row[j] * local[j] for i, row in enumerate(matrix(link.inertial)) for j in range(3))
        load, inertia = load + mass * frames.dot(arm, pull), inertia + mass * frames.dot(arm, arm) + spin
    excess = abs(load) - joint.friction
    if excess <= 0.0 or inertia <= 0.0 or (most is not None and abs(load) > most):
        return 0.0
    return min(excess / inertia * time * time / 2, excess / joint.damping * time if joint.damping > 0.0 else inf)


RULES = (command_cut_off, joint_driven_twice, limp_at_start)
