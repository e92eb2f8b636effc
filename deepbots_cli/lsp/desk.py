"""What is open, and what is known of it: requests are answered from here, and never wait for an analysis."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from lsprotocol import types

from deepbots_cli.diagnostics import Source, Span
from deepbots_cli.document import Mapping, Path, descend
from deepbots_cli.document.load import Drafts
from deepbots_cli.document.nodes import Node
from deepbots_cli.lsp.analysing import Analysis
from deepbots_cli.lsp.asking import at
from deepbots_cli.lsp.cursor import Place, place
from deepbots_cli.lsp.documents import Document


@dataclass(frozen=True, eq=False)
class View:
    """A place in a document as it is now, and the last analysis in which names had a meaning, if there is one.

    `source` is the document as it was then, and `then` where the place stood in it; None for what was written since.
    `is_settled` says that an analysis of just this text is known, so that an answer would be the same a moment later.
    """

    document: Document
    offset: int
    analysis: Analysis | None
    source: Source | None
    then: int | None
    is_settled: bool

    @cached_property
    def place(self) -> Place:
        """What is being written there; its path is that in the scenario."""
        return self.placed(self.offset)

    def placed(self, offset: int) -> Place:
        found = place(self.document.plain, offset)
        return found._replace(path=(*self._above, *found.path), data=_below(found.data, self._above))

    @property
    def data(self) -> Any:
        """The scenario as plain values: as it is known, and upon that what stands before the place."""
        return _laid(self.analysis.data, self.place.data) if self.analysis else self.place.data

    @property
    def keys(self) -> set[str]:
        """The keys beside the one that is being written, which stand in this document."""
        before = at(self.place.data, self.place.path)
        given = set(before) if isinstance(before, dict) else set()
        if self.analysis is not None and self.analysis.checked is not None and self.analysis.checked.document.root is not None:
            node, _, steps = descend(self.analysis.checked.document.root, self.place.path)
            if steps == len(self.place.path) and isinstance(node, Mapping):
                given |= {name for name, entry in node.entries.items() if self._is_elsewhere(entry.key.span)}
        return given

    def _is_elsewhere(self, span: Span) -> bool:
        """Whether what the analysis saw there still stands in this document, and the cursor is not in it."""
        if span.source is not self.source:
            return False
        now = self.document.plain
        end = _moved(span.end, span.source.text, now)
        start = (end or 0) - len(span.text)
        return end is not None and now[max(0, start) : end] == span.text and not start <= self.offset <= end

    @cached_property
    def _above(self) -> Path:
        """Where in the scenario a piece of it belongs."""
        if self.document.is_scenario or self.analysis is None or self.source is None or self.analysis.checked is None:
            return ()
        return _path_above(self.analysis.checked.document.root, self.source)


class Desk:
    """The open documents by their addresses, the last analysis of each, and the last one that was sound."""

    def __init__(self) -> None:
        self.documents: dict[str, Document] = {}
        self.latest: dict[str, Analysis] = {}
        self._sound: dict[str, Analysis] = {}

    def put(self, document: Document) -> None:
        self.documents[document.uri] = document

    def drop(self, uri: str) -> None:
        for table in (self.documents, self.latest, self._sound):
            table.pop(uri, None)

    def learn(self, analysis: Analysis) -> None:
        """Keep what an analysis found, as long as its document is open."""
        uri = analysis.document.uri
        if uri in self.documents:
            self.latest[uri] = analysis
            before = self._sound.get(uri)
            if analysis.is_sound and (analysis.is_whole or before is None or not before.is_whole):
                self._sound[uri] = analysis

    @property
    def drafts(self) -> Drafts:
        return {document.path: document.bytes for document in self.documents.values()}

    @property
    def open_uris(self) -> dict[str, str]:
        """How the client calls each open file."""
        return {str(document.path): uri for uri, document in self.documents.items()}

    def ours(self, uri: str) -> Document | None:
        """The open document of an address, if it is a scenario, a piece of one, or still empty; an editor shows us all of its YAML."""
        document = self.documents.get(uri)
        if document is None or document.is_scenario or document.is_blank:
            return document
        known = (*self.latest.values(), *self._sound.values())
        return document if any(one.checked and document.path in one.checked.document.files for one in known) else None

    def readers(self, document: Document) -> list[str]:
        """The addresses of the other open documents that read this one."""
        return [uri for uri, known in self.latest.items() if uri != document.uri and document.path in known.paths.values()]

    def current(self, document: Document) -> Iterable[tuple[Analysis, Source]]:
        """The analyses that have read just this version of the document."""
        for analysis in self.latest.values():
            source = analysis.source(document.path)
            if source is not None and source.text == document.plain:
                yield analysis, source

    def view(self, uri: str, position: types.Position) -> View | None:
        """What there is to say about a place; None for a document that is not open, or none of ours."""
        document = self.ours(uri)
        if document is None:
            return None
        offset = document.lines.offset(position)
        analysis = self._sound.get(uri) or next((known for known in self._sound.values() if known.source(document.path)), None)
        source = analysis.source(document.path) if analysis else None
        then = None if source is None else _moved(offset, document.plain, source.text)
        return View(document, offset, analysis, source, then, any(True for _ in self.current(document)))


def _moved(offset: int, now: str, then: str) -> int | None:
    """Where an offset of a text stood in an earlier version; None for what has been written since.

    That is known before and behind all that differs, and in between for a line that was there just so, and once.
    """
    if now == then:
        return offset
    most = min(len(now), len(then))
    same = bisect_left(range(most), True, key=lambda index: now[: index + 1] != then[: index + 1])
    if offset <= same:
        return offset
    tail = bisect_left(range(most - same), True, key=lambda index: now[len(now) - index - 1 :] != then[len(then) - index - 1 :])
    if offset >= len(now) - tail:
        return offset - len(now) + len(then)
    begin, end = now.rfind("\n", 0, offset), now.find("\n", offset)
    line = now[begin:end]
    return then.index(line) + offset - begin if 0 <= begin < end and line.strip() and then.count(line) == 1 else None


def _path_above(node: Node | None, source: Source, path: Path = ()) -> Path:
    """The path of the mapping into which the text of `source` went: that of the first key that comes from it."""
    if isinstance(node, Mapping):
        for entry in node.entries.values():
            if entry.key.span.source is source:
                within = place(source.text, entry.key.span.end).path
                return path[: len(path) - len(within)]
        for name, entry in node.entries.items():
            if found := _path_above(entry.value, source, (*path, name)):
                return found
    return ()


def _below(data: Any, path: Path) -> Any:
    for step in reversed(path):
        data = {step: data}
    return data


def _laid(known: Any, written: Any) -> Any:
    """`written` laid upon `known`: mappings key by key, all else replaced, but for what is still empty."""
    if isinstance(known, dict) and isinstance(written, dict):
        return {**known, **{key: _laid(known.get(key, ""), value) for key, value in written.items()}}
    return known if written == "" else written
