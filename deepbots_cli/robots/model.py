"""A robot as data: links, joints, limits, inertia; mass and inertia of simple shapes in closed form.

SI units; rpy in rad, fixed axes x, y, z as in URDF.

Frozen and free of places in the text, so that it can stand in the compiled scenario and be hashed;
`reader.RobotFile` holds the places.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

from deepbots_cli import frames
from deepbots_cli.frames import Matrix

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

    @property
    def matrix(self) -> Matrix:
        """The inertia as a symmetric matrix."""
        return ((self.ixx, self.ixy, self.ixz), (self.ixy, self.iyy, self.iyz), (self.ixz, self.iyz, self.izz))

    @property
    def is_plausible(self) -> bool:
        """Whether a rigid body can have this inertia: positive definite, and no principal moment above the sum of the others.

        The second holds exactly if the second moments of the mass, J = tr(I)/2 - I, are positive semidefinite.
        """
        tensor = self.matrix
        trace = tensor[0][0] + tensor[1][1] + tensor[2][2]
        if trace <= 0:
            return False
        unit = scaled(tensor, 1 / trace)
        return _is_positive(unit, 0.0) and _is_positive(second_moments(unit), _TOLERANCE)


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

    def subtree_mass(self) -> dict[str, float]:
        """For each link by name, the mass (kg) of the link and of everything below it."""
        mass = {link.name: link.inertial.mass if link.inertial else 0.0 for link in self.links}
        below: dict[str, list[str]] = {name: [] for name in mass}
        for joint in self.joints:
            below[joint.parent].append(joint.child)
        order = [self.root]
        for link in order:  # parents first; a chain of links may be longer than Python's stack
            order += below[link]
        for link in reversed(order):
            mass[link] += sum(mass[child] for child in below[link])
        return mass


# Simple shapes: inertia in kg m^2 about the centre of mass, in axes parallel to the shape's own

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


# As URDF text

Lines = list[str]
# `quoteattr` of the standard library does the same, and imports 66 modules, `urllib` and `email` among them.
_ESCAPES = str.maketrans({"&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;", "\n": "&#10;", "\r": "&#13;", "\t": "&#9;"})


def write(model: RobotModel) -> str:
    """The model as URDF text: one element per line, floats to the last digit, meshes by the path that the model holds.

    `reader.read_bytes(write(model).encode(), ...)` gives the same model again. This text, never the user's own file, is what an engine
    loads.
    """
    colours: dict[Colour, str] = {}
    links = [line for link in model.links for line in _link(link, colours)]
    joints = [line for joint in model.joints for line in _joint(joint)]
    return "\n".join(['<?xml version="1.0" encoding="utf-8"?>', *_element("robot", [*links, *joints], name=model.name), ""])


def _element(tag: str, inside: Lines | None = None, **attributes: str | float | tuple[float, ...] | None) -> Lines:
    """An element with the lines inside it; attributes that are None are left out."""
    written = [f" {name}={_value(value)}" for name, value in attributes.items() if value is not None]
    if inside is None:
        return [f"<{tag}{''.join(written)}/>"]
    return [f"<{tag}{''.join(written)}>", *(f"  {line}" for line in inside), f"</{tag}>"]


def _value(value: str | float | tuple[float, ...]) -> str:
    text = value if isinstance(value, str) else " ".join(map(repr, value if isinstance(value, tuple) else (value,)))
    return f'"{text.translate(_ESCAPES)}"'


def _link(link: Link, colours: dict[Colour, str]) -> Lines:
    inside = _inertial(link.inertial) if link.inertial else []
    for tag, geometries in (("visual", link.visuals), ("collision", link.collisions)):
        for geometry in geometries:
            inside += _geometry(tag, geometry, colours)
    return _element("link", inside + _friction(link.friction), name=link.name)


def _inertial(inertial: Inertial) -> Lines:
    i = inertial
    moments = _element("inertia", ixx=i.ixx, ixy=i.ixy, ixz=i.ixz, iyy=i.iyy, iyz=i.iyz, izz=i.izz)
    return _element("inertial", [*_origin(i.origin), *_element("mass", value=i.mass), *moments])


def _origin(pose: Pose) -> Lines:
    return _element("origin", xyz=pose.xyz, rpy=pose.rpy)


def _geometry(tag: str, geometry: Geometry, colours: dict[Colour, str]) -> Lines:
    inside = [*_origin(geometry.origin), *_element("geometry", _shape(geometry.shape))]
    if geometry.colour:
        # Engines look materials up by name in the whole file: one name must mean one colour.
        name = colours.setdefault(geometry.colour, f"colour_{len(colours)}")
        inside += _element("material", _element("color", rgba=geometry.colour), name=name)
    return _element(tag, inside)


def _shape(shape: Shape) -> Lines:
    match shape:
        case Box(size):
            return _element("box", size=size)
        case Sphere(radius):
            return _element("sphere", radius=radius)
        case Cylinder(radius, length):
            return _element("cylinder", radius=radius, length=length)
        case Capsule(radius, length):
            return _element("capsule", radius=radius, length=length)
        case Mesh(path, _, scale):
            return _element("mesh", filename=path, scale=scale)


def _friction(friction: Friction) -> Lines:
    values = {
        "lateral_friction": friction.lateral,
        "spinning_friction": friction.spinning,
        "rolling_friction": friction.rolling,
        "restitution": friction.restitution,
    }
    inside = [line for tag, value in values.items() if value is not None for line in _element(tag, value=value)]
    return _element("contact", inside) if inside else []


def _joint(joint: Joint) -> Lines:
    inside = [
        *_origin(joint.origin),
        *_element("parent", link=joint.parent),
        *_element("child", link=joint.child),
        *_element("axis", xyz=joint.axis),
    ]
    limit = joint.limit
    if limit != Limit():
        inside += _element("limit", lower=limit.lower, upper=limit.upper, velocity=limit.velocity, effort=limit.effort)
    if joint.damping or joint.friction:
        inside += _element("dynamics", damping=joint.damping, friction=joint.friction)
    if joint.mimic:
        inside += _element("mimic", joint=joint.mimic.joint, multiplier=joint.mimic.multiplier, offset=joint.mimic.offset)
    return _element("joint", inside, name=joint.name, type=joint.type)
