"""The world of a project: the bodies of its robots as robot models, its surroundings as entries of a
scenario, and their names.

A link has its origin at the anchor of its joint, as URDF asks for; a body of Webots has it anywhere. Joint
positions are those of Webots: the world shows a joint at its `position`, and the model has it at 0.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import field, replace
from io import BytesIO
from itertools import chain, count
from math import hypot, inf

import numpy as np

from deepbots_cli import frames
from deepbots_cli.frames import Frame
from deepbots_cli.records import dataclass
from deepbots_cli.robots import model as urdf
from deepbots_cli.scenario.fields import RESERVED, suggested_name
from deepbots_webots.nodes import is_a, number, numbers, real, rotation, text, vector, walk
from deepbots_webots.project import World
from deepbots_webots.scene import ORIGIN, Body, Geometry, Joint, Scene
from deepbots_webots.shapes import (
    Grid,
    Mesh,
    Plane,
    Shape,
    inverse,
    kind_of,
    pose_of,
    trimesh_of,
)
from deepbots_webots.syntax import Node, WorldFindings

_WORDS_OF_YAML = frozenset(["true", "false", "null", "yes", "no", "on", "off"])
_MAX_LENGTH = 40


def scenario_name(text: str, fallback: str = "part") -> str:
    """Return a name of the scenario language for a name of Webots or Python: `polePosSensor` becomes
    `pole_pos_sensor`."""
    name = re.sub("__+", "_", suggested_name(text))[:_MAX_LENGTH].strip("_") or fallback
    is_taken = name in _WORDS_OF_YAML | RESERVED or name in ("x", "y", "z")
    return f"{fallback}_{name}" if is_taken or name[0].isdigit() else name


class Names:
    """Gives names that differ from each other."""

    def __init__(self) -> None:
        self._taken: set[str] = set()

    def new(self, text: str, fallback: str = "part") -> str:
        """Return a name that was not returned before."""
        name = scenario_name(text, fallback)
        names = chain([name], (f"{name}_{number}" for number in count(2)))
        unused = next(each for each in names if each not in self._taken)
        self._taken.add(unused)
        return unused


_LIGHT = urdf.Inertial(1e-3, ixx=4e-8, iyy=4e-8, izz=4e-8)
"""A ball of 1 g and 1 cm: a link without inertia, as a solid without physics at the end of a joint."""


@dataclass
class RobotParts:
    """The bodies of one robot, parents first.

    `links` are names of links by solid, of bodies and of solids fixed to them, and `joints` names of joints
    by `id` of the joint of the scene. `starts` maps joint names to positions (rad or m) other than 0, and
    `meshes` paths of mesh files to their content; `build` adds them.
    """

    name: str
    bodies: list[Body]
    links: dict[Node, str] = field(default_factory=dict)
    joints: dict[int, str] = field(default_factory=dict)
    starts: dict[str, float] = field(default_factory=dict)
    meshes: dict[str, bytes] = field(default_factory=dict)

    @property
    def root(self) -> Body:
        return self.bodies[0]

    def link_of(self, body: Body) -> str:
        return self.links[body.node]

    def frame_in_link(self, body: Body, frame: Frame) -> Frame:
        """Return a frame of a body in the frame of its link."""
        return frames.compose(inverse(_link_frame(body)), frame)


def robot_parts(scene: Scene, root: Body, name: str, labels: Mapping[Node, str]) -> RobotParts:
    """Return the bodies below a root with names for their links and joints; `labels` are the DEF names."""
    parts, members, names = RobotParts(name, [root]), {root.index}, Names()
    for body in scene.bodies:
        if body.parent is not None and body.parent.index in members:
            parts.bodies.append(body)
            members.add(body.index)
    for body in parts.bodies:
        link = parts.links[body.node] = names.new(labels.get(body.node) or text(body.node, "name"), "link")
        for joint in body.joints:
            label = joint.motor is not None and text(joint.motor, "name")
            parts.joints[id(joint)] = names.new(f"{label or link}_joint", "joint")
    for node, (body, _) in scene.attachments.items():
        is_named = is_a(node, "Solid") and node in labels and node not in parts.links
        if body.index in members and is_named:
            parts.links[node] = names.new(labels[node], "link")
    return parts


def build(parts: RobotParts, scene: Scene, split: Sequence[Node], findings: WorldFindings) -> urdf.RobotModel:
    """Return the model of a robot; the solids of `split`, which are fixed to a body, become links."""
    pieces = list(_pieces(parts, scene, split, findings))
    return urdf.RobotModel(
        parts.name,
        tuple(piece for piece in pieces if isinstance(piece, urdf.Link)),
        tuple(piece for piece in pieces if isinstance(piece, urdf.Joint)),
        parts.link_of(parts.root),
    )


def _pieces(
    parts: RobotParts, scene: Scene, split: Sequence[Node], findings: WorldFindings
) -> Iterator[urdf.Link | urdf.Joint]:
    for body in parts.bodies:
        if body.parent is not None:
            yield from _joints(parts, body, body.parent, findings)
        origins = {body.node: _link_frame(body)}
        for node in split:
            if scene.attachments[node][0] is body:
                origins.setdefault(node, scene.attachments[node][1])
        fixed = [node for node in origins if node is not body.node]
        solids = {inner: node for node in fixed for inner in walk([node])}
        for node, frame in origins.items():
            geometries = [each for each in body.geometries if solids.get(each.owner, body.node) is node]
            inertias = [inertial for owner, inertial in body.inertias if solids.get(owner, body.node) is node]
            yield _link(parts, parts.links[node], inverse(frame), geometries, inertias, scene, findings)
        for node in fixed:
            name, pose = parts.links[node], pose_of(parts.frame_in_link(body, origins[node]))
            yield urdf.Joint(f"{name}_fixed", "fixed", parts.link_of(body), name, pose)


# Links


def _link(
    parts: RobotParts,
    name: str,
    origin: Frame,
    geometries: Sequence[Geometry],
    inertias: Sequence[urdf.Inertial],
    scene: Scene,
    findings: WorldFindings,
) -> urdf.Link:
    """Return a link with these bounding objects and inertias; `origin` is the frame of the body in it."""
    masses = [
        replace(inertia, origin=pose_of(frames.compose(origin, frames.frame(inertia.origin))))
        for inertia in inertias
    ]
    shapes: list[urdf.Geometry] = []
    for geometry in geometries:
        pose = pose_of(frames.compose(origin, geometry.frame))
        shape = _shape(geometry.shape, parts, name)
        if shape is None:
            findings.warning(geometry.owner.span, f"a {kind_of(geometry.shape)} of a robot is left out")
            continue
        shapes.append(urdf.Geometry(shape, pose))
    if not masses and name != parts.link_of(parts.root):
        masses = [_LIGHT]
    friction = urdf.Friction(lateral=_friction(geometries, scene))
    inertial = urdf.combined(masses) if masses else None
    return urdf.Link(name, inertial, tuple(shapes), tuple(shapes), friction)


def _friction(geometries: Sequence[Geometry], scene: Scene) -> float | None:
    """Return the friction of a material with the default one, if the world names it."""
    values = (scene.contact(geometry.material, "default").friction for geometry in geometries)
    return next((value for value in values if value != 1.0), None)


def _shape(shape: Shape, parts: RobotParts, link: str) -> urdf.Shape | None:
    """Return a shape of URDF, with the file of a mesh; None for a plane or a grid."""
    match shape:
        case Plane() | Grid():
            return None
        case Mesh():
            content = bytes(trimesh_of(shape).export(file_type="stl"))
            path = f"{parts.name}_{link}_{len(parts.meshes)}.stl"
            parts.meshes[path] = content
            return urdf.Mesh(path, hashlib.sha256(content).hexdigest())
    return shape


# Joints


def _joints(
    parts: RobotParts, body: Body, parent: Body, findings: WorldFindings
) -> Iterator[urdf.Link | urdf.Joint]:
    """Yield the joints of a body; those of a Hinge2Joint have a light link between them."""
    above = parts.link_of(parent)
    frame = frames.compose(inverse(_link_frame(parent)), frames.compose(body.frame, _link_frame(body)))
    if body.joints and body.joints[0].kind == "ball":
        findings.error(body.node.span, "a BallJoint in a robot has no counterpart in URDF")
    for joint in body.joints:
        name = parts.joints[id(joint)]
        if joint is body.joints[-1]:
            below = parts.link_of(body)
        else:
            below = f"{name}_link"
            yield urdf.Link(below, _LIGHT)
        if abs(joint.position) > 1e-6:
            parts.starts[name] = joint.position
        yield _joint(name, joint, above, below, _at_zero(frame, joint))
        above, frame = below, ORIGIN


def _at_zero(frame: Frame, joint: Joint) -> Frame:
    """Return the frame of a joint at the position 0."""
    back = (frames.scaled(joint.axis, -joint.position), frames.IDENTITY_ROTATION)
    if joint.kind == "hinge":
        back = ((0.0, 0.0, 0.0), frames.from_axis_angle(joint.axis, -joint.position))
    return frames.compose(frame, back)


def _joint(name: str, joint: Joint, above: str, below: str, frame: Frame) -> urdf.Joint:
    low, high = _limits(joint)
    velocity = effort = None
    if joint.motor is not None:
        is_linear = joint.motor.type == "LinearMotor"
        velocity = number(joint.motor, "maxVelocity")
        effort = number(joint.motor, "maxForce" if is_linear else "maxTorque")
    kind: urdf.JointType = "prismatic"
    if joint.kind != "slide":
        kind = "continuous" if low is None else "revolute"
    limit = urdf.Limit(low, high, velocity, effort if effort != -1 else None)
    return urdf.Joint(
        name,
        kind,
        above,
        below,
        pose_of(frame),
        pose_of((joint.axis, frames.IDENTITY_ROTATION)).xyz,
        limit,
        damping=joint.damping,
        friction=joint.friction,
    )


def _limits(joint: Joint) -> tuple[float | None, float | None]:
    """Return the stops of a joint, or else the positions of its motor; None for a joint without limits."""
    low, high = joint.limits
    if low == high == 0.0 and joint.motor is not None:
        low, high = number(joint.motor, "minPosition"), number(joint.motor, "maxPosition")
    if low == high == 0.0 or abs(low) == inf or low >= high:
        return None, None
    return low, high


# Frames


def _link_frame(body: Body) -> Frame:
    """Return the frame of the link of a body, in the body."""
    if body.parent is None or not body.joints:
        return ORIGIN
    return body.joints[0].anchor, frames.IDENTITY_ROTATION


MAX_OBJECTS = 60
LARGEST_SUBSTEP = 8  # ms; the largest at which physics is within 1 % of its closed forms


@dataclass
class Surroundings:
    """Entries of `world` and `objects` as pairs of key and YAML text. `pictures` are the PNG files that they
    name, and `left_out` locations and sentences about parts of the world without a counterpart."""

    world: list[tuple[str, str]] = field(default_factory=list)
    objects: dict[str, str] = field(default_factory=dict)
    pictures: dict[str, bytes] = field(default_factory=dict)
    left_out: list[tuple[str, str]] = field(default_factory=list)


def surroundings(
    world: World, scene: Scene, objects: Mapping[int, str], used: Iterable[Node], step: int
) -> Surroundings:
    """Return the entries of a world; `objects` are names of bodies by their index, `used` the nodes that the
    code reads, and `step` the control step (ms)."""
    result = Surroundings([("timestep", f"{step} ms")])
    substeps = -(-step // LARGEST_SUBSTEP)
    if substeps > 1:
        result.world.append(("substeps", str(substeps)))
    if scene.gravity != (0.0, 0.0, -9.81):
        result.world.append(("gravity", f"{plain(*scene.gravity)} m/s^2"))
    nodes_in_result = _arena(scene, result) | _terrain(world, scene, result)
    needed = set(used)
    for index, name in objects.items():
        body = scene.bodies[index]
        if body.node not in nodes_in_result:
            _object(body, scene, name, body.node in needed, result)
    return result


def plain(*values: float) -> str:
    """Return numbers with up to nine digits, separated by spaces."""
    return " ".join(f"{value + 0.0:.9g}" for value in values)


# Arena and terrain


def _arena(scene: Scene, result: Surroundings) -> set[Node]:
    for node in walk(scene.nodes):
        if node.type != "RectangleArena" or node.body is None:
            continue
        if hypot(*vector(node, "translation")) > 1e-6 or abs(rotation(node, "rotation")[3]) < 1 - 1e-9:
            continue
        x, y = (*numbers(node, "floorSize"), 1.0, 1.0)[:2]
        walls = (
            f"wall_{name}: {plain(number(node, f'wall{name.title()}'))} m" for name in ("height", "thickness")
        )
        result.world.append(("arena", f"{{{', '.join([f'size: {plain(x, y)} m', *walls])}}}"))
        return {real(node)}
    return set()


def _terrain(world: World, scene: Scene, result: Surroundings) -> set[Node]:
    """Add the first grid that stays and lies around the origin, such as a Pit, as a picture of its
    heights."""
    for body in scene.bodies:
        is_alone = body.robot is None and body.parent is None and not body.is_free
        if not is_alone or len(body.geometries) != 1 or not isinstance(body.geometries[0].shape, Grid):
            continue
        (geometry,), shape = body.geometries, body.geometries[0].shape
        low, high = float(shape.heights.min()), float(shape.heights.max())
        (x, y, z), orientation = frames.compose(body.frame, geometry.frame)
        middle = (x + shape.size[0] / 2, y + shape.size[1] / 2, z + low)
        if max(map(abs, middle)) > 1e-6 or abs(orientation[3]) < 1 - 1e-9 or high - low < 1e-3:
            continue
        file = f"{scenario_name(world.path.stem)}_terrain.png"
        result.pictures[file] = _picture(shape, low, high)
        parts = [
            f"type: heightfield, file: {file}, size: {plain(*shape.size)} m, height: {plain(high - low)} m"
        ]
        if (friction := _friction([geometry], scene)) is not None:
            parts.append(f"friction: {plain(friction)}")
        result.world.append(("terrain", f"{{{', '.join(parts)}}}"))
        return {body.node}
    return set()


def _picture(grid: Grid, low: float, high: float) -> bytes:
    """Return the heights of a grid as a gray PNG of 16 bits, of which the upper row is the one of largest
    y."""
    from PIL import Image

    shares = (grid.heights[::-1] - low) / (high - low)
    content = BytesIO()
    Image.fromarray(np.rint(shares * 65535).astype(np.uint16)).save(content, "PNG")
    return content.getvalue()


# Objects


def _object(body: Body, scene: Scene, name: str, is_used: bool, result: Surroundings) -> None:
    label = text(body.node, "name") or body.node.type
    solid = [geometry for geometry in body.geometries if not _is_ground(geometry, body)]
    if not solid:
        if is_used:
            pose = pose_text(body.frame)
            result.objects[name] = f"{{shape: sphere, radius: 1 cm, solid: false, fixed: true, pose: {pose}}}"
        return
    reason = ""
    if len(result.objects) + len(solid) > MAX_OBJECTS:
        reason = f", because the world has more than {MAX_OBJECTS} objects"
    elif any(child.parent is body for child in scene.bodies) or (body.is_free and len(solid) > 1):
        reason = ", which has several parts: write a robot file for it"
    if reason:
        result.left_out.append((body.node.span.location, f"'{label}'{reason}"))
        return
    for position, geometry in enumerate(solid):
        shape = _shape_text(geometry.shape)
        if shape is None:
            result.left_out.append((body.node.span.location, f"the {kind_of(geometry.shape)} of '{label}'"))
            continue
        parts = [shape]
        mass = sum(inertia.mass for _, inertia in body.inertias)
        parts.append(f"mass: {plain(mass)} kg" if body.is_free and mass > 0 else "fixed: true")
        if (friction := _friction([geometry], scene)) is not None:
            parts.append(f"friction: {plain(friction)}")
        parts.append(f"pose: {pose_text(frames.compose(body.frame, geometry.frame))}")
        result.objects[name if position == 0 else f"{name}_{position + 1}"] = f"{{{', '.join(parts)}}}"


def _is_ground(geometry: Geometry, body: Body) -> bool:
    """Return whether a plane is the ground of a scenario: level, at the height 0."""
    if not isinstance(geometry.shape, Plane) or body.is_free:
        return False
    position, orientation = frames.compose(body.frame, geometry.frame)
    return abs(position[2]) < 1e-3 and frames.rotate(orientation, (0.0, 0.0, 1.0))[2] > 0.9999


def _shape_text(shape: Shape) -> str | None:
    match shape:
        case urdf.Box(size):
            return f"shape: box, size: {plain(*size)} m"
        case urdf.Sphere(radius):
            return f"shape: sphere, radius: {plain(radius)} m"
        case urdf.Cylinder(radius, height) | urdf.Capsule(radius, height):
            return f"shape: {kind_of(shape)}, radius: {plain(radius)} m, height: {plain(height)} m"
    return None


def pose_text(frame: Frame) -> str:
    """Return a frame as the value of `pose`."""
    pose = pose_of(frame)
    parts = [f"xyz: {plain(*pose.xyz)} m"]
    if hypot(*pose.rpy) > 1e-9:
        parts.append(f"rpy: {plain(*pose.rpy)} rad")
    return f"{{{', '.join(parts)}}}"
