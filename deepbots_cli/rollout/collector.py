"""Experience for a learner, fragment by fragment.

A `Collector` returns the next fragment for the learner: the rows of some steps, the episodes that ended, and the state from which a shard
continues. `LocalCollector` steps worlds in this process. A shard is the worlds of one collector; shards in other processes or on other
machines are another implementation of the same interface. On-policy algorithms take any collector. The experience does not depend on where
shards run, because:

- The worlds of a shard have their own seeds and random streams, and a shard acts with its own copy of the policy.
- Fragments are joined by the number of their shard (`join`), never by the order in which they arrive.
- A shard returns its `ShardState`: the start and the actions of each running episode. Another shard can continue from it exactly.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import gymnasium as gym
import numpy as np

from deepbots_cli.rollout.worlds import Array, Ending, Worlds, WorldsStep, observation_digest
from deepbots_cli.runtime.batch import EpisodeHistory
from deepbots_cli.runtime.spaces import by_part


class Decision(NamedTuple):
    """The output of an actor: `actions` for the worlds, one per row, and further arrays (`columns`) to store in the fragment."""

    actions: Array
    columns: Mapping[str, Array] = {}


Actor = Callable[[Any, Array, Array | None], Decision]
"""Acts on the observations of all rows, given which rows begin an episode, and which options are allowed (None: all)."""
OnStep = Callable[[WorldsStep], bool]
"""Called after each step of all rows; returns whether to continue."""


@dataclass(frozen=True)
class Fragment:
    """The experience of some steps: arrays of shape (steps, rows, ...), or a dictionary of arrays for observations with parts.

    Attributes:
        observations: The observations on which the agents acted.
        actions: The actions of the agents.
        rewards: float32.
        starts: Whether an episode began with the observation.
        columns: Further arrays of the actor, such as values and log-probabilities.
        following: The observations after the last step, of shape (rows, ...).
        following_starts: Whether an episode begins with them.
        endings: The episodes that ended, each with the number of the step, in the order of steps and rows.
    """

    observations: Any
    actions: Array
    rewards: Array
    starts: Array
    columns: Mapping[str, Array]
    following: Any
    following_starts: Array
    endings: Sequence[tuple[int, Ending]]


class ShardState(NamedTuple):
    """The running episode of each world, and the digest of the present observations."""

    episodes: list[EpisodeHistory]
    observed: str


class Collector(Protocol):
    """Gives a learner its experience."""

    rows: int
    observation_space: gym.Space[Any]
    action_space: gym.Space[Any]

    def collect(self, actor: Actor, steps: int, on_step: OnStep, *, with_masks: bool = False) -> Fragment | None:
        """The next `steps` of every row; None if `on_step` ended it before. `with_masks` gives the actor which options are allowed."""

    def state(self) -> ShardState:
        """What another collector with the same worlds goes on from, between two fragments."""

    def restore(self, state: ShardState, seeds: Sequence[int]) -> bool:
        """Go on from a state. Returns False where the worlds come to other observations: then they begin anew from `seeds`."""


class LocalCollector:
    """Collects from worlds in this process."""

    def __init__(self, worlds: Worlds) -> None:
        self.worlds = worlds
        self.rows, self.observation_space, self.action_space = worlds.rows, worlds.observation_space, worlds.action_space
        self.starts = np.ones(self.rows, bool)
        """Whether an episode begins with the observations that the agents act on next."""

    def begin(self) -> Any:
        """The observations that the agents act on next; the first episodes begin if none has."""
        return self.worlds.reset() if self.worlds.observations is None else self.worlds.observations

    def collect(self, actor: Actor, steps: int, on_step: OnStep = lambda step: True, *, with_masks: bool = False) -> Fragment | None:
        observations, starts = self.begin(), self.starts
        seen, decisions, rewards, begun, endings = [], [], [], [], []
        for number in range(steps):
            decision = actor(observations, starts, self.worlds.action_masks() if with_masks else None)
            seen.append(observations)
            decisions.append(decision)
            begun.append(starts)
            step = self.step_all(decision.actions)
            if not on_step(step):
                return None
            rewards.append(step.rewards)
            endings += [(number, ending) for ending in step.endings]
            observations, starts = step.observations, step.dones
        columns = {name: np.stack([decision.columns[name] for decision in decisions]) for name in decisions[0].columns}
        actions = np.stack([decision.actions for decision in decisions])
        return Fragment(_joined(np.stack, seen), actions, np.stack(rewards), np.stack(begun), columns, observations, starts, endings)

    def step_all(self, actions: Any) -> WorldsStep:
        """One step, for a learner that asks for single steps."""
        outcome = self.worlds.step_all(actions)
        self.starts = outcome.dones
        return outcome

    def state(self) -> ShardState:
        return ShardState(self.worlds.histories(), observation_digest(self.worlds.observations))

    def restore(self, state: ShardState, seeds: Sequence[int]) -> bool:
        self.starts = np.repeat([not episode.actions for episode in state.episodes], self.rows // len(state.episodes))
        if observation_digest(self.worlds.repeat(state.episodes)) == state.observed:
            return True
        self.worlds.starts = list(seeds)
        self.worlds.reset()
        self.starts = np.ones(self.rows, bool)
        return False


def join(fragments: Sequence[Fragment]) -> Fragment:
    """The fragments of shards 0, 1, 2, ... as one, with the rows of the first shard first."""
    offsets = np.cumsum([0, *(fragment.rewards.shape[1] for fragment in fragments)])
    endings = [
        (number, ending._replace(row=ending.row + int(offset)))
        for fragment, offset in zip(fragments, offsets, strict=False)
        for number, ending in fragment.endings
    ]

    def side_by_side(parts: Sequence[Any]) -> Any:
        return np.concatenate(parts, axis=1)

    return Fragment(
        _joined(side_by_side, [fragment.observations for fragment in fragments]),
        side_by_side([fragment.actions for fragment in fragments]),
        side_by_side([fragment.rewards for fragment in fragments]),
        side_by_side([fragment.starts for fragment in fragments]),
        {name: side_by_side([fragment.columns[name] for fragment in fragments]) for name in fragments[0].columns},
        _joined(np.concatenate, [fragment.following for fragment in fragments]),
        np.concatenate([fragment.following_starts for fragment in fragments]),
        sorted(endings, key=lambda entry: (entry[0], entry[1].row)),
    )


def _joined(join_arrays: Callable[[Sequence[Any]], Any], observations: Sequence[Any]) -> Any:
    """Observations joined array by array."""
    return by_part(lambda *parts: join_arrays(parts), *observations)
