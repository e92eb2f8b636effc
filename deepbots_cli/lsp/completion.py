"""Completion of keys, words, names, expressions and files, also in a document that is broken at the cursor.

The schema gives keys and words by the path of the cursor. Names come from the last analysis that resolved
them and from the current text.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from typing import Any

from lsprotocol.types import (
    CompletionItem,
    CompletionItemKind,
    CompletionList,
    MarkupContent,
    MarkupKind,
    TextEdit,
)

from deepbots_cli.compiler.inventory import names_at
from deepbots_cli.diagnostics.registry import RULES
from deepbots_cli.document import shipped
from deepbots_cli.document.nodes import NodePath
from deepbots_cli.lsp.choices import Choice, unique
from deepbots_cli.lsp.cursor import value_at
from deepbots_cli.lsp.expression_completion import expression_choices, is_expression, word_before
from deepbots_cli.lsp.hover import describe_key, describe_shape, summary
from deepbots_cli.lsp.lookup import section_of, shapes_at
from deepbots_cli.lsp.workspace import CursorView
from deepbots_cli.lsp.written_names import names_in_text
from deepbots_cli.robots.meshes import MESH_SUFFIXES
from deepbots_cli.scenario.base import Kinds, MappingOf, Section, section_fields
from deepbots_cli.scenario.documentation import example_of, section_description
from deepbots_cli.scenario.fields.base import FieldType
from deepbots_cli.scenario.fields.names import FilePath, Pattern, Reference
from deepbots_cli.scenario.fields.quantities import Quantity, Range
from deepbots_cli.scenario.fields.words import COLORS, ColorValue, Flag, Word
from deepbots_cli.scenario.scenario import VERSION

_INCLUDE = Choice(
    "include",
    CompletionItemKind.Keyword,
    "a file with the value of this mapping; its other keys are merged over it",
)
_FILE_KEYS = {
    "extends": "the scenario that this one changes: a path, or the name of a shipped one",
    "remove": "paths to remove from the extended scenario, such as `[observation.tip_speed]`",
}
_VERSION_LINE = Choice(f"deepbots: {VERSION}", CompletionItemKind.Keyword, "the first line of a scenario")
_SUFFIXES = {"robot file": (".urdf",), "mesh file": MESH_SUFFIXES, "picture": (".png",)}
_MAX_FILES = 300
_CODES = re.compile(r"deepbots:[ \t]*ignore\[(?:[^\]]*,)?[ \t]*([A-Za-z0-9]*)$")
_COLON = re.compile(r"[\w]*[ \t]*:")


def completion(view: CursorView) -> CompletionList:
    """Return all completions at the cursor; the client filters them by the text before the cursor.

    The list is marked as incomplete until the current text is analyzed, so that the client repeats the
    request at the next letter.
    """
    cursor = view.cursor
    if view.document.is_blank:
        items = (
            []
            if cursor.role == "aside"
            else [_item(view, _VERSION_LINE, cursor.start, f"{_VERSION_LINE.text}\n")]
        )
    elif cursor.role == "aside":
        items = _codes(view)
    elif cursor.role == "key":
        items = [*_keys(view), *(_values(view) if cursor.path else ())]
    else:
        items = list(_values(view))
    for index, item in enumerate(items):  # otherwise clients sort alphabetically
        item.sort_text = f"{index:04}"
    return CompletionList(is_incomplete=not view.is_settled, items=items)


# Keys


def _keys(view: CursorView) -> Iterator[CompletionItem]:
    cursor, data = view.cursor, view.data
    present = view.keys
    colon = "" if _COLON.match(view.document.plain, view.offset) else ": "
    for choice in unique(_key_choices(view, data)):
        if choice.text not in present:
            yield _item(view, choice, cursor.start, choice.text + colon)


def _key_choices(view: CursorView, data: Any) -> Iterator[Choice]:
    path = view.cursor.path
    for shape in shapes_at(path, data):
        match shape:
            case Kinds():
                yield from _kind_keys(shape, value_at(data, path))
                yield _INCLUDE
            case MappingOf(key=key):
                yield from _named(view, key, path)
            case type():
                yield from _section_keys(shape)
                yield _INCLUDE
    if not path:
        yield from (Choice(word, CompletionItemKind.Keyword, doc) for word, doc in _FILE_KEYS.items())


def _section_keys(section: type[Section]) -> Iterator[Choice]:
    for key in section_fields(section):
        yield Choice(key, CompletionItemKind.Property, summary(section, key), describe_key(section, key))


def _kind_keys(shape: Kinds, data: Any) -> Iterator[Choice]:
    section = shape.find(data)
    if section is not None:
        yield from _section_keys(section)
        return
    yield Choice(shape.key, CompletionItemKind.Property, f"one of {', '.join(shape.names)}")
    for key, model in shape.models_by_key.items():
        yield Choice(key, CompletionItemKind.Property, summary(model, key), describe_key(model, key))


# Values


def _values(view: CursorView) -> Iterator[CompletionItem]:
    cursor, data = view.cursor, view.data
    words = list(_word_choices(view, data))
    # The example is a whole value; among the entries of a mapping, it would be an error.
    if not words and not (cursor.role == "key" and view.keys):
        words = [*_example(view, data)]
    yield from (_item(view, choice, cursor.start) for choice in unique(words))
    for shape in shapes_at(cursor.path, data):
        if isinstance(shape, FieldType) and is_expression(shape):
            start = view.offset - len(word_before(cursor.text))
            is_called = view.document.plain.startswith("(", view.offset)
            for choice in unique(expression_choices(view, shape)):
                yield _item(view, choice, start, choice.text.removesuffix("(") if is_called else None)
            return


def _example(view: CursorView, data: Any) -> Iterator[Choice]:
    """Yield the documented example of the key at the cursor, for values without a vocabulary."""
    path = view.cursor.path
    section = section_of(path, data) if not view.cursor.text.strip() else None
    example = example_of(section, str(path[-1])) if section is not None else None
    if example is not None and "\n" not in example.text:
        yield Choice(example.text, CompletionItemKind.Value, "an example")


def _word_choices(view: CursorView, data: Any) -> Iterator[Choice]:
    path = view.cursor.path
    for shape in shapes_at(path[:-1], data) if path else ():
        if isinstance(shape, Kinds) and shape.key == path[-1]:
            yield from (
                Choice(
                    word, CompletionItemKind.EnumMember, shape.key, section_description(shape.models[word])
                )
                for word in shape.names
            )
    if path and path[-1] in ("include", "extends"):
        yield from _files(view, (".yaml", ".yml"), shipped.SCENARIOS if path[-1] == "extends" else None)
    for shape in shapes_at(path, data):
        if isinstance(shape, FieldType):
            yield from _field_choices(view, shape, path)


def _field_choices(view: CursorView, field: FieldType, path: NodePath) -> Iterator[Choice]:
    match field:
        case Word(words=words):
            yield from _words(words, "a word of the language")
        case Flag():
            yield from _words(("true", "false"), "a switch")
        case ColorValue():
            yield from (Choice(word, CompletionItemKind.Color, "a color") for word in COLORS)
        case Reference() | Pattern():
            yield from _named(view, field, path)
        case FilePath(kind=kind):
            yield from _files(view, _SUFFIXES.get(kind, ()), shipped.ROBOTS if kind == "robot file" else None)
        case Range(auto=True):
            yield Choice("auto", CompletionItemKind.Keyword, "the known range")
        case Quantity(words=words, urdf=urdf):
            yield from _words((*words, *(("urdf",) if urdf else ())), "a word of the language")
        case FieldType(example=str() as example) if not is_expression(field):
            yield Choice(example, CompletionItemKind.Value, describe_shape(field))


def _words(words: Iterable[str], detail: str) -> Iterator[Choice]:
    return (Choice(word, CompletionItemKind.EnumMember, detail) for word in words)


def _named(view: CursorView, field: FieldType, path: NodePath) -> Iterator[Choice]:
    """Yield the names that a reference may take."""
    if isinstance(field, (Reference, Pattern)):
        entries = names_at(view.checked, field.kind, path) if view.checked is not None else ()
        yield from (Choice(entry.name, CompletionItemKind.Reference, entry.description) for entry in entries)
        yield from (
            Choice(name, CompletionItemKind.Reference, field.kind)
            for name in names_in_text(field.kind, path, view.data)
        )


def _files(
    view: CursorView, suffixes: tuple[str, ...], library: shipped.Library | None = None
) -> Iterator[Choice]:
    """Yield the files and folders that may continue the path at the cursor."""
    folder, slash, _ = view.cursor.text.rpartition("/")
    if library and not slash:
        yield from (
            Choice(name, CompletionItemKind.Module, f"a {library.noun} that comes with deepbots")
            for name in library.names()
        )
    try:
        root = (view.document.path.parent / f"{folder}{slash}".replace("\0", "")).resolve()
        paths = (
            sorted(root.iterdir())[:_MAX_FILES]
            if any(root.is_relative_to(allowed) for allowed in view.roots)
            else []
        )
    except (OSError, RuntimeError, ValueError):
        return
    for path in paths:
        name = f"{folder}{slash}{path.name}"
        if path.suffix in suffixes and path != view.document.path:
            yield Choice(name, CompletionItemKind.File, "a file")
        elif path.is_dir() and not path.name.startswith("."):
            yield Choice(f"{name}/", CompletionItemKind.Folder, "a folder")


# Comments


def _codes(view: CursorView) -> list[CompletionItem]:
    """Return the warnings that a comment may suppress."""
    match = _CODES.search(view.document.plain[max(0, view.offset - 200) : view.offset])
    if match is None:
        return []
    warnings = (rule for rule in RULES.values() if rule.severity == "warning" and rule.family != "linting")
    start = view.offset - len(match[1])
    return [
        _item(view, Choice(rule.code, CompletionItemKind.Value, rule.name, rule.summary), start)
        for rule in warnings
    ]


# Items


def _item(view: CursorView, choice: Choice, start: int, text: str | None = None) -> CompletionItem:
    before = view.document.plain[: view.offset]
    # The protocol requires an edit on one line.
    start = max(start, len(before) - len(before.rpartition("\n")[2].lstrip()))
    span = view.document.lines.range(start, view.offset)
    return CompletionItem(
        label=choice.text,
        kind=choice.kind,
        detail=choice.detail or None,
        documentation=MarkupContent(MarkupKind.Markdown, choice.doc) if choice.doc else None,
        text_edit=TextEdit(span, text or choice.text),
        filter_text=choice.text,
    )
