"""Go to definition (of names, references, aliases and file paths), and document symbols."""

from __future__ import annotations

import re
from collections.abc import Iterator
from fnmatch import fnmatchcase
from pathlib import Path

from lsprotocol import types

from deepbots_cli.compiler.inventory import definition, names
from deepbots_cli.diagnostics import Span
from deepbots_cli.document import Entry, Mapping, descend, shipped
from deepbots_cli.document.files import resolve
from deepbots_cli.document.nodes import follow
from deepbots_cli.lsp.diagnostics import Locator
from deepbots_cli.lsp.lookup import KeyOrValue, expression_at, field_types_at, key_or_value_at, shapes_at
from deepbots_cli.lsp.workspace import Document, View, uri_of
from deepbots_cli.robots import meshes
from deepbots_cli.scenario.base import MappingOf
from deepbots_cli.scenario.fields import FieldType, FilePath, Pattern, Reference

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
