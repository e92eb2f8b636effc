"""Kinds of terrain, and of its tiles."""

from typing import Annotated, Literal

from deepbots_cli.scenario.base import Kinds, Section, Size
from deepbots_cli.scenario.fields import Bool, FilePath, LocalName, MeshFile, PlainText, Scalar
from deepbots_cli.scenario.quantities import Area, Expression, Range, Scale, Share, Thickness, WholeNumber
from deepbots_cli.scenario.world import Terrain


class Pit(Terrain):
    """A bowl around the origin."""

    type: Literal["pit"]
    height: Thickness
    """Height factor, m: without `noise`, the rim is a quarter as high as this above the bottom."""
    radius: Thickness | None = None
    """Radius of the rim, m; by default 3.18 m."""
    noise: Share = 0
    """Unevenness, 0 to 1: random bumps lower each point by at most this fraction of its height. The bumps are
    the same in every world."""


class Heightfield(Terrain):
    """Heights from a grayscale image."""

    type: Literal["heightfield"]
    file: Annotated[str, FilePath("picture")]
    """The image; black is low, white is high."""
    size: Area
    """Size along x and y, m."""
    height: Thickness
    """Height of white above black, m."""


class Formula(Terrain):
    """Heights from an expression."""

    type: Literal["formula"]
    heights: Annotated[Scalar, Expression("field", boolean=False)]
    """Height at the point `x`, `y` (lengths), such as `5 cm * sin(x / m * 90 deg)`."""
    size: Area
    """Size along x and y, m."""


class Tile(Section):
    """A kind of tile. Measures are ranges: the first value is that of the lowest level, the second that of
    the highest one."""

    type: PlainText
    """Kind of tile."""


class Slope(Tile):
    """A pyramid of four slopes around the platform."""

    type: Literal["slope"]
    angle: Annotated[str, Range("angle")]
    """Angle of the slopes."""
    inverted: Bool = False
    """Whether the platform is the lowest place."""


class Stairs(Tile):
    """Stairs on all four sides of the platform."""

    type: Literal["stairs"]
    height: Annotated[str, Range("length")]
    """Height of a step."""
    tread: Thickness = "30 cm"
    """Depth of a step."""
    inverted: Bool = False
    """Whether the platform is the lowest place."""


class Waves(Tile):
    """Waves along x and y."""

    type: Literal["waves"]
    height: Annotated[str, Range("length")]
    """Height of the crests above the troughs."""
    length: Thickness = "2 m"
    """Distance between two crests."""


class Rough(Tile):
    """Random heights."""

    type: Literal["rough"]
    height: Annotated[str, Range("length")]
    """Height of the highest above the lowest places."""
    grain: Thickness = "20 cm"
    """Distance between two random heights."""


class Blocks(Tile):
    """Boxes of random heights side by side."""

    type: Literal["blocks"]
    height: Annotated[str, Range("length")]
    """Largest height of a box."""
    side: Thickness = "50 cm"
    """Side of a box."""


class SteppingStones(Tile):
    """Stones of one height, with gaps between them."""

    type: Literal["stepping_stones"]
    side: Annotated[str, Range("length")]
    """Side of a stone."""
    gap: Annotated[str, Range("length")]
    """Distance between two stones."""
    depth: Thickness = "1 m"
    """Depth of the gaps."""


class Gaps(Tile):
    """Trenches around the platform."""

    type: Literal["gaps"]
    width: Annotated[str, Range("length")]
    """Width of a trench."""
    spacing: Thickness = "1 m"
    """Width of the ground between two trenches."""
    depth: Thickness = "1 m"
    """Depth of the trenches."""


TILES: dict[str, type[Tile]] = {
    "slope": Slope,
    "stairs": Stairs,
    "waves": Waves,
    "rough": Rough,
    "blocks": Blocks,
    "stepping_stones": SteppingStones,
    "gaps": Gaps,
}


class TileTerrain(Terrain):
    """Square tiles side by side: kinds along x in the order of the file, levels along y from easy to hard."""

    type: Literal["tiles"]
    tiles: Annotated[dict[LocalName, Annotated[Tile, Kinds("type", TILES)]], Size(1, "tile")]
    """Kinds of tiles by name."""
    levels: Annotated[int, WholeNumber(1, 64)] = 10
    """Number of levels."""
    side: Thickness = "8 m"
    """Side of a tile."""
    platform: Thickness = "1.5 m"
    """Side of the flat middle of a tile."""
    border: Thickness = "2 m"
    """Width of the flat border."""
    cell: Thickness = "10 cm"
    """Distance between two heights."""
    seed: Annotated[int, WholeNumber(0, 2_147_483_647)] = 0
    """Seed of random heights."""


class MeshTerrain(Terrain):
    """Ground from a mesh file."""

    type: Literal["mesh"]
    file: MeshFile
    """The mesh file."""
    scale: Scale | None = None
    """Scale factors along x, y and z."""


TERRAINS: dict[str, type[Terrain]] = {
    "pit": Pit,
    "heightfield": Heightfield,
    "formula": Formula,
    "tiles": TileTerrain,
    "mesh": MeshTerrain,
}
