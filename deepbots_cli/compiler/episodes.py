"""How an episode begins: arrangements, joints, the requirement on the start, and the time to settle."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from deepbots_cli.compiler.namespace import Namespace, Origin, ParameterScope
from deepbots_cli.compiler.places import Layouts, PlacementChecker, Places
from deepbots_cli.compiler.robots import joint_dimension, joint_missing, warn_beyond
from deepbots_cli.compiler.values import Text
from deepbots_cli.expressions.dimensions import TIME, Dimension
from deepbots_cli.expressions.lower import constant
from deepbots_cli.expressions.types import Components, Context, Invocation, Kind, Subject, Symbol, walk
from deepbots_cli.program.resets import JointStart, Layout, Placement, Reset
from deepbots_cli.program.values import Expression
from deepbots_cli.program.world import MAX_SETTLING_STEPS, ObjectBody, WorldModel
from deepbots_cli.scenario.fields import choose_from
from deepbots_cli.scenario.task import JointState
from deepbots_cli.scenario.task import Reset as ResetSpec

_JOINTS = frozenset({Kind.JOINT, Kind.JOINTS})


def joint_starts(namespace: Namespace, poses: Mapping[str, dict[str, Symbol]]) -> tuple[JointStart, ...]:
    """The entries of `reset.set`: joints and groups of joints of robots; `poses` are those of each robot."""
    starts = [_joint_start(key, namespace.scenario.reset, namespace, poses) for key in namespace.scenario.reset.set]
    return tuple(start for start in starts if start is not None)


def _joint_start(key: str, spec: ResetSpec, namespace: Namespace, poses: Mapping[str, dict[str, Symbol]]) -> JointStart | None:
    robot_name, dot, part = key.partition(".")
    robot, text = namespace.robots.get(robot_name), namespace.values.key_text((*spec.path, "set", key))
    if robot is None:
        if robot_name not in namespace.robots:
            namespace.values.report_unknown(text.part(0, len(robot_name)), "robot", robot_name, namespace.names_of(Origin.ROBOT))
        return None
    if not part:
        movable = [name for name, (kind, _) in robot.groups.items() if kind in _JOINTS] + [
            joint.name for joint in robot.model.moving_joints
        ]
        help = choose_from(key, [f"{key}.{name}" for name in movable]) if movable else "no joint of this robot can move"
        namespace.values.findings.add("DB203", text.span, f"the robot `{key}` where a joint or a group of joints is needed", help=help)
        return None
    subject = robot.subject(part, _JOINTS)
    if subject is None or subject.kind not in _JOINTS:
        joint_missing(namespace.values, text.part(len(robot_name + dot), len(key)), part, robot.model)
        return None
    joints = tuple(member.partition(".")[2] for member in subject.members) or (part,)
    scope, given = namespace.scope(Context.RESET, poses.get(robot_name)), spec.set[key]
    angle, read = joint_dimension(robot.model.joint(joints[0])), namespace.values.field
    if not isinstance(given, JointState):
        position = _start_value(read(spec, "set", key), key, angle, subject, scope, joints)
        return JointStart(robot_name, joints, position, None) if position else None
    position = _start_value(read(given, "position"), key, angle, subject, scope, joints)
    velocity = _start_value(read(given, "velocity"), key, angle / TIME, subject, scope, joints)
    return JointStart(robot_name, joints, position, velocity) if position and velocity else None


def _start_value(
    text: Text, key: str, dimension: Dimension, subject: Subject, scope: ParameterScope, joints: Components
) -> Expression | None:
    """A draw that is written once is drawn anew for each joint of a group."""
    namespace, values = scope.namespace, scope.namespace.values
    typed = namespace.typed(text, "the start of a joint", dimension=dimension, components=subject.components, scope=scope)
    if typed is None:
        return None
    reach, limits = typed.type.interval, subject.interval
    if dimension == subject.dimension and reach.finite and not reach.inside(limits):
        help = "set a position within the limits: an engine pushes the joint back at once"
        warn_beyond(values, text, dimension, limits, "a start at", reach, help)
    return text.expression(typed, key, per_component=joints if len(joints) > 1 else None)


# Before the first step nothing has touched or acted, and no picture was taken.
_UNMOVED = {
    **dict.fromkeys(("contact", "collided"), "before the first step nothing has touched; ask for `clearance(...) > 1 cm`"),
    "joint_torque": "before the first step no motor has acted; remove it",
    "visible": "the start is chosen before the first picture is taken; use the position of the body, as in `abs(bearing(...)) < 30 deg`",
}


def arrangement(namespace: Namespace, world: WorldModel) -> tuple[Reset, tuple[ObjectBody, ...]]:
    """How bodies are arranged, and the walls that only maps put up.

    Bodies stand in the order of the file; one that a layout does not place stands at its own `pose`, and of a group no
    copy is there.
    """
    spec = namespace.scenario
    room = PlacementChecker(namespace, world)
    places = Places(namespace, world, room)
    layouts = Layouts(namespace, places, world)
    common = places.placements(spec.reset.place, ("reset", "place"))
    found = layouts.used()
    placed = {placement.body for layout in found for placement in layout.placements} | {placement.body for placement in common}
    common += [places.at_home(body) for body in (*spec.objects, *spec.robots) if body not in placed and body not in namespace.groups]
    completed = tuple(replace(layout, placements=(*layout.placements, *_left_out(layout, placed, places, namespace))) for layout in found)
    _require_places(namespace)
    room.check_surroundings(common, completed)
    require = _requirement(namespace)
    return Reset(tuple(common), layouts=completed, require=require, attempts=spec.reset.attempts), tuple(layouts.walls)


def _left_out(layout: Layout, placed: set[str], places: Places, namespace: Namespace) -> list[Placement]:
    """Bodies at home that other layouts place."""
    here = {placement.body for placement in layout.placements}
    known = {*namespace.names_of(Origin.ROBOT, Origin.OBJECT)} - set(namespace.groups)
    return [places.at_home(body) for body in namespace.definitions if body in placed - here and body in known]


def _require_places(namespace: Namespace) -> None:
    """DB102 for a group that no layout places: its copies would never be there."""
    layouts = namespace.scenario.reset.layouts.values()
    mentioned = {
        *namespace.scenario.reset.place,
        *(name for layout in layouts for name in (layout if isinstance(layout, dict) else layout.legend.values())),
    }
    for name, group in namespace.groups.items():
        if name not in mentioned and namespace.origin(name) is Origin.OBJECT and not namespace.values.is_invalid(name):
            help = f"write where they start, as in `{name}: {{region: arena}}`"
            namespace.values.findings.add("DB102", group.count.span, f"`reset.place` has no entry for the copies of `{name}`", help=help)


def _requirement(namespace: Namespace) -> Expression | None:
    """The condition that a start must meet, which may ask for whatever is so before the first step."""
    if namespace.scenario.reset.require is None:
        return None
    values = namespace.values
    text = values.field(namespace.scenario.reset, "require")
    typed = values.expression(text, namespace.scope(Context.REQUIRE), boolean=True)
    if typed is None:
        return None
    for call in walk(typed):
        if isinstance(call, Invocation) and call.function in _UNMOVED:
            span = text.part(call.start, call.start + len(call.function))
            headline = f"`{call.function}` in a requirement on the start"
            values.findings.add("DB407", span, headline, help=_UNMOVED[call.function])
    if constant(typed) == (False,):
        values.findings.add("DB105", text.span, "no start can meet this requirement", help="use a condition on positions or distances")
    return text.expression(typed)


def settling_time(namespace: Namespace, timestep: float) -> float:
    """Seconds, in whole timesteps of `timestep` s."""
    values, settle = namespace.values, namespace.fixed(namespace.scenario.reset, "settle") or 0.0
    span = values.field(namespace.scenario.reset, "settle").span
    if abs(settle - round(settle / timestep) * timestep) > 1e-9 * settle and not values.is_invalid("world.timestep"):
        headline = f"the settling time of {settle:g} s is not a multiple of the timestep of {timestep:g} s"
        values.findings.add("DB308", span, headline, help="write a multiple of the timestep")
    if settle / timestep * namespace.scenario.world.substeps > MAX_SETTLING_STEPS:
        headline = f"the settling time of {settle:g} s takes more than {MAX_SETTLING_STEPS:,} physics steps in every reset"
        values.findings.add("DB105", span, headline, help="a few seconds are usual")
    return settle
