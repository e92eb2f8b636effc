"""One process at a time trains in a run."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from deepbots_cli.errors import UsageError


@contextmanager
def sole_trainer(folder: Path) -> Iterator[None]:
    """Within, nobody else trains in the run directory `folder`.

    The claim ends with the process, however that ends: there is nothing to clean up after a kill. Windows and some network
    drives cannot lock a directory; there it is up to the user.

    Raises:
        UsageError: Another training is at work there.
    """
    if sys.platform == "win32":
        yield
        return
    import fcntl

    descriptor = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise UsageError(f"another training is at work in {folder}; wait for its end, or end it") from None
        except OSError:
            pass  # a drive without locks
        yield
    finally:
        os.close(descriptor)
