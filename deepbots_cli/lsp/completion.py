"""Completion in keys, values, and texts of the expression language.

The schema gives keys and words by the path of the cursor. Names come from the last analysis that resolved
them.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

from lsprotocol.types import (
    CompletionItem,
    CompletionItemKind,
    CompletionList,
    MarkupContent,
    MarkupKind,
    TextEdit,
)

from deepbots_cli.compiler.inventory import definition, names_at, namespace_at
from deepbots_cli.compiler.namespace import ParameterScope, RobotScope, ScenarioScope, SupervisorScope
from deepbots_cli.diagnostics.registry import RULES
from deepbots_cli.document import shipped
from deepbots_cli.document.nodes import NodePath
from deepbots_cli.expressions import parser, syntax
from deepbots_cli.expressions.check import check
from deepbots_cli.expressions.dimensions import UNITS, Unit
from deepbots_cli.expressions.functions import ALLOWED_FAMILIES, FUNCTIONS, Family, Form, Param
from deepbots_cli.expressions.types import Context, Kind, Scope, ValueType
from deepbots_cli.lsp.cursor import section_of, shapes_at, value_at
from deepbots_cli.lsp.hover import (
    describe_function,
    describe_key,
    describe_shape,
    describe_symbol,
    ignore_finding,
    summary,
)
from deepbots_cli.lsp.workspace import CursorView, DocumentAnalysis
from deepbots_cli.robots.meshes import MESH_SUFFIXES
from deepbots_cli.scenario.base import Kinds, MappingOf, Section, section_fields
from deepbots_cli.scenario.documentation import example_of, section_description
from deepbots_cli.scenario.fields import (
    COLORS,
    REFERENCE_KINDS,
    ColorValue,
    FieldType,
    FilePath,
    Flag,
    Pattern,
    Reference,
    Word,
)
from deepbots_cli.scenario.quantities import MEASURES, Column, Expression, Quantity, Range
from deepbots_cli.scenario.scenario import VERSION

_WORD = re.compile(r"[A-Za-z_][\w.]*$")
_AFTER_NUMBER = re.compile(
    r"(?<![A-Za-z_\d])(?:\d[\d_]*\.?\d*|\.\d+)(?:[eE][+-]?\d+)?(?:\s+|\s*(?:[A-Za-z%]+(?:\^-?\d)?[*/])+)?$"
)
_GRAMMAR = {
    "when": "`a when c`: a if the condition is true, otherwise 0",
    "if": "`a if c else b`: a if the condition is true, otherwise b",
    "else": "`a if c else b`: a if the condition is true, otherwise b",
    "and": "both conditions are true",
    "or": "at least one condition is true",
    "not": "the condition is false",
    "true": "always true",
    "false": "never true",
}
_REPEATS = {
    "every": "draws again after this time: `uniform(0 .. 1) every 5 s`",
    "each step": "draws again in each step",
}
_CONTEXTS = {"field": Context.FIXED, "require": Context.REQUIRE, "parameter": Context.PARAMETER}
_MAX_NAMES = 1000
_MAX_LOOKBACK = 2000
"""The number of characters before the cursor that are searched for an open bracket."""


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


def is_expression(field: FieldType) -> bool:
    """Return whether a value of this type is a text of the expression language."""
    return isinstance(field, (Expression, Quantity, Range, Column))


def expression_choices(view: CursorView, field: FieldType) -> Iterator[Choice]:
    """Yield the choices that may come next in an expression."""
    path, text = view.cursor.path, view.cursor.text
    if _expects_unit(text):
        yield from _units(text, field)
        return
    scope = _scope_of(view.analysis, field, path) if view.analysis else None
    if scope is not None and view.checked is not None:
        choices = _choices_in_scope(text, scope)
        yield from (choice for choice in choices if not defines(path, choice.text))
    else:
        yield from functions(frozenset(Family))


def word_before(text: str) -> str:
    """Return the name at the end of the text, up to the cursor."""
    match = _WORD.search(text)
    return match.group() if match else ""


def functions(families: frozenset[Family]) -> Iterator[Choice]:
    """Yield the functions of these families."""
    for function in FUNCTIONS.values():
        if function.family in families:
            yield Choice(
                f"{function.name}(",
                CompletionItemKind.Function,
                function.signature,
                describe_function(function),
            )


# What the text before the cursor expects


def _expects_unit(text: str) -> bool:
    """Return whether `text` ends in a number, or in a unit followed by `*` or `/`."""
    word = word_before(text)
    return "." not in word and _AFTER_NUMBER.search(text[: len(text) - len(word)]) is not None


def _expected_parts(before: str) -> frozenset[Kind] | None:
    """Return the kinds of parts that the argument at the end of the text may name; None for a value or
    outside of a call."""
    called = _open_call(before)
    if called is None:
        return None
    name, index = called
    function = FUNCTIONS.get(name)
    params: tuple[Param, ...] = function.params if function is not None else ()
    if not params or (function is not None and function.family is Family.DRAW):
        return None
    param = params[min(index, len(params) - 1)]
    return (
        param.kinds
        if param.form is Form.SUBJECT and not before.rstrip().endswith(("+", "-", "*", "/"))
        else None
    )


def _open_call(before: str) -> tuple[str, int] | None:
    """Return the innermost open call at the end of the text: its function and the index of the argument."""
    depth = commas = 0
    for index in range(len(before) - 1, max(-1, len(before) - _MAX_LOOKBACK), -1):
        sign = before[index]
        if sign == ")":
            depth += 1
        elif sign == "," and depth == 0:
            commas += 1
        elif sign == "(" and depth:
            depth -= 1
        elif sign == "(":
            match = _WORD.search(before[:index])
            return (match.group(), commas) if match else None
    return None


def _scope_of(analysis: DocumentAnalysis, field: FieldType, path: NodePath) -> ScenarioScope | None:
    """Return the scope of an expression at `path` in a field of this type."""
    namespace = namespace_at(analysis.checked, path) if analysis.checked is not None else None
    if namespace is None:
        return None
    if not isinstance(field, Expression):
        may_vary = isinstance(field, Quantity) and field.known != "fixed"
        return ParameterScope(namespace, Context.FIELD if may_vary else Context.FIXED)
    if field.context in _CONTEXTS:
        return ParameterScope(namespace, _CONTEXTS[field.context])
    context = Context[field.context.upper()]
    if field.context not in ("emit", "apply"):
        return SupervisorScope(namespace, context)
    robot = str(path[1]) if len(path) > 1 else ""
    scopes = [
        reading.scope
        for reading in analysis.readings
        if isinstance(reading.scope, RobotScope) and reading.scope.robot == robot
    ]
    same = next((scope for scope in scopes if scope.context is context), scopes[0] if scopes else None)
    return RobotScope(namespace, context, robot, dict(same.symbols) if same else {})


# Units


def _units(text: str, field: FieldType) -> Iterator[Choice]:
    """Yield the units that may follow a number; those of the field come first."""
    # After `*` or `/`, only single units follow, not `N*m`.
    goes_on = text[: len(text) - len(word_before(text))].endswith(("*", "/"))
    units = [unit for measure in _measures(field) if (unit := _unit(measure)) is not None]
    if not goes_on:
        yield from (
            Choice(unit.text, CompletionItemKind.Unit, unit.dimension.description)
            for unit in units
            if unit.text not in UNITS
        )
    dimensions = [unit.dimension for unit in units]
    for unit in sorted(UNITS.values(), key=lambda unit: unit.dimension not in dimensions):
        yield Choice(unit.text, CompletionItemKind.Unit, unit.dimension.description)
    if isinstance(field, Expression) and not goes_on:
        yield from (
            Choice(word, CompletionItemKind.Keyword, "", _GRAMMAR[word]) for word in ("when", "and", "or")
        )


def _measures(field: FieldType) -> list[str]:
    if not isinstance(field, (Quantity, Range, Column)):
        return []
    return [
        measure
        for measure in (field.measure, *field.measure.split(" or "))
        if measure in MEASURES and measure != "any"
    ]


def _unit(measure: str) -> Unit | None:
    tree = parser.parse(MEASURES[measure][1], ignore_finding)
    return tree.unit if isinstance(tree, syntax.Number) else None


# Names


def _choices_in_scope(text: str, scope: ScenarioScope) -> Iterator[Choice]:
    """Yield the choices that may replace the name at the end of `text`, except units."""
    word = word_before(text)
    before = text[: len(text) - len(word)]
    kinds = _expected_parts(before)
    if kinds is not None:
        yield from _parts(scope, kinds)
        return
    if before.endswith(")."):
        yield from _components_of_call(before[:-1], scope)
        return
    if "." in word:
        yield from _components(word.rpartition(".")[0], scope)
    yield from _names(scope)
    yield from functions(ALLOWED_FAMILIES[scope.context])
    for word, doc in {**_GRAMMAR, **(_REPEATS if scope.context is Context.PARAMETER else {})}.items():
        yield Choice(word, CompletionItemKind.Keyword, "", doc)


def _names(scope: ScenarioScope) -> Iterator[Choice]:
    for name in list(dict.fromkeys(scope.names()))[:_MAX_NAMES]:
        symbol = scope.lookup(name)
        if symbol is not None and symbol.refusal is None:
            entry = definition(scope, name)
            yield Choice(
                name,
                CompletionItemKind.Variable,
                describe_symbol(symbol),
                entry.description if entry else "built in",
            )


def _parts(scope: Scope, kinds: frozenset[Kind]) -> Iterator[Choice]:
    for name in list(dict.fromkeys((*scope.subjects(), "ground")))[:_MAX_NAMES]:
        subject = scope.subject(name, kinds)
        if subject is not None and subject.kind in kinds:
            yield Choice(name, CompletionItemKind.Reference, subject.kind.description)


def _components(name: str, scope: Scope) -> Iterator[Choice]:
    """Return the components of a named vector, such as `name.x`."""
    symbol = scope.lookup(name)
    return _component_choices(symbol.type if symbol else None, f"{name}.")


def _components_of_call(text: str, scope: Scope) -> Iterator[Choice]:
    """Return the components of the vector that the call at the end of the text returns, such as `x`."""
    depth = 0
    for index in range(len(text) - 1, max(-1, len(text) - _MAX_LOOKBACK), -1):
        depth += {")": 1, "(": -1}.get(text[index], 0)
        if depth == 0:
            break
    begin = index - len(word_before(text[:index]))
    tree = parser.parse(text[begin:], ignore_finding)
    typed = check(tree, scope, ignore_finding) if tree is not None else None
    return _component_choices(typed.type if typed else None, "")


def _component_choices(vector: ValueType | None, before: str) -> Iterator[Choice]:
    """Yield each component of a vector, and `xy` for a vector in space."""
    components = (vector and vector.components) or ()
    for picked in (*components, *(("xy",) if components == ("x", "y", "z") else ())):
        words = vector._replace(components=None).description if vector else ""
        yield Choice(f"{before}{picked}", CompletionItemKind.Field, words)


def defines(path: NodePath, name: str) -> bool:
    """Return whether `path` is the definition of the name, which cannot refer to itself."""
    return path[:-1] in REFERENCE_KINDS["value"].sections and path[-1] == name


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
_SUFFIXES = {"robot file": (".urdf", ".xacro"), "mesh file": MESH_SUFFIXES, "picture": (".png",)}
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
    return (_key(section, key) for key in section_fields(section))


def _key(section: type[Section], key: str) -> Choice:
    return Choice(key, CompletionItemKind.Property, summary(section, key), describe_key(section, key))


def _kind_keys(shape: Kinds, data: Any) -> Iterator[Choice]:
    section = shape.find(data)
    if section is not None:
        yield from _section_keys(section)
        return
    yield Choice(shape.key, CompletionItemKind.Property, f"one of {', '.join(shape.names)}")
    yield from (_key(model, key) for key, model in shape.models_by_key.items())


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
    if isinstance(field, (Reference, Pattern)) and view.checked is not None:
        entries = names_at(view.checked, field.kind, path, is_pattern=isinstance(field, Pattern))
        yield from (Choice(entry.name, CompletionItemKind.Reference, entry.description) for entry in entries)


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
