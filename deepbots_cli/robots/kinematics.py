"""Where the links and shapes of a robot are: frames of links, bounding boxes, the height at which a body
rests, its center of mass, what a joint moves, and which links may touch each other. Lengths are in m,
angles in rad.

Link frames do not use yourdfpy: lint needs them and imports no numpy.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations, product

from deepbots_cli import frames
from deepbots_cli.frames import Frame, Triple, quaternion
from deepbots_cli.robots.meshes import Bounds, mesh_bounds, mesh_reach
from deepbots_cli.robots.model import (
    WATER,
    Box,
    Capsule,
    Cylinder,
    Geometry,
    Inertial,
    Joint,
    Link,
    Mesh,
    Pose,
    RobotModel,
    Shape,
    Sphere,
    combined,
    homogeneous_inertial,
    volume,
    with_link,
)

_MIN_SIDE_M = 1e-4
"""The least side of the box in place of a mesh, which may be flat."""

# Link frames


def link_frames(model: RobotModel, positions: Mapping[str, float] | None = None) -> dict[str, Frame]:
    """Return the frame of every link in the frame of the root; `positions` of joints (rad or m) are by name;
    others are at 0 or follow."""
    positions = positions or {}
    if model.followers:
        followers = {
            name: mimic.position(positions.get(mimic.joint, 0.0)) for name, mimic in model.followers.items()
        }
        positions = {**followers, **positions}
    frames_by_link = {model.root: frames.IDENTITY_FRAME}
    waiting = [model.root]
    while waiting:
        parent = waiting.pop()
        for joint in model.joints_below[parent]:
            frames_by_link[joint.child] = child_frame(
                joint, frames_by_link[parent], positions.get(joint.name, 0.0)
            )
            waiting.append(joint.child)
    return frames_by_link


def child_frame(joint: Joint, parent: Frame, position: float) -> Frame:
    """Return the frame of a joint's child link, from the frame of its parent link."""
    frame = frames.compose(parent, frames.frame(joint.origin))
    if not joint.moves or position == 0.0:
        return frame
    # URDF gives the axis in the frame of the joint, so the motion follows the origin.
    if joint.type == "prismatic":
        return frames.compose(frame, (frames.scaled(joint.axis, position), frames.IDENTITY_ROTATION))
    return frames.compose(frame, (frames.IDENTITY_FRAME[0], frames.from_axis_angle(joint.axis, position)))


def placed(
    model: RobotModel,
    shapes_of: Callable[[Link], Iterable[Geometry]],
    positions: Mapping[str, float] | None = None,
) -> list[tuple[Shape, Frame]]:
    """Return the shapes of each link of a robot, in the frame of its root."""
    where = link_frames(model, positions)
    parts = [(where[link.name], part) for link in model.links for part in shapes_of(link)]
    return [(part.shape, frames.compose(link, frames.frame(part.origin))) for link, part in parts]


# Bounding boxes


def robot_bounds(model: RobotModel, positions: Mapping[str, float] | None = None) -> Bounds:
    """Return the box around all shapes of a robot and the origins of its links, in the frame of its root;
    `positions` as in `link_frames`."""
    boxes = [
        bounds_of_shape(shape, frame)
        for shape, frame in placed(model, lambda link: (*link.visuals, *link.collisions), positions)
    ]
    boxes += [(origin, origin) for origin, _ in link_frames(model, positions).values()]
    return box_around(boxes)


def without_meshes(model: RobotModel) -> RobotModel:
    """Return the robot without its meshes, which may take seconds to read."""

    def plain(parts: tuple[Geometry, ...]) -> tuple[Geometry, ...]:
        return tuple(part for part in parts if not isinstance(part.shape, Mesh))

    links = tuple(
        replace(link, visuals=plain(link.visuals), collisions=plain(link.collisions)) for link in model.links
    )
    return replace(model, links=links)


def box_around(boxes: Sequence[Bounds]) -> Bounds:
    """Return the box around all boxes; a cube of 1 m around the origin for none."""
    lows, highs = zip(*(boxes or [((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5))]), strict=True)
    (x, y, z), (x_end, y_end, z_end) = map(min, zip(*lows, strict=True)), map(max, zip(*highs, strict=True))
    return (x, y, z), (x_end, y_end, z_end)


def box_sides(box: Bounds) -> Triple:
    """Return the lengths of a box along x, y and z."""
    return frames.subtract(box[1], box[0])


def resting_height(
    body: Shape | RobotModel,
    roll: float = 0.0,
    pitch: float = 0.0,
    positions: Mapping[str, float] | None = None,
) -> float:
    """Return the height of the origin of a body that rests on flat ground with this attitude: the lowest
    point of an object, or of all collision shapes of a robot; `positions` as in `link_frames`."""
    tilted = (frames.IDENTITY_FRAME[0], quaternion(roll, pitch, 0.0))
    if not isinstance(body, RobotModel):
        # `0.0 - z` and not `-z`, which is -0.0 for a body with its lowest point at the origin.
        return 0.0 - lowest_point(body, tilted)
    parts = placed(body, lambda link: link.collisions, positions)
    return 0.0 - min(
        (lowest_point(shape, frames.compose(tilted, frame)) for shape, frame in parts), default=0.0
    )


def lowest_point(shape: Shape, frame: Frame) -> float:
    """Return the height of the lowest point of a shape whose own frame is `frame`; of a mesh, that of its
    vertices."""
    if isinstance(shape, Mesh):
        return frame[0][2] - mesh_reach(shape, frames.rotate_back(frame[1], (0.0, 0.0, -1.0)))
    return bounds_of_shape(shape, frame)[0][2]


def highest_point(shape: Shape, frame: Frame) -> float:
    """Return the height of the highest point of a shape, as `lowest_point` does."""
    if isinstance(shape, Mesh):
        return frame[0][2] + mesh_reach(shape, frames.rotate_back(frame[1], (0.0, 0.0, 1.0)))
    return bounds_of_shape(shape, frame)[1][2]


def bounds_of_shape(shape: Shape, frame: Frame = frames.IDENTITY_FRAME) -> Bounds:
    """Return the box around a shape whose own frame is `frame`."""
    (x, y, z), turn = frame
    match shape:
        case Sphere(radius):
            dx = dy = dz = radius
        case Capsule(radius, length):
            dx, dy, dz = (abs(c) * length / 2 + radius for c in frames.rotate(turn, (0.0, 0.0, 1.0)))
        case Cylinder(radius, length):
            axis = frames.rotate(turn, (0.0, 0.0, 1.0))
            # Rounding may take |c| above 1, and Python's root of a negative number is complex.
            dx, dy, dz = (abs(c) * length / 2 + radius * max(0.0, 1.0 - c * c) ** 0.5 for c in axis)
        case _:
            xs, ys, zs = zip(*corners(shape, frame), strict=True)
            return (min(xs), min(ys), min(zs)), (max(xs), max(ys), max(zs))
    return (x - dx, y - dy, z - dz), (x + dx, y + dy, z + dz)


def corners(shape: Shape, frame: Frame) -> list[Triple]:
    """Return the corners of the box around a shape in its own axes; a mesh whose size is unknown counts as
    its origin."""
    x, y, z = zip(*_own_bounds(shape), strict=True)
    return [frames.add(frame[0], frames.rotate(frame[1], corner)) for corner in product(x, y, z)]


def _own_bounds(shape: Shape) -> Bounds:
    match shape:
        case Mesh():
            return mesh_bounds(shape) or (frames.IDENTITY_FRAME[0], frames.IDENTITY_FRAME[0])
        case Box(size):
            a, b, c = size[0] / 2, size[1] / 2, size[2] / 2
        case Cylinder(radius, length):
            a, b, c = radius, radius, length / 2
        case Capsule(radius, length):
            a, b, c = radius, radius, length / 2 + radius
        case Sphere(radius):
            a = b = c = radius
    return (-a, -b, -c), (a, b, c)


# Inertia from shapes


def inertial_of_shapes(link: Link, mass: float) -> Inertial | None:
    """Return the inertial of a link of `mass` kg whose shapes are homogeneous, by its collision shapes or
    else its visuals; None without any. The box around it replaces a mesh."""
    pieces = [_solid(piece) for piece in link.collisions or link.visuals]
    volumes = [volume(shape) or 0.0 for shape, _ in pieces]
    if not sum(volumes) > 0.0:
        return None
    parts = [
        homogeneous_inertial(shape, mass * share / sum(volumes), origin)
        for (shape, origin), share in zip(pieces, volumes, strict=True)
    ]
    return combined([part for part in parts if part is not None])


def _solid(piece: Geometry) -> tuple[Shape, Pose]:
    """Return a shape in place of a mesh: the box around it, and the pose of its middle."""
    if not isinstance(piece.shape, Mesh):
        return piece.shape, piece.origin
    bounds = mesh_bounds(piece.shape)
    if bounds is None:
        return Box((0.0, 0.0, 0.0)), piece.origin
    middle = frames.scaled(frames.add(*bounds), 0.5)
    xyz, _ = frames.compose(frames.frame(piece.origin), (middle, frames.IDENTITY_FRAME[1]))
    x, y, z = (max(side, _MIN_SIDE_M) for side in box_sides(bounds))
    return Box((x, y, z)), Pose(xyz, piece.origin.rpy)


def with_inertia_of_shapes(model: RobotModel, link: str) -> RobotModel | str:
    """Return the link with the inertia of its shapes about its center of mass; mass and center stay, and the
    axes are those of the link."""
    old = model.link(link)
    if old.inertial is None or old.inertial.mass <= 0.0:
        return (
            f"the inertia of link {link!r} needs a mass, and the robot file states none; write its `mass` too"
        )
    inertial = inertial_of_shapes(old, old.inertial.mass)
    if inertial is None:
        return f"link {link!r} has no shape, so its inertia cannot be computed"
    origin = Pose(old.inertial.origin.xyz, inertial.origin.rpy)
    return with_link(model, replace(old, inertial=replace(inertial, origin=origin)))


def with_mass_of_shapes(model: RobotModel, link: str, mass: float) -> RobotModel:
    """Return a link without a mass as a homogeneous body of `mass` kg: of its shapes, or a ball of water at
    its origin."""
    old = model.link(link)
    ball = Sphere((mass / (4 / 3 * math.pi * WATER)) ** (1 / 3))
    inertial = inertial_of_shapes(old, mass) or homogeneous_inertial(ball, mass)
    return with_link(model, replace(old, inertial=inertial, density=None))


# Masses


def center_of_mass(model: RobotModel, where: Mapping[str, Frame]) -> Triple:
    """Return the center of mass of a robot whose links have the frames `where`, in the same frame; the origin
    of its root without a mass."""
    masses = [(link.inertial, where[link.name]) for link in model.links if link.inertial is not None]
    weighted = [
        frames.scaled(frames.compose(frame, frames.frame(inertial.origin))[0], inertial.mass)
        for inertial, frame in masses
    ]
    mass = sum(inertial.mass for inertial, _ in masses)
    total = [sum(axis) for axis in zip(*weighted, strict=True)]
    return (total[0] / mass, total[1] / mass, total[2] / mass) if mass > 0.0 else where[model.root][0]


def joint_inertia(model: RobotModel, where: Mapping[str, Frame], joint: Joint) -> float:
    """Return the inertia (kg m^2 or kg) that a joint moves: that of the links behind it, and its armature."""
    pivot, joint_rotation = where[joint.child]
    axis = frames.rotate(joint_rotation, joint.axis)
    inertia = joint.armature
    for link in map(model.link, model.links_below(joint.child)):
        if link.inertial is None:
            continue
        mass = link.inertial.mass
        center, link_rotation = frames.compose(where[link.name], frames.frame(link.inertial.origin))
        if joint.type == "prismatic":
            inertia += mass
            continue
        arm = frames.cross(axis, frames.subtract(center, pivot))
        local = frames.rotate_back(link_rotation, axis)
        spin = sum(
            local[i] * row[j] * local[j] for i, row in enumerate(link.inertial.matrix) for j in range(3)
        )
        inertia += mass * frames.dot(arm, arm) + spin
    return inertia


def min_spring_inertia(stiffness: float, damping: float, step: float) -> float:
    """Return the inertia (kg m^2 or kg) above which the motion on a spring is stable in engine steps of h
    seconds.

    Engines compute the torque of a spring from the state before each step. With the stiffness k, the damping
    d and the inertia I, the motion is stable for k h^2 + 2 d h < 4 I (Jury's criterion for the semi-implicit
    Euler method).
    """
    return (stiffness * step**2 + 2.0 * damping * step) / 4.0


def self_collision_pairs(model: RobotModel) -> Iterator[tuple[str, str]]:
    """Yield the pairs of links of a robot that may touch each other: no rigid group has both, and no joint
    joins their groups."""
    heads = [model.root, *(joint.child for joint in model.joints if joint.type != "fixed")]
    group = {link: head for head in heads for link in model.links_below(head, rigid=True)}
    joined = {frozenset((group[joint.parent], group[joint.child])) for joint in model.joints}
    for first, second in combinations([link.name for link in model.links], 2):
        if group[first] != group[second] and frozenset((group[first], group[second])) not in joined:
            yield first, second
