"""A process that does the work of `local_processes.py`: `python -m deepbots_cli.cluster.worker`.

Standard input brings calls, as pickled bytes of a function and its arguments, or None for a stop. Answers and
news go to standard output, pickled. Code that is called sees neither. The process ends as soon as standard
input does, so it does not outlive its parent.
"""

from __future__ import annotations

import _thread
import os
import pickle
import signal
import threading
import traceback
from collections.abc import Callable
from queue import SimpleQueue
from typing import IO, Any, Self


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
    source = os.fdopen(os.dup(0), "rb")
    parent = Parent(os.fdopen(os.dup(1), "wb"))
    nowhere = os.open(os.devnull, os.O_RDWR)
    os.dup2(nowhere, 0)
    os.dup2(nowhere, 1)
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
