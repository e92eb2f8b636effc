"""A training that is interrupted becomes the same as one that is not, to the bit: a run and a group, in this
process and on workers."""

from __future__ import annotations

import os
import signal
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from test_cluster_fleet import act_at
from test_cluster_shards import children, workers

from deepbots_cli import api
from deepbots_cli.cluster import Cluster
from deepbots_cli.learning import resume, resume_group, train, train_group
from deepbots_cli.learning.campaigns.group import Group
from deepbots_cli.learning.executor import SERIAL, Executor
from tests.cluster.calls import square
from tests.few import few
from tests.learning.interruption import At, outcome

SCENARIO = (
    "world.engine=mujoco",
    "truncation.max_steps=30",
    "solved=mean_return >= 1000 over 5 episodes",
    "train={algorithm: PPO, total_timesteps: 500, environments: 4, n_steps: 32, batch_size: 32, n_epochs: 2,"
    " network: {hidden: [16]}, shards: 2}",
)
"""Rollouts of 128 steps, whose ends are in the middle of episodes."""
SEEDS = (0, 1)
KINDS = ("run", "group")


def begun(kind: str, folder: Path, executor: Executor = SERIAL, progress: Any = False) -> Any:
    """The result of a training in `folder`."""
    compiled = api.compile("cartpole", overrides=SCENARIO)
    if kind == "run":
        return train(compiled, run=folder, executor=executor, progress=progress)
    return train_group(compiled, SEEDS, group=folder, executor=executor, progress=progress)


def outcomes(kind: str, folder: Path) -> dict[str, Any]:
    """The results of the trainings in a folder, and the names of its files."""
    runs = [folder] if kind == "run" else Group.open(folder).runs
    names = sorted(path.name for path in folder.iterdir() if path.name != "workers")
    return {"files": names, **{run.name if kind == "group" else "run": outcome(run) for run in runs}}


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The result of a training without interruption."""

    @cache
    def of(kind: str) -> dict[str, Any]:
        folder = tmp_path_factory.mktemp("whole") / "training"
        begun(kind, folder)
        return outcomes(kind, folder)

    return of


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_in_this_process_after_ctrl_c(kind: str, whole: Any, tmp_path: Path) -> None:
    begun(kind, tmp_path / "parts", progress=At(200))
    if kind == "run":
        assert resume(tmp_path / "parts").inexact == ()
    else:
        rest = resume_group(tmp_path / "parts")
        assert len(rest.trained) == 2
        assert rest.waiting == ()
    assert outcomes(kind, tmp_path / "parts") == whole(kind)


@pytest.mark.slow
@pytest.mark.parametrize("kind", few(KINDS, ["group"]))
def test_on_workers_after_one_was_killed(
    kind: str, whole: Any, either: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kill = At(200, lambda: os.kill((workers() or children("ray::_perform"))[0], signal.SIGKILL))
    killed = act_at(monkeypatch, 200, 1, kill.act)
    training = begun(kind, tmp_path / "parts", either, kill if kind == "run" else True)
    assert outcomes(kind, tmp_path / "parts") == whole(kind)
    if kind == "run":
        assert any("was lost; its shards continue" in note for note in kill.notes)
        assert (tmp_path / "parts" / "workers" / "0.log").is_file()
        assert not workers()  # they end with the training
    else:
        assert len(killed) == 1
        assert training.failed == {}
        assert list(either.map(square, range(3))) == [0, 1, 4]  # the workers go on
