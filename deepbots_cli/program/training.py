"""How the policy is trained and judged."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Solved:
    """What counts as solved, over `episodes` consecutive episodes."""

    episodes: int
    mean_return: float | None = None
    success_rate: float | None = None


@dataclass(frozen=True)
class Policy:
    """Hidden layers of actor and critic, and their activation."""

    hidden: tuple[int, ...] = (64, 64)
    activation: str = "tanh"


@dataclass(frozen=True)
class Schedule:
    """A value that goes linearly from `start` to `end` over the training."""

    start: float
    end: float


@dataclass(frozen=True)
class Hyperparameter:
    """A hyperparameter, under the algorithm's own name for it."""

    name: str
    value: bool | int | float | str | Schedule | None


@dataclass(frozen=True)
class ActionNoise:
    """Noise on the actions while training; `sigma` is its standard deviation in the agent's [-1, 1], `theta` is per step."""

    type: Literal["normal", "ornstein_uhlenbeck"]
    sigma: Schedule
    theta: float = 0.15


@dataclass(frozen=True)
class Hindsight:
    """Hindsight experience replay: `goals` made-up goals per step, from later in the episode, its end, or anywhere in it."""

    goals: int = 4
    strategy: Literal["future", "final", "episode"] = "future"


@dataclass(frozen=True)
class Training:
    algorithm: str
    total_timesteps: int
    environments: int = 1
    hyperparameters: tuple[Hyperparameter, ...] = ()
    policy: Policy = Policy()
    action_noise: ActionNoise | None = None
    replay: Hindsight | None = None


@dataclass(frozen=True)
class Evaluation:
    episodes: int = 100


@dataclass(frozen=True)
class Criterion:
    """When a stage of the curriculum is done: a mean over its last `episodes` episodes is reached, or `threshold` steps are taken."""

    metric: Literal["success_rate", "mean_return", "steps"]
    threshold: float
    episodes: int = 1
