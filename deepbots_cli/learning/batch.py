"""A batch of worlds as a vector environment of Stable-Baselines3."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn

from deepbots_cli import api, engines
from deepbots_cli.codegen import not_batched
from deepbots_cli.learning.environments import BuildWorld, VectorEnvironment, last_info
from deepbots_cli.learning.episodes import Episode
from deepbots_cli.program import Program
from deepbots_cli.runtime.batch import BatchSupervisor, Outcome, Running

SMALLEST = 8
"""Worlds from which on a batch is faster: what it does per step over arrays takes as long as 5 single worlds."""


def reasons_against(program: Program, worlds: int, engine: str, build: BuildWorld) -> list[str]:
    """Why a training steps its worlds one by one; nothing where they are a batch."""
    if engine not in engines.BATCHES:
        return [f"the engine '{engine}' has no batches"]
    if worlds < SMALLEST:
        return [f"there are fewer than {SMALLEST} worlds"]
    own = [] if getattr(build, "func", None) is api.build else ["its worlds are made by a function of the caller"]
    return [*own, *not_batched(program), *(["it has a curriculum"] if program.curriculum else [])]


def described(program: Program, worlds: int, engine: str, build: BuildWorld) -> str:
    """Whether a training steps its worlds as a batch, and why not; empty where no batch is to be expected."""
    if engine not in engines.BATCHES or worlds < SMALLEST:
        return ""
    reasons = reasons_against(program, worlds, engine, build)
    how = f"one by one: {'; '.join(reasons)}" if reasons else "together, as a batch"
    return f"{program.name} steps its {worlds} worlds {how}"


class Sums:
    """Adds up the running episodes of a batch, as `EpisodeAccumulator` does for a single world."""

    def __init__(self, batch: BatchSupervisor) -> None:
        self._names, self._count = batch.TERMS, batch.count
        self.clear()

    def clear(self) -> None:
        self._returns, self._lengths = np.zeros(self._count), np.zeros(self._count, int)
        self._terms = np.zeros((len(self._names), self._count))

    def add(self, rewards: npt.NDArray[Any], terms: npt.NDArray[Any], acting: Any = True) -> None:
        """Count one step of the worlds that are `acting` (truth values)."""
        self._returns += np.where(acting, rewards, 0.0)
        self._lengths += acting
        self._terms += np.where(acting, terms, 0.0)

    def close(self, world: int, info: Mapping[str, Any], seed: int | None = None, drawn: Mapping[str, Any] | None = None) -> Episode:
        """The finished episode of a world, given the info of its last step; the next one begins."""
        terms = dict(zip(self._names, self._terms[:, world].tolist(), strict=True))
        total, length = float(self._returns[world]), int(self._lengths[world])
        self._returns[world], self._lengths[world], self._terms[:, world] = 0.0, 0, 0.0
        return Episode(total, length, info["is_success"], info["ended_by"], terms, seed, drawn or {})


class BatchedWorlds(VectorEnvironment):
    """The worlds of a batch, a row each; world i starts from `seeds[i]` at the first reset and runs on from there.

    Args:
        batch: The worlds, which are closed with this.
        seeds: The seed of each.
        on_step: Called after the step of each row.
        on_episode: Called after each episode of a row with the number of its world.
    """

    def __init__(
        self,
        batch: BatchSupervisor,
        seeds: Sequence[int],
        *,
        on_step: Callable[[], None] = lambda: None,
        on_episode: Callable[[int, Episode], None] = lambda world, episode: None,
    ) -> None:
        self.batch = batch
        self._sums = Sums(batch)
        super().__init__(batch.singles, seeds, on_step=on_step, on_episode=on_episode)

    def reset(self) -> VecEnvObs:
        self._sums.clear()
        self.last_observations = self.batch.reset(self.starts)
        self.drawn = [single.drawn() for single in self.batch.singles]
        return self.last_observations

    def step_wait(self) -> VecEnvStepReturn:
        outcome = self.batch.step(self._actions)
        self._sums.add(outcome.rewards, outcome.terms)
        dones = np.zeros(self.num_envs, bool)
        dones[outcome.done] = True
        infos: list[dict[str, Any]] = [_NOTHING] * self.num_envs
        ended = dict(zip(outcome.done.tolist(), range(len(outcome.done)), strict=True))
        for world in range(self.num_envs):
            self._on_step()
            if world in ended:
                infos[world] = self._close(world, ended[world], outcome)
                self.drawn[world] = self.batch.singles[world].drawn()  # the next episode has begun
        self.last_observations = outcome.observations
        return self.last_observations, outcome.rewards.astype(np.float32), dones, infos

    def _close(self, world: int, place: int, outcome: Outcome) -> dict[str, Any]:
        """The last info of an episode, which is reported."""
        info, last = outcome.infos[place], outcome.last
        episode = self._sums.close(world, info)
        self._on_episode(world, episode)
        seen = {key: part[place] for key, part in last.items()} if isinstance(last, dict) else last[place]
        return last_info(info, seen, episode, timed_out=not outcome.terminated[world])

    def histories(self) -> list[Running]:
        return self.batch.snapshot()

    def repeat(self, histories: Sequence[Running]) -> VecEnvObs:
        self._sums.clear()
        batch = self.batch
        self.last_observations = batch.restore(histories, lambda acting: self._sums.add(batch.rewards(), batch.terms(), acting))
        self.drawn = [single.drawn() for single in batch.singles]
        return self.last_observations

    def close(self) -> None:
        self.batch.close()


_NOTHING: dict[str, Any] = {}
"""The info of a world whose episode goes on."""
