"""Functions that workers call; they import this module, which therefore imports little."""

from __future__ import annotations

import os
import signal
import sys
import time

from deepbots_cli.errors import UsageError
from deepbots_cli.learning.executor import Attempt


def square(item: int, attempt: Attempt) -> int:
    if item == 3:
        raise UsageError("there is no square of 3")
    return item**2


def lose(item: int, attempt: Attempt) -> int:
    """The worker of item 0 is lost once, that of item 1 always."""
    if item == 1 or (item == 0 and attempt.number == 1):
        os.kill(os.getpid(), signal.SIGKILL)
    return attempt.number


def imported(item: str, attempt: Attempt) -> bool:
    """Whether a worker has imported a module."""
    return item in sys.modules


def sleep(item: int, attempt: Attempt) -> None:
    attempt.report(os.getpid())
    time.sleep(item)


def priority(item: int, attempt: Attempt) -> int:
    return os.nice(0)


class Echo:
    """Work of a worker that returns its arguments."""

    def work(self, value: int) -> int:
        return value
