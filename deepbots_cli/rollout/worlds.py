"""Worlds that run side by side, with a row for each agent: single worlds, which are stepped in turn, and the
worlds of a batch, on arrays.

When an episode of a world ends, its next one begins within the same step. A step of a light world costs tens
of microseconds, less than handing it to another process would.
"""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from enum import IntEnum
from operator import itemgetter
from typing import Any, NamedTuple, Protocol, TypedDict, Unpack

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from deepbots_cli.errors import DeepbotsError, UsageError
from deepbots_cli.program import AgentEnding, Member, Program
from deepbots_cli.rollout.episode import (
    Episode,
    EpisodeAccumulator,
    random_state,
    set_number,
    set_random_state,
)
from deepbots_cli.runtime.batch import BatchStep, BatchSupervisor, EpisodeHistory, LostWorld
from deepbots_cli.runtime.spaces import apply_to_parts

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
    """

    on_step: Callable[[], None]
    on_episode: Callable[[int, Episode], None]
    options: Callable[[int], Mapping[str, Any] | None]


class Worlds(ABC):
    """Worlds that run side by side. World i starts from `seeds[i]` at the first reset and continues from
    there.

    There is a row for each agent: one per world, or one for each copy of a robot in a world with several. An
    episode ends for all copies when it ends for one. For the others it is truncated, and `ended_by` is
    `another_copy`.

    Args:
        worlds: The worlds, with their agents.
        seeds: The seed of each.
        on_step, on_episode, options: See `WorldsOptions`.
    """

    def __init__(
        self,
        worlds: Sequence[gym.Env[Any, Any]],
        seeds: Sequence[int],
        *,
        on_step: Callable[[], None] = lambda: None,
        on_episode: Callable[[int, Episode], None] = lambda world, episode: None,
        options: Callable[[int], Mapping[str, Any] | None] = lambda world: None,
    ) -> None:
        self.worlds = worlds
        self.seeds = list(seeds)
        self._on_step = on_step
        self._on_episode = on_episode
        self._options = options
        self._members = _members_of(worlds[0])
        self._agents_alone = [name for name, member in self._members.items() if member.alone]
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
                name: np.array([member.reward(info["reward_terms"]) for info in infos], np.float32)
                for name, member in self._members.items()
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


def _members_of(world: gym.Env[Any, Any]) -> Mapping[str, Member]:
    """Return the agents of a world of several, by name."""
    if not world.has_wrapper_attr("scenario"):
        return {}
    program: Program = world.get_wrapper_attr("scenario")
    return program.members


def observation_digest(observations: Any) -> str:
    """Return the SHA-256 of observations, to the bit."""
    parts = (
        [observations[key] for key in sorted(observations)]
        if isinstance(observations, dict)
        else [observations]
    )
    return hashlib.sha256(b"".join(np.ascontiguousarray(part).tobytes() for part in parts)).hexdigest()


class BatchEpisodes:
    """The running episodes of a batch, which it adds up as `EpisodeAccumulator` does for a single world.
    Worlds may be paused.

    With `by_copy`, there is an episode for each copy of a robot, in the row of the batch, else one for each
    world.
    """

    def __init__(self, batch: BatchSupervisor, *, by_copy: bool = False) -> None:
        self.batch = batch
        self._by_copy = by_copy
        self.resting = np.zeros(len(batch.singles), bool)
        self.clear()

    def clear(self) -> None:
        """Begin all episodes."""
        count = self.batch.count if self._by_copy else len(self.resting)
        self.resting[:] = False
        self.returns = np.zeros(count)
        self._lengths = np.zeros(count, int)
        self._terms = np.zeros((len(self.batch.TERMS), count))

    def step_all(self, actions: Any) -> BatchStep:
        """Act in the worlds that are not paused."""
        outcome = self.batch.advance(actions, self.resting if self.resting.any() else None)
        outcome = outcome if self._by_copy else self.batch.rows.step_by_world(outcome)
        self.add(
            outcome.rewards,
            outcome.terms,
            (~self.resting).repeat(self.batch.copies if self._by_copy else 1),
        )
        return outcome

    def add(self, rewards: Array, terms: Array, running: Any = True) -> None:
        """Count one step of the episodes that are `running` (truth values)."""
        self.returns += np.where(running, rewards, 0.0)
        self._lengths += running
        self._terms += np.where(running, terms, 0.0)

    def close(
        self,
        row: int,
        info: Mapping[str, Any],
        seed: int | None = None,
        draws: Mapping[str, Any] | None = None,
    ) -> Episode:
        """Return the finished episode of a row, given the info of its last step. The next one begins."""
        terms = dict(zip(self.batch.TERMS, self._terms[:, row].tolist(), strict=True))
        total = float(self.returns[row])
        length = int(self._lengths[row])
        self.returns[row] = 0.0
        self._lengths[row] = 0
        self._terms[:, row] = 0.0
        success = info["is_success"]
        ended_by = info["ended_by"]
        ends = info.get("agent_endings", {})
        return Episode(total, length, success, ended_by, terms, seed, draws or {}, ends, info["endings"])

    def repeat(self, histories: Sequence[EpisodeHistory]) -> None:
        """Bring the worlds back to the moment at which `histories` were taken."""
        self.clear()
        self.batch.restore(
            histories, lambda acting: self.add(self.batch.rewards(), self.batch.terms(), acting)
        )


def _phases_of(batch: BatchSupervisor, agent: str) -> Array:
    """Return the phase of one of several agents in each row."""
    ends = batch.agent_ends[agent]
    phases = np.where(ends.steps == batch.step_count, Phase.ENDS, Phase.RESTS)
    return np.where(ends.ended, phases, Phase.ACTS).astype(np.int8)


class LossRecorder(Protocol):
    """Keeps the episodes of a batch that fail; `stage` is the number of the stage of a curriculum.

    `record_failed` raises a `DeepbotsError` once it has found the episode that failed.
    """

    def record_lost(self, stage: int, loss: LostWorld, history: EpisodeHistory) -> None: ...
    def record_failed(self, stage: int, histories: Sequence[EpisodeHistory]) -> None: ...


class BatchWorlds(Worlds):
    """The worlds of a batch.

    In a curriculum, each world enters the next stage when its episode ends. There is a batch for each stage
    of a world, in which the other worlds are paused.

    Args:
        build: Makes the worlds of a stage, by its number; they are closed with this.
        seeds: The seed of each.
        stages: The stage of each, which `next_seed` may change.
        next_seed: Called before a world begins another episode; returns a seed if it begins one of another
            stage.
        recorder: Keeps the episodes of worlds that fail.
        shared: The arguments that single worlds have too.
    """

    def __init__(
        self,
        build: Callable[[int], BatchSupervisor],
        seeds: Sequence[int],
        stages: Sequence[int] | None = None,
        *,
        next_seed: Callable[[int], int | None] = lambda world: None,
        recorder: LossRecorder | None = None,
        **shared: Unpack[WorldsOptions],
    ) -> None:
        self._build = build
        self._next_seed = next_seed
        self._recorder = recorder
        self.stages = [0] * len(seeds) if stages is None else stages
        self._batches: dict[int, BatchEpisodes] = {}
        first = self._batch_of(self.stages[0])
        super().__init__(first.singles, seeds, **shared)
        self._term_places = {
            name: [first.TERMS.index(term) for term in member.terms.values()]
            for name, member in self._members.items()
        }

    def _batch_of(self, stage: int) -> BatchSupervisor:
        """Return the worlds of a stage, built when one of them is first needed."""
        if stage not in self._batches:
            self._batches[stage] = BatchEpisodes(self._build(stage), by_copy=True)
        return self._batches[stage].batch

    def _in(self, stage: int) -> Array:
        """Return the worlds that are in a stage, as truth values."""
        return np.array([world_stage == stage for world_stage in self.stages])

    def _rows_in(self, stage: int) -> Array:
        return self._in(stage).repeat(self._width)

    def reset(self) -> Any:
        for stage in dict.fromkeys(self.stages):
            with self._recording_failures(stage):
                self._reset(self._batch_of(stage))
        for episodes in self._batches.values():
            episodes.clear()
        return self._begun()

    def _reset(self, batch: BatchSupervisor) -> None:
        """Begin an episode in all worlds of a batch, from their first seeds."""
        batch.begin_all(self.seeds, [self._options(world) for world in range(len(self.seeds))])

    def _begun(self) -> Any:
        """Keep the values that each world drew, in its stage. Returns the observations."""
        self.drawn = [self._batch_of(stage).singles[world].drawn() for world, stage in enumerate(self.stages)]
        self.observations = self._observe()
        return self.observations

    def _observe(self) -> Any:
        """Return the observations of each world in its stage."""
        (_, first), *other_batches = self._batches.items()
        observations = first.batch.observations()
        for stage, episodes in other_batches:
            rows = self._rows_in(stage)
            more = episodes.batch.observations()
            for target, source in (
                zip(observations.values(), more.values(), strict=True)
                if isinstance(observations, dict)
                else [(observations, more)]
            ):
                target[rows] = source[rows]
        return observations

    def action_masks(self) -> Array:
        (_, first), *other_batches = self._batches.items()
        masks = first.batch.action_masks()
        for stage, episodes in other_batches:
            rows = self._rows_in(stage)
            masks[rows] = episodes.batch.action_masks()[rows]
        return masks

    def scripted(self, name: str) -> Array:
        (_, first), *other_batches = self._batches.items()
        actions = np.asarray(first.batch.script(name))
        for stage, episodes in other_batches:
            rows = self._rows_in(stage)
            actions[rows] = np.asarray(episodes.batch.script(name))[rows]
        return actions

    def step_all(self, actions: Any) -> WorldsStep:
        rewards, ended = np.zeros(self.rows, np.float32), np.zeros(self.rows, bool)
        agent_rewards = {agent: np.zeros(self.rows, np.float32) for agent in self._term_places}
        phases = {agent: np.zeros(self.rows, np.int8) for agent in self._agents_alone}
        infos: list[dict[str, Any]] = [{}] * self.rows
        ended_rows: dict[int, tuple[int, BatchStep, BatchEpisodes]] = {}
        lost: dict[int, LostWorld] = {}
        for stage, episodes in self._batches.items():
            acting = self._rows_in(stage)
            episodes.resting = ~self._in(stage)
            losses_before = len(episodes.batch.losses)
            with self._recording_failures(stage):
                outcome = episodes.step_all(actions)
            lost |= {loss.world: loss for loss in episodes.batch.losses[losses_before:]}
            rewards[acting] = outcome.rewards[acting]
            for agent, term_rows in self._term_places.items():
                agent_rewards[agent][acting] = outcome.terms[term_rows].sum(axis=0)[acting]
            for agent in self._agents_alone:
                phases[agent][acting] = _phases_of(episodes.batch, agent)[acting]
            ended[outcome.done] = True
            ended_rows |= {row: (index, outcome, episodes) for index, row in enumerate(outcome.done.tolist())}
        begun: dict[int, list[tuple[int, int | None]]] = {}
        endings = []
        for row in range(self.rows):
            self._on_step()
            if row in ended_rows:
                index, outcome, episodes = ended_rows[row]
                infos[row] = outcome.infos[index]
                world = row // self._width
                loss = lost.pop(world, None)
                if loss is not None and self._recorder is not None:
                    history = episodes.batch.histories.snapshot()[world]
                    self._recorder.record_lost(self.stages[world], loss, history)
                episode = episodes.close(
                    row, with_cause(infos[row], outcome.terminated[row] or outcome.truncated[row])
                )
                self._on_episode(world, episode)
                final_observation = apply_to_parts(itemgetter(index), outcome.final_observations)
                endings.append(Ending(row, episode, final_observation, not outcome.terminated[row]))
                # After the last copy of a world, because all copies enter the next stage at once.
                if row + 1 == self._width * (world + 1):
                    seed = self._next_seed(world)
                    begun.setdefault(self.stages[world], []).append((world, seed))
        for stage, beginning in begun.items():
            self._begin_in(stage, beginning)
        # A list, because the loop removes entries of the dictionary.
        for stage in [stage for stage in self._batches if stage not in self.stages]:
            self._batches.pop(stage).batch.close()
        self.observations = self._observe()
        return WorldsStep(self.observations, rewards, ended, infos, endings, agent_rewards, phases)

    @contextmanager
    def _recording_failures(self, stage: int) -> Iterator[None]:
        """Context in which an error of the batch becomes that of the episode which fails, if this is
        found."""
        try:
            yield
        # An action that a world refuses is an error of the policy, which no repeated episode shows.
        except UsageError:
            raise
        except DeepbotsError:
            if self._recorder is not None:
                histories = self._batch_of(stage).histories.snapshot()
                self._recorder.record_failed(
                    stage,
                    [
                        histories[world]
                        for world, world_stage in enumerate(self.stages)
                        if world_stage == stage
                    ],
                )
            raise

    def _begin_in(self, stage: int, beginning: Sequence[tuple[int, int | None]]) -> None:
        """Begin an episode of worlds in a stage. When the first ones enter it, the others are paused in
        it."""
        is_new = stage not in self._batches
        worlds = self._batch_of(stage)
        with self._recording_failures(stage):
            if is_new:
                self._reset(worlds)
            worlds.begin(
                [world for world, _ in beginning],
                [seed for _, seed in beginning],
                [self._options(world) for world, _ in beginning],
            )
        for world, _ in beginning:
            self.drawn[world] = worlds.singles[world].drawn()

    def histories(self) -> list[EpisodeHistory]:
        running = {stage: episodes.batch.histories.snapshot() for stage, episodes in self._batches.items()}
        return [running[stage][world] for world, stage in enumerate(self.stages)]

    def start_of(self, world: int) -> int | dict[str, Any]:
        return self._batch_of(self.stages[world]).histories.starts[world]

    def random_state_of(self, world: int) -> dict[str, Any]:
        return self._batch_of(self.stages[world]).singles[world].random_state()

    def repeat(self, histories: Sequence[EpisodeHistory]) -> Any:
        for stage in dict.fromkeys(self.stages):
            inside = self._in(stage)
            self._batch_of(stage)
            self._batches[stage].repeat(
                [
                    history._replace(options=self._options(world))
                    if inside[world]
                    # A batch has all worlds. Those of other stages get an episode that nobody reads.
                    else EpisodeHistory(self.seeds[world], [])
                    for world, history in enumerate(histories)
                ]
            )
        return self._begun()

    def close(self) -> None:
        for episodes in self._batches.values():
            episodes.batch.close()
