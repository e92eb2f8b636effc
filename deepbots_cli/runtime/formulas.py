"""The functions that generated code calls instead of long expressions.

A pose is the position (m) of a link's origin in the world and its orientation, a quaternion (x, y, z, w). The
meaning of a function of the language is its entry in `expressions.functions`; the formulas here compute the
same to the bit.
"""

from __future__ import annotations

import math
import operator
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from functools import reduce
from math import pi, tau
from typing import Any, ClassVar

from deepbots_cli.frames import Frame, Quaternion, Triple

_SUM_COMPENSATES = sys.version_info >= (3, 12)


def clamp(x: float, low: float, high: float) -> float:
    """Return `min(max(x, low), high)`, in a third of the time."""
    x = low if x < low else x
    return high if x > high else x


def wrap_angle(angle: float) -> float:
    """Return the same angle (rad), above -pi and up to pi."""
    return pi - (pi - angle) % tau


def total(values: Iterable[float]) -> float:
    """Return the sum of one or more values from left to right; `sum` is five times as fast, but from Python
    3.12 on compensates for rounding."""
    # From -0.0, because 0.0 + -0.0 is 0.0, and `reduce` keeps the sign.
    return reduce(operator.add, values) if _SUM_COMPENSATES else sum(values, -0.0)


# The mapping of observations and actions to [-1, 1]


def scale(value: float, low: float, high: float) -> float:
    """Map [low, high] to [-1, 1]; a value outside becomes -1 or 1.

    Raises:
        FloatingPointError: The value is not a number.
    """
    scaled = (value - (high + low) / 2) * (1 / ((high - low) / 2))
    return scaled if -1.0 <= scaled <= 1.0 else clip(scaled)


def scale_each(values: Iterable[float], low: float, high: float) -> list[float]:
    """Map each value as `scale` does."""
    middle, factor = (high + low) / 2, 1 / ((high - low) / 2)
    # x - 0.0 is x to the bit, so that the result is that of the general case.
    if middle == 0.0:
        return [x if -1.0 <= (x := value * factor) <= 1.0 else clip(x) for value in values]
    return [x if -1.0 <= (x := (value - middle) * factor) <= 1.0 else clip(x) for value in values]


def scale_freely(value: float, low: float, high: float) -> float:
    """Map [low, high] to [-1, 1], and values beyond to values beyond.

    Raises:
        FloatingPointError: The result is not finite, or too large for a float32.
    """
    scaled = (value - (high + low) / 2) * (1 / ((high - low) / 2))
    if not -1e30 < scaled < 1e30:
        raise FloatingPointError(f"an observation of {scaled}")
    return scaled


def clip(value: float) -> float:
    """Return the value within [-1, 1].

    Raises:
        FloatingPointError: The value is not a number.
    """
    if -1.0 <= value <= 1.0:
        return value
    if value != value:
        raise FloatingPointError("not a number")
    return 1.0 if value > 0.0 else -1.0


# Poses


def pose_functions(atan2: Callable[..., Any], hypot: Callable[..., Any]) -> tuple[Callable[..., Any], ...]:
    """Return functions for distance, distance in the plane, bearing, roll, pitch, yaw and tilt, of numbers or
    of columns by the given functions."""

    def distance(pose: Frame, target: Frame) -> Any:
        """Return the distance (m) between two origins."""
        (x, y, z), (to_x, to_y, to_z) = pose[0], target[0]
        return hypot(to_x - x, to_y - y, to_z - z)

    def ground_distance(pose: Frame, target: Frame) -> Any:
        """Return the distance (m) between two origins in the plane."""
        (x, y, _), (to_x, to_y, _) = pose[0], target[0]
        return hypot(to_x - x, to_y - y)

    def bearing(pose: Frame, target: Frame) -> Any:
        """Return the horizontal angle (rad) from straight ahead to the other origin; left is positive."""
        (x, y, _), (to_x, to_y, _) = pose[0], target[0]
        ahead_x, ahead_y = _ahead(pose[1])
        dx, dy = to_x - x, to_y - y
        return atan2(ahead_x * dy - ahead_y * dx, ahead_x * dx + ahead_y * dy)

    def roll(pose: Frame) -> Any:
        """Return the turn about the forward axis (rad)."""
        x, y, z, w = pose[1]
        return atan2(2.0 * (z * y + x * w), 1.0 - 2.0 * (x * x + y * y))

    def pitch(pose: Frame) -> Any:
        """Return the turn about the sideways axis (rad); nose down is positive."""
        x, y, z, w = pose[1]
        ahead_x, ahead_y = _ahead(pose[1])
        # `asin` has no value where rounding leads beyond 1.
        return atan2(-(2.0 * (z * x - y * w)), hypot(ahead_x, ahead_y))

    def yaw(pose: Frame) -> Any:
        """Return the turn about the vertical (rad); left is positive."""
        ahead_x, ahead_y = _ahead(pose[1])
        return atan2(ahead_y, ahead_x)

    def tilt(pose: Frame) -> Any:
        """Return the angle (rad) between the link's own vertical and that of the world."""
        x, y, z, w = pose[1]
        # `acos` of the cosine would lose half of the digits near 0.
        return 2.0 * atan2(hypot(x, y), hypot(z, w))

    return distance, ground_distance, bearing, roll, pitch, yaw, tilt


distance, ground_distance, bearing, roll, pitch, yaw, tilt = pose_functions(math.atan2, math.hypot)


def to_body_frame(pose: Frame, vector: Sequence[float]) -> Triple:
    """Return a vector of the world as seen from the body: the transposed rotation matrix times the vector."""
    x, y, z, w = pose[1]
    a, b, c = vector
    xx, yy, zz, xy, xz, yz, xw, yw, zw = x * x, y * y, z * z, x * y, x * z, y * z, x * w, y * w, z * w
    return (
        (1.0 - 2.0 * (yy + zz)) * a + 2.0 * (xy + zw) * b + 2.0 * (xz - yw) * c,
        2.0 * (xy - zw) * a + (1.0 - 2.0 * (xx + zz)) * b + 2.0 * (yz + xw) * c,
        2.0 * (xz + yw) * a + 2.0 * (yz - xw) * b + (1.0 - 2.0 * (xx + yy)) * c,
    )


def _ahead(turn: Quaternion) -> tuple[float, float]:
    """Return the body's forward axis, seen from above: the first column of the rotation matrix."""
    x, y, z, w = turn
    return 1.0 - 2.0 * (y * y + z * z), 2.0 * (y * x + z * w)


class Memory(ABC):
    """The memory of a stateful function of the language for one number or truth value; `timestep` in s.

    `update` is called once per timestep, whether or not its value is used. The first call of an episode, with
    the values right after the reset, is `begin`, and every other is `advance`. All take the arguments that
    the function has in the language. A memory `on_message` has no value before the first message: its first
    call begins with the values of that message and advances.
    """

    update: Callable[..., Any]

    def __init__(self, timestep: float, *, on_message: bool = False) -> None:
        self.timestep = timestep
        self.first_update = self.begin_and_advance if on_message else self.begin
        self.reset()

    def reset(self) -> None:
        """Forget the last episode."""
        self.kept: Any = None
        self.update = self._begin

    def _begin(self, *arguments: Any) -> Any:
        self.update = self.advance
        return self.first_update(*arguments)

    def begin_and_advance(self, *arguments: Any) -> Any:
        """Return the first value, if no value was known at the reset."""
        self.begin(*arguments)
        return self.advance(*arguments)

    def begin(self, x: Any, *arguments: Any) -> Any:
        """Keep the first value; most functions give it back."""
        self.kept = x
        return x

    @abstractmethod
    def advance(self, *arguments: Any) -> Any:
        """Return the value in this timestep."""


class Memories:
    """One memory for each component of a vector; `update` takes and returns vectors."""

    def __init__(self, kind: type[Memory], count: int, timestep: float, *, on_message: bool = False) -> None:
        self.component = kind
        self.count = count
        self.timestep = timestep
        self.parts = [kind(timestep, on_message=on_message) for _ in range(count)]
        self._advance = [memory.advance for memory in self.parts]
        self.reset()

    def reset(self) -> None:
        """Forget the last episode."""
        for memory in self.parts:
            memory.reset()
        self._update: list[Callable[..., Any]] = [memory.first_update for memory in self.parts]

    @property
    def kept(self) -> list[Any]:
        """The value that each of them keeps."""
        return [memory.kept for memory in self.parts]

    def update(self, *arguments: Iterable[Any]) -> list[Any]:
        """Return the value of each component in this timestep; one vector per argument that the function has
        in the language."""
        update, self._update = self._update, self._advance
        return list(map(operator.call, update, *arguments))


def memory_of_vector(
    kind: type[Memory], count: int, timestep: float, *, on_message: bool = False
) -> Memory | Memories:
    """Return the memory of a stateful function for a vector of `count` components; `update` takes and returns
    vectors."""
    vector_memory = _VECTOR_MEMORIES.get(kind)
    return (
        Memories(kind, count, timestep, on_message=on_message)
        if vector_memory is None
        else vector_memory(count, timestep, on_message=on_message)
    )


class Delta(Memory):
    """The change since the previous timestep; 0 at a reset."""

    def begin(self, x: Any, start: Any = None) -> Any:
        self.kept = x if start is None else start
        return 0.0

    def advance(self, x: Any, start: Any = None) -> Any:
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


class LowPass(Memory):
    """A first-order low-pass filter with the time constant `tau` (s), discretized with the backward Euler
    method."""

    def advance(self, x: float, tau: float) -> Any:
        self.kept = self.kept + (x - self.kept) * (self.timestep / (tau + self.timestep))
        return self.kept


class Integral(Memory):
    """The integral over time since the reset."""

    def begin(self, x: float) -> Any:
        self.kept = 0.0
        return 0.0

    def advance(self, x: float) -> Any:
        self.kept = self.kept + x * self.timestep
        return self.kept


class Accumulate(Memory):
    """The running sum of increments, limited to the range."""

    @staticmethod
    def limit(value: Any, low: Any, high: Any) -> Any:
        return clamp(value, low, high)

    def begin(self, increment: float, low: float, high: float, start: float) -> Any:
        self.kept = self.limit(start, low, high)
        return self.kept

    def advance(self, increment: float, low: float, high: float, start: float) -> Any:
        self.kept = self.limit(self.kept + increment, low, high)
        return self.kept


class Duration(Memory):
    """The time (s) for which the condition has held without a break."""

    def begin(self, condition: Any) -> Any:
        self.kept = 0.0
        return 0.0

    def advance(self, condition: Any) -> Any:
        self.kept = self.kept + self.timestep if condition else 0.0
        return self.kept


class RisingEdge(Memory):
    """Whether the condition has just become true."""

    def begin(self, condition: Any) -> Any:
        self.kept = condition
        return False

    def advance(self, condition: Any) -> Any:
        before, self.kept = self.kept, condition
        return condition > before  # True is greater than False


class VectorMemory(Memory):
    """The memory of a stateful function for a whole vector. It takes between 1/70 and 1/2 of the time of a
    memory for each component."""

    component: ClassVar[type[Memory]]
    """The memory of a single component, which gives the same values."""

    def __init__(self, count: int, timestep: float, *, on_message: bool = False) -> None:
        self.count = count
        super().__init__(timestep, on_message=on_message)


class DeltaOfVector(VectorMemory, Delta):
    """The change of each component since the previous timestep; 0 at a reset."""

    component = Delta

    def begin(self, x: Sequence[float], start: Sequence[float] | None = None) -> Any:
        super().begin(x, start)
        return [0.0] * self.count

    def advance(self, x: Sequence[float], start: Sequence[float] | None = None) -> Any:
        before, self.kept = self.kept, x
        return list(map(operator.sub, x, before))


class PreviousOfVector(VectorMemory, Previous):
    """Each component in the previous timestep."""

    component = Previous


class RisingEdgeOfVector(VectorMemory, RisingEdge):
    """Whether the condition of each component has just become true."""

    component = RisingEdge

    def begin(self, condition: Sequence[bool]) -> Any:
        super().begin(condition)
        return [False] * self.count

    def advance(self, condition: Sequence[bool]) -> Any:
        before, self.kept = self.kept, condition
        return list(map(operator.gt, condition, before))


class DurationOfVector(VectorMemory, Duration):
    """The time (s) for which the condition of each component has held without a break."""

    component = Duration

    def begin(self, condition: Sequence[bool]) -> Any:
        self.kept = [0.0] * self.count
        return self.kept

    def advance(self, condition: Sequence[bool]) -> Any:
        step = self.timestep
        self.kept = [time + step if holds else 0.0 for time, holds in zip(self.kept, condition, strict=True)]
        return self.kept


_VECTOR_MEMORIES: dict[type[Memory], type[VectorMemory]] = {
    kind.component: kind for kind in (DeltaOfVector, PreviousOfVector, RisingEdgeOfVector, DurationOfVector)
}
