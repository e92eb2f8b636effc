"""The sections of the task: what an agent does, sees and is rewarded for, alone or among several; how an
episode begins, is disturbed and ends; the evaluation, `tune`, and the tests of a scenario.
"""

from typing import Annotated, Any, ClassVar, Literal

from deepbots_cli.scenario.base import FORMS, KeyCount, Many, Section, Size
from deepbots_cli.scenario.fields import (
    BodyName,
    Bool,
    LocalName,
    PlainText,
    Reference,
    Scalar,
    SharedName,
    Text,
)
from deepbots_cli.scenario.quantities import (
    Bounds,
    Expression,
    Length,
    PositiveInt,
    Quantity,
    Range,
    Share,
    Signal,
    SmallInt,
    Solved,
    Thickness,
    WholeNumber,
)
from deepbots_cli.scenario.search import SearchField
from deepbots_cli.scenario.training import AnyTraining, EndingNames, Settings
from deepbots_cli.scenario.world import Pose

PYTHON_PATH = Text(
    "a function as `package.module:function`",
    r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*",
    "package.module:function",
)
Choice = Annotated[Scalar, Quantity("any")]
Noise = Annotated[Scalar, Quantity("any", known="episode", relative=True, minimum=0)]


class PythonTerm(Section):
    """A term that a Python function of an installed package computes. deepbots runs it only with
    `--allow-code` (`Permissions(code=True)`)."""

    python: Annotated[str, PYTHON_PATH]
    """The function, `package.module:function`."""


class ContinuousAction(Section):
    """Numbers in [-1, 1] that the policy chooses and deepbots maps to a range."""

    range: Annotated[str, Range("any")]
    """The range of the action, such as `0.25 .. 1`: -1 is mapped to its lower end, 1 to its upper end."""
    each: Annotated[str, Reference("group")] | None = None
    """A group or an actuator: the action has one number for each of its members."""


class DiscreteAction(Section):
    """A choice of one of several options."""

    identifying_keys: ClassVar[frozenset[str]] = frozenset({"choices", "forbid"})

    choices: Annotated[
        dict[LocalName, Annotated[dict[SharedName, Choice] | Choice, FORMS]], Size(2, "choice")
    ]
    """The options by name. Each option has a number, or sets several variables: `{ahead: {left: 1, right: 1},
    stop: {left: 0, right: 0}}`."""
    forbid: dict[Annotated[str, Reference("choice")], Annotated[str, Expression("forbid", boolean=True)]] = {}
    """Conditions by option: while its condition is true, the policy must not choose the option."""


Action = Annotated[DiscreteAction | ContinuousAction | Annotated[str, Range("any")], FORMS]


class Agent(Section):
    """How the policy acts in the scenario."""

    action_repeat: SmallInt = 1
    """Number of timesteps for which the environment applies each action."""
    frame_stack: SmallInt = 1
    """Number of consecutive observations that the policy gets at once."""
    each: Annotated[str, Reference("robot")] | None = None
    """A robot with several copies: one shared policy controls each copy separately."""


class Observed(Section):
    """One entry of the observation, with further settings besides its range."""

    range: Annotated[str, Range("any", auto=True, vector=True)]
    """The range that deepbots maps to [-1, 1], such as `-0.4 .. 0.4 m`. `auto` uses the range that deepbots
    derives, for example from joint limits."""
    history: SmallInt = 1
    """Number of consecutive values that the policy gets at once, newest last."""
    noise: Noise = 0
    """Standard deviation of added noise, such as `0.01 rad`, or `2 %` of the value."""
    clip: Bool = True
    """Whether values outside the range are clipped to it."""


class Goal(Section):
    """The goal of an episode, for hindsight experience replay."""

    achieved: Annotated[Scalar, Expression("goal", boolean=False)]
    """The value that the agent has reached."""
    desired: Annotated[Scalar, Expression("goal", boolean=False)]
    """The value to reach."""
    tolerance: Annotated[Scalar, Quantity("any", minimum=0)]
    """Largest distance between `achieved` and `desired` at which the goal is reached."""
    range: Annotated[str, Range("any", vector=True)]
    """Range of `achieved` and `desired`, which is mapped to [-1, 1] in the observation."""
    noise: Noise = 0
    """Standard deviation of the noise on `achieved`: in the unit of `achieved`, such as `5 mm`, or as `2 %`
    of the value."""


Condition = Annotated[PythonTerm | Annotated[str, Expression("ending", boolean=True)], FORMS]


Decision = Annotated[
    Annotated[
        dict[Annotated[str, Reference("choice")], Annotated[Scalar | bool, Expression("script")]],
        Size(1, "option"),
    ]
    | Annotated[Scalar, Expression("script", boolean=False)],
    FORMS,
]
Script = Annotated[dict[Annotated[str, Reference("action")], Decision], Size(1, "action")]


class Measured(Section):
    """A value that the supervisor measures with noise. Every expression that uses the name reads the same
    noisy value."""

    value: Signal
    """The exact value."""
    noise: Noise = 0
    """Standard deviation of the noise: in the unit of the value, such as `2 mm`, or as `2 %` of the value."""


Augmentation = Annotated[
    Many[Annotated[str, Reference("parameter or signal")]]
    | dict[SharedName, Annotated[Measured | Signal, FORMS]],
    FORMS,
]
Reward = dict[LocalName, Annotated[PythonTerm | Annotated[Scalar, Expression("reward")], FORMS]]
Observation = dict[
    Annotated[str, Reference("value")],
    Annotated[Observed | Annotated[str, Range("any", auto=True, vector=True)], FORMS],
]


# Several agents

ALL_AGENTS = "all"
"""The word that names all agents."""
AgentName = Annotated[str, Reference("agent")]
AgentNames = Annotated[Annotated[Many[AgentName], Size(1, "agent")] | AgentName, FORMS]


class AgentOfSeveral(Section):
    """One of several agents, each with its own policy: the robots that it drives, what it does, what it sees,
    and its reward. Its keys mean the same as at the top level of a scenario with one agent."""

    key_rules: ClassVar[tuple[KeyCount, ...]] = (KeyCount(("like", "robots"), min=1, max=2),)

    like: AgentName | None = None
    """An agent that this one mirrors: it has the same keys, in which the names of the two agents and of their
    robots change places. Keys beside `like` replace its keys."""
    robots: Annotated[Many[Annotated[str, Reference("robot")]], Size(1, "robot")] = ()
    """The robots that the agent drives. With `like`, by default those whose names contain the name of the
    agent where the others contain that of the mirrored agent."""
    policy: AgentName | None = None
    """An agent that this one mirrors exactly, and with which it has one policy: both act by it, and it learns
    from both. By default, an agent has a policy of its own."""
    frame_stack: SmallInt = 1
    """Number of consecutive observations that the policy gets at once."""
    action: dict[SharedName, Action] = {}
    """Actions of the agent, each under a name that you choose: a range, or choices."""
    augment: Augmentation = {}
    """Values from the supervisor that the policy of this agent may observe."""
    signals: dict[SharedName, Signal] = {}
    """Helper values of this agent, for its reward and its scripts."""
    observation: Observation = {}
    """Entries of the observation: for each, the name of a value and the range that deepbots maps to [-1,
    1]."""
    critic: Observation = {}
    """Values that only the critic of this agent gets, in training."""
    reward: Reward = {}
    """Terms of the reward of this agent, each under a name that you choose."""
    scripts: dict[LocalName, Script] = {}
    """Hand-written policies of this agent, each under a name that you choose."""
    solved: Annotated[str, Solved()] | None = None
    """When the task of this agent is solved."""
    train: AnyTraining | None = None
    """How the policy of this agent is trained."""


class Ending(Section):
    """A condition that ends the task of agents, and what it is for each of them."""

    when: Condition
    """The condition."""
    ends: AgentNames = ALL_AGENTS
    """The agents whose episode ends: names such as `left`, or `all`. Others go on; the episode of the world
    ends with that of the last agent."""
    success: AgentNames = ()
    """The agents that have then succeeded: names, or `all`."""
    failure: AgentNames = ()
    """The agents that have then failed: names, or `all`."""


class Role(Section):
    """One of several agents, which a policy plays beside the others."""

    agent: AgentName
    """The agent that is trained and evaluated; `--agent` sets it."""
    others: dict[AgentName, Annotated[str, Reference("driver")]] = {}
    """Who acts for each other agent: one of its scripts, `random`, `zero`, or the policy of a run by the path
    of the run or of one of its models. `--against` sets it. Default: the first script of the agent, else
    `random`."""


# Episodes


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

    key_rules: ClassVar[tuple[KeyCount, ...]] = (KeyCount(("layouts", "place")),)

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
    every: Annotated[Scalar, Quantity("time", known="step", minimum=1e-3)] | None = None
    """Time from the beginning of one push to the beginning of the next. It is also the time before the first
    push, unless `at` is given."""
    at: Annotated[Scalar, Quantity("time", known="episode", minimum=0)] | None = None
    """Start time of the first push. Without `every`, there is only this push."""
    duration: Annotated[Scalar, Quantity("time", known="step", minimum=0)]
    """Duration of a push."""


# Evaluation


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
