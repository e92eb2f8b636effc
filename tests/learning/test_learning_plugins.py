"""Callbacks and loggers of other packages follow a training and keep it exact; one that fails is named."""

from __future__ import annotations

import json
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import stand_in
from stable_baselines3 import PPO
from stand_in import hyper

from deepbots_cli.cli.records import training_text
from deepbots_cli.errors import PluginError, UsageError
from deepbots_cli.learning import TrainingResult, resume, resume_group, train, train_group
from deepbots_cli.learning.campaigns.group import Group
from deepbots_cli.learning.evaluation import load_model
from deepbots_cli.learning.runs.records import RunRecord
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.program.task import Training
from tests.learning.interruption import At
from tests.plugins import test_plugins

GROUPS = ("deepbots.callbacks", "deepbots.loggers")
TASK = stand_in.compiled(training=Training("PPO", 256, 2, hyper(n_steps=32, batch_size=32)))


@pytest.fixture(scope="module", autouse=True)
def installed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """The entries that the package of the tests registers for trainings."""
    site = tmp_path_factory.mktemp("site")
    groups = tomllib.loads((test_plugins.PACKAGE / "pyproject.toml").read_text())["project"]["entry-points"]
    test_plugins.installed(site, {group: groups[group] for group in GROUPS})
    sys.path[:0] = [str(site), str(test_plugins.PACKAGE)]
    yield
    del sys.path[:2]


def short(folder: Path, **settings: Any) -> TrainingResult:
    return train(TASK, run=folder, build=stand_in.build, **settings)


def lines(run: Path, name: str) -> list[str]:
    """Those of a log, without times."""
    return [line for line in (run / "logs" / name).read_text().splitlines() if ",time/" not in line]


@pytest.mark.slow
def test_a_training_that_was_interrupted_calls_and_logs_as_one_that_was_not(tmp_path: Path) -> None:
    names: dict[str, Any] = {"callbacks": ["explore_less"], "loggers": ["csv", "json_lines"]}
    whole = short(tmp_path / "whole", **names)
    assert short(tmp_path / "parts", **names, progress=At(128)).interrupted
    with (tmp_path / "parts" / "logs" / "scalars.csv").open("a") as file:
        file.write("140,written after the checkpoint,1\n")
    parts = resume(tmp_path / "parts", build=stand_in.build)
    assert (parts.weights_digest, parts.inexact) == (whole.weights_digest, ())
    assert whole.weights_digest != short(tmp_path / "without").weights_digest
    for name in ("scalars.csv", "scalars.jsonl"):
        assert lines(whole.run, name) == lines(parts.run, name)
    saved = PPO.load(whole.run / "logs" / "whole.zip")
    last: Any = load_model(Run.open(whole.run), "last")
    last.model = saved
    assert last.digest() == whole.weights_digest
    rows = [line.split(",") for line in lines(whole.run, "scalars.csv")]
    assert rows[0] == ["steps", "name", "value"]
    assert {"acme/norm", "rollout/ep_rew_mean", "reward/alive"} <= {row[1] for row in rows}


def test_a_name_that_no_package_registers_is_refused_with_the_nearest(tmp_path: Path) -> None:
    with pytest.raises(
        UsageError,
        match=r"^there is no callback 'explore_les'; the known ones are .*failing.* \(did you mean"
        r" explore_less\?\)$",
    ):
        short(tmp_path / "run", callbacks=["explore_les"])
    with pytest.raises(
        UsageError,
        match=r"^there is no logger 'cvs'; the known ones are csv, json_lines, full_disk \(did you mean"
        r" csv\?\)$",
    ):
        short(tmp_path / "run", loggers=["cvs"])
    with pytest.raises(UsageError, match="given twice"):
        short(tmp_path / "run", loggers=["csv", "csv"])
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("names", "sentence"),
    [
        (
            {"callbacks": ["failing"]},
            r"the callback 'failing' failed after 100 steps: KeyError: 'no such gauge' \(.*training.py:\d+\)",
        ),
        ({"callbacks": ["odd"]}, "the callback 'odd' is a str, and not a BaseCallback of Stable-Baselines3"),
        (
            {"loggers": ["full_disk"]},
            r"the logger 'full_disk' failed after \d+ steps: OSError: .*No space left on device \(.*\)",
        ),
    ],
)
def test_one_that_fails_is_named_and_the_training_can_go_on(
    tmp_path: Path, names: dict[str, Any], sentence: str
) -> None:
    with pytest.raises(PluginError, match=f"^{sentence}(?m:$)") as caught:
        short(tmp_path / "run", **names)
    if "odd" not in sentence:
        assert "the last checkpoint" in caught.value.full_message
        assert f"deepbots resume {tmp_path / 'run'}" in caught.value.full_message
    assert RunRecord.read(tmp_path / "run").status == "failed"


def test_a_callback_may_end_the_training(tmp_path: Path) -> None:
    result = short(tmp_path / "run", callbacks=["impatient"])
    assert result.status == "finished"
    assert result.steps == 100
    assert result.stopped_by == "impatient"
    assert "stopped by" in training_text(result)
    assert "the callback impatient" in training_text(result)


def test_a_resumed_run_and_the_seeds_of_a_group_keep_them(tmp_path: Path) -> None:
    group = train_group(
        TASK, [0, 1], group=tmp_path / "group", build=stand_in.build, callbacks=["impatient"], loggers=["csv"]
    )
    assert [result.stopped_by for result in group.trained] == ["impatient"] * 2
    run = group.trained[0].run
    assert lines(run, "scalars.csv")
    content = json.loads((run / "run.json").read_text())
    (run / "run.json").write_text(json.dumps(content | {"callbacks": ["gone"]}))
    with pytest.raises(UsageError, match="there is no callback 'gone'") as caught:
        resume(run, build=stand_in.build)
    assert "--callback none" in caught.value.full_message
    rest = resume(run, build=stand_in.build, total_timesteps=200, callbacks=(), loggers=())
    assert rest.steps >= 200
    assert rest.stopped_by is None
    assert rest.inexact == ("the callbacks changed at 0 steps from gone to none",)
    assert (RunRecord.read(run).callbacks, RunRecord.read(run).loggers) == ((), ())


@pytest.mark.slow
def test_a_resumed_group_drops_them_in_every_seed(tmp_path: Path) -> None:
    train_group(TASK, [0, 1], group=tmp_path / "group", build=stand_in.build, callbacks=["impatient"])
    with pytest.raises(UsageError, match="there is no callback 'gone'"):
        resume_group(tmp_path / "group", total_timesteps=200, callbacks=["gone"], build=stand_in.build)
    assert Group.open(tmp_path / "group").record.callbacks == ("impatient",)
    rest = resume_group(tmp_path / "group", total_timesteps=200, callbacks=(), build=stand_in.build)
    assert [result.stopped_by for result in rest.trained] == [None, None]
    assert Group.open(tmp_path / "group").record.callbacks == ()
