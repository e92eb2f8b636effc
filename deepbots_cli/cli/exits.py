"""From exceptions to exit codes, and to one line each on stderr."""

from __future__ import annotations

import errno
import os
import signal
import sys
import tempfile
import threading
import traceback
from collections.abc import Callable
from types import FrameType

from deepbots_cli.cli import terminal
from deepbots_cli.cli.outlets import outlets
from deepbots_cli.errors import DeepbotsError, ScenarioError, UsageError

FAILED, WRONG, FAULT, INTERRUPTED = 1, 2, 3, 130
"""The same for every verb: findings or a result that was not met; wrong usage or a missing file; a fault of deepbots itself, which
`lint` also reports as DB903 of the file; Ctrl-C or SIGTERM."""

_DISK_ERRORS = (errno.ENOSPC, errno.EFBIG, errno.EIO, errno.EROFS)


def guarded(run: Callable[[], object]) -> int:
    """Call `run`, tell what goes wrong, and return the exit code, which does not depend on whether anyone reads the output."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, _interrupt)
    with outlets():
        code = _told(run)
        # What is left in the buffer may still fail to be written.
        return _told(sys.stdout.flush) or code


def _interrupt(number: int, frame: FrameType | None) -> None:
    """SIGTERM ends a command as Ctrl-C does: what is open is closed, and a run knows that it was interrupted."""
    raise KeyboardInterrupt


def _told(run: Callable[[], object]) -> int:
    try:
        run()
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else FAILED if end.code else 0
    except ScenarioError as error:
        terminal.show_findings(error.findings)
        return FAILED
    except DeepbotsError as error:
        terminal.complain(str(error))
        return WRONG if isinstance(error, UsageError) else FAILED
    except KeyboardInterrupt:
        return INTERRUPTED
    except OSError as error:
        # Of a failed write (in contrast to opening) the system does not say in which file.
        if error.filename is None and error.errno not in _DISK_ERRORS:
            return _fault(error)
        terminal.complain(f"{error.filename or 'writing a file'}: {(error.strerror or 'cannot be used').lower()}")
        return WRONG
    except Exception as error:  # the last handler: what arrives here is a fault of ours  # noqa: BLE001
        return _fault(error)
    return 0


def _fault(error: Exception) -> int:
    if os.environ.get("DEEPBOTS_DEBUG") == "1":
        raise error
    with tempfile.NamedTemporaryFile(
        "w", encoding="utf-8", errors="backslashreplace", prefix="deepbots-", suffix=".txt", delete=False
    ) as file:
        file.write("".join(traceback.format_exception(error)))
    terminal.complain(
        f"deepbots has failed, which is a fault of its own and not yours\n"
        f"  {type(error).__name__}: {error}\n"
        f"  the traceback is in {file.name}; DEEPBOTS_DEBUG=1 shows it here"
    )
    return FAULT
