"""Commands and actuators of robots (DB312 to DB315)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import ceil, degrees, inf, radians
from typing import TypeGuard

from deepbots_cli import frames
from deepbots_cli.compiler.robots import carries, joint_dimension
from deepbots_cli.compiler.values import Values
from deepbots_cli.diagnostics import Finding, Label, Span
from deepbots_cli.expressions.dimensions import TIME
from deepbots_cli.expressions.intervals import NEVER, Interval, hull
from deepbots_cli.expressions.scalar import Const, Name, Op, Scalar
from deepbots_cli.footprint import link_frames
from deepbots_cli.frames import Frame, Triple
from deepbots_cli.lint.analysis import Analysis
from deepbots_cli.lint.context import Context
from deepbots_cli.lint.ranges import range_text, with_unit
from deepbots_cli.lint.simulation import Miss, Simulation, Where
from deepbots_cli.program.robots import Actuator, Cartesian, CustomActuator, Motor, Robot, Thrust
from deepbots_cli.program.world import RobotBody
from deepbots_cli.robots.inertia import matrix
from deepbots_cli.robots.model import Joint, RobotModel

_KNOWN_WITHIN = 0.2
"""rad or m; the initial position of a joint counts as known if it is drawn from no more."""
_MIN_SHARE = 0.25
"""Share of what the agent can ask for that an actuator must be able to do."""
_OFTEN = 0.1
"""Share of the commands of an episode: a script may pass over what is out of reach on its way."""
_SLIGHT_DISTANCE, _SLIGHT_ANGLE = 0.001, radians(0.5)
"""m, rad; a finding mentions a smaller miss only by the other measure."""


def command_cut_off(context: Context) -> Iterator[Finding]:
    """DB312: an actuator cuts off most of the commands that the agent can give, so that most actions have the same effect.

    A speed beyond the limit of the motor, a thrust beyond its range and a position beyond the stop of the joint are clipped. Where less
    than a quarter of the range of commands can be followed, the agent has to find the few actions that make a difference, and the noise
    of its exploration makes none. Commands that depend on sensors are not reported.

    Example::

        parameters: {wheel_speed: 500 rad/s}
        action: {drive: -1 .. 1}

    Instead::

        parameters: {wheel_speed: 10 rad/s}
        action: {drive: -1 .. 1}
    """
    analysis = context.analysis
    for robot in context.program.robots:
        for command in robot.commands:
            trees = analysis.on_board(command.target, robot.name)
            limits = Interval(0.0, 1.0) if command.opening else _limits(command.actuator, analysis.body(robot.name).model)
            if limits is None or not all(_follows_action(analysis, tree, robot) for tree in trees):
                continue
            asked = hull([analysis.ranges.of(tree) for tree in trees])
            done = min(asked.high, limits.high) - max(asked.low, limits.low)
            if asked.finite and not asked.single and done < _MIN_SHARE * (asked.high - asked.low):
                dimension = command.target.typed.type.dimension
                able = f"is asked for {range_text(asked, dimension)}, and can do {range_text(limits, dimension)}"
                help = "let the action, or what multiplies it, go as far as the actuator does"
                yield Finding("DB312", command.target.span, f"`{command.actuator.name}` {able}", help=help)


def _limits(actuator: Actuator, model: RobotModel) -> Interval | None:
    """The range of commands that all its joints or links can follow; None where there is no limit."""
    match actuator:
        case Thrust(low=low, high=high) | CustomActuator(low=float() as low, high=float() as high):
            return Interval(low, high)
        case Motor(kind="position_motor", joints=joints):
            ends = [(limit.lower, limit.upper) for limit in (model.joint(joint).limit for joint in joints)]
        case Motor(kind=kind, max_torque=torques, max_velocity=speeds):
            ends = [(None if limit is None else -limit, limit) for limit in (torques if kind == "torque_motor" else speeds)]
        case _:
            return None
    known = [Interval(low, high) for low, high in ends if low is not None and high is not None and low < high]
    return hull(known) if len(known) == len(ends) else None


def _follows_action(analysis: Analysis, target: Scalar, robot: Robot) -> bool:
    """Whether a command depends on nothing but the action."""
    received = {value.name for value in robot.receive}
    for node in analysis.unfold(target):
        match node:
            case Const() | Op():
                continue
            case Name(name) if analysis.sensor(node) is None and name.partition(":")[2] not in received:
                continue
            case _:
                return False
    return True


def joint_driven_twice(context: Context) -> Iterator[Finding]:
    """DB313: two actuators drive the motor of the same joint, so that the command of the first is lost.

    A joint has one motor, and the last command counts. Most often a line was copied, and nothing moves the joint on the other side. A
    torque or a spring (`stiffness`) beside a motor adds to it, and is not reported.

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
    for robot in context.program.robots:
        driving: dict[str, str] = {}
        for command in robot.commands:
            name, joints = command.actuator.name, _held_joints(command.actuator)
            shared = next((joint for joint in joints if joint in driving), None)
            if shared is not None:
                first, second = (_joints_span(context.values, robot.name, called) for called in (driving[shared], name))
                headline = f"`{name}` drives the joint `{shared}`, which `{driving[shared]}` drives already"
                yield Finding("DB313", second, headline, help="give each joint one motor", also=(Label(first, "driven here"),))
            driving |= dict.fromkeys(joints, name)


def _held_joints(actuator: Actuator) -> tuple[str, ...]:
    """The joints whose motors in the engine an actuator uses."""
    match actuator:
        case Motor(kind="velocity_motor" | "position_motor", stiffness=None) | Cartesian():
            return actuator.joints
        case _:
            return ()


def _joints_span(values: Values, robot: str, actuator: str) -> Span:
    place = ("robots", robot, "actuators", actuator)
    key = next((key for key in ("joint", "joints") if values.stands((*place, key))), None)
    return values.span((*place, key)) if key else values.key_span(place)


def limp_at_start(context: Context) -> Iterator[Finding]:
    """DB314: an arm sinks at the start of an episode, since the first command reaches its torque motors late.

    A torque motor exerts nothing until its first command; position and velocity motors hold. The rule reports joints of robots with a
    fixed base that gravity moves by more than 2 deg or 5 mm in this time, if the motor is strong enough to hold them.

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
    program, analysis, values = context.program, context.analysis, context.values
    if program.reset.settle or any(varied.what == "gravity" for varied in program.reset.variations):
        return
    for robot in program.robots:
        held = {joint for command in robot.commands if not _is_limp(command.actuator) for joint in getattr(command.actuator, "joints", ())}
        limp = [command.actuator for command in robot.commands if _is_limp(command.actuator)]
        body = analysis.body(robot.name)
        positions = _start_positions(analysis, body) if limp else None
        ticks = int(program.timing == "delayed")
        if robot.to_route.latency is not None:
            latency = analysis.ranges.of(analysis.scalars(robot.to_route.latency)[0]).low
            ticks += ceil(latency / program.world.timestep - 1e-9) if latency > 0.0 else 0
        for motor in limp:
            wait = ticks * program.world.timestep + motor.response.delay
            joints = {joint: limit for joint, limit in zip(motor.joints, motor.max_torque, strict=True) if joint not in held}
            if positions is None or wait <= program.world.timestep:
                continue
            sunk = _sunk(body, positions, joints, program.world.gravity, wait)
            if sunk is not None:
                by = with_unit(sunk[1], joint_dimension(sunk[0]))
                headline = f"`{motor.name}` exerts nothing for the first {with_unit(wait, TIME)}, and `{sunk[0].name}` sinks by about {by}"
                help = "hold the joint with a `position_motor`, or let the first command come sooner"
                late = ("messages", "to_robot", "latency")
                also = (Label(values.span(late), "what it waits for"),) if values.stands(late) else ()
                yield Finding("DB314", values.key_span(("robots", robot.name, "actuators", motor.name)), headline, help=help, also=also)


def _is_limp(actuator: Actuator) -> TypeGuard[Motor]:
    """Whether it exerts nothing until its first command."""
    return isinstance(actuator, Motor) and (actuator.kind == "torque_motor" or actuator.stiffness == 0.0)


def _start_positions(analysis: Analysis, body: RobotBody) -> dict[str, float] | None:
    """The initial positions of the joints of a robot with a fixed base, rad or m; None where they are not known."""
    placements = analysis.program.reset.placements
    is_tilted = any(place.body == body.name and place.coordinates.keys() & {"roll", "pitch"} for place in placements)
    if not body.fixed_base or is_tilted:
        return None
    found = {joint.name: analysis.start.joint(f"{body.name}.{joint.name}") or NEVER for joint in body.model.moving_joints}
    if any(known.high - known.low > _KNOWN_WITHIN for known in found.values()):
        return None
    return {name: (known.low + known.high) / 2 for name, known in found.items()}


def _sunk(
    body: RobotBody, positions: Mapping[str, float], joints: Mapping[str, float | None], gravity: Triple, time: float
) -> tuple[Joint, float] | None:
    """The joint that gravity moves farthest in a time (s), and how far (rad or m); `joints` maps names to the torque limits of motors."""
    where = link_frames(body.model, positions)
    pull = frames.rotate_back(frames.frame(body.pose)[1], gravity)
    moved = {name: _moved(body.model, where, body.model.joint(name), limit, pull, time) for name, limit in joints.items()}
    name = max(moved, key=lambda joint: moved[joint], default="")
    if not name:
        return None
    joint = body.model.joint(name)
    return (joint, moved[name]) if moved[name] > (0.005 if joint.type == "prismatic" else radians(2.0)) else None


def _moved(model: RobotModel, where: Mapping[str, Frame], joint: Joint, limit: float | None, pull: Triple, time: float) -> float:
    """How far gravity moves a joint while the other joints are still; 0 where its motor could not hold it."""
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
    if excess <= 0.0 or inertia <= 0.0 or (limit is not None and abs(load) > limit):
        return 0.0
    return min(excess / inertia * time * time / 2, excess / joint.damping * time if joint.damping > 0.0 else inf)


# Measured in a simulation


def pose_out_of_reach(simulation: Simulation) -> Iterator[Finding]:
    """DB315: a `cartesian` actuator is commanded to a pose that the inverse kinematics does not reach."""
    reported: set[tuple[str, str]] = set()
    for miss in simulation.report.misses:
        if (miss.turn or miss.out >= _OFTEN * miss.commands) and (miss.robot, miss.actuator) not in reported:
            reported.add((miss.robot, miss.actuator))
            yield _turned_in_place(simulation, miss) if miss.turn else _missed(simulation, miss)


def _missed(simulation: Simulation, miss: Miss) -> Finding:
    model = simulation.analysis.body(miss.robot).model
    is_turned = miss.angle > _SLIGHT_ANGLE
    span = simulation.values.span(("robots", miss.robot, "actuators", miss.actuator, "rpy" if is_turned else "link"))
    distance = f"{miss.distance:.3g} m" if miss.distance > _SLIGHT_DISTANCE else ""
    by = " and ".join(filter(None, [distance, f"{degrees(miss.angle):.3g} deg" if is_turned else ""]))
    notes = [simulation.when(Where(miss.by, miss.seed, miss.step))]
    for name, limit in miss.at_limit.items():
        notes.append(f"joint `{name}` is at its limit of {with_unit(limit, joint_dimension(model.joint(name)))}")
    notes += [f"{miss.out} of {miss.commands} commands in that episode are out of reach"] if miss.commands > 1 else []
    remedy = "choose another `rpy`, or leave it out if any attitude will do" if is_turned else "command positions that the arm reaches"
    headline = f"`{miss.actuator}` is commanded to a pose that the inverse kinematics misses by {by}"
    help = f"{remedy}; `deepbots inspect` prints the pose of the link at the start of an episode"
    return Finding("DB315", span, headline, help=help, notes=tuple(notes))


def _turned_in_place(simulation: Simulation, miss: Miss) -> Finding:
    """The arm reaches a command only by contorting itself, since its link starts in another attitude."""
    span = simulation.values.span(("robots", miss.robot, "actuators", miss.actuator, "rpy"))
    angles = [round(degrees(angle)) for angle in miss.start]
    start = " ".join(str(180 if angle == -180 else angle) for angle in angles)
    headline = f"the first command turns `{miss.actuator}` by {degrees(miss.turn):.3g} deg in place"
    help = f"write `rpy: {start} deg`, which is about the attitude at the start, or let the arm start in another pose"
    notes = (simulation.when(Where(miss.by, miss.seed, miss.step)), "the arm contorts itself, and may swing far on its way")
    return Finding("DB315", span, headline, help=help, notes=notes)


RULES = (command_cut_off, joint_driven_twice, limp_at_start)
MEASURED = (pose_out_of_reach,)
