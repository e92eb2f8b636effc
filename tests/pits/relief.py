"""Two more pits like that of PitEscape, as files: a picture of heights with other lumps, and a smooth bowl of
triangles.

    python tests/pits/relief.py

writes `pit.png` and `pit.obj` beside this file. Both follow the formula of the paper's world (Kirtas et al.,
AIAI 2020), `height * g * (1 - g)` with a bell g of width 2.7 m around the origin, and are as high on average
as the terrain `pit` is with a height of 2.5 m and a noise of 0.15.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

HERE = Path(__file__).parent
HEIGHT, NOISE, WIDTH = 2.5, 0.15, 2.7
SIDE, CELLS = 8.0, 80
"""Of the picture: m, and cells of 0.1 m along either side."""
WHITE = 0.75
"""Height of white in the picture, m."""
RINGS, SECTORS, REACH = 24, 48, 3.6
"""Of the mesh: its triangles are up to 0.47 m wide, and meet at other lines than a grid of squares has."""


def profile(
    x: NDArray[np.float64], y: NDArray[np.float64], lumps: NDArray[np.float64] | float = 0.5
) -> NDArray[np.float64]:
    """Heights (m) at places (m); `lumps`, from 0 to 1, say how much of the noise there is."""
    bell = np.exp(-(x**2 + y**2) / (2 * WIDTH**2))
    return np.asarray(HEIGHT * bell * (1 - bell) * (1 - NOISE + NOISE * lumps))


def lumps(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Waves of 1 to 3 m in fixed directions, from 0 to 1."""
    rng = np.random.default_rng(1)
    waves = [
        np.sin(2 * np.pi * (x * np.cos(angle) + y * np.sin(angle)) / length + shift)
        for angle, length, shift in zip(
            rng.uniform(0, np.pi, 6), rng.uniform(1, 3, 6), rng.uniform(0, 2 * np.pi, 6), strict=True
        )
    ]
    return np.clip(0.5 + sum(waves) / 6, 0.0, 1.0)


def picture() -> bytes:
    """A gray PNG of 16 bits; its first row is the farthest along y."""
    along = np.linspace(-SIDE / 2, SIDE / 2, CELLS + 1)
    x, y = np.meshgrid(along, along[::-1])
    gray = np.rint(profile(x, y, lumps(x, y)) / WHITE * 65535).astype(">u2")
    rows = b"".join(b"\x00" + row.tobytes() for row in gray)
    header = struct.pack(">IIBBBBB", CELLS + 1, CELLS + 1, 16, 0, 0, 0, 0)
    parts = ((b"IHDR", header), (b"IDAT", zlib.compress(rows, 9)), (b"IEND", b""))
    chunks = (
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in parts
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


def mesh() -> str:
    """An OBJ of rings around the origin."""
    lines = ["# a pit of rings and sectors; written by relief.py", "v 0 0 0"]
    for ring in range(1, RINGS + 1):
        radius = REACH * ring / RINGS
        for sector in range(SECTORS):
            angle = 2 * np.pi * sector / SECTORS
            x, y = radius * np.cos(angle), radius * np.sin(angle)
            lines.append(f"v {x:.4f} {y:.4f} {float(profile(x, y)):.4f}")
    lines += [f"f 1 {2 + sector} {2 + (sector + 1) % SECTORS}" for sector in range(SECTORS)]
    for ring in range(RINGS - 1):
        for sector in range(SECTORS):
            inner, outer = 2 + ring * SECTORS, 2 + (ring + 1) * SECTORS
            after = (sector + 1) % SECTORS
            lines.append(f"f {inner + sector} {outer + sector} {outer + after} {inner + after}")
    return "\n".join(lines) + "\n"


def main() -> None:
    (HERE / "pit.png").write_bytes(picture())
    (HERE / "pit.obj").write_text(mesh(), encoding="utf-8")


if __name__ == "__main__":
    main()
