"""One way to name a model: every command that takes the policy of a run also takes one of its models."""

from __future__ import annotations

import contextlib
import json
import shutil
from io import StringIO
from pathlib import Path

import pytest

from deepbots_cli.cli import main
from deepbots_cli.learning.runs.records import RunRecord
from tests.cli.conftest import Deepbots

TINY = (
    "--timesteps",
    "200",
    "--set",
    "train.n_epochs=1",
    "--set",
    "train.environments=2",
    "--set",
    "train.n_steps=64",
)
FEW = ("--set", "evaluation={episodes: 4}", "--set", "solved=mean_return >= 195 over 4 episodes")
STEP = "mine/models/agent/step-000000128.zip"


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a run of 256 steps, `mine`, and a model after 128 steps."""
    folder = tmp_path_factory.mktemp("trained")
    err = StringIO()
    with contextlib.chdir(folder), contextlib.redirect_stdout(StringIO()), contextlib.redirect_stderr(err):
        code = main(["train", "cartpole", *TINY, *FEW, "--keep-checkpoints", "2", "--run", "mine"])
    assert code == 0, err.getvalue()
    return folder


@pytest.fixture
def mine(first: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(first / "mine", tmp_path / "mine"))


@pytest.mark.slow
def test_a_run_is_compared_with_one_of_its_models(deepbots: Deepbots, mine: Path) -> None:
    ran = deepbots("compare", "mine", STEP, "--episodes", "2")
    assert "mine (step-000000128)" in ran.out
    assert "after_steps" in ran.out
    report = json.loads(deepbots("compare", "mine", STEP, "--episodes", "2", "--json").out)
    assert [group["runs"][0]["model_steps"] for group in report["groups"]] == [256, 128]


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        ("eval", STEP, "--episodes", "1"),
        ("diagnose", STEP, "--episode", "0"),
        ("render", STEP, "-o", "one.mcap", "--steps", "2"),
        ("inspect", STEP),
        ("diff", STEP, "mine"),
        ("train", "cartpole", *TINY, *FEW, "--initialize-from", STEP, "--run", "other"),
    ],
)
def test_every_command_that_takes_a_policy_takes_a_checkpoint(
    deepbots: Deepbots, mine: Path, words: tuple[str, ...]
) -> None:
    deepbots(*words)


@pytest.mark.slow
def test_robustness_of_a_checkpoint_is_that_of_the_checkpoint(deepbots: Deepbots, mine: Path) -> None:
    report = json.loads(deepbots("robustness", STEP, "--episodes", "1", "--json").out)
    assert report["nominal"]["model"] == "step-000000128"
    assert report["nominal"]["model_steps"] == 128


@pytest.mark.slow
def test_the_best_model_of_a_run_is_chosen_again_and_evaluated(deepbots: Deepbots, mine: Path) -> None:
    ran = deepbots("eval", "mine", "--keep", "--episodes", "4")
    assert "models of mine on new starts, the best first" in ran.out
    assert "on further new starts, which were not used to choose it:\nevaluation of CartPole" in ran.out
    best = RunRecord.read(mine).result.best_model  # type: ignore[union-attr]
    assert best is not None
    assert best.chosen_by == "new starts"
    assert f"held-out starts from evaluation seed {best.evaluation_seed}" in ran.out


def test_a_checkpoint_becomes_the_best_model_by_hand(deepbots: Deepbots, mine: Path) -> None:
    report = json.loads(deepbots("eval", STEP, "--keep", "--episodes", "2", "--json").out)
    assert report["model"] == "best"
    assert report["model_steps"] == 128
    assert report["kept"]["best"]["chosen_by"] == "hand"
    assert report["kept"]["earlier"] == "mine/models/agent/earlier-1.zip"
    assert "chosen by hand" in deepbots("inspect", "mine").out
    refused = deepbots("eval", "mine", "--keep", "--set", "fall_angle=3 deg", code=2)
    assert "--set cannot be combined with --keep" in refused.err


def test_the_list_of_runs_names_the_command_that_chooses_again(deepbots: Deepbots, mine: Path) -> None:
    record = json.loads((mine / "run.json").read_text())
    record["result"].pop("best")
    (mine / "run.json").write_text(json.dumps(record | {"result": record["result"] | {"best_return": 12.5}}))
    assert "choose again with: deepbots eval mine --keep" in deepbots("runs", ".").err
