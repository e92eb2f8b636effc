"""An episode: its draws (parameters, channels, disturbances), its start, its signals, reward and endings, its
limits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from math import ceil, floor, inf, log10
from typing import Literal

from deepbots_cli.compiler.namespace import (
    Namespace,
    NamespaceReader,
    Origin,
    ParameterScope,
    SupervisorScope,
)
from deepbots_cli.compiler.places import Layouts, Places
from deepbots_cli.compiler.robots import ResolvedRobot, joint_dimension, report_follower, warn_beyond_limits
from deepbots_cli.compiler.texts import SourceText
from deepbots_cli.compiler.values import ValueReader
from deepbots_cli.diagnostics.nearest import Replacement
from deepbots_cli.document.nodes import NodePath
from deepbots_cli.expressions import unification
from deepbots_cli.expressions.dimensions import NUMBER, TIME, Dimension
from deepbots_cli.expressions.functions import contains_draw
from deepbots_cli.expressions.intervals import EVERYTHING, TRUTH, Interval, hull
from deepbots_cli.expressions.lower import constant_values
from deepbots_cli.expressions.types import (
    Components,
    Constant,
    Context,
    Invocation,
    Kind,
    Known,
    Redraw,
    Subject,
    Symbol,
    TypedNode,
    ValueType,
    walk,
)
from deepbots_cli.expressions.unification import expect_value
from deepbots_cli.program import Program
from deepbots_cli.program.resets import Disturbance, JointStart, Layout, Placement, Reset
from deepbots_cli.program.robots import Direction, Robot, Route
from deepbots_cli.program.task import Solved, Truncation
from deepbots_cli.program.values import Expression, Foreign
from deepbots_cli.program.world import MAX_SETTLING_STEPS, ObjectBody, WorldModel
from deepbots_cli.scenario.base import Section
from deepbots_cli.scenario.fields import choices_help
from deepbots_cli.scenario.quantities import Quantity, read_until
from deepbots_cli.scenario.robots import Route as RouteSpec
from deepbots_cli.scenario.task import ALL_AGENTS, JointState, Measured, PythonTerm
from deepbots_cli.scenario.task import Disturbance as DisturbanceSpec
from deepbots_cli.scenario.task import Truncation as TruncationSpec


class Parameters(NamespaceReader):
    """The parameters: fixed ones are folded into expressions, the others are drawn."""

    def __init__(self, namespace: Namespace) -> None:
        super().__init__(namespace)
        self._drawn: dict[str, Expression] = {}
        for name in namespace.scenario.parameters:
            namespace.define(name, Origin.PARAMETER, ("parameters", name), partial(self._parameter, name))

    def drawn(self) -> tuple[Expression, ...]:
        """Return the drawn parameters, each after those that it is made of."""
        return tuple(self._drawn[name] for name in self._namespace.order if name in self._drawn)

    def _parameter(self, name: str) -> Symbol:
        values = self._values
        text = self._values.field(self._spec, "parameters", name)
        checked = values.drawn(text, self._namespace.scope(Context.PARAMETER))
        if checked is None or not is_repeated_as_a_whole(checked.value, checked.redraw, text, values):
            return Symbol(name, None)
        typed = checked.value
        unification.warn_of_degrees(typed, values.reporter(text))
        if typed.type.known is Known.FIXED:
            fixed = values.fixed(typed, text, f"`{name}`")
            return Symbol(name, typed.type if fixed is not None else None, fixed)
        self._drawn[name] = text.expression(typed, redraw=checked.redraw)
        return Symbol(name, typed.type)


def route(direction: Direction | Literal["between_robots"], namespace: Namespace) -> Route:
    """Return the route that `messages.to_robot`, `from_robot` or `between_robots` describes."""
    spec: RouteSpec = getattr(namespace.scenario.messages, direction)
    values = namespace.values
    if namespace.scenario.messages.format == "none" and spec.model_fields_set:
        values.add_at_key(
            "DB407",
            spec.path,
            f"`{direction}` needs messages, but `messages.format` is `none`",
            "choose a format, such as `struct`: with `none`, the supervisor controls the robot directly",
        )
        return Route()
    latency, loss, range_ = (_setting(spec, name, namespace) for name in ("latency", "loss", "range"))
    burst = namespace.fields.fixed(spec, "burst", scope=namespace.scope(Context.FIELD))
    if burst is not None and loss is not None:
        lowest, highest = loss.typed.type.interval.low, loss.typed.type.interval.high
        # Losses in runs of mean length b with at least one message between make up b / (b + 1) of all, at
        # most. With a loss of exactly 100 %, there is none between.
        most = burst / (burst + 1.0)
        if most < highest * (1.0 - 1e-9) and lowest < 1.0:
            share = f"{floor(1000.0 * most) / 10.0:g} %"
            help = f"keep `loss` at {share} or below"
            if highest < 1.0:
                least = highest / (1.0 - highest)
                unit = 10.0 ** (floor(log10(least)) - 2)  # three digits, rounded up
                # 0.9 / (1 - 0.9) is 9.000000000000002.
                help += f", or write a `burst` of at least {ceil(round(least / unit, 6)) * unit:.6g}"
            values.add(
                "DB105",
                values.field(spec, "burst").span,
                f"with a `burst` of {burst:g} messages, at most {share} can be lost, but `loss`"
                f" reaches {100.0 * highest:g} %",
                help,
            )
    return Route(latency, loss, burst, range_, spec.order, spec.on_loss)


def _setting(spec: RouteSpec, name: str, namespace: Namespace) -> Expression | None:
    """Return a setting of a route, if the file has it and it is not zero. The expression of a setting that
    may be new in every step may contain how often its draws are repeated."""
    if name not in spec.model_fields_set or getattr(spec, name) is None:
        return None
    values = namespace.values
    text = namespace.values.field(spec, name)
    label = f"`{name}`"
    assert isinstance(text.kind, Quantity)  # the fields of the model
    if text.kind.known == "step" and text.kind.dimension is not None:
        typed, redraw = values.redrawn(text, label, namespace.scope(Context.FIELD), text.kind.dimension)
    else:
        typed = namespace.fields.typed(text)
        redraw = None
    if typed is None or not is_repeated_as_a_whole(typed, redraw, text, values):
        return None
    # A latency and a loss of zero are none; a range is positive.
    if typed.type.known is Known.FIXED and not any(values.fixed(typed, text, label) or ()):
        return None
    return Expression(name, text.span, text.text, typed, name, redraw=redraw)


def is_repeated_as_a_whole(
    typed: TypedNode, redraw: Redraw | None, text: SourceText, values: ValueReader
) -> bool:
    """Return whether a value that changes within an episode determines how often its own draws are
    repeated."""
    if redraw is not None or typed.type.known is not Known.STEP or not contains_draw(typed):
        return redraw is None or redraw.period is None or _is_positive(redraw.period, text, values)
    values.add(
        "DB407",
        text.span,
        "a single random draw cannot be combined with a value that changes within the episode",
        "add `every 5 s` or `each step` to repeat the draw, or define the random value under `parameters`",
    )
    return False


def _is_positive(period: TypedNode, text: SourceText, values: ValueReader) -> bool:
    if expect_value(period, values.reporter(text), "the period") is None:
        return False
    low, high = period.type.interval.low, period.type.interval.high
    if low >= 0.0 and high > 0.0:
        return True
    values.reporter(text)(
        "DB105", period.start, period.end, f"the period can be {low:g} s", "keep it above 0 s"
    )
    return False


def disturbances(namespace: Namespace) -> tuple[Disturbance, ...]:
    """Return the entries of `disturbances`, in the order of the file."""
    compiled = [_disturbance(name, spec, namespace) for name, spec in namespace.scenario.disturbances.items()]
    return tuple(push for push in compiled if push is not None)


def _disturbance(name: str, spec: DisturbanceSpec, namespace: Namespace) -> Disturbance | None:
    pushed = _pushed(spec, namespace)
    keys = ("force", "torque", "at", "every", "duration")
    force, torque, first, interval, duration = expressions = [
        namespace.fields.expression(spec, key, known=Known.STEP) for key in keys
    ]
    if interval is not None and duration is not None:
        longest, soonest = duration.typed.type.interval.high, interval.typed.type.interval.low
        if longest > soonest * (1 + 1e-9):
            namespace.values.add(
                "DB105",
                duration.span,
                f"a push can last {longest:g} s, but the next one can begin after {soonest:g} s",
                "make `duration` shorter than `every`",
            )
    is_broken = any(
        value is None and getattr(spec, key) is not None for key, value in zip(keys, expressions, strict=True)
    )
    return (
        None
        if pushed is None or duration is None or is_broken
        else Disturbance(name, *pushed, force, torque, first, interval, duration)
    )


def _pushed(spec: DisturbanceSpec, namespace: Namespace) -> tuple[str, str | None] | None:
    """Return body and link that are pushed; None after a finding."""
    called = spec.body
    values = namespace.values
    span = values.field(spec, "body").span
    subject = namespace.subject(called, frozenset({Kind.LINK}))
    if subject is None:
        links = [f"{robot.name}.{link}" for robot in namespace.resolved_robots for link in robot.link_names]
        values.report_unknown(
            span, "robot, link or object", called, [*namespace.names_of(Origin.ROBOT, Origin.OBJECT), *links]
        )
        return None
    if subject.kind is Kind.BROKEN:
        return None
    body, _, link = called.partition(".")
    if subject.kind not in {Kind.ROBOT, Kind.LINK, Kind.OBJECT}:
        values.add(
            "DB203",
            span,
            f"`{called}` is {subject.kind.description}",
            "write the name of a robot, a link or an object",
        )
        return None
    if _is_fixed(body, link, namespace):
        values.add("DB203", span, f"`{called}` does not move", "push a body that is not fixed")
        return None
    return body, link or None


def _is_fixed(body: str, link: str, namespace: Namespace) -> bool:
    """Return whether it never moves: a fixed object, a mark, a link that no joint moves of a robot that is
    bolted down."""
    robot = namespace.robots.get(body)
    if robot is not None:
        model = robot.model
        return robot.spec.base == "fixed" and link in ("", *model.links_below(model.root, rigid=True))
    object_spec = namespace.scenario.objects.get(body)
    return bool(getattr(object_spec, "fixed", False)) or getattr(object_spec, "solid", True) is False


# How an episode begins

_JOINTS = frozenset({Kind.JOINT, Kind.JOINTS})

HELP_BEFORE_FIRST_STEP = {
    **dict.fromkeys(
        ("contact", "collided", "contact_force", "contact_force_vector"),
        "contacts are not known before the first step; use `clearance(...) > 1 cm`",
    ),
    "joint_torque": "remove it: no motor has exerted a torque before the first step",
    "visible": "no picture exists when the start is drawn; use the position of the body, as in"
    " `abs(bearing(...)) < 30 deg`",
}
"""The functions that `require` cannot use: before the first step nothing has touched or acted, and no picture
was taken."""


def joint_starts(namespace: Namespace, poses: Mapping[str, dict[str, Symbol]]) -> tuple[JointStart, ...]:
    """Return the entries of `reset.joints`: joints and groups of joints of robots; `poses` are the poses of
    each robot."""
    starts = [_joint_start(key, namespace, poses) for key in namespace.scenario.reset.joints]
    return tuple(start for start in starts if start is not None)


def _pose_help(robot: ResolvedRobot, pose_name: str, poses: Mapping[str, Symbol]) -> str | None:
    """Return how to start a robot in one of its poses: by the group of the joints of the pose."""
    pose = poses.get(pose_name)
    if pose is None or pose.type is None or not pose.type.components:
        return None
    joints = pose.type.components
    group = next(
        (name for name, (kind, members) in robot.groups.items() if kind is Kind.JOINTS and members == joints),
        None,
    )
    define = (
        ""
        if group
        else f"define `groups: {{posed: [{', '.join(joints)}]}}` under `robots.{robot.name}`, and "
    )
    return (
        f"a pose sets the group of its joints: {define}write `{robot.name}.{group or 'posed'}: {pose_name}`"
    )


def _movable_parts(robot: ResolvedRobot) -> list[str]:
    """Return the groups of joints of a robot, and its joints that a start can set."""
    groups = [name for name, (kind, _) in robot.groups.items() if kind in _JOINTS]
    return [*groups, *robot.drivable_joints]


def _report_missing_robot(key: str, text: SourceText, namespace: Namespace) -> None:
    """Report an unknown robot in the key of a start: a joint without its robot, or another name."""
    name = key.partition(".")[0]
    parts = [f"{robot.name}.{part}" for robot in namespace.resolved_robots for part in _movable_parts(robot)]
    if any(full_name.partition(".")[2] == key for full_name in parts):
        namespace.values.report_unknown(text.span, "joint", key, parts)
    elif name not in namespace.robots:
        robots = namespace.names_of(Origin.ROBOT)
        namespace.values.report_unknown(text.part(0, len(name)), "robot", name, robots)


def _report_whole_robot(
    robot: ResolvedRobot, text: SourceText, namespace: Namespace, poses: Mapping[str, Symbol]
) -> None:
    """Report a start that names a robot where it must name a joint."""
    key = robot.name
    movable = [f"{key}.{part}" for part in _movable_parts(robot)]
    help = choices_help(key, movable) if movable else "no joint of this robot can move"
    help = _pose_help(robot, str(namespace.scenario.reset.joints[key]), poses) or help
    namespace.values.add(
        "DB203", text.span, f"expected a joint or a group of joints, found the robot `{key}`", help
    )


def _joint_start(key: str, namespace: Namespace, poses: Mapping[str, dict[str, Symbol]]) -> JointStart | None:
    spec = namespace.scenario.reset
    robot_name, dot, part = key.partition(".")
    robot = namespace.robots.get(robot_name)
    text = namespace.values.key_text((*spec.path, "joints", key))
    if robot is None:
        _report_missing_robot(key, text, namespace)
        return None
    if not part:
        _report_whole_robot(robot, text, namespace, poses.get(key, {}))
        return None
    subject = robot.subject(part, _JOINTS)
    if subject is None or subject.kind not in _JOINTS:
        robot.report_missing_joint(
            namespace.values, text.part(len(robot_name + dot), len(key)), part, robot.drivable_joints
        )
        return None
    drivable = {f"{robot_name}.{joint}" for joint in robot.drivable_joints}
    # All of these joints are followers.
    if f"{robot_name}.{part}" not in drivable and drivable.isdisjoint(subject.members):
        follower = (subject.members or (key,))[0].partition(".")[2]
        report_follower(namespace.values, text.part(len(robot_name + dot), len(key)), follower, robot.model)
        return None
    if subject.members:
        pairs = [
            (member, limits)
            for member, limits in zip(subject.members, subject.intervals, strict=True)
            if member in drivable
        ]
        members, intervals = zip(*pairs, strict=True)
        subject = subject._replace(members=members, intervals=intervals, interval=hull(intervals))
    joints = tuple(member.partition(".")[2] for member in subject.members) or (part,)
    scope = namespace.scope(Context.RESET, poses.get(robot_name))
    start = spec.joints[key]
    angle = joint_dimension(robot.model.joint(joints[0]))
    field = namespace.values.field
    if not isinstance(start, JointState):
        position = _start_value(field(spec, "joints", key), key, angle, subject, scope, joints)
        return JointStart(robot_name, joints, position, None) if position else None
    position = _start_value(field(start, "position"), key, angle, subject, scope, joints)
    velocity = _start_value(field(start, "velocity"), key, angle / TIME, subject, scope, joints)
    return JointStart(robot_name, joints, position, velocity) if position and velocity else None


def _start_value(
    text: SourceText,
    key: str,
    dimension: Dimension,
    subject: Subject,
    scope: ParameterScope,
    joints: Components,
) -> Expression | None:
    """Return the start of joints. A draw that is written once is drawn anew for each joint of a group."""
    namespace = scope.namespace
    values = scope.namespace.values
    typed = namespace.fields.typed(
        text, "the start of a joint", dimension=dimension, components=subject.components, scope=scope
    )
    if typed is None:
        return None
    allowed = subject.intervals or (subject.interval,)
    reached = typed.type.intervals or (typed.type.interval,) * len(allowed)
    for reach, limits in zip(reached, allowed, strict=True):
        if dimension == subject.dimension and reach.is_finite and not reach.is_within(limits):
            warn_beyond_limits(
                values,
                text,
                dimension,
                limits,
                "an initial position of",
                reach,
                "set a position within the limits; otherwise the physics engine pushes the joint back at once",
            )
            break
    return text.expression(typed, key, per_component=joints if len(joints) > 1 else None)


def compile_reset(namespace: Namespace, world: WorldModel) -> tuple[Reset, tuple[ObjectBody, ...]]:
    """Return the arrangement of bodies, and the walls that only maps put up.

    Bodies are in the order of the file; a body that a layout does not place is at its own `pose`, and a group
    that it does not place has no copy.
    """
    spec = namespace.scenario
    places = Places(namespace, world)
    layouts = Layouts(namespace, places, world)
    common = places.placements(spec.reset.place, ("reset", "place"))
    weighted = layouts.weighted_layouts()
    placed_bodies = {placement.body for layout in weighted for placement in layout.placements} | {
        placement.body for placement in common
    }
    common += [
        places.at_own_pose(body)
        for body in (*spec.objects, *spec.robots)
        if body not in placed_bodies and body not in namespace.groups
    ]
    completed = tuple(
        replace(layout, placements=(*layout.placements, *_left_out(layout, placed_bodies, places, namespace)))
        for layout in weighted
    )
    _require_places(namespace)
    places.check_tops(common, completed)
    require = _requirement(namespace)
    return Reset(tuple(common), layouts=completed, require=require, attempts=spec.reset.attempts), tuple(
        layouts.walls
    )


def _left_out(
    layout: Layout, placed_bodies: set[str], places: Places, namespace: Namespace
) -> list[Placement]:
    """Return the bodies at home that other layouts place."""
    layout_bodies = {placement.body for placement in layout.placements}
    bodies = {*namespace.names_of(Origin.ROBOT, Origin.OBJECT)} - set(namespace.groups)
    return [
        places.at_own_pose(body)
        for body in namespace.definitions
        if body in placed_bodies - layout_bodies and body in bodies
    ]


def _require_places(namespace: Namespace) -> None:
    """Report DB102 for a group that no layout places: its copies would never be there."""
    layouts = namespace.scenario.reset.layouts.values()
    mentioned = {
        *namespace.scenario.reset.place,
        *(
            name
            for layout in layouts
            for name in (layout if isinstance(layout, dict) else layout.legend.values())
        ),
    }
    for name, group in namespace.groups.items():
        if (
            name not in mentioned
            and namespace.origin(name) is Origin.OBJECT
            and not namespace.values.is_invalid(name)
        ):
            namespace.values.add(
                "DB102",
                group.count.span,
                f"`reset.place` does not place the copies of `{name}`",
                f"write where they start, as in `{name}: {{region: arena}}`",
            )


def _requirement(namespace: Namespace) -> Expression | None:
    """Return the condition that a start must meet, which may use every value that exists before the first
    step."""
    if namespace.scenario.reset.require is None:
        return None
    values = namespace.values
    text = values.field(namespace.scenario.reset, "require")
    typed = values.expression(text, namespace.scope(Context.REQUIRE), boolean=True)
    if typed is None:
        return None
    for call in walk(typed):
        if isinstance(call, Invocation) and call.function in HELP_BEFORE_FIRST_STEP:
            span = text.part(call.start, call.start + len(call.function))
            values.add(
                "DB407",
                span,
                f"`{call.function}` cannot be used in `reset.require`",
                HELP_BEFORE_FIRST_STEP[call.function],
            )
    if constant_values(typed) == (False,):
        values.add(
            "DB105",
            text.span,
            "this requirement is always false",
            "write a condition on positions or distances that some starts meet",
        )
    return text.expression(typed)


def settling_time(namespace: Namespace, timestep: float) -> float:
    """Return the time in s, in whole timesteps of `timestep` s."""
    values = namespace.values
    settle = namespace.fields.fixed(namespace.scenario.reset, "settle") or 0.0
    span = values.field(namespace.scenario.reset, "settle").span
    if not values.is_invalid("world.timestep"):
        values.check_whole_timesteps(settle, timestep, span, "the settling time")
    if settle / timestep * namespace.scenario.world.substeps > MAX_SETTLING_STEPS:
        values.add(
            "DB105",
            span,
            f"the settling time of {settle:g} s takes more than {MAX_SETTLING_STEPS:,} physics steps"
            " in every reset",
            "write a shorter time; a few seconds are usual",
        )
    return settle


# Signals, reward and endings

_MAX_SHOWN_CHARACTERS = 60
MAX_ENDINGS = 200
"""The maximum number of endings: every reward term is compared with each of them."""
NO_SUCCESS_DEFINED = "a success rate needs a success, but the scenario does not define one"


def python_term(name: str, term: PythonTerm, namespace: Namespace, *, boolean: bool) -> Expression:
    """Return a term of which nothing is known but whether it is a truth value."""
    values = namespace.values
    text = namespace.values.field(term, "python")
    if namespace.document.permissions.code:
        values.add(
            "DB410",
            text.span,
            f"`{name}` runs Python code: {term.python}",
            "write it as an expression, if the language has its functions",
        )
    else:
        values.add(
            "DB409",
            text.span,
            f"`{name}` would run Python code: {term.python}",
            "write an expression, or allow it with --allow-code if you trust the package",
        )
    module, _, function = term.python.partition(":")
    kind = ValueType(
        boolean=boolean,
        interval=TRUTH if boolean else Interval(float("-inf"), float("inf")),
        known=Known.STEP,
    )
    nothing = Constant(kind, 0, len(text.text), (False if boolean else 0.0,))
    return Expression(
        name, text.span, text.text, nothing, ".".join(map(str, term.path)), foreign=Foreign(module, function)
    )


class Signals(NamespaceReader):
    """Augmentation, signals and endings: named values of the supervisor, typed on first use."""

    def __init__(self, namespace: Namespace) -> None:
        super().__init__(namespace)
        spec = self._spec
        self.valued: dict[str, Expression] = {}
        if isinstance(spec.augment, dict):
            for name, value in spec.augment.items():
                if value == name and self._is_defined_elsewhere(name):
                    self._values.add(
                        "DB202",
                        self._values.key_span(("augment", name)),
                        f"`{name}` under `augment` exists already",
                        f"to send an existing value, name it in a list: `augment: [{name}, ...]`; an"
                        " entry of a mapping needs a new name",
                    )
                    continue
                self._define(name, value, Origin.AUGMENT, ("augment", name), Context.SIGNAL)
        for name, value in spec.signals.items():
            self._define(name, value, Origin.SIGNAL, ("signals", name), Context.SIGNAL)
        if not isinstance(spec.augment, dict):
            self._check_augmented(spec.augment)
        outcomes = {"success": spec.termination.success, "failure": spec.termination.failure}
        if len(spec.termination.success) + len(spec.termination.failure) > MAX_ENDINGS:
            self._values.add_at_key(
                "DB005", ("termination",), f"more than {MAX_ENDINGS} endings", "join conditions with `or`"
            )
            for name in (*spec.termination.success, *spec.termination.failure):
                self._values.mark_invalid(name)
            outcomes = {}
        for outcome, conditions in outcomes.items():
            for name, condition in conditions.items():
                self._define(name, condition, Origin.ENDING, ("termination", outcome, name), Context.ENDING)

    def _is_defined_elsewhere(self, name: str) -> bool:
        return name in self._spec.parameters or name in self._spec.signals

    def _check_augmented(self, names: Sequence[str]) -> None:
        """Check that a list under `augment` names values that exist, which the policy may see."""
        kinds = (Origin.PARAMETER, Origin.SIGNAL)
        for index, name in enumerate(names):
            self._namespace.mark_used(name)
            if self._namespace.origin(name) not in kinds:
                measured = self._namespace.names_of(*kinds)
                self._values.report_unknown(
                    self._values.span(("augment", index)), "parameter or signal", name, measured
                )

    def _define(self, name: str, value: object, origin: Origin, path: NodePath, context: Context) -> None:
        self._namespace.define(name, origin, path, partial(self._typed, name, value, path, context))

    def _typed(self, name: str, value: object, path: NodePath, context: Context) -> Symbol:
        if isinstance(value, PythonTerm):
            self.valued[name] = python_term(name, value, self._namespace, boolean=True)
            return Symbol(name, self.valued[name].typed.type)
        text = (
            self._values.field(value, "value")
            if isinstance(value, Measured)
            else self._values.text(path, value)
        )
        typed = self._values.expression(text, SupervisorScope(self._namespace, context))
        if typed is not None and context is Context.ENDING:
            typed = expect_value(typed, self._values.reporter(text), "an ending", boolean=True)
        if typed is None:
            return Symbol(name, None)
        # Noise is normally distributed, so that a value with noise has no bounds.
        added = self._fields.noise(value, typed) if isinstance(value, Measured) else None
        self.valued[name] = text.expression(typed, name, noise=added)
        return Symbol(
            name,
            typed.type._replace(interval=EVERYTHING, intervals=(), known=Known.STEP) if added else typed.type,
        )

    def ordered(self) -> tuple[Expression, ...]:
        """Return augmentation and signals, each after those that it is made of."""
        for name in self._namespace.names_of(Origin.AUGMENT, Origin.SIGNAL):
            self._namespace.resolve(name)
        origins = (Origin.AUGMENT, Origin.SIGNAL)
        return tuple(
            self.valued[name]
            for name in self._namespace.order
            if name in self.valued and self._namespace.origin(name) in origins
        )

    def endings(self) -> tuple[Expression, ...]:
        """Return the endings, successes first, each kind in file order."""
        names = self._namespace.names_of(Origin.ENDING)
        for name in names:
            self._namespace.resolve(name)
        return tuple(self.valued[name] for name in names if name in self.valued)


def reward_terms(namespace: Namespace) -> tuple[Expression, ...]:
    """Return the summands of the reward: single plain numbers."""
    terms = []
    for name, term in namespace.scenario.reward.items():
        if isinstance(term, PythonTerm):
            terms.append(python_term(name, term, namespace, boolean=False))
            continue
        text = namespace.values.field(namespace.scenario, "reward", name)
        typed = _reward_value(text, namespace)
        if typed is not None:
            terms.append(text.expression(typed))
    return tuple(terms)


def _reward_value(text: SourceText, namespace: Namespace) -> TypedNode | None:
    report = namespace.values.reporter(text)
    typed = namespace.values.expression(text, SupervisorScope(namespace, Context.REWARD))
    if typed is not None and typed.type.boolean:
        help = (
            "write the reward for it, as in `1 when"
            f" {text.text if len(text.text) <= _MAX_SHOWN_CHARACTERS else '...'}`"
        )
        report(
            "DB403",
            0,
            len(text.text),
            "expected a number, found a truth value",
            help,
            Replacement(f"1 when {text.text}", safe=False),
        )
        return None
    return typed and expect_value(typed, report, "a reward", dimension=NUMBER)


def truncation(namespace: Namespace) -> Truncation:
    """Return the limits; without any, nothing is sure to end an episode."""
    values = namespace.values
    limits = namespace.scenario.truncation
    if limits is None:
        if not values.is_invalid("truncation"):
            key = "termination" if "termination" in namespace.scenario.model_fields_set else "reward"
            values.add_at_key(
                "DB803",
                (key,),
                "the scenario has no time limit, so an episode could last forever",
                "add `truncation: {max_steps: 1000}`, or a `max_time`",
            )
        return Truncation()
    steps = namespace.fields.fixed(*_limit(limits, "max_steps"))
    for name in limits.success:
        _check_successful(namespace, limits, name)
    return Truncation(
        None if steps is None else int(steps), namespace.fields.fixed(*_limit(limits, "max_time"))
    )


def _limit(limits: TruncationSpec, name: str) -> tuple[Section, str]:
    """Return the section and the key of the value of a limit."""
    limit = getattr(limits, name)
    return (limit, "limit") if isinstance(limit, Section) else (limits, name)


def _check_successful(namespace: Namespace, limits: TruncationSpec, name: str) -> None:
    """Report agents that do not exist: the only agent of a scenario is named by `all`."""
    path = ("truncation", name, "success")
    agents = getattr(limits, name).success
    agents_by_path = (
        {path: agents} if isinstance(agents, str) else {(*path, i): agent for i, agent in enumerate(agents)}
    )
    for key_path, agent in agents_by_path.items():
        if agent != ALL_AGENTS:
            namespace.values.report_unknown(namespace.values.span(key_path), "agent", agent, [ALL_AGENTS])


def success_help(
    limits: Truncation, period: float, instead: str, has_failures: bool, agent: str | None
) -> str:
    """Return how to define a success of episodes of at most `limits`, with steps of the agent of `period` s,
    or to write `instead`; `agent` is one of several agents."""
    if agent is not None:
        limit = f"max_time: {{limit: 20 s, success: {agent}}}"
        return (
            f"name `{agent}` under `success` of an ending, or of a limit as in `{limit}`; or require a"
            f" return: `{instead}`"
        )
    steps = limits.max_steps
    seconds = min(limits.max_time or inf, inf if steps is None else steps * period)
    if has_failures and seconds < inf:
        lasting = f"success: {{lasted: time > {0.95 * seconds:.3g} s}}"
        success = (
            f"`{lasting}` (95 % of the longest episode), if an episode without a failure is a success, or"
            " another condition"
        )
    else:
        success = "`success: {reached: CONDITION}`, with a condition such as `distance(cart, ball) < 10 cm`"
    return f"under `termination`, write {success}; or require a return: `{instead}`"


def solved(namespace: Namespace, limits: Truncation, period: float) -> Solved | None:
    """Return the criterion by which the training has solved the task, whose episodes end at `limits` and
    have steps of the agent of `period` s."""
    spec = namespace.scenario
    values = namespace.values
    if spec.solved is None:
        return None
    criterion = read_until(spec.solved)
    threshold, episodes = (criterion.threshold, criterion.episodes or 0) if criterion else (0.0, 0)
    if criterion is not None and criterion.metric == "mean_return":
        return Solved(episodes, mean_return=threshold)
    if not (spec.defines_success or any(map(values.is_invalid, ("success", "termination", "goal")))):
        instead = f"solved: mean_return >= 100 over {episodes} episodes"
        has_failures = bool(spec.termination.failure)
        help = success_help(limits, period, instead, has_failures, namespace.document.agent)
        values.add("DB407", ("solved",), NO_SUCCESS_DEFINED, help)
    return Solved(episodes, success_rate=threshold)


def with_reading_ages(program: Program) -> Program:
    """Return the program with a further field in the messages of robots for each sensor whose age the
    supervisor uses.

    A sensor that is read when the message is written, as perfect ones are, is as old as the message.
    """
    if all(sensor.is_direct for robot in program.robots for sensor in robot.sensors):
        return program
    timed = (value for value in program.computed_expressions if "age" in value.text)
    calls = (
        node
        for value in timed
        for node in walk(value.typed)
        if isinstance(node, Invocation) and node.function == "age"
    )
    names = dict.fromkeys(call.subjects[0].name for call in calls)
    return (
        replace(program, robots=tuple(_with_ages(robot, names) for robot in program.robots))
        if names
        else program
    )


def _with_ages(robot: Robot, names: dict[str, None]) -> Robot:
    fields = {value.name for value in robot.emit}
    sensors = {f"{robot.name}.{sensor.name}": sensor for sensor in robot.sensors}
    ages = []
    for name in names:
        if name in sensors and not sensors[name].is_direct:
            field = f"{sensors[name].name}_age"
            while field in fields:
                field += "_"
            ages.append((sensors[name].name, field))
    return replace(robot, ages=tuple(ages)) if ages else robot
