"""The triangles of a glTF 2.0 file, and its faults. This module needs no numpy, since lint imports it.

A `.glb` file has its buffer inside; a `.gltf` file is JSON, whose buffers are texts inside or files beside
it, and is read as the `.glb` file of the same content. Coordinates are taken as they are, as trimesh and
MuJoCo take them: glTF calls y up, and URDF has no such word. Materials, pictures and animations are left out.
"""

from __future__ import annotations

import base64
import binascii
import json
import math
import os
import struct
import sys
from array import array
from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

from deepbots_cli.files import is_file, read_at_most
from deepbots_cli.frames import rotate
from deepbots_cli.robots.collada import IDENTITY, MAX_CORNERS, MAX_NODES, Rows, Triangles, product

GLTF_SUFFIXES = (".glb", ".gltf")
_MAGIC = b"glTF"
_HEADER, _CHUNK = struct.Struct("<4sII"), struct.Struct("<I4s")
_TYPES = {5121: "B", 5123: "H", 5125: "I", 5126: "f"}
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_IS_COMPRESSED = ("draco", "meshopt")
_NOT_DRAWN = ("images", "textures", "samplers", "animations", "cameras", "skins")
_ZERO, _ONE, _UPRIGHT = (0.0,) * 3, (1.0,) * 3, (0.0, 0.0, 0.0, 1.0)


class FaultyGltfError(ValueError):
    """The reason why a file is not read, as a headline."""


def read_gltf(path: Path, limit: int) -> bytes:
    """Return a glTF file as `.glb`, with at most `limit` bytes; one byte more shows that it is larger.

    Raises:
        FaultyGltfError: It is not JSON, or a buffer is missing, outside the folder of the file, or wrong.
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
        for name in _NOT_DRAWN:
            document.pop(name, None)
        text = json.dumps(document, separators=(",", ":"), sort_keys=True).encode()
    text += b" " * (-len(text) % 4)
    size = _HEADER.size + 2 * _CHUNK.size + len(text) + len(buffer)
    parts = [_HEADER.pack(_MAGIC, 2, size), _CHUNK.pack(len(text), b"JSON"), text]
    return b"".join([*parts, _CHUNK.pack(len(buffer), b"BIN\0"), bytes(buffer)])


def _buffer(uri: str, folder: Path, limit: int) -> bytes:
    if uri.startswith("data:"):
        return base64.b64decode(uri.partition(",")[2], validate=True)
    path = Path(os.path.realpath(folder / uri.replace("%20", " ")))
    if "://" in uri or not path.is_relative_to(os.path.realpath(folder)):
        raise FaultyGltfError("a buffer of the glTF file lies outside its folder")
    if not is_file(path):
        raise FaultyGltfError(f"the buffer {uri[-60:]!r} of the glTF file does not exist beside it")
    return read_at_most(path, limit + 1)


class _faults:  # noqa: N801  (a context manager, called as a function)
    """Turns what a wrong value of the JSON raises into the fault of the file."""

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: object) -> None:
        wrong = (ValueError, LookupError, TypeError, AttributeError, OverflowError, struct.error)
        if isinstance(error, wrong) and not isinstance(error, FaultyGltfError):
            is_base64 = isinstance(error, binascii.Error)
            what = "a buffer of the glTF file is not base64" if is_base64 else "the glTF file is not sound"
            raise FaultyGltfError(what) from error


def _document(data: bytes) -> dict[str, Any]:
    try:
        document = json.loads(data.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise FaultyGltfError("the mesh is not a glTF file") from error
    if not isinstance(document, dict):
        raise FaultyGltfError("the mesh is not a glTF file")
    return document


@lru_cache(maxsize=1)
def placed_triangles(data: bytes) -> tuple[tuple[Triangles, Rows], ...]:
    """Return the triangles of a `.glb` file in the frame of their mesh, and the map from there to the frame
    of the file, once for each node that places the mesh.

    Raises:
        FaultyGltfError: The file is not sound, is compressed, or places too much.
    """
    document, buffer = _parts(data)
    for extension in document.get("extensionsRequired") or []:
        if any(word in str(extension) for word in _IS_COMPRESSED):
            raise FaultyGltfError(f"the glTF file is compressed ({str(extension)[:40]})")
    with _faults():
        meshes: dict[int, list[Triangles]] = {}
        placed: list[tuple[Triangles, Rows]] = []
        corners = 0
        for number, rows in _instances(document):
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
                    raise FaultyGltfError(f"the glTF file places more than {MAX_CORNERS:,} corners")
                placed.append((part, rows))
        return tuple(placed)
    raise AssertionError  # `_faults` passes every other exception on


def _parts(data: bytes) -> tuple[dict[str, Any], bytes]:
    """Return the JSON of a `.glb` file, and its buffer."""
    if len(data) < _HEADER.size + _CHUNK.size or not data.startswith(_MAGIC):
        raise FaultyGltfError("the mesh is not a binary glTF file")
    _, version, size = _HEADER.unpack_from(data)
    if version != 2:
        raise FaultyGltfError(f"the glTF file is of version {version}, and deepbots reads version 2")
    if size != len(data):
        raise FaultyGltfError(f"the glTF file declares {size:,} bytes, but has {len(data):,}")
    chunks: dict[bytes, bytes] = {}
    at = _HEADER.size
    while at + _CHUNK.size <= len(data):
        length, kind = _CHUNK.unpack_from(data, at)
        at += _CHUNK.size
        if at + length > len(data):
            raise FaultyGltfError("a part of the glTF file is longer than the file")
        chunks.setdefault(kind, data[at : at + length])
        at += length
    return _document(chunks.get(b"JSON", b"")), chunks.get(b"BIN\0", b"")


def _instances(document: dict[str, Any]) -> Iterator[tuple[int, Rows]]:
    """Yield the number of each mesh of the scene, and the map from its own frame to that of the file."""
    nodes, scenes = document.get("nodes", []), document.get("scenes", [])
    first = scenes[document.get("scene", 0)].get("nodes", []) if scenes else range(len(nodes))
    waiting = [(number, IDENTITY) for number in first]
    visited = 0
    while waiting:
        visited += 1
        if visited > MAX_NODES:
            raise FaultyGltfError(f"the glTF file places more than {MAX_NODES:,} nodes")
        number, above = waiting.pop()
        node = nodes[_index(number)]
        rows = product(above, _rows(node))
        if "mesh" in node:
            yield _index(node["mesh"]), rows
        waiting += [(child, rows) for child in node.get("children", [])]


def _index(number: object) -> int:
    if not isinstance(number, int) or number < 0:
        raise FaultyGltfError("the glTF file is not sound")
    return number


def _rows(node: dict[str, Any]) -> Rows:
    """Return the map of a node: a matrix by columns, or a scale, a rotation and a translation."""
    if "matrix" in node:
        matrix = _floats(node["matrix"], 16)
        return tuple(matrix[row::4] for row in range(3))
    x, y, z, w = _floats(node.get("rotation", _UPRIGHT), 4)
    scale = _floats(node.get("scale", _ONE), 3)
    axes = [rotate((x, y, z, w), unit) for unit in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))]
    at = _floats(node.get("translation", _ZERO), 3)
    return tuple(
        (*(axis[row] * factor for axis, factor in zip(axes, scale, strict=True)), at[row]) for row in range(3)
    )


def _floats(values: object, size: int) -> tuple[float, ...]:
    numbers = tuple(map(float, values)) if isinstance(values, (list, tuple)) else ()
    if len(numbers) != size or not all(map(math.isfinite, numbers)):
        raise FaultyGltfError("a node of the glTF file is not placed by finite numbers")
    return numbers


def _triangles(document: dict[str, Any], buffer: bytes, primitive: dict[str, Any]) -> Triangles | None:
    """Return the triangles of a primitive; None for points and lines."""
    mode = primitive.get("mode", _TRIANGLES)
    if mode not in (_TRIANGLES, _STRIP, _FAN):
        return None
    numbers = _accessor(document, buffer, primitive["attributes"]["POSITION"], 3, "f")
    count = len(numbers) // 3
    if not math.isfinite(sum(numbers)):
        raise FaultyGltfError("the glTF file contains a vertex that is not finite")
    given = primitive.get("indices")
    indices = array("I", range(count)) if given is None else _accessor(document, buffer, given, 1, "BHI")
    if len(indices) and max(indices) >= count:
        raise FaultyGltfError(
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
        raise FaultyGltfError("the numbers of the glTF file are compressed or of a kind that is not read")
    view = document["bufferViews"][_index(accessor["bufferView"])]
    if _index(view["buffer"]) != 0:
        raise FaultyGltfError("a buffer of the glTF file lies outside of it")
    count, numbers = _index(accessor["count"]), array(code)
    width = size * numbers.itemsize
    stride = _index(view.get("byteStride", 0)) or width
    start = _index(view.get("byteOffset", 0)) + _index(accessor.get("byteOffset", 0))
    if stride < width or start + (count - 1) * stride + width > len(buffer) or count * size > 3 * MAX_CORNERS:
        raise FaultyGltfError("the glTF file has fewer numbers than it declares")
    if stride == width:
        numbers.frombytes(buffer[start : start + count * width])
    else:
        for at in range(start, start + count * stride, stride):
            numbers.frombytes(buffer[at : at + width])
    if sys.byteorder == "big":
        numbers.byteswap()
    return numbers
