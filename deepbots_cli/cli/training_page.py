"""The page in the browser of `train --view`, in a separate process beside the training."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path

from deepbots_cli.document import Permissions
from deepbots_cli.errors import MissingExtraError
from deepbots_cli.processes import Process

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
    pages: list[Process] = []

    def show(run: Path) -> None:
        if enabled:
            options = ["--fps", str(_FRAME_RATE), *(["--allow-code"] if permissions.code else [])]
            pages.append(Process("deepbots_cli", "view", *options, "--", str(run), hear=show_address))

    def show_address(line: bytes) -> None:
        """Show the address of the page once it is served, and lower the priority of its process."""
        print(line.decode("utf-8", "replace"), end="", file=sys.stderr, flush=True)
        _lower_priority(pages[0].pid)

    try:
        yield show
    finally:
        for page in pages:
            page.end()  # killed, since the page would report SIGTERM


def _lower_priority(pid: int) -> None:
    if sys.platform != "win32":
        # In Linux, the priority of a process is that of its first thread, so each thread is set.
        threads = Path(f"/proc/{pid}/task")
        with suppress(OSError):  # the process has ended
            for thread in [int(folder.name) for folder in threads.iterdir()] if threads.is_dir() else [pid]:
                os.setpriority(os.PRIO_PROCESS, thread, 15)
