"""The open documents, positions in them, their analyses, and the view of the cursor that answers requests.

The protocol counts lines and columns from 0. Columns count UTF-16 units unless client and server agree on
another encoding; findings count code points. Lines end in `\\n`, `\\r\\n` or `\\r`.
"""

from __future__ import annotations

import re
from bisect import bisect_left, bisect_right
from collections.abc import Iterable
from dataclasses import field, replace
from functools import cached_property
from itertools import accumulate
from pathlib import Path
from typing import Any
from zlib import crc32

from lsprotocol import types
from pygls import uris
from pygls.workspace import PositionCodec

from deepbots_cli.compiler import CheckedScenario, check
from deepbots_cli.compiler.texts import does_harm
from deepbots_cli.compiler.values import ScopedExpression
from deepbots_cli.diagnostics import Finding, Findings, Source, Span
from deepbots_cli.diagnostics.findings import Selection
from deepbots_cli.document import MappingNode, Permissions, descend, files, load, to_data
from deepbots_cli.document.files import project_root
from deepbots_cli.document.load import Drafts
from deepbots_cli.document.nodes import Node, NodePath
from deepbots_cli.document.parse import parse
from deepbots_cli.errors import UsageError
from deepbots_cli.files import recorded_reads
from deepbots_cli.lint import all_findings
from deepbots_cli.lint.settings import Settings, is_scenario, settings
from deepbots_cli.lsp.cursor import Cursor, cursor_at, value_at
from deepbots_cli.records import dataclass

_BOM = "\ufeff"
_UTF_16 = PositionCodec()

_MAX_EXAMINED = 3
"""The number of errors whose fixes are examined, each by a check of the whole scenario."""
_NAMELESS = "<untitled {:08x}>"


class Lines:
    """Converts between offsets in a text and positions of the protocol, whose columns count units of the
    client's encoding.

    A byte order mark takes a column, but offsets start after it, as in a `Source`.
    """

    def __init__(self, text: str, codec: PositionCodec = _UTF_16) -> None:
        self._text = text
        self._codec = codec
        self._mark = len(_BOM) if text.startswith(_BOM) else 0
        ends = list(re.finditer(r"\r\n|\n|\r", text))
        self._starts = [0, *(end.end() for end in ends)]
        self._ends = [*(end.start() for end in ends), len(text)]

    def position(self, offset: int) -> types.Position:
        """Return the position of the character at `offset`; an offset beyond the text gives the end of the
        text."""
        index = min(max(0, offset) + self._mark, len(self._text))
        line = bisect_right(self._starts, index) - 1
        before = self._text[self._starts[line] : index]
        # For ASCII text, every position encoding has one unit per character.
        return types.Position(line, len(before) if before.isascii() else self._codec.client_num_units(before))

    def range(self, start: int, end: int) -> types.Range:
        return types.Range(self.position(start), self.position(end))

    def offset(self, position: types.Position) -> int:
        """Return the offset of a position.

        A position beyond a line or the text gives its end, a position inside a character the start of that
        character.
        """
        if position.line >= len(self._starts):
            return len(self._text) - self._mark
        line = max(0, position.line)
        start = self._starts[line]
        text = self._text[self._starts[line] : self._ends[line]]
        column = min(max(0, position.character), len(text))
        if not text.isascii():
            column = bisect_right(
                list(accumulate(map(self._codec.client_num_units, text))), max(0, position.character)
            )
        return max(0, start + column - self._mark)


@dataclass(frozen=True, eq=False)
class Document:
    """A version of an open file; `path` is its file, which need not exist."""

    uri: str
    version: int
    text: str
    path: Path
    codec: PositionCodec = _UTF_16

    @cached_property
    def lines(self) -> Lines:
        return Lines(self.text, self.codec)

    @property
    def plain(self) -> str:
        """The text without a byte order mark; offsets count in this text."""
        return self.text.removeprefix("\ufeff")

    @cached_property
    def is_scenario(self) -> bool:
        """Whether this is a scenario rather than a file that scenarios include."""
        return is_scenario(self.bytes)

    @property
    def is_blank(self) -> bool:
        """Whether the document has only comments and at most the beginning of one word."""
        *lines, last = self.text.removeprefix("\ufeff").rstrip().split("\n")
        begun = "" if re.fullmatch("[a-z]+", last) else last
        return all(line.lstrip()[:1] in ("", "#") for line in (*lines, begun))

    @cached_property
    def bytes(self) -> bytes:
        # A JSON string may contain half a surrogate pair, which UTF-8 refuses otherwise.
        return self.text.encode("utf-8", "surrogatepass")

    def read(self) -> tuple[Source, Node | None, Findings]:
        """Return the source, the parsed tree (None if the text is not readable) and the findings of the
        parser."""
        findings = Findings()
        source, readable = files.decode(self.bytes, str(self.path), findings)
        return source, parse(source, findings) if readable else None, findings


def path_of(uri: str) -> Path:
    """Return the file of a URI. A URI without a file gets a unique name in the working directory."""
    nameless = _NAMELESS.format(crc32(uri.encode("utf-8", "surrogatepass")))
    file_name = uris.to_fs_path(uri) if uri.startswith("file:") else None
    try:
        return Path(file_name or nameless).resolve()
    except (OSError, ValueError, RuntimeError):  # the name is not possible for a file
        return Path(nameless).absolute()


def uri_of(path: Path) -> str:
    return str(uris.from_fs_path(str(path)))


@dataclass(frozen=True, eq=False)
class DocumentAnalysis:
    """The result of compiling and linting one version of a document.

    `drafts` has the open files at that time by path. `checked` is None for an included file and for
    unreadable files. `selection` determines the reported findings of the project; `settings_error` describes
    a fault in the project's settings. `reads` are the files that were read from the disk.
    """

    document: Document
    drafts: Drafts
    findings: tuple[Finding, ...] = ()
    checked: CheckedScenario | None = None
    settings_error: str | None = None
    selection: Selection = field(default_factory=Selection)
    reads: frozenset[Path] = frozenset()

    @property
    def is_complete(self) -> bool:
        """Whether all robots were read; a finding in a robot removes its names from the namespace."""
        namespace = self.checked.namespace if self.checked else None
        return namespace is not None and None not in namespace.robots.values()

    @cached_property
    def data(self) -> Any:
        """The scenario as plain values, with everything it extends and includes."""
        return to_data(self.checked.document.root) if self.checked and self.checked.document.root else {}

    @cached_property
    def paths(self) -> dict[Source, Path]:
        """The files that the analysis read."""
        if self.checked is None:
            return {}
        paths = {source: path for path, source in self.checked.document.files.items()}
        for robot in (self.checked.robots or {}).values():
            paths |= {
                robot.file.source: robot.path,
                **(robot.file.xacro.included if robot.file.xacro else {}),
            }
        return paths

    def path(self, source: Source) -> Path:
        """Return the file of a source. A file that could not be read is found by its name."""
        return self.paths.get(source) or Path(source.name).absolute()

    def source(self, path: Path) -> Source | None:
        """Return the text that the analysis read from a file."""
        return next((source for source, read_path in self.paths.items() if read_path == path), None)

    @cached_property
    def readings(self) -> tuple[ScopedExpression, ...]:
        """Every expression of the scenario; expressions of cases and stages come last."""
        if self.checked is None:
            return ()
        scenarios = (self.checked, *self.checked.variants)
        return tuple(
            reading
            for scenario in scenarios
            if scenario.namespace is not None
            for reading in scenario.namespace.values.readings
        )


def analyze(
    document: Document, drafts: Drafts, *, permissions: Permissions = Permissions()
) -> DocumentAnalysis:
    """Load, check and lint a document. `drafts` replace files on the disk; the permissions are those of
    `deepbots lint`."""
    with recorded_reads() as reads:
        analysis = _analysis(document, drafts, permissions)
    return replace(analysis, reads=frozenset(reads))


def _analysis(document: Document, drafts: Drafts, permissions: Permissions) -> DocumentAnalysis:
    if not document.is_scenario:
        return DocumentAnalysis(document, drafts)  # scenarios that include the file report its findings
    settings_error = None
    try:
        project = settings(document.path.parent)
    except UsageError as error:
        project = Settings(document.path.parent)
        settings_error = str(error)
    preview = bool(project.preview)
    try:
        selection = Selection(project.select, project.ignore, preview=preview)
    except UsageError as error:
        selection = Selection(preview=preview)
        settings_error = str(error)
    try:
        loaded = load(
            document.path,
            display=str(document.path),
            permissions=permissions,
            drafts={**drafts, document.path: document.bytes},
        )
    except UsageError:  # it is a folder, or the name is not possible for a file
        return DocumentAnalysis(document, drafts)
    checked = check(loaded)
    findings = _without_harmful_fixes(checked, all_findings(checked, preview=preview))
    selected_findings = (*selection.inactive_rules(), *filter(selection.selects, findings))
    return DocumentAnalysis(document, drafts, selected_findings, checked, settings_error, selection)


def _without_harmful_fixes(checked: CheckedScenario, findings: list[Finding]) -> list[Finding]:
    """Return the findings; the first errors without the fixes that would leave more errors."""
    document = checked.document
    errors = [finding for finding in findings if finding.severity == "error" and finding.fix]
    if document.root is not None:  # the compiler examines the fix of a syntax error
        for finding in errors[:_MAX_EXAMINED]:
            if does_harm(finding, document, lambda other: len(check(other).findings.errors)):
                findings[findings.index(finding)] = replace(finding, fix=None)
    return findings


class Locator:
    """Converts spans of one analysis to locations; `open_uris` gives the client's URI of each open file, by
    path."""

    def __init__(self, analysis: DocumentAnalysis, open_uris: dict[Path, str]) -> None:
        self._analysis = analysis
        self._open_uris = open_uris
        self._lines: dict[Source, Lines] = {}

    def uri(self, source: Source) -> str:
        path = self._analysis.path(source)
        return self._open_uris.get(path) or uri_of(path)

    def range(self, span: Span) -> types.Range:
        if span.source not in self._lines:
            draft = self._analysis.drafts.get(self._analysis.path(span.source), b"")
            mark = "\ufeff" if draft.startswith(b"\xef\xbb\xbf") else ""
            self._lines[span.source] = Lines(mark + span.source.text, self._analysis.document.codec)
        return self._lines[span.source].range(span.start, span.end)

    def location(self, span: Span) -> types.Location:
        return types.Location(self.uri(span.source), self.range(span))


@dataclass(frozen=True, eq=False)
class CursorView:
    """A cursor in the current text of a document, and the last analysis that resolved the names of its
    scenario, if any.

    `source` is the text of the document in that analysis. `known_offset` is the offset of the cursor in
    `source`, None if this text was typed later. `is_settled` is true if an analysis of the current text
    exists.
    """

    document: Document
    offset: int
    analysis: DocumentAnalysis | None
    source: Source | None
    known_offset: int | None
    is_settled: bool

    @property
    def checked(self) -> CheckedScenario | None:
        return self.analysis.checked if self.analysis else None

    @cached_property
    def cursor(self) -> Cursor:
        """The key or value under the cursor; its path starts at the root of the scenario, also in an included
        file."""
        return self.cursor_at(self.offset)

    def cursor_at(self, offset: int) -> Cursor:
        cursor = cursor_at(self.document.plain, offset)
        return cursor._replace(path=(*self._prefix, *cursor.path), data=_nested(cursor.data, self._prefix))

    @property
    def data(self) -> Any:
        """The scenario of the last analysis as plain values, updated with the text before the cursor."""
        return _merged(self.analysis.data, self.cursor.data) if self.analysis else self.cursor.data

    @property
    def keys(self) -> set[str]:
        """The other keys of the mapping at the cursor in this document."""
        before = value_at(self.cursor.data, self.cursor.path)
        keys = set(before) if isinstance(before, dict) else set()
        if self.checked is not None and self.checked.document.root is not None:
            node, _, steps = descend(self.checked.document.root, self.cursor.path)
            if steps == len(self.cursor.path) and isinstance(node, MappingNode):
                keys |= {name for name, entry in node.entries.items() if self._is_elsewhere(entry.key.span)}
        return keys

    @property
    def roots(self) -> tuple[Path, ...]:
        """The folders from which the scenario may read files."""
        return self.checked.document.roots if self.checked else (project_root(self.document.path.parent),)

    def _is_elsewhere(self, span: Span) -> bool:
        """Return whether the current text still contains the span of the analysis, outside the cursor."""
        if span.source is not self.source:
            return False
        now = self.document.plain
        end = _map_offset(span.end, span.source.text, now)
        start = (end or 0) - len(span.text)
        return end is not None and now[max(0, start) : end] == span.text and not start <= self.offset <= end

    @cached_property
    def _prefix(self) -> NodePath:
        """The path in the scenario at which an included document is merged."""
        if self.document.is_scenario or self.source is None or self.checked is None:
            return ()
        return _include_path(self.checked.document.root, self.source)


class Workspace:
    """The open documents by URI, the last analysis of each, and the last analysis that resolved its names."""

    def __init__(self) -> None:
        self.documents: dict[str, Document] = {}
        self.latest: dict[str, DocumentAnalysis] = {}
        self._resolved: dict[str, DocumentAnalysis] = {}

    def put(self, document: Document) -> None:
        self.documents[document.uri] = document

    def remove(self, uri: str) -> None:
        for table in (self.documents, self.latest, self._resolved):
            table.pop(uri, None)

    def record(self, analysis: DocumentAnalysis) -> None:
        """Keep an analysis if its document is still open."""
        uri = analysis.document.uri
        if uri in self.documents:
            self.latest[uri] = analysis
            before = self._resolved.get(uri)
            is_resolved = analysis.checked is not None and analysis.checked.namespace is not None
            if is_resolved and (analysis.is_complete or before is None or not before.is_complete):
                self._resolved[uri] = analysis

    @property
    def drafts(self) -> Drafts:
        return {document.path: document.bytes for document in self.documents.values()}

    @property
    def by_path(self) -> dict[Path, Document]:
        return {document.path: document for document in self.documents.values()}

    @property
    def open_uris(self) -> dict[Path, str]:
        """The client's URI of each open file, by path."""
        return {document.path: uri for uri, document in self.documents.items()}

    def document(self, uri: str) -> Document | None:
        """Return the open document of a URI if it is a scenario, included by one, or blank; editors send
        every YAML file."""
        document = self.documents.get(uri)
        return document if document is not None and self._is_relevant(document) else None

    def _is_relevant(self, document: Document) -> bool:
        if document.is_scenario or document.is_blank:
            return True
        analyses = (*self.latest.values(), *self._resolved.values())
        return any(
            analysis.checked and document.path in analysis.checked.document.files for analysis in analyses
        )

    def dependents(self, document: Document) -> list[str]:
        """Return the URIs of the other open documents that read this one."""
        return [
            uri
            for uri, analysis in self.latest.items()
            if uri != document.uri and document.path in analysis.paths.values()
        ]

    def analyses_of(self, document: Document) -> Iterable[tuple[DocumentAnalysis, Source]]:
        """Yield the analyses that read this version of the document."""
        for analysis in self.latest.values():
            source = analysis.source(document.path)
            if source is not None and source.text == document.plain:
                yield analysis, source

    def view(self, uri: str, position: types.Position) -> CursorView | None:
        """Return the view of a position; None if the document is not open or not part of a scenario."""
        document = self.documents.get(uri)
        return self.view_of(document, position) if document is not None else None

    def view_of(self, document: Document, position: types.Position) -> CursorView | None:
        """Return the view of a position in a version of a document, which need not be the open one; None if
        the document is not part of a scenario."""
        if not self._is_relevant(document):
            return None
        uri = document.uri
        offset = document.lines.offset(position)
        analysis = self._resolved.get(uri) or next(
            (candidate for candidate in self._resolved.values() if candidate.source(document.path)), None
        )
        source = analysis.source(document.path) if analysis else None
        known_offset = None if source is None else _map_offset(offset, document.plain, source.text)
        return CursorView(
            document, offset, analysis, source, known_offset, any(True for _ in self.analyses_of(document))
        )


def _map_offset(offset: int, now: str, then: str) -> int | None:
    """Return the offset in `then`, an earlier version of the text, for an offset in `now`; None for text that
    is new.

    Offsets before and after the changed region map directly. Within it, a line maps if `then` contains it
    exactly once.
    """
    if now == then:
        return offset
    start, end_now, end_then = changed_part(now, then)
    if offset <= start:
        return offset
    if offset >= end_now:
        return offset - end_now + end_then
    begin, end = now.rfind("\n", 0, offset), now.find("\n", offset)
    line = now[begin:end]
    return (
        then.index(line) + offset - begin
        if 0 <= begin < end and line.strip() and then.count(line) == 1
        else None
    )


def changed_part(before: str, after: str) -> tuple[int, int, int]:
    """Return where two texts differ: the start, and the end in each, without their common start and end."""
    start = _common_prefix(before, after)
    # The common end must not overlap the common beginning, as in `aa` and `aaa`.
    tail = min(_common_prefix(before[::-1], after[::-1]), min(len(before), len(after)) - start)
    return start, len(before) - tail, len(after) - tail


def _common_prefix(first: str, second: str) -> int:
    """Return the length of the common prefix; bisection compares slices, which is faster than single
    characters."""
    return bisect_left(
        range(min(len(first), len(second))), True, key=lambda index: first[: index + 1] != second[: index + 1]
    )


def _include_path(node: Node | None, source: Source, path: NodePath = ()) -> NodePath:
    """Return the path of the mapping into which `source` was included, found by the first key that comes from
    it."""
    if isinstance(node, MappingNode):
        for entry in node.entries.values():
            if entry.key.span.source is source:
                within = cursor_at(source.text, entry.key.span.end).path
                return path[: len(path) - len(within)]
        for name, entry in node.entries.items():
            if included := _include_path(entry.value, source, (*path, name)):
                return included
    return ()


def _nested(data: Any, path: NodePath) -> Any:
    for step in reversed(path):
        data = {step: data}
    return data


def _merged(older: Any, newer: Any) -> Any:
    """Merge `newer` into `older`: mappings key by key, other values replaced unless the newer one is
    empty."""
    if isinstance(older, dict) and isinstance(newer, dict):
        return {**older, **{key: _merged(older.get(key, ""), value) for key, value in newer.items()}}
    return older if newer == "" else newer
