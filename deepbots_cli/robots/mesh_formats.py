"""The triangles of STL, OBJ, COLLADA and glTF 2.0 files, and their faults. This module needs no numpy, since
lint imports it.

Every file is read here before an engine or a library reads it. PyBullet 3.2.7 crashes on a vertex that is not
a number and on an OBJ face that names a missing vertex; it draws nothing for an STL file of a wrong length.

COLLADA: the reader of PyBullet 3.2.7 crashes on an index beyond the vertices, on a reference that leads
nowhere and on a missing id, and does not end on a count that is too large. It composes rotations, and a scale
with a translation, in an order of its own (hokuyo.dae of pybullet_data lies on its side), and trimesh ignores
the unit of the file (duck.dae is 100 times as large). Both ignore `<up_axis>`, and so does this reader.

glTF: a `.glb` file has its buffer inside; a `.gltf` file is JSON, whose buffers are texts inside or files
beside it, and is read as the `.glb` file of the same content. Coordinates are taken as they are, as trimesh
and MuJoCo take them: glTF calls y up, and URDF has no such word. Materials, pictures and animations are left
out.
"""

from __future__ import annotations

import base64
import binascii
import json
import math
import os
import re
import struct
import sys
from array import array
from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote

from deepbots_cli.files import is_file, read_at_most
from deepbots_cli.frames import from_axis_angle, rotate
from deepbots_cli.records import dataclass

if TYPE_CHECKING:
    from xml.etree import ElementTree


_MAX_INDICES = 6_000_000  # 1,500,000 corners, as of an OBJ file, of four numbers each
MAX_CORNERS = 1_500_000
MAX_NODES = 10_000  # nodes may place others, so a short file could place billions
Rows = tuple[tuple[float, ...], ...]
"""The rows of an affine map: three of four numbers."""
IDENTITY: Rows = ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0))
_SECTIONS = ("asset", "library_geometries", "library_visual_scenes", "scene")
_FACES = ("triangles", "polylist", "polygons")


class FaultyMeshError(ValueError):
    """The reason why a file is not read, as a headline."""


@dataclass(frozen=True)
class Triangles:
    """The vertices of triangles: `numbers` has three coordinates per vertex, and `corners` the index of a
    vertex per corner, three per triangle."""

    numbers: array[float]
    corners: array[int]

    def moved(self, rows: Rows) -> array[float]:
        """Return the coordinates of the vertices in the frame to which `rows` map."""
        if rows == IDENTITY:
            return self.numbers
        points = list(zip(*(self.numbers[axis::3] for axis in range(3)), strict=True))
        moved = array("d", bytes(24 * len(points)))
        for axis, (a, b, c, d) in enumerate(rows):
            moved[axis::3] = array("d", [a * x + b * y + c * z + d for x, y, z in points])
        return moved


Placed = tuple[tuple[Triangles, Rows], ...]


@lru_cache(maxsize=1)
def placed_triangles(suffix: str, data: bytes) -> Placed:
    """Return the triangles of a mesh file, and the map from their frame to that of the file, once for each
    node that places them; coordinates are in the units of an STL or OBJ file, and in m of the others.

    Raises:
        FaultyMeshError: The file is not sound, has no triangle, or places too much.
    """
    read, headline = _READERS.get(suffix, (gltf_triangles, "the scene of the glTF file has no triangle"))
    placed = read(data)
    if not any(part.corners for part, _ in placed):
        raise FaultyMeshError(headline)
    return placed


# STL


_NUMBER = rb"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
_THREE_NUMBERS = rb"[ \t]+" + rb"[ \t]+".join([rb"(" + _NUMBER + rb")"] * 3) + rb"(?=\s|$)"


def is_text_stl(data: bytes) -> bool:
    """Return whether an STL file is text; some programs begin the header of a binary file with `solid`
    too."""
    return data.lstrip()[:5].lower() == b"solid" and b"facet" in data.lower()


def _stl_triangles(data: bytes) -> Placed:
    if is_text_stl(data):
        numbers = _places(data, rb"(?i)vertex", "STL")
        if len(numbers) % 9:
            raise FaultyMeshError("a triangle of the STL file does not have three vertices")
    elif len(data) < 84:
        raise FaultyMeshError("the STL file is shorter than its header")
    else:
        triangles = int.from_bytes(data[80:84], "little")
        if len(data) != 84 + 50 * triangles:
            raise FaultyMeshError(
                f"the STL file declares {triangles:,} triangles, but it is as long as a file of"
                f" {(len(data) - 84) / 50:,g} triangles"
            )
        # A header of 80 bytes and a count of 4; then 50 bytes per triangle: a normal of 12, corners of 36,
        # and 2.
        numbers = array("f", b"".join(data[at : at + 36] for at in range(96, len(data), 50)))
        if sys.byteorder == "big":
            numbers.byteswap()
        # A sum is finite only if every summand is, and finite 32-bit floats cannot overflow it.
        if not math.isfinite(sum(numbers)):
            raise FaultyMeshError("the STL file contains a vertex that is not finite")
    return ((Triangles(numbers, array("q", range(len(numbers) // 3))), IDENTITY),)


def _places(data: bytes, vertex: bytes, kind: str) -> array[float]:
    """Return the coordinates of all vertices of a file of text. Raises: FaultyMeshError: One has none."""
    places = re.findall(vertex + _THREE_NUMBERS, data)
    vertices = re.findall(vertex + rb"[ \t]([^\n]*)", data)
    if any(map(re.compile(rb"(?i)nan|inf").search, vertices)):
        raise FaultyMeshError(f"the {kind} file contains a vertex that is not finite")
    if len(vertices) != len(places):
        raise FaultyMeshError(f"a vertex of the {kind} file is not three numbers")
    return array("d", map(float, chain.from_iterable(places)))


# OBJ


_LINE = rb"(?m)^[ \t]*([vf])(?=[ \t])([^\n]*)"
# vertices and faces of an OBJ file; 32 MiB could hold millions, and take seconds and a gigabyte to read
_MAX_FACE_CORNERS = 100_000
"""Of one face, whose corners are all in memory at a time, 170 bytes each."""
_MAX_LINES = 400_000


def is_plain_obj(data: bytes) -> bool:
    """Return whether each vertex and face of an OBJ file is a line without a comment; PyBullet and trimesh
    read no others."""
    return re.search(rb"(?m)^[ \t]*[vf][ \t][^\n]*(?:#|\\\r?$)", data) is None


def _obj_triangles(data: bytes) -> Placed:
    """Return the triangles around the first corner of each face."""
    if b"\0" in data:
        raise FaultyMeshError("the OBJ file is not text")
    if not is_plain_obj(data):
        data = re.sub(rb"\\\r?\n", b" ", re.sub(rb"#[^\n]*", b"", data))
    lines = list(islice(re.finditer(_LINE, data), _MAX_LINES + 1))
    if len(lines) > _MAX_LINES:
        raise FaultyMeshError(f"the OBJ file contains more than {_MAX_LINES:,} vertices and faces")
    numbers = _places(data, rb"(?m)^[ \t]*v", "OBJ")
    vertices, before, total = len(numbers) // 3, 0, 0
    if not vertices:
        raise FaultyMeshError("the OBJ file contains no vertex")
    corners = array("q")
    for line in lines:
        if line[1] == b"v":
            before += 1
            continue
        if sum(data.count(blank, *line.span(2)) for blank in (b" ", b"\t")) > _MAX_FACE_CORNERS:
            raise FaultyMeshError(f"a face of the OBJ file has more than {_MAX_FACE_CORNERS:,} corners")
        face = re.compile(rb"[ \t](-?)0*([0-9]+)").findall(data, *line.span(2))
        total += len(face)
        if total > MAX_CORNERS:
            raise FaultyMeshError(
                f"the faces of the OBJ file together have more than {MAX_CORNERS:,} corners"
            )
        # -1 is the last vertex before the face. `int` refuses more than 4300 digits.
        indices = [before - int(digits[:10]) if sign else int(digits[:10]) - 1 for sign, digits in face]
        for (_, digits), index in zip(face, indices, strict=True):
            if not 0 <= index < vertices:
                raise FaultyMeshError(
                    f"a face of the OBJ file has vertex {digits[:12].decode()}, but the file has only"
                    f" {vertices} vertices"
                )
        for second in range(1, len(indices) - 1):
            corners.extend((indices[0], indices[second], indices[second + 1]))
    return ((_used(numbers, corners), IDENTITY),)


# COLLADA


def collada_triangles(data: bytes) -> Placed:
    """Return the triangles of a COLLADA file in the frame of their geometry, and the map from there to the
    frame of the file, in m, once for each node that places the geometry.

    A polygon gives the triangles around its first corner. Nodes move what follows in the order of the
    elements in them, and the unit of the file scales it.

    Raises:
        FaultyMeshError: PyBullet cannot read the file, or it places too much.
    """
    root = _root(data)
    missing = next((tag for tag in _SECTIONS if root.find(tag) is None), None)
    if missing is not None:
        raise FaultyMeshError(f"the COLLADA file has no <{missing}>")
    _require(root, (("geometry", "id"), ("visual_scene", "id"), ("instance_geometry", "url")))
    unit = root.find("asset/unit")
    meter = 1.0 if unit is None else _floats(unit.attrib.get("meter", "1").split(), 1)[0]
    if not meter > 0.0:
        raise FaultyMeshError("the unit of the COLLADA file is not above 0")
    geometries = {
        "#" + geometry.attrib["id"]: [part for mesh in geometry.iter("mesh") for part in _triangles_of(mesh)]
        for geometry in root.iter("geometry")
    }
    nodes = {"#" + element.attrib.get("id", ""): element for element in root.iter("node")}
    placed: list[tuple[Triangles, Rows]] = []
    corners = 0
    for url, rows in _instances(root, nodes):
        for part in geometries.get(url, ()):
            corners += len(part.corners)
            if corners > MAX_CORNERS:
                raise FaultyMeshError(f"the COLLADA file places more than {MAX_CORNERS:,} corners")
            placed.append((part, tuple(tuple(meter * entry for entry in row) for row in rows)))
    return tuple(placed)


def _root(data: bytes) -> ElementTree.Element:
    """Return the outermost element, all tags without their namespaces."""
    from xml.etree import ElementTree  # `lint` of robots without such meshes starts 8 ms sooner

    text = data.decode("utf-8", errors="replace").removeprefix("\ufeff").strip(" \t\r\n\0")
    try:
        # Without a DOCTYPE, no entity can expand.
        root = None if "<!DOCTYPE" in text else ElementTree.fromstring(text)
    except ElementTree.ParseError:
        root = None
    if root is None or root.tag.rpartition("}")[2] != "COLLADA":
        raise FaultyMeshError("the mesh is not a COLLADA file")
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]  # ElementTree writes {namespace}tag
    return root


def _instances(
    root: ElementTree.Element, nodes: Mapping[str, ElementTree.Element]
) -> Iterator[tuple[str, Rows]]:
    """Yield the url of each geometry of the scene, and the map from its own frame to that of the file."""
    shown = root.find("scene/instance_visual_scene")
    url = "" if shown is None else shown.attrib.get("url", "").removeprefix("#")
    scenes = list(root.iter("visual_scene"))
    scene = next((element for element in scenes if element.attrib.get("id") == url), None)
    scene = scenes[0] if scene is None and scenes else scene
    waiting = [] if scene is None else [(node, IDENTITY) for node in scene.findall("node")]
    placed = 0
    while waiting:
        node, rows = waiting.pop()
        for element in node:
            placed += element.tag in ("node", "instance_node", "instance_geometry")
            if placed > MAX_NODES:
                raise FaultyMeshError(f"the COLLADA file places more than {MAX_NODES:,} nodes")
            url = element.attrib.get("url", "")
            if element.tag == "instance_geometry":
                yield url, rows
            elif element.tag == "node":
                waiting.append((element, rows))
            elif element.tag == "instance_node" and url in nodes:
                waiting.append((nodes[url], rows))
            else:
                rows = product(rows, _map(element))


def _map(element: ElementTree.Element) -> Rows:
    """Return the map of an element of a node; the identity for one that does not move what follows."""
    words = (element.text or "").split()
    match element.tag:
        case "matrix":
            numbers = _floats(words, 16)
            return tuple(tuple(numbers[at : at + 4]) for at in (0, 4, 8))
        case "translate":
            return tuple((*row[:3], step) for row, step in zip(IDENTITY, _floats(words, 3), strict=True))
        case "scale":
            factors = _floats(words, 3)
            return tuple(
                tuple(entry * factor for entry in row) for row, factor in zip(IDENTITY, factors, strict=True)
            )
        case "rotate":
            x, y, z, degrees = _floats(words, 4)
            length = math.hypot(x, y, z) or 1.0
            turn = from_axis_angle((x / length, y / length, z / length), math.radians(degrees))
            columns = [rotate(turn, axis) for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))]
            return tuple((*row, 0.0) for row in zip(*columns, strict=True))
        case _:
            return IDENTITY


def product(outer: Rows, inner: Rows) -> Rows:
    """Return the map that applies `inner`, then `outer`."""
    if inner is IDENTITY:
        return outer
    columns = list(zip(*inner, strict=True))
    return tuple(
        tuple(
            a * column[0] + b * column[1] + c * column[2] + (d if index == 3 else 0.0)
            for index, column in enumerate(columns)
        )
        for a, b, c, d in outer
    )


def _floats(words: list[str], count: int) -> list[float]:
    """Return so many numbers. Raises: FaultyMeshError: There are fewer, or one is not finite."""
    try:
        numbers = list(map(float, words[:count]))
    except ValueError as error:
        raise FaultyMeshError("a number of the COLLADA file is not a number") from error
    if len(numbers) < count or not math.isfinite(sum(map(abs, numbers))):
        raise FaultyMeshError("a vector of the COLLADA file lacks a number, or is not finite")
    return numbers


def _require(holder: ElementTree.Element, attributes: tuple[tuple[str, str], ...]) -> None:
    for tag, name in attributes:
        if any(name not in element.attrib for element in holder.iter(tag)):
            raise FaultyMeshError(f"a <{tag}> of the COLLADA file has no {name}")


def _triangles_of(mesh: ElementTree.Element) -> Iterator[Triangles]:
    _require(mesh, (("source", "id"), ("vertices", "id")))
    sources = {element.attrib["id"]: element for element in mesh.iter("source")}
    position_inputs = {element.attrib["id"]: _input(element, "POSITION") for element in mesh.iter("vertices")}
    positions: dict[str, array[float]] = {}
    for triangles in (element for element in mesh.iter() if element.tag in _FACES):
        corner = _input(triangles, "VERTEX")
        name = position_inputs.get(corner.source, _Input("", 0)).source
        source = sources.get(name)
        floats = source.find("float_array") if source is not None else None
        if source is None or floats is None or source.find(".//accessor") is None:
            raise FaultyMeshError("a <triangles> of the COLLADA file refers to no positions")
        if name not in positions:
            words = (floats.text or "").split()
            positions[name] = array("d", _floats(words, len(words) // 3 * 3))
        read = _corners if triangles.tag == "triangles" else _polygon_corners
        yield _used(positions[name], read(triangles, corner.offset))


def _used(numbers: array[float], corners: array[int]) -> Triangles:
    """Return triangles with the vertices that they use. Raises: FaultyMeshError: One is missing."""
    indices = sorted(set(corners))
    vertices = len(numbers) // 3
    outside = next((index for index in (*indices[-1:], *indices[:1]) if not 0 <= index < vertices), None)
    if outside is not None:
        reason = f"has vertex {outside}, but there are only {vertices} vertices"
        raise FaultyMeshError(f"a triangle of the COLLADA file {reason}")
    if len(indices) == vertices:
        return Triangles(numbers, corners)
    used = array("d")
    for index in indices:
        used.extend(numbers[3 * index : 3 * index + 3])
    place = {index: at for at, index in enumerate(indices)}
    return Triangles(used, array("q", map(place.__getitem__, corners)))


@dataclass(frozen=True)
class _Input:
    source: str
    offset: int


def _input(holder: ElementTree.Element, semantic: str) -> _Input:
    """Return the source of the numbers of a kind. Raises: FaultyMeshError: There is none."""
    for element in holder.iter("input"):
        if element.attrib.get("semantic") == semantic:
            return _Input(element.attrib.get("source", "").removeprefix("#"), _count(element, "offset", 0))
    raise FaultyMeshError(f"a <{holder.tag}> of the COLLADA file has no <input> with semantic {semantic}")


def _count(element: ElementTree.Element, name: str, default: int) -> int:
    """Return an attribute that counts. Raises: FaultyMeshError: It is not a number from 0 to a billion."""
    text = element.attrib.get(name, str(default)).strip()
    if not re.fullmatch("[0-9]{1,9}", text):
        raise FaultyMeshError(f"the {name} of a <{element.tag}> of the COLLADA file is not a number")
    return int(text)


def _corners(triangles: ElementTree.Element, offset: int) -> array[int]:
    """Return the indices of the vertices of triangles."""
    inputs = [*triangles.iter("input")]
    if any(not {"semantic", "source", "offset"} <= {*element.attrib} for element in inputs):
        raise FaultyMeshError("an <input> of the COLLADA file lacks its semantic, source or offset")
    stride = 1 + max(_count(element, "offset", 0) for element in inputs)
    indices = _integers(next((element.text or "" for element in triangles.iter("p")), ""))
    if not indices or 3 * stride * _count(triangles, "count", 0) > len(indices):
        raise FaultyMeshError("a <triangles> of the COLLADA file has fewer triangles than its count")
    return indices[offset::stride]


def _polygon_corners(polygons: ElementTree.Element, offset: int) -> array[int]:
    """Return the indices of the vertices of the triangles around the first corner of each polygon."""
    stride = 1 + max(_count(element, "offset", 0) for element in polygons.iter("input"))
    texts = [element.text or "" for element in polygons.iter("p")]
    indices = [_integers(text)[offset::stride] for text in texts]
    counts = polygons.find("vcount")
    if counts is not None:
        every, at = indices[0] if indices else array("q"), 0
        indices = []
        for count in _integers(counts.text or ""):
            indices.append(every[at : at + count])
            at += max(count, 0)
        if at > len(every):
            raise FaultyMeshError("a <polylist> of the COLLADA file has fewer corners than its counts")
    corners = array("q")
    for polygon in indices:
        if len(corners) + 3 * len(polygon) > 3 * MAX_CORNERS:
            raise FaultyMeshError(f"the polygons of the COLLADA file have more than {MAX_CORNERS:,} corners")
        for second in range(1, len(polygon) - 1):
            corners.extend((polygon[0], polygon[second], polygon[second + 1]))
    return corners


def _integers(text: str) -> array[int]:
    """Return the integers of a text. Raises: FaultyMeshError: There are too many, or one is none."""
    tokens = text.split(None, _MAX_INDICES)
    if len(tokens) > _MAX_INDICES:
        raise FaultyMeshError(f"a <p> of the COLLADA file has more than {_MAX_INDICES:,} indices")
    try:
        return array("q", map(int, tokens))
    except (ValueError, OverflowError) as error:
        raise FaultyMeshError("an index of the COLLADA file is not a number") from error


# glTF


GLTF_SUFFIXES = (".glb", ".gltf")
_MAGIC = b"glTF"
_HEADER, _CHUNK = struct.Struct("<4sII"), struct.Struct("<I4s")
_TYPES = {5121: "B", 5123: "H", 5125: "I", 5126: "f"}
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_ZERO, _ONE, _UPRIGHT = (0.0,) * 3, (1.0,) * 3, (0.0, 0.0, 0.0, 1.0)


def read_gltf(path: Path, limit: int) -> bytes:
    """Return a glTF file as `.glb`, with at most `limit` bytes; one byte more shows that it is larger.

    Raises:
        FaultyMeshError: It is not JSON, or a buffer is missing, outside the folder of the file, or wrong.
        OSError: The file cannot be read.
    """
    data = read_at_most(path, limit + 1)
    if path.suffix.lower() == ".glb" or data.startswith(_MAGIC) or len(data) > limit:
        return data
    document = _document(data)
    with _faults():
        buffer = bytearray()
        starts = list[int]()
        for entry in document.get("buffers", []):
            starts.append(len(buffer))
            buffer += _buffer(str(entry["uri"]), path.parent, limit)[: int(entry["byteLength"])]
            buffer += b"\0" * (-len(buffer) % 4)
            if len(buffer) > limit:
                return b"\0" * (limit + 1)
        for view in document.get("bufferViews", []):
            view["byteOffset"] = int(view.get("byteOffset", 0)) + starts[int(view["buffer"])]
            view["buffer"] = 0
        document["buffers"] = [{"byteLength": len(buffer)}]
        for name in ("images", "textures", "samplers", "animations", "cameras", "skins"):
            document.pop(name, None)
        text = json.dumps(document, separators=(",", ":"), sort_keys=True).encode()
    text += b" " * (-len(text) % 4)
    size = _HEADER.size + 2 * _CHUNK.size + len(text) + len(buffer)
    parts = [_HEADER.pack(_MAGIC, 2, size), _CHUNK.pack(len(text), b"JSON"), text]
    return b"".join([*parts, _CHUNK.pack(len(buffer), b"BIN\0"), bytes(buffer)])


def _buffer(uri: str, folder: Path, limit: int) -> bytes:
    if uri.startswith("data:"):
        return base64.b64decode(uri.partition(",")[2], validate=True)
    path = Path(os.path.realpath(folder / unquote(uri)))
    if "://" in uri or not path.is_relative_to(os.path.realpath(folder)):
        raise FaultyMeshError("a buffer of the glTF file lies outside its folder")
    if not is_file(path):
        raise FaultyMeshError(f"the buffer {uri[-60:]!r} of the glTF file does not exist beside it")
    return read_at_most(path, limit + 1)


class _faults:  # noqa: N801  (a context manager, called as a function)
    """Turns what a wrong value of the JSON raises into the fault of the file."""

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: object) -> None:
        wrong = (ValueError, LookupError, TypeError, AttributeError, OverflowError, struct.error)
        if isinstance(error, wrong) and not isinstance(error, FaultyMeshError):
            is_base64 = isinstance(error, binascii.Error)
            what = "a buffer of the glTF file is not base64" if is_base64 else "the glTF file is not sound"
            raise FaultyMeshError(what) from error


def _document(data: bytes) -> dict[str, Any]:
    try:
        document = json.loads(data.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise FaultyMeshError("the mesh is not a glTF file") from error
    if not isinstance(document, dict):
        raise FaultyMeshError("the mesh is not a glTF file")
    return document


def gltf_triangles(data: bytes) -> Placed:
    """Return the triangles of a `.glb` file in the frame of their mesh, and the map from there to the frame
    of the file, once for each node that places the mesh.

    Raises:
        FaultyMeshError: The file is not sound, is compressed, or places too much.
    """
    document, buffer = _parts(data)
    for extension in document.get("extensionsRequired") or []:
        if any(word in str(extension) for word in ("draco", "meshopt")):
            raise FaultyMeshError(f"the glTF file is compressed ({str(extension)[:40]})")
    with _faults():
        meshes: dict[int, list[Triangles]] = {}
        placed: list[tuple[Triangles, Rows]] = []
        corners = 0
        for number, rows in _gltf_instances(document):
            if number not in meshes:
                primitives = document["meshes"][number]["primitives"]
                meshes[number] = [
                    triangles
                    for primitive in primitives
                    if (triangles := _triangles(document, buffer, primitive)) is not None
                ]
            for part in meshes[number]:
                corners += len(part.corners)
                if corners > MAX_CORNERS:
                    raise FaultyMeshError(f"the glTF file places more than {MAX_CORNERS:,} corners")
                placed.append((part, rows))
        return tuple(placed)
    raise AssertionError  # `_faults` passes every other exception on


def _parts(data: bytes) -> tuple[dict[str, Any], bytes]:
    """Return the JSON of a `.glb` file, and its buffer."""
    if len(data) < _HEADER.size + _CHUNK.size or not data.startswith(_MAGIC):
        raise FaultyMeshError("the mesh is not a binary glTF file")
    _, version, size = _HEADER.unpack_from(data)
    if version != 2:
        raise FaultyMeshError(f"the glTF file is of version {version}, and deepbots reads version 2")
    if size != len(data):
        raise FaultyMeshError(f"the glTF file declares {size:,} bytes, but has {len(data):,}")
    chunks: dict[bytes, bytes] = {}
    at = _HEADER.size
    while at + _CHUNK.size <= len(data):
        length, kind = _CHUNK.unpack_from(data, at)
        at += _CHUNK.size
        if at + length > len(data):
            raise FaultyMeshError("a part of the glTF file is longer than the file")
        chunks.setdefault(kind, data[at : at + length])
        at += length
    return _document(chunks.get(b"JSON", b"")), chunks.get(b"BIN\0", b"")


def _gltf_instances(document: dict[str, Any]) -> Iterator[tuple[int, Rows]]:
    """Yield the number of each mesh of the scene, and the map from its own frame to that of the file."""
    nodes, scenes = document.get("nodes", []), document.get("scenes", [])
    first = scenes[document.get("scene", 0)].get("nodes", []) if scenes else range(len(nodes))
    waiting = [(number, IDENTITY) for number in first]
    visited = 0
    while waiting:
        visited += 1
        if visited > MAX_NODES:
            raise FaultyMeshError(f"the glTF file places more than {MAX_NODES:,} nodes")
        number, above = waiting.pop()
        node = nodes[_index(number)]
        rows = product(above, _rows(node))
        if "mesh" in node:
            yield _index(node["mesh"]), rows
        waiting += [(child, rows) for child in node.get("children", [])]


def _index(number: object) -> int:
    if not isinstance(number, int) or number < 0:
        raise FaultyMeshError("the glTF file is not sound")
    return number


def _rows(node: dict[str, Any]) -> Rows:
    """Return the map of a node: a matrix by columns, or a scale, a rotation and a translation."""
    if "matrix" in node:
        matrix = _gltf_floats(node["matrix"], 16)
        return tuple(matrix[row::4] for row in range(3))
    x, y, z, w = _gltf_floats(node.get("rotation", _UPRIGHT), 4)
    scale = _gltf_floats(node.get("scale", _ONE), 3)
    axes = [rotate((x, y, z, w), unit) for unit in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))]
    at = _gltf_floats(node.get("translation", _ZERO), 3)
    return tuple(
        (*(axis[row] * factor for axis, factor in zip(axes, scale, strict=True)), at[row]) for row in range(3)
    )


def _gltf_floats(values: object, size: int) -> tuple[float, ...]:
    numbers = tuple(map(float, values)) if isinstance(values, (list, tuple)) else ()
    if len(numbers) != size or not all(map(math.isfinite, numbers)):
        raise FaultyMeshError("a node of the glTF file is not placed by finite numbers")
    return numbers


def _triangles(document: dict[str, Any], buffer: bytes, primitive: dict[str, Any]) -> Triangles | None:
    """Return the triangles of a primitive; None for points and lines."""
    mode = primitive.get("mode", _TRIANGLES)
    if mode not in (_TRIANGLES, _STRIP, _FAN):
        return None
    numbers = _accessor(document, buffer, primitive["attributes"]["POSITION"], 3, "f")
    count = len(numbers) // 3
    if not math.isfinite(sum(numbers)):
        raise FaultyMeshError("the glTF file contains a vertex that is not finite")
    accessor = primitive.get("indices")
    indices = (
        array("I", range(count)) if accessor is None else _accessor(document, buffer, accessor, 1, "BHI")
    )
    if len(indices) and max(indices) >= count:
        raise FaultyMeshError(
            f"a face of the glTF file has vertex {max(indices)}, but there are only {count}"
        )
    return Triangles(array("d", numbers), _LISTED[mode](array("I", indices)))


def _listed(indices: array[int]) -> array[int]:
    return indices[: len(indices) - len(indices) % 3]


def _strip(indices: array[int]) -> array[int]:
    corners = array("I")
    for at in range(len(indices) - 2):
        a, b, c = indices[at : at + 3]
        corners.extend((b, a, c) if at % 2 else (a, b, c))
    return corners


def _fan(indices: array[int]) -> array[int]:
    corners = array("I")
    for at in range(1, len(indices) - 1):
        corners.extend((indices[0], indices[at], indices[at + 1]))
    return corners


_LISTED: dict[int, Callable[[array[int]], array[int]]] = {_TRIANGLES: _listed, _STRIP: _strip, _FAN: _fan}


def _accessor(document: dict[str, Any], buffer: bytes, number: object, size: int, types: str) -> array[Any]:
    """Return the numbers of an accessor with `size` numbers per entry, of one of the `types` of `array`."""
    accessor = document["accessors"][_index(number)]
    code = _TYPES.get(accessor["componentType"], "")
    if not code or code not in types or "sparse" in accessor or "bufferView" not in accessor:
        raise FaultyMeshError("the numbers of the glTF file are compressed or of a kind that is not read")
    view = document["bufferViews"][_index(accessor["bufferView"])]
    if _index(view["buffer"]) != 0:
        raise FaultyMeshError("a buffer of the glTF file lies outside of it")
    count, numbers = _index(accessor["count"]), array(code)
    width = size * numbers.itemsize
    stride = _index(view.get("byteStride", 0)) or width
    start = _index(view.get("byteOffset", 0)) + _index(accessor.get("byteOffset", 0))
    if stride < width or start + (count - 1) * stride + width > len(buffer) or count * size > 3 * MAX_CORNERS:
        raise FaultyMeshError("the glTF file has fewer numbers than it declares")
    if stride == width:
        numbers.frombytes(buffer[start : start + count * width])
    else:
        for at in range(start, start + count * stride, stride):
            numbers.frombytes(buffer[at : at + width])
    if sys.byteorder == "big":
        numbers.byteswap()
    return numbers


_READERS: dict[str, tuple[Callable[[bytes], Placed], str]] = {
    ".stl": (_stl_triangles, "the STL file contains no triangle"),
    ".obj": (_obj_triangles, "the OBJ file contains no face"),
    ".dae": (collada_triangles, "the scene of the COLLADA file has no triangle or polygon"),
}
"""The reader of each format but glTF, and the fault of a file without triangles."""
