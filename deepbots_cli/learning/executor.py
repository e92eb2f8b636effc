"""Executors of work: in this process, or on the workers of `deepbots_cli.cluster`; and its interruption.

Work is calls of one function with several items, such as the seeds of a group, or the shards of one training.
A result depends on its item only. A call whose worker was lost is repeated on another one.

The first Ctrl-C or SIGTERM ends a training after its rollout, the second one at once.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, Protocol, TypedDict, TypeVar, Unpack

from deepbots_cli.errors import DeepbotsError
from deepbots_cli.records import dataclass

if TYPE_CHECKING:
    from deepbots_cli.learning.environments import WorldFactory
    from deepbots_cli.learning.runs.run import Run
    from deepbots_cli.program.task import Training
    from deepbots_cli.rollout.collector import ShardPool


def _ignore(value: object) -> None:
    pass


@dataclass(frozen=True)
class Attempt:
    """A call of the function.

    Attributes:
        number: 1, or higher if the worker of an earlier call with this item was lost.
        report: Reports how far the call is; the newest value replaces an earlier one.
        note: Passes a note to the user.
    """

    number: int = 1
    report: Callable[[object], None] = _ignore
    note: Callable[[str], None] = _ignore


class Watcher:
    """Follows calls; items are numbered from 0. This one does nothing."""

    def on_report(self, item: int, value: object) -> None:
        """Called with the newest `report` of a call."""

    def on_note(self, item: int, text: str) -> None:
        """Called with a note of a call for the user."""

    def on_loss(self, item: int) -> None:
        """Called when the worker of a call was lost. Another worker repeats the call."""

    def on_done(self, item: int, outcome: object) -> None:
        """Called after a call with the value that `map` yields for it, not necessarily in the order of the
        items."""


UNWATCHED = Watcher()


class Counter(Watcher):
    """Calls a function with the number of completed items and the number of all items."""

    def __init__(self, show: Callable[[int, int], object] | None, total: int) -> None:
        self._show = show
        self._done = 0
        self.total = total

    def on_done(self, item: int, outcome: object) -> None:
        self._done += 1
        if self._show is not None:
            self._show(self._done, self.total)


Item = TypeVar("Item")
Result = TypeVar("Result")


class CallOptions(TypedDict, total=False):
    """Options of `Executor.map`.

    Attributes:
        watcher: Is called with reports, notes and results.
        files: Files that every worker must be able to read.
        log: Returns the file for the output of the call with an item, on a worker.
        stop: Returns whether to stop: calls that run on workers receive SIGTERM once, and no other call
            begins. With it, each call has a process of its own.
    """

    watcher: Watcher
    files: Sequence[Path]
    log: Callable[[Any], Path]
    stop: Callable[[], bool]


class Executor(Protocol):
    """Runs calls and shards."""

    @property
    def is_here(self) -> bool:
        """Whether calls run in this process, one after the other."""

    @property
    def workers(self) -> int:
        """The number of calls at a time."""

    def map(
        self,
        function: Callable[[Item, Attempt], Result],
        items: Iterable[Item],
        **options: Unpack[CallOptions],
    ) -> Generator[Result | DeepbotsError | None]:
        """Call a function with each item, and yield the results in the order of the items.

        A DeepbotsError that a call raises is yielded in its place, and the other calls go on. After a stop
        the results end early, and None stands for a call that has not been completed. Closing the generator
        ends the calls.

        Args:
            function: A function of a module, which takes an item. Workers require that both can be pickled.
            items: The items; they are made when they are needed.

        Raises:
            UsageError: A worker has other versions of deepbots or of its libraries, or cannot read a file.
        """

    def shards(
        self, stack: ExitStack, run: Run, training: Training, build: WorldFactory, note: Callable[[str], None]
    ) -> ShardPool:
        """Create the shards of a training, which end with `stack`. `note` is called with messages for the
        user.

        Raises:
            UsageError: A worker cannot read the run, or has other versions of deepbots or of its libraries.
        """


class _ThisProcess:
    is_here = True
    workers = 1

    def map(
        self,
        function: Callable[[Item, Attempt], Result],
        items: Iterable[Item],
        **options: Unpack[CallOptions],
    ) -> Generator[Result | DeepbotsError | None]:
        watcher = options.get("watcher", UNWATCHED)
        for number, item in enumerate(items):
            outcome: Result | DeepbotsError
            try:
                outcome = function(
                    item, Attempt(1, partial(watcher.on_report, number), partial(watcher.on_note, number))
                )
            except DeepbotsError as error:
                outcome = error
            watcher.on_done(number, outcome)
            yield outcome

    def shards(
        self, stack: ExitStack, run: Run, training: Training, build: WorldFactory, note: Callable[[str], None]
    ) -> ShardPool:
        from deepbots_cli.learning.shards import LocalShards, Shard, world_numbers

        pool = LocalShards(
            [Shard(run, build, number, worlds) for number, worlds in enumerate(world_numbers(training))]
        )
        stack.callback(pool.close)
        return pool


SERIAL: Executor = _ThisProcess()


def results(outcomes: Generator[Result | DeepbotsError | None]) -> Generator[Result]:
    """Yield the results of `map`. The first error among them is raised, and ends the calls."""
    try:
        for outcome in outcomes:
            if isinstance(outcome, DeepbotsError):
                raise outcome
            if outcome is not None:
                yield outcome
    finally:
        outcomes.close()


class Interruption:
    """A requested end of the training, by Ctrl-C or SIGTERM."""

    def __init__(self) -> None:
        self.requested = False

    def __call__(self, number: int, frame: FrameType | None) -> None:
        if self.requested:
            # Whoever asks twice does not want to wait for the end of an update.
            raise KeyboardInterrupt
        self.requested = True


@contextmanager
def signals_handled(interruption: Interruption) -> Iterator[None]:
    """Context in which the first signal only sets `requested`, and the second raises KeyboardInterrupt.
    Restores the handlers.

    Python delivers signals to the main thread only; in other threads this changes nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, interruption) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            # None stands for a handler that was not set from Python, and cannot be set again.
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
