"""How an episode begins: where bodies are placed in which layout, what is required of the start."""

from __future__ import annotations

from dataclasses import replace

from deepbots_cli import ir
from deepbots_cli.compiler.layouts import Layouts
from deepbots_cli.compiler.namespace import Namespace, Origin
from deepbots_cli.compiler.places import Places
from deepbots_cli.compiler.room import check_surroundings
from deepbots_cli.compiler.scopes import ParameterScope
from deepbots_cli.expressions.lower import constant
from deepbots_cli.expressions.typed import Invocation, Typed, children
from deepbots_cli.expressions.types import Context
from deepbots_cli.scenario.scenario import Scenario
from deepbots_cli.task import Beginnings, Placement, TaskLayout, Valued

# Before the first step nothing has touched or acted, and no picture was taken.
_UNMOVED = {
    **dict.fromkeys(("contact", "collided"), "before the first step nothing has touched; ask for `gap(...) > 1 cm`"),
    "joint_torque": "before the first step no motor has acted; take it out",
    "visible": "a start is found before the first picture is taken; ask where the body stands, as in `abs(bearing(...)) < 30 deg`",
}


def beginnings(spec: Scenario, namespace: Namespace, world: ir.WorldModel) -> tuple[Beginnings, tuple[ir.ObjectBody, ...]]:
    """How bodies are arranged, and the walls that only maps put up.

    Bodies stand in the order of the file; one that a layout does not place stands at its own `pose`, and of a group no
    copy is there.
    """
    places = Places(spec, namespace, world)
    layouts = Layouts(spec, namespace, places, world)
    common = places.placements(spec.reset.place, ("reset", "place"))
    found = layouts.used()
    placed = {placement.body for layout in found for placement in layout.placements} | {placement.body for placement in common}
    common += [places.at_home(body) for body in (*spec.objects, *spec.robots) if body not in placed and body not in namespace.groups]
    completed = tuple(replace(layout, placements=(*layout.placements, *_left_out(layout, placed, places, namespace))) for layout in found)
    _require_places(spec, namespace)
    check_surroundings(common, completed, world, namespace)
    beginning = Beginnings(tuple(common), completed, _requirement(spec, namespace), spec.reset.attempts)
    return beginning, tuple(layouts.walls)


def _left_out(layout: TaskLayout, placed: set[str], places: Places, namespace: Namespace) -> list[Placement]:
    """Bodies at home that other layouts place."""
    here = {placement.body for placement in layout.placements}
    known = {*namespace.named(Origin.ROBOT, Origin.OBJECT)} - set(namespace.groups)
    return [places.at_home(body) for body in namespace.definitions if body in placed - here and body in known]


def _require_places(spec: Scenario, namespace: Namespace) -> None:
    """DB102 for a group that no layout places: its copies would never be there."""
    layouts = spec.reset.layouts.values()
    mentioned = {
        *spec.reset.place,
        *(name for layout in layouts for name in (layout if isinstance(layout, dict) else layout.legend.values())),
    }
    for name, group in namespace.groups.items():
        if name not in mentioned and namespace.origin(name) is Origin.OBJECT and not namespace.values.is_lost(name):
            help = f"say where they stand under `reset.place`, such as `{name}: {{region: arena}}`"
            namespace.values.findings.add("DB102", group.count.span, f"no place for the copies of `{name}`", help=help)


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
            headline = f"`{call.function}` in a requirement on the start"
            values.findings.add("DB407", span, headline, help=_UNMOVED[call.function])
    if constant(typed) == (False,):
        values.findings.add("DB105", text.span, "a requirement that no start meets", help="let it depend on where things are")
    return Valued("require", text.span, text.text, typed, "reset.require")


def _calls(value: Typed) -> list[Invocation]:
    return [*([value] if isinstance(value, Invocation) else []), *(call for child in children(value) for call in _calls(child))]
