"""Further processes of Python, which import nothing from the working directory: its modules may be anyone's.

`python -m` and `python -c` put the working directory first on the path of imports, so a `typer.py` there
would run. deepbots starts every process with the arguments that this module returns.

`Process` is a process that gets messages and answers with messages, and may end at any time: the simulation
of lint, a worker of this machine, the robot of the studio, the page of a training. What it had not written is
lost. Within such a process, `message_streams` keeps prints out of its messages, and `limit` bounds it.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from math import ceil
from pathlib import Path
from typing import IO, Any, cast

VERDICT_FILE = "DEEPBOTS_VERDICT_FILE"
"""The environment variable with the file into which a command writes its verdict, for the program that has
started it."""
CORES_OF_CONTAINER = Path(
    "/sys/fs/cgroup/cpu.max"
)  # the CPU time that it may use in a period, and the period
_MAX_LINE_BYTES = 1 << 20
_LAST_BREATH_S = 1.0
"""The time in s that a process may take to end after it has closed its output."""
_MIB = 2**20

# Processes inherit the variable; the option -P would have to be in each command line.
_SAFE_PATH = "PYTHONSAFEPATH"


def available_cores() -> int:
    """Return the number of cores that this process may use; a container and `taskset` may allow fewer than
    all."""
    # `cpu_count` has all cores; macOS and Windows have nothing better.
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    with suppress(OSError, ValueError):  # there is no such file, or it says `max`
        quota, period = map(int, CORES_OF_CONTAINER.read_text().split())
        return min(cores, ceil(quota / period))
    return cores


def python_command(module: str, *arguments: str) -> list[str]:
    """Return the command line that runs a module in a process of its own, together with
    `python_environment`."""
    return [sys.executable, "-m", module, *arguments]


def python_script(text: str) -> list[str]:
    """Return the command line that runs a script of the standard library alone: without packages, the
    environment and the working directory."""
    return [sys.executable, "-ISc", text]


def python_environment(changes: Mapping[str, str] | None = None) -> dict[str, str]:
    """Return the environment of such a process, in which this very deepbots is found.

    An empty entry of PYTHONPATH, which is the working directory, is left out.
    """
    path = [str(Path(__file__).parents[1]), *filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(path), _SAFE_PATH: "1", **(changes or {})}


@contextmanager
def safe_path() -> Iterator[None]:
    """Keep processes that `multiprocessing` starts in the block from importing modules of the working
    directory."""
    before = os.environ.get(_SAFE_PATH)
    os.environ[_SAFE_PATH] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ[_SAFE_PATH]
        else:
            os.environ[_SAFE_PATH] = before


def line_of(stream: IO[bytes]) -> bytes:
    """Return the next line of a stream; a line of more than 1 MiB comes in parts.

    Raises:
        EOFError: The stream has ended.
    """
    line = stream.readline(_MAX_LINE_BYTES)
    if not line:
        raise EOFError
    return line


class Process:
    """A process that gets messages on its standard input and writes messages to its standard output.

    A thread reads the messages, so that the process never waits for this one, and its end is noticed at once.
    """

    def __init__(
        self,
        module: str,
        *arguments: str,
        hear: Callable[[Any], object],
        on_end: Callable[[int], object] = lambda code: None,
        read: Callable[[IO[bytes]], Any] = line_of,
        environment: Mapping[str, str] | None = None,
        quiet: bool = False,
        apart: bool = False,
    ) -> None:
        """Start a module of deepbots.

        Args:
            hear: Called in the thread with each message.
            on_end: Called in the thread once the process has ended, with its exit code; that of a signal is
                its negative number.
            read: Reads a message, and raises EOFError at the end of the stream.
            environment: Variables that are set for the process.
            quiet: Whether its standard error is dropped.
            apart: Whether Ctrl-C in the terminal of this process leaves it alone.

        Raises:
            OSError: The system starts no further process.
        """
        import subprocess  # 10 ms of CPU, which static linting does not need

        self._process = subprocess.Popen(
            python_command(module, *arguments),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL if quiet else None,
            env=python_environment(environment),
            start_new_session=apart,
            creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0) if apart else 0,  # of Windows
        )
        self.pid = self._process.pid
        self._hear, self._on_end, self._read = hear, on_end, read
        threading.Thread(target=self._receive, daemon=True).start()

    def _receive(self) -> None:
        try:
            with cast(IO[bytes], self._process.stdout) as source, suppress(EOFError, OSError, ValueError):
                while True:
                    self._hear(self._read(source))
        finally:
            self._on_end(self.end(_LAST_BREATH_S))

    def send(self, message: bytes) -> None:
        """Send a message; one to a process that has ended is lost."""
        stream = cast(IO[bytes], self._process.stdin)
        with suppress(OSError, ValueError):
            stream.write(message)
            stream.flush()

    def end(self, patience_s: float = 0.0) -> int:
        """End the process, unless it ends by itself until then. Returns its exit code."""
        import subprocess

        with suppress(subprocess.TimeoutExpired):
            self._process.wait(patience_s)
        self._process.kill()
        code = self._process.wait()
        with suppress(OSError):
            cast(IO[bytes], self._process.stdin).close()
        return code


def ending(code: int) -> str:
    """Return the name of the signal that ended a process, such as `SIGKILL`, or `exit code 1`."""
    names = {number.value: number.name for number in signal.Signals}
    return names.get(-code, f"signal {-code}" if code < 0 else f"exit code {code}")


# Within such a process


def message_streams() -> tuple[IO[bytes], IO[bytes]]:
    """Return standard input and output of this process for its messages. Other code, also in C, then reads
    nothing from the one and prints nothing to the other."""
    streams = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    nowhere = os.open(os.devnull, os.O_RDWR)
    for number in (0, 1):
        os.dup2(nowhere, number)
    return streams


def limit(cpu_s: int, memory_mib: int, file_mib: int | None = None) -> None:
    """Limit the CPU time, the address space and perhaps the size of each written file of this process and of
    all that it starts. Windows has no such limits."""
    if sys.platform == "win32":
        return
    import resource

    for kind, bound in (
        (resource.RLIMIT_CPU, cpu_s),
        (resource.RLIMIT_AS, memory_mib * _MIB),
        (resource.RLIMIT_CORE, 0),  # an engine that crashes leaves no file of its memory
        *([] if file_mib is None else [(resource.RLIMIT_FSIZE, file_mib * _MIB)]),
    ):
        hard = resource.getrlimit(kind)[1]
        resource.setrlimit(kind, (bound if hard == resource.RLIM_INFINITY else min(bound, hard), hard))
