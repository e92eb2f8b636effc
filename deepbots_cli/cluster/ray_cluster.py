"""A Ray cluster that runs already. Only this module imports Ray, and names private members of it.

Calls of functions report to a board, a small actor in the node of this process, and learn from it that they
should stop.

Ray prints the messages of its nodes and has no option against this, so `node_messages_silenced` replaces a
private function of Ray. Its version is pinned for this reason, and a test looks for the function in the
library.
"""

from __future__ import annotations

import logging
import os
import re
import signal
import socket
import subprocess
import tempfile
import threading
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import TimeoutError as FutureTimeoutError
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, Self

import ray

from deepbots_cli.cluster.worker import Call, Refusal, Requirements, perform
from deepbots_cli.cluster.worker_pool import News, WorkerLost
from deepbots_cli.errors import RunError, UsageError
from deepbots_cli.processes import python_script

_ADDRESS_TIMEOUT_S = 5.0
_HOST = re.compile(r"[\w-]{1,63}(\.[\w-]{1,63})*\.?|\[[\da-f:.]+\]", re.ASCII | re.IGNORECASE)
_EXCHANGE_INTERVAL_S = 0.3
_EXCHANGE_TIMEOUT_S = 10.0
_SILENT: Mapping[str, Any] = {"log_to_driver": False, "logging_level": logging.CRITICAL}
_WITNESS = """
import sys
last = sys.stdin.read().splitlines()[-1:]
if any(last):
    print(*last, file=sys.stderr)
"""


class RayCluster:
    """An `WorkerPool` on the Ray cluster at `HOST:PORT`, or the one of this machine (`auto`); it leaves the
    cluster after the block."""

    def __init__(self, address: str) -> None:
        self._address = address
        self._stack = ExitStack()
        self._set_message_if_lost: Callable[[str], None] = lambda text: None

    def __enter__(self) -> Self:
        _check_address(self._address)
        if ray.is_initialized():
            raise UsageError("this process uses a Ray cluster already; end it with ray.shutdown()")
        with ExitStack() as stack:
            self._set_message_if_lost = stack.enter_context(_message_if_lost())
            with _termination_handler_kept():
                self._join(stack)
            self._stack = stack.pop_all()
        return self

    def _join(self, stack: ExitStack) -> None:
        """Join the cluster.

        Raises:
            UsageError: Nobody answers, or the cluster has another version of Ray or Python.
        """
        stack.callback(ray.shutdown)
        try:
            with (
                tempfile.TemporaryDirectory() as folder,
                _working_directory(Path(folder)),
                node_messages_silenced(),
            ):
                ray.init(address=self._address, **_SILENT)
        except (ConnectionError, ValueError) as error:
            raise UsageError(
                f"there is no Ray cluster at {self._address}; start one with: ray start --head"
            ) from error
        except (RuntimeError, ray.exceptions.RayError) as error:
            raise UsageError(
                f"the cluster at {self._address} refuses this process: {' '.join(str(error).split())}"
            ) from error

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    @property
    def workers(self) -> int:
        return max(1, int(ray.cluster_resources().get("CPU", 1)))

    def free(self) -> int:
        return int(ray.available_resources().get("CPU", 0))

    def start(self, kind: Callable[..., Any], *arguments: object) -> Any:
        options = {"num_cpus": 1, "max_restarts": 0, "max_task_retries": 0, "scheduling_strategy": "SPREAD"}
        return ray.remote(kind).options(**options).remote(*arguments)

    def ask(self, worker: Any, method: str, *arguments: object) -> Any:
        return getattr(worker, method).remote(*arguments)

    def share(self, value: object) -> Any:
        return ray.put(value)

    def end(self, worker: Any) -> None:
        ray.kill(worker)

    def wait(self, owed: Collection[Any], count: int = 1, timeout_s: float | None = None) -> Sequence[Any]:
        ready: Sequence[Any] = ray.wait(list(owed), num_returns=count, timeout=timeout_s)[0]
        return ready

    def answer(self, owed: Any) -> Any:
        try:
            return ray.get(owed)
        except ray.exceptions.RayTaskError as error:
            if isinstance(error.cause, ray.exceptions.RaySystemError):
                return Refusal(f"a worker cannot import deepbots, or what it calls: {error.cause}")
            raise error.cause from error
        except ray.exceptions.RayError as error:
            if isinstance(error, ray.exceptions.RayActorError) and error.actor_init_failed:
                raise UsageError(
                    "a worker cannot import deepbots; install the same version on all nodes"
                ) from error
            raise WorkerLost(str(error).strip().partition("\n")[0]) from error

    def check(self) -> None:
        """Check that Ray can answer: its calls may wait forever for a node of this process that was lost."""
        here = ray.get_runtime_context().get_node_id()
        if not any(node["Alive"] for node in ray.nodes() if node["NodeID"] == here):
            error = RunError("the Ray node of this process was lost")
            error.add_note("start again; a training continues with `deepbots resume`")
            raise error

    def set_message_if_lost(self, text: str) -> None:
        self._set_message_if_lost(
            f"error: the connection to Ray was lost, or this process was killed; {text}"
        )

    def calls(self, requirements: Requirements, *, can_stop: bool) -> RayCalls:
        return RayCalls(self, requirements, can_stop=can_stop)


class RayCalls:
    """Calls of functions as Ray tasks."""

    def __init__(self, cluster: RayCluster, requirements: Requirements, *, can_stop: bool) -> None:
        self._cluster = cluster
        self._requirements = requirements
        for reason in self._unfit_nodes().values():
            raise UsageError(reason)
        self._board = _make_board()
        # A call that can be stopped has a process of its own: the signal never reaches the next call.
        max_calls = 1 if can_stop else 0
        self._perform = ray.remote(
            num_cpus=1, max_retries=0, max_calls=max_calls, scheduling_strategy="SPREAD"
        )(_perform)
        self._left_out: set[str] = set()
        self._where: dict[str, Any] = {}

    def submit(self, call: Call) -> Any:
        return self._perform.options(**self._where).remote(call, self._board)

    def cancel(self, owed: Any) -> None:
        ray.cancel(owed, force=True)

    def news(self, *, stop: bool) -> News:
        try:
            return News(*ray.get(self._board.news.remote(stop), timeout=_EXCHANGE_TIMEOUT_S))
        except ray.exceptions.RayError:  # it starts again, unless its node was lost
            self._cluster.check()
            return News({}, [], None)

    def leave_out(self) -> Sequence[str] | None:
        """Give no more work to the nodes that lack something, which have joined since the start."""
        unfit = self._unfit_nodes()
        if not unfit:
            return None
        if len(unfit) == len(_nodes()):
            raise UsageError(next(iter(unfit.values())))
        notes = [
            f"a node that joined gets no work: {reason}"
            for node, reason in unfit.items()
            if node not in self._left_out
        ]
        self._left_out |= unfit.keys()
        self._where = {"label_selector": {"ray.io/node-id": f"!in({','.join(sorted(self._left_out))})"}}
        return notes

    def close(self) -> None:
        ray.kill(self._board)

    def _unfit_nodes(self) -> dict[str, str]:
        """Return a sentence for each node of a cluster that lacks something."""
        from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

        checks = []
        unfit = {}
        for node, host in _nodes().items():
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
    """Return the hosts of the nodes with a CPU for workers, by the identifier of the node."""
    nodes = ray.nodes()
    return {
        node["NodeID"]: node["NodeManagerHostname"]
        for node in nodes
        if node["Alive"] and node["Resources"].get("CPU", 0) >= 1
    }


def _perform(call: Call, board: Any) -> object:
    return perform(call, _BoardLine(call, board))


class _BoardLine:
    """The `Line` of a call to the board, in a thread."""

    def __init__(self, call: Call, board: Any) -> None:
        self._call = call
        self._board = board
        self._newest: object = None
        self._notes: list[str] = []
        self._is_stopping = False
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    def report(self, value: object) -> None:
        self._newest = value

    def note(self, text: str) -> None:
        if not self._is_stopping:  # the caller prints how to continue
            self._notes.append(text)

    def _run(self) -> None:
        from ray.exceptions import RayError

        while True:
            is_last = self._ended.wait(_EXCHANGE_INTERVAL_S)
            notes = tuple(self._notes)
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


def _make_board() -> Any:
    """Return the actor that keeps the newest report of each call. Its class is sent to the worker as it is,
    without an import of deepbots."""
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
            news = (self.reports, self.notes, self.begun)
            self.stop = stop
            self.reports = {}
            self.notes = []
            return news

    here = NodeAffinitySchedulingStrategy(ray.get_runtime_context().get_node_id(), soft=False)
    return (
        ray.remote(Board)
        .options(num_cpus=0, max_restarts=-1, max_task_retries=0, scheduling_strategy=here)
        .remote()
    )


def _check_address(address: str) -> None:
    """Check that an address is one, and that a cluster answers there.

    Raises:
        UsageError: It is not an address, or no cluster answers there.
    """
    if address == "auto":
        return
    host, _, port = address.rpartition(":")
    if not _HOST.fullmatch(host) or not port.isdecimal() or int(port) > 65535:
        raise UsageError(
            f"'{address}' is not an address of a Ray cluster; write HOST:PORT, such as 10.0.0.5:6379, or auto"
        )
    try:
        socket.create_connection((host.strip("[]"), int(port)), _ADDRESS_TIMEOUT_S).close()
    except OSError as error:
        raise UsageError(
            f"nobody answers at {address} ({error.strerror or error}); is the cluster running?"
        ) from error


@contextmanager
def _message_if_lost() -> Iterator[Callable[[str], None]]:
    """Yield a function that sets what another process prints if this one ends within the block.

    Ray ends this process without a message when its node or the head of the cluster is lost, as soon as it
    needs one of them.
    """
    witness = subprocess.Popen(
        python_script(_WITNESS),
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
        start_new_session=True,
    )

    def set_message_if_lost(text: str) -> None:
        with suppress(OSError):  # the witness was killed
            print(text, file=witness.stdin, flush=True)

    with witness:
        try:
            yield set_message_if_lost
        finally:
            set_message_if_lost("")


@contextmanager
def _termination_handler_kept() -> Iterator[None]:
    """Keep the handler of SIGTERM within the block; Ray sets one that ends the process."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


@contextmanager
def _working_directory(folder: Path) -> Iterator[None]:
    """Make `folder` the working directory within the block: Ray puts it first on the import path of its
    workers."""
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)


@contextmanager
def node_messages_silenced() -> Iterator[None]:
    """Silence the messages of Ray's nodes within the block: deepbots reports lost workers itself."""
    from ray._private import worker

    before = worker.listen_error_messages
    worker.listen_error_messages = lambda *_: None
    try:
        yield
    finally:
        worker.listen_error_messages = before
