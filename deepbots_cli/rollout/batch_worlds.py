"""The worlds of a batch on arrays, with a row for each agent."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from operator import itemgetter
from typing import Any, Protocol, Unpack

import numpy as np

from deepbots_cli.errors import DeepbotsError, UsageError
from deepbots_cli.rollout.episode import Episode
from deepbots_cli.rollout.worlds import (
    Array,
    Ending,
    Phase,
    Worlds,
    WorldsOptions,
    WorldsStep,
    with_cause,
)
from deepbots_cli.runtime.batch import BatchStep, BatchSupervisor, EpisodeHistory, LostWorld
from deepbots_cli.runtime.spaces import apply_to_parts


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
        return Episode(total, length, success, ended_by, terms, seed, draws or {}, ends)

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
            agent: [first.TERMS.index(name) for name in names] for agent, names in self._agent_terms.items()
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
        for stage, episodes in self._batches.items():
            acting = self._rows_in(stage)
            episodes.resting = ~self._in(stage)
            losses_before = len(episodes.batch.losses)
            with self._recording_failures(stage):
                outcome = episodes.step_all(actions)
            if self._recorder is not None:
                for loss in episodes.batch.losses[losses_before:]:
                    self._recorder.record_lost(stage, loss, episodes.batch.histories.snapshot()[loss.world])
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
