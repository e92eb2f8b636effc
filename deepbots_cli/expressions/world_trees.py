"""Scalar trees of functions of the world, over readings of the engine: the same on every engine.

The world frame has z up; a body has x forward, y left and z up. Angles are in radians.
"""

from __future__ import annotations

from deepbots_cli.expressions.scalar import Const, EngineRead, Op, Scalar
from deepbots_cli.expressions.types import QUATERNION


def _op(name: str, *args: Scalar) -> Op:
    return Op(name, args)


def _position(body: str, axis: str) -> EngineRead:
    return EngineRead("position", (body,), axis)


def _quaternion(body: str) -> tuple[EngineRead, ...]:
    return tuple(EngineRead("orientation", (body,), axis) for axis in QUATERNION)


def rotation(body: str, row: int, column: int) -> Scalar:
    """Return one entry of the matrix that turns vectors of the body into vectors of the world."""
    q = _quaternion(body)
    two = Const(2.0)
    if row == column:
        a, b = (q[axis] for axis in range(3) if axis != row)
        return _op("sub", Const(1.0), _op("mul", two, _op("add", _op("mul", a, a), _op("mul", b, b))))
    third = q[3 - row - column]
    sign = "add" if (row - column) % 3 == 1 else "sub"
    return _op("mul", two, _op(sign, _op("mul", q[row], q[column]), _op("mul", third, q[3])))


def roll(body: str) -> Scalar:
    return _op("atan2", rotation(body, 2, 1), rotation(body, 2, 2))


def pitch(body: str) -> Scalar:
    """Return the pitch as an atan2, which is exact at the poles, where rounding takes an arcsine out of its
    domain."""
    level = _op("hypot", rotation(body, 0, 0), rotation(body, 1, 0))
    return _op("atan2", _op("neg", rotation(body, 2, 0)), level)


def yaw(body: str) -> Scalar:
    return _op("atan2", rotation(body, 1, 0), rotation(body, 0, 0))


def tilt(body: str) -> Scalar:
    """Return twice the half angle, which is exact near 0, where the arccosine of the matrix entry loses half
    its digits."""
    x, y, z, w = _quaternion(body)
    return _op("mul", Const(2.0), _op("atan2", _op("hypot", x, y), _op("hypot", z, w)))


def _apart(body: str, target: str, axis: str) -> Scalar:
    return _op("sub", _position(target, axis), _position(body, axis))


def distance(body: str, target: str) -> Scalar:
    return _op("hypot", *(_apart(body, target, axis) for axis in "xyz"))


def ground_distance(body: str, target: str) -> Scalar:
    return _op("hypot", *(_apart(body, target, axis) for axis in "xy"))


def bearing(body: str, target: str) -> Scalar:
    """Return the angle between the body's forward axis and the line to the other, both seen from above."""
    ahead_x, ahead_y = rotation(body, 0, 0), rotation(body, 1, 0)
    dx, dy = _apart(body, target, "x"), _apart(body, target, "y")
    across = _op("sub", _op("mul", ahead_x, dy), _op("mul", ahead_y, dx))
    along = _op("add", _op("mul", ahead_x, dx), _op("mul", ahead_y, dy))
    return _op("atan2", across, along)
