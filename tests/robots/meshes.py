"""Closed meshes as the bytes of files."""

from __future__ import annotations

import math
import struct
from itertools import product

Triangle = tuple[int, int, int]
Point = tuple[float, ...]


def block(name: str, size: tuple[float, float, float], *, outward: bool = True) -> bytes:
    """A box around the origin as an OBJ or a binary STL file, by the suffix of its name."""
    points = [
        tuple(sign * side / 2 for sign, side in zip(signs, size, strict=True))
        for signs in product((-1, 1), repeat=3)
    ]
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [triangle for a, b, c, d in quads for triangle in ((a, b, c), (a, c, d))]
    faces = faces if outward else [(a, c, b) for a, b, c in faces]
    return as_obj(points, faces) if name.endswith(".obj") else as_stl(points, faces)


def ball(radius: float, rings: int) -> bytes:
    """A sphere around the origin as an OBJ file."""
    sectors = 2 * rings
    points: list[Point] = [(0.0, 0.0, radius)]
    for ring in range(1, rings):
        down = math.pi * ring / rings
        around = [2 * math.pi * sector / sectors for sector in range(sectors)]
        points += [
            (
                radius * math.sin(down) * math.cos(a),
                radius * math.sin(down) * math.sin(a),
                radius * math.cos(down),
            )
            for a in around
        ]
    points.append((0.0, 0.0, -radius))
    last = len(points) - 1
    faces: list[Triangle] = []
    for sector in range(sectors):
        after = (sector + 1) % sectors
        faces += [(0, 1 + sector, 1 + after), (last, last - sectors + after, last - sectors + sector)]
        for ring in range(rings - 2):
            upper, lower = 1 + ring * sectors, 1 + (ring + 1) * sectors
            faces += [
                (upper + sector, lower + sector, lower + after),
                (upper + sector, lower + after, upper + after),
            ]
    return as_obj(points, faces)


def as_obj(points: list[Point], faces: list[Triangle]) -> bytes:
    lines = ["v " + " ".join(map(repr, point)) for point in points] + [
        f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces
    ]
    return "\n".join(lines).encode()


def as_stl(points: list[Point], faces: list[Triangle]) -> bytes:
    body = b"".join(struct.pack("<12fH", 0, 0, 0, *points[a], *points[b], *points[c], 0) for a, b, c in faces)
    return bytes(80) + struct.pack("<I", len(faces)) + body
