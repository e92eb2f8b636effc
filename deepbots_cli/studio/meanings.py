"""What a word of a scenario's text means: its description, where it is defined, and what uses it.

The functions are those of the language server.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

from lsprotocol import types

from deepbots_cli.insight.suggestions import properties
from deepbots_cli.lsp.hover import hover
from deepbots_cli.lsp.lookup import definitions, document_symbols
from deepbots_cli.lsp.uses import references
from deepbots_cli.lsp.workspace import CursorView, Document

_WORD = re.compile(r"[^\W_]+")
_MAX_USES = 12


@dataclass(frozen=True)
class Meaning:
    """What the word at a place means.

    Attributes:
        word: The word.
        text: The hover text (Markdown); empty without one.
        definitions, uses: Places as Markdown, with links to the lines of the same file; without the place of
            the word itself.
    """

    word: str
    text: str = ""
    definitions: tuple[str, ...] = ()
    uses: tuple[str, ...] = ()

    def markdown(self) -> str:
        """Return the meaning as Markdown; empty if nothing is known about the word."""
        parts = [self.text] if self.text else []
        if self.definitions:
            parts.append(f"Defined in {', '.join(self.definitions)}.")
        if self.uses:
            parts.append("Used in:")
            parts.append("\n".join(f"- {use}" for use in self.uses))
        return "\n\n".join(parts)


def meaning(view: CursorView, word: str) -> Meaning:
    """Return what the word at a place means."""
    shown = hover(view)
    text = shown.contents.value if shown is not None and hasattr(shown.contents, "value") else ""
    if view.analysis is None:
        return Meaning(word, text)
    line_of_word = view.document.lines.range(view.offset, view.offset).start.line

    def lines_of(places: list[types.Location]) -> list[int]:
        lines = {place.range.start.line: None for place in places if place.uri == view.document.uri}
        return [line for line in lines if line != line_of_word]

    texts = view.document.plain.split("\n")
    uses = [(line, texts[line]) for line in lines_of(references(view, {}))]
    return Meaning(
        word,
        text,
        tuple(map(_link, lines_of(definitions(view, {})))),
        tuple(_link(line, text) for line, text in uses[:_MAX_USES]),
    )


def names_like(document: Document, phrase: str) -> list[tuple[str, int]]:
    """Return the names of a text that have a word of a phrase, with the line of each, from 0; first those
    with the most words of it."""
    words = {word.lower() for word in _WORD.findall(phrase) if len(word) > 2} | properties(phrase)
    names: dict[str, int] = {}

    def read(symbols: Iterable[object]) -> None:
        for symbol in symbols:
            name = str(getattr(symbol, "name", ""))
            if words & set(_WORD.findall(name.lower())):
                names.setdefault(name, symbol.selection_range.start.line)  # type: ignore[attr-defined]
            read(getattr(symbol, "children", None) or ())

    read(document_symbols(document))
    common = {name: len(words & set(_WORD.findall(name.lower()))) for name in names}
    return sorted(names.items(), key=lambda item: -common[item[0]])


def line_link(line: int) -> str:
    """Return a link to a line (from 0) of the shown file."""
    return f"[line {line + 1}](#line:{line + 1})"


def _link(line: int, text: str = "") -> str:
    quoted = text.strip().replace("`", "'")
    return f"{line_link(line)}: `{quoted}`" if quoted else line_link(line)
