"""Processes in which damaged and hostile files are tried, and what they take: memory, CPU time, opened files."""

from __future__ import annotations

import json
import os
import pickle
import re
import resource
import signal
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from deepbots_cli.document import shipped

ROOT = Path(__file__).parents[2]
SERVE = "--serve"
"""The argument with which a module runs `serve`."""

# Memory


def peak_memory() -> int:
    """Bytes of memory that this process held at most.

    On Linux `ru_maxrss` would begin with the peak of the process that started this one.
    """
    status = Path("/proc/self/status")
    held = (
        re.search(r"^VmHWM:\s*(\d+) kB", status.read_text(encoding="utf-8"), re.MULTILINE)
        if status.exists()
        else None
    )
    return 1024 * (int(held[1]) if held else resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)


def rise_of_memory(action: Callable[[], object]) -> int:
    """The bytes that an action takes at most, beyond those that the process has."""
    Path("/proc/self/clear_refs").write_text("5")  # begins the peak anew
    before = peak_memory()
    action()
    return peak_memory() - before


# Files

OUTSIDE: list[str] = []
"""What was opened since the list was last cleared, and lies nowhere that it may."""
_allowed: tuple[str, ...] = ()


def allow(*folders: str | Path) -> None:
    """Files below these may be opened, and no others apart from what is installed or shipped, and where the
    peak of memory stands."""
    global _allowed
    installed = (
        sys.prefix,
        sys.base_prefix,
        ROOT / "deepbots_cli",
        ROOT / "deepbots_webots",
        ROOT / "tests",
        *shipped.data_roots(),
        "/proc/self/status",
    )
    _allowed = tuple(os.path.join(os.path.realpath(folder), "") for folder in (*folders, *installed))


def watch() -> None:
    """From now on note every file that is opened and may not be. Python has no way back from it."""
    searched = {os.path.realpath(folder) for folder in sys.path}  # for packages, by the import system

    def hook(event: str, arguments: tuple[object, ...]) -> None:
        if event in ("open", "os.listdir", "os.scandir") and isinstance(
            arguments[0], str | bytes | os.PathLike
        ):
            path = os.path.realpath(os.fsdecode(arguments[0]))
            if not os.path.join(path, "").startswith(_allowed) and not (event != "open" and path in searched):
                OUTSIDE.append(path)

    sys.addaudithook(hook)


# Processes


def serve(answer: Callable[[Any], Any]) -> None:
    """Answer each line of JSON with a line of JSON."""
    for line in sys.stdin:
        print(json.dumps(answer(json.loads(line))), file=sys.__stdout__, flush=True)


def answers(module: str, requests: Iterable[Any], *, quiet: bool = False) -> Iterator[tuple[Any, Any]]:
    """Yield each request with the answer of a process that runs `serve` in a module; None if the request took
    the process down, and a further one answers the next."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "tests" / "learning")])}
    nowhere = subprocess.DEVNULL if quiet else None
    waiting = iter(requests)
    is_done = False
    while not is_done:
        with subprocess.Popen(
            [sys.executable, "-m", module, SERVE],
            env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=nowhere, text=True,
        ) as process:  # fmt: skip
            assert process.stdin is not None
            assert process.stdout is not None
            is_done = True
            for request in waiting:
                print(json.dumps(request), file=process.stdin, flush=True)
                line = process.stdout.readline()
                yield request, json.loads(line) if line else None
                if not line:
                    is_done = False
                    break
            process.stdin.close()


class Fork(NamedTuple):
    """The result of an action in a forked process, None if the process was ended; its CPU seconds, and the
    signal that ended it."""

    result: Any
    seconds: float
    signal: int


def in_fork(action: Callable[[], Any], wall_seconds: int = 200) -> Fork:
    """Do something in a forked process, which is ended after a time."""
    read_end, write_end = os.pipe()
    child = os.fork()
    if not child:
        try:
            signal.signal(signal.SIGALRM, signal.SIG_DFL)
            signal.alarm(wall_seconds)
            with os.fdopen(write_end, "wb") as stream:
                pickle.dump(action(), stream)
        finally:
            os._exit(0)
    os.close(write_end)
    with os.fdopen(read_end, "rb") as stream:
        answer = stream.read()
    _, status, usage = os.wait4(child, 0)
    result = pickle.loads(answer) if answer else None
    return Fork(result, usage.ru_utime + usage.ru_stime, os.WTERMSIG(status))
