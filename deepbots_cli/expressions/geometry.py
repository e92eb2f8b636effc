"""Functions of the world as arithmetic over what an engine can read.

An engine supplies positions, quaternions, velocities and joints; angles, distances and turned
vectors are computed here from those, so that they mean the same on every engine.
World frame, z up; quaternions (x, y, z, w).
"""

from __future__ import annotations

from collections.abc import Callable

from deepbots_cli.expressions.fold import op
from deepbots_cli.expressions.scalar import Const, Scalar, World

_TWO = Const(2.0)


def position(body: str, axis: str) -> World:
    return World("position", (body,), axis)


def rotation(body: str, row: int, column: int) -> Scalar:
    """One entry of the matrix that turns vectors of the body into vectors of the world."""
    q = [World("orientation", (body,), axis) for axis in "xyzw"]
    w = q[3]
    if row == column:
        a, b = (q[axis] for axis in range(3) if axis != row)
        return op("sub", Const(1.0), op("mul", _TWO, op("add", op("mul", a, a), op("mul", b, b))))
    other = q[3 - row - column]
    plus = (row - column) % 3 == 1
    return op("mul", _TWO, op("add" if plus else "sub", op("mul", q[row], q[column]), op("mul", other, w)))


def local(body: str, vector: tuple[Scalar, ...]) -> tuple[Scalar, ...]:
    """A vector of the world in the axes of the body: the transposed matrix times it."""
    return tuple(op("add", *(op("mul", rotation(body, row, column), vector[row]) for row in range(3))) for column in range(3))


def roll(body: str) -> Scalar:
    return op("atan2", rotation(body, 2, 1), rotation(body, 2, 2))


def pitch(body: str) -> Scalar:
    """As an atan2 it stays exact at the poles, where an arcsine would leave its domain by rounding."""
    level = op("hypot", rotation(body, 0, 0), rotation(body, 1, 0))
    return op("atan2", op("neg", rotation(body, 2, 0)), level)


def yaw(body: str) -> Scalar:
    return op("atan2", rotation(body, 1, 0), rotation(body, 0, 0))


def tilt(body: str) -> Scalar:
    """Twice the half angle: exact near 0, where the arccosine of the matrix entry loses half its digits."""
    x, y, z, w = (World("orientation", (body,), axis) for axis in "xyzw")
    return op("mul", _TWO, op("atan2", op("hypot", x, y), op("hypot", z, w)))


def distance(body: str, other: str) -> Scalar:
    return op("hypot", *(_apart(body, other, axis) for axis in "xyz"))


def ground_distance(body: str, other: str) -> Scalar:
    return op("hypot", *(_apart(body, other, axis) for axis in "xy"))


def bearing(body: str, other: str) -> Scalar:
    """The angle between the body's forward axis and the way to the other, both seen from above."""
    ahead_x, ahead_y = rotation(body, 0, 0), rotation(body, 1, 0)
    dx, dy = _apart(body, other, "x"), _apart(body, other, "y")
    across = op("sub", op("mul", ahead_x, dy), op("mul", ahead_y, dx))
    along = op("add", op("mul", ahead_x, dx), op("mul", ahead_y, dy))
    return op("atan2", across, along)


def _apart(body: str, other: str, axis: str) -> Scalar:
    return op("sub", position(other, axis), position(body, axis))


OF_ONE: dict[str, Callable[[str], Scalar]] = {"roll": roll, "pitch": pitch, "yaw": yaw, "tilt": tilt}
OF_TWO: dict[str, Callable[[str, str], Scalar]] = {"distance": distance, "ground_distance": ground_distance, "bearing": bearing}
