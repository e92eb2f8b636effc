"""Names, patterns and groups of joints and links, and findings about those that match nothing."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from fnmatch import fnmatchcase

from deepbots_cli.compiler.joints import joint_dimension
from deepbots_cli.compiler.values import Values
from deepbots_cli.diagnostics import Span
from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions.types import Kind
from deepbots_cli.robots.model import Joint, RobotModel
from deepbots_cli.scenario.fields import choose_from

Group = tuple[Kind, tuple[str, ...]]
"""Joints or links, and the short names of its members."""


def expand(names: Sequence[str], patterns: str | Iterable[str], groups: Mapping[str, Group]) -> tuple[tuple[str, ...], list[str]]:
    """The names that patterns and groups stand for, in order, without repeats; and what stood for nothing."""
    found: dict[str, None] = {}
    missing = []
    for pattern in [patterns] if isinstance(patterns, str) else patterns:
        matched = tuple(member for member in groups[pattern][1] if member in names) if pattern in groups else match(names, pattern)
        if not matched:
            missing.append(pattern)
        found.update(dict.fromkeys(matched))
    return tuple(found), missing


def match(names: Iterable[str], pattern: str) -> tuple[str, ...]:
    """The one of this name; or those that fit `pattern` (`*`, `?`, `[abc]`; upper and lower case differ), in their given order."""
    known = tuple(names)
    return (pattern,) if pattern in known else tuple(name for name in known if fnmatchcase(name, pattern))


def unmatched(values: Values, span: Span, pattern: str, what: str, names: Sequence[str]) -> None:
    """DB206 for a pattern, DB302 or DB201 for a plain name, with what there is."""
    if not set(pattern) & set("*?["):
        values.unknown(span, what, pattern, names, "DB302" if what == "joint" else "DB201")
    else:
        values.findings.add("DB206", span, f"`{pattern}` matches no {what}", help=choose_from(pattern, names))


def joint_missing(values: Values, span: Span, pattern: str, model: RobotModel) -> None:
    """A joint where one is needed that moves: it does not exist, or it cannot move."""
    joint = next((joint for joint in model.joints if joint.name == pattern), None)
    if joint is not None:
        motionless(values, span, joint, model)
    else:
        unmatched(values, span, pattern, "joint", [joint.name for joint in model.moving_joints])


def links_of(values: Values, links: Sequence[str], groups: Mapping[str, Group], spec: object, place: Path) -> tuple[str, ...]:
    """The links that `link` or `links` of the sensor or actuator at `place` names; none after a finding."""
    one = getattr(spec, "link", None)
    if one is not None:
        if one not in links:
            values.unknown(values.span((*place, "link")), "link", one, links)
        return (one,) if one in links else ()
    patterns = getattr(spec, "links", None) or ()  # neither is left where the schema had a finding about it
    names, missing = expand(links, patterns, groups)
    for index, pattern in enumerate([patterns] if isinstance(patterns, str) else patterns):
        if pattern in missing:
            span = values.span((*place, "links") if isinstance(patterns, str) else (*place, "links", index))
            unmatched(values, span, pattern, "link", links)
    return () if missing else names


def motionless(values: Values, span: Span, joint: Joint, model: RobotModel) -> None:
    names = ", ".join(f"`{moving.name}`" for moving in model.moving_joints)
    help = f"joints that move are {names}" if names else "no joint of this robot can move"
    values.findings.add("DB303", span, f"the joint `{joint.name}` cannot move: it is {joint.type}", help=help)


def joints_of(values: Values, model: RobotModel, groups: Mapping[str, Group], spec: object, place: Path) -> tuple[Joint, ...]:
    """The joints that `joint` or `joints` of the sensor or actuator at `place` names; none after a finding."""
    key = "joint" if getattr(spec, "joint", None) is not None else "joints"
    patterns = getattr(spec, key) or ()  # neither is left where the schema had a finding about it
    names, missing = expand([joint.name for joint in model.moving_joints], patterns, groups)
    for index, pattern in enumerate([patterns] if isinstance(patterns, str) else patterns):
        if pattern in missing:
            span = values.span((*place, key) if isinstance(patterns, str) else (*place, key, index))
            joint_missing(values, span, pattern, model)
    if missing or not names:
        return ()
    joints = tuple(model.joint(name) for name in names)
    if len({joint_dimension(joint) for joint in joints}) > 1:
        values.findings.add("DB404", values.span((*place, key)), "turning and sliding joints together", help="name them apart")
        return ()
    return joints
