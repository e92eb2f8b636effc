"""How an episode begins: where bodies are placed in which layout, what is required of the start."""

from __future__ import annotations

from collections.abc import Mapping

from deepbots_cli import ir
from deepbots_cli.compiler.namespace import Namespace, Origin
from deepbots_cli.compiler.places import Places
from deepbots_cli.compiler.scopes import ParameterScope
from deepbots_cli.lang.typed import Invocation, Typed, children
from deepbots_cli.lang.types import Context
from deepbots_cli.schema.pose import Pose
from deepbots_cli.schema.scenario import Scenario
from deepbots_cli.source.nodes import Path
from deepbots_cli.task import Beginnings, Placement, Valued

_UNMOVED = ("contact", "collided", "joint_torque")  # nothing has acted or touched before the first step


def beginnings(spec: Scenario, namespace: Namespace, world: ir.WorldModel) -> Beginnings:
    """Bodies in the order of the file; one that is placed nowhere stands at its own `pose`."""
    places = Places(spec, namespace, world)
    found = _placements(spec.reset.place, ("reset", "place"), places, namespace)
    placed = {placement.body for placement in found}
    return Beginnings((*found, *_at_home(spec, placed, places)), require=_requirement(spec, namespace), attempts=spec.reset.attempts)


def _placements(given: Mapping[str, Pose], path: Path, places: Places, namespace: Namespace) -> list[Placement]:
    """The placements of one layout, or of `reset.place`."""
    found = []
    for body, pose in given.items():
        if namespace.origin(body) not in (Origin.ROBOT, Origin.OBJECT):
            known = namespace.named(Origin.ROBOT, Origin.OBJECT)
            namespace.values.unknown(namespace.values.key_span((*path, body)), "robot or object", body, known)
        else:
            found.append(places.placement(body, pose, (*path, body)))
    return found


def _at_home(spec: Scenario, placed: set[str], places: Places) -> list[Placement]:
    """What no layout places."""
    bodies = (("objects", spec.objects), ("robots", spec.robots))
    return [
        places.placement(name, body.pose, (section, name, "pose"))
        for section, named in bodies
        for name, body in named.items()
        if name not in placed
    ]


def _requirement(spec: Scenario, namespace: Namespace) -> Valued | None:
    """The condition that a start must meet, which may ask for whatever is so before the first step."""
    if spec.reset.require is None:
        return None
    values = namespace.values
    text = values.text(("reset", "require"), spec.reset.require)
    typed = values.expression(text, ParameterScope(namespace, Context.REQUIRE), boolean=True)
    if typed is None:
        return None
    for call in _calls(typed):
        if call.function in _UNMOVED:
            span = text.part(call.start, call.start + len(call.function))
            help = "before the first step nothing has touched; ask for `gap(...) > 1 cm`"
            values.findings.add("DB407", span, f"`{call.function}` in a requirement on the start", help=help)
    return Valued("require", text.span, text.text, typed, "reset.require")


def _calls(value: Typed) -> list[Invocation]:
    return [*([value] if isinstance(value, Invocation) else []), *(call for child in children(value) for call in _calls(child))]
