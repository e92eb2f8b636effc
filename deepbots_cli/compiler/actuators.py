"""The actuators of a robot: what they drive, how strongly, how promptly, and what a command has to be."""

from __future__ import annotations

from typing import NamedTuple

from deepbots_cli import ir
from deepbots_cli.compiler.joints import effort_of, joint_dimension
from deepbots_cli.compiler.matching import joints_of
from deepbots_cli.compiler.namespace import Namespace
from deepbots_cli.compiler.robots import RobotScene
from deepbots_cli.compiler.scopes import ParameterScope
from deepbots_cli.compiler.variations import figure, figures
from deepbots_cli.lang.dimensions import NUMBER, TIME, Dimension
from deepbots_cli.lang.types import Components, Context
from deepbots_cli.schema.actuators import Actuator, Motor, PositionMotor, VelocityMotor
from deepbots_cli.source.nodes import Path
from deepbots_cli.urdf.model import Joint

_KINDS: dict[str, ir.MotorKind] = {
    "velocity_motor": "velocity_motor",
    "position_motor": "position_motor",
    "torque_motor": "torque_motor",
}


class Driven(NamedTuple):
    """An actuator, and what its command is: of a dimension, with components or (None) a single number."""

    actuator: ir.Actuator
    dimension: Dimension
    components: Components | None


class Actuators:
    """Reads the actuators of one robot."""

    def __init__(self, scene: RobotScene, namespace: Namespace) -> None:
        self._scene = scene
        self._namespace = namespace
        self._values = namespace.values
        self._scope = ParameterScope(namespace, Context.FIELD)

    def read(self, name: str) -> Driven | None:
        """The actuator called `name`; None after a finding. One without a command varies nothing."""
        spec = self._scene.spec.actuators[name]
        varied = len(self._namespace.variations)
        driven = self._motor(name, spec) if isinstance(spec, Motor) else None  # `support` has refused the others
        if name not in self._scene.spec.apply:
            del self._namespace.variations[varied:]
        return driven

    def _motor(self, name: str, spec: Motor) -> Driven | None:
        place = self._place(name)
        joints = joints_of(self._values, self._scene.model, self._scene.groups, spec, place)
        if not joints:
            return None
        names, effort, position = tuple(joint.name for joint in joints), effort_of(joints[0]), joint_dimension(joints[0])
        max_torque = self._effort(name, spec.max_torque, joints)
        rate, max_velocity = position / TIME, tuple(joint.limit.velocity for joint in joints)
        max_acceleration = stiffness = damping = None
        if isinstance(spec, (VelocityMotor, PositionMotor)):
            max_velocity = self._velocity(name, spec.max_velocity, joints)
        if isinstance(spec, VelocityMotor) and spec.max_acceleration is not None:
            max_acceleration = self._values.number((*place, "max_acceleration"), spec.max_acceleration, rate / TIME, self._scope)
        if isinstance(spec, PositionMotor):
            stiffness = self._each(name, "stiffness", spec.stiffness, effort / position, names)
            damping = self._each(name, "damping", spec.damping, effort / rate, names)
            if spec.damping is not None and spec.stiffness is None:
                headline, help = "a damping without a stiffness", "give `stiffness` too, or leave both to the servo of the engine"
                self._values.findings.add("DB102", self._values.key_span((*place, "damping")), headline, help=help)
        kind = _KINDS[spec.type]
        response = self._response(name, spec, names)
        motor = ir.Motor(name, kind, names, max_torque, max_velocity, stiffness, damping, max_acceleration, response)
        dimension = {"velocity_motor": rate, "position_motor": position, "torque_motor": effort}[kind]
        many = len(joints) > 1 or spec.joints is not None
        return Driven(motor, dimension, names if many else None)

    def _response(self, name: str, spec: Actuator, parts: tuple[str, ...]) -> ir.Response:
        """Strength is drawn for each of the parts, delay and lag for all of them together."""
        strength = self._each(name, "strength", spec.strength, NUMBER, parts)
        delay, lag = (self._whole(name, what, getattr(spec, what), TIME) for what in ("delay", "lag"))
        return ir.Response(1.0 if strength is None else strength, delay or 0.0, lag or 0.0)

    def _effort(self, name: str, given: object, joints: tuple[Joint, ...]) -> tuple[float | None, ...]:
        """The largest torque or force of each joint: the scenario's, else that of the robot file."""
        own = tuple(joint.limit.effort for joint in joints)
        known = len(self._namespace.variations)
        effort = effort_of(joints[0])
        figure = self._each(name, "max_torque", given, effort, tuple(joint.name for joint in joints))
        if figure is None:
            return own
        drawn = self._namespace.variations[known:]
        self._compare(name, "max_torque", drawn[0].value.typed.type.interval.high if drawn else figure, effort, own)
        return (figure,) * len(own)

    def _velocity(self, name: str, given: object, joints: tuple[Joint, ...]) -> tuple[float | None, ...]:
        own = tuple(joint.limit.velocity for joint in joints)
        if given is None:
            return own
        rate = joint_dimension(joints[0]) / TIME
        figure = self._values.number((*self._place(name), "max_velocity"), given, rate, self._scope)
        if figure is None:
            return own
        self._compare(name, "max_velocity", figure, rate, own)
        return (figure,) * len(own)

    def _compare(self, name: str, key: str, limit: float, dimension: Dimension, own: tuple[float | None, ...]) -> None:
        """DB304 for a limit beyond those of the robot file."""
        over = [least for least in own if least is not None and limit > least * (1 + 1e-9)]
        if over:
            headline = f"a limit of {limit:g} {dimension}, where the robot file allows {min(over):g}"
            help = f"lower it, or raise `{key}` under `joints` if the motor can do more"
            self._values.findings.add("DB304", self._values.span((*self._place(name), key)), headline, help=help)

    def _each(self, name: str, key: str, given: object, dimension: Dimension, parts: tuple[str, ...]) -> float | None:
        """A figure of all parts alike, or one that every episode draws anew for each of them."""
        of = (self._scene.name, name)
        found = figures(self._namespace, (*self._place(name), key), given, dimension, self._scope, f"actuator_{key}", of, None, parts)
        return found[0] if found else None

    def _whole(self, name: str, key: str, given: object, dimension: Dimension) -> float | None:
        of = (self._scene.name, name)
        return figure(self._namespace, (*self._place(name), key), given, dimension, self._scope, f"actuator_{key}", of)

    def _place(self, name: str) -> Path:
        return ("robots", self._scene.name, "actuators", name)
