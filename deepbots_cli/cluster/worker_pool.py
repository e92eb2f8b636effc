"""The interface between shards or calls and the processes that do their work, and the processes of this
machine.

`LocalProcesses` starts processes on this machine, and `RayCluster` (`ray_cluster.py`) uses those of a Ray
cluster.

A process of this machine is an interpreter of its own, which imports deepbots and nothing of the main
module: it works from a script, `python -c` and a notebook. `concurrent.futures` and `multiprocessing.Pool` do
not serve here: the first ends all calls when one process is killed, the second waits for its answer forever,
and both import the main module.
"""

from __future__ import annotations

import os
import pickle
import time
from collections import deque
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from functools import partial
from queue import Empty, SimpleQueue
from typing import IO, Any, NamedTuple, Protocol, Self

from deepbots_cli.cluster.worker import Call, Parent, Requirements, invoke, perform
from deepbots_cli.errors import UsageError
from deepbots_cli.processes import Process, ending

MAX_LOSSES = 3
"""The number of workers that may be lost in one fragment of a shard, or in one call."""
_TICK_S = 1.0
"""The time in s that this process waits before it looks at signals, which a wait on Windows ignores."""


class WorkerLost(Exception):  # noqa: N818  # a state, which never reaches the user
    """The process of a worker ended before its answer; the message is the reason."""


class News(NamedTuple):
    """The reports that calls have sent since the last question, by the numbers of their items.

    `begun` has all calls that have begun; it is None if nobody answered.
    """

    reports: Mapping[int, object]
    notes: Sequence[tuple[int, str]]
    begun: Collection[int] | None


class WorkerPool(Protocol):
    """Processes for objects with methods (`start`, `ask`) and for calls of functions (`calls`).

    An answer that a worker owes is a hashable object, which `wait` and `answer` take.
    """

    @property
    def workers(self) -> int:
        """The number of processes that work at a time."""

    def free(self) -> int:
        """Return the number of processes that can start now."""

    def start(self, kind: Callable[..., Any], *arguments: object) -> Any:
        """Make an object in a process of its own."""

    def ask(self, worker: Any, method: str, *arguments: object) -> Any:
        """Call a method of such an object after the earlier ones; the answer that it owes."""

    def share(self, value: object) -> Any:
        """Return the object to pass instead of a value that several calls take."""

    def end(self, worker: Any) -> None:
        """End the process of such an object."""

    def wait(self, owed: Collection[Any], count: int = 1, timeout_s: float | None = None) -> Sequence[Any]:
        """Wait for `count` answers, at most `timeout_s`, and return those that are ready."""

    def answer(self, owed: Any) -> Any:
        """Return an answer that is ready.

        Raises:
            WorkerLost: The worker ended before it answered.
            Exception: The call raised it.
        """

    def check(self) -> None:
        """Check that the workers can still answer.

        Raises:
            RunError: They cannot.
        """

    def set_message_if_lost(self, text: str) -> None:
        """Print this if the processes take this one with them when they are lost."""

    def calls(self, requirements: Requirements, *, can_stop: bool) -> Calls:
        """Begin with calls of functions.

        Raises:
            UsageError: A worker does not meet the requirements.
        """


class Calls(Protocol):
    """The calls of one `Executor.map` on a pool."""

    def submit(self, call: Call) -> Any:
        """Begin a call and return the answer that it owes, which is that of `perform`."""

    def cancel(self, owed: Any) -> None:
        """End the process of a call."""

    def news(self, *, stop: bool) -> News:
        """Return the news. With `stop`, the calls that have begun receive SIGTERM, each once."""

    def leave_out(self) -> Sequence[str] | None:
        """Give no more work to unfit workers, after a refusal. Returns notes, None if all workers are fit.

        Raises:
            UsageError: Nothing is fit.
        """

    def close(self) -> None:
        """End with calls."""


# Processes of this machine


class Owed:
    """The answer to a call. `hear` is called with the kind and value of each message that the call sends
    before."""

    def __init__(self, worker: Worker, hear: Callable[[str, Any], None] | None = None) -> None:
        self.worker = worker
        self.hear = hear
        self.result: tuple[str, Any] | None = None


Inbox = SimpleQueue[tuple["Worker", str, Any]]
"""Messages of workers: their kind, and their value."""


class Worker:
    """A process; it makes its calls one after the other. `loss` is the reason why it ended, empty before."""

    def __init__(self, inbox: Inbox) -> None:
        self.beginning: tuple[object, ...] = ()
        self.owed: deque[Owed] = deque()
        self.loss = ""
        try:
            self.process = Process(
                "deepbots_cli.cluster.worker",
                hear=lambda message: inbox.put((self, *message)),
                on_end=lambda code: inbox.put((self, "lost", _loss(code))),
                read=_unpickled,
                environment={"OMP_NUM_THREADS": os.environ.get("OMP_NUM_THREADS", "1")},
                apart=True,  # this process handles Ctrl-C, which a terminal sends to the whole group
            )
        except OSError as error:
            raise UsageError(f"a worker cannot start: {error.strerror}; use fewer workers") from error

    def send(self, message: bytes | None) -> None:
        self.process.send(pickle.dumps(message))


def _unpickled(stream: IO[bytes]) -> Any:
    try:
        return pickle.load(stream)
    except pickle.UnpicklingError as error:  # the process ended within a message
        raise EOFError from error


def _loss(code: int) -> str:
    reason = ", as the system does when memory runs out" if ending(code) == "SIGKILL" else ""
    return (
        f"its process was ended by {ending(code)}{reason}"
        if code < 0
        else f"its process ended with code {code}"
    )


class LocalProcesses:
    """An `WorkerPool` with up to `workers` processes, which start when there is work and end with the
    block."""

    def __init__(self, workers: int) -> None:
        self.workers = workers
        self._inbox: Inbox = SimpleQueue()
        self._alive: set[Worker] = set()
        self._idle: list[Worker] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for worker in list(self._alive):
            self.end(worker)

    def free(self) -> int:
        return self.workers - len(self._alive) + len(self._idle)

    def start(self, kind: Callable[..., Any], *arguments: object) -> Worker:
        worker = self._process()
        worker.beginning = (kind, arguments)
        return worker

    def ask(self, worker: Worker, method: str, *arguments: object) -> Owed:
        return self._send(Owed(worker), invoke, *worker.beginning, method, *arguments)

    def share(self, value: object) -> object:
        return value

    def end(self, worker: Worker) -> None:
        self._remove(worker, _loss(worker.process.end()))

    def wait(self, owed: Collection[Owed], count: int = 1, timeout_s: float | None = None) -> Sequence[Owed]:
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        while sum(entry.result is not None for entry in owed) < min(count, len(owed)):
            left = _TICK_S if deadline is None else min(_TICK_S, deadline - time.monotonic())
            if left <= 0:
                break
            with suppress(Empty):
                self._take(*self._inbox.get(timeout=left))
        return [entry for entry in owed if entry.result is not None]

    def answer(self, owed: Owed) -> Any:
        kind, value = owed.result or ("lost", "it has not answered")
        if kind == "lost":
            raise WorkerLost(value)
        if kind == "error" and isinstance(value, Exception):
            raise value
        return value

    def check(self) -> None:
        pass

    def set_message_if_lost(self, text: str) -> None:
        pass

    def calls(self, requirements: Requirements, *, can_stop: bool) -> LocalCalls:
        return LocalCalls(self)

    def call(
        self, function: Callable[..., object], *arguments: object, hear: Callable[[str, Any], None]
    ) -> Owed:
        """Call a function in a process that is idle, or in a new one; it becomes idle again."""
        return self._send(Owed(self._process(), hear), function, *arguments)

    def _process(self) -> Worker:
        worker = self._idle.pop() if self._idle else Worker(self._inbox)
        self._alive.add(worker)
        return worker

    def _send(self, owed: Owed, function: Callable[..., object], *arguments: object) -> Owed:
        content = pickle.dumps((function, arguments))
        if owed.worker.loss:  # between two calls
            owed.result = ("lost", owed.worker.loss)
            return owed
        owed.worker.owed.append(owed)
        owed.worker.send(content)
        return owed

    def _take(self, worker: Worker, kind: str, value: Any) -> None:
        """Take a message of a worker."""
        if kind == "lost":
            self._remove(worker, value)
        elif not worker.owed:
            return  # a late message of a process that was ended, whose calls are lost
        elif kind in ("answer", "error"):
            owed = worker.owed.popleft()
            owed.result = (kind, value)
            if owed.hear is not None and not worker.loss:
                self._idle.append(worker)
        elif (hear := worker.owed[0].hear) is not None:
            hear(kind, value)

    def _remove(self, worker: Worker, loss: str) -> None:
        """Remove a process that has ended; its calls are lost."""
        worker.loss = loss
        self._alive.discard(worker)
        if worker in self._idle:
            self._idle.remove(worker)
        while worker.owed:
            worker.owed.popleft().result = ("lost", loss)


class LocalCalls:
    """Calls of functions, each in a process that does not start another one meanwhile."""

    def __init__(self, processes: LocalProcesses) -> None:
        self._processes = processes
        self._running: dict[int, Owed] = {}
        self._reports: dict[int, object] = {}
        self._notes: list[tuple[int, str]] = []
        self._stopped: set[int] = set()
        self._begun: set[int] = set()

    def submit(self, call: Call) -> Owed:
        self._begun.discard(call.item)
        owed = self._processes.call(_perform, call, hear=partial(self._hear, call.item))
        self._running[call.item] = owed
        return owed

    def cancel(self, owed: Owed) -> None:
        if owed.result is None:
            self._processes.end(owed.worker)

    def news(self, *, stop: bool) -> News:
        if stop:
            for item in self._begun - self._stopped:
                if self._running[item].result is None:
                    self._stopped.add(item)
                    self._running[item].worker.send(None)
        news = News(self._reports, self._notes, self._begun)
        self._reports = {}
        self._notes = []
        return news

    def leave_out(self) -> None:
        return None

    def close(self) -> None:
        """Close the calls. A process that was told to stop could receive the signal in its next call, so it
        gets no further call."""
        for item in self._stopped:
            self._processes.end(self._running[item].worker)

    def _hear(self, item: int, kind: str, value: Any) -> None:
        if kind == "begun":
            self._begun.add(item)
        elif kind == "report":
            self._reports[item] = value
        elif item not in self._stopped:  # after that, the caller prints how to continue
            self._notes.append((item, value))


def _perform(parent: Parent, call: Call) -> object:
    return perform(call, parent)
