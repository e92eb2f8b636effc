"""The robot follows a training: it shows the newest policy of it until the person saves a text."""

from __future__ import annotations

from pathlib import Path

from deepbots_cli.rollout.drivers import POLICY
from deepbots_cli.studio.commands import Commands
from deepbots_cli.studio.robot import Robot


class Following:
    """The training that the robot follows.

    Attributes:
        is_on: Whether the robot shows each training that begins. Otherwise it shows one that begins while the
            robot shows a policy.
    """

    def __init__(self, robot: Robot, commands: Commands) -> None:
        self._robot, self._commands = robot, commands
        self.is_on = False
        self._run: Path | None = None
        self._waits = False

    @property
    def is_offered(self) -> bool:
        """Whether a training runs whose policy the robot does not show."""
        training, task = self._commands.training, self._commands.training_task
        if training is None or training.listed is None or task is None or not task.is_running:
            return False
        return self._robot.reference != str(training.path)

    def begin(self, run: Path) -> None:
        """Follow a training that has been started, if the robot is to; it is shown once its run exists."""
        state = self._robot.state
        self._waits = self.is_on or (state is not None and state.driver == POLICY)
        self._run = run if self._waits else None

    def turn(self, on: bool) -> None:
        """Begin or stop to follow the shown training and each later one. With `on` false, the shown robot
        stays."""
        self.is_on = on
        if on and self._commands.training is not None:
            self.begin(self._commands.training.path)
        elif not on:
            self._waits = False

    def leave(self, scenario: Path | None) -> bool:
        """Show the scenario if the robot shows a training that it follows; return whether it did."""
        if self._run is None or scenario is None or self._robot.reference != str(self._run):
            return False
        self._run = None
        self._robot.show(scenario)
        return True

    def look(self) -> None:
        """Show the training as soon as it has begun."""
        training, run = self._commands.training, self._run
        has_begun = training is not None and training.path == run and training.listed is not None
        if self._waits and run is not None and has_begun:
            self._waits = False
            self._robot.show(run)
