"""The state of the studio, free of the page: open files, findings, robot, tasks and runs; what the page
shows.

All browsers show the same session. It lives in the thread of the server's event loop; what takes time runs
in threads or processes. `Shown` is what all pages render: whose robot, which tab, which curve, which output,
which notice, and what is starting. The process of the robot says of which source its world is; files say what
a training has reached.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal, get_args

from deepbots_cli.course.grading import PROGRESS_NAME
from deepbots_cli.course.marking import StepMark
from deepbots_cli.document import Permissions
from deepbots_cli.errors import DeepbotsError, UsageError
from deepbots_cli.files import file_stamps
from deepbots_cli.learning.campaigns.changes import RunChange, RunChanges
from deepbots_cli.learning.campaigns.listing import ListedRun, list_runs
from deepbots_cli.rollout.drivers import POLICY
from deepbots_cli.studio.commands import RUNS_FOLDER, STUDIO_FOLDER, Commands, Task
from deepbots_cli.studio.files import OpenFile, changed_lines, difference, read_text
from deepbots_cli.studio.language import Language, written_parameters
from deepbots_cli.studio.robot import Robot
from deepbots_cli.studio.trainings import WatchedTraining

_WATCH_INTERVAL_S = 0.5
_RUNS_INTERVAL_S = 5.0
_SUFFIXES = (".yaml", ".yml")
_MAX_FILES = 500

Topic = Literal["text", "findings", "files", "robot", "task", "training", "runs", "notice", "tab"]
Tab = Literal["Lesson", "Train", "Runs", "Commands"]
TABS: tuple[Tab, ...] = get_args(Tab)
Listener = Callable[[Topic], None]
HAS_ERRORS = "the scenario has errors; correct them first"


class Shown:
    """What the page shows.

    Attributes:
        tab: The open tab.
        notice: The last message for the person; empty once it was withdrawn.
        is_warning: Whether the notice is the error of something that the person did.
        task: The command whose output the tab *Commands* shows, if any.
        training: The training whose curve is shown, if any.
        follows: Whether the robot shows each training that begins. Otherwise it shows one that begins while
            the robot shows a policy.
    """

    def __init__(self, robot: Robot, commands: Commands, tell: Callable[[Topic], None]) -> None:
        """`tell` is called after each change, with what has changed."""
        self._robot, self._commands, self._tell = robot, commands, tell
        self.tab: Tab = "Train"
        self.notice, self.is_warning = "", False
        self.task: Task | None = None
        self.training: WatchedTraining | None = None
        self.follows = True
        self._awaited: Path | None = None
        """The training that the robot is to show once its run exists."""
        self._restarts = False
        """Whether a notice is to say that the robot of a saved text has started."""
        self._problem = ""

    # Notices and tabs

    def say(self, sentence: str, *, is_warning: bool = False) -> None:
        """Show a message on all pages."""
        self.notice, self.is_warning = sentence, is_warning
        self._tell("notice")

    def withdraw(self, sentence: str | None = None) -> None:
        """Remove a message that no longer holds, if it is the one that is shown; by default, any."""
        if self.notice and sentence in (None, self.notice):
            self.say("")

    def open_tab(self, tab: Tab) -> None:
        if tab != self.tab:
            self.tab = tab
            self._tell("tab")

    # The robot

    @property
    def source(self) -> str:
        """The scenario or run whose robot is shown, or is loaded first; empty for none."""
        state = self._robot.state
        return (state.reference if state is not None else "") or self._robot.reference

    @property
    def robot_starts(self) -> bool:
        """Whether a robot is to come, and there is none to look at."""
        robot = self._robot
        return bool(robot.reference) and not robot.problem and (robot.state is None or robot.is_late)

    def show_robot(self, reference: Path) -> None:
        """Show the robot of a scenario or a run."""
        self._awaited, self._restarts = None, False
        self._robot.show(reference)

    def restart_robot(self, scenario: Path, changed: tuple[str, ...]) -> None:
        """Show the robot of the saved text, in place of any other one; the parameters `changed` take the
        values of the text. While the text has errors, the robot before stays."""
        self._awaited, self._restarts = None, True
        self._robot.save(scenario, changed)

    def robot_changed(self) -> None:
        """Take the news of the process of the robot."""
        robot, problem = self._robot, self._problem
        self._problem = robot.problem
        if robot.problem and robot.problem != problem:
            self.say(robot.problem)
        state = robot.state
        if self._restarts and state is not None and robot.is_current:
            self._restarts = False
            changes = state.changes.replace(" -> ", " → ")
            self.say(
                "the robot has started again, with "
                + (changes if 0 < len(changes.split()) < 7 else "the saved text")
            )
        self._tell("robot")

    # Trainings

    @property
    def training_task(self) -> Task | None:
        """The newest command that trains the shown run."""
        if self.training is None:
            return None
        run, trained = self.training.path, self._commands.trained_run
        return next((task for task in reversed(self._commands.tasks.all) if trained(task) == run), None)

    @property
    def trains(self) -> bool:
        """Whether a command trains the shown run."""
        task = self.training_task
        return task is not None and task.is_running

    @property
    def training_starts(self) -> bool:
        """Whether the shown run is trained, and has no curve yet."""
        return self.training is not None and self.trains and self.training.log is None

    @property
    def may_follow(self) -> bool:
        """Whether a training runs whose policy the robot does not show."""
        training = self.training
        if training is None or training.listed is None or not self.trains:
            return False
        return self._robot.reference != str(training.path)

    def follow(self, on: bool) -> None:
        """Begin or stop to follow the shown training and each later one. With `on` false, the shown robot
        stays."""
        self.follows = on
        self._awaited = self.training.path if on and self.training is not None else None
        self._tell("training")

    def started(self, task: Task) -> None:
        """Show the output of a command that was started; of a training, also the curve, and the robot if it
        is to follow."""
        self.show_task(task)
        run, state = self._commands.trained_run(task), self._robot.state
        if run is not None:
            self.show_training(run)
            follows = self.follows or (state is not None and state.driver == POLICY)
            self._awaited = run if follows else None

    def show_task(self, task: Task) -> None:
        """Show the output of a command."""
        self.task = task
        self._tell("task")

    def show_training(self, run: Path | None) -> None:
        """Show the curve of a run, or none."""
        self.training = None if run is None else WatchedTraining(run)
        self._tell("training")

    def show_newest_training(self, stem: str) -> None:
        """Show the curve of the newest training of the scenario with this name, unless a training runs."""
        if not self.trains:
            self.show_training(self._commands.newest_training(stem))

    def adopt_running(self) -> None:
        """Show what an earlier server has started and still runs."""
        for task in self._commands.tasks.running:
            self.show_task(task)
            if run := self._commands.trained_run(task):
                self.show_training(run)

    async def look(self, *, reads: bool) -> None:
        """Take the news of commands, and with `reads` those of the files of the training."""
        ended, runs = self._commands.look()
        if ended or runs:
            self._tell("task")
        for task in ended:
            if self.training is not None:
                self.training.watch_again()
            self.say(self._commands.end_of(task))
        training = self.training
        if training is None:
            return
        if reads and training.is_due(is_running=self.trains):
            await asyncio.to_thread(training.read)
            self._tell("training")
        if training.path == self._awaited and training.listed is not None:
            self.show_robot(training.path)


class Session:
    """The state of the studio of one folder.

    Attributes:
        folder: The folder, beyond which no file is opened but those that its scenarios read.
        state_folder: The folder of tasks, which need not exist.
        has_lesson: Whether a lesson was started in the folder.
        files: The open files by path, in the order of opening.
        current: The scenario that is edited, and that commands get.
        shown: What the page shows.
        robot, commands: The process of the robot, and the commands that run.
        runs: The runs of the folder, the newest last.
        run_changes: The start and the changes of each run, by its path.
        timesteps: The timesteps of the next training; empty for those of the file.
        marked: The marks of each step of a lesson, and what they are of.
    """

    def __init__(self, folder: Path, permissions: Permissions = Permissions()) -> None:
        self.folder = folder.resolve()
        self.permissions = permissions
        self.files: dict[Path, OpenFile] = {}
        self.current: Path | None = None
        self.robot = Robot(permissions, lambda: self.shown.robot_changed())
        self.commands = Commands(self.folder, permissions, self._started)
        self.shown = Shown(self.robot, self.commands, self._tell)
        self.has_lesson = (self.folder / PROGRESS_NAME).is_file()
        if self.has_lesson:
            self.shown.tab = "Lesson"
        self.runs: list[ListedRun] = []
        self.run_changes: dict[Path, RunChange] = {}
        self._changes = RunChanges()
        self.timesteps = ""
        self.marked: dict[str, tuple[StepMark, str]] = {}
        self._listeners: list[Listener] = []
        self._language: Language | None = None
        self.state_folder = self.folder / RUNS_FOLDER / STUDIO_FOLDER
        self._written: dict[tuple[Path, str], str] = {}
        self._texts: dict[Path, Mapping[Path, object]] = {}
        """The contents of the current scenario when each command about it began, by the path of its task."""
        self._stamps: Mapping[Path, object] = {}
        self._last_runs = 0.0
        self._entries: Mapping[Path, object] = {}

    @property
    def language(self) -> Language:
        if self._language is None:
            self._language = Language(self.permissions, lambda path: self._tell("findings"), self.shown.say)
        return self._language

    # Listeners

    def listen(self, listener: Listener) -> Callable[[], None]:
        """Call a function after each change, with its topic. Returns a function that removes the listener."""
        self._listeners.append(listener)
        return lambda: self._listeners.remove(listener) if listener in self._listeners else None

    def _tell(self, topic: Topic) -> None:
        for listener in list(self._listeners):
            listener(topic)

    # Files

    def scenarios(self) -> list[Path]:
        """Return the YAML files of the folder, without hidden folders and runs."""
        paths = []
        for path in sorted(self.folder.rglob("*")):
            inner = path.relative_to(self.folder).parts
            if any(part.startswith(".") or part in (RUNS_FOLDER, "__pycache__") for part in inner):
                continue
            if path.suffix in _SUFFIXES and self.may_open(path):
                paths.append(path)
            if len(paths) >= _MAX_FILES:
                break
        return paths

    def may_open(self, path: Path) -> bool:
        """Return whether a file is a scenario file of the folder, after following links."""
        real = _real_path(path)
        return real is not None and path.suffix in _SUFFIXES and real.is_relative_to(self.folder)

    def name_of(self, path: Path) -> str:
        """Return a file as the page names it: relative to the folder if it is in it."""
        return str(path.relative_to(self.folder)) if path.is_relative_to(self.folder) else path.name

    def open(self, path: Path) -> OpenFile:
        """Open a file.

        Raises:
            UsageError: It is outside of the folder and no scenario reads it, or it is not a text file.
        """
        path = self.folder / path
        real = _real_path(path)
        if real is not None and real in self.files:
            return self.files[real]
        is_read = any(real in self.language.files_of(other) for other in self.files)
        if real is None or (not self.may_open(path) and not is_read):
            raise UsageError(f"{path} is no scenario in {self.folder}; the studio opens no other files")
        file = self.files[real] = OpenFile.open(real, read_only=not real.is_relative_to(self.folder))
        self.language.update(file)
        self._tell("files")
        return file

    def show(self, path: Path) -> None:
        """Open a scenario, and show its robot."""
        file = self.open(path)
        if self.current != file.path:
            self.current = file.path
            self.timesteps = ""  # of the scenario before
            self.shown.show_newest_training(file.path.stem)
            self._written = self._saved_parameters()
            self.shown.show_robot(file.path)
        self._tell("files")

    def close_file(self, path: Path) -> None:
        """Close a file that is gone, or a file without unsaved changes."""
        file = self.files.get(path)
        if file is None or (file.is_modified and not file.is_gone):
            return
        del self.files[path]
        self.language.remove(path)
        if path == self.current:
            self.current = None
            others = [scenario for scenario in self.scenarios() if scenario != path]
            if others:
                self.show(others[0])
        self._tell("files")

    def change(self, file: OpenFile, revision: int, text: str) -> bool:
        """Take the text of a browser, as `OpenFile.change` does."""
        is_same = file.change(revision, text)
        self.edited(file)
        return is_same

    def edited(self, file: OpenFile) -> None:
        """Analyze and show a file that the studio has changed."""
        self.language.update(file)
        self._tell("text")

    def save(self, file: OpenFile) -> None:
        """Write a file, and restart the robot with it.

        Raises:
            UsageError: The file cannot be written, or another program has changed it.
        """
        try:
            file.save()
            self.language.update_all()
            self._restart_robot()
            self._stamps = file_stamps(self._watched())
        finally:
            self._tell("text")

    def _restart_robot(self) -> None:
        """Read the files of the robot again; parameters whose text has changed take the new text."""
        if self.current is None:
            return
        # The analysis of a text that was typed just now is not done yet.
        now = self._saved_parameters()
        changed = {
            name for (path, name), text in now.items() if self._written.get((path, name), text) != text
        }
        self._written = now
        self.shown.restart_robot(self.current, tuple(changed))

    def _saved_parameters(self) -> dict[tuple[Path, str], str]:
        """Return the parameters as they are written in each saved file that the current scenario reads."""
        if self.current is None:
            return {}
        parameters = {}
        for path in (self.current, *self.language.files_of(self.current)):
            with suppress(UsageError):
                text = self.files[path].saved if path in self.files else read_text(path)[0]
                parameters.update({(path, name): value for name, value in written_parameters(text).items()})
        return parameters

    def write_values(self, values: Mapping[str, str]) -> list[int]:
        """Write values into the text of the current scenario, by the path of each, such as `train.gamma`.
        Comments and layout stay.

        Returns:
            The changed lines of the new text, from 0.

        Raises:
            UsageError: There is no scenario, or a value has no place in its file.
        """
        file = self.files.get(self.current) if self.current is not None else None
        if file is None:
            raise UsageError("open a scenario first")
        draft = OpenFile(file.path, file.text)  # all values are written, or none
        for path, value in values.items():
            edit = self.language.assignment(draft, path, value)
            if edit is None:
                raise UsageError(f"{file.path.name} has no place for `{path}`; write it yourself")
            draft.edit([edit])
        if "train.total_timesteps" in values:
            self.timesteps = ""
        if draft.text == file.text:
            raise UsageError(f"{file.path.name} has these values already")
        lines = changed_lines(file.text, draft.text)
        file.edit([difference(file.text, draft.text)])
        self.edited(file)
        return lines

    # Commands

    def _started(self, task: Task) -> None:
        is_of_text = self.current is not None and self._current_name in task.record.words
        self._texts[task.path] = self._contents() if is_of_text else {}
        self.shown.started(task)

    def is_outdated(self, task: Task) -> bool:
        """Return whether a command was about the current scenario, whose text or robot has changed since."""
        now = self._contents()
        return any(now.get(path, was) != was for path, was in self._texts.get(task.path, {}).items())

    def _contents(self) -> dict[Path, object]:
        """Return the texts of the open files that the current scenario reads, and the stamps of its files
        that cannot be opened, such as robot files."""
        stamps = {
            path: each for path, each in file_stamps(self._watched()).items() if path.suffix not in _SUFFIXES
        }
        return stamps | {path: file.text for path, file in self.files.items() if path in self._watched()}

    async def picture(self) -> bytes:
        """Return a picture (PNG) of the shown scenario or run at the start of an episode; empty if there is
        none, for example because the scenario has errors."""
        if not self.shown.source:
            return b""
        with TemporaryDirectory() as folder:
            path = Path(folder, "robot.png")
            _, code = await self.commands.call(["render", self.shown.source, "-o", str(path)])
            return await asyncio.to_thread(path.read_bytes) if code == 0 else b""

    def saved_name(self) -> str:
        """Return the current scenario as commands get it: without errors, and saved with the files that it
        extends or includes.

        Raises:
            UsageError: There is none, or it has errors.
        """
        if self.current is None:
            raise UsageError("open a scenario first")
        # Right after a change, the command finds the errors itself.
        is_checked = self.language.checked_revision(self.current) == self.files[self.current].revision
        if is_checked and self.language.has_errors(self.current):
            raise UsageError(HAS_ERRORS)
        for path in (self.current, *self.language.files_of(self.current)):
            file = self.files.get(path)
            if file is not None and file.is_modified and not file.read_only:
                self.save(file)
        return self._current_name

    @property
    def _current_name(self) -> str:
        """The current scenario as commands get it."""
        name = self.name_of(self.current) if self.current is not None else ""
        return f"./{name}" if name.startswith("-") else name

    # Watching

    async def run_forever(self) -> None:
        """Watch files, tasks and trainings until it is canceled."""
        self.shown.adopt_running()
        while True:
            try:
                await self._look()
            except Exception as error:  # noqa: BLE001 - the page goes on, whatever fails
                sentence = str(error) if isinstance(error, DeepbotsError | OSError) else repr(error)
                if self.shown.notice != sentence:
                    self.shown.say(sentence)
            await asyncio.sleep(_WATCH_INTERVAL_S)

    async def _look(self) -> None:
        now = time.monotonic()
        self._look_at_files()
        if self._listeners and now - self._last_runs > _RUNS_INTERVAL_S:
            self._last_runs = now
            await self.read_runs()
        await self.shown.look(reads=bool(self._listeners))

    async def close(self) -> None:
        """End the robot. Commands go on."""
        if self._language is not None:
            self._language.close()
        self.robot.close()

    async def read_runs(self) -> None:
        """List the runs of the folder again."""
        runs = await asyncio.to_thread(list_runs, self.folder / RUNS_FOLDER)
        if runs != self.runs:
            self.runs = runs
            self._tell("runs")
            self.run_changes = await asyncio.to_thread(self._changes.read, runs)
            self._tell("runs")

    def _look_at_files(self) -> None:
        """Take changes of other programs."""
        changed = [file for file in self.files.values() if file.read_outside()]
        for file in changed:
            self.language.update(file)
        if changed:
            self._tell("text")
        entries = file_stamps([self.folder])
        if entries != self._entries:  # a file is new, or gone
            self._entries = entries
            self._tell("files")
        stamps = file_stamps(self._watched())
        # A finished analysis may name more files, which have not changed.
        if any(stamp != stamps.get(path, stamp) for path, stamp in self._stamps.items()):
            if not changed:
                self.language.update_all()
            self._restart_robot()
        self._stamps = stamps

    def _watched(self) -> frozenset[Path]:
        """Return the files that the current scenario reads."""
        if self.current is None:
            return frozenset()
        return frozenset({self.current, *self.language.inputs_of(self.current)})


def _real_path(path: Path) -> Path | None:
    """Return the path without links; None for links in a circle and names that no file has."""
    try:
        return path.resolve()
    except (OSError, RuntimeError, ValueError):
        return None
