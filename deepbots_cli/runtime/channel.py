"""The path of messages between one emitter and one receiver."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any


class Channel:
    """Delivers messages in order, each `delay` ticks after it was sent.

    One message is sent per tick. Without delay, sending and receiving are the two ends of a queue and
    nothing else; with it, `receive` gives None while nothing has arrived.
    """

    send: Callable[[Any], None]
    receive: Callable[[], Any]

    def __init__(self, delay: int = 0) -> None:
        self._queue: deque[Any] = deque()
        self._delay = delay
        self.send = self._queue.append
        self.receive = self._queue.popleft if delay == 0 else self._receive_late

    def _receive_late(self) -> Any:
        return self._queue.popleft() if len(self._queue) > self._delay else None

    def clear(self) -> None:
        """Forget what is under way; a reset leaves no message behind."""
        self._queue.clear()

    def __len__(self) -> int:
        return len(self._queue)
