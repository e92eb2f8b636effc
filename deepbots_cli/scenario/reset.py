"""How an episode begins, and what disturbs it later."""

from __future__ import annotations

from typing import Annotated, ClassVar

from deepbots_cli.scenario.fields import Expression, Quantity, Range, Reference, Scalar
from deepbots_cli.scenario.part import FORMS, Keys, Part, Size, field
from deepbots_cli.scenario.plain import Count
from deepbots_cli.scenario.pose import Pose
from deepbots_cli.scenario.quantity import BodyName, DrawnDuration, Duration, Length, Prose, Share, SharedName, Thickness, Whole

JointRate = Annotated[Scalar, Quantity("angular speed or speed", stage="episode")]
JointAngle = Annotated[Scalar, Quantity("angle or length", stage="episode")]


class JointState(Part):
    """Where a joint is at the start, and how fast."""

    position: JointAngle = field(description="Position, an angle or a length.")
    velocity: JointRate = field(default=0, description="Velocity.")


class Region(Part):
    """A rectangle in the ground plane."""

    x: Annotated[str, Range("length")] = field(description="From where to where along x, such as `-1 .. 1 m`.")
    y: Annotated[str, Range("length")] = field(description="From where to where along y.")


class Placement(Pose):
    """Where a body stands at the start: at a pose, somewhere in a region, or on a line."""

    needs: ClassVar[tuple[Keys, ...]] = (
        *Pose.needs,
        Keys(("region", "line", "xyz")),
        *(Keys((way, axis)) for way in ("region", "line", "on") for axis in ("x", "y")),
        *(Keys(("on", way)) for way in ("line", "xyz")),
    )

    region: Annotated[Region | Annotated[str, Reference("region")], FORMS] | None = field(
        default=None, description="Draws a free spot: `arena`, or a rectangle `{x: -1 .. 1 m, y: -1 .. 1 m}`."
    )
    on: Annotated[str, Reference("object")] | None = field(
        default=None,
        description="Draws a free spot on the flat top of this object, a box or a cylinder: anywhere on it, or where `region` lies on it.",
    )
    clearance: Length = field(
        default=0,
        description="Least gap to other bodies, m, and of what can move to the arena and to the edge of the top that it stands on.",
    )
    grid: Thickness | None = field(default=None, description="Draws the spot from a grid with this mesh, m.")
    line: Annotated[str, Reference("line")] | None = field(
        default=None, description="Stands at the beginning of this painted line, along it."
    )
    at_most: Whole | None = field(default=None, description="How many copies of a group are placed; the others are absent.")
    spacing: Annotated[Scalar, Quantity("length", 2)] | None = field(
        default=None, description="From each copy of a group to the next, along x and y, such as `0 1.5 m`: a row about the spot."
    )
    velocity: Annotated[Scalar, Quantity("speed", 3, "episode")] | None = field(
        default=None, description="Velocity at the start, world frame."
    )
    angular_velocity: Annotated[Scalar, Quantity("angular speed", 3, "episode")] | None = field(
        default=None, description="Angular velocity at the start, world frame."
    )


Places = dict[BodyName, Placement]


class MapLayout(Part):
    """A layout drawn in letters: each cell of the map holds one letter of the legend, or a dot for nothing."""

    marks: ClassVar[frozenset[str]] = frozenset({"map", "cell"})

    cell: Thickness = field(description="Size of a cell, m.")
    legend: Annotated[dict[Annotated[str, Reference("letter")], BodyName], Size(1, "letter")] = field(
        description="What each letter stands for: a robot, an object, or `wall`."
    )
    map: Prose = field(description="The rows of the map, cells apart by blanks; the first row is the farthest along y.")


class Reset(Part):
    """How an episode begins."""

    needs: ClassVar[tuple[Keys, ...]] = (Keys(("layout", "place")),)

    place: Places = field(default={}, description="Where robots and objects stand, in this order; later ones avoid earlier ones.")
    set: dict[Annotated[str, Reference("joints")], Annotated[JointState | JointAngle, FORMS]] = field(
        default={}, description="Positions of joints, such as `cart.pole_hinge: uniform(-1 .. 1 deg)`, or of a group."
    )
    layout: (
        Annotated[
            Annotated[dict[Annotated[str, Reference("layout")], Share], Size(1, "layout")] | Annotated[str, Reference("layout")], FORMS
        ]
        | None
    ) = field(default=None, description="The layout to use, or a mixture with shares such as `{scattered: 88 %, paper: 12 %}`.")
    layouts: dict[SharedName, Annotated[MapLayout | Places, FORMS]] = field(
        default={}, description="Arrangements by names of your choice: a place for each body, or a map in letters."
    )
    require: Annotated[str, Expression("require", boolean=True)] | None = field(
        default=None, description="What must hold at the start; otherwise everything is drawn again."
    )
    attempts: Annotated[int, Count(maximum=100_000)] = field(default=100, description="How often to draw before giving up.")
    settle: Duration = field(default="0 s", description="Simulated time for things to come to rest before the episode begins.")


class Disturbance(Part):
    """A force or a torque that acts on a body now and then."""

    needs: ClassVar[tuple[Keys, ...]] = (Keys(("force", "torque"), least=1, most=2), Keys(("every", "at"), least=1, most=2))

    body: Annotated[str, Reference("body or link")] = field(description="The robot, link or object that is pushed.")
    force: Annotated[Scalar, Quantity("force", 3, "step")] | None = field(
        default=None, description="Force in the world frame, drawn anew for each push."
    )
    torque: Annotated[Scalar, Quantity("torque", 3, "step")] | None = field(
        default=None, description="Torque in the world frame, drawn anew for each push."
    )
    every: Annotated[Scalar, Quantity("time", stage="step", minimum=0, exclusive=True)] | None = field(
        default=None,
        description="Time from the beginning of one push to that of the next, and before the first, unless `at` says when that is.",
    )
    at: DrawnDuration | None = field(default=None, description="Time of the first push, which is the only one without `every`.")
    lasts: Annotated[Scalar, Quantity("time", stage="step", minimum=0)] = field(description="How long a push acts.")
