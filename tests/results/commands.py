"""Runs commands one after the other or two at a time, with their CPU time; a wish to stop reaches them, and is waited for."""

from __future__ import annotations

import json
import os
import shlex
import signal
import subprocess
import sys
import tempfile
import threading
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from deepbots_cli.cli.exits import INTERRUPTED
from tests.results.places import ROOT


class StoppedError(Exception):
    """Somebody wants the work to end; what is finished is kept."""


class CommandFailedError(Exception):
    """A command ended in an error, which it has told on standard error."""


@dataclass(frozen=True)
class Outcome:
    """What a command printed, and its CPU seconds: user and system, of its own children too."""

    text: str
    code: int
    cpu_seconds: float

    @property
    def data(self) -> Any:
        return json.loads(self.text)


class Commands:
    """The commands under way; `stop` asks them to end, and lets none begin."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._running: set[subprocess.Popen[bytes]] = set()
        self._stopping = threading.Event()

    def stop(self) -> None:
        with self._lock:
            self._stopping.set()
            for process in self._running:
                with suppress(ProcessLookupError):
                    os.kill(process.pid, signal.SIGTERM)  # Popen's own way may take the end of it, and its CPU time, from `wait4`

    def pause(self, seconds: float) -> None:
        """Raises: StoppedError: It was asked for meanwhile."""
        if self._stopping.wait(seconds):
            raise StoppedError

    def python(self, *words: str) -> Outcome:
        """`python -m ...` at the root of the repository, to its end however it ends; standard error is ours.

        Raises:
            StoppedError: Before it began.
        """
        with tempfile.TemporaryFile() as told:
            with self._lock:
                if self._stopping.is_set():
                    raise StoppedError
                # In a session of its own Ctrl-C does not reach it: it gets one signal, from us. A second would cost it its last steps.
                process = subprocess.Popen([sys.executable, "-m", *words], cwd=ROOT, stdout=told, start_new_session=True)
                self._running.add(process)
            _, status, used = os.wait4(process.pid, 0)
            with self._lock:
                self._running.discard(process)
            process.returncode = os.waitstatus_to_exitcode(status)
            told.seek(0)
            return Outcome(told.read().decode(), process.returncode, used.ru_utime + used.ru_stime)

    def deepbots(self, *words: str, ledger: Path | None = None) -> Outcome:
        """A verb with its arguments; prints JSON. Its CPU time is entered in `ledger` however it ends.

        Raises:
            StoppedError: Before it began, or it was interrupted.
            CommandFailedError: It ended in an error.
        """
        outcome = self.python("deepbots_cli", *words, "--json")
        if ledger is not None:
            with ledger.open("a", encoding="utf-8") as stream:
                stream.write(f"{outcome.cpu_seconds:.2f}\n")
        if outcome.code == -signal.SIGKILL:
            raise StoppedError(f"killed outright, for want of memory perhaps: deepbots {shlex.join(words)}")
        if outcome.code in (INTERRUPTED, -signal.SIGTERM):
            raise StoppedError
        if outcome.code:
            raise CommandFailedError(f"exit code {outcome.code} of: deepbots {shlex.join(words)}")
        return outcome
