"""`critic` of an agent that is trained beside others."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import pytest

import deepbots_cli
from deepbots_cli import api
from deepbots_cli.learning.evaluation import evaluate, load_model
from deepbots_cli.learning.runs.run import Run
from tests.agents.carts import CARTS

CRITIC = CARTS.replace(
    "    reward: {upright", "    critic: {gap: 0 .. 4 m, spin: -5 .. 5 rad/s}\n    reward: {upright"
).replace(
    "augment: {speed: velocity(left).x}",
    "augment: {speed: velocity(left).x, gap: apart, spin: angular_velocity(left.pole).y}",
)
PPO = (
    "train: {algorithm: PPO, total_timesteps: 64, environments: 8, n_steps: 8, n_epochs: 1,"
    " network: {hidden: [8]}}\n"
)
ROLE = "role={agent: right, others: {left: lean}}"


@pytest.fixture
def carts(tmp_path: Path) -> api.Compiled:
    file = tmp_path / "carts.yaml"
    file.write_text(CRITIC + PPO)
    return api.compile(file, overrides=[ROLE, "world.engine=mujoco"])


def test_the_worlds_of_the_training_show_what_its_own_critic_sees(carts: api.Compiled) -> None:
    program = carts.program.with_critic
    assert program.agent.policy_columns == (0, 1)
    with closing(api.build(program)) as single, closing(api.build_batch(program, 2)) as batch:
        seen, _ = single.reset(seed=3)
        assert seen.shape == (4,)
        assert batch.reset([3, 4])[0].tolist() == seen.tolist()
        after, *_, info = single.step([0.5])
        assert after[2] == pytest.approx(2 * (-10 * info["reward_terms"]["near"]) / 4 - 1)
        assert after.tolist() == batch.step([[0.5], [0.5]]).observations[0].tolist()
    with closing(api.build(carts.program)) as world:
        assert world.observation_space.shape == (2,)


def test_a_critic_learns_from_more_than_the_policy_sees(carts: api.Compiled, tmp_path: Path) -> None:
    deepbots_cli.train(carts, run=tmp_path / "run", seed=1)
    model = load_model(Run.open(tmp_path / "run"), "best").model  # type: ignore[attr-defined]  # of Stable-Baselines3
    assert model.policy.mlp_extractor.policy_net[0].in_features == 2
    assert model.policy.mlp_extractor.value_net[0].in_features == 4
    assert evaluate(tmp_path / "run", episodes=2).episodes == 2
