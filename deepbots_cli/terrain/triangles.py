"""Mesh files as triangles, for the height of the ground under a place. The files were checked (`urdf.mesh_format`)."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from deepbots_cli.errors import EngineError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from deepbots_cli.robots.model import Mesh


def triangles(mesh: Mesh) -> NDArray[np.float64]:
    """The corners, scaled: shape (count, 3 corners, 3 coordinates), in m.

    Raises:
        EngineError: The file has gone, or holds no triangles.
    """
    path = Path(mesh.path)
    try:
        data = path.read_bytes()
        corners = _stl(data) if path.suffix.lower() == ".stl" else _obj(data)
    except (OSError, ValueError, IndexError) as error:
        raise EngineError(f"mesh {mesh.path} cannot be read") from error
    return np.asarray(corners * np.asarray(mesh.scale))


def _stl(data: bytes) -> NDArray[np.float64]:
    if data.lstrip()[:5].lower() == b"solid" and b"facet" in data:
        numbers = [line.split()[1:4] for line in data.splitlines() if line.split()[:1] == [b"vertex"]]
        return np.array(numbers, np.float64).reshape(-1, 3, 3)
    faces = np.frombuffer(data, np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")]), offset=84)
    return faces["corners"].astype(np.float64)


def _obj(data: bytes) -> NDArray[np.float64]:
    vertices, faces = [], []
    for line in data.splitlines():
        match line.split():
            case [b"v", x, y, z, *_]:
                vertices.append((float(x), float(y), float(z)))
            case [b"f", *corners]:
                indices = [int(corner.partition(b"/")[0]) for corner in corners]
                indices = [index - 1 if index > 0 else len(vertices) + index for index in indices]
                faces += [(indices[0], *pair) for pair in pairwise(indices[1:])]
    return np.array(vertices, np.float64)[np.array(faces, np.int64)]
