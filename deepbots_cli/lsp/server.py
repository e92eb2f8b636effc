"""The server: request handlers, findings as diagnostics, the background analysis that publishes them, and the
text edits of code actions.

A failing handler returns an empty answer and shows the client a message.
"""

from __future__ import annotations

import asyncio
import gc
import logging
import os
import sys
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

from lsprotocol import types
from pygls.lsp.server import LanguageServer
from pygls.protocol import LanguageServerProtocol

import deepbots_cli
from deepbots_cli import api
from deepbots_cli.diagnostics import Edit, Finding
from deepbots_cli.diagnostics.render import message, shortened
from deepbots_cli.document import Permissions
from deepbots_cli.document.layout import canonical_text
from deepbots_cli.document.load import Drafts, allowed_folders
from deepbots_cli.errors import UsageError
from deepbots_cli.lint.fixes import Fixer
from deepbots_cli.lsp.completion import completion
from deepbots_cli.lsp.hover import definitions, hover
from deepbots_cli.lsp.workspace import (
    CursorView,
    Document,
    DocumentAnalysis,
    Locator,
    Workspace,
    analyze,
    path_of,
)

# Findings as diagnostics, and the text edits that fix them

_SEVERITIES = {"error": types.DiagnosticSeverity.Error, "warning": types.DiagnosticSeverity.Warning}

_DEBOUNCE = 0.05
"""Seconds between a change and its analysis; people type up to ten letters a second."""

FIX_ALL = f"{types.CodeActionKind.SourceFixAll.value}.deepbots"
KINDS = (types.CodeActionKind.QuickFix, FIX_ALL)

_MAX_TITLE = 40


def diagnostic(finding: Finding, locator: Locator) -> types.Diagnostic:
    """Convert a finding with its related locations."""
    also = [
        types.DiagnosticRelatedInformation(locator.location(label.span), shortened(label.text))
        for label in finding.labels
    ]
    also += [
        types.DiagnosticRelatedInformation(locator.location(span), "included from here")
        for span in finding.span.source.inclusion_chain
    ]
    return types.Diagnostic(
        range=locator.range(finding.span),
        message=message(finding),
        severity=_SEVERITIES[finding.severity],
        code=finding.code,
        source="deepbots",
        related_information=also or None,
        # Editors show unnecessary text faded.
        tags=[types.DiagnosticTag.Unnecessary] if finding.code in {"DB205", "DB901"} else None,
        data={"name": finding.name},
    )


def diagnostics(analysis: DocumentAnalysis, open_uris: dict[Path, str]) -> dict[str, list[types.Diagnostic]]:
    """Return all diagnostics by URI. The document and all open files that it reads always have an entry."""
    locator = Locator(analysis, open_uris)
    read_uris = (open_uris[path] for path in analysis.paths.values() if path in open_uris)
    by_uri: dict[str, list[types.Diagnostic]] = {uri: [] for uri in (analysis.document.uri, *read_uris)}
    for finding in analysis.findings:
        by_uri.setdefault(locator.uri(finding.span.source), []).append(diagnostic(finding, locator))
    return by_uri


Publish = Callable[[str, int | None, list[types.Diagnostic]], None]
Warn = Callable[[str], None]
Analyze = Callable[[Document, Drafts], DocumentAnalysis]


class _Published(NamedTuple):
    """The diagnostics of the last analysis of a document, by URI."""

    analysis: DocumentAnalysis
    diagnostics: dict[str, list[types.Diagnostic]]

    def is_about(self, document: Document | None) -> bool:
        """Return whether the analysis read the current text of a document; None stands for a file that is not
        open."""
        return document is None or self.analysis.drafts.get(document.path) == document.bytes


class Checker:
    """Analyses scheduled documents one at a time in a thread, and publishes the diagnostics.

    `publish` receives a URI, the version of the document (None if it is not open) and all its diagnostics.
    `warn` receives a message for the user.
    """

    def __init__(self, workspace: Workspace, analyze: Analyze, publish: Publish, warn: Warn) -> None:
        self._workspace = workspace
        self._analyze = analyze
        self._publish = publish
        self._warn = warn
        self._queue: dict[str, None] = {}
        self._task: asyncio.Task[None] | None = None
        # One thread, because two analyses would wait for the same interpreter lock.
        self._executor = ThreadPoolExecutor(1, "analysis")
        self._published: dict[str, _Published] = {}

    def put(self, document: Document) -> None:
        """Take a version of a document, and analyze it soon. An included file is analyzed with the scenarios
        that read it."""
        self._workspace.put(document)
        dependents = self._workspace.dependents(document)
        self.schedule(*([document.uri] if document.is_scenario or not dependents else []), *dependents)

    def remove(self, uri: str) -> None:
        """Forget a document with its diagnostics, and analyze those that read it."""
        document = self._workspace.documents.get(uri)
        if document is not None:
            dependents = self._workspace.dependents(document)
            self._workspace.remove(uri)
            self._retract(uri)
            self.schedule(*dependents)

    def schedule(self, *uris: str) -> None:
        """Analyze documents soon, before the documents that wait already."""
        self._queue = {**dict.fromkeys(uris), **self._queue}
        if self._task is None or self._task.done():
            self._task = asyncio.get_running_loop().create_task(self._run_queue())

    def _retract(self, uri: str) -> None:
        """Withdraw the diagnostics that a document's analysis published."""
        self._queue.pop(uri, None)
        if uri in self._published:
            self._publish_all(self._published.pop(uri).diagnostics)

    def stop(self) -> None:
        self._queue.clear()
        self._executor.shutdown(wait=False, cancel_futures=True)

    async def _run_queue(self) -> None:
        while self._queue:
            await asyncio.sleep(_DEBOUNCE)
            # `remove` or `stop` may have emptied the queue during the sleep.
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
            # If the text has changed, a newer version is scheduled.
            if self._workspace.documents.get(document.uri) is document:
                self._record(analysis)
        except Exception as error:  # an internal error must not end the server  # noqa: BLE001
            self._warn(
                f"deepbots could not check this file, which is a fault of its own: {type(error).__name__}:"
                f" {error}"
            )

    def _run(self, document: Document, drafts: Drafts) -> DocumentAnalysis:
        """Analyze in the thread, and collect garbage there, because the server disables automatic
        collection."""
        try:
            return self._analyze(document, drafts)
        finally:
            gc.collect()

    def _record(self, analysis: DocumentAnalysis) -> None:
        uri = analysis.document.uri
        if analysis.settings_error:
            self._warn(analysis.settings_error)
        before = self._published[uri].diagnostics if uri in self._published else {}
        now = self._published[uri] = _Published(analysis, diagnostics(analysis, self._workspace.open_uris))
        # A file that has changed meanwhile is published by the next analysis of the documents that read it.
        self._publish_all(
            affected_uri
            for affected_uri in {*before, *now.diagnostics}
            if now.is_about(self._workspace.documents.get(affected_uri))
        )

    def _publish_all(self, uris: Iterable[str]) -> None:
        """Publish the current diagnostics of some URIs.

        A diagnostic that several analyses report is published once: from the file's own analysis, or else
        from the last document by name.
        """
        for uri in sorted(uris):
            document = self._workspace.documents.get(uri)
            order = sorted(self._published, key=lambda reader: (reader == uri, reader))
            groups = [
                self._published[reader].diagnostics.get(uri, ())
                for reader in order
                if self._published[reader].is_about(document)
            ]
            unique = {
                # The ranges of lsprotocol are not hashable.
                (str(diagnostic.range), diagnostic.code, diagnostic.message): diagnostic
                for diagnostic in chain.from_iterable(groups)
            }
            self._publish(uri, document.version if document else None, list(unique.values()))


class CodeActions:
    """The code actions of a document; edits apply only to the open versions of documents."""

    def __init__(self, workspace: Workspace, document: Document, *, versioned: bool) -> None:
        self._workspace = workspace
        self._document = document
        self._versioned = versioned

    def at(self, range: types.Range, only: Iterable[str] | None = None) -> list[types.CodeAction]:
        """Return the code actions for a range of the document, limited to the kinds in `only`."""
        actions: list[types.CodeAction] = []
        if _is_wanted(types.CodeActionKind.QuickFix.value, only):
            for finding, analysis in self._findings(range):
                actions += self._actions_for(finding, analysis)
        findings = (
            self._analysis.findings if self._analysis is not None and self._document.is_scenario else ()
        )
        if _is_wanted(FIX_ALL, only) and any(
            finding.fix is not None and finding.fix.safe for finding in findings
        ):
            actions.append(types.CodeAction("Make all safe fixes", kind=FIX_ALL, edit=self.fix_all()))
        return actions

    def fix_all(self) -> types.WorkspaceEdit | None:
        """Return the fixes that `deepbots lint --fix` makes in the scenario and the files it includes."""
        analysis = self._analysis
        if analysis is None or analysis.checked is None:
            return None
        document = analysis.checked.document
        try:
            load = partial(api.load, permissions=document.permissions)
            rewrites = Fixer(
                [str(self._document.path)],
                load,
                selects=analysis.selection.selects,
                drafts=self._workspace.drafts,
            ).fix()
        except UsageError:  # a file does not exist yet or has changed
            return None
        by_path = self._workspace.by_path
        changes = {
            by_path[rewrite.path]: _whole(
                by_path[rewrite.path], rewrite.after.decode("utf-8").removeprefix("\ufeff")
            )
            for rewrite in rewrites
            if rewrite.path in by_path
        }
        return self._edit(changes) if changes else None

    @property
    def _analysis(self) -> DocumentAnalysis | None:
        latest = self._workspace.latest.get(self._document.uri)
        return latest if latest is not None and latest.document is self._document else None

    def _findings(self, range: types.Range) -> Iterator[tuple[Finding, DocumentAnalysis]]:
        """Yield the findings in the document that touch the range, each once."""
        lines = self._document.lines
        keys = set()
        start, end = lines.offset(range.start), lines.offset(range.end)
        for analysis, source in self._workspace.analyses_of(self._document):
            for finding in analysis.findings:
                span = finding.span
                if (
                    span.source is source
                    and span.start <= end
                    and span.end >= start
                    and finding.sort_key not in keys
                ):
                    keys.add(finding.sort_key)
                    yield finding, analysis

    def _actions_for(self, finding: Finding, analysis: DocumentAnalysis) -> Iterator[types.CodeAction]:
        about = [diagnostic(finding, Locator(analysis, self._workspace.open_uris))]
        changes = self._changes(finding, analysis)
        if changes and finding.fix is not None:
            title = f"{_title(finding.fix.edits[0])}{'' if finding.fix.safe else ' (check it)'}"
            edit = self._edit(changes)
            yield types.CodeAction(
                title, types.CodeActionKind.QuickFix, about, is_preferred=finding.fix.safe or None, edit=edit
            )

    def _changes(self, finding: Finding, analysis: DocumentAnalysis) -> dict[Document, list[types.TextEdit]]:
        """Return the edits of a fix by document; empty unless all apply to the current text of open
        documents."""
        changes: dict[Document, list[types.TextEdit]] = {}
        by_path = self._workspace.by_path
        if finding.fix:
            for edit in finding.fix.edits:
                document = by_path.get(analysis.path(edit.span.source))
                if document is None or document.plain != edit.span.source.text:
                    return {}
                span = document.lines.range(edit.span.start, edit.span.end)
                changes.setdefault(document, []).append(types.TextEdit(span, edit.text))
        return changes

    def _edit(self, changes: dict[Document, list[types.TextEdit]]) -> types.WorkspaceEdit:
        if not self._versioned:
            return types.WorkspaceEdit(changes={document.uri: edits for document, edits in changes.items()})
        # A client refuses an edit whose version is not the current one.
        return types.WorkspaceEdit(
            document_changes=[
                types.TextDocumentEdit(
                    types.OptionalVersionedTextDocumentIdentifier(document.uri, document.version), list(edits)
                )
                for document, edits in changes.items()
            ]
        )


def _is_wanted(kind: str, only: Iterable[str] | None) -> bool:
    """Return whether a client requests a kind: `source` includes `source.*`; source actions are given only on
    request."""
    if only is None:
        return not kind.startswith("source")
    return any(kind == requested or kind.startswith(f"{requested}.") for requested in only)


def _title(edit: Edit) -> str:
    old, new = (" ".join(text.split())[:_MAX_TITLE] for text in (edit.span.text, edit.text))
    if not old and not new:
        return "Correct the indentation"
    if new and not old:
        return f"Insert `{new}`"
    return f"Replace `{old}` with `{new}`" if new else f"Remove `{old}`"


def formatting(document: Document) -> list[types.TextEdit]:
    """Return the edits that `deepbots fmt` would make; empty if there are none or the document cannot be
    parsed."""
    _, root, findings = document.read()
    before = document.plain
    after = canonical_text(before) if root is not None and not findings.errors else None
    return _whole(document, after) if after not in (None, before) else []


def _whole(document: Document, after: str) -> list[types.TextEdit]:
    """Return the edit that replaces the text of a document."""
    return [types.TextEdit(document.lines.range(0, len(document.plain)), after)]


# The server and its request handlers

_WATCHED = (
    "**/*.{yaml,yml,urdf,xacro}",
    "**/*.{obj,stl,dae,glb,gltf,bin,png}",
    "**/{deepbots,pyproject}.toml",
)


class _Protocol(LanguageServerProtocol):
    """Forgets the results of notifications, which pygls 2.1 keeps forever: 2 MB for every 1 000 letters
    typed."""

    def _check_handler_result(self, future: Future[Any]) -> None:
        super()._check_handler_result(future)
        for number in [number for number, pending in self._request_futures.items() if pending is future]:
            del self._request_futures[number]


class Server(LanguageServer):
    """Answers requests from the workspace, which the checker keeps up to date. The permissions are those of
    `deepbots lint`."""

    def __init__(self, permissions: Permissions = Permissions()) -> None:
        full = types.TextDocumentSyncKind.Full
        super().__init__(
            "deepbots", deepbots_cli.__version__, text_document_sync_kind=full, protocol_cls=_Protocol
        )
        self.exit_code = 0  # the protocol requires 1 if the client exits without a shutdown request
        self._is_shut_down = False
        self.scenarios = Workspace()
        self._warned: set[str] = set()
        run = partial(analyze, permissions=permissions)
        self.checker = Checker(self.scenarios, run, self._publish, self._warn)
        self._register(types.TEXT_DOCUMENT_DID_OPEN, self._opened)
        self._register(types.TEXT_DOCUMENT_DID_CHANGE, self._changed)
        self._register(types.TEXT_DOCUMENT_DID_SAVE, self._saved)
        self._register(types.TEXT_DOCUMENT_DID_CLOSE, self._closed)
        self._register(types.WORKSPACE_DID_CHANGE_WATCHED_FILES, self._saved)
        self._register(
            types.TEXT_DOCUMENT_COMPLETION,
            self._at(completion),
            types.CompletionOptions(trigger_characters=[".", " ", ":", "(", "[", "{", ",", "/", "*", "|"]),
        )
        self._register(types.TEXT_DOCUMENT_HOVER, self._at(hover))
        self._register(
            types.TEXT_DOCUMENT_DEFINITION, self._at(lambda view: definitions(view, self.scenarios.open_uris))
        )
        self._register(
            types.TEXT_DOCUMENT_CODE_ACTION,
            self._code_actions,
            types.CodeActionOptions(list(KINDS)),
        )
        self._register(types.TEXT_DOCUMENT_FORMATTING, self._format)
        self._register(types.INITIALIZED, self._initialized)
        self._register(types.SHUTDOWN, self._shut_down)
        self._register(types.EXIT, self._exit)

    def _register(self, method: str, handler: Callable[[Any], Any], options: Any = None) -> None:
        self.feature(method, options)(self._guard(method, handler))

    def _guard(self, method: str, handler: Callable[[Any], Any]) -> Callable[[Any], Any]:
        """Wrap a handler. On an exception it returns an empty answer and warns the user."""

        def guarded(params: Any) -> Any:
            try:
                return handler(params)
            except Exception as error:
                if os.environ.get("DEEPBOTS_DEBUG") == "1":
                    raise
                self._warn(
                    f"{method} has failed, which is a fault of deepbots: {type(error).__name__}: {error}"
                )
                return None

        return guarded

    def _initialized(self, _params: types.InitializedParams) -> None:
        """Request from the client that it reports changes of the files that scenarios read, if it can."""
        workspace = self.client_capabilities.workspace
        watching = workspace.did_change_watched_files if workspace else None
        if watching is not None and watching.dynamic_registration:
            options = types.DidChangeWatchedFilesRegistrationOptions(
                [types.FileSystemWatcher(pattern) for pattern in _WATCHED]
            )
            registration = types.Registration("watched", types.WORKSPACE_DID_CHANGE_WATCHED_FILES, options)
            self.client_register_capability(types.RegistrationParams([registration]))

    # Documents

    def _opened(self, params: types.DidOpenTextDocumentParams) -> None:
        self._update(params.text_document.uri, params.text_document.version, params.text_document.text)

    def _changed(self, params: types.DidChangeTextDocumentParams) -> None:
        # With full synchronization, each change has the whole text.
        if params.content_changes:
            self._update(
                params.text_document.uri, params.text_document.version, params.content_changes[-1].text
            )

    def _update(self, uri: str, version: int, text: str) -> None:
        self.checker.put(Document(uri, version, text, path_of(uri), self.workspace.position_codec))

    def _saved(self, _params: object) -> None:
        """Analyze all documents again, because a robot, a mesh or the project's settings may have changed."""
        self.checker.schedule(*self.scenarios.documents)

    def _closed(self, params: types.DidCloseTextDocumentParams) -> None:
        self.checker.remove(params.text_document.uri)

    # Requests

    def _at(self, answer: Callable[[CursorView], Any]) -> Callable[[Any], Any]:
        """Return the handler of a request about a position."""

        def handler(params: Any) -> Any:
            view = self.scenarios.view(params.text_document.uri, params.position)
            return answer(view) if view else None

        return handler

    def _format(self, params: types.DocumentFormattingParams) -> list[types.TextEdit] | None:
        document = self.scenarios.document(params.text_document.uri)
        return formatting(document) if document else None

    def _code_actions(self, params: types.CodeActionParams) -> list[types.CodeAction]:
        actions = self._actions(params.text_document.uri)
        # lsprotocol leaves a kind that it does not list as text.
        only = (
            None
            if params.context.only is None
            else [str(getattr(kind, "value", kind)) for kind in params.context.only]
        )
        return actions.at(params.range, only) if actions else []

    def _shut_down(self, _params: object) -> None:
        self.checker.stop()
        self._is_shut_down = True

    def _exit(self, _params: object) -> None:
        self.exit_code = 0 if self._is_shut_down else 1

    # To the client

    def _actions(self, uri: str) -> CodeActions | None:
        document = self.scenarios.documents.get(uri)
        edits = self.client_capabilities.workspace and self.client_capabilities.workspace.workspace_edit
        return (
            CodeActions(self.scenarios, document, versioned=bool(edits and edits.document_changes))
            if document
            else None
        )

    def shutdown(self) -> None:
        """Close the connection too, because pygls leaves it open, and asyncio waits for it from Python 3.12
        on."""
        super().shutdown()  # type: ignore[no-untyped-call]
        if isinstance(self.protocol.writer, asyncio.StreamWriter):
            self.protocol.writer.close()

    def _publish(self, uri: str, version: int | None, entries: list[types.Diagnostic]) -> None:
        self.text_document_publish_diagnostics(types.PublishDiagnosticsParams(uri, entries, version))

    def _warn(self, sentence: str) -> None:
        """Show the user a message once."""
        if sentence not in self._warned:
            self._warned.add(sentence)
            self.window_show_message(types.ShowMessageParams(types.MessageType.Warning, sentence))


def serve(port: int | None = None, *, permissions: Permissions = Permissions()) -> int:
    """Serve one client over standard input and output or a local port until it exits; return the exit code.

    Raises:
        UsageError: The port is not available, or an allowed path is not a folder.
    """
    # pygls logs tracebacks to standard error; the client gets the messages as answers.
    logging.getLogger("pygls").setLevel(logging.CRITICAL + 1)
    # Each analysis collects its own garbage. Automatic collections visited all 500 000 objects and stopped
    # answers for 0.5 s. Imported modules stay forever, so they are frozen out of collections.
    gc.collect()
    gc.freeze()
    gc.disable()
    # The default of 5 ms doubles the time of an answer while an analysis runs.
    sys.setswitchinterval(0.001)
    server = Server(Permissions(allowed_folders(permissions.folders), permissions.code))
    if port is not None:
        try:
            # The protocol has no authentication, so only this machine may connect.
            server.start_tcp("127.0.0.1", port)
        except OSError as error:
            raise UsageError(
                f"cannot listen on port {port}: {os.strerror(error.errno or 0).lower()}"
            ) from None
        return server.exit_code
    # Only the protocol writes to standard output; other prints go to standard error.
    stream = os.fdopen(os.dup(sys.__stdout__.fileno() if sys.__stdout__ else 1), "wb")
    stdout, sys.stdout = sys.stdout, sys.stderr
    try:
        server.start_io(stdout=stream)
    finally:
        sys.stdout = stdout
    return server.exit_code
