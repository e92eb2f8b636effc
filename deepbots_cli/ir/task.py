"""What the agent does and sees, what it is paid for, when an episode ends."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Literal

from deepbots_cli.expressions.scalar import Const, Name, Op, Scalar
from deepbots_cli.ir.values import Noise
from deepbots_cli.robots.model import Vector

Outcome = Literal["success", "failure"]

# What one observation may hold, in numbers and in bytes of pictures; a network with more inputs is no small one.
MOST_SEEN = 100_000
MOST_SEEN_BYTES = 10_000_000


@dataclass(frozen=True)
class Option:
    """One choice of a discrete action: its name, the value of each variable that it sets, and when it may not be chosen."""

    name: str
    values: tuple[float, ...]
    forbidden: Scalar | None = None


@dataclass(frozen=True)
class Choices:
    """A discrete part of the action."""

    name: str
    variables: tuple[str, ...]
    options: tuple[Option, ...]


@dataclass(frozen=True)
class Interval:
    """A continuous part of the action: the agent's [-1, 1] maps to [low, high], per component."""

    name: str
    components: tuple[str, ...]
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class Observed:
    """One number of the observation, mapped from [low, high] to [-1, 1] and clipped; a truth value is 0 or 1.

    `history` is how many values in a row the policy sees; noise is added before the mapping.
    """

    name: str
    component: str | None
    value: Scalar
    low: float
    high: float
    unit: str
    truth: bool = False
    history: int = 1
    clip: bool = True
    noise: Noise | None = None

    @property
    def full_name(self) -> str:
        return self.name if self.component is None else f"{self.name}.{self.component}"


@dataclass(frozen=True)
class Pictured:
    """A picture that the policy sees: uint8 of `shape` (rows, columns, channels), with its history side by side as channels."""

    name: str
    value: Scalar
    shape: tuple[int, ...]
    history: int = 1

    @property
    def key(self) -> str:
        """Where it stands in the observation; torch takes no dots."""
        return self.name.replace(".", "_")

    def ages(self, stack: int = 1) -> tuple[int, ...]:
        """How many steps ago each picture that the policy sees was the newest, oldest first."""
        return tuple(back + ago for back in reversed(range(stack)) for ago in reversed(range(self.history)))


def viewed(observation: Sequence[Observed], stack: int = 1) -> tuple[tuple[int, int], ...]:
    """Of every number that the policy sees, in its order: the index of the entry, and how many steps ago.

    The frames of the stack come oldest first; in each, the named values in file order, each with its
    history, oldest first, and within that its components.
    """
    named = [list(group) for _, group in groupby(range(len(observation)), key=lambda index: observation[index].name)]
    return tuple(
        (index, back + ago)
        for back in reversed(range(stack))
        for group in named
        for ago in reversed(range(observation[group[0]].history))
        for index in group
    )


def own_action(action: Sequence[Choices | Interval]) -> tuple[str, ...]:
    """The names of the numbers that the agent itself gives: an option of each choice (one-hot), a component of each range.

    Those of several parts carry the name of their part; where that makes two alike, all are numbered from 1.
    """
    names: list[str] = []
    for part in action:
        inner = [option.name for option in part.options] if isinstance(part, Choices) else list(part.components)
        alone = len(action) == 1 or not inner
        names += [part.name] if not inner else inner if alone else [f"{part.name}_{name}" for name in inner]
    return tuple(names) if len(set(names)) == len(names) else tuple(str(number + 1) for number in range(len(names)))


@dataclass(frozen=True)
class Goal:
    """Where the agent has got and where it shall get, told apart from the observation; one value per component, or one.

    The policy sees both mapped from [low, high] to [-1, 1] and clipped. The names `achieved` and `desired`
    mean what is left of them there, so that a reward can be recomputed from what was seen.
    """

    components: tuple[str, ...]
    achieved: tuple[Scalar, ...]
    desired: tuple[Scalar, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    within: float
    unit: str

    def names(self, which: Literal["achieved", "desired"]) -> tuple[Name, ...]:
        return tuple(Name(which, component) for component in self.components or (None,))

    @property
    def reached(self) -> Scalar:
        """Whether the two are `within` of each other."""
        apart = tuple(Op("sub", pair) for pair in zip(self.names("achieved"), self.names("desired"), strict=True))
        return Op("less_equal", (Op("hypot", apart) if len(apart) > 1 else Op("abs", apart), Const(self.within)))


@dataclass(frozen=True)
class MeasuredGoal(Goal):
    """A goal whose `achieved` has noise, one per component, which is added before the mapping."""

    noise: tuple[Noise, ...] = ()


@dataclass(frozen=True)
class Foreign:
    """A function of an installed package, which is called with the supervisor."""

    module: str
    function: str

    def __str__(self) -> str:
        return f"{self.module}:{self.function}"


@dataclass(frozen=True)
class Term:
    """A named summand of the reward; where it is `foreign`, the value does not count."""

    name: str
    value: Scalar
    foreign: Foreign | None = None


@dataclass(frozen=True)
class Ending:
    """A condition that terminates the episode; where it is `foreign`, the condition here does not count."""

    name: str
    outcome: Outcome
    condition: Scalar
    foreign: Foreign | None = None


@dataclass(frozen=True)
class Truncation:
    """Limits that are no part of the task: agent steps, simulated seconds."""

    max_steps: int | None = None
    max_time: float | None = None

    def most_steps(self, period: float) -> int:
        """Steps of the agent, of `period` s each, after which an episode is cut short at the latest."""
        time = [math.ceil(self.max_time / period - 1e-9)] if self.max_time else []
        return max(1, min([self.max_steps or 2**63, *time]))


@dataclass(frozen=True)
class Copies:
    """Copies of a robot that share one world and one policy; all else in the scenario is said of one of them.

    They stand in a row around the place of the robot, each `spacing` (m) from the one before.
    """

    robot: str
    count: int
    spacing: Vector


@dataclass(frozen=True)
class Agent:
    """How the policy is joined to the scenario.

    One action of the agent is held for `repeat` control ticks, which make one step; it sees `stack`
    observations in a row. `each` lets it act for every copy of a robot.
    """

    repeat: int = 1
    stack: int = 1
    each: Copies | None = None
