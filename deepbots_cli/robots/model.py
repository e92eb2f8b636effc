"""A robot as data: links, joints, limits, inertia; inertia of simple shapes in closed form; URDF text; pure
functions that change it.

SI units; rpy in rad, fixed axes x, y, z as in URDF.

The model is frozen and has no positions in the text, so that it can be part of the compiled scenario and be
hashed; `reader.RobotFile` has the positions.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import field, fields, replace
from functools import cached_property
from typing import Literal

from deepbots_cli import frames
from deepbots_cli.frames import Matrix, diagonal, product, rotate_tensor, rotation_matrix, transposed
from deepbots_cli.records import dataclass

Vector = tuple[float, float, float]
Color = tuple[float, float, float, float]
"""Red, green, blue and alpha, 0 to 1."""
JointType = Literal["revolute", "continuous", "prismatic", "fixed", "floating", "planar"]
ZERO: Vector = (0.0, 0.0, 0.0)
WATER = 1000.0
"""The density of water, kg/m^3, for links that state no mass."""
_TRACE_INERTIA = 1e-18  # kg m^2; a grain of dust of 1 ug and 0.1 mm has 1e-17


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
    """A cylinder along the local z axis."""

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
    """Mass in kg; inertia about the center of mass in the frame `origin`, in kg m^2."""

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
        return (
            (self.ixx, self.ixy, self.ixz),
            (self.ixy, self.iyy, self.iyz),
            (self.ixz, self.iyz, self.izz),
        )

    @property
    def is_stated(self) -> bool:
        """Whether there is a mass and an inertia above rounding; an engine makes up an inertia of zeros."""
        return self.mass > 0.0 and max(self.ixx, self.iyy, self.izz) > _TRACE_INERTIA

    @property
    def is_plausible(self) -> bool:
        """Whether a rigid body can have this inertia: positive definite, and no principal moment above the
        sum of the others.

        The second is true exactly if the second moments of the mass, J = tr(I)/2 - I, are positive
        semidefinite.
        """
        tensor = self.matrix
        trace = tensor[0][0] + tensor[1][1] + tensor[2][2]
        if trace <= 0:
            return False
        unit = scaled_matrix(tensor, 1 / trace)
        return _is_positive(unit, 0.0) and _is_positive(second_moments(unit), _TOLERANCE)


@dataclass(frozen=True)
class Geometry:
    """A shape placed on a link, for drawing or for contact."""

    shape: Shape
    origin: Pose = Pose()
    color: Color | None = None


FRICTION_TAGS = ("lateral_friction", "spinning_friction", "rolling_friction", "restitution")
"""The elements of a robot file with the fields of `Friction`."""


@dataclass(frozen=True)
class Friction:
    """Contact parameters of a link. None means not stated: engines take 1 for `lateral` and 0 for the
    others."""

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
    """The density in kg/m^3 of a link whose mesh gives its inertial when it is simulated
    (`deepbots_cli.geometry`)."""
    center_varies: bool = False
    """Whether episodes move its center of mass."""

    @property
    def mass(self) -> float:
        """The mass in kg; 0 without an inertial."""
        return self.inertial.mass if self.inertial else 0.0

    def digest_fields(self) -> dict[str, object]:
        """Return the fields; `center_varies` is left out where it is false, as in digests from before it was
        a field."""
        return _without_default(self, "center_varies")


@dataclass(frozen=True)
class Limit:
    """Joint limits: rad or m, rad/s or m/s, N m or N. `lower > upper` never occurs: None means unlimited."""

    lower: float | None = None
    upper: float | None = None
    velocity: float | None = None
    effort: float | None = None


@dataclass(frozen=True)
class Mimic:
    """The position of a joint is `multiplier * position of the leader + offset`; the leader is `joint`."""

    joint: str
    multiplier: float = 1.0
    offset: float = 0.0

    def position(self, leader: float) -> float:
        """Return the position (rad or m) of the follower for a position of the leader."""
        return self.multiplier * leader + self.offset


@dataclass(frozen=True)
class Joint:
    """`axis` is a unit vector in the joint frame; damping in N m s/rad or N s/m, friction in N m or N,
    armature (inertia of the rotor) in kg m^2 or kg, for which URDF has no element."""

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
    armature: float = 0.0

    def digest_fields(self) -> dict[str, object]:
        """Return the fields; an armature of 0 is left out, as in digests from before it was a field."""
        return _without_default(self, "armature")

    @property
    def moves(self) -> bool:
        """Whether the joint has exactly one degree of freedom, which an actuator may drive."""
        return self.type in ("revolute", "continuous", "prismatic")

    def ends(self, unlimited: float) -> tuple[float, float]:
        """Return the lower and the upper limit (rad or m); an absent one is `unlimited` away from 0."""
        limit = Limit() if self.type == "continuous" else self.limit
        return (
            -unlimited if limit.lower is None else limit.lower,
            unlimited if limit.upper is None else limit.upper,
        )


def _without_default(part: Link | Joint, name: str) -> dict[str, object]:
    """Return the fields of a part by name; without the one called `name` where it has its default."""
    members = {entry.name: getattr(part, entry.name) for entry in fields(part)}
    return members if members[name] else {key: value for key, value in members.items() if key != name}


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

    @cached_property
    def followers(self) -> dict[str, Mimic]:
        """The moving joints that follow another one, each with the joint at the end of its chain, which
        follows none."""
        names = {joint.name for joint in self.moving_joints}
        mimics = {
            joint.name: joint.mimic
            for joint in self.moving_joints
            if joint.mimic is not None and joint.mimic.joint in names
        }
        followers = {}
        for name, mimic in mimics.items():
            while (above := mimics.get(mimic.joint)) is not None:
                mimic = Mimic(above.joint, mimic.multiplier * above.multiplier, mimic.position(above.offset))
            followers[name] = mimic
        return followers

    def followers_of(self, leader: str) -> dict[str, Mimic]:
        """Return the joints that follow this one."""
        return {name: mimic for name, mimic in self.followers.items() if mimic.joint == leader}

    def links_below(self, first: str, *, rigid: bool = False) -> list[str]:
        """Return a link and the links that it carries; `rigid` leaves out those behind a joint that moves."""
        links = [first]
        for link in links:
            links += [
                joint.child
                for joint in self.joints
                if joint.parent == link and (joint.type == "fixed" or not rigid)
            ]
        return links

    @property
    def mass(self) -> float:
        """The mass of all links in kg."""
        return sum(link.mass for link in self.links)

    @cached_property
    def joints_below(self) -> dict[str, list[Joint]]:
        """The joints that begin at each link."""
        below: dict[str, list[Joint]] = {link.name: [] for link in self.links}
        for joint in self.joints:
            below[joint.parent].append(joint)
        return below

    def subtree_mass(self) -> dict[str, float]:
        """Return for each link by name the mass (kg) of the link and of everything below it."""
        mass = {link.name: link.mass for link in self.links}
        order = [self.root]
        for link in order:  # parents first; a chain of links may be longer than Python's stack
            order += [joint.child for joint in self.joints_below[link]]
        for link in reversed(order):
            mass[link] += sum(mass[joint.child] for joint in self.joints_below[link])
        return mass


# Simple shapes: inertia in kg m^2 about the center of mass, in axes parallel to the shape's own

_IDENTITY_POSE = Pose()
# Published files round to three digits, and a flat plate lies exactly on the boundary.
_TOLERANCE = 1e-3


def volume(shape: Shape) -> float | None:
    """Return the volume in m^3; None for a mesh, which may not be closed."""
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


def homogeneous_inertial(shape: Shape, mass: float, origin: Pose = _IDENTITY_POSE) -> Inertial | None:
    """Return the inertial of a homogeneous body of `mass` kg whose shape has the pose `origin`; None for a
    mesh."""
    match shape:
        case Box((x, y, z)):
            return Inertial(
                mass,
                origin,
                ixx=mass / 12 * (y * y + z * z),
                iyy=mass / 12 * (x * x + z * z),
                izz=mass / 12 * (x * x + y * y),
            )
        case Sphere(r):
            moment = 2 / 5 * mass * r * r
            return Inertial(mass, origin, ixx=moment, iyy=moment, izz=moment)
        case Cylinder(r, length):
            across = mass / 12 * (3 * r * r + length * length)
            return Inertial(mass, origin, ixx=across, iyy=across, izz=mass / 2 * r * r)
        case Capsule(r, length):
            middle = mass * length / (length + 4 / 3 * r)
            ends = mass - middle
            # A half ball has its center 3/8 r from its flat face; about the middle by the parallel axis
            # theorem.
            across = middle / 12 * (3 * r * r + length * length) + ends * (
                2 / 5 * r * r + length * length / 4 + 3 / 8 * length * r
            )
            return Inertial(
                mass, origin, ixx=across, iyy=across, izz=middle / 2 * r * r + ends * 2 / 5 * r * r
            )
        case Mesh():
            return None


def combined(parts: Sequence[Inertial]) -> Inertial:
    """Return the inertial of several bodies as one, in axes parallel to those of the link; one body stays as
    it is."""
    if len(parts) == 1:
        return parts[0]
    mass = sum(part.mass for part in parts)
    x, y, z = (
        sum(part.mass * part.origin.xyz[axis] for part in parts) / mass if mass > 0.0 else 0.0
        for axis in range(3)
    )
    total = [[0.0] * 3 for _ in range(3)]
    for part in parts:
        own = rotate_tensor(part.matrix, rotation_matrix(part.origin.rpy))
        offset = frames.subtract(part.origin.xyz, (x, y, z))
        away = frames.dot(offset, offset)
        for row, column in itertools.product(range(3), repeat=2):
            # The parallel axis theorem: m (|d|^2 1 - d d^T).
            steiner = away * (row == column) - offset[row] * offset[column]
            total[row][column] += own[row][column] + part.mass * steiner
    (ixx, ixy, ixz), (_, iyy, iyz), (_, _, izz) = total
    return Inertial(mass, Pose((x, y, z)), ixx=ixx, ixy=ixy, ixz=ixz, iyy=iyy, iyz=iyz, izz=izz)


def second_moments(tensor: Matrix) -> Matrix:
    """Return J = tr(I)/2 - I, the integral of r r^T over the mass."""
    return _trace_minus(tensor, 0.5)


def scaled_matrix(m: Matrix, factor: float) -> Matrix:
    return (frames.scaled(m[0], factor), frames.scaled(m[1], factor), frames.scaled(m[2], factor))


def _trace_minus(m: Matrix, share: float) -> Matrix:
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = m
    trace = share * (xx + yy + zz)
    return ((trace - xx, -xy, -xz), (-xy, trace - yy, -yz), (-xz, -yz, trace - zz))


def _is_positive(m: Matrix, shift: float) -> bool:
    """Return whether `m` plus `shift` on the diagonal is positive definite (Sylvester)."""
    (a, d, e), (_, b, f), (_, _, c) = m
    a, b, c = a + shift, b + shift, c + shift
    return a > 0 and a * b - d * d > 0 and a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e) > 0


# As URDF text

Lines = list[str]
# `quoteattr` of the standard library does the same, and imports 66 modules, `urllib` and `email` among them.
XML_ESCAPES = str.maketrans(
    {"&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;", "\n": "&#10;", "\r": "&#13;", "\t": "&#9;"}
)


def to_urdf(model: RobotModel) -> str:
    """Return the model as URDF text: one element per line, floats to the last digit, meshes by the path in
    the model.

    `reader.read_bytes(to_urdf(model).encode(), ...)` gives an equal model, except for fields that URDF lacks,
    such as the armature, and for a maximum velocity or effort of 0, which is read as none. Engines load this
    text, never the user's own file.
    """
    colors: dict[Color, str] = {}
    links = [line for link in model.links for line in _link(link, colors)]
    joints = [line for joint in model.joints for line in _joint(joint)]
    return "\n".join(
        ['<?xml version="1.0" encoding="utf-8"?>', *_element("robot", [*links, *joints], name=model.name), ""]
    )


def _element(
    tag: str, inside: Lines | None = None, **attributes: str | float | tuple[float, ...] | None
) -> Lines:
    """Return an element with the lines inside it; attributes that are None are left out."""
    attribute_texts = [f" {name}={_value(value)}" for name, value in attributes.items() if value is not None]
    if inside is None:
        return [f"<{tag}{''.join(attribute_texts)}/>"]
    return [f"<{tag}{''.join(attribute_texts)}>", *(f"  {line}" for line in inside), f"</{tag}>"]


def _value(value: str | float | tuple[float, ...]) -> str:
    numbers = value if isinstance(value, tuple) else (value,)
    # The shortest text of the same float.
    text = value if isinstance(value, str) else " ".join(map(repr, numbers))
    return f'"{text.translate(XML_ESCAPES)}"'


def _link(link: Link, colors: dict[Color, str]) -> Lines:
    inside = _inertial(link.inertial) if link.inertial else []
    for tag, geometries in (("visual", link.visuals), ("collision", link.collisions)):
        for geometry in geometries:
            inside += _geometry(tag, geometry, colors)
    return _element("link", inside + _friction(link.friction), name=link.name)


def _inertial(inertial: Inertial) -> Lines:
    i = inertial
    moments = _element("inertia", ixx=i.ixx, ixy=i.ixy, ixz=i.ixz, iyy=i.iyy, iyz=i.iyz, izz=i.izz)
    return _element("inertial", [*_origin(i.origin), *_element("mass", value=i.mass), *moments])


def _origin(pose: Pose) -> Lines:
    return _element("origin", xyz=pose.xyz, rpy=pose.rpy)


def _geometry(tag: str, geometry: Geometry, colors: dict[Color, str]) -> Lines:
    inside = [*_origin(geometry.origin), *_element("geometry", _shape(geometry.shape))]
    if geometry.color:
        # Engines look materials up by name in the whole file: one name must mean one color.
        name = colors.setdefault(geometry.color, f"color_{len(colors)}")
        inside += _element("material", _element("color", rgba=geometry.color), name=name)
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
    values = zip(
        FRICTION_TAGS,
        (friction.lateral, friction.spinning, friction.rolling, friction.restitution),
        strict=True,
    )
    inside = [line for tag, value in values if value is not None for line in _element(tag, value=value)]
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
        lower, upper = limit.lower, limit.upper
        if (lower is None) is not (upper is None):
            # An absent bound is 0 in URDF.
            lower, upper = -math.inf if lower is None else lower, math.inf if upper is None else upper
        inside += _element("limit", lower=lower, upper=upper, velocity=limit.velocity, effort=limit.effort)
    if joint.damping or joint.friction:
        inside += _element("dynamics", damping=joint.damping, friction=joint.friction)
    if joint.mimic:
        inside += _element(
            "mimic", joint=joint.mimic.joint, multiplier=joint.mimic.multiplier, offset=joint.mimic.offset
        )
    return _element("joint", inside, name=joint.name, type=joint.type)


# Changes: an impossible one returns a sentence with the reason. The link or joint must exist: callers report
# unknown names

_ALIGNMENT_TOLERANCE = 1e-4


def with_link(model: RobotModel, link: Link) -> RobotModel:
    """Return `model` with `link` in place of the link of the same name."""
    return replace(model, links=tuple(link if old.name == link.name else old for old in model.links))


def with_mass(model: RobotModel, link: str, mass: float) -> RobotModel | str:
    """Return the link with `mass` kg; its inertia grows in proportion, as if the material were denser."""
    old = model.link(link)
    if old.inertial is None or old.inertial.mass <= 0:
        return f"the mass of link {link!r} cannot be changed, because {_missing(old, 'no mass')}"
    if not (math.isfinite(mass) and mass > 0):
        return f"the mass of link {link!r} must be above 0"
    tensor = scaled_matrix(old.inertial.matrix, mass / old.inertial.mass)
    return with_link(model, replace(old, inertial=_with_matrix(replace(old.inertial, mass=mass), tensor)))


def with_center(model: RobotModel, link: str, offset: Vector) -> RobotModel | str:
    """Return the link with its center of mass moved by `offset` (m, axes of the link); the inertia about it
    stays."""
    old = model.link(link)
    if old.inertial is None or old.inertial.mass <= 0:
        return f"the center of mass of link {link!r} cannot be moved, because {_missing(old, 'no mass')}"
    origin = replace(old.inertial.origin, xyz=frames.add(old.inertial.origin.xyz, offset))
    return with_link(model, replace(old, inertial=replace(old.inertial, origin=origin)))


def with_inertia(model: RobotModel, link: str, factor: float) -> RobotModel | str:
    """Return the link with its inertia about the center of mass multiplied by `factor`; the mass stays."""
    old = model.link(link)
    if old.inertial is None or not old.inertial.is_stated:
        return f"the inertia of link {link!r} cannot be scaled, because {_missing(old, 'none')}"
    tensor = scaled_matrix(old.inertial.matrix, factor)
    return with_link(model, replace(old, inertial=_with_matrix(old.inertial, tensor)))


def _missing(link: Link, absent: str) -> str:
    """Return the reason why a link has no inertial that can be changed."""
    if link.density is None:
        return f"the robot file states {absent}"
    return "a `density` gives the mass of a mesh only when it is simulated; write `mass` in its place"


def with_density(model: RobotModel, link: str, density: float) -> RobotModel | str:
    """Return the link as a homogeneous body of `density` kg/m^3; the mass of a mesh is computed when it is
    simulated."""
    old = model.link(link)
    shapes = old.collisions or old.visuals
    if not shapes:
        return f"link {link!r} has no shape, and a density needs one; write its `mass` instead"
    solids = [
        homogeneous_inertial(piece.shape, density * (volume(piece.shape) or 0.0), piece.origin)
        for piece in shapes
    ]
    parts = [solid for solid in solids if solid is not None]
    if len(parts) < len(solids):
        return with_link(model, replace(old, inertial=None, density=density))
    return with_link(model, replace(old, inertial=combined(parts), density=None))


def with_friction(model: RobotModel, link: str, **parameters: float | None) -> RobotModel:
    """Return the link with the given contact parameters, by the names of `Friction`; None keeps the old
    value."""
    old = model.link(link)
    present = {name: value for name, value in parameters.items() if value is not None}
    return with_link(model, replace(old, friction=replace(old.friction, **present)))


def with_color(model: RobotModel, link: str, color: Color) -> RobotModel:
    """Return the link with all its visuals in one color; a link without visuals shows its collision
    shapes."""
    old = model.link(link)
    return with_link(
        model,
        replace(old, visuals=tuple(replace(visual, color=color) for visual in old.visuals or old.collisions)),
    )


def with_joint(
    model: RobotModel,
    joint: str,
    *,
    damping: float | None = None,
    friction: float | None = None,
    armature: float | None = None,
    limit: Limit | None = None,
) -> RobotModel:
    """Return the joint with `damping` (N m s/rad or N s/m), `friction` (N m or N), `armature` (kg m^2 or kg)
    and `limit`; None keeps the value of the file."""
    old = model.joint(joint)
    new = replace(
        old,
        damping=old.damping if damping is None else damping,
        friction=old.friction if friction is None else friction,
        armature=old.armature if armature is None else armature,
        limit=old.limit if limit is None else limit,
    )
    return _with_joints(model, {joint: new})


def _with_joints(model: RobotModel, changed: dict[str, Joint]) -> RobotModel:
    return replace(model, joints=tuple(changed.get(old.name, old) for old in model.joints))


class _ShapeError(Exception):
    """The error for a shape that cannot be stretched so; `args` has the reason."""


def with_scale(model: RobotModel, link: str, scale: Vector) -> RobotModel | str:
    """Return the link stretched by `scale` along the axes of its own frame, as if it were made longer from
    the same material.

    Shapes, center of mass and the origins of child joints move with it, mass grows with the volume, and the
    inertia is exact for any distribution of mass, since the second moments transform linearly.
    """
    if not all(math.isfinite(factor) and factor > 0 for factor in scale):
        return f"the scale of link {link!r} must be above 0"
    old = model.link(link)
    kind = "visual"
    try:
        visuals = tuple(_stretched(geometry, scale) for geometry in old.visuals)
        kind = "collision"
        collisions = tuple(_stretched(geometry, scale) for geometry in old.collisions)
    except _ShapeError as error:
        return f"a {kind} shape of link {link!r} cannot be scaled like this: {error}"
    inertial = _stretched_inertial(old.inertial, scale) if old.inertial else None
    children = {
        joint.name: replace(joint, origin=replace(joint.origin, xyz=_along(joint.origin.xyz, scale)))
        for joint in model.joints
        if joint.parent == link
    }
    return _with_joints(
        with_link(model, replace(old, inertial=inertial, visuals=visuals, collisions=collisions)), children
    )


def _along(v: Vector, scale: Vector) -> Vector:
    return (v[0] * scale[0], v[1] * scale[1], v[2] * scale[2])


def _stretched_inertial(old: Inertial, scale: Vector) -> Inertial:
    """Return the inertial J' = m'/m S J S with S in the axes of the link; the inertial keeps its own axes."""
    growth = scale[0] * scale[1] * scale[2]
    axes = rotation_matrix(old.origin.rpy)
    moments = rotate_tensor(second_moments(old.matrix), axes)
    stretched = scaled_matrix(product(product(diagonal(scale), moments), diagonal(scale)), growth)
    # I = tr(J) - J, the inverse of `second_moments`.
    tensor = _trace_minus(rotate_tensor(stretched, transposed(axes)), 1.0)
    return _with_matrix(
        replace(old, mass=old.mass * growth, origin=replace(old.origin, xyz=_along(old.origin.xyz, scale))),
        tensor,
    )


def _with_matrix(old: Inertial, tensor: Matrix) -> Inertial:
    (ixx, ixy, ixz), (_, iyy, iyz), (_, _, izz) = tensor
    return replace(old, ixx=ixx, ixy=ixy, ixz=ixz, iyy=iyy, iyz=iyz, izz=izz)


def _stretched(old: Geometry, scale: Vector) -> Geometry:
    """Return the stretched shape; its own axes stay at right angles exactly if S is diagonal in them."""
    stretch = rotate_tensor(diagonal(scale), transposed(rotation_matrix(old.origin.rpy)))
    if max(abs(stretch[0][1]), abs(stretch[0][2]), abs(stretch[1][2])) > _ALIGNMENT_TOLERANCE * max(scale):
        raise _ShapeError("it is rotated relative to the axes of the link, so scaling would skew it")
    shape = _stretched_shape(old.shape, (stretch[0][0], stretch[1][1], stretch[2][2]))
    return Geometry(shape, replace(old.origin, xyz=_along(old.origin.xyz, scale)), old.color)


def _stretched_shape(shape: Shape, scale: Vector) -> Shape:
    x, y, z = scale
    round_about_z = math.isclose(x, y, rel_tol=_ALIGNMENT_TOLERANCE)
    uniform = round_about_z and math.isclose(x, z, rel_tol=_ALIGNMENT_TOLERANCE)
    match shape:
        case Box(size):
            return Box(_along(size, scale))
        case Mesh():
            return replace(shape, scale=_along(shape.scale, scale))
        case Cylinder(radius, length) if round_about_z:
            return Cylinder(radius * x, length * z)
        case Cylinder():
            raise _ShapeError("a cylinder would not stay round")
        case Sphere(radius) if uniform:
            return Sphere(radius * x)
        case Sphere():
            raise _ShapeError("a sphere would not stay round")
        case Capsule(radius, length) if uniform:
            return Capsule(radius * x, length * z)
        case _:
            raise _ShapeError("the ends of a capsule would not stay round")
