"""Ctrl-C and SIGTERM: the first one ends a training after its rollout, the second one at once."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


class Interruption:
    """A requested end of the training, by Ctrl-C or SIGTERM."""

    def __init__(self) -> None:
        self.requested = False

    def __call__(self, number: int, frame: FrameType | None) -> None:
        if self.requested:
            # Whoever asks twice does not want to wait for the end of an update.
            raise KeyboardInterrupt
        self.requested = True


@contextmanager
def signals_handled(interruption: Interruption) -> Iterator[None]:
    """Context in which the first signal only sets `requested`, and the second raises KeyboardInterrupt.
    Restores the handlers.

    Python delivers signals to the main thread only; in other threads this changes nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, interruption) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            # None stands for a handler that was not set from Python, and cannot be set again.
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
