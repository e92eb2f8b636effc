"""Standard output and standard error that outlive whoever reads them."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, BinaryIO, TextIO

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer


class Outlet(io.BufferedIOBase):
    """Passes on what is written; after the first failure everything goes nowhere, so that none is told twice.

    A reader that has gone has seen enough (`| head`), which is no reason to end a training. A disk that is full is an
    error of standard output; of standard error there is no one left to tell.
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
def outlets() -> Iterator[None]:
    """Within, printing fails only where a file that stdout is written to cannot be; and no character fails to be printed.

    A terminal of another encoding shows an escape instead. Streams that a caller has put in place of the process's own
    stay what they are.
    """
    kept = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = _lasting(sys.stdout, 1), _lasting(sys.stderr, 2)
    try:
        yield
    finally:
        sys.stdout, sys.stderr = kept


def _lasting(stream: TextIO | None, number: int) -> TextIO:
    if stream is None:
        # The process was started without it (`>&-`); the next file to be opened would get its number, and all that is printed.
        _lead_nowhere(number)
        return open(number, "w", encoding="utf-8", errors="backslashreplace", closefd=False)
    if not isinstance(stream, io.TextIOWrapper):
        return stream
    stream.reconfigure(errors="backslashreplace")
    if stream not in (sys.__stdout__, sys.__stderr__):
        return stream
    outlet = Outlet(stream.buffer, "standard output" if number == 1 else "standard error", essential=number == 1)
    by_line = stream.line_buffering or stream.write_through
    return io.TextIOWrapper(outlet, stream.encoding, "backslashreplace", line_buffering=by_line)


def _lead_nowhere(number: int) -> None:
    nowhere = os.open(os.devnull, os.O_WRONLY)
    if nowhere != number:
        os.dup2(nowhere, number)
        os.close(nowhere)
