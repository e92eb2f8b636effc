"""The number of times that the triangles of a mesh cover the box around it. This module needs no numpy, since
lint imports it.

A renderer without a graphics card shades every triangle in a pixel, hidden or not. PyBullet took 440 s for a
picture of 640,000 large triangles in one plane, and takes 4 s for a ball of as many triangles. Of 2,432
published meshes, the triangles of one cover its box 7 times, and those of all others less. Areas are
estimated from a random sample.
"""

from __future__ import annotations

import re
import struct
from bisect import bisect_right
from collections.abc import Iterable, Sequence
from random import Random
from typing import NamedTuple

from deepbots_cli.robots import collada, gltf
from deepbots_cli.robots.collada import Rows, Triangles
from deepbots_cli.robots.model import Vector

MAX_LAYERS = 100
_SAMPLE = 1_000  # triangles
_NUMBERS = rb"[ \t]+([-+.0-9eE]+)[ \t]+([-+.0-9eE]+)[ \t]+([-+.0-9eE]+)"
_VERTEX = re.compile(rb"^[ \t]*v" + _NUMBERS, re.MULTILINE)
_FACE = re.compile(rb"^[ \t]*f(?=[ \t])([^\n]*)", re.MULTILINE)
_CORNER = re.compile(rb"[ \t](-?[0-9]+)")
_PLACE_STL = re.compile(rb"vertex" + _NUMBERS, re.IGNORECASE)

Triangle = tuple[Vector, Vector, Vector]


class Coverage(NamedTuple):
    """Areas as seen along x, y and z, in squared units of a mesh: of all triangles together, and of the box
    around them."""

    triangles: Vector
    box: Vector

    def layers(self, scale: Vector) -> float:
        """Return how many times the triangles of the scaled mesh cover its box."""
        x, y, z = map(abs, scale)
        area, box = (max(a * y * z, b * x * z, c * x * y) for a, b, c in self)
        return area / box if box > 0.0 else 0.0


def mesh_coverage(suffix: str, data: bytes, seed: str) -> Coverage | None:
    """Return the coverage of a mesh without fault; None of one with few triangles.

    Args:
        suffix: The suffix of the file, in lower case.
        data: The content of the file.
        seed: The seed of the sample, such as a digest: a file cannot be written to fit it.
    """
    pick = {".stl": _stl, ".obj": _obj, ".dae": _dae}.get(suffix, _glb)
    try:
        count, sample = pick(data, Random(seed))
    except (ValueError, LookupError, OverflowError, struct.error):  # no engine draws such a file
        return None
    return _coverage(count, sample) if count > MAX_LAYERS and sample else None


def _coverage(count: int, sample: Sequence[Triangle]) -> Coverage:
    """Return the coverage from the number of all triangles and some of them."""
    x = y = z = 0.0
    for (ax, ay, az), (bx, by, bz), (cx, cy, cz) in sample:
        bx, by, bz, cx, cy, cz = bx - ax, by - ay, bz - az, cx - ax, cy - ay, cz - az
        x, y, z = x + abs(by * cz - bz * cy), y + abs(bz * cx - bx * cz), z + abs(bx * cy - by * cx)
    share = count / len(sample) / 2  # a cross product is twice the area of its triangle
    axes = zip(*(corner for triangle in sample for corner in triangle), strict=True)
    a, b, c = (max(coordinates) - min(coordinates) for coordinates in axes)
    return Coverage((share * x, share * y, share * z), (b * c, a * c, a * b))


def _chosen(count: int, random: Random) -> list[int]:
    """Return the numbers of some of so many triangles, in order; none if there are few."""
    # Few triangles cannot cover each other more than `MAX_LAYERS` times.
    return sorted(random.sample(range(count), min(count, _SAMPLE))) if count > MAX_LAYERS else []


def _vector(numbers: Sequence[bytes | str | float]) -> Vector:
    """Return three numbers as a vector.

    Raises:
        ValueError: They are not three numbers.
    """
    x, y, z = map(float, numbers)
    return x, y, z


def _stl(data: bytes, random: Random) -> tuple[int, list[Triangle]]:
    if data.lstrip()[:5].lower() == b"solid" and b"facet" in data:
        corners = _PLACE_STL.findall(data) if data.count(b"facet") > MAX_LAYERS else []
        count = len(corners) // 3
        triangles = (
            [_vector(corner) for corner in corners[3 * number : 3 * number + 3]]
            for number in _chosen(count, random)
        )
    else:
        count = int.from_bytes(data[80:84], "little")
        numbers = (struct.unpack_from("<9f", data, 96 + 50 * number) for number in _chosen(count, random))
        triangles = ([_vector(row[at : at + 3]) for at in (0, 3, 6)] for row in numbers)
    return count, [(a, b, c) for a, b, c in triangles]


def _obj(data: bytes, random: Random) -> tuple[int, list[Triangle]]:
    """Return the number of triangles and some of them. A face with more than three corners gives the
    triangles around its first corner."""
    faces = [(face.start(), _CORNER.findall(face[1])) for face in _FACE.finditer(data)]
    ends = list[int]()
    for _, corners in faces:
        ends.append((ends[-1] if ends else 0) + max(len(corners) - 2, 0))
    count = ends[-1] if ends else 0
    vertices = [*_VERTEX.finditer(data)] if count > MAX_LAYERS else []
    starts = [vertex.start() for vertex in vertices]
    sample = list[Triangle]()
    for number in _chosen(count, random):
        face_index = bisect_right(ends, number)
        at, corners = faces[face_index]
        second = number - ends[face_index] + len(corners) - 1
        indices = [int(corners[corner]) for corner in (0, second, second + 1)]
        before = bisect_right(starts, at)  # -1 is the last vertex before the face
        a, b, c = (
            _vector(vertices[index - 1 if index > 0 else before + index].groups()) for index in indices
        )
        sample.append((a, b, c))
    return count, sample


def _dae(data: bytes, random: Random) -> tuple[int, list[Triangle]]:
    """Return the number of triangles and some of them, without the nodes that place geometries."""
    return _placed(collada.placed_triangles(data), random)


def _glb(data: bytes, random: Random) -> tuple[int, list[Triangle]]:
    """Return the number of triangles and some of them, without the nodes that place meshes."""
    return _placed(gltf.placed_triangles(data), random)


def _placed(parts: Iterable[tuple[Triangles, Rows]], random: Random) -> tuple[int, list[Triangle]]:
    count, sample = 0, list[Triangle]()
    for triangles, _ in parts:
        for number in _chosen(len(triangles.corners) // 3, random):
            corners = triangles.corners[3 * number : 3 * number + 3]
            a, b, c = (_vector(triangles.numbers[3 * corner : 3 * corner + 3]) for corner in corners)
            sample.append((a, b, c))
        count += len(triangles.corners) // 3
    return count, sample
