"""A robot as URDF: what is in the model and nothing else, one element per line, floats to the last digit.

`reader.read_bytes(write(model).encode(), ...)` gives the same model again. This text, never the user's
own file, is what an engine loads.
"""

from __future__ import annotations

from collections.abc import Iterator
from xml.sax.saxutils import quoteattr

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
    Pose,
    RobotModel,
    Shape,
    Sphere,
)


def write(model: RobotModel) -> str:
    """The model as URDF text; meshes by the path that the model holds."""
    lines = ['<?xml version="1.0" encoding="utf-8"?>', f"<robot name={quoteattr(model.name)}>"]
    colours: dict[tuple[float, ...], str] = {}
    for link in model.links:
        lines += _link(link, colours)
    for joint in model.joints:
        lines += _joint(joint)
    return "\n".join([*lines, "</robot>", ""])


def _numbers(*values: float) -> str:
    return '"' + " ".join(map(repr, values)) + '"'


def _link(link: Link, colours: dict[tuple[float, ...], str]) -> Iterator[str]:
    yield f"  <link name={quoteattr(link.name)}>"
    if link.inertial:
        yield from _inertial(link.inertial)
    for visual in link.visuals:
        yield from _geometry("visual", visual, colours)
    for collision in link.collisions:
        yield from _geometry("collision", collision, colours)
    yield from _friction(link.friction)
    yield "  </link>"


def _inertial(inertial: Inertial) -> Iterator[str]:
    yield "    <inertial>"
    yield f"      {_origin(inertial.origin)}"
    yield f"      <mass value={_numbers(inertial.mass)}/>"
    moments = (f"{name}={_numbers(getattr(inertial, name))}" for name in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
    yield f"      <inertia {' '.join(moments)}/>"
    yield "    </inertial>"


def _origin(pose: Pose) -> str:
    return f"<origin xyz={_numbers(*pose.xyz)} rpy={_numbers(*pose.rpy)}/>"


def _geometry(tag: str, geometry: Geometry, colours: dict[tuple[float, ...], str]) -> Iterator[str]:
    yield f"    <{tag}>"
    yield f"      {_origin(geometry.origin)}"
    yield f"      <geometry>{_shape(geometry.shape)}</geometry>"
    if geometry.colour:
        # Engines look materials up by name in the whole file: one name must mean one colour.
        name = colours.setdefault(geometry.colour, f"colour_{len(colours)}")
        yield f'      <material name="{name}"><color rgba={_numbers(*geometry.colour)}/></material>'
    yield f"    </{tag}>"


def _shape(shape: Shape) -> str:
    match shape:
        case Box(size):
            return f"<box size={_numbers(*size)}/>"
        case Sphere(radius):
            return f"<sphere radius={_numbers(radius)}/>"
        case Cylinder(radius, length):
            return f"<cylinder radius={_numbers(radius)} length={_numbers(length)}/>"
        case Capsule(radius, length):
            return f"<capsule radius={_numbers(radius)} length={_numbers(length)}/>"
        case Mesh(path, _, scale):
            return f"<mesh filename={quoteattr(path)} scale={_numbers(*scale)}/>"


def _friction(friction: Friction) -> Iterator[str]:
    values = {
        "lateral_friction": friction.lateral,
        "spinning_friction": friction.spinning,
        "rolling_friction": friction.rolling,
        "restitution": friction.restitution,
    }
    if friction != Friction():
        yield "    <contact>"
        yield from (f"      <{tag} value={_numbers(value)}/>" for tag, value in values.items() if value is not None)
        yield "    </contact>"


def _joint(joint: Joint) -> Iterator[str]:
    yield f'  <joint name={quoteattr(joint.name)} type="{joint.type}">'
    yield f"    {_origin(joint.origin)}"
    yield f"    <parent link={quoteattr(joint.parent)}/>"
    yield f"    <child link={quoteattr(joint.child)}/>"
    yield f"    <axis xyz={_numbers(*joint.axis)}/>"
    if joint.limit != Limit():
        values = {name: getattr(joint.limit, name) for name in ("lower", "upper", "velocity", "effort")}
        yield f"    <limit {' '.join(f'{name}={_numbers(value)}' for name, value in values.items() if value is not None)}/>"
    if joint.damping or joint.friction:
        yield f"    <dynamics damping={_numbers(joint.damping)} friction={_numbers(joint.friction)}/>"
    if joint.mimic:
        factor, offset = _numbers(joint.mimic.multiplier), _numbers(joint.mimic.offset)
        yield f"    <mimic joint={quoteattr(joint.mimic.joint)} multiplier={factor} offset={offset}/>"
    yield "  </joint>"
