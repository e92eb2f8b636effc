"""Which piece of how many is being measured, and how long it took, on standard error."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager


class Progress:
    def __init__(self, pieces: int) -> None:
        self._pieces = pieces
        self._begun = 0
        self._lock = threading.Lock()

    @contextmanager
    def piece(self, what: str) -> Iterator[None]:
        """Tells that it begins, and after how long it is done; nothing about one that fails."""
        with self._lock:
            self._begun += 1
            place = f"[{self._begun} of {self._pieces}] {what}"
        self.say(f"{place} ...")
        began = time.monotonic()
        yield
        self.say(f"{place}: done in {duration(time.monotonic() - began)}")

    def say(self, text: str) -> None:
        print(text, file=sys.stderr, flush=True)


def duration(seconds: float) -> str:
    """`42 s`, `3 min 20 s`, `2 h 5 min`."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    minutes, rest = divmod(whole, 60)
    return f"{minutes} min {rest} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"
