"""The actuators of a robot: what they drive, and what a command has to be."""

from __future__ import annotations

from typing import NamedTuple

from deepbots_cli.compiler.drives import Figures
from deepbots_cli.compiler.joints import carries, effort_of, joint_dimension, joint_interval
from deepbots_cli.compiler.matching import expand, joints_of, links_of, unmatched
from deepbots_cli.compiler.namespace import Namespace
from deepbots_cli.compiler.robots import RobotScene
from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions.dimensions import ANGLE, FORCE, LENGTH, NUMBER, TIME, Dimension
from deepbots_cli.expressions.intervals import exact
from deepbots_cli.expressions.types import SPACE, Components
from deepbots_cli.program.robots import Actuator, Cartesian, Motor, MotorKind, Thrust
from deepbots_cli.robots.model import Joint
from deepbots_cli.scenario.actuators import Actuator as ActuatorSpec
from deepbots_cli.scenario.actuators import Cartesian as CartesianSpec
from deepbots_cli.scenario.actuators import Gripper, PositionMotor, VelocityMotor
from deepbots_cli.scenario.actuators import Motor as MotorSpec
from deepbots_cli.scenario.actuators import Thrust as ThrustSpec

_KINDS: dict[str, MotorKind] = {
    "velocity_motor": "velocity_motor",
    "position_motor": "position_motor",
    "torque_motor": "torque_motor",
}


class Driven(NamedTuple):
    """An actuator, and what its command is: of a dimension, with components or (None) a single number."""

    actuator: Actuator
    dimension: Dimension
    components: Components | None
    opening: tuple[float, float] | None = None
    """Of a gripper: the position of its joints at a command of 0, and at 1."""


def driven_parts(scene: RobotScene, spec: ActuatorSpec) -> Components | None:
    """The components of a command to the actuator, without findings; None where there are none."""
    if isinstance(spec, CartesianSpec):
        return SPACE
    if isinstance(spec, ThrustSpec):
        found, _ = expand(scene.link_names, spec.links or spec.link or (), scene.groups)
    else:
        patterns = getattr(spec, "joints", None) or getattr(spec, "joint", None) or ()
        found, _ = expand([joint.name for joint in scene.model.moving_joints], patterns, scene.groups)
    return found or None


class Actuators:
    """Reads the actuators of one robot."""

    def __init__(self, scene: RobotScene, namespace: Namespace) -> None:
        self._scene = scene
        self._namespace = namespace
        self._values = namespace.values

    def read(self, name: str) -> Driven | None:
        """The actuator called `name`; None after a finding. One without a command varies nothing."""
        spec = self._scene.spec.actuators[name]
        figures = Figures(self._scene.name, name, self._namespace)
        varied = len(self._namespace.variations)
        match spec:
            case MotorSpec():
                driven = self._motor(name, spec, figures)
            case ThrustSpec():
                driven = self._thrust(name, spec, figures)
            case CartesianSpec():
                driven = self._cartesian(name, spec, figures)
            case Gripper():
                driven = self._gripper(name, spec, figures)
            case _:
                raise TypeError(f"{type(spec).__name__} is in no table")
        if name not in self._scene.spec.apply:
            del self._namespace.variations[varied:]
        return driven

    def _motor(self, name: str, spec: MotorSpec, figures: Figures) -> Driven | None:
        joints = joints_of(self._values, self._scene.model, self._scene.groups, spec, figures.place)
        if not joints:
            return None
        names, effort, position = tuple(joint.name for joint in joints), effort_of(joints[0]), joint_dimension(joints[0])
        max_torque, rate = figures.max_torque(spec.max_torque, joints), position / TIME
        max_velocity = figures.max_velocity(spec.max_velocity if isinstance(spec, (VelocityMotor, PositionMotor)) else None, joints)
        if isinstance(spec, PositionMotor) and spec.stiffness is not None and spec.max_velocity is None:
            max_velocity = (None,) * len(joints)  # a spring pulls as it is said to, and its torque is what bounds it
        max_acceleration = stiffness = damping = None
        if isinstance(spec, VelocityMotor):
            max_acceleration = figures.number("max_acceleration", spec.max_acceleration, rate / TIME)
        if isinstance(spec, PositionMotor):
            stiffness = figures.each("stiffness", spec.stiffness, effort / position, names)
            damping = figures.each("damping", spec.damping, effort / rate, names)
            if spec.damping is not None and spec.stiffness is None:
                headline, help = "a damping without a stiffness", "give `stiffness` too, or leave both to the servo of the engine"
                self._values.findings.add("DB102", self._values.key_span((*figures.place, "damping")), headline, help=help)
        kind, response = _KINDS[spec.type], figures.response(spec, names)
        motor = Motor(name, kind, names, max_torque, max_velocity, stiffness, damping, max_acceleration, response)
        dimension = {"velocity_motor": rate, "position_motor": position, "torque_motor": effort}[kind]
        return Driven(motor, dimension, names if len(names) > 1 or spec.joints is not None else None)

    def _cartesian(self, name: str, spec: CartesianSpec, figures: Figures) -> Driven | None:
        joints = joints_of(self._values, self._scene.model, self._scene.groups, spec, figures.place)
        if spec.link not in self._scene.link_names:
            self._values.unknown(self._values.span((*figures.place, "link")), "link", spec.link, self._scene.link_names)
            return None
        rpy = None if spec.rpy is None else self._values.numbers((*figures.place, "rpy"), spec.rpy, ANGLE, SPACE, figures.scope)
        if not joints or (spec.rpy is not None and rpy is None):
            return None
        moving = {joint.name for joint in self._scene.model.moving_joints if carries(self._scene.model, joint, spec.link)}
        idle = [joint.name for joint in joints if joint.name not in moving]
        if idle:
            headline, help = f"the joint `{idle[0]}` does not move `{spec.link}`", "name the joints between the base and the link"
            self._values.findings.add("DB203", self._values.span((*figures.place, "joints")), headline, help=help)
            return None
        names = tuple(joint.name for joint in joints)
        limits = figures.max_torque(spec.max_torque, joints), figures.max_velocity(spec.max_velocity, joints)
        attitude = None if rpy is None else (rpy[0], rpy[1], rpy[2])
        return Driven(Cartesian(name, spec.link, names, attitude, *limits, figures.response(spec, names)), LENGTH, SPACE)

    def _gripper(self, name: str, spec: Gripper, figures: Figures) -> Driven | None:
        """A servo whose command is how far it is open."""
        joints = joints_of(self._values, self._scene.model, self._scene.groups, spec, figures.place)
        if not joints:
            return None
        position = joint_dimension(joints[0])
        closed, open_ = (figures.number(key, getattr(spec, key), position) for key in ("closed", "open"))
        names = tuple(joint.name for joint in joints)
        limits = figures.max_torque(spec.max_torque, joints), figures.max_velocity(None, joints)
        motor = Motor(name, "position_motor", names, *limits, response=figures.response(spec, names))
        if closed is None or open_ is None:
            return None
        for key, figure in (("closed", closed), ("open", open_)):
            self._check_reach((*figures.place, key), figure, joints)
        return Driven(motor, NUMBER, None, (closed, open_))

    def _check_reach(self, place: Path, position: float, joints: tuple[Joint, ...]) -> None:
        """DB304 for a position that a joint cannot take."""
        for joint in joints:
            reach = joint_interval(joint)
            if not reach.low <= position <= reach.high:
                from deepbots_cli.compiler.confines import Confines  # only on the way to a finding

                confines = Confines(self._values, self._values.text(place), joint_dimension(joint), reach)
                confines.report("a position of", exact(position), f"keep to the limits of `{joint.name}`")
                return

    def _thrust(self, name: str, spec: ThrustSpec, figures: Figures) -> Driven | None:
        links = links_of(self._values, self._scene.link_names, self._scene.groups, spec, figures.place)
        text = self._values.text((*figures.place, "range"), spec.range)
        ends = self._values.ends(text, "the range of a thrust", figures.scope, dimension=FORCE)
        drag = figures.number("drag", spec.drag, LENGTH)
        response = figures.response(spec, links)
        spin = self._spin(spec, links, figures)
        if not links or ends is None or spin is None:
            return None
        thrust = Thrust(name, links, ends.low[0], ends.high[0], drag or 0.0, spin, response)
        return Driven(thrust, FORCE, links if len(links) > 1 or spec.links is not None else None)

    def _spin(self, spec: ThrustSpec, links: tuple[str, ...], figures: Figures) -> tuple[float, ...] | None:
        """The sense of each link, from one figure for all or from patterns; None after a finding."""
        if not isinstance(spec.spin, dict):
            found = figures.number("spin", spec.spin, NUMBER)
            return None if found is None else (found,) * len(links)
        senses: dict[str, float | None] = {}
        unknown = False
        place = (*figures.place, "spin")
        for pattern, given in spec.spin.items():
            members, missing = expand(links, pattern, self._scene.groups)
            unknown = unknown or bool(missing)
            if missing and links:
                unmatched(self._values, self._values.key_span((*place, pattern)), pattern, "link", links)
            sense = self._values.number((*place, pattern), given, NUMBER, figures.scope)
            senses |= dict.fromkeys(members, sense)
        open_ = [link for link in links if link not in senses]
        if open_ and not unknown:
            headline, help = f"no spin for `{open_[0]}`", "give 1 or -1 for each link"
            self._values.findings.add("DB102", self._values.key_span(place), headline, help=help)
        found_all = [sense for link in links if (sense := senses.get(link)) is not None]
        return tuple(found_all) if len(found_all) == len(links) else None
