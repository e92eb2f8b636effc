"""The file in which Optuna keeps the trials of a study: a JSON object in each line.

Importing this module loads Optuna.
"""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

from optuna.exceptions import OptunaError
from optuna.storages.journal import JournalFileBackend, JournalFileOpenLock

from deepbots_cli.errors import RunError, StorageError
from deepbots_cli.files import unwritable_message

_LAST_BYTES = 1 << 16  # bytes at the end that contain the last line
_COPYING = (2, 3, 5, 7, 8, 9)  # codes of attributes, parameters and reports
_MAX_COPIED = 200_000_000
"""The largest number of copied entries. For each entry, Optuna copies all entries of this kind about the
trial.

A study of 10,000 trials with 30 seeds copies 45 million. A journal with 300,000 entries about one trial
would take an hour.
"""
_ERRORS = (
    ArithmeticError,
    AssertionError,
    AttributeError,
    LookupError,
    OptunaError,
    RuntimeError,
    TypeError,
    ValueError,
)
"""The exceptions that Optuna raises for entries of another origin, which it does not check."""


class JournalFile(JournalFileBackend):
    """The file of a journal, in which a crash while a line is written damages no more than this line.

    A process that writes holds the lock until its lines are complete. A last line that is not complete while
    another process has the lock was cut by a crash. Optuna leaves out such a line when it reads the file, and
    appends to it when it writes, which makes the file unreadable.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._own_lock = JournalFileOpenLock(str(path))
        self._line: int | None = None
        """The number of the line that is read, from 1."""
        self._kept: Counter[str] = Counter()
        """The number of entries of a kind about each trial."""
        self._copied = 0
        super().__init__(str(path), self._own_lock)

    def read_logs(self, log_number_from: int) -> Generator[dict[str, Any], None, None]:
        """Yield the entries after so many lines.

        Raises:
            ValueError: A line is not JSON.
            RunError: There are too many entries about one trial.
        """
        self._line = log_number_from + 1
        for log in super().read_logs(log_number_from):
            if log["op_code"] in _COPYING:
                kind = f"{log['op_code']} {log.get('trial_id')}"
                self._copied += self._kept[kind]
                self._kept[kind] += 1
            if self._copied > _MAX_COPIED:
                raise RunError(
                    f"{self._path} has too many entries about one trial, so deepbots did not write it"
                )
            yield log  # an error may be raised here, while Optuna applies it
            self._line += 1
        if log_number_from == 0:
            self._check_last_line()
        self._line = None

    def _check_last_line(self) -> None:
        """Check the last line, because Optuna leaves out a last line that is not JSON, even if it is
        complete.

        Raises:
            ValueError: It is such a line.
        """
        with self._path.open("rb") as file:
            file.seek(max(0, _end_of_entries(file) - _LAST_BYTES))
            *_, last, _ = [b"", *file.read().split(b"\n")]
        # A longer line was cut by this reading, so that it is not JSON.
        if last and len(last) < _LAST_BYTES:
            json.loads(last)

    def append_logs(self, logs: list[dict[str, Any]]) -> None:
        """Append entries, in place of a last line that is not complete.

        Raises:
            StorageError: The file cannot be written.
        """
        text = "".join(f"{json.dumps(log, separators=(',', ':'))}\n" for log in logs)
        self._own_lock.acquire()
        try:
            with self._path.open("r+b") as file:
                file.seek(_end_of_entries(file))
                file.truncate()
                file.write(text.encode())
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise StorageError(unwritable_message(self._path, error)) from error
        finally:
            self._own_lock.release()

    @contextmanager
    def checked(self) -> Iterator[None]:
        """Context in which errors of Optuna are reported as errors of the file.

        Raises:
            RunError: The file is damaged.
        """
        try:
            yield
        except _ERRORS as error:
            where = "" if self._line is None else f": line {self._line} is not an entry of Optuna"
            raise RunError(f"{self._path} is damaged, or was not written by deepbots{where}") from error
        except OSError as error:
            raise RunError(f"{self._path} cannot be read: {error.strerror}") from error


def _end_of_entries(file: BinaryIO) -> int:
    """Return the position of the next entry, after the last complete line."""
    size = file.seek(0, os.SEEK_END)
    # The whole file only if its last line is longer than `_LAST_BYTES`.
    for length in (_LAST_BYTES, size):
        begin = max(0, size - length)
        file.seek(begin)
        end = begin + file.read().rfind(b"\n") + 1
        if end > begin:
            return end
    return 0
