"""Task to compiled scenario: names become scalar trees, messages get their layouts."""

from __future__ import annotations

import math
import zlib
from dataclasses import replace

from deepbots_cli import footprint, ir
from deepbots_cli.compiler.stamps import with_stamps
from deepbots_cli.expressions import lower as lang
from deepbots_cli.expressions.intervals import Interval
from deepbots_cli.expressions.lower import op
from deepbots_cli.expressions.scalar import Const, Draw, Name, Scalar, walk
from deepbots_cli.task import (
    Command,
    Coordinate,
    JointStart,
    ObservedValue,
    Pick,
    Placement,
    Push,
    Task,
    TaskGoal,
    TaskNoise,
    TaskRobot,
    TaskRoute,
    TaskScript,
    Valued,
    Varied,
)


def lower(task: Task) -> ir.CompiledScenario:
    """The compiled scenario of a task without errors."""
    return with_stamps(_compiled(task), _layout)


def _compiled(task: Task) -> ir.CompiledScenario:
    return ir.CompiledScenario(
        task.name,
        task.summary,
        task.language,
        task.world,
        tuple(_robot(robot, task) for robot in task.robots),
        task.format,
        task.timing,
        tuple(_parameter(value) for value in task.parameters),
        _action(task),
        tuple(_signal(value) for value in task.order),
        tuple(entry for observed in task.observation if not observed.value.typed.type.picture for entry in _observed(observed)),
        tuple(ir.Term(term.name, _scalars(term)[0], term.foreign) for term in task.reward),
        tuple(ir.Ending(ending.value.name, ending.outcome, _scalars(ending.value)[0], ending.value.foreign) for ending in task.endings),
        task.truncation,
        ir.Reset(
            tuple(_place(placement, task) for placement in task.beginnings.placements),
            tuple(start for joints in task.joint_starts for start in _joint_starts(joints)),
            task.settle,
            (*(_variation(varied) for varied in task.variations), *task.colours),
            tuple(ir.Group(group.name, group.capacity, _scalars(group.count)[0]) for group in task.groups),
            tuple(
                ir.Layout(layout.name, layout.share, tuple(_place(placement, task) for placement in layout.placements))
                for layout in task.beginnings.layouts
            ),
            _scalars(task.beginnings.require)[0] if task.beginnings.require else None,
            task.beginnings.attempts,
        ),
        task.solved,
        task.training,
        task.evaluation,
        task.agent,
        tuple(ir.Case(case.name, case.episodes, lower(case.task)) for case in task.cases),
        tuple(ir.Stage(stage.name, stage.until, lower(stage.task)) for stage in task.curriculum),
        tuple(_disturbance(push) for push in task.disturbances),
        goal=_goal(task.goal),
        pictures=tuple(_pictured(observed) for observed in task.observation if observed.value.typed.type.picture),
        scripts=tuple(_script(script, task) for script in task.scripts),
    )


def _scalars(value: Valued, spread: tuple[str, ...] | None = None) -> tuple[Scalar, ...]:
    return lang.lower(value.typed, value.owner, spread)


def _named(value: Valued) -> ir.NamedValues:
    return ir.NamedValues(value.name, value.components, _scalars(value))


def _signal(value: Valued) -> ir.NamedValues:
    noise = _noise(value.noise, value.components or None)
    return ir.Measured(value.name, value.components, _scalars(value), noise) if noise else _named(value)


def _parameter(value: Valued) -> ir.Parameter:
    return ir.Parameter(value.name, value.components, _scalars(value), _redraw(value, value.owner))


def _redraw(value: Valued, owner: str) -> ir.Redraw | None:
    if value.redraw is None:
        return None
    period = value.redraw.period
    return ir.Redraw(None if period is None else lang.lower(period, f"{owner}.every")[0])


def _goal(goal: TaskGoal | None) -> ir.Goal | None:
    if goal is None:
        return None
    achieved, components = _scalars(goal.achieved), goal.achieved.components
    desired = _scalars(goal.desired)
    unit = str(goal.achieved.typed.type.dimension)
    figures = components, achieved, desired * (len(achieved) // len(desired)), goal.low, goal.high, goal.within, unit
    noise = _noise(goal.achieved.noise, components or None)
    return ir.MeasuredGoal(*figures, noise) if noise else ir.Goal(*figures)


def _action(task: Task) -> tuple[ir.Choices | ir.Interval, ...]:
    """The parts of the action, each option with the condition that forbids it."""
    conditions = {(found.action, found.option): _scalars(found.condition)[0] for found in task.forbidden}
    return tuple(
        replace(part, options=tuple(replace(option, forbidden=conditions.get((part.name, option.name))) for option in part.options))
        if isinstance(part, ir.Choices)
        else part
        for part in task.action
    )


def _script(script: TaskScript, task: Task) -> ir.Script:
    """One value for a range of several components is for all of them."""
    parts: list[ir.Pick | ir.Aim] = []
    for part, decided in zip(task.action, script.parts, strict=True):
        if isinstance(decided, Pick):
            options = (*(option for option, _ in decided.rules), decided.otherwise)
            parts.append(ir.Pick(options, tuple(_scalars(condition)[0] for _, condition in decided.rules)))
        else:
            values = tuple(scalar for value in decided for scalar in _scalars(value))
            count = len(part.components) if isinstance(part, ir.Interval) else 0
            parts.append(ir.Aim(values * count if len(values) == 1 and count else values))
    return ir.Script(script.name, tuple(parts))


def _observed(observed: ObservedValue) -> list[ir.Observed]:
    value = observed.value
    known = value.typed.type
    components = known.components or (None,)
    noise = _noise(observed.noise, known.components) or (None,) * len(components)
    rows = zip(components, _scalars(value), observed.low, observed.high, noise, strict=True)
    unit, history, clip = str(known.dimension), observed.history, observed.clip
    return [
        ir.Observed(value.name, component, scalar, low, high, unit, known.boolean, history, clip, added)
        for component, scalar, low, high, added in rows
    ]


def _pictured(observed: ObservedValue) -> ir.Pictured:
    value = observed.value
    return ir.Pictured(value.name, _scalars(value)[0], value.typed.type.picture or (), observed.history)


def _noise(noise: TaskNoise | None, components: tuple[str, ...] | None) -> tuple[ir.Noise, ...]:
    """One for each component; a deviation that is drawn is drawn anew for each."""
    if noise is None:
        return ()
    return tuple(ir.Noise(deviation, noise.relative) for deviation in _scalars(noise.deviation, components))


# Robots and their messages


def _robot(robot: TaskRobot, task: Task) -> ir.Robot:
    emit = tuple(_named(value) for value in robot.emit)
    apply = tuple(_command(command) for command in robot.commands)
    added = tuple(_named(value) for value in robot.receive)
    action = tuple(entry for entry in _action_variables(apply, task) if entry.name not in {value.name for value in robot.receive})
    return ir.Robot(
        robot.name,
        robot.sensors,
        robot.actuators,
        (*action, *added),
        emit,
        apply,
        _layout(robot.name, "to_robot", (*_action_fields(action, task), *map(_field, robot.receive))),
        _layout(robot.name, "from_robot", tuple(_field(value) for value in robot.emit)),
        _route(task.to_robot, f"{robot.name}.to_robot"),
        _route(task.from_robot, f"{robot.name}.from_robot"),
    )


def _route(route: TaskRoute, owner: str) -> ir.Route:
    """The figures of one robot's route, drawn by streams of its own."""
    found = {
        name: ir.Setting(lang.lower(value.typed, f"{owner}.{name}")[0], _redraw(value, f"{owner}.{name}"))
        for name, value in (("latency", route.latency), ("loss", route.loss), ("range", route.range))
        if value is not None
    }
    return ir.Route(**found, burst=route.burst, order=route.order, on_loss=route.on_loss)


def _command(command: Command) -> ir.NamedValues:
    """One target per component, within the velocity limits of joints and the range of thrusts."""
    actuator = command.actuator
    values = _scalars(command.target)
    reach = command.target.typed.type.interval
    if command.opening:
        closed, open_ = command.opening
        share = _clamped(values[0], 0.0, 1.0, reach)
        values = (op("add", Const(closed), op("mul", Const(open_ - closed), share)),)
    values = values * len(actuator.components) if len(values) == 1 else values
    match actuator:
        case ir.Motor(kind="velocity_motor"):
            values = tuple(_limited(value, limit, reach) for value, limit in zip(values, actuator.max_velocity, strict=True))
        case ir.Thrust(low=low, high=high):
            values = tuple(_clamped(value, low, high, reach) for value in values)
    return ir.NamedValues(actuator.name, actuator.components, values)


def _limited(value: Scalar, limit: float | None, reach: Interval) -> Scalar:
    return value if limit is None else _clamped(value, -limit, limit, reach)


def _clamped(value: Scalar, low: float, high: float, reach: Interval) -> Scalar:
    """The value kept within bounds, where it may leave them: it is known to stay within `reach`."""
    return value if low <= reach.low and reach.high <= high else op("clamp", value, Const(low), Const(high))


def _action_variables(apply: tuple[ir.NamedValues, ...], task: Task) -> tuple[ir.NamedValues, ...]:
    """The action variables that `apply` uses, in the order of the action: they are sent unasked."""
    used = {node.name for entry in apply for value in entry.values for node in walk(value) if isinstance(node, Name)}
    found = []
    for part in task.action:
        variables = [(name, ()) for name in part.variables] if isinstance(part, ir.Choices) else [(part.name, part.components)]
        for name, components in variables:
            if name in used:
                found.append(ir.NamedValues(name, components, tuple(Name(name, component) for component in components or (None,))))
    return tuple(found)


def _action_fields(action: tuple[ir.NamedValues, ...], task: Task) -> tuple[ir.Field, ...]:
    units = {part.name: part.unit for part in task.action if isinstance(part, ir.Interval)}
    return tuple(ir.Field(entry.name, units.get(entry.name, "1"), entry.components) for entry in action)


def _field(value: Valued) -> ir.Field:
    known = value.typed.type
    if known.picture:
        return ir.Field(value.name, "", (), "uint8", known.picture)
    return ir.Field(
        value.name, "" if known.boolean else str(known.dimension), known.components or (), "bool" if known.boolean else "float64"
    )


def _layout(robot: str, direction: ir.Direction, fields: tuple[ir.Field, ...]) -> ir.MessageLayout:
    """The stamp is a CRC-32 over everything that both ends must agree on."""
    parts = ((field, ",".join([*field.components, *map(str, field.shape)])) for field in fields)
    text = "|".join([f"v{ir.IR_VERSION}", robot, direction, *(f"{f.name}:{f.dtype}:{f.unit}:{inside}" for f, inside in parts)])
    return ir.MessageLayout(robot, direction, fields, zlib.crc32(text.encode()))


def _disturbance(push: Push) -> ir.Disturbance:
    """Without a time of its own, the first push begins after one interval, which is drawn like any other."""
    every = _scalars(push.every)[0] if push.every else None
    first = _scalars(push.first)[0] if push.first else every or Const(0.0)
    return ir.Disturbance(push.name, push.body, push.link, _vector(push.force), _vector(push.torque), first, every, _scalars(push.lasts)[0])


def _vector(value: Valued | None) -> tuple[Scalar, Scalar, Scalar]:
    if value is None:
        return ir.NOTHING
    x, y, z = _scalars(value)
    return x, y, z


# Resets


def _variation(varied: Varied) -> ir.Variation:
    values = _scalars(varied.value, varied.spread)
    count = len(varied.components or varied.spread or ("",))
    values = values * count if len(values) == 1 else values
    if varied.most:
        pairs = zip(values, varied.most, strict=True)
        values = tuple(value if most is None else op("min", value, Const(most)) for value, most in pairs)
    return ir.Variation(varied.what, varied.of, values)


def _place(placement: Placement, task: Task) -> ir.Place:
    x, y, z, roll, pitch, yaw = (_coordinate(placement.coordinates.get(key), key) for key in ("x", "y", "z", "roll", "pitch", "yaw"))
    rests = placement.rests
    shapes = {thing.name: thing.shape for thing in task.world.objects if not thing.pooled}
    body = shapes.get(placement.body) or next((robot.model for robot in task.world.robots if robot.name == placement.body), None)
    if rests and body and not task.world.terrain and isinstance(roll, Const) and isinstance(pitch, Const):
        rests, z = False, Const(footprint.resting(body, roll.value, pitch.value))
    return ir.Place(
        placement.body,
        (x, y, z),
        (roll, pitch, op("add", Const(placement.heading), yaw)),
        _scalars(placement.velocity) if placement.velocity else (),
        _scalars(placement.angular_velocity) if placement.angular_velocity else (),
        rests,
        placement.spot,
        placement.clearance,
        placement.at_most,
        placement.spacing,
        placement.owner if placement.spot else "",
    )


def _coordinate(coordinate: Coordinate | None, key: str) -> Scalar:
    if coordinate is None:
        return Const(0.0)
    if coordinate.typed is None:
        return Draw("uniform", (Const(-math.pi), Const(math.pi)), f"{coordinate.owner}#0")
    owner, _, index = coordinate.owner.partition("[")
    scalars = lang.lower(coordinate.typed, owner)
    return scalars[int(index.rstrip("]"))] if index and len(scalars) > 1 else scalars[0]


def _joint_starts(start: JointStart) -> list[ir.SetJoint]:
    """A draw that is written once is drawn anew for each joint of a group."""
    spread = start.joints if len(start.joints) > 1 else None
    positions = _scalars(start.position, spread)
    velocities = _scalars(start.velocity, spread) if start.velocity else (Const(0.0),) * len(start.joints)
    return [
        ir.SetJoint(start.robot, joint, position, velocity)
        for joint, position, velocity in zip(start.joints, positions, velocities, strict=True)
    ]
