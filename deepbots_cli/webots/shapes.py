"""Geometries: their sizes, volumes and meshes."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from io import BytesIO
from math import pi
from typing import TYPE_CHECKING, Literal

from deepbots_cli import frames
from deepbots_cli.errors import UsageError
from deepbots_cli.files import is_file, read_at_most
from deepbots_cli.robots.meshes import mesh_problem, mesh_size
from deepbots_cli.webots.nodes import child, integer, number, numbers, texts, vectors

if TYPE_CHECKING:
    from pathlib import Path

    from deepbots_cli.frames import Frame, Triple
    from deepbots_cli.webots.findings import WorldFindings
    from deepbots_cli.webots.project import Files
    from deepbots_cli.webots.syntax import Node

MAX_MESH_BYTES = 32 * 2**20
MAX_VERTICES = 200_000
MAX_HEIGHTS = 1_000_000
"""The maximum numbers of vertices of a mesh, and of heights of a grid."""
MAX_FACES = 2 * MAX_VERTICES  # as many as a closed mesh has
_PLY_FACES = re.compile(rb"element[ \t]+face[ \t]+([0-9]{1,18})")
_FLAT = 1e-9  # m; a mesh of less extent along some axis has no volume

Kind = Literal["box", "sphere", "cylinder", "capsule", "plane", "mesh", "grid"]


@dataclass(eq=False)
class Shape:
    """A geometry in its own frame.

    `size` (m) is that of a box; radius and height of a cylinder or capsule, whose axis is z; the radius of a
    sphere; the extent of a grid along x and y. A capsule is without its caps as high as `height`. A grid
    begins at its origin; its heights are row by row along x.
    """

    kind: Kind
    size: tuple[float, ...] = ()
    vertices: Sequence[Triple] = ()
    faces: Sequence[tuple[int, int, int]] = ()
    heights: Sequence[float] = ()
    columns: int = 0

    @cached_property
    def volume(self) -> float:
        """In m^3; 0 for planes and grids."""
        match self.kind:
            case "box":
                x, y, z = self.size
                return x * y * z
            case "sphere":
                return 4 / 3 * pi * self.size[0] ** 3
            case "cylinder":
                return pi * self.size[0] ** 2 * self.size[1]
            case "capsule":
                radius, height = self.size
                return pi * radius**2 * height + 4 / 3 * pi * radius**3
            case "mesh":
                return _mesh_volume(self.vertices, self.faces)
        return 0.0


def shape_of(node: Node, scale: Triple, files: Files, findings: WorldFindings) -> Shape | None:
    """Return the geometry of a node, scaled; None with a finding for one that cannot collide."""
    sx, sy, sz = (abs(factor) for factor in scale)
    widest = max(sx, sy)
    match node.type:
        case "Box":
            x, y, z = (*numbers(node, "size"), 0.0, 0.0, 0.0)[:3]
            return _positive(node, Shape("box", (x * sx, y * sy, z * sz)), findings)
        case "Sphere":
            return _positive(node, Shape("sphere", (number(node, "radius") * max(widest, sz),)), findings)
        case "Cylinder" | "Capsule":
            kind: Kind = "cylinder" if node.type == "Cylinder" else "capsule"
            size = (number(node, "radius") * widest, number(node, "height") * sz)
            return _positive(node, Shape(kind, size), findings)
        case "Plane":
            return Shape("plane", tuple(numbers(node, "size")))
        case "ElevationGrid":
            return _grid(node, (sx, sy, sz), findings)
        case "IndexedFaceSet":
            return _face_set(node, (sx, sy, sz), findings)
        case "Mesh":
            return _mesh(node, (sx, sy, sz), files, findings)
    findings.warning(node.span, f"{node.type} cannot collide", "it is left out of the bounding object")
    return None


def _positive(node: Node, shape: Shape, findings: WorldFindings) -> Shape | None:
    if all(1e-7 < length < 1e6 for length in shape.size):
        return shape
    findings.error(node.span, f"a {node.type} whose size is not positive, or is above 1000 km")
    return None


def _grid(node: Node, scale: Triple, findings: WorldFindings) -> Shape | None:
    columns, rows = integer(node, "xDimension"), integer(node, "yDimension")
    heights = numbers(node, "height")
    along_x, along_y = number(node, "xSpacing") * scale[0], number(node, "ySpacing") * scale[1]
    if columns < 2 or rows < 2 or not (0 < along_x < 1e6 and 0 < along_y < 1e6):
        findings.error(node.span, "an ElevationGrid with less than two rows or columns, or without spacing")
        return None
    if columns * rows > MAX_HEIGHTS:
        findings.error(node.span, f"an ElevationGrid with more than {MAX_HEIGHTS:,} heights")
        return None
    count = columns * rows
    heights = [height * scale[2] for height in (heights + [0.0] * count)[:count]]  # Webots fills with 0
    size = ((columns - 1) * along_x, (rows - 1) * along_y)
    return Shape("grid", size, heights=heights, columns=columns)


def _face_set(node: Node, scale: Triple, findings: WorldFindings) -> Shape | None:
    coordinates = child(node, "coord")
    points = vectors(coordinates, "point") if coordinates is not None else []
    faces: list[tuple[int, int, int]] = []
    corners: list[int] = []
    for index in (*numbers(node, "coordIndex"), -1.0):
        if index >= 0:
            corners.append(int(index))
            continue
        # A fan is right for convex faces, which VRML assumes by default.
        faces += [(corners[0], corners[at], corners[at + 1]) for at in range(1, len(corners) - 1)]
        corners = []
    if any(corner >= len(points) for face in faces for corner in face):
        findings.error(node.span, "an IndexedFaceSet whose coordIndex names a point that does not exist")
        return None
    return _solid_mesh(node, points, faces, scale, findings)


def _mesh(node: Node, scale: Triple, files: Files, findings: WorldFindings) -> Shape | None:
    address = next(iter(texts(node, "url")), "")
    path = files.project / "worlds" / address
    if "://" in address or not is_file(path) or not files.allows(path):
        findings.error(node.span, f"the mesh '{address[:80]}' is not a file of the project")
        return None
    try:
        points, faces = _load_mesh(path)
    except (ValueError, OSError, KeyError, IndexError, UsageError) as error:
        findings.error(node.span, f"the mesh '{address[:80]}' cannot be read: {str(error)[:100]}")
        return None
    return _solid_mesh(node, points, faces, scale, findings)


def _load_mesh(path: Path) -> tuple[list[Triple], list[tuple[int, int, int]]]:
    import trimesh

    suffix = path.suffix[1:].lower()
    if suffix not in ("stl", "obj", "ply"):
        raise UsageError("deepbots reads STL, OBJ and PLY")
    data = read_at_most(path, MAX_MESH_BYTES + 1)
    if len(data) > MAX_MESH_BYTES:
        raise UsageError(f"it is larger than {MAX_MESH_BYTES >> 20} MiB")
    # 32 MiB have millions of faces, which take trimesh 26 s and 839 MB.
    problem = None if suffix == "ply" else mesh_problem(f".{suffix}", data)
    size = None if suffix == "ply" or problem else mesh_size(f".{suffix}", data)
    faces = (
        sum(map(int, _PLY_FACES.findall(data.partition(b"end_header")[0])))
        if size is None
        else size.triangles
    )
    if problem is not None or faces > MAX_FACES:
        raise UsageError(problem or f"it has {faces:,} faces, and the limit is {MAX_FACES:,}")
    loaded = trimesh.load_mesh(BytesIO(data), file_type=suffix, skip_materials=True)
    points = [(float(x), float(y), float(z)) for x, y, z in loaded.vertices]
    return points, [(int(a), int(b), int(c)) for a, b, c in loaded.faces]


def _solid_mesh(
    node: Node,
    points: Sequence[Triple],
    faces: Sequence[tuple[int, int, int]],
    scale: Triple,
    findings: WorldFindings,
) -> Shape | None:
    scaled = [(x * scale[0], y * scale[1], z * scale[2]) for x, y, z in points]
    extents = [max(axis) - min(axis) for axis in zip(*scaled, strict=True)] if scaled else []
    if len(scaled) < 4 or not faces or min(extents, default=0.0) < _FLAT:
        findings.error(node.span, f"{node.type} encloses no volume", "use a Box as the bounding object")
        return None
    if len(scaled) > MAX_VERTICES or max(extents) > 1e6:
        findings.error(node.span, f"{node.type} has more than {MAX_VERTICES:,} points, or is above 1000 km")
        return None
    return Shape("mesh", vertices=scaled, faces=faces)


def _mesh_volume(vertices: Sequence[Triple], faces: Sequence[tuple[int, int, int]]) -> float:
    # Signed tetrahedra with the origin (divergence theorem); faces that point inward give a negative sum.
    total = 0.0
    for a, b, c in faces:
        total += frames.dot(vertices[a], frames.cross(vertices[b], vertices[c]))
    return abs(total) / 6


def compose(outer: Frame, inner: Frame, scale: Triple = (1.0, 1.0, 1.0)) -> Frame:
    """Return a frame in the frame of `outer`; `scale` is that of the coordinates of `inner`."""
    (x, y, z), rotation = inner
    offset = frames.rotate(outer[1], (x * scale[0], y * scale[1], z * scale[2]))
    return frames.add(outer[0], offset), frames.multiply(outer[1], rotation)
