"""The commands that the studio runs."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Callable, Sequence
from pathlib import Path

from deepbots_cli.document import Permissions
from deepbots_cli.learning.campaigns.listing import read_listed
from deepbots_cli.processes import python_command, python_environment
from deepbots_cli.studio.tasks import Task, Tasks
from deepbots_cli.studio.trainings import result_text

RUNS_FOLDER = "runs"
STUDIO_FOLDER = ".studio"
"""The folder in `runs` for drafts and tasks."""

_INTERRUPTED = 130
"""The exit code after Ctrl-C."""
_TRAINING_VERBS = ("train", "resume")
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
}
"""The headings of outputs of commands, before the name of a run."""
_RESULTS = {
    "test": re.compile(r"^\d+ passed.*|^\d+ failed.*", re.MULTILINE),
    "try": re.compile(r"^[\d,]+ (?:of [\d,]+ )?episodes?(?: succeeded)?, .*", re.MULTILINE),
    "eval": re.compile(r"^ +(?:mean return|success rate) .*|^(?:not )?solved.*", re.MULTILINE),
    "compare": re.compile(
        r"^.*(?: is (?:better|worse) than | no significant difference |: the same .* in every |"
        r": cannot be compared).*|(?<=note: )the rewards of the runs differ.*",
        re.MULTILINE,
    ),
    "diagnose": re.compile(r"^Episode .*", re.MULTILINE),
    "lint": re.compile(r"^.*: no findings$|^\d+ (?:error|warning).*", re.MULTILINE),
}
"""The lines of the output of a command with its result."""


def title_of(task: Task) -> str:
    """Return a heading for the output of a command: what it makes, and of what."""
    verb, *words = task.record.words
    about = task.record.run or (words[0] if words else "")
    return f"{_TITLES[verb]} of {Path(about).name}" if verb in _TITLES and about else task.command


def result_of(task: Task) -> str:
    """Return the result of a command that has ended, in a sentence; empty if there is none."""
    pattern = _RESULTS.get(task.record.words[0])
    if task.exit_code == 0 and task.record.output:
        return f"{task.record.output} is written"
    lines = pattern.findall(task.output()) if pattern is not None and not task.is_running else []
    text = "; ".join(" ".join(line.split()) for line in dict.fromkeys(lines))
    is_random = task.record.words[0] == "try" and "--driver" not in task.record.words
    return f"Random actions: {text}" if text and is_random else text


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
        is_training = task.record.words[0] in _TRAINING_VERBS and bool(task.record.run)
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
        """Return a sentence about a command that has ended."""
        code, run = task.exit_code, task.record.run
        name = f"{task.record.words[0]} of {run}" if run else task.record.words[0]
        if code == _INTERRUPTED:
            return f"{name} was stopped"
        if result := result_of(task):
            return f"{name}: {result}"
        if code:
            return f"{name} has failed; the tab Commands shows why"
        if run and task.record.words[0] in _TRAINING_VERBS:
            return f"{run}: {result_text(read_listed(self._folder / run))}"
        return f"{name} has ended; the tab Commands shows its output"

    def look(self) -> tuple[list[Task], bool]:
        """Return the commands that have ended since the last look, and whether any runs."""
        self.tasks.reap()
        running = {task.path for task in self.tasks.running}
        ended, self._was_running = self._was_running - running, running
        return [task for task in self.tasks.all if task.path in ended], bool(running)
