"""The page in the browser of `train --view`, in a separate process beside the training."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from threading import Thread

from deepbots_cli.document import Permissions
from deepbots_cli.errors import MissingExtraError
from deepbots_cli.processes import python_command, python_environment

_FRAME_RATE = 10
"""The pictures per second, few because a browser that draws in software shares the cores with the
training."""


@contextmanager
def training_page(*, enabled: bool, permissions: Permissions) -> Iterator[Callable[[Path], None]]:
    """Context with a function that shows a run in the browser, if `enabled`. The page ends with the block.

    The page has its own process, so that the training does not wait for it, and has a low priority once it
    serves its address: on a busy machine, a page that began with a low priority served none for 40 s.
    """
    if enabled and find_spec("viser") is None:
        raise MissingExtraError("view", "a page in the browser")
    started: list[tuple[subprocess.Popen[str], Thread]] = []

    def show(run: Path) -> None:
        if enabled:
            options = ["--fps", str(_FRAME_RATE), *(["--allow-code"] if permissions.code else [])]
            command = python_command("deepbots_cli", "view", *options, "--", str(run))
            nowhere, pipe = subprocess.DEVNULL, subprocess.PIPE
            process = subprocess.Popen(
                command, stdin=nowhere, stdout=pipe, text=True, env=python_environment()
            )
            started.append((process, Thread(target=_await_page, args=(process,), daemon=True)))
            started[0][1].start()

    try:
        yield show
    finally:
        for process, waiting in started:
            process.kill()  # the page reports SIGTERM, but not this
            process.wait()
            waiting.join()  # its standard output has ended


def _await_page(page: subprocess.Popen[str]) -> None:
    """Show the address of a page once it is served, and lower the priority of its process."""
    assert page.stdout is not None
    print(page.stdout.readline(), end="", file=sys.stderr, flush=True)
    if sys.platform != "win32":
        # In Linux, the priority of a process is that of its first thread, so each thread is set.
        threads = Path(f"/proc/{page.pid}/task")
        with suppress(OSError):  # the process has ended
            for thread in (
                [int(folder.name) for folder in threads.iterdir()] if threads.is_dir() else [page.pid]
            ):
                os.setpriority(os.PRIO_PROCESS, thread, 15)
