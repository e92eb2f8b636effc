"""The commands that the studio runs, each in a process of its own, which survives the server.

A task is a folder with `task.json` (the command), `log` (its output), `verdict` (its result) and, once it has
ended, `exit` (its exit code). The process, `python -m deepbots_cli.studio.commands FOLDER`, locks the folder
while it runs, so a studio that starts again finds it.
"""

from __future__ import annotations

import asyncio
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from pydantic import BaseModel, Field

from deepbots_cli.document import Permissions
from deepbots_cli.errors import RunError, UsageError
from deepbots_cli.files import unwritable_message
from deepbots_cli.learning.runs.directories import is_training, read_json, run_lock, write_text
from deepbots_cli.processes import VERDICT_FILE, python_command, python_environment
from deepbots_cli.records import dataclass

RUNS_FOLDER = "runs"
STUDIO_FOLDER = ".studio"
"""The folder in `runs` for tasks."""

_INTERRUPTED = 130
"""The exit code after Ctrl-C."""
_PATH_VERBS = ("train", "try", "test", "eval", "render", "compare", "new", "lint", "diff")
"""The commands that have the options `--allow-path` and `--allow-code`."""
_CODE_VERBS = (*_PATH_VERBS, "resume", "report", "diagnose")
"""The commands that have the option `--allow-code`."""

_TITLES = {
    "try": "A few episodes",
    "test": "The tests",
    "eval": "Evaluation",
    "render": "Video",
    "report": "Report",
    "train": "Training",
    "resume": "Training",
    "compare": "Comparison",
    "diagnose": "Explanation",
    "lint": "Check",
    "diff": "Differences",
}
"""What commands make, in headings and notices."""
TASK_NAME, LOG_NAME, EXIT_NAME, VERDICT_NAME = "task.json", "log", "exit", "verdict"
_MAX_RECORD_BYTES = 100_000
MAX_LOG_BYTES = 200_000
"""The number of bytes at the end of an output that the page shows."""
_MAX_LINE_BYTES = 1_000
_BESIDE_LEARNING = re.compile(r"[\d,]+ of [\d,]+ steps  (.+?)(, needs .+)? \.\.\.")
_EPISODES = re.compile(r"([\d,]+ of [\d,]+ episodes)(?:.*  (\d+ s to go))?")
_START_S = 60.0
"""The time in s within which a process locks its folder: 0.5 s alone, over 10 s on a busy machine."""
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

    @property
    def has_failed(self) -> bool:
        """Whether the command has ended without an answer; `diff` answers with the exit code 1, too."""
        is_answer = self.record.words[0] == "diff" and self.exit_code == 1
        return bool(self.exit_code) and not is_answer

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
        episodes = _EPISODES.fullmatch(line)
        return ", ".join(["evaluating", *filter(None, episodes.groups())]) if episodes is not None else ""

    @property
    def verdict(self) -> str:
        """The result of the command in a sentence; empty before its end and without one."""
        return self._tail(MAX_LOG_BYTES, VERDICT_NAME)

    def _tail(self, size: int, name: str = LOG_NAME) -> str:
        """Return at most `size` bytes of the end of a file, by default the output, as text."""
        try:
            with (self.path / name).open("rb") as stream:
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
        """Read the tasks that earlier sessions have started."""
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
            python_command("deepbots_cli.studio.commands", str(path)),
            cwd=folder,
            env=python_environment({VERDICT_FILE: str(path / VERDICT_NAME)}),
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


# The commands of the page


def title_of(task: Task) -> str:
    """Return a heading for the output of a command: what it makes, and of what."""
    verb, *words = task.record.words
    about = task.record.run or next((word for word in words if not word.startswith("--")), "")
    return f"{_TITLES[verb]} of {Path(about).name}" if verb in _TITLES and about else task.command


def result_of(task: Task) -> str:
    """Return the result of a command in a sentence, or what it does while it runs; empty if neither is
    known."""
    if task.exit_code == 0 and task.record.output:
        return f"{task.record.output} is written"
    if task.is_running:
        return task.activity
    if not task.verdict and task.has_failed:
        return "stopped" if task.exit_code == _INTERRUPTED else "failed; the last lines say why"
    is_random = task.record.words[0] == "try" and "--driver" not in task.record.words
    return f"Random actions: {task.verdict}" if task.verdict and is_random else task.verdict


class Commands:
    """The commands of the studio of one folder, each in a process of its own that outlives the server.

    Attributes:
        tasks: All commands of this and of earlier servers.
    """

    def __init__(self, folder: Path, permissions: Permissions, on_start: Callable[[Task], None]) -> None:
        """Create the commands of a folder. `on_start` is called with each command that was started."""
        self._folder, self._permissions, self._on_start = folder, permissions, on_start
        self.tasks = Tasks(folder / RUNS_FOLDER / STUDIO_FOLDER / "tasks")
        self._was_running = {task.path for task in self.tasks.running}

    def run(self, words: Sequence[str], run: Path | None = None, output: Path | None = None) -> Task:
        """Start a command in a process of its own.

        Args:
            run: The run directory that it makes or reads, relative to the folder.
            output: The file that it writes for the person, relative to the folder.

        Raises:
            UsageError: The folder cannot be written.
        """
        words = [*words, *self.permission_options(words[0])]
        task = self.tasks.start(words, folder=self._folder, run=run, output=output)
        self._was_running.add(task.path)
        self._on_start(task)
        return task

    def train(self, scenario: str, options: Sequence[str] = ()) -> Task:
        """Train a scenario in a new run directory."""
        run = self.new_run(Path(scenario).stem)
        return self.run(["train", scenario, "--run", str(run), *options], run)

    def run_with_output(self, words: Sequence[str], run: Path, name: str) -> Task:
        """Start a command that writes a file `name` into a new place beside a run."""
        stem, suffix = Path(name).stem, Path(name).suffix
        numbers = (run.with_name(f"{run.name}-{stem}{number or ''}{suffix}") for number in range(10**6))
        # A running command writes its file at its end.
        taken = {task.record.output for task in self.tasks.running}
        output = next(
            path for path in numbers if str(path) not in taken and not (self._folder / path).exists()
        )
        return self.run([*words, "-o", str(output)], run, output)

    async def call(self, words: Sequence[str]) -> tuple[str, int]:
        """Run a short command. Returns its output, or its messages if it has failed without output, and its
        exit code."""
        process = await asyncio.create_subprocess_exec(
            *python_command("deepbots_cli", *words, *self.permission_options(words[0])),
            cwd=self._folder,
            env=python_environment(),
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
        )
        output, messages = await process.communicate()
        code = process.returncode or 0
        return (messages if code and not output else output).decode("utf-8", "replace"), code

    def trained_run(self, task: Task) -> Path | None:
        """Return the run that a command trains; None for other commands."""
        is_training = task.record.words[0] in ("train", "resume") and bool(task.record.run)
        return self._folder / task.record.run if is_training else None

    def newest_training(self, stem: str) -> Path | None:
        """Return the run of the newest training of the scenario with this name, if any."""
        name = self.new_run(stem).name.rpartition("-")[0]
        runs = map(self.trained_run, reversed(self.tasks.all))
        return next((run for run in runs if run and run.name.rpartition("-")[0] == name), None)

    def new_run(self, stem: str) -> Path:
        """Return the name of a new run directory, relative to the folder."""
        stem = re.sub(r"[^A-Za-z0-9_.-]+", "_", stem)
        # A training makes its directory some seconds after its start.
        names = {Path(task.record.run).name for task in self.tasks.running}
        names |= {path.name for path in (self._folder / RUNS_FOLDER).glob(f"{stem}-*")}
        number = next(number for number in range(1, 10**6) if f"{stem}-{number}" not in names)
        return Path(RUNS_FOLDER, f"{stem}-{number}")

    def permission_options(self, verb: str) -> list[str]:
        """Return the options for files and Python functions that this server was started with."""
        folders = self._permissions.folders if verb in _PATH_VERBS else ()
        options = [f"--allow-path={Path(folder).absolute()}" for folder in folders]
        return [*options, "--allow-code"] if self._permissions.code and verb in _CODE_VERBS else options

    def end_of(self, task: Task) -> str:
        """Return a few words about a command that has ended."""
        # The process of a task does not need it, and starts 0.25 s earlier.
        from deepbots_cli.learning.campaigns.listing import read_listed

        code, run, title = task.exit_code, self.trained_run(task), title_of(task)
        if code == _INTERRUPTED:
            return f"{title}: stopped"
        if task.verdict or not task.has_failed:
            solved = None if run is None else read_listed(run).solved
            return f"{title}: {({True: 'solved', False: 'not solved', None: 'finished'})[solved]}"
        return f"{title}: failed; the tab Commands shows why"

    def look(self) -> tuple[list[Task], bool]:
        """Return the commands that have ended since the last look, and whether any runs."""
        self.tasks.reap()
        running = {task.path for task in self.tasks.running}
        ended, self._was_running = self._was_running - running, running
        return [task for task in self.tasks.all if task.path in ended], bool(running)


# The process of a task


def run_task(folder: Path) -> int:
    """Run the command of a folder. Returns its exit code."""
    record = TaskRecord.model_validate_json((folder / TASK_NAME).read_bytes())
    with run_lock(folder):
        log = os.open(folder / LOG_NAME, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
        os.dup2(log, 1)
        os.dup2(log, 2)
        started = record.model_copy(update={"pid": os.getpid()})
        write_text(folder / TASK_NAME, started.model_dump_json(indent=2))
        code = 1
        try:
            code = _run(record)
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            (folder / EXIT_NAME).write_text(str(code), encoding="ascii")
    return code


def _run(record: TaskRecord) -> int:
    from deepbots_cli.cli import main as deepbots

    sys.argv = ["deepbots", *record.words]  # which a run records as its command
    try:
        return deepbots()
    except SystemExit as error:
        return error.code if isinstance(error.code, int) else int(error.code is not None)


if __name__ == "__main__":
    sys.exit(run_task(Path(sys.argv[1])))
