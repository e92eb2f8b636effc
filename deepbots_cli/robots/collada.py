"""The triangles of a COLLADA file, and their faults. This module needs no numpy, since lint imports it.

The reader of PyBullet 3.2.7 crashes on an index beyond the vertices, on a reference that leads nowhere and on
a missing id, and does not end on a count that is too large.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from xml.etree import ElementTree

_MAX_INDICES = 6_000_000  # 1,500,000 corners, as of an OBJ file, of four numbers each
_WITH_ID = (("source", "id"), ("vertices", "id"))
_REFERENCES = (("geometry", "id"), ("visual_scene", "id"), ("instance_geometry", "url"))


class FaultyColladaError(ValueError):
    """The reason why PyBullet cannot read a file, as a headline."""


@dataclass(frozen=True)
class Triangles:
    """The vertices of triangles: `numbers` has three coordinates per vertex, and `corners` the index of a
    vertex per corner, three per triangle."""

    numbers: list[str]
    corners: array[int]


def collada_triangles(data: bytes) -> Iterator[Triangles]:
    """Yield each `<triangles>` of a COLLADA file without a DOCTYPE, in the frame of its geometry.

    Polygons are left out, as PyBullet does.

    Raises:
        FaultyColladaError: PyBullet cannot read the file.
    """
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
    _require(root, _REFERENCES)
    for mesh in root.iter("mesh"):
        yield from _triangles_of(mesh)


def _require(holder: ElementTree.Element, attributes: tuple[tuple[str, str], ...]) -> None:
    for tag, name in attributes:
        if any(name not in element.attrib for element in holder.iter(tag)):
            raise FaultyColladaError(f"a <{tag}> of the COLLADA file has no {name}")


def _triangles_of(mesh: ElementTree.Element) -> Iterator[Triangles]:
    _require(mesh, _WITH_ID)
    sources = {element.attrib["id"]: element for element in mesh.iter("source")}
    position_inputs = {element.attrib["id"]: _input(element, "POSITION") for element in mesh.iter("vertices")}
    for triangles in mesh.iter("triangles"):
        corner = _input(triangles, "VERTEX")
        source = sources.get(position_inputs.get(corner.source, _Input("", 0)).source)
        floats = source.find("float_array") if source is not None else None
        if source is None or floats is None or source.find(".//accessor") is None:
            raise FaultyColladaError("a <triangles> of the COLLADA file refers to no positions")
        numbers, corners = (floats.text or "").split(), _corners(triangles, corner.offset)
        vertices = len(numbers) // 3
        outside = next(
            (
                number
                for number in (max(corners, default=0), min(corners, default=0))
                if not 0 <= number < vertices
            ),
            None,
        )
        if outside is not None:
            reason = f"has vertex {outside}, but there are only {vertices} vertices"
            raise FaultyColladaError(f"a triangle of the COLLADA file {reason}")
        yield Triangles(numbers, corners)


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
