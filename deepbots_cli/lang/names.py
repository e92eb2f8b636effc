"""What the names in an expression mean, and findings about those that mean nothing."""

from __future__ import annotations

from collections.abc import Iterable

from deepbots_cli.diagnostics.nearest import meant
from deepbots_cli.lang import syntax
from deepbots_cli.lang.table import FUNCTIONS
from deepbots_cli.lang.typed import Pick, Reference, Typed
from deepbots_cli.lang.types import Kind, Report, Scope, Subject, shown

# What is asked most often of a part of the world that is no place.
_ASKED = {Kind.JOINT: "joint_position", Kind.JOINTS: "joint_position", Kind.LINE: "length", Kind.SENSOR: "age", Kind.CAMERA: "age"}


def reference(node: syntax.Name, scope: Scope, report: Report) -> Typed | None:
    """The symbol of the longest known part of a dotted name; the rest of it picks components."""
    for length in range(len(node.parts), 0, -1):
        symbol = scope.lookup(".".join(node.parts[:length]))
        if symbol is None:
            continue
        if symbol.refused is not None:
            report("DB407", node.start, node.end, f"`{symbol.name}` has no value here", symbol.refused)
        if symbol.type is None:
            return None
        value: Typed | None = Reference(symbol.type, node.start, node.end, symbol)
        for member in node.parts[length:]:
            value = value and pick(value, member, node.start, node.end, report)
        return value
    _no_value(node, scope, report)
    return None


def pick(value: Typed, member: str, start: int, end: int, report: Report) -> Typed | None:
    """One component by its name, or several by single letters (`.xy`)."""
    components = value.type.components
    if components is None:
        report("DB402", start, end, f"`.{member}` of a single value", "only vectors have components")
        return None
    wanted = (member,) if member in components else tuple(member)
    if not set(wanted) <= set(components) or len(set(wanted)) < len(wanted):
        unknown("component", member, components, start, end, report)
        return None
    chosen = value.type._replace(components=None if len(wanted) == 1 else wanted)
    return Pick(chosen, start, end, value, tuple(components.index(name) for name in wanted))


def subject_of(node: syntax.Node, kinds: frozenset[Kind], function: str, scope: Scope, report: Report) -> Subject | None:
    """The part of the world that an argument names; DB203 for one of another kind, DB402 for none."""
    wanted = _one_of(kinds)
    if not isinstance(node, syntax.Name):
        report(
            "DB203",
            node.start,
            node.end,
            f"a value where `{function}` needs {wanted}",
            "name a part of the world, as in `position(cart.tip)`",
        )
        return None
    subject = scope.subject(node.dotted, kinds)
    if subject is not None and subject.kind is Kind.BROKEN:
        return None
    if subject is not None and subject.kind in kinds:
        return subject
    fitting = [name for name in dict.fromkeys(scope.subjects()) if (other := scope.subject(name, kinds)) and other.kind in kinds]
    if subject is not None:
        report("DB203", node.start, node.end, f"`{node.dotted}` is {subject.kind.words}, but `{function}` needs {wanted}", _known(fitting))
    elif (symbol := scope.lookup(node.dotted)) is not None:
        if symbol.type is not None or symbol.refused is not None:
            report("DB203", node.start, node.end, f"`{node.dotted}` is a value, but `{function}` needs {wanted}", _known(fitting))
    else:
        unknown("name", node.dotted, fitting, node.start, node.end, report)
    return None


def unknown(what: str, name: str, known: Iterable[str], start: int, end: int, report: Report) -> None:
    """DB402 with the nearest of the known names, and a list of them."""
    names = sorted(known)
    near = meant(name, names)
    parts = [f"did you mean `{near.text}`?" if near else None, _known(names)]
    report("DB402", start, end, f"unknown {what} `{name}`", " ".join(filter(None, parts)) or None, meant=near)


def _no_value(node: syntax.Name, scope: Scope, report: Report) -> None:
    subject = scope.subject(node.dotted)
    if subject is not None:
        if subject.kind is not Kind.BROKEN:
            help = f"ask for one of its values, as in `{_ASKED.get(subject.kind, 'position')}({node.dotted})`"
            report("DB203", node.start, node.end, f"`{node.dotted}` is {subject.kind.words}, not a value", help)
    elif node.dotted in FUNCTIONS:
        report("DB402", node.start, node.end, f"`{node.dotted}` is a function", f"call it: `{FUNCTIONS[node.dotted].signature}`")
    else:
        unknown("name", node.dotted, scope.names(), node.start, node.end, report)


def _known(names: list[str]) -> str | None:
    return f"known are {shown((f'`{name}`' for name in sorted(names)), 20)}" if names else None


def _one_of(kinds: frozenset[Kind]) -> str:
    named = [kind.words for kind in Kind if kind in kinds]
    return named[0] if len(named) == 1 else f"{', '.join(named[:-1])} or {named[-1]}"
