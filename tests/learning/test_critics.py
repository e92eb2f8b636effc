"""The predictions of the critic of an off-policy algorithm beside the returns that followed."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from deepbots_cli import api
from deepbots_cli.learning import train
from deepbots_cli.learning.sb3.critics import discounted_returns
from deepbots_cli.view.training_logs import scalars_of


def test_the_return_that_followed_ends_with_the_episode_and_is_unknown_after_a_time_limit():
    rewards = np.ones((6, 1))
    none = np.zeros((6, 1), bool)
    ended, cut = none.copy(), none.copy()
    ended[2] = True
    followed, unknown = discounted_returns(rewards, ended, none, 0.5)
    assert followed[:3, 0].tolist() == [1.75, 1.5, 1.0]
    assert unknown[:3, 0].tolist() == [0.0, 0.0, 0.0]
    assert unknown[3:, 0].tolist() == [0.125, 0.25, 0.5]  # what follows has not come yet
    cut[2] = True
    _, unknown = discounted_returns(rewards, ended, cut, 0.5)
    assert unknown[:3, 0].tolist() == [0.125, 0.25, 0.5]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scenario", "algorithm"),
    [("cartpole_continuous", "TD3"), pytest.param("cartpole", "DQN", marks=pytest.mark.slow)],
)
def test_a_training_logs_both(tmp_path, scenario, algorithm):
    settings = (
        "total_timesteps: 500, environments: 4, learning_starts: 100, batch_size: 32, gamma: 0.9,"
        " network: {hidden: [8]}"
    )
    compiled = api.compile(api.load(scenario, overrides=[f"train={{algorithm: {algorithm}, {settings}}}"]))
    scalars = scalars_of(train(compiled, seed=1, run=tmp_path / "run").run / "tensorboard")
    followed, value = scalars["critic/followed"][1], scalars["critic/value"][1]
    assert len(followed) == len(value) > 0
    assert np.isfinite(value).all()
    assert (
        (followed > 4) & (followed < 10)
    ).all()  # a reward of 1 a step, over ten steps or to the end of an episode
