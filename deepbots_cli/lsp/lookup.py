"""What the schema allows at a path; the expression, key or value under the cursor, its definition; the symbols of a document."""

from __future__ import annotations

import re
from collections.abc import Iterator
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, NamedTuple

from lsprotocol import types

from deepbots_cli.compiler.inventory import definition, names
from deepbots_cli.compiler.namespace import RobotScope
from deepbots_cli.compiler.values import Reading, Text
from deepbots_cli.diagnostics import Span
from deepbots_cli.document import Entry, Mapping, descend, shipped
from deepbots_cli.document.files import resolve
from deepbots_cli.document.nodes import Path as KeyPath
from deepbots_cli.document.nodes import follow
from deepbots_cli.expressions import parser, syntax
from deepbots_cli.expressions.check import check
from deepbots_cli.expressions.functions import FUNCTIONS, Form
from deepbots_cli.expressions.types import Kind, Type, Typed, children
from deepbots_cli.lsp.cursor import value_at
from deepbots_cli.lsp.diagnostics import Locator
from deepbots_cli.lsp.workspace import Document, View, uri_of
from deepbots_cli.robots import meshes
from deepbots_cli.scenario.base import Forms, Kinds, ListOf, MappingOf, Section, Shape, fields
from deepbots_cli.scenario.fields import FieldType, FilePath, Pattern, Reference
from deepbots_cli.scenario.scenario import Scenario

_OPTION = Reference("option")


def shapes_at(path: KeyPath, data: Any) -> list[Shape]:
    """Every shape that the schema allows at `path`; several while the data does not decide between the forms of a value."""
    found = list(dict.fromkeys(_shapes(Scenario, data, path)))
    # A rule of a script gives an expression or an option of the action; the schema cannot tell the two apart.
    return [_OPTION, *found] if path[:1] == ("scripts",) and len(path) == 3 else found


def field_types_at(path: KeyPath, data: Any) -> list[FieldType]:
    """The field types that the schema allows at `path`."""
    return [shape for shape in shapes_at(path, data) if isinstance(shape, FieldType)]


def section_of(path: KeyPath, data: Any) -> type[Section] | None:
    """The section that defines the last key of `path`; None for a name that the user chose."""
    if not path or not isinstance(path[-1], str):
        return None
    for shape in shapes_at(path[:-1], data):
        for section in _sections(shape, value_at(data, path[:-1])):
            if path[-1] in fields(section):
                return section
    return None


def _shapes(shape: Shape, data: Any, path: KeyPath) -> Iterator[Shape]:
    if isinstance(shape, Forms):
        for option in _forms(shape, data, bool(path)):
            yield from _shapes(option, data, path)
        return
    if not path:
        yield shape
        return
    step, rest = path[0], path[1:]
    below = value_at(data, (step,))
    match shape:
        case ListOf() if isinstance(step, int):
            yield from _shapes(shape.item, below, rest)
        case MappingOf() if isinstance(step, str):
            yield from _shapes(shape.value, below, rest)
        case FieldType() if isinstance(step, int) and not rest:
            yield shape  # a list of names is one value
        case FieldType() | ListOf() | MappingOf():
            return
        case _:
            for section in _sections(shape, data):
                if step in fields(section):
                    yield from _shapes(fields(section)[str(step)], below, rest)


def _forms(shape: Forms, data: Any, goes_on: bool) -> tuple[Shape, ...]:
    """The form that the data chooses, or all forms while the data decides nothing."""
    if isinstance(data, (dict, list)) and data:
        chosen = shape.choose(data)
        if chosen is not None:
            return (chosen,)
    if isinstance(data, str) and data and not goes_on:
        return tuple(option for option in shape.options if isinstance(option, FieldType)) or shape.options
    return shape.options


def _sections(shape: Shape, data: Any) -> tuple[type[Section], ...]:
    """The sections whose keys data of this shape may hold."""
    if isinstance(shape, Kinds):
        found = shape.find(data)
        return (found,) if found else shape.every
    return (shape,) if isinstance(shape, type) else ()


_KEY = re.compile(r"[^\s:,\[\]{}#\"']*")
_COLON = re.compile(r"[\"']?[ \t]*:")
_VALUE = re.compile(r"(?:[^\s,\[\]{}]|[ \t]+(?![#\s]))*")


class ExpressionNode(NamedTuple):
    """A node of an expression's syntax tree.

    `cursor` is the cursor's offset in the text of the expression. `kinds` is given if the node names a part of the world.
    """

    reading: Reading
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
    def robot(self) -> str | None:
        """The robot that computes the expression; None for the supervisor."""
        return self.reading.scope.robot if isinstance(self.reading.scope, RobotScope) else None

    @property
    def type(self) -> Type | None:
        """The type of the node's value."""
        for tree in self.reading.trees:
            for node in _below(tree):
                if (node.start, node.end) == (self.node.start, self.node.end):
                    return node.type
        if isinstance(self.node, (syntax.Range, syntax.Spread, syntax.Options)):
            return None
        typed = check(self.node, self.reading.scope, ignore_finding)
        return typed.type if typed else None


class KeyOrValue(NamedTuple):
    """A key or a value at a path of the scenario; `start` and `end` are offsets in the current text."""

    path: KeyPath
    text: str
    start: int
    end: int
    is_key: bool


def expression_at(view: View) -> ExpressionNode | None:
    """The innermost node of the expression under the cursor."""
    if view.analysis is None or view.source is None or view.known_offset is None:
        return None
    found = [(size, reading) for reading in view.analysis.readings if (size := _size_around(view, reading)) is not None]
    if not found:
        return None
    reading = min(found, key=lambda one: one[0])[1]
    index = _index(reading.text, view.known_offset)
    text = reading.text.text
    tree = parser.parse(text, ignore_finding)
    if tree is None or not tree.start <= index <= tree.end or "#" in text[text.rfind("\n", 0, index) + 1 : index]:  # a comment
        return None
    return _innermost(ExpressionNode(reading, index, tree))


def key_or_value_at(view: View) -> KeyOrValue | None:
    """The key or the single value under the cursor."""
    place, text = view.place, view.document.plain
    if place.role == "aside":
        return None
    if place.role == "key":
        end = _end(_KEY, text, view.offset)
        again = view.place_at(end)
        word = text[again.start : end]
        is_key = _COLON.match(text, end) is not None  # otherwise it may be a value on its own line
        return KeyOrValue((*again.path, word) if is_key else again.path, word, again.start, end, is_key)
    end = _end(_VALUE, text, view.offset)
    return KeyOrValue(place.path, text[place.start : end].strip("\"'"), place.start, end, is_key=False)


def _end(pattern: re.Pattern[str], text: str, start: int) -> int:
    found = pattern.match(text, start)
    return found.end() if found else start


def _size_around(view: View, reading: Reading) -> int | None:
    """The length of the expression's text if it holds the cursor, otherwise None; a default has no text in the file."""
    text, then = reading.text, view.known_offset
    first, last = text.part(0, 1), text.part(max(0, len(text.text) - 1), len(text.text))
    if first.source is not view.source or then is None or not first.start <= then <= last.end:
        return None
    is_default = first == last and first.end - first.start > 1
    return None if is_default else last.end - first.start


def _index(text: Text, offset: int) -> int:
    """The index in `text` of the character at an offset of its file."""
    return next((index for index in range(len(text.text)) if text.part(index, index + 1).end > offset), len(text.text))


def _innermost(outer: ExpressionNode) -> ExpressionNode:
    """The smallest node that holds the cursor; the end of a name belongs to the name."""
    node, index = outer.node, outer.cursor
    if isinstance(node, syntax.Call) and index <= node.name_end:
        return outer
    for child, kinds in _inside(node):
        if child.start <= index <= child.end and not (child.start == index and isinstance(child, syntax.Binary)):
            return _innermost(outer._replace(node=child, kinds=kinds))
    return outer


def _inside(node: syntax.Node) -> Iterator[tuple[syntax.Node, frozenset[Kind] | None]]:
    """The child nodes, with the allowed kinds for arguments that name a part of the world."""
    function = FUNCTIONS.get(node.function) if isinstance(node, syntax.Call) else None
    for index, child in enumerate(syntax.children(node)):
        param = function.params[min(index, len(function.params) - 1)] if function and function.params else None
        yield child, param.kinds if param is not None and param.form is Form.SUBJECT else None


def _below(tree: Typed) -> Iterator[Typed]:
    yield tree
    for child in children(tree):
        yield from _below(child)


def ignore_finding(*_finding: object, **_more: object) -> None:
    """Discard findings; the analysis reports them."""


_START = types.Range(types.Position(0, 0), types.Position(0, 0))
_ALIAS = re.compile(r"\*([\w-]+)")


def definitions(view: View, open_uris: dict[Path, str]) -> list[types.Location]:
    """The definitions of the name, alias or file under the cursor; several for a pattern that matches several names."""
    anchor = _anchor(view)
    if anchor is not None:
        return [anchor]
    found = key_or_value_at(view)
    file = _file(view, found, open_uris) if found is not None else None
    if file is not None:
        return [file]
    if view.analysis is None:
        return []
    locator = Locator(view.analysis, open_uris)
    return [locator.location(span) for span in _by_name(view) or (_by_reference(view, found) if found else [])]


def _anchor(view: View) -> types.Location | None:
    """The anchor of the alias under the cursor."""
    text = view.document.plain
    begin = text.rfind("\n", 0, view.offset) + 1
    for alias in _ALIAS.finditer(text, begin, view.offset + 100):
        if alias.start() <= view.offset <= alias.end():
            anchors = list(re.finditer(rf"&{re.escape(alias[1])}(?![\w-])", text[: alias.start()]))
            return types.Location(view.document.uri, view.document.lines.range(*anchors[-1].span())) if anchors else None
    return None


def _file(view: View, found: KeyOrValue, open_uris: dict[Path, str]) -> types.Location | None:
    kinds = [field.kind for field in field_types_at(found.path, view.data) if isinstance(field, FilePath)]
    if found.is_key or not (kinds or found.path[-1:] in (("include",), ("extends",))):
        return None
    path = _located(view, found.text, robots="robot file" in kinds)
    return types.Location(open_uris.get(path) or uri_of(path), _START) if path is not None else None


def _located(view: View, reference: str, *, robots: bool) -> Path | None:
    """The file that a reference names; None if no such file exists or the scenario may not read it."""
    if reference.startswith("package://"):
        return meshes.in_package(reference)
    found = resolve(reference, view.document.path.parent, view.roots)
    if isinstance(found, Path):
        return found
    return shipped.robot_path(reference) if robots else None


def _by_name(view: View) -> list[Span]:
    """The definition of the name under the cursor in an expression."""
    found = expression_at(view)
    if found is None or found.name is None or view.checked is None:
        return []
    named = definition(view.checked, found.name, found.robot)
    return [named.span] if named and named.span else []


def _by_reference(view: View, found: KeyOrValue) -> list[Span]:
    """The definitions of a reference or pattern outside of expressions."""
    checked = view.checked
    if checked is None or checked.document.root is None:
        return []
    kinds: list[FieldType] = field_types_at(found.path, view.data)
    if found.is_key:
        kinds = [shape.key for shape in shapes_at(found.path[:-1], view.data) if isinstance(shape, MappingOf)]
    for field in kinds:
        if isinstance(field, (Reference, Pattern)):
            fitting = [known.span for known in names(checked, field.kind, found.path) if fnmatchcase(known.name, found.text) and known.span]
            if fitting:
                return fitting
            if field.kind == "setting":
                return _setting(checked.document.root, found.text)
    return []


def _setting(root: Mapping, text: str) -> list[Span]:
    """The key at the dotted path of a setting."""
    steps, _, rest = follow(root, text)
    key = descend(root, steps)[1] if steps and not rest else None
    return [key.span] if key else []


_DEPTH = 4
_SECTIONS = {
    "parameters": types.SymbolKind.Constant,
    "signals": types.SymbolKind.Variable,
    "augment": types.SymbolKind.Variable,
    "robots": types.SymbolKind.Class,
    "objects": types.SymbolKind.Object,
    "action": types.SymbolKind.Event,
    "reward": types.SymbolKind.Number,
    "success": types.SymbolKind.Boolean,
    "failure": types.SymbolKind.Boolean,
    "sensors": types.SymbolKind.Interface,
    "actuators": types.SymbolKind.Interface,
    "scripts": types.SymbolKind.Function,
}
"""The symbol kind of the names in a section."""


def document_symbols(document: Document) -> list[types.DocumentSymbol]:
    """The keys of a document in the order of the file; empty if the document cannot be parsed."""
    _, root, _ = document.read()
    return list(_symbols(document, root, "", _DEPTH)) if isinstance(root, Mapping) else []


def _symbols(document: Document, mapping: Mapping, section: str, depth: int) -> Iterator[types.DocumentSymbol]:
    for name, entry in mapping.entries.items():
        inner = entry.value
        is_here = isinstance(inner, Mapping) and inner.span.start >= entry.key.span.start  # the value of an alias lies elsewhere
        below = list(_symbols(document, inner, name, depth - 1)) if isinstance(inner, Mapping) and is_here and depth > 1 else []
        kind = types.SymbolKind.Namespace if below else types.SymbolKind.Property
        yield _document_symbol(document, entry, _SECTIONS.get(section, kind), below)


def _document_symbol(document: Document, entry: Entry, kind: types.SymbolKind, below: list[types.DocumentSymbol]) -> types.DocumentSymbol:
    key = entry.key.span
    end = max(key.end, entry.value.span.end if entry.value.span.start >= key.start else key.end)
    whole = document.lines.range(key.start, end)
    return types.DocumentSymbol(entry.key.text, kind, whole, document.lines.range(key.start, key.end), children=below or None)
