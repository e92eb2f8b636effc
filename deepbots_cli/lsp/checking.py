"""Analyses behind the scenes: one at a time in a thread of its own, the newest version of each document only."""

from __future__ import annotations

import asyncio
import gc
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from itertools import chain
from typing import NamedTuple

from lsprotocol import types

from deepbots_cli.document.load import Drafts
from deepbots_cli.lsp.analysing import Analysis
from deepbots_cli.lsp.desk import Desk
from deepbots_cli.lsp.diagnosing import diagnostics
from deepbots_cli.lsp.documents import Document

_PAUSE = 0.05
"""Seconds that a change waits for the next one; people type up to ten letters a second."""

Publish = Callable[[str, int | None, list[types.Diagnostic]], None]
Complain = Callable[[str], None]
Analyse = Callable[[Document, Drafts], Analysis]


class _Shown(NamedTuple):
    """What the last analysis of a document has found, by address."""

    analysis: Analysis
    found: dict[str, list[types.Diagnostic]]

    def is_about(self, document: Document | None) -> bool:
        """Whether the analysis has seen a document as it is now; None is a file that is not open."""
        return document is None or self.analysis.drafts.get(document.path) == document.bytes


class Checker:
    """Keeps what the desk knows up to date, by what `analyse` makes of a document, and publishes what is found.

    `publish` is given an address, its version if it is open, and all its diagnostics; `complain` a sentence for the user.
    """

    def __init__(self, desk: Desk, analyse: Analyse, publish: Publish, complain: Complain) -> None:
        self._desk = desk
        self._analyse = analyse
        self._publish = publish
        self._complain = complain
        self._waiting: dict[str, None] = {}
        self._task: asyncio.Task[None] | None = None
        self._thread = ThreadPoolExecutor(1, "analysis")
        self._shown: dict[str, _Shown] = {}

    def want(self, *uris: str) -> None:
        """Have documents looked at soon, before those that wait already."""
        self._waiting = {**dict.fromkeys(uris), **self._waiting}
        if self._task is None or self._task.done():
            self._task = asyncio.get_running_loop().create_task(self._work())

    def forget(self, uri: str) -> None:
        """Take back what was published because of a document."""
        self._waiting.pop(uri, None)
        if uri in self._shown:
            self._tell(self._shown.pop(uri).found)

    def stop(self) -> None:
        self._waiting.clear()
        self._thread.shutdown(wait=False, cancel_futures=True)

    async def _work(self) -> None:
        while self._waiting:
            await asyncio.sleep(_PAUSE)
            uri = next(iter(self._waiting), None)
            document = self._desk.documents.get(uri) if uri else None
            if uri is not None:
                del self._waiting[uri]
            if document is not None:
                await self._look(document)

    async def _look(self, document: Document) -> None:
        loop = asyncio.get_running_loop()
        try:
            analysis = await loop.run_in_executor(self._thread, self._analysed, document, self._desk.drafts)
            self._desk.learn(analysis)
            if self._desk.documents.get(document.uri) is document:  # else it is stale, and the next one is under way
                self._show(analysis)
        except Exception as error:  # a fault of ours, which must not end the service  # noqa: BLE001
            self._complain(f"deepbots could not check this file, which is a fault of its own: {type(error).__name__}: {error}")

    def _analysed(self, document: Document, drafts: Drafts) -> Analysis:
        """An analysis, in its thread, and what is left of the one before collected."""
        try:
            return self._analyse(document, drafts)
        finally:
            gc.collect()

    def _show(self, analysis: Analysis) -> None:
        uri = analysis.document.uri
        if analysis.complaint:
            self._complain(analysis.complaint)
        before = self._shown[uri].found if uri in self._shown else {}
        now = self._shown[uri] = _Shown(analysis, diagnostics(analysis, self._desk.open_uris))
        # Of a file that has changed meanwhile nothing new is said: what reads it waits to be looked at again.
        self._tell(other for other in {*before, *now.found} if now.is_about(self._desk.documents.get(other)))

    def _tell(self, uris: Iterable[str]) -> None:
        """Publish all that is known of some addresses as they are.

        What several documents have found there is told once: as it was found in the file itself, or else in the last of them by name.
        """
        for uri in sorted(uris):
            document = self._desk.documents.get(uri)
            order = sorted(self._shown, key=lambda reader: (reader == uri, reader))
            shown = [self._shown[reader].found.get(uri, ()) for reader in order if self._shown[reader].is_about(document)]
            unique = {(str(found.range), found.code, found.message): found for found in chain.from_iterable(shown)}
            self._publish(uri, document.version if document else None, list(unique.values()))
