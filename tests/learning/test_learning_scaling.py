"""The measurement of trainings with several numbers of shards."""

from __future__ import annotations

from pathlib import Path

import pytest

from deepbots_cli.learning.executor import SERIAL
from deepbots_cli.learning.scaling import measure


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
