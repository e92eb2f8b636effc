"""The controller of a robot: its poses, its commands, and the messages that it sends and receives; its
actuators with their kinds, limits and responses."""

from __future__ import annotations

import math
from collections.abc import Container, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Literal, NamedTuple, TypedDict, Unpack

from deepbots_cli.compiler.namespace import Namespace, NamespaceReader, Origin, RobotScope, SupervisorScope
from deepbots_cli.compiler.robots import (
    ResolvedRobot,
    effort_dimension,
    expand_patterns,
    joint_dimension,
    joint_interval,
    joint_moves_link,
    report_unmatched,
    warn_beyond_limits,
)
from deepbots_cli.compiler.sensing import SensorsCompiler
from deepbots_cli.compiler.values import Default, FieldContext, ValueReader
from deepbots_cli.diagnostics.nearest import nearest_word
from deepbots_cli.document.nodes import NodePath
from deepbots_cli.expressions.dimensions import LENGTH, TIME, Dimension
from deepbots_cli.expressions.intervals import ZERO, Interval, hull, single
from deepbots_cli.expressions.types import (
    Components,
    Context,
    Invocation,
    Known,
    Reference,
    Symbol,
    ValueType,
    referenced_names,
    walk,
)
from deepbots_cli.program.resets import OfActuator
from deepbots_cli.program.robots import (
    Actuator,
    Cartesian,
    Command,
    CustomActuator,
    Direction,
    Link,
    MessageField,
    Motor,
    Response,
    Robot,
    Route,
    Thrust,
)
from deepbots_cli.program.task import ActionPart, ActionRange
from deepbots_cli.program.values import Expression
from deepbots_cli.records import dataclass
from deepbots_cli.robots.model import Joint
from deepbots_cli.scenario import actuators as specs
from deepbots_cli.scenario.base import kind_parameters

_BEGIN_AT_ZERO = frozenset({"integral", "duration"})
"""The functions that begin at 0, whatever the first message contains."""


def poses(robot: ResolvedRobot, namespace: Namespace) -> dict[str, Symbol]:
    """Return each pose as a vector by joint: patterns in the order of the file, the joints of each in the
    order of the robot file."""
    return {name: _pose(name, robot, namespace) for name in robot.spec.poses}


def _pose(name: str, robot: ResolvedRobot, namespace: Namespace) -> Symbol:
    values = namespace.values
    moving = robot.drivable_joints
    positions: dict[str, float] = {}
    is_complete = True
    for pattern in robot.spec.poses[name]:
        joints, missing = expand_patterns(moving, pattern, robot.groups)
        if missing:
            robot.report_missing_joint(
                values, values.key_span((*robot.spec.path, "poses", name, pattern)), pattern, moving
            )
        dimension = joint_dimension(robot.model.joint(joints[0])) if joints else None
        position = (
            namespace.fields.fixed(robot.spec, "poses", name, pattern, dimension=dimension)
            if joints
            else None
        )
        is_complete = is_complete and position is not None
        positions |= dict.fromkeys(joints, position or 0.0)
    dimensions = {joint_dimension(robot.model.joint(joint)) for joint in positions}
    if len(dimensions) > 1:
        values.add_at_key(
            "DB404",
            (*robot.spec.path, "poses", name),
            "a pose cannot contain both turning and sliding joints",
            "write one pose for the turning joints and one for the sliding joints",
        )
    if not is_complete or len(dimensions) != 1:
        return Symbol(name, None)
    fixed = tuple(positions.values())
    return Symbol(
        name, ValueType(dimensions.pop(), tuple(positions)).with_intervals(map(single, fixed)), fixed
    )


@dataclass(eq=False)
class RobotBuilder:
    """The builder of the `Robot` of a program: it defines the names, types the values that the robot emits,
    receives and applies, and `finish` returns the robot."""

    robot: ResolvedRobot
    namespace: Namespace

    def __post_init__(self) -> None:
        self.values: ValueReader = self.namespace.values
        self.path: NodePath = ("robots", self.robot.name)
        self.sensing = SensorsCompiler(self.robot, self.namespace)
        self.poses = poses(self.robot, self.namespace)
        self.symbols: dict[str, Symbol] = {**self.poses, **self.sensing.symbols}
        self.fields: dict[str, Expression] = {}
        self.heard: dict[str, Expression] = {}
        self.received: dict[str, Expression] = {}
        self._check_names()
        self._define_fields()

    # Names on board

    def _check_names(self) -> None:
        """Check that no name on board means two things, also not one here and another in the scenario."""
        spec = self.robot.spec
        places_by_name: dict[str, tuple[str, NodePath]] = {}
        for name in self.namespace.names_of(Origin.PARAMETER, Origin.ACTION):
            definition = self.namespace.definitions[name]
            places_by_name[name] = (definition.origin.value, definition.path)
        for noun, section, names in (("a pose", "poses", spec.poses), ("a sensor", "sensors", spec.sensors)):
            for name in names:
                path = (*self.path, section, name)
                if name in places_by_name:
                    self.values.report_duplicate(path, name, *places_by_name[name])
                places_by_name[name] = (noun, path)
        for name in spec.receive or {}:
            if name in spec.poses or name in spec.sensors:
                self.values.report_duplicate((*self.path, "receive", name), name, *places_by_name[name])

    # Sent values

    def _define_fields(self) -> None:
        emit = self.robot.spec.emit
        entries: list[tuple[str, NodePath]] = []
        match emit:
            case None:
                entries = [(name, (*self.path, "sensors", name)) for name in self.robot.spec.sensors]
            case dict():
                entries = [(name, (*self.path, "emit", name)) for name in emit]
            case _:
                entries = [(name, (*self.path, "emit", i)) for i, name in enumerate(emit)]
        for name, path in entries:
            make = partial(self._sensor_field if emit is None else self._field, name, path)
            self.namespace.define(f"{self.robot.name}.{name}", Origin.FIELD, path, make)

    def define_heard(self) -> None:
        """Define the names of what other robots send to this one; call this when all fields are defined."""
        for name, source in self.robot.spec.hear.items():
            path = (*self.path, "hear", name)
            self.namespace.define(
                f"{self.robot.name}.{name}", Origin.FIELD, path, partial(self._heard, name, source, path)
            )

    def _heard(self, name: str, source: str, path: NodePath) -> Symbol:
        full = f"{self.robot.name}.{name}"
        sender = source.partition(".")[0]
        namespace = self.namespace
        if sender == self.robot.name:
            self.values.add(
                "DB407",
                path,
                f"`{sender}` cannot hear itself",
                "use the value itself, or that of another robot",
            )
            return Symbol(full, None)
        heard = namespace.definitions.get(source)
        if heard is not None and heard.path[2:3] == ("hear",):
            self.values.add(
                "DB407",
                path,
                f"`{sender}` hears `{source}`, and does not send it",
                "hear the robot that sends the value, or send a value of `emit`",
            )
            return Symbol(full, None)
        if namespace.origin(source) is not Origin.FIELD:
            fields = [
                field
                for field in namespace.names_of(Origin.FIELD)
                if not field.startswith(self.robot.name + ".")
            ]
            self.values.report_unknown(self.values.span(path), "value of another robot", source, fields)
            return Symbol(full, None)
        symbol = namespace.use(source)
        if symbol is None or symbol.type is None:
            return Symbol(full, None)
        typed = Reference(symbol.type, 0, len(source), symbol)
        self.heard[name] = Expression(
            name, self.values.span(path), source, typed, f"{self.robot.name}.hear.{name}"
        )
        return Symbol(full, self._received_type(symbol.type, "between_robots"))

    def _received_type(self, sent: ValueType, direction: Direction | Literal["between_robots"]) -> ValueType:
        """Return the type of a sent value where it arrives: 0 may replace it in a lost message."""
        received = sent._replace(known=Known.STEP)
        if getattr(self.namespace.scenario.messages, direction).on_loss != "zero":
            return received
        return received.with_intervals(
            hull((interval, ZERO)) for interval in received.intervals or (received.interval,)
        )

    def links(self, route: Route) -> Iterator[Link]:
        """Yield the paths of messages from other robots to this one."""
        for name in self.robot.spec.hear:
            self.namespace.resolve(f"{self.robot.name}.{name}")
        senders = dict.fromkeys(value.text.partition(".")[0] for value in self.heard.values())
        for sender in senders:
            values = [value for value in self.heard.values() if value.text.partition(".")[0] == sender]
            link_route = route.route_for(sender, f"to_{self.robot.name}")
            yield Link(sender, self.robot.name, tuple(values), link_route)

    def sent(self) -> tuple[Expression, ...]:
        """Return the values that the robot sends; without an `emit`, the sensors that the supervisor uses,
        which are known once everything is typed."""
        is_listed = self.robot.spec.emit is not None
        return tuple(
            field
            for name, field in self.fields.items()
            if is_listed or self.namespace.is_sent(f"{self.robot.name}.{name}")
        )

    def _sensor_field(self, name: str, path: NodePath) -> Symbol:
        """Return the field of a sensor that no `emit` lists."""
        full = f"{self.robot.name}.{name}"
        sensor = self.symbols[name]
        if sensor.type is None:
            return Symbol(full, None)
        typed = Reference(sensor.type, 0, len(name), sensor)
        self.fields[name] = Expression(
            name, self.values.key_span(path), name, typed, f"{self.robot.name}.emit.{name}"
        )
        return Symbol(full, self._received_type(sensor.type, "from_robot"))

    def _field(self, name: str, path: NodePath) -> Symbol:
        full = f"{self.robot.name}.{name}"
        emit = self.robot.spec.emit or ()
        text = self.values.text(path, emit[name] if isinstance(emit, dict) else name)
        if not isinstance(emit, dict) and name not in self.symbols:
            sensors = list(self.robot.spec.sensors)
            self.values.report_unknown(text.span, "sensor", name, sensors)
            if nearest := nearest_word(name, sensors):
                self.values.mark_invalid(f"{self.robot.name}.{nearest}")
            return Symbol(full, None)
        typed = self.values.expression(
            text, RobotScope(self.namespace, Context.EMIT, self.robot.name, self.symbols)
        )
        if typed is None:
            return Symbol(full, None)
        self.fields[name] = Expression(name, text.span, text.text, typed, f"{self.robot.name}.emit.{name}")
        return Symbol(full, self._received_type(typed.type, "from_robot"))

    # Received values and commands

    def _receive(self) -> dict[str, Symbol]:
        """Return the action variables, and the fields of `receive`."""
        spec = self.robot.spec
        symbols = {}
        for name in self.namespace.names_of(Origin.ACTION):
            symbol = self.namespace.resolve(name) or Symbol(name, None)
            received = symbol.type and self._received_type(symbol.type, "to_robot")
            symbols[name] = symbol._replace(type=received)
        for name, value in (spec.receive or {}).items():
            path = (*self.path, "receive", name)
            text = self.values.text(path, value)
            typed = self.values.expression(text, SupervisorScope(self.namespace, Context.RECEIVE))
            symbols[name] = Symbol(name, None)
            if typed is not None:
                self.received[name] = Expression(
                    name, text.span, text.text, typed, f"{self.robot.name}.receive.{name}"
                )
                symbols[name] = Symbol(name, self._received_type(typed.type, "to_robot"))
        return symbols

    def finish(self, timestep: float, action: Sequence[ActionPart], routes: tuple[Route, Route]) -> Robot:
        """Type everything that is left; the world's timestep is `timestep` s, `routes` are the routes to and
        from robots.

        The fields that the robot sends are added later (`sent`).
        """
        received = self._receive()
        scope = RobotScope(self.namespace, Context.APPLY, self.robot.name, {**self.symbols, **received})
        actuators = Actuators(self.robot, self.namespace)
        driven = {
            name: actuator
            for name in self.robot.spec.actuators
            if (actuator := actuators.read(name)) is not None
        }
        commands = []
        for name, source in self.robot.spec.apply.items():
            path = (*self.path, "apply", name)
            if name not in self.robot.spec.actuators:
                self.values.report_unknown(
                    self.values.key_span(path), "actuator", name, list(self.robot.spec.actuators)
                )
                continue
            command = self._command(name, source, path, driven.get(name), scope)
            if command:
                commands.append(command)
        name = self.robot.name
        to_robot, from_robot = routes
        robot = Robot(
            name,
            self.sensing.compiled(timestep),
            tuple(actuator.actuator for actuator in driven.values()),
            tuple(self.received.values()),
            (),
            tuple(commands),
            tuple(_used_variables(action, commands, self.received)),
            to_robot.route_for(name, "to_robot"),
            from_robot.route_for(name, "from_robot"),
        )
        if to_robot.on_loss == "zero" and (to_robot.loses or to_robot.range is not None):
            self._report_lost_starts(robot)
        return robot

    def _report_lost_starts(self, robot: Robot) -> None:
        """Report each memory whose start is received, where zeros replace a first message that is lost."""
        for command in robot.commands:
            for node in walk(command.target.typed):
                if not isinstance(node, Invocation) or node.function in _BEGIN_AT_ZERO:
                    continue
                if (command.target.owner, f"{node.occurrence}") in robot.begun_by_message:
                    report = self.values.reporter(
                        self.values.text((*self.path, "apply", command.name), command.target.text)
                    )
                    report(
                        "DB407",
                        node.start,
                        node.end,
                        f"the start of `{node.function}` is a received value; with `on_loss: zero`,"
                        " it is 0 if the first message is lost",
                        "write `on_loss: hold` or `skip` under `messages.to_robot`: the robot applies"
                        " nothing until a message arrives",
                    )

    def _command(
        self, name: str, command: object, path: NodePath, driven: ResolvedActuator | None, scope: RobotScope
    ) -> Command | None:
        text = self.values.text(path, command)
        if driven is None:
            self.values.expression(text, scope, boolean=False)
            return None
        parts = driven.components or ("",)
        spec = self.robot.spec.actuators[name]
        example = (
            f"{{type: {spec.type}, {'link' if isinstance(spec, specs.Thrust) else 'joint'}: {parts[0]}}}"
        )
        help = (
            "write one number, which drives all of them; to control each of them separately, define one"
            f" actuator for each: `{parts[0]}: {example}`"
        )
        typed = self.values.quantity(
            text, f"the target of `{name}`", scope, driven.dimension, driven.components, Known.STEP, help
        )
        if typed is None:
            return None
        return Command(
            driven.actuator,
            Expression(name, text.span, text.text, typed, f"{self.robot.name}.apply.{name}"),
            driven.opening,
        )


def commanded(
    robots: Iterable[Robot], action: Sequence[ActionPart], signals: Iterable[Expression]
) -> Iterator[str]:
    """Yield the names of the robots whose messages depend on the action; each of the `signals` comes after
    those that it is made of."""
    moved = {name for part in action for name in part.variables}
    for signal in signals:
        if moved.intersection(referenced_names(signal.typed)):
            moved.add(signal.name)
    for robot in robots:
        if robot.variables or any(
            moved.intersection(referenced_names(value.typed)) for value in robot.receive
        ):
            yield robot.name


def _used_variables(
    action: Sequence[ActionPart], commands: Iterable[Command], received: Container[str]
) -> Iterator[MessageField]:
    """Yield the action variables that commands use, in the order of the action; `received` names of the robot
    hide them."""
    used = {
        node.symbol.name
        for command in commands
        for node in walk(command.target.typed)
        if isinstance(node, Reference)
    }
    for part in action:
        if isinstance(part, ActionRange):
            fields = [MessageField(part.name, part.unit, part.components)]
        else:
            fields = [MessageField(variable, "1") for variable in part.variables]
        yield from (field for field in fields if field.name in used and field.name not in received)


# Actuators


Limits = tuple[float | None, ...]

_ROUNDING = 1e-9
"""The share by which a limit may exceed that of the robot file, which conversions of units round."""


class _TorqueCurve(TypedDict, total=False):
    stall_torque: float
    no_load_speed: float


class ResolvedActuator(NamedTuple):
    """An actuator, and its command: of a dimension, with components or (None) a single number."""

    actuator: Actuator
    dimension: Dimension
    components: Components | None
    opening: tuple[float, float] | None = None
    """The position of the joints of a gripper at a command of 0, and at 1."""


def driven_parts(robot: ResolvedRobot, spec: specs.Actuator) -> Components | None:
    """Return the components of a command to the actuator, without findings; None where there are none."""
    if spec.components:
        return spec.components
    key, names = (
        ("link", robot.link_names) if isinstance(spec, specs.Thrust) else ("joint", robot.drivable_joints)
    )
    parts, _ = expand_patterns(
        names, getattr(spec, f"{key}s") or getattr(spec, key, None) or (), robot.groups
    )
    return parts or None


class Actuators(NamespaceReader):
    """Reads the actuators of one robot."""

    def __init__(self, robot: ResolvedRobot, namespace: Namespace) -> None:
        super().__init__(namespace)
        self._robot = robot

    def read(self, name: str) -> ResolvedActuator | None:
        """Return the actuator called `name`; None after a finding.

        The draws of an actuator that `apply` does not command are dropped.
        """
        spec = self._robot.spec.actuators[name]
        varied = len(self._fields.variations)
        match spec:
            case specs.JointActuator():
                driven = self._motor(name, spec)
            case specs.Thrust():
                driven = self._thrust(name, spec)
            case specs.Cartesian():
                driven = self._cartesian(name, spec)
            case specs.Gripper():
                driven = self._gripper(name, spec)
            case _:
                raise TypeError(f"there is no reader for the actuator {type(spec).__name__}")
        if name not in self._robot.spec.apply:
            del self._fields.variations[varied:]
        return driven

    def _motor(self, name: str, spec: specs.JointActuator) -> ResolvedActuator | None:
        joints = self._robot.joints_of(spec, self._values)
        if not joints:
            return None
        names = tuple(joint.name for joint in joints)
        dimension = spec.dimension_of(joints[0])
        max_torque = self._max_torque(spec, joints)
        max_velocity = self._max_velocity(spec, joints)
        motor: Actuator
        match spec:
            case specs.VelocityMotor():
                acceleration = self._fields.fixed(spec, "max_acceleration", dimension=dimension / TIME)
                motor = Motor(
                    name,
                    spec.type,
                    names,
                    max_torque,
                    max_velocity,
                    max_acceleration=acceleration,
                    response=self._response(spec, names),
                )
            case specs.PositionMotor():
                motor = Motor(
                    name,
                    spec.type,
                    names,
                    max_torque,
                    max_velocity,
                    *self._gains(spec, names, effort_dimension(joints[0]) / dimension),
                    response=self._response(spec, names),
                    **self._torque_curve(spec, joints[0]),
                )
            case specs.TorqueMotor():
                motor = Motor(
                    name,
                    spec.type,
                    names,
                    max_torque,
                    max_velocity,
                    response=self._response(spec, names),
                    **self._torque_curve(spec, joints[0]),
                )
            case _:
                slides = joint_dimension(joints[0]) == LENGTH
                parameters = self._fields.parameters(
                    spec, kind_parameters(type(spec), specs.JointActuator), dimension, slides=slides
                )
                if parameters is None:
                    return None
                low, high = (end if math.isfinite(end) else None for end in spec.interval)
                response = self._response(spec, names)
                limits = max_torque, max_velocity
                motor = CustomActuator(
                    name, spec.type, names, *limits, spec.drive, parameters, low, high, response
                )
        return ResolvedActuator(
            motor, dimension, names if len(names) > 1 or spec.joints is not None else None
        )

    def _gains(
        self, spec: specs.PositionMotor, names: tuple[str, ...], dimension: Dimension
    ) -> tuple[float | None, float | None]:
        """Return stiffness and damping of a position motor; `dimension` is that of the stiffness."""
        stiffness = self._scalar_or_randomized(
            spec, "stiffness", None, dimension=dimension, per_component=names
        )
        damping = self._scalar_or_randomized(
            spec, "damping", None, dimension=dimension * TIME, per_component=names
        )
        if spec.damping is not None and spec.stiffness is None:
            self._values.add_at_key(
                "DB102",
                (*spec.path, "damping"),
                "`damping` needs `stiffness`",
                "add `stiffness`, or remove `damping` to use the built-in position control of the engine",
            )
        return stiffness, damping

    def _torque_curve(self, spec: specs.SpeedLimitedMotor, joint: Joint) -> _TorqueCurve:
        """Return stall torque and no-load speed of a motor; empty where it has none, and after a finding."""
        stall = self._fields.fixed(spec, "stall_torque", dimension=effort_dimension(joint))
        speed = self._fields.fixed(spec, "no_load_speed", dimension=joint_dimension(joint) / TIME)
        for key, other_key in (("stall_torque", "no_load_speed"), ("no_load_speed", "stall_torque")):
            if getattr(spec, key) is not None and getattr(spec, other_key) is None:
                help = f"add `{other_key}`, or remove `{key}`"
                self._values.add_at_key("DB102", (*spec.path, key), f"`{key}` needs `{other_key}`", help)
        if stall is None or speed is None:
            return {}
        if isinstance(spec, specs.PositionMotor) and spec.stiffness is None:
            help = (
                "add `stiffness`, or remove `stall_torque` and `no_load_speed` to use the built-in position"
                " control of the engine"
            )
            self._values.add_at_key(
                "DB102", (*spec.path, "stall_torque"), "`stall_torque` needs `stiffness`", help
            )
        return {"stall_torque": stall, "no_load_speed": speed}

    def _cartesian(self, name: str, spec: specs.Cartesian) -> ResolvedActuator | None:
        joints = self._robot.joints_of(spec, self._values)
        links = self._robot.links_of(spec, self._values)
        rpy = self._fields.triple(spec, "rpy")
        if not links or not joints or (spec.rpy is not None and rpy is None):
            return None
        model = self._robot.model
        idle = [joint.name for joint in joints if not joint_moves_link(model, joint, spec.link)]
        if idle:
            self._values.add(
                "DB203",
                (*spec.path, "joints"),
                f"the joint `{idle[0]}` does not move `{spec.link}`",
                "name the joints between the base and the link",
            )
            return None
        names = tuple(joint.name for joint in joints)
        limits = self._max_torque(spec, joints), self._max_velocity(spec, joints)
        return ResolvedActuator(
            Cartesian(name, spec.link, names, rpy, *limits, self._response(spec, names)),
            spec.dimension,
            spec.components,
        )

    def _gripper(self, name: str, spec: specs.Gripper) -> ResolvedActuator | None:
        """Return a servo whose command is how far it is open."""
        joints = self._robot.joints_of(spec, self._values)
        if not joints:
            return None
        position = joint_dimension(joints[0])
        closed, open_ = (self._fields.fixed(spec, key, dimension=position) for key in ("closed", "open"))
        names = tuple(joint.name for joint in joints)
        limits = self._max_torque(spec, joints), self._max_velocity(spec, joints)
        motor = Motor(name, "position_motor", names, *limits, response=self._response(spec, names))
        if closed is None or open_ is None:
            return None
        for key, end in (("closed", closed), ("open", open_)):
            self._check_reach(spec, key, end, joints)
        return ResolvedActuator(motor, spec.dimension, None, (closed, open_))

    def _check_reach(self, spec: specs.Gripper, key: str, position: float, joints: tuple[Joint, ...]) -> None:
        for joint in joints:
            reach = joint_interval(joint)
            if not reach.low <= position <= reach.high:
                text = self._values.field(spec, key)
                warn_beyond_limits(
                    self._values,
                    text,
                    joint_dimension(joint),
                    reach,
                    "a position of",
                    single(position),
                    f"write a value within the limits of `{joint.name}`",
                )
                return

    def _thrust(self, name: str, spec: specs.Thrust) -> ResolvedActuator | None:
        links = self._robot.links_of(spec, self._values)
        ends = self._fields.ends(spec, "range", description="the range of a thrust")
        moment_constant = self._fields.fixed(spec, "moment_constant") or 0.0
        response = self._response(spec, links)
        spin = self._spin(spec, links)
        if not links or ends is None or spin is None:
            return None
        thrust = Thrust(name, links, ends.low[0], ends.high[0], moment_constant, spin, response, spec.axis)
        return ResolvedActuator(
            thrust, spec.dimension, links if len(links) > 1 or spec.links is not None else None
        )

    def _spin(self, spec: specs.Thrust, links: tuple[str, ...]) -> tuple[float, ...] | None:
        """Return the direction of spin of each link, 1 or -1, from one number for all or from patterns; None
        after a finding."""
        if not isinstance(spec.spin, dict):
            spin = self._fields.fixed(spec, "spin") if "spin" in spec.model_fields_set else 1.0
            return None if spin is None else (spin,) * len(links)
        directions: dict[str, float | None] = {}
        unknown = False
        for pattern in spec.spin:
            members, missing = expand_patterns(links, pattern, self._robot.groups)
            unknown = unknown or bool(missing)
            if missing and links:
                report_unmatched(
                    self._values, self._values.key_span((*spec.path, "spin", pattern)), pattern, "link", links
                )
            directions |= dict.fromkeys(members, self._fields.fixed(spec, "spin", pattern))
        missing_links = [link for link in links if link not in directions]
        if missing_links and not unknown:
            self._values.add_at_key(
                "DB102",
                (*spec.path, "spin"),
                f"`spin` has no value for `{missing_links[0]}`",
                f"write 1 or -1 for each link, as in `{missing_links[0]}: 1`",
            )
        spins = [spin for link in links if (spin := directions.get(link)) is not None]
        return tuple(spins) if len(spins) == len(links) else None

    # Limits and response

    def _response(self, spec: specs.Actuator, parts: tuple[str, ...]) -> Response:
        """Return the response. Strength is drawn for each of the parts, delay and time constant for all of
        them together."""
        strength = self._scalar_or_randomized(spec, "strength", 1.0, per_component=parts)
        return Response(
            strength,
            self._scalar_or_randomized(spec, "delay", 0.0),
            self._scalar_or_randomized(spec, "time_constant", 0.0),
        )

    def _max_torque(self, spec: specs.Actuator, joints: tuple[Joint, ...]) -> Limits:
        """Return the largest torque or force of each joint: the tighter of the scenario's and that of the
        robot file."""
        file_limits = tuple(joint.limit.effort for joint in joints)
        variations = len(self._fields.variations)
        effort = effort_dimension(joints[0])
        max_torque = self._scalar_or_randomized(
            spec, "max_torque", None, dimension=effort, per_component=tuple(joint.name for joint in joints)
        )
        if max_torque is None:
            return file_limits
        new_variations = self._fields.variations[variations:]
        self._compare(
            spec,
            "max_torque",
            new_variations[0].value.typed.type.interval.high if new_variations else max_torque,
            effort,
            file_limits,
        )
        # A drawn limit is cut in each episode at that of the robot file, as a fixed one is cut below.
        self._fields.variations[variations:] = [replace(varied, max=file_limits) for varied in new_variations]
        return _tighter(file_limits, max_torque)

    def _max_velocity(self, spec: specs.Actuator, joints: tuple[Joint, ...]) -> Limits:
        """Return the largest velocity of each joint, which is not drawn: the tighter limit of scenario and
        robot file."""
        file_limits = tuple(joint.limit.velocity for joint in joints)
        if getattr(spec, "max_velocity", None) is None:
            # A spring has the given stiffness, and only its torque is limited.
            return (
                (None,) * len(joints)
                if isinstance(spec, specs.PositionMotor) and spec.stiffness is not None
                else file_limits
            )
        rate = joint_dimension(joints[0]) / TIME
        max_velocity = self._fields.fixed(spec, "max_velocity", dimension=rate)
        if max_velocity is None:
            return file_limits
        self._compare(spec, "max_velocity", max_velocity, rate, file_limits)
        return _tighter(file_limits, max_velocity)

    def _scalar_or_randomized(
        self, spec: specs.Actuator, key: str, default: Default, **context: Unpack[FieldContext]
    ) -> float | Default:
        """Return a value that an episode may draw."""
        subject = OfActuator(self._robot.name, str(spec.path[-1]))
        parameter: Any = f"actuator_{key}"  # one of the literals of the parameters
        return self._fields.scalar_or_randomized(spec, key, parameter, subject, default, **context)

    def _compare(
        self, spec: specs.Actuator, key: str, limit: float, dimension: Dimension, file_limits: Limits
    ) -> None:
        """Report DB304 for a limit that the robot file undercuts for every joint."""
        limits = [file_limit for file_limit in file_limits if file_limit is not None]
        if len(limits) == len(file_limits) and limit > max(limits) * (1 + _ROUNDING):
            text = self._values.field(spec, key)
            allowed = Interval(-math.inf, max(limits))
            joints = f"robots.{self._robot.name}.joints"
            warn_beyond_limits(
                self._values,
                text,
                dimension,
                allowed,
                "a limit of",
                single(limit),
                "deepbots uses the smaller limit: lower this value or, if the motor is stronger, write"
                f" its `{key}` under `{joints}`",
            )


def _tighter(file_limits: Limits, limit: float) -> Limits:
    return tuple(limit if file_limit is None else min(limit, file_limit) for file_limit in file_limits)
