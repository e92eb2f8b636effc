"""The side of a worker: the checks that it makes, a call of a function, and a process of this machine.

`python -m deepbots_cli.cluster.worker` is a process that does the work of `LocalProcesses`. Standard input
brings calls, as pickled bytes of a function and its arguments, or None for a stop. Answers and news go to
standard output, pickled. Code that is called sees neither. The process ends as soon as standard input does,
so it does not outlive its parent. A worker of a Ray cluster calls `perform` too.
"""

from __future__ import annotations

import _thread
import hashlib
import os
import pickle
import signal
import socket
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from pathlib import Path
from queue import SimpleQueue
from types import FrameType
from typing import IO, Any, NamedTuple, NoReturn, Protocol, Self

import deepbots_cli
from deepbots_cli.errors import DeepbotsError
from deepbots_cli.learning.executor import Attempt
from deepbots_cli.learning.runs.run import versions
from deepbots_cli.processes import message_streams
from deepbots_cli.records import dataclass

_LIBRARIES = ("numpy", "torch", "stable-baselines3", "pybullet", "mujoco")
"""The libraries on whose versions the results depend."""


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
            digest_here = _digest(path)
            if not digest_here:
                return f"{worker} does not see {path}; use a folder that all nodes share"
            if digest_here != digest:
                return (
                    f"{worker} sees another {path}, which has changed since this command began, or is in a"
                    " folder that the nodes do not share; start the command again"
                )
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


# A process of this machine


class Parent:
    """The connection to the process that has started this one.

    Attributes:
        state: The values that calls keep for later ones.
    """

    def __init__(self, out: IO[bytes]) -> None:
        self._out = out
        self._lock = threading.Lock()
        self.state: dict[str, Any] = {}

    def __enter__(self) -> Self:
        self.send("begun", None)
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def report(self, value: object) -> None:
        self.send("report", value)

    def note(self, text: str) -> None:
        self.send("note", text)

    def send(self, kind: str, value: object) -> None:
        message = pickle.dumps((kind, value))
        try:
            with self._lock:
                self._out.write(message)
                self._out.flush()
        except OSError:
            os._exit(1)


def invoke(
    parent: Parent, kind: Callable[..., Any], beginning: tuple[Any, ...], method: str, *arguments: object
) -> Any:
    """Call a method of the object of this process, which the first call makes."""
    if "object" not in parent.state:
        parent.state["object"] = kind(*beginning)
    return getattr(parent.state["object"], method)(*arguments)


def _main() -> None:
    source, out = message_streams()
    parent = Parent(out)
    calls: SimpleQueue[bytes] = SimpleQueue()
    threading.Thread(target=_receive, args=(source, calls), daemon=True).start()
    while True:
        content = calls.get()
        try:
            function, arguments = pickle.loads(content)
            parent.send("answer", function(parent, *arguments))
        except Exception as error:  # noqa: BLE001  # raised in the parent
            parent.send("error", _passable(error))


def _receive(source: IO[bytes], calls: SimpleQueue[bytes]) -> None:
    try:
        while True:
            content = pickle.load(source)
            if content is None:
                _thread.interrupt_main(signal.SIGTERM)
            else:
                calls.put(content)
    except (EOFError, OSError, pickle.UnpicklingError):  # the parent has ended, perhaps within a message
        os._exit(0)


def _passable(error: Exception) -> Exception:
    """Return an error that can be pickled, with its traceback in a note."""
    text = "".join(traceback.format_exception(error))
    try:
        error.add_note(f"in a worker:\n{text}")
        pickle.loads(pickle.dumps(error))
    except Exception:  # noqa: BLE001  # any error of a class that cannot be pickled
        return RuntimeError(f"an error in a worker:\n{text}")
    return error


if __name__ == "__main__":
    try:
        _main()
    except KeyboardInterrupt:  # a stop after the call
        os._exit(0)
