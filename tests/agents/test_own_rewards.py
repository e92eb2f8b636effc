"""`previous_reward` and `episode_return` of one among several agents."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from deepbots_cli import api
from deepbots_cli.runtime.agents import seats_of
from tests.agents.carts import CARTS

OBSERVED = (
    CARTS.replace(
        "speed: -1 .. 1 m/s}", "speed: -1 .. 1 m/s, previous_reward: -10 .. 10, earned: -100 .. 100}"
    )
    .replace("augment: {", "augment: {earned: episode_return, ")
    .replace("near:", "more: 0.1 * previous_reward, near:")
    .replace("ahead: {drive: 1}", "ahead: {drive: 0.1 * previous_reward}")
)


@pytest.mark.parametrize("repeat", ["", "agent: {action_repeat: 3}\n"])
def test_an_agent_sees_its_own_rewards(tmp_path: Path, repeat: str) -> None:
    file = tmp_path / "carts.yaml"
    file.write_text(OBSERVED + repeat)
    with closing(api.make(file)) as world:
        world.reset(seed=1)
        seats = seats_of(world)
        generator = np.random.default_rng(0)
        earned, last = dict.fromkeys(seats, 0.0), dict.fromkeys(seats, 0.0)
        for _ in range(5):
            observed, _, _, _, info = world.step(generator.uniform(-1, 1, 2).astype(np.float32))
            for name, seat in seats.items():
                reward = seat.reward(info)
                *_, seen, total = seat.observation(observed)
                assert seen == pytest.approx(reward / 10, rel=1e-5)
                if not repeat:  # within a step of several timesteps, the return grows in each of them
                    assert total == pytest.approx(earned[name] / 100, abs=1e-6)
                assert seat.script("ahead")[0] == pytest.approx(min(1.0, 0.1 * reward), rel=1e-5)
                more = seat.info(info)["reward_terms"]["more"]
                assert more == pytest.approx(0.1 * last[name] * (3 if repeat else 1))
                earned[name] += reward
                last[name] = reward


def test_a_batch_computes_the_rewards_of_agents_as_single_worlds_do(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    file = tmp_path / "carts.yaml"
    file.write_text(OBSERVED)
    with closing(api.make_vec(file, 3)) as batch, closing(api.make(file, engine="mujoco")) as single:
        batch.reset(seed=[4, 5, 6])
        single.reset(seed=5)
        generator = np.random.default_rng(0)
        for _ in range(8):
            actions = generator.uniform(-1, 1, (3, 2)).astype(np.float32)
            assert batch.step(actions)[0][1].tolist() == single.step(actions[1])[0].tolist()
