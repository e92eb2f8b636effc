"""The controller of a robot: its actuators and their limits, poses, commands, and the messages that it sends and receives."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

from deepbots_cli.compiler.namespace import Namespace, Origin, ParameterScope, RobotScope, SupervisorScope
from deepbots_cli.compiler.robots import (
    RobotScene,
    carries,
    effort_of,
    expand,
    joint_dimension,
    joint_interval,
    joint_missing,
    joints_of,
    links_of,
    unmatched,
)
from deepbots_cli.compiler.sensing import Sensing
from deepbots_cli.compiler.values import Text, Values, figure, figures
from deepbots_cli.diagnostics import Edit, Fix
from deepbots_cli.diagnostics.nearest import nearest
from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions import syntax
from deepbots_cli.expressions.dimensions import ANGLE, FORCE, LENGTH, NUMBER, TIME, UNITS, Dimension, Unit
from deepbots_cli.expressions.intervals import Interval, exact
from deepbots_cli.expressions.types import SPACE, Components, Context, Reference, Stage, Symbol, Type, walk
from deepbots_cli.program.robots import Actuator, Cartesian, Command, MessageField, Motor, MotorKind, Response, Robot, Route, Thrust
from deepbots_cli.program.task import ActionPart, ActionRange
from deepbots_cli.program.values import Expression
from deepbots_cli.robots.model import Joint
from deepbots_cli.scenario.actuators import Actuator as ActuatorSpec
from deepbots_cli.scenario.actuators import Cartesian as CartesianSpec
from deepbots_cli.scenario.actuators import Gripper, PositionMotor, VelocityMotor
from deepbots_cli.scenario.actuators import Motor as MotorSpec
from deepbots_cli.scenario.actuators import Thrust as ThrustSpec

_NUMBER = re.compile(r"[-+]?[0-9.][0-9_.]*(?:[eE][-+]?[0-9]+)?")
_DIGITS = 4


class Confines:
    """What the robot file allows a figure that is written in `text`."""

    def __init__(self, values: Values, text: Text, dimension: Dimension, allowed: Interval) -> None:
        self._values = values
        self._text = text
        self._allowed = allowed
        tree = values.parsed(text)
        self._figures = list(_figures(tree)) if tree else []
        units = [figure.unit for figure in self._figures if figure.unit is not None and figure.unit.dimension == dimension]
        self._unit = units[0] if units else UNITS["deg"] if dimension == ANGLE else Unit(str(dimension), dimension)

    def report(self, what: str, found: Interval, help: str) -> None:
        """A warning that `what` is `found`, which is not all within what is allowed."""
        limits = self._allowed if self._allowed.low > -math.inf else Interval(self._allowed.high, self._allowed.high)
        headline = f"{what} {self._shown(found)} {self._unit.text}, where the robot file allows {self._shown(limits)}"
        self._values.findings.add("DB304", self._text.span, headline, help=help, fix=self._within())

    def _shown(self, known: Interval) -> str:
        low, high = (f"{end / self._unit.to_si(1.0):.{_DIGITS}g}" for end in known)
        return low if low == high else f"{low} .. {high}"

    def _within(self) -> Fix | None:
        """Each figure at the limit that it is beyond; None where they stand for something else, or none would be left to draw from."""
        kept = [self._held(limit) for limit in self._figures]
        if not kept or (len(kept) > 1 and kept[0] >= kept[1]):
            return None
        edits = []
        for limit, value in zip(self._figures, kept, strict=True):
            written = _NUMBER.match(self._text.text, limit.start)
            if written is None:
                return None
            span = self._text.part(*written.span())
            if span.text != written.group():
                return None
            if value != limit.value:
                edits.append(Edit(span, f"{value:.{_DIGITS}g}"))
        return Fix(tuple(edits), safe=False) if edits else None

    def _held(self, figure: syntax.Number) -> float:
        one = figure.unit.to_si(1.0) if figure.unit else 1.0
        low, high = (end / one for end in self._allowed)
        return _rounded(low, math.ceil) if figure.value < low else _rounded(high, math.floor) if figure.value > high else figure.value


def _figures(tree: syntax.Node) -> Iterator[syntax.Number]:
    """The numbers of a text that holds a single figure, or the two ends that one is drawn from; otherwise none."""
    match tree:
        case syntax.Number():
            yield tree
        case syntax.Call(function="uniform", args=(syntax.Range(low=syntax.Number() as low, high=syntax.Number() as high),)):
            yield from (low, high)


def _rounded(limit: float, inwards: Callable[[float], int]) -> float:
    """A limit to a few digits, and not beyond itself."""
    near = float(f"{limit:.{_DIGITS}g}")
    if math.isclose(near, limit, rel_tol=1e-9) or limit == 0.0:
        return near
    digits = _DIGITS - 1 - math.floor(math.log10(abs(limit)))
    scale = 10.0**digits
    return inwards(limit * scale) / scale


Limits = tuple[float | None, ...]


class ActuatorLimits:
    """Reads figures of the actuator called `name`; what an episode draws anew becomes a variation `actuator_...` of it."""

    def __init__(self, robot: str, name: str, namespace: Namespace) -> None:
        self.place: Path = ("robots", robot, "actuators", name)
        self._of = (robot, name)
        self._namespace = namespace
        self._values = namespace.values
        self.scope = ParameterScope(namespace, Context.FIELD)

    def response(self, spec: ActuatorSpec, parts: tuple[str, ...]) -> Response:
        """Strength is drawn for each of the parts, delay and lag for all of them together."""
        strength = self.each("strength", spec.strength, NUMBER, parts)
        delay, lag = (self._single(key, getattr(spec, key), TIME) for key in ("delay", "lag"))
        return Response(1.0 if strength is None else strength, delay or 0.0, lag or 0.0)

    def max_torque(self, given: object, joints: tuple[Joint, ...]) -> Limits:
        """The largest torque or force of each joint: the tighter of the scenario's and that of the robot file."""
        own, known, effort = tuple(joint.limit.effort for joint in joints), len(self._namespace.variations), effort_of(joints[0])
        found = self.each("max_torque", given, effort, tuple(joint.name for joint in joints))
        if found is None:
            return own
        drawn = self._namespace.variations[known:]
        self._compare("max_torque", drawn[0].value.typed.type.interval.high if drawn else found, effort, own)
        self._namespace.variations[known:] = [replace(varied, max=own) for varied in drawn]
        return _tighter(own, found)

    def max_velocity(self, given: object, joints: tuple[Joint, ...]) -> Limits:
        """The same for velocities, which are not drawn."""
        own = tuple(joint.limit.velocity for joint in joints)
        if given is None:
            return own
        rate = joint_dimension(joints[0]) / TIME
        found = self._values.number((*self.place, "max_velocity"), given, rate, self.scope)
        if found is None:
            return own
        self._compare("max_velocity", found, rate, own)
        return _tighter(own, found)

    def number(self, key: str, given: object, dimension: Dimension) -> float | None:
        """A fixed figure; None where none is given, and after a finding."""
        return None if given is None else self._values.number((*self.place, key), given, dimension, self.scope)

    def each(self, key: str, given: object, dimension: Dimension, parts: tuple[str, ...]) -> float | None:
        """A figure of all parts alike, or one that every episode draws anew for each of them."""
        place = (*self.place, key)
        found = figures(self._namespace, place, given, dimension, self.scope, f"actuator_{key}", self._of, None, parts)
        return found[0] if found else None

    def _single(self, key: str, given: object, dimension: Dimension) -> float | None:
        return figure(self._namespace, (*self.place, key), given, dimension, self.scope, f"actuator_{key}", self._of)

    def _compare(self, key: str, limit: float, dimension: Dimension, own: Limits) -> None:
        """DB304 for a limit that the robot file undercuts for every joint."""
        known = [most for most in own if most is not None]
        if len(known) == len(own) and limit > max(known) * (1 + 1e-9):
            place = (*self.place, key)
            confines = Confines(self._values, self._values.text(place), dimension, Interval(-math.inf, max(known)))
            help = f"that of the robot file holds: lower this one, or raise `{key}` under `joints` if the motor can do more"
            confines.report("a limit of", exact(limit), help)


def _tighter(own: Limits, found: float) -> Limits:
    return tuple(found if most is None else min(found, most) for most in own)


_KINDS: dict[str, MotorKind] = {
    "velocity_motor": "velocity_motor",
    "position_motor": "position_motor",
    "torque_motor": "torque_motor",
}


class ResolvedActuator(NamedTuple):
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

    def read(self, name: str) -> ResolvedActuator | None:
        """The actuator called `name`; None after a finding. One without a command varies nothing."""
        spec = self._scene.spec.actuators[name]
        figures = ActuatorLimits(self._scene.name, name, self._namespace)
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

    def _motor(self, name: str, spec: MotorSpec, figures: ActuatorLimits) -> ResolvedActuator | None:
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
        return ResolvedActuator(motor, dimension, names if len(names) > 1 or spec.joints is not None else None)

    def _cartesian(self, name: str, spec: CartesianSpec, figures: ActuatorLimits) -> ResolvedActuator | None:
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
        return ResolvedActuator(Cartesian(name, spec.link, names, attitude, *limits, figures.response(spec, names)), LENGTH, SPACE)

    def _gripper(self, name: str, spec: Gripper, figures: ActuatorLimits) -> ResolvedActuator | None:
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
        for key, end in (("closed", closed), ("open", open_)):
            self._check_reach((*figures.place, key), end, joints)
        return ResolvedActuator(motor, NUMBER, None, (closed, open_))

    def _check_reach(self, place: Path, position: float, joints: tuple[Joint, ...]) -> None:
        """DB304 for a position that a joint cannot take."""
        for joint in joints:
            reach = joint_interval(joint)
            if not reach.low <= position <= reach.high:
                confines = Confines(self._values, self._values.text(place), joint_dimension(joint), reach)
                confines.report("a position of", exact(position), f"keep to the limits of `{joint.name}`")
                return

    def _thrust(self, name: str, spec: ThrustSpec, figures: ActuatorLimits) -> ResolvedActuator | None:
        links = links_of(self._values, self._scene.link_names, self._scene.groups, spec, figures.place)
        text = self._values.text((*figures.place, "range"), spec.range)
        ends = self._values.ends(text, "the range of a thrust", figures.scope, dimension=FORCE)
        drag = figures.number("drag", spec.drag, LENGTH)
        response = figures.response(spec, links)
        spin = self._spin(spec, links, figures)
        if not links or ends is None or spin is None:
            return None
        thrust = Thrust(name, links, ends.low[0], ends.high[0], drag or 0.0, spin, response)
        return ResolvedActuator(thrust, FORCE, links if len(links) > 1 or spec.links is not None else None)

    def _spin(self, spec: ThrustSpec, links: tuple[str, ...], figures: ActuatorLimits) -> tuple[float, ...] | None:
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


def poses(scene: RobotScene, namespace: Namespace) -> dict[str, Symbol]:
    """Each pose as a vector by joint: patterns in the order of the file, each in that of the robot file."""
    return {name: _pose(name, scene, namespace) for name in scene.spec.poses}


def _pose(name: str, scene: RobotScene, namespace: Namespace) -> Symbol:
    values, scope = namespace.values, ParameterScope(namespace, Context.FIXED)
    moving = [joint.name for joint in scene.model.moving_joints]
    positions: dict[str, float] = {}
    sound = True
    for pattern, given in scene.spec.poses[name].items():
        place: Path = ("robots", scene.name, "poses", name, pattern)
        joints, missing = expand(moving, pattern, scene.groups)
        if missing:
            joint_missing(values, values.key_span(place), pattern, scene.model)
        position = values.number(place, given, joint_dimension(scene.model.joint(joints[0])), scope) if joints else None
        sound = sound and position is not None
        positions |= dict.fromkeys(joints, position or 0.0)
    dimensions = {joint_dimension(scene.model.joint(joint)) for joint in positions}
    if len(dimensions) > 1:
        place = ("robots", scene.name, "poses", name)
        values.findings.add("DB404", values.key_span(place), "turning and sliding joints in one pose", help="make a pose of each")
    if not sound or len(dimensions) != 1:
        return Symbol(name, None)
    figures = tuple(positions.values())
    return Symbol(name, Type(dimensions.pop(), tuple(positions), interval=Interval(min(figures), max(figures))), figures)


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
        self.fields: dict[str, Expression] = {}
        self.received: dict[str, Expression] = {}
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
        self.fields[name] = Expression(name, text.span, text.text, typed, f"{self.scene.name}.emit.{name}")
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
                self.received[name] = Expression(name, text.span, text.text, typed, f"{self.scene.name}.receive.{name}")
                symbols[name] = Symbol(name, typed.type._replace(stage=Stage.STEP))
        return symbols

    def finish(self, tick: float, action: Sequence[ActionPart], routes: tuple[Route, Route]) -> Robot:
        """Type everything that is left; the world's timestep is `tick` s, `routes` are those to and from robots."""
        received = self._receive()
        scope = RobotScope(self.namespace, Context.APPLY, self.scene.name, {**self.own, **received})
        actuators = Actuators(self.scene, self.namespace)
        driven = {name: found for name in self.scene.spec.actuators if (found := actuators.read(name)) is not None}
        commands = []
        for name, given in self.scene.spec.apply.items():
            place = (*self.path, "apply", name)
            if name not in self.scene.spec.actuators:
                self.values.unknown(self.values.key_span(place), "actuator", name, list(self.scene.spec.actuators))
                continue
            command = self._command(name, given, place, driven.get(name), scope)
            if command:
                commands.append(command)
        name, (to_robot, from_robot) = self.scene.name, routes
        return Robot(
            name,
            self.sensing.finished(tick),
            tuple(found.actuator for found in driven.values()),
            tuple(self.received.values()),
            tuple(self.fields.values()),
            tuple(commands),
            tuple(_used_variables(action, commands, self.received)),
            to_robot.of(name, "to_robot"),
            from_robot.of(name, "from_robot"),
        )

    def _command(self, name: str, given: object, place: Path, driven: ResolvedActuator | None, scope: RobotScope) -> Command | None:
        text = self.values.text(place, given)
        if driven is None:
            self.values.expression(text, scope, boolean=False)
            return None
        typed = self.values.quantity(text, f"the target of `{name}`", scope, driven.dimension, driven.components, Stage.STEP)
        if typed is None:
            return None
        return Command(driven.actuator, Expression(name, text.span, text.text, typed, f"{self.scene.name}.apply.{name}"), driven.opening)


def _used_variables(action: Sequence[ActionPart], commands: Iterable[Command], received: Container[str]) -> Iterator[MessageField]:
    """The action variables that commands use, in the order of the action; `received` names of the robot hide them."""
    used = {node.symbol.name for command in commands for node in walk(command.target.typed) if isinstance(node, Reference)}
    for part in action:
        if isinstance(part, ActionRange):
            fields = [MessageField(part.name, part.unit, part.components)]
        else:
            fields = [MessageField(variable, "1") for variable in part.variables]
        yield from (field for field in fields if field.name in used and field.name not in received)
