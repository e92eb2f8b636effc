"""The progress that a command shows on standard error.

On a terminal, the tasks of `rich.progress` below the printed lines are refreshed in place; elsewhere only the
lines are printed. A display has no thread of its own: `bench` measures the CPU time of the process.
"""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

REFRESH_INTERVAL_S = 0.25
"""Seconds between two refreshes."""
_BAR_WIDTH = 20
_LINES_OF_TASK = 2
"""The lines that a task of several takes at most, but for a line that a narrow terminal breaks."""


class Display:
    """Lines, and below them tasks that are refreshed in place.

    Args:
        stream: By default standard error.
        transient: Whether `close` takes the tasks away.
    """

    def __init__(self, stream: TextIO | None = None, *, transient: bool = False) -> None:
        self._stream = sys.stderr if stream is None else stream
        self._transient = transient
        self._progress: Progress | None = None
        self._tasks: dict[object, TaskID] = {}
        self._drawn = 0.0

    @property
    def is_terminal(self) -> bool:
        """Whether `show` shows anything."""
        return self._stream.isatty()

    def print(self, text: str) -> None:
        """Print a line that stays."""
        if self._progress is None:
            print(text, file=self._stream, flush=True)
        else:
            # `out` neither wraps the line nor reads brackets in it as rich markup.
            self._progress.console.out(text, highlight=False)

    def show(
        self, text: str, done: int = 0, total: int = 0, *, task: object = None, at_once: bool = False
    ) -> None:
        """Show a text for a task, behind a bar if there is a `total`.

        Without `at_once`, the display is drawn once in `REFRESH_INTERVAL_S`. Of tasks for which the terminal
        has no room, those that were changed last are shown.
        """
        if not self.is_terminal:
            return
        if self._progress is None:
            self._progress = _progress(self._stream, has_bars=total > 0, transient=self._transient)
            self._progress.start()
        number = self._tasks.pop(task, None)
        if number is None:
            number = self._progress.add_task("", total=total, text=text)
        self._tasks[task] = number
        self._progress.update(number, completed=done, total=total, text=text)
        now = time.perf_counter()
        if at_once or now - self._drawn >= REFRESH_INTERVAL_S:
            room = max(2, self._progress.console.height // _LINES_OF_TASK - 1)
            for place, listed in enumerate(reversed(self._tasks.values())):
                self._progress.update(listed, visible=place < room)
            self._progress.refresh()
            self._drawn = now

    def close(self) -> None:
        """End the tasks, and leave the terminal as it was; `show` may follow."""
        if self._progress is not None:
            self._progress.stop()
            self._progress = None
            self._tasks.clear()
            self._drawn = 0.0


def _progress(stream: TextIO, *, has_bars: bool, transient: bool) -> Progress:
    from rich.console import Console  # 60 ms, which only a terminal pays
    from rich.progress import BarColumn, Progress, TextColumn

    texts = TextColumn("{task.fields[text]}", markup=False)
    columns = [BarColumn(bar_width=_BAR_WIDTH), texts] if has_bars else [texts]
    return Progress(*columns, console=Console(file=stream), auto_refresh=False, transient=transient)
