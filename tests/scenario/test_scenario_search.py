"""The search spaces of `tune`: how they are written, and which values are refused."""

from __future__ import annotations

import inspect
import json
from collections.abc import Callable

import pytest

from deepbots_cli import api
from deepbots_cli.compiler import CheckedScenario
from deepbots_cli.diagnostics import Finding
from deepbots_cli.scenario import Scenario
from deepbots_cli.scenario.search import SearchSpace
from deepbots_cli.scenario.training import ALGORITHMS, SET_ELSEWHERE_HELP, Training


def with_search(search: str) -> CheckedScenario:
    return api.load("cartpole", overrides=[f"tune.search={{{search}}}"], tests=True)


def spaces(search: str) -> dict[str, SearchSpace]:
    checked = with_search(search)
    assert list(checked.findings) == []
    return dict(checked.search)


def headlines_of(search: str) -> list[str]:
    return [f"{finding.code} {finding.headline}" for finding in with_search(search).findings]


def test_a_range_has_units_and_a_logarithm():
    by_key = spaces("fall_angle: 10..20deg, track: 30 cm .. 0.39 m, train.learning_rate: 1e-4..1e-2:log")
    assert by_key["fall_angle"] == SearchSpace(low=10, high=20, unit="deg")
    assert by_key["track"] == SearchSpace(low=0.3, high=0.39, unit="m")
    assert by_key["train.learning_rate"] == SearchSpace(low=1e-4, high=1e-2, log=True)


def test_a_key_of_whole_numbers_gets_whole_numbers_and_any_other_key_fractions():
    by_key = spaces("train.n_epochs: 5 .. 20, train.ent_coef: 0 .. 1")
    assert [space.whole for space in by_key.values()] == [True, False]
    assert [space.text(value) for space, value in zip(by_key.values(), (7.0, 0.12345), strict=True)] == [
        "7",
        "0.123",
    ]


def test_choices_are_written_with_bars_or_as_a_list():
    by_key = spaces(
        "train.network.activation: tanh | relu, train.network.hidden: [[10, 10], [64, 64]], train.gamma:"
        " [0.9, 0.99]"
    )
    assert [space.choices for space in by_key.values()] == [
        ("tanh", "relu"),
        ("[10, 10]", "[64, 64]"),
        ("0.9", "0.99"),
    ]


def test_a_value_is_rounded_and_stays_in_its_range():
    space = SearchSpace(low=0.99996, high=0.99998, unit="m")
    assert [space.text(value) for value in (0.99996, 0.999973456, 0.99998)] == [
        "0.99996 m",
        "0.99997346 m",
        "0.99998 m",
    ]
    assert SearchSpace(low=1e-5, high=1e-2, log=True).text(0.000123456) == "0.0001235"


def test_a_text_of_the_scenario_is_a_value_of_the_space_or_none():
    assert SearchSpace(low=10, high=20, unit="deg").value_of("15 deg") == 15
    assert SearchSpace(low=0.1, high=0.5, unit="m").value_of("39 cm") == 0.39
    assert SearchSpace(low=0.1, high=0.5, unit="m").value_of("0.7 m") is None
    assert SearchSpace(low=0.1, high=0.5, unit="m").value_of("uniform(0.1 .. 0.2 m)") is None
    assert SearchSpace(choices=("tanh", "relu")).value_of("relu") == "relu"


def test_a_space_that_cannot_be_searched_is_a_finding_at_its_place():
    assert headlines_of("train.lerning_rate: 1e-4 .. 1e-2") == ["DB101 unknown key `lerning_rate` in `train`"]
    assert headlines_of("fall_angl: 1 .. 2 deg") == ["DB201 there is no parameter `fall_angl`"]
    assert headlines_of("train.gamma: 0.9 .. 1.2") == ["DB105 `1.2` is above the largest allowed value"]
    assert headlines_of("train.n_epochs: 5.5 .. 20") == [
        "DB103 expected a whole number, found the number `5.5`"
    ]
    assert headlines_of("track: 0.2 .. 0.4") == [
        "DB503 a length (m) is combined with `track`, a plain number"
    ]
    assert headlines_of("train.network.activation: tanh | relux") == ["DB104 unknown word `relux`"]
    assert headlines_of("track: 0.2 m .. 0.3 m, parameters.track: 0.2 .. 0.4 m") == [
        "DB202 `parameters.track` is already searched"
    ]
    assert headlines_of("solved: a | b") == ["DB407 a search cannot change `solved`"]
    assert headlines_of("train.total_timesteps: 10 .. 20") == [
        "DB407 a search cannot change `train.total_timesteps`"
    ]
    assert headlines_of("train.ent_coef: 0 .. 1 :log") == [
        "DB105 `0 .. 1 :log` has no logarithm at its low end"
    ]
    assert headlines_of("train.gamma: 0.99 .. 0.9") == ["DB105 the range `0.99 .. 0.9` is empty"]
    assert headlines_of("train.batch_size: 64") == [
        "DB103 expected a range or choices, found the number `64`"
    ]
    assert headlines_of("observation.x: -1 .. 1 m | -2 .. 2 m") == [
        "DB613 `observation.x: -1 .. 1 m` changes the interface of the policy"
    ]


def test_a_run_keeps_the_scenario_without_the_search():
    compiled = api.compile(with_search("fall_angle: 10 .. 20 deg"))
    assert "tune" not in compiled.resolved
    assert compiled.digest == api.compile("cartpole").digest


# The table of hyperparameters says what the learning libraries take


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
OURS = {"replay", "lstm", "init_std"}
"""Hyperparameters that are arguments of other classes of the library."""


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


def test_what_is_said_elsewhere_is_not_a_hyperparameter() -> None:
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
