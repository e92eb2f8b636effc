"""The poses of a robot: named positions of its joints, which its controller and the reset may use."""

from __future__ import annotations

from deepbots_cli.compiler.joints import joint_dimension
from deepbots_cli.compiler.matching import expand, joint_missing
from deepbots_cli.compiler.namespace import Namespace
from deepbots_cli.compiler.robots import RobotScene
from deepbots_cli.compiler.scopes import ParameterScope
from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions.intervals import Interval
from deepbots_cli.expressions.types import Context, Symbol, Type


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
