"""Interval arithmetic: closed intervals that contain every possible result, infinite if nothing is known."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

INF = math.inf


class Interval(NamedTuple):
    """All numbers from `low` to `high`, both included; either may be infinite.

    Rules make thousands of them for each scenario; a tuple takes half the time of a frozen dataclass.
    """

    low: float = -INF
    high: float = INF

    def __contains__(self, value: Any) -> bool:
        return bool(self.low <= value <= self.high)

    @property
    def is_finite(self) -> bool:
        return self.low > -INF and self.high < INF

    @property
    def is_single(self) -> bool:
        """Whether only one number is left, as for a constant."""
        return self.low == self.high

    def is_within(self, other: Interval) -> bool:
        return other.low <= self.low and self.high <= other.high


EVERYTHING = Interval()
POSITIVE = Interval(0.0, INF)
SIGNED_UNIT = Interval(-1.0, 1.0)
TRUTH = Interval(0.0, 1.0)
HALF_TURN = Interval(0.0, math.pi)
QUARTER_TURNS = Interval(-math.pi / 2, math.pi / 2)
TURN = Interval(-math.pi, math.pi)
ZERO = Interval(0.0, 0.0)
NEVER, ALWAYS = ZERO, Interval(1.0, 1.0)
"""Truth values as numbers: never true, and always."""


def _interval(low: float, high: float) -> Interval:
    """Return the interval; a bound that is not a number (inf - inf) becomes infinite."""
    return Interval(low if low == low else -INF, high if high == high else INF)


def _times(a: float, b: float) -> float:
    return 0.0 if a == 0.0 or b == 0.0 else a * b


def evaluate_with_default(function: Callable[..., float], *args: float, beyond: float = INF) -> float:
    """Return the value of a math function; `beyond` where it overflows or is not defined."""
    try:
        return function(*args)
    except (OverflowError, ZeroDivisionError, ValueError):
        return beyond


def single(value: float) -> Interval:
    return Interval(value, value)


def hull(intervals: Sequence[Interval]) -> Interval:
    """Return the smallest interval that contains all of them."""
    return Interval(min(i.low for i in intervals), max(i.high for i in intervals))


def negate(a: Interval) -> Interval:
    return Interval(-a.high, -a.low)


def add(a: Interval, b: Interval, *more: Interval) -> Interval:
    total = _interval(a.low + b.low, a.high + b.high)
    return add(total, *more) if more else total


def subtract(a: Interval, b: Interval) -> Interval:
    return _interval(a.low - b.high, a.high - b.low)


def multiply(a: Interval, b: Interval) -> Interval:
    (p, q), (r, s) = a, b
    corners = (p * r, p * s, q * r, q * s)
    # 0 times infinity is 0 here. The sum is also NaN for infinities of both signs, which stay.
    if math.isnan(sum(corners)):
        corners = (_times(p, r), _times(p, s), _times(q, r), _times(q, s))
    return Interval(min(corners), max(corners))


def divide(a: Interval, b: Interval) -> Interval:
    if 0.0 in b:
        return EVERYTHING
    corners = [x / y for x in a for y in b]  # a product with 1 / y may differ from them in the last digit
    if math.isnan(sum(corners)):
        return multiply(a, Interval(1.0 / b.high, 1.0 / b.low))
    return Interval(min(corners), max(corners))


def power(a: Interval, exponent: Interval) -> Interval:
    if not exponent.is_single or not exponent.is_finite:
        return POSITIVE if a.low >= 0.0 else EVERYTHING
    n = exponent.low
    # A fraction as exponent has no real value below 0. For a base below 0, an even power falls; over the
    # absolute value it only rises.
    if not n.is_integer():
        a = Interval(max(a.low, 0.0), max(a.high, 0.0))
    elif n % 2.0 == 0.0:
        a = absolute(a)
    if n < 0.0 and 0.0 in a:
        return EVERYTHING
    # `math.pow` raises OverflowError; an odd power that overflows has the sign of its base.
    ends = (
        evaluate_with_default(math.pow, a.low, n, beyond=-INF if a.low < 0.0 else INF),
        evaluate_with_default(math.pow, a.high, n, beyond=INF if a.high > 0.0 else -INF),
    )
    return Interval(min(ends), max(ends))


def absolute(a: Interval) -> Interval:
    if 0.0 in a:
        return Interval(0.0, max(-a.low, a.high))
    return Interval(*sorted((abs(a.low), abs(a.high))))


def apply_monotone(function: Callable[[float], float], a: Interval) -> Interval:
    """Return the image under a function that never falls; infinite where the function overflows."""
    return Interval(
        evaluate_with_default(function, a.low, beyond=-INF if a.low < 0.0 else INF),
        evaluate_with_default(function, a.high),
    )


def square_root(a: Interval) -> Interval:
    return apply_monotone(math.sqrt, Interval(max(a.low, 0.0), max(a.high, 0.0)))


def logarithm(a: Interval) -> Interval:
    return apply_monotone(lambda x: math.log(x) if x > 0.0 else -INF, a)


def sine(a: Interval) -> Interval:
    return _wave(math.sin, math.pi / 2, a)


def cosine(a: Interval) -> Interval:
    return _wave(math.cos, 0.0, a)


def _wave(function: Callable[[float], float], peak: float, a: Interval) -> Interval:
    """Return the values at both ends, and the peaks and troughs between them."""
    # At 1e6, neighboring doubles are 1e-10 apart, and `_passes` loses digits.
    if not a.is_finite or a.high - a.low >= 2 * math.pi or max(abs(a.low), abs(a.high)) > 1e6:
        return SIGNED_UNIT
    extremes = [-1.0] * _passes(a, peak - math.pi) + [1.0] * _passes(a, peak)
    return hull([single(value) for value in (function(a.low), function(a.high), *extremes)])


def tangent(a: Interval) -> Interval:
    # The tangent rises between its poles at -pi / 2 and pi / 2.
    inside = -math.pi / 2 < a.low and a.high < math.pi / 2
    return apply_monotone(math.tan, a) if inside else EVERYTHING


def _passes(a: Interval, angle: float) -> bool:
    """Return whether `angle` plus some whole turns lies in `a`."""
    return angle + math.ceil((a.low - angle) / (2 * math.pi)) * 2 * math.pi <= a.high


def wrap_angle(a: Interval) -> Interval:
    if not a.is_within(TURN) or a.low == -math.pi:  # -pi becomes pi
        return TURN
    return Interval(*(math.pi - (math.pi - end) % math.tau for end in a))  # as `formulas.wrap_angle` rounds


def minimum(*intervals: Interval) -> Interval:
    return Interval(min(i.low for i in intervals), min(i.high for i in intervals))


def maximum(*intervals: Interval) -> Interval:
    return Interval(max(i.low for i in intervals), max(i.high for i in intervals))


def clamp(a: Interval, low: Interval, high: Interval) -> Interval:
    return minimum(maximum(a, low), high)


def where(condition: Interval, a: Interval, b: Interval) -> Interval:
    """Return `a` where the condition holds, otherwise `b`."""
    if condition.low > 0.0:
        return a
    if condition.high <= 0.0:
        return b
    return hull((a, b))


def hypot(*parts: Interval) -> Interval:
    """Return the square root of a sum of squares."""
    sizes = [absolute(part) for part in parts]
    return Interval(
        evaluate_with_default(math.hypot, *(s.low for s in sizes)),
        evaluate_with_default(math.hypot, *(s.high for s in sizes)),
    )


def atan2(y: Interval, x: Interval) -> Interval:
    """Return the angle of the point (x, y), without the half planes where the point cannot lie."""
    if y.low < 0.0 or (y.low == 0.0 and x.low < 0.0):  # the angle of (-1, -0.0) is -pi
        return QUARTER_TURNS if x.low >= 0.0 else TURN
    if y == x == ZERO:
        return TURN  # the angle of (-0.0, 0.0) is pi
    if y == ZERO and x.low >= 0.0:
        return ZERO
    return Interval(0.0, math.pi / 2) if x.low >= 0.0 else HALF_TURN


def _truth(sure: bool, out: bool) -> Interval:
    if sure:
        return ALWAYS
    if out:
        return NEVER
    return TRUTH


def less(a: Interval, b: Interval) -> Interval:
    return _truth(a.high < b.low, a.low >= b.high)


def less_equal(a: Interval, b: Interval) -> Interval:
    return _truth(a.high <= b.low, a.low > b.high)


def equal(a: Interval, b: Interval) -> Interval:
    # Infinity also stands for an unknown value, so two infinities need not be equal.
    return _truth(a.is_single and a == b and abs(a.low) < INF, a.high < b.low or b.high < a.low)
