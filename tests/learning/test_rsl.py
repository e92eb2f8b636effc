"""PPO of RSL-RL trains, resumes, evaluates and exports as the built-in algorithms do."""

from __future__ import annotations

import inspect
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

pytest.importorskip("rsl_rl")

import stand_in
import torch
from rsl_rl.models import MLPModel
from rsl_rl.modules import GaussianDistribution
from stable_baselines3.common.logger import Logger
from stand_in import hyper
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensordict import TensorDict

from deepbots_cli import api
from deepbots_cli.cli import main
from deepbots_cli.errors import MissingExtraError, ScenarioError, UsageError
from deepbots_cli.learning import evaluate, learner, resume, train
from deepbots_cli.learning.evaluation import load_model
from deepbots_cli.learning.learner import Setup
from deepbots_cli.learning.rsl import internals
from deepbots_cli.learning.rsl.learner import RslLearner
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.learning.sb3.defaults import effective_hyperparameters
from deepbots_cli.program.task import Training
from deepbots_cli.rollout.collector import LocalCollector
from deepbots_cli.rollout.worlds import SingleWorlds
from tests.learning.interruption import At
from tests.private_members import private_members

MODULE = Path(internals.__file__)
RANGES = gym.spaces.Box(-1.0, 1.0, (2,), np.float32)
SHORT = Training("rsl_rl.PPO", 2_000, 4, hyper(num_steps_per_env=32))
EVERYTHING = replace(
    SHORT,
    normalize="reward",
    hyperparameters=hyper(num_steps_per_env=32, obs_normalization=True, std_type="log", optimizer="adamw"),
)


def policy(training: Training = SHORT, **settings: Any) -> RslLearner:
    """A policy that does not learn."""
    untrained = learner.create(Setup(training, RANGES, RANGES, **settings))
    assert isinstance(untrained, RslLearner)
    return untrained


def test_only_the_critic_sees_the_values_of_the_critic() -> None:
    wide = gym.spaces.Box(-1.0, 1.0, (5,), np.float32)
    columns = (0, 3)
    untrained = learner.create(Setup(SHORT, wide, RANGES, policy_columns=columns))
    assert isinstance(untrained, RslLearner)
    observations = np.random.default_rng(1).uniform(-1, 1, (4, 5)).astype(np.float32)
    changed = observations.copy()
    changed[:, [1, 2, 4]] += 0.5
    actions = [
        untrained.predict(rows, deterministic=True)[0]
        for rows in (observations, changed, observations[:, list(columns)])
    ]
    np.testing.assert_array_equal(actions[0], actions[1])
    np.testing.assert_array_equal(actions[0], actions[2])
    assert untrained.algorithm.critic.mlp[0].in_features == 5
    assert untrained.network().layers[0].in_features == 2


def scalars_of(folder: Path) -> EventAccumulator:
    events = EventAccumulator(str(folder / "tensorboard"), size_guidance={"scalars": 0})
    events.Reload()
    return events


def digest_of(folder: Path) -> str:
    return load_model(Run.open(folder), "last").digest()


@pytest.mark.slow
def test_a_training_changes_the_weights_and_its_policy_is_evaluated(tmp_path: Path) -> None:
    task = stand_in.compiled(training=SHORT, continuous=True)
    short, whole = (
        train(task, run=tmp_path / name, build=stand_in.build, total_timesteps=steps)
        for name, steps in (("short", 128), ("whole", 384))
    )
    assert (short.steps, whole.steps) == (128, 384)
    assert short.weights_digest != whole.weights_digest == digest_of(whole.run)
    evaluation = evaluate(whole.run, episodes=3, build=stand_in.build)
    assert evaluation.episodes == 3


@pytest.mark.slow
@pytest.mark.parametrize(
    "training",
    [
        pytest.param(SHORT, id="usual", marks=pytest.mark.slow),
        pytest.param(EVERYTHING, id="everything", marks=pytest.mark.slow),
        pytest.param(replace(SHORT, shards=2), id="shards", marks=pytest.mark.slow),
        pytest.param(replace(EVERYTHING, shards=2, staleness=1), id="stale shards of everything"),
    ],
)
def test_an_interrupted_training_has_the_weights_of_one_that_was_not(
    tmp_path: Path, training: Training
) -> None:
    task = stand_in.compiled(training=training, continuous=True)
    whole = train(task, run=tmp_path / "whole", build=stand_in.build)
    assert train(task, run=tmp_path / "parts", build=stand_in.build, progress=At(1_000)).interrupted
    parts = resume(tmp_path / "parts", build=stand_in.build)
    assert (parts.weights_digest, parts.inexact) == (whole.weights_digest, ())
    for name in ("train/learning_rate", "rollout/ep_rew_mean"):
        values = [
            [(event.step, event.value) for event in scalars_of(run).Scalars(name)]
            for run in (whole.run, parts.run)
        ]
        assert len(values[0]) > 10
        assert values[0] == values[1]


def test_the_value_of_the_observation_at_a_time_limit_is_added_to_the_last_reward() -> None:
    settings = hyper(num_steps_per_env=16, learning_rate=1e-12, schedule="fixed")  # the values stay
    training = replace(SHORT, hyperparameters=settings)
    program = stand_in.compiled(training=training, continuous=True, max_steps=5).program
    collector = LocalCollector(SingleWorlds([stand_in.build(program)], [0]))
    spaces = collector.observation_space, collector.action_space
    untrained = learner.create(Setup(training, *spaces, collector=collector))
    assert isinstance(untrained, RslLearner)
    untrained.log = Logger(None, [])  # type: ignore[assignment]
    fragment = collector.collect(untrained.act, 16)
    assert fragment is not None
    untrained.fragment = fragment
    untrained.update()
    stored = untrained.algorithm.storage.rewards[..., 0].numpy()
    assert [ending.timed_out for _, ending in fragment.endings] == [True] * 3
    expected = fragment.rewards.copy()
    for step, ending in fragment.endings:
        values = untrained.values([ending.observation])
        assert values is not None
        expected[step, ending.row] += untrained.algorithm.gamma * values[0]
    assert np.abs(stored - expected).max() < 1e-5


def test_the_prediction_is_the_mean_of_the_distribution_in_the_range_of_the_agent() -> None:
    untrained = policy(EVERYTHING)
    actor = untrained.algorithm.actor
    observations = np.random.default_rng(0).normal(0, 50, (100, 2)).astype(np.float32)
    untrained.algorithm.actor.update_normalization(
        TensorDict({"policy": torch.from_numpy(observations) / 7}, batch_size=[100])
    )
    with torch.no_grad():
        means = actor(TensorDict({"policy": torch.from_numpy(observations)}, batch_size=[100])).numpy()
    actions, _ = untrained.predict(observations, deterministic=True)
    assert (actions == means.clip(-1, 1)).all()
    drawn, _ = untrained.predict(observations)
    assert (drawn != actions).any()
    assert np.abs(drawn).max() <= 1


@pytest.mark.slow
@pytest.mark.parametrize("training", [SHORT, EVERYTHING], ids=["usual", "everything"])
def test_an_exported_policy_acts_as_the_policy(tmp_path: Path, training: Training) -> None:
    pytest.importorskip("onnx")
    onnxruntime = pytest.importorskip("onnxruntime")
    from deepbots_cli.insight.export.network import policy_graph

    task = stand_in.compiled(training=training, continuous=True)
    train(task, run=tmp_path / "run", build=stand_in.build, total_timesteps=300)
    loaded = load_model(Run.open(tmp_path / "run"), "last")
    session = onnxruntime.InferenceSession(policy_graph(loaded, task.program))
    observations = np.random.default_rng(0).uniform(-1, 1, (50, 4)).astype(np.float32)
    (actions,) = session.run(["action"], {"observation": observations})
    expected, _ = loaded.predict(observations, deterministic=True)
    assert np.abs(actions - expected).max() < 1e-5


TRAIN = "train={algorithm: rsl_rl.PPO, total_timesteps: 500, environments: 4, num_steps_per_env: 64}"


def test_the_commands_train_evaluate_and_export(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("onnx")
    monkeypatch.chdir(tmp_path)
    changes = ("--set", TRAIN, "--set", "world.engine=mujoco", "--set", "evaluation={episodes: 3}")
    for words in (
        ("train", "cartpole_continuous", "--run", "run", *changes),
        ("eval", "run", "--last", "--json"),
        ("export", "run", "--output", "bundle.zip"),
    ):
        assert main([*words]) == 0, capfd.readouterr().err
    assert json.loads(Path("run/run.json").read_text())["result"]["steps"] == 512


def test_a_choice_is_refused_in_a_finding_and_in_an_error() -> None:
    with pytest.raises(ScenarioError, match="DB612"):
        api.compile("cartpole", overrides=[TRAIN])
    with pytest.raises(
        UsageError, match=r"^rsl_rl\.PPO acts by ranges, such as `drive: -1 \.\. 1`; for choices"
    ):
        learner.create(Setup(SHORT, RANGES, gym.spaces.Discrete(2)))


def test_without_the_extra_the_error_names_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rsl_rl.algorithms", None)
    monkeypatch.delitem(sys.modules, "deepbots_cli.learning.rsl.learner")
    with pytest.raises(MissingExtraError, match=r"^training with rsl_rl\.PPO needs the 'rsl' extra"):
        learner.create(Setup(SHORT, RANGES, RANGES))


def test_an_image_is_refused() -> None:
    image = gym.spaces.Box(0, 255, (8, 8, 3), np.uint8)
    with pytest.raises(UsageError, match=r"^rsl_rl\.PPO observes a vector of numbers, without images"):
        learner.create(Setup(SHORT, image, RANGES))


def test_an_unknown_setting_is_a_finding_with_the_nearest_name() -> None:
    train = TRAIN.replace("num_steps_per_env", "num_minibatches")
    with pytest.raises(ScenarioError) as caught:
        api.compile("cartpole_continuous", overrides=[train])
    (finding,) = caught.value.findings
    assert finding.headline == "unknown key `num_minibatches` in `train`"
    assert "num_mini_batches" in (finding.help or "")


@pytest.mark.parametrize(
    ("training", "sentence"),
    [
        (replace(SHORT, device="cuda"), "trains on the CPU"),
        (replace(SHORT, network=replace(SHORT.network, hidden=())), "needs a hidden layer"),
    ],
    ids=["cuda", "no layers"],
)
def test_settings_that_the_learner_does_not_support_are_refused(training: Training, sentence: str) -> None:
    with pytest.raises(UsageError, match=sentence):
        RslLearner.check(training)


def test_a_rollout_that_is_smaller_than_its_batches_is_refused(tmp_path: Path) -> None:
    settings = hyper(num_steps_per_env=1, num_mini_batches=4)
    task = stand_in.compiled(training=replace(SHORT, hyperparameters=settings), continuous=True)
    with pytest.raises(UsageError, match="a rollout of 4 steps cannot be divided into 4 batches"):
        train(task, run=tmp_path / "run", build=stand_in.build)


def test_a_policy_that_does_not_learn_leaves_the_generators_and_the_checks_of_torch_as_they_are() -> None:
    before = torch.get_rng_state()
    policy(seed=7)
    assert (torch.get_rng_state() == before).all()
    with pytest.raises(ValueError, match="constraint"):
        torch.distributions.Normal(torch.tensor(float("nan")), torch.tensor(1.0))


def test_the_seed_determines_the_initial_weights() -> None:
    assert policy(seed=1).digest() == policy(seed=1).digest() != policy(seed=2).digest()


# The library


def test_the_algorithm_of_the_library_gets_the_effective_hyperparameters() -> None:
    training = replace(SHORT, hyperparameters=hyper(gamma=0.9, schedule="fixed"))
    program = stand_in.compiled(training=training, continuous=True).program
    algorithm = policy(training).algorithm
    effective = {
        entry.name: entry.value
        for entry in effective_hyperparameters(program, 2_000)
        if hasattr(algorithm, entry.name) and entry.name != "optimizer"
    }
    assert effective.keys() >= {"learning_rate", "gamma", "schedule", "clip_param", "use_clipped_value_loss"}
    assert {name: getattr(algorithm, name) for name in effective} == effective


def test_our_defaults_of_networks_are_those_of_the_library() -> None:
    program = stand_in.compiled(training=SHORT, continuous=True).program
    effective = {entry.name: entry.value for entry in effective_hyperparameters(program, 2_000)}
    arguments = {
        **inspect.signature(GaussianDistribution).parameters,
        **inspect.signature(MLPModel).parameters,
    }
    for name in ("init_std", "std_type", "learn_std", "obs_normalization"):
        assert effective[name] == arguments[name].default


def test_the_libraries_have_each_private_member() -> None:
    used = {name for _, name in private_members(MODULE)}
    assert used == {"_validate_args"}
    assert all(hasattr(torch.distributions.Distribution, name) for name in used)
