"""Channels of messages between one emitter and one receiver: one that delivers all, and a lossy one where the scenario asks for it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from heapq import heappop, heappush
from math import hypot, inf
from typing import Any

from deepbots_cli.expressions.scalar import Const
from deepbots_cli.frames import Triple
from deepbots_cli.program.robots import Route
from deepbots_cli.runtime.messages import Wire
from deepbots_cli.runtime.streams import Streams

_ROUNDING = 1e-9
"""In timesteps: a latency of a whole number of timesteps must not become one more by rounding."""

Where = Callable[[], tuple[Triple, Any]]


class LossyChannel:
    """Delivers messages late, in another order, or not at all.

    `receive` or `newest` is called once in each tick, after what is sent in that tick. A message that was sent in one
    tick is delivered in the first that begins at or after its arrival. A lost one leaves a gap, which is
    treated as the route says when the message would have been delivered.

    Losses are a Gilbert-Elliott chain of two states, lost and not: after a lost message the next is lost with
    1 - 1/burst, after another with loss / (burst (1 - loss)), so that the share of losses is `loss`.
    """

    latency: float
    """In s; that of the next message, as are `loss` and `range`."""
    loss: float
    range: float
    message_received: bool
    """Whether a message arrived in this timestep."""
    measured: int
    """The timestep at whose end the message that arrived last was made."""
    latest: Any
    """The encoded message that the receiver acts on: the one that arrived last, or zeros."""

    def __init__(
        self,
        name: str,
        route: Route,
        timestep: float,
        delay: int = 0,
        where: Where | None = None,
        wire: Wire | None = None,
        *,
        first_at_once: bool = False,
    ) -> None:
        """Each message takes `delay` timesteps besides its latency, but for the first one of an episode where that arrives `first_at_once`.

        `where` gives the position of the robot (m), `wire` encodes and decodes; without, messages go as they are.
        """
        self.wire = wire
        self._first_at_once = first_at_once
        self._name = name
        self._route = route
        self._rate = 1.0 / timestep
        self._delay = float(delay)
        self._where = where
        self._zeros = wire.silence if wire else None
        self._loses = route.loses
        self.range = inf
        self.latency = self.loss = 0.0
        for name, value in route.settings:
            setattr(self, name, float(value.scalar.value) if isinstance(value.scalar, Const) else 0.0)
        self._timestep = timestep
        self._queue: list[tuple[float, int, int, Any]] = []
        self.begin(Streams(0))

    def begin(self, streams: Streams) -> None:
        """Forget what is under way; `streams` gives the draws of what follows."""
        self._random = streams[f"{self._name}.loss"].random if self._loses else None
        self._queue.clear()
        self._tick = self._sent = self.measured = 0
        self._arrival = 0.0
        self._newest = -1
        self._losing: bool | None = None
        self.latest = None
        self.message_received = False
        self._begins = self._first_at_once

    @property
    def age(self) -> float:
        """Time (s) since the message that arrived last was made, at the end of a timestep."""
        return (self._tick - self.measured) * self._timestep

    def send(self, message: Any) -> None:
        """Set a message on its way, whether it will arrive or not."""
        self.transmit(self.wire.encode(message) if self.wire else message)

    def transmit(self, message: Any) -> None:
        """The same for a message that is encoded already."""
        if self._begins:
            self.latest = message
            self.message_received = True
            return
        arrival = self._tick + self._delay + max(self.latency * self._rate, 0.0)
        if self._route.order == "sent":
            arrival = self._arrival = max(arrival, self._arrival)
        heappush(self._queue, (arrival, self._sent, self._tick, None if self._is_lost() else (message,)))
        self._sent += 1

    def _is_lost(self) -> bool:
        route, lost = self._route, False
        if self._random is not None:
            share, burst = self.loss, route.burst
            if burst is None or self._losing is None or not 0.0 < share < 1.0:
                chance = share
            else:
                chance = 1.0 - 1.0 / burst if self._losing else share / (burst * (1.0 - share))
            lost = self._losing = self._random() < chance
        return lost or (route.range is not None and self._where is not None and hypot(*self._where()[0]) > self.range)

    def receive(self) -> list[Any]:
        """What the receiver takes in this timestep, in order."""
        taken = self._arrived()
        return [self.wire.decode(message) for message in taken] if self.wire else taken

    def newest(self) -> Any:
        """The message that the receiver goes by in this timestep: it arrived in this one or in an earlier one."""
        if self._begins:
            self._begins = False
        else:
            self._arrived()
        return self.wire.decode(self.latest) if self.wire else self.latest

    def _arrived(self) -> list[Any]:
        now, queue, taken = self._tick + _ROUNDING, self._queue, []
        self._tick += 1
        self.message_received = False
        while queue and queue[0][0] <= now:
            _, number, tick, parcel = heappop(queue)
            if self._route.order == "newest":
                if number < self._newest:
                    continue
                self._newest = number if parcel else self._newest
            if parcel:
                (self.latest,) = parcel
                self.measured = tick + 1
                self.message_received = True
            elif self._route.on_loss == "zero":
                self.latest = self._zeros
            if parcel or (self._route.on_loss != "skip" and self.latest is not None):
                taken.append(self.latest)
        return taken

    def __len__(self) -> int:
        """How many messages are under way."""
        return len(self._queue)


class Channel:
    """Delivers each message in the timestep in which it was sent.

    What is sent is one value per field of the layout, and so is what is received: messages are encoded on the way, decoded and checked.
    """

    def __init__(self, wire: Wire) -> None:
        self.wire = wire
        self._queue: deque[Any] = deque()
        self.transmit: Callable[[Any], None] = self._queue.append
        """Sends a message that is encoded already."""

    def send(self, message: Sequence[Any]) -> None:
        """Send one value per field."""
        self._queue.append(self.wire.encode(message))

    def receive(self) -> Sequence[Any]:
        """One value per field of the next message.

        Raises:
            MessageError: The message is not of the layout.
        """
        return self.wire.decode(self._queue.popleft())

    def begin(self, streams: Streams) -> None:
        """Forget what is under way; a reset leaves no message behind."""
        self._queue.clear()

    def __len__(self) -> int:
        return len(self._queue)
