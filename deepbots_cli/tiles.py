"""Heights of a terrain of tiles: squares of one kind each, such as stairs, from easy to hard.

A tile has a level platform in its middle, where a robot can stand, and is at the height 0 along its edge, so
that all tiles fit together. Its measures go from those of the lowest to those of the highest level.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from deepbots_cli.program.world import TILE_MARGIN_M

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from deepbots_cli.program.world import Tiles

    Heights = NDArray[np.float64]


class _Square(NamedTuple):
    """The points of a tile: x and y (m) from its middle, and the larger of both distances."""

    x: Heights
    y: Heights
    distance: Heights
    half: float
    platform: float
    """Half the side of the platform, m."""
    random: np.random.Generator

    @property
    def inside(self) -> Heights:
        """1 within the margin, and down to 0 at the edge."""
        return np.clip((self.half - self.distance) / TILE_MARGIN_M, 0.0, 1.0)

    @property
    def off_platform(self) -> NDArray[np.bool_]:
        return self.distance > self.platform


def _slope(square: _Square, angle: float, inverted: float) -> Heights:
    rise: Heights = np.tan(angle) * (square.half - np.maximum(square.distance, square.platform))
    return -rise if inverted else rise


def _stairs(square: _Square, height: float, tread: float, inverted: float) -> Heights:
    """Steps from the edge to the platform, which is reached by the last one."""
    into = square.half - np.maximum(square.distance, square.platform)
    # 1e-9: rounding must not take a step from a whole number of treads.
    steps = np.floor(into / tread + 1e-9)
    return (-height if inverted else height) * steps


def _waves(square: _Square, height: float, length: float) -> Heights:
    # The sum of both cosines goes from -2 to 2, the height from 0 to `height`.
    along = np.cos(2.0 * np.pi * square.x / length) + np.cos(2.0 * np.pi * square.y / length)
    return height * (along + 2.0) / 4.0 * square.inside


def _rough(square: _Square, height: float, grain: float) -> Heights:
    """Random heights `grain` apart, with straight lines between them."""
    count = max(2, int(np.ceil(2.0 * square.half / grain)) + 1)
    values = square.random.random((count, count))
    at = np.linspace(0.0, count - 1.0, len(square.x))
    # The last point is part of the last piece.
    first = np.minimum(at.astype(int), count - 2)
    part = at - first
    along = values[:, first] * (1 - part) + values[:, first + 1] * part
    whole = along[first] * (1 - part)[:, None] + along[first + 1] * part[:, None]
    rough: Heights = height * whole * square.inside
    return rough


def _blocks(square: _Square, height: float, side: float) -> Heights:
    """Boxes of random height side by side."""
    count = max(1, int(np.ceil(2.0 * square.half / side)))
    values = square.random.random((count, count))
    # 1e-9 absorbs rounding at the edge of a box: 0.3 / 0.1 is 2.9999999999999996.
    column = np.minimum(((square.x + square.half) / side + 1e-9).astype(int), count - 1)
    row = np.minimum(((square.y + square.half) / side + 1e-9).astype(int), count - 1)
    is_inside = (square.half - square.distance >= TILE_MARGIN_M) & square.off_platform
    return np.where(is_inside, height * values[row, column], 0.0)


def _stepping_stones(square: _Square, side: float, gap: float, depth: float) -> Heights:
    """Stones of one height, with gaps between them."""
    pitch = side + gap
    on_stone = np.ones(square.x.shape, bool)
    for place in (square.x, square.y):
        # 1e-9: the edge of a stone is part of it, in spite of rounding.
        on_stone &= np.abs((place + pitch / 2) % pitch - pitch / 2) <= side / 2 + 1e-9
    is_inside = (square.half - square.distance >= TILE_MARGIN_M) & square.off_platform
    return np.where(is_inside & ~on_stone, -depth, 0.0)


def _gaps(square: _Square, width: float, spacing: float, depth: float) -> Heights:
    """Trenches around the platform, one after the other."""
    out = square.distance - square.platform
    # 1e-9: the near edge of a trench is ground, the far edge is part of the trench.
    in_gap = ((out - 1e-9) % (spacing + width) >= spacing) & square.off_platform
    return np.where(in_gap & (square.half - square.distance >= TILE_MARGIN_M), -depth, 0.0)


_SHAPES: Mapping[str, Callable[..., Heights]] = {
    "slope": _slope,
    "stairs": _stairs,
    "waves": _waves,
    "rough": _rough,
    "blocks": _blocks,
    "stepping_stones": _stepping_stones,
    "gaps": _gaps,
}


def tile_heights(tiles: Tiles, kind: int, level: int) -> Heights:
    """Heights (m) of one tile; shape (n, n), rows along y and columns along x."""
    tile = tiles.tiles[kind]
    share = level / max(1, tiles.levels - 1)
    # linspace misses round numbers by up to 1e-15, which would put points on either side of an edge.
    along = np.linspace(-tiles.side / 2, tiles.side / 2, round(tiles.side / tiles.cell) + 1).round(9)
    x, y = np.meshgrid(along, along)
    # Each tile has its own stream, so that another kind of tile changes none of the others.
    # `default_rng` does not fix its bit generator, and the terrain of a seed must not change with NumPy.
    random = np.random.Generator(np.random.PCG64([tiles.seed, kind, level]))
    square = _Square(x, y, np.maximum(np.abs(x), np.abs(y)), tiles.side / 2, tiles.platform / 2, random)
    measures = {name: low + (high - low) * share for name, low, high in tile.measures}
    return _SHAPES[tile.kind](square, **measures)


def heights(tiles: Tiles) -> Heights:
    """Heights (m) of the whole terrain: kinds side by side along x, levels along y, and a flat border."""
    cells, border = round(tiles.side / tiles.cell), round(tiles.border / tiles.cell)
    rows, columns = (count * cells + 2 * border + 1 for count in (tiles.levels, len(tiles.tiles)))
    whole = np.zeros((rows, columns))
    for kind in range(len(tiles.tiles)):
        for level in range(tiles.levels):
            first_row, first_column = border + level * cells, border + kind * cells
            part = whole[first_row : first_row + cells + 1, first_column : first_column + cells + 1]
            part += tile_heights(tiles, kind, level)  # neighbors share an edge, which is 0
    return whole
