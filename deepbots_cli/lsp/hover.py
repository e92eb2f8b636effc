"""Hover texts, and descriptions of functions, types, names and rules in Markdown."""

from __future__ import annotations

import re

from lsprotocol import types

from deepbots_cli.compiler.inventory import Named, definition, names
from deepbots_cli.compiler.namespace import RobotScope
from deepbots_cli.diagnostics.registry import RULES
from deepbots_cli.document import Scalar, descend
from deepbots_cli.expressions import syntax
from deepbots_cli.expressions.dimensions import UNITS
from deepbots_cli.expressions.functions import FUNCTIONS, Function
from deepbots_cli.expressions.intervals import EVERYTHING, Interval
from deepbots_cli.expressions.types import Symbol, Type, shown
from deepbots_cli.lint.pages import pages_of
from deepbots_cli.lsp.lookup import ExpressionNode, KeyOrValue, expression_at, field_types_at, key_or_value_at, section_of, shapes_at
from deepbots_cli.lsp.workspace import View
from deepbots_cli.scenario.base import Kinds, MappingOf, Section, Shape, fields, noun_of
from deepbots_cli.scenario.docs import about_kind
from deepbots_cli.scenario.docs import hover as hover_text
from deepbots_cli.scenario.fields import FieldType, Pattern, Reference

_CODE = re.compile(r"DB\d{3}")
_LONGEST = 300


def hover(view: View) -> types.Hover | None:
    """The hover text of a place; None for white space and text without a meaning."""
    found = _suppressed_code(view) or _expression(view) or _key_or_value(view)
    if found is None:
        return None
    text, start, end = found
    return types.Hover(types.MarkupContent(types.MarkupKind.Markdown, text), view.document.lines.range(start, end))


HoverText = tuple[str, int, int]
"""Markdown, and the start and end of the described text as offsets in the document."""


def _suppressed_code(view: View) -> HoverText | None:
    """The page of a rule whose code a suppressing comment names."""
    text = view.document.plain
    begin = text.rfind("\n", 0, view.offset) + 1
    end = text.find("\n", view.offset)
    line = text[begin : end if end >= 0 else len(text)]
    comment = line.find("deepbots:")
    for found in _CODE.finditer(line, max(0, comment)) if comment >= 0 else ():
        if begin + found.start() <= view.offset <= begin + found.end() and (page := describe_rule(found.group())):
            return page, begin + found.start(), begin + found.end()
    return None


def _expression(view: View) -> HoverText | None:
    found = expression_at(view)
    if found is None or view.known_offset is None:
        return None
    text = _node_text(view, found)
    if not text:
        return None
    span = found.reading.text.part(found.node.start, found.node.end)
    moved = view.offset - view.known_offset
    return text, span.start + moved, span.end + moved


def _node_text(view: View, found: ExpressionNode) -> str | None:
    node, name = found.node, found.name
    if isinstance(node, syntax.Call) and found.cursor <= node.name_end and node.function in FUNCTIONS:
        known = found.type
        return describe_function(FUNCTIONS[node.function]) + (f"\n\nHere it is {describe_type(known)}." if known else "")
    if name is not None:
        return _name_text(view, found, name)
    known = found.type
    source = " ".join(found.reading.text.text[node.start : node.end].split())
    return f"`{source[:_LONGEST]}`: {describe_type(known)}" if known else None


def _name_text(view: View, found: ExpressionNode, name: str) -> str | None:
    checked = view.checked
    if checked is None:
        return None
    named = definition(checked, name, found.robot)
    if found.kinds is not None:
        subject = found.reading.scope.subject(name, found.kinds)
        return f"`{name}`: {subject.kind.words}{_definition_line(named)}" if subject else None
    symbol = found.reading.scope.lookup(name)
    if symbol is None:  # a component of a vector, or a unit
        known = found.type
        if known:
            return f"`{name}`: {describe_type(known)}{_definition_line(named)}"
        return f"`{name}`: {UNITS[name].dimension.words}" if name in UNITS else None
    what = f"{named.what}, " if named else ""
    return f"`{name}`: {what}{describe_symbol(symbol)}{_definition_line(named)}"


def _definition_line(named: Named | None) -> str:
    """The source line of a definition as a code block; empty if there is none."""
    if named is None or named.span is None:
        return ""
    line = named.span.source.line(named.span.begin.line).strip()[:_LONGEST]
    language = "xml" if line.startswith("<") else "yaml"
    return f"\n\n```{language}\n{line}\n```"


def _key_or_value(view: View) -> HoverText | None:
    found = key_or_value_at(view)
    if found is None or not found.text or not found.start <= view.offset <= found.end:
        return None
    text = _key_text(view, found) if found.is_key else _value_text(view, found)
    return (text, found.start, found.end) if text else None


def _key_text(view: View, found: KeyOrValue) -> str | None:
    kinds = _kinds(view, found)
    if kinds is not None:
        return f"**{found.text}**: one of {', '.join(f'`{name}`' for name in kinds.names)}"
    part = section_of(found.path, view.data)
    if part is not None:
        return hover_text(part, str(found.path[-1]))
    for shape in shapes_at(found.path[:-1], view.data):
        if isinstance(shape, MappingOf):
            own = _reference_text(view, found, shape.key) or _defined_name_text(view, found)
            return own or f"`{found.text}`: a name of your choice, for {describe_shape(shape.value)}"
    return None


def _kinds(view: View, found: KeyOrValue) -> Kinds | None:
    """The kinds among which the value of this key chooses."""
    above = shapes_at(found.path[:-1], view.data) if found.path else ()
    return next((shape for shape in above if isinstance(shape, Kinds) and shape.key == found.path[-1]), None)


def _defined_name_text(view: View, found: KeyOrValue) -> str | None:
    """The description of a name at its definition."""
    checked = view.checked
    if view.analysis is None or checked is None or checked.namespace is None or checked.document.root is None:
        return None
    defined = next((one for one in checked.namespace.definitions.values() if one.path == found.path and one.symbol is not None), None)
    if defined is not None and defined.symbol is not None:
        return f"`{found.text}`: {defined.origin.value}, {describe_symbol(defined.symbol)}"
    if found.path[:1] == ("robots",) and found.path[2:3] == ("sensors",):
        boards = (reading.scope for reading in view.analysis.readings if isinstance(reading.scope, RobotScope))
        own = next((board.own[found.text] for board in boards if board.robot == found.path[1] and found.text in board.own), None)
        return f"`{found.text}`: a sensor, {describe_symbol(own)}" if own is not None else None
    node, _, steps = descend(checked.document.root, found.path)
    if steps < len(found.path) or not isinstance(node, Scalar):
        return None
    span = node.part(0, len(node.text))
    read = next((reading for reading in view.analysis.readings if reading.trees and reading.text.span == span), None)
    return f"`{found.text}`: {describe_type(read.trees[0].type)}" if read is not None else None


def _value_text(view: View, found: KeyOrValue) -> str | None:
    for field in field_types_at(found.path, view.data):
        named = _reference_text(view, found, field)
        if named:
            return named
    kinds = _kinds(view, found)
    if kinds is not None and found.text in kinds.names:
        return f"`{found.text}`: {about_kind(kinds, found.text)}"
    steps = next((found.path[:end] for end in range(len(found.path), 0, -1) if isinstance(found.path[end - 1], str)), ())
    part = section_of(steps, view.data)
    return hover_text(part, str(steps[-1])) if part is not None else None


def _reference_text(view: View, found: KeyOrValue, field: FieldType) -> str | None:
    checked = view.checked
    if checked is None or not isinstance(field, (Reference, Pattern)):
        return None
    match = next((known for known in names(checked, field.kind, found.path) if known.name == found.text), None)
    return f"`{match.name}`: {match.what}{_definition_line(match)}" if match else None


_LONGEST_NOUN = 120


def summary(part: type[Section], key: str) -> str:
    """The noun of a key's value, shortened for a completion list."""
    noun = noun_of(fields(part)[key])
    return noun if len(noun) <= _LONGEST_NOUN else f"{noun[:_LONGEST_NOUN]}…"


def describe_shape(shape: Shape) -> str:
    """The noun of a shape, with an example if it has one."""
    example = getattr(shape, "example", None)
    return f"{noun_of(shape)}, such as `{example}`" if example else noun_of(shape)


def describe_function(function: Function) -> str:
    lines = ["```text", function.signature, "```", function.doc]
    return "\n".join(lines + (["", f"For example `{function.example}`."] if function.example else []))


def describe_type(known: Type) -> str:
    """The dimension, components, interval and stage of a type: `a length (m), from 0 to 2.7 m, fixed`."""
    if known.picture is not None:
        rows, columns, channels = known.picture
        return f"a picture of {columns} x {rows} pixels with {channels} channel{'s' if channels > 1 else ''}"
    words = [known.words]
    if known.components is not None:
        words.append(f"with the components {shown(known.components)}")
    if not known.boolean and known.interval != EVERYTHING:
        words.append(_interval(known.interval, str(known.dimension)))
    return ", ".join([*words, known.stage.words])


def _interval(interval: Interval, dimension: str) -> str:
    unit = "" if dimension == "1" else f" {dimension}"
    if interval.single:
        return f"{interval.low:.6g}{unit}"
    if not interval.finite:
        low, high = interval.low > -float("inf"), interval.high < float("inf")
        return f"at least {interval.low:.6g}{unit}" if low else f"at most {interval.high:.6g}{unit}" if high else ""
    return f"from {interval.low:.6g} to {interval.high:.6g}{unit}"


def describe_symbol(symbol: Symbol) -> str:
    """The type and value of a name, or the reason why it has no value."""
    if symbol.refused is not None:
        return f"no value here: {symbol.refused}"
    if symbol.type is None:
        return "its definition has a finding"
    text = describe_type(symbol.type)
    if symbol.value is None or len(symbol.value) < 2:
        return text
    return f"{text}: {' '.join(f'{number:.6g}' for number in symbol.value)}"


def describe_rule(code: str) -> str | None:
    """The page of a rule by its code; None if no rule has the code."""
    rule = RULES.get(code)
    if rule is None:
        return None
    head = f"**{code}** {rule.name} ({rule.severity}{', in preview' if rule.preview else ''}): {rule.summary}"
    return "\n\n".join([head, *(page.markdown() for page in pages_of(code))])
