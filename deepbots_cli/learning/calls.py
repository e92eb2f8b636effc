"""Calls of a function by an executor: their reports, and the watchers that follow them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


def _ignore(value: object) -> None:
    pass


@dataclass(frozen=True)
class Attempt:
    """A call of the function.

    Attributes:
        number: 1, or higher if the worker of an earlier call with this item was lost.
        report: Reports how far the call is; the newest value replaces an earlier one.
        note: Passes a note to the user.
    """

    number: int = 1
    report: Callable[[object], None] = _ignore
    note: Callable[[str], None] = _ignore


class Watcher:
    """Follows calls; items are numbered from 0. This one does nothing."""

    def on_report(self, item: int, value: object) -> None:
        """Called with the newest `report` of a call."""

    def on_note(self, item: int, text: str) -> None:
        """Called with a note of a call for the user."""

    def on_loss(self, item: int) -> None:
        """Called when the worker of a call was lost. Another worker repeats the call."""

    def on_done(self, item: int, outcome: object) -> None:
        """Called after a call with the value that `map` yields for it, not necessarily in the order of the
        items."""


UNWATCHED = Watcher()


class Counter(Watcher):
    """Calls a function with the number of completed items and the number of all items."""

    def __init__(self, show: Callable[[int, int], object] | None, total: int) -> None:
        self._show = show
        self._done = 0
        self.total = total

    def on_done(self, item: int, outcome: object) -> None:
        self._done += 1
        if self._show is not None:
            self._show(self._done, self.total)
