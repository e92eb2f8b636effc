"""What is under the cursor: hover texts and definitions; the descriptions of keys, functions, types and
rules."""

from __future__ import annotations

import re
from collections.abc import Iterator
from fnmatch import fnmatchcase
from pathlib import Path
from typing import NamedTuple

from lsprotocol import types

from deepbots_cli.compiler.inventory import NameEntry, definition, names_at
from deepbots_cli.compiler.namespace import RobotScope, ScenarioScope
from deepbots_cli.compiler.texts import SourceText
from deepbots_cli.compiler.values import ScopedExpression
from deepbots_cli.diagnostics import Span
from deepbots_cli.diagnostics.registry import RULE_CODE, RULES
from deepbots_cli.document import MappingNode, ScalarNode, descend, shipped
from deepbots_cli.document.files import resolve_reference
from deepbots_cli.document.nodes import NodePath, follow_dotted
from deepbots_cli.expressions import parser, syntax
from deepbots_cli.expressions.check import check
from deepbots_cli.expressions.dimensions import UNITS
from deepbots_cli.expressions.functions import FUNCTIONS, Form, Function
from deepbots_cli.expressions.intervals import EVERYTHING, Interval
from deepbots_cli.expressions.types import Kind, Symbol, ValueType, shortened_list, walk
from deepbots_cli.lint.pages import pages_of
from deepbots_cli.lsp.cursor import field_types_at, section_of, shapes_at
from deepbots_cli.lsp.workspace import CursorView, Locator, uri_of
from deepbots_cli.robots import packages
from deepbots_cli.scenario.base import (
    Kinds,
    MappingOf,
    Section,
    Shape,
    example_text,
    noun_of,
    section_fields,
    unit_of,
)
from deepbots_cli.scenario.documentation import default_of, key_description, section_description
from deepbots_cli.scenario.fields import FieldType, FilePath, Pattern, Reference
from deepbots_cli.words import counted

_MAX_CHARACTERS = 300
_LONGEST_NOUN = 120
_KEY = re.compile(r"[^\s:,\[\]{}#\"']*")
_COLON = re.compile(r"[\"']?[ \t]*:")
_VALUE = re.compile(r"(?:[^\s,\[\]{}]|[ \t]+(?![#\s]))*")
_START = types.Range(types.Position(0, 0), types.Position(0, 0))


class ExpressionNode(NamedTuple):
    """A node of an expression's syntax tree.

    `cursor` is the cursor's offset in the text of the expression. `kinds` is given if the node names a part
    of the world.
    """

    reading: ScopedExpression
    cursor: int
    node: syntax.Node
    kinds: frozenset[Kind] | None = None

    @property
    def name(self) -> str | None:
        """The dotted name under the cursor, up to the word under the cursor."""
        if not isinstance(self.node, syntax.Name):
            return None
        end = self.node.start
        text = self.reading.text.text
        for word in self.node.parts:
            end = text.index(word, end) + len(word)
            if self.cursor <= end:
                break
        return "".join(text[self.node.start : end].split())

    @property
    def definition(self) -> NameEntry | None:
        """The definition of the name under the cursor."""
        scope = self.reading.scope
        return definition(scope, self.name) if self.name and isinstance(scope, ScenarioScope) else None

    @property
    def type(self) -> ValueType | None:
        """The type of the node's value."""
        for tree in self.reading.trees:
            for node in walk(tree):
                if (node.start, node.end) == (self.node.start, self.node.end):
                    return node.type
        if isinstance(self.node, (syntax.Range, syntax.Spread, syntax.Options)):
            return None
        typed = check(self.node, self.reading.scope, ignore_finding)
        return typed.type if typed else None


class KeyOrValue(NamedTuple):
    """A key or a value at a path of the scenario; `start` and `end` are offsets in the current text."""

    path: NodePath
    text: str
    start: int
    end: int
    is_key: bool


def expression_at(view: CursorView) -> ExpressionNode | None:
    """Return the innermost node of the expression under the cursor."""
    if view.analysis is None or view.source is None or view.known_offset is None:
        return None
    readings = [
        (size, reading)
        for reading in view.analysis.readings
        if (size := _size_around(view, reading)) is not None
    ]
    if not readings:
        return None
    reading = min(readings, key=lambda pair: pair[0])[1]
    index = _index(reading.text, view.known_offset)
    text = reading.text.text
    tree = parser.parse(text, ignore_finding)
    # A comment is not part of the expression.
    if (
        tree is None
        or not tree.start <= index <= tree.end
        or "#" in text[text.rfind("\n", 0, index) + 1 : index]
    ):
        return None
    return _innermost(ExpressionNode(reading, index, tree))


def key_or_value_at(view: CursorView) -> KeyOrValue | None:
    """Return the key or the single value under the cursor."""
    cursor = view.cursor
    text = view.document.plain
    if cursor.role == "aside":
        return None
    if cursor.role == "key":
        end = _end(_KEY, text, view.offset)
        again = view.cursor_at(end)
        word = text[again.start : end]
        is_key = _COLON.match(text, end) is not None  # otherwise it may be a value on its own line
        return KeyOrValue((*again.path, word) if is_key else again.path, word, again.start, end, is_key)
    end = _end(_VALUE, text, view.offset)
    return KeyOrValue(cursor.path, text[cursor.start : end].strip("\"'"), cursor.start, end, is_key=False)


def _end(pattern: re.Pattern[str], text: str, start: int) -> int:
    match = pattern.match(text, start)
    return match.end() if match else start


def _size_around(view: CursorView, reading: ScopedExpression) -> int | None:
    """Return the length of the expression's text if it contains the cursor, otherwise None. A default has no
    text in the file."""
    text = reading.text
    then = view.known_offset
    first, last = text.part(0, 1), text.part(max(0, len(text.text) - 1), len(text.text))
    if first.source is not view.source or then is None or not first.start <= then <= last.end:
        return None
    is_default = first == last and first.end - first.start > 1
    return None if is_default else last.end - first.start


def _index(text: SourceText, offset: int) -> int:
    return next(
        (index for index in range(len(text.text)) if text.part(index, index + 1).end > offset), len(text.text)
    )


def _innermost(outer: ExpressionNode) -> ExpressionNode:
    """Return the smallest node that contains the cursor. The end of a name belongs to the name."""
    node, index = outer.node, outer.cursor
    if isinstance(node, syntax.Call) and index <= node.name_end:
        return outer
    for child, kinds in _inside(node):
        if child.start <= index <= child.end:
            return _innermost(outer._replace(node=child, kinds=kinds))
    return outer


def _inside(node: syntax.Node) -> Iterator[tuple[syntax.Node, frozenset[Kind] | None]]:
    """Yield the child nodes, with the allowed kinds for arguments that name a part of the world; numbers of a
    vector have its unit."""
    function = FUNCTIONS.get(node.function) if isinstance(node, syntax.Call) else None
    for index, child in enumerate(syntax.children(node)):
        param = (
            function.params[min(index, len(function.params) - 1)] if function and function.params else None
        )
        if isinstance(node, syntax.Vector) and isinstance(child, syntax.Number):
            child = child._replace(unit=node.unit)
        yield child, param.kinds if param is not None and param.form is Form.SUBJECT else None


def ignore_finding(*_finding: object, **_more: object) -> None:
    """Discard a finding, because the analysis reports it."""


# Hover texts


def hover(view: CursorView) -> types.Hover | None:
    """Return the hover text of a place; None for white space and text without a meaning."""
    contents = _suppressed_code(view) or _expression(view) or _key_or_value(view)
    if contents is None:
        return None
    text, start, end = contents
    return types.Hover(
        types.MarkupContent(types.MarkupKind.Markdown, text), view.document.lines.range(start, end)
    )


_HoverText = tuple[str, int, int]
"""Markdown, and the start and end of the described text as offsets in the document."""


def _suppressed_code(view: CursorView) -> _HoverText | None:
    """Return the page of a rule whose code a suppressing comment names."""
    text = view.document.plain
    begin = text.rfind("\n", 0, view.offset) + 1
    end = text.find("\n", view.offset)
    line = text[begin : end if end >= 0 else len(text)]
    comment = line.find("deepbots:")
    if comment >= 0:
        for match in RULE_CODE.finditer(line, max(0, comment)):
            if begin + match.start() <= view.offset <= begin + match.end() and (
                page := describe_rule(match.group())
            ):
                return page, begin + match.start(), begin + match.end()
    return None


def _expression(view: CursorView) -> _HoverText | None:
    node = expression_at(view)
    if node is None or view.known_offset is None:
        return None
    text = _node_text(view, node)
    if not text:
        return None
    span = node.reading.text.part(node.node.start, node.node.end)
    moved = view.offset - view.known_offset
    return text, span.start + moved, span.end + moved


def _node_text(view: CursorView, located: ExpressionNode) -> str | None:
    node, name = located.node, located.name
    if isinstance(node, syntax.Call) and located.cursor <= node.name_end and node.function in FUNCTIONS:
        node_type = located.type
        return describe_function(FUNCTIONS[node.function]) + (
            f"\n\nHere it is {describe_type(node_type)}." if node_type else ""
        )
    if name is not None:
        return _name_text(view, located, name)
    node_type = located.type
    source = " ".join(located.reading.text.text[node.start : node.end].split())
    return f"`{source[:_MAX_CHARACTERS]}`: {describe_type(node_type)}" if node_type else None


def _name_text(view: CursorView, node: ExpressionNode, name: str) -> str | None:
    entry = node.definition
    if node.kinds is not None:
        subject = node.reading.scope.subject(name, node.kinds)
        return f"`{name}`: {subject.kind.description}{_definition_line(entry)}" if subject else None
    symbol = node.reading.scope.lookup(name)
    if symbol is None and isinstance(node.node, syntax.Name) and name != node.node.dotted:
        subject = node.reading.scope.subject(name)
        return f"`{name}`: {subject.kind.description}{_definition_line(entry)}" if subject else None
    if symbol is None:  # the name is a component of a vector, or a unit
        node_type = node.type
        if node_type:
            return f"`{name}`: {describe_type(node_type)}{_definition_line(entry)}"
        return f"`{name}`: {UNITS[name].dimension.description}" if name in UNITS else None
    description = f"{entry.description}, " if entry else ""
    return f"`{name}`: {description}{describe_symbol(symbol)}{_definition_line(entry)}"


def _definition_line(entry: NameEntry | None) -> str:
    """Return the source line of a definition as a code block; empty if there is none."""
    if entry is None or entry.span is None:
        return ""
    line = entry.span.source.line(entry.span.start_position.line).strip()[:_MAX_CHARACTERS]
    language = "xml" if line.startswith("<") else "yaml"
    return f"\n\n```{language}\n{line}\n```"


def _key_or_value(view: CursorView) -> _HoverText | None:
    target = key_or_value_at(view)
    if target is None or not target.text or not _touches(view, target):
        return None
    text = _key_text(view, target) if target.is_key else _value_text(view, target)
    return (text, target.start, target.end) if text else None


def _touches(view: CursorView, target: KeyOrValue) -> bool:
    """Return whether the cursor is at a character of the target, and not among blanks or before a comment."""
    text, offset = view.document.plain, view.offset
    if not target.start <= offset <= target.end:
        return False
    before, after = text[target.start : offset][-1:], text[offset : target.end][:1]
    is_comment = after == "#" and text[offset - 1 : offset].isspace()
    return bool(before.strip()) or (bool(after.strip()) and not is_comment)


def _key_text(view: CursorView, target: KeyOrValue) -> str | None:
    kinds = _kinds(view, target)
    if kinds is not None:
        return f"**{target.text}**: one of {', '.join(f'`{name}`' for name in kinds.names)}"
    part = section_of(target.path, view.data)
    if part is not None:
        return describe_key(part, str(target.path[-1]))
    for shape in shapes_at(target.path[:-1], view.data):
        if isinstance(shape, MappingOf):
            text = _reference_text(view, target) or _defined_name_text(view, target)
            return text or f"`{target.text}`: a name of your choice, for {describe_shape(shape.value)}"
    return None


def _kinds(view: CursorView, target: KeyOrValue) -> Kinds | None:
    """Return the kinds among which the value of this key chooses."""
    above = shapes_at(target.path[:-1], view.data) if target.path else ()
    return next((shape for shape in above if isinstance(shape, Kinds) and shape.key == target.path[-1]), None)


def _defined_name_text(view: CursorView, target: KeyOrValue) -> str | None:
    """Return the description of a name at its definition."""
    checked = view.checked
    if view.analysis is None or checked is None or checked.namespace is None or checked.document.root is None:
        return None
    defined = next(
        (
            entry
            for entry in checked.namespace.definitions.values()
            if entry.path == target.path and entry.symbol is not None
        ),
        None,
    )
    is_sensor = target.path[:1] == ("robots",) and target.path[2:3] == ("sensors",)
    if defined is not None and defined.symbol is not None:
        return (
            f"`{target.text}`: {'a sensor' if is_sensor else defined.origin.value},"
            f" {describe_symbol(defined.symbol)}"
        )
    if is_sensor:
        boards = (
            reading.scope for reading in view.analysis.readings if isinstance(reading.scope, RobotScope)
        )
        symbol = next(
            (
                board.symbols[target.text]
                for board in boards
                if board.robot == target.path[1] and target.text in board.symbols
            ),
            None,
        )
        return f"`{target.text}`: a sensor, {describe_symbol(symbol)}" if symbol is not None else None
    node, _, steps = descend(checked.document.root, target.path)
    if steps < len(target.path) or not isinstance(node, ScalarNode):
        return None
    span = node.part(0, len(node.text))
    own_reading = next(
        (reading for reading in view.analysis.readings if reading.trees and reading.text.span == span), None
    )
    return f"`{target.text}`: {describe_type(own_reading.trees[0].type)}" if own_reading is not None else None


def _value_text(view: CursorView, target: KeyOrValue) -> str | None:
    if text := _reference_text(view, target):
        return text
    kinds = _kinds(view, target)
    if kinds is not None and target.text in kinds.names:
        return f"`{target.text}`: {section_description(kinds.models[target.text])}"
    steps = next(
        (
            target.path[:end]
            for end in range(len(target.path), 0, -1)
            if isinstance(target.path[end - 1], str)
        ),
        (),
    )
    part = section_of(steps, view.data)
    return describe_key(part, str(steps[-1])) if part is not None else None


def _reference_text(view: CursorView, target: KeyOrValue) -> str | None:
    match = next((entry for entry in _references_to(view, target) if entry.name == target.text), None)
    return f"`{match.name}`: {match.description}{_definition_line(match)}" if match else None


# Definitions


def definitions(view: CursorView, open_uris: dict[Path, str]) -> list[types.Location]:
    """Return the definitions of the name or file under the cursor; several for a pattern that matches
    several names."""
    target = key_or_value_at(view)
    file = _file(view, target, open_uris) if target is not None else None
    if file is not None:
        return [file]
    if view.analysis is None:
        return []
    locator = Locator(view.analysis, open_uris)
    return [
        locator.location(span) for span in _by_name(view) or (_by_reference(view, target) if target else [])
    ]


def _file(view: CursorView, target: KeyOrValue, open_uris: dict[Path, str]) -> types.Location | None:
    kinds = [field.kind for field in field_types_at(target.path, view.data) if isinstance(field, FilePath)]
    if target.is_key or not (kinds or target.path[-1:] in (("include",), ("extends",))):
        return None
    if target.path[-1:] == ("extends",):
        library = shipped.SCENARIOS
    elif "robot file" in kinds:
        library = shipped.ROBOTS
    else:
        library = None
    path = _located(view, target.text, library)
    return types.Location(open_uris.get(path) or uri_of(path), _START) if path is not None else None


def _located(view: CursorView, reference: str, library: shipped.Library | None) -> Path | None:
    """Return the file that a reference names; None if no such file exists or the scenario may not read it."""
    if reference.startswith("package://"):
        return packages.locate_file(reference, view.document.path.parent, view.roots)
    path = resolve_reference(reference, view.document.path.parent, view.roots, library)
    return path if isinstance(path, Path) else None


def _by_name(view: CursorView) -> list[Span]:
    """Return the definition of the name under the cursor in an expression."""
    node = expression_at(view)
    entry = node.definition if node is not None else None
    return [entry.span] if entry is not None and entry.span is not None else []


def _fields_of(view: CursorView, target: KeyOrValue) -> list[FieldType]:
    """Return the types that the schema gives a key of a mapping, or a value."""
    if not target.is_key:
        return field_types_at(target.path, view.data)
    above = shapes_at(target.path[:-1], view.data)
    return [shape.key for shape in above if isinstance(shape, MappingOf)]


def _references_to(view: CursorView, target: KeyOrValue) -> list[NameEntry]:
    """Return the names that a key or value refers to outside of expressions; several for a pattern."""
    for field in _fields_of(view, target):
        if view.checked is not None and isinstance(field, (Reference, Pattern)):
            entries = names_at(view.checked, field.kind, target.path, is_pattern=isinstance(field, Pattern))
            if fitting := [entry for entry in entries if fnmatchcase(entry.name, target.text)]:
                return fitting
    return []


def _by_reference(view: CursorView, target: KeyOrValue) -> list[Span]:
    """Return the definitions of a reference or pattern outside of expressions."""
    spans = [entry.span for entry in _references_to(view, target) if entry.span]
    root = view.checked.document.root if view.checked is not None else None
    kinds = [field.kind for field in _fields_of(view, target) if isinstance(field, Reference)]
    return _setting(root, target.text) if root is not None and not spans and "setting" in kinds else spans


def _setting(root: MappingNode, text: str) -> list[Span]:
    """Return the key at the dotted path of a setting."""
    steps, _, unresolved = follow_dotted(root, text)
    key = descend(root, steps)[1] if steps and not unresolved else None
    return [key.span] if key else []


# Descriptions


def summary(part: type[Section], key: str) -> str:
    """Return the noun of a key's value, shortened for a completion list."""
    noun = noun_of(section_fields(part)[key])
    return noun if len(noun) <= _LONGEST_NOUN else f"{noun[:_LONGEST_NOUN]}…"


def describe_key(section: type[Section], key: str) -> str:
    """Return a key in Markdown: its type, sentence, unit, default and example."""
    shape = section_fields(section)[key]
    unit = unit_of(shape)
    if unit == "1":
        shown = "none, a plain number"
    elif unit.startswith("of the "):
        shown = unit
    else:
        shown = f"`{unit.replace(' or ', '` or `')}`"
    facts = [f"**Unit:** {shown}"] if unit else []
    if section.model_fields[key].is_required():
        facts.append("**Required**")
    elif default := default_of(section, key):
        facts.append(f"**Default:** `{default}`")
    example = example_text(section, key)
    blocks = [f"**{key}**: {noun_of(shape)}", key_description(section, key), " · ".join(facts)]
    return "\n\n".join([*filter(None, blocks), *([f"```yaml\n{key}: {example}\n```"] if example else [])])


def describe_shape(shape: Shape) -> str:
    """Return the noun of a shape, with an example if it has one."""
    example = getattr(shape, "example", None)
    return f"{noun_of(shape)}, such as `{example}`" if example else noun_of(shape)


def describe_function(function: Function) -> str:
    lines = ["```text", function.signature, "```", function.doc]
    return "\n".join(lines + (["", f"For example `{function.example}`."] if function.example else []))


def describe_type(value_type: ValueType) -> str:
    """Return the dimension, components and interval of a type, and when it is known: `a length (m), from 0 to
    2.7 m, fixed`."""
    if value_type.picture is not None:
        rows, columns, channels = value_type.picture
        return f"a picture of {columns} x {rows} pixels with {counted(channels, 'channel')}"
    words = [value_type.description]
    if value_type.components is not None:
        words.append(f"with the components {shortened_list(value_type.components)}")
    if not value_type.boolean and value_type.interval != EVERYTHING:
        words.append(_interval(value_type.interval, str(value_type.dimension)))
    return ", ".join([*words, value_type.known.description])


def _interval(interval: Interval, dimension: str) -> str:
    unit = "" if dimension == "1" else f" {dimension}"
    if interval.is_single:
        return f"{interval.low:.6g}{unit}"
    if not interval.is_finite:
        low, high = interval.low > -float("inf"), interval.high < float("inf")
        if low:
            return f"at least {interval.low:.6g}{unit}"
        if high:
            return f"at most {interval.high:.6g}{unit}"
        return ""
    return f"from {interval.low:.6g} to {interval.high:.6g}{unit}"


def describe_symbol(symbol: Symbol) -> str:
    """Return the type and value of a name, or the reason why it has no value."""
    if symbol.refusal is not None:
        return f"no value here: {symbol.refusal}"
    if symbol.type is None:
        return "its definition has a finding"
    text = describe_type(symbol.type)
    if symbol.value is None or len(symbol.value) < 2:
        return text
    return f"{text}: {' '.join(f'{number:.6g}' for number in symbol.value)}"


def describe_rule(code: str) -> str | None:
    """Return the page of a rule by its code; None if no rule has the code."""
    rule = RULES.get(code)
    if rule is None:
        return None
    head = f"**{code}** {rule.name} ({rule.severity}{', in preview' if rule.preview else ''}): {rule.summary}"
    return "\n\n".join([head, *(page.markdown() for page in pages_of(code))])
