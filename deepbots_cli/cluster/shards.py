"""The shards of a training as Ray actors.

A worker has one or more shards. When it is lost, alone or with its node, its shards continue on another worker from the end of the last
fragment, and repeat what was lost of the present one: the same numbers. A node that joins later gets a worker with the next fragment.
"""

from __future__ import annotations

import os
import socket
import sys
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from shlex import quote
from typing import Any, NamedTuple

import deepbots_cli
from deepbots_cli.document import Permissions
from deepbots_cli.errors import DeepbotsError, RunError, UsageError
from deepbots_cli.learning.run import Run, versions
from deepbots_cli.rollout.collector import Evaluated, EvaluationOrder, Harvest, Order, RunningEpisode
from deepbots_cli.rollout.worlds import Array

MAX_LOSSES = 3
"""Workers that may be lost in one fragment of a shard."""
_READY_TIMEOUT_S = 60.0
"""How long shards wait for a new worker while others could take them, and then for the next attempt to start one."""
_MAX_VAIN_STARTS = 5
"""How often in a row all new workers may end while they start, if there are no others."""
_LIBRARIES = ("numpy", "torch", "stable-baselines3", "pybullet", "mujoco")
"""Libraries on whose versions the numbers depend."""


class Beginning(NamedTuple):
    """What a worker needs to make a shard: the numbers of its worlds, the running episode of each, and the permissions of the training."""

    worlds: Sequence[int]
    episodes: Sequence[RunningEpisode]
    permissions: Permissions


class ShardWorker:
    """An actor with shards of one training."""

    def __init__(self, run: Path, number: int) -> None:
        write_output_to(run / "workers" / f"{number}.log")
        from deepbots_cli.learning.sb3.algorithms import torch_settings

        torch_settings().__enter__()  # for the life of this process
        self._path, self._number = run, number
        self._shards: dict[int, Any] = {}

    def describe(self) -> dict[str, str]:
        """Where it runs and with what; `digest` is that of the scenario of the run, empty if this process does not see the run."""
        try:
            digest = Run.open(self._path).digest
        except DeepbotsError:
            digest = ""
        return {"host": socket.gethostname(), **library_versions(), "digest": digest}

    def work(self, number: int, beginning: Beginning | None, order: Order | EvaluationOrder | None, memory: Mapping[str, Array]) -> Any:
        """Make a shard if there is a `beginning`, and return the observations, or the answer to an order.

        An error that ends the training is returned, since Ray would add a traceback to it.
        """
        from deepbots_cli.learning.environments import supervisor_factory
        from deepbots_cli.learning.shards import Shard

        began = time.process_time()
        try:
            seen = None
            if beginning is not None:
                if number not in self._shards:
                    run = Run.open(self._path)
                    build = supervisor_factory(run.record.engine, permissions=beginning.permissions)
                    self._shards[number] = Shard(run, build, number, beginning.worlds)
                seen = self._shards[number].begin(beginning.episodes)
            if order is None:
                return seen
            shard = self._shards[number]
            answer = shard.evaluate(order) if isinstance(order, EvaluationOrder) else shard.collect(order, memory)
            return replace(answer, cpu_seconds=time.process_time() - began, worker=self._number)
        except DeepbotsError as error:
            return error


def library_versions() -> dict[str, str]:
    return {"deepbots": deepbots_cli.__version__, **{name: text for name, text in versions().items() if name in _LIBRARIES}}


def check_node() -> None:
    """Raises: RunError: The Ray node of this process was lost; calls of Ray may wait for it forever."""
    import ray

    here = ray.get_runtime_context().get_node_id()
    if not any(node["Alive"] for node in ray.nodes() if node["NodeID"] == here):
        error = RunError("the Ray node of this process was lost")
        error.add_note("start again; a training continues with `deepbots train --resume`")
        raise error


def write_output_to(path: Path) -> None:
    """Write standard output and error of this process into a file."""
    sys.stdout.flush()
    sys.stderr.flush()
    with suppress(OSError):  # a folder that is not shared is refused in words, after `describe`
        path.parent.mkdir(exist_ok=True)
        log = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | getattr(os, "O_NOFOLLOW", 0), 0o644)
        os.dup2(log, 1)
        os.dup2(log, 2)
        os.close(log)


class RemoteShards:
    """The shards of a training on workers.

    Args:
        run: The run, in a folder that all workers see.
        permissions: Those of the training.
        worlds: The numbers of the worlds of each shard.
        workers: The largest number of workers.
        note: Called with what the user should know, such as a lost worker.
    """

    def __init__(
        self, run: Run, permissions: Permissions, worlds: Sequence[Sequence[int]], workers: int, note: Callable[[str], None]
    ) -> None:
        self._run, self._permissions, self._worlds, self._note = run, permissions, worlds, note
        self._wanted = min(workers, len(worlds))
        self._workers: dict[int, Any] = {}
        self._homes: list[int | None] = [None] * len(worlds)
        """The worker of each shard; None after this was lost."""
        self._new: set[int] = set()
        """The shards that have to begin on their worker."""
        self._started = self._vain_starts = 0
        self._next_start = 0.0

    def begin(self, episodes: Sequence[Sequence[RunningEpisode]]) -> list[Any]:
        self._homes = [None] * len(self._worlds)
        return self._work(None, [{} for _ in self._worlds], episodes)()

    def collect(
        self, order: Order, memories: Sequence[Mapping[str, Array]], episodes: Sequence[Sequence[RunningEpisode]]
    ) -> Callable[[], list[Harvest]]:
        return self._work(order, memories, episodes)

    def evaluate(self, order: EvaluationOrder, episodes: Sequence[Sequence[RunningEpisode]]) -> list[Evaluated]:
        return self._work(order, [{} for _ in self._worlds], episodes)()

    def close(self) -> None:
        import ray

        for worker in self._workers.values():
            ray.kill(worker)

    def _work(
        self,
        order: Order | EvaluationOrder | None,
        memories: Sequence[Mapping[str, Array]],
        episodes: Sequence[Sequence[RunningEpisode]],
    ) -> Callable[[], list[Any]]:
        """Ask all shards, each on its worker. The result waits for the answers, and replaces lost workers."""
        import ray

        self._find_homes()
        shared = ray.put(order)
        answers: dict[int, Any] = {}
        losses: Counter[int] = Counter()
        waiting: dict[Any, tuple[int, int]] = {}

        def ask(shard: int, *, anew: bool) -> None:
            home = self._home_of(shard)
            beginning = Beginning(self._worlds[shard], episodes[shard], self._permissions) if anew else None
            waiting[self._workers[home].work.remote(shard, beginning, shared, memories[shard])] = (shard, home)

        new, self._new = self._new, set()
        for shard in range(len(self._worlds)):
            ask(shard, anew=shard in new)

        def wait() -> list[Any]:
            while waiting:
                (ready, *_), _ = ray.wait(list(waiting))
                shard, worker = waiting.pop(ready)
                try:
                    answer = ray.get(ready)
                except ray.exceptions.RayTaskError:
                    raise
                except ray.exceptions.RayError as error:
                    lost = {call: other for call, (other, home) in waiting.items() if home == worker}
                    for call in lost:
                        del waiting[call]
                    unfinished = sorted([shard, *lost.values()])
                    losses[unfinished[0]] += 1  # a worker works on its shards in the order of their numbers
                    self._forget(worker)
                    if losses[unfinished[0]] == MAX_LOSSES:
                        raise self._too_many_losses(unfinished[0], order, worker) from error
                    self._find_homes(balance=False)  # the other shards are at work
                    for other in unfinished:
                        self._new.discard(other)
                        ask(other, anew=True)
                    continue
                if isinstance(answer, DeepbotsError):
                    raise answer
                answers[shard] = answer
            return [answers[shard] for shard in range(len(self._worlds))]

        return wait

    # Workers

    def _home_of(self, shard: int) -> int:
        home = self._homes[shard]
        if home is None:
            raise RuntimeError(f"shard {shard} has no worker")
        return home

    def _find_homes(self, *, balance: bool = True) -> None:
        """Give each shard without a worker one: new workers start while the cluster has room.

        With `balance`, shards of the busiest workers move, until all have about as many.
        """
        self._start_workers()
        load = Counter(dict.fromkeys(self._workers, 0))
        load.update(home for home in self._homes if home is not None)
        for shard, home in enumerate(self._homes):
            busiest, idlest = max(load, key=lambda worker: load[worker]), min(load, key=lambda worker: load[worker])
            if home is None or (balance and home == busiest and load[busiest] > load[idlest] + 1):
                if home is not None:
                    load[home] -= 1
                load[idlest] += 1
                self._homes[shard] = idlest
                self._new.add(shard)

    def _start_workers(self) -> None:
        """Start the workers that are missing, if the cluster has room for them; without any, wait for room.

        Raises:
            UsageError: A worker does not see the run, or has other versions.
        """
        import ray

        missing = self._wanted - len(self._workers)
        if not missing or (self._workers and time.monotonic() < self._next_start):
            return
        waiting = self._begun(missing)
        while not self._workers and not ray.wait(list(waiting), timeout=_READY_TIMEOUT_S)[0]:
            check_node()
        ready, late = ray.wait(list(waiting), num_returns=len(waiting), timeout=_READY_TIMEOUT_S) if waiting else ((), ())
        for call in late:  # its node was lost, or is busy with something else
            ray.kill(waiting[call][1])
        is_any_lost = bool(late)
        for call in ready:
            number, worker = waiting[call]
            try:
                self._check(ray.get(call))
            except ray.exceptions.RayActorError as error:
                if error.actor_init_failed:
                    raise UsageError("a worker cannot import deepbots; install the same version on all nodes") from error
                is_any_lost = True
            else:
                self._workers[number] = worker
        if is_any_lost:
            self._next_start = time.monotonic() + _READY_TIMEOUT_S
        self._vain_starts = 0 if self._workers else self._vain_starts + 1
        if self._vain_starts == _MAX_VAIN_STARTS:
            log = self._log(self._started - 1)
            raise RunError(f"{_MAX_VAIN_STARTS} workers in a row ended while they started; {log} has the output of the last one")
        if not self._workers:
            self._start_workers()

    def _begun(self, missing: int) -> dict[Any, tuple[int, Any]]:
        """Begin to start as many of the missing workers as the cluster has room for, at least one if there is none: the calls to wait
        for, with number and worker."""
        import ray

        free = int(ray.available_resources().get("CPU", 0))
        if not self._workers and not free and not self._vain_starts:
            self._note("waiting for a free CPU in the cluster")
        actor = ray.remote(ShardWorker).options(num_cpus=1, max_restarts=0, max_task_retries=0, scheduling_strategy="SPREAD")
        waiting = {}
        for _ in range(min(missing, free) if self._workers else max(1, min(missing, free))):
            number, self._started = self._started, self._started + 1
            worker = actor.remote(self._run.path.absolute(), number)
            waiting[worker.describe.remote()] = (number, worker)
        return waiting

    def _check(self, there: dict[str, str]) -> None:
        """Compare a worker with this process."""
        host, digest = there.pop("host"), there.pop("digest")
        if not digest:
            raise UsageError(f"the worker on {host} does not see {self._run.path.absolute()}; train in a folder that all nodes share")
        for name, version in library_versions().items():
            if there.get(name) != version:
                raise UsageError(f"the worker on {host} has {name} {there.get(name, 'not installed')}, but this process has {version}")
        if digest != self._run.digest:
            raise UsageError(f"the worker on {host} compiles the scenario to a different program; install the same version of deepbots")

    def _forget(self, lost: int) -> None:
        """A worker is lost: its shards have no home."""
        if self._workers.pop(lost, None) is not None:
            self._note(f"worker {lost} was lost; its shards continue on another worker")
        self._homes = [None if home == lost else home for home in self._homes]

    def _too_many_losses(self, shard: int, order: Order | EvaluationOrder | None, worker: int) -> RunError:
        steps = order.begun if isinstance(order, Order) else 0
        when = "in an evaluation" if isinstance(order, EvaluationOrder) else f"in the steps after {steps:,}"
        error = RunError(f"shard {shard} ended its worker {MAX_LOSSES} times {when}; {self._log(worker)} has its last output")
        error.add_note(f"to repeat this in one process: deepbots train --resume {quote(str(self._run.path))}")
        return error

    def _log(self, worker: int) -> Path:
        return self._run.path / "workers" / f"{worker}.log"
