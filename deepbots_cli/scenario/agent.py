"""What an agent does, sees and is rewarded for: of the only agent of a scenario, or of one among several."""

from typing import Annotated, ClassVar

from deepbots_cli.scenario.base import FORMS, KeyCount, Many, Section, Size
from deepbots_cli.scenario.fields.base import Scalar
from deepbots_cli.scenario.fields.names import Bool, LocalName, Reference, SharedName, Text
from deepbots_cli.scenario.fields.quantities import Expression, Quantity, Range, Signal, SmallInt
from deepbots_cli.scenario.fields.training import Solved
from deepbots_cli.scenario.training import AnyTraining

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
