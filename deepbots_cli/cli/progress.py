"""How far a row of episodes is, on stderr: one line that is written anew on a terminal, a line for every tenth elsewhere.

The bar of a training needs more than a simulation does; this one needs nothing.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from deepbots_cli.learning.episodes import Episode

_WIDTH = 20
_PAUSE = 0.2  # s between two lines on a terminal


def told(episodes: Iterable[Episode], count: int, stream: TextIO | None = None) -> Iterator[Episode]:
    """The episodes, of which there will be `count` at most, with a word on how many there were and how long the others will take."""
    stream = sys.stderr if stream is None else stream
    onto_terminal, began, last, tenth, width = stream.isatty(), time.perf_counter(), 0.0, 0, 0
    for number, episode in enumerate(episodes, start=1):
        yield episode
        now = time.perf_counter()
        line = f"{number:,} of {count:,} episodes  {(now - began) / number * (count - number):.0f} s to go"
        if onto_terminal and now - last > _PAUSE:
            filled = _WIDTH * number // count
            line = f"[{'#' * filled}{'.' * (_WIDTH - filled)}] {line}"
            width = max(width, len(line))
            print(f"\r{line:<{width}}", end="", file=stream, flush=True)
            last = now
        elif not onto_terminal and 10 * number // count > tenth and number < count:
            tenth = 10 * number // count
            print(line, file=stream, flush=True)
    if width:
        print(f"\r{'':<{width}}\r", end="", file=stream, flush=True)
