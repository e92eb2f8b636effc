"""Batches of worlds as a vector environment of Stable-Baselines3."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any, cast

import numpy as np
import numpy.typing as npt
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn

from deepbots_cli import api, engines
from deepbots_cli.codegen import batch_obstacles
from deepbots_cli.errors import DeepbotsError, UsageError
from deepbots_cli.learning.environments import VectorEnvironment, WorldFactory, last_info
from deepbots_cli.learning.failures import BatchFailureRecorder
from deepbots_cli.program import Program
from deepbots_cli.rollout import Episode
from deepbots_cli.runtime.batch import BatchStep, BatchSupervisor, EpisodeHistory

MIN_WORLDS = 8
"""Worlds from which on a batch is faster: what it does per step over arrays takes as long as 5 single worlds."""


def reasons_against_batch(program: Program, worlds: int, engine: str, build: WorldFactory) -> list[str]:
    """Why a training steps its worlds one by one; nothing where they are a batch."""
    if engine not in engines.BATCHES:
        return [f"the engine '{engine}' has no batches"]
    if worlds < MIN_WORLDS:
        return [f"there are fewer than {MIN_WORLDS} worlds"]
    own = [] if getattr(build, "func", None) is api.build else ["its worlds are made by a function of the caller"]
    stages = [stage.program for stage in program.curriculum]
    return list(dict.fromkeys([*own, *(reason for one in (program, *stages) for reason in batch_obstacles(one))]))


def stepping_text(program: Program, worlds: int, engine: str, build: WorldFactory) -> str:
    """Whether a training steps its worlds as a batch, and why not; empty where no batch is to be expected."""
    if engine not in engines.BATCHES or worlds < MIN_WORLDS:
        return ""
    reasons = reasons_against_batch(program, worlds, engine, build)
    how = f"one by one: {'; '.join(reasons)}" if reasons else "together, as a batch"
    return f"{program.name} steps its {worlds} worlds {how}"


class BatchEpisodeAccumulator:
    """Adds up the running episodes of a batch, as `EpisodeAccumulator` does for a single world."""

    def __init__(self, batch: BatchSupervisor) -> None:
        self._names, self._count = batch.TERMS, batch.count
        self.clear()

    def clear(self) -> None:
        self._returns, self._lengths = np.zeros(self._count), np.zeros(self._count, int)
        self._terms = np.zeros((len(self._names), self._count))

    def add(self, rewards: npt.NDArray[Any], terms: npt.NDArray[Any], running: Any = True) -> None:
        """Count one step of the worlds that are `running` (truth values)."""
        self._returns += np.where(running, rewards, 0.0)
        self._lengths += running
        self._terms += np.where(running, terms, 0.0)

    def close(self, world: int, info: Mapping[str, Any], seed: int | None = None, drawn: Mapping[str, Any] | None = None) -> Episode:
        """The finished episode of a world, given the info of its last step; the next one begins."""
        terms = dict(zip(self._names, self._terms[:, world].tolist(), strict=True))
        total, length = float(self._returns[world]), int(self._lengths[world])
        self._returns[world], self._lengths[world], self._terms[:, world] = 0.0, 0, 0.0
        return Episode(total, length, info["is_success"], info["ended_by"], terms, seed, drawn or {})


class BatchVectorEnvironment(VectorEnvironment):
    """The worlds of a batch, a row each; world i starts from `seeds[i]` at the first reset and runs on from there.

    In a curriculum, each world enters the next stage when its episode ends. There is a batch for each stage that worlds are in; the
    others rest in it.

    Args:
        build: Makes the worlds of a stage, by its number; they are closed with this.
        seeds: The seed of each.
        stages: The stage of each, which `next_seed` may change.
        on_step: Called after the step of each row.
        on_episode: Called after each episode of a row with the number of its world.
        next_seed: Called before a world begins another episode; gives a seed if it begins one of another stage.
        recorder: Keeps the episodes of worlds that fail.
    """

    def __init__(
        self,
        build: Callable[[int], BatchSupervisor],
        seeds: Sequence[int],
        stages: Sequence[int] | None = None,
        *,
        on_step: Callable[[], None] = lambda: None,
        on_episode: Callable[[int, Episode], None] = lambda world, episode: None,
        next_seed: Callable[[int], int | None] = lambda world: None,
        recorder: BatchFailureRecorder | None = None,
    ) -> None:
        self._build, self._next_seed, self._recorder = build, next_seed, recorder
        self.stages = [0] * len(seeds) if stages is None else stages
        self._batches: dict[int, tuple[BatchSupervisor, BatchEpisodeAccumulator]] = {}
        first = self._batch_of(self.stages[0])
        super().__init__(first.singles, seeds, on_step=on_step, on_episode=on_episode)

    def _batch_of(self, stage: int) -> BatchSupervisor:
        """The worlds of a stage, built when one of them is first needed."""
        if stage not in self._batches:
            made = self._build(stage)
            self._batches[stage] = made, BatchEpisodeAccumulator(made)
        return self._batches[stage][0]

    def _in(self, stage: int) -> npt.NDArray[np.bool_]:
        """The worlds that are in a stage, as truth values."""
        return np.array([own == stage for own in self.stages])

    def reset(self) -> VecEnvObs:
        for stage in dict.fromkeys(self.stages):
            with self._recording_failures(stage):
                self._batch_of(stage).reset(self.starts)
        for _, sums in self._batches.values():
            sums.clear()
        self.drawn = [self._batch_of(stage).singles[world].drawn() for world, stage in enumerate(self.stages)]
        self.last_observations = self._observations()
        return self.last_observations

    def _observations(self) -> VecEnvObs:
        """Of each world in its stage."""
        (_, (first, _)), *others = self._batches.items()
        seen = first.observations()
        for stage, (worlds, _) in others:
            rows, more = self._in(stage), worlds.observations()
            for mine, other in zip(seen.values(), more.values(), strict=True) if isinstance(seen, dict) else [(seen, more)]:
                mine[rows] = other[rows]
        return cast(VecEnvObs, seen)

    def step_wait(self) -> VecEnvStepReturn:
        rewards, dones = np.zeros(self.num_envs, np.float32), np.zeros(self.num_envs, bool)
        infos: list[dict[str, Any]] = [_EMPTY_INFO] * self.num_envs
        ended: dict[int, tuple[int, BatchStep, BatchEpisodeAccumulator]] = {}
        for stage, (worlds, sums) in self._batches.items():
            acting = self._in(stage)
            known = len(worlds.losses)
            with self._recording_failures(stage):
                outcome = worlds.advance(self._actions, None if acting.all() else ~acting)
            if self._recorder is not None:
                for loss in worlds.losses[known:]:
                    self._recorder.record_lost(stage, loss, worlds.snapshot()[loss.world])
            sums.add(outcome.rewards, outcome.terms, acting)
            rewards[acting] = outcome.rewards[acting]
            dones[outcome.done] = True
            ended |= {world: (place, outcome, sums) for place, world in enumerate(outcome.done.tolist())}
        begun: dict[int, list[tuple[int, int | None]]] = {}
        for world in range(self.num_envs):
            self._on_step()
            if world in ended:
                infos[world] = self._close(world, *ended[world])
                seed = self._next_seed(world)
                begun.setdefault(self.stages[world], []).append((world, seed))
        for stage, beginning in begun.items():
            self._begin_in(stage, beginning)
        for stage in [stage for stage in self._batches if stage not in self.stages]:
            self._batches.pop(stage)[0].close()
        self.last_observations = self._observations()
        return self.last_observations, rewards, dones, infos

    @contextmanager
    def _recording_failures(self, stage: int) -> Iterator[None]:
        """Within, an error of the batch becomes that of the episode which fails, if this is found."""
        try:
            yield
        except UsageError:
            raise
        except DeepbotsError:
            if self._recorder is not None:
                histories = self._batch_of(stage).snapshot()
                self._recorder.record_failed(stage, [histories[world] for world, own in enumerate(self.stages) if own == stage])
            raise

    def _begin_in(self, stage: int, beginning: Sequence[tuple[int, int | None]]) -> None:
        """Let worlds begin an episode in a stage; the first ones that enter it find the others at rest there."""
        is_new, worlds = stage not in self._batches, self._batch_of(stage)
        with self._recording_failures(stage):
            if is_new:
                worlds.reset(self.starts)
            worlds.begin([world for world, _ in beginning], [seed for _, seed in beginning])
        for world, _ in beginning:
            self.drawn[world] = worlds.singles[world].drawn()

    def _close(self, world: int, place: int, outcome: BatchStep, sums: BatchEpisodeAccumulator) -> dict[str, Any]:
        """The last info of an episode, which is reported."""
        info, last = outcome.infos[place], outcome.final_observations
        episode = sums.close(world, info)
        self._on_episode(world, episode)
        seen = {key: part[place] for key, part in last.items()} if isinstance(last, dict) else last[place]
        return last_info(info, seen, episode, timed_out=not outcome.terminated[world])

    def histories(self) -> list[EpisodeHistory]:
        running = {stage: worlds.snapshot() for stage, (worlds, _) in self._batches.items()}
        return [running[stage][world] for world, stage in enumerate(self.stages)]

    def repeat(self, histories: Sequence[EpisodeHistory]) -> VecEnvObs:
        for stage in dict.fromkeys(self.stages):
            worlds, inside = self._batch_of(stage), self._in(stage)
            sums = self._batches[stage][1]
            sums.clear()
            begun = [history if inside[world] else EpisodeHistory(self.starts[world], []) for world, history in enumerate(histories)]
            worlds.restore(begun, partial(_count, worlds, sums))
        self.drawn = [self._batch_of(stage).singles[world].drawn() for world, stage in enumerate(self.stages)]
        self.last_observations = self._observations()
        return self.last_observations

    def close(self) -> None:
        for worlds, _ in self._batches.values():
            worlds.close()


def _count(worlds: BatchSupervisor, sums: BatchEpisodeAccumulator, acting: npt.NDArray[np.bool_]) -> None:
    sums.add(worlds.rewards(), worlds.terms(), acting)


_EMPTY_INFO: dict[str, Any] = {}
"""The info of a world whose episode goes on."""
