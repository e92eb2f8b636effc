"""What stateful functions of the language remember from one timestep to the next.

`update` is called once per timestep, whether or not its value is used. The first call of an episode, with what holds right after the
reset, is `begin`, and every other is `advance`. All take the arguments that the function has in the language.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any


class Memory(ABC):
    """The memory of one number or truth value; `timestep` in s."""

    update: Callable[..., Any]

    def __init__(self, timestep: float) -> None:
        self.timestep = timestep
        self.reset()

    def reset(self) -> None:
        """Forget the last episode."""
        self.kept: Any = None
        self.update = self._begin

    def _begin(self, *arguments: Any) -> Any:
        self.update = self.advance
        return self.begin(*arguments)

    def begin(self, x: Any, *others: Any) -> Any:
        """Keep the first value; most functions give it back."""
        self.kept = x
        return x

    @abstractmethod
    def advance(self, *arguments: Any) -> Any:
        """The value in this timestep."""


class Delta(Memory):
    """The change since the previous timestep; 0 at a reset."""

    def begin(self, x: float, start: float | None = None) -> Any:
        self.kept = x if start is None else start
        return 0.0

    def advance(self, x: float, start: float | None = None) -> Any:
        change: float = x - self.kept
        self.kept = x
        return change


class Previous(Memory):
    """The value in the previous timestep."""

    def begin(self, x: Any, start: Any = None) -> Any:
        self.kept = x if start is None else start
        return self.kept

    def advance(self, x: Any, start: Any = None) -> Any:
        before, self.kept = self.kept, x
        return before


class RunningMax(Memory):
    """The largest value since the reset."""

    def advance(self, x: float) -> Any:
        self.kept = max(self.kept, x)
        return self.kept


class RunningMin(Memory):
    """The smallest value since the reset."""

    def advance(self, x: float) -> Any:
        self.kept = min(self.kept, x)
        return self.kept


class Hold(Memory):
    """The value when the condition last held, or at the reset."""

    def advance(self, x: Any, condition: bool) -> Any:
        if condition:
            self.kept = x
        return self.kept


class Smooth(Memory):
    """A first-order low-pass filter with the time constant `tau` (s), as backward Euler has it."""

    def advance(self, x: float, tau: float) -> Any:
        self.kept += (x - self.kept) * (self.timestep / (tau + self.timestep))
        return self.kept


class Integral(Memory):
    """The integral over time since the reset."""

    def begin(self, x: float) -> Any:
        self.kept = 0.0
        return 0.0

    def advance(self, x: float) -> Any:
        self.kept += x * self.timestep
        return self.kept


class Accumulate(Memory):
    """The running sum of increments, limited to the range."""

    def begin(self, increment: float, low: float, high: float, start: float) -> Any:
        self.kept = start
        return start

    def advance(self, increment: float, low: float, high: float, start: float) -> Any:
        self.kept = min(max(self.kept + increment, low), high)
        return self.kept


class Duration(Memory):
    """How long (s) the condition has held without a break."""

    def begin(self, condition: bool) -> Any:
        self.kept = 0.0
        return 0.0

    def advance(self, condition: bool) -> Any:
        self.kept = self.kept + self.timestep if condition else 0.0
        return self.kept


class Rising(Memory):
    """Whether the condition has just become true."""

    def begin(self, condition: bool) -> bool:
        self.kept = condition
        return False

    def advance(self, condition: bool) -> bool:
        before, self.kept = self.kept, condition
        return condition and not before
