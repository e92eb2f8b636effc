"""The table of hyperparameters says what the learning libraries take."""

import inspect
import json
from collections.abc import Callable

import pytest

from deepbots_cli.diagnostics import Finding
from deepbots_cli.scenario import Scenario
from deepbots_cli.scenario.training import ALGORITHMS, SET_ELSEWHERE_HELP, Training

Check = Callable[[str], tuple[Scenario | None, list[Finding]]]
EXCLUDED = {
    "self",
    "policy",
    "env",
    "verbose",
    "device",
    "seed",
    "tensorboard_log",
    "policy_kwargs",
    "_init_setup_model",
} | {f"{kind}_buffer_{what}" for kind in ("rollout", "replay") for what in ("class", "kwargs")}
OURS = {"replay", "lstm"}


def signature(algorithm: str) -> inspect.Signature:
    library = "sb3_contrib" if algorithm in ("MaskablePPO", "RecurrentPPO", "TQC") else "stable_baselines3"
    return inspect.signature(getattr(pytest.importorskip(library), algorithm).__init__)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_the_table_has_what_the_algorithm_takes(algorithm: str) -> None:
    assert (
        set(ALGORITHMS[algorithm].hyperparameter_names()) - OURS
        == set(signature(algorithm).parameters) - EXCLUDED
    )


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_the_defaults_of_the_algorithm_may_be_written(algorithm: str, check: Check, cartpole: str) -> None:
    parameters = signature(algorithm).parameters
    own = {
        name: parameters[name].default
        for name in ALGORITHMS[algorithm].hyperparameter_names()
        if name not in OURS
    }
    train = {"algorithm": algorithm, "total_timesteps": 1000} | {
        name: value for name, value in own.items() if value is not None
    }
    text = (
        "\n".join(line for line in cartpole.splitlines() if not line.startswith("train:"))
        + f"\ntrain: {json.dumps(train)}\n"
    )
    scenario, findings = check(text)
    assert [finding.headline for finding in findings] == []
    assert scenario is not None
    assert isinstance(scenario.train, Training)
    assert set(scenario.train.hyperparameters) == set(train) - {"algorithm", "total_timesteps"}


def test_what_is_said_elsewhere_is_no_hyperparameter() -> None:
    assert not [
        name
        for name in SET_ELSEWHERE_HELP
        if any(name in model.model_fields for model in ALGORITHMS.values())
    ]


@pytest.mark.parametrize(
    ("algorithm", "entry", "sound"),
    [
        ("SAC", "ent_coef: auto_0.1", True),
        ("SAC", "ent_coef: often", False),
        ("PPO", "ent_coef: auto", False),
        ("SAC", "train_freq: 1 episode", True),
        ("SAC", "train_freq: 0", False),
        ("TD3", "action_noise: {type: ornstein_uhlenbeck, sigma: 0.5 -> 0.1}", True),
        ("TD3", "action_noise: {type: pink, sigma: 0.5}", False),
        ("SAC", "replay: her", True),
        ("SAC", "replay: {type: her, n_sampled_goal: 8}", True),
        ("SAC", "replay: hers", False),
        ("PPO", "clip_range: 0.2 -> 0.1", True),
        ("PPO", "gamma: 98 %", True),
        ("PPO", "gamma: 101 %", False),
        ("PPO", "gamma: 98", False),
        ("PPO", "learning_rate: -1e-3", False),
        ("PPO", "learning_rate: 1e-3 -> -1", False),
    ],
)
def test_hyperparameters_are_checked_by_their_kind(
    check: Check, cartpole: str, algorithm: str, entry: str, sound: bool
) -> None:
    _, findings = check(cartpole.replace("algorithm: PPO,", f"algorithm: {algorithm}, {entry},"))
    assert (not findings) == sound
    assert len(findings) <= 1


def test_a_percentage_becomes_a_number(check: Check, cartpole: str) -> None:
    scenario, _ = check(cartpole.replace("algorithm: PPO,", "algorithm: PPO, gamma: 57 %,"))
    assert scenario is not None
    assert scenario.train is not None
    assert scenario.train.hyperparameters["gamma"] == 0.57
