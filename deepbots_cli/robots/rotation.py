"""The little linear algebra that robots as data need: 3 by 3 matrices as tuples of rows; roll, pitch, yaw as a quaternion."""

from __future__ import annotations

import math

from deepbots_cli.robots.model import Vector

Matrix = tuple[Vector, Vector, Vector]


def from_rpy(rpy: Vector) -> Matrix:
    """The rotation from the child's axes to the parent's: yaw about z, after pitch about y, after roll about x."""
    roll, pitch, yaw = rpy
    cr, sr, cp, sp, cy, sy = math.cos(roll), math.sin(roll), math.cos(pitch), math.sin(pitch), math.cos(yaw), math.sin(yaw)
    return (
        (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        (-sp, cp * sr, cp * cr),
    )


def quaternion(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """The same rotation as (x, y, z, w)."""
    (sr, cr), (sp, cp), (sy, cy) = ((math.sin(angle / 2), math.cos(angle / 2)) for angle in (roll, pitch, yaw))
    return (sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy, cr * cp * cy + sr * sp * sy)


def transposed(m: Matrix) -> Matrix:
    return ((m[0][0], m[1][0], m[2][0]), (m[0][1], m[1][1], m[2][1]), (m[0][2], m[1][2], m[2][2]))


def product(a: Matrix, b: Matrix) -> Matrix:
    columns = transposed(b)
    return (_row(a[0], columns), _row(a[1], columns), _row(a[2], columns))


def _row(row: Vector, columns: Matrix) -> Vector:
    return (dot(row, columns[0]), dot(row, columns[1]), dot(row, columns[2]))


def dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def turned(m: Matrix, r: Matrix) -> Matrix:
    """The tensor `m`, given in the axes of the child, in those of the parent: r m r^T."""
    return product(product(r, m), transposed(r))


def diagonal(v: Vector) -> Matrix:
    return ((v[0], 0.0, 0.0), (0.0, v[1], 0.0), (0.0, 0.0, v[2]))
