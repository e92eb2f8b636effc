"""The interface between shards or calls and the processes that do their work.

`LocalProcesses` (`local_processes.py`) starts processes on this machine, and `RayCluster` (`ray_cluster.py`)
uses those of a Ray cluster. The module also has the functions that a worker of either kind runs and the
requirements that it checks.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import signal
import socket
import sys
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple, NoReturn, Protocol

import deepbots_cli
from deepbots_cli.errors import DeepbotsError
from deepbots_cli.learning.executor import Attempt
from deepbots_cli.learning.runs.records import versions

MAX_LOSSES = 3
"""The number of workers that may be lost in one fragment of a shard, or in one call."""
_LIBRARIES = ("numpy", "torch", "stable-baselines3", "pybullet", "mujoco")
"""The libraries on whose versions the results depend."""


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


# Functions that a worker runs


@dataclass(frozen=True)
class Requirements:
    """The requirements of a worker: the working directory, the same files, and the same versions of deepbots
    and its libraries."""

    folder: Path
    files: Mapping[Path, str]
    versions: Mapping[str, str]

    @classmethod
    def of_this_process(cls, files: Sequence[Path]) -> Requirements:
        return cls(Path.cwd(), {path.absolute(): _digest(path) for path in files}, library_versions())

    def unmet(self) -> str | None:
        """Return a sentence with the requirement that this process does not meet."""
        worker = f"the worker on {socket.gethostname()}"
        here = library_versions()
        for name, version in self.versions.items():
            if here.get(name) != version:
                return (
                    f"{worker} has {name} {here.get(name, 'not installed')}, but this process has {version}"
                )
        for path, digest in self.files.items():
            if _digest(path) != digest:
                return f"{worker} does not see {path}; use a folder that all nodes share"
        return (
            None
            if self.folder.is_dir()
            else f"{worker} does not see {self.folder}; work in a folder that all nodes share"
        )


def library_versions() -> dict[str, str]:
    return {
        "deepbots": deepbots_cli.__version__,
        **{name: text for name, text in versions().items() if name in _LIBRARIES},
    }


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
    """The reason why a worker cannot do any call."""

    reason: str


class Line(Protocol):
    """The connection of a call to the process that asked for it; it opens when the call begins."""

    def report(self, value: object) -> None:
        """Send how far the call is."""

    def note(self, text: str) -> None:
        """Send a message for the user."""


def perform(call: Call, line: AbstractContextManager[Line]) -> object:
    """Make a call in a worker. The result is the error itself if it is one of deepbots, and None after a
    stop."""
    reason = call.requirements.unmet()
    if reason is not None:
        return Refusal(reason)
    os.chdir(call.requirements.folder)
    with ExitStack() as stack:
        if call.log is not None:
            stack.enter_context(output_in(call.log))
        if call.can_stop:  # until a training handles the signal itself
            stack.callback(signal.signal, signal.SIGTERM, signal.signal(signal.SIGTERM, _interrupt))
        try:
            function, item = pickle.loads(call.content)
            opened = stack.enter_context(line)
            return function(item, Attempt(call.attempt, opened.report, opened.note))
        except DeepbotsError as error:
            return error
        except KeyboardInterrupt:
            return None


def _interrupt(number: int, frame: FrameType | None) -> NoReturn:
    raise KeyboardInterrupt


@contextmanager
def output_in(path: Path) -> Iterator[None]:
    """Write standard output and error of this process into a file within the block."""
    streams = (sys.stdout, sys.stderr)
    for stream in streams:
        stream.flush()
    before = [os.dup(number) for number in (1, 2)]
    with suppress(OSError):  # a folder that is not shared is refused in words
        path.parent.mkdir(exist_ok=True)
        log = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | getattr(os, "O_NOFOLLOW", 0), 0o644)
        os.dup2(log, 1)
        os.dup2(log, 2)
        os.close(log)
    try:
        yield
    finally:
        for stream, number, saved in zip(streams, (1, 2), before, strict=True):
            stream.flush()
            os.dup2(saved, number)
            os.close(saved)
