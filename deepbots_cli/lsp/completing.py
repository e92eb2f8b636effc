"""Completion: what may be written at a place, though the document may be broken there at the moment.

What the language takes there is asked by the path of the place, and names come from the last analysis that was sound,
and from what was written since.
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
    Range,
    TextEdit,
)

from deepbots_cli.compiler.inventory import names
from deepbots_cli.diagnostics.registry import RULES
from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions.functions import Family
from deepbots_cli.lsp.asking import at, key_of, specs
from deepbots_cli.lsp.describing import brief, of_kind
from deepbots_cli.lsp.desk import View
from deepbots_cli.lsp.expressing import BODY, Choice, awaited, awaits_unit, begun, choices, functions, is_expression, scope_of, units
from deepbots_cli.lsp.files import files
from deepbots_cli.lsp.written import defines, written
from deepbots_cli.scenario.base import Kinds, MappingOf, Section, fields
from deepbots_cli.scenario.docs import about_kind, example_of
from deepbots_cli.scenario.docs import hover as hover_text
from deepbots_cli.scenario.fields import COLOURS, Color, FieldType, FilePath, Flag, Pattern, Quantity, Reference, Word
from deepbots_cli.scenario.fields import Range as RangeLeaf
from deepbots_cli.scenario.scenario import VERSION

_INCLUDE = Choice("include", CompletionItemKind.Keyword, "a file with the value of this mapping; what stands beside it is merged over it")
_OF_FILES = {
    "extends": "another scenario that this one changes",
    "remove": "paths to take out of the extended scenario, such as `[observation.tip_speed]`",
}
_FIRST = Choice(f"deepbots: {VERSION}", CompletionItemKind.Keyword, "the first line of a scenario")
_CODES = re.compile(r"deepbots:[ \t]*ignore\[(?:[^\]]*,)?[ \t]*([A-Za-z0-9]*)$")
_COLON = re.compile(r"[\w]*[ \t]*:")


def completion(view: View) -> CompletionList:
    """Everything that may be written at the place; the client filters by what is there already.

    While the newest text has not been looked at, the list is incomplete: the client asks again at the next letter.
    """
    place = view.place
    if view.document.is_blank:
        items = [] if place.role == "aside" else [_item(view, _FIRST, place.start, f"{_FIRST.text}\n")]
    elif place.role == "aside":
        items = _codes(view)
    elif place.role == "key":
        items = [*_keys(view), *(_values(view) if place.path else ())]
    else:
        items = list(_values(view))
    for index, item in enumerate(items):  # clients sort by the alphabet otherwise
        item.sort_text = f"{index:04}"
    return CompletionList(is_incomplete=not view.is_settled, items=items)


# Keys


def _keys(view: View) -> Iterator[CompletionItem]:
    place, data = view.place, view.data
    given = view.keys
    colon = "" if _COLON.match(view.document.plain, view.offset) else ": "
    for choice in _unique(_key_choices(view, data)):
        if choice.text not in given:
            yield _item(view, choice, place.start, choice.text + colon)


def _key_choices(view: View, data: Any) -> Iterator[Choice]:
    path = view.place.path
    for spec in specs(path, data):
        match spec:
            case Kinds():
                yield from _kind_keys(spec, at(data, path))
                yield _INCLUDE
            case MappingOf(key=key):
                yield from _named(view, key, path)
            case type():
                yield from _part_keys(spec)
                yield _INCLUDE
    if not path:
        yield from (Choice(word, CompletionItemKind.Keyword, doc) for word, doc in _OF_FILES.items())


def _part_keys(part: type[Section]) -> Iterator[Choice]:
    for key in fields(part):
        yield Choice(key, CompletionItemKind.Property, brief(part, key), hover_text(part, key))


def _kind_keys(spec: Kinds, data: Any) -> Iterator[Choice]:
    found = spec.find(data)
    if found is not None:
        yield from _part_keys(found)
        return
    yield Choice(spec.key, CompletionItemKind.Property, f"one of {', '.join(spec.names)}")
    for mark, model in spec.marked.items():
        yield Choice(mark, CompletionItemKind.Property, brief(model, mark), hover_text(model, mark))


# Values


def _values(view: View) -> Iterator[CompletionItem]:
    place, data = view.place, view.data
    words = list(_word_choices(view, data)) or [*_example(view, data)]
    yield from (_item(view, choice, place.start) for choice in _unique(words))
    for spec in specs(place.path, data):
        if isinstance(spec, FieldType) and is_expression(spec):
            start, is_called = view.offset - len(begun(place.text)), view.document.plain.startswith("(", view.offset)
            for choice in _unique(_in_expression(view, spec, data)):
                yield _item(view, choice, start, choice.text.removesuffix("(") if is_called else None)
            return


def _in_expression(view: View, leaf: FieldType, data: Any) -> Iterator[Choice]:
    """What may come next in an expression; names that no analysis knows yet come as they are written."""
    path, text = view.place.path, view.place.text
    if awaits_unit(text):
        yield from units(text, leaf)
        return
    scope = scope_of(view.analysis, leaf, path) if view.analysis else None
    if scope is not None and view.analysis is not None and view.analysis.checked is not None:
        known = choices(text, scope, view.analysis.checked)
        yield from (choice for choice in known if not defines(path, choice.text))
    kind = awaited(text, leaf)
    for name in written(kind, path, data):
        if scope is None or (scope.lookup(name) is None and scope.subject(name) is None):
            yield Choice(name, CompletionItemKind.Variable, "")
    if scope is None and kind != BODY:
        yield from functions(frozenset(Family))


def _example(view: View, data: Any) -> Iterator[Choice]:
    """The example of the key whose value is due, where the language has no words for it."""
    path = view.place.path
    part = key_of(path, data) if not view.place.text.strip() else None
    found = example_of(part, str(path[-1])) if part is not None else None
    if found is not None and "\n" not in found.text:
        yield Choice(found.text, CompletionItemKind.Value, "an example")


def _word_choices(view: View, data: Any) -> Iterator[Choice]:
    path = view.place.path
    for spec in specs(path[:-1], data) if path else ():
        if isinstance(spec, Kinds) and spec.key == path[-1]:
            yield from (Choice(word, CompletionItemKind.EnumMember, spec.key, about_kind(spec, word)) for word in spec.names)
    if path and path[-1] in ("include", "extends"):
        yield from files(view, (".yaml", ".yml"))
    for spec in specs(path, data):
        if isinstance(spec, FieldType):
            yield from _of_leaf(view, spec, path)


def _of_leaf(view: View, leaf: FieldType, path: Path) -> Iterator[Choice]:
    match leaf:
        case Word(words=words):
            yield from _words(words, "a word of the language")
        case Flag():
            yield from _words(("true", "false"), "a switch")
        case Color():
            yield from (Choice(word, CompletionItemKind.Color, "a colour") for word in COLOURS)
        case Reference() | Pattern():
            yield from _named(view, leaf, path)
        case FilePath(kind=kind):
            yield from files(view, _SUFFIXES.get(kind, ()), robots=kind == "robot file")
        case RangeLeaf(auto=True):
            yield Choice("auto", CompletionItemKind.Keyword, "the range that is known")
        case Quantity(words=words, urdf=urdf):
            yield from _words((*words, *(("urdf",) if urdf else ())), "a word of the language")
        case FieldType(example=str() as example) if not is_expression(leaf):
            yield Choice(example, CompletionItemKind.Value, of_kind(leaf))


_SUFFIXES = {"robot file": (".urdf",), "mesh file": (".obj", ".stl", ".dae"), "picture": (".png",)}


def _words(words: Iterable[str], detail: str) -> Iterator[Choice]:
    return (Choice(word, CompletionItemKind.EnumMember, detail) for word in words)


def _named(view: View, leaf: FieldType, path: Path) -> Iterator[Choice]:
    """The names that a reference may mean."""
    checked = view.analysis.checked if view.analysis else None
    if isinstance(leaf, (Reference, Pattern)):
        known = names(checked, leaf.kind, path) if checked is not None else ()
        yield from (Choice(found.name, CompletionItemKind.Reference, found.what) for found in known)
        yield from (Choice(name, CompletionItemKind.Reference, leaf.kind) for name in written(leaf.kind, path, view.data))


# Comments


def _codes(view: View) -> list[CompletionItem]:
    """The warnings that a comment may suppress."""
    found = _CODES.search(view.document.plain[max(0, view.offset - 200) : view.offset])
    if found is None:
        return []
    warnings = (rule for rule in RULES.values() if rule.severity == "warning" and rule.family != "linting")
    start = view.offset - len(found[1])
    return [_item(view, Choice(rule.code, CompletionItemKind.Value, rule.name, rule.summary), start) for rule in warnings]


# Items


def _unique(found: Iterable[Choice]) -> Iterable[Choice]:
    first: dict[str, Choice] = {}
    for choice in found:
        first.setdefault(choice.text, choice)
    return first.values()


def _item(view: View, choice: Choice, start: int, text: str | None = None) -> CompletionItem:
    lines, before = view.document.lines, view.document.plain[: view.offset]
    start = max(start, len(before) - len(before.rpartition("\n")[2].lstrip()))  # an edit may not go beyond the line
    span = Range(lines.position(start), lines.position(view.offset))
    return CompletionItem(
        label=choice.text,
        kind=choice.kind,
        detail=choice.detail or None,
        documentation=MarkupContent(MarkupKind.Markdown, choice.doc) if choice.doc else None,
        text_edit=TextEdit(span, text or choice.text),
        filter_text=choice.text,
    )
