"""Why a training fell apart: the setting that explains the fall comes first, and its advice is a value that
the scenario does not have."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from deepbots_cli import api
from deepbots_cli.cli import main
from deepbots_cli.document import shipped
from deepbots_cli.insight.collapse import suspects
from deepbots_cli.insight.diagnosis import causes_after, diagnose
from deepbots_cli.insight.training import TrainingEvidence, read_training
from deepbots_cli.learning.runs.decline import Decline
from deepbots_cli.learning.runs.run import Run
from tests.few import few
from tests.insight.collapses import CASES, has_fallen, named, trained

MEANS = (20, 60, 200, 200, 195, 200, 60, 40, 30, 50)


def _lines(means=MEANS, every: int = 6000) -> list[dict]:
    """Evaluations of 20 episodes whose returns have these means."""
    spread = np.linspace(-3, 3, 20)
    return [
        {
            "steps": every * (number + 1),
            "stage": "",
            "is_best": False,
            "returns": (mean + spread).tolist(),
            "successes": [0.0] * 20,
        }
        for number, mean in enumerate(means)
    ]


def _fallen(
    run: Path, *settings: str, scenario: str = "cartpole", means=MEANS, **scalars
) -> TrainingEvidence:
    """A training of another scenario and with other logs, in the folder of a short one."""
    training = read_training(Run.open(run))
    opened = replace(
        training.run,
        record=training.run.record.model_copy(update={"total_timesteps": 60_000}),
        compiled=api.compile(api.load(scenario, overrides=settings)),
    )
    curves = {
        name.replace("__", "/"): (np.linspace(0, 60_000, len(values)), np.asarray(values, float))
        for name, values in scalars.items()
    }
    return replace(training, run=opened, all_evaluations=_lines(means), scalars=curves)


@pytest.mark.parametrize(
    ("settings", "path", "advised"),
    [
        (["train.learning_rate=2e-2"], "train.learning_rate", "0.003 -> 0.0003"),
        (["train.n_epochs=100"], "train.n_epochs", "10"),
        (["train.ent_coef=0.2"], "train.ent_coef", "0.01"),
        (["train.clip_range=0.9"], "train.clip_range", "0.2"),
        (["train.batch_size=8"], "train.batch_size", "256"),
        (["train.max_grad_norm=50"], "train.max_grad_norm", "0.5"),
        (["train.gamma=0.5"], "train.gamma", "0.98"),
    ],
)
def test_the_setting_that_is_far_from_usual_comes_first(short, settings, path, advised):
    training = _fallen(
        short, *settings, train__approx_kl=[0.01, 0.2] * 10, train__entropy_loss=[-0.6, -0.4, -0.5, -0.65]
    )
    first = diagnose(training)[0]
    assert first.cause == "fell_apart"
    assert first.evidence["suspects"][0]["path"] == path
    assert first.settings == {path: advised}
    assert f"`{path}: {advised}`" in first.advice
    assert first.text.startswith(
        "The training got worse: the mean return of its evaluations fell from 200 at 36,000 steps"
    )


def test_large_rewards_are_named(short):
    means = [100 * mean for mean in MEANS]
    training = _fallen(short, "reward.alive=100", means=means, train__explained_variance=[0.1] * 20)
    first = diagnose(training)[0]
    assert first.settings == {"train.normalize": "reward"}
    normalized = _fallen(
        short, "reward.alive=100", "train.normalize=reward", means=means, train__explained_variance=[0.1] * 20
    )
    assert "train.normalize" not in diagnose(normalized)[0].settings


@pytest.mark.parametrize(
    ("settings", "path"),
    [
        ("algorithm: DQN", None),
        ("algorithm: DQN, buffer_size: 500", "train.buffer_size"),
        ("algorithm: DQN, target_update_interval: 1", "train.target_update_interval"),
        ("algorithm: DQN, learning_rate: 1e-2", "train.learning_rate"),
        ("algorithm: A2C", None),
    ],
)
def test_defaults_are_not_suspected_and_values_far_from_them_are(short, settings, path):
    first = diagnose(_fallen(short, f"train={{{settings}, total_timesteps: 60_000, environments: 8}}"))[0]
    assert [suspect["path"] for suspect in first.evidence["suspects"]][:1] == ([] if path is None else [path])


def test_with_usual_settings_the_advice_is_smaller_updates(short):
    first = diagnose(_fallen(short))[0]
    assert first.cause == "fell_apart"
    assert first.evidence["suspects"] == []
    assert first.settings == {"train.learning_rate": "0.005 -> 0.0005"}


def test_a_success_that_is_given_up_for_more_reward_is_not_a_matter_of_settings(short):
    """As where a policy learns to stay beside the mark, which pays more than the mark."""
    training = _fallen(
        short, "train.n_epochs=100", scenario="pit_escape", means=(1, 3, 9, 9, 9, 10, 20, 30, 31, 34)
    )
    for number, each in enumerate(training.all_evaluations):
        each["successes"] = [float(2 <= number <= 5)] * 20
    solved = replace(training.run.program.agent, solved=None)
    opened = replace(training.run.compiled, program=replace(training.run.program, agent=solved))
    training = replace(training, run=replace(training.run, compiled=opened))
    (cause,) = [cause for cause in diagnose(training) if cause.cause == "fell_apart"]
    assert cause.settings == {}
    assert "Meanwhile the mean return rose from" in cause.text


def test_a_training_that_gets_worse_after_its_teacher_ended_is_named(short):
    """A training with a teacher that got much worse after its best evaluation once had no diagnosis."""
    taught = (
        [1.0] * 12 + [0.5] * 2 + [0.0] * 6
    )  # the weight falls from 37,900 steps on, the evaluations from 42,000
    first = diagnose(_fallen(short, teacher__weight=taught))[0]
    assert first.cause == "fell_apart"
    assert "It fell after the teacher had ended, at 37,894 steps" in first.text
    assert first.settings == {"train.learning_rate": "0.001"}
    during = diagnose(_fallen(short, teacher__weight=[1.0] * 20))[0]
    assert during.cause == "fell_apart"
    assert "teacher" not in during.text


@pytest.mark.parametrize("scenario", few(shipped.scenario_names(), ["find_ball", "panda_push", "pit_escape"]))
def test_no_setting_of_a_shipped_scenario_is_suspected(short, scenario):
    training = _fallen(short, scenario=scenario)
    fall = Decline("mean_return", 200.0, 36_000, 40.0, 42_000, 20, 60, "the last quarter", 45_000)
    assert suspects(replace(training, all_evaluations=[]), fall) == []


def test_a_healthy_training_has_not_fallen_apart(short):
    assert "fell_apart" not in [
        cause.cause for cause in diagnose(_fallen(short, means=(20, 60, 150, 190, 200, 195, 200, 198)))
    ]


@pytest.fixture
def fallen(short, tmp_path) -> Path:
    """A run whose evaluations fell, of a training that records nothing else of it."""
    run = Path(shutil.copytree(short, tmp_path / "fallen"))
    (run / "evaluations" / "training.jsonl").write_text("".join(f"{json.dumps(line)}\n" for line in _lines()))
    return run


@pytest.mark.slow
def test_every_command_prints_the_same_sentence(fallen, tmp_path, capsys):
    sentence = "the training got worse: the mean return of its evaluations fell from 200 at 36,000 steps to"
    assert main(["runs", str(fallen.parent)]) == 0
    assert f"fallen: {sentence}" in capsys.readouterr().err
    assert main(["runs", str(fallen.parent), "--json"]) == 0
    (listed,) = json.loads(capsys.readouterr().out)
    assert listed["decline"]["text"].startswith(sentence)
    assert listed["decline"]["measure"] == "mean_return"
    assert listed["decline"]["best_steps"] == 36_000
    assert main(["diagnose", str(fallen), "--only-logs"]) == 0
    assert sentence[1:] in capsys.readouterr().out
    assert main(["eval", str(fallen), "--episodes", "2"]) == 0
    assert main(["report", str(fallen), "-o", str(tmp_path / "page.html")]) == 0
    assert sentence in (tmp_path / "page.html").read_text("utf-8")


def test_a_training_that_fell_apart_after_it_was_solved_has_the_cause_of_its_fall(fallen):
    training = read_training(Run.open(fallen))
    assert training.solved  # by an evaluation
    assert causes_after(fallen)[0].cause == "fell_apart"


@pytest.mark.slow
def test_the_planted_setting_is_among_the_first_two(tmp_path):
    """Ten minutes of CPU time."""
    right = fell = 0
    for case in CASES:
        run = trained(case, tmp_path / case.name)
        is_named, paths = named(run)
        if case.planted and has_fallen(run):
            assert is_named, case
            fell += 1
            right += bool(set(paths[:2]) & set(case.planted))
        elif not case.planted and not has_fallen(run):
            assert not is_named, case
    assert fell > 0
    assert right >= 0.8 * fell
