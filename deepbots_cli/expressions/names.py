"""What the names in an expression mean, and findings about those that mean nothing."""

from __future__ import annotations

from collections.abc import Iterable

from deepbots_cli.diagnostics.nearest import Meant, meant
from deepbots_cli.expressions import syntax
from deepbots_cli.expressions.functions import ALLOWED, Family
from deepbots_cli.expressions.table import FUNCTIONS
from deepbots_cli.expressions.typed import Pick, Reference, Typed
from deepbots_cli.expressions.types import SPACE, Context, Kind, Report, Scope, Subject, shown

# What is asked most often of a part of the world that is no place.
_ASKED = {
    Kind.JOINT: "joint_position",
    Kind.JOINTS: "joint_position",
    Kind.WALLS: "collided",
    Kind.LINE: "length",
    Kind.SENSOR: "age",
    Kind.CAMERA: "age",
}

# Where a name may still have to be given that is missing, besides what is known there.
_NAMED = {"pi": "half a turn is `180 deg`"}
_ELSEWHERE = {Context.APPLY: "what the agent decides is named under `action`"}


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
        written = symbol.name
        for member in node.parts[length:]:
            value = value and pick(value, member, node.start, node.end, report, written)
            written = f"{written}.{member}"
        return value
    _no_value(node, scope, report)
    return None


def pick(value: Typed, member: str, start: int, end: int, report: Report, written: str | None = None) -> Typed | None:
    """One component by its name, or several by single letters (`.xy`); `written` is the value, where that is a name."""
    components = value.type.components
    if components is None:
        report("DB402", start, end, f"`.{member}` of a single value", "only vectors have components")
        return None
    wanted = (member,) if member in components else tuple(member)
    if not set(wanted) <= set(components) or len(set(wanted)) < len(wanted):
        unknown("component", member, components, start, end, report, None if written is None else f"{written}.")
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


def unknown(
    what: str, name: str, known: Iterable[str], start: int, end: int, report: Report, before: str | None = "", also: str | None = None
) -> None:
    """DB402 with the nearest of the known names, and a list of them.

    From `start` to `end` stand `before` and the name; None for what is no text to write again. What may be `also` of use is
    said where no name is like it.
    """
    names = sorted(known)
    near = _of_a_part(name, names) or meant(name, names)
    parts = [f"did you mean `{near.text}`?" if near else None, "; ".join(filter(None, (_known(names), None if near else also)))]
    fix = near._replace(text=f"{before}{near.text}") if near and before is not None else None
    report("DB402", start, end, f"unknown {what} `{name}`", " ".join(filter(None, parts)) or None, meant=fix)


def _of_a_part(name: str, known: list[str]) -> Meant | None:
    """`cart.speed.x` for `speed.x`, if one part alone has a `speed`."""
    first, dot, rest = name.partition(".")
    longer = [other for other in known if other.endswith(f".{first}")]
    return Meant(f"{longer[0]}{dot}{rest}", safe=False) if len(longer) == 1 else None


def _no_value(node: syntax.Name, scope: Scope, report: Report) -> None:
    subject = scope.subject(node.dotted)
    if subject is not None:
        if subject.kind is not Kind.BROKEN:
            help = f"ask for one of its values, as in `{_ASKED.get(subject.kind, 'position')}({node.dotted})`"
            report("DB203", node.start, node.end, f"`{node.dotted}` is {subject.kind.words}, not a value", help)
    elif node.dotted in FUNCTIONS:
        report("DB402", node.start, node.end, f"`{node.dotted}` is a function", f"call it: `{FUNCTIONS[node.dotted].signature}`")
    elif asked := _asked_of_a_body(node, scope):
        help = f"what is known of the world is asked for by functions: `{asked}`"
        report("DB402", node.start, node.end, f"unknown name `{node.dotted}`", help, meant=Meant(asked, safe=False))
    else:
        unknown(
            "name",
            node.dotted,
            scope.names(),
            node.start,
            node.end,
            report,
            also=_NAMED.get(node.dotted.lower(), _ELSEWHERE.get(scope.context)),
        )


def _asked_of_a_body(node: syntax.Name, scope: Scope) -> str | None:
    """`position(cart).x` for `cart.position.x` and for `cart.x`."""
    for length in range(len(node.parts) - 1, 0, -1):
        body, (asked, *rest) = ".".join(node.parts[:length]), node.parts[length:]
        subject = scope.subject(body) if Family.WORLD in ALLOWED[scope.context] else None
        if subject is not None and subject.kind in (Kind.ROBOT, Kind.LINK, Kind.OBJECT, Kind.WALL):
            function = FUNCTIONS.get(asked)
            if function is not None and function.family is Family.WORLD and len(function.params) == 1:
                return ".".join([f"{asked}({body})", *rest])
            return f"position({body}).{asked}" if asked in SPACE and not rest else None
    return None


def _known(names: list[str]) -> str:
    return f"known are {shown((f'`{name}`' for name in sorted(names)), 20)}" if names else "there is none to choose from"


def _one_of(kinds: frozenset[Kind]) -> str:
    named = [kind.words for kind in Kind if kind in kinds]
    if kinds >= {Kind.WALL, Kind.WALLS}:
        named.remove(Kind.WALLS.words)
        named[named.index(Kind.WALL.words)] = "a wall"
    return named[0] if len(named) == 1 else f"{', '.join(named[:-1])} or {named[-1]}"
