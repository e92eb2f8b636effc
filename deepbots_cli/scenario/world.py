"""The world without its bodies: time, gravity, ground, arena, terrain, painted lines."""

from __future__ import annotations

from typing import Annotated, ClassVar

from deepbots_cli.scenario.fields import Expression, FilePath, Quantity, Scalar
from deepbots_cli.scenario.part import Keys, Kinds, Many, Part, Size, field
from deepbots_cli.scenario.plain import Count
from deepbots_cli.scenario.quantity import (
    Area,
    DrawnFactor,
    DrawnShare,
    MeshFile,
    OnOff,
    Paint,
    Point,
    Prose,
    Share,
    SharedName,
    Thickness,
    Tick,
)


class Ground(Part):
    """The plane z = 0."""

    friction: DrawnFactor = field(default=1.0, description="Coulomb's coefficient of friction.")
    restitution: DrawnShare = field(default=0, description="Share of the speed that a bounce keeps, 0 to 1.")
    colour: Paint | None = field(default=None, description="Colour in pictures: a word, or `'#rrggbb'`.")


class Arena(Part):
    """A rectangle of walls around the origin."""

    size: Area = field(description="Inner size along x and y, such as `1 1 m`.")
    wall_height: Thickness = field(default="0.1 m", description="Height of the walls, m.")
    wall_thickness: Thickness = field(default="0.01 m", description="Thickness of the walls, m.")
    friction: DrawnFactor = field(default=1.0, description="Friction of the walls.")
    colour: Paint | None = field(default=None, description="Colour of the walls.")


class Wall(Part):
    """A wall along a line of straight pieces."""

    through: Annotated[Many[Point], Size(2, "point")] = field(description="The corners in the ground plane, such as `[0 0 m, 1 0 m]`.")
    closed: OnOff = field(default=False, description="Whether the last corner is joined to the first.")
    height: Thickness = field(default="0.1 m", description="Height, m.")
    thickness: Thickness = field(default="0.01 m", description="Thickness, m.")
    friction: DrawnFactor = field(default=1.0, description="Friction of its sides.")
    colour: Paint | None = field(default=None, description="Colour of the wall.")


class Line(Part):
    """A line painted on the ground: no body, nothing to bump into."""

    through: Annotated[Many[Point], Size(2, "point")] = field(description="The points of the line in the ground plane.")
    closed: OnOff = field(default=False, description="Whether the last point is joined to the first.")
    width: Thickness = field(description="Width of the stroke, m.")
    reflectance: Share = field(default=0, description="Light that the paint throws back, 0 (black) to 1 (white).")
    colour: Paint = field(default="black", description="Colour in pictures.")


class Terrain(Part):
    """Ground that is not flat; heights count from z = 0."""

    type: Prose = field(description="What gives the ground its shape.")
    friction: DrawnFactor = field(default=1.0, description="Friction of the ground.")
    colour: Paint | None = field(default=None, description="Colour of the ground.")


class Pit(Terrain):
    """A bowl around the origin."""

    height: Thickness = field(description="Four times the height of the rim above the bottom, m.")
    radius: Thickness | None = field(default=None, description="Radius of the rim, m; 3.18 m unless given.")
    noise: Share = field(default=0, description="Share of the height that lumps in the ground take away; they are the same in every world.")


class Heightfield(Terrain):
    """Heights from a grey picture."""

    file: Annotated[str, FilePath("picture")] = field(description="The picture; black is low, white is high.")
    size: Area = field(description="Size along x and y, m.")
    height: Thickness = field(description="Height of white above black, m.")


class Formula(Terrain):
    """Heights as an expression."""

    heights: Annotated[Scalar, Expression("field", boolean=False)] = field(
        description="Height at the place `x`, `y` (lengths), such as `5 cm * sin(x / m * 90 deg)`."
    )
    size: Area = field(description="Size along x and y, m.")


class MeshTerrain(Terrain):
    """Ground from a mesh file."""

    file: MeshFile = field(description="The mesh.")
    scale: Annotated[Scalar, Quantity("number", components=3)] | None = field(default=None, description="Factors along x, y and z.")


TERRAINS: dict[str, type[Terrain]] = {"pit": Pit, "heightfield": Heightfield, "formula": Formula, "mesh": MeshTerrain}


class World(Part):
    """Time and place of the simulation."""

    needs: ClassVar[tuple[Keys, ...]] = (Keys(("ground", "terrain")),)

    timestep: Tick = field(description="One control tick: robots sense and act this often, such as `32 ms`.")
    substeps: Annotated[int, Count(maximum=10_000)] = field(default=1, description="Physics steps in one control tick.")
    gravity: Annotated[Scalar, Quantity("acceleration", 3, "episode", like="0 0 -9.81 m/s^2")] = field(
        default="0 0 -9.81 m/s^2", description="Gravity in the world frame, m/s^2."
    )
    ground: Ground = field(default=Ground(), description="The plane that everything stands on.")
    arena: Arena | None = field(default=None, description="A rectangle of walls around the origin.")
    walls: dict[SharedName, Wall] = field(default={}, description="Further walls, by names of your choice.")
    terrain: Annotated[Terrain, Kinds("type", tuple(TERRAINS), TERRAINS.__getitem__)] | None = field(
        default=None, description="Ground that is not flat."
    )
    lines: dict[SharedName, Line] = field(default={}, description="Lines painted on the ground, by names of your choice.")
    light: DrawnFactor = field(default=1.0, description="Brightness of the light in pictures; 1 is ordinary.")
