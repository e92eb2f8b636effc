"""Findings as diagnostics of the protocol, and the analysis in the background that publishes them."""

from __future__ import annotations

import asyncio
import gc
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from itertools import chain
from pathlib import Path
from typing import NamedTuple

from lsprotocol import types

from deepbots_cli.diagnostics import Finding, Source, Span
from deepbots_cli.diagnostics.render import message, shortened
from deepbots_cli.document.load import Drafts
from deepbots_cli.lsp.workspace import Analysis, Document, Lines, Workspace, uri_of

_SOURCE = "deepbots"
_SEVERITIES = {"error": types.DiagnosticSeverity.Error, "warning": types.DiagnosticSeverity.Warning}
_UNNECESSARY = frozenset({"DB205", "DB901"})
"""Rules that report unnecessary text, which editors show faded."""


class Locator:
    """Converts spans of one analysis to locations; `open_uris` gives the client's URI of each open file, by path."""

    def __init__(self, analysis: Analysis, open_uris: dict[Path, str]) -> None:
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


def diagnostic(finding: Finding, locator: Locator) -> types.Diagnostic:
    """One finding with its related locations."""
    also = [types.DiagnosticRelatedInformation(locator.location(label.span), shortened(label.text)) for label in finding.also]
    also += [types.DiagnosticRelatedInformation(locator.location(span), "included from here") for span in finding.span.source.chain]
    return types.Diagnostic(
        range=locator.range(finding.span),
        message=message(finding),
        severity=_SEVERITIES[finding.severity],
        code=finding.code,
        source=_SOURCE,
        related_information=also or None,
        tags=[types.DiagnosticTag.Unnecessary] if finding.code in _UNNECESSARY else None,
        data={"name": finding.name},
    )


def diagnostics(analysis: Analysis, open_uris: dict[Path, str]) -> dict[str, list[types.Diagnostic]]:
    """All diagnostics by URI. The document and all open files that it reads always have an entry."""
    locator = Locator(analysis, open_uris)
    read = (open_uris[path] for path in analysis.paths.values() if path in open_uris)
    found: dict[str, list[types.Diagnostic]] = {uri: [] for uri in (analysis.document.uri, *read)}
    for finding in analysis.findings:
        found.setdefault(locator.uri(finding.span.source), []).append(diagnostic(finding, locator))
    return found


_DEBOUNCE = 0.05
"""Seconds between a change and its analysis; people type up to ten letters a second."""

Publish = Callable[[str, int | None, list[types.Diagnostic]], None]
Warn = Callable[[str], None]
Analyse = Callable[[Document, Drafts], Analysis]


class _Published(NamedTuple):
    """The diagnostics of the last analysis of a document, by URI."""

    analysis: Analysis
    found: dict[str, list[types.Diagnostic]]

    def is_about(self, document: Document | None) -> bool:
        """Whether the analysis read the current text of a document; None stands for a file that is not open."""
        return document is None or self.analysis.drafts.get(document.path) == document.bytes


class Checker:
    """Analyses scheduled documents one at a time in a thread, and publishes the diagnostics.

    `publish` receives a URI, the version of the document (None if it is not open) and all its diagnostics. `warn` receives a
    message for the user.
    """

    def __init__(self, workspace: Workspace, analyse: Analyse, publish: Publish, warn: Warn) -> None:
        self._workspace = workspace
        self._analyse = analyse
        self._publish = publish
        self._warn = warn
        self._queue: dict[str, None] = {}
        self._task: asyncio.Task[None] | None = None
        self._executor = ThreadPoolExecutor(1, "analysis")
        self._published: dict[str, _Published] = {}

    def schedule(self, *uris: str) -> None:
        """Analyse documents soon, before the documents that wait already."""
        self._queue = {**dict.fromkeys(uris), **self._queue}
        if self._task is None or self._task.done():
            self._task = asyncio.get_running_loop().create_task(self._run_queue())

    def retract(self, uri: str) -> None:
        """Withdraw the diagnostics that a document's analysis published."""
        self._queue.pop(uri, None)
        if uri in self._published:
            self._publish_all(self._published.pop(uri).found)

    def stop(self) -> None:
        self._queue.clear()
        self._executor.shutdown(wait=False, cancel_futures=True)

    async def _run_queue(self) -> None:
        while self._queue:
            await asyncio.sleep(_DEBOUNCE)
            uri = next(iter(self._queue), None)
            document = self._workspace.documents.get(uri) if uri else None
            if uri is not None:
                del self._queue[uri]
            if document is not None:
                await self._check(document)

    async def _check(self, document: Document) -> None:
        loop = asyncio.get_running_loop()
        try:
            analysis = await loop.run_in_executor(self._executor, self._run, document, self._workspace.drafts)
            self._workspace.record(analysis)
            if self._workspace.documents.get(document.uri) is document:  # otherwise a newer version is scheduled
                self._record(analysis)
        except Exception as error:  # an internal error must not end the server  # noqa: BLE001
            self._warn(f"deepbots could not check this file, which is a fault of its own: {type(error).__name__}: {error}")

    def _run(self, document: Document, drafts: Drafts) -> Analysis:
        """Analyse in the thread, and collect garbage there, because the server disables automatic collection."""
        try:
            return self._analyse(document, drafts)
        finally:
            gc.collect()

    def _record(self, analysis: Analysis) -> None:
        uri = analysis.document.uri
        if analysis.settings_error:
            self._warn(analysis.settings_error)
        before = self._published[uri].found if uri in self._published else {}
        now = self._published[uri] = _Published(analysis, diagnostics(analysis, self._workspace.open_uris))
        # A file that has changed meanwhile is published by the next analysis of the documents that read it.
        self._publish_all(other for other in {*before, *now.found} if now.is_about(self._workspace.documents.get(other)))

    def _publish_all(self, uris: Iterable[str]) -> None:
        """Publish the current diagnostics of some URIs.

        A diagnostic that several analyses report is published once: from the file's own analysis, or else from the last
        document by name.
        """
        for uri in sorted(uris):
            document = self._workspace.documents.get(uri)
            order = sorted(self._published, key=lambda reader: (reader == uri, reader))
            shown = [self._published[reader].found.get(uri, ()) for reader in order if self._published[reader].is_about(document)]
            unique = {(str(found.range), found.code, found.message): found for found in chain.from_iterable(shown)}
            self._publish(uri, document.version if document else None, list(unique.values()))
