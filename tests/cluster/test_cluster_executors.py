"""What both kinds of workers do: processes of this machine, and the workers of a Ray cluster. What only the
former do is below."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from deepbots_cli.cli import main, processes
from deepbots_cli.cluster import Cluster
from deepbots_cli.errors import DeepbotsError, UsageError
from deepbots_cli.learning.calls import Watcher
from deepbots_cli.learning.executor import results
from tests.cluster.calls import imported, lose, priority, square


class Losses(Watcher):
    def __init__(self) -> None:
        self.items: list[int] = []

    def on_loss(self, item: int) -> None:
        self.items.append(item)


def test_results_and_errors_come_in_the_order_of_the_items(either: Cluster) -> None:
    assert list(results(either.map(square, range(3)))) == [0, 1, 4]
    *squares, error, last = either.map(square, range(5))
    assert squares == [0, 1, 4]
    assert str(error) == "there is no square of 3"
    assert last == 16


def test_a_worker_with_another_version_or_without_a_file_is_refused(
    either: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "group.json"
    file.write_text("{}")
    unseen = either.map(square, range(2), files=[file])
    file.write_text("{ }")
    with pytest.raises(
        UsageError, match=r"the worker on .* does not see .*group\.json; use a folder that all nodes share"
    ):
        list(unseen)
    monkeypatch.setattr(
        "deepbots_cli.__version__", "99.0"
    )  # here, so this process believes in another version
    with pytest.raises(UsageError, match=r"the worker on .* has deepbots .*, but this process has 99\.0"):
        list(either.map(square, range(2)))


@pytest.mark.slow
def test_a_lost_call_is_repeated_up_to_three_times(either: Cluster) -> None:
    losses = Losses()
    first, failure, other = either.map(lose, range(3), watcher=losses)
    assert (first, other) == (2, 1)
    assert isinstance(failure, DeepbotsError)
    assert "it ended its worker 3 times" in str(failure)
    assert sorted(losses.items) == [0, 1, 1]


# Processes of this machine


SCRIPT = """
import os, signal
signal.signal(signal.SIGINT, signal.default_int_handler)  # a test in the background ignores it
from deepbots_cli.cluster import Cluster
from deepbots_cli.learning.calls import Watcher
from tests.cluster.calls import sleep

class Printer(Watcher):
    def on_report(self, item, value):
        print(value, flush=True)

with Cluster(workers=2) as cluster:
    list(cluster.map(sleep, [{seconds}, {seconds}], watcher=Printer()))
"""


def begun(seconds: int, folder: Path) -> tuple[subprocess.Popen[str], set[int]]:
    """A script without a guard of its main module, and its two workers once they work."""
    script = folder / "script.py"
    script.write_text(SCRIPT.format(seconds=seconds))
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    process = subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, text=True, env=environment)
    assert process.stdout is not None
    return process, {int(process.stdout.readline()) for _ in range(2)}


def alive(numbers: set[int]) -> set[int]:
    """The processes that have not ended."""
    living = set()
    for number in numbers:
        with suppress(ProcessLookupError):
            os.kill(number, 0)
            living.add(number)
    return living


@pytest.mark.parametrize("number", [signal.SIGKILL, pytest.param(signal.SIGINT, marks=pytest.mark.slow)])
def test_no_worker_outlives_its_parent(number: signal.Signals, tmp_path: Path) -> None:
    process, pids = begun(600, tmp_path)
    assert len(alive(pids)) == 2
    process.send_signal(number)
    process.communicate(timeout=60)
    deadline = time.monotonic() + 10
    while alive(pids) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not alive(pids)


def test_workers_run_without_ray(
    cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    monkeypatch.chdir(tmp_path)
    assert main(["test", "cartpole", "find_ball", "--workers", "2"]) == 0
    assert list(cluster.map(imported, ["ray", "deepbots_cli"])) == [False, True]
    capsys.readouterr()
    assert main(["test", "cartpole", "find_ball", "--cluster", "auto"]) == 2
    assert "error: --cluster needs the 'cluster' extra" in capsys.readouterr().err


def test_workers_have_our_priority(cluster: Cluster) -> None:
    assert list(cluster.map(priority, [0])) == [os.nice(0)]


@pytest.mark.slow
def test_more_workers_than_cores_are_noted(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(processes, "available_cores", lambda: 1)
    with processes.executor(2, None) as executor:
        assert executor.workers == 2
    assert capsys.readouterr().err == "2 workers share 1 core; more workers than cores are not faster\n"
