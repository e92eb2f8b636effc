"""Copies of a robot that share one world and one policy."""

from __future__ import annotations

from deepbots_cli.compiler.namespace import Namespace
from deepbots_cli.compiler.scopes import ParameterScope
from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions.dimensions import LENGTH, NUMBER
from deepbots_cli.expressions.types import SPACE, Context
from deepbots_cli.program.task import RobotCopies
from deepbots_cli.program.world import MAX_BODIES
from deepbots_cli.scenario.scenario import Scenario

_NOT_YET = "take it out for now; the page about the language lists, at its end, what does not run yet"
_TOGETHER: tuple[tuple[Path, str], ...] = (
    (("goal",), "a goal"),
    (("world", "terrain"), "terrain"),
    (("reset", "require"), "`require`"),
    (("reset", "layout"), "layouts"),
)


def copies(spec: Scenario, namespace: Namespace) -> RobotCopies | None:
    """What `agent.each` and the `count` of its robot say; None for a single robot, and after a finding."""
    name, values = spec.agent.each, namespace.values
    for robot, given in spec.robots.items():
        if "count" in given.model_fields_set and robot != name and not values.is_lost("each"):
            headline = f"copies of `{robot}` without a policy for each are not supported yet"
            help = f"write `agent: {{each: {robot}}}`, which lets one policy act for every copy"
            values.findings.add("DB108", values.key_span(("robots", robot, "count")), headline, help=help)
    if name is None:
        return None
    if name not in spec.robots:
        values.unknown(values.span(("agent", "each")), "robot", name, list(spec.robots))
        return None
    _refuse_others(spec, name, namespace)
    path, scope = ("robots", name), ParameterScope(namespace, Context.FIXED)
    robot_spec = spec.robots[name]
    count = values.number((*path, "count"), robot_spec.count, NUMBER, scope)
    if robot_spec.spacing is None and values.is_lost("spacing"):
        return None
    if robot_spec.spacing is None:
        help = f"say how far they stand apart, as in `robots.{name}.spacing: 0 0.5 0 m`"
        values.findings.add("DB102", values.span(("agent", "each")), f"the copies of `{name}` have no `spacing`", help=help)
        return None
    spacing = values.numbers((*path, "spacing"), robot_spec.spacing, LENGTH, SPACE, scope)
    if count is None or spacing is None:
        return None
    if not 1 <= count <= MAX_BODIES:
        values.findings.add("DB105", values.span((*path, "count")), f"{count:g} copies", help=f"give 1 to {MAX_BODIES}")
        return None
    x, y, z = spacing
    return RobotCopies(name, int(count), (x, y, z))


def _refuse_others(spec: Scenario, name: str, namespace: Namespace) -> None:
    """DB108 for what would have to be agreed upon between the copies."""
    values, paths = namespace.values, list(_TOGETHER)
    paths += [(("robots", other), f"the robot `{other}`") for other in spec.robots if other != name]
    paths += [(("objects", thing), f"the group `{thing}`") for thing, given in spec.objects.items() if "count" in given.model_fields_set]
    paths += [(("reset", "place", name, key), f"`{key}`") for key in ("region", "line", "grid")]
    for path, what in paths:
        if values.stands(path):
            values.findings.add("DB108", values.key_span(path), f"{what} beside copies of `{name}` is not supported yet", help=_NOT_YET)
