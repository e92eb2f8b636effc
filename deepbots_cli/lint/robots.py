"""Robots: commands and actuators (DB312, DB313, DB315, DB319, DB325), wheels that do not move a robot
(DB322), robots that topple (DB324), and limits in degrees (DB317).
"""

from __future__ import annotations

from collections.abc import Iterator
from math import ceil, degrees, hypot, inf, pi, radians, sqrt

from deepbots_cli import frames
from deepbots_cli.analysis import Analysis
from deepbots_cli.analysis.ranges import range_text, with_unit
from deepbots_cli.compiler.robots import joint_dimension
from deepbots_cli.diagnostics import Finding, Label
from deepbots_cli.engine_kinds import DEFAULT_ENGINE, ENGINES
from deepbots_cli.expressions.intervals import Interval, hull
from deepbots_cli.expressions.scalar import Const, EngineRead, Name, Op, Scalar, walk
from deepbots_cli.expressions.types import Reference
from deepbots_cli.expressions.types import walk as walk_typed
from deepbots_cli.lint.context import Match, RuleContext, Simulation, rule
from deepbots_cli.lint.geometry import SAME_HEIGHT_M
from deepbots_cli.lint.simulation import TOPPLING_S, SimulationPosition, UnreachedPose, driven_wheels
from deepbots_cli.program.robots import Actuator, Cartesian, CustomActuator, Motor, Robot, Thrust
from deepbots_cli.robots import kinematics
from deepbots_cli.robots.kinematics import joint_inertia, link_frames, min_spring_inertia
from deepbots_cli.robots.model import Joint, Mesh, RobotModel

_MIN_SHARE = 0.5
"""The share of the commands of the agent that an actuator must be able to follow."""
_MIN_MISS_SHARE = 0.1
"""The share of the commands of an episode: a script may pass over positions out of reach on its way."""
# The least distance (m) and angle (rad) that a finding mentions; a smaller miss is given only by the other
# measure.
_MIN_SHOWN_DISTANCE_M = 0.001
_MIN_SHOWN_ANGLE = radians(0.5)
_MIN_WHEEL_TURN = pi
"""The angle (rad) that a driven wheel has turned where its robot should have moved."""
# A robot that slips moves at most by this distance (m) and angle (rad).
_MAX_STAY_M = 0.01
_MAX_STAY_ANGLE = radians(5.0)
_STEP_MARGIN = 1.5
"""The factor by which a suggested engine step is shorter than the longest one that is stable."""
_TOPPLED = radians(45.0)
"""The tilt (rad) of a robot that has toppled."""
_ATTITUDE_SENSORS = frozenset(
    {"gyro", "accelerometer", "projected_gravity", "orientation", "angular_velocity"}
)
_MAX_NAMES = 4
"""The number of joints that a finding lists."""
_DEGREES = Interval(13.0, 360.0)
"""The larger limit (rad) of a joint that is probably in degrees; a whole number, since the turns of a joint
are multiples of pi. Files of motors that turn without end have up to 10 rad, and none has two turns each
way."""
_JOINT_KEYS = ("joint", "joints")


# Commands and actuators


@rule(
    "DB312",
    "`{actuator}` receives commands of {commands}, but its limits are {limits}",
    "change {changed} so that the commands stay within `{limits}`",
)
def command_cut_off(context: RuleContext) -> Iterator[Match]:
    """Report that most commands of the agent are beyond the limits of an actuator."""
    analysis = context.analysis
    for robot in context.program.robots:
        for command in robot.commands:
            trees = analysis.value_on_robot(command.target.typed, command.target.owner, robot.name)
            limits = (
                Interval(0.0, 1.0)
                if command.opening
                else _limits(command.actuator, analysis.body(robot.name).model)
            )
            if limits is None or not all(_follows_action(analysis, tree, robot) for tree in trees):
                continue
            command_range = hull([analysis.ranges.of(tree) for tree in trees])
            used_width = min(command_range.high, limits.high) - max(command_range.low, limits.low)
            if (
                command_range.is_finite
                and not command_range.is_single
                and used_width < _MIN_SHARE * (command_range.high - command_range.low)
            ):
                dimension = command.target.typed.type.dimension
                names = [
                    node.symbol.name
                    for node in walk_typed(command.target.typed)
                    if isinstance(node, Reference) and node.symbol.value
                ]
                yield Match(
                    command.target.span,
                    actuator=command.actuator.name,
                    commands=range_text(command_range, dimension),
                    limits=range_text(limits, dimension),
                    changed=" or ".join(f"`{name}`" for name in names)
                    or "the command or the range of the action",
                )


def _limits(actuator: Actuator, model: RobotModel) -> Interval | None:
    """Return the range of commands that all its joints or links can follow; None where there is no limit."""
    match actuator:
        case Thrust(low=low, high=high) | CustomActuator(low=float() as low, high=float() as high):
            return Interval(low, high)
        case Motor(kind="position_motor", joints=joints):
            ends = [(limit.lower, limit.upper) for limit in (model.joint(joint).limit for joint in joints)]
        case Motor(kind=kind, max_torque=torques, max_velocity=speeds):
            ends = [
                (None if limit is None else -limit, limit)
                for limit in (torques if kind == "torque_motor" else speeds)
            ]
        case _:
            return None
    intervals = [
        Interval(low, high) for low, high in ends if low is not None and high is not None and low < high
    ]
    return hull(intervals) if len(intervals) == len(ends) else None


def _follows_action(analysis: Analysis, target: Scalar, robot: Robot) -> bool:
    """Return whether a command depends on nothing but the action."""
    received = {value.name for value in robot.receive}
    for node in analysis.walk_definitions(target):
        match node:
            case Const() | Op():
                continue
            case Name(name) if analysis.sensor(node) is None and name.partition(":")[2] not in received:
                continue
            case _:
                return False
    return True


@rule(
    "DB313",
    "`{second}` drives the joint `{joint}`, which `{first}` already drives",
    "drive each joint with only one of the two actuators",
)
def joint_driven_twice(context: RuleContext) -> Iterator[Match]:
    """Report two actuators that drive the motor of the same joint, so that the command of the first one is
    lost."""
    for robot in context.program.robots:
        driving: dict[str, str] = {}
        for command in robot.commands:
            name = command.actuator.name
            joints = _held_joints(command.actuator)
            shared = next((joint for joint in joints if joint in driving), None)
            if shared is not None:
                first, second = (
                    context.values.span_of_first(("robots", robot.name, "actuators", called), *_JOINT_KEYS)
                    for called in (driving[shared], name)
                )
                labels = (Label(first, "driven here"),)
                yield Match(second, labels=labels, second=name, joint=shared, first=driving[shared])
            driving |= dict.fromkeys(joints, name)


def _held_joints(actuator: Actuator) -> tuple[str, ...]:
    """Return the joints whose motors in the engine an actuator uses."""
    match actuator:
        case Motor(kind="velocity_motor" | "position_motor", stiffness=None) | Cartesian():
            return actuator.joints
        case _:
            return ()


@rule("DB325")
def shaking_spring(context: RuleContext) -> Iterator[Finding]:
    """Report a spring on a joint that is too light for the engine step: the joint shakes while its link is in
    the air.

    See `min_spring_inertia`. The damping c of the joint itself is implicit: in a step of h seconds it adds
    h c to the inertia.
    """
    world = context.program.world
    step = world.timestep / world.substeps
    for robot in context.program.robots:
        model = context.analysis.body(robot.name).model
        where = link_frames(model, {})
        for command in robot.commands:
            motor = command.actuator
            if not isinstance(motor, Motor) or motor.stiffness is None:
                continue
            needed = min_spring_inertia(motor.stiffness, motor.damping or 0.0, step)
            inertias = {
                name: joint_inertia(model, where, joint) + step * joint.damping
                for name, joint in ((name, model.joint(name)) for name in motor.joints)
            }
            light = [name for name, inertia in inertias.items() if 0.0 < inertia < needed]
            if light:
                yield _shaking(context, robot, motor, light, min(map(inertias.__getitem__, light)), needed)


def _shaking(
    context: RuleContext,
    robot: Robot,
    motor: Motor,
    light: list[str],
    inertia: float,
    needed: float,
) -> Finding:
    joint = context.analysis.body(robot.name).model.joint(light[0])
    unit, spring = ("kg", "N/m") if joint.type == "prismatic" else ("kg*m^2", "N*m/rad")
    names = ", ".join(f"`{name}`" for name in light[:_MAX_NAMES])
    more = f" and {len(light) - _MAX_NAMES} more" if len(light) > _MAX_NAMES else ""
    headline = (
        f"`{motor.name}` shakes {names}{more}: the spring is too strong for an inertia of {inertia:.2g}"
        f" {unit} and this engine step"
    )
    longest = _longest_step(motor.stiffness or 0.0, motor.damping or 0.0, inertia)
    substeps = ceil(context.program.world.timestep / (longest / _STEP_MARGIN))
    kind = ENGINES.get(context.program.engine or DEFAULT_ENGINE)
    rotor = (
        f"add the inertia of the rotors under `joints`, as in `{light[0]}: {{armature:"
        f" {2.0 * needed:.1g} {unit}}}`; or "
        if kind is not None and kind.supports("armature")
        else ""
    )
    share = 0.99 * inertia / needed
    damping = f" and the damping below {motor.damping * share:.3g}" if motor.damping else ""
    lower = f"lower the stiffness below {(motor.stiffness or 0.0) * share:.3g} {spring}{damping}"
    more_substeps = f", or write `substeps: {substeps}` under `world`" if substeps <= 10_000 else ""
    help = f"{rotor}{lower}{more_substeps}"
    return Finding(
        "DB325",
        context.values.key_span(("robots", robot.name, "actuators", motor.name)),
        headline,
        help,
    )


def _longest_step(stiffness: float, damping: float, inertia: float) -> float:
    """Return the engine step (s) at which the motion of a spring on this inertia ceases to be stable."""
    # The positive root h of k h^2 + 2 d h = 4 I, the criterion of `min_spring_inertia`, without a difference
    # that is 0 where d is large.
    return 4.0 * inertia / (hypot(damping, 2.0 * sqrt(stiffness * inertia)) + damping)


# Measured in a simulation


@rule("DB315", simulated=True)
def pose_out_of_reach(simulation: Simulation) -> Iterator[Finding]:
    """Report a pose of a `cartesian` actuator that the inverse kinematics does not reach."""
    reported: set[tuple[str, str]] = set()
    for miss in simulation.report.misses:
        if (miss.turn or miss.unreached_commands >= _MIN_MISS_SHARE * miss.commands) and (
            miss.robot,
            miss.actuator,
        ) not in reported:
            reported.add((miss.robot, miss.actuator))
            yield _turned_in_place(simulation, miss) if miss.turn else _missed(simulation, miss)


def _missed(simulation: Simulation, miss: UnreachedPose) -> Finding:
    model = simulation.analysis.body(miss.robot).model
    is_turned = miss.angle > _MIN_SHOWN_ANGLE
    span = simulation.values.span(
        ("robots", miss.robot, "actuators", miss.actuator, "rpy" if is_turned else "link")
    )
    distance = f"{miss.distance:.3g} m" if miss.distance > _MIN_SHOWN_DISTANCE_M else ""
    by = " and ".join(filter(None, [distance, f"{degrees(miss.angle):.3g} deg" if is_turned else ""]))
    notes = [simulation.when(SimulationPosition(miss.policy, miss.seed, miss.step))]
    for name, limit in miss.at_limit.items():
        notes.append(
            f"joint `{name}` is at its limit of {with_unit(limit, joint_dimension(model.joint(name)))}"
        )
    notes += (
        [f"{miss.unreached_commands} of {miss.commands} commands in this episode are out of reach"]
        if miss.commands > 1
        else []
    )
    change = (
        "change `rpy`, or remove it if the orientation does not matter"
        if is_turned
        else "send positions within the reach of the arm"
    )
    headline = f"`{miss.actuator}` is commanded to a pose that its inverse kinematics misses by {by}"
    help = f"{change}; `deepbots inspect` prints the pose of the link at the start of an episode"
    return Finding("DB315", span, headline, help, notes=tuple(notes))


def _turned_in_place(simulation: Simulation, miss: UnreachedPose) -> Finding:
    """Return a finding about a first command that turns a link far in place, because the link starts in
    another orientation."""
    span = simulation.values.span(("robots", miss.robot, "actuators", miss.actuator, "rpy"))
    angles = [round(degrees(angle)) for angle in miss.start]
    start = " ".join(str(180 if angle == -180 else angle) for angle in angles)
    headline = f"the first command turns `{miss.actuator}` by {degrees(miss.turn):.3g} deg in place"
    help = (
        f"write `rpy: {start} deg`, which is near the initial orientation, or start the arm in another pose"
    )
    notes = (
        simulation.when(SimulationPosition(miss.policy, miss.seed, miss.step)),
        "the joints may move far before the link reaches the pose",
    )
    return Finding("DB315", span, headline, help, notes=notes)


@rule(
    "DB322",
    "`{robot}` stays in its place although its wheels turn: it moves by less than {moved} mm",
    "let the driven wheels carry the robot: raise its skids and casters, or reduce their friction under"
    " `links`",
    simulated=True,
)
def robot_stays(simulation: Simulation) -> Iterator[Match]:
    """Report a robot that no action moves or turns, although its wheels turn: they slip, or do not touch the
    ground."""
    if not simulation.is_complete:
        return
    for robot, rolling in simulation.report.summary.rolling.items():
        if (
            rolling.wheel > _MIN_WHEEL_TURN
            and rolling.distance < _MAX_STAY_M
            and rolling.turn < _MAX_STAY_ANGLE
        ):
            body = simulation.analysis.body(robot)
            wheels = driven_wheels(
                next(entry for entry in simulation.program.robots if entry.name == robot), body.model
            )
            yield Match(
                simulation.values.key_span(("robots", robot)),
                notes=(*_links_beside_wheels(body.model, wheels), simulation.summary),
                robot=robot,
                moved=ceil(rolling.distance * 1000),
            )


@rule(
    "DB324",
    "`{robot}` topples: its base is free, and tilts by {tilt:.0f} deg within {time:g} s of doing nothing",
    "an arm needs `base: fixed` under `{robot}`, which bolts it to the world; for a robot that has to"
    " balance, end the episode with `tilt({robot}) > 45 deg`",
    simulated=True,
)
def topples(simulation: Simulation) -> Iterator[Match]:
    """Report a robot with a free base that topples while nothing is done, if the scenario does not measure
    whether it falls."""
    for name, tilt in simulation.report.summary.tilts.items():
        robot = next(entry for entry in simulation.program.robots if entry.name == name)
        if tilt <= _TOPPLED or simulation.program.disturbances or _is_watched(simulation, robot):
            continue
        span = simulation.values.span_of_first(("robots", name), "base", "urdf")
        yield Match(span, notes=(simulation.summary,), robot=name, tilt=degrees(tilt), time=TOPPLING_S)


def _is_watched(simulation: Simulation, robot: Robot) -> bool:
    """Return whether the scenario measures the attitude or the height of the base of a robot, or the robot
    flies."""
    flies = any(isinstance(actuator, (Thrust, CustomActuator)) for actuator in robot.actuators)
    if flies or any(sensor.kind in _ATTITUDE_SENSORS for sensor in robot.sensors):
        return True
    reads = (
        node
        for value in simulation.program.computed_expressions
        for tree in value.scalars
        for node in walk(tree)
    )
    base = f"{robot.name}.{simulation.analysis.body(robot.name).model.root}"
    facts = (node for node in reads if isinstance(node, EngineRead) and node.subjects[0] == base)
    return any(
        fact.function == "orientation" or (fact.function, fact.component) == ("position", "z")
        for fact in facts
    )


def _links_beside_wheels(model: RobotModel, wheels: tuple[str, ...]) -> Iterator[str]:
    """Yield a sentence on each link that reaches the ground where the driven wheels do, or before; with all
    joints at 0, without meshes."""
    where = link_frames(model)
    shapes = [
        (link.name, part)
        for link in model.links
        for part in link.collisions
        if not isinstance(part.shape, Mesh)
    ]
    bottoms: dict[str, float] = {}
    for link, part in shapes:
        box = kinematics.bounds_of_shape(part.shape, frames.compose(where[link], frames.frame(part.origin)))
        bottoms[link] = min(bottoms.get(link, inf), box[0][2])
    driven = {model.joint(wheel).child for wheel in wheels}
    lowest = min((bottoms.get(link, inf) for link in driven), default=inf)
    for link, bottom in bottoms.items():
        if link not in driven and bottom < lowest + SAME_HEIGHT_M < inf:
            gap = lowest - bottom
            yield f"`{link}` reaches " + (
                f"{gap * 1000:.2g} mm lower than the driven wheels"
                if gap > SAME_HEIGHT_M
                else "as low as the driven wheels"
            )


# Limits of the robot file


@rule(
    "DB319",
    "`{actuator}` has no limit of {quantity}: the robot file states no effort for {joints}",
    "write `max_torque` with the {quantity} of the motor, such as `max_torque: 10 {unit}`",
)
def unlimited_motor(context: RuleContext) -> Iterator[Match]:
    """Report a motor without a limit of torque or force."""
    for robot in context.program.robots:
        model = context.analysis.body(robot.name).model
        for actuator in robot.actuators:
            limits = dict(zip(_held_joints(actuator), getattr(actuator, "max_torque", ()), strict=False))
            free = [model.joint(joint) for joint, limit in limits.items() if limit is None]
            if not free:
                continue
            quantity, unit = ("force", "N") if free[0].type == "prismatic" else ("torque", "N*m")
            joint_names = ", ".join(f"`{joint.name}`" for joint in free[:_MAX_NAMES]) + (
                ", ..." if len(free) > _MAX_NAMES else ""
            )
            yield Match(
                context.values.span_of_first(
                    ("robots", robot.name, "actuators", actuator.name), *_JOINT_KEYS
                ),
                notes=('an effort of 0 in a robot file is read as "not stated"',),
                actuator=actuator.name,
                quantity=quantity,
                unit=unit,
                joints=joint_names,
            )


@rule(
    "DB317",
    "the limits {low:g} and {high:g} rad of joint `{joint}` are {turns:.3g} turns apart",
    'if they are degrees, write lower="{lower:.5g}" upper="{upper:.5g}" in the robot file, or'
    " `range: {low:g} .. {high:g} deg` under `joints`",
)
def limits_in_degrees(context: RuleContext) -> Iterator[Match]:
    """Report limits of a joint in a robot file that were probably meant in degrees."""
    program = context.program
    for robot in program.robots:
        resolved = context.namespace.robots[robot.name]
        in_degrees = list(filter(_is_in_degrees, context.analysis.body(robot.name).model.moving_joints))
        if resolved is None or not in_degrees:
            continue
        trees = [tree for value in program.computed_expressions for tree in value.scalars]
        subjects = {node.subjects[0] for tree in trees for node in walk(tree) if isinstance(node, EngineRead)}
        used = {joint for actuator in robot.actuators for joint in getattr(actuator, "joints", ())}
        used |= {name for sensor in robot.sensors for name in sensor.subjects}
        used |= {subject.removeprefix(f"{robot.name}.") for subject in subjects}
        suspects = [
            joint
            for joint in in_degrees
            if joint.name in used
            and joint.name in resolved.file.limit_spans
            and joint.limit == resolved.file.model.joint(joint.name).limit
        ]
        for joint in suspects[:1]:
            low, high = joint.limit.lower or 0.0, joint.limit.upper or 0.0
            names = [other.name for other in suspects[1:]]
            yield Match(
                resolved.file.limit_spans[joint.name],
                notes=(f"the same is true of {', '.join(names)}",) if names else (),
                low=low,
                high=high,
                joint=joint.name,
                turns=(high - low) / (2 * pi),
                lower=radians(low),
                upper=radians(high),
            )


def _is_in_degrees(joint: Joint) -> bool:
    """Return whether the limits of a hinge are whole numbers that are plausible as degrees alone."""
    low, high = joint.limit.lower, joint.limit.upper
    if joint.type != "revolute" or low is None or high is None:
        return False
    is_whole = low.is_integer() and high.is_integer()
    return is_whole and _DEGREES.low <= max(-low, high) <= _DEGREES.high
