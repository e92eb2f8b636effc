"""The workers that the user requests, and what runs on them: calls of a function, and the shards of a
training.

The workers are some processes of this machine, or a Ray cluster that runs already.

A worker has one or more shards. When it is lost, alone or with its node, its shards continue on another
worker from the end of the last fragment, and repeat the lost part of the present one with the same results. A
node that joins later gets a worker with the next fragment.
"""

from __future__ import annotations

import pickle
import socket
import time
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Self, Unpack

from deepbots_cli.api import build as api_build
from deepbots_cli.cluster.worker import Call, Refusal, Requirements, output_in
from deepbots_cli.cluster.worker_pool import (
    MAX_LOSSES,
    LocalProcesses,
    WorkerLost,
    WorkerPool,
)
from deepbots_cli.compiler.inputs import RESOLVED_NAME
from deepbots_cli.document import Permissions
from deepbots_cli.errors import DeepbotsError, MissingExtraError, RunError, UsageError
from deepbots_cli.learning.executor import UNWATCHED, Attempt, CallOptions, Item, Result
from deepbots_cli.learning.runs.directories import WORKERS_FOLDER
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.rollout.collector import (
    EvaluationOrder,
    Order,
    RunningEpisode,
    ShardPool,
)
from deepbots_cli.rollout.worlds import Array
from deepbots_cli.words import shell_word

if TYPE_CHECKING:
    from deepbots_cli.cluster.ray_cluster import RayCluster
    from deepbots_cli.learning.environments import WorldFactory
    from deepbots_cli.program.task import Training

MAX_WORKERS = 1024
_NEWS_INTERVAL_S = 0.3
_READY_TIMEOUT_S = 60.0
"""The time in s for which shards wait for a new worker while others could take them, and then for the next
attempt to start one."""
_MAX_FAILED_STARTS = 5
"""The number of times in a row that all new workers may end while they start, if there are no others."""


# Calls of a function


class Tasks:
    """Calls of a function on the workers of a pool.

    Args:
        pool: The pool.
        options: The options of `Executor.map`.
    """

    def __init__(self, pool: WorkerPool, options: CallOptions) -> None:
        self._pool = pool
        self._watcher = options.get("watcher", UNWATCHED)
        self._log = options.get("log")
        self._stop = options.get("stop")
        self._requirements = Requirements.of_this_process(options.get("files", ()))
        self._calls = pool.calls(self._requirements, can_stop=self._stop is not None)
        self._running: dict[Any, Call] = {}
        self._losses: Counter[int] = Counter()
        self._again: deque[Call] = deque()
        self._outcomes: dict[int, Any] = {}

    def run(
        self, function: Callable[[Item, Attempt], Result], items: Iterable[Item]
    ) -> Generator[Result | DeepbotsError | None]:
        """Yield the outcomes in the order of the items."""
        waiting = self._waiting(function, items)
        following = 0
        is_stopping = False
        try:
            while True:
                if self._stop is not None and not is_stopping and self._stop():
                    is_stopping = True
                    self._outcomes |= {call.item: None for call in self._again}
                while not is_stopping and len(self._running) < self._pool.workers:
                    call = self._again.popleft() if self._again else next(waiting, None)
                    if call is None:
                        break
                    self._running[self._calls.submit(call)] = call
                while following in self._outcomes:
                    yield self._outcomes.pop(following)
                    following += 1
                if not self._running:
                    return
                for ready in self._pool.wait(self._running, timeout_s=_NEWS_INTERVAL_S):
                    self._end(ready, is_stopping=is_stopping)
                self._hand_on_news(is_stopping=is_stopping)
        finally:
            for running in self._running:
                self._calls.cancel(running)
            self._calls.close()

    def _waiting(self, function: Callable[[Item, Attempt], Result], items: Iterable[Item]) -> Iterator[Call]:
        for number, item in enumerate(items):
            log = None if self._log is None else self._log(item).absolute()
            yield Call(
                number, 1, pickle.dumps((function, item)), self._requirements, log, self._stop is not None
            )

    def _end(self, ready: Any, *, is_stopping: bool) -> None:
        """Handle the end of a call, or of its worker."""
        call = self._running.pop(ready)
        try:
            outcome = self._pool.answer(ready)
        except WorkerLost as loss:
            self._lose(call, loss, is_stopping=is_stopping)
        except Exception:
            # A call that is stopped may end in any error of its function: only its end matters then.
            if not is_stopping:
                raise
            self._finish(call, None)
        else:
            if isinstance(outcome, Refusal) and is_stopping:
                self._finish(call, None)
            elif isinstance(outcome, Refusal):
                self._repeat_elsewhere(call, outcome)
            else:
                self._finish(call, outcome)

    def _lose(self, call: Call, loss: WorkerLost, *, is_stopping: bool) -> None:
        """Repeat a call whose worker was lost, up to `MAX_LOSSES` times and unless the calls are stopped."""
        self._losses[call.item] += 1
        if is_stopping:
            self._finish(call, None)
        elif self._losses[call.item] < MAX_LOSSES:
            self._watcher.on_loss(call.item)
            self._again.append(call._replace(attempt=call.attempt + 1))
        else:
            self._finish(call, _too_many_losses(call, loss))

    def _repeat_elsewhere(self, call: Call, refusal: Refusal) -> None:
        """Repeat a call without the nodes that refuse it.

        Raises:
            UsageError: No node is left.
        """
        notes = self._calls.leave_out()
        if notes is None:
            raise UsageError(refusal.reason)
        for note in notes:
            self._watcher.on_note(call.item, note)
        self._again.append(call)

    def _finish(self, call: Call, outcome: Any) -> None:
        """Keep the outcome of a call, and remove its log if it is empty."""
        self._outcomes[call.item] = outcome
        self._watcher.on_done(call.item, outcome)
        if call.log is not None:
            with suppress(OSError):
                if not call.log.stat().st_size:
                    call.log.unlink()
                    call.log.parent.rmdir()

    def _hand_on_news(self, *, is_stopping: bool) -> None:
        """Hand on the news; after a stop, take back the calls that have not begun."""
        news = self._calls.news(stop=is_stopping)
        for number, text in news.notes:
            self._watcher.on_note(number, text)
        for number, report in news.reports.items():
            self._watcher.on_report(number, report)
        if is_stopping and news.begun is not None:
            for running, call in list(self._running.items()):
                if call.item not in news.begun:
                    self._calls.cancel(running)


def _too_many_losses(call: Call, error: Exception) -> DeepbotsError:
    hint = f"; {call.log} has its last output" if call.log is not None else ""
    reason = str(error).strip().partition("\n")[0]
    return DeepbotsError(f"it ended its worker {MAX_LOSSES} times{hint} (the last time: {reason})")


# Shards


class Beginning(NamedTuple):
    """The arguments with which a worker makes a shard: the numbers of its worlds, the running episode of
    each, and the permissions of the training."""

    worlds: Sequence[int]
    episodes: Sequence[RunningEpisode]
    permissions: Permissions


class ShardWorker:
    """Shards of one training, in a process of their own."""

    def __init__(self, run: Path, number: int) -> None:
        self._settings = ExitStack()  # closed when the process ends
        self._settings.enter_context(output_in(run / WORKERS_FOLDER / f"{number}.log"))
        from deepbots_cli.learning.sb3.algorithms import torch_settings

        self._settings.enter_context(torch_settings())
        self._path = run
        self._shards: dict[int, Any] = {}

    def unmet(self, requirements: Requirements, digest: str) -> str | None:
        """Return what keeps this process from working on the run, as a sentence; None if nothing does.

        `digest` is that of the program of the run.
        """
        reason = requirements.unmet()
        if reason is None and Run.open(self._path).digest != digest:
            host = socket.gethostname()
            reason = (
                f"the worker on {host} compiles the scenario to a different program; install the same"
                " version of deepbots"
            )
        return reason

    def work(
        self,
        number: int,
        beginning: Beginning | None,
        order: Order | EvaluationOrder | None,
        memory: Mapping[str, Array],
    ) -> Any:
        """Make a shard if there is a `beginning`, and return the observations, or the answer to an order.

        An error that ends the training is returned, since a traceback of the worker is added to one that is
        raised.
        """
        from deepbots_cli.learning.environments import supervisor_factory
        from deepbots_cli.learning.shards import Shard

        began = time.process_time()
        try:
            if beginning is not None and number not in self._shards:
                run = Run.open(self._path)
                build = supervisor_factory(run.record.engine, permissions=beginning.permissions)
                self._shards[number] = Shard(run, build, number, beginning.worlds)
            episodes = None if beginning is None else beginning.episodes
            answer = self._shards[number].work(order, memory, episodes)
        except DeepbotsError as error:
            return error
        if order is None:
            return answer
        return replace(answer, cpu_seconds=time.process_time() - began)


class RemoteShards:
    """The shards of a training on workers.

    Args:
        pool: The pool of processes.
        run: The run, in a folder that all workers see.
        permissions: The permissions of the training.
        worlds: The numbers of the worlds of each shard.
        note: Called with messages for the user, such as about a lost worker.
    """

    def __init__(
        self,
        pool: WorkerPool,
        run: Run,
        permissions: Permissions,
        worlds: Sequence[Sequence[int]],
        note: Callable[[str], None],
    ) -> None:
        self._pool = pool
        self._run = run
        self._permissions = permissions
        self._worlds = worlds
        self._note = note
        self._workers: dict[int, Any] = {}
        self._homes: list[int | None] = [None] * len(worlds)
        """The worker of each shard; None after it was lost."""
        self._new: set[int] = set()
        """The shards that have to begin on their worker."""
        self._started = self._failed_starts = 0
        self._next_start = 0.0

    def close(self) -> None:
        for worker in self._workers.values():
            self._pool.end(worker)

    def work(
        self,
        order: Order | EvaluationOrder | None,
        episodes: Sequence[Sequence[RunningEpisode]],
        memories: Sequence[Mapping[str, Array]],
    ) -> Callable[[], list[Any]]:
        """Ask all shards, each on its worker. The result waits for the answers, and replaces lost workers."""
        if order is None:
            self._homes = [None] * len(self._worlds)
        self._find_homes()
        shared = self._pool.share(order)
        answers: dict[int, Any] = {}
        losses: Counter[int] = Counter()
        waiting: dict[Any, tuple[int, int]] = {}

        def ask(shard: int, *, anew: bool) -> None:
            home = self._home_of(shard)
            beginning = Beginning(self._worlds[shard], episodes[shard], self._permissions) if anew else None
            waiting[
                self._pool.ask(self._workers[home], "work", shard, beginning, shared, memories[shard])
            ] = (shard, home)

        new, self._new = self._new, set()
        for shard in range(len(self._worlds)):
            ask(shard, anew=shard in new)

        def wait() -> list[Any]:
            while waiting:
                ready, *_ = self._pool.wait(waiting)
                shard, worker = waiting[ready]
                try:
                    answer = self._pool.answer(ready)
                except WorkerLost as error:
                    # A worker works in the order of the calls, so it was lost in the first of these.
                    lost = {call: other for call, (other, home) in waiting.items() if home == worker}
                    first = next(iter(lost.values()))
                    losses[first] += 1
                    self._forget(worker, str(error))
                    if losses[first] == MAX_LOSSES:
                        raise self._too_many_losses(first, order, worker) from error
                    self._find_homes(balance=False)  # the other shards are at work
                    for call, other in lost.items():
                        del waiting[call]
                        self._new.discard(other)
                        ask(other, anew=True)
                    continue
                del waiting[ready]
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
            busiest = max(load, key=lambda worker: load[worker])
            idlest = min(load, key=lambda worker: load[worker])
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
        missing = min(self._pool.workers, len(self._worlds)) - len(self._workers)
        if missing <= 0 or (self._workers and time.monotonic() < self._next_start):
            return
        waiting = self._start_missing(missing)
        while not self._workers and not self._pool.wait(waiting, timeout_s=_READY_TIMEOUT_S):
            self._pool.check()
        ready = self._pool.wait(waiting, len(waiting), _READY_TIMEOUT_S) if waiting else ()
        for call in waiting.keys() - set(ready):  # its node was lost, or is busy with something else
            self._pool.end(waiting[call][1])
        is_any_lost = len(ready) < len(waiting)
        refusals = []
        for call in ready:
            number, worker = waiting[call]
            try:
                reason = self._pool.answer(call)
            except WorkerLost:
                is_any_lost = True
                continue
            self._workers[number] = worker
            refusals += [reason] if reason is not None else []
        if refusals:
            raise UsageError(refusals[0])
        if is_any_lost:
            self._next_start = time.monotonic() + _READY_TIMEOUT_S
        self._failed_starts = 0 if self._workers else self._failed_starts + 1
        if self._failed_starts == _MAX_FAILED_STARTS:
            log = self._log(self._started - 1)
            raise RunError(
                f"{_MAX_FAILED_STARTS} workers in a row ended while they started; {log} has the output of the"
                " last one"
            )
        if not self._workers:
            self._start_workers()

    def _start_missing(self, missing: int) -> dict[Any, tuple[int, Any]]:
        """Start as many of the missing workers as the cluster has room for, at least one if there is none.
        Return the calls to wait for, with number and worker."""
        free = self._pool.free()
        if not self._workers and not free and not self._failed_starts:
            self._note("waiting for a free CPU in the cluster")
        waiting = {}
        requirements = Requirements.of_this_process([self._run.path / RESOLVED_NAME])
        for _ in range(min(missing, free) if self._workers else max(1, min(missing, free))):
            number, self._started = self._started, self._started + 1
            worker = self._pool.start(ShardWorker, self._run.path.absolute(), number)
            waiting[self._pool.ask(worker, "unmet", requirements, self._run.digest)] = (number, worker)
        return waiting

    def _forget(self, lost: int, reason: str) -> None:
        """Forget a worker that is lost, and the homes of its shards."""
        if self._workers.pop(lost, None) is not None:
            self._note(f"worker {lost} was lost ({reason}); its shards continue on another worker")
        self._homes = [None if home == lost else home for home in self._homes]

    def _too_many_losses(self, shard: int, order: Order | EvaluationOrder | None, worker: int) -> RunError:
        steps = order.begun if isinstance(order, Order) else 0
        when = "in an evaluation" if isinstance(order, EvaluationOrder) else f"in the steps after {steps:,}"
        error = RunError(
            f"shard {shard} ended its worker {MAX_LOSSES} times {when}; {self._log(worker)} has its last"
            " output"
        )
        error.add_note(f"to repeat this in one process: deepbots resume {shell_word(self._run.path)}")
        return error

    def _log(self, worker: int) -> Path:
        return self._run.path / WORKERS_FOLDER / f"{worker}.log"


# The workers


def _ray_cluster(address: str) -> RayCluster:
    """Return a Ray cluster; Ray takes a second to import.

    Raises:
        MissingExtraError: Ray is not installed.
    """
    try:
        from deepbots_cli.cluster.ray_cluster import RayCluster
    except ModuleNotFoundError:
        raise MissingExtraError("cluster", "--cluster") from None
    return RayCluster(address)


class Cluster:
    """Workers for the shards of a training, and for several trainings, evaluations or tests (`map`); a
    context manager.

    Args:
        workers: Use this number of processes on this machine. They start when there is work, and end with the
            block.
        address: Join the Ray cluster at `HOST:PORT`, or the one of this machine (`auto`).
    """

    is_here = False

    def __init__(self, *, workers: int | None = None, address: str | None = None) -> None:
        if (workers is None) == (address is None):
            raise UsageError("name either a number of workers or the address of a cluster")
        if workers is not None and not 1 <= workers <= MAX_WORKERS:
            raise UsageError(f"the number of workers must be from 1 to {MAX_WORKERS}, not {workers}")
        self._pool: RayCluster | LocalProcesses = (
            _ray_cluster(address) if address is not None else LocalProcesses(workers or 1)
        )

    def __enter__(self) -> Self:
        self._pool.__enter__()
        self._pool.set_message_if_lost("to continue a training, use `deepbots resume`")
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.__exit__()

    @property
    def workers(self) -> int:
        """The number of workers: the requested one, or the number of CPUs of the cluster."""
        return self._pool.workers

    def shards(
        self, stack: ExitStack, run: Run, training: Training, build: WorldFactory, note: Callable[[str], None]
    ) -> ShardPool:
        """Return the shards of a training on the workers.

        Raises:
            UsageError: A worker does not see the run, or has another version of deepbots or of its libraries.
        """
        from deepbots_cli.learning.shards import world_numbers

        if not isinstance(build, partial) or build.func is not api_build:
            raise UsageError("the argument `build` makes worlds in this process only; leave out the workers")
        pool = RemoteShards(self._pool, run, build.keywords["permissions"], world_numbers(training), note)
        stack.callback(pool.close)
        self._pool.set_message_if_lost(f"to continue: deepbots resume {shell_word(run.path)}")
        return pool

    def map(
        self,
        function: Callable[[Item, Attempt], Result],
        items: Iterable[Item],
        **options: Unpack[CallOptions],
    ) -> Generator[Result | DeepbotsError | None]:
        """Call a function with each item on the workers, as many at a time as there are workers; see
        `Executor.map`."""
        return Tasks(self._pool, options).run(function, items)
