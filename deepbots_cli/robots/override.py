"""A robot with one thing changed. Pure functions; what cannot be done is answered with a sentence that says why.

Names are taken as given: an unknown link or joint is the caller's to report, at the place where it was written.
"""

from __future__ import annotations

import math
from dataclasses import replace

from deepbots_cli.robots.inertia import from_second_moments, matrix, scaled, second_moments
from deepbots_cli.robots.model import (
    Box,
    Capsule,
    Cylinder,
    Friction,
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
)
from deepbots_cli.robots.rotation import Matrix, diagonal, from_rpy, product, transposed, turned

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
    tensor = scaled(matrix(old.inertial), mass / old.inertial.mass)
    return with_link(model, replace(old, inertial=_with_matrix(replace(old.inertial, mass=mass), tensor)))


def with_friction(
    model: RobotModel,
    link: str,
    *,
    lateral: float | None = None,
    spinning: float | None = None,
    rolling: float | None = None,
    restitution: float | None = None,
) -> RobotModel:
    """The link with the given contact figures; None keeps the old one."""
    old = model.link(link)
    new = Friction(
        old.friction.lateral if lateral is None else lateral,
        old.friction.spinning if spinning is None else spinning,
        old.friction.rolling if rolling is None else rolling,
        old.friction.restitution if restitution is None else restitution,
    )
    return with_link(model, replace(old, friction=new))


def with_colour(model: RobotModel, link: str, colour: tuple[float, float, float, float]) -> RobotModel:
    """The link with all that is seen of it in one colour; one without visuals shows what it collides with."""
    old = model.link(link)
    return with_link(model, replace(old, visuals=tuple(replace(seen, colour=colour) for seen in old.visuals or old.collisions)))


def with_joint(
    model: RobotModel,
    joint: str,
    *,
    damping: float | None = None,
    friction: float | None = None,
    limit: Limit | None = None,
) -> RobotModel:
    """The joint with `damping` (N m s/rad or N s/m), `friction` (N m or N) and `limit`; None keeps what the file says."""
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


def stretch(model: RobotModel, link: str, scale: Vector) -> RobotModel | str:
    """The link stretched by `scale` along the axes of its own frame, as if it were made longer from the same material.

    Shapes, centre of mass and the origins of child joints move with it, mass grows with the volume, and the
    inertia is exact for any distribution of mass, since the second moments transform linearly.
    """
    if not all(math.isfinite(factor) and factor > 0 for factor in scale):
        return f"link {link!r} can only be stretched by numbers above 0"
    old = model.link(link)
    visuals = _stretched_all(old.visuals, scale)
    if isinstance(visuals, str):
        return f"a visual shape of link {link!r} cannot follow this stretch: {visuals}"
    collisions = _stretched_all(old.collisions, scale)
    if isinstance(collisions, str):
        return f"a collision shape of link {link!r} cannot follow this stretch: {collisions}"
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
    axes = from_rpy(old.origin.rpy)
    moments = turned(second_moments(matrix(old)), axes)
    stretched = scaled(product(product(diagonal(scale), moments), diagonal(scale)), growth)
    tensor = from_second_moments(turned(stretched, transposed(axes)))
    return _with_matrix(replace(old, mass=old.mass * growth, origin=replace(old.origin, xyz=_along(old.origin.xyz, scale))), tensor)


def _with_matrix(old: Inertial, tensor: Matrix) -> Inertial:
    (ixx, ixy, ixz), (_, iyy, iyz), (_, _, izz) = tensor
    return replace(old, ixx=ixx, ixy=ixy, ixz=ixz, iyy=iyy, iyz=iyz, izz=izz)


def _stretched_all(geometries: tuple[Geometry, ...], scale: Vector) -> tuple[Geometry, ...] | str:
    stretched = []
    for old in geometries:
        new = _stretched(old, scale)
        if isinstance(new, str):
            return new
        stretched.append(new)
    return tuple(stretched)


def _stretched(old: Geometry, scale: Vector) -> Geometry | str:
    """The shape's own axes must stay at right angles, which they do if S is diagonal in them."""
    own = turned(diagonal(scale), transposed(from_rpy(old.origin.rpy)))
    if max(abs(own[0][1]), abs(own[0][2]), abs(own[1][2])) > _ALIGNED * max(scale):
        return "it is turned against the axes of the link, which would make it oblique"
    shape = _stretched_shape(old.shape, (own[0][0], own[1][1], own[2][2]))
    return shape if isinstance(shape, str) else Geometry(shape, replace(old.origin, xyz=_along(old.origin.xyz, scale)), old.colour)


def _stretched_shape(shape: Shape, scale: Vector) -> Shape | str:
    x, y, z = scale
    round_about_z = math.isclose(x, y, rel_tol=_ALIGNED)
    match shape:
        case Box(size):
            return Box(_along(size, scale))
        case Mesh():
            return replace(shape, scale=_along(shape.scale, scale))
        case Cylinder(radius, length):
            return Cylinder(radius * x, length * z) if round_about_z else "a cylinder would not stay round"
        case Sphere(radius):
            return Sphere(radius * x) if round_about_z and math.isclose(x, z, rel_tol=_ALIGNED) else "a sphere would not stay round"
        case Capsule(radius, length):
            uniform = round_about_z and math.isclose(x, z, rel_tol=_ALIGNED)
            return Capsule(radius * x, length * z) if uniform else "the ends of a capsule would not stay round"
