"""Trainings that follow one another with the values that a diagnosis advises."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path

import pytest

pytest.importorskip("stable_baselines3")

from deepbots_cli import api
from deepbots_cli.cli import main
from deepbots_cli.errors import RunError, UsageError
from deepbots_cli.insight.report import Report
from deepbots_cli.insight.retry import is_worse, next_attempt, resume_retries, train_with_retries
from deepbots_cli.insight.statements import Statement
from deepbots_cli.learning.campaigns.group import Group, RetryAttempt, resume_group
from deepbots_cli.learning.campaigns.listing import list_runs
from deepbots_cli.learning.comparison import evaluate_group
from deepbots_cli.learning.runs.records import EvaluationRecord, RunRecord
from deepbots_cli.learning.runs.verdict import RunVerdict

SCENARIO = """\
deepbots: 1
extends: cartpole
name: Mine
world: {engine: mujoco}
evaluation: {episodes: 4}
solved: mean_return >= 150 over 4 episodes
train:
  total_timesteps: 256
  environments: 2
  learning_rate: 0.5  # a guess
"""


@pytest.fixture(scope="module")
def retried(tmp_path_factory) -> Path:
    """A group whose first training has a learning rate that is far too high; not to be changed."""
    folder = tmp_path_factory.mktemp("retry")
    (folder / "mine.yaml").write_text(SCENARIO)
    result = train_with_retries(api.compile(folder / "mine.yaml"), 2, seed=3, group=folder / "group")
    assert not result.solved
    return result.group


@pytest.mark.slow
def test_the_next_attempt_has_the_advised_value_and_the_reason(retried):
    first, second, *_ = Group.open(retried).record.attempts
    assert first.settings == {}
    assert first.base == 0
    assert second.settings == {"train.learning_rate": "0.003"}
    assert second.base == 1
    assert second.cause == "learning_rate_too_high"
    assert "The learning rate is 0.5, 167 times the usual 0.003" in second.text
    runs = [RunRecord.read(retried / name) for name in ("try-1", "try-2")]
    assert [run.seed for run in runs] == [3, 3]
    assert "train.learning_rate=0.003" in runs[1].command


@pytest.mark.slow
def test_a_group_that_was_killed_before_an_attempt_continues_with_it_to_the_bit(retried, tmp_path):
    def kill(run: Path, attempt: RetryAttempt) -> None:
        if attempt.base:
            raise KeyboardInterrupt

    compiled = api.compile(retried.parent / "mine.yaml")
    with pytest.raises(KeyboardInterrupt):
        train_with_retries(compiled, 2, seed=3, group=tmp_path / "group", on_attempt=kill)
    assert [run.name for run in Group.open(tmp_path / "group").runs] == ["try-1"]
    continued = resume_retries(tmp_path / "group")
    whole = Group.open(retried)
    assert Group.open(continued.group).record.attempts == whole.record.attempts
    results = [
        [RunRecord.read(run).result.weights_digest for run in Group.open(group).runs]
        for group in (retried, continued.group)
    ]
    assert results[0] == results[1]


@pytest.mark.slow
def test_an_attempt_that_only_trains_longer_continues_a_copy(tmp_path):
    settings = [
        "world.engine=mujoco",
        "evaluation={episodes: 4}",
        "train.environments=2",
        "train.total_timesteps=1024",
    ]
    result = train_with_retries(
        api.compile("cartpole", overrides=settings), 1, group=tmp_path / "group", total_timesteps=256
    )
    assert [entry.attempt.cause for entry in result.attempts] == ["", "too_few_steps"]
    first, longer = (RunRecord.read(entry.path) for entry in result.attempts)
    assert (first.resumed_at, longer.resumed_at) == ((), (256,))
    assert (first.result.steps, longer.result.steps) == (256, 1024)


def test_advice_that_was_tried_is_not_tried_again():
    def cause(name: str, likelihood: float, **settings: str) -> Statement:
        return Statement(name, name, "", {"likelihood": likelihood}, settings)

    first = RetryAttempt()
    lower = RetryAttempt(settings={"a": "1"}, base=1, cause="one")
    causes = [cause("one", 0.95, a="1"), cause("two", 0.6), cause("three", 0.5, b="2")]
    assert next_attempt(causes, [first], 1) == lower.model_copy(update={"text": "one"})
    assert next_attempt(causes, [first, lower], 1).settings == {"b": "2"}
    assert next_attempt(causes, [first, lower], 2).settings == {"a": "1", "b": "2"}
    certain = [cause("reward", 0.95), *causes]  # what the reward lacks, no value under `train` gives
    assert next_attempt(certain, [first], 1) is None


def test_an_attempt_that_is_clearly_worse_is_left_for_the_best_one():
    def verdict(*interval: float) -> RunVerdict:
        evaluation = EvaluationRecord(
            evaluated="",
            model="best",
            seed=0,
            episodes=100,
            mean_return=0.0,
            return_interval=None,
            success_defined=True,
            success_rate=sum(interval) / 2,
            success_interval=interval,
            solved=False,
        )
        return RunVerdict(False, evaluation)

    assert is_worse(verdict(0.1, 0.2), verdict(0.3, 0.5))
    assert not is_worse(verdict(0.1, 0.35), verdict(0.3, 0.5))
    assert is_worse(RunVerdict(None, None), verdict(0.3, 0.5))


@pytest.mark.slow
def test_the_report_of_the_group_names_what_each_attempt_changed_and_why(retried):
    report = Report.read(retried)
    assert len(report.runs) == 1
    name, changed, why, result = report.attempts[1]
    assert (name, changed) == ("try-2", "train.learning_rate: 0.003")
    assert why.startswith("try-1: The learning rate is 0.5")
    assert "not solved" in result
    assert "train.learning_rate: 0.003" in report.html()


def test_the_list_shows_the_best_attempt_and_statistics_over_attempts_are_refused(retried):
    (group,) = list_runs(retried.parent)
    best = Group.open(retried).best_attempt
    assert group.mean_return == group.runs[best - 1].mean_return == max(run.mean_return for run in group.runs)
    assert group.runs[1].settings == ("train.learning_rate=0.003",)
    with pytest.raises(RunError, match=f"different values.*name one of them, such as .*try-{best}"):
        evaluate_group(retried)
    with pytest.raises(UsageError, match="resume"):
        resume_group(retried)


def test_the_values_of_the_best_attempt_are_written_only_on_request(retried, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(retried, "group")
    Path("mine.yaml").write_text(SCENARIO)
    record = json.loads(Path("group/group.json").read_text())
    values = record["attempts"][Group.open("group").best_attempt - 1]["settings"]
    assert main(["apply", "group", "mine.yaml", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["values"] == values
    written = Path("mine.yaml").read_text()
    assert (
        f"learning_rate: 0.003  # a guess  # set by group, try-{Group.open('group').best_attempt}" in written
    )
    assert (retried.parent / "mine.yaml").read_text() == SCENARIO


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["train", "cartpole", "--retry", "2", "--seeds", "0..2"], "leave out --seeds"),
        (["train", "cartpole", "--retry", "2", "--view"], "leave out --view"),
        (["train", "open.yaml", "--retry", "2"], "does not say when it is solved"),
        (
            ["resume", "GROUP", "--timesteps", "9k"],
            "--timesteps does not go with a group of `train --retry`; it takes: --retry",
        ),
        (["resume", "GROUP/try-1", "--retry", "2"], "--retry does not go with a run; it takes: --timesteps"),
        (["apply", "GROUP/try-1"], "is a run, and not a group of runs or a study"),
    ],
)
def test_options_that_do_not_fit_are_refused_in_one_sentence(
    retried, tmp_path, monkeypatch, capsys, words, message
):
    monkeypatch.chdir(tmp_path)
    (retried.parent / "open.yaml").write_text(
        "deepbots: 1\nextends: cartpole\nname: Open\nremove: [solved]\n"
    )
    words = [
        word.replace("GROUP", str(retried)).replace("open.yaml", str(retried.parent / "open.yaml"))
        for word in words
    ]
    monkeypatch.setattr(sys, "argv", ["deepbots", *words])
    assert main(words) == 2
    assert message in capsys.readouterr().err.splitlines()[-1]
    assert list(tmp_path.iterdir()) == []


def test_a_group_whose_attempts_do_not_follow_one_another_is_damaged(retried, tmp_path):
    shutil.copytree(retried, tmp_path / "group")
    record = json.loads((tmp_path / "group" / "group.json").read_text())
    record["attempts"][1]["base"] = 7
    (tmp_path / "group" / "group.json").write_text(json.dumps(record))
    with pytest.raises(RunError, match=r"group.json is damaged"):
        Group.open(tmp_path / "group")
