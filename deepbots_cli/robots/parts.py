"""From elements to links, joints and materials. Each function reads one element and reports into `Report`."""

from __future__ import annotations

import math
from typing import get_args

from deepbots_cli.robots.mesh import Meshes, Refusal
from deepbots_cli.robots.model import (
    Box,
    Capsule,
    Cylinder,
    Friction,
    Geometry,
    Inertial,
    Joint,
    JointType,
    Limit,
    Link,
    Mesh,
    Mimic,
    Pose,
    Shape,
    Sphere,
    Vector,
)
from deepbots_cli.robots.report import Report, known_names, quoted
from deepbots_cli.robots.xml import Element

Colour = tuple[float, float, float, float]

BALL = "spherical"  # a type of joint that URDF lacks and PyBullet reads
_FULL_TURN = 6.29  # rad: above 2 pi as files round it
JOINT_TYPES: tuple[JointType, ...] = get_args(JointType)
_SHAPES = ("box", "sphere", "cylinder", "capsule", "mesh")
_UNIT_TOLERANCE = 1e-12


def colours(root: Element, report: Report) -> dict[str, Colour]:
    """The named materials that have a colour: those of the robot, then those first written inside a visual."""
    named: dict[str, Colour] = {}
    inside = [visual for link in root.all("link") for visual in link.all("visual")]
    for holder in (root, *inside):
        for material in holder.all("material"):
            name, colour = material.attributes.get("name"), _colour(material, report)
            if name and colour:
                named.setdefault(name, colour)
    return named


def _colour(material: Element, report: Report) -> Colour | None:
    """The material's own colour, each part brought into 0 to 1."""
    element = report.only(material, "color")
    if element is None:
        return None
    red, green, blue, alpha = report.vector(element, "rgba", None, 4)
    colour = (red, green, blue, alpha)
    if any(not 0 <= part <= 1 for part in colour):
        report.warn("DB311", element, "a colour outside 0 to 1 is cut off", attribute="rgba", help="divide by 255")
    return (_unit(red), _unit(green), _unit(blue), _unit(alpha))


def _unit(part: float) -> float:
    return min(max(part, 0.0), 1.0)


def _vector(element: Element, name: str, default: Vector | None, report: Report) -> Vector:
    x, y, z = report.vector(element, name, default, 3)
    return (x, y, z)


def _pose(element: Element, report: Report) -> Pose:
    origin = report.only(element, "origin")
    if origin is None:
        return Pose()
    angles = _vector(origin, "rpy", (0.0, 0.0, 0.0), report)
    largest = max(angles, key=abs)
    if abs(largest) > _FULL_TURN:
        turned = " ".join(f"{round(math.radians(angle), 4):g}" for angle in angles)
        help = f'angles are in rad; if degrees are meant, write rpy="{turned}"'
        report.warn("DB504", origin, f"{largest:g} rad is more than a full turn", attribute="rpy", help=help)
    return Pose(_vector(origin, "xyz", (0.0, 0.0, 0.0), report), angles)


def link(element: Element, name: str, named: dict[str, Colour], meshes: Meshes, report: Report) -> Link:
    """One `<link>`."""
    visuals = [_geometry(visual, meshes, report, _visual_colour(visual, named, report)) for visual in element.all("visual")]
    collisions = [_geometry(collision, meshes, report, None) for collision in element.all("collision")]
    return Link(
        name,
        _inertial(element, report),
        tuple(geometry for geometry in visuals if geometry),
        tuple(geometry for geometry in collisions if geometry),
        _friction(element, report),
    )


def _inertial(link: Element, report: Report) -> Inertial | None:
    element = report.only(link, "inertial")
    if element is None:
        return None
    mass = report.required(element, "mass")
    inertia = report.required(element, "inertia")
    if mass is None or inertia is None:
        return None
    return Inertial(
        mass=report.not_negative(mass, "value"),
        origin=_pose(element, report),
        ixx=report.not_negative(inertia, "ixx"),
        ixy=report.number(inertia, "ixy", 0.0),
        ixz=report.number(inertia, "ixz", 0.0),
        iyy=report.not_negative(inertia, "iyy"),
        iyz=report.number(inertia, "iyz", 0.0),
        izz=report.not_negative(inertia, "izz"),
    )


def _visual_colour(visual: Element, named: dict[str, Colour], report: Report) -> Colour | None:
    """The colour inside the visual, else that of the material it names."""
    material = report.only(visual, "material")
    if material is None:
        return None
    if material.all("color"):
        return _colour(material, report)
    return named.get(material.attributes.get("name", ""))


def _geometry(holder: Element, meshes: Meshes, report: Report, colour: Colour | None) -> Geometry | None:
    element = report.required(holder, "geometry")
    if element is None:
        return None
    shapes = [child for child in element.children if child.tag in _SHAPES]
    if not shapes:
        report.error(element, "<geometry> without a shape that is known", help=f"the shapes are: {', '.join(_SHAPES)}")
        return None
    for extra in shapes[1:]:
        report.warn(
            "DB311", extra, "a further shape in the same <geometry> is not read", help="give it a <visual> or <collision> of its own"
        )
    shape = _shape(shapes[0], meshes, report)
    if shape is None or not _has_size(shape, shapes[0], holder.tag, report):
        return None
    return Geometry(shape, _pose(holder, report), colour)


def _shape(element: Element, meshes: Meshes, report: Report) -> Shape | None:
    match element.tag:
        case "box":
            return Box(_vector(element, "size", None, report))
        case "sphere":
            return Sphere(report.number(element, "radius"))
        case "cylinder":
            return Cylinder(report.number(element, "radius"), report.number(element, "length"))
        case "capsule":
            return Capsule(report.number(element, "radius"), report.number(element, "length"))
        case _:
            return _mesh(element, meshes, report)


def _has_size(shape: Shape, element: Element, holder: str, report: Report) -> bool:
    """Whether each measure is above 0. A visual of size 0 is a known way to draw nothing, and harmless."""
    match shape:
        case Box(size):
            measures = {"size": min(size)}
        case Sphere(radius):
            measures = {"radius": radius}
        case Cylinder(radius, length) | Capsule(radius, length):
            measures = {"radius": radius, "length": length}
        case Mesh():
            measures = {}
    wrong = next((name for name, value in measures.items() if value <= 0), None)
    if wrong is None:
        return True
    if holder == "visual" and measures[wrong] == 0:
        report.warn("DB311", element, "a visual without size draws nothing", attribute=wrong, help="remove the <visual>")
    else:
        report.error(element, f"'{wrong}' must be above 0", attribute=wrong)
    return False


def _mesh(element: Element, meshes: Meshes, report: Report) -> Mesh | None:
    filename = report.text(element, "filename")
    scale = _vector(element, "scale", (1.0, 1.0, 1.0), report)
    if not all(scale):
        report.error(element, "a mesh cannot be scaled by 0", attribute="scale")
    if filename is None:
        return None
    loaded = meshes.load(filename)
    if isinstance(loaded, Refusal):
        report.error(element, loaded.why, attribute="filename", help=loaded.help)
        return None
    if loaded.reference:
        headline = "the mesh is not beside the robot file; one in a folder above is read, as PyBullet does"
        report.warn("DB311", element, headline, attribute="filename", help=f'write filename="{loaded.reference}"')
    return Mesh(str(loaded.path), loaded.digest, scale)


def _friction(link: Element, report: Report) -> Friction:
    contact = report.only(link, "contact")
    if contact is None:
        return Friction()

    def figure(tag: str) -> float | None:
        element = report.only(contact, tag)
        return None if element is None else report.not_negative(element, "value")

    return Friction(figure("lateral_friction"), figure("spinning_friction"), figure("rolling_friction"), figure("restitution"))


def joint(element: Element, name: str, report: Report) -> Joint | None:
    """One `<joint>`; None where it has no type or does not say what it joins."""
    kind = _joint_type(element, report)
    parent = report.required(element, "parent")
    child = report.required(element, "child")
    above = parent and report.text(parent, "link")
    below = child and report.text(child, "link")
    if kind is None or not above or not below:
        return None
    dynamics = report.only(element, "dynamics")
    return Joint(
        name,
        kind,
        above,
        below,
        origin=_pose(element, report),
        axis=_axis(element, kind, report),
        limit=_limit(element, kind, name, report),
        damping=report.not_negative(dynamics, "damping", 0.0) if dynamics else 0.0,
        friction=report.not_negative(dynamics, "friction", 0.0) if dynamics else 0.0,
        mimic=_mimic(element, report),
    )


def hinges(ball: Joint) -> tuple[list[Link], list[Joint]]:
    """A ball joint as three hinges at one place, about x, then y, then z, with two links between them that have neither mass nor shape.

    Each hinge has the effort, velocity, damping and friction of the ball joint. The angles are
    those of intrinsic rotations about x, y, z: near -90 or 90 deg about y, the axes of x and z coincide.
    """
    between = [Link(f"{ball.name}_{axis}") for axis in "xy"]
    names = [ball.parent, *(link.name for link in between), ball.child]
    axes: tuple[Vector, ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    joints = [
        Joint(
            f"{ball.name}_{letter}",
            "continuous",
            above,
            below,
            origin=ball.origin if letter == "x" else Pose(),
            axis=axis,
            limit=ball.limit,
            damping=ball.damping,
            friction=ball.friction,
        )
        for letter, axis, above, below in zip("xyz", axes, names, names[1:], strict=False)
    ]
    return between, joints


def _joint_type(element: Element, report: Report) -> JointType | None:
    word = report.text(element, "type")
    if word is None:
        return None
    if word == BALL:
        return "continuous"
    kind = next((known for known in JOINT_TYPES if known == word), None)
    if kind is None:
        help = known_names(word, JOINT_TYPES, "joint types")
        report.error(element, f"unknown joint type {quoted(word)}", attribute="type", help=help)
    return kind


def _axis(joint: Element, kind: JointType, report: Report) -> Vector:
    """The axis brought to length 1. A fixed or floating joint has none, and whatever is written there is not read."""
    element = report.only(joint, "axis")
    if element is None or kind in ("fixed", "floating"):
        return (1.0, 0.0, 0.0)
    x, y, z = _vector(element, "xyz", (1.0, 0.0, 0.0), report)
    length = math.hypot(x, y, z)
    if length < 1e-9:
        report.error(element, "the axis has no length", attribute="xyz", help="write the direction the joint turns about or slides along")
        return (1.0, 0.0, 0.0)
    if abs(length - 1) < _UNIT_TOLERANCE:
        return (x, y, z)
    return (x / length, y / length, z / length)


def _limit(joint: Element, kind: JointType, name: str, report: Report) -> Limit:
    """Bounds in rad or m. An effort or velocity of 0 is read as "not stated".

    Many published files write 0 there for joints that are driven; taken literally the joint could never move.
    """
    element = report.only(joint, "limit")
    if element is None:
        if kind in ("revolute", "prismatic"):
            report.warn("DB307", joint, f"joint {quoted(name)} has no limits", help='add <limit lower="..." upper="..." .../>')
        return Limit()
    effort = report.not_negative(element, "effort", 0.0) or None
    velocity = report.not_negative(element, "velocity", 0.0) or None
    lower, upper = report.number(element, "lower", 0.0), report.number(element, "upper", 0.0)
    if kind not in ("revolute", "prismatic"):
        return Limit(None, None, velocity, effort)
    if not {"lower", "upper"} & element.attributes.keys():
        report.warn("DB307", element, f"joint {quoted(name)} has no limits", help='add lower="..." and upper="..."')
        return Limit(None, None, velocity, effort)
    if lower > upper:
        headline = f"the lower limit of joint {quoted(name)} is above the upper one, so it has none"
        report.warn("DB307", element, headline, help="exchange the two, or make the joint continuous")
        return Limit(None, None, velocity, effort)
    return Limit(lower, upper, velocity, effort)


def _mimic(joint: Element, report: Report) -> Mimic | None:
    element = report.only(joint, "mimic")
    if element is None:
        return None
    other = report.text(element, "joint")
    return Mimic(other, report.number(element, "multiplier", 1.0), report.number(element, "offset", 0.0)) if other else None
