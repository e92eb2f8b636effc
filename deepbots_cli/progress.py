"""Progress on standard error: a bar on a terminal, a line for every tenth of the way elsewhere."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from rich.progress import Progress

_PAUSE = 0.2
"""Seconds between two refreshes of the bar. It has no thread of its own: `bench` measures the CPU time of the process."""


class ProgressBar:
    """How much of a task is done, how fast, and how long the rest will take.

    Args:
        total: The amount of work, at least 1.
        unit: What is counted, in the plural.
        done: The amount that was done before.
        transient: Whether the bar disappears at the end.
        stream: Where to write; standard error by default.
    """

    def __init__(self, total: int, unit: str, *, done: int = 0, transient: bool = False, stream: TextIO | None = None) -> None:
        self._total, self._unit, self._first = max(1, total), unit, done
        self._stream = sys.stderr if stream is None else stream
        self._began, self._shown = time.perf_counter(), 0.0
        self._tenth = 10 * done // self._total
        self._bar = _bar(self._stream, transient) if self._stream.isatty() else None
        if self._bar is not None:
            self._task = self._bar.add_task("", total=self._total, completed=done)
            self._bar.start()

    def update(self, done: int, text: str = "") -> None:
        """Show that `done` of the total is done, with `text` beside it."""
        now = time.perf_counter()
        if self._bar is not None:
            if now - self._shown > _PAUSE or done >= self._total:
                self._bar.update(self._task, completed=done, description=self._line(done, text, now), refresh=True)
                self._shown = now
        elif 10 * done // self._total > self._tenth:
            self._tenth = 10 * done // self._total
            print(self._line(done, text, now), file=self._stream, flush=True)

    def _line(self, done: int, text: str, now: float) -> str:
        parts = [f"{done:,} of {self._total:,} {self._unit}", text]
        speed = (done - self._first) / max(1e-9, now - self._began)
        if speed >= 1.0:
            parts.append(f"{speed:,.0f} {self._unit}/s")
        if speed > 0.0 and done < self._total:
            parts.append(f"{(self._total - done) / speed:.0f} s to go")
        return "  ".join(filter(None, parts))

    def close(self) -> None:
        """Leave the terminal as it was; the bar stays unless it is transient."""
        if self._bar is not None:
            self._bar.stop()


def _bar(stream: TextIO, transient: bool) -> Progress:
    from rich.console import Console  # 60 ms, which only a terminal pays
    from rich.progress import BarColumn, Progress, TextColumn
    from rich.table import Column

    text = TextColumn("{task.description}", table_column=Column(no_wrap=True, overflow="ellipsis"), markup=False)
    return Progress(BarColumn(bar_width=20), text, console=Console(file=stream), auto_refresh=False, transient=transient)
