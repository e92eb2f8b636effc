"""Calls of a function as Ray tasks. A call whose worker is lost, alone or with its node, is repeated on another worker.

A call reports to a board, a small actor in the node of this process, and learns from it that it should stop.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import signal
import socket
import threading
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import TimeoutError as FutureTimeoutError
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple, NoReturn

from deepbots_cli.cluster.shards import MAX_LOSSES, check_node, library_versions, write_output_to
from deepbots_cli.errors import DeepbotsError, UsageError
from deepbots_cli.learning.spread import UNWATCHED, Attempt, CallOptions, Item, Result

_EXCHANGE_INTERVAL_S = 0.3
_EXCHANGE_TIMEOUT_S = 10.0


@dataclass(frozen=True)
class Requirements:
    """What a worker must have: the working directory, the same files, and the same versions of deepbots and its libraries."""

    folder: Path
    files: Mapping[Path, str]
    versions: Mapping[str, str]

    @classmethod
    def of_this_process(cls, files: Sequence[Path]) -> Requirements:
        return cls(Path.cwd(), {path.absolute(): _digest(path) for path in files}, library_versions())

    def unmet(self) -> str | None:
        """What this process lacks, in a sentence."""
        worker, here = f"the worker on {socket.gethostname()}", library_versions()
        for name, version in self.versions.items():
            if here.get(name) != version:
                return f"{worker} has {name} {here.get(name, 'not installed')}, but this process has {version}"
        for path, digest in self.files.items():
            if _digest(path) != digest:
                return f"{worker} does not see {path}; use a folder that all nodes share"
        return None if self.folder.is_dir() else f"{worker} does not see {self.folder}; work in a folder that all nodes share"


def _digest(path: Path) -> str:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError:
        return ""


class Call(NamedTuple):
    """A call of a function, to be made by a worker; `content` is the function with its item."""

    item: int
    attempt: int
    content: bytes
    requirements: Requirements
    log: Path | None
    can_stop: bool


class Refusal(NamedTuple):
    """Why a worker cannot do any call."""

    reason: str


def perform(call: Call, board: Any) -> object:
    """Make a call in a worker. The result is the error itself if it is one of deepbots, and None after a stop."""
    reason = call.requirements.unmet()
    if reason is not None:
        return Refusal(reason)
    os.chdir(call.requirements.folder)
    if call.log is not None:
        write_output_to(call.log)
    if call.can_stop:  # until a training handles the signal itself
        signal.signal(signal.SIGTERM, _interrupt)
    exchange = _Exchange(call, board)
    try:
        function, item = pickle.loads(call.content)
        return function(item, Attempt(call.attempt, exchange.report, exchange.note))
    except DeepbotsError as error:
        return error
    except KeyboardInterrupt:
        return None
    finally:
        exchange.close()


def _interrupt(number: int, frame: FrameType | None) -> NoReturn:
    raise KeyboardInterrupt


class _Exchange:
    """The connection of a call to the board, in a thread."""

    def __init__(self, call: Call, board: Any) -> None:
        self._call, self._board = call, board
        self._newest: object = None
        self._notes: list[str] = []
        self._is_stopping, self._ended = False, threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def report(self, value: object) -> None:
        self._newest = value

    def note(self, text: str) -> None:
        if not self._is_stopping:  # the caller says how to go on
            self._notes.append(text)

    def _run(self) -> None:
        from ray.exceptions import RayError

        while True:
            is_last, notes = self._ended.wait(_EXCHANGE_INTERVAL_S), tuple(self._notes)
            try:
                # A future: a task that waits for an object in another way lends its CPU to the next task.
                answer = self._board.tell.remote(self._call.item, self._newest, notes).future()
                wants_stop = answer.result(_EXCHANGE_TIMEOUT_S)
            except (RayError, FutureTimeoutError):  # the board was lost, and starts again
                wants_stop = False
            else:
                del self._notes[: len(notes)]
            if is_last:
                return
            if wants_stop and self._call.can_stop and not self._is_stopping:
                self._is_stopping = True
                os.kill(os.getpid(), signal.SIGTERM)  # Ray blocks SIGINT

    def close(self) -> None:
        self._ended.set()
        self._thread.join()


def _make_board() -> Any:
    """The actor that keeps the newest report of each call. Its class goes to the worker as it is, without an import of deepbots."""
    import ray
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

    class Board:
        def __init__(self) -> None:
            self.reports: dict[int, object] = {}
            self.notes: list[tuple[int, str]] = []
            self.begun: set[int] = set()
            self.stop = False

        def tell(self, item: int, report: object, notes: Sequence[str]) -> bool:
            self.begun.add(item)
            if report is not None:
                self.reports[item] = report
            self.notes += [(item, note) for note in notes]
            return self.stop

        def news(self, stop: bool) -> tuple[dict[int, object], list[tuple[int, str]], set[int]]:
            found, self.stop = (self.reports, self.notes, self.begun), stop
            self.reports, self.notes = {}, []
            return found

    here = NodeAffinitySchedulingStrategy(ray.get_runtime_context().get_node_id(), soft=False)
    return ray.remote(Board).options(num_cpus=0, max_restarts=-1, max_task_retries=0, scheduling_strategy=here).remote()


class Tasks:
    """Calls of a function on the workers of a Ray that runs.

    Args:
        workers: Returns the number of calls at a time.
        options: Those of `Spread.map`.
        is_joined: Whether workers may be on other machines.
    """

    def __init__(self, workers: Callable[[], int], options: CallOptions, *, is_joined: bool) -> None:
        import ray

        self._workers, self._watcher = workers, options.get("watcher", UNWATCHED)
        self._log, self._stop = options.get("log"), options.get("stop")
        self._requirements, self._is_joined = Requirements.of_this_process(options.get("files", ())), is_joined
        for reason in self._unfit_nodes().values():
            raise UsageError(reason)
        self._board = _make_board()
        # A process of its own has clean threads, generators and signals.
        max_calls = 0 if self._stop is None else 1
        self._perform = ray.remote(num_cpus=1, max_retries=0, max_calls=max_calls, scheduling_strategy="SPREAD")(perform)
        self._running: dict[Any, Call] = {}
        self._losses: Counter[int] = Counter()
        self._left_out: set[str] = set()
        self._where: dict[str, Any] = {}
        self._again: deque[Call] = deque()
        self._outcomes: dict[int, Any] = {}

    def run(self, function: Callable[[Item, Attempt], Result], items: Iterable[Item]) -> Generator[Result | DeepbotsError | None]:
        """Yield the outcomes in the order of the items."""
        import ray

        calls, following, is_stopping = self._calls(function, items), 0, False
        try:
            while True:
                if self._stop is not None and not is_stopping and self._stop():
                    is_stopping = True
                    self._outcomes |= {call.item: None for call in self._again}
                while not is_stopping and len(self._running) < self._workers():
                    call = self._again.popleft() if self._again else next(calls, None)
                    if call is None:
                        break
                    self._running[self._perform.options(**self._where).remote(call, self._board)] = call
                while following in self._outcomes:
                    yield self._outcomes.pop(following)
                    following += 1
                if not self._running:
                    return
                for ready in ray.wait(list(self._running), timeout=_EXCHANGE_INTERVAL_S)[0]:
                    self._end(ready, is_stopping=is_stopping)
                self._look_at_board(is_stopping=is_stopping)
        finally:
            for running in self._running:
                ray.cancel(running, force=True)
            ray.kill(self._board)

    def _calls(self, function: Callable[[Item, Attempt], Result], items: Iterable[Item]) -> Iterator[Call]:
        for number, item in enumerate(items):
            log = None if self._log is None else self._log(item).absolute()
            yield Call(number, 1, pickle.dumps((function, item)), self._requirements, log, self._stop is not None)

    def _end(self, ready: Any, *, is_stopping: bool) -> None:
        """A call has ended, or its worker."""
        import ray

        call = self._running.pop(ready)
        try:
            outcome = ray.get(ready)
        except ray.exceptions.RayTaskError as error:
            if is_stopping:  # the signal may also come too late
                outcome = None
            elif isinstance(error.cause, ray.exceptions.RaySystemError) and self._leaves_out_nodes(call):  # which cannot import deepbots
                return
            else:
                raise error.cause from error
        except ray.exceptions.RayError as error:
            self._losses[call.item] += 1
            if is_stopping:
                outcome = None
            elif self._losses[call.item] < MAX_LOSSES:
                self._watcher.on_loss(call.item)
                self._again.append(call._replace(attempt=call.attempt + 1))
                return
            else:
                outcome = _too_many_losses(call, error)
        if isinstance(outcome, Refusal):
            if self._leaves_out_nodes(call):
                return
            raise UsageError(outcome.reason)
        self._outcomes[call.item] = outcome
        self._watcher.on_done(call.item, outcome)
        if call.log is not None:
            with suppress(OSError):
                if not call.log.stat().st_size:
                    call.log.unlink()
                    call.log.parent.rmdir()

    def _look_at_board(self, *, is_stopping: bool) -> None:
        """Hand on the news; after a stop, take back the calls that have not begun."""
        import ray

        try:
            reports, notes, begun = ray.get(self._board.news.remote(is_stopping), timeout=_EXCHANGE_TIMEOUT_S)
        except ray.exceptions.RayError:  # it starts again, unless its node was lost
            check_node()
            return
        for number, text in notes:
            self._watcher.on_note(number, text)
        for number, report in reports.items():
            self._watcher.on_report(number, report)
        if is_stopping:
            for running, call in self._running.items():
                if call.item not in begun:
                    ray.cancel(running, force=True)

    def _leaves_out_nodes(self, call: Call) -> bool:
        """Repeat a call without the nodes that lack something, which have joined since the start; whether there are any.

        Raises:
            UsageError: There is no other node.
        """
        unfit = self._unfit_nodes()
        if not unfit:
            return False
        if len(unfit) == len(_nodes()):
            raise UsageError(next(iter(unfit.values())))
        for node, reason in unfit.items():
            if node not in self._left_out:
                self._watcher.on_note(call.item, f"a node that joined gets no work: {reason}")
        self._left_out |= unfit.keys()
        self._where = {"label_selector": {"ray.io/node-id": f"!in({','.join(sorted(self._left_out))})"}}
        self._again.append(call)
        return True

    def _unfit_nodes(self) -> dict[str, str]:
        """What nodes of a cluster lack, in a sentence for each."""
        import ray
        from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

        checks, unfit = [], {}
        for node, host in _nodes().items() if self._is_joined else ():
            there = NodeAffinitySchedulingStrategy(node, soft=False)
            check = ray.remote(num_cpus=0, max_retries=0, scheduling_strategy=there)(Requirements.unmet)
            checks.append((node, host, check.remote(self._requirements)))
        for node, host, check in checks:
            try:
                reason = ray.get(check)
            except ray.exceptions.RayTaskError:
                reason = f"the worker on {host} cannot import deepbots; install the same version there"
            except ray.exceptions.RayError:  # this node was lost meanwhile
                continue
            if reason is not None:
                unfit[node] = reason
        return unfit


def _nodes() -> dict[str, str]:
    """The hosts of the nodes with a CPU for workers, by the identifier of the node."""
    import ray

    found = ray.nodes()
    return {node["NodeID"]: node["NodeManagerHostname"] for node in found if node["Alive"] and node["Resources"].get("CPU", 0) >= 1}


def _too_many_losses(call: Call, error: Exception) -> DeepbotsError:
    hint = f"; {call.log} has its last output" if call.log is not None else ""
    reason = str(error).strip().partition("\n")[0]
    return DeepbotsError(f"it ended its worker {MAX_LOSSES} times{hint} (the last time: {reason})")
