"""The library, imported without what it prints, and its numbers that stand for something."""

from __future__ import annotations

import ctypes
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress


@contextmanager
def hushed() -> Iterator[Callable[[], str]]:
    """Catch what is written to the process's own stdout and stderr, below Python's; yields a way to read it."""
    _flush()
    with tempfile.TemporaryFile() as caught:
        kept: list[tuple[int, int]] = []
        for fd in (1, 2):
            with suppress(OSError):  # a program may have closed its own
                kept.append((fd, os.dup(fd)))
        try:
            for fd, _ in kept:
                os.dup2(caught.fileno(), fd)

            def said() -> str:
                _flush()
                caught.seek(0)
                return caught.read().decode(errors="replace").strip()

            yield said
        finally:
            _flush()
            for fd, copy in kept:
                os.dup2(copy, fd)
                os.close(copy)


def _flush() -> None:
    """Empty Python's buffers and the C library's, which would otherwise print after the terminal is back."""
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            stream.flush()
    if os.name == "posix":
        ctypes.CDLL(None).fflush(None)


with hushed():  # it prints the time of its build
    import pybullet

__all__ = ["pybullet"]

BASE = -1  # the number of a root link
FAINT = 1e-200  # N m or N; stands for no force, at which a motor would go on reporting what it last exerted
STRONGEST = 1e12  # N m or N; stands for an unlimited motor
UNREACHABLE = 1e9  # rad/s or m/s; a velocity motor that aims there exerts exactly its limit
GAINS = (0.1, 1.0, -1.0)  # the library's own position and velocity gain, and no cap; positional arguments cost half of named ones
