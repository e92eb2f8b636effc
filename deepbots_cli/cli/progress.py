"""How far a row of episodes is, on stderr: one line that is written anew on a terminal, a line for every tenth elsewhere.

The bar of a training needs more than a simulation does; this one needs nothing.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from deepbots_cli.learning.episodes import Episode

_WIDTH = 20
_PAUSE = 0.2  # s between two lines on a terminal


class Meter:
    """Tells how many episodes are done, out of how many, and how long the others will take; again from 1 on for the next row of them.

    `what` says what is counted in place of episodes.
    """

    def __init__(self, stream: TextIO | None = None, what: str = "episodes") -> None:
        self._what = what
        self._stream = sys.stderr if stream is None else stream
        self._onto_terminal = self._stream.isatty()
        self._width = 0
        self._begin()

    def _begin(self) -> None:
        self._began, self._last, self._tenth = time.perf_counter(), 0.0, 0

    def __call__(self, number: int, count: int) -> None:
        now = time.perf_counter()
        line = f"{number:,} of {count:,} {self._what}"
        if number:
            line += f"  {(now - self._began) / number * (count - number):.0f} s to go"
        if self._onto_terminal and now - self._last > _PAUSE:
            filled = _WIDTH * number // count
            line = f"[{'#' * filled}{'.' * (_WIDTH - filled)}] {line}"
            self._width = max(self._width, len(line))
            print(f"\r{line:<{self._width}}", end="", file=self._stream, flush=True)
            self._last = now
        elif not self._onto_terminal and 10 * number // count > self._tenth and number < count:
            self._tenth = 10 * number // count
            print(line, file=self._stream, flush=True)
        if number == count:
            self._begin()

    def clear(self) -> None:
        """Take the line away again."""
        if self._width:
            print(f"\r{'':<{self._width}}\r", end="", file=self._stream, flush=True)
        self._width = 0


@contextmanager
def on_terminal(what: str = "episodes") -> Iterator[Meter | None]:
    """A meter for what is over in seconds or minutes: on a terminal only, and gone when it is done."""
    meter = Meter(what=what) if sys.stderr.isatty() else None
    try:
        yield meter
    finally:
        if meter is not None:
            meter.clear()


def told(episodes: Iterable[Episode], count: int, stream: TextIO | None = None) -> Iterator[Episode]:
    """The episodes, of which there will be `count` at most, with a word on how many there were and how long the others will take."""
    meter = Meter(stream)
    for number, episode in enumerate(episodes, start=1):
        yield episode
        meter(number, count)
    meter.clear()
