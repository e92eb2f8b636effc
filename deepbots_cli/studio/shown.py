"""What the page shows: whose robot, which tab, which curve, which output, which notice, and what is starting.

All browsers render from this one object. The process of the robot says of which source its world is; files
say what a training has reached.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Literal, get_args

from deepbots_cli.rollout.drivers import POLICY
from deepbots_cli.studio.commands import Commands
from deepbots_cli.studio.robot import Robot
from deepbots_cli.studio.tasks import Task
from deepbots_cli.studio.trainings import WatchedTraining

Topic = Literal["text", "findings", "files", "robot", "task", "training", "runs", "notice", "tab"]
Tab = Literal["Train", "Runs", "Commands"]
TABS: tuple[Tab, ...] = get_args(Tab)


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
        self.follows = False
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
            self.say(f"the robot has started again, with {changes or 'the saved text'}")
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
        return self.training is not None and self.trains and not self.training.curves.returns

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
        for task in ended:
            if self.training is not None:
                self.training.watch_again()
            self.say(self._commands.end_of(task))
        if ended or runs:
            self._tell("task")
        training = self.training
        if training is None:
            return
        if reads and training.is_due(is_running=self.trains):
            await asyncio.to_thread(training.read)
            self._tell("training")
        if training.path == self._awaited and training.listed is not None:
            self.show_robot(training.path)
