"""What a mesh file must hold so that an engine survives it.

PyBullet 3.2.7 was seen to crash the process on a vertex that is not a number, on an OBJ face that names a
missing vertex and on a COLLADA file without its libraries; an STL file of another length than it claims is
drawn as nothing.
"""

from __future__ import annotations

import math
import re
import sys
from array import array
from itertools import islice
from typing import NamedTuple

from deepbots_cli.diagnostics import Findings, Source
from deepbots_cli.robots import xml

_VERTEX = re.compile(rb"^[ \t]*v[ \t]", re.MULTILINE)
_NOT_FINITE = re.compile(rb"^[ \t]*v[ \t][^\n]*(?:nan|inf)", re.MULTILINE | re.IGNORECASE)
_NOT_FINITE_STL = re.compile(rb"vertex[ \t][^\n]*(?:nan|inf)", re.IGNORECASE)
_PLACE = re.compile(rb"^[ \t]*v[ \t]+([-+.0-9eE \t]+)", re.MULTILINE)
_PLACE_STL = re.compile(rb"vertex[ \t]+([-+.0-9eE \t]+)", re.IGNORECASE)
_FACE = re.compile(rb"^[ \t]*f([ \t][^\n]*)", re.MULTILINE)
_INDEX = re.compile(rb"[ \t]-?0*([0-9]+)")
_LINES = re.compile(rb"^[ \t]*(?=[vf][ \t])", re.MULTILINE)
_MOST_LINES = 400_000
"""Vertices and faces of an OBJ file; 32 MiB could hold millions, and take seconds and a gigabyte to read."""
_MOST_CORNERS = 1_500_000
_COLLADA = ("asset", "library_geometries", "library_visual_scenes")


def fault(suffix: str, data: bytes) -> str | None:
    """What is wrong with the mesh in `data`, as a headline; None where it may be loaded."""
    match suffix:
        case ".stl":
            return _stl(data)
        case ".obj":
            return _obj(data)
        case _:
            return _dae(data)


class Measure(NamedTuple):
    """The corners of the box that holds a mesh, in its own units, and how many triangles it has."""

    lower: tuple[float, float, float]
    upper: tuple[float, float, float]
    triangles: int


def measure(suffix: str, data: bytes) -> Measure | None:
    """The size of a mesh without fault; None of a COLLADA file, which has units and frames of its own."""
    if suffix == ".dae":
        return None
    if suffix == ".obj":
        numbers = [float(number) for vertex in _PLACE.findall(data) for number in vertex.split()[:3]]
        faces = sum(max(len(_INDEX.findall(face)) - 2, 1) for face in _FACE.findall(data))
    elif data.lstrip()[:5].lower() == b"solid" and b"facet" in data:
        numbers = [float(number) for vertex in _PLACE_STL.findall(data) for number in vertex.split()[:3]]
        faces = len(numbers) // 9
    else:
        numbers, faces = list(_stl_numbers(data)), int.from_bytes(data[80:84], "little")
    lower, upper = (tuple(end(numbers[axis::3], default=0.0) for axis in range(3)) for end in (min, max))
    return Measure((lower[0], lower[1], lower[2]), (upper[0], upper[1], upper[2]), faces)


def _stl(data: bytes) -> str | None:
    if data.lstrip()[:5].lower() == b"solid" and b"facet" in data:
        return "the STL file holds a vertex that is not finite" if _NOT_FINITE_STL.search(data) else None
    if len(data) < 84:
        return "the STL file is shorter than its header"
    triangles = int.from_bytes(data[80:84], "little")
    if len(data) != 84 + 50 * triangles:
        return f"the STL file claims {triangles} triangles and has room for {(len(data) - 84) / 50:g}"
    if not triangles:
        return "the STL file holds no triangle"
    # A sum is finite only if every summand is, and finite 32-bit floats cannot overflow it.
    return None if math.isfinite(sum(_stl_numbers(data))) else "the STL file holds a vertex that is not finite"


def _stl_numbers(data: bytes) -> array[float]:
    """The coordinates of all corners of a binary file, one after the other."""
    numbers = array("f", b"".join(data[at : at + 36] for at in range(96, len(data), 50)))
    if sys.byteorder == "big":
        numbers.byteswap()
    return numbers


def _obj(data: bytes) -> str | None:
    if b"\0" in data:
        return "the OBJ file is not text"
    if sum(1 for _ in islice(_LINES.finditer(data), _MOST_LINES + 1)) > _MOST_LINES:
        return f"the OBJ file holds more than {_MOST_LINES:_} vertices and faces"
    vertices = len(_VERTEX.findall(data))
    if not vertices:
        return "the OBJ file holds no vertex"
    lower = data.lower()  # two plain searches take a third of the time of the pattern, which they nearly always spare
    if (b"nan" in lower or b"inf" in lower) and _NOT_FINITE.search(data):
        return "the OBJ file holds a vertex that is not finite"
    indices: set[bytes] = set()
    corners = 0
    for face in _FACE.finditer(data):
        named = _INDEX.findall(data, face.start(1), min(face.end(1), face.start(1) + 16 * _MOST_CORNERS))
        indices.update(named)
        corners += len(named)
        if corners > _MOST_CORNERS:
            return f"the OBJ file has faces of more than {_MOST_CORNERS:_} corners together"
    if not indices:
        return "the OBJ file holds no face"
    last = max(indices, key=lambda digits: (len(digits), digits))
    if len(last) > 9 or int(last) > vertices:
        return f"the OBJ file has a face with vertex {last[:12].decode()} and only {vertices} vertices"
    return None


def _dae(data: bytes) -> str | None:
    source = Source("mesh", data.decode("utf-8", errors="replace").removeprefix("\ufeff"))
    root = xml.parse(source, Findings())
    if root is None or root.tag != "COLLADA":
        return "the mesh is not a COLLADA file"
    missing = next((tag for tag in _COLLADA if not root.all(tag)), None)
    return f"the COLLADA file has no <{missing}>" if missing else None
