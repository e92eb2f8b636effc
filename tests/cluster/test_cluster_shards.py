"""Shards of a training on workers: the same weights and logs as in this process, also after a worker was
lost."""

from __future__ import annotations

import csv
import os
import signal
import subprocess
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from deepbots_cli import api
from deepbots_cli.cluster import Cluster
from deepbots_cli.cluster.local_processes import LocalProcesses, Owed, Worker
from deepbots_cli.cluster.shards import RemoteShards
from deepbots_cli.cluster.worker_pool import WorkerLost, WorkerPool
from deepbots_cli.document import Permissions
from deepbots_cli.errors import RunError, UsageError
from deepbots_cli.learning import resume, train
from deepbots_cli.learning.executor import SERIAL, Executor
from deepbots_cli.learning.report import Reporter
from deepbots_cli.learning.runs.run import Run
from tests.cluster.calls import Echo
from tests.learning.interruption import At

TIMES = ("cpu_seconds", "wall_seconds", "solved_at")
SOON = "solved=mean_return >= 1000 over 5 episodes"
SHORT = ("truncation.max_steps=5", SOON)


def train_section(algorithm: str, more: str = "") -> str:
    return (
        f"train={{algorithm: {algorithm}, total_timesteps: 1000, environments: 4, network: {{hidden: [16,"
        f" 16]}}, {more}}}"
    )


CASES = {
    "PPO": ("cartpole", [*SHORT, "train.environments=4"], 1_280),
    "PPO, normalized rewards": (
        "pit_escape",
        [SOON, "parameters.time_limit=1 s", "train.environments=4"],
        512,
    ),
    "PPO on a batch": (
        "cartpole",
        [*SHORT, "world.engine=mujoco", "train.environments=32", "train.n_steps=16"],
        1_536,
    ),
    "TD3, curriculum": (
        "find_ball_random",
        [
            *SHORT,
            "curriculum.0.until=120 steps",
            "train.environments=4",
            "train.learning_starts=100",
            "train.network.hidden=[16, 16]",
        ],
        240,
    ),
    "SAC": ("cartpole_continuous", [*SHORT, train_section("SAC", "learning_starts: 100")], 320),
    "A2C": ("cartpole", [*SHORT, train_section("A2C")], 320),
    "RecurrentPPO": (
        "cartpole",
        [*SHORT, train_section("RecurrentPPO", "n_steps: 32, batch_size: 32, lstm: 8")],
        384,
    ),
    "MaskablePPO": ("cartpole", [*SHORT, train_section("MaskablePPO", "n_steps: 32, batch_size: 32")], 384),
    "SAC, older weights": (
        "cartpole_continuous",
        [*SHORT, train_section("SAC", "learning_starts: 100, staleness: 1")],
        320,
    ),
    "PPO, older weights": ("cartpole", [*SHORT, "train.environments=4", "train.staleness=1"], 1_280),
    "DQN": ("cartpole", [*SHORT, train_section("DQN", "learning_starts: 100")], 320),
}
"""Short trainings, each with ended episodes and an evaluation: the scenario, what is changed in it, and the
number of steps."""


def outcome(folder: Path) -> tuple[Any, ...]:
    """The result of a training, to the bit; without times."""
    run = Run.open(folder)
    assert run.record.result is not None
    with run.monitor.open(newline="") as file:
        next(file)
        rows = [{name: value for name, value in row.items() if name != "t"} for row in csv.DictReader(file)]
    log = run.evaluations / "training.jsonl"
    result = {name: value for name, value in run.record.result if name not in TIMES}
    return result, rows, log.read_text() if log.exists() else ""


def trained(
    name: str, folder: Path, executor: Executor, shards: int = 2, progress: Reporter | bool = False
) -> tuple[Any, ...]:
    scenario, changes, steps = CASES[name]
    compiled = api.compile(scenario, overrides=[*changes, f"train.shards={shards}"])
    train(compiled, run=folder, total_timesteps=steps, executor=executor, progress=progress)
    return outcome(folder)


def workers() -> list[int]:
    """The processes of shards: children of this process, or of a raylet which is one."""
    return children("deepbots_cli.cluster.worker") or children("ray::ShardWorker")


def children(name: str) -> list[int]:
    processes = subprocess.run(
        ["ps", "-ww", "-eo", "pid=,ppid=,args="], capture_output=True, text=True, check=True
    ).stdout.splitlines()
    parents = {int(pid): int(parent) for pid, parent, *_ in map(str.split, processes)}
    matching = [int(line.split()[0]) for line in processes if name in line and "defunct" not in line]
    return sorted(pid for pid in matching if os.getpid() in (parents[pid], parents.get(parents[pid])))


@pytest.mark.slow
def test_a_worker_with_another_scenario_is_refused(
    cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Here, since this process believes in another version of deepbots."""
    monkeypatch.setattr("deepbots_cli.__version__", "99.0")
    with pytest.raises(UsageError, match=r"the worker on .* has deepbots .*, but this process has 99\.0"):
        trained("PPO", tmp_path / "run", cluster)


@pytest.mark.slow
def test_workers_with_several_shards_give_the_same(cluster: Cluster, tmp_path: Path) -> None:
    kill = At(400, lambda: os.kill(workers()[0], signal.SIGKILL))
    assert trained("PPO", tmp_path / "workers", cluster, 4, kill) == trained(
        "PPO", tmp_path / "here", SERIAL, 4
    )
    assert kill.notes


class DeadlyProcesses(LocalProcesses):
    """Processes that die as soon as they get work."""

    is_deadly = False

    def ask(self, worker: Worker, method: str, *arguments: object) -> Owed:
        if self.is_deadly and method == "work":
            worker.process.kill()
        return super().ask(worker, method, *arguments)


@pytest.mark.slow
def test_an_episode_that_always_kills_its_worker_ends_the_training(tmp_path: Path) -> None:
    processes = DeadlyProcesses(2)
    kill = At(400, lambda: setattr(processes, "is_deadly", True))
    with Cluster(workers=2) as cluster, processes:
        cluster._pool = processes
        with pytest.raises(RunError, match="ended its worker 3 times in the steps after"):
            trained("PPO", tmp_path / "run", cluster, progress=kill)
    resume(tmp_path / "run")
    assert outcome(tmp_path / "run") == trained("PPO", tmp_path / "here", SERIAL)


def test_a_worker_that_is_killed_between_two_calls_is_lost_in_the_next_one() -> None:
    with LocalProcesses(2) as processes:
        killed, survivor = processes.start(Echo), processes.start(Echo)
        answers = [processes.ask(worker, "work", 1) for worker in (killed, survivor)]
        processes.wait(answers, count=2)
        killed.process.kill()
        killed.process.wait()
        processes.wait([processes.ask(survivor, "work", 2)])  # meanwhile its end is noticed
        processes.wait([], timeout_s=0.0)
        deadline = time.monotonic() + 20.0
        while not killed.process.stdin.closed and time.monotonic() < deadline:  # type: ignore[union-attr]
            processes.wait([processes.ask(survivor, "work", 3)])
        lost = processes.ask(killed, "work", 4)
        assert processes.wait([lost], timeout_s=20.0) == [lost]
        with pytest.raises(WorkerLost, match="ended by SIGKILL"):
            processes.answer(lost)


class WrittenPool:
    """A pool of two workers that answer and are lost as `events` says: (worker, is lost), one after the
    other. Each loss or answer is that of the first call of the worker."""

    workers = 2

    def __init__(self, events: list[tuple[int, bool]]) -> None:
        self.events = events
        self.calls: list[tuple[int, str, int]] = []
        self.lost: set[int] = set()

    def share(self, value: object) -> object:
        return value

    def free(self) -> int:
        return 0 if self.calls else self.workers

    def start(self, kind: object, run: object, number: int) -> int:
        return number

    def ask(self, worker: int, method: str, *arguments: Any) -> int:
        self.calls.append((worker, method, arguments[0]))
        return len(self.calls) - 1

    def wait(self, owed: Any, count: int = 1, timeout_s: float | None = None) -> list[int]:
        if self.calls[min(owed)][1] == "unmet":
            return sorted(owed)
        worker, is_lost = self.events.pop(0)
        self.lost |= {worker} if is_lost else set()
        return [min(call for call in owed if self.calls[call][0] == worker)]

    def answer(self, owed: int) -> object:
        worker, method, _ = self.calls[owed]
        if method == "work" and worker in self.lost:
            raise WorkerLost("its process ended")
        return None


def test_a_lost_worker_is_charged_to_the_shard_that_it_worked_on(tmp_path: Path) -> None:
    """Worker 0 has the shards 0 and 2, and gets 1 and 3 after those of worker 1, which is lost in 1. Each of
    the next workers is lost in shard 2."""
    pool = WrittenPool([(1, True), (0, False), (0, True), (2, True), (3, True)])
    run: Any = SimpleNamespace(path=tmp_path, digest="")
    shards = RemoteShards(cast(WorkerPool, pool), run, Permissions(), [[0], [1], [2], [3]], lambda _: None)
    with pytest.raises(RunError, match="shard 2 ended its worker 3 times"):
        shards.begin([[]] * 4)
