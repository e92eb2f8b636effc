"""The commands that the studio runs, each in a process of its own, which survives the server.

A task is a folder with `task.json` (the command), `log` (its output) and, once it has ended, `exit` (its exit
code). The process locks the folder while it runs, so a studio that starts again finds it.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from pydantic import BaseModel, Field

from deepbots_cli.errors import RunError, UsageError
from deepbots_cli.files import unwritable_message
from deepbots_cli.learning.runs.directories import is_training, read_json
from deepbots_cli.processes import python_command, python_environment

TASK_NAME, LOG_NAME, EXIT_NAME = "task.json", "log", "exit"
_MAX_RECORD_BYTES = 100_000
MAX_LOG_BYTES = 200_000
"""The number of bytes at the end of an output that the page shows."""
_MAX_LINE_BYTES = 1_000
_BESIDE_LEARNING = re.compile(r"[\d,]+ of [\d,]+ steps  (.+?)(, needs .+)? \.\.\.")
_EPISODES = re.compile(r"[\d,]+ of [\d,]+ episodes")
_START_S = 10.0
"""The time in s within which a process locks its folder."""
_MAX_TASKS = 100


class TaskRecord(BaseModel, strict=True, frozen=True):
    """A command as it was started.

    Attributes:
        words: The arguments of `deepbots`.
        run: The run directory that the command makes or reads; empty without one.
        output: The file that the command writes for the person; empty without one.
        started: The time in s since 1970.
        pid: The process, 0 until it runs.
    """

    words: tuple[str, ...]
    folder: str
    run: str = ""
    output: str = ""
    started: float = 0.0
    pid: int = Field(default=0, ge=0)


@dataclass(frozen=True, eq=False)
class Task:
    """A command that runs or has run. `path` is its folder."""

    path: Path
    record: TaskRecord

    @property
    def command(self) -> str:
        """The command for a shell."""
        return shlex.join(["deepbots", *self.record.words])

    @property
    def exit_code(self) -> int | None:
        """The exit code, None while the process runs; -9 if it ended without one."""
        try:
            return int((self.path / EXIT_NAME).read_bytes()[:10])
        except (OSError, ValueError):
            pass
        begins = 0 <= time.time() - self.record.started < _START_S and not (self.path / LOG_NAME).exists()
        return None if begins or is_training(self.path) else -9

    @property
    def is_running(self) -> bool:
        return self.exit_code is None

    def output(self) -> str:
        """Return the end of the output, without the lines that a progress display has replaced."""
        lines = self._tail(MAX_LOG_BYTES).split("\n")
        return "\n".join(line.rstrip("\r").rpartition("\r")[2] for line in lines)

    @property
    def activity(self) -> str:
        """What the last line of the output says about the progress of an evaluation; empty if it says
        something else."""
        line = self._tail(_MAX_LINE_BYTES).rstrip().rpartition("\n")[2]
        training = _BESIDE_LEARNING.fullmatch(line)
        if training is not None:
            return training[1]
        return f"evaluating, {line}" if _EPISODES.match(line) else ""

    def _tail(self, size: int) -> str:
        """Return at most `size` bytes of the end of the output as text."""
        try:
            with (self.path / LOG_NAME).open("rb") as stream:
                stream.seek(max(0, stream.seek(0, os.SEEK_END) - size))
                return stream.read(size).decode("utf-8", "replace")
        except OSError:
            return ""

    def stop(self) -> None:
        """End the process as Ctrl-C does; a training keeps its policy."""
        if not is_training(self.path):
            return
        try:
            pid = _read(self.path).pid
            if pid:
                os.kill(pid, signal.SIGINT if sys.platform != "win32" else signal.SIGTERM)
        except (OSError, RunError):
            return  # it has just ended


class Tasks:
    """The tasks in a folder, the newest last."""

    def __init__(self, folder: Path) -> None:
        """Read the tasks that earlier sessions have started; those beyond the newest hundred are removed."""
        self._folder = folder
        self.all: list[Task] = []
        self._processes: list[subprocess.Popen[bytes]] = []
        numbers = sorted(int(path.name) for path in folder.glob("[0-9]*") if path.name.isdecimal())
        for number in numbers:
            path = folder / f"{number:04d}"
            try:
                self.all.append(Task(path, _read(path)))
            except RunError:
                continue
        self._next = 1 + max(numbers, default=0)

    def start(
        self,
        words: Sequence[str],
        *,
        folder: Path,
        run: Path | None = None,
        output: Path | None = None,
    ) -> Task:
        """Start a command in the working directory `folder`.

        Raises:
            UsageError: The folder of tasks cannot be written.
        """
        path = self._folder / f"{self._next:04d}"
        record = TaskRecord(
            words=tuple(words),
            folder=str(folder),
            run=str(run or ""),
            output=str(output or ""),
            started=time.time(),
        )
        try:
            path.mkdir(parents=True)
            (path / TASK_NAME).write_text(record.model_dump_json(indent=2), encoding="utf-8")
        except OSError as error:
            raise UsageError(unwritable_message(path, error)) from error
        self._next += 1
        process = subprocess.Popen(
            python_command("deepbots_cli.studio.task_process", str(path)),
            cwd=folder,
            env=python_environment({"DEEPBOTS_STUDIO_TASK": "1"}),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        self._processes.append(process)
        task = Task(path, record)
        self.all.append(task)
        self._forget()
        return task

    def reap(self) -> None:
        """Let the system forget processes that have ended."""
        self._processes = [process for process in self._processes if process.poll() is None]

    @property
    def running(self) -> list[Task]:
        return [task for task in self.all if task.is_running]

    def _forget(self) -> None:
        """Remove the oldest tasks that have ended."""
        for task in self.all[: max(0, len(self.all) - _MAX_TASKS)]:
            if not task.is_running:
                shutil.rmtree(task.path, ignore_errors=True)
                self.all.remove(task)


def _read(path: Path) -> TaskRecord:
    return read_json(path / TASK_NAME, TaskRecord, _MAX_RECORD_BYTES)
