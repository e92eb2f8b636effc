"""Geometries: their sizes, volumes and meshes; how Shape nodes look: color and texture; the color of the sky.

A texture covers a face of a box, a plane or a grid; other shapes have its mean color.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from io import BytesIO
from math import cos, isfinite, pi, sin
from typing import TYPE_CHECKING, Literal

import numpy as np

from deepbots_cli import frames
from deepbots_cli.errors import UsageError
from deepbots_cli.files import is_file, read_at_most
from deepbots_cli.robots.meshes import mesh_problem, mesh_size
from deepbots_cli.webots.nodes import child, integer, is_a, number, numbers, real, texts, vector, vectors
from deepbots_cli.webots.syntax import WorldFindings

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from deepbots_cli.frames import Frame, Triple
    from deepbots_cli.webots.project import Files
    from deepbots_cli.webots.scene import Visual
    from deepbots_cli.webots.syntax import Node

    Pixels = NDArray[np.uint8]


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


def inverse(frame: Frame) -> Frame:
    """Return the frame of the outer one in a frame of it."""
    rotation = frames.inverse(frame[1])
    return frames.rotate(rotation, frames.scaled(frame[0], -1.0)), rotation


# How Shape nodes look

MAX_PICTURE_BYTES = 16 * 2**20
MAX_PICTURE_SIDE = 4096
"""The largest file of a texture, and its largest width and height in pixels."""
SIDE = 512
"""The largest width and height that is drawn, in pixels."""
MAX_REPEATS = 10_000.0
_MISSING = ((1.0, 1.0, 1.0), (0.55, 0.55, 0.55))
"""The squares of a texture that is not available, as parts of the color of the appearance."""
_PATTERNS: Mapping[str, tuple[Triple, ...]] = {
    "deepbots:parquetry": ((1.0, 0.84, 0.64), (0.92, 0.75, 0.55)),
    "deepbots:chequered parquetry": ((1.0, 0.84, 0.64), (0.62, 0.43, 0.28)),
    "deepbots:sand": ((1.0, 0.88, 0.68),),
    "deepbots:grass": ((0.45, 0.66, 0.32),),
    "deepbots:asphalt": ((0.5, 0.5, 0.52),),
}
"""The colors of the two squares of each pattern of the library, by its address. A single color has no
squares."""
_TILE_M = 0.5
"""The length of a pattern of the library: two squares."""


@dataclass(frozen=True, eq=False)
class Texture:
    """A picture: `pixels` of shape (rows, columns, 3). It repeats `repeats` times along x and y of a face, or
    every `length` meters unless `length` is 0."""

    pixels: Pixels
    repeats: tuple[float, float] = (1.0, 1.0)
    length: float = 0.0

    @property
    def mean(self) -> Triple:
        """The mean color, from 0 to 1."""
        red, green, blue = (float(channel) / 255 for channel in self.pixels.mean(axis=(0, 1)))
        return red, green, blue

    def repeats_on(self, size: Sequence[float]) -> tuple[float, float]:
        """Return how often the picture repeats on a face of a size (m)."""
        if not self.length:
            return self.repeats
        x, y = (min(max(side / self.length, 1.0), MAX_REPEATS) for side in size[:2])
        return x, y


def texture_of(appearance: Node, field: str, files: Files) -> Texture | None:
    """Return the texture in a field of an appearance; None if it has none."""
    image = child(appearance, field)
    addresses = texts(image, "url") if image is not None else []
    if image is None or not addresses:
        return None
    address = addresses[0]
    if address in _PATTERNS:
        return Texture(_squares(_PATTERNS[address]), length=_TILE_M)
    path = files.picture(address, image.span.source.name)
    pixels = _pixels(path) if path is not None else None
    return Texture(pixels if pixels is not None else _squares(_MISSING, 2), _repeats(appearance))


def _repeats(appearance: Node) -> tuple[float, float]:
    transform = child(appearance, "textureTransform")
    x, y = numbers(transform, "scale")[:2] if transform is not None else (1.0, 1.0)
    if not (isfinite(x) and isfinite(y)):
        return 1.0, 1.0
    return min(abs(x), MAX_REPEATS) or 1.0, min(abs(y), MAX_REPEATS) or 1.0


def _pixels(path: Path) -> Pixels | None:
    """Return the pixels of a picture; None for one that is too large or cannot be read."""
    from PIL import Image

    try:
        data = read_at_most(path, MAX_PICTURE_BYTES + 1)
        if len(data) > MAX_PICTURE_BYTES:
            return None
        with Image.open(BytesIO(data), formats=("PNG", "JPEG")) as picture:
            # Pillow has read the header alone, so that a huge picture is refused before it takes memory.
            if max(picture.size) > MAX_PICTURE_SIDE:
                return None
            picture.thumbnail((SIDE, SIDE))
            return np.asarray(picture.convert("RGB"))
    # Pillow raises SyntaxError for a broken PNG.
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        return None


def _squares(colors: Sequence[Triple], count: int = 1) -> Pixels:
    """Return squares of two colors in turn, `count` pairs along each side; a single color is one square."""
    if len(colors) == 1:
        side = np.zeros((8, 8), np.intp)
    else:
        side = np.kron(np.indices((2 * count, 2 * count)).sum(axis=0) % 2, np.ones((32, 32), np.intp))
    return (np.array(colors)[side] * 255).round().astype(np.uint8)


CONE_SIDES = 32
"""The sides of a cone, which is drawn as a mesh."""


def visible_shape(visual: Visual, files: Files) -> Shape | None:
    """Return the geometry of a Shape node; None for one that is not drawn."""
    geometry = child(visual.node, "geometry")
    if geometry is None:
        return None
    if geometry.type == "Cone":
        return _cone(number(geometry, "bottomRadius"), number(geometry, "height"), visual.scale)
    return shape_of(geometry, visual.scale, files, WorldFindings())


def _cone(radius: float, height: float, scale: Triple) -> Shape:
    """Return a cone around z, with its base at the bottom."""
    rim: list[Triple] = [
        (radius * cos(2 * pi * k / CONE_SIDES), radius * sin(2 * pi * k / CONE_SIDES), -height / 2)
        for k in range(CONE_SIDES)
    ]
    points = [*rim, (0.0, 0.0, height / 2), (0.0, 0.0, -height / 2)]
    faces = []
    for k in range(CONE_SIDES):
        after = (k + 1) % CONE_SIDES
        faces += [(k, after, CONE_SIDES), (after, k, CONE_SIDES + 1)]
    scaled = [(x * scale[0], y * scale[1], z * scale[2]) for x, y, z in points]
    return Shape("mesh", vertices=scaled, faces=faces)


@dataclass(frozen=True)
class Look:
    """The color (red, green, blue, opacity, from 0 to 1) of a Shape node below its texture."""

    base: tuple[float, float, float, float] = (0.8, 0.8, 0.8, 1.0)
    texture: Texture | None = None

    @property
    def color(self) -> tuple[float, float, float, float]:
        """The color with the mean of the texture."""
        if self.texture is None:
            return self.base
        red, green, blue = (
            channel * share for channel, share in zip(self.base, self.texture.mean, strict=False)
        )
        return red, green, blue, self.base[3]


def look_of(node: Node, files: Files) -> Look:
    """Return the color and texture of a Shape node."""
    appearance = child(node, "appearance")
    if appearance is None:
        return Look()
    if is_a(appearance, "PBRAppearance"):
        return _look(appearance, "baseColor", texture_of(appearance, "baseColorMap", files))
    if not is_a(appearance, "Appearance"):
        return Look()
    texture = texture_of(appearance, "texture", files)
    material = child(appearance, "material")
    return _look(material, "diffuseColor", texture) if material is not None else Look(texture=texture)


def _look(node: Node, field: str, texture: Texture | None) -> Look:
    return Look((*vector(node, field), 1.0 - number(node, "transparency")), texture)


def color_of(node: Node, files: Files) -> Sequence[float]:
    """Return the color and opacity of a Shape node, with the mean color of its texture."""
    return look_of(node, files).color


def sky_color(nodes: Sequence[Node]) -> Triple | None:
    """Return the color of the sky; None in a world without a Background."""
    sky = next((real(node) for node in nodes if real(node).type == "Background"), None)
    return None if sky is None else vector(sky, "skyColor")
