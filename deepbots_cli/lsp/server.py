"""The server: which request is answered by what. Whatever goes wrong in one is told to the client in a sentence."""

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
from deepbots_cli.lsp.analysing import analyse
from deepbots_cli.lsp.checking import Checker
from deepbots_cli.lsp.completing import completion
from deepbots_cli.lsp.defining import definitions
from deepbots_cli.lsp.desk import Desk
from deepbots_cli.lsp.documents import Document, path_of
from deepbots_cli.lsp.formatting import formatting
from deepbots_cli.lsp.hovering import hover
from deepbots_cli.lsp.mending import KINDS, Actions
from deepbots_cli.lsp.outlining import outline

_WATCHED = ("**/*.{yaml,yml,urdf}", "**/*.{obj,stl,dae,png}", "**/{deepbots,pyproject}.toml")
_TRIGGERS = [".", " ", ":", "(", "[", "{", ",", "/", "*", "|"]


class _Protocol(LanguageServerProtocol):
    """That of pygls, which (2.1) remembers for good what came of each notification: 2 MB for every 1 000 letters typed."""

    def _check_handler_result(self, future: Future[Any]) -> None:
        super()._check_handler_result(future)
        for number in [number for number, known in self._request_futures.items() if known is future]:
            del self._request_futures[number]


class Server(LanguageServer):
    """Answers from the desk; the checker keeps that up to date. What may be read and run is as for `lint`."""

    def __init__(self, allow_paths: Sequence[Path] = (), allow_code: bool = False) -> None:
        full = types.TextDocumentSyncKind.Full
        super().__init__("deepbots", deepbots_cli.__version__, text_document_sync_kind=full, protocol_cls=_Protocol)
        self.code = 0  # of the process, which the protocol wants to be 1 for a client that leaves without a shutdown
        self._is_over = False
        self.desk = Desk()
        self._said: set[str] = set()
        look = partial(analyse, allow_paths=tuple(allow_paths), allow_code=allow_code)
        self.checker = Checker(self.desk, look, self._publish, self._complain)
        self._on(types.TEXT_DOCUMENT_DID_OPEN, self._opened)
        self._on(types.TEXT_DOCUMENT_DID_CHANGE, self._changed)
        self._on(types.TEXT_DOCUMENT_DID_SAVE, self._saved)
        self._on(types.TEXT_DOCUMENT_DID_CLOSE, self._closed)
        self._on(types.WORKSPACE_DID_CHANGE_WATCHED_FILES, self._saved)
        self._on(types.TEXT_DOCUMENT_COMPLETION, self._complete, types.CompletionOptions(trigger_characters=_TRIGGERS))
        self._on(types.TEXT_DOCUMENT_HOVER, self._hover)
        self._on(types.TEXT_DOCUMENT_DEFINITION, self._define)
        self._on(types.TEXT_DOCUMENT_CODE_ACTION, self._act, types.CodeActionOptions(list(KINDS), resolve_provider=True))
        self._on(types.CODE_ACTION_RESOLVE, self._resolve)
        self._on(types.TEXT_DOCUMENT_DOCUMENT_SYMBOL, self._outline)
        self._on(types.TEXT_DOCUMENT_FORMATTING, self._format)
        self._on(types.INITIALIZED, self._begin)
        self._on(types.SHUTDOWN, self._shut_down)
        self._on(types.EXIT, self._exit)

    def _on(self, method: str, handler: Callable[[Any], Any], options: Any = None) -> None:
        self.feature(method, options)(self._guarded(method, handler))

    def _guarded(self, method: str, handler: Callable[[Any], Any]) -> Callable[[Any], Any]:
        """A handler that answers nothing where it fails, and says so."""

        def guarded(params: Any) -> Any:
            try:
                return handler(params)
            except Exception as error:
                if os.environ.get("DEEPBOTS_DEBUG") == "1":
                    raise
                self._complain(f"{method} has failed, which is a fault of deepbots: {type(error).__name__}: {error}")
                return None

        return guarded

    def _begin(self, _params: types.InitializedParams) -> None:
        """Have the client tell of changes of files that scenarios read, if it can."""
        workspace = self.client_capabilities.workspace
        watching = workspace.did_change_watched_files if workspace else None
        if watching is not None and watching.dynamic_registration:
            options = types.DidChangeWatchedFilesRegistrationOptions([types.FileSystemWatcher(pattern) for pattern in _WATCHED])
            wanted = types.Registration("watched", types.WORKSPACE_DID_CHANGE_WATCHED_FILES, options)
            self.client_register_capability(types.RegistrationParams([wanted]))

    # Documents

    def _opened(self, params: types.DidOpenTextDocumentParams) -> None:
        self._take(params.text_document.uri, params.text_document.version, params.text_document.text)

    def _changed(self, params: types.DidChangeTextDocumentParams) -> None:
        if params.content_changes:
            self._take(params.text_document.uri, params.text_document.version, params.content_changes[-1].text)

    def _take(self, uri: str, version: int, text: str) -> None:
        encoding: Any = self.workspace.position_encoding
        document = Document(uri, version, text, path_of(uri), str(getattr(encoding, "value", encoding)))  # type: ignore[arg-type]
        self.desk.put(document)
        readers = self.desk.readers(document)
        # A piece is looked at as a part of those that read it.
        self.checker.want(*([uri] if document.is_scenario or not readers else []), *readers)

    def _saved(self, _params: object) -> None:
        """A file may have changed that open documents read: a robot, a mesh, the settings of the project."""
        self.checker.want(*self.desk.documents)

    def _closed(self, params: types.DidCloseTextDocumentParams) -> None:
        document = self.desk.documents.get(params.text_document.uri)
        if document is not None:
            readers = self.desk.readers(document)
            self.desk.drop(document.uri)
            self.checker.forget(document.uri)
            self.checker.want(*readers)

    # Requests

    def _complete(self, params: types.CompletionParams) -> types.CompletionList | None:
        view = self.desk.view(params.text_document.uri, params.position)
        return completion(view) if view else None

    def _hover(self, params: types.HoverParams) -> types.Hover | None:
        view = self.desk.view(params.text_document.uri, params.position)
        return hover(view) if view else None

    def _define(self, params: types.DefinitionParams) -> list[types.Location] | None:
        view = self.desk.view(params.text_document.uri, params.position)
        return definitions(view, self.desk.open_uris) if view else None

    def _act(self, params: types.CodeActionParams) -> list[types.CodeAction]:
        actions = self._actions(params.text_document.uri)
        only = None if params.context.only is None else [str(getattr(kind, "value", kind)) for kind in params.context.only]
        found = actions.at(params.range, only) if actions else []
        return found if self._resolves else [self._resolve(action) for action in found]

    def _resolve(self, action: types.CodeAction) -> types.CodeAction:
        """The edit of an action for which trying takes time."""
        data = action.data
        actions = self._actions(str(data.get("uri"))) if isinstance(data, dict) else None
        if actions is not None and action.edit is None:
            action.edit = actions.fix_all()
        return action

    def _outline(self, params: types.DocumentSymbolParams) -> list[types.DocumentSymbol] | None:
        document = self.desk.ours(params.text_document.uri)
        return outline(document) if document else None

    def _format(self, params: types.DocumentFormattingParams) -> list[types.TextEdit] | None:
        document = self.desk.ours(params.text_document.uri)
        return formatting(document) if document else None

    def _shut_down(self, _params: object) -> None:
        self.checker.stop()
        self._is_over = True

    def _exit(self, _params: object) -> None:
        self.code = 0 if self._is_over else 1

    # To the client

    def _actions(self, uri: str) -> Actions | None:
        document = self.desk.documents.get(uri)
        edits = self.client_capabilities.workspace and self.client_capabilities.workspace.workspace_edit
        return Actions(self.desk, document, versioned=bool(edits and edits.document_changes)) if document else None

    @property
    def _resolves(self) -> bool:
        """Whether the client asks for the edit of an action when it is chosen."""
        known = self.client_capabilities.text_document and self.client_capabilities.text_document.code_action
        support = known.resolve_support if known else None
        return support is not None and "edit" in support.properties

    def _publish(self, uri: str, version: int | None, found: list[types.Diagnostic]) -> None:
        self.text_document_publish_diagnostics(types.PublishDiagnosticsParams(uri, found, version))

    def _complain(self, sentence: str) -> None:
        """Show the user a sentence, once."""
        if sentence not in self._said:
            self._said.add(sentence)
            self.window_show_message(types.ShowMessageParams(types.MessageType.Warning, sentence))


def serve(port: int | None = None, *, allow_paths: Sequence[Path] = (), allow_code: bool = False) -> int:
    """Serve one client, over standard input and output or over a port of this machine, until it leaves; the exit code.

    Raises:
        UsageError: The port cannot be had, or what is allowed to be read is no folder.
    """
    # What the library has to say goes to the client as answers; its log would go to standard error, with tracebacks.
    logging.getLogger("pygls").setLevel(logging.CRITICAL + 1)
    # Garbage is collected behind each analysis, which leaves most of it: by itself Python looked through all of some 500 000
    # objects now and then, and stopped every answer for half a second. What is imported stays, and is not looked through.
    gc.collect()
    gc.freeze()
    gc.disable()
    # How long the analysis may go on while an answer waits for its turn; at the usual 5 ms answers took twice as long.
    sys.setswitchinterval(0.001)
    server = Server(allowed_folders(allow_paths), allow_code)
    if port is not None:
        try:
            server.start_tcp("127.0.0.1", port)
        except OSError as error:
            raise UsageError(f"port {port} of this machine cannot be listened on: {os.strerror(error.errno or 0).lower()}") from None
        return server.code
    # The protocol has standard output for itself; what anything else prints goes to standard error.
    stream = os.fdopen(os.dup(sys.__stdout__.fileno() if sys.__stdout__ else 1), "wb")
    kept, sys.stdout = sys.stdout, sys.stderr
    try:
        server.start_io(stdout=stream)
    finally:
        sys.stdout = kept
    return server.code
