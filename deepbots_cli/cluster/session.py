"""The workers that the user requests, and calls of a function on them: some processes of this machine, or a
Ray cluster that runs already.
"""

from __future__ import annotations

import pickle
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import ExitStack, suppress
from functools import partial
from shlex import quote
from typing import TYPE_CHECKING, Any, Self, Unpack

from deepbots_cli.api import build as api_build
from deepbots_cli.cluster.local_processes import LocalProcesses
from deepbots_cli.cluster.ray_cluster import RayCluster
from deepbots_cli.cluster.worker_pool import MAX_LOSSES, Call, Refusal, Requirements, WorkerLost, WorkerPool
from deepbots_cli.errors import DeepbotsError, UsageError
from deepbots_cli.learning.executor import UNWATCHED, Attempt, CallOptions, Item, Result

if TYPE_CHECKING:
    from deepbots_cli.learning.environments import WorldFactory
    from deepbots_cli.learning.runs.run import Run
    from deepbots_cli.program.task import Training
    from deepbots_cli.rollout.collector import ShardPool


_NEWS_INTERVAL_S = 0.3


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
            if isinstance(outcome, Refusal):
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


MAX_WORKERS = 1024


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
            RayCluster(address) if address is not None else LocalProcesses(workers or 1)
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
        from deepbots_cli.cluster.shards import RemoteShards
        from deepbots_cli.learning.shards import world_numbers

        if not isinstance(build, partial) or build.func is not api_build:
            raise UsageError("the argument `build` makes worlds in this process only; leave out the workers")
        pool = RemoteShards(self._pool, run, build.keywords["permissions"], world_numbers(training), note)
        stack.callback(pool.close)
        self._pool.set_message_if_lost(f"to continue: deepbots resume {quote(str(run.path))}")
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
