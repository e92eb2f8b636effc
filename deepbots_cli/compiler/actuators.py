"""The actuators of a robot: kinds, limits, responses."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple, TypedDict, Unpack

from deepbots_cli.compiler.namespace import Namespace, NamespaceReader
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
from deepbots_cli.compiler.values import Default, FieldContext
from deepbots_cli.expressions.dimensions import LENGTH, TIME, Dimension
from deepbots_cli.expressions.intervals import Interval, single
from deepbots_cli.expressions.types import (
    Components,
)
from deepbots_cli.program.resets import OfActuator
from deepbots_cli.program.robots import (
    Actuator,
    Cartesian,
    CustomActuator,
    Motor,
    Response,
    Thrust,
)
from deepbots_cli.robots.model import Joint
from deepbots_cli.scenario import actuators as specs
from deepbots_cli.scenario.base import kind_parameters

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
            help = "add `stiffness`, or remove `damping` to use the built-in position control of the engine"
            self._values.add_at_key("DB102", (*spec.path, "damping"), "`damping` needs `stiffness`", help)
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
            headline = f"the joint `{idle[0]}` does not move `{spec.link}`"
            help = "name the joints between the base and the link"
            self._values.add("DB203", (*spec.path, "joints"), headline, help)
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
                help = f"write a value within the limits of `{joint.name}`"
                warn_beyond_limits(
                    self._values,
                    text,
                    joint_dimension(joint),
                    reach,
                    "a position of",
                    single(position),
                    help,
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
            help = f"write 1 or -1 for each link, as in `{missing_links[0]}: 1`"
            self._values.add_at_key(
                "DB102", (*spec.path, "spin"), f"`spin` has no value for `{missing_links[0]}`", help
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
            help = (
                "deepbots uses the smaller limit: lower this value or, if the motor is stronger, write"
                f" its `{key}` under `{joints}`"
            )
            warn_beyond_limits(self._values, text, dimension, allowed, "a limit of", single(limit), help)


def _tighter(file_limits: Limits, limit: float) -> Limits:
    return tuple(limit if file_limit is None else min(limit, file_limit) for file_limit in file_limits)
