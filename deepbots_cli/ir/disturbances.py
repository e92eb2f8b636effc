"""What pushes bodies about while an episode runs."""

from __future__ import annotations

from dataclasses import dataclass

from deepbots_cli.expressions.scalar import Const, Scalar

Vector = tuple[Scalar, Scalar, Scalar]
NOTHING: Vector = (Const(0.0), Const(0.0), Const(0.0))


@dataclass(frozen=True)
class Disturbance:
    """Pushes of a link at its origin (`link` None is the root link, or an object), in the axes of the world.

    The first begins `first` s into the episode, each further one `every` s after the one before; without `every` it is
    the only one. Force (N), torque (N m), `lasts` (s) and `every` are computed anew for each push.
    """

    name: str
    body: str
    link: str | None
    force: Vector
    torque: Vector
    first: Scalar
    every: Scalar | None
    lasts: Scalar
