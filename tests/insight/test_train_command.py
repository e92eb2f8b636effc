"""The command that trains the scenario of a run again."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

pytest.importorskip("stable_baselines3")

from deepbots_cli.insight.train_command import training_command
from deepbots_cli.learning.runs.records import write_record
from deepbots_cli.learning.runs.run import Run


@pytest.fixture
def short_copy(short: Path, tmp_path: Path) -> Path:
    return shutil.copytree(short, tmp_path / "short")


def command_of(folder: Path, *words: str) -> list[str]:
    """Return the command for a run that this command line has trained."""
    run = Run.open(folder)
    write_record(folder, run.record.model_copy(update={"command": ("deepbots", "train", "cartpole", *words)}))
    return training_command(Run.open(folder), ["train.gamma=0.9"])


def test_it_has_the_seed_the_settings_and_further_values(short_copy):
    words = command_of(short_copy, "--set", "train.gamma=0.5", "--set=train.n_steps=64")
    assert words[:3] == ["deepbots", "train", "cartpole"]
    assert words[words.index("--seed") + 1] == "2"
    settings = [words[index + 1] for index, word in enumerate(words) if word == "--set"]
    assert settings == ["train.n_steps=64", "train.gamma=0.9"]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("--initialize-from", "runs/a"),
        ("--keep-checkpoints", "5"),
        ("--callback", "own"),
        ("--logger", "csv"),
        ("--allow-path", "/data/robots"),
    ],
)
def test_an_option_of_the_run_is_kept(short_copy, name: str, value: str):
    for words in ([name, value], [f"{name}={value}"]):
        command = command_of(short_copy, *words)
        assert command[command.index(name) + 1] == value


def test_the_shards_are_those_that_were_chosen(short_copy):
    words = command_of(short_copy, "--shards", "auto")
    assert words[words.index("--shards") + 1] == "1"


def test_permissions_for_code_are_kept_and_the_folder_of_the_run_is_not(short_copy):
    command = command_of(short_copy, "--run", "runs/mine", "--allow-code")
    assert "--allow-code" in command
    assert "--run" not in command
