"""Robots as controllers: sensors, actuators, what they receive, emit and apply."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from deepbots_cli import ir
from deepbots_cli.compiler.joints import effort_of, joint_dimension
from deepbots_cli.compiler.matching import joints_of
from deepbots_cli.compiler.namespace import Namespace, Origin
from deepbots_cli.compiler.poses import poses
from deepbots_cli.compiler.robots import RobotScene
from deepbots_cli.compiler.scopes import ParameterScope, RobotScope, SupervisorScope
from deepbots_cli.compiler.sensing import Sensing
from deepbots_cli.compiler.values import Values
from deepbots_cli.diagnostics.nearest import nearest
from deepbots_cli.lang.dimensions import TIME, Dimension
from deepbots_cli.lang.types import Context, Stage, Symbol
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
        self.sensing = Sensing(self.scene, self.namespace)
        self.poses = poses(self.scene, self.namespace)
        self.own: dict[str, Symbol] = {**self.poses, **self.sensing.symbols}
        self.fields: dict[str, Valued] = {}
        self.received: dict[str, Valued] = {}
        self._check_names()
        self._define_fields()

    # What it knows

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

    def finish(self, tick: float) -> TaskRobot:
        """Type everything that is left; the world's timestep is `tick` s."""
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
            self.sensing.finished(tick),
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
        joints = joints_of(self.values, self.scene.model, self.scene.groups, spec, place)
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


def _target_dimension(kind: str, joint: Joint) -> Dimension:
    position = joint_dimension(joint)
    return {"velocity_motor": position / TIME, "position_motor": position, "torque_motor": effort_of(joint)}[kind]
