"""Vectors, frames, and rotations as quaternions (x, y, z, w) and as 3 by 3 matrices, in plain floats: faster
than numpy on so few numbers."""

from __future__ import annotations

from math import asin, atan2, copysign, cos, hypot, pi, sin
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from deepbots_cli.robots.model import Pose

Triple = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Matrix = tuple[Triple, Triple, Triple]
"""Rows of a 3 by 3 matrix."""
Frame = tuple[Triple, Quaternion]
"""A frame in another: its origin (m) and its rotation."""

IDENTITY_ROTATION: Quaternion = (0.0, 0.0, 0.0, 1.0)


_VERTICAL = 1 - 1e-9
"""The sine of the pitch, 45 microradians from 90 degrees, above which roll and yaw are noise: at exactly 90
degrees, a pole came out turned by 0.4 rad."""

IDENTITY_FRAME: Frame = ((0.0, 0.0, 0.0), IDENTITY_ROTATION)


def quaternion(roll: float, pitch: float, yaw: float) -> Quaternion:
    """Return the rotation by roll about x, then pitch about y, then yaw about z (rad), all of them fixed
    axes."""
    roll, pitch, yaw = roll / 2, pitch / 2, yaw / 2
    sr, cr, sp, cp, sy, cy = sin(roll), cos(roll), sin(pitch), cos(pitch), sin(yaw), cos(yaw)
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


def from_axis_angle(axis: Triple, angle: float) -> Quaternion:
    """Return the rotation by `angle` (rad) about a unit axis."""
    s = sin(angle / 2)
    return (axis[0] * s, axis[1] * s, axis[2] * s, cos(angle / 2))


def multiply(a: Quaternion, b: Quaternion) -> Quaternion:
    """Return the rotation by `b`, then by `a`."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def inverse(q: Quaternion) -> Quaternion:
    """Return the inverse of a unit quaternion."""
    return (-q[0], -q[1], -q[2], q[3])


def wxyz(q: Quaternion) -> Quaternion:
    """Return a quaternion as MuJoCo and viser write it, with w first."""
    return (q[3], q[0], q[1], q[2])


def roll_pitch_yaw(q: Quaternion) -> Triple:
    """Return roll, pitch and yaw (rad) of a unit quaternion, about the fixed axes x, y and z in this
    order.

    Where the pitch is 90 or -90 degrees, only the difference or the sum of roll and yaw counts: the roll is
    0.
    """
    x, y, z, w = q
    sin_pitch = 2 * (w * y - z * x)
    if abs(sin_pitch) > _VERTICAL:
        return 0.0, copysign(pi / 2, sin_pitch), atan2(2 * (w * z - x * y), 1 - 2 * (x * x + z * z))
    roll = atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    # Rounding may take the sine beyond 1, where `asin` raises ValueError; `_VERTICAL` excludes that.
    return roll, asin(sin_pitch), atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def normalized(q: Quaternion) -> Quaternion:
    length = hypot(*q)
    return (q[0] / length, q[1] / length, q[2] / length, q[3] / length)


def yaw_only(rotation: Quaternion) -> Quaternion:
    """Return the yaw of a rotation alone; the identity where its forward axis is vertical."""
    x, y, _ = rotate(rotation, (1.0, 0.0, 0.0))
    # Below 1e-9, the direction in the plane is rounding alone.
    return quaternion(0.0, 0.0, atan2(y, x) if hypot(x, y) > 1e-9 else 0.0)


def cross(a: Triple, b: Triple) -> Triple:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def dot(a: Triple, b: Triple) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def add(a: Triple, b: Triple) -> Triple:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def subtract(a: Triple, b: Triple) -> Triple:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def scaled(a: Triple, factor: float) -> Triple:
    return (a[0] * factor, a[1] * factor, a[2] * factor)


def mean(vectors: Sequence[Triple]) -> Triple:
    """Return the mean of vectors, summed in their order; 0 of none."""
    x = y = z = 0.0
    for vector in vectors:
        x, y, z = x + vector[0], y + vector[1], z + vector[2]
    count = max(len(vectors), 1)
    return x / count, y / count, z / count


def rotate(q: Quaternion, v: Triple) -> Triple:
    """Return `v` turned by a unit quaternion: v + 2 u x (u x v + w v), with u the vector part and w the
    rest."""
    x, y, z, w = q
    tx = 2.0 * (y * v[2] - z * v[1])
    ty = 2.0 * (z * v[0] - x * v[2])
    tz = 2.0 * (x * v[1] - y * v[0])
    return (v[0] + w * tx + y * tz - z * ty, v[1] + w * ty + z * tx - x * tz, v[2] + w * tz + x * ty - y * tx)


def rotate_back(q: Quaternion, v: Triple) -> Triple:
    """Return `v` turned by the inverse of a unit quaternion."""
    x, y, z, w = q
    tx = 2.0 * (z * v[1] - y * v[2])
    ty = 2.0 * (x * v[2] - z * v[0])
    tz = 2.0 * (y * v[0] - x * v[1])
    return (v[0] + w * tx - y * tz + z * ty, v[1] + w * ty - z * tx + x * tz, v[2] + w * tz - x * ty + y * tx)


def frame(pose: Pose) -> Frame:
    return pose.xyz, quaternion(*pose.rpy)


def compose(outer: Frame, inner: Frame) -> Frame:
    """Return the frame `inner`, given relative to `outer`, in the frame that `outer` is relative to."""
    return add(outer[0], rotate(outer[1], inner[0])), multiply(outer[1], inner[1])


# Matrices


def rotation_matrix(rpy: Triple) -> Matrix:
    """Return the rotation of `quaternion(*rpy)`, from the child's axes to the parent's."""
    roll, pitch, yaw = rpy
    cr, sr, cp, sp, cy, sy = cos(roll), sin(roll), cos(pitch), sin(pitch), cos(yaw), sin(yaw)
    return (
        (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        (-sp, cp * sr, cp * cr),
    )


def transposed(m: Matrix) -> Matrix:
    return ((m[0][0], m[1][0], m[2][0]), (m[0][1], m[1][1], m[2][1]), (m[0][2], m[1][2], m[2][2]))


def product(a: Matrix, b: Matrix) -> Matrix:
    x, y, z = transposed(b)
    rows = [(dot(row, x), dot(row, y), dot(row, z)) for row in a]
    return (rows[0], rows[1], rows[2])


def rotate_tensor(m: Matrix, r: Matrix) -> Matrix:
    """Return the tensor `m` in the axes of the parent, from that in the axes of the child: r m r^T."""
    return product(product(r, m), transposed(r))


def diagonal(v: Triple) -> Matrix:
    return ((v[0], 0.0, 0.0), (0.0, v[1], 0.0), (0.0, 0.0, v[2]))
