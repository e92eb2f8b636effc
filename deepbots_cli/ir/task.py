"""What the agent does and sees, what it is paid for, when an episode ends."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from deepbots_cli.lang.scalar import Scalar

Outcome = Literal["success", "failure"]


@dataclass(frozen=True)
class Option:
    """One choice of a discrete action: its name and the value of each variable that it sets."""

    name: str
    values: tuple[float, ...]


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
    """One number of the observation, mapped from [low, high] to [-1, 1] and clipped; a truth value is 0 or 1."""

    name: str
    component: str | None
    value: Scalar
    low: float
    high: float
    unit: str
    truth: bool = False

    @property
    def full_name(self) -> str:
        return self.name if self.component is None else f"{self.name}.{self.component}"


@dataclass(frozen=True)
class Term:
    """A named summand of the reward."""

    name: str
    value: Scalar


@dataclass(frozen=True)
class Ending:
    """A condition that terminates the episode."""

    name: str
    outcome: Outcome
    condition: Scalar


@dataclass(frozen=True)
class Truncation:
    """Limits that are no part of the task: agent steps, simulated seconds."""

    max_steps: int | None = None
    max_time: float | None = None


@dataclass(frozen=True)
class Agent:
    """How the policy is joined to the scenario.

    One action of the agent is held for `repeat` control ticks, which make one step; it sees `stack`
    observations in a row.
    """

    repeat: int = 1
    stack: int = 1
