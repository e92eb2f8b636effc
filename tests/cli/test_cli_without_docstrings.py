"""`python -OO -m deepbots_cli` prints the same: no text for users is a docstring, and no assertion is
needed."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from deepbots_cli.cli.commands import COMMANDS

LINES = [
    *([name, "--help"] for name in COMMANDS),
    ["--help"],
    ["explain", "DB603"],
    ["explain", "DB611"],
    ["explain", "gyro"],
    ["lint", "cartpole"],
]


@pytest.fixture(autouse=True)
def same_width(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "100")


def without_docstrings(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-OO", *words], cwd=folder, capture_output=True, text=True, check=True
    )


@pytest.mark.parametrize(
    "lines",
    [LINES, pytest.param([["lint", "cartpole", "--deep"]], marks=pytest.mark.slow)],
    ids=["all", "deep"],
)
def test_a_command_prints_the_same_without_docstrings(deepbots, tmp_path, lines):
    code = f"from deepbots_cli.cli import main\nfor line in {lines}:\n    main(line)"
    printed = [deepbots(*line).out for line in lines]
    assert all(printed)
    assert without_docstrings(tmp_path, "-c", code).stdout == "".join(printed)


@pytest.mark.slow
def test_a_training_is_diagnosed_the_same_without_docstrings(deepbots, tmp_path):
    trained = without_docstrings(
        tmp_path, "-m", "deepbots_cli", "train", "cartpole", "--timesteps", "2000", "--run", "mine"
    )
    assert "most likely cause: The training is short." in trained.stdout + trained.stderr
    diagnosis = without_docstrings(tmp_path, "-m", "deepbots_cli", "diagnose", "mine").stdout
    assert "Try: Continue the training" in diagnosis
    assert diagnosis == deepbots("diagnose", "mine").out
