"""A robot model as URDF text: one element per line, floats to the last digit.

`reader.read_bytes(write(model).encode(), ...)` gives the same model again. This text, never the user's
own file, is what an engine loads.
"""

from __future__ import annotations

from xml.sax.saxutils import quoteattr

from deepbots_cli.robots.model import (
    Box,
    Capsule,
    Colour,
    Cylinder,
    Friction,
    Geometry,
    Inertial,
    Joint,
    Limit,
    Link,
    Mesh,
    Pose,
    RobotModel,
    Shape,
    Sphere,
)

Lines = list[str]


def write(model: RobotModel) -> str:
    """The model as URDF text; meshes by the path that the model holds."""
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
    return quoteattr(value if isinstance(value, str) else " ".join(map(repr, value if isinstance(value, tuple) else (value,))))


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
