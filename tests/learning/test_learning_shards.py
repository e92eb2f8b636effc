"""The worlds of a training in shards: the result depends on their number, and not on where and how often they
begin."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import stand_in
from test_learning_resume import CASES, build_of

from deepbots_cli.learning import train
from deepbots_cli.learning.environments import WorldFactory
from deepbots_cli.learning.executor import SERIAL, Executor
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.learning.shards import LocalShards, Shard, world_numbers
from deepbots_cli.program.task import Solved, Training
from deepbots_cli.rollout.collector import Order, RunningEpisode, ShardPool, ShardResult
from deepbots_cli.rollout.worlds import Array
from tests.few import few
from tests.learning.interruption import outcome

ALGORITHMS = [name for name in CASES if name not in ("DDPG", "TQC", "older weights")]


class Forgetful:
    """Shards that are lost with every fragment: others continue from the state that the collector keeps."""

    def shards(
        self, stack: ExitStack, run: Run, training: Training, build: WorldFactory, note: Any
    ) -> ShardPool:
        class Pool(LocalShards):
            def collect(
                self,
                order: Order,
                memories: Sequence[Mapping[str, Array]],
                episodes: Sequence[Sequence[RunningEpisode]],
            ) -> Callable[[], list[ShardResult]]:
                self.close()
                self._shards = [
                    Shard(run, build, number, worlds) for number, worlds in enumerate(world_numbers(training))
                ]
                self.begin(episodes)
                return super().collect(order, memories, episodes)

        pool = Pool(
            [Shard(run, build, number, worlds) for number, worlds in enumerate(world_numbers(training))]
        )
        stack.callback(pool.close)
        return pool


def trained(
    name: str, folder: Path, executor: Executor, shards: int = 2, staleness: int = 0
) -> dict[str, Any]:
    settings = {"solved": Solved(30, mean_return=190.0)} | CASES[name]
    training: Training = settings["training"]
    total = min(training.total_timesteps, 600)
    settings["training"] = replace(
        training,
        environments=max(3, training.environments),
        shards=shards,
        total_timesteps=total,
        staleness=staleness,
    )
    compiled = stand_in.compiled(**settings)
    section = compiled.program.agent.training
    assert section is not None
    assert (section.shards, section.staleness) == (shards, staleness)
    train(compiled, run=folder, build=build_of(name), executor=executor)
    return outcome(folder)


@pytest.mark.slow
@pytest.mark.parametrize("name", few(ALGORITHMS, ["TD3"]))
def test_shards_that_are_lost_with_every_fragment_give_the_same(tmp_path: Path, name: str) -> None:
    kept, lost = trained(name, tmp_path / "kept", SERIAL), trained(name, tmp_path / "lost", Forgetful())
    for part in kept:
        assert lost[part] == kept[part], part


@pytest.mark.slow
@pytest.mark.parametrize("name", few(ALGORITHMS, ["curriculum"]))
def test_with_older_weights_too(tmp_path: Path, name: str) -> None:
    kept = trained(name, tmp_path / "kept", SERIAL, staleness=1)
    lost = trained(name, tmp_path / "lost", Forgetful(), staleness=1)
    for part in kept:
        assert lost[part] == kept[part], part
    assert kept["models"] != trained(name, tmp_path / "newest", SERIAL)["models"]


def test_the_first_shards_have_one_world_more_if_the_sizes_differ() -> None:
    assert world_numbers(Training("PPO", 1, environments=7, shards=3)) == [range(3), range(3, 5), range(5, 7)]
