"""The messages between the process of a controller and the server, over a pipe, and the side of the
simulation: it starts the processes of controllers, and answers their requests.
"""

from __future__ import annotations

import os
import subprocess
import threading
from multiprocessing.connection import Pipe
from typing import IO, Any, NamedTuple, Protocol

from deepbots_cli.errors import UsageError
from deepbots_cli.processes import python_command, python_environment
from deepbots_cli.webots.runner import (
    CONTROLLER_ENVIRONMENT,
    GRACE_S,
    Controller,
    ControllerError,
    Prefixed,
    Runner,
)
from deepbots_cli.webots.sensors import Device
from deepbots_cli.webots.supervisor import Keyboard, Robot, Supervisor
from deepbots_cli.webots.tree import Field, Node

KEYBOARD, ROBOT, SUPERVISOR = "Keyboard", "Robot", "Supervisor"


class Reference(NamedTuple):
    """An object of the server: its number, and the name of its class."""

    number: int
    kind: str


class Create(NamedTuple):
    """Asks for a new Robot, Supervisor or Keyboard; answered by a `Result`."""

    kind: str


class Call(NamedTuple):
    """Asks for a call of a method; `unused` are the numbers of objects that are not needed any more."""

    number: int
    method: str
    arguments: tuple[Any, ...]
    options: dict[str, Any]
    unused: list[int]


class Failed(NamedTuple):
    """Says that the program ended with an exception."""

    description: str


class Result(NamedTuple):
    """The answer to a request."""

    value: Any


class Raised(NamedTuple):
    """The exception of a request."""

    error: Exception


class Exit(NamedTuple):
    """Ends the program in place of an answer."""

    code: int


def replaced(value: Any, kind: type | tuple[type, ...], replace: Any) -> Any:
    """Return a value with the objects of a type in it replaced, also those in lists and tuples."""
    if isinstance(value, kind):
        return replace(value)
    if type(value) in (list, tuple):
        return type(value)(replaced(item, kind, replace) for item in value)
    return value


_API = (Device, Field, Keyboard, Node, Robot)
"""The classes whose objects stay here; a process has a reference to each."""
PACKAGES = "DEEPBOTS_CONTROLLER_PACKAGES"
"""The variable of the environment with further folders from which controllers import."""


# The server


class ProcessRunner(Runner):
    """Runs each controller in a process of its own; `Runner` decides whose turn it is."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        """Prepare a run, with the arguments of `Runner`.

        Raises:
            UsageError: Processes of this system cannot inherit a pipe.
        """
        if os.name != "posix":
            raise UsageError("--processes needs Linux or macOS")
        super().__init__(*arguments, **options)
        self._processes: list[subprocess.Popen[str]] = []

    def _finish(self) -> None:
        for process in self._processes:
            process.kill()
        for controller in self.controllers:
            if controller.thread is not None:
                controller.thread.join(GRACE_S)

    def _enter(self, controller: Controller) -> None:
        """Do nothing: a process has its own surroundings."""

    def _leave(self, controller: Controller) -> None:
        """Do nothing: a process has its own surroundings."""

    def _execute(self, controller: Controller) -> None:
        local_end, remote_end = Pipe()
        with local_end:
            # Closed here once the process has its copy: otherwise `recv` would not end with the process.
            with remote_end:
                process = self._start(controller, remote_end.fileno())
            readers = [
                threading.Thread(
                    target=_pass_on, args=(source, Prefixed(target, lambda: controller.name, self._on_line))
                )
                for source, target in ((process.stdout, self._output), (process.stderr, self._errors))
            ]
            for reader in readers:
                reader.start()
            failure = _Requests(local_end).serve()
        code = process.wait()
        for reader in readers:
            reader.join(GRACE_S)
        if failure or code < 0:
            raise ControllerError(failure or f"its process was ended by signal {-code}")
        raise SystemExit(code)

    def _start(self, controller: Controller, pipe: int) -> subprocess.Popen[str]:
        changes = {name: os.environ.get(name, value) for name, value in CONTROLLER_ENVIRONMENT.items()}
        # Else lines arrive late through a pipe.
        changes |= {"PYTHONUNBUFFERED": "1", PACKAGES: os.pathsep.join(self.packages)}
        process = subprocess.Popen(
            python_command(
                "deepbots_cli.webots.remote", str(pipe), str(controller.program), *controller.arguments
            ),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            pass_fds=[pipe],
            cwd=controller.program.parent,
            env=python_environment(changes),
            text=True,
            encoding="utf-8",
            errors="replace",
            start_new_session=True,  # Ctrl-C is for this process, which ends the others
        )
        self._processes.append(process)
        return process


def _pass_on(source: IO[str] | None, target: Prefixed) -> None:
    for line in source or ():
        target.write(line)
    target.close()


class _Pipe(Protocol):
    """An end of a `multiprocessing.Pipe`, whose class depends on the system."""

    def send(self, value: Any, /) -> None: ...

    def recv(self) -> Any: ...


class _Requests:
    """The requests of one controller, and the objects that it has references to."""

    def __init__(self, pipe: _Pipe) -> None:
        self._pipe = pipe
        self._objects: dict[int, Any] = {}
        self._numbers: dict[tuple[type, Any], int] = {}
        self._last = 0

    def serve(self) -> str:
        """Answer requests until the process ends; returns why its program failed, or an empty text."""
        while True:
            try:
                request = self._pipe.recv()
            except (EOFError, OSError):
                return ""
            if isinstance(request, Failed):
                return request.description
            answer = self._answer(request)
            try:
                self._pipe.send(answer)
            except OSError:
                return ""
            if isinstance(answer, Exit):
                return ""

    def _answer(self, request: Create | Call) -> Result | Raised | Exit:
        try:
            return Result(replaced(self._do(request), _API, self._reference))
        except SystemExit:
            return Exit(0)
        except Exception as error:  # noqa: BLE001  # the program gets it
            return Raised(error)

    def _do(self, request: Create | Call) -> Any:
        if isinstance(request, Create):
            return {"Keyboard": Keyboard, "Robot": Robot, "Supervisor": Supervisor}[request.kind]()
        for number in request.unused:
            instance = self._objects.pop(number)
            del self._numbers[type(instance), instance]
        arguments = replaced(request.arguments, Reference, lambda reference: self._objects[reference.number])
        return getattr(self._objects[request.number], request.method)(*arguments, **request.options)

    def _reference(self, instance: Any) -> Reference:
        key = type(instance), instance
        if key not in self._numbers:
            self._last += 1
            self._numbers[key], self._objects[self._last] = self._last, instance
        return Reference(self._numbers[key], type(instance).__name__)
