"""Links that do not move against each other, as one body."""

from __future__ import annotations

from dataclasses import dataclass

from deepbots_cli import frames
from deepbots_cli.engines.mechanics import rigid_group
from deepbots_cli.errors import EngineError
from deepbots_cli.frames import IDENTITY_FRAME, Frame, Matrix, Triple, cross, dot, rotate, scaled, subtract
from deepbots_cli.robots.model import RobotModel

_NOTHING: Matrix = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


@dataclass(frozen=True)
class Lump:
    """Mass (kg), center of mass (m) and inertia about it (kg m^2) in the frame of the first link; where each
    link is in it."""

    name: str
    mass: float
    center: Triple
    inertia: Matrix
    members: dict[str, Frame]

    def inertia_about(self, axis: Triple) -> float:
        """About a unit axis through the origin of the first link."""
        arm = cross(axis, self.center)
        return dot(axis, self.times_inertia(axis)) + self.mass * dot(arm, arm)

    def times_inertia(self, v: Triple) -> Triple:
        return (dot(self.inertia[0], v), dot(self.inertia[1], v), dot(self.inertia[2], v))

    def inverse_inertia(self) -> Matrix:
        """Cramer's rule: of a symmetric matrix, the cross products of its rows over its determinant."""
        a, b, c = self.inertia
        volume = dot(a, cross(b, c))
        if self.mass <= 0.0 or volume <= 0.0:
            raise EngineError(
                f"'{self.name}' moves without mass or without inertia; give each of its links an inertial"
            )
        return (
            scaled(cross(b, c), 1 / volume),
            scaled(cross(c, a), 1 / volume),
            scaled(cross(a, b), 1 / volume),
        )


def joined(model: RobotModel, first: str) -> Lump:
    """The link `first` and all that fixed joints hold to it."""
    members = rigid_group(model, first)
    parts = []
    for name, place in members.items():
        inertial = model.link(name).inertial
        if inertial:
            center, turned = frames.compose(place, frames.frame(inertial.origin))
            columns = tuple(rotate(turned, axis) for axis in frames.diagonal((1.0, 1.0, 1.0)))
            turn = frames.transposed((columns[0], columns[1], columns[2]))
            parts.append((inertial.mass, center, frames.rotate_tensor(inertial.matrix, turn)))
    mass = sum(part[0] for part in parts)
    if mass <= 0.0:
        return Lump(first, 0.0, IDENTITY_FRAME[0], _NOTHING, members)
    weighted = [scaled(center, part_mass / mass) for part_mass, center, _ in parts]
    center = (sum(w[0] for w in weighted), sum(w[1] for w in weighted), sum(w[2] for w in weighted))
    tensor = _NOTHING
    for part_mass, at, own in parts:
        tensor = _plus(tensor, _plus(own, _of_point(part_mass, subtract(at, center))))
    return Lump(first, mass, center, tensor, members)


def _of_point(mass: float, at: Triple) -> Matrix:
    """Inertia of a point mass: m (|r|^2 - r r^T)."""
    x, y, z = at
    return (
        (mass * (y * y + z * z), -mass * x * y, -mass * x * z),
        (-mass * x * y, mass * (x * x + z * z), -mass * y * z),
        (-mass * x * z, -mass * y * z, mass * (x * x + y * y)),
    )


def _plus(a: Matrix, b: Matrix) -> Matrix:
    return (frames.add(a[0], b[0]), frames.add(a[1], b[1]), frames.add(a[2], b[2]))
