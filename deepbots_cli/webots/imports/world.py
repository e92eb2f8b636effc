"""The surroundings of robots as entries of a scenario: timestep, gravity, arena, terrain, objects."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, field
from math import hypot
from typing import TYPE_CHECKING

from deepbots_cli import frames
from deepbots_cli.webots.imports.names import scenario_name
from deepbots_cli.webots.imports.robots import pose_of
from deepbots_cli.webots.looks import color_of
from deepbots_cli.webots.nodes import number, numbers, real, rotation, text, vector, walk

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from deepbots_cli.frames import Frame
    from deepbots_cli.webots.project import World
    from deepbots_cli.webots.scene import Body, Geometry, Scene
    from deepbots_cli.webots.shapes import Shape
    from deepbots_cli.webots.syntax import Node

MAX_OBJECTS = 60
LARGEST_SUBSTEP = 8  # ms; the largest at which physics is within 1 % of its closed forms


@dataclass
class Surroundings:
    """Entries of `world` and `objects` as pairs of key and YAML text, and what has no counterpart."""

    world: list[tuple[str, str]] = field(default_factory=list)
    objects: dict[str, str] = field(default_factory=dict)
    pictures: dict[str, bytes] = field(default_factory=dict)
    """PNG files that the entries name."""
    left_out: list[tuple[str, str]] = field(default_factory=list)
    """Locations and sentences about parts of the world without a counterpart."""


def surroundings(
    world: World, scene: Scene, objects: Mapping[int, str], used: Iterable[Node], step: int
) -> Surroundings:
    """Return the entries of a world; `objects` are names of bodies by their index, `used` the nodes that the
    code reads, and `step` the control step (ms)."""
    result = Surroundings()
    entries = result.world
    entries.append(("timestep", f"{step} ms"))
    substeps = -(-step // LARGEST_SUBSTEP)
    if substeps > 1:
        entries.append(("substeps", str(substeps)))
    if scene.gravity != (0.0, 0.0, -9.81):
        entries.append(("gravity", f"{plain(*scene.gravity)} m/s^2"))
    nodes_in_result = _arena(scene, result) | _terrain(world, scene, result)
    needed = set(used)
    for body in scene.bodies:
        if body.robot is None and body.node not in nodes_in_result and body.index in objects:
            _object(body, scene, objects[body.index], body.node in needed, result)
    return result


def plain(*values: float) -> str:
    """Return numbers with up to nine digits, separated by spaces."""
    return " ".join(f"{value + 0.0:.9g}" for value in values)


# Arena and terrain


def _proto_nodes(scene: Scene, kind: str) -> list[Node]:
    return [node for node in walk(scene.nodes) if node.type == kind and node.body is not None]


def _is_at_origin(node: Node) -> bool:
    return hypot(*vector(node, "translation")) < 1e-6 and abs(rotation(node, "rotation")[3]) > 1 - 1e-9


def _arena(scene: Scene, result: Surroundings) -> set[Node]:
    for node in _proto_nodes(scene, "RectangleArena"):
        if not _is_at_origin(node):
            continue
        x, y = (*numbers(node, "floorSize"), 1.0, 1.0)[:2]
        parts = [f"size: {plain(x, y)} m"]
        if (height := number(node, "wallHeight")) != 0.1:
            parts.append(f"wall_height: {plain(height)} m")
        if (thickness := number(node, "wallThickness")) != 0.01:
            parts.append(f"wall_thickness: {plain(thickness)} m")
        result.world.append(("arena", f"{{{', '.join(parts)}}}"))
        return {real(node)}
    return set()


def _terrain(world: World, scene: Scene, result: Surroundings) -> set[Node]:
    """Add the first grid that stays and lies around the origin, such as a Pit, as a picture of its
    heights."""
    for body in scene.bodies:
        is_alone = body.robot is None and body.parent is None and not body.is_free
        if not is_alone or [geometry.shape.kind for geometry in body.geometries] != ["grid"]:
            continue
        (geometry,) = body.geometries
        shape = geometry.shape
        low, high = min(shape.heights), max(shape.heights)
        (x, y, z), orientation = frames.compose(body.frame, geometry.frame)
        middle = (x + shape.size[0] / 2, y + shape.size[1] / 2, z + low)
        if max(map(abs, middle)) > 1e-6 or abs(orientation[3]) < 1 - 1e-9 or high - low < 1e-3:
            continue
        file = f"{scenario_name(world.path.stem)}_terrain.png"
        result.pictures[file] = _picture(shape, low, high)
        parts = [
            f"type: heightfield, file: {file}, size: {plain(*shape.size)} m, height: {plain(high - low)} m"
        ]
        friction = scene.contact(geometry.material, "default").friction
        if friction != 1.0:
            parts.append(f"friction: {plain(friction)}")
        result.world.append(("terrain", f"{{{', '.join(parts)}}}"))
        return {body.node}
    return set()


def _picture(shape: Shape, low: float, high: float) -> bytes:
    """Return the heights of a grid as a gray PNG of 16 bits, of which the upper row is the one of largest
    y."""
    levels = [round((height - low) / (high - low) * 65535) for height in shape.heights]
    rows = [levels[at : at + shape.columns] for at in range(0, len(levels), shape.columns)]
    pixels = b"".join(b"\0" + struct.pack(f">{len(row)}H", *row) for row in reversed(rows))
    header = struct.pack(">IIBBBBB", shape.columns, len(rows), 16, 0, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(pixels, 9)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in chunks
    )


# Objects


def _object(body: Body, scene: Scene, name: str, is_used: bool, result: Surroundings) -> None:
    label = text(body.node, "name") or body.node.type
    solid = [geometry for geometry in body.geometries if not _is_ground(geometry, body)]
    if not solid:
        if is_used:
            pose = pose_text(body.frame)
            result.objects[name] = f"{{shape: sphere, radius: 1 cm, solid: false, fixed: true, pose: {pose}}}"
        return
    if len(result.objects) + len(solid) > MAX_OBJECTS:
        _leave_out(body, f"'{label}', because the world has more than {MAX_OBJECTS} objects", result)
        return
    if body.parent is not None or any(child.parent is body for child in scene.bodies):
        _leave_out(body, f"'{label}', which has joints: write a robot file for it", result)
        return
    if body.is_free and len(solid) > 1:
        _leave_out(body, f"'{label}', a body of {len(solid)} shapes: write a robot file for it", result)
        return
    for position, geometry in enumerate(solid):
        shape = _shape_text(geometry.shape)
        if shape is None:
            _leave_out(body, f"the {geometry.shape.kind} of '{label}'", result)
            continue
        parts = [shape]
        mass = geometry.mass + sum(inertia.mass for inertia in body.inertias)
        parts.append(f"mass: {plain(mass)} kg" if body.is_free and mass > 0 else "fixed: true")
        friction = scene.contact(geometry.material, "default").friction
        if friction != 1.0:
            parts.append(f"friction: {plain(friction)}")
        parts.append(f"pose: {pose_text(frames.compose(body.frame, geometry.frame))}")
        if color := _color_text(body, scene):
            parts.append(f"color: '{color}'")
        result.objects[name if position == 0 else f"{name}_{position + 1}"] = f"{{{', '.join(parts)}}}"


def _color_text(body: Body, scene: Scene) -> str:
    """Return the color of the first Shape node of a body, such as `#ff0000`; empty without one."""
    visual = next((visual for visual in scene.visuals if visual.body is body), None)
    if visual is None:
        return ""
    channels = (
        round(255 * min(max(channel, 0.0), 1.0)) for channel in color_of(visual.node, scene.files)[:3]
    )
    return "#" + "".join(f"{channel:02x}" for channel in channels)


def _leave_out(body: Body, sentence: str, result: Surroundings) -> None:
    result.left_out.append((body.node.span.location, sentence))


def _is_ground(geometry: Geometry, body: Body) -> bool:
    """Return whether a plane is the ground of a scenario: level, at the height 0."""
    if geometry.shape.kind != "plane" or body.is_free:
        return False
    position, orientation = frames.compose(body.frame, geometry.frame)
    return abs(position[2]) < 1e-3 and frames.rotate(orientation, (0.0, 0.0, 1.0))[2] > 0.9999


def _shape_text(shape: Shape) -> str | None:
    match shape.kind:
        case "box":
            return f"shape: box, size: {plain(*shape.size)} m"
        case "sphere":
            return f"shape: sphere, radius: {plain(*shape.size)} m"
        case "cylinder" | "capsule":
            radius, height = shape.size
            return f"shape: {shape.kind}, radius: {plain(radius)} m, height: {plain(height)} m"
    return None


def pose_text(frame: Frame) -> str:
    """Return a frame as the value of `pose`."""
    pose = pose_of(frame)
    parts = [f"xyz: {plain(*pose.xyz)} m"]
    if hypot(*pose.rpy) > 1e-9:
        parts.append(f"rpy: {plain(*pose.rpy)} rad")
    return f"{{{', '.join(parts)}}}"
