"""The world: time, gravity, ground, arena, walls, terrain, painted lines; poses, and bodies other than
robots. `terrains.py` and `objects.py` are imported for a file that has a terrain or an object."""

from typing import Annotated, ClassVar

from pydantic import Field

from deepbots_cli.engine_kinds import ENGINES
from deepbots_cli.scenario.base import ImportedModels, KeyCount, Kinds, Many, Section, Size
from deepbots_cli.scenario.fields import (
    Bool,
    Color,
    PlainText,
    Scalar,
    SharedName,
    Word,
)
from deepbots_cli.scenario.quantities import (
    Area,
    Point,
    Quantity,
    RandomizableAngle,
    RandomizableCoordinate,
    RandomizableCount,
    RandomizableFactor,
    RandomizableShare,
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
    terrain: (
        Annotated[Terrain, Kinds("type", ImportedModels("deepbots_cli.scenario.terrains:TERRAINS"))] | None
    ) = None
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


class PlacedBody(Section):
    """Pose and number of copies of an object."""

    pose: Pose = Field(default_factory=Pose)
    """Start pose of the object, unless `reset` places it."""
    count: RandomizableCount | None = None
    """Number of copies. The name then refers to the group of all copies, also of one. Default: the object
    alone, without a group."""


_ARTICULATED = (
    "move this body to `robots`: every body with a robot file is a robot, even without sensors and actuators"
)
AnyObject = Annotated[
    PlacedBody,
    Kinds(
        "shape",
        ImportedModels("deepbots_cli.scenario.objects:OBJECTS"),
        models_by_key=ImportedModels("deepbots_cli.scenario.objects:OBJECTS_BY_KEY"),
        help_by_key={"urdf": _ARTICULATED},
    ),
]
