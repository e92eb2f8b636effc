"""Processes of this machine, with nothing but the standard library.

A worker is an interpreter of its own, which imports deepbots and nothing of the main module: it works from a
script, `python -c` and a notebook. `concurrent.futures` and `multiprocessing.Pool` do not serve here: the
first ends all calls when one process is killed, the second waits for its answer forever, and both import the
main module. Each worker has two pipes. A thread for each reads its messages, so that a worker never waits for
this process, and sees at once when a worker has ended.
"""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from functools import partial
from queue import Empty, SimpleQueue
from typing import IO, Any, Self, cast

from deepbots_cli.cluster.worker import Parent, invoke
from deepbots_cli.cluster.worker_pool import Call, News, Requirements, WorkerLost, perform
from deepbots_cli.errors import UsageError
from deepbots_cli.processes import python_command, python_environment

_LAST_BREATH_S = 1.0
"""The time in s that a process may take to end after it has closed its pipe."""
_TICK_S = 1.0
"""The time in s that this process waits before it looks at signals, which a wait on Windows ignores."""


class Owed:
    """The answer to a call. `hear` is called with the kind and value of each message that the call sends
    before."""

    def __init__(self, worker: Worker, hear: Callable[[str, Any], None] | None = None) -> None:
        self.worker = worker
        self.hear = hear
        self.result: tuple[str, Any] | None = None


class Worker:
    """A process; it makes its calls one after the other."""

    def __init__(self, inbox: SimpleQueue[tuple[Worker, tuple[str, Any] | None]]) -> None:
        self.beginning: tuple[object, ...] = ()
        self.owed: deque[Owed] = deque()
        try:
            self.process = subprocess.Popen(
                python_command("deepbots_cli.cluster.worker"),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                env=python_environment({"OMP_NUM_THREADS": os.environ.get("OMP_NUM_THREADS", "1")}),
                # this process handles Ctrl-C, which a terminal sends to the whole group
                start_new_session=True,
                creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),  # the same on Windows
            )
        except OSError as error:
            raise UsageError(f"a worker cannot start: {error.strerror}; use fewer workers") from error
        self._inbox = inbox
        self._pipe = cast(IO[bytes], self.process.stdin)
        threading.Thread(target=self._receive, daemon=True).start()

    def _receive(self) -> None:
        try:
            with (
                cast(IO[bytes], self.process.stdout) as source,
                suppress(EOFError, OSError, pickle.UnpicklingError),
            ):
                while True:
                    self._inbox.put((self, pickle.load(source)))
        finally:
            self._inbox.put((self, None))

    def send(self, message: bytes | None) -> None:
        with suppress(OSError, ValueError):  # the process was lost, or its pipe is closed already
            pickle.dump(message, self._pipe)
            self._pipe.flush()

    def end(self, patience_s: float = 0.0) -> str:
        """End the process, unless it ends by itself until then; how it ended, in words."""
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(patience_s)
        self.process.kill()
        code = self.process.wait()
        with suppress(OSError):
            self._pipe.close()
        return (
            f"its process was ended by {signal.Signals(-code).name}"
            if code < 0
            else f"its process ended with code {code}"
        )


class LocalProcesses:
    """An `WorkerPool` with up to `workers` processes, which start when there is work and end with the
    block."""

    def __init__(self, workers: int) -> None:
        self.workers = workers
        self._inbox: SimpleQueue[tuple[Worker, tuple[str, Any] | None]] = SimpleQueue()
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
        self._remove(worker)

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
        if owed.worker not in self._alive:  # it was lost between two calls
            owed.result = ("lost", owed.worker.end())
            return owed
        owed.worker.owed.append(owed)
        owed.worker.send(content)
        return owed

    def _take(self, worker: Worker, message: tuple[str, Any] | None) -> None:
        """Take a message of a worker; None is its end."""
        if message is None:
            self._remove(worker, _LAST_BREATH_S)
        elif not worker.owed:
            return  # a late message of a process that was ended, whose calls are lost
        elif message[0] in ("answer", "error"):
            owed = worker.owed.popleft()
            owed.result = message
            if owed.hear is not None and worker in self._alive:
                self._idle.append(worker)
        elif (hear := worker.owed[0].hear) is not None:
            hear(*message)

    def _remove(self, worker: Worker, patience_s: float = 0.0) -> None:
        """End a process, unless it has ended; its calls are lost."""
        self._alive.discard(worker)
        if worker in self._idle:
            self._idle.remove(worker)
        reason = worker.end(patience_s)
        while worker.owed:
            worker.owed.popleft().result = ("lost", reason)


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
