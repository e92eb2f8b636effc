"""Exit codes: an exception becomes a code and a line on stderr. Output without a reader is not an error."""

from __future__ import annotations

import errno
import io
import os
import signal
import sys
import tempfile
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING, BinaryIO, TextIO

from deepbots_cli.cli import terminal
from deepbots_cli.errors import DeepbotsError, ScenarioError, UsageError
from deepbots_cli.installation import extra_with, install_hint

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

# The exit codes of every command.
FAILED = 1
"""Findings, or a result that was not met."""
WRONG_USAGE = 2
"""Wrong usage, or a missing file."""
INTERNAL_ERROR = 3
"""A fault of deepbots itself, which `lint` also reports as DB903 of the file."""
INTERRUPTED = 130
"""Ctrl-C or SIGTERM."""

_DISK_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS)


def run_guarded(run: Callable[[], object]) -> int:
    """Call `run`, report errors, and return the exit code, which does not depend on whether anyone reads the
    output."""
    # Python accepts signal handlers in the main thread only.
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, _interrupt)
    with _lasting_streams():
        code = _exit_code(run)
        # The rest of the buffer may still fail to be written.
        return _exit_code(sys.stdout.flush) or code


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt, so that SIGTERM ends a command like Ctrl-C: files are closed, and a run
    records that it was interrupted."""
    raise KeyboardInterrupt


def _exit_code(run: Callable[[], object]) -> int:
    try:
        run()
    except SystemExit as end:
        if isinstance(end.code, int):
            return end.code
        if end.code:
            return FAILED
        return 0
    except ScenarioError as error:
        from deepbots_cli.document import Permissions

        terminal.show_findings(error.findings, Permissions())
        return FAILED
    except DeepbotsError as error:
        terminal.print_error(error.full_message)
        return WRONG_USAGE if isinstance(error, UsageError) else FAILED
    except KeyboardInterrupt:
        # The interruption came before the command or after its end; `Commands.invoke` reports others.
        terminal.note("interrupted")
        return INTERRUPTED
    except OSError as error:
        # The system does not name the file where writing fails, in contrast to opening.
        if error.filename is None and error.errno not in _DISK_ERRORS:
            return _fault(error)
        reason = (error.strerror or "cannot be used").lower()
        terminal.print_error(f"{os.fsdecode(error.filename or 'writing a file')}: {reason}")
        return WRONG_USAGE
    except ModuleNotFoundError as error:
        module = (error.name or "").partition(".")[0]
        extra = extra_with(module)
        if extra is None:
            return _fault(error)
        terminal.print_error(f"this needs '{module}' of the '{extra}' extra; {install_hint(extra)}")
        return WRONG_USAGE
    except Exception as error:  # the last handler: what arrives here is a fault of ours  # noqa: BLE001
        return _fault(error)
    return 0


def _fault(error: Exception) -> int:
    if isinstance(error.__cause__, KeyboardInterrupt):  # pydantic raises its own error from it
        terminal.note("interrupted")
        return INTERRUPTED
    if os.environ.get("DEEPBOTS_DEBUG") == "1":
        raise error
    try:
        with tempfile.NamedTemporaryFile(
            "w", encoding="utf-8", errors="backslashreplace", prefix="deepbots-", suffix=".txt", delete=False
        ) as file:
            file.write("".join(traceback.format_exception(error)))
        location_text = f"the traceback is in {file.name}; "
    except OSError:  # the disk is full
        location_text = ""
    terminal.print_error(
        f"deepbots failed because of an error in deepbots, not in your input\n"
        f"  {type(error).__name__}: {error}\n"
        f"  {location_text}DEEPBOTS_DEBUG=1 shows the traceback here"
    )
    return INTERNAL_ERROR


class _Stream(io.BufferedIOBase):
    """A stream that survives its reader: after the first failure everything is discarded, so that it is
    reported once.

    A missing reader (`| head`) is no reason to end a training. A full disk is an error for standard output
    only, because an error about standard error could not be read.
    """

    def __init__(self, target: BinaryIO, name: str, *, essential: bool) -> None:
        self._target = target
        self._essential = essential
        self.name = name

    def writable(self) -> bool:
        return True

    def fileno(self) -> int:
        return self._target.fileno()

    def isatty(self) -> bool:
        return self._target.isatty()

    def write(self, data: ReadableBuffer, /) -> int:
        try:
            return self._target.write(data)
        except OSError as error:
            self._shut(error)
            return memoryview(data).nbytes

    def flush(self) -> None:
        try:
            self._target.flush()
        except OSError as error:
            self._shut(error)

    def _shut(self, error: OSError) -> None:
        _lead_nowhere(self.fileno())
        if self._essential and not isinstance(error, BrokenPipeError):
            raise OSError(error.errno, error.strerror, self.name) from None


@contextmanager
def _lasting_streams() -> Iterator[None]:
    """Context in which printing fails only if stdout is a file that cannot be written, and every character
    can be printed.

    A terminal of another encoding shows escapes. Streams that a caller has put in place of the process's own
    stay as they are.
    """
    streams = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = _lasting(sys.stdout, 1), _lasting(sys.stderr, 2)
    try:
        yield
    finally:
        sys.stdout, sys.stderr = streams


def _lasting(stream: TextIO | None, number: int) -> TextIO:
    if stream is None:
        # The process was started without it (`>&-`); the next file to be opened would get its number, and all
        # that is printed.
        _lead_nowhere(number)
        return open(number, "w", encoding="utf-8", errors="backslashreplace", closefd=False)
    if not isinstance(stream, io.TextIOWrapper):
        return stream
    stream.reconfigure(errors="backslashreplace")
    if stream not in (sys.__stdout__, sys.__stderr__):
        return stream
    lasting = _Stream(
        stream.buffer, "standard output" if number == 1 else "standard error", essential=number == 1
    )
    by_line = stream.line_buffering or stream.write_through
    return io.TextIOWrapper(lasting, stream.encoding, "backslashreplace", line_buffering=by_line)


def _lead_nowhere(number: int) -> None:
    nowhere = os.open(os.devnull, os.O_WRONLY)
    if nowhere != number:
        os.dup2(nowhere, number)
        os.close(nowhere)
