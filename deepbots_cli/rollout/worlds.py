"""Worlds that run side by side, with a row for each agent; single worlds, which are stepped in turn.

When an episode of a world ends, its next one begins within the same step. A step of a light world costs tens
of microseconds, less than handing it to another process would.
"""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from enum import IntEnum
from types import MappingProxyType
from typing import Any, NamedTuple, TypedDict, Unpack

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from deepbots_cli.program import AgentEnding
from deepbots_cli.rollout.episode import (
    Episode,
    EpisodeAccumulator,
    random_state,
    set_number,
    set_random_state,
)
from deepbots_cli.runtime.batch import EpisodeHistory

Array = NDArray[Any]
ENDED_BY_ANOTHER_COPY = "another_copy"
"""The value of `ended_by` if another copy of the robot ended the episode."""
Outcome = tuple[Any, float, bool, bool, dict[str, Any]]
"""The result of a step, as Gymnasium returns it: observation, reward, terminated, truncated, info."""


class Ending(NamedTuple):
    """The last step of an episode in a row; the next episode has begun."""

    row: int
    episode: Episode
    observation: Any
    timed_out: bool


class WorldsStep(NamedTuple):
    """A step of all rows. The observations are those on which the agents act next. A batch has infos of ended
    episodes only. With several agents in a world, `agent_rewards` are the rewards of each, whose sum is
    `rewards`, and `agent_phases` the phases of those whose episode may end while others go on."""

    observations: Any
    rewards: Array
    ended: Array
    infos: list[dict[str, Any]]
    endings: list[Ending]
    agent_rewards: Mapping[str, Array] = {}
    agent_phases: Mapping[str, Array] = {}


class Phase(IntEnum):
    """The part that one of several agents has in a step."""

    ACTS = 0
    ENDS = 1
    """Its episode ends with the step, while others go on."""
    RESTS = 2
    """Its episode has ended before."""

    @classmethod
    def of(cls, end: AgentEnding | None, step: int) -> Phase:
        """Return the phase in a step of the episode of the world, given the end of that of the agent."""
        if end is None:
            return cls.ACTS
        return cls.ENDS if end.step == step else cls.RESTS


AgentTerms = Mapping[str, Sequence[str]]
"""The names of the reward terms of each of several agents in a world; empty for one agent."""
ONE_AGENT: AgentTerms = MappingProxyType({})


class HistoryRecorder(gym.Wrapper[Any, Any, Any, Any]):
    """A world with the `history` of its running episode, from which the episode can be repeated."""

    def __init__(self, world: gym.Env[Any, Any]) -> None:
        super().__init__(world)
        self.history = EpisodeHistory(0, [])

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        self.history = EpisodeHistory(random_state(self.env) if seed is None else seed, [], options)
        return self.env.reset(seed=seed, options=options)

    def step(self, action: Any) -> Outcome:
        self.history.actions.append(action)
        return self.env.step(action)  # type: ignore[return-value]  # a reward of any number


class WorldsOptions(TypedDict, total=False):
    """The arguments that single worlds and batches share.

    Attributes:
        on_step: Called after the step of each row.
        on_episode: Called after each episode of a row with the number of its world.
        options: Returns the values that the next episode of a world takes in place of draws, as `options` of
            `reset`.
        agent_terms: The reward terms of each of several agents, for `agent_rewards` of each step.
        agents_alone: Those among several agents whose episode may end while others go on.
    """

    on_step: Callable[[], None]
    on_episode: Callable[[int, Episode], None]
    options: Callable[[int], Mapping[str, Any] | None]
    agent_terms: AgentTerms
    agents_alone: Sequence[str]


class Worlds(ABC):
    """Worlds that run side by side. World i starts from `seeds[i]` at the first reset and continues from
    there.

    There is a row for each agent: one per world, or one for each copy of a robot in a world with several. An
    episode ends for all copies when it ends for one. For the others it is truncated, and `ended_by` is
    `another_copy`.

    Args:
        worlds: The worlds, with their agents.
        seeds: The seed of each.
        on_step, on_episode, options, agent_terms, agents_alone: See `WorldsOptions`.
    """

    def __init__(
        self,
        worlds: Sequence[gym.Env[Any, Any]],
        seeds: Sequence[int],
        *,
        on_step: Callable[[], None] = lambda: None,
        on_episode: Callable[[int, Episode], None] = lambda world, episode: None,
        options: Callable[[int], Mapping[str, Any] | None] = lambda world: None,
        agent_terms: AgentTerms = ONE_AGENT,
        agents_alone: Sequence[str] = (),
    ) -> None:
        self.worlds = worlds
        self.seeds = list(seeds)
        self._on_step = on_step
        self._on_episode = on_episode
        self._options = options
        self._agent_terms = agent_terms
        self._agents_alone = agents_alone
        self._has_copies = has_copies(worlds[0])
        first = self._agents_of(worlds[0])
        self._width = len(first)
        self.rows = self._width * len(worlds)
        self.observation_space, self.action_space = first[0].observation_space, first[0].action_space
        self.drawn: list[Mapping[str, Any]] = [{} for _ in worlds]
        """The values that the running episode of each world drew, by name."""
        self.observations: Any = None
        """The observations on which the agents act next; None before the first reset."""

    def _agents_of(self, world: gym.Env[Any, Any]) -> list[Any]:
        """Return the agents of a world, one per row. A world with a single agent is its own agent, so that
        its wrappers act too."""
        return list(world.get_wrapper_attr("agents").values()) if self._has_copies else [world]

    @property
    def agents(self) -> list[Any]:
        """The agent of each row."""
        return [agent for world in self.worlds for agent in self._agents_of(world)]

    @abstractmethod
    def action_masks(self) -> Array | None:
        """Return which options are allowed in each row; None if the worlds have no masks."""

    @abstractmethod
    def scripted(self, name: str) -> Array:
        """Return the next action of a script of the scenario in each world, in the action space."""

    @abstractmethod
    def reset(self) -> Any:
        """Begin the first episodes, or once more from the seeds. Returns the observations."""

    @abstractmethod
    def step_all(self, actions: Any) -> WorldsStep:
        """Act in all rows."""

    @abstractmethod
    def histories(self) -> list[EpisodeHistory]:
        """Return the running episode of each world, from which it can be repeated."""

    @abstractmethod
    def start_of(self, world: int) -> int | dict[str, Any]:
        """Return the start of the running episode of a world, as in its history."""

    @abstractmethod
    def random_state_of(self, world: int) -> dict[str, Any]:
        """Return the present states of the random generators of a world."""

    @abstractmethod
    def repeat(self, histories: Sequence[EpisodeHistory]) -> Any:
        """Bring the worlds back to the moment at which `histories` were taken. Returns the observations,
        which are the same if the physics is."""

    @abstractmethod
    def close(self) -> None:
        """Close the worlds."""


class SingleWorlds(Worlds):
    """Single worlds, stepped in turn.

    Args:
        worlds: The worlds, which are closed with this.
        seeds: The seed of each.
        next_world: Called before a world begins its next episode. It may return a replacement world and its
            seed.
        shared: The arguments that batches have too.
    """

    worlds: list[HistoryRecorder]

    def __init__(
        self,
        worlds: Sequence[gym.Env[Any, Any]],
        seeds: Sequence[int],
        *,
        next_world: Callable[[int], tuple[gym.Env[Any, Any], int] | None] = lambda world: None,
        **shared: Unpack[WorldsOptions],
    ) -> None:
        super().__init__([_recorded(world) for world in worlds], seeds, **shared)
        self._next_world = next_world
        self._accumulators = [EpisodeAccumulator() for _ in range(self.rows)]
        self._keys = (
            list(self.observation_space.spaces)
            if isinstance(self.observation_space, gym.spaces.Dict)
            else None
        )

    def action_masks(self) -> Array | None:
        agents = self.agents
        if not agents[0].has_wrapper_attr("action_masks"):
            return None
        return np.stack([agent.get_wrapper_attr("action_masks")() for agent in agents])

    def scripted(self, name: str) -> Array:
        return np.stack([np.asarray(world.get_wrapper_attr("script")(name)) for world in self.worlds])

    def reset(self) -> Any:
        return self.repeat([EpisodeHistory(seed, []) for seed in self.seeds])

    def step_all(self, actions: Any) -> WorldsStep:
        observations: list[Any] = []
        rewards = []
        ended = []
        infos = []
        endings = []
        lengths: list[int] = []
        for index in range(len(self.worlds)):
            action = (
                actions[index * self._width : (index + 1) * self._width]
                if self._has_copies
                else actions[index]
            )
            outcomes, has_ended = self._act(index, action)
            world_observations = []
            for row, (observation, reward, terminated, truncated, info) in enumerate(
                outcomes, index * self._width
            ):
                reward = float(reward)
                accumulator = self._accumulators[row]
                accumulator.add(reward, info)
                lengths.append(accumulator.length)
                self._on_step()
                if has_ended:
                    episode = accumulator.close(with_cause(info, terminated or truncated))
                    self._on_episode(index, episode)
                    endings.append(Ending(row, episode, observation, not terminated))
                world_observations.append(observation)
                rewards.append(reward)
                ended.append(has_ended)
                infos.append(info)
            observations += self._begin_next(index) if has_ended else world_observations
        self.observations = self._stack(observations)
        return WorldsStep(
            self.observations,
            np.array(rewards, dtype=np.float32),
            np.array(ended, dtype=bool),
            infos,
            endings,
            {
                agent: np.array(
                    [sum(info["reward_terms"][name] for name in names) for info in infos], np.float32
                )
                for agent, names in self._agent_terms.items()
            },
            {agent: self._phases(agent, infos, lengths) for agent in self._agents_alone},
        )

    @staticmethod
    def _phases(agent: str, infos: Sequence[Mapping[str, Any]], steps: Sequence[int]) -> Array:
        """Return the phase of an agent in each row."""
        ends = [info["agent_endings"].get(agent) for info in infos]
        return np.array([Phase.of(end, step) for end, step in zip(ends, steps, strict=True)], np.int8)

    def _act(self, index: int, action: Any) -> tuple[list[Outcome], bool]:
        """Make a step of a world. Returns the outcome of each row, and whether the episode is over."""
        world = self.worlds[index]
        observation, reward, terminated, truncated, info = world.step(action)
        has_ended = terminated or truncated
        if not self._has_copies:
            return [(observation, float(reward), terminated, truncated, info)], has_ended
        return [
            (a.get_observations(), a.get_reward(), *a.is_done(), a.get_info()) for a in self._agents_of(world)
        ], has_ended

    def _begin_next(self, index: int) -> list[Any]:
        """Begin the next episode of a world, or the first episode of its replacement."""
        following = self._next_world(index)
        if following is None:
            return self._begin(index, None)
        self.worlds[index].close()
        world, seed = following
        self.worlds[index] = _recorded(world)
        return self._begin(index, seed)

    def _begin(self, index: int, seed: int | None) -> list[Any]:
        """Begin an episode. Returns the observation of each row."""
        world = self.worlds[index]
        set_number(world, index)
        options = self._options(index)
        observation, info = world.reset(seed=seed, options=None if options is None else dict(options))
        self.drawn[index] = info.get("drawn", {})
        return (
            [agent.get_observations() for agent in self._agents_of(world)]
            if self._has_copies
            else [observation]
        )

    def _stack(self, observations: list[Any]) -> Any:
        if self._keys is None:
            return np.array(observations)
        return {key: np.array([observation[key] for observation in observations]) for key in self._keys}

    def histories(self) -> list[EpisodeHistory]:
        return [world.history for world in self.worlds]

    def start_of(self, world: int) -> int | dict[str, Any]:
        return self.worlds[world].history.start

    def random_state_of(self, world: int) -> dict[str, Any]:
        return random_state(self.worlds[world])

    def repeat(self, histories: Sequence[EpisodeHistory]) -> Any:
        self._accumulators = [EpisodeAccumulator() for _ in self._accumulators]
        observations: list[Any] = []
        for index, history in enumerate(histories):
            seed = history.start if isinstance(history.start, int) else None
            if isinstance(history.start, dict):
                set_random_state(self.worlds[index], history.start)
            world_observations = self._begin(index, seed)
            for action in history.actions:
                # A history belongs to a running episode, so none of its actions ends the episode.
                outcomes, _ = self._act(index, action)
                for row, (_, reward, _, _, info) in enumerate(outcomes, index * self._width):
                    self._accumulators[row].add(float(reward), info)
                world_observations = [outcome[0] for outcome in outcomes]
            observations += world_observations
        self.observations = self._stack(observations)
        return self.observations

    def close(self) -> None:
        for world in self.worlds:
            world.close()


def with_cause(info: dict[str, Any], ended: bool) -> dict[str, Any]:
    """Return the info of the last step. If the own episode of the agent has not `ended`, another copy ended
    it, and `ended_by` says so."""
    return info if ended else {**info, "ended_by": ENDED_BY_ANOTHER_COPY}


def _recorded(world: gym.Env[Any, Any]) -> HistoryRecorder:
    return world if isinstance(world, HistoryRecorder) else HistoryRecorder(world)


def has_copies(world: gym.Env[Any, Any]) -> bool:
    """Return whether the agents of the world are copies of a robot, and not the world itself."""
    return (
        world.has_wrapper_attr("agents") and world.unwrapped not in world.get_wrapper_attr("agents").values()
    )


def observation_digest(observations: Any) -> str:
    """Return the SHA-256 of observations, to the bit."""
    parts = (
        [observations[key] for key in sorted(observations)]
        if isinstance(observations, dict)
        else [observations]
    )
    return hashlib.sha256(b"".join(np.ascontiguousarray(part).tobytes() for part in parts)).hexdigest()
