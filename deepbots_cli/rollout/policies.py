"""Episodes of a policy, in a world or in a batch of them, with results that do not depend on which
(`runtime/spaces.py`). `evaluate_policy` of learning libraries provides neither this nor the same starts
for every policy.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
import torch

from deepbots_cli.errors import EngineError
from deepbots_cli.rollout.episode import (
    Driver,
    Episode,
    EpisodeAccumulator,
    OnEpisode,
    Start,
    play,
    set_number,
)
from deepbots_cli.rollout.worlds import Array, BatchEpisodes, has_copies
from deepbots_cli.runtime.batch import BatchSupervisor
from deepbots_cli.runtime.spaces import FORWARD_BATCH_SIZE, ForwardPass, Predictor
from deepbots_cli.runtime.streams import derive_seed

NumberedEpisode = tuple[int, Episode]
"""A finished episode of an evaluation, with its number from 0."""
StopCondition = Callable[[Sequence[Episode]], bool]
"""Returns whether the first episodes of an evaluation are enough."""


def play_episodes(
    policy: Predictor,
    world: gym.Env[Any, Any],
    seeds: Sequence[int],
    *,
    deterministic: bool,
    numbers: Iterable[int],
) -> Iterator[NumberedEpisode]:
    """Play the episodes with these `numbers`, each from its seed.

    An episode depends on its seed and its number only, so it is the same for any division of the numbers.
    """
    driver = PolicyDriver(policy, world, deterministic=deterministic)
    for number in numbers:
        yield number, play(world, driver, Start(seeds[number], number=number))


def play_together(
    policy: Predictor, worlds: Sequence[gym.Env[Any, Any]], seeds: Sequence[int], numbers: Sequence[int]
) -> Iterator[NumberedEpisode]:
    """Play the episodes of `play_episodes` in at most `FORWARD_BATCH_SIZE` worlds at once, with the likeliest
    actions: a forward pass acts in all of them, and each world plays the numbers of its rows."""
    forward = ForwardPass(worlds[0].observation_space, _choices(policy, worlds[0]))
    waiting: list[deque[int]] = [deque() for _ in worlds]
    for number in numbers:
        waiting[number % FORWARD_BATCH_SIZE % len(worlds)].append(number)
    episodes = [EpisodeAccumulator() for _ in worlds]
    running: dict[int, int] = {}

    def put(world: int, observation: Any) -> None:
        forward.put(running[world] % FORWARD_BATCH_SIZE, observation, _masks(worlds[world], forward))

    def begin_next(world: int) -> None:
        running.pop(world, None)
        if not waiting[world]:
            return
        number = running[world] = waiting[world].popleft()
        forward.starts[number % FORWARD_BATCH_SIZE] = True
        set_number(worlds[world], number)
        observation, info = worlds[world].reset(seed=seeds[number])
        episodes[world].begin(seeds[number], info)
        put(world, observation)

    for world in range(len(worlds)):
        begin_next(world)
    while running:
        actions = forward.predict(policy, deterministic=True)
        for world, number in list(running.items()):
            action = actions[number % FORWARD_BATCH_SIZE]
            observation, reward, terminated, truncated, info = worlds[world].step(action)
            episodes[world].add(float(reward), info)
            if terminated or truncated:
                yield number, episodes[world].close(info)
                begin_next(world)
            else:
                put(world, observation)


def ordered_episodes(
    finished: Iterable[NumberedEpisode],
    numbers: Sequence[int],
    on_episode: OnEpisode | None = None,
    until: StopCondition | None = None,
) -> list[Episode]:
    """Return the episodes in the order of `numbers`; the last one is the first for which `until` returns
    True."""
    episodes_by_number: dict[int, Episode] = {}
    episodes: list[Episode] = []
    for number, episode in finished:
        episodes_by_number[number] = episode
        if on_episode is not None:
            on_episode(len(episodes_by_number), len(numbers))
        while len(episodes) < len(numbers) and numbers[len(episodes)] in episodes_by_number:
            episodes.append(episodes_by_number[numbers[len(episodes)]])
            if until is not None and until(episodes):
                return episodes
    return episodes


def play_batch(policy: Predictor, worlds: BatchSupervisor, seeds: Sequence[int]) -> Iterator[NumberedEpisode]:
    """Play the episodes of `play_episodes` in a batch of worlds, with the likeliest actions; there are at
    least as many seeds as worlds.

    World i has row i mod `FORWARD_BATCH_SIZE` of one of several forward passes, and plays the episodes of the
    same row in `play_episodes`. With copies of a robot each world has its own forward pass, with a row for
    each copy.

    Raises:
        DeepbotsError: A world fails; `play_episodes` reports its place.
    """
    count = len(worlds.singles)
    width = worlds.copies
    size = 1 if has_copies(worlds.singles[0]) else FORWARD_BATCH_SIZE
    choices = _choices(policy, next(iter(worlds.singles[0].agents.values())))
    passes = [ForwardPass(worlds.observation_space, choices, size * width) for _ in range(0, count, size)]
    # From the first number after those of the worlds that is `row` modulo `size`, in steps of `size`.
    waiting = [deque(range(count + (row - count) % size, len(seeds), size)) for row in range(size)]
    numbers = list(range(count))
    running = BatchEpisodes(worlds)
    answers: list[Any] = [None] * len(passes)
    lost = len(worlds.losses)
    observations = worlds.reset(seeds[:count])
    draws = [single.drawn() for single in worlds.singles]
    while not running.resting.all():
        masks = None if choices is None else worlds.action_masks()
        for index, forward in enumerate(passes):
            part = slice(index * size, min(count, (index + 1) * size))
            # Resting worlds ignore actions, so a pass with only resting worlds keeps its last answer.
            if answers[index] is None or not running.resting[part].all():
                forward.put_all(observations, slice(part.start * width, part.stop * width), masks)
                answers[index] = forward.predict(policy, deterministic=True)
        outcome = running.step_all(np.concatenate(answers)[: worlds.count])
        # A batch ends the episode of a lost world and goes on, but its outcome says nothing about the policy.
        if len(worlds.losses) > lost:
            raise EngineError(worlds.losses[-1].error)
        begun = []
        for index, world in enumerate(outcome.done.tolist()):
            number = numbers[world]
            row = world % size
            yield number, running.close(world, outcome.infos[index], seeds[number], draws[world])
            if waiting[row]:
                numbers[world] = waiting[row].popleft()
                passes[world // size].starts[row * width : (row + 1) * width] = True
                begun.append(world)
            else:
                running.resting[world] = True
        if begun:
            worlds.begin(begun, [seeds[numbers[world]] for world in begun])
            for world in begun:
                draws[world] = worlds.singles[world].drawn()
        observations = worlds.observations() if begun else worlds.rows.by_row(outcome.observations)


class PolicyDriver(Driver):
    """The policy of a model.

    If the start of an episode has a number, the actions are bit for bit those of the evaluation episode with
    this number. For copies of a robot this is always true, because each forward pass has one row per copy.

    Args:
        batch: The batch of `world`; the policy then acts in all of its worlds, with one row per world.
    """

    def __init__(
        self,
        policy: Predictor,
        world: gym.Env[Any, Any],
        *,
        deterministic: bool = True,
        batch: BatchSupervisor | None = None,
    ) -> None:
        self._policy = policy
        self._world = world
        self._deterministic = deterministic
        if batch:
            self._size = batch.count
        elif has_copies(world):
            self._size = len(world.get_wrapper_attr("agents"))
        else:
            self._size = 0
        self._takes_masks = policy.takes_masks and world.has_wrapper_attr("action_masks")
        self._masks = batch.action_masks if batch else lambda: world.get_wrapper_attr("action_masks")()
        self._forward: ForwardPass | None = None
        self._row = 0
        self._starts = np.ones(self._size or 1, bool)
        self._memory: Any = None

    def begin(self, start: Start) -> None:
        if start.seed is not None:  # only a policy that samples draws from it
            _seed_sampling(derive_seed(start.seed, "policy"))
        self._memory = None
        self._starts[:] = True
        self._forward = None
        if start.number is not None and not self._size:
            self._row = start.number % FORWARD_BATCH_SIZE
            self._forward = ForwardPass(self._world.observation_space, _choices(self._policy, self._world))

    def act(self, observation: Any) -> Any:
        if self._forward is not None:
            self._forward.put(self._row, observation, _masks(self._world, self._forward))
            return self._forward.predict(self._policy, deterministic=self._deterministic)[self._row]
        masks = self._masks() if self._takes_masks else None
        if masks is not None and self._size:
            masks = masks.reshape(self._size, -1)
        action, self._memory = self._policy.predict(
            observation, self._memory, self._starts, self._deterministic, masks
        )
        self._starts = np.zeros_like(self._starts)
        return action


def _seed_sampling(seed: int) -> None:
    """Seed the generators of torch on the devices in use.

    Without a GPU `torch.manual_seed` takes 0.1 to 1 ms, since it prints the stack for each kind of device and
    keeps it.
    """
    if torch.cuda.is_initialized():  # type: ignore[no-untyped-call]
        torch.manual_seed(seed)
    else:
        torch.default_generator.manual_seed(seed)


def _choices(policy: Predictor, world: gym.Env[Any, Any]) -> int | None:
    """Return the number of options of the agent, over all parts of its action; None if the policy takes no
    masks, or the world forbids no option."""
    if not (policy.takes_masks and world.has_wrapper_attr("action_masks")):
        return None
    space: Any = world.action_space
    return int(space.n) if isinstance(space, gym.spaces.Discrete) else int(space.nvec.sum())


def _masks(world: gym.Env[Any, Any], forward: ForwardPass) -> Array | None:
    """Return which options the world allows, if the policy takes masks."""
    return None if forward.masks is None else world.get_wrapper_attr("action_masks")()
