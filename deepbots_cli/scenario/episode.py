"""The sections of an episode: how it begins, is disturbed and ends."""

from typing import Annotated, ClassVar

from deepbots_cli.scenario.agent import AgentNames, Condition
from deepbots_cli.scenario.base import FORMS, KeyCount, Section, Size
from deepbots_cli.scenario.fields.base import Scalar
from deepbots_cli.scenario.fields.names import BodyName, PlainText, Reference, SharedName
from deepbots_cli.scenario.fields.quantities import (
    Expression,
    Length,
    PositiveInt,
    Quantity,
    Range,
    Share,
    Thickness,
    WholeNumber,
)
from deepbots_cli.scenario.world import Pose


class Termination(Section):
    """Conditions that end the task: the episode is `terminated`."""

    success: dict[SharedName, Condition] = {}
    """Conditions under which the agent has succeeded, each under a name that you choose."""
    failure: dict[SharedName, Condition] = {}
    """Conditions under which the agent has failed, each under a name that you choose. Failure has precedence
    over success."""


MaxSteps = Annotated[Scalar, Quantity("number", minimum=1, whole=True)]
MaxTime = Annotated[Scalar, Quantity("time", minimum=0, exclusive=True)]


class StepLimit(Section):
    """A number of steps at which an agent has succeeded."""

    limit: MaxSteps
    """Maximum number of steps of the agent."""
    success: AgentNames
    """The agents that have then succeeded: names, or `all`. With one agent: `all`."""


class TimeLimit(Section):
    """A time at which an agent has succeeded."""

    limit: MaxTime
    """Maximum simulated time."""
    success: AgentNames
    """The agents that have then succeeded: names, or `all`. With one agent: `all`."""


class Truncation(Section):
    """Limits that are not part of the task: the episode is `truncated`."""

    key_rules: ClassVar[tuple[KeyCount, ...]] = (KeyCount(("max_steps", "max_time"), min=1, max=2),)

    max_steps: Annotated[StepLimit | MaxSteps, FORMS] | None = None
    """Maximum number of steps of the agent; `{limit: 200, success: all}` is also a success of agents."""
    max_time: Annotated[TimeLimit | MaxTime, FORMS] | None = None
    """Maximum simulated time, such as `60 s`; `{limit: 60 s, success: all}` is also a success of agents."""

    @property
    def success(self) -> tuple[str, ...]:
        """The limits that are a success."""
        limits = {"max_steps": self.max_steps, "max_time": self.max_time}
        return tuple(name for name, limit in limits.items() if isinstance(limit, StepLimit | TimeLimit))


JointRate = Annotated[Scalar, Quantity("angular speed or speed", known="episode")]
JointAngle = Annotated[Scalar, Quantity("angle or length", known="episode")]


class JointState(Section):
    """Position and velocity of a joint at the start."""

    position: JointAngle
    """Position of the joint: an angle or a length."""
    velocity: JointRate = 0
    """Velocity of the joint, rad/s or m/s."""


class Region(Section):
    """A rectangle in the ground plane."""

    x: Annotated[str, Range("length")]
    """Range along x, such as `-1 .. 1 m`."""
    y: Annotated[str, Range("length")]
    """Range along y."""


class Placement(Pose):
    """Start pose of a body: given, drawn from a region, or at the beginning of a line."""

    key_rules: ClassVar[tuple[KeyCount, ...]] = (
        *Pose.key_rules,
        KeyCount(("region", "line", "xyz")),
        *(KeyCount((key, axis)) for key in ("region", "line", "on") for axis in ("x", "y")),
        *(KeyCount(("on", key)) for key in ("line", "xyz")),
    )

    region: Annotated[Region | Annotated[str, Reference("region")], FORMS] | None = None
    """Region in which deepbots draws a free position: `arena`, or a rectangle `{x: -1 .. 1 m, y: -1 .. 1
    m}`."""
    on: Annotated[str, Reference("object")] | None = None
    """A box or a cylinder on whose flat top deepbots draws a free position: on the whole top, or on its part
    within `region`."""
    clearance: Length = 0
    """Minimum distance to other bodies, m. For a movable body it is also the minimum distance to the arena
    walls and to the edge of the surface below it."""
    grid: Thickness | None = None
    """Spacing, m, of a grid from which deepbots draws the position."""
    line: Annotated[str, Reference("line")] | None = None
    """A painted line: the body starts at its beginning, heading along the line."""
    at_most: PositiveInt | None = None
    """Maximum number of copies of a group that are placed; the others are absent."""
    spacing: Annotated[Scalar, Quantity("length", 2)] | None = None
    """Offset from each copy of a group to the next, along x and y, such as `0 1.5 m`. The row is centered on
    the position."""
    velocity: Annotated[Scalar, Quantity("speed", 3, "episode")] | None = None
    """Velocity at the start, m/s, in the world frame."""
    angular_velocity: Annotated[Scalar, Quantity("angular speed", 3, "episode")] | None = None
    """Angular velocity at the start, rad/s, in the world frame."""


Places = dict[BodyName, Placement]


class MapLayout(Section):
    """A layout as a map: each cell is a letter of the legend, or a dot if it is empty."""

    identifying_keys: ClassVar[frozenset[str]] = frozenset({"map", "cell"})

    cell: Thickness
    """Size of a cell, m."""
    legend: Annotated[dict[Annotated[str, Reference("letter")], BodyName], Size(1, "letter")]
    """The meaning of each letter: a robot, an object, or `wall`."""
    map: PlainText
    """The rows of the map; blanks separate the cells, and the first row has the largest y."""


LayoutName = Annotated[str, Reference("layout")]
Mixture = Annotated[dict[LayoutName, Share], Size(1, "layout")]


class Reset(Section):
    """How an episode begins."""

    key_rules: ClassVar[tuple[KeyCount, ...]] = (KeyCount(("layout", "place")),)

    place: Places = {}
    """Start poses of robots and objects. Bodies with coordinates are placed first; the others follow in the
    order of the file, and avoid the bodies placed before."""
    joints: dict[Annotated[str, Reference("joints")], Annotated[JointState | JointAngle, FORMS]] = {}
    """Start positions of joints or of groups of joints, such as `cart.pole_hinge: uniform(-1 .. 1 deg)`."""
    layout: Annotated[Mixture | LayoutName, FORMS] | None = None
    """The layout to use, or several layouts with their probabilities, such as `{scattered: 88 %, paper: 12
    %}`."""
    layouts: dict[SharedName, Annotated[MapLayout | Places, FORMS]] = {}
    """Layouts, each under a name that you choose: a start pose for each body, or a map of letters."""
    require: Annotated[str, Expression("require", boolean=True)] | None = None
    """A condition that each start must meet. If it is false, deepbots draws the layout, the positions and the
    joints again; parameters keep their values."""
    attempts: Annotated[int, WholeNumber(1, 100_000)] = 100
    """Maximum number of draws per reset. If none gives a valid start, the reset fails."""
    settle: Annotated[Scalar, Quantity("time", minimum=0)] = "0 s"
    """Simulated time before the episode begins, so that bodies come to rest."""


class Disturbance(Section):
    """A force or a torque that acts on a body for a short time."""

    key_rules: ClassVar[tuple[KeyCount, ...]] = (
        KeyCount(("force", "torque"), min=1, max=2),
        KeyCount(("every", "at"), min=1, max=2),
    )

    body: Annotated[str, Reference("body or link")]
    """The robot, link or object that is pushed."""
    force: Annotated[Scalar, Quantity("force", 3, "step")] | None = None
    """Force in the world frame, N, drawn for each push."""
    torque: Annotated[Scalar, Quantity("torque", 3, "step")] | None = None
    """Torque in the world frame, N*m, drawn for each push."""
    every: Annotated[Scalar, Quantity("time", known="step", minimum=0, exclusive=True)] | None = None
    """Time from the beginning of one push to the beginning of the next. It is also the time before the first
    push, unless `at` is given."""
    at: Annotated[Scalar, Quantity("time", known="episode", minimum=0)] | None = None
    """Start time of the first push. Without `every`, there is only this push."""
    duration: Annotated[Scalar, Quantity("time", known="step", minimum=0)]
    """Duration of a push."""
