"""The task: action, observation, reward, endings, resets, disturbances, curriculum and evaluation."""

from typing import Annotated, ClassVar

from deepbots_cli.scenario.base import FORMS, KeyCount, Many, Section, Size
from deepbots_cli.scenario.fields import (
    BodyName,
    Bool,
    Bounds,
    Expression,
    Length,
    LocalName,
    Number,
    PlainText,
    PositiveInt,
    Quantity,
    Range,
    Reference,
    Scalar,
    Setting,
    Share,
    SharedName,
    Signal,
    SmallInt,
    Text,
    Thickness,
    Until,
    Whole,
)
from deepbots_cli.scenario.world import Pose

PYTHON_PATH = Text("the place of a function", r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*", "package.module:function")
Choice = Annotated[Scalar, Quantity("any")]
Noise = Annotated[Scalar, Quantity("any", stage="episode", relative=True, minimum=0)]


class PythonTerm(Section):
    """A term computed by a function of an installed package; refused unless foreign code is allowed."""

    python: Annotated[str, PYTHON_PATH]
    """The function, `package.module:function`."""


class ContinuousAction(Section):
    """Numbers that the agent chooses in [-1, 1], which are mapped to the range."""

    range: Annotated[str, Range("any")]
    """The range that [-1, 1] is mapped to, such as `0.25 .. 1`."""
    each: Annotated[str, Reference("group")] | None = None
    """One number for each member of this group or actuator."""


class DiscreteAction(Section):
    """One of several options."""

    identifying_keys: ClassVar[frozenset[str]] = frozenset({"choices", "forbid"})

    choices: Annotated[dict[LocalName, Annotated[dict[SharedName, Choice] | Choice, FORMS]], Size(2, "choice")]
    """The options by name, each with a number, or with the variables that it sets: `{forward: {left: 1, right: 1}}`."""
    forbid: dict[Annotated[str, Reference("choice")], Annotated[str, Expression("forbid", boolean=True)]] = {}
    """For each option, the condition under which it may not be chosen."""


Action = Annotated[DiscreteAction | ContinuousAction | Annotated[str, Range("any")], FORMS]


class Agent(Section):
    """How the policy acts in the scenario."""

    action_repeat: SmallInt = 1
    """Timesteps for which one action of the agent is held."""
    frame_stack: SmallInt = 1
    """How many observations in a row the policy sees."""
    each: Annotated[str, Reference("robot")] | None = None
    """One shared policy over the copies of this robot."""


class Observed(Section):
    """One entry of the observation, with more than its range."""

    range: Annotated[str, Range("any", auto=True)]
    """The range that is mapped to [-1, 1], such as `-0.4 .. 0.4 m`; `auto` takes the known interval."""
    history: SmallInt = 1
    """How many values in a row the policy sees, newest last."""
    noise: Noise = 0
    """Standard deviation of added noise, such as `0.01 rad`, or `2 %` of the value."""
    clip: Bool = True
    """Whether values outside the range are clipped to it."""


class Goal(Section):
    """Goal specification, for hindsight replay."""

    achieved: Annotated[Scalar, Expression("goal", boolean=False)]
    """The value that the agent has reached."""
    desired: Annotated[Scalar, Expression("goal", boolean=False)]
    """The value to reach."""
    tolerance: Annotated[Scalar, Quantity("any", minimum=0)]
    """Largest distance between `achieved` and `desired` at which the goal counts as reached."""
    range: Annotated[str, Range("any")]
    """Range of `achieved` and `desired`, which is mapped to [-1, 1] in the observation."""
    noise: Noise = 0
    """Standard deviation of the noise on `achieved`: in its unit, such as `5 mm`, or as `2 %` of the value."""


Condition = Annotated[PythonTerm | Annotated[str, Expression("ending", boolean=True)], FORMS]


class Termination(Section):
    """Conditions that end the task; the agent learns about them."""

    success: dict[SharedName, Condition] = {}
    """Conditions under which the agent has succeeded, by names of your choice."""
    failure: dict[SharedName, Condition] = {}
    """Conditions under which the agent has failed, by names of your choice. Failure has precedence over success."""


class Truncation(Section):
    """Limits that only cut the episode short; they are not part of the task."""

    key_rules: ClassVar[tuple[KeyCount, ...]] = (KeyCount(("max_steps", "max_time"), min=1, max=2),)

    max_steps: Annotated[Scalar, Quantity("number", minimum=1, whole=True)] | None = None
    """Steps of the agent."""
    max_time: Annotated[Scalar, Quantity("time", minimum=0, exclusive=True)] | None = None
    """Simulated time, such as `60 s`."""


Decision = Annotated[
    Annotated[dict[Annotated[str, Reference("choice")], Annotated[Scalar | bool, Expression("script")]], Size(1, "option")]
    | Annotated[Scalar, Expression("script", boolean=False)],
    FORMS,
]
Script = Annotated[dict[Annotated[str, Reference("action")], Decision], Size(1, "action")]


Settings = dict[Annotated[str, Reference("setting")], Annotated[str | int | float | bool | dict[str, object] | list[object], Setting()]]


class Stage(Section):
    """A stage of the curriculum."""

    name: LocalName
    """Name of the stage."""
    set: Settings = {}
    """Changes: parameters by name, or other values by path, such as `reset.layout: paper`."""
    until: Annotated[str, Until()] | None = None
    """When the next stage begins: `success_rate >= 0.7 over 40 episodes`, or after `50_000 steps`."""


class Case(Section):
    """One case of the evaluation."""

    set: Settings = {}
    """Changes: parameters by name, or other values by path."""
    episodes: PositiveInt | None = None
    """Episodes of this case."""


class Evaluation(Section):
    """Evaluation of a trained policy."""

    episodes: PositiveInt = 100
    """Episodes, or episodes per case."""
    cases: dict[LocalName, Case] = {}
    """Further conditions under which the policy is evaluated, by names of your choice."""


class Solved(Section):
    """Criterion for a solved task."""

    key_rules: ClassVar[tuple[KeyCount, ...]] = (KeyCount(("mean_return", "success_rate"), min=1, max=2),)

    mean_return: Annotated[float, Number()] | None = None
    """Minimum of the mean return over the episodes."""
    success_rate: Share | None = None
    """Minimum of the share of successful episodes, 0 to 1."""
    episodes: PositiveInt = 100
    """Number of consecutive episodes."""


# Tests

FixedAction = dict[Annotated[str, Reference("action")], Annotated[dict[Annotated[str, Reference("choice")], Choice] | Choice, FORMS]]
Requirement = Annotated[str, Expression("test", boolean=True)]
Requirements = Annotated[Annotated[Many[Requirement], Size(1, "condition")] | Requirement, FORMS]
EndingName = Annotated[str, Reference("ending")]


class Expectation(Section):
    """Result that a test expects; all of it must hold."""

    key_rules: ClassVar[tuple[KeyCount, ...]] = (
        KeyCount(("success_rate", "failure_rate", "mean_return", "ends_by", "always", "eventually"), min=1, max=6),
    )

    success_rate: Annotated[Scalar, Bounds()] | None = None
    """Share of successful episodes: its minimum, or a range."""
    failure_rate: Annotated[Scalar, Bounds()] | None = None
    """Share of episodes that end by a failure: its minimum, or a range."""
    mean_return: Annotated[Scalar, Bounds()] | None = None
    """Mean return of the episodes: its minimum, or a range."""
    ends_by: Annotated[Annotated[Many[EndingName], Size(1, "ending")] | EndingName, FORMS] | None = None
    """The ending or limit, or several, by one of which every episode ends."""
    always: Requirements | None = None
    """A condition, or several, that hold after every step."""
    eventually: Requirements | None = None
    """A condition, or several, each of which holds after at least one step of every episode."""


class ScenarioTest(Section):
    """Episodes without a trained policy, and their expected result."""

    key_rules: ClassVar[tuple[KeyCount, ...]] = (KeyCount(("policy", "actions"), min=1), KeyCount(("case", "stage")))

    policy: Annotated[str, Reference("policy")] | None = None
    """What acts: a script, `random`, or `zero`, which takes the middle of each range and the first option of each choice."""
    actions: Annotated[Many[Annotated[FixedAction | Choice, FORMS]], Size(1, "action")] | None = None
    """Actions of the first steps; the episode stops after the last of them."""
    episodes: Annotated[int, Whole(1, 1000)] = 1
    """Number of episodes."""
    seed: Annotated[int, Whole(0, 1_000_000_000)] = 0
    """Root seed of the episodes, which start as those of an evaluation."""
    max_steps: PositiveInt | None = None
    """Steps after which an episode stops."""
    max_time: Annotated[Scalar, Quantity("time", minimum=0, exclusive=True)] | None = None
    """Simulated time after which an episode stops."""
    case: Annotated[str, Reference("case")] | None = None
    """Case of the evaluation whose settings apply."""
    stage: Annotated[str, Reference("stage")] | None = None
    """Stage of the curriculum whose settings apply."""
    expect: Expectation
    """Expected result."""


class Measured(Section):
    """A value that the supervisor measures with noise. Every expression that uses the name reads the same noisy value."""

    value: Signal
    """The exact value."""
    noise: Noise = 0
    """Standard deviation of the noise on it: in its unit, such as `2 mm`, or as `2 %` of the value."""


Augmentation = Annotated[
    Many[Annotated[str, Reference("parameter or signal")]] | dict[SharedName, Annotated[Measured | Signal, FORMS]], FORMS
]
Reward = dict[LocalName, Annotated[PythonTerm | Annotated[Scalar, Expression("reward")], FORMS]]
Observation = dict[Annotated[str, Reference("value")], Annotated[Observed | Annotated[str, Range("any", auto=True)], FORMS]]


# The beginning of an episode

JointRate = Annotated[Scalar, Quantity("angular speed or speed", stage="episode")]
JointAngle = Annotated[Scalar, Quantity("angle or length", stage="episode")]


class JointState(Section):
    """Position and velocity of a joint at the start."""

    position: JointAngle
    """Position, an angle or a length."""
    velocity: JointRate = 0
    """Velocity."""


class Region(Section):
    """A rectangle in the ground plane."""

    x: Annotated[str, Range("length")]
    """Range along x, such as `-1 .. 1 m`."""
    y: Annotated[str, Range("length")]
    """Range along y."""


class Placement(Pose):
    """Where a body stands at the start: at a pose, somewhere in a region, or on a line."""

    key_rules: ClassVar[tuple[KeyCount, ...]] = (
        *Pose.key_rules,
        KeyCount(("region", "line", "xyz")),
        *(KeyCount((way, axis)) for way in ("region", "line", "on") for axis in ("x", "y")),
        *(KeyCount(("on", way)) for way in ("line", "xyz")),
    )

    region: Annotated[Region | Annotated[str, Reference("region")], FORMS] | None = None
    """Draws a free position: `arena`, or a rectangle `{x: -1 .. 1 m, y: -1 .. 1 m}`."""
    on: Annotated[str, Reference("object")] | None = None
    """Draws a free position on the flat top of this object, a box or a cylinder: on the whole top, or on its part within `region`."""
    clearance: Length = 0
    """Minimum distance to other bodies, m; a movable body also keeps it to the walls of the arena and to the edge of its surface."""
    grid: Thickness | None = None
    """Draws the position from a grid with this spacing, m."""
    line: Annotated[str, Reference("line")] | None = None
    """Stands at the beginning of this painted line, along it."""
    at_most: PositiveInt | None = None
    """Maximum number of copies of a group that are placed; the others are absent."""
    spacing: Annotated[Scalar, Quantity("length", 2)] | None = None
    """Offset from each copy of a group to the next, along x and y, such as `0 1.5 m`; the row is centred on the position."""
    velocity: Annotated[Scalar, Quantity("speed", 3, "episode")] | None = None
    """Velocity at the start, world frame."""
    angular_velocity: Annotated[Scalar, Quantity("angular speed", 3, "episode")] | None = None
    """Angular velocity at the start, world frame."""


Places = dict[BodyName, Placement]


class MapLayout(Section):
    """A layout as a map of letters: each cell holds one letter of the legend, or a dot if it is empty."""

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
    """Where robots and objects stand, in this order; later ones avoid earlier ones."""
    set: dict[Annotated[str, Reference("joints")], Annotated[JointState | JointAngle, FORMS]] = {}
    """Positions of joints, such as `cart.pole_hinge: uniform(-1 .. 1 deg)`, or of a group."""
    layout: Annotated[Mixture | LayoutName, FORMS] | None = None
    """The layout to use, or several layouts with their shares, such as `{scattered: 88 %, paper: 12 %}`."""
    layouts: dict[SharedName, Annotated[MapLayout | Places, FORMS]] = {}
    """Arrangements by names of your choice: a place for each body, or a map in letters."""
    require: Annotated[str, Expression("require", boolean=True)] | None = None
    """A condition at the start; while it is false, everything is drawn again."""
    attempts: Annotated[int, Whole(1, 100_000)] = 100
    """Maximum number of draws; then the reset fails."""
    settle: Annotated[Scalar, Quantity("time", minimum=0)] = "0 s"
    """Simulated time for things to come to rest before the episode begins."""


class Disturbance(Section):
    """A force or a torque that acts on a body for a short time."""

    key_rules: ClassVar[tuple[KeyCount, ...]] = (KeyCount(("force", "torque"), min=1, max=2), KeyCount(("every", "at"), min=1, max=2))

    body: Annotated[str, Reference("body or link")]
    """The robot, link or object that is pushed."""
    force: Annotated[Scalar, Quantity("force", 3, "step")] | None = None
    """Force in the world frame, drawn anew for each push."""
    torque: Annotated[Scalar, Quantity("torque", 3, "step")] | None = None
    """Torque in the world frame, drawn anew for each push."""
    every: Annotated[Scalar, Quantity("time", stage="step", minimum=0, exclusive=True)] | None = None
    """Time from the beginning of one push to the beginning of the next; also the time before the first push, unless `at` is given."""
    at: Annotated[Scalar, Quantity("time", stage="episode", minimum=0)] | None = None
    """Time of the first push, which is the only one without `every`."""
    duration: Annotated[Scalar, Quantity("time", stage="step", minimum=0)]
    """How long a push acts."""
