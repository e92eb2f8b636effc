"""`critic`: values that only the value function gets."""

from __future__ import annotations

from pathlib import Path, PurePosixPath
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch

from deepbots_cli import api
from deepbots_cli.errors import UsageError
from deepbots_cli.insight.export import bundle
from deepbots_cli.learning import TrainingResult, evaluate, load_policy, resume, train
from deepbots_cli.learning.learner import Setup, create
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.learning.sb3 import networks
from deepbots_cli.program.identity import digest
from deepbots_cli.program.task import Network, Training
from tests.few import few
from tests.learning.interruption import At, outcome

COLUMNS = (0, 1, 3)
WIDE = gym.spaces.Box(-1.0, 1.0, (5,), np.float32)
PARTS = gym.spaces.Dict(
    {
        "observation": WIDE,
        "achieved_goal": gym.spaces.Box(-1.0, 1.0, (2,), np.float32),
        "desired_goal": gym.spaces.Box(-1.0, 1.0, (2,), np.float32),
    }
)
RANGES = gym.spaces.Box(-1.0, 1.0, (2,), np.float32)
CHOICE = gym.spaces.Discrete(3)
ALGORITHMS = {
    "PPO": RANGES,
    "A2C": CHOICE,
    "MaskablePPO": CHOICE,
    "RecurrentPPO": RANGES,
    "SAC": RANGES,
    "TD3": RANGES,
    "DDPG": RANGES,
    "TQC": RANGES,
}

CART = """
deepbots: 1
extends: {base}
name: PrivilegedCart
parameters: {{drag: uniform(-1 .. 1)}}
signals: {{spin: angular_velocity(cart.pole).y}}
critic: {{drag: -1 .. 1, spin: -4 .. 4 rad/s}}
evaluation: {{episodes: 4}}
solved: mean_return >= 1000000 over 2 episodes
{more}
train: {{algorithm: {algorithm}, total_timesteps: 512, environments: 4, {settings}}}
"""
PPO = "n_steps: 32, batch_size: 64"


def learner_for(algorithm: str, space: gym.Space[Any]) -> Any:
    training = Training(algorithm, 1_000, network=Network((8,)))
    return create(Setup(training, space, ALGORITHMS[algorithm], policy_columns=COLUMNS))


def with_numbers(observation: Any, numbers: Any) -> Any:
    return numbers if not isinstance(observation, dict) else {**observation, "observation": numbers}


@pytest.mark.parametrize("space", [WIDE, PARTS], ids=["numbers", "parts"])
@pytest.mark.parametrize("algorithm", few(ALGORITHMS, ["PPO", "RecurrentPPO", "SAC"]))
def test_only_the_critic_sees_the_values_of_the_critic(algorithm: str, space: gym.Space[Any]) -> None:
    learner = learner_for(algorithm, space)
    policy: Any = learner.model.policy
    space.seed(3)
    observation = space.sample()
    numbers = observation["observation"] if isinstance(observation, dict) else observation
    changed = numbers.copy()
    changed[[2, 4]] += 0.5
    first, second = with_numbers(observation, numbers), with_numbers(observation, changed)
    actions = [learner.predict(each, deterministic=True)[0] for each in (first, second)]
    own, _ = learner.predict(with_numbers(observation, numbers[list(COLUMNS)]), deterministic=True)
    np.testing.assert_array_equal(actions[0], actions[1])
    np.testing.assert_array_equal(own, actions[0])
    values = [value_of(policy, algorithm, each) for each in (first, second)]
    assert values[0] != pytest.approx(values[1], abs=1e-6)


def value_of(policy: Any, algorithm: str, observation: Any) -> float:
    tensors, _ = policy.obs_to_tensor(observation)
    with torch.no_grad():
        if algorithm == "RecurrentPPO":
            zeros = torch.zeros(policy.lstm_hidden_state_shape)
            return float(policy.predict_values(tensors, (zeros, zeros), torch.zeros(1)))
        if hasattr(policy, "predict_values"):
            return float(policy.predict_values(tensors))
        predicted = policy.critic(tensors, torch.zeros(1, 2))
        return float(predicted.mean() if isinstance(predicted, torch.Tensor) else predicted[0])


def test_fast_actions_are_those_of_the_policy_to_the_bit() -> None:
    policy = learner_for("PPO", WIDE).model.policy
    observations = torch.rand(6, 5)
    torch.manual_seed(5)
    drawn = networks.sampled_actions(policy, observations)
    torch.manual_seed(5)
    expected = policy(observations)
    assert drawn is not None
    assert all(torch.equal(actual, wanted) for actual, wanted in zip(drawn, expected, strict=True))


# Trainings


def scenario(
    folder: Path, algorithm: str = "PPO", settings: str = PPO, more: str = "", base: str = "cartpole"
) -> Path:
    path = folder / "cart.yaml"
    path.write_text(CART.format(base=base, algorithm=algorithm, settings=settings, more=more))
    return path


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> TrainingResult:
    folder = tmp_path_factory.mktemp("critic")
    return train(scenario(folder), run=folder / "run", engine="pybullet")


@pytest.mark.slow
def test_the_policy_of_a_run_takes_the_observation_alone(trained: TrainingResult) -> None:
    assert trained.status == "finished"
    policy = load_policy(trained.run)
    assert len(policy.observation) == 4
    assert policy.observation_space.shape == (4,)
    assert policy.action_space.contains(int(policy(np.zeros(4, np.float32))))
    assert evaluate(trained.run, episodes=3).episodes == 3


def test_the_environment_of_a_scenario_has_the_observation_alone(tmp_path: Path) -> None:
    with api.make(scenario(tmp_path)) as world:
        assert world.observation_space.shape == (4,)


@pytest.mark.slow
@pytest.mark.parametrize("case", ["PPO", "PPO in shards", "SAC", "RecurrentPPO"])
def test_a_training_that_is_interrupted_continues_to_the_bit(tmp_path: Path, case: str) -> None:
    settings = {
        "PPO in shards": f"{PPO}, shards: 2",
        "SAC": "learning_starts: 100, batch_size: 16, train_freq: 4",
    }.get(case, PPO)
    base = "cartpole_continuous" if case == "SAC" else "cartpole"
    path = scenario(tmp_path, case.split()[0], settings, base=base)
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    train(path, run=whole, engine="pybullet")
    train(path, run=parts, engine="pybullet", progress=At(200))
    resume(parts)
    expected, continued = outcome(whole), outcome(parts)
    for part in ("models", "scalars", "monitor", "evaluations"):
        assert continued[part] == expected[part], part


def test_histories_and_frame_stacks_keep_the_columns_of_the_policy(tmp_path: Path) -> None:
    path = scenario(
        tmp_path,
        more="agent: {frame_stack: 2}\nobservation: {cart.pole_angle: {range: -20 .. 20 deg, history: 3}}",
    )
    text = path.read_text().replace("spin: -4 .. 4 rad/s", "spin: {range: -4 .. 4 rad/s, history: 2}")
    path.write_text(text)
    program = api.compile(path).program
    agent = program.with_critic.agent
    columns = agent.policy_columns
    assert columns is not None
    kept = [agent.inputs[column] for column in columns]
    assert [(entry.name, entry.steps_ago) for entry in kept] == [
        (entry.name, entry.steps_ago) for entry in program.agent.inputs
    ]
    hidden = {agent.inputs[place].name for place in range(len(agent.inputs)) if place not in columns}
    assert hidden == {"drag", "spin"}


def test_an_export_does_not_have_the_critic(trained: TrainingResult) -> None:
    files = bundle.bundle_files(Run.open(trained.run), "best")
    info = files[PurePosixPath("bundle.json")].decode()
    assert "pole_angle" in info
    assert "drag" not in info
    assert "spin" not in info


def test_a_scenario_with_the_section_has_another_digest(tmp_path: Path) -> None:
    with_critic = api.compile(scenario(tmp_path)).program
    path = tmp_path / "plain.yaml"
    path.write_text((tmp_path / "cart.yaml").read_text().replace("critic:", "# critic:"))
    assert digest(api.compile(path).program) != digest(with_critic)


def test_a_run_keeps_its_critic_after_the_file_is_gone(trained: TrainingResult) -> None:
    assert [entry.name for entry in Run.open(trained.run).program.agent.critic] == ["drag", "spin"]


def test_an_algorithm_of_a_package_without_such_a_policy_is_refused() -> None:
    training = Training("DQN", 1_000, network=Network((8,)))
    with pytest.raises(UsageError, match="DQN has no policy whose critic may see more"):
        create(Setup(training, WIDE, CHOICE, policy_columns=COLUMNS))
