"""Robots as controllers: sensors, actuators, what they receive, emit and apply."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from deepbots_cli import ir
from deepbots_cli.compiler.joints import effort_of, hull, joint_dimension
from deepbots_cli.compiler.matching import expand, joint_missing
from deepbots_cli.compiler.namespace import Namespace, Origin
from deepbots_cli.compiler.poses import poses
from deepbots_cli.compiler.robots import RobotScene
from deepbots_cli.compiler.scopes import ParameterScope, RobotScope, SupervisorScope
from deepbots_cli.compiler.sensors import SENSOR_KINDS
from deepbots_cli.compiler.values import Values
from deepbots_cli.diagnostics.nearest import nearest
from deepbots_cli.lang.dimensions import LENGTH, SPEED, TIME, Dimension
from deepbots_cli.lang.intervals import EVERYTHING, Interval
from deepbots_cli.lang.types import SPACE, Context, Stage, Symbol, Type
from deepbots_cli.schema.actuators import Motor, PositionMotor, TorqueMotor, VelocityMotor
from deepbots_cli.source.nodes import Path
from deepbots_cli.task import Command, TaskRobot, Valued
from deepbots_cli.urdf.model import Joint


@dataclass(eq=False)
class Controller:
    """The controller of one robot, while it is being compiled."""

    scene: RobotScene
    namespace: Namespace

    def __post_init__(self) -> None:
        self.values: Values = self.namespace.values
        self.path: Path = ("robots", self.scene.name)
        self.sensors: dict[str, ir.Sensor] = {}
        self.poses = poses(self.scene, self.namespace)
        self.own: dict[str, Symbol] = dict(self.poses)
        self.fields: dict[str, Valued] = {}
        self.received: dict[str, Valued] = {}
        self._add_sensors()
        self._check_names()
        self._define_fields()

    # What it knows

    def _add_sensors(self) -> None:
        for name, spec in self.scene.spec.sensors.items():
            kind = SENSOR_KINDS.get(spec.type)
            self.own[name] = Symbol(name, None)
            if kind is None:
                continue  # `support` has said that this kind is not delivered yet
            place = (*self.path, "sensors", name)
            if kind.of == "joints":
                joints = self.joints_of(spec, place)
                if joints:
                    self.own[name] = self._joint_sensor(name, spec.type, joints, many=getattr(spec, "joints", None) is not None)
            else:
                link = str(getattr(spec, "link", ""))
                if link not in self.scene.link_names:
                    self.values.unknown(self.values.span((*place, "link")), "link", link, self.scene.link_names)
                    continue
                dimension = LENGTH if spec.type == "position" else SPEED
                self.sensors[name] = ir.Sensor(name, spec.type, (link,), SPACE, str(dimension))
                self.own[name] = Symbol(name, Type(dimension, SPACE, stage=Stage.STEP))

    def _check_names(self) -> None:
        """No name on board may mean two things, also not one here and another in the scenario."""
        spec = self.scene.spec
        taken: dict[str, tuple[str, Path]] = {}
        for name in self.namespace.named(Origin.PARAMETER, Origin.ACTION):
            definition = self.namespace.definitions[name]
            taken[name] = (definition.origin.value, definition.path)
        for what, section, names in (("a pose", "poses", spec.poses), ("a sensor", "sensors", spec.sensors)):
            for name in names:
                place = (*self.path, section, name)
                if name in taken:
                    self.values.taken(place, name, *taken[name])
                taken[name] = (what, place)
        for name in spec.receive or {}:
            if name in spec.poses or name in spec.sensors:
                self.values.taken((*self.path, "receive", name), name, *taken[name])

    def _joint_sensor(self, name: str, kind: str, joints: tuple[Joint, ...], *, many: bool) -> Symbol:
        dimension = _fact_dimension(kind, joints[0])
        components = tuple(joint.name for joint in joints) if many else ()
        interval = _interval(kind, joints)
        self.sensors[name] = ir.Sensor(name, kind, tuple(joint.name for joint in joints), components, str(dimension))
        return Symbol(name, Type(dimension, components or None, interval=interval, stage=Stage.STEP))

    def joints_of(self, spec: object, place: Path) -> tuple[Joint, ...]:
        """The joints that `joint` or `joints` of a sensor or actuator names; empty after a finding."""
        key = "joint" if getattr(spec, "joint", None) is not None else "joints"
        patterns = getattr(spec, key) or ()  # neither is left where the schema had a finding about it
        moving = [joint.name for joint in self.scene.model.moving_joints]
        names, missing = expand(moving, patterns, self.scene.groups)
        for index, pattern in enumerate([patterns] if isinstance(patterns, str) else patterns):
            if pattern in missing:
                span = self.values.span((*place, key) if isinstance(patterns, str) else (*place, key, index))
                joint_missing(self.values, span, pattern, self.scene.model)
        if missing or not names:
            return ()
        joints = tuple(self.scene.model.joint(name) for name in names)
        if len({joint_dimension(joint) for joint in joints}) > 1:
            self.values.findings.add(
                "DB404", self.values.span((*place, key)), "turning and sliding joints together", help="name them apart"
            )
            return ()
        return joints

    # What it sends

    def _define_fields(self) -> None:
        emit = self.scene.spec.emit
        entries = (
            [(name, (*self.path, "emit", name)) for name in emit]
            if isinstance(emit, dict)
            else [(name, (*self.path, "emit", i)) for i, name in enumerate(emit)]
        )
        for name, place in entries:
            self.namespace.define(f"{self.scene.name}.{name}", Origin.FIELD, place, partial(self._field, name, place))

    def _field(self, name: str, place: Path) -> Symbol:
        full = f"{self.scene.name}.{name}"
        emit = self.scene.spec.emit
        text = self.values.text(place, emit[name] if isinstance(emit, dict) else name)
        if not isinstance(emit, dict) and name not in self.own:
            sensors = list(self.scene.spec.sensors)
            self.values.unknown(text.span, "sensor", name, sensors)
            if meant := nearest(name, sensors):
                self.values.lose(f"{self.scene.name}.{meant}")
            return Symbol(full, None)
        typed = self.values.expression(text, RobotScope(self.namespace, Context.EMIT, self.scene.name, self.own))
        if typed is None:
            return Symbol(full, None)
        self.fields[name] = Valued(name, text.span, text.text, typed, f"{self.scene.name}.emit.{name}")
        return Symbol(full, typed.type._replace(stage=Stage.STEP))

    # What it receives and does

    def _receive(self) -> dict[str, Symbol]:
        """Action variables, and what `receive` adds to them."""
        spec = self.scene.spec
        symbols = {name: self.namespace.settle(name) or Symbol(name, None) for name in self.namespace.named(Origin.ACTION)}
        for name, given in (spec.receive or {}).items():
            place = (*self.path, "receive", name)
            text = self.values.text(place, given)
            typed = self.values.expression(text, SupervisorScope(self.namespace, Context.RECEIVE))
            symbols[name] = Symbol(name, None)
            if typed is not None:
                self.received[name] = Valued(name, text.span, text.text, typed, f"{self.scene.name}.receive.{name}")
                symbols[name] = Symbol(name, typed.type._replace(stage=Stage.STEP))
        return symbols

    def finish(self) -> TaskRobot:
        """Type everything that is left."""
        received = self._receive()
        scope = RobotScope(self.namespace, Context.APPLY, self.scene.name, {**self.own, **received})
        actuators = {name: actuator for name in self.scene.spec.actuators if (actuator := self._actuator(name)) is not None}
        commands = []
        for name, given in self.scene.spec.apply.items():
            place = (*self.path, "apply", name)
            if name not in self.scene.spec.actuators:
                self.values.unknown(self.values.key_span(place), "actuator", name, list(self.scene.spec.actuators))
                continue
            command = self._command(name, given, place, actuators.get(name), scope)
            if command:
                commands.append(command)
        return TaskRobot(
            self.scene.name,
            tuple(self.sensors.values()),
            tuple(actuators.values()),
            tuple(self.received.values()),
            tuple(self.fields.values()),
            tuple(commands),
        )

    def _command(self, name: str, given: object, place: Path, actuator: ir.Actuator | None, scope: RobotScope) -> Command | None:
        text = self.values.text(place, given)
        if actuator is None:
            self.values.expression(text, scope, boolean=False)
            return None
        dimension = _target_dimension(actuator.kind, self.scene.model.joint(actuator.joints[0]))
        components = actuator.joints if len(actuator.joints) > 1 or getattr(self.scene.spec.actuators[name], "joints", None) else None
        typed = self.values.quantity(text, f"the target of `{name}`", scope, dimension, components, Stage.STEP)
        return Command(actuator, Valued(name, text.span, text.text, typed, f"{self.scene.name}.apply.{name}")) if typed else None

    def _actuator(self, name: str) -> ir.Actuator | None:
        spec = self.scene.spec.actuators[name]
        place = (*self.path, "actuators", name)
        if not isinstance(spec, Motor):
            return None  # `support` has said that this kind is not delivered yet
        joints = self.joints_of(spec, place)
        if not joints:
            return None
        effort = effort_of(joints[0])
        max_torque = self._limit((*place, "max_torque"), spec.max_torque, effort, [joint.limit.effort for joint in joints])
        rate = joint_dimension(joints[0]) / TIME
        given_velocity = spec.max_velocity if isinstance(spec, (VelocityMotor, PositionMotor)) else None
        max_velocity = self._limit((*place, "max_velocity"), given_velocity, rate, [joint.limit.velocity for joint in joints])
        stiffness = damping = None
        if isinstance(spec, PositionMotor):
            stiffness = self._figure((*place, "stiffness"), spec.stiffness, effort / joint_dimension(joints[0]))
            damping = self._figure((*place, "damping"), spec.damping, effort / rate)
        kind: ir.ActuatorKind = (
            "torque_motor" if isinstance(spec, TorqueMotor) else "velocity_motor" if isinstance(spec, VelocityMotor) else "position_motor"
        )
        return ir.Actuator(name, kind, tuple(joint.name for joint in joints), max_torque, max_velocity, stiffness, damping)

    def _limit(self, place: Path, given: object, dimension: Dimension, from_urdf: list[float | None]) -> tuple[float | None, ...]:
        """The limit of each joint: the scenario's, else that of the robot file."""
        figure = self._figure(place, given, dimension)
        if figure is None:
            return tuple(from_urdf)
        over = [limit for limit in from_urdf if limit is not None and figure > limit * (1 + 1e-9)]
        if over:
            headline = f"a limit of {figure:g} {dimension}, where the robot file allows {min(over):g}"
            self.values.findings.add(
                "DB304", self.values.span(place), headline, help=f"lower it, or raise `{place[-1]}` under `joints` if the motor can do more"
            )
        return (figure,) * len(from_urdf)

    def _figure(self, place: Path, given: object, dimension: Dimension) -> float | None:
        return self.values.figure(place, given, dimension, ParameterScope(self.namespace, Context.FIELD))


def _fact_dimension(kind: str, joint: Joint) -> Dimension:
    position = joint_dimension(joint)
    return {"joint_position": position, "joint_velocity": position / TIME, "joint_torque": effort_of(joint)}[kind]


def _target_dimension(kind: str, joint: Joint) -> Dimension:
    position = joint_dimension(joint)
    return {"velocity_motor": position / TIME, "position_motor": position, "torque_motor": effort_of(joint)}[kind]


def _interval(kind: str, joints: tuple[Joint, ...]) -> Interval:
    """What the limits of the joints leave for a sensor's readings."""
    return hull(joints) if kind == "joint_position" else EVERYTHING
