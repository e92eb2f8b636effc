"""Geometries: their sizes, volumes and meshes; how Shape nodes look: color and texture; the color of the sky.

A texture covers a face of a box, a plane or a grid; other shapes have its mean color.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from io import BytesIO
from math import isfinite
from typing import TYPE_CHECKING, Any

import numpy as np

from deepbots_cli import frames
from deepbots_cli.errors import UsageError
from deepbots_cli.files import is_file, read_at_most
from deepbots_cli.geometry import HeightGrid
from deepbots_cli.records import dataclass
from deepbots_cli.robots.meshes import mesh_problem, mesh_size
from deepbots_cli.robots.model import (
    Box,
    Capsule,
    Cylinder,
    Inertial,
    Pose,
    Sphere,
    homogeneous_inertial,
    volume,
)
from deepbots_webots.nodes import child, integer, number, numbers, real, texts, vector, vectors
from deepbots_webots.syntax import Node, WorldFindings

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from deepbots_cli.frames import Frame, Triple
    from deepbots_webots.project import Files
    from deepbots_webots.scene import Visual

    Floats = NDArray[np.float64]
    Pixels = NDArray[np.uint8]


MAX_MESH_BYTES = 32 * 2**20
MAX_VERTICES = 200_000
MAX_HEIGHTS = 1_000_000  # the maximum numbers of vertices of a mesh, and of heights of a grid
MAX_FACES = 2 * MAX_VERTICES  # as many as a closed mesh has
_PLY_FACES = re.compile(rb"element[ \t]+face[ \t]+([0-9]{1,18})")
_EXACT = 12  # digits behind the point of a length (m) or an angle (rad)
_FLAT = 1e-9  # m; a mesh of less extent along some axis has no volume


@dataclass(frozen=True)
class Plane:
    """A plane, which collides without end; `size` is the extent of its picture along x and y, m."""

    size: tuple[float, ...]


class Grid(HeightGrid):
    """Heights over a rectangle that begins at the origin."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles: points, m, shape (points, 3), and the points of each face, shape (faces, 3)."""

    vertices: Floats
    faces: NDArray[np.int32]


Shape = Box | Sphere | Cylinder | Capsule | Plane | Grid | Mesh
"""A geometry in its own frame. The axis of a cylinder or capsule is z."""


def kind_of(shape: Shape) -> str:
    """Return the name of the kind of a shape, such as `box`."""
    return type(shape).__name__.lower()


def volume_of(shape: Shape) -> float:
    """Return the volume, m^3; 0 for planes and grids."""
    if isinstance(shape, Mesh):
        return abs(float(trimesh_of(shape).volume))
    return 0.0 if isinstance(shape, Plane | Grid) else volume(shape) or 0.0


def inertial_of(shape: Shape, mass: float, frame: Frame) -> Inertial:
    """Return the inertial of a homogeneous box, ball, cylinder, capsule or mesh at a frame."""
    if not isinstance(shape, Mesh):
        inertial = (
            None if isinstance(shape, Plane | Grid) else homogeneous_inertial(shape, mass, pose_of(frame))
        )
        assert inertial is not None  # planes and grids have no mass
        return inertial
    solid = trimesh_of(shape)
    solid.density = mass / solid.volume  # both are negative if faces point inward
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = solid.moment_inertia.tolist()
    x, y, z = solid.center_mass.tolist()
    center = compose(frame, ((x, y, z), frames.IDENTITY_ROTATION))
    return Inertial(mass, pose_of(center), xx, xy, xz, yy, yz, zz)


def trimesh_of(mesh: Mesh) -> Any:
    """Return a mesh as one of trimesh."""
    import trimesh

    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


def pose_of(frame: Frame) -> Pose:
    """Return a frame as a pose: m, and rad about fixed axes."""
    (x, y, z), rotation = frame
    roll, pitch, yaw = frames.roll_pitch_yaw(frames.normalized(rotation))
    return Pose((_rounded(x), _rounded(y), _rounded(z)), (_rounded(roll), _rounded(pitch), _rounded(yaw)))


def _rounded(value: float) -> float:
    return round(value, _EXACT) + 0.0


def shape_of(node: Node, scale: Triple, files: Files, findings: WorldFindings) -> Shape | None:
    """Return the geometry of a node, scaled; None with a finding for one that cannot collide."""
    sx, sy, sz = (abs(factor) for factor in scale)
    widest = max(sx, sy)
    match node.type:
        case "Box":
            x, y, z = (*numbers(node, "size"), 0.0, 0.0, 0.0)[:3]
            return _positive(node, Box((x * sx, y * sy, z * sz)), (x * sx, y * sy, z * sz), findings)
        case "Sphere":
            radius = number(node, "radius") * max(widest, sz)
            return _positive(node, Sphere(radius), (radius,), findings)
        case "Cylinder" | "Capsule":
            kind = Cylinder if node.type == "Cylinder" else Capsule
            size = (number(node, "radius") * widest, number(node, "height") * sz)
            return _positive(node, kind(*size), size, findings)
        case "Plane":
            return Plane(tuple(numbers(node, "size")[:: -1 if node.has_old_axes else 1]))
        case "ElevationGrid":
            return _grid(node, (sx, sy, sz), findings)
        case "IndexedFaceSet":
            return _face_set(node, (sx, sy, sz), findings)
        case "Mesh":
            return _mesh(node, (sx, sy, sz), files, findings)
    findings.warning(node.span, f"{node.type} cannot collide", "it is left out of the bounding object")
    return None


def _positive(node: Node, shape: Shape, size: Sequence[float], findings: WorldFindings) -> Shape | None:
    if all(1e-7 < length < 1e6 for length in size):
        return shape
    findings.error(node.span, f"a {node.type} whose size is not positive, or is above 1000 km")
    return None


def _grid(node: Node, scale: Triple, findings: WorldFindings) -> Shape | None:
    second = "y"
    if node.has_old_axes:  # rows along z, which is x now
        second, scale = "z", (scale[1], scale[0], scale[2])
    columns, rows = integer(node, "xDimension"), integer(node, f"{second}Dimension")
    heights = numbers(node, "height")
    along_x, along_y = number(node, "xSpacing") * scale[0], number(node, f"{second}Spacing") * scale[1]
    if columns < 2 or rows < 2 or not (0 < along_x < 1e6 and 0 < along_y < 1e6):
        findings.error(node.span, "an ElevationGrid with less than two rows or columns, or without spacing")
        return None
    if columns * rows > MAX_HEIGHTS:
        findings.error(node.span, f"an ElevationGrid with more than {MAX_HEIGHTS:,} heights")
        return None
    count = columns * rows
    filled = np.array((heights + [0.0] * count)[:count]).reshape(rows, columns)  # Webots fills with 0
    extent = ((columns - 1) * along_x, (rows - 1) * along_y)
    return Grid(filled.T * scale[2], extent[::-1]) if node.has_old_axes else Grid(filled * scale[2], extent)


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


def _load_mesh(path: Path) -> tuple[Any, Any]:
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
    return loaded.vertices, loaded.faces


def _solid_mesh(node: Node, points: Any, faces: Any, scale: Triple, findings: WorldFindings) -> Shape | None:
    scaled = np.array(points, np.float64).reshape(-1, 3) * scale
    extents = np.ptp(scaled, axis=0) if len(scaled) else np.zeros(3)
    if len(scaled) < 4 or not len(faces) or extents.min() < _FLAT:
        findings.error(node.span, f"{node.type} encloses no volume", "use a Box as the bounding object")
        return None
    if len(scaled) > MAX_VERTICES or extents.max() > 1e6:
        findings.error(node.span, f"{node.type} has more than {MAX_VERTICES:,} points, or is above 1000 km")
        return None
    return Mesh(scaled, np.array(faces, np.int32))


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
MAX_PICTURE_SIDE = 4096  # the largest file of a texture, and its largest width and height in pixels
SIDE = 512  # the largest width and height that is drawn, in pixels
MAX_REPEATS = 10_000.0
_MISSING = ((1.0, 1.0, 1.0), (0.55, 0.55, 0.55))
"""The squares of a texture that is not available, as parts of the color of the appearance."""
_PATTERNS: Mapping[str, tuple[Triple, ...]] = {
    "deepbots:Parquetry": ((1.0, 0.84, 0.64), (0.92, 0.75, 0.55)),
    "deepbots:ChequeredParquetry": ((1.0, 0.84, 0.64), (0.62, 0.43, 0.28)),
    "deepbots:SandyGround": ((1.0, 0.88, 0.68),),
    "deepbots:Grass": ((0.45, 0.66, 0.32),),
    "deepbots:Asphalt": ((0.5, 0.5, 0.52),),
}
"""The colors of the two squares of each pattern of the library, by its address. A single color has no
squares."""
_TILE_M = 0.5  # the length of a pattern of the library: two squares


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


CONE_SIDES = 32  # the sides of a cone, which is drawn as a mesh


def visible_shape(visual: Visual, files: Files) -> Shape | None:
    """Return the geometry of a Shape node; None for one that is not drawn."""
    geometry = child(visual.node, "geometry")
    if geometry is None:
        return None
    if geometry.type != "Cone":
        return shape_of(geometry, visual.scale, files, WorldFindings())
    import trimesh

    height = number(geometry, "height")
    cone = trimesh.creation.cone(number(geometry, "bottomRadius"), height, sections=CONE_SIDES)
    # Its base is at the bottom.
    return Mesh((cone.vertices - (0.0, 0.0, height / 2)) * visual.scale, cone.faces.astype(np.int32))


Color = tuple[float, float, float, float]
"""Red, green, blue and opacity, from 0 to 1."""
GRAY: Color = (0.8, 0.8, 0.8, 1.0)


@dataclass(frozen=True)
class Look:
    """The color of a Shape node below its texture."""

    base: Color = GRAY
    texture: Texture | None = None

    @property
    def color(self) -> Color:
        """The color and opacity, with the mean color of the texture."""
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
    field = "baseColorMap" if appearance.type == "PBRAppearance" else "texture"
    return Look(base_color(appearance), texture_of(appearance, field, files))


def base_color(appearance: Node) -> Color:
    """Return the color of an appearance below its texture."""
    is_pbr = appearance.type == "PBRAppearance"
    colored = appearance if is_pbr else child(appearance, "material")
    if colored is None:
        return GRAY
    return *vector(colored, "baseColor" if is_pbr else "diffuseColor"), 1.0 - number(colored, "transparency")


def sky_color(nodes: Sequence[Node]) -> Triple | None:
    """Return the color of the sky; None in a world without a Background."""
    sky = next((real(node) for node in nodes if real(node).type == "Background"), None)
    return None if sky is None else vector(sky, "skyColor")
