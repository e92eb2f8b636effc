"""Processes that are killed at random moments change nothing in the result of a training, and leave no
process behind.

The environment variable KILLS_SEED repeats the moments of a run; a test that fails has printed it.
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from test_cluster_workers import CASES, outcomes, trained

from deepbots_cli import api
from deepbots_cli.learning import train_group
from deepbots_cli.learning.executor import SERIAL
from tests.cluster.hasty import HastyCluster
from tests.cluster.nodes import cluster_of_nodes

pytestmark = pytest.mark.slow
SEED = int(os.environ.get("KILLS_SEED", random.randrange(10**6)))
KINDS = ("PPO", "SAC", "group", "PPO", "SAC")
SEEDS = (0, 1, 2)
WORKERS = ("ray::ShardWorker", "ray::_perform", f"{sys.executable} -m deepbots_cli.cluster.worker")
GROUP = ("cartpole", [*CASES["PPO"][1], "train.n_steps=32"], 1_280)
"""The scenario of a group, what is changed in it, and the number of steps."""


class Process(NamedTuple):
    """A process; `started` distinguishes it from another one with its number."""

    pid: int
    started: str
    parent: int
    command: str


def processes() -> list[Process]:
    lines = subprocess.run(
        ["ps", "-ww", "-eo", "pid=,ppid=,lstart=,args="], capture_output=True, text=True, check=True
    ).stdout.splitlines()
    fields = [line.split(maxsplit=7) for line in lines if "<defunct>" not in line]
    return [
        Process(int(pid), " ".join(started), int(parent), command)
        for pid, parent, *started, command in fields
    ]


def below(root: int) -> list[Process]:
    """The processes that another one has started, and those that they have started."""
    alive = processes()
    tree = {root}
    while more := {process.pid for process in alive if process.parent in tree} - tree:
        tree |= more
    return [process for process in alive if process.pid in tree - {root}]


class Processes:
    """The processes that were seen; in the end, each has to be gone."""

    def __init__(self) -> None:
        self.seen: set[tuple[int, str]] = set()

    def below(self, root: int) -> list[Process]:
        started = below(root)
        self.seen |= {
            (process.pid, process.started) for process in started if not process.command.startswith("ps ")
        }
        return started

    def left(self, timeout_s: float = 120.0) -> list[Process]:
        """Those that are left; an agent of Ray whose node was killed looks for it for a minute."""
        deadline = time.monotonic() + timeout_s
        while True:
            remaining = [process for process in processes() if process[:2] in self.seen]
            if not remaining or time.monotonic() > deadline:
                return remaining
            time.sleep(0.5)


@pytest.fixture(scope="module")
def started_processes() -> Iterator[Processes]:
    """Used before the clusters, so that it ends after them."""
    started = Processes()
    yield started
    assert not started.left()


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Any]:
    """What a training makes that nobody disturbs."""

    @cache
    def of(kind: str) -> Any:
        return train(kind, tmp_path_factory.mktemp("here") / "run", SERIAL)

    return of


def train(kind: str, folder: Path, place: Any) -> Any:
    if kind != "group":
        return trained(kind, folder, place)
    scenario, changes, steps = GROUP
    training = train_group(
        api.compile(scenario, overrides=changes), SEEDS, group=folder, total_timesteps=steps, executor=place
    )
    assert not training.failed
    return outcomes(folder)


def has_episodes(folder: Path) -> bool:
    return any(
        log.read_text().count("\n") > 2
        for log in [*folder.glob("monitor.csv"), *folder.glob("*/monitor.csv")]
    )


class Site:
    """Where the trainings run, and what can be killed there."""

    def __init__(self, place: HastyCluster, nodes: Any, started_processes: Processes) -> None:
        self.place, self._nodes, self._seen = place, nodes, started_processes

    def kill(self, generator: random.Random) -> list[str]:
        """Kill one or two workers, or a node, for which another one joins; what was killed."""
        started = self._seen.below(os.getpid())
        nodes = sorted(self._nodes.worker_nodes, key=_raylet) if self._nodes else []
        if nodes and generator.random() < 0.6:
            node = generator.choice(nodes)
            raylet = _raylet(node)
            victims = [raylet, *(process.pid for process in below(raylet))]
            if generator.random() < 0.5:  # the other processes end when they miss it
                del victims[1:]
            is_late = generator.random() < 0.5
            if not is_late:
                self.add_node()
            for pid in victims:
                _kill(pid)
            self._nodes.worker_nodes.remove(node)
            node.kill_all_processes(check_alive=False, allow_graceful=False, wait=True)
            if is_late:
                time.sleep(generator.uniform(0.0, 5.0))
                self.add_node()
            return [
                f"node with {len(victims)} processes, the other one joined"
                f" {'after' if is_late else 'before'} that"
            ]
        workers = [
            process
            for process in started
            if process.command.startswith((*WORKERS, *(["ray::Board"] if generator.random() < 0.2 else [])))
        ]
        if not workers:
            return []
        chosen = generator.sample(workers, 2 if len(workers) > 1 and generator.random() < 0.25 else 1)
        for process in chosen:
            _kill(process.pid)
        return [process.command for process in chosen]

    def add_node(self) -> None:
        self._nodes.add_node(num_cpus=1, object_store_memory=100 << 20)
        self._seen.below(os.getpid())


def _raylet(node: Any) -> int:
    return int(node.all_processes["raylet"][0].process.pid)


def _kill(pid: int) -> None:
    with suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)


@pytest.fixture(scope="module", params=["workers", "nodes"])
def site(request: pytest.FixtureRequest, started_processes: Processes) -> Iterator[Site]:
    if request.param == "workers":
        with HastyCluster(workers=2) as place:
            yield Site(place, None, started_processes)
        return
    pytest.importorskip("ray")
    with cluster_of_nodes() as nodes:
        for _ in range(2):
            nodes.add_node(num_cpus=1, object_store_memory=100 << 20)
        nodes._shutdown_at_exit = (
            False  # only the main thread could install the handlers of a node that joins later
        )
        with HastyCluster(address=nodes.address) as place:
            yield Site(place, nodes, started_processes)


class Killer(threading.Thread):
    """Kills once, at a random moment of a training: often after its first episode, else at any moment."""

    def __init__(self, site: Site, folder: Path, generator: random.Random) -> None:
        super().__init__()
        self.killed: list[str] = []
        self._error: Exception | None = None
        self._site, self._folder, self._generator = site, folder, generator
        self._awaits_episode = generator.random() < 0.7
        self._after = generator.uniform(0.0, 2.0 if self._awaits_episode else 6.0)
        self._ended = threading.Event()

    def run(self) -> None:
        while self._awaits_episode and not has_episodes(self._folder) and not self._ended.wait(0.02):
            pass
        self._ended.wait(self._after)
        try:
            while not self._ended.is_set() and not self.killed:
                self.killed = self._site.kill(self._generator)
                self._ended.wait(0.1)
        except Exception as error:  # noqa: BLE001  # raised by `end`, since this is a thread
            self._error = error

    def end(self) -> None:
        self._ended.set()
        self.join()
        if self._error is not None:
            raise self._error

    def __str__(self) -> str:
        return (
            f"{self._after:.2f} s after {'the first episode' if self._awaits_episode else 'the start'}:"
            f" {self.killed or 'nothing'}"
        )


@pytest.mark.parametrize(
    ("site", "number"),
    [("workers", n) for n in range(8)] + [("nodes", n) for n in range(8, 20)],
    indirect=["site"],
)
def test_workers_and_nodes_that_are_killed_change_nothing(
    site: Site, number: int, undisturbed: Callable[[str], Any], tmp_path: Path
) -> None:
    kind = KINDS[number % len(KINDS)]
    expected = undisturbed(kind)
    for attempt in range(10):  # until a training has not ended before the moment
        folder = tmp_path / str(attempt)
        killer = Killer(site, folder, random.Random(f"{SEED}/{number}/{attempt}"))
        killer.start()
        try:
            result = train(kind, folder, site.place)
        finally:
            killer.end()
        print(f"KILLS_SEED={SEED} {number}: {kind}, {killer}", file=sys.stderr)
        assert result == expected
        if killer.killed:
            return
    pytest.fail("every training ended before the kill")
