"""A policy that sees more teaches one that sees less."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from deepbots_cli import api
from deepbots_cli.errors import UsageError
from deepbots_cli.learning import TrainingResult, load_policy, resume, train
from tests.learning.interruption import At, outcome

TEACHER = """
deepbots: 1
extends: cartpole
name: Knowing
world: {engine: mujoco}
evaluation: {episodes: 4}
train: {total_timesteps: 2048}
"""
STUDENT = """
deepbots: 1
extends: cartpole
name: Sensing
world: {engine: mujoco}
evaluation: {episodes: 4}
remove: [observation.speed, observation.tip_speed]
observation: {cart.pole_angle: {range: -20 .. 20 deg, history: 3}}
critic: {CRITIC}
solved: mean_return >= 1000000 over 2 episodes
train: {total_timesteps: 4096, algorithm: {algorithm}}
"""
CRITIC = "{speed: -0.8 .. 0.8 m/s, tip_speed: -2 .. 2 m/s}"


@pytest.fixture(scope="module")
def teacher(tmp_path_factory: pytest.TempPathFactory) -> TrainingResult:
    folder = tmp_path_factory.mktemp("teacher")
    (folder / "teacher.yaml").write_text(TEACHER)
    return train(folder / "teacher.yaml", run=folder / "run")


def student(folder: Path, critic: str = CRITIC, algorithm: str = "PPO") -> Path:
    path = folder / "student.yaml"
    path.write_text(STUDENT.replace("{CRITIC}", critic).replace("{algorithm}", algorithm))
    return path


def test_a_policy_imitates_one_that_sees_more(teacher: TrainingResult, tmp_path: Path) -> None:
    result = train(
        student(tmp_path),
        run=tmp_path / "run",
        demonstrations=teacher.run,
        loggers=["csv"],
    )
    rows = [line.split(",") for line in (result.run / "logs" / "scalars.csv").read_text().splitlines()[1:]]
    agreements = [float(value) for _, name, value in rows if name == "teacher/agreement"]
    assert max(agreements) > 0.8
    assert any(name == "teacher/mean_return" for _, name, _ in rows)
    assert [entry.name for entry in load_policy(result.run).observation] == ["x"] + 3 * ["cart.pole_angle"]


@pytest.mark.slow
def test_an_interrupted_training_continues_without_the_run_of_its_teacher(
    teacher: TrainingResult, tmp_path: Path
) -> None:
    copy = shutil.copytree(teacher.run, tmp_path / "teacher")
    compiled = api.compile(student(tmp_path), overrides=["train.n_steps=32", "world.engine=pybullet"])
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    train(compiled, run=whole, demonstrations=copy, total_timesteps=768)
    train(compiled, run=parts, demonstrations=copy, total_timesteps=768, progress=At(300))
    shutil.rmtree(copy)
    resume(parts)
    expected, continued = outcome(whole), outcome(parts)
    for part in ("models", "scalars", "monitor", "evaluations"):
        assert continued[part] == expected[part], part


@pytest.mark.parametrize(
    ("critic", "words"),
    [
        (
            "{speed: -0.8 .. 0.8 m/s}",
            "sees `tip_speed`, which the training does not compute; list it under `critic`",
        ),
        ("{speed: -1 .. 1 m/s, tip_speed: -2 .. 2 m/s}", "sees `speed` with another range or history"),
    ],
)
def test_the_training_computes_all_that_the_teacher_sees(
    teacher: TrainingResult, tmp_path: Path, critic: str, words: str
) -> None:
    with pytest.raises(UsageError, match=words):
        train(student(tmp_path, critic), run=tmp_path / "run", demonstrations=teacher.run)
    assert not (tmp_path / "run").exists()


def test_a_teacher_with_another_action_is_refused(teacher: TrainingResult, tmp_path: Path) -> None:
    compiled = api.compile("cartpole_continuous")
    with pytest.raises(UsageError, match="has another action than CartPoleContinuous"):
        train(compiled, run=tmp_path / "run", demonstrations=teacher.run)


def test_an_off_policy_algorithm_is_refused(teacher: TrainingResult, tmp_path: Path) -> None:
    compiled = api.compile("cartpole_continuous", overrides=["train={algorithm: SAC, total_timesteps: 1000}"])
    with pytest.raises(UsageError, match="SAC cannot learn from the policy of a run; use PPO"):
        train(compiled, run=tmp_path / "run", demonstrations=teacher.run)
