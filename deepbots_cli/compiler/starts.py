"""Where joints start."""

from __future__ import annotations

from collections.abc import Mapping

from deepbots_cli.compiler.joints import joint_dimension
from deepbots_cli.compiler.matching import joint_missing
from deepbots_cli.compiler.namespace import Namespace, Origin
from deepbots_cli.compiler.scopes import ParameterScope
from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions.dimensions import TIME, Dimension
from deepbots_cli.expressions.types import Components, Context, Kind, Stage, Subject, Symbol
from deepbots_cli.program.resets import JointStart
from deepbots_cli.program.values import Expression
from deepbots_cli.scenario.fields import choose_from
from deepbots_cli.scenario.scenario import Scenario
from deepbots_cli.scenario.task import JointState

_JOINTS = frozenset({Kind.JOINT, Kind.JOINTS})


def joint_starts(spec: Scenario, namespace: Namespace, poses: Mapping[str, dict[str, Symbol]]) -> tuple[JointStart, ...]:
    """The entries of `reset.set`: joints and groups of joints of robots; `poses` are those of each robot."""
    starts = [_joint_start(key, given, namespace, poses) for key, given in spec.reset.set.items()]
    return tuple(start for start in starts if start is not None)


def _joint_start(key: str, given: object, namespace: Namespace, poses: Mapping[str, dict[str, Symbol]]) -> JointStart | None:
    path: Path = ("reset", "set", key)
    robot_name, dot, part = key.partition(".")
    robot, text = namespace.robots.get(robot_name), namespace.values.key_text(path)
    if robot is None:
        if robot_name not in namespace.robots:
            namespace.values.unknown(text.part(0, len(robot_name)), "robot", robot_name, namespace.named(Origin.ROBOT))
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
    scope = ParameterScope(namespace, Context.RESET, poses.get(robot_name, {}))
    angle = joint_dimension(robot.model.joint(joints[0]))
    if not isinstance(given, JointState):
        position = _start_value(given, path, angle, subject, scope, joints)
        return JointStart(robot_name, joints, position, None) if position else None
    position = _start_value(given.position, (*path, "position"), angle, subject, scope, joints)
    velocity = _start_value(given.velocity, (*path, "velocity"), angle / TIME, subject, scope, joints)
    return JointStart(robot_name, joints, position, velocity) if position and velocity else None


def _start_value(
    given: object, path: Path, dimension: Dimension, subject: Subject, scope: ParameterScope, joints: Components
) -> Expression | None:
    """A draw that is written once is drawn anew for each joint of a group."""
    values = scope.namespace.values
    text = values.text(path, given)
    typed = values.quantity(text, "the start of a joint", scope, dimension, subject.components, Stage.EPISODE)
    if typed is None:
        return None
    reach, limits = typed.type.interval, subject.interval
    if dimension == subject.dimension and reach.finite and not reach.inside(limits):
        from deepbots_cli.compiler.confines import Confines  # only on the way to a finding

        help = "an engine pushes the joint back at once; keep to its limits"
        Confines(values, text, dimension, limits).report("a start at", reach, help)
    return Expression(str(path[2]), text.span, text.text, typed, ".".join(map(str, path)), joints if len(joints) > 1 else None)
