"""The tree of links, and names by pattern."""

from __future__ import annotations

from collections.abc import Iterable
from fnmatch import fnmatchcase

from deepbots_cli.urdf.model import Joint, RobotModel


def tree_order(model: RobotModel) -> tuple[str, ...]:
    """The links from the root on, each before its children, branches in the order of the joints in the file."""
    below: dict[str, list[str]] = {}
    for joint in model.joints:
        below.setdefault(joint.parent, []).append(joint.child)
    order: list[str] = []
    waiting = [model.root]
    while waiting:
        link = waiting.pop()
        order.append(link)
        waiting.extend(reversed(below.get(link, ())))
    return tuple(order)


def joint_above(model: RobotModel, link: str) -> Joint | None:
    """The joint that holds `link`; None for the root."""
    return next((joint for joint in model.joints if joint.child == link), None)


def match(names: Iterable[str], pattern: str) -> tuple[str, ...]:
    """The names that fit `pattern` (`*`, `?`, `[abc]`; upper and lower case differ), in their given order."""
    return tuple(name for name in names if fnmatchcase(name, pattern))
