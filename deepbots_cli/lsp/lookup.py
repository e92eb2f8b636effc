"""Look-ups by path and cursor: the shapes that the schema allows; the expression, key or value under the
cursor and its definition; document symbols; names that the current text defines, and choices of a
completion.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, NamedTuple

from lsprotocol import types
from lsprotocol.types import CompletionItemKind

from deepbots_cli.compiler.inventory import action_at, definition, names_at
from deepbots_cli.compiler.namespace import RobotScope
from deepbots_cli.compiler.texts import SourceText
from deepbots_cli.compiler.values import ScopedExpression
from deepbots_cli.diagnostics import Span
from deepbots_cli.document import Entry, MappingNode, descend, shipped
from deepbots_cli.document.files import resolve_reference
from deepbots_cli.document.nodes import NodePath, follow_dotted
from deepbots_cli.expressions import parser, syntax
from deepbots_cli.expressions.check import check
from deepbots_cli.expressions.functions import FUNCTIONS, Form
from deepbots_cli.expressions.types import Kind, ValueType, walk
from deepbots_cli.lsp.cursor import value_at
from deepbots_cli.lsp.workspace import CursorView, Document, Locator, uri_of
from deepbots_cli.robots import packages
from deepbots_cli.scenario.base import Forms, Kinds, ListOf, MappingOf, Section, Shape, section_fields
from deepbots_cli.scenario.fields import (
    REFERENCE_KINDS,
    FieldType,
    FilePath,
    Pattern,
    Reference,
    ReferenceKind,
)
from deepbots_cli.scenario.scenario import Scenario


class Choice(NamedTuple):
    """A completion: its text, what it is in a few words (`detail`), and its documentation in Markdown."""

    text: str
    kind: CompletionItemKind
    detail: str
    doc: str = ""


def unique(choices: Iterable[Choice]) -> Iterable[Choice]:
    """Return the first choice of each text."""
    first: dict[str, Choice] = {}
    for choice in choices:
        first.setdefault(choice.text, choice)
    return first.values()


VALUE_ON_BOARD = "value on board"
"""The kind of the names in expressions of a robot controller, beside those of `REFERENCE_KINDS`."""
_ON_BOARD = ReferenceKind({("parameters",): "a parameter", ("action",): "an action"}, ("sensors", "receive"))
_WRITTEN_PARTS = ("sensors", "actuators", "receive")
"""The sections of a robot whose keys are names, not names or patterns of parts of its file."""


def names_in_text(kind: str, path: NodePath, data: Any) -> Iterator[str]:
    """Yield the names in `data` that a reference of this kind may name at `path`."""
    for section in _section_paths(kind, path):
        value = value_at(data, section)
        if isinstance(value, dict):
            yield from (name for name in value if not defines(path, name))
        elif isinstance(value, list):
            names = (value_at(item, ("name",)) for item in value)
            yield from (name for name in names if isinstance(name, str) and name)
    if kind == "value":
        yield from _sent(data)
    if kind == "message field":
        yield from (name for name in _sent(data) if not name.startswith(f"{path[1]}."))
    if kind == "letter":
        cells = dict.fromkeys(str(value_at(data, (*path[:3], "map"))).split())
        yield from (letter for letter in cells if letter != ".")


def defines(path: NodePath, name: str) -> bool:
    """Return whether `path` is the definition of the name, which cannot refer to itself."""
    return path[:-1] in REFERENCE_KINDS["value"].sections and path[-1] == name


def _sent(data: Any) -> Iterator[str]:
    """Yield the full names of what robots send."""
    robots = value_at(data, ("robots",))
    for robot in robots if isinstance(robots, dict) else ():
        sent = value_at(data, ("robots", robot, "emit")) or value_at(data, ("robots", robot, "sensors"))
        if isinstance(sent, (dict, list)):
            yield from (f"{robot}.{name}" for name in sent if isinstance(name, str) and name)


def _section_paths(kind: str, path: NodePath) -> Iterator[NodePath]:
    if kind in ("choice", "option"):
        if action := action_at(path):
            yield ("action", action, "choices")
        return
    if kind == "value" and path[:1] == ("observation",):
        yield ("augment",)
        return
    reference = _ON_BOARD if kind == VALUE_ON_BOARD else REFERENCE_KINDS[kind]
    robot = path[:2] if path[:1] == ("robots",) and len(path) > 1 else ()
    if robot:
        yield from ((*robot, part) for part in reference.parts if part in _WRITTEN_PARTS)
    yield from reference.sections
    if path[:1] == ("agents",) and len(path) > 1:
        yield from ((*path[:2], *section) for section in reference.sections)


_OPTION = Reference("option")
_KEY = re.compile(r"[^\s:,\[\]{}#\"']*")
_COLON = re.compile(r"[\"']?[ \t]*:")
_VALUE = re.compile(r"(?:[^\s,\[\]{}]|[ \t]+(?![#\s]))*")
_START = types.Range(types.Position(0, 0), types.Position(0, 0))
_ALIAS = re.compile(r"\*([\w-]+)")
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
    "tests": types.SymbolKind.Method,
}
"""The symbol kind of the names in a section."""


def shapes_at(path: NodePath, data: Any) -> list[Shape]:
    """Return every shape that the schema allows at `path`; several while the data does not determine the form
    of a value."""
    shapes = list(dict.fromkeys(_shapes(Scenario, data, path)))
    # A rule of a script, or an action of a test, gives an expression or an option of the action; the schema
    # does not distinguish them.
    of_test = path[:1] == ("tests",) and path[2:3] == ("actions",) and len(path) in (4, 5)
    return [_OPTION, *shapes] if of_test or (path[:1] == ("scripts",) and len(path) == 3) else shapes


def field_types_at(path: NodePath, data: Any) -> list[FieldType]:
    """Return the field types that the schema allows at `path`."""
    return [shape for shape in shapes_at(path, data) if isinstance(shape, FieldType)]


def section_of(path: NodePath, data: Any) -> type[Section] | None:
    """Return the section that defines the last key of `path`; None for a name that the user chose."""
    if not path or not isinstance(path[-1], str):
        return None
    for shape in shapes_at(path[:-1], data):
        for section in _sections(shape, value_at(data, path[:-1])):
            if path[-1] in section_fields(section):
                return section
    return None


def _shapes(shape: Shape, data: Any, path: NodePath) -> Iterator[Shape]:
    if isinstance(shape, Forms):
        for option in _forms(shape, data, bool(path)):
            yield from _shapes(option, data, path)
        return
    if not path:
        yield shape
        return
    step, remaining_path = path[0], path[1:]
    below = value_at(data, (step,))
    match shape:
        case ListOf() if isinstance(step, int):
            yield from _shapes(shape.item, below, remaining_path)
        case MappingOf() if isinstance(step, str):
            yield from _shapes(shape.value, below, remaining_path)
        case FieldType() if isinstance(step, int) and not remaining_path:
            yield shape  # a list of names is one value
        case FieldType() | ListOf() | MappingOf():
            return
        case _:
            for section in _sections(shape, data):
                if step in section_fields(section):
                    yield from _shapes(section_fields(section)[str(step)], below, remaining_path)


def _forms(shape: Forms, data: Any, goes_on: bool) -> tuple[Shape, ...]:
    """Return the form that the data determines, or all forms if the data determines none."""
    if isinstance(data, (dict, list)) and data:
        form = shape.choose(data)
        if form is not None:
            return (form,)
    if isinstance(data, str) and data and not goes_on:
        return tuple(option for option in shape.options if isinstance(option, FieldType)) or shape.options
    return shape.options


def _sections(shape: Shape, data: Any) -> tuple[type[Section], ...]:
    """Return the sections whose keys data of this shape may have."""
    if isinstance(shape, Kinds):
        section = shape.find(data)
        return (section,) if section else shape.distinct_models
    return (shape,) if isinstance(shape, type) else ()


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
    def robot(self) -> str | None:
        """The robot that computes the expression; None for the supervisor."""
        return self.reading.scope.robot if isinstance(self.reading.scope, RobotScope) else None

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
        if child.start <= index <= child.end and not (
            child.start == index and isinstance(child, syntax.Binary)
        ):
            return _innermost(outer._replace(node=child, kinds=kinds))
    return outer


def _inside(node: syntax.Node) -> Iterator[tuple[syntax.Node, frozenset[Kind] | None]]:
    """Yield the child nodes, with the allowed kinds for arguments that name a part of the world."""
    function = FUNCTIONS.get(node.function) if isinstance(node, syntax.Call) else None
    for index, child in enumerate(syntax.children(node)):
        param = (
            function.params[min(index, len(function.params) - 1)] if function and function.params else None
        )
        yield child, param.kinds if param is not None and param.form is Form.SUBJECT else None


def ignore_finding(*_finding: object, **_more: object) -> None:
    """Discard a finding, because the analysis reports it."""


def definitions(view: CursorView, open_uris: dict[Path, str]) -> list[types.Location]:
    """Return the definitions of the name, alias or file under the cursor; several for a pattern that matches
    several names."""
    anchor = _anchor(view)
    if anchor is not None:
        return [anchor]
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


def _anchor(view: CursorView) -> types.Location | None:
    text = view.document.plain
    begin = text.rfind("\n", 0, view.offset) + 1
    for alias in _ALIAS.finditer(text, begin, view.offset + 100):
        if alias.start() <= view.offset <= alias.end():
            anchors = list(re.finditer(rf"&{re.escape(alias[1])}(?![\w-])", text[: alias.start()]))
            return (
                types.Location(view.document.uri, view.document.lines.range(*anchors[-1].span()))
                if anchors
                else None
            )
    return None


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
    if node is None or node.name is None or view.checked is None:
        return []
    entry = definition(view.checked, node.name, node.robot)
    return [entry.span] if entry and entry.span else []


def _by_reference(view: CursorView, target: KeyOrValue) -> list[Span]:
    """Return the definitions of a reference or pattern outside of expressions."""
    checked = view.checked
    if checked is None or checked.document.root is None:
        return []
    kinds: list[FieldType] = field_types_at(target.path, view.data)
    if target.is_key:
        kinds = [
            shape.key for shape in shapes_at(target.path[:-1], view.data) if isinstance(shape, MappingOf)
        ]
    for field in kinds:
        if isinstance(field, (Reference, Pattern)):
            fitting = [
                entry.span
                for entry in names_at(checked, field.kind, target.path)
                if fnmatchcase(entry.name, target.text) and entry.span
            ]
            if fitting:
                return fitting
            if field.kind == "setting":
                return _setting(checked.document.root, target.text)
    return []


def _setting(root: MappingNode, text: str) -> list[Span]:
    """Return the key at the dotted path of a setting."""
    steps, _, unresolved = follow_dotted(root, text)
    key = descend(root, steps)[1] if steps and not unresolved else None
    return [key.span] if key else []


def document_symbols(document: Document) -> list[types.DocumentSymbol]:
    """Return the keys of a document in the order of the file; empty if the document cannot be parsed."""
    _, root, _ = document.read()
    return list(_symbols(document, root, "", _DEPTH)) if isinstance(root, MappingNode) else []


def _symbols(
    document: Document, mapping: MappingNode, section: str, depth: int
) -> Iterator[types.DocumentSymbol]:
    for name, entry in mapping.entries.items():
        inner = entry.value
        # The value of an alias has another place in the text.
        is_here = isinstance(inner, MappingNode) and inner.span.start >= entry.key.span.start
        below = (
            list(_symbols(document, inner, name, depth - 1))
            if isinstance(inner, MappingNode) and is_here and depth > 1
            else []
        )
        kind = types.SymbolKind.Namespace if below else types.SymbolKind.Property
        yield _document_symbol(document, entry, _SECTIONS.get(section, kind), below)


def _document_symbol(
    document: Document, entry: Entry, kind: types.SymbolKind, below: list[types.DocumentSymbol]
) -> types.DocumentSymbol:
    key = entry.key.span
    end = max(key.end, entry.value.span.end if entry.value.span.start >= key.start else key.end)
    full_range = document.lines.range(key.start, end)
    return types.DocumentSymbol(
        entry.key.text, kind, full_range, document.lines.range(key.start, key.end), children=below or None
    )
