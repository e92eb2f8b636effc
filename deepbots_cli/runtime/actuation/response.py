"""Commands on their way to an actuator: delayed, lagging, changing only so fast."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from math import ceil, exp

Origin = Callable[[], Sequence[float]]
_EARLY = 1e-9  # of a substep; what a sum of durations may be off


class Response:
    """What of its commands an actuator follows, from substep to substep.

    A command takes effect in the first substep that begins `delay` after it was sent, or later. From there on what is
    followed approaches it: in a substep of h seconds by the share 1 - exp(-h / lag) of what is left, which is a lag of
    first order exactly, and by at most `rate` * h. It starts from what `origin` says when the first command takes effect.

    `delay` and `lag` are in s, `rates` in units of the command per s, one per component; they are in force from the
    next `reset`. A negative one, such as a normal distribution may draw, counts as 0.
    """

    def __init__(self, substep: float, origin: Origin, delay: float = 0.0, lag: float = 0.0, rates: Sequence[float] = ()) -> None:
        """`substep` is the length of one, s; without `rates` a command may jump."""
        self.delay = delay
        self.lag = lag
        self._substep = substep
        self._origin = origin
        self._most = [rate * substep for rate in rates]
        self._sent: deque[tuple[int, Sequence[float]]] = deque()
        self.reset()

    def reset(self) -> None:
        """No command was ever sent."""
        self._sent.clear()
        self._now = 0
        self._wait = max(0, ceil(self.delay / self._substep - _EARLY))
        self._share = 1.0 - exp(-self._substep / self.lag) if self.lag > 0.0 else 1.0
        self._jumps = self._share == 1.0 and not self._most
        self._goal: Sequence[float] = ()
        self._value: Sequence[float] | None = None
        self._still = True

    def start(self, value: Sequence[float]) -> None:
        """What is followed now, before any command."""
        self._value = value

    def send(self, command: Sequence[float]) -> None:
        self._sent.append((self._now + self._wait, command))

    def advance(self) -> Sequence[float] | None:
        """What is followed in the substep that begins now; None where that is what it was in the last one, or nothing."""
        sent = self._sent
        while sent and sent[0][0] <= self._now:
            self._goal = sent.popleft()[1]
            self._still = False
        self._now += 1
        if self._still:
            return None
        if self._jumps:
            self._still = True
            return self._goal
        before, share = self._origin() if self._value is None else self._value, self._share
        after = [old + share * (goal - old) for old, goal in zip(before, self._goal, strict=True)]
        if self._most:
            after = [
                old + most if new - old > most else old - most if new - old < -most else new
                for old, new, most in zip(before, after, self._most, strict=True)
            ]
        self._still = self._value is not None and after == before
        self._value = after
        return after
