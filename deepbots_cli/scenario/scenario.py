"""The scenario: robots, messages, the task, and the whole file, whose sections stand in the order in which a reader wants them."""

import pathlib
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, PrivateAttr

from deepbots_cli.document.nodes import NodePath
from deepbots_cli.message_formats import FORMATS
from deepbots_cli.scenario.actuators import AnyActuator, JointPosition
from deepbots_cli.scenario.base import FORMS, InsteadOf, KeyCount, Many, Section, Size, visit_values
from deepbots_cli.scenario.fields import (
    BodyName,
    Bool,
    Bounds,
    Color,
    Expression,
    FilePath,
    JointPattern,
    Length,
    LocalName,
    Number,
    Pattern,
    PlainText,
    PositiveInt,
    Quantity,
    RandomizableCount,
    RandomizableFactor,
    RandomizableShare,
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
    WholeNumber,
    Word,
)
from deepbots_cli.scenario.sensors import AnySensor
from deepbots_cli.scenario.training import AnyTraining
from deepbots_cli.scenario.world import AnyObject, Pose, World

# Robots and messages


class LinkOverride(Section):
    """Overrides of a link; `urdf` stands for the value in the robot file."""

    mass: Annotated[Scalar, Quantity("mass", known="episode", minimum=0, urdf=True)] | None = None
    """Mass, kg; it also scales the inertia. `urdf * 1.2` is 1.2 times the mass in the robot file."""
    density: Annotated[Scalar, Quantity("density", minimum=0, exclusive=True)] | None = None
    """In place of `mass`: mass, centre and inertia of a homogeneous body of the shape of the link."""
    scale: Annotated[Scalar, Quantity("number", components=3, minimum=0, exclusive=True)] | None = None
    """Factors along x, y and z on shapes, centre of mass and child joints; the mass scales with the volume."""
    friction: Annotated[Scalar, Quantity("number", known="episode", minimum=0)] | None = None
    """Coulomb's coefficient of friction."""
    spinning_friction: RandomizableFactor | None = None
    """Friction against spinning on the spot."""
    rolling_friction: RandomizableFactor | None = None
    """Friction against rolling."""
    restitution: RandomizableShare | None = None
    """Share of the speed that a bounce keeps, 0 to 1."""
    color: Color | None = None
    """Color of the link."""


class JointOverride(Section):
    """Overrides of a joint; `urdf` stands for the value in the robot file."""

    damping: Annotated[Scalar, Quantity("damping", known="episode", minimum=0, urdf=True)] | None = None
    """Viscous damping, N*m*s/rad or N*s/m."""
    friction: Annotated[Scalar, Quantity("torque or force", known="episode", minimum=0, urdf=True)] | None = None
    """Dry friction, N*m or N."""
    range: Annotated[str, Range("angle or length")] | None = None
    """Lower and upper limit, such as `-90 .. 90 deg`."""
    max_torque: Annotated[Scalar, Quantity("torque or force", minimum=0, urdf=True)] | None = None
    """Effort limit, N*m or N."""
    max_velocity: Annotated[Scalar, Quantity("angular speed or speed", minimum=0, urdf=True)] | None = None
    """Velocity limit."""


Emitted = Annotated[Many[Annotated[str, Reference("sensor")]] | dict[LocalName, Annotated[Scalar, Expression("emit")]], FORMS]


class Robot(Section):
    """A body from a robot file, with sensors, actuators, and a controller that acts on messages."""

    urdf: Annotated[str, FilePath("robot file")]
    """The robot file: a path relative to this file, the name of a shipped robot, or `package://name/path`."""
    base: Literal["free", "fixed"] = "free"
    """Whether the root link moves or is fixed to the world."""
    pose: Pose = Field(default_factory=Pose)
    """Where it stands unless `reset` places it."""
    count: RandomizableCount = 1
    """Number of copies; the name then stands for the group."""
    spacing: Annotated[Scalar, Quantity("length", components=3)] | None = None
    """Offset from each copy to the next, x y z; the row is centred on the position of the robot."""
    links: dict[Annotated[str, Pattern("link")], LinkOverride] = {}
    """Changes of links, by name or pattern such as `wheel_*`."""
    joints: dict[JointPattern, JointOverride] = {}
    """Changes of joints, by name or pattern."""
    groups: dict[LocalName, Annotated[Many[Annotated[str, Pattern("joint or link")]], Size(1, "name")]] = {}
    """Names for several joints or several links: lists of names and patterns."""
    poses: dict[LocalName, Annotated[dict[JointPattern, JointPosition], Size(1, "joint")]] = {}
    """Names for positions of the joints."""
    sensors: dict[LocalName, AnySensor] = {}
    """Sensors, by names of your choice."""
    actuators: dict[LocalName, AnyActuator] = {}
    """Actuators, by names of your choice."""
    receive: dict[LocalName, Annotated[Scalar, Expression("receive")]] | None = None
    """Values that the supervisor sends besides the action: a name and an expression each."""
    emit: Emitted | None = None
    """What the robot sends in every timestep: sensors, or names with expressions over them. Default: sensors that the supervisor uses."""
    apply: dict[Annotated[str, Reference("actuator")], Annotated[Scalar, Expression("apply", boolean=False)]] = {}
    """The command of each actuator, from received values and sensors."""


class Route(Section):
    """Transmission of messages in one direction."""

    latency: Annotated[Scalar, Quantity("time", known="step", minimum=0, maximum=60, usual_unit="ms")] = "0 ms"
    """Time from sending to arrival."""
    loss: Annotated[Scalar, Quantity("number", known="step", minimum=0, maximum=1)] = 0
    """Share of messages that never arrive."""
    burst: Annotated[Scalar, Quantity("number", minimum=1)] | None = None
    """Mean number of messages that are lost in a row; without it, losses are independent of each other."""
    range: Annotated[Scalar, Quantity("length", known="episode", minimum=0)] | None = None
    """Maximum distance from the origin of the world to the robot's root link; beyond it no message arrives."""
    order: Literal["sent", "arrival", "newest"] = "sent"
    """Which message counts when several are on their way: in the order sent, as they arrive, or only the newest."""
    on_loss: Literal["hold", "zero", "skip"] = "hold"
    """How the receiver replaces a lost message: it holds the last one, takes zeros, or does nothing."""


class Messages(Section):
    """Messages between supervisor and robots."""

    format: Annotated[str, Word(FORMATS)] = "struct"
    """Encoding of messages; with `none`, the supervisor acts on the robot without messages."""
    timing: Literal["immediate", "delayed"] = "immediate"
    """`immediate`: an action takes effect in its timestep; `delayed`: one timestep later, and the robot's messages are one timestep old."""
    to_robot: Route = Field(default_factory=Route)
    """The channel from the supervisor to the robots."""
    from_robot: Route = Field(default_factory=Route)
    """The channel from the robots to the supervisor."""


# Task

PYTHON_PATH = Text("the place of a function", r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*", "package.module:function")
Choice = Annotated[Scalar, Quantity("any")]
Noise = Annotated[Scalar, Quantity("any", known="episode", relative=True, minimum=0)]


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
    """The options by name. Each has a number, or the variables that it sets: `{ahead: {left: 1, right: 1}, stop: {left: 0, right: 0}}`."""
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
    """When the next stage begins: `success_rate >= 0.7 over 40 episodes` of the training, `success_rate >= 0.7 in evaluation` without
    exploration, or after `50_000 steps`."""


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

    key_rules: ClassVar[tuple[KeyCount, ...]] = (KeyCount(("driver", "actions"), min=1), KeyCount(("case", "stage")))

    driver: Annotated[Annotated[str, Reference("driver")] | None, InsteadOf("policy", "script")] = None
    """Who acts: a script, `random`, or `zero`, which takes the middle of each range and the first option of each choice."""
    actions: Annotated[Many[Annotated[FixedAction | Choice, FORMS]], Size(1, "action")] | None = None
    """Actions of the first steps; the episode stops after the last of them."""
    episodes: Annotated[int, WholeNumber(1, 1000)] = 1
    """Number of episodes."""
    seed: Annotated[int, WholeNumber(0, 1_000_000_000)] = 0
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

JointRate = Annotated[Scalar, Quantity("angular speed or speed", known="episode")]
JointAngle = Annotated[Scalar, Quantity("angle or length", known="episode")]


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
    joints: Annotated[dict[Annotated[str, Reference("joints")], Annotated[JointState | JointAngle, FORMS]], InsteadOf("set")] = {}
    """Positions of joints, such as `cart.pole_hinge: uniform(-1 .. 1 deg)`, or of a group."""
    layout: Annotated[Mixture | LayoutName, FORMS] | None = None
    """The layout to use, or several layouts with their shares, such as `{scattered: 88 %, paper: 12 %}`."""
    layouts: dict[SharedName, Annotated[MapLayout | Places, FORMS]] = {}
    """Arrangements by names of your choice: a place for each body, or a map in letters."""
    require: Annotated[str, Expression("require", boolean=True)] | None = None
    """A condition at the start; while it is false, everything is drawn again."""
    attempts: Annotated[int, WholeNumber(1, 100_000)] = 100
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
    every: Annotated[Scalar, Quantity("time", known="step", minimum=0, exclusive=True)] | None = None
    """Time from the beginning of one push to the beginning of the next; also the time before the first push, unless `at` is given."""
    at: Annotated[Scalar, Quantity("time", known="episode", minimum=0)] | None = None
    """Time of the first push, which is the only one without `every`."""
    duration: Annotated[Scalar, Quantity("time", known="step", minimum=0)]
    """How long a push acts."""


# The whole file

VERSION = 1
"""The version of the language that is read."""

TITLE = Text(
    "a name",
    r"[A-Za-z][A-Za-z0-9_-]{0,63}",
    "CartPole",
    refused="the name of a scenario",
    help="use letters, digits, `_` and `-`, at most 64, and begin with a letter",
)


class Scenario(Section):
    """One task: world, robots, messages, observation, reward, endings, resets, training.

    It may be built in Python of nested models, mappings and plain values. A value of a wrong type or form and an unknown key raise
    `pydantic.ValidationError`. Checks of the whole scenario follow in `deepbots_cli.lint` and `compile`.
    """

    deepbots: PositiveInt
    """Version of the scenario language: `1`."""
    name: Annotated[str, TITLE]
    """Name of the scenario; runs are named after it."""
    summary: PlainText = ""
    """One sentence about the task."""
    parameters: dict[SharedName, Annotated[Scalar, Expression("parameter")]] = {}
    """Values by names of your choice: constants, or draws such as `uniform(0 .. 1 m)` that are new in every episode."""
    world: World
    """Time and place: timestep, gravity, ground, arena."""
    objects: dict[SharedName, AnyObject] = {}
    """Bodies that are no robots, by names of your choice."""
    robots: Annotated[dict[SharedName, Robot], Size(1, "robot")]
    """The robots, by names of your choice."""
    messages: Messages = Field(default_factory=Messages)
    """Messages between supervisor and robots."""
    action: Annotated[dict[SharedName, Action], Size(1, "action")]
    """Actions of the agent, by names of your choice: a range, or choices."""
    agent: Agent = Field(default_factory=Agent)
    """How the policy is joined to the scenario."""
    augment: Augmentation = {}
    """Values that the supervisor adds to those of the robots; the policy may see them."""
    signals: dict[SharedName, Signal] = {}
    """Helpers for reward and endings; the policy never sees them."""
    goal: Goal | None = None
    """Goal specification."""
    observation: Annotated[Observation, Size(1, "entry")]
    """Observation of the policy, in this order: the name of a value, and the range that is mapped to [-1, 1]."""
    reward: Annotated[Reward, Size(1, "term")]
    """Terms of the reward, by names of your choice. Each term is a plain number; the reward is their sum."""
    termination: Termination = Field(default_factory=Termination)
    """Endings of the task: success and failure."""
    truncation: Truncation | None = None
    """Limits that cut an episode short."""
    reset: Reset = Field(default_factory=Reset)
    """How an episode begins."""
    disturbances: dict[SharedName, Disturbance] = {}
    """Pushes and gusts, by names of your choice."""
    scripts: dict[LocalName, Script] = {}
    """Hand-written policies by names of your choice: an expression for every part of the action."""
    curriculum: Annotated[Many[Stage], Size(1, "stage")] = ()
    """Stages of increasing difficulty."""
    evaluation: Evaluation = Field(default_factory=Evaluation)
    """Evaluation of a trained policy."""
    solved: Solved | None = None
    """Criterion for a solved task."""
    train: AnyTraining | None = None
    """How the policy is trained."""
    tests: dict[LocalName, ScenarioTest] = {}
    """Tests by names of your choice, which `deepbots test` runs: who acts, and the expected result."""

    _pruned: frozenset[NodePath] = PrivateAttr(frozenset())

    @property
    def pruned(self) -> frozenset[NodePath]:
        """The paths that `validate` removed because they had findings; their names are known, their values are not."""
        return self._pruned

    @classmethod
    def from_yaml(cls, path: str | pathlib.Path) -> Self:
        """The scenario in a file, with all that the file extends and includes; files that it names get absolute paths.

        Raises:
            ScenarioError: The file has findings at error level.
            UsageError: There is no such file.
        """
        from deepbots_cli.document import descend, load, shipped, to_data
        from deepbots_cli.errors import ScenarioError
        from deepbots_cli.scenario.validate import validate

        document = load(path)
        root = document.root
        found = validate(root, document.findings) if root is not None else None
        if root is None or found is None or document.findings.errors:
            raise ScenarioError(list(document.findings))
        data: Any = to_data(root)
        for place, kind, value in visit_values(found):
            node = descend(root, place)[0]
            file = document.directory_of(node.span) / str(value)
            if isinstance(kind, FilePath) and value not in shipped.robot_names() and file.exists():
                holder = data
                for step in place[:-1]:
                    holder = holder[step]
                holder[place[-1]] = str(file.resolve())
        return cls.model_validate(data)

    def to_yaml(self) -> str:
        """The scenario as the text of a file; values left to their defaults are left out."""
        import yaml

        return yaml.safe_dump(self.model_dump(mode="json", exclude_unset=True), sort_keys=False, allow_unicode=True, width=120)

    @classmethod
    def model_json_schema(cls, *args: Any, **kwargs: Any) -> dict[str, Any]:
        """The JSON Schema for editors, whatever the arguments."""
        from deepbots_cli.scenario.json_schema import json_schema

        return json_schema()
