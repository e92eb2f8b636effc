"""Shapes at simulation time: terrain as a grid of heights or as triangles, the height of the ground, and the
inertials of meshes.

Engines and the placement of bodies use the same surface. trimesh and yourdfpy read meshes: the triangles of a
terrain, and the masses of links with a density. Importing the two libraries takes 0.57 s of CPU. Each
function imports them when it is called, so only a world with such a mesh pays for them, and lint never needs
them.

A terrain of tiles consists of squares of one kind each, such as stairs, from easy to hard. A tile has a level
platform in its middle, where a robot can stand, and is at the height 0 along its edge, so that all tiles fit
together. Its measures go from those of the lowest to those of the highest level.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from hashlib import sha256
from io import BytesIO
from math import floor, inf, log, sqrt
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from deepbots_cli.arrays import evaluate
from deepbots_cli.engine_kinds import Diagonal
from deepbots_cli.errors import DeepbotsError, EngineError
from deepbots_cli.expressions.scalar import Name
from deepbots_cli.frames import rotation_matrix
from deepbots_cli.pictures import MAX_PICTURE_BYTES, picture_problem
from deepbots_cli.program.world import TILE_MARGIN_M, Formula, Picture, Pit, Terrain, TerrainShape, Tiles
from deepbots_cli.records import dataclass
from deepbots_cli.robots.mesh_formats import FaultyMeshError, placed_triangles
from deepbots_cli.robots.meshes import mesh_bounds, read_verified
from deepbots_cli.robots.model import (
    Geometry,
    Inertial,
    Link,
    Mesh,
    Pose,
    RobotModel,
    Vector,
    combined,
    homogeneous_inertial,
    volume,
    with_link,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Column = NDArray[np.float64]


class _Square(NamedTuple):
    """The points of a tile: x and y (m) from its middle, and the larger of both distances."""

    x: Column
    y: Column
    distance: Column
    half: float
    platform: float
    """Half the side of the platform, m."""
    random: np.random.Generator

    @property
    def relief(self) -> Column:
        """1 between the margins of the edge and of the platform, and down to 0 at both."""
        return np.clip(
            np.minimum(self.half - self.distance, self.distance - self.platform) / TILE_MARGIN_M, 0.0, 1.0
        )

    @property
    def is_ring(self) -> NDArray[np.bool_]:
        """Whether a point is between the platform and the margin of the edge."""
        return (self.distance > self.platform) & (self.half - self.distance >= TILE_MARGIN_M)


def _slope(square: _Square, angle: float, inverted: float) -> Column:
    rise: Column = np.tan(angle) * (square.half - np.maximum(square.distance, square.platform))
    return -rise if inverted else rise


def _stairs(square: _Square, height: float, tread: float, inverted: float) -> Column:
    """Steps from the edge to the platform, which is reached by the last one."""
    into = square.half - np.maximum(square.distance, square.platform)
    # 1e-9: rounding must not take a step from a whole number of treads.
    steps = np.floor(into / tread + 1e-9)
    return (-height if inverted else height) * steps


def _waves(square: _Square, height: float, length: float) -> Column:
    # The sum of both cosines goes from -2 to 2, the height from 0 to `height`.
    along = np.cos(2.0 * np.pi * square.x / length) + np.cos(2.0 * np.pi * square.y / length)
    return height * (along + 2.0) / 4.0 * square.relief


def _rough(square: _Square, height: float, grain: float) -> Column:
    """Random heights `grain` apart, with straight lines between them."""
    count = max(2, int(np.ceil(2.0 * square.half / grain)) + 1)
    values = square.random.random((count, count))
    at = np.linspace(0.0, count - 1.0, len(square.x))
    # The last point is part of the last piece.
    first = np.minimum(at.astype(int), count - 2)
    part = at - first
    along = values[:, first] * (1 - part) + values[:, first + 1] * part
    whole = along[first] * (1 - part)[:, None] + along[first + 1] * part[:, None]
    rough: Column = height * whole * square.relief
    return rough


def _blocks(square: _Square, height: float, side: float) -> Column:
    """Boxes of random height side by side."""
    count = max(1, int(np.ceil(2.0 * square.half / side)))
    values = square.random.random((count, count))
    # 1e-9 absorbs rounding at the edge of a box: 0.3 / 0.1 is 2.9999999999999996.
    column = np.minimum(((square.x + square.half) / side + 1e-9).astype(int), count - 1)
    row = np.minimum(((square.y + square.half) / side + 1e-9).astype(int), count - 1)
    return np.where(square.is_ring, height * values[row, column], 0.0)


def _stepping_stones(square: _Square, side: float, gap: float, depth: float) -> Column:
    """Stones of one height, with gaps between them."""
    pitch = side + gap
    on_stone = np.ones(square.x.shape, bool)
    for place in (square.x, square.y):
        # 1e-9: the edge of a stone is part of it, in spite of rounding.
        on_stone &= np.abs((place + pitch / 2) % pitch - pitch / 2) <= side / 2 + 1e-9
    return np.where(square.is_ring & ~on_stone, -depth, 0.0)


def _gaps(square: _Square, width: float, spacing: float, depth: float) -> Column:
    """Trenches around the platform, one after the other."""
    out = square.distance - square.platform
    # 1e-9: the near edge of a trench is ground, the far edge is part of the trench.
    in_gap = (out - 1e-9) % (spacing + width) >= spacing
    return np.where(square.is_ring & in_gap, -depth, 0.0)


_SHAPES: Mapping[str, Callable[..., Column]] = {
    "slope": _slope,
    "stairs": _stairs,
    "waves": _waves,
    "rough": _rough,
    "blocks": _blocks,
    "stepping_stones": _stepping_stones,
    "gaps": _gaps,
}


def tile_heights(tiles: Tiles, kind: int, level: int) -> Column:
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
    return _SHAPES[tile.kind](
        square, **{name: low + (high - low) * share for name, low, high in tile.measures}
    )


def tile_terrain_heights(tiles: Tiles) -> Column:
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


# Terrain

Height = Callable[[float, float], float]
"""The height (m) of the ground at x, y (m), which are numbers; beyond the terrain, the height of its nearest
edge."""
Heights = Callable[["Column", "Column"], "Column"]
"""The same for columns, to the bit; NaN where a coordinate is NaN."""

# g (1 - g) is largest at g = exp(-r^2 / 2) = 1/2, with r in widths of the bell.
RIM_RADIUS_PER_SIGMA = sqrt(2.0 * log(2.0))
"""The radius of a pit's rim over the width of its bell."""
_PIT_CELLS = 200
"""Cells along either side of a pit."""
_PIT_WIDTH = 0.135
"""The width of the bell, as a share of the side."""
_LUMPS = 20
"""The number of lumps of the noise along either side."""
_MAX_HEIGHT_M = 1e4
"""Higher ground is a mistake, and engines lose their digits."""
_MIN_AREA_M2 = 1e-12
"""Twice the area, seen from above, of the smallest triangle that is not vertical."""
_MIN_VOLUME_M3 = 1e-15
"""A mesh with less volume has none, but for rounding."""
_EDGE_TOLERANCE = 1e-9
"""By how much barycentric coordinates of a point in a triangle may miss 0 .. 1, so that no point between two
triangles is in neither."""
_MAX_DISTANCE_M = 1e6
"""Farther points, also infinite ones, have the height of such a point."""


@dataclass(frozen=True, eq=False)
class HeightGrid:
    """Heights (m) over a rectangle around the origin: `heights[row, column]`, rows along y and columns along
    x, both upwards.

    Each cell is two triangles, which meet along a diagonal. A falling diagonal joins the corner at the
    greater x and the one at the greater y, a rising one the other two.
    """

    heights: NDArray[np.float64]
    size: tuple[float, float]
    diagonal: Diagonal = "falling"

    @property
    def cell(self) -> tuple[float, float]:
        """Along x and y, m."""
        rows, columns = self.heights.shape
        return self.size[0] / (columns - 1), self.size[1] / (rows - 1)

    def triangles(self) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Return the vertices (n, 3) in m, and for each triangle the numbers of its vertices,
        counter-clockwise from above; the diagonals are falling."""
        rows, columns = self.heights.shape
        x, y = np.meshgrid(
            np.linspace(-0.5, 0.5, columns) * self.size[0], np.linspace(-0.5, 0.5, rows) * self.size[1]
        )
        first = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
        lower = np.stack([first, first + 1, first + columns], axis=1)
        upper = np.stack([first + 1, first + columns + 1, first + columns], axis=1)
        return np.stack([x.ravel(), y.ravel(), self.heights.ravel()], axis=1), np.concatenate([lower, upper])

    def coarsened(self, max_cells: int) -> HeightGrid:
        """Return the same surface in at most `max_cells` cells along either side, interpolated linearly."""
        heights = self.heights
        for _ in range(2):  # along y, then along x
            at = np.linspace(0.0, len(heights) - 1, min(len(heights) - 1, max_cells) + 1)
            first = np.minimum(at.astype(int), len(heights) - 2)
            part = (at - first)[:, None]
            heights = (heights[first] * (1 - part) + heights[first + 1] * part).T
        return HeightGrid(heights, self.size, self.diagonal)

    def heights_function(self) -> Heights:
        """Return a function of columns, which computes the same as `height_function`."""
        rows, columns = self.heights.shape
        z = self.heights
        (dx, dy), (half_x, half_y) = self.cell, (self.size[0] / 2, self.size[1] / 2)

        def heights_at(x: Column, y: Column) -> Column:
            # (u, v): x and y in cells, from the corner of the grid, and then from that of the cell.
            u = np.minimum(np.maximum((np.asarray(x, float) + half_x) / dx, 0.0), columns - 1.0)
            v = np.minimum(np.maximum((np.asarray(y, float) + half_y) / dy, 0.0), rows - 1.0)
            u, v = np.broadcast_arrays(u, v)
            # NaN, as of a lost world, is in no cell: converted to a whole number, it is any index.
            exists = ~(np.isnan(u) | np.isnan(v))
            u, v = np.where(exists, u, 0.0), np.where(exists, v, 0.0)
            # The edges at the greatest x and y are part of the last cells.
            column = np.minimum(u.astype(int), columns - 2)
            row = np.minimum(v.astype(int), rows - 2)
            u, v = u - column, v - row
            # Two triangles per cell, as in the engine; bilinear interpolation would differ from it.
            east, north = z[row, column + 1], z[row + 1, column]
            corner, far = z[row, column], z[row + 1, column + 1]
            if self.diagonal == "rising":
                lower = corner + u * (east - corner) + v * (far - east)
                upper = corner + v * (north - corner) + u * (far - north)
                heights = np.where(v <= u, lower, upper)
            else:
                lower = corner + u * (east - corner) + v * (north - corner)
                upper = far + (1.0 - u) * (north - far) + (1.0 - v) * (east - far)
                heights = np.where(u + v <= 1.0, lower, upper)
            return np.where(exists, heights, np.nan)

        return heights_at

    def height_function(self) -> Height:
        """Return a function of plain floats, for use in a loop."""
        rows, columns = self.heights.shape
        z = self.heights.tolist()
        is_rising = self.diagonal == "rising"
        (dx, dy), (half_x, half_y) = self.cell, (self.size[0] / 2, self.size[1] / 2)

        def height_at(x: float, y: float) -> float:
            # The same operations in the same order as in `heights_function`.
            u = min(max((x + half_x) / dx, 0.0), columns - 1.0)
            v = min(max((y + half_y) / dy, 0.0), rows - 1.0)
            column, row = min(floor(u), columns - 2), min(floor(v), rows - 2)
            u, v = u - column, v - row
            here, there = z[row], z[row + 1]
            if is_rising:
                corner = here[column]
                far = there[column + 1]
                if v <= u:
                    return float(corner + u * (here[column + 1] - corner) + v * (far - here[column + 1]))
                return float(corner + v * (there[column] - corner) + u * (far - there[column]))
            if u + v <= 1.0:
                corner = here[column]
                return float(corner + u * (here[column + 1] - corner) + v * (there[column] - corner))
            corner = there[column + 1]
            return float(
                corner + (1.0 - u) * (there[column] - corner) + (1.0 - v) * (here[column + 1] - corner)
            )

        return height_at


def height_grid(terrain_shape: TerrainShape) -> HeightGrid | None:
    """Return the heights of a relief; None for a mesh, which is not a grid.

    Raises:
        EngineError: A picture has gone or changed; a formula has no height somewhere.
    """
    match terrain_shape:
        case Pit():
            grid = _pit(terrain_shape)
        case Picture():
            grid = _picture(terrain_shape)
        case Formula():
            grid = _formula(terrain_shape)
        case Tiles():
            grid = HeightGrid(tile_terrain_heights(terrain_shape), terrain_shape.size)
        case _:
            return None
    if not np.all(np.abs(grid.heights) < _MAX_HEIGHT_M):  # false for NaN
        raise EngineError("somewhere in the terrain, the height is undefined or outside -10 km .. 10 km")
    return grid


@lru_cache(maxsize=4)
def terrain_bounds(terrain_shape: TerrainShape) -> tuple[Vector, Vector]:
    """Return the lowest and the highest coordinates (m) of a terrain; those of a COLLADA mesh are 0.

    Raises:
        EngineError: As for `height_grid`.
    """
    grid = height_grid(terrain_shape)
    if grid is None:
        assert isinstance(terrain_shape, Mesh)  # all others are grids
        return mesh_bounds(terrain_shape) or ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    x, y = (side / 2 for side in grid.size)
    return (-x, -y, float(grid.heights.min())), (x, y, float(grid.heights.max()))


def ground_height(terrain: Terrain | None, diagonal: Diagonal = "falling") -> Height:
    """Return the height of the ground, which is 0 if the ground is a plane; `diagonal` is that of the
    engine."""
    return (lambda x, y: 0.0) if terrain is None else _height_of(terrain.shape, diagonal)


def ground_heights(terrain: Terrain | None, diagonal: Diagonal = "falling") -> Heights:
    """Return the height of the ground over columns; see `ground_height`."""
    if terrain is None:
        return lambda x, y: np.where(np.isnan(x) | np.isnan(y), np.nan, 0.0)
    return _heights_of(terrain.shape, diagonal)


@lru_cache(maxsize=4)
def _height_of(terrain_shape: TerrainShape, diagonal: Diagonal) -> Height:
    """Return the height of a relief. Worlds with the same one share it: a terrain of a million heights takes
    32 MB as plain floats.
    """
    grid = height_grid(terrain_shape)
    if grid is not None:
        return replace(grid, diagonal=diagonal).height_function()
    assert isinstance(terrain_shape, Mesh)  # all others are grids
    return _mesh_height(mesh_triangles(terrain_shape))


@lru_cache(maxsize=4)
def _heights_of(terrain_shape: TerrainShape, diagonal: Diagonal) -> Heights:
    grid = height_grid(terrain_shape)
    if grid is not None:
        return replace(grid, diagonal=diagonal).heights_function()
    height = _height_of(terrain_shape, diagonal)

    def heights_at(x: Column, y: Column) -> Column:
        x, y = np.broadcast_arrays(x, y)
        return np.array([height(*place) for place in zip(x.ravel(), y.ravel(), strict=True)]).reshape(x.shape)

    return heights_at


def _pit(pit: Pit) -> HeightGrid:
    """Return the heights `height * g * (1 - g)` with a Gaussian g around the origin; 0 beyond three standard
    deviations.

    The rim is a quarter of `height` high. Noise reduces low heights by a share; it is the same in every
    world. The values are taken from a published world (Kirtas et al., AIAI 2020).
    """
    share = np.linspace(-0.5, 0.5, _PIT_CELLS + 1)
    squared = (share[:, None] ** 2 + share[None, :] ** 2) / _PIT_WIDTH**2
    bell = np.exp(-squared / 2)
    heights = pit.height * bell * (1 - bell) * (1 - pit.noise + pit.noise * _value_noise())
    side = pit.radius / (RIM_RADIUS_PER_SIGMA * _PIT_WIDTH)
    return HeightGrid(np.where(squared < 9.0, heights, 0.0), (side, side))


def _value_noise() -> NDArray[np.float64]:
    """Return fixed noise from 0 to 1 over the grid of a pit: random values a twentieth of the side apart,
    smoothly joined."""
    # The bit generator is named because that of `default_rng` may change with NumPy.
    values = np.random.Generator(np.random.PCG64(0)).random((_LUMPS + 1, _LUMPS + 1))
    at = np.arange(_PIT_CELLS + 1) * _LUMPS / _PIT_CELLS
    first = np.minimum(at.astype(int), _LUMPS - 1)
    part = at - first
    # Smoothstep: its slope is 0 at both ends, so the surface has no creases at the lumps.
    part = part * part * (3 - 2 * part)
    along = values[:, first] * (1 - part) + values[:, first + 1] * part
    return np.asarray(along[first] * (1 - part)[:, None] + along[first + 1] * part[:, None])


def _picture(picture: Picture) -> HeightGrid:
    try:
        path = Path(picture.path)
        # A pipe would block, and a device such as /dev/zero has no end.
        data = path.read_bytes() if path.is_file() and path.stat().st_size <= MAX_PICTURE_BYTES else b""
    except (OSError, ValueError) as error:
        raise EngineError(f"picture {picture.path} cannot be read") from error
    if sha256(data).hexdigest() != picture.digest:
        raise EngineError(f"picture {picture.path} has changed since the scenario was compiled")
    wrong = picture_problem(data)
    if wrong is not None:
        raise EngineError(f"picture {picture.path} cannot be read: {wrong}")
    bits = data[24]  # bits of a pixel, by the header
    # The rows of a picture go down, the rows of a grid along y.
    return HeightGrid(picture_pixels(data)[::-1] * (picture.height / (2**bits - 1)), picture.size)


def picture_pixels(data: bytes) -> NDArray[np.integer]:
    """Return the pixels of a PNG picture without fault, shape (height, width), rows from the top.

    Raises:
        EngineError: A chunk of the file is damaged.
    """
    from PIL import Image

    try:
        with Image.open(BytesIO(data), formats=("PNG",)) as image:
            return np.asarray(image)
    except (OSError, ValueError, SyntaxError) as error:  # PIL raises SyntaxError for a wrong checksum
        raise EngineError(f"the picture cannot be read: {error}") from error


def _formula(formula: Formula) -> HeightGrid:
    """Return the heights of a formula, with the resolution of a pit along the longer side, and with square
    cells as far as possible."""
    columns, rows = (max(2, round(_PIT_CELLS * side / max(formula.size))) + 1 for side in formula.size)
    x, y = np.meshgrid(
        np.linspace(-0.5, 0.5, columns) * formula.size[0], np.linspace(-0.5, 0.5, rows) * formula.size[1]
    )
    try:
        heights = evaluate(formula.heights, {Name("x"): x, Name("y"): y})
    except DeepbotsError as error:
        raise EngineError(f"the heights of the terrain cannot be computed: {error}") from error
    # A formula without x and y is one number; `broadcast_to` gives a read-only view.
    return HeightGrid(np.broadcast_to(np.asarray(heights, np.float64), x.shape).copy(), formula.size)


def _mesh_height(corners: NDArray[np.float64]) -> Height:
    """Return the highest point of any triangle above or below a place; where there is none, that of the
    nearest edge of a triangle."""
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = (corners[:, corner].T for corner in range(3))
    # Twice the area of each triangle, seen from above.
    area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
    is_level = np.abs(area) > _MIN_AREA_M2
    # Avoids a division by zero for vertical triangles, which `is_level` excludes below.
    area = np.where(is_level, area, 1.0)
    beyond = _edge_height(corners[is_level])

    def height_at(x: float, y: float) -> float:
        x, y = min(max(x, -_MAX_DISTANCE_M), _MAX_DISTANCE_M), min(max(y, -_MAX_DISTANCE_M), _MAX_DISTANCE_M)
        # Barycentric coordinates of (x, y) in each triangle, seen from above: 1 - b - c, b, c.
        b = ((x - ax) * (cy - ay) - (cx - ax) * (y - ay)) / area
        c = ((bx - ax) * (y - ay) - (x - ax) * (by - ay)) / area
        is_inside = (
            is_level & (b >= -_EDGE_TOLERANCE) & (c >= -_EDGE_TOLERANCE) & (b + c <= 1 + _EDGE_TOLERANCE)
        )
        # `initial` is the result for a mesh without triangles, where `np.max` raises ValueError.
        top = np.max(np.where(is_inside, az + b * (bz - az) + c * (cz - az), -inf), initial=-inf)
        return float(top) if top > -inf else beyond(x, y)

    return height_at


def _edge_height(corners: NDArray[np.float64]) -> Height:
    """Return the height of the edge that is nearest to a place, seen from above; of several, the highest."""
    starts = corners.reshape(-1, 3)
    along = np.roll(corners, -1, axis=1).reshape(-1, 3) - starts
    squared_lengths = along[:, 0] ** 2 + along[:, 1] ** 2

    def height_at(x: float, y: float) -> float:
        away = np.array([x, y]) - starts[:, :2]
        share = np.clip((away * along[:, :2]).sum(axis=1) / squared_lengths, 0.0, 1.0)
        distances = np.hypot(*(away - share[:, None] * along[:, :2]).T)
        nearest = distances <= distances.min(initial=inf) + 1e-9
        heights = (starts[:, 2] + share * along[:, 2])[nearest]
        # 0 * (x + y) is NaN for a place that is NaN.
        return float(heights.max()) if len(heights) else 0.0 * (x + y)

    return height_at


# Meshes


def mesh_triangles(mesh: Mesh) -> NDArray[np.float64]:
    """Return the corners of a mesh, scaled: shape (count, 3 corners, 3 coordinates), in m.

    Raises:
        EngineError: The file has gone or changed, or holds no triangles.
    """
    try:
        placed = placed_triangles(Path(mesh.path).suffix.lower(), read_verified(mesh))
    except FaultyMeshError as error:
        raise EngineError(f"mesh {mesh.path} cannot be read") from error
    corners = [np.array(part.moved(rows)).reshape(-1, 3)[np.array(part.corners)] for part, rows in placed]
    return np.asarray(np.concatenate(corners).reshape(-1, 3, 3) * np.asarray(mesh.scale), np.float64)


def with_masses(model: RobotModel) -> RobotModel:
    """Return the model with mass, center and inertia of each link that has a density, from the volume of its
    mesh.

    Raises:
        EngineError: A mesh has gone or changed, or encloses no volume.
    """
    for link in model.links:
        if link.density is not None:
            model = with_link(model, replace(link, inertial=_inertial(link, link.density), density=None))
    return model


def _inertial(link: Link, density: float) -> Inertial:
    """Return the inertial of a link whose shapes are homogeneous, in axes parallel to those of the link;
    `density` in kg/m^3. Where shapes overlap, both count."""
    parts = []
    for piece in link.collisions or link.visuals:
        own = volume(piece.shape)
        if own is None:
            parts.append(_mesh_inertial(link, piece, density))
        else:
            parts.append(homogeneous_inertial(piece.shape, density * own, piece.origin) or Inertial(0.0))
    return combined(parts)


def _mesh_inertial(link: Link, piece: Geometry, density: float) -> Inertial:
    """Return the inertial of a mesh; the convex hull replaces one that is not closed.

    Raises:
        EngineError: The mesh has gone or changed, or encloses no volume.
    """
    import trimesh
    from scipy.spatial import QhullError

    assert isinstance(piece.shape, Mesh)
    corners = mesh_triangles(piece.shape).reshape(-1, 3)
    corners = corners @ np.array(rotation_matrix(piece.origin.rpy)).T + piece.origin.xyz
    solid = trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3))
    with np.errstate(divide="ignore", invalid="ignore"):  # of a flat mesh
        if not solid.is_watertight or not solid.is_winding_consistent:
            with suppress(QhullError, ValueError):
                solid = solid.convex_hull
        has_volume = solid.is_watertight and abs(solid.volume) > _MIN_VOLUME_M3
    if not has_volume:
        raise EngineError(
            f"the mesh of link '{link.name}' encloses no volume, so its mass cannot be computed from the"
            " density; write its `mass` instead"
        )
    if solid.volume < 0.0:  # every face is inside out
        solid.invert()
    solid.density = density
    (ixx, ixy, ixz), (_, iyy, iyz), (_, _, izz) = solid.moment_inertia.tolist()
    x, y, z = solid.center_mass.tolist()
    return Inertial(float(solid.mass), Pose((x, y, z)), ixx=ixx, ixy=ixy, ixz=ixz, iyy=iyy, iyz=iyz, izz=izz)
