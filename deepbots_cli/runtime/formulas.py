"""The functions that generated code calls for what would be long to write out.

A pose is the position (m) of a link's origin in the world and its orientation, a quaternion (x, y, z, w). What a function of the
language means is its entry in `expressions.functions`; the formulas here compute the same to the bit.
"""

from __future__ import annotations

import operator
from collections.abc import Iterable, Sequence
from functools import reduce
from math import atan2, hypot, pi, tau

from deepbots_cli.frames import Frame, Quaternion, Triple


def clamp(x: float, low: float, high: float) -> float:
    """`min(max(x, low), high)`, in a third of the time."""
    x = low if x < low else x
    return high if x > high else x


def wrap_angle(angle: float) -> float:
    """The same angle (rad), above -pi and up to pi."""
    return pi - (pi - angle) % tau


def total(values: Iterable[float]) -> float:
    """The sum of one or more values from left to right. `sum` compensates for rounding from Python 3.12 on."""
    return reduce(operator.add, values)


# The mapping of observations and actions to [-1, 1]


def scale(value: float, low: float, high: float) -> float:
    """Map [low, high] to [-1, 1], and what is beyond to its ends.

    Raises:
        FloatingPointError: The value is not a number.
    """
    scaled = (value - (high + low) / 2) * (1 / ((high - low) / 2))
    return scaled if -1.0 <= scaled <= 1.0 else clip(scaled)


def scale_each(values: Iterable[float], low: float, high: float) -> list[float]:
    """Map each value as `scale` does."""
    middle, factor = (high + low) / 2, 1 / ((high - low) / 2)
    if middle == 0.0:
        return [x if -1.0 <= (x := value * factor) <= 1.0 else clip(x) for value in values]
    return [x if -1.0 <= (x := (value - middle) * factor) <= 1.0 else clip(x) for value in values]


def scale_freely(value: float, low: float, high: float) -> float:
    """Map [low, high] to [-1, 1], and what is beyond to beyond.

    Raises:
        FloatingPointError: The result is not finite, or too large for a float32.
    """
    scaled = (value - (high + low) / 2) * (1 / ((high - low) / 2))
    if not -1e30 < scaled < 1e30:
        raise FloatingPointError(f"an observation of {scaled}")
    return scaled


def clip(value: float) -> float:
    """The value within [-1, 1].

    Raises:
        FloatingPointError: The value is not a number.
    """
    if -1.0 <= value <= 1.0:
        return value
    if value != value:
        raise FloatingPointError("not a number")
    return 1.0 if value > 0.0 else -1.0


# Poses


def distance(pose: Frame, other: Frame) -> float:
    """The distance (m) between two origins."""
    (x, y, z), (to_x, to_y, to_z) = pose[0], other[0]
    return hypot(to_x - x, to_y - y, to_z - z)


def ground_distance(pose: Frame, other: Frame) -> float:
    """The distance (m) between two origins in the plane."""
    (x, y, _), (to_x, to_y, _) = pose[0], other[0]
    return hypot(to_x - x, to_y - y)


def bearing(pose: Frame, other: Frame) -> float:
    """The horizontal angle (rad) from straight ahead to the other origin; left is positive."""
    (x, y, _), (to_x, to_y, _) = pose[0], other[0]
    ahead_x, ahead_y = _ahead(pose[1])
    dx, dy = to_x - x, to_y - y
    return atan2(ahead_x * dy - ahead_y * dx, ahead_x * dx + ahead_y * dy)


def roll(pose: Frame) -> float:
    """The turn about the forward axis (rad)."""
    x, y, z, w = pose[1]
    return atan2(2.0 * (z * y + x * w), 1.0 - 2.0 * (x * x + y * y))


def pitch(pose: Frame) -> float:
    """The turn about the sideways axis (rad); nose down is positive."""
    x, y, z, w = pose[1]
    ahead_x, ahead_y = _ahead(pose[1])
    return atan2(-(2.0 * (z * x - y * w)), hypot(ahead_x, ahead_y))


def yaw(pose: Frame) -> float:
    """The turn about the vertical (rad); left is positive."""
    ahead_x, ahead_y = _ahead(pose[1])
    return atan2(ahead_y, ahead_x)


def tilt(pose: Frame) -> float:
    """The angle (rad) between the link's own vertical and that of the world."""
    x, y, z, w = pose[1]
    return 2.0 * atan2(hypot(x, y), hypot(z, w))


def local(pose: Frame, vector: Sequence[float]) -> Triple:
    """A vector of the world as seen from the body: the transposed rotation matrix times the vector."""
    x, y, z, w = pose[1]
    a, b, c = vector
    return (
        (1.0 - 2.0 * (y * y + z * z)) * a + 2.0 * (y * x + z * w) * b + 2.0 * (z * x - y * w) * c,
        2.0 * (x * y - z * w) * a + (1.0 - 2.0 * (x * x + z * z)) * b + 2.0 * (z * y + x * w) * c,
        2.0 * (x * z + y * w) * a + 2.0 * (y * z - x * w) * b + (1.0 - 2.0 * (x * x + y * y)) * c,
    )


def _ahead(turn: Quaternion) -> tuple[float, float]:
    """The body's forward axis, seen from above: the first column of the rotation matrix."""
    x, y, z, w = turn
    return 1.0 - 2.0 * (y * y + z * z), 2.0 * (y * x + z * w)
