"""Several trainings, evaluations and tests on workers: the same results as one after the other, also after
workers were lost."""

from __future__ import annotations

import io
import os
import pickle
import re
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from test_cluster_shards import outcome, workers

from deepbots_cli import api
from deepbots_cli.api import Compiled
from deepbots_cli.cli import main
from deepbots_cli.cluster import Cluster
from deepbots_cli.errors import DeepbotsError
from deepbots_cli.learning import evaluate, evaluate_group, resume_group, train_group
from deepbots_cli.learning.campaigns.group import GroupTraining
from deepbots_cli.learning.executor import SERIAL
from deepbots_cli.learning.report import GroupProgressReporter, TrainingProgress
from deepbots_cli.learning.runs.records import TrainingResult

SEEDS = (0, 1, 2)


@pytest.fixture(scope="module")
def scenario() -> Compiled:
    return api.compile("cartpole", overrides=["train.n_steps=64"])


def outcomes(group: Path) -> list[Any]:
    """The results of the trainings of a group, to the bit."""
    return [outcome(run) for run in sorted(group.glob("seed-*"))]


def test_every_error_passes_from_a_worker_to_this_process() -> None:
    def kinds(base: type[DeepbotsError]) -> Iterator[type[DeepbotsError]]:
        yield base
        for kind in base.__subclasses__():
            yield from kinds(kind)

    for kind in kinds(DeepbotsError):
        error = kind.__new__(kind, "what is wrong")
        error.add_note("what to do")
        received = pickle.loads(pickle.dumps(error))
        assert (type(received), received.full_message) == (kind, "what is wrong\nwhat to do")


def act_at(
    monkeypatch: pytest.MonkeyPatch, steps: int, times: int, act: Callable[[], object]
) -> list[object]:
    """Each time a training has come so many steps further, `act` is called; the list of what it returned."""
    done: list[object] = []
    reported = GroupProgressReporter.on_report

    def on_report(self: GroupProgressReporter, item: int, value: object) -> None:
        reported(self, item, value)
        if (
            isinstance(value, TrainingProgress)
            and value.steps > (1 + len(done)) * steps
            and len(done) < times
        ):
            done.append(act())

    monkeypatch.setattr(GroupProgressReporter, "on_report", on_report)
    return done


@pytest.fixture(scope="module")
def trained_here(scenario: Compiled, tmp_path_factory: pytest.TempPathFactory) -> GroupTraining:
    return train_group(scenario, SEEDS, runs=tmp_path_factory.mktemp("here"), total_timesteps=6_000)


@pytest.mark.slow
def test_ctrl_c_stops_all_trainings_after_their_rollouts(
    cluster: Cluster,
    scenario: Compiled,
    trained_here: GroupTraining,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    asked = act_at(monkeypatch, 1_000, 1, lambda: os.kill(os.getpid(), signal.SIGINT))
    stopped = train_group(
        scenario, SEEDS, group=tmp_path / "stopped", total_timesteps=6_000, progress=True, executor=cluster
    )
    assert len(asked) == 1
    assert {result.status for result in stopped.trained} == {"interrupted"}
    assert stopped.waiting == SEEDS
    assert capfd.readouterr().err.count("continue with: deepbots resume") == 1
    assert resume_group(tmp_path / "stopped", executor=cluster).waiting == ()
    assert outcomes(tmp_path / "stopped") == outcomes(trained_here.group)


@pytest.mark.slow
def test_a_second_ctrl_c_ends_them_at_once(
    cluster: Cluster, scenario: Compiled, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def twice() -> None:
        os.kill(os.getpid(), signal.SIGINT)
        os.kill(os.getpid(), signal.SIGINT)

    act_at(monkeypatch, 200, 1, twice)
    stopped = train_group(
        scenario, SEEDS, group=tmp_path / "group", total_timesteps=600_000, progress=True, executor=cluster
    )
    assert (stopped.trained, stopped.waiting) == ((), SEEDS)
    deadline = time.monotonic() + 20
    while workers() and time.monotonic() < deadline:
        time.sleep(0.2)
    assert not workers()


@pytest.mark.slow
def test_evaluations_on_workers_are_the_same_and_stop_at_the_same_episode(
    cluster: Cluster, trained_here: GroupTraining
) -> None:
    for until, episodes in ((None, [6, 6, 6]), (lambda done: len(done) >= 8, [6, 2])):
        here, workers = (
            evaluate_group(trained_here.group, episodes=6, until=until, executor=executor).evaluations
            for executor in (SERIAL, cluster)
        )
        assert [result.episodes for result in workers] == episodes
        assert [each.model_dump(mode="json") for each in workers] == [
            each.model_dump(mode="json") for each in here
        ]


@pytest.mark.slow
@pytest.mark.parametrize("options", [{}, {"deterministic": False}, {"until": lambda done: len(done) >= 11}])
def test_the_episodes_of_an_evaluation_on_workers_are_the_same(
    cluster: Cluster, trained_here: GroupTraining, options: dict[str, Any]
) -> None:
    run = trained_here.group / "seed-0"
    progress = [0]
    here = evaluate(run, episodes=21, **options)
    workers = evaluate(
        run, episodes=21, executor=cluster, on_episode=lambda done, of: progress.append(done), **options
    )
    assert workers.model_dump(mode="json") == here.model_dump(mode="json")
    assert progress == sorted(set(progress))


@pytest.mark.slow
@pytest.mark.parametrize("command", ["eval", "eval run", "compare", "robustness", "test"])
def test_commands_print_the_same_with_workers(
    command: str,
    trained_here: GroupTraining,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    group = str(trained_here.group)
    arguments = {
        "eval": [group, "--episodes", "5"],
        "eval run": [f"{group}/seed-0", "--episodes", "9", "--json"],
        "compare": [group, "--episodes", "5", "--json"],
        "robustness": [f"{group}/seed-0", "--episodes", "2", "--min-return", "1", "--json"],
        "test": ["cartpole", "find_ball", "--json"],
    }[command]
    printed = []
    for more in ([], ["--workers", "2"]):
        code = main([command.split()[0], *arguments, *more])
        printed.append((code, re.sub(r'"seconds": [0-9.]+', "", capfd.readouterr().out)))
    assert printed[1] == printed[0]
    assert printed[0][0] == 0


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (
            ["train", "cartpole", "--seeds", "3", "--workers", "2"],
            "--workers has nothing to divide, since there is one seed",
        ),
        (
            ["test", "cartpole", "--cluster", "auto"],
            "--cluster has nothing to divide, since there is one scenario",
        ),
        (["train", "cartpole", "--workers", "0"], "--workers 0 starts no process; write --workers 1 or more"),
        (
            ["test", "cartpole", "--workers", "-3"],
            "--workers -3 starts no process; write --workers 1 or more",
        ),
        (["bench", "cartpole", "--workers", "2"], "--workers and --cluster need --shards"),
        (["bench", "cartpole", "--shards", "1,2", "--quick"], "--shards and --quick cannot be combined"),
        (
            ["bench", "cartpole", "--shards", "1,x"],
            "--shards 1,x is not a list of whole numbers from 1, such as 1,2,4",
        ),
        (
            ["test", "cartpole", "find_ball", "--workers", "2", "--cluster", "auto"],
            "--workers and --cluster cannot be combined",
        ),
    ],
)
def test_workers_and_shards_that_make_no_sense_are_refused(
    arguments: list[str], reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    assert reason in capsys.readouterr().err


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def finished(run: Path) -> TrainingResult:
    return TrainingResult(
        run=run,
        status="finished",
        steps=6_144,
        total_timesteps=6_000,
        episodes=146,
        mean_return=42.19,
        success_rate=None,
        best_return=50.0,
        simulated_hours=0.1,
        evaluation_steps=0,
        solved_at=None,
        cpu_seconds=1.0,
        wall_seconds=1.0,
        weights_digest="",
    )


def test_the_table_of_trainings_fits_80_columns(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("LINES", "10")
    monkeypatch.setenv("TERM", "xterm")
    stream = Terminal()
    table = GroupProgressReporter(Path("runs/group"), range(20), stream)
    table.on_report(12, TrainingProgress(1_000_000, 40_000_000, 31_415, -1234.5, 0.125))
    table.on_done(0, finished(Path("runs/group/seed-0")))
    table.close()
    lines = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", stream.getvalue()).splitlines()
    assert max(map(len, lines)) <= 80
    text = " ".join(" ".join(lines).split())
    assert "12 training 1,000,000 of 40,000,000 31,415 -1234.5 12%" in text
    assert "1 training, 1 finished, 18 waiting" in text


def test_without_a_terminal_each_training_has_a_line_at_its_end() -> None:
    stream = io.StringIO()
    lines = GroupProgressReporter(Path("runs/group"), (7, 8), stream)
    lines.on_loss(1)
    lines.on_done(0, finished(Path("runs/group/seed-7")))
    lines.stop()
    lines.stop()
    lines.close()
    assert stream.getvalue().splitlines() == [
        "note: the worker of seed 8 was lost; another one resumes the training",
        "seed 7  finished  steps 6,144 of 6,000  episodes 146  return 42.2",
        "stopping after these rollouts; continue with: deepbots resume runs/group",
    ]
