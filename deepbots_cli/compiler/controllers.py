"""The controller of a robot: its poses, its commands, and the messages that it sends and receives."""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

from deepbots_cli.compiler.actuators import Actuators, ResolvedActuator
from deepbots_cli.compiler.namespace import Namespace, Origin, RobotScope, SupervisorScope
from deepbots_cli.compiler.robots import (
    ResolvedRobot,
    expand_patterns,
    joint_dimension,
)
from deepbots_cli.compiler.sensing import SensorsCompiler
from deepbots_cli.compiler.values import ValueReader
from deepbots_cli.diagnostics.nearest import nearest_word
from deepbots_cli.document.nodes import NodePath
from deepbots_cli.expressions.intervals import ZERO, hull, single
from deepbots_cli.expressions.types import (
    Context,
    Invocation,
    Known,
    Reference,
    Symbol,
    ValueType,
    referenced_names,
    walk,
)
from deepbots_cli.program.robots import (
    Command,
    Direction,
    Link,
    MessageField,
    Robot,
    Route,
)
from deepbots_cli.program.task import ActionPart, ActionRange
from deepbots_cli.program.values import Expression
from deepbots_cli.scenario import actuators as specs

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
            help = "hear the robot that sends the value, or send a value of `emit`"
            self.values.add("DB407", path, f"`{sender}` hears `{source}`, and does not send it", help)
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
                    headline = (
                        f"the start of `{node.function}` is a received value; with `on_loss: zero`,"
                        " it is 0 if the first message is lost"
                    )
                    help = (
                        "write `on_loss: hold` or `skip` under `messages.to_robot`: the robot applies"
                        " nothing until a message arrives"
                    )
                    report("DB407", node.start, node.end, headline, help)

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
