"""`diagnose` and `report` of each agent of a run by itself."""

from __future__ import annotations

import json
import shutil
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import deepbots_cli
from deepbots_cli.cli import main
from deepbots_cli.errors import RunError
from deepbots_cli.insight.diagnosis import causes_after, diagnose
from deepbots_cli.insight.probes import run_probes
from deepbots_cli.insight.training import TrainingEvidence, read_training, read_trainings
from deepbots_cli.learning.runs.records import PoolGames
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.view import recordings
from deepbots_cli.view.episodes import Showing
from deepbots_cli.view.players import open_player
from deepbots_cli.view.replay import ReplayPlayer
from tests.agents.test_multi_agent_training import SHARED, write_scenario

HOPELESS = SHARED.replace("right_fell: {when: tilt(right.pole) > 30 deg", "late: {when: step > 13")
"""The right agent has failed after 14 steps, whatever it does."""


@pytest.fixture(scope="module")
def hopeless(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run in which the right agent cannot succeed; not to be changed."""
    folder = tmp_path_factory.mktemp("hopeless")
    deepbots_cli.train(write_scenario(folder, HOPELESS), run=folder / "run", seed=1)
    assert main(["eval", str(folder / "run"), "--episodes", "20"]) == 0
    return folder / "run"


def evidence_of(run: Path, agent: str) -> TrainingEvidence:
    (training,) = [each for each in read_trainings(Run.open(run)) if each.agent == agent]
    return training


def test_each_agent_has_its_own_returns_successes_and_curves(hopeless: Path) -> None:
    of_all, left, right = read_training(Run.open(hopeless)), *read_trainings(Run.open(hopeless))
    assert (left.agent, right.agent) == ("left", "right")
    total = left.all_episodes.returns + right.all_episodes.returns
    assert total == pytest.approx(of_all.all_episodes.returns, abs=1e-5)
    assert left.all_episodes.successes.mean() == 1
    assert right.all_episodes.successes.mean() == 0
    assert left.evaluations[-1]["returns"] == [each.total_return for each in left.final_episodes]
    assert {term.name for term in right.program.agent.reward} == {"upright", "calm"}
    for training in (left, right):
        assert len(training.curve("train/approx_kl"))
        assert len(training.curve("reward/upright"))
    assert left.curve("train/approx_kl").tolist() != right.curve("train/approx_kl").tolist()


def test_short_episodes_of_an_agent_are_beside_the_policies_of_the_others(hopeless: Path) -> None:
    training = evidence_of(hopeless, "right")
    run_probes(training)
    assert {*training.constant_actions} == {"drive"}
    assert training.policy
    assert not training.scripts  # a training of several agents has no teacher
    assert len(training.failed) == 6
    for trace, episode in zip(training.failed, training.final_episodes, strict=False):
        assert trace.returns == pytest.approx(episode.total_return)


def test_a_rival_that_is_too_strong_is_named_first(hopeless: Path) -> None:
    cause = diagnose(evidence_of(hopeless, "right"))[0]
    assert cause.cause == "rival_too_strong"
    assert "`right` succeeds in 0%" in cause.text
    assert "`left` in 100%" in cause.text
    assert "rival_too_strong" not in [each.cause for each in diagnose(evidence_of(hopeless, "left"))]
    named = [each.text.partition(":")[0] for each in causes_after(hopeless) if each.cause == cause.cause]
    assert named == ["right"]


@pytest.mark.parametrize(("own", "other"), [(0.3, 0.7), (0.0, 0.5)])
def test_a_rival_that_is_only_better_is_not_too_strong(hopeless: Path, own: float, other: float) -> None:
    training = evidence_of(hopeless, "right")
    draw = np.random.default_rng(0).uniform(size=len(training.all_episodes))
    training.all_episodes.successes = draw < own
    planted = replace(training, rivals={"left": (draw > 1 - other).astype(float)})
    assert "rival_too_strong" not in [each.cause for each in diagnose(planted)]


def test_a_rival_that_got_better_is_not_a_fall_of_the_policy(hopeless: Path) -> None:
    training = evidence_of(hopeless, "right")
    count = len(training.all_episodes)
    training.all_episodes.successes = np.arange(count) < count / 2
    planted = replace(training, rivals={"left": (np.arange(count) >= count / 2).astype(float)})
    causes = {cause.cause: cause for cause in diagnose(planted)}
    assert "`right` succeeded in 100% of the episodes" in causes["rival_improved"].text
    assert "`left` went from 0% to 100%" in causes["rival_improved"].text
    assert "fell_apart" not in causes


def with_games(run: Path, *games: PoolGames) -> TrainingEvidence:
    training = evidence_of(run, "left")
    result = training.run.record.result
    assert result is not None
    record = training.run.record.model_copy(
        update={"result": result.model_copy(update={"pool_games": games})}
    )
    return replace(training, run=Run(run, record, training.run.compiled))


def test_strategies_that_go_round_in_a_circle_are_a_cause(hopeless: Path) -> None:
    games = PoolGames(100, 8, 32), PoolGames(200, 20, 20), PoolGames(300, 34, 6)
    causes = {each.cause: each for each in diagnose(with_games(hopeless, *games))}
    assert "wins 20% of its decided games against the version of 100 steps" in causes["strategies_cycle"].text
    assert "85% against the later version of 300 steps" in causes["strategies_cycle"].text


@pytest.mark.slow
@pytest.mark.parametrize(
    "games",
    [
        (PoolGames(100, 34, 6), PoolGames(300, 8, 32)),  # it has got worse than the newest ones
        (PoolGames(100, 2, 6), PoolGames(300, 6, 2)),  # too few games
        (PoolGames(100, 17, 23), PoolGames(300, 34, 6)),  # by chance
        (),
    ],
)
def test_games_without_a_circle_are_not_a_cause(hopeless: Path, games: tuple[PoolGames, ...]) -> None:
    assert "strategies_cycle" not in [each.cause for each in diagnose(with_games(hopeless, *games))]


def test_advice_for_an_agent_is_a_setting_of_this_agent(hopeless: Path) -> None:
    training = evidence_of(hopeless, "right")
    training.all_episodes.successes[:] = 0
    steps = np.arange(20.0)
    curves = {"train/clip_fraction": (steps, np.full(20, 0.9)), "train/approx_kl": (steps, np.full(20, 0.5))}
    planted = replace(training, rivals={}, scalars=curves)
    planted.__dict__["settings"] = {**training.settings, "learning_rate": 0.1}
    (cause,) = [each for each in diagnose(planted) if each.cause == "learning_rate_too_high"]
    assert [*cause.settings] == ["agents.right.train.learning_rate"]
    assert "--set agents.right.train.learning_rate=" in cause.command


def test_diagnose_prints_the_causes_of_each_agent(hopeless: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["diagnose", str(hopeless), "--only-logs", "--json"]) == 0
    reports = json.loads(capsys.readouterr().out)["runs"]
    assert [each["agent"] for each in reports] == ["left", "right"]
    assert reports[1]["causes"][0]["cause"] == "rival_too_strong"
    assert main(["diagnose", str(hopeless), "--only-logs", "--agent", "right"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith(f"{hopeless}, right: ")
    assert main(["diagnose", str(hopeless), "--agent", "middle"]) == 2
    assert "its agents are left, right" in capsys.readouterr().err


def test_an_episode_is_explained_for_one_agent(hopeless: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["diagnose", str(hopeless), "--agent", "right", "--episode", "failed", "--json"]) == 0
    explained = json.loads(capsys.readouterr().out)
    assert explained["episode"].startswith("episode 0 of ")
    assert explained["outcome"] == "failure"
    assert main(["diagnose", str(hopeless), "--agent", "left", "--episode", "failed"]) == 2
    assert "none of the 20 episodes" in capsys.readouterr().err


def test_a_recording_has_the_episodes_that_one_agent_failed(
    hopeless: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["render", str(hopeless), "-o", str(tmp_path / "failed.mcap"), "--episodes", "failed"]
    assert main(arguments) == 2
    assert "--agent left|right" in capsys.readouterr().err
    assert main([*arguments, "--agent", "right", "--json"]) == 0
    (recording,) = json.loads(capsys.readouterr().out)["files"]
    evaluated = evidence_of(hopeless, "right").final_episodes
    assert [each["return"] for each in recording["episodes"]] == pytest.approx(
        [each.total_return for each in evaluated]
    )


def test_a_log_without_the_agents_is_refused_with_the_reason(hopeless: Path, tmp_path: Path) -> None:
    run = shutil.copytree(hopeless, tmp_path / "run")
    lines = (run / "monitor.csv").read_text().splitlines()
    lines[1] = lines[1].removesuffix(",agents")
    (run / "monitor.csv").write_text("\n".join(lines) + "\n")
    with pytest.raises(RunError, match="an older version wrote it"):
        read_trainings(Run.open(run))


@pytest.mark.slow
def test_a_report_has_the_figures_and_the_causes_of_each_agent(
    hopeless: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("viser")
    page, figures = tmp_path / "run.html", tmp_path / "figures"
    words = ["report", str(hopeless), "-o", str(page), "--no-clips", "--episodes", "3", "--json"]
    assert main([*words, "--figures", str(figures)]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["agents"]["right"]["causes"][0]["cause"] == "rival_too_strong"
    assert "success rate 0.0%" in data["agents"]["right"]["result"]
    names = {file.stem for file in figures.glob("*-*.png")}
    assert names == {
        f"{agent}-{name}" for agent in ("left", "right") for name in ("returns", "shares", "actions")
    } | {"left-successes"}
    text = page.read_text()
    assert "<h2>left</h2>" in text
    assert "The rival is too strong" in text


def test_the_model_of_agents_that_compete_is_called_the_newest(
    hopeless: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["eval", str(hopeless), "--episodes", "2"]) == 0
    output = capsys.readouterr().out
    assert "run (newest, after 768 steps)" in output
    assert "2 held-out starts from evaluation seed 1, which no training uses" in output
    assert main(["runs", str(hopeless)]) == 0
    assert " newest " in capsys.readouterr().out


def test_the_caption_of_a_picture_names_the_agent_that_succeeds(hopeless: Path, tmp_path: Path) -> None:
    pytest.importorskip("viser")
    pytest.importorskip("mcap")
    player = open_player(Showing(str(hopeless)).open())
    with closing(player):
        last = [*player.episode(1, 0)][-1]
        recordings.record(player, tmp_path / "one.mcap", 1, [0])
    with closing(ReplayPlayer(Showing(str(tmp_path / "one.mcap")).open())) as replayed:
        recorded = [*replayed.episode(1, 0)][-1]
    assert last.ending == recorded.ending == "success of left: late"
