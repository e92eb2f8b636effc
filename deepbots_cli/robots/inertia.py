"""Mass, volume and inertia of simple shapes in closed form.

Inertia is in kg m^2 about the centre of mass, in axes parallel to the shape's own.
"""

from __future__ import annotations

import math

from deepbots_cli import frames
from deepbots_cli.frames import Matrix
from deepbots_cli.robots.model import Box, Capsule, Cylinder, Inertial, Mesh, Pose, RobotModel, Shape, Sphere

_HERE = Pose()
# Published files round to three digits, and a flat plate lies exactly on the boundary.
_TOLERANCE = 1e-3


def volume(shape: Shape) -> float | None:
    """In m^3; None for a mesh, which may not be closed."""
    match shape:
        case Box((x, y, z)):
            return x * y * z
        case Sphere(r):
            return 4 / 3 * math.pi * r * r * r
        case Cylinder(r, length):
            return math.pi * r * r * length
        case Capsule(r, length):
            return math.pi * r * r * (length + 4 / 3 * r)
        case Mesh():
            return None


def homogeneous(shape: Shape, mass: float, origin: Pose = _HERE) -> Inertial | None:
    """The inertial of a homogeneous body of `mass` kg whose shape has the pose `origin`; None for a mesh."""
    match shape:
        case Box((x, y, z)):
            return Inertial(mass, origin, ixx=mass / 12 * (y * y + z * z), iyy=mass / 12 * (x * x + z * z), izz=mass / 12 * (x * x + y * y))
        case Sphere(r):
            moment = 2 / 5 * mass * r * r
            return Inertial(mass, origin, ixx=moment, iyy=moment, izz=moment)
        case Cylinder(r, length):
            across = mass / 12 * (3 * r * r + length * length)
            return Inertial(mass, origin, ixx=across, iyy=across, izz=mass / 2 * r * r)
        case Capsule(r, length):
            middle = mass * length / (length + 4 / 3 * r)
            ends = mass - middle
            across = middle / 12 * (3 * r * r + length * length) + ends * (2 / 5 * r * r + length * length / 4 + 3 / 8 * length * r)
            return Inertial(mass, origin, ixx=across, iyy=across, izz=middle / 2 * r * r + ends * 2 / 5 * r * r)
        case Mesh():
            return None


def is_plausible(inertial: Inertial) -> bool:
    """Whether a rigid body can have this inertia: positive definite, and no principal moment above the sum of the others.

    The second holds exactly if the second moments of the mass, J = tr(I)/2 - I, are positive semidefinite.
    """
    tensor = matrix(inertial)
    trace = tensor[0][0] + tensor[1][1] + tensor[2][2]
    if trace <= 0:
        return False
    unit = scaled(tensor, 1 / trace)
    return _is_positive(unit, 0.0) and _is_positive(second_moments(unit), _TOLERANCE)


def matrix(inertial: Inertial) -> Matrix:
    """The inertia as a symmetric matrix."""
    i = inertial
    return ((i.ixx, i.ixy, i.ixz), (i.ixy, i.iyy, i.iyz), (i.ixz, i.iyz, i.izz))


def second_moments(tensor: Matrix) -> Matrix:
    """J = tr(I)/2 - I, the integral of r r^T over the mass."""
    return _trace_minus(tensor, 0.5)


def from_second_moments(moments: Matrix) -> Matrix:
    """I = tr(J) - J, the inverse of `second_moments`."""
    return _trace_minus(moments, 1.0)


def scaled(m: Matrix, factor: float) -> Matrix:
    return (frames.scaled(m[0], factor), frames.scaled(m[1], factor), frames.scaled(m[2], factor))


def _trace_minus(m: Matrix, share: float) -> Matrix:
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = m
    trace = share * (xx + yy + zz)
    return ((trace - xx, -xy, -xz), (-xy, trace - yy, -yz), (-xz, -yz, trace - zz))


def _is_positive(m: Matrix, shift: float) -> bool:
    """Whether `m` plus `shift` on the diagonal is positive definite (Sylvester)."""
    (a, d, e), (_, b, f), (_, _, c) = m
    a, b, c = a + shift, b + shift, c + shift
    return a > 0 and a * b - d * d > 0 and a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e) > 0


def subtree_mass(model: RobotModel) -> dict[str, float]:
    """For each link by name, the mass (kg) of the link and of everything below it."""
    mass = {link.name: link.inertial.mass if link.inertial else 0.0 for link in model.links}
    below: dict[str, list[str]] = {name: [] for name in mass}
    for joint in model.joints:
        below[joint.parent].append(joint.child)
    order = [model.root]
    for link in order:  # parents first; a chain of links may be longer than Python's stack
        order += below[link]
    for link in reversed(order):
        mass[link] += sum(mass[child] for child in below[link])
    return mass
