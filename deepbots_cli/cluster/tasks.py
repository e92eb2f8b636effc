"""Calls of a function on workers. A call whose worker is lost is repeated on another worker."""

from __future__ import annotations

import pickle
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import suppress
from typing import Any

from deepbots_cli.cluster.worker_pool import MAX_LOSSES, Call, Refusal, Requirements, WorkerLost, WorkerPool
from deepbots_cli.errors import DeepbotsError, UsageError
from deepbots_cli.learning.calls import UNWATCHED, Attempt
from deepbots_cli.learning.executor import CallOptions, Item, Result

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
