"""A robot as data: links, joints, limits, inertia. SI units; rpy in rad, fixed axes x, y, z as in URDF.

Frozen and free of places in the text, so that it can stand in the compiled scenario and be hashed;
`reader.RobotFile` holds the places.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

Vector = tuple[float, float, float]
Colour = tuple[float, float, float, float]
"""Red, green, blue and alpha, 0 to 1."""
JointType = Literal["revolute", "continuous", "prismatic", "fixed", "floating", "planar"]
ZERO: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Pose:
    """A frame in its parent: translation in m, then roll, pitch, yaw in rad."""

    xyz: Vector = ZERO
    rpy: Vector = ZERO


@dataclass(frozen=True)
class Box:
    size: Vector


@dataclass(frozen=True)
class Sphere:
    radius: float


@dataclass(frozen=True)
class Cylinder:
    """Along the local z axis."""

    radius: float
    length: float


@dataclass(frozen=True)
class Capsule:
    """A cylinder of `length` along z with a half sphere on either end."""

    radius: float
    length: float


@dataclass(frozen=True)
class Mesh:
    """A triangle mesh: the resolved path of the file, its digest (sha256, hex) and the scale per axis."""

    path: str
    digest: str
    scale: Vector = (1.0, 1.0, 1.0)


Shape = Box | Sphere | Cylinder | Capsule | Mesh


@dataclass(frozen=True)
class Inertial:
    """Mass in kg; inertia about the centre of mass in the frame `origin`, in kg m^2."""

    mass: float
    origin: Pose = Pose()
    ixx: float = 0.0
    ixy: float = 0.0
    ixz: float = 0.0
    iyy: float = 0.0
    iyz: float = 0.0
    izz: float = 0.0


@dataclass(frozen=True)
class Geometry:
    """A shape placed on a link, for drawing or for contact."""

    shape: Shape
    origin: Pose = Pose()
    colour: Colour | None = None


@dataclass(frozen=True)
class Friction:
    """Contact parameters of a link. None means not stated: engines take 1 for `lateral` and 0 for the others."""

    lateral: float | None = None
    spinning: float | None = None
    rolling: float | None = None
    restitution: float | None = None


@dataclass(frozen=True)
class Link:
    name: str
    inertial: Inertial | None = None
    visuals: tuple[Geometry, ...] = ()
    collisions: tuple[Geometry, ...] = ()
    friction: Friction = Friction()
    density: float | None = None
    """kg/m^3, of a link whose mesh gives its inertial when it is simulated (`deepbots_cli.geometry`)."""


@dataclass(frozen=True)
class Limit:
    """Joint limits: rad or m, rad/s or m/s, N m or N. `lower > upper` never occurs: None means unlimited."""

    lower: float | None = None
    upper: float | None = None
    velocity: float | None = None
    effort: float | None = None


@dataclass(frozen=True)
class Mimic:
    joint: str
    multiplier: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class Joint:
    """`axis` is a unit vector in the joint frame; damping in N m s/rad or N s/m, friction in N m or N."""

    name: str
    type: JointType
    parent: str
    child: str
    origin: Pose = Pose()
    axis: Vector = (1.0, 0.0, 0.0)
    limit: Limit = Limit()
    damping: float = 0.0
    friction: float = 0.0
    mimic: Mimic | None = None

    @property
    def moves(self) -> bool:
        """Whether the joint has exactly one degree of freedom, which an actuator may drive."""
        return self.type in ("revolute", "continuous", "prismatic")


@dataclass(frozen=True)
class RobotModel:
    """A tree of links joined by joints, both in file order; `root` is the one link without parent."""

    name: str
    links: tuple[Link, ...]
    joints: tuple[Joint, ...]
    root: str = field(default="")

    def link(self, name: str) -> Link:
        return next(link for link in self.links if link.name == name)

    def joint(self, name: str) -> Joint:
        return next(joint for joint in self.joints if joint.name == name)

    @property
    def moving_joints(self) -> tuple[Joint, ...]:
        return tuple(joint for joint in self.joints if joint.moves)
