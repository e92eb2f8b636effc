"""The triangles of a COLLADA file, and their faults. This module needs no numpy, since lint imports it.

The reader of PyBullet 3.2.7 crashes on an index beyond the vertices, on a reference that leads nowhere and on
a missing id, and does not end on a count that is too large. It composes rotations, and a scale with a
translation, in an order of its own (hokuyo.dae of pybullet_data lies on its side), and trimesh ignores the
unit of the file (duck.dae is 100 times as large). Both ignore `<up_axis>`, and so does this reader.
"""

from __future__ import annotations

import math
import re
from array import array
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

from deepbots_cli.frames import from_axis_angle, rotate

if TYPE_CHECKING:
    from xml.etree import ElementTree

_MAX_INDICES = 6_000_000  # 1,500,000 corners, as of an OBJ file, of four numbers each
MAX_CORNERS = 1_500_000
MAX_NODES = 10_000  # nodes may place others, so a short file could place billions
Rows = tuple[tuple[float, ...], ...]
"""The rows of an affine map: three of four numbers."""
IDENTITY: Rows = ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0))
_FACES = ("triangles", "polylist", "polygons")
_WITH_ID = (("source", "id"), ("vertices", "id"))
_REFERENCES = (("geometry", "id"), ("visual_scene", "id"), ("instance_geometry", "url"))


class FaultyColladaError(ValueError):
    """The reason why PyBullet cannot read a file, as a headline."""


@dataclass(frozen=True)
class Triangles:
    """The vertices of triangles: `numbers` has three coordinates per vertex, and `corners` the index of a
    vertex per corner, three per triangle."""

    numbers: array[float]
    corners: array[int]

    def moved(self, rows: Rows, step: int = 1) -> array[float]:
        """Return the coordinates of every so many vertices in the frame to which `rows` map."""
        if rows == IDENTITY and step == 1:
            return self.numbers
        points = list(zip(*(self.numbers[axis :: 3 * step] for axis in range(3)), strict=True))
        moved = array("d", bytes(24 * len(points)))
        for axis, (a, b, c, d) in enumerate(rows):
            moved[axis::3] = array("d", [a * x + b * y + c * z + d for x, y, z in points])
        return moved


@lru_cache(maxsize=1)
def placed_triangles(data: bytes) -> tuple[tuple[Triangles, Rows], ...]:
    """Return the triangles of a COLLADA file without a DOCTYPE, in the frame of their geometry, and the map
    from there to the frame of the file, in m, once for each node that places the geometry.

    A polygon gives the triangles around its first corner. Nodes move what follows in the order of the
    elements in them, and the unit of the file scales it.

    Raises:
        FaultyColladaError: PyBullet cannot read the file, or it places too much.
    """
    root = _root(data)
    _require(root, _REFERENCES)
    unit = root.find("asset/unit")
    meter = 1.0 if unit is None else _floats(unit.attrib.get("meter", "1").split(), 1)[0]
    if not meter > 0.0:
        raise FaultyColladaError("the unit of the COLLADA file is not above 0")
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
                raise FaultyColladaError(f"the COLLADA file places more than {MAX_CORNERS:,} corners")
            placed.append((part, tuple(tuple(meter * entry for entry in row) for row in rows)))
    return tuple(placed)


def _root(data: bytes) -> ElementTree.Element:
    """Return the outermost element of a file without a DOCTYPE, all tags without their namespaces."""
    from xml.etree import ElementTree  # `lint` of robots without such meshes starts 8 ms sooner

    try:
        # No entity can expand here: `meshes._dae` refuses a file with a DOCTYPE before.
        root = ElementTree.fromstring(
            data.decode("utf-8", errors="replace").removeprefix("\ufeff").strip(" \t\r\n\0")
        )
    except ElementTree.ParseError as error:
        raise FaultyColladaError("the mesh is not a COLLADA file") from error
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
                raise FaultyColladaError(f"the COLLADA file places more than {MAX_NODES:,} nodes")
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
    """Return so many numbers. Raises: FaultyColladaError: There are fewer, or one is not finite."""
    try:
        numbers = list(map(float, words[:count]))
    except ValueError as error:
        raise FaultyColladaError("a number of the COLLADA file is not a number") from error
    if len(numbers) < count or not math.isfinite(sum(map(abs, numbers))):
        raise FaultyColladaError("a vector of the COLLADA file lacks a number, or is not finite")
    return numbers


def _require(holder: ElementTree.Element, attributes: tuple[tuple[str, str], ...]) -> None:
    for tag, name in attributes:
        if any(name not in element.attrib for element in holder.iter(tag)):
            raise FaultyColladaError(f"a <{tag}> of the COLLADA file has no {name}")


def _triangles_of(mesh: ElementTree.Element) -> Iterator[Triangles]:
    _require(mesh, _WITH_ID)
    sources = {element.attrib["id"]: element for element in mesh.iter("source")}
    position_inputs = {element.attrib["id"]: _input(element, "POSITION") for element in mesh.iter("vertices")}
    positions: dict[str, array[float]] = {}
    for triangles in (element for element in mesh.iter() if element.tag in _FACES):
        corner = _input(triangles, "VERTEX")
        name = position_inputs.get(corner.source, _Input("", 0)).source
        source = sources.get(name)
        floats = source.find("float_array") if source is not None else None
        if source is None or floats is None or source.find(".//accessor") is None:
            raise FaultyColladaError("a <triangles> of the COLLADA file refers to no positions")
        if name not in positions:
            words = (floats.text or "").split()
            positions[name] = array("d", _floats(words, len(words) // 3 * 3))
        read = _corners if triangles.tag == "triangles" else _polygon_corners
        yield _used(positions[name], read(triangles, corner.offset))


def _used(numbers: array[float], corners: array[int]) -> Triangles:
    """Return triangles with the vertices that they use. Raises: FaultyColladaError: One is missing."""
    indices = sorted(set(corners))
    vertices = len(numbers) // 3
    outside = next((index for index in (*indices[-1:], *indices[:1]) if not 0 <= index < vertices), None)
    if outside is not None:
        reason = f"has vertex {outside}, but there are only {vertices} vertices"
        raise FaultyColladaError(f"a triangle of the COLLADA file {reason}")
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
    """Return the source of the numbers of a kind. Raises: FaultyColladaError: There is none."""
    for element in holder.iter("input"):
        if element.attrib.get("semantic") == semantic:
            return _Input(element.attrib.get("source", "").removeprefix("#"), _count(element, "offset", 0))
    raise FaultyColladaError(f"a <{holder.tag}> of the COLLADA file has no <input> with semantic {semantic}")


def _count(element: ElementTree.Element, name: str, default: int) -> int:
    """Return an attribute that counts. Raises: FaultyColladaError: It is not a number from 0 to a billion."""
    text = element.attrib.get(name, str(default)).strip()
    if not re.fullmatch("[0-9]{1,9}", text):
        raise FaultyColladaError(f"the {name} of a <{element.tag}> of the COLLADA file is not a number")
    return int(text)


def _corners(triangles: ElementTree.Element, offset: int) -> array[int]:
    """Return the indices of the vertices of triangles."""
    inputs = [*triangles.iter("input")]
    if any(not {"semantic", "source", "offset"} <= {*element.attrib} for element in inputs):
        raise FaultyColladaError("an <input> of the COLLADA file lacks its semantic, source or offset")
    stride = 1 + max(_count(element, "offset", 0) for element in inputs)
    text = next((element.text or "" for element in triangles.iter("p")), "")
    # The limit keeps the rest of a huge text in one piece, which is then refused.
    tokens = text.split(None, _MAX_INDICES)
    if len(tokens) > _MAX_INDICES:
        raise FaultyColladaError(f"a <triangles> of the COLLADA file has more than {_MAX_INDICES:,} indices")
    if not tokens or 3 * stride * _count(triangles, "count", 0) > len(tokens):
        raise FaultyColladaError("a <triangles> of the COLLADA file has fewer triangles than its count")
    try:
        corners = array("q", map(int, tokens[offset::stride]))
    except (ValueError, OverflowError) as error:
        raise FaultyColladaError("an index of the COLLADA file is not a number") from error
    return corners


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
            raise FaultyColladaError("a <polylist> of the COLLADA file has fewer corners than its counts")
    corners = array("q")
    for polygon in indices:
        if len(corners) + 3 * len(polygon) > 3 * MAX_CORNERS:
            raise FaultyColladaError(
                f"the polygons of the COLLADA file have more than {MAX_CORNERS:,} corners"
            )
        for second in range(1, len(polygon) - 1):
            corners.extend((polygon[0], polygon[second], polygon[second + 1]))
    return corners


def _integers(text: str) -> array[int]:
    """Return the integers of a text. Raises: FaultyColladaError: There are too many, or one is none."""
    tokens = text.split(None, _MAX_INDICES)
    if len(tokens) > _MAX_INDICES:
        raise FaultyColladaError(f"a <p> of the COLLADA file has more than {_MAX_INDICES:,} indices")
    try:
        return array("q", map(int, tokens))
    except (ValueError, OverflowError) as error:
        raise FaultyColladaError("an index of the COLLADA file is not a number") from error
