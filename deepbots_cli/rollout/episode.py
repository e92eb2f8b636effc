"""An episode: `steps` yields a `Step` for the reset and for each step of the environment, and `result_of`
adds them up.

for step in steps(environment, random_driver(environment), Start(seed=3)):
    print(step.number, step.reward)
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import field, replace
from typing import TYPE_CHECKING, Any, NamedTuple

from pydantic import NonNegativeInt

from deepbots_cli.errors import DeepbotsError
from deepbots_cli.program import AgentEnding, Member
from deepbots_cli.records import dataclass

if TYPE_CHECKING:
    import gymnasium as gym


OnEpisode = Callable[[int, int], None]
"""Called after each episode with the number of completed episodes, and of all."""


class Start(NamedTuple):
    """The start of an episode.

    Attributes:
        seed: The seed of the reset; None continues the random generators.
        options: The values that the reset takes instead of drawing them.
        number: The number of the episode in an evaluation, from 0.
        state: The states of the random generators before the reset, as `random_state` returns them.
    """

    seed: int | None = None
    options: Mapping[str, Any] | None = None
    number: int | None = None
    state: dict[str, Any] | None = None

    @classmethod
    def of_evaluation(cls, root: int, number: int, options: Mapping[str, Any] | None = None) -> Start:
        """Return the start of episode `number`, from 0, of an evaluation with the seed `root`."""
        # Commands that only read runs work without gymnasium.
        from deepbots_cli.runtime.streams import (
            derive_seed,
        )

        return cls(derive_seed(root, "evaluation", number), options, number)


class Driver:
    """Acts in an episode: returns an action for each observation.

    `note` is a text about the driver for the user.
    """

    note = ""

    def __init__(self, act: Callable[[Any], Any]) -> None:
        self._act = act

    def begin(self, start: Start) -> None:
        """Called before the reset of an episode."""

    def act(self, observation: Any) -> Any:
        """Return the next action, in the action space."""
        return self._act(observation)


class Step(NamedTuple):
    """The reset (`number` 0, without action and reward), or a step of the environment; names as in
    Gymnasium."""

    number: int
    action: Any
    observation: Any
    reward: float
    terminated: bool
    truncated: bool
    info: dict[str, Any]

    @property
    def is_last(self) -> bool:
        return self.terminated or self.truncated


def steps(world: gym.Env[Any, Any], driver: Driver, start: Start = Start()) -> Iterator[Step]:
    """Run an episode; the caller may stop at any step.

    Raises:
        DeepbotsError: The environment raised it.
    """
    if start.state is not None:
        set_random_state(world, start.state)
    driver.begin(start)
    if start.number is not None:
        set_number(world, start.number)
    observation, info = world.reset(
        seed=start.seed, options=None if start.options is None else dict(start.options)
    )
    step = Step(0, None, observation, 0.0, False, False, info)
    yield step
    while not (step.terminated or step.truncated):
        action = driver.act(step.observation)
        observation, reward, terminated, truncated, info = world.step(action)
        step = Step(step.number + 1, action, observation, float(reward), terminated, truncated, info)
        yield step


def play(world: gym.Env[Any, Any], driver: Driver, start: Start = Start()) -> Episode:
    """Run an episode to its end.

    Raises:
        DeepbotsError: A reward is not finite, or the environment raised it.
    """
    return result_of(steps(world, driver, start), start.seed)


def set_number(world: gym.Env[Any, Any], number: int) -> None:
    """Let policies that act for other agents in the next episode act as in the episode of this number."""
    from deepbots_cli.runtime.agents import AgentEnvironment

    if isinstance(world.unwrapped, AgentEnvironment):
        world.unwrapped.number = number


def random_state(world: gym.Env[Any, Any]) -> dict[str, Any]:
    """Return the states of all random generators of a world, in a form for JSON."""
    if world.has_wrapper_attr("random_state"):
        state: dict[str, Any] = world.get_wrapper_attr("random_state")()
        return state
    return dict(world.unwrapped.np_random.bit_generator.state)


def set_random_state(world: gym.Env[Any, Any], state: dict[str, Any]) -> None:
    """Restore what `random_state` returned; the next reset without a seed begins from it."""
    if world.has_wrapper_attr("set_random_state"):
        world.get_wrapper_attr("set_random_state")(state)
    else:
        world.unwrapped.np_random.bit_generator.state = state


# Results


@dataclass(frozen=True)
class Episode:
    """A finished episode; `terms` are the reward terms, summed over it. `endings` are all endings that held in
    its last step, of which `ended_by` is the first. `agent_endings` are the ends of the episodes of those
    among several agents whose episode ended before.

    For an episode of an evaluation, `seed` is the seed of its reset, and `drawn` contains the drawn values in
    SI units by their path in the scenario, such as `parameters.mark` (see `Supervisor.reset`).
    """

    total_return: float
    length: NonNegativeInt
    is_success: bool
    ended_by: str | None
    terms: Mapping[str, float] = field(default_factory=dict)
    seed: int | None = None
    drawn: Mapping[str, float | str] = field(default_factory=dict)
    agent_endings: Mapping[str, AgentEnding] = field(default_factory=dict)
    endings: tuple[str, ...] = ()


class EpisodeAccumulator:
    """Adds up the running episode."""

    def __init__(self) -> None:
        self._return = 0.0
        self._length = 0
        self._terms: dict[str, float] = {}
        self._seed: int | None = None
        self._drawn: Mapping[str, float | str] = {}

    @property
    def length(self) -> int:
        """The number of steps so far."""
        return self._length

    def begin(self, seed: int | None, info: Mapping[str, Any]) -> None:
        """Begin an episode with the seed of the reset, and the info that it returned."""
        self._seed = seed
        self._drawn = info.get("drawn", {})

    def add(self, reward: float, info: Mapping[str, Any]) -> None:
        """Count one step.

        Raises:
            DeepbotsError: The reward is not finite; the message names the terms at fault.
        """
        terms = info.get("reward_terms", {})
        if not math.isfinite(reward):
            at_fault = (
                ", ".join(name for name, value in terms.items() if not math.isfinite(value)) or "their sum"
            )
            raise DeepbotsError(
                f"the reward is no longer finite in step {self._length + 1} of an episode ({at_fault})"
            )
        self._return += reward
        self._length += 1
        sums = self._terms
        for name, value in terms.items():
            sums[name] = sums.get(name, 0.0) + value

    def close(self, info: Mapping[str, Any]) -> Episode:
        """Return the finished episode, given the info of its last step. The next one begins."""
        success = bool(info.get("is_success", False))
        ended_by = info.get("ended_by")
        episode = Episode(
            self._return,
            self._length,
            success,
            ended_by,
            self._terms,
            self._seed,
            self._drawn,
            info.get("agent_endings", {}),
            info.get("endings", ()),
        )
        self._return = 0.0
        self._length = 0
        self._terms = {}
        self._seed = None
        self._drawn = {}
        return episode


def result_of(steps: Iterable[Step], seed: int | None = None) -> Episode:
    """Add up the steps of an episode, from its reset on; `ended_by` is None if they stop before its end.

    Raises:
        DeepbotsError: A reward is not finite, or the environment raised it.
    """
    accumulator = EpisodeAccumulator()
    for step in steps:
        if step.number:
            accumulator.add(step.reward, step.info)
        else:
            accumulator.begin(seed, step.info)
    return accumulator.close(step.info)


# Several agents


def own_episode(member: Member, episode: Episode) -> Episode:
    """Return an episode as it was for an agent: its return, its reward terms, its length, and whether it
    succeeded."""
    terms = {name: episode.terms[joint] for name, joint in member.terms.items() if joint in episode.terms}
    agent_episode = replace(episode, total_return=sum(terms.values()), terms=terms)
    end = episode.agent_endings.get(member.name)
    if end is not None:
        return replace(agent_episode, length=end.step, is_success=end.is_success, ended_by=end.endings[0])
    # The log of a training, and evaluations of earlier versions, have the first ending alone.
    first = () if episode.ended_by is None else (episode.ended_by,)
    return replace(agent_episode, is_success=member.has_succeeded(episode.endings or first))
