"""The progress that a command shows on standard error.

On a terminal, text below the printed lines is refreshed in place; elsewhere only the lines are printed. A
display has no thread of its own: `bench` measures the CPU time of the process.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.live import Live

REFRESH_INTERVAL_S = 0.25
"""Seconds between two refreshes."""


class Display:
    """Lines, and below them text that is refreshed in place.

    Args:
        stream: By default standard error.
        transient: Whether `close` takes the text away.
    """

    def __init__(self, stream: TextIO | None = None, *, transient: bool = False) -> None:
        self._stream = sys.stderr if stream is None else stream
        self._transient = transient
        self._live: Live | None = None
        self._drawn = 0.0

    @property
    def is_terminal(self) -> bool:
        """Whether `show` shows anything."""
        return self._stream.isatty()

    def print(self, text: str) -> None:
        """Print a line that stays."""
        if self._live is None:
            print(text, file=self._stream, flush=True)
        else:
            # `out` neither wraps the line nor reads brackets in it as rich markup.
            self._live.console.out(text, highlight=False)

    def show(self, content: Callable[[int], RenderableType], *, at_once: bool = False) -> None:
        """Show `content`, which takes the height of the terminal in lines; it is called only if it is drawn.

        Without `at_once`, it is drawn once in `REFRESH_INTERVAL_S`.
        """
        now = time.perf_counter()
        if not self.is_terminal or not (at_once or now - self._drawn >= REFRESH_INTERVAL_S):
            return
        if self._live is None:
            from rich.console import Console  # 60 ms, which only a terminal pays
            from rich.live import Live

            self._live = Live(
                console=Console(file=self._stream), auto_refresh=False, transient=self._transient
            )
            self._live.start()
        self._live.update(content(self._live.console.height), refresh=True)
        self._drawn = now

    def show_line(self, text: str) -> None:
        """Show one line."""

        def line(_height: int) -> RenderableType:
            from rich.text import Text

            return Text(text, no_wrap=True, overflow="ellipsis")

        self.show(line)

    def close(self) -> None:
        """End the text, and leave the terminal as it was; `show` may follow."""
        if self._live is not None:
            self._live.stop()
            self._live = None
            self._drawn = 0.0
