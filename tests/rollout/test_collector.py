"""Fragments of experience: the same wherever the worlds of a shard go on."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import closing
from typing import Any

import numpy as np
import pytest
from stable_baselines3.common.logger import Logger

from deepbots_cli import api
from deepbots_cli.errors import UsageError
from deepbots_cli.learning import learner
from deepbots_cli.learning.learner import Setup
from deepbots_cli.program.task import Hyperparameter, Training
from deepbots_cli.rollout.batch_worlds import BatchWorlds
from deepbots_cli.rollout.collector import (
    Actor,
    Decision,
    Fragment,
    Lesson,
    LocalCollector,
    OnStep,
    ShardState,
    join,
)
from deepbots_cli.rollout.worlds import SingleWorlds
from deepbots_cli.runtime.batch import EpisodeHistory

PROGRAM = api.compile("cartpole").program


def shard(number: int, kind: str, worlds: int = 2) -> LocalCollector:
    """Worlds of CartPole with the seeds 10, 11, ... for shard 0, 20, 21, ... for shard 1."""
    seeds = [10 + 10 * number + index for index in range(worlds)]
    if kind == "batch":
        pytest.importorskip("deepbots_cli.engines.mujoco")
        return LocalCollector(BatchWorlds(lambda stage: api.build_batch(PROGRAM, worlds), seeds))
    return LocalCollector(SingleWorlds([api.build(PROGRAM) for _ in seeds], seeds))


def act(observations: Any, starts: Any, masks: Any) -> Decision:
    """Drives to the side to which the pole leans; `lean` is a further column, as a policy may return it
    beside the action."""
    lean = observations[:, 2] + observations[:, 3]
    return Decision((lean > 0).astype(int), {"lean": lean})


def collected(collector: LocalCollector, steps: int) -> Fragment:
    fragment = collector.collect(act, steps)
    assert fragment is not None
    return fragment


def is_equal(first: Fragment, second: Fragment) -> bool:
    arrays = ("observations", "actions", "rewards", "starts", "following", "following_starts")
    same = all(np.array_equal(getattr(first, name), getattr(second, name)) for name in arrays)
    endings = [
        [(step, ending.row, ending.episode) for step, ending in fragment.endings]
        for fragment in (first, second)
    ]
    return same and np.array_equal(first.columns["lean"], second.columns["lean"]) and endings[0] == endings[1]


@pytest.mark.parametrize("kind", ["single", "batch"])
def test_a_fragment_has_rows_by_step_and_the_episodes_that_ended(kind: str) -> None:
    collector = shard(0, kind)
    with closing(collector.worlds):
        fragment = collected(collector, 80)
        assert fragment.observations.shape == (80, 2, 4)
        assert (fragment.rewards.shape, fragment.columns["lean"].shape) == ((80, 2), (80, 2))
        assert fragment.starts[0].all()
        begun = {(step + 1, ending.row) for step, ending in fragment.endings}
        assert {(step, row) for step, row in np.argwhere(fragment.starts).tolist() if step} == {
            pair for pair in begun if pair[0] < 80
        }
        assert begun
        assert np.array_equal(collected(collector, 1).observations[0], fragment.following)


@pytest.mark.parametrize("kind", ["single", "batch"])
def test_a_shard_goes_on_elsewhere_to_the_bit(kind: str) -> None:
    """From its state, which JSON can hold, in fresh worlds; the first shard meanwhile runs on."""
    original, restored = shard(0, kind), shard(1, kind)
    with closing(original.worlds), closing(restored.worlds):
        collected(original, 70)
        start = [(episode.start, np.array(episode.actions).tolist()) for episode in original.state().episodes]
        kept = json.loads(json.dumps(start))
        state = ShardState(
            [EpisodeHistory(begun, list(np.array(actions))) for begun, actions in kept],
            original.state().observed,
        )
        assert restored.restore(state, [0, 0])
        assert is_equal(collected(original, 60), collected(restored, 60))
        assert not restored.restore(state._replace(observed="of another world"), [3, 4])
        assert [episode.start for episode in restored.state().episodes] == [3, 4]


def test_joined_fragments_are_what_one_shard_with_all_worlds_collects() -> None:
    """The rows of shard 0 come first."""
    shards = [shard(number, "single") for number in (0, 1)]
    whole = LocalCollector(SingleWorlds([api.build(PROGRAM) for _ in range(4)], [10, 11, 20, 21]))
    with closing(whole.worlds), closing(shards[0].worlds), closing(shards[1].worlds):
        assert is_equal(join([collected(each, 50) for each in shards]), collected(whole, 50))


def test_a_fragment_may_be_ended_before_its_last_step() -> None:
    collector = shard(0, "single")
    with closing(collector.worlds):
        steps: list[int] = []
        assert collector.collect(act, 10, lambda step: steps.append(0) or len(steps) < 4) is None
        assert len(steps) == 4


class Shards:
    """Two shards as one collector, asked in the order of their numbers."""

    def __init__(self, *shards: LocalCollector) -> None:
        self.shards = shards
        self.rows = sum(shard.rows for shard in shards)
        self.observation_space, self.action_space = shards[0].observation_space, shards[0].action_space

    def collect(
        self,
        actor: Actor,
        steps: int,
        on_step: OnStep,
        *,
        with_masks: bool = False,
        lesson: Lesson | None = None,
    ) -> Fragment | None:
        fragments = [
            shard.collect(actor, steps, on_step, with_masks=with_masks, lesson=lesson)
            for shard in self.shards
        ]
        return join([fragment for fragment in fragments if fragment is not None])

    def state(self) -> ShardState:
        states = [shard.state() for shard in self.shards]
        return ShardState(
            [episode for state in states for episode in state.episodes],
            " ".join(state.observed for state in states),
        )

    def restore(self, state: ShardState, seeds: Sequence[int]) -> bool:
        raise NotImplementedError


def test_an_on_policy_learner_learns_from_any_collector_and_others_refuse_one() -> None:
    shards = Shards(shard(0, "single"), shard(1, "single"))
    spaces = shards.observation_space, shards.action_space
    with closing(shards.shards[0].worlds), closing(shards.shards[1].worlds):
        settings = tuple(Hyperparameter(name, 32) for name in ("n_steps", "batch_size"))
        ppo = learner.create(
            Setup(Training("PPO", 1000, environments=4, hyperparameters=settings), *spaces, collector=shards)
        )
        ppo.log = Logger(None, [])  # type: ignore[assignment]  # writes nothing
        ppo.begin(1000, Monitor())  # type: ignore[arg-type]  # what a learner calls of it
        ppo.start()
        before = ppo.digest()
        assert ppo.collect()
        assert ppo.steps == 4 * 32
        assert ppo.recent()[1].shape[:2] == (32, 4)
        ppo.update()
        assert ppo.digest() != before
        with pytest.raises(UsageError, match="DQN needs its worlds in the training process"):
            learner.create(Setup(Training("DQN", 1000, environments=4), *spaces, collector=shards))


class Monitor:
    """Lets a training go on."""

    defines_success = False

    def on_step(self) -> bool:
        return True

    def on_collected(self) -> None:
        pass
