"""The world, as an engine builds it."""

from __future__ import annotations

from dataclasses import dataclass

from deepbots_cli.urdf.model import Pose, RobotModel, Shape, Vector

# What one world and one reset may ask of an engine; beyond, building or resetting would take minutes.
MOST_BODIES = 500
MOST_SUBSTEPS = 10_000
MOST_SETTLING_STEPS = 100_000


@dataclass(frozen=True)
class Ground:
    """The plane z = 0; friction is Coulomb's coefficient."""

    friction: float = 1.0
    restitution: float = 0.0


@dataclass(frozen=True)
class Arena:
    """A rectangle of walls around the origin: inner size along x and y in m."""

    size: tuple[float, float]
    wall_height: float
    wall_thickness: float = 0.01
    friction: float = 1.0


@dataclass(frozen=True)
class Variant:
    """One of the forms that a pooled body may take."""

    name: str
    shape: Shape
    mass: float = 0.0
    colour: tuple[float, float, float, float] = (0.7, 0.7, 0.7, 1.0)
    friction: float = 1.0
    fixed: bool = False


@dataclass(frozen=True)
class ObjectBody:
    """A body that is no robot. Mass in kg; a fixed one never moves, one that is not solid is only seen.

    A pooled one is absent after a reset, until it is placed. With `variants` it takes the form of one of them, of the
    first unless another is chosen, and its own shape, mass, colour, friction and `fixed` mean nothing.
    """

    name: str
    shape: Shape
    pose: Pose = Pose()
    mass: float = 0.0
    colour: tuple[float, float, float, float] = (0.7, 0.7, 0.7, 1.0)
    friction: float = 1.0
    fixed: bool = False
    solid: bool = True
    pooled: bool = False
    variants: tuple[Variant, ...] = ()


@dataclass(frozen=True)
class RobotBody:
    """A robot in the world; `pose` places the origin of its root link when nothing else does."""

    name: str
    model: RobotModel
    fixed_base: bool = False
    pose: Pose = Pose()


@dataclass(frozen=True)
class WorldModel:
    """All that an engine needs. `timestep` (s) is one control tick, made of `substeps` engine steps."""

    timestep: float
    substeps: int
    gravity: Vector = (0.0, 0.0, -9.81)
    ground: Ground | None = Ground()
    arena: Arena | None = None
    robots: tuple[RobotBody, ...] = ()
    objects: tuple[ObjectBody, ...] = ()
