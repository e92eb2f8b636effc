"""Episodes of a trained policy, several worlds at a time, with results that do not depend on how many.

A matrix product may round a row otherwise when it stands in another place or among another number of rows, and a rounding
is enough to tip an action. So every forward pass has the same number of rows and episode k always sits in row k mod ROWS;
what the other rows hold does not touch it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm

from deepbots_cli.learning import algorithms
from deepbots_cli.learning.environments import World, is_team
from deepbots_cli.learning.episodes import Episode, Tally
from deepbots_cli.runtime.streams import derive

ROWS = 8
"""A forward pass of a small policy takes about 0.1 ms for any number of rows up to 16; more worlds than 8 gain little."""

OnEpisode = Callable[[int, int], None]
"""Is told after each episode how many are done, and of how many."""


def _silent(_done: int, _of: int) -> None:
    pass


def rollout(
    model: BaseAlgorithm, worlds: Sequence[World], seeds: Sequence[int], *, deterministic: bool, on_episode: OnEpisode = _silent
) -> list[Episode]:
    """One episode from each seed, in the order of `seeds`; uses up to ROWS of the worlds, a sampling policy or a team only one."""
    if is_team(worlds[0]):
        return list(_team_episodes(model, worlds[0], seeds, deterministic=deterministic, on_episode=on_episode))
    together = min(len(worlds), ROWS) if deterministic else 1
    batch = _Batch(worlds[0].observation_space, _choices(worlds[0]) if algorithms.takes_masks(model) else None)
    finished: dict[int, Episode] = {}
    for first in range(0, min(ROWS, len(seeds)), together):
        rows = range(first, min(first + together, ROWS, len(seeds)))
        lanes = [_Lane(world, row, range(row, len(seeds), ROWS), seeds) for world, row in zip(worlds, rows, strict=False)]
        running = [lane for lane in lanes if lane.begin(batch)]
        while running:
            actions = batch.answer(model, deterministic=deterministic)
            for lane in running:
                episode = lane.step(actions[lane.row], batch)
                if episode is not None:
                    finished[lane.number] = episode
                    on_episode(len(finished), len(seeds))
            running = [lane for lane in running if lane.number not in finished or lane.begin(batch)]
    return [finished[number] for number in range(len(seeds))]


def _team_episodes(
    model: BaseAlgorithm, world: World, seeds: Sequence[int], *, deterministic: bool, on_episode: OnEpisode
) -> Iterator[Episode]:
    for number, seed in enumerate(seeds, start=1):
        yield _team_episode(model, world, seed, deterministic=deterministic)
        on_episode(number, len(seeds))


def _team_episode(model: BaseAlgorithm, world: World, seed: int, *, deterministic: bool) -> Episode:
    """An episode of all copies of a robot, with the mean of their rewards; each forward pass has a row for each copy."""
    torch.manual_seed(derive(seed, "policy"))
    observation, _ = world.reset(seed=seed)
    size, tally = len(world.get_wrapper_attr("agents")), Tally()
    memory, starts = None, np.ones(size, dtype=bool)
    heeds_masks = algorithms.takes_masks(model) and world.has_wrapper_attr("action_masks")
    while True:
        masks = {"action_masks": world.get_wrapper_attr("action_masks")().reshape(size, -1)} if heeds_masks else {}
        actions, memory = model.predict(observation, state=memory, episode_start=starts, deterministic=deterministic, **masks)
        starts = np.zeros(size, dtype=bool)
        observation, reward, terminated, truncated, info = world.step(actions)
        tally.add(float(reward), info)
        if terminated or truncated:
            return tally.close(info)


class _Batch:
    """The observations of one forward pass; rows of worlds that do not run keep what they last held.

    Where the policy heeds them, `masks` say beside them which of the agent's `choices` are allowed. A recurrent policy
    has a `memory` for each row, which it forgets where `starts` says that an episode begins.
    """

    def __init__(self, space: gym.Space[Any], choices: int | None) -> None:
        self.memory: Any = None
        self.starts = np.ones(ROWS, dtype=bool)
        self.masks: dict[str, Any] = {} if choices is None else {"action_masks": np.ones((ROWS, choices), dtype=bool)}
        self.observations: Any = (
            {key: _zeros(part) for key, part in space.spaces.items()} if isinstance(space, gym.spaces.Dict) else _zeros(space)
        )

    def answer(self, model: BaseAlgorithm, *, deterministic: bool) -> Any:
        """An action for each row."""
        actions, self.memory = model.predict(
            self.observations, state=self.memory, episode_start=self.starts, deterministic=deterministic, **self.masks
        )
        self.starts[:] = False
        return actions

    def put(self, row: int, observation: Any, world: World) -> None:
        for masks in self.masks.values():
            masks[row] = world.get_wrapper_attr("action_masks")()
        if isinstance(self.observations, dict):
            for key, rows in self.observations.items():
                rows[row] = observation[key]
        else:
            self.observations[row] = observation


def _choices(world: World) -> int | None:
    """How many options the agent has, over all parts of its action; None where the world forbids none."""
    if not world.has_wrapper_attr("action_masks"):
        return None
    space: Any = world.action_space
    return int(space.n) if isinstance(space, gym.spaces.Discrete) else int(space.nvec.sum())


def _zeros(space: gym.Space[Any]) -> np.ndarray[Any, np.dtype[Any]]:
    return np.zeros((ROWS, *(space.shape or ())), dtype=space.dtype)


class _Lane:
    """One world that goes through its episodes `todo`, in one row of the batch."""

    def __init__(self, world: World, row: int, todo: Iterable[int], seeds: Sequence[int]) -> None:
        self.row = row
        self.number = row
        self._world = world
        self._todo = iter(todo)
        self._seeds = seeds
        self._tally = Tally()

    def begin(self, batch: _Batch) -> bool:
        """Start the next episode; whether there was one."""
        number = next(self._todo, None)
        if number is None:
            return False
        self.number = number
        # Only a policy that samples draws from this.
        torch.manual_seed(derive(self._seeds[number], "policy"))
        batch.starts[self.row] = True
        batch.put(self.row, self._world.reset(seed=self._seeds[number])[0], self._world)
        return True

    def step(self, action: Any, batch: _Batch) -> Episode | None:
        """The episode, if this step was its last."""
        observation, reward, terminated, truncated, info = self._world.step(action)
        self._tally.add(float(reward), info)
        batch.put(self.row, observation, self._world)
        return self._tally.close(info) if terminated or truncated else None
