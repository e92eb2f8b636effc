"""How Shape nodes look: their geometry, color and texture; the color of the sky.

A texture covers a face of a box, a plane or a grid; other shapes have its mean color.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from math import cos, isfinite, pi, sin
from typing import TYPE_CHECKING

import numpy as np

from deepbots_cli.files import read_at_most
from deepbots_cli.webots.findings import WorldFindings
from deepbots_cli.webots.nodes import child, is_a, number, numbers, real, texts, vector
from deepbots_cli.webots.shapes import Shape, shape_of

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from deepbots_cli.frames import Triple
    from deepbots_cli.webots.project import Files
    from deepbots_cli.webots.scene import Visual
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


CONE_SIDES = 32
"""The sides of a cone, which is drawn as a mesh."""


def visible_shape(visual: Visual, files: Files) -> Shape | None:
    """Return the geometry of a Shape node; None for one that is not drawn."""
    geometry = child(visual.node, "geometry")
    if geometry is None:
        return None
    if geometry.type == "Cone":
        return _cone(number(geometry, "bottomRadius"), number(geometry, "height"), visual.scale)
    return shape_of(geometry, visual.scale, files, WorldFindings())


def _cone(radius: float, height: float, scale: Triple) -> Shape:
    """Return a cone around z, with its base at the bottom."""
    rim: list[Triple] = [
        (radius * cos(2 * pi * k / CONE_SIDES), radius * sin(2 * pi * k / CONE_SIDES), -height / 2)
        for k in range(CONE_SIDES)
    ]
    points = [*rim, (0.0, 0.0, height / 2), (0.0, 0.0, -height / 2)]
    faces = []
    for k in range(CONE_SIDES):
        after = (k + 1) % CONE_SIDES
        faces += [(k, after, CONE_SIDES), (after, k, CONE_SIDES + 1)]
    scaled = [(x * scale[0], y * scale[1], z * scale[2]) for x, y, z in points]
    return Shape("mesh", vertices=scaled, faces=faces)


@dataclass(frozen=True)
class Look:
    """The color (red, green, blue, opacity, from 0 to 1) of a Shape node below its texture."""

    base: tuple[float, float, float, float] = (0.8, 0.8, 0.8, 1.0)
    texture: Texture | None = None

    @property
    def color(self) -> tuple[float, float, float, float]:
        """The color with the mean of the texture."""
        if self.texture is None:
            return self.base
        red, green, blue = (
            channel * share for channel, share in zip(self.base, self.texture.mean, strict=False)
        )
        return red, green, blue, self.base[3]


def look_of(node: Node, files: Files) -> Look:
    """Return the color and texture of a Shape node."""
    appearance = child(node, "appearance")
    if appearance is None:
        return Look()
    if is_a(appearance, "PBRAppearance"):
        return _look(appearance, "baseColor", texture_of(appearance, "baseColorMap", files))
    if not is_a(appearance, "Appearance"):
        return Look()
    texture = texture_of(appearance, "texture", files)
    material = child(appearance, "material")
    return _look(material, "diffuseColor", texture) if material is not None else Look(texture=texture)


def _look(node: Node, field: str, texture: Texture | None) -> Look:
    return Look((*vector(node, field), 1.0 - number(node, "transparency")), texture)


def color_of(node: Node, files: Files) -> Sequence[float]:
    """Return the color and opacity of a Shape node, with the mean color of its texture."""
    return look_of(node, files).color


def sky_color(nodes: Sequence[Node]) -> Triple | None:
    """Return the color of the sky; None in a world without a Background."""
    sky = next((real(node) for node in nodes if real(node).type == "Background"), None)
    return None if sky is None else vector(sky, "skyColor")
