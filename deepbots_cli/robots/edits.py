"""Pure functions that change one property of a robot. An impossible change returns a sentence with the reason.

The link or joint must exist: callers report unknown names.
"""

from __future__ import annotations

import math
from dataclasses import replace

from deepbots_cli.frames import Matrix, diagonal, product, rotate_tensor, rotation_matrix, transposed
from deepbots_cli.robots.model import (
    Box,
    Capsule,
    Colour,
    Cylinder,
    Geometry,
    Inertial,
    Joint,
    Limit,
    Link,
    Mesh,
    RobotModel,
    Shape,
    Sphere,
    Vector,
    from_second_moments,
    homogeneous,
    scaled,
    second_moments,
    volume,
)

_ALIGNED = 1e-6


def with_link(model: RobotModel, link: Link) -> RobotModel:
    """`model` with the link of the same name exchanged."""
    return replace(model, links=tuple(link if old.name == link.name else old for old in model.links))


def with_mass(model: RobotModel, link: str, mass: float) -> RobotModel | str:
    """The link with `mass` kg; its inertia grows in proportion, as if the material were denser."""
    old = model.link(link)
    if old.inertial is None or old.inertial.mass <= 0:
        return f"link {link!r} has no mass in its robot file that could be changed"
    if not (math.isfinite(mass) and mass > 0):
        return f"the mass of link {link!r} must be above 0"
    tensor = scaled(old.inertial.matrix, mass / old.inertial.mass)
    return with_link(model, replace(old, inertial=_with_matrix(replace(old.inertial, mass=mass), tensor)))


def with_density(model: RobotModel, link: str, density: float) -> RobotModel | str:
    """The link as a homogeneous body of `density` kg/m^3; the mass of a mesh is computed when it is simulated."""
    old = model.link(link)
    shapes = old.collisions or old.visuals
    if len(shapes) != 1:
        return f"link {link!r} has {len(shapes)} shapes, and a density needs exactly one; give its `mass`"
    shape = shapes[0].shape
    if isinstance(shape, Mesh) and shape.path.lower().endswith(".dae"):
        return f"the mesh of link {link!r} is a COLLADA file, whose volume is not read; give its `mass`"
    inertial = homogeneous(shape, density * (volume(shape) or 0.0), shapes[0].origin)
    return with_link(model, replace(old, inertial=inertial, density=density if inertial is None else None))


def with_friction(model: RobotModel, link: str, **parameters: float | None) -> RobotModel:
    """The link with the given contact parameters, by the names of `Friction`; None keeps the old value."""
    old = model.link(link)
    given = {name: value for name, value in parameters.items() if value is not None}
    return with_link(model, replace(old, friction=replace(old.friction, **given)))


def with_colour(model: RobotModel, link: str, colour: Colour) -> RobotModel:
    """The link with all its visuals in one colour; a link without visuals shows its collision shapes."""
    old = model.link(link)
    return with_link(model, replace(old, visuals=tuple(replace(visual, colour=colour) for visual in old.visuals or old.collisions)))


def with_joint(
    model: RobotModel, joint: str, *, damping: float | None = None, friction: float | None = None, limit: Limit | None = None
) -> RobotModel:
    """The joint with `damping` (N m s/rad or N s/m), `friction` (N m or N) and `limit`; None keeps the value of the file."""
    old = model.joint(joint)
    new = replace(
        old,
        damping=old.damping if damping is None else damping,
        friction=old.friction if friction is None else friction,
        limit=old.limit if limit is None else limit,
    )
    return _with_joints(model, {joint: new})


def _with_joints(model: RobotModel, changed: dict[str, Joint]) -> RobotModel:
    return replace(model, joints=tuple(changed.get(old.name, old) for old in model.joints))


class _ShapeError(Exception):
    """A shape cannot be stretched so; `args` holds the reason."""


def with_scale(model: RobotModel, link: str, scale: Vector) -> RobotModel | str:
    """The link stretched by `scale` along the axes of its own frame, as if it were made longer from the same material.

    Shapes, centre of mass and the origins of child joints move with it, mass grows with the volume, and the
    inertia is exact for any distribution of mass, since the second moments transform linearly.
    """
    if not all(math.isfinite(factor) and factor > 0 for factor in scale):
        return f"link {link!r} can only be stretched by numbers above 0"
    old = model.link(link)
    what = "visual"
    try:
        visuals = tuple(_stretched(geometry, scale) for geometry in old.visuals)
        what = "collision"
        collisions = tuple(_stretched(geometry, scale) for geometry in old.collisions)
    except _ShapeError as error:
        return f"a {what} shape of link {link!r} cannot follow this stretch: {error}"
    inertial = _stretched_inertial(old.inertial, scale) if old.inertial else None
    children = {
        joint.name: replace(joint, origin=replace(joint.origin, xyz=_along(joint.origin.xyz, scale)))
        for joint in model.joints
        if joint.parent == link
    }
    return _with_joints(with_link(model, replace(old, inertial=inertial, visuals=visuals, collisions=collisions)), children)


def _along(v: Vector, scale: Vector) -> Vector:
    return (v[0] * scale[0], v[1] * scale[1], v[2] * scale[2])


def _stretched_inertial(old: Inertial, scale: Vector) -> Inertial:
    """J' = m'/m S J S with S in the axes of the link; the inertial keeps its own axes."""
    growth = scale[0] * scale[1] * scale[2]
    axes = rotation_matrix(old.origin.rpy)
    moments = rotate_tensor(second_moments(old.matrix), axes)
    stretched = scaled(product(product(diagonal(scale), moments), diagonal(scale)), growth)
    tensor = from_second_moments(rotate_tensor(stretched, transposed(axes)))
    return _with_matrix(replace(old, mass=old.mass * growth, origin=replace(old.origin, xyz=_along(old.origin.xyz, scale))), tensor)


def _with_matrix(old: Inertial, tensor: Matrix) -> Inertial:
    (ixx, ixy, ixz), (_, iyy, iyz), (_, _, izz) = tensor
    return replace(old, ixx=ixx, ixy=ixy, ixz=ixz, iyy=iyy, iyz=iyz, izz=izz)


def _stretched(old: Geometry, scale: Vector) -> Geometry:
    """The shape's own axes stay at right angles exactly if S is diagonal in them."""
    own = rotate_tensor(diagonal(scale), transposed(rotation_matrix(old.origin.rpy)))
    if max(abs(own[0][1]), abs(own[0][2]), abs(own[1][2])) > _ALIGNED * max(scale):
        raise _ShapeError("it is turned against the axes of the link, which would make it oblique")
    shape = _stretched_shape(old.shape, (own[0][0], own[1][1], own[2][2]))
    return Geometry(shape, replace(old.origin, xyz=_along(old.origin.xyz, scale)), old.colour)


def _stretched_shape(shape: Shape, scale: Vector) -> Shape:
    x, y, z = scale
    round_about_z = math.isclose(x, y, rel_tol=_ALIGNED)
    uniform = round_about_z and math.isclose(x, z, rel_tol=_ALIGNED)
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
