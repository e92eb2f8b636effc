"""Damaged files of a run: damaged or correct, never a crash, little memory, and nothing changes where a
command is refused."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "learning"))

import stand_in
from stand_in import hyper

from deepbots_cli.cli.records import evaluation_json, write_evaluation
from deepbots_cli.learning import evaluate, train
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.program.task import Network, Solved, Training
from tests.fuzz.run_files import files_of, problems


def trained(folder: Path, training: Training) -> Path:
    """A run with all its steps and an evaluation."""
    task = stand_in.compiled(training=training, solved=Solved(10, mean_return=1e6))
    run = train(task, run=folder / training.algorithm.lower(), build=stand_in.build).run
    write_evaluation(Run.open(run), evaluation_json(evaluate(run, episodes=4, build=stand_in.build), ()))
    return run


@pytest.fixture(scope="module")
def run_on_policy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return trained(
        tmp_path_factory.mktemp("trained"),
        Training("PPO", 640, 2, hyper(n_steps=32, batch_size=32, n_epochs=1)),
    )


@pytest.fixture(scope="module")
def runs(run_on_policy: Path, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    off_policy = Training("DQN", 300, 2, hyper(learning_starts=50, buffer_size=400), Network((16,)))
    return [run_on_policy, trained(tmp_path_factory.mktemp("trained"), off_policy)]


PARTS = ("checkpoints", "run.json", "resolved.yaml", "monitor.csv", "evaluations", "models", "tensorboard")


@pytest.mark.slow
def test_a_damaged_file_of_a_run_is_damaged_or_correct(run_on_policy: Path) -> None:
    files = files_of(run_on_policy)
    cases = [(file, number) for file in files for number in range(2 if file.endswith("state.json") else 1)]
    assert {file.partition("/")[0] for file, _ in cases} == set(PARTS)
    assert not list(problems(run_on_policy, cases))


@pytest.mark.slow
@pytest.mark.parametrize(("run", "part"), [*((0, part) for part in PARTS), (1, "checkpoints")])
def test_so_is_each_file_after_any_of_five_hundred_changes(runs: list[Path], run: int, part: str) -> None:
    cases = [(file, number) for file in files_of(runs[run]) if file.startswith(part) for number in range(500)]
    assert not list(problems(runs[run], cases))
