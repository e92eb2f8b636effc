"""A training that is not solved names what it changed since the run that was."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

pytest.importorskip("stable_baselines3")

from deepbots_cli.cli import main
from tests.insight.logs import SHUTTLE

SHORT = (
    SHUTTLE.read_text("utf-8")
    .replace("environments: 16", "environments: 2")
    .replace("n_steps: 64", "n_steps: 32")
)
TEXT = f"""{SHORT}
solved: success_rate >= 50 % over 20 episodes
"""
EASY = TEXT.replace("near:  4 cm", "near:  5 m")
HARD = TEXT.replace("near:  4 cm", "near:  0.1 mm").replace("  time: ", "  bonus: 0.001\n  time: ")


def _trained(folder: Path, name: str, text: str, *options: str) -> Path:
    folder.mkdir(exist_ok=True)
    shutil.copy(SHUTTLE.with_name("shuttle.urdf"), folder)
    (folder / "mine.yaml").write_text(text, encoding="utf-8")
    run = folder / "runs" / name
    options = ("--timesteps", "128", *options)
    assert main(["train", str(folder / "mine.yaml"), "--run", str(run), "--quiet", *options]) == 0
    return run


def _causes(run: Path, capsys) -> list[dict]:
    capsys.readouterr()
    assert main(["diagnose", str(run), "--only-logs", "--json"]) == 0
    return json.loads(capsys.readouterr().out)["runs"][0]["causes"]


@pytest.fixture
def solved(tmp_path) -> Path:
    return _trained(tmp_path, "solved", EASY)


def test_what_changed_since_a_solved_run_is_named_with_its_places(solved, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run = _trained(tmp_path, "missed", HARD)
    shown = capsys.readouterr().out
    causes = _causes(run, capsys)
    (cause,) = (cause for cause in causes if cause["cause"] == "changed_since_solved")
    # The earlier run needed no more steps, so the length of the training is not a cause.
    assert "too_few_steps" not in {other["cause"] for other in causes}
    lines = HARD.splitlines()
    places = [f"mine.yaml:{lines.index(line) + 1}" for line in ("  bonus: 0.001", "  near:  0.1 mm")]
    assert cause["text"] == (
        f"Changed since runs/solved, which was solved: reward.bonus (none) -> 0.001 ({places[0]})"
        f" and near 5 m -> 0.1 mm ({places[1]})."
    )
    assert cause["text"] in " ".join(shown.split())
    assert "most likely cause: Changed" not in shown
    assert cause["command"] == f"deepbots diff {Path('runs/solved')} {Path('runs/missed')}"
    assert all(change["is_written"] for change in cause["evidence"]["changes"])

    # The fact comes first, unless a cause is certain.
    before = [each["evidence"]["likelihood"] for each in _causes(run, capsys)]
    assert before == sorted(before, reverse=True)

    # After the file has changed, the places are those of the copy in the run.
    (tmp_path / "mine.yaml").write_text(f"# a comment\n{HARD}", encoding="utf-8")
    (cause,) = (cause for cause in _causes(run, capsys) if cause["cause"] == "changed_since_solved")
    assert f"(runs/missed/inputs/{places[1]})" in cause["text"]


def test_a_single_change_is_not_called_one_of_several(solved, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run = _trained(tmp_path, "missed", TEXT.replace("near:  4 cm", "near:  0.1 mm"))
    (cause,) = (cause for cause in _causes(run, capsys) if cause["cause"] == "changed_since_solved")
    assert cause["advice"].startswith("Set it back and train again")


def test_a_training_that_is_shorter_than_a_solved_one_comes_before_other_changes(
    tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    _trained(tmp_path, "longer", EASY, "--timesteps", "512", "--full")
    run = _trained(tmp_path, "missed", HARD, "--set", "train.total_timesteps=512")
    causes = _causes(run, capsys)
    assert [cause["cause"] for cause in causes][:2] == ["too_few_steps", "changed_since_solved"]
    assert causes[0]["text"].startswith(
        f"The training is shorter than {Path('runs/longer')}, which made 512 steps and was solved"
    )


def test_the_nearest_of_the_solved_runs_is_compared(solved, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    _trained(tmp_path, "newer", EASY.replace("  time: ", "  other: 0.002\n  time: "))
    run = _trained(tmp_path, "missed", HARD)
    (cause,) = (cause for cause in _causes(run, capsys) if cause["cause"] == "changed_since_solved")
    assert cause["evidence"]["earlier"] == str(Path("runs/solved"))


def test_a_solved_run_of_another_name_or_folder_is_not_compared(solved, tmp_path, capsys):
    renamed = _trained(tmp_path, "renamed", HARD.replace("name: Shuttle", "name: Other"))
    assert "changed_since_solved" not in [cause["cause"] for cause in _causes(renamed, capsys)]
    elsewhere = _trained(tmp_path / "elsewhere", "hard", HARD)
    assert "changed_since_solved" not in [cause["cause"] for cause in _causes(elsewhere, capsys)]
