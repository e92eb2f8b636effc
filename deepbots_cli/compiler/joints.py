"""What the figures of a joint measure: angles where it turns, lengths where it slides."""

from __future__ import annotations

from collections.abc import Iterable

from deepbots_cli.expressions import intervals
from deepbots_cli.expressions.dimensions import ANGLE, FORCE, LENGTH, TIME, TORQUE, Dimension
from deepbots_cli.expressions.intervals import EVERYTHING, Interval
from deepbots_cli.frames import HERE, Frame, inside
from deepbots_cli.frames import frame as pose_frame
from deepbots_cli.robots.model import Joint, RobotModel


def joint_dimension(joint: Joint) -> Dimension:
    """Of a joint's position: a length where it slides, else an angle."""
    return LENGTH if joint.type == "prismatic" else ANGLE


def effort_of(joint: Joint) -> Dimension:
    """Of what drives it: a force where it slides, else a torque."""
    return FORCE if joint.type == "prismatic" else TORQUE


def sensed_dimension(kind: str, joint: Joint) -> Dimension:
    """Of what a sensor of this kind measures at a joint."""
    position = joint_dimension(joint)
    return {"joint_position": position, "joint_velocity": position / TIME, "joint_torque": effort_of(joint)}[kind]


def joint_interval(joint: Joint) -> Interval:
    """The positions that the limits of the joint leave."""
    if joint.limit.lower is None or joint.limit.upper is None:
        return EVERYTHING
    return Interval(joint.limit.lower, joint.limit.upper)


def carries(model: RobotModel, joint: Joint, link: str) -> bool:
    """Whether the link moves when the joint does."""
    above = {other.child: other for other in model.joints}
    while link in above:
        if above[link].name == joint.name:
            return True
        link = above[link].parent
    return False


def held(model: RobotModel, link: str) -> tuple[str, Frame]:
    """The link that carries another by fixed joints alone, farthest towards the root; and the other's frame in its frame."""
    above = {joint.child: joint for joint in model.joints if not joint.moves}
    frame = HERE
    for _ in model.joints:  # no more than there are, whatever circle a forged model may hold
        joint = above.get(link)
        if joint is None:
            break
        link, frame = joint.parent, inside(pose_frame(joint.origin), frame)
    return link, frame


def hull(joints: Iterable[Joint]) -> Interval:
    """The positions that the limits of any of the joints leave."""
    return intervals.hull([joint_interval(joint) for joint in joints])
