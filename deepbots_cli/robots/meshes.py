"""Mesh files: access and content. This module needs no numpy, since lint imports it.

Every file is checked here before an engine or a library reads it.

A renderer without a graphics card shades every triangle in a pixel, hidden or not. PyBullet took 440 s for a
picture of 640,000 large triangles in one plane, and takes 4 s for a ball of as many triangles. Of 2,432
published meshes, the triangles of one cover its box 7 times, and those of all others less. The number of
times that triangles cover the box is estimated from a random sample.
"""

from __future__ import annotations

import hashlib
from array import array
from bisect import bisect
from collections.abc import Iterable, Sequence
from contextlib import suppress
from functools import lru_cache
from itertools import accumulate, chain, product
from pathlib import Path
from random import Random
from typing import NamedTuple

from deepbots_cli import frames
from deepbots_cli.diagnostics import Span
from deepbots_cli.errors import EngineError
from deepbots_cli.files import read_at_most
from deepbots_cli.robots.elements import Element
from deepbots_cli.robots.mesh_formats import (
    GLTF_SUFFIXES,
    FaultyMeshError,
    Rows,
    Triangles,
    placed_triangles,
    read_gltf,
)
from deepbots_cli.robots.model import ZERO, Mesh, Vector
from deepbots_cli.robots.packages import MeshElsewhere, ResolveMesh, UnusableMesh

MAX_BYTES = 32 * 2**20
MAX_TOTAL_BYTES = 256 * 2**20
MAX_CACHED_MESHES = 256
_CHECKED: dict[tuple[str, str], CheckedMesh] = {}
"""The meshes that were checked, by suffix and sha256 digest."""
MESH_SUFFIXES = (".stl", ".obj", ".dae", *GLTF_SUFFIXES)
_MAX_COORDINATE = 1e6  # in the units of the mesh: 1 km in millimeters
MAX_EXACT_VERTICES = 300_000  # read in 0.5 s
_LFS_POINTER = b"version https://git-lfs"
_ARCHIVES = (
    b"PK\x03\x04",
    b"PK\x05\x06",
    b"\x1f\x8b",
    b"BZh",
    b"\xfd7zXZ\0",
    b"7z\xbc\xaf",
    b"Rar!",
    b"\x28\xb5\x2f\xfd",
)


Bounds = tuple[Vector, Vector]
"""The lowest and the highest coordinates of a box."""


class CheckedMesh(NamedTuple):
    """The first problem of a mesh; else how often its triangles cover it where they are many, and the box
    around it, in its own units."""

    problem: str | None
    coverage: Coverage | None = None
    box: Bounds = (ZERO, ZERO)


class LoadedMesh(NamedTuple):
    """A mesh that an engine may load; `elsewhere` is its path from the folder of the robot, if it is not
    where the robot file says."""

    path: Path
    digest: str
    elsewhere: str | None = None


class MeshReader:
    """Reads each mesh of one robot once: path and sha256 digest, or a refusal. `spans` has the real path of
    each mesh that was read, by the span of its file name, and `boxes` the box around it, in its own
    units, by suffix and digest. The reader collects the elements of the meshes that are
    `refused`, by the headline of the refusal, with whether the robot can do without, and of those
    `elsewhere`, with their paths."""

    def __init__(self, resolve: ResolveMesh) -> None:
        self.spans: dict[Span, str] = {}
        self.boxes: dict[tuple[str, str], Bounds] = {}
        self.refused: dict[str, list[tuple[Element, UnusableMesh, bool]]] = {}
        self.elsewhere: list[tuple[Element, str]] = []
        self._resolve = resolve
        self._loaded: dict[Path, tuple[str, Coverage | None] | UnusableMesh] = {}
        self._total = 0

    def load(self, reference: str, scale: Vector) -> LoadedMesh | UnusableMesh:
        """Return a mesh as a robot file names it, with the factors along its axes."""
        try:
            resolved = self._resolve(reference)
            if isinstance(resolved, UnusableMesh):
                return resolved
            path = resolved.path if isinstance(resolved, MeshElsewhere) else resolved
            # A mesh that is visual and collision shape is read once, and counts once in the total.
            if path not in self._loaded:
                self._loaded[path] = self._digest(path)
        except OSError as error:
            return UnusableMesh(f"the mesh cannot be read: {error.strerror}")
        measured = self._loaded[path]
        elsewhere = resolved.reference if isinstance(resolved, MeshElsewhere) else None
        if isinstance(measured, UnusableMesh):
            return measured
        digest, coverage = measured
        layers = coverage.layers(scale) if coverage is not None else 0.0
        if layers > MAX_LAYERS:
            headline = (
                f"the triangles of the mesh cover each other about {layers:,.0f} times, and the limit"
                f" is {MAX_LAYERS}"
            )
            return UnusableMesh(
                headline, "remove triangles that lie in or behind others: a picture of them takes minutes"
            )
        return LoadedMesh(path, digest, elsewhere)

    def _digest(self, path: Path) -> tuple[str, Coverage | None] | UnusableMesh:
        if not str(path).isprintable():
            return UnusableMesh(
                "the path of the mesh contains characters that cannot be printed",
                "rename the file or its folder",
            )
        if path.suffix.lower() not in MESH_SUFFIXES:
            return UnusableMesh(
                f"the mesh format {path.suffix[:20]!r} is not supported",
                f"convert it to one of: {', '.join(MESH_SUFFIXES)}",
            )
        if not path.exists():
            help = f"check the path: deepbots looked for {path}"
            return UnusableMesh("the mesh does not exist", help, is_missing=True)
        if not path.is_file():
            return UnusableMesh("the mesh is not a regular file")
        # By the bytes that are read: the size that the system names may be that of another moment.
        try:
            data = read_mesh(path)
        except FaultyMeshError as error:
            return UnusableMesh(str(error), "export the mesh again")
        if len(data) > MAX_BYTES:
            return UnusableMesh(f"the mesh is larger than {MAX_BYTES >> 20} MiB", "simplify it")
        self._total += len(data)
        if self._total > MAX_TOTAL_BYTES:
            return UnusableMesh(
                f"the meshes of this robot are larger than {MAX_TOTAL_BYTES >> 20} MiB together",
                "simplify them",
            )
        if data.startswith(_LFS_POINTER):
            return UnusableMesh(
                "the mesh is a Git LFS pointer, a small text in place of the mesh",
                "fetch the meshes with `git lfs pull` in the clone of the repository",
            )
        if data.startswith(_ARCHIVES):
            return UnusableMesh("the mesh is an archive", "unpack it")
        suffix, digest = path.suffix.lower(), hashlib.sha256(data).hexdigest()
        if (suffix, digest) not in _CHECKED:
            if len(_CHECKED) >= MAX_CACHED_MESHES:
                _CHECKED.clear()
            _CHECKED[suffix, digest] = _checked(suffix, data, digest)
        checked = _CHECKED[suffix, digest]
        self.boxes[suffix, digest] = checked.box
        return (
            UnusableMesh(checked.problem, "export the mesh again")
            if checked.problem
            else (digest, checked.coverage)
        )


def read_mesh(path: Path) -> bytes:
    """Return the content of a mesh, a `.gltf` file as the `.glb` file with its buffers; at most one byte more
    than `MAX_BYTES`.

    Raises:
        FaultyMeshError: A `.gltf` file cannot be read with its buffers.
        OSError: The file cannot be read.
    """
    # The caller says what a pointer or an archive is.
    if path.suffix.lower() in GLTF_SUFFIXES and not read_at_most(path, len(_LFS_POINTER)).startswith(
        (_LFS_POINTER, *_ARCHIVES)
    ):
        return read_gltf(path, MAX_BYTES)
    return read_at_most(path, MAX_BYTES + 1)


def read_verified(mesh: Mesh) -> bytes:
    """Return the file of a mesh of a compiled scenario, if it is still the file that the compiler checked.

    Raises:
        EngineError: The file cannot be read, or has changed.
    """
    path = Path(mesh.path)
    if "\0" in mesh.path or not path.is_file():  # a pipe or a device would be read for ever
        raise EngineError(f"mesh {mesh.path} cannot be read: it is not a file")
    try:
        data = read_mesh(path)
    except FaultyMeshError as error:
        raise EngineError(f"mesh {mesh.path} cannot be read: {error}") from error
    except OSError as error:
        raise EngineError(f"mesh {mesh.path} cannot be read: {error.strerror}") from error
    if hashlib.sha256(data).hexdigest() != mesh.digest:
        raise EngineError(f"mesh {mesh.path} has changed since the scenario was compiled")
    return data


def mesh_bounds(mesh: Mesh) -> Bounds | None:
    """Return the box around a scaled mesh, m; None if the file is missing or changed."""
    with suppress(EngineError):
        return _bounds(mesh)
    return None


@lru_cache(maxsize=1000)  # an exception is not cached: the file may be there later
def _bounds(mesh: Mesh) -> Bounds:
    return scaled_box(_box(_verified_coordinates(mesh)), mesh.scale)


def scaled_box(box: Bounds, scale: Vector) -> Bounds:
    """Return the box around a mesh that is multiplied by factors along its axes; a negative one mirrors
    it."""
    ends = [sorted((a * factor, b * factor)) for a, b, factor in zip(*box, scale, strict=True)]
    (x, x_end), (y, y_end), (z, z_end) = ends
    return (x, y, z), (x_end, y_end, z_end)


def _box(numbers: Sequence[float]) -> Bounds:
    axes = [numbers[axis::3] for axis in range(3)]
    (x, y, z), (x_end, y_end, z_end) = ([end(axis, default=0.0) for axis in axes] for end in (min, max))
    return (x, y, z), (x_end, y_end, z_end)


def mesh_vertices(mesh: Mesh) -> tuple[Vector, ...]:
    """Return the vertices of a scaled mesh, m: the convex hull of a mesh is that of its vertices.

    A mesh with more than `MAX_EXACT_VERTICES` of them gives the corners of its box; a file that is missing or
    changed gives none.
    """
    with suppress(EngineError):
        return _vertices(mesh)
    return ()


@lru_cache(maxsize=64)
def _vertices(mesh: Mesh) -> tuple[Vector, ...]:
    numbers = _verified_coordinates(mesh)
    axes = [numbers[axis::3] for axis in range(3)]
    own: Iterable[tuple[float, ...]] = (
        set(zip(*axes, strict=True))
        if len(numbers) <= 3 * MAX_EXACT_VERTICES
        else product(*((min(axis), max(axis)) for axis in axes))
    )
    a, b, c = mesh.scale
    return tuple((a * x, b * y, c * z) for x, y, z in own)


def mesh_reach(mesh: Mesh, direction: Vector) -> float:
    """Return how far the vertices of a mesh reach from its origin along a unit vector, m; 0 for a file that
    is missing or changed."""
    with suppress(EngineError):
        return _reach(mesh, direction)
    return 0.0


@lru_cache(maxsize=4096)
def _reach(mesh: Mesh, direction: Vector) -> float:
    a, b, c = direction
    return max((a * x + b * y + c * z for x, y, z in _vertices(mesh)), default=0.0)


def _verified_coordinates(mesh: Mesh) -> array[float]:
    return _coordinates(Path(mesh.path).suffix.lower(), read_verified(mesh))


# Content


def _checked(suffix: str, data: bytes, digest: str) -> CheckedMesh:
    problem = mesh_problem(suffix, data)
    if problem:
        return CheckedMesh(problem)
    box = mesh_size(suffix, data)[:2]
    return CheckedMesh(None, mesh_coverage(suffix, data, digest, box), box)


def mesh_problem(suffix: str, data: bytes) -> str | None:
    """Return the headline for the first problem of a mesh; None if an engine may load it.

    Beyond all plausible sizes, engines search a grid as large as the mesh, and do not end.
    """
    try:
        size = mesh_size(suffix, data)
    except FaultyMeshError as error:
        return str(error)
    farthest = max(map(abs, (*size.lower, *size.upper)))
    return (
        f"the mesh has a vertex at {farthest:.2g}, and the limit is {_MAX_COORDINATE:.0g}"
        if farthest > _MAX_COORDINATE
        else None
    )


class MeshSize(NamedTuple):
    """The corners of the box around a mesh, in its own units, and how many triangles it has."""

    lower: Vector
    upper: Vector
    triangles: int


def mesh_size(suffix: str, data: bytes) -> MeshSize:
    """Return the size of a mesh.

    Raises:
        FaultyMeshError: The file is not sound.
    """
    faces = sum(len(part.corners) // 3 for part, _ in placed_triangles(suffix, data))
    return MeshSize(*_box(_coordinates(suffix, data)), faces)


def _coordinates(suffix: str, data: bytes) -> array[float]:
    """Return the coordinates of the vertices that the triangles of a mesh name, one after the other."""
    return array("d", chain.from_iterable(part.moved(rows) for part, rows in placed_triangles(suffix, data)))


# Coverage


MAX_LAYERS = 100
_SAMPLE = 1_000  # triangles


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


def mesh_coverage(suffix: str, data: bytes, seed: str, box: Bounds) -> Coverage | None:
    """Return the coverage of a mesh without fault; None of one with few triangles.

    Args:
        suffix: The suffix of the file, in lower case.
        data: The content of the file.
        seed: The seed of the sample, such as a digest: a file cannot be written to fit it.
        box: The box around the mesh, in its own units.
    """
    placed = placed_triangles(suffix, data)
    *starts, count = accumulate((len(part.corners) // 3 for part, _ in placed), initial=0)
    # Few triangles cannot cover each other more than `MAX_LAYERS` times.
    if count <= MAX_LAYERS:
        return None
    numbers = Random(seed).sample(range(count), min(count, _SAMPLE))
    x = y = z = 0.0
    for number in sorted(numbers):
        index = bisect(starts, number) - 1
        ax, ay, az, bx, by, bz, cx, cy, cz = _triangle(*placed[index], number - starts[index])
        bx, by, bz, cx, cy, cz = bx - ax, by - ay, bz - az, cx - ax, cy - ay, cz - az
        x, y, z = x + abs(by * cz - bz * cy), y + abs(bz * cx - bx * cz), z + abs(bx * cy - by * cx)
    share = count / len(numbers) / 2  # a cross product is twice the area of its triangle
    a, b, c = frames.subtract(box[1], box[0])
    return Coverage((share * x, share * y, share * z), (b * c, a * c, a * b))


def _triangle(part: Triangles, rows: Rows, number: int) -> Sequence[float]:
    """Return the coordinates of the corners of a triangle, where a node places it."""
    corners = part.corners[3 * number : 3 * number + 3]
    own = chain.from_iterable(part.numbers[3 * corner : 3 * corner + 3] for corner in corners)
    return Triangles(array("d", own), corners).moved(rows)
