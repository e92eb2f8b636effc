"""The server and its request handlers. A failing handler answers nothing and shows the client a message."""

from __future__ import annotations

import gc
import logging
import os
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from functools import partial
from pathlib import Path
from typing import Any

from lsprotocol import types
from pygls.lsp.server import LanguageServer
from pygls.protocol import LanguageServerProtocol

import deepbots_cli
from deepbots_cli.document.load import allowed_folders
from deepbots_cli.errors import UsageError
from deepbots_cli.lsp.completion import completion
from deepbots_cli.lsp.diagnostics import KINDS, Checker, CodeActions, formatting
from deepbots_cli.lsp.lookup import definitions, document_symbols, hover
from deepbots_cli.lsp.workspace import Document, Workspace, analyse, path_of

_WATCHED = ("**/*.{yaml,yml,urdf}", "**/*.{obj,stl,dae,png}", "**/{deepbots,pyproject}.toml")
_TRIGGERS = [".", " ", ":", "(", "[", "{", ",", "/", "*", "|"]


class _Protocol(LanguageServerProtocol):
    """Forgets the results of notifications, which pygls 2.1 keeps forever: 2 MB for every 1 000 letters typed."""

    def _check_handler_result(self, future: Future[Any]) -> None:
        super()._check_handler_result(future)
        for number in [number for number, known in self._request_futures.items() if known is future]:
            del self._request_futures[number]


class Server(LanguageServer):
    """Answers requests from the workspace, which the checker keeps up to date. The permissions are those of `deepbots lint`."""

    def __init__(self, allow_paths: Sequence[Path] = (), allow_code: bool = False) -> None:
        full = types.TextDocumentSyncKind.Full
        super().__init__("deepbots", deepbots_cli.__version__, text_document_sync_kind=full, protocol_cls=_Protocol)
        self.exit_code = 0  # the protocol wants 1 if the client exits without a shutdown request
        self._is_shut_down = False
        self.scenarios = Workspace()
        self._warned: set[str] = set()
        run = partial(analyse, allow_paths=tuple(allow_paths), allow_code=allow_code)
        self.checker = Checker(self.scenarios, run, self._publish, self._warn)
        self._register(types.TEXT_DOCUMENT_DID_OPEN, self._opened)
        self._register(types.TEXT_DOCUMENT_DID_CHANGE, self._changed)
        self._register(types.TEXT_DOCUMENT_DID_SAVE, self._saved)
        self._register(types.TEXT_DOCUMENT_DID_CLOSE, self._closed)
        self._register(types.WORKSPACE_DID_CHANGE_WATCHED_FILES, self._saved)
        self._register(types.TEXT_DOCUMENT_COMPLETION, self._completion, types.CompletionOptions(trigger_characters=_TRIGGERS))
        self._register(types.TEXT_DOCUMENT_HOVER, self._hover)
        self._register(types.TEXT_DOCUMENT_DEFINITION, self._definition)
        self._register(types.TEXT_DOCUMENT_CODE_ACTION, self._code_actions, types.CodeActionOptions(list(KINDS), resolve_provider=True))
        self._register(types.CODE_ACTION_RESOLVE, self._resolve_code_action)
        self._register(types.TEXT_DOCUMENT_DOCUMENT_SYMBOL, self._document_symbols)
        self._register(types.TEXT_DOCUMENT_FORMATTING, self._formatting)
        self._register(types.INITIALIZED, self._initialized)
        self._register(types.SHUTDOWN, self._shut_down)
        self._register(types.EXIT, self._exit)

    def _register(self, method: str, handler: Callable[[Any], Any], options: Any = None) -> None:
        self.feature(method, options)(self._guard(method, handler))

    def _guard(self, method: str, handler: Callable[[Any], Any]) -> Callable[[Any], Any]:
        """Wrap a handler: on an exception it answers nothing and warns the user."""

        def guarded(params: Any) -> Any:
            try:
                return handler(params)
            except Exception as error:
                if os.environ.get("DEEPBOTS_DEBUG") == "1":
                    raise
                self._warn(f"{method} has failed, which is a fault of deepbots: {type(error).__name__}: {error}")
                return None

        return guarded

    def _initialized(self, _params: types.InitializedParams) -> None:
        """Ask the client to report changes of the files that scenarios read, if it can."""
        workspace = self.client_capabilities.workspace
        watching = workspace.did_change_watched_files if workspace else None
        if watching is not None and watching.dynamic_registration:
            options = types.DidChangeWatchedFilesRegistrationOptions([types.FileSystemWatcher(pattern) for pattern in _WATCHED])
            wanted = types.Registration("watched", types.WORKSPACE_DID_CHANGE_WATCHED_FILES, options)
            self.client_register_capability(types.RegistrationParams([wanted]))

    # Documents

    def _opened(self, params: types.DidOpenTextDocumentParams) -> None:
        self._update(params.text_document.uri, params.text_document.version, params.text_document.text)

    def _changed(self, params: types.DidChangeTextDocumentParams) -> None:
        if params.content_changes:
            self._update(params.text_document.uri, params.text_document.version, params.content_changes[-1].text)

    def _update(self, uri: str, version: int, text: str) -> None:
        document = Document(uri, version, text, path_of(uri), self.workspace.position_codec)
        self.scenarios.put(document)
        dependents = self.scenarios.dependents(document)
        # An included file is analysed with the scenarios that read it.
        self.checker.schedule(*([uri] if document.is_scenario or not dependents else []), *dependents)

    def _saved(self, _params: object) -> None:
        """Analyse all documents again: a robot, a mesh or the project's settings may have changed."""
        self.checker.schedule(*self.scenarios.documents)

    def _closed(self, params: types.DidCloseTextDocumentParams) -> None:
        document = self.scenarios.documents.get(params.text_document.uri)
        if document is not None:
            dependents = self.scenarios.dependents(document)
            self.scenarios.remove(document.uri)
            self.checker.retract(document.uri)
            self.checker.schedule(*dependents)

    # Requests

    def _completion(self, params: types.CompletionParams) -> types.CompletionList | None:
        view = self.scenarios.view(params.text_document.uri, params.position)
        return completion(view) if view else None

    def _hover(self, params: types.HoverParams) -> types.Hover | None:
        view = self.scenarios.view(params.text_document.uri, params.position)
        return hover(view) if view else None

    def _definition(self, params: types.DefinitionParams) -> list[types.Location] | None:
        view = self.scenarios.view(params.text_document.uri, params.position)
        return definitions(view, self.scenarios.open_uris) if view else None

    def _code_actions(self, params: types.CodeActionParams) -> list[types.CodeAction]:
        actions = self._actions(params.text_document.uri)
        only = None if params.context.only is None else [str(getattr(kind, "value", kind)) for kind in params.context.only]
        found = actions.at(params.range, only) if actions else []
        return found if self._resolves else [self._resolve_code_action(action) for action in found]

    def _resolve_code_action(self, action: types.CodeAction) -> types.CodeAction:
        """Compute the edit of an action, which takes time."""
        data = action.data
        actions = self._actions(str(data.get("uri"))) if isinstance(data, dict) else None
        if actions is not None and action.edit is None:
            action.edit = actions.fix_all()
        return action

    def _document_symbols(self, params: types.DocumentSymbolParams) -> list[types.DocumentSymbol] | None:
        document = self.scenarios.document(params.text_document.uri)
        return document_symbols(document) if document else None

    def _formatting(self, params: types.DocumentFormattingParams) -> list[types.TextEdit] | None:
        document = self.scenarios.document(params.text_document.uri)
        return formatting(document) if document else None

    def _shut_down(self, _params: object) -> None:
        self.checker.stop()
        self._is_shut_down = True

    def _exit(self, _params: object) -> None:
        self.exit_code = 0 if self._is_shut_down else 1

    # To the client

    def _actions(self, uri: str) -> CodeActions | None:
        document = self.scenarios.documents.get(uri)
        edits = self.client_capabilities.workspace and self.client_capabilities.workspace.workspace_edit
        return CodeActions(self.scenarios, document, versioned=bool(edits and edits.document_changes)) if document else None

    @property
    def _resolves(self) -> bool:
        """Whether the client requests the edit of an action when the user chooses it."""
        known = self.client_capabilities.text_document and self.client_capabilities.text_document.code_action
        support = known.resolve_support if known else None
        return support is not None and "edit" in support.properties

    def _publish(self, uri: str, version: int | None, found: list[types.Diagnostic]) -> None:
        self.text_document_publish_diagnostics(types.PublishDiagnosticsParams(uri, found, version))

    def _warn(self, sentence: str) -> None:
        """Show the user a message once."""
        if sentence not in self._warned:
            self._warned.add(sentence)
            self.window_show_message(types.ShowMessageParams(types.MessageType.Warning, sentence))


def serve(port: int | None = None, *, allow_paths: Sequence[Path] = (), allow_code: bool = False) -> int:
    """Serve one client over standard input and output or a local port until it exits; return the exit code.

    Raises:
        UsageError: The port is not available, or an allowed path is no folder.
    """
    # pygls logs tracebacks to standard error; the client gets the messages as answers.
    logging.getLogger("pygls").setLevel(logging.CRITICAL + 1)
    # Each analysis collects its own garbage. Automatic collections visited all 500 000 objects and stopped answers for 0.5 s.
    # Imported modules stay forever, so they are frozen out of collections.
    gc.collect()
    gc.freeze()
    gc.disable()
    # The default of 5 ms doubles the time of an answer while an analysis runs.
    sys.setswitchinterval(0.001)
    server = Server(allowed_folders(allow_paths), allow_code)
    if port is not None:
        try:
            server.start_tcp("127.0.0.1", port)
        except OSError as error:
            raise UsageError(f"port {port} of this machine cannot be listened on: {os.strerror(error.errno or 0).lower()}") from None
        return server.exit_code
    # Only the protocol writes to standard output; other prints go to standard error.
    stream = os.fdopen(os.dup(sys.__stdout__.fileno() if sys.__stdout__ else 1), "wb")
    kept, sys.stdout = sys.stdout, sys.stderr
    try:
        server.start_io(stdout=stream)
    finally:
        sys.stdout = kept
    return server.exit_code
