"""The outline of a document: its keys, as far down as they have names that people look for."""

from __future__ import annotations

from collections.abc import Iterator

from lsprotocol import types

from deepbots_cli.document import Entry, Mapping
from deepbots_cli.lsp.documents import Document

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
"""What the names in a section are."""


def outline(document: Document) -> list[types.DocumentSymbol]:
    """The keys of a document that can be parsed, in the order of the file; nothing for any other."""
    _, root, _ = document.read()
    return list(_symbols(document, root, "", _DEPTH)) if isinstance(root, Mapping) else []


def _symbols(document: Document, mapping: Mapping, section: str, depth: int) -> Iterator[types.DocumentSymbol]:
    for name, entry in mapping.entries.items():
        inner = entry.value
        is_here = isinstance(inner, Mapping) and inner.span.start >= entry.key.span.start  # that of an alias stands elsewhere
        below = list(_symbols(document, inner, name, depth - 1)) if isinstance(inner, Mapping) and is_here and depth > 1 else []
        kind = types.SymbolKind.Namespace if below else types.SymbolKind.Property
        yield _symbol(document, entry, _SECTIONS.get(section, kind), below)


def _symbol(document: Document, entry: Entry, kind: types.SymbolKind, below: list[types.DocumentSymbol]) -> types.DocumentSymbol:
    key = entry.key.span
    end = max(key.end, entry.value.span.end if entry.value.span.start >= key.start else key.end)
    whole = document.lines.range(key.start, end)
    return types.DocumentSymbol(entry.key.text, kind, whole, document.lines.range(key.start, key.end), children=below or None)
