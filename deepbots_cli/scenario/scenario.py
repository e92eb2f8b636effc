"""The scenario: robots, messages, the task, and the whole file."""

import pathlib
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, PrivateAttr, model_validator

from deepbots_cli.document.nodes import MappingNode, NodePath, node_at
from deepbots_cli.message_formats import FORMATS
from deepbots_cli.scenario.actuators import AnyActuator, JointPosition
from deepbots_cli.scenario.agent import (
    Action,
    Agent,
    AgentName,
    AgentNames,
    AgentOfSeveral,
    Augmentation,
    Choice,
    Condition,
    Ending,
    Goal,
    Observation,
    Reward,
    Role,
    Script,
)
from deepbots_cli.scenario.base import FORMS, KeyCount, Many, Section, Size, visit_values
from deepbots_cli.scenario.curriculum import EndingNames, Levels, Settings, Stage
from deepbots_cli.scenario.fields.base import Scalar
from deepbots_cli.scenario.fields.names import (
    BodyName,
    FilePath,
    JointPattern,
    LocalName,
    Pattern,
    Reference,
    SharedName,
)
from deepbots_cli.scenario.fields.numbers import PositiveInt, WholeNumber
from deepbots_cli.scenario.fields.quantities import (
    Bounds,
    Expression,
    Length,
    Quantity,
    RandomizableCount,
    RandomizableFactor,
    RandomizableShare,
    Range,
    Share,
    Signal,
    Thickness,
)
from deepbots_cli.scenario.fields.training import Solved
from deepbots_cli.scenario.fields.words import Bool, Color, PlainText, Text, Word
from deepbots_cli.scenario.search import SearchField
from deepbots_cli.scenario.sensors import AnySensor
from deepbots_cli.scenario.training import AnyTraining
from deepbots_cli.scenario.world import AnyObject, Pose, World

# Robots and messages


class LinkOverride(Section):
    """Overrides of a link. In expressions, `urdf` is the value in the robot file."""

    mass: Annotated[Scalar, Quantity("mass", known="episode", minimum=0, urdf=True)] | None = None
    """Mass, kg; it also scales the inertia. `urdf * 1.2` is 1.2 times the mass in the robot file."""
    density: Annotated[Scalar, Quantity("density", minimum=0, exclusive=True)] | None = None
    """Density, kg/m^3, in place of `mass`: the link gets the mass, center of mass and inertia of a
    homogeneous body of its shape."""
    scale: Annotated[Scalar, Quantity("number", components=3, minimum=0, exclusive=True)] | None = None
    """Scale factors along x, y and z for shapes, center of mass and child joints. The mass scales with the
    volume."""
    com: Annotated[Scalar, Quantity("length", known="episode", components=3)] | None = None
    """Offset of the center of mass along x, y and z of the link, such as `uniform(-2 -2 0 .. 2 2 0 cm)`; it
    is added to the center of mass in the robot file."""
    inertia: Annotated[Scalar, Quantity("number", known="episode", minimum=0, exclusive=True)] | None = None
    """Scale factor of the inertia about the center of mass, such as `uniform(0.8 .. 1.2)`. The mass keeps its
    value."""
    friction: Annotated[Scalar, Quantity("number", known="episode", minimum=0)] | None = None
    """Coulomb's coefficient of friction."""
    spinning_friction: RandomizableFactor | None = None
    """Friction against spinning on the spot, in m, written as a plain number."""
    rolling_friction: RandomizableFactor | None = None
    """Friction against rolling, in m, written as a plain number."""
    restitution: RandomizableShare | None = None
    """Fraction of the speed that remains after a bounce, 0 to 1."""
    color: Color | None = None
    """Color of the link."""


class JointOverride(Section):
    """Overrides of a joint. In expressions, `urdf` is the value in the robot file."""

    damping: Annotated[Scalar, Quantity("damping", known="episode", minimum=0, urdf=True)] | None = None
    """Viscous damping, N*m*s/rad or N*s/m."""
    friction: Annotated[Scalar, Quantity("torque or force", known="episode", minimum=0, urdf=True)] | None = (
        None
    )
    """Dry friction, N*m or N."""
    armature: (
        Annotated[Scalar, Quantity("moment of inertia or mass", known="episode", minimum=0, urdf=True)] | None
    ) = None
    """Inertia of the rotor at the joint, kg*m^2 or kg: that of the motor times the square of its gear ratio.
    It needs the engine `mujoco`."""
    range: Annotated[str, Range("angle or length")] | None = None
    """Lower and upper limit, such as `-90 .. 90 deg`."""
    max_torque: Annotated[Scalar, Quantity("torque or force", minimum=0, urdf=True)] | None = None
    """Effort limit, N*m or N."""
    max_velocity: Annotated[Scalar, Quantity("angular speed or speed", minimum=0, urdf=True)] | None = None
    """Velocity limit, rad/s or m/s."""


Emitted = Annotated[
    Many[Annotated[str, Reference("sensor")]] | dict[LocalName, Annotated[Scalar, Expression("emit")]], FORMS
]


class Robot(Section):
    """A robot from a robot file, with sensors, actuators, and a controller that exchanges messages with the
    supervisor."""

    urdf: Annotated[str, FilePath("robot file")]
    """The robot file: a path relative to the scenario file in which it is written, the name of a shipped
    robot, or `package://name/path`."""
    base: Literal["free", "fixed"] = "free"
    """Whether the root link moves or is fixed to the world."""
    self_collision: bool = False
    """Whether links of the robot touch each other. Links that a joint joins never do."""
    pose: Pose = Field(default_factory=Pose)
    """Start pose of the robot, unless `reset` places it."""
    count: RandomizableCount = 1
    """Number of copies. With more than one, the name refers to the group of all copies."""
    spacing: Annotated[Scalar, Quantity("length", components=3)] | None = None
    """Offset from each copy to the next along x, y and z. The row is centered on the position of the
    robot."""
    links: dict[Annotated[str, Pattern("link")], LinkOverride] = {}
    """Changes to links, by name or by a pattern such as `wheel_*`."""
    joints: dict[JointPattern, JointOverride] = {}
    """Changes to joints, by name or by a pattern."""
    groups: dict[LocalName, Annotated[Many[Annotated[str, Pattern("joint or link")]], Size(1, "name")]] = {}
    """Names for several joints or several links: lists of names and patterns."""
    poses: dict[LocalName, Annotated[dict[JointPattern, JointPosition], Size(1, "joint")]] = {}
    """Names for positions of the joints, by joint, pattern or group. An entry replaces earlier ones of the same
    joint."""
    sensors: dict[LocalName, AnySensor] = {}
    """Sensors, each under a name that you choose."""
    actuators: dict[LocalName, AnyActuator] = {}
    """Actuators, each under a name that you choose."""
    receive: dict[LocalName, Annotated[Scalar, Expression("receive")]] | None = None
    """Further values that the supervisor sends with the action: names with expressions."""
    emit: Emitted | None = None
    """Values that the robot sends in each timestep: sensors, or names with expressions. Default: the sensors
    that the supervisor uses."""
    hear: dict[LocalName, Annotated[str, Reference("message field")]] = {}
    """Values that other robots send to this one, each under a name that you choose: `{mate_angle:
    scout.angle}`. They arrive over the channel `messages.between_robots`, at the earliest in the timestep
    after they were sent."""
    apply: dict[
        Annotated[str, Reference("actuator")], Annotated[Scalar, Expression("apply", boolean=False)]
    ] = {}
    """The command of each actuator, from received values and sensors."""


class Route(Section):
    """Transmission of messages in one direction."""

    latency: Annotated[Scalar, Quantity("time", known="step", minimum=0, maximum=60, usual_unit="ms")] = (
        "0 ms"
    )
    """Time from sending to arrival."""
    loss: Annotated[Scalar, Quantity("number", known="step", minimum=0, maximum=1)] = 0
    """Probability that a message is lost, 0 to 1."""
    burst: Annotated[Scalar, Quantity("number", minimum=1)] | None = None
    """Mean number of messages that are lost in a row. By default, losses are independent of each other."""
    range: Annotated[Scalar, Quantity("length", known="episode", minimum=0)] | None = None
    """Range of the channel, m: no message arrives while the root link of the robot is farther from the origin
    of the world. By default unlimited."""
    order: Literal["sent", "arrival", "newest"] = "sent"
    """Order of delivery. `sent`: in the order of sending, so a late message delays the following ones.
    `arrival`: in the order of arrival. `newest`: as `arrival`, but without messages that are older than one
    already delivered."""
    on_loss: Literal["hold", "zero", "skip"] = "hold"
    """What the receiver does for a lost message. `hold`: it uses the last message again. `zero`: it uses
    zeros. `skip`: it does nothing."""


class Messages(Section):
    """Messages between supervisor and robots."""

    format: Annotated[str, Word(FORMATS)] = "struct"
    """Encoding of messages. With `none`, the supervisor controls the robots without messages."""
    timing: Literal["immediate", "delayed"] = "immediate"
    """`immediate`: an action takes effect in the same timestep. `delayed`: it takes effect one timestep
    later, and messages from robots arrive one timestep later."""
    to_robot: Route = Field(default_factory=Route)
    """The channel from the supervisor to the robots."""
    from_robot: Route = Field(default_factory=Route)
    """The channel from the robots to the supervisor."""
    between_robots: Route = Field(default_factory=Route)
    """The channels between robots, for `hear`. Their `range` is the distance between the root links of the
    two robots."""


# Task

ROS_TYPES = (
    "sensor_msgs/JointState",
    "sensor_msgs/LaserScan",
    "sensor_msgs/Range",
    "sensor_msgs/Imu",
    "sensor_msgs/Image",
    "sensor_msgs/CompressedImage",
    "geometry_msgs/Twist",
    "geometry_msgs/PoseStamped",
    "geometry_msgs/WrenchStamped",
    "nav_msgs/Odometry",
    "std_msgs/Float64MultiArray",
)
"""The types that `PARTS` of `deepbots_robot.topics` describes: the language has them also where
deepbots-robot is not installed."""
ROS_TOPIC = Text("a topic of ROS 2", r"/[A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*)*", "/joint_states")


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


class Case(Section):
    """One case of the evaluation."""

    set: Settings = {}
    """Changes: parameters by name, or other values by path."""
    episodes: PositiveInt | None = None
    """Number of episodes of this case."""


class Evaluation(Section):
    """Evaluation of a trained policy."""

    episodes: PositiveInt = 100
    """Number of episodes, for each case."""
    cases: dict[LocalName, Case] = {}
    """Further conditions under which the policy is evaluated, each under a name that you choose."""


class Tune(Section):
    """A search for better values, for `deepbots tune`. An option of the command replaces the key of the same
    name."""

    search: Annotated[
        dict[Annotated[str, Reference("setting")], Annotated[str | Many[Any], SearchField()]], Size(1, "key")
    ]
    """The values to try: parameters by name, or other values by path. Each has a range, such as `0.5 .. 1.5
    m`, or choices, such as `64 | 128` or `[[64, 64], [10, 10]]`. Values of `1e-4 .. 1e-2 :log` are drawn by
    their logarithm."""
    trials: Annotated[int, WholeNumber(1, 100_000)] = 40
    """Number of trials. A trial trains the scenario with one set of values, once for each seed."""
    seeds: Annotated[int, WholeNumber(1, 1000)] = 3
    """Number of seeds of each trial, counted from 0."""
    timesteps: Annotated[int, WholeNumber(1, 10**12)] | None = None
    """Number of steps of each training. Default: `train.total_timesteps`."""
    objective: Literal["solved", "success_rate", "mean_return"] | None = None
    """What makes a trial good. `solved`: few steps until the task is solved. `success_rate`, `mean_return`:
    those of the evaluation of the best models. Default: `solved` where the scenario has the key `solved`,
    else `success_rate` where it defines success."""
    prune: Bool = True
    """Whether a trial ends early while its evaluations are worse than the median of other trials after as
    many steps."""


# Tests

DriverName = Annotated[str, Reference("driver")]
FixedAction = dict[
    Annotated[str, Reference("action")],
    Annotated[dict[Annotated[str, Reference("choice")], Choice] | Choice, FORMS],
]
Requirement = Annotated[str, Expression("test", boolean=True)]
Requirements = Annotated[Annotated[Many[Requirement], Size(1, "condition")] | Requirement, FORMS]


class Expectation(Section):
    """Results that a test expects. The test passes if all of them are met."""

    key_rules: ClassVar[tuple[KeyCount, ...]] = (
        KeyCount(
            ("success_rate", "failure_rate", "mean_return", "ends_by", "always", "eventually"), min=1, max=6
        ),
    )

    success_rate: Annotated[Scalar, Bounds()] | None = None
    """Fraction of successful episodes: a minimum, or a range."""
    failure_rate: Annotated[Scalar, Bounds()] | None = None
    """Fraction of episodes that end by a failure: a minimum, or a range."""
    mean_return: Annotated[Scalar, Bounds()] | None = None
    """Mean return of the episodes: a minimum, or a range."""
    ends_by: EndingNames | None = None
    """The allowed endings and limits: each episode must end by one of them."""
    always: Requirements | None = None
    """Conditions that must be true after every step."""
    eventually: Requirements | None = None
    """Conditions, each of which must be true after at least one step of every episode."""


class ScenarioTest(Section):
    """Episodes without a trained policy, and their expected result."""

    key_rules: ClassVar[tuple[KeyCount, ...]] = (
        KeyCount(("driver", "actions"), min=1),
        KeyCount(("case", "stage")),
    )

    agent: AgentName | None = None
    """With several agents, the one whose results are expected, and whose names conditions may use. Default:
    the first one."""
    driver: Annotated[dict[AgentName, Annotated[str, Reference("driver")]] | DriverName, FORMS] | None = None
    """Who acts: a script, `random`, or `zero` (the middle of each range and the first option of each choice);
    or who acts for each of several agents."""
    actions: Annotated[Many[Annotated[FixedAction | Choice, FORMS]], Size(1, "action")] | None = None
    """Actions of the first steps; the episode stops after the last of them. With several agents, the action
    of each: `{hunter: {gas: 1}, prey: {gas: 0}}`; an agent without one does nothing in this step."""
    episodes: Annotated[int, WholeNumber(1, 1000)] = 1
    """Number of episodes."""
    seed: Annotated[int, WholeNumber(0, 1_000_000_000)] = 0
    """Seed of the test. Its episodes start like the episodes of an evaluation with this seed."""
    max_steps: PositiveInt | None = None
    """Number of steps after which an episode stops."""
    max_time: Annotated[Scalar, Quantity("time", minimum=0, exclusive=True)] | None = None
    """Simulated time after which an episode stops."""
    case: Annotated[str, Reference("case")] | None = None
    """Case of `evaluation` whose settings the test uses."""
    stage: Annotated[str, Reference("stage")] | None = None
    """Stage of `curriculum` whose settings the test uses."""
    expect: Expectation
    """Expected result."""


class Deploy(Section):
    """What a real robot needs that has no supervisor; `deepbots export` writes it into the bundle."""

    supplied_by: dict[Annotated[str, Reference("reading")], PlainText] = {}
    """What supplies each reading of the world that the policy needs and no robot measures, such as
    `position(ball): motion capture`."""


class RosTopic(Section):
    """The ROS 2 topic of a sensor, a reading of the world or an actuator."""

    topic: Annotated[str, ROS_TOPIC]
    """Name of the topic, such as `/joint_states`."""
    type: Annotated[str, Word(ROS_TYPES)]
    """Type of its messages. The message must have a part with the unit and the number of values of the
    sensor, reading or actuator."""
    part: PlainText | None = None
    """Part of the message, such as `velocity` or `linear.x`. Default: the part whose unit and number of
    values fit."""


# The beginning of an episode

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


# The whole file

VERSION = 1
"""The version of the language that is read."""

TITLE = Text(
    "a name",
    r"[A-Za-z][A-Za-z0-9_-]{0,63}",
    "CartPole",
    role="the name of a scenario",
    help="use letters, digits, `_` and `-`, at most 64, and begin with a letter",
)


_OF_ONE_AGENT: Mapping[str, Any] = {
    "action": {"none": "-1 .. 1"},
    "observation": {"none": "-1 .. 1"},
    "reward": {"none": 0},
}
"""Stand-ins for the sections that a scenario with one agent requires."""


class Scenario(Section):
    """One task: world, robots, messages, observation, reward, endings, resets, training.

    You can build a scenario in Python from nested models, mappings and plain values. An unknown key, or a
    value of the wrong type or form, raises `pydantic.ValidationError`. `deepbots_cli.api.lint` and
    `deepbots_cli.compile` check the scenario as a whole.
    """

    deepbots: PositiveInt
    """Version of the scenario language: `1`."""
    name: Annotated[str, TITLE]
    """Name of the scenario; runs are named after it."""
    summary: PlainText = ""
    """One sentence about the task."""
    parameters: dict[SharedName, Annotated[Scalar, Expression("parameter")]] = {}
    """Values, each under a name that you choose: constants, or draws such as `uniform(0 .. 1 m)` that are new
    in every episode."""
    world: World
    """The simulated world: timestep, physics engine, gravity, ground, arena."""
    objects: dict[SharedName, AnyObject] = {}
    """Bodies other than robots, each under a name that you choose."""
    robots: Annotated[dict[SharedName, Robot], Size(1, "robot")]
    """The robots, each under a name that you choose."""
    messages: Messages = Field(default_factory=Messages)
    """Messages between supervisor and robots."""
    action: Annotated[dict[SharedName, Action], Size(1, "action")]
    """Actions of the agent, each under a name that you choose: a range, or choices."""
    agent: Agent = Field(default_factory=Agent)
    """How the policy acts: action repeat, frame stack, one policy for all copies."""
    augment: Augmentation = {}
    """Values from the supervisor that the policy may observe, in addition to values that robots send."""
    signals: dict[SharedName, Signal] = {}
    """Helper values for reward, endings and scripts. The policy cannot observe them; list values for the
    policy under `augment`."""
    goal: Goal | None = None
    """The goal of an episode: a value to reach."""
    observation: Annotated[Observation, Size(1, "entry")]
    """Entries of the observation: for each, the name of a value and the range that deepbots maps to [-1, 1].
    The policy gets them in the order of the file."""
    critic: Observation = {}
    """Values that only the critic gets, in training: the value function of the algorithm sees them in
    addition to the observation, the policy does not. They may be signals and parameters, such as a friction
    that was drawn."""
    reward: Annotated[Reward, Size(1, "term")]
    """Terms of the reward, each under a name that you choose. Each term is a plain number; the reward is
    their sum."""
    termination: Termination = Field(default_factory=Termination)
    """Endings of the task: success and failure."""
    truncation: Truncation | None = None
    """Limits that cut an episode short."""
    reset: Reset = Field(default_factory=Reset)
    """How an episode begins."""
    disturbances: dict[SharedName, Disturbance] = {}
    """Pushes and gusts, each under a name that you choose."""
    scripts: dict[LocalName, Script] = {}
    """Hand-written policies, each under a name that you choose: an expression for every part of the
    action."""
    curriculum: Annotated[Annotated[Many[Stage], Size(1, "stage")] | Levels, FORMS] = ()
    """Stages of increasing difficulty, one after the other, or a level for each world."""
    evaluation: Evaluation = Field(default_factory=Evaluation)
    """Evaluation of a trained policy."""
    solved: Annotated[str, Solved()] | None = None
    """When the task is solved: a minimum of `mean_return` or `success_rate` over the last episodes."""
    train: AnyTraining | None = None
    """How the policy is trained. Without it, `deepbots train` chooses the learner."""
    tune: Tune | None = None
    """A search for better values of the scenario."""
    deploy: Deploy | None = None
    """What a real robot needs; with this section, `lint` reports readings of the world that nothing supplies
    (DB617)."""
    ros: dict[Annotated[str, Reference("sensor, reading or actuator")], RosTopic] = {}
    """ROS 2 topics, for `deepbots serve --ros`: of sensors and actuators (`cart.pole_angle`), and of readings
    of the world that no robot measures (`position(ball)`). `deepbots inspect --ros` prints this section with
    a topic for each of them; it is used where there is no entry."""
    tests: dict[LocalName, ScenarioTest] = {}
    """Tests for `deepbots test`, each under a name that you choose: who acts, and the expected result."""
    agents: Annotated[dict[SharedName, AgentOfSeveral], Size(2, "agent")] | None = None
    """Several agents, each with a policy of its own, in place of `action`, `observation`, `reward` and the
    like at the top level."""
    endings: dict[SharedName, Ending] = {}
    """Endings of the task of several agents, each under a name that you choose, in place of `termination`."""
    role: Role | None = None
    """Which of several agents a policy plays, and who acts for the others. Without it, the scenario is that
    of all agents."""

    _pruned: frozenset[NodePath] = PrivateAttr(frozenset())

    @model_validator(mode="wrap")
    @classmethod
    def _leave_sections_to_agents(cls, data: Any, handler: Callable[[Any], Self]) -> Self:
        """With several agents, the sections that a scenario with one requires are in those of the agents."""
        if not isinstance(data, Mapping) or data.get("agents") is None:
            return handler(data)
        missing = {key: value for key, value in _OF_ONE_AGENT.items() if key not in data}
        scenario = handler({**data, **missing})
        for key in missing:
            scenario.__dict__[key] = {}
            scenario.model_fields_set.discard(key)
        return scenario

    @property
    def stages(self) -> tuple[Stage, ...]:
        """The stages of the curriculum; none if it has levels."""
        return () if isinstance(self.curriculum, Levels) else self.curriculum

    @property
    def defines_success(self) -> bool:
        """Whether an ending, a goal or a limit is a success."""
        is_limit = self.truncation is not None and bool(self.truncation.success)
        return bool(self.termination.success) or self.goal is not None or is_limit

    @property
    def levels(self) -> Levels | None:
        """The levels of the curriculum; None if it has stages."""
        return self.curriculum if isinstance(self.curriculum, Levels) else None

    @property
    def pruned(self) -> frozenset[NodePath]:
        """The paths that `validate` removed because they had findings; their names are known, their values
        are not."""
        return self._pruned

    @classmethod
    def from_yaml(cls, path: str | pathlib.Path) -> Self:
        """Load a scenario from a file, including the files that it extends and includes. Paths of other files
        become absolute. Where an agent has some keys of `train`, those at the top level are added.

        Raises:
            ScenarioError: The file has findings at error level.
            UsageError: The file does not exist.
        """
        from deepbots_cli.document import descend, load, shipped, to_data
        from deepbots_cli.errors import ScenarioError
        from deepbots_cli.scenario.validate import validate

        document = load(path)
        root = None if document.root is None else _with_whole_training(document.root)
        scenario = validate(root, document.findings) if root is not None else None
        if root is None or scenario is None or document.findings.errors:
            raise ScenarioError(list(document.findings))
        data: Any = to_data(root)
        for place, kind, value in visit_values(scenario):
            node = descend(root, place)[0]
            file = document.directory_of(node.span) / str(value)
            if isinstance(kind, FilePath) and value not in shipped.robot_names() and file.exists():
                holder = data
                for step in place[:-1]:
                    holder = holder[step]
                holder[place[-1]] = str(file.resolve())
        return cls.model_validate(data)

    def to_yaml(self) -> str:
        """Return the scenario as YAML text, without the values that were not set."""
        import yaml

        # By default, PyYAML sorts the keys and writes other characters than ASCII as escapes.
        return yaml.safe_dump(
            self.model_dump(mode="json", exclude_unset=True), sort_keys=False, allow_unicode=True, width=120
        )

    @classmethod
    def model_json_schema(cls, *args: Any, **kwargs: Any) -> dict[str, Any]:
        """Return the JSON Schema for editors, whatever the arguments."""
        from deepbots_cli.scenario.json_schema import json_schema

        return json_schema()


def _with_whole_training(root: MappingNode) -> MappingNode:
    """Return the scenario in which the `train` of each agent has the keys at the top level too."""
    agents, shared = node_at(root, "agents"), node_at(root, "train")
    if not isinstance(agents, MappingNode) or not isinstance(shared, MappingNode):
        return root
    sections = {}
    for name, entry in agents.entries.items():
        section = entry.value
        train = node_at(entry.value, "train")
        if isinstance(section, MappingNode) and isinstance(train, MappingNode):
            whole = replace(train, entries={**shared.entries, **train.entries})
            training = section.entries["train"]._replace(value=whole)
            section = replace(section, entries={**section.entries, "train": training})
        sections[name] = entry._replace(value=section)
    divided = root.entries["agents"]._replace(value=replace(agents, entries=sections))
    return replace(root, entries={**root.entries, "agents": divided})
