"""A scenario that names no algorithm is trained with the learner that deepbots chooses by its structure."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from deepbots_cli import api
from deepbots_cli.api import Compiled
from deepbots_cli.document import shipped
from deepbots_cli.errors import ScenarioError
from deepbots_cli.learning import train
from deepbots_cli.learning.runs.run import Run
from tests.few import few

EXPECTED = {
    "balancer": ("PPO", 16),
    "cartpole": ("PPO", 8),
    "cartpole_continuous": ("PPO", 8),
    "find_and_avoid": ("MaskablePPO", 16),
    "find_ball": ("SAC", 8),
    "multi_cartpole": ("PPO", 1),
    "panda_push": ("SAC", 4),
    "panda_reach": ("SAC", 4),
    "quadruped": ("PPO", 256),
    "see_ball": ("PPO", 16),
}


def compiled(folder: Path, scenario: str, train: str | None = None) -> Compiled:
    """A shipped scenario with this `train` section instead of its own, with the learner that is chosen."""
    own = "" if train is None else f"train: {train}\n"
    base = folder / "base.yaml"
    base.write_text(f"deepbots: 1\nextends: {scenario}\nname: Base\nremove: [train]\n", encoding="utf-8")
    file = folder / "mine.yaml"
    file.write_text(f"deepbots: 1\nextends: base.yaml\nname: Mine\n{own}", encoding="utf-8")
    return api.with_learner(api.compile(file))


def settings(chosen: Compiled) -> dict[str, Any]:
    training = chosen.program.agent.training
    assert training is not None
    return {entry.name: entry.value for entry in training.hyperparameters} | vars(training)


@pytest.mark.parametrize(
    "scenario", few(shipped.scenario_names(), ("cartpole", "find_ball", "panda_push", "quadruped", "tag"))
)
def test_every_shipped_scenario_without_train_can_be_trained(tmp_path: Path, scenario: str) -> None:
    chosen = compiled(tmp_path, scenario)
    assert chosen.findings == ()
    assert chosen.learner
    algorithm, worlds = EXPECTED.get(scenario, (None, None))
    assert algorithm is None or (settings(chosen)["algorithm"], settings(chosen)["environments"]) == (
        algorithm,
        worlds,
    )


@pytest.mark.slow
@pytest.mark.parametrize("scenario", few(EXPECTED, ("cartpole",)))
def test_a_chosen_learner_trains(tmp_path: Path, scenario: str) -> None:
    result = train(compiled(tmp_path, scenario), run=tmp_path / "run", total_timesteps=300)
    assert result.steps >= 300
    run = Run.open(tmp_path / "run")
    assert run.program.agent.training == compiled(tmp_path, scenario).program.agent.training
    assert run.record.learner == compiled(tmp_path, scenario).learner


def test_auto_is_the_same_as_none(tmp_path: Path) -> None:
    none, empty, auto = (
        compiled(tmp_path, "cartpole", text) for text in (None, "{gamma: 98 %}", "{algorithm: auto}")
    )
    assert none.digest == auto.digest == empty.digest
    assert none.resolved == auto.resolved


def test_with_a_teacher_the_policy_learns_by_imitation(tmp_path: Path) -> None:
    assert settings(compiled(tmp_path, "panda_push", "{teacher: by_hand}"))["algorithm"] == "PPO"
    assert settings(compiled(tmp_path, "quadruped", "{teacher: trot}"))["environments"] == 16


def test_given_values_stay_and_their_reasons_go(tmp_path: Path) -> None:
    values = {
        "gamma": 0.5,
        "n_epochs": 3,
        "environments": 3,
        "network": {"activation": "relu"},
        "total_timesteps": 1000,
        "learning_rate": "1e-3 -> 0",
    }
    chosen = compiled(tmp_path, "cartpole", json.dumps(values))
    chosen_settings = settings(chosen)
    assert (
        chosen_settings["gamma"],
        chosen_settings["environments"],
        chosen_settings["total_timesteps"],
    ) == (0.5, 3, 1000)
    assert chosen_settings["network"].hidden == (64, 64)
    assert chosen_settings["network"].activation == "relu"
    assert (chosen_settings["learning_rate"].start, chosen_settings["learning_rate"].end) == (1e-3, 0)
    assert (chosen_settings["n_epochs"], chosen_settings["n_steps"]) == (3, 64)
    assert [reason.split(":")[0] for reason in chosen.learner] == [
        "PPO"
    ]  # those for `environments` and `gamma` are gone


def test_a_scenario_without_train_is_otherwise_as_before(tmp_path: Path) -> None:
    compiled(tmp_path, "cartpole")
    assert api.compile(tmp_path / "mine.yaml").program.agent.training is None


def test_what_no_algorithm_can_act_in_is_an_error(tmp_path: Path) -> None:
    base = compiled(tmp_path, "cartpole").source
    mixed = tmp_path / "mixed.yaml"
    mixed.write_text(
        f"deepbots: 1\nextends: {base.name}\nname: Mixed\naction: {{more: -1 .. 1}}\n", encoding="utf-8"
    )
    with pytest.raises(ScenarioError, match="no algorithm supports choices and ranges"):
        train(mixed, run=tmp_path / "run")
    assert not (tmp_path / "run").exists()
