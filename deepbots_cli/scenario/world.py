"""The world: time, gravity, ground, arena, walls, terrain, painted lines; poses, and bodies other than
robots."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from deepbots_cli.engine_kinds import ENGINES
from deepbots_cli.scenario.base import KeyCount, Kinds, Many, Section, Size
from deepbots_cli.scenario.fields import (
    Bool,
    Color,
    FilePath,
    LocalName,
    MeshFile,
    PlainText,
    Scalar,
    SharedName,
    Word,
)
from deepbots_cli.scenario.quantities import (
    Area,
    Expression,
    Point,
    Quantity,
    RandomizableAngle,
    RandomizableCoordinate,
    RandomizableCount,
    RandomizableFactor,
    RandomizableShare,
    Range,
    Scale,
    Share,
    Thickness,
    Timestep,
    WholeNumber,
)


class Ground(Section):
    """The ground: the plane z = 0."""

    friction: RandomizableFactor = 1.0
    """Coulomb's coefficient of friction."""
    restitution: RandomizableShare = 0
    """Fraction of the speed that remains after a bounce, 0 to 1."""
    color: Color | None = None
    """Color in images: a word, or `'#rrggbb'`."""


class Arena(Section):
    """A rectangle of walls around the origin."""

    size: Area
    """Inner size along x and y, such as `1 1 m`."""
    wall_height: Thickness = "0.1 m"
    """Height of the walls, m."""
    wall_thickness: Thickness = "0.01 m"
    """Thickness of the walls, m."""
    friction: RandomizableFactor = 1.0
    """Friction of the walls."""
    color: Color | None = None
    """Color of the walls."""


class Wall(Section):
    """A wall along a polyline."""

    points: Annotated[Many[Point], Size(2, "point")]
    """The corners in the ground plane, such as `[0 0 m, 1 0 m]`."""
    closed: Bool = False
    """Whether the last corner is joined to the first."""
    height: Thickness = "0.1 m"
    """Height, m."""
    thickness: Thickness = "0.01 m"
    """Thickness, m."""
    friction: RandomizableFactor = 1.0
    """Friction of the wall."""
    color: Color | None = None
    """Color of the wall."""


class Line(Section):
    """A line painted on the ground, without collisions."""

    points: Annotated[Many[Point], Size(2, "point")]
    """The points of the line in the ground plane."""
    closed: Bool = False
    """Whether the last point is joined to the first."""
    width: Thickness
    """Width of the stroke, m."""
    reflectance: Share = 0
    """Reflectance of the paint, 0 (black) to 1 (white)."""
    color: Color = "black"
    """Color in images."""


class Terrain(Section):
    """Ground that is not flat."""

    type: PlainText
    """Kind of terrain."""
    friction: RandomizableFactor = 1.0
    """Friction of the ground."""
    color: Color | None = None
    """Color of the ground."""


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


class World(Section):
    """The simulated world."""

    key_rules: ClassVar[tuple[KeyCount, ...]] = (KeyCount(("ground", "terrain")),)

    timestep: Timestep
    """Duration of one control step, such as `32 ms`. Robots read their sensors and act once in each
    timestep."""
    substeps: Annotated[int, WholeNumber(1, 10_000)] = 1
    """Number of physics steps in one timestep."""
    engine: Annotated[str, Word(ENGINES)] | None = None
    """Physics engine; by default `pybullet`. `--engine` on the command line overrides it."""
    gravity: Annotated[Scalar, Quantity("acceleration", 3, "episode", example_text="0 0 -9.81 m/s^2")] = (
        "0 0 -9.81 m/s^2"
    )
    """Gravity in the world frame, m/s^2."""
    ground: Ground = Field(default_factory=Ground)
    """The plane on which bodies stand."""
    arena: Arena | None = None
    """A rectangle of walls around the origin."""
    walls: dict[SharedName, Wall] = {}
    """Further walls, each under a name that you choose."""
    terrain: Annotated[Terrain, Kinds("type", TERRAINS)] | None = None
    """Ground that is not flat."""
    lines: dict[SharedName, Line] = {}
    """Lines painted on the ground, each under a name that you choose."""
    light: RandomizableFactor = 1.0
    """Brightness of the light in images; 1 is normal."""


# Poses

_POSE_KEY_RULES = tuple(
    KeyCount((whole, part))
    for whole, parts in (("xyz", "xyz"), ("rpy", ("roll", "pitch", "yaw")))
    for part in parts
)

Coordinate = Annotated[Scalar, Quantity("length")]
Angle = Annotated[Scalar, Quantity("angle")]


class SensorFrame(Section):
    """A pose in the frame of a link."""

    key_rules: ClassVar[tuple[KeyCount, ...]] = _POSE_KEY_RULES

    x: Coordinate = 0
    """Position along x of the link, m."""
    y: Coordinate = 0
    """Position along y of the link, m."""
    z: Coordinate = 0
    """Position along z of the link, m."""
    xyz: Annotated[Scalar, Quantity("length", components=3)] | None = None
    """All three coordinates at once, such as `30 0 40 mm`."""
    roll: Angle = 0
    """Rotation about x."""
    pitch: Angle = 0
    """Rotation about y."""
    yaw: Angle = 0
    """Rotation about z; left is positive."""
    rpy: Annotated[Scalar, Quantity("angle", components=3)] | None = None
    """Roll, pitch and yaw at once, such as `0 0 90 deg`."""


class Pose(Section):
    """A pose in the world, which may be drawn in every episode."""

    key_rules: ClassVar[tuple[KeyCount, ...]] = _POSE_KEY_RULES

    x: RandomizableCoordinate | None = None
    """Position along x of the world, m."""
    y: RandomizableCoordinate | None = None
    """Position along y of the world, m."""
    z: RandomizableCoordinate | None = None
    """Height above the ground or the terrain, m."""
    xyz: Annotated[Scalar, Quantity("length", 3, "episode")] | None = None
    """All three coordinates at once."""
    roll: RandomizableAngle | None = None
    """Rotation about x; `any` draws it from the full circle."""
    pitch: RandomizableAngle | None = None
    """Rotation about y; `any` draws it from the full circle."""
    yaw: RandomizableAngle | None = None
    """Rotation about z; `any` draws it from the full circle."""
    rpy: Annotated[Scalar, Quantity("angle", 3, "episode")] | None = None
    """Roll, pitch and yaw at once."""


# Bodies


class Material(Section):
    """Material of a body; a variant of `one_of` overrides it."""

    mass: Annotated[Scalar, Quantity("mass", known="episode", minimum=0, exclusive=True)] | None = None
    """Mass, kg. By default, the mass of a body of this shape with the density of water. A mesh that can move
    requires a mass."""
    color: Color | None = None
    """Color: a word, `'#rrggbb'`, or `choice(red | green)`."""
    friction: RandomizableFactor | None = None
    """Coulomb's coefficient of friction."""
    spinning_friction: RandomizableFactor | None = None
    """Friction against spinning on the spot, in m, written as a plain number. Times the normal force, and the
    `friction` of the other body, it is the largest torque."""
    rolling_friction: RandomizableFactor | None = None
    """Friction against rolling, in m, written as a plain number. Times the normal force, and the `friction`
    of the other body, it is the largest torque."""
    restitution: RandomizableShare | None = None
    """Fraction of the speed that remains after a bounce, 0 to 1."""
    fixed: Bool | None = None
    """Whether the body is fixed to the world; by default `false`."""
    solid: Bool | None = None
    """Whether the body collides; by default `true`. `false` makes a marker without collisions."""


class ShapedBody(Material):
    """A body of one shape."""

    shape: PlainText
    """The shape of the body."""


class Box(ShapedBody):
    """A box."""

    shape: Literal["box"]
    size: Annotated[Scalar, Quantity("length", components=3, minimum=1e-4)]
    """Lengths along x, y and z, such as `10 10 10 cm`."""


class Sphere(ShapedBody):
    """A ball."""

    shape: Literal["sphere"]
    radius: Thickness
    """Radius, m."""


class Cylinder(ShapedBody):
    """A cylinder along z."""

    shape: Literal["cylinder"]
    radius: Thickness
    """Radius, m."""
    height: Thickness
    """Height, m."""


class Capsule(ShapedBody):
    """A cylinder along z with a hemisphere on each end."""

    shape: Literal["capsule"]
    radius: Thickness
    """Radius, m."""
    height: Thickness
    """Height of the cylinder between the hemispheres, m."""


class Mesh(ShapedBody):
    """A body from a mesh file."""

    shape: Literal["mesh"]
    file: MeshFile
    """The mesh file."""
    scale: Scale | None = None
    """Scale factors along x, y and z."""


SHAPES: dict[str, type[ShapedBody]] = {
    "box": Box,
    "sphere": Sphere,
    "cylinder": Cylinder,
    "capsule": Capsule,
    "mesh": Mesh,
}


class PlacedBody(Section):
    """Pose and number of copies of an object."""

    pose: Pose = Field(default_factory=Pose)
    """Start pose of the object, unless `reset` places it."""
    count: RandomizableCount | None = None
    """Number of copies. The name then refers to the group of all copies, also of one. Default: the object
    alone, without a group."""


class BoxObject(PlacedBody, Box):
    """A box in the world."""


class SphereObject(PlacedBody, Sphere):
    """A ball in the world."""


class CylinderObject(PlacedBody, Cylinder):
    """A cylinder in the world."""


class CapsuleObject(PlacedBody, Capsule):
    """A capsule in the world."""


class MeshObject(PlacedBody, Mesh):
    """A mesh in the world."""


class VariedObject(PlacedBody, Material):
    """Copies of different shapes, which are drawn from variants."""

    one_of: Annotated[dict[LocalName, Annotated[ShapedBody, Kinds("shape", SHAPES)]], Size(1, "variant")]
    """Variants, each under a name that you choose; deepbots draws one of them for each copy."""


OBJECTS: dict[str, type[PlacedBody]] = {
    "box": BoxObject,
    "sphere": SphereObject,
    "cylinder": CylinderObject,
    "capsule": CapsuleObject,
    "mesh": MeshObject,
}
_ARTICULATED = (
    "move this body to `robots`: every body with a robot file is a robot, even without sensors and actuators"
)
AnyObject = Annotated[
    PlacedBody,
    Kinds("shape", OBJECTS, models_by_key={"one_of": VariedObject}, help_by_key={"urdf": _ARTICULATED}),
]
