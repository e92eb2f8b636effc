"""Hover: what stands under the cursor, in a few lines."""

from __future__ import annotations

import re

from lsprotocol import types

from deepbots_cli.compiler.inventory import Named, definition, names
from deepbots_cli.compiler.namespace import RobotScope
from deepbots_cli.document import Scalar, descend
from deepbots_cli.expressions import syntax
from deepbots_cli.expressions.dimensions import UNITS
from deepbots_cli.expressions.functions import FUNCTIONS
from deepbots_cli.lsp.asking import key_of, leaves, specs
from deepbots_cli.lsp.describing import of_finding, of_function, of_kind, of_symbol, of_type
from deepbots_cli.lsp.desk import View
from deepbots_cli.lsp.pointing import Piece, Pointed, piece, pointed
from deepbots_cli.scenario.base import Kinds, MappingOf
from deepbots_cli.scenario.docs import about_kind
from deepbots_cli.scenario.docs import hover as hover_text
from deepbots_cli.scenario.fields import FieldType, Pattern, Reference

_CODE = re.compile(r"DB\d{3}")
_LONGEST = 300


def hover(view: View) -> types.Hover | None:
    """What there is to say about the place; nothing about white space and what means nothing."""
    found = _code(view) or _expression(view) or _key_or_value(view)
    if found is None:
        return None
    text, start, end = found
    lines = view.document.lines
    return types.Hover(types.MarkupContent(types.MarkupKind.Markdown, text), types.Range(lines.position(start), lines.position(end)))


Said = tuple[str, int, int]
"""Markdown, and the offsets in the document that it is about."""


def _code(view: View) -> Said | None:
    """The code in a comment that suppresses it."""
    text = view.document.plain
    begin = text.rfind("\n", 0, view.offset) + 1
    end = text.find("\n", view.offset)
    line = text[begin : end if end >= 0 else len(text)]
    comment = line.find("deepbots:")
    for found in _CODE.finditer(line, max(0, comment)) if comment >= 0 else ():
        if begin + found.start() <= view.offset <= begin + found.end() and (page := of_finding(found.group())):
            return page, begin + found.start(), begin + found.end()
    return None


def _expression(view: View) -> Said | None:
    found = piece(view)
    if found is None or view.then is None:
        return None
    text = _of_piece(view, found)
    if not text:
        return None
    span = found.reading.text.part(found.node.start, found.node.end)
    moved = view.offset - view.then
    return text, span.start + moved, span.end + moved


def _of_piece(view: View, found: Piece) -> str | None:
    node, name = found.node, found.name
    if isinstance(node, syntax.Call) and found.cursor <= node.name_end and node.function in FUNCTIONS:
        known = found.type
        return of_function(FUNCTIONS[node.function]) + (f"\n\nHere it is {of_type(known)}." if known else "")
    if name is not None:
        return _of_name(view, found, name)
    known = found.type
    shown = " ".join(found.reading.text.text[node.start : node.end].split())
    return f"`{shown[:_LONGEST]}`: {of_type(known)}" if known else None


def _of_name(view: View, found: Piece, name: str) -> str | None:
    checked = view.analysis.checked if view.analysis else None
    if checked is None:
        return None
    leads = definition(checked, name, found.robot)
    if found.kinds is not None:
        subject = found.reading.scope.subject(name, found.kinds)
        return f"`{name}`: {subject.kind.words}{_shown(leads)}" if subject else None
    symbol = found.reading.scope.lookup(name)
    if symbol is None:  # a component of a vector, or a unit
        known = found.type
        unit = UNITS.get(name)
        return f"`{name}`: {of_type(known)}{_shown(leads)}" if known else f"`{name}`: {unit.dimension.words}" if unit else None
    what = f"{leads.what}, " if leads else ""
    return f"`{name}`: {what}{of_symbol(symbol)}{_shown(leads)}"


def _shown(leads: Named | None) -> str:
    """The line of the definition, where there is one."""
    if leads is None or leads.span is None:
        return ""
    line = leads.span.source.line(leads.span.begin.line).strip()[:_LONGEST]
    language = "xml" if line.startswith("<") else "yaml"
    return f"\n\n```{language}\n{line}\n```"


def _key_or_value(view: View) -> Said | None:
    found = pointed(view)
    if found is None or not found.text or not found.start <= view.offset <= found.end:
        return None
    text = _of_key(view, found) if found.is_key else _of_value(view, found)
    return (text, found.start, found.end) if text else None


def _of_key(view: View, found: Pointed) -> str | None:
    kinds = _kinds(view, found)
    if kinds is not None:
        return f"**{found.text}**: one of {', '.join(f'`{name}`' for name in kinds.names)}"
    part = key_of(found.path, view.data)
    if part is not None:
        return hover_text(part, str(found.path[-1]))
    for spec in specs(found.path[:-1], view.data):
        if isinstance(spec, MappingOf):
            own = _of_reference(view, found, spec.key) or _of_own_name(view, found)
            return own or f"`{found.text}`: a name of your choice, for {of_kind(spec.value)}"
    return None


def _kinds(view: View, found: Pointed) -> Kinds | None:
    """The kinds among which the word under this key chooses."""
    above = specs(found.path[:-1], view.data) if found.path else ()
    return next((spec for spec in above if isinstance(spec, Kinds) and spec.key == found.path[-1]), None)


def _of_own_name(view: View, found: Pointed) -> str | None:
    """A name that is defined there, and what is known of its value."""
    checked = view.analysis.checked if view.analysis else None
    if view.analysis is None or checked is None or checked.namespace is None or checked.document.root is None:
        return None
    defined = next((one for one in checked.namespace.definitions.values() if one.path == found.path and one.symbol is not None), None)
    if defined is not None and defined.symbol is not None:
        return f"`{found.text}`: {defined.origin.value}, {of_symbol(defined.symbol)}"
    if found.path[:1] == ("robots",) and found.path[2:3] == ("sensors",):
        boards = (reading.scope for reading in view.analysis.readings if isinstance(reading.scope, RobotScope))
        own = next((board.own[found.text] for board in boards if board.robot == found.path[1] and found.text in board.own), None)
        return f"`{found.text}`: a sensor, {of_symbol(own)}" if own is not None else None
    node, _, steps = descend(checked.document.root, found.path)
    if steps < len(found.path) or not isinstance(node, Scalar):
        return None
    span = node.part(0, len(node.text))
    read = next((reading for reading in view.analysis.readings if reading.trees and reading.text.span == span), None)
    return f"`{found.text}`: {of_type(read.trees[0].type)}" if read is not None else None


def _of_value(view: View, found: Pointed) -> str | None:
    for leaf in leaves(found.path, view.data):
        named = _of_reference(view, found, leaf)
        if named:
            return named
    kinds = _kinds(view, found)
    if kinds is not None and found.text in kinds.names:
        return f"`{found.text}`: {about_kind(kinds, found.text)}"
    steps = next((found.path[:end] for end in range(len(found.path), 0, -1) if isinstance(found.path[end - 1], str)), ())
    part = key_of(steps, view.data)
    return hover_text(part, str(steps[-1])) if part is not None else None


def _of_reference(view: View, found: Pointed, leaf: FieldType) -> str | None:
    checked = view.analysis.checked if view.analysis else None
    if checked is None or not isinstance(leaf, (Reference, Pattern)):
        return None
    match = next((known for known in names(checked, leaf.kind, found.path) if known.name == found.text), None)
    return f"`{match.name}`: {match.what}{_shown(match)}" if match else None
