"""From exceptions to exit codes, and to one line each on stderr."""

from __future__ import annotations

import os
import signal
import sys
import tempfile
import threading
import traceback
from collections.abc import Callable
from types import FrameType

from deepbots_cli.cli import terminal
from deepbots_cli.errors import DeepbotsError, ScenarioError, UsageError

FAILED, WRONG, FAULT, INTERRUPTED = 1, 2, 3, 130


def guarded(run: Callable[[], object]) -> int:
    """Call `run`, tell what goes wrong, and return the exit code."""
    terminal.prepare()
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, _interrupt)
    try:
        code = _told(run)
        sys.stdout.flush()
    except BrokenPipeError:
        # Whoever read the output has seen enough; what is left to flush goes nowhere.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = FAILED
    return code


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
    except BrokenPipeError:
        raise
    except OSError as error:
        if error.filename is None:
            return _fault(error)
        terminal.complain(f"{error.filename}: {(error.strerror or 'cannot be used').lower()}")
        return WRONG
    except Exception as error:  # noqa: BLE001  # the last handler: what arrives here is a fault of ours
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
