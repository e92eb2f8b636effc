"""Algorithms and what they need.

* The inputs of the algorithms: noise, hindsight, masks, pictures.
* `critic`: values that only the value function gets.
* `train.symmetry`: mirror images of observations and actions, and trainings that learn from them.
* Several copies of a robot in one world, under one policy.
* Stable-Baselines3 has the private members that deepbots uses, and one module names them.
"""

from __future__ import annotations

import inspect
import math
import re
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import stable_baselines3
import stand_in
import torch
from hypothesis import given
from hypothesis import strategies as st
from sb3_contrib import QRDQN
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize
from stand_in import Reach, hyper

from deepbots_cli import api
from deepbots_cli.errors import MissingExtraError, UsageError
from deepbots_cli.insight.export import bundle
from deepbots_cli.installation import install_hint
from deepbots_cli.learning import TrainingResult, evaluate, load_policy, resume, train
from deepbots_cli.learning.learner import Setup, create
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.learning.sb3 import algorithms, defaults, internals, networks
from deepbots_cli.learning.sb3.algorithms import DecayingNoise, DivergenceRate
from deepbots_cli.learning.sb3.networks import mirrored_actions, mirrored_experience, mirrored_observations
from deepbots_cli.learning.sb3.rollouts import CollectorEnvironment, ExplorationActor, spaces_only
from deepbots_cli.program import Program
from deepbots_cli.program.identity import digest
from deepbots_cli.program.task import (
    ActionNoise,
    AdaptiveRate,
    Hindsight,
    Mirror,
    Network,
    Schedule,
    Symmetry,
    Training,
)
from deepbots_cli.rollout import Episode
from deepbots_cli.rollout.collector import LocalCollector
from deepbots_cli.rollout.worlds import SingleWorlds
from deepbots_cli.runtime.spaces import action_space
from deepbots_cli.scenario.training import ALGORITHMS
from tests.few import few
from tests.files import written
from tests.learning.interruption import becomes_the_same
from tests.private_members import private_members

SMALL = Network((8,))


def learned(world: Any, tmp_path: Path, training: Training, **settings: Any) -> TrainingResult:
    return train(stand_in.compiled(training=training, **settings), run=tmp_path / "run", build=world)


# Exploration
@pytest.mark.parametrize("algorithm", ["PPO", "A2C"])
def test_a_policy_explores_with_the_initial_standard_deviation(algorithm: str) -> None:
    env = gym.make("Pendulum-v1")
    training = Training(algorithm, 100, hyperparameters=hyper(init_std=0.3))
    plain: Any = getattr(stable_baselines3, algorithm)("MlpPolicy", env)
    policy: Any = algorithms.create(training, plain.get_env(), seed=0, total_timesteps=100).policy
    torch.manual_seed(0)
    actions = policy.get_distribution(torch.zeros(4_000, 3)).get_actions()
    assert actions.std().item() == pytest.approx(0.3, rel=0.05)


# Optimizers
def test_an_optimizer_takes_the_steps_of_torch_to_the_bit() -> None:
    generator = torch.Generator().manual_seed(0)
    start, gradients = torch.randn(20, 3, generator=generator), torch.randn(5, 20, 3, generator=generator)
    learned = []
    for kind in (torch.optim.Adam, algorithms.Adam):
        weights = torch.nn.Parameter(start.clone())
        optimizer = kind([weights], lr=0.01)
        for gradient in gradients:
            optimizer.zero_grad()
            weights.backward(gradient)
            optimizer.step()
        learned.append((weights.detach(), optimizer.state_dict()["state"][0]["exp_avg_sq"]))
    assert all(torch.equal(own, of_torch) for own, of_torch in zip(*learned, strict=True))


@pytest.mark.parametrize("algorithm", ["PPO", "DQN"])
def test_an_algorithm_keeps_the_optimizer_settings_of_stable_baselines(algorithm: str) -> None:
    env = gym.make("CartPole-v1")
    plain: Any = getattr(stable_baselines3, algorithm)("MlpPolicy", env)
    ours: Any = algorithms.create(Training(algorithm, 100), plain.get_env(), seed=0, total_timesteps=100)
    for name in ("eps", "betas", "weight_decay", "amsgrad"):
        assert ours.policy.optimizer.defaults[name] == plain.policy.optimizer.defaults[name]
    assert "optimizer_class" not in ours.policy_kwargs


# Learning rates
@given(st.lists(st.floats(0.0, 1.0), max_size=60))
def test_an_adaptive_rate_moves_against_the_divergence_within_its_limits(divergences: list[float]) -> None:
    rate = DivergenceRate(AdaptiveRate(kl=0.01, start=1e-3))
    for divergence in divergences:
        before = rate(0.5)
        rate.follow(divergence)
        factor = rate(0.5) / before
        if divergence > 0.02:
            assert factor == pytest.approx(max(1 / 1.5, 1e-5 / before))
        elif 0.0 < divergence < 0.005:
            assert factor == pytest.approx(min(1.5, 1e-2 / before))
        else:
            assert factor == 1.0


@pytest.mark.slow
def test_a_training_writes_the_rate_that_it_took(tmp_path: Path) -> None:
    path = written(
        tmp_path / "cart.yaml",
        "deepbots: 1\nextends: cartpole\nname: Adaptive\nworld: {engine: mujoco}\ntrain: {algorithm: PPO, total_timesteps: 1024, n_steps: 64,"
        " environments: 2, batch_size: 64, learning_rate: {kl: 1.0e-5, start: 2e-3}}\n",
    )
    result = train(path, run=tmp_path / "run", loggers=["csv"], stop_when_solved=False)
    rows = [line.split(",") for line in (result.run / "logs" / "scalars.csv").read_text().splitlines()]
    rates = [float(value) for _, name, value in rows[1:] if name == "train/learning_rate"]
    assert (rates[0], rates) == (pytest.approx(2e-3), sorted(rates, reverse=True))
    assert rates[-1] < 1e-3


# Noise
@pytest.mark.parametrize("theta", [0.15, 1.0])
def test_drifting_noise_has_the_deviation_and_the_memory_that_it_is_given(theta: float) -> None:
    np.random.seed(1)
    drawn = DecayingNoise(
        ActionNoise("ornstein_uhlenbeck", Schedule(0.5, 0.5), theta), (20_000,), lambda: 1.0
    )
    first, second = drawn(), drawn()
    for sample in (first, second):
        assert sample.std() == pytest.approx(0.5, rel=0.03)
    assert np.corrcoef(first, second)[0, 1] == pytest.approx(math.exp(-theta), abs=0.03)
    drawn.reset()
    assert abs(np.corrcoef(second, drawn())[0, 1]) < 0.03


@pytest.mark.parametrize("kind", ["normal", "ornstein_uhlenbeck"])
def test_noise_goes_from_its_first_deviation_to_its_last(kind: Any) -> None:
    np.random.seed(2)
    left = [1.0]
    drawn = DecayingNoise(ActionNoise(kind, Schedule(0.5, 0.1)), (20_000,), lambda: left[0])
    for share, deviation in ((1.0, 0.5), (0.5, 0.3), (0.0, 0.1)):
        left[0] = share
        assert drawn().std() == pytest.approx(deviation, rel=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", few(["TD3", "DDPG", "SAC", "TQC"], ["TD3"]))
def test_noise_fades_while_the_training_goes_on(
    tmp_path: Path, algorithm: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    remaining_shares: list[float] = []

    def watched(kind: Any, size: Any, remaining: Any) -> Any:
        return DecayingNoise(kind, size, lambda: remaining_shares.append(remaining()) or remaining())

    monkeypatch.setattr(algorithms, "DecayingNoise", watched)
    training = Training(
        algorithm,
        300,
        2,
        hyper(learning_starts=50),
        SMALL,
        ActionNoise("ornstein_uhlenbeck", Schedule(0.5, 0.1)),
    )
    learned(stand_in.build, tmp_path, training, continuous=True)
    assert remaining_shares[0] > 0.8
    assert remaining_shares[-1] < 0.05
    assert remaining_shares == sorted(remaining_shares, reverse=True)


# Hindsight
GOAL: dict[str, Any] = {
    "continuous": True,
    "max_steps": 10,
    "more": "goal: {achieved: x, desired: 0.1 m, tolerance: 2 cm, range: -0.4 .. 0.4 m}\n",
}
REACH = Training(
    "DDPG",
    1_500,
    2,
    hyper(learning_starts=200, buffer_size=1_000, learning_rate=3e-3, gamma=0.9),
    Network((32,)),
    None,
    Hindsight(),
)


@pytest.fixture(scope="module")
def reached(tmp_path_factory: pytest.TempPathFactory) -> TrainingResult:
    return learned(Reach, tmp_path_factory.mktemp("reach"), REACH, **GOAL)


@pytest.mark.slow
def test_hindsight_learns_from_goals_that_were_made_up(reached: TrainingResult) -> None:
    assert evaluate(reached.run, episodes=20, model="last", build=Reach).successes >= 15


def copies_of(program: Program, world: Any = Reach) -> Any:
    return CollectorEnvironment(LocalCollector(SingleWorlds([world(program), world(program)], [0, 1])))


def test_hindsight_waits_for_the_first_episode_to_end(tmp_path: Path) -> None:
    training = replace(REACH, total_timesteps=100, hyperparameters=())
    base = stand_in.compiled(training=training, **{**GOAL, "max_steps": 700})
    model = algorithms.create(
        training, copies_of(base.program), seed=0, total_timesteps=100, longest_episode=700
    )
    assert (model.learning_starts, train(base, run=tmp_path / "run", build=Reach).steps) == (1_400, 100)


# Masks
class OneWay(stand_in.CartPole):
    """The second option is forbidden whenever the cart is right of the middle, and taking it then is a
    fault."""

    def action_masks(self) -> Any:
        return np.array([True, self.x <= 0.0])

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        assert self.action_masks()[action], "a forbidden action"
        return super().step(action)


def test_forbidden_choices_are_never_taken_in_training_and_evaluation(tmp_path: Path) -> None:
    run = learned(
        OneWay, tmp_path, Training("MaskablePPO", 300, 2, hyper(n_steps=32, batch_size=32), SMALL)
    ).run
    assert evaluate(run, episodes=9, build=OneWay).episodes == 9
    assert evaluate(run, episodes=2, deterministic=False, build=OneWay).episodes == 2
    assert resume(run, total_timesteps=400, build=OneWay).steps >= 400


def test_an_algorithm_that_is_not_installed_is_refused_with_the_command_to_install_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(algorithms.ALGORITHMS["TQC"], "import_path", "not_there:TQC")
    with pytest.raises(
        MissingExtraError,
        match=re.escape(f"training with TQC needs the 'contrib' extra; {install_hint('contrib')}"),
    ):
        learned(stand_in.build, tmp_path, Training("TQC", 300), continuous=True)
    assert not (tmp_path / "run").exists()


# Memory
class Remember(stand_in.CartPole):
    """A cue is shown at the start, and three steps later it counts which of the two it was."""

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.cue = int(self.np_random.integers(2))
        return np.array([2 * self.cue - 1, 0, 0, 0], np.float32), self._info(None)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.steps += 1
        over = self.steps == 4
        right = over and int(action) == self.cue
        return (
            np.zeros(4, np.float32),
            float(right),
            False,
            over,
            self._info("max_steps" if over else None) | {"is_success": right},
        )


@pytest.fixture(scope="module")
def remembered(tmp_path_factory: pytest.TempPathFactory) -> TrainingResult:
    figures = hyper(lstm=16, n_steps=32, batch_size=64, n_epochs=5, learning_rate=1e-2)
    return learned(
        Remember,
        tmp_path_factory.mktemp("memory"),
        Training("RecurrentPPO", 1_800, 8, figures, Network((16,))),
    )


@pytest.mark.slow
def test_a_policy_with_a_memory_acts_by_what_it_saw_before(remembered: TrainingResult) -> None:
    assert evaluate(remembered.run, episodes=30, model="last", build=Remember).success_rate == 1.0


@pytest.mark.slow
def test_a_memory_is_of_one_episode(remembered: TrainingResult) -> None:
    first = evaluate(remembered.run, episodes=20, build=stand_in.build)
    assert len({first.mean_return, first.least_return, first.greatest_return}) == 3  # episodes that differ
    assert evaluate(remembered.run, episodes=9, build=stand_in.build).outcomes == first.outcomes[:9]
    assert evaluate(remembered.run, episodes=3, deterministic=False, build=stand_in.build).episodes == 3


@pytest.mark.parametrize("units", ["0", "-1", "1000000000", "true", "2.5", "'64'"])
@pytest.mark.parametrize("setting", ["lstm: {}", "environments: {}", "network: {{hidden: [{}]}}"])
def test_numbers_of_units_and_worlds_that_no_machine_could_have_are_refused(setting: str, units: str) -> None:
    train = f"algorithm: RecurrentPPO, total_timesteps: 100, {setting.format(units)}"
    findings = api.lint("cartpole", overrides=[f"train={{{train}}}"])
    assert [finding.code for finding in findings] == ["DB105" if units.lstrip("-").isdigit() else "DB103"]


def test_an_unknown_activation_is_refused() -> None:
    (finding,) = api.lint("cartpole", overrides=["train.network.activation=relou"])
    assert finding.code == "DB104"
    assert finding.fix is not None


# Pictures
class Seeing(stand_in.CartPole):
    """The cart-pole with a picture beside its numbers."""

    SIZE = 36

    def __init__(self, program: Program, render_mode: str | None = None) -> None:
        super().__init__(program, render_mode)
        picture = gym.spaces.Box(0, 255, (self.SIZE, self.SIZE, 3), np.uint8)
        self.observation_space = gym.spaces.Dict(
            {"observation": self.observation_space, "cart_camera": picture}
        )

    def _observation(self) -> Any:
        picture = np.zeros((self.SIZE, self.SIZE, 3), np.uint8)
        picture[:, int(18 + 30 * self.x)] = 255
        return {"observation": super()._observation(), "cart_camera": picture}


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", few(["PPO", "DQN", "SAC"], ["DQN"]))
def test_a_policy_that_sees_pictures_is_trained_kept_evaluated_and_gone_on_with(
    tmp_path: Path, algorithm: str
) -> None:
    settings = {"n_steps": 32, "batch_size": 32} if algorithm == "PPO" else {"learning_starts": 50}
    run = learned(
        Seeing, tmp_path, Training(algorithm, 100, 2, hyper(**settings), SMALL), continuous=algorithm == "SAC"
    ).run
    first, again = (evaluate(run, episodes=3, model="last", build=Seeing) for _ in range(2))
    assert first == again
    assert resume(run, total_timesteps=150, build=Seeing).steps >= 150


def test_remembered_pictures_beyond_the_memory_are_refused_before_anything_is_made(
    tmp_path: Path,
) -> None:
    with pytest.raises(UsageError, match=r"a replay buffer of .* steps needs .* GB of memory"):
        learned(Seeing, tmp_path, Training("DQN", 10**9, 1, hyper(buffer_size=10**8)))
    assert not (tmp_path / "run").exists()


def test_the_frequency_of_updates_may_be_given_in_episodes(tmp_path: Path) -> None:
    training = Training("DQN", 200, 1, hyper(train_freq="2 episodes", learning_starts=50), SMALL)
    assert learned(stand_in.build, tmp_path, training).steps >= 200


# Networks
def test_a_policy_with_unknown_networks_is_refused_where_its_layers_are_needed() -> None:
    model = QRDQN("MlpPolicy", gym.make("CartPole-v1"), buffer_size=1)
    assert networks.critic_values(model.policy, [np.zeros(4, np.float32)]) is None
    with pytest.raises(
        UsageError,
        match="the policy QRDQNPolicy cannot act in other processes: it has no network `action_net`, `q_net` or"
        " `actor`",
    ):
        ExplorationActor(model).parameters()


# Defaults
@pytest.mark.parametrize("algorithm", sorted(ALGORITHMS))
def test_the_effective_hyperparameters_are_those_that_the_library_gets(algorithm: str) -> None:
    training = Training(algorithm, 5_000, 2, hyper(gamma=0.9), SMALL)
    scenario = stand_in.scenario(training=training, continuous=algorithm not in ("DQN", "MaskablePPO"))
    model = algorithms.create(training, copies_of(scenario, stand_in.CartPole), seed=0, total_timesteps=5_000)
    effective = {row.name: row for row in defaults.effective_hyperparameters(scenario, 5_000)}
    assert (effective["gamma"].value, effective["gamma"].source) == (0.9, "scenario")
    got = {
        name: getattr(model, name)
        for name in effective
        if isinstance(getattr(model, name, None), (int, float))
    }
    got = {
        name: value for name, value in got.items() if effective[name].value != "auto"
    }  # which the library resolves
    assert got.keys() >= {"learning_rate", "gamma", "n_steps"}
    assert {name: effective[name].value for name in got} == got


@pytest.mark.parametrize("algorithm", sorted(ALGORITHMS))
def test_the_defaults_of_the_library_are_read_from_its_signature(algorithm: str) -> None:
    home = pytest.importorskip(algorithms.ALGORITHMS[algorithm].import_path.partition(":")[0])
    signature = inspect.signature(getattr(home, algorithm).__init__)
    theirs = {
        name: entry.default
        for name, entry in signature.parameters.items()
        if entry.default is not entry.empty
    }
    assert defaults.library_defaults(algorithm) == theirs


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
WITH_CRITIC = {
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
FEW_STEPS = "n_steps: 32, batch_size: 64"


def learner_for(algorithm: str, space: gym.Space[Any]) -> Any:
    training = Training(algorithm, 1_000, network=Network((8,)))
    return create(Setup(training, space, WITH_CRITIC[algorithm], policy_columns=COLUMNS))


def with_numbers(observation: Any, numbers: Any) -> Any:
    return numbers if not isinstance(observation, dict) else {**observation, "observation": numbers}


@pytest.mark.parametrize("space", [WIDE, PARTS], ids=["numbers", "parts"])
@pytest.mark.parametrize("algorithm", few(WITH_CRITIC, ["PPO", "RecurrentPPO", "SAC"]))
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
    folder: Path, algorithm: str = "PPO", settings: str = FEW_STEPS, more: str = "", base: str = "cartpole"
) -> Path:
    return written(
        folder / "cart.yaml", CART.format(base=base, algorithm=algorithm, settings=settings, more=more)
    )


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> TrainingResult:
    folder = tmp_path_factory.mktemp("critic")
    return train(scenario(folder), run=folder / "run", engine="pybullet")


@pytest.mark.slow
def test_the_policy_of_a_run_takes_the_observation_alone(trained: TrainingResult) -> None:
    assert trained.status == "finished"
    policy = load_policy(trained.run)
    assert (len(policy.observation), policy.observation_space.shape) == (4, (4,))
    assert policy.action_space.contains(int(policy(np.zeros(4, np.float32))))
    assert evaluate(trained.run, episodes=3).episodes == 3


def test_the_environment_of_a_scenario_has_the_observation_alone(tmp_path: Path) -> None:
    with api.make(scenario(tmp_path)) as world:
        assert world.observation_space.shape == (4,)


@pytest.mark.slow
@pytest.mark.parametrize("case", ["PPO", "PPO in shards", "SAC", "RecurrentPPO"])
def test_a_training_that_is_interrupted_continues_to_the_bit(tmp_path: Path, case: str) -> None:
    settings = {
        "PPO in shards": f"{FEW_STEPS}, shards: 2",
        "SAC": "learning_starts: 100, batch_size: 16, train_freq: 4",
    }.get(case, FEW_STEPS)
    base = "cartpole_continuous" if case == "SAC" else "cartpole"
    path = scenario(tmp_path, case.split()[0], settings, base=base)
    becomes_the_same(path, tmp_path, 200, engine="pybullet")


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
    info = bundle.bundle_files(Run.open(trained.run), "best")[PurePosixPath("bundle.json")].decode()
    assert "pole_angle" in info
    assert "drag" not in info
    assert "spin" not in info


def test_a_scenario_with_the_section_has_another_digest(tmp_path: Path) -> None:
    with_critic = api.compile(scenario(tmp_path)).program
    path = written(
        tmp_path / "plain.yaml", (tmp_path / "cart.yaml").read_text().replace("critic:", "# critic:")
    )
    assert digest(api.compile(path).program) != digest(with_critic)


def test_a_run_keeps_its_critic_after_the_file_is_gone(trained: TrainingResult) -> None:
    assert [entry.name for entry in Run.open(trained.run).program.agent.critic] == ["drag", "spin"]


def test_an_algorithm_of_a_package_without_such_a_policy_is_refused() -> None:
    training = Training("DQN", 1_000, network=Network((8,)))
    with pytest.raises(UsageError, match="DQN has no policy whose critic may see more"):
        create(Setup(training, WIDE, CHOICE, policy_columns=COLUMNS))


CART_SYMMETRY = """
deepbots: 1
extends: cartpole_continuous
name: MirroredCart
remove: [reset.joints]
world: {engine: mujoco}
evaluation: {episodes: 4}
solved: mean_return >= 1000000 over 2 episodes
train:
  algorithm: PPO
  total_timesteps: 512
  environments: 4
  n_steps: 32
  batch_size: 64
  symmetry: {flip: [x, speed, tip_speed, cart.pole_angle, drive]}
"""
DOG = """
deepbots: 1
extends: quadruped
name: MirroredDog
observation: {vx: -1 .. 3 m/s}
critic: {time: 0 .. 10 s, w: -6 .. 6 rad/s}
train:
  symmetry:
    swap: {FL: FR, RL: RR}
    flip: ["*_hip_joint", wz, v.y, "clock.*", dog.down.y, dog.gyro.x, dog.gyro.z, w.x, w.z]
"""
CHOICES = """
deepbots: 1
extends: cartpole
name: MirroredChoices
action:
  drive: {choices: {left: -1, stay: 0, right: 1}}
  left_arm: {choices: {up: 1, down: 0}}
  right_arm: {choices: {down: 0, up: 1}}
observation: {previous_action: auto}
signals: {arms: left_arm + right_arm}
reward: {arms: arms}
train: {algorithm: PPO, total_timesteps: 512, symmetry: {swap: {left: right}, flip: [x, "*speed", "*_angle"]}}
"""


def compiled(folder: Path, text: str) -> Any:
    path = written(folder / "mirrored.yaml", text)
    return api.compile(path).program


def symmetry_of(program: Any) -> Symmetry:
    symmetry: Symmetry = program.agent.training.symmetry
    assert symmetry is not None
    return symmetry


@pytest.mark.parametrize("text", [CART_SYMMETRY, DOG, CHOICES], ids=["cart", "dog", "choices"])
def test_the_mirror_image_of_a_mirror_image_is_the_original(tmp_path: Path, text: str) -> None:
    program = compiled(tmp_path, text)
    symmetry = symmetry_of(program)
    space = action_space(program.agent)
    random = np.random.default_rng(1)
    observations = random.uniform(-1.0, 1.0, (20, len(program.with_critic.agent.inputs)))
    image = mirrored_observations(symmetry, observations)
    np.testing.assert_allclose(mirrored_observations(symmetry, image), observations, atol=1e-12)
    space.seed(2)
    actions = np.array([space.sample() for _ in range(20)]).reshape(20, -1)
    once = mirrored_actions(symmetry, space, actions)
    np.testing.assert_array_equal(mirrored_actions(symmetry, space, once), actions)


def test_sides_change_places_and_values_change_their_signs_in_their_units(tmp_path: Path) -> None:
    program = compiled(tmp_path, DOG)
    wide = program.with_critic.agent
    places = {observation.name: place for place, observation in enumerate(wide.inputs)}
    values = {
        "vx": 0.5,
        "wz": 0.3,
        "v.y": -0.2,
        "dog.q.FL_hip_joint": 0.7,
        "dog.q.RL_upper_joint": 0.4,
        "w.z": 2.0,
    }
    observation = np.zeros(len(wide.inputs))
    for name, value in values.items():
        entry = wide.inputs[places[name]]
        observation[places[name]] = (value - (entry.low + entry.high) / 2) / ((entry.high - entry.low) / 2)
    image = mirrored_observations(symmetry_of(program), observation)

    def value_of(name: str) -> float:
        entry = wide.inputs[places[name]]
        return float((entry.low + entry.high) / 2 + image[places[name]] * (entry.high - entry.low) / 2)

    mirrored = {
        "vx": 0.5,
        "wz": -0.3,
        "v.y": 0.2,
        "dog.q.FR_hip_joint": -0.7,
        "dog.q.RR_upper_joint": 0.4,
        "w.z": -2.0,
    }
    assert {name: value_of(name) for name in mirrored} == pytest.approx(mirrored)
    assert value_of("dog.q.FL_hip_joint") == pytest.approx(0.0)


def test_options_have_mirror_images(tmp_path: Path) -> None:
    program = compiled(tmp_path, CHOICES)
    forward, left, stay, right = 0, 2, 3, 4
    up_and_down, down_and_up = [0, 0], [1, 1]  # the options of the arms stand in another order
    actions = np.array([[left, *up_and_down], [stay, *down_and_up], [right, 0, 1], [forward, 1, 0]])
    image = mirrored_actions(symmetry_of(program), action_space(program.agent), actions)
    np.testing.assert_array_equal(
        image, [[right, *down_and_up], [stay, *up_and_down], [left, 0, 1], [forward, 1, 0]]
    )


def test_a_mirrored_episode_is_the_mirror_image_of_the_episode(tmp_path: Path) -> None:
    program = compiled(tmp_path, CART_SYMMETRY)
    symmetry = symmetry_of(program)
    actions = np.random.default_rng(4).uniform(-0.5, 0.5, (40, 1)).astype(np.float32)

    def played(acts: Any) -> Any:
        with api.make(tmp_path / "mirrored.yaml", overrides=["termination={}"], engine="pybullet") as world:
            world.reset(seed=0)
            return np.array([world.step(act)[0] for act in acts])

    observations = played(actions)
    image = played(mirrored_actions(symmetry, action_space(program.agent), actions))
    assert np.abs(observations).max() > 0.05
    np.testing.assert_allclose(
        image, mirrored_observations(symmetry, observations), atol=0.01
    )  # contacts are solved in another order


def test_an_update_has_each_sample_and_its_mirror_image() -> None:
    model = PPO("MlpPolicy", gym.make("Pendulum-v1"), n_steps=8, batch_size=4)
    buffer = model.rollout_buffer
    buffer.observations[...] = np.random.default_rng(5).uniform(-1, 1, buffer.observations.shape)
    buffer.advantages[...] = np.arange(8)[:, None]
    mirror = Mirror((1, 0, 2), (1.0, 1.0, -1.0), (0.0, 0.0, 0.5))
    with mirrored_experience(model, Symmetry(mirror, Mirror((0,), (-1.0,), (0.0,)))):
        both = model.rollout_buffer
        assert model.batch_size == 8
        np.testing.assert_array_equal(both.observations[:, 0], buffer.observations[:, 0])
        np.testing.assert_allclose(
            both.observations[:, 1], buffer.observations[:, 0][:, [1, 0, 2]] * [1, 1, -1] + [0, 0, 0.5]
        )
        np.testing.assert_array_equal(both.advantages[:, 0], both.advantages[:, 1])
        assert sum(len(batch.advantages) for batch in both.get(model.batch_size)) == 16
    assert (model.rollout_buffer, model.batch_size) == (buffer, 4)


@pytest.mark.slow
def test_a_training_with_mirror_images_continues_to_the_bit(tmp_path: Path) -> None:
    becomes_the_same(written(tmp_path / "cart.yaml", CART_SYMMETRY), tmp_path, 200, engine="pybullet")


def test_the_previous_action_has_the_sign_of_the_action(tmp_path: Path) -> None:
    text = CART_SYMMETRY.replace("deepbots: 1\n", "deepbots: 1\nobservation: {previous_action: auto}\n", 1)
    program = compiled(tmp_path, text)
    names = [entry.name for entry in program.agent.inputs]
    symmetry = symmetry_of(program)
    assert symmetry.ranges.factors == (-1.0,)
    assert symmetry.observation.factors[names.index("previous_action.drive")] == -1.0


def test_the_previous_action_has_the_sign_of_a_component_that_is_named_with_its_action(
    tmp_path: Path,
) -> None:
    text = DOG.replace('flip: ["*_hip_joint"', 'flip: ["dog.*_hip_joint", "stride.*_hip_joint"')
    program = compiled(tmp_path, text)
    names = [entry.name for entry in program.with_critic.agent.inputs]
    factors = symmetry_of(program).observation.factors
    assert factors[names.index("previous_action.FL_hip_joint")] == -1.0
    assert factors[names.index("previous_action.FL_upper_joint")] == 1.0


SIZE = 3


class Member(stand_in.CartPole):
    """A cart-pole whose last step can be asked for again."""

    def reset(self, **settings: Any) -> tuple[Any, dict[str, Any]]:
        self.outcome = (*super().reset(**settings), 0.0, False, False)
        return self.outcome[0], self.outcome[1]

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        observation, reward, terminated, truncated, info = super().step(action)
        self.outcome = (observation, info, reward, terminated, truncated)
        return observation, reward, terminated, truncated, info

    def get_observations(self) -> Any:
        return self.outcome[0]

    def get_reward(self) -> float:
        return self.outcome[2]

    def get_info(self) -> dict[str, Any]:
        return self.outcome[1]

    def is_done(self) -> tuple[bool, bool]:
        return self.outcome[3], self.outcome[4]


class Team(gym.Env[Any, Any]):
    """Three of them; the episode ends for all when it ends for one."""

    def __init__(self, program: Program, render_mode: str | None = None) -> None:
        self.agents = {f"cart#{number}": Member(program) for number in range(1, SIZE + 1)}
        self.observation_space = gym.spaces.Box(-1, 1, (SIZE, 4), np.float32)
        self.action_space = gym.spaces.MultiDiscrete([2] * SIZE)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        for member in self.agents.values():
            member.reset(seed=int(self.np_random.integers(2**31)))
        return self._rows(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        assert np.shape(action) == (SIZE,)
        outcomes = [member.step(int(row)) for member, row in zip(self.agents.values(), action, strict=True)]
        ended = [info for _, _, terminated, _, info in outcomes if terminated]
        info = ended[0] if ended else outcomes[0][4]
        return (
            self._rows(),
            float(np.mean([o[1] for o in outcomes])),
            bool(ended),
            not ended and outcomes[0][3],
            info,
        )

    def _rows(self) -> Any:
        return np.stack([member.get_observations() for member in self.agents.values()])


def test_a_team_is_unrolled_into_a_row_for_each_copy() -> None:
    program = stand_in.scenario()
    episodes: list[tuple[int, Episode]] = []
    copies = SingleWorlds(
        [Team(program), Team(program)],
        [1, 2],
        on_episode=lambda world, episode: episodes.append((world, episode)),
    )
    alone = [Team(program), Team(program)]
    first = np.concatenate([team.reset(seed=seed)[0] for team, seed in zip(alone, (1, 2), strict=True)])
    assert (copies.rows, copies.observation_space.shape) == (6, (4,))
    assert (copies.reset() == first).all()
    dones = np.zeros(6, bool)
    count = 0
    while (
        not dones.any()
    ):  # the first team drives on, the second back and forth, which holds the poles up for longer
        actions = np.array([0, 1, 1] + [count % 2] * 3)
        count = count + 1
        before = np.concatenate(
            [team.step(rows)[0] for team, rows in zip(alone, (actions[:3], actions[3:]), strict=True)]
        )
        step = copies.step_all(actions)
        observations, rewards, dones, endings = step.observations, step.rewards, step.ended, step.endings
        assert (rewards == 1.0).all()
    world = int(np.argmax(dones)) // SIZE
    rows = range(world * SIZE, world * SIZE + SIZE)
    assert dones.tolist() == [row in rows for row in range(6)]
    ended = {ending.row: ending for ending in endings}
    own = [row for row in rows if not ended[row].timed_out]
    assert own  # whoever ended it did so itself; for the others it was cut short
    assert list(ended) == list(rows)
    assert all((ended[row].observation == before[row]).all() for row in rows)
    assert all((observations[row] != before[row]).any() for row in rows)  # of the next episode
    assert [(world, episode.ended_by) for world, episode in episodes] == [
        (world, "fallen" if row in own else "another_copy") for row in rows
    ]


MODULE = Path(internals.__file__)
GOALS = gym.spaces.Dict(dict.fromkeys(("observation", "achieved_goal", "desired_goal"), RANGES))


def learner_of(
    algorithm: str, observations: gym.Space[Any] = RANGES, actions: gym.Space[Any] = RANGES, **settings: Any
) -> Any:
    env: Any = VecNormalize(spaces_only(observations, actions), norm_obs=False)
    return algorithms.create(Training(algorithm, 1_000, **settings), env, seed=0, total_timesteps=1_000)


def test_the_library_has_each_private_member() -> None:
    models = [
        learner_of("PPO"),
        learner_of("RecurrentPPO"),
        learner_of("SAC"),
        learner_of("DDPG", GOALS, replay=Hindsight()),
    ]
    models.append(learner_of("DQN", actions=gym.spaces.Discrete(2)))
    parts: list[Any] = [*models, models[0].env, *(model.policy for model in models)]
    parts += [
        getattr(model, name)
        for model in models
        for name in ("rollout_buffer", "replay_buffer")
        if hasattr(model, name)
    ]
    used = {name for _, name in private_members(MODULE)}
    assert len(used) > 15
    assert {name for name in used if not any(hasattr(part, name) for part in parts)} == set()


INTERNALS = {"learning/sb3": "internals.py", "cluster": "ray_cluster.py"}


@pytest.mark.parametrize("package", INTERNALS)
def test_one_module_of_a_package_names_private_members(package: str) -> None:
    folder = MODULE.parents[2] / package
    named = [path.name for path in folder.glob("*.py") if any(private_members(path))]
    assert named == [INTERNALS[package]]
