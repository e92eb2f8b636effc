"""The measurement of trainings with several numbers of shards."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from deepbots_cli.learning.executor import SERIAL
from deepbots_cli.learning.scaling import ShardTiming, candidates, choose, described, measure

TIMING = ShardTiming(1, 0, 1000.0, 1.0, 1.0, 0.1, 700.0, 100.0, 0.0, 0.0, 200.0)


def timings(*rates: float) -> list[ShardTiming]:
    return [replace(TIMING, shards=1 << number, steps_per_second=rate) for number, rate in enumerate(rates)]


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    [
        ["train.n_steps=16"],
        pytest.param(
            ["train={algorithm: DQN, total_timesteps: 1000, environments: 2}"], marks=pytest.mark.slow
        ),
    ],
)
def test_the_parts_of_the_time_add_up_and_nothing_is_left(tmp_path: Path, changes: list[str]) -> None:
    measured = measure("cartpole", [1, 2], SERIAL, overrides=changes, folder=tmp_path, seconds=0.2)
    assert [timing.shards for timing in measured] == [1, 2]
    for timing in measured:
        parts = (
            timing.worlds_us + timing.policy_us + timing.transfer_us + timing.waiting_us + timing.update_us
        )
        assert parts == pytest.approx(1e6 / timing.steps_per_second)
        assert min(timing.worlds_us, timing.policy_us, timing.update_us) > 0
    assert not list(tmp_path.iterdir())


def test_several_shards_are_chosen_only_if_they_are_clearly_faster() -> None:
    assert choose(timings(1000, 1900, 3000)).shards == 4
    assert choose(timings(1000, 1900, 1500)).shards == 2
    assert choose(slow := timings(1000, 1090)).shards == 1
    assert described(slow, slow[0]) == (
        "measured: 1 shard 1,000 steps/s, 2 shards 1,090 steps/s; the training has 1 shard, because more are"
        " less than 1.1 times as fast"
    )


@pytest.mark.parametrize(
    ("environments", "workers", "numbers"),
    [(8, 2, [1, 2]), (8, 6, [1, 2, 4, 6]), (3, 16, [1, 2, 3]), (1, 4, [1]), (9, 8, [1, 2, 4, 8])],
)
def test_each_power_of_two_is_a_candidate_and_a_shard_for_each_worker(
    environments: int, workers: int, numbers: list[int]
) -> None:
    assert candidates(environments, workers) == numbers
