"""The world, as an engine builds it."""

from __future__ import annotations

import math
from typing import Literal

from deepbots_cli.expressions.scalar import Scalar
from deepbots_cli.records import dataclass
from deepbots_cli.robots.model import Mesh, Pose, RobotModel, Shape, Vector

# Limits of one world and one reset; above them, building or resetting takes minutes.
MAX_BODIES = 500
MAX_SETTLING_STEPS = 100_000
MAX_POINTS = 10_000  # for all painted lines together

# Bodies of the world that are not objects; neither word may name one.
GROUND = "ground"
ARENA_WALLS = ("front wall", "back wall", "left wall", "right wall")

Point = tuple[float, float]
Color = tuple[float, float, float, float]
"""Red, green, blue and opacity, 0 to 1."""

WorldParameter = Literal["gravity", "light"]
LinkParameter = Literal[
    "mass",
    "center_of_mass",
    "inertia",
    "lateral_friction",
    "spinning_friction",
    "rolling_friction",
    "restitution",
    "color",
]
JointParameter = Literal["joint_damping", "joint_friction", "joint_armature"]
EngineParameter = WorldParameter | LinkParameter | JointParameter
"""A value that an engine sets anew for an episode; `port.Engine.set_parameter` gives the units."""

WALL_COLOR: Color = (0.55, 0.60, 0.68, 1.0)
"""The color of walls without a color of their own."""

TILE_MARGIN_M = 0.5
"""The width (m) over which waves and random heights fade to the height 0 of the edge and the platform of a
tile."""


def whole_timesteps(duration: float, timestep: float) -> int:
    """Return the number of timesteps that a duration takes, rounded up; both in s."""
    # In floats, 70 ms are 7.000000000000001 timesteps of 10 ms.
    return math.ceil(duration / timestep - 1e-9)


@dataclass(frozen=True)
class Ground:
    """The plane z = 0; friction is Coulomb's coefficient."""

    friction: float = 1.0
    restitution: float = 0.0
    color: Color | None = None


@dataclass(frozen=True)
class Pit:
    """A bowl around the origin, 20 m wide; `deepbots_cli.geometry` has the formula. Height and radius in m,
    noise a share."""

    height: float
    radius: float
    noise: float = 0.0


@dataclass(frozen=True)
class Picture:
    """Heights from a gray PNG, black at 0 and white at `height` (m); its first row is the farthest along y.

    The fields are the path of the file, its digest (sha256, hex), and its extent along x and y (m), around
    the origin.
    """

    path: str
    digest: str
    size: tuple[float, float]
    height: float


@dataclass(frozen=True)
class Formula:
    """Heights (m) as an expression of the names `x` and `y` (m), over `size` (m) around the origin."""

    heights: Scalar
    size: tuple[float, float]


@dataclass(frozen=True)
class Tile:
    """The kind of a tile, and its measures by name: at the lowest and at the highest level, in SI units."""

    kind: str
    measures: tuple[tuple[str, float, float], ...]


@dataclass(frozen=True)
class Tiles:
    """Square tiles around the origin: kinds along x, levels along y, with a flat `border`; lengths in m.

    `side` and `border` are multiples of `cell`, the distance between heights. `deepbots_cli.geometry` has the
    shapes.
    """

    tiles: tuple[Tile, ...]
    levels: int
    side: float
    border: float
    platform: float
    cell: float
    seed: int

    @property
    def size(self) -> tuple[float, float]:
        """Along x and y, m."""
        along_x, along_y = len(self.tiles) * self.side, self.levels * self.side
        return along_x + 2 * self.border, along_y + 2 * self.border

    def largest_height(self, kind: int) -> float:
        """Return the largest height or depth (m) that a kind of tile can have in any level."""
        tile = self.tiles[kind]
        rise = (self.side - self.platform) / 2
        largest = {name: max(low, high) for name, low, high in tile.measures}
        if tile.kind == "slope":
            return math.tan(largest["angle"]) * rise
        if tile.kind == "stairs":
            tread = min(min(low, high) for name, low, high in tile.measures if name == "tread")
            # 1e-9: a rise of a whole number of treads must not lose a step by rounding.
            return largest["height"] * math.floor(rise / tread + 1e-9)
        return largest["height" if "height" in largest else "depth"]


TerrainShape = Pit | Picture | Formula | Tiles | Mesh


@dataclass(frozen=True)
class Terrain:
    """Ground that is not flat, in place of the plane; its body has the name `GROUND`, too."""

    shape: TerrainShape
    friction: float = 1.0
    color: Color | None = None


@dataclass(frozen=True)
class Line:
    """A line painted on the ground: through points (m) in order, a stroke of `width` (m) that throws back so
    much light.

    A closed one goes on from its last point to its first.
    """

    name: str
    points: tuple[Point, ...]
    closed: bool
    width: float
    reflectance: float = 0.0
    color: Color = (0.1, 0.1, 0.1, 1.0)

    @property
    def pieces(self) -> tuple[tuple[Point, Point], ...]:
        """Its straight pieces, in order."""
        ends = (*self.points[1:], self.points[0]) if self.closed else self.points[1:]
        # The last point of an open line begins no piece.
        return tuple(zip(self.points, ends, strict=False))

    @property
    def length(self) -> float:
        """The length in m, along the middle of the stroke."""
        return sum(math.dist(*piece) for piece in self.pieces)


@dataclass(frozen=True)
class Arena:
    """A rectangle of walls around the origin: inner size along x and y in m."""

    size: tuple[float, float]
    wall_height: float
    wall_thickness: float = 0.01
    friction: float = 1.0
    color: Color | None = None


@dataclass(frozen=True)
class Variant:
    """One of the forms that a pooled body may take."""

    name: str
    shape: Shape
    mass: float = 0.0
    color: tuple[float, float, float, float] = (0.7, 0.7, 0.7, 1.0)
    friction: float = 1.0
    fixed: bool = False


@dataclass(frozen=True)
class ObjectBody:
    """A body that is not a robot. Mass in kg; a fixed one never moves, one that is not solid is only seen.

    A pooled one is absent after a reset, until it is placed. With `variants` it takes the form of one of
    them, of the first unless another is chosen, and its own shape, mass, color, friction and `fixed` mean
    nothing.
    """

    name: str
    shape: Shape
    pose: Pose = Pose()
    mass: float = 0.0
    color: Color = (0.7, 0.7, 0.7, 1.0)
    friction: float = 1.0
    fixed: bool = False
    solid: bool = True
    pooled: bool = False
    variants: tuple[Variant, ...] = ()
    spinning_friction: float = 0.0
    rolling_friction: float = 0.0
    restitution: float = 0.0

    @property
    def bodies(self) -> int:
        """The number of bodies that an engine builds for it: one for each variant."""
        return max(1, len(self.variants))


@dataclass(frozen=True)
class RobotBody:
    """A robot in the world; `pose` places the origin of its root link when nothing else does."""

    name: str
    model: RobotModel
    fixed_base: bool = False
    pose: Pose = Pose()
    self_collision: bool = False
    """Whether its links touch each other."""


@dataclass(frozen=True)
class WorldModel:
    """The input of an engine. `timestep` (s) is one control timestep, made of `substeps` engine steps.

    Where there is a terrain there is no plane. `light` is the brightness of pictures, 1 the ordinary one.
    """

    timestep: float
    substeps: int
    gravity: Vector = (0.0, 0.0, -9.81)
    ground: Ground | None = Ground()
    arena: Arena | None = None
    robots: tuple[RobotBody, ...] = ()
    objects: tuple[ObjectBody, ...] = ()
    terrain: Terrain | None = None
    lines: tuple[Line, ...] = ()
    light: float = 1.0

    def line(self, name: str) -> Line:
        return next(line for line in self.lines if line.name == name)
