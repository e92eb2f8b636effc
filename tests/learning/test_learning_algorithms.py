"""The inputs of the algorithms: noise, hindsight, masks, pictures."""

from __future__ import annotations

import inspect
import math
import re
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
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
from stand_in import hyper

from deepbots_cli import api
from deepbots_cli.errors import MissingExtraError, UsageError
from deepbots_cli.installation import install_hint
from deepbots_cli.learning import TrainingResult, evaluate, resume, train
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.learning.sb3 import algorithms, defaults, models, networks
from deepbots_cli.learning.sb3.learner import OffPolicyLearner
from deepbots_cli.learning.sb3.rollouts import CollectorEnvironment, ExplorationActor
from deepbots_cli.learning.sb3.schedules import DecayingNoise, DivergenceRate
from deepbots_cli.program import Program
from deepbots_cli.program.task import ActionNoise, AdaptiveRate, Hindsight, Network, Schedule, Training
from deepbots_cli.rollout.collector import LocalCollector
from deepbots_cli.rollout.worlds import SingleWorlds
from deepbots_cli.scenario.training import ALGORITHMS
from tests.few import few

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
    path = tmp_path / "cart.yaml"
    path.write_text(
        "deepbots: 1\nextends: cartpole\nname: Adaptive\nworld: {engine: mujoco}\ntrain: {algorithm: PPO, total_timesteps: 1024, n_steps: 64,"
        " environments: 2, batch_size: 64, learning_rate: {kl: 1.0e-5, start: 2e-3}}\n"
    )
    result = train(path, run=tmp_path / "run", loggers=["csv"], stop_when_solved=False)
    rows = [line.split(",") for line in (result.run / "logs" / "scalars.csv").read_text().splitlines()]
    rates = [float(value) for _, name, value in rows[1:] if name == "train/learning_rate"]
    assert rates[0] == pytest.approx(2e-3)
    assert rates == sorted(rates, reverse=True)
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


class Reach(stand_in.CartPole):
    """A point on a line that has to get to another; its reward follows from the two."""

    def __init__(self, program: Program, render_mode: str | None = None) -> None:
        super().__init__(program, render_mode)
        one = gym.spaces.Box(-1, 1, (1,), np.float32)
        self.observation_space = gym.spaces.Dict(
            {"observation": one, "achieved_goal": one, "desired_goal": one}
        )
        self.action_space = gym.spaces.Box(-1, 1, (1,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.place = 0.0
        self.goal = float(self.np_random.uniform(-1, 1))
        return self._seen(), self._info(None)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.place = float(np.clip(self.place + 0.2 * action[0], -1, 1))
        self.steps += 1
        seen = self._seen()
        reward = float(self.compute_reward(seen["achieved_goal"], seen["desired_goal"], {}))
        cut = self.steps >= 10
        return (
            seen,
            reward,
            False,
            cut,
            self._info("max_steps" if cut else None) | {"is_success": reward == 0.0},
        )

    def _seen(self) -> dict[str, Any]:
        place = np.array([self.place], np.float32)
        return {
            "observation": place,
            "achieved_goal": place,
            "desired_goal": np.array([self.goal], np.float32),
        }

    def compute_reward(self, achieved: Any, desired: Any, info: Any) -> Any:
        return -(np.abs(achieved - desired)[..., 0] > 0.1).astype(np.float32)


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


@pytest.mark.slow
def test_a_resumed_training_remembers_steps_and_the_episodes_that_they_belong_to(
    reached: TrainingResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    replays = []

    class Seen(OffPolicyLearner):
        def start(self) -> None:
            replays.append(
                deepcopy(
                    {key: value for key, value in vars(self.model.replay_buffer).items() if key != "env"}
                )
            )
            super().start()

    monkeypatch.setattr("deepbots_cli.learning.sb3.learner.OffPolicyLearner", Seen)
    result = resume(reached.run, total_timesteps=1_600, build=Reach)
    (replay,) = replays
    assert replay["full"]
    assert replay["buffer_size"] == 500  # 1 000 for two copies, and the ring has gone round
    # All episodes have ten steps; the oldest has lost some, the newest may not have ended.
    assert set(np.unique(replay["ep_length"][10:490])) == {10}
    assert (replay["ep_start"][10:490] % 10 == replay["ep_start"][10] % 10).all()
    assert result.steps >= 1_600


def copies_of(program: Program, world: Any = Reach) -> Any:
    return CollectorEnvironment(LocalCollector(SingleWorlds([world(program), world(program)], [0, 1])))


def test_hindsight_waits_for_the_first_episode_to_end(tmp_path: Path) -> None:
    training = replace(REACH, total_timesteps=100, hyperparameters=())
    base = stand_in.compiled(training=training, **{**GOAL, "max_steps": 700})
    model = algorithms.create(
        training, copies_of(base.program), seed=0, total_timesteps=100, longest_episode=700
    )
    assert model.learning_starts == 1_400
    assert train(base, run=tmp_path / "run", build=Reach).steps == 100


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


def test_masks_are_not_asked_for_where_nothing_is_forbidden(tmp_path: Path) -> None:
    run = learned(
        stand_in.build, tmp_path, Training("MaskablePPO", 300, 2, hyper(n_steps=32, batch_size=32), SMALL)
    ).run
    assert evaluate(run, episodes=3, build=stand_in.build).episodes == 3


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
    result = evaluate(remembered.run, episodes=30, model="last", build=Remember)
    assert result.success_rate == 1.0


@pytest.mark.slow
def test_a_memory_is_of_one_episode_however_many_worlds_run_at_once(remembered: TrainingResult) -> None:
    first = evaluate(remembered.run, episodes=20, build=stand_in.build)
    assert len({first.mean_return, first.least_return, first.greatest_return}) == 3  # episodes that differ
    for copies in (1, 3):
        assert evaluate(remembered.run, episodes=20, copies=copies, build=stand_in.build) == first
    assert evaluate(remembered.run, episodes=3, deterministic=False, build=stand_in.build).episodes == 3


@pytest.mark.slow
def test_a_policy_with_a_memory_is_kept_whole_and_goes_on_learning(remembered: TrainingResult) -> None:
    settings = Run.open(remembered.run).program.agent.training
    assert settings is not None
    model = algorithms.create(settings, copies_of(stand_in.scenario(), Remember), seed=5, total_timesteps=100)
    models.load(remembered.run / "models" / "agent" / "last.zip", model)
    assert model.policy.lstm_actor.hidden_size == 16
    more = remembered.steps + 1
    assert resume(remembered.run, total_timesteps=more, build=Remember).steps >= more


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
    assert effective["gamma"].value == 0.9
    assert effective["gamma"].source == "scenario"
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
