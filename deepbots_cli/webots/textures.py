"""Textures of appearances: pictures of the project, and plain patterns for those that deepbots does not have.

A texture covers a face of a box, a plane or a grid; other shapes have its mean color.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from math import isfinite
from typing import TYPE_CHECKING

import numpy as np

from deepbots_cli.files import read_at_most
from deepbots_cli.webots.nodes import child, numbers, texts

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from deepbots_cli.frames import Triple
    from deepbots_cli.webots.project import Files
    from deepbots_cli.webots.syntax import Node

    Pixels = NDArray[np.uint8]

MAX_PICTURE_BYTES = 16 * 2**20
MAX_PICTURE_SIDE = 4096
"""The largest file of a texture, and its largest width and height in pixels."""
SIDE = 512
"""The largest width and height that is drawn, in pixels."""
MAX_REPEATS = 10_000.0
_MISSING = ((1.0, 1.0, 1.0), (0.55, 0.55, 0.55))
"""The squares of a texture that is not available, as parts of the color of the appearance."""
_PATTERNS: Mapping[str, tuple[Triple, ...]] = {
    "deepbots:parquetry": ((1.0, 0.84, 0.64), (0.92, 0.75, 0.55)),
    "deepbots:chequered parquetry": ((1.0, 0.84, 0.64), (0.62, 0.43, 0.28)),
    "deepbots:sand": ((1.0, 0.88, 0.68),),
    "deepbots:grass": ((0.45, 0.66, 0.32),),
    "deepbots:asphalt": ((0.5, 0.5, 0.52),),
}
"""The colors of the two squares of each pattern of the library, by its address. A single color has no
squares."""
_TILE_M = 0.5
"""The length of a pattern of the library: two squares."""


@dataclass(frozen=True, eq=False)
class Texture:
    """A picture: `pixels` of shape (rows, columns, 3). It repeats `repeats` times along x and y of a face, or
    every `length` meters unless `length` is 0."""

    pixels: Pixels
    repeats: tuple[float, float] = (1.0, 1.0)
    length: float = 0.0

    @property
    def mean(self) -> Triple:
        """The mean color, from 0 to 1."""
        red, green, blue = (float(channel) / 255 for channel in self.pixels.mean(axis=(0, 1)))
        return red, green, blue

    def repeats_on(self, size: Sequence[float]) -> tuple[float, float]:
        """Return how often the picture repeats on a face of a size (m)."""
        if not self.length:
            return self.repeats
        x, y = (min(max(side / self.length, 1.0), MAX_REPEATS) for side in size[:2])
        return x, y


def texture_of(appearance: Node, field: str, files: Files) -> Texture | None:
    """Return the texture in a field of an appearance; None if it has none."""
    image = child(appearance, field)
    addresses = texts(image, "url") if image is not None else []
    if image is None or not addresses:
        return None
    address = addresses[0]
    if address in _PATTERNS:
        return Texture(_squares(_PATTERNS[address]), length=_TILE_M)
    path = files.picture(address, image.span.source.name)
    pixels = _pixels(path) if path is not None else None
    return Texture(pixels if pixels is not None else _squares(_MISSING, 2), _repeats(appearance))


def _repeats(appearance: Node) -> tuple[float, float]:
    transform = child(appearance, "textureTransform")
    x, y = numbers(transform, "scale")[:2] if transform is not None else (1.0, 1.0)
    if not (isfinite(x) and isfinite(y)):
        return 1.0, 1.0
    return min(abs(x), MAX_REPEATS) or 1.0, min(abs(y), MAX_REPEATS) or 1.0


def _pixels(path: Path) -> Pixels | None:
    """Return the pixels of a picture; None for one that is too large or cannot be read."""
    from PIL import Image

    try:
        data = read_at_most(path, MAX_PICTURE_BYTES + 1)
        if len(data) > MAX_PICTURE_BYTES:
            return None
        with Image.open(BytesIO(data), formats=("PNG", "JPEG")) as picture:
            # Pillow has read the header alone, so that a huge picture is refused before it takes memory.
            if max(picture.size) > MAX_PICTURE_SIDE:
                return None
            picture.thumbnail((SIDE, SIDE))
            return np.asarray(picture.convert("RGB"))
    # Pillow raises SyntaxError for a broken PNG.
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        return None


def _squares(colors: Sequence[Triple], count: int = 1) -> Pixels:
    """Return squares of two colors in turn, `count` pairs along each side; a single color is one square."""
    if len(colors) == 1:
        side = np.zeros((8, 8), np.intp)
    else:
        side = np.kron(np.indices((2 * count, 2 * count)).sum(axis=0) % 2, np.ones((32, 32), np.intp))
    return (np.array(colors)[side] * 255).round().astype(np.uint8)
