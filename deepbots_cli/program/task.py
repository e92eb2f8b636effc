"""Agents (action, observation, goal, reward, scripts, training), and their shared parts: endings, time
limits, evaluation, and the levels of a curriculum in which each world of a training has its own."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, replace
from functools import cached_property
from itertools import groupby
from typing import Literal, NamedTuple

from deepbots_cli.diagnostics import Span
from deepbots_cli.expressions.scalar import Const, Name, Op, Scalar
from deepbots_cli.program.values import Expression, Noise
from deepbots_cli.program.world import whole_timesteps
from deepbots_cli.records import dataclass
from deepbots_cli.robots.model import Vector
from deepbots_cli.words import unit_text

# Limits of one observation, in numbers and in bytes of images; a network with more inputs is not small.
MAX_OBSERVED_NUMBERS = 100_000
MAX_OBSERVED_BYTES = 10_000_000

SAME_OBSERVATION = 1e-6
"""Numbers of the observation, from -1 to 1, that differ by less are equal."""

MAX_CONDITIONS = 1000
"""The maximum number of conditions of one choice in a script: Python's compiler goes down one level for
each."""


# Action


@dataclass(frozen=True, eq=False)
class Option:
    """An option of a choice: its name, the value of each variable that it sets, and the condition that
    forbids it."""

    name: str
    values: tuple[float, ...]
    forbidden: Expression | None = None


@dataclass(frozen=True, eq=False)
class Choices:
    """A discrete part of the action."""

    name: str
    variables: tuple[str, ...]
    options: tuple[Option, ...]


@dataclass(frozen=True)
class ActionRange:
    """A continuous part of the action: the agent's [-1, 1] maps to [low, high], per component."""

    name: str
    components: tuple[str, ...]
    low: float
    high: float
    unit: str

    @property
    def names(self) -> list[str]:
        """`speed.left` and `speed.right`, or `speed` without components."""
        return [f"{self.name}.{component}" for component in self.components] or [self.name]

    @property
    def variables(self) -> tuple[str, ...]:
        return (self.name,)


ActionPart = Choices | ActionRange


def action_names(action: Sequence[ActionPart]) -> tuple[str, ...]:
    """Return the names of the numbers that the agent itself gives: an option of each choice (one-hot), a
    component of each range.

    The numbers of several parts carry the name of their part; where that makes two alike, all are numbered
    from 1.
    """
    names: list[str] = []
    for part in action:
        inner = (
            [option.name for option in part.options] if isinstance(part, Choices) else list(part.components)
        )
        alone = len(action) == 1 or not inner
        if inner and not alone:
            inner = [f"{part.name}_{name}" for name in inner]
        names += inner or [part.name]
    return (
        tuple(names)
        if len(set(names)) == len(names)
        else tuple(str(number + 1) for number in range(len(names)))
    )


def idle_action(action: Sequence[ActionPart]) -> tuple[list[int], list[float]] | None:
    """Return the action that does nothing: the number of an option for each choice, and a value from -1 to 1
    for each component of a range.

    It is the option of zeros, and the value of a range that is nearest to 0. None where a choice has no
    option of zeros.
    """
    choices, values = [], []
    for part in action:
        if isinstance(part, Choices):
            still = next(
                (number for number, option in enumerate(part.options) if not any(option.values)), None
            )
            if still is None:
                return None
            choices.append(still)
        else:
            nearest = min(max(0.0, part.low), part.high)
            # The inverse of the map from [-1, 1] to [low, high].
            values += [2.0 * (nearest - part.low) / (part.high - part.low) - 1.0] * len(part.names)
    return choices, values


@dataclass(frozen=True)
class RobotCopies:
    """Copies of a robot that share one world and one policy; everything else in the scenario describes one of
    them.

    They are in a row around the place of the robot, each `spacing` (m) from the one before.
    """

    robot: str
    count: int
    spacing: Vector


# Observation


@dataclass(frozen=True, eq=False)
class Observation:
    """An entry of the observation: its value, and the bounds of each component in SI units, which map to [-1,
    1].

    `history` is how many values in a row the policy sees; noise is added before the mapping. Without `clip`,
    values beyond the bounds lie beyond [-1, 1].
    """

    value: Expression
    low: tuple[float, ...]
    high: tuple[float, ...]
    history: int = 1
    clip: bool = True
    noise: Noise | None = None

    @property
    def name(self) -> str:
        return self.value.name

    @cached_property
    def numbers(self) -> tuple[ObservedNumber, ...]:
        """One per component."""
        value_type = self.value.typed.type
        components = value_type.components or (None,)
        stds = self.noise.std.scalars if self.noise else (None,) * len(components)
        rows = zip(components, self.value.scalars, self.low, self.high, stds, strict=True)
        return tuple(
            ObservedNumber(
                self.name,
                part,
                scalar,
                low,
                high,
                str(value_type.dimension),
                value_type.boolean,
                self.history,
                self.clip,
                std,
                self.noise,
            )
            for part, scalar, low, high, std in rows
        )


class ImageObservation(Observation):
    """An image that the policy sees: uint8 of `shape` (rows, columns, channels), with its history side by
    side as channels.

    It has no bounds and no noise.
    """

    @property
    def shape(self) -> tuple[int, ...]:
        return self.value.typed.type.picture or ()

    @property
    def key(self) -> str:
        """The key in the observation space; torch does not allow dots."""
        return self.name.replace(".", "_")

    @property
    def numbers(self) -> tuple[ObservedNumber, ...]:
        return ()

    def ages(self, stack: int = 1) -> tuple[int, ...]:
        """The number of steps ago at which each image that the policy sees was the newest, oldest first."""
        return tuple(back + ago for back in reversed(range(stack)) for ago in reversed(range(self.history)))


class ObservedNumber(NamedTuple):
    """One number of the observation; a truth value is 0 or 1. `std` is the tree of the standard deviation of
    `noise`."""

    name: str
    component: str | None
    scalar: Scalar
    low: float
    high: float
    unit: str
    is_truth: bool
    history: int
    clip: bool
    std: Scalar | None
    noise: Noise | None

    @property
    def full_name(self) -> str:
        return self.name if self.component is None else f"{self.name}.{self.component}"


@dataclass(frozen=True)
class ObservedValue:
    """A number that the policy sees: its name, its unit (SI), and the range in this unit that maps to [-1,
    1].

    A truth value (`truth`) is 0 or 1 and has no range to map. `steps_ago` is 0 for the present value, more
    for an older one. Values beyond the range are `clipped` to it, or lie beyond [-1, 1].
    """

    name: str
    unit: str
    low: float
    high: float
    truth: bool = False
    steps_ago: int = 0
    clipped: bool = True


# Goal, endings, limits


@dataclass(frozen=True, eq=False)
class Goal:
    """The achieved and the desired goal, apart from the observation, with the bounds of both per component.

    The policy sees both mapped from [low, high] to [-1, 1] and clipped. In rewards, the names `achieved` and
    `desired` mean the clipped values, so that a reward can be recomputed from an observation. The goal is
    reached when the two are within `tolerance` of each other. The noise on the achieved goal is added before
    the mapping.
    """

    achieved: Expression
    desired: Expression
    low: tuple[float, ...]
    high: tuple[float, ...]
    tolerance: float

    @property
    def components(self) -> tuple[str, ...]:
        return self.achieved.components

    @property
    def unit(self) -> str:
        return str(self.achieved.typed.type.dimension)

    @property
    def values(self) -> tuple[ObservedValue, ...]:
        """The numbers of a goal, with the range of each."""
        rows = zip(self.components or ("goal",), self.low, self.high, strict=True)
        return tuple(ObservedValue(name, self.unit, low, high) for name, low, high in rows)

    @cached_property
    def middles(self) -> tuple[float, ...]:
        """The middle of the range of each component, which the policy sees as 0."""
        return tuple((high + low) / 2 for low, high in zip(self.low, self.high, strict=True))

    @cached_property
    def halves(self) -> tuple[float, ...]:
        """Half of the range of each component, which the policy sees as 1."""
        return tuple((high - low) / 2 for low, high in zip(self.low, self.high, strict=True))

    @cached_property
    def targets(self) -> tuple[Scalar, ...]:
        """The tree of the desired goal, per component."""
        desired = self.desired.scalars
        return desired * (len(self.achieved.scalars) // len(desired))

    def names(self, which: Literal["achieved", "desired"]) -> tuple[Name, ...]:
        return tuple(Name(which, component) for component in self.components or (None,))

    @property
    def reached(self) -> Scalar:
        """Whether the two are within `tolerance` of each other."""
        apart = tuple(
            Op("sub", pair) for pair in zip(self.names("achieved"), self.names("desired"), strict=True)
        )
        return Op(
            "less_equal", (Op("hypot", apart) if len(apart) > 1 else Op("abs", apart), Const(self.tolerance))
        )


@dataclass(frozen=True)
class Truncation:
    """Limits that are not part of the task: agent steps, simulated seconds."""

    max_steps: int | None = None
    max_time: float | None = None

    @property
    def limits(self) -> tuple[str, ...]:
        """The names of the limits that there are."""
        return tuple(name for name in ("max_steps", "max_time") if getattr(self, name) is not None)

    def timesteps(self, timestep: float, action_repeat: int) -> dict[str, int]:
        """Return the number of timesteps, of `timestep` s each, after which each limit ends an episode; it
        may be within a step of the agent."""
        ticks = {}
        if self.max_steps is not None:
            ticks["max_steps"] = self.max_steps * action_repeat
        if self.max_time is not None:
            ticks["max_time"] = max(1, whole_timesteps(self.max_time, timestep))
        return ticks

    def max_episode_steps(self, period: float) -> int:
        """Return the steps of the agent, of `period` s each, after which an episode is cut short at the
        latest."""
        time = [whole_timesteps(self.max_time, period)] if self.max_time else []
        return max(1, min([self.max_steps or 2**63, *time]))


# Scripts


@dataclass(frozen=True, eq=False)
class ScriptedChoice:
    """A choice of a script: the first option whose condition holds, and `otherwise` if none does."""

    branches: tuple[tuple[str, Expression], ...]
    otherwise: str

    @property
    def options(self) -> tuple[str, ...]:
        return (*(option for option, _ in self.branches), self.otherwise)

    @property
    def values(self) -> tuple[Expression, ...]:
        return tuple(condition for _, condition in self.branches)

    @property
    def scalars(self) -> tuple[Scalar, ...]:
        """The condition of each option but the last."""
        return tuple(condition.scalar for condition in self.values)


@dataclass(frozen=True, eq=False)
class ScriptedRange:
    """The decision of a script for a range of `size` numbers: one expression for all components, or one for
    each.

    Values are in the unit of the range, to whose ends they are clamped.
    """

    values: tuple[Expression, ...]
    size: int

    @property
    def scalars(self) -> tuple[Scalar, ...]:
        """One per number of the range."""
        scalars = tuple(scalar for value in self.values for scalar in value.scalars)
        return scalars * self.size if len(scalars) == 1 else scalars


@dataclass(frozen=True, eq=False)
class Script:
    """A policy that is written in the scenario: a decision for each part of the action, in their order."""

    name: str
    parts: tuple[ScriptedChoice | ScriptedRange, ...]

    @property
    def scalars(self) -> tuple[Scalar, ...]:
        return tuple(scalar for part in self.parts for scalar in part.scalars)


# Tests


@dataclass(frozen=True)
class FixedAction:
    """A constant action: the index of an option of each choice, and a number in [-1, 1] for each component of
    the ranges.

    `text` is the form for `deepbots try --driver`.
    """

    choices: tuple[int, ...]
    ranges: tuple[float, ...]
    text: str


ExpectedKey = Literal["success_rate", "failure_rate", "mean_return", "ends_by", "always", "eventually"]


@dataclass(frozen=True, eq=False)
class ExpectedResult:
    """An expected result, its place and its text in the file.

    A rate or a return is expected from `low` to `high`; one of the `endings` is expected to end every
    episode; a `condition` has the values that it compares, which a failed test shows.
    """

    key: ExpectedKey
    span: Span
    text: str
    low: float = -math.inf
    high: float = math.inf
    endings: tuple[str, ...] = ()
    condition: Expression | None = None
    compared: tuple[Expression, ...] = ()


@dataclass(frozen=True, eq=False)
class ScenarioTest:
    """Episodes without a trained policy, and the expected results.

    The driver is the name of a script, `random`, `zero`, or a sequence of actions. `steps` is the largest
    number of steps of an episode. With several agents, `agent` is the one whose results are expected;
    `drivers` has the name of the driver of each, unless all act by a sequence of actions.
    """

    name: str
    span: Span
    driver: str | tuple[FixedAction, ...]
    episodes: int
    seed: int
    steps: int
    expected: tuple[ExpectedResult, ...]
    case: str | None = None
    stage: str | None = None
    agent: str | None = None
    drivers: Mapping[str, str] = field(default_factory=dict)

    @property
    def conditions(self) -> tuple[ExpectedResult, ...]:
        return tuple(entry for entry in self.expected if entry.condition is not None)

    @property
    def scalars(self) -> tuple[Scalar, ...]:
        """The conditions."""
        return tuple(entry.condition.scalar for entry in self.expected if entry.condition is not None)

    @property
    def compared(self) -> tuple[Scalar, ...]:
        """The compared values of all conditions in a row."""
        return tuple(value.scalar for entry in self.conditions for value in entry.compared)


# Training


ACTIVATIONS = {
    "elu": "ELU",
    "gelu": "GELU",
    "leaky_relu": "LeakyReLU",
    "relu": "ReLU",
    "silu": "SiLU",
    "tanh": "Tanh",
}
"""The classes of `torch.nn` by the names of activations."""


@dataclass(frozen=True)
class Network:
    """Hidden layers of actor and critic, and their activation."""

    hidden: tuple[int, ...] = (64, 64)
    activation: str = "tanh"


@dataclass(frozen=True)
class Schedule:
    """A value that goes linearly from `start` to `end` over the training."""

    start: float
    end: float

    @property
    def text(self) -> str:
        """The schedule as a scenario writes it, such as `0.3 -> 0.1`, or its only value."""
        return f"{self.start:g}" if self.start == self.end else f"{self.start:g} -> {self.end:g}"

    def at(self, progress: float) -> float:
        """Return the value at a progress of the training, from 0 to 1."""
        return self.start + min(1.0, progress) * (self.end - self.start)


@dataclass(frozen=True)
class AdaptiveRate:
    """A learning rate that begins at `start`, and follows the KL divergence of the policy to the target
    `kl`."""

    kl: float
    start: float


@dataclass(frozen=True)
class Hyperparameter:
    """A hyperparameter, under the algorithm's own name for it."""

    name: str
    value: bool | int | float | str | Schedule | AdaptiveRate | None


@dataclass(frozen=True)
class ActionNoise:
    """Noise on the actions while training; `sigma` is its standard deviation in the agent's [-1, 1], `theta`
    is per step."""

    type: Literal["normal", "ornstein_uhlenbeck"]
    sigma: Schedule
    theta: float = 0.15


@dataclass(frozen=True)
class Hindsight:
    """Hindsight experience replay: `goals` made-up goals per step, from later in the episode, its end, or
    anywhere in it."""

    goals: int = 4
    strategy: Literal["future", "final", "episode"] = "future"


@dataclass(frozen=True)
class Teacher:
    """A script from which the policy learns first.

    Attributes:
        share: The largest share of all timesteps in which the policy only imitates the script.
    """

    script: str
    share: float = 0.3


@dataclass(frozen=True)
class SelfPlay:
    """One policy for two equal agents, which plays against itself and against past versions of itself.

    Attributes:
        every: The number of steps after which the present policy becomes a member of the pool.
        pool: The largest number of members.
        newest: The share of the worlds in which the policy plays against itself.
        scripts: The share of the worlds in which it plays against scripts.
        has_default_interval: Whether `every` is that of a training of this length.
    """

    every: int
    pool: int
    newest: float
    scripts: float = 0.0
    has_default_interval: bool = False

    @staticmethod
    def default_interval(total_timesteps: int) -> int:
        """Return the default of `every`: 20 policies of a training become members."""
        return max(1, total_timesteps // 20)


@dataclass(frozen=True)
class Mirror:
    """A permutation of numbers with signs, between the ranges that map to [-1, 1].

    The mirror image of `values` is `factors[i] * values[sources[i]] + offsets[i]`. An offset is not 0 only
    where a range is not symmetric about 0.
    """

    sources: tuple[int, ...]
    factors: tuple[float, ...]
    offsets: tuple[float, ...]


@dataclass(frozen=True)
class Symmetry:
    """The mirror images of an observation and of an action. Each is its own inverse.

    Attributes:
        observation: The mirror image of the numbers of the observation, with those of the critic.
        ranges: The mirror image of the ranges of the action.
        choices: The choice from which each choice of the action gets its mirror image.
        options: For each choice, the option that is the mirror image of each option of its source.
    """

    observation: Mirror
    ranges: Mirror
    choices: tuple[int, ...] = ()
    options: tuple[tuple[int, ...], ...] = ()


@dataclass(frozen=True)
class Training:
    algorithm: str
    total_timesteps: int
    environments: int = 1
    hyperparameters: tuple[Hyperparameter, ...] = ()
    network: Network = Network()
    action_noise: ActionNoise | None = None
    replay: Hindsight | None = None
    normalize: Literal["reward"] | None = None
    device: Literal["auto", "cpu", "cuda"] = "cpu"
    shards: int = 1
    teacher: Teacher | None = None
    staleness: int = 0
    patience: int | None = None
    symmetry: Symmetry | None = None
    agents: tuple[tuple[str, Training], ...] = ()
    self_play: SelfPlay | None = None
    turns: int | None = None

    def with_total(self, total_timesteps: int) -> Training:
        """Return the training, and those of its agents, with another number of steps."""
        self_play = self.self_play
        if self_play is not None and self_play.has_default_interval:
            self_play = replace(self_play, every=SelfPlay.default_interval(total_timesteps))
        agents = tuple((name, training.with_total(total_timesteps)) for name, training in self.agents)
        return replace(self, total_timesteps=total_timesteps, self_play=self_play, agents=agents)


# Agent

ONLY_AGENT = "agent"
"""The name of the one agent of a scenario."""


@dataclass(frozen=True)
class Solved:
    """The criterion for a solved task, over `episodes` consecutive episodes."""

    episodes: int
    mean_return: float | None = None
    success_rate: float | None = None

    @property
    def thresholds(self) -> str:
        """`mean return >= 195`."""
        returns = "" if self.mean_return is None else f"mean return >= {self.mean_return:g}"
        rate = "" if self.success_rate is None else f"success rate >= {100 * self.success_rate:g} %"
        return " and ".join(filter(None, (returns, rate)))

    @property
    def description(self) -> str:
        """`mean return >= 195 over 100 episodes`."""
        return f"{self.thresholds} over {self.episodes} episodes"

    def is_met(self, mean_return: float, success_rate: float) -> bool:
        """Return whether means over enough episodes reach every threshold of the criterion."""
        return (self.mean_return is None or mean_return >= self.mean_return) and (
            self.success_rate is None or success_rate >= self.success_rate
        )


@dataclass(frozen=True, eq=False)
class Agent:
    """The action, observation, goal and reward of one agent, and its training.

    `robots` are the robots that the action commands. The agent sees `frame_stack` observations in a row, and
    the goal if there is one. `reward` has the terms, whose sum is the reward. `success` names the endings
    that are a success of the agent; all others are failures. With `copies`, the agent acts for each copy of a
    robot. `scripts` are hand-written policies for the same action. `critic` has the values that only the
    value function of the learner gets.
    """

    name: str
    robots: tuple[str, ...]
    action: tuple[ActionPart, ...]
    observation: tuple[Observation, ...]
    reward: tuple[Expression, ...]
    success: tuple[str, ...] = ()
    goal: Goal | None = None
    solved: Solved | None = None
    frame_stack: int = 1
    copies: RobotCopies | None = None
    scripts: tuple[Script, ...] = ()
    training: Training | None = None
    critic: tuple[Observation, ...] = ()

    @property
    def with_critic(self) -> Agent:
        """The agent whose observation has the values of the critic at its end, as in the worlds of a
        training."""
        return replace(self, observation=(*self.observation, *self.critic)) if self.critic else self

    @property
    def policy_columns(self) -> tuple[int, ...] | None:
        """The places of the numbers that the policy sees, in an observation with the values of the critic;
        None if the observation has no others."""
        hidden = {entry.name for entry in self.critic}
        if not any(entry.name in hidden for entry in self.observation):
            return None
        return tuple(
            column for column, (index, _) in enumerate(self.seen) if self.numbers[index].name not in hidden
        )

    @cached_property
    def numbers(self) -> tuple[ObservedNumber, ...]:
        """The numbers of one frame of the observation, apart from images."""
        return tuple(number for entry in self.observation for number in entry.numbers)

    @cached_property
    def seen(self) -> tuple[tuple[int, int], ...]:
        """The index of each number that the policy sees, and how many steps ago it was read, in the order of
        the policy.

        The frames of the stack come oldest first; in each, the named values in file order, each with its
        history, oldest first, and within that its components.
        """
        groups = [
            list(group)
            for _, group in groupby(range(len(self.numbers)), key=lambda index: self.numbers[index].name)
        ]
        return tuple(
            (index, back + ago)
            for back in reversed(range(self.frame_stack))
            for group in groups
            for ago in reversed(range(self.numbers[group[0]].history))
            for index in group
        )

    @property
    def newest(self) -> list[int]:
        """The index of the newest value of each number among those that the policy sees."""
        return [column for column, (_, age) in enumerate(self.seen) if age == 0]

    @cached_property
    def inputs(self) -> tuple[ObservedValue, ...]:
        """The numbers that the policy sees, in their order in its observation."""
        entries = [(self.numbers[index], age) for index, age in self.seen]
        return tuple(
            ObservedValue(n.full_name, unit_text(n.unit), n.low, n.high, n.is_truth, age, n.clip)
            for n, age in entries
        )

    @property
    def discount(self) -> float:
        """The discount factor of the training, per step; 0.99 is the default of every algorithm."""
        hyperparameters = self.training.hyperparameters if self.training else ()
        return next(
            (
                float(entry.value)
                for entry in hyperparameters
                if entry.name == "gamma" and isinstance(entry.value, int | float)
            ),
            0.99,
        )

    @property
    def choices(self) -> tuple[Choices, ...]:
        return tuple(part for part in self.action if isinstance(part, Choices))

    @property
    def ranges(self) -> tuple[ActionRange, ...]:
        return tuple(part for part in self.action if isinstance(part, ActionRange))

    @property
    def range_names(self) -> tuple[str, ...]:
        """The names of the components of all ranges."""
        return tuple(name for part in self.ranges for name in part.names)

    @property
    def images(self) -> tuple[ImageObservation, ...]:
        return tuple(entry for entry in self.observation if isinstance(entry, ImageObservation))


# Evaluation


@dataclass(frozen=True)
class Evaluation:
    episodes: int = 100


@dataclass(frozen=True)
class Criterion:
    """The end of a stage of the curriculum: a mean reaches `threshold`, or `threshold` steps are taken.

    The mean is over the last `episodes` training episodes of the stage, rounded up to equally many of each
    world; with None, over one evaluation.
    """

    metric: Literal["success_rate", "mean_return", "steps"]
    threshold: float
    episodes: int | None = 1


# Levels


LIMITS = ("max_steps", "max_time")
"""The names of the limits of an episode."""
SUCCESS = "success"
"""The outcome of an episode that has reached its goal when a limit ends it. An ending, and a limit that is
a success itself, has its own name."""


@dataclass(frozen=True)
class Levels:
    """Levels from 0, the easiest, up, and how a world changes its own.

    Attributes:
        count: The number of levels.
        values: The value of each parameter in each level, in SI units, by the name of its draw.
        start: The lowest and the highest level in which worlds begin.
        up: The outcomes after which the next episode is one level higher: names of endings and limits, and
            `SUCCESS`.
        down: The outcomes after which it is one level lower.
        is_random_at_top: Whether `up` in the highest level leads to a random level.
        per_world: The name of a draw, and its values (SI units), of which each world has one for the whole
            training; none without it.
    """

    count: int
    values: tuple[tuple[str, tuple[float, ...]], ...]
    start: tuple[int, int]
    up: frozenset[str]
    down: frozenset[str]
    is_random_at_top: bool
    per_world: tuple[str, tuple[float, ...]] | None = None

    def digest_fields(self) -> dict[str, object]:
        # The order of a set of texts differs between processes.
        fields = {**vars(self), "up": tuple(sorted(self.up)), "down": tuple(sorted(self.down))}
        if self.per_world is None:  # The digests of files without it stay.
            del fields["per_world"]
        return fields

    def first(self, world: int) -> int:
        """Return the level in which a world begins: the levels from the lowest to the highest, in turn, and
        all values of `per_world` in each of them."""
        low, high = self.start
        turns = 1 if self.per_world is None else len(self.per_world[1])
        return low + world // turns % (high - low + 1)

    def settings(self, world: int, level: int) -> Mapping[str, float]:
        """Return the values of the draws of a world in a level, as `options` of `reset`."""
        return {name: values[level] for name, values in self.values} | self.settings_of(world)

    def settings_of(self, world: int) -> dict[str, float]:
        """Return the value of `per_world` that a world has in all levels."""
        if self.per_world is None:
            return {}
        name, values = self.per_world
        return {name: values[world % len(values)]}

    def next(self, level: int, outcomes: Sequence[str], draw: Callable[[], int]) -> int:
        """Return the level after an episode.

        Args:
            level: The level of the episode.
            outcomes: The outcome of the episode, for each copy of a robot that ended it. `down` has
                precedence.
            draw: Returns a random whole number from 0 up, for a random level.
        """
        if not self.down.isdisjoint(outcomes):
            return max(0, level - 1)
        if self.up.isdisjoint(outcomes):
            return level
        if level < self.count - 1:
            return level + 1
        return draw() % self.count if self.is_random_at_top else level
