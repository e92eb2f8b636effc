"""The simulation as a robot: a world that sends what its sensors measure over a link, and whose motors obey the commands that come.

The link takes the place of the scenario's channels, and commands reach the motors as on a robot: what robot controllers compute under
`apply` does not run. The reward and the endings are those of the scenario.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from deepbots_cli.errors import UsageError
from deepbots_cli.program import Program
from deepbots_cli.program.robots import Route
from deepbots_cli.program.topics import command_fields, sensor_fields
from deepbots_cli.rollout.drivers import zero_action
from deepbots_cli.rollout.episode import Driver, Episode, Start, play
from deepbots_robot.intake import Input, Intake
from deepbots_robot.link import Link
from deepbots_robot.topics import Field

if TYPE_CHECKING:
    from deepbots_cli.runtime import Supervisor
    from deepbots_cli.runtime.supervisor import RobotController

AGAIN = 0.25
"""Seconds without an answer after which the robot that waits sends its sensors again."""
PATIENCE = 60.0
"""Seconds that the robot waits for the first command of an episode, and in lockstep for every command."""

Reader = Callable[[], Any]


def robot_program(program: Program) -> Program:
    """The scenario without what the link replaces: messages come at once, and none is lost.

    Raises:
        UsageError: The scenario has copies of a robot.
    """
    if program.agent.copies is not None:
        raise UsageError(f"{program.name} has copies of a robot, which cannot be served; set `agent.each` aside or choose another scenario")
    robots = tuple(replace(robot, to_route=Route()) if robot.name in program.agent.robots else robot for robot in program.robots)
    return replace(program, robots=robots, timing="immediate")


class SimulatedRobot(Driver):
    """Drives an environment of `robot_program` by the commands that come over a link.

    In real time a step lasts `program.period / speed`, and the newest commands are obeyed; the time of an episode begins with its first
    command. With `lockstep` each step waits for commands that answer its sensors.
    """

    note = "commands of a policy at the other end of a link"

    def __init__(
        self, environment: Supervisor, link: Link, *, lockstep: bool = False, speed: float = 1.0, patience: float = PATIENCE
    ) -> None:
        super().__init__(lambda _: self._still)
        self.link = link
        self.answers: list[float] = []
        self.late_steps = self.held_steps = self.episodes = 0
        self._lockstep, self._patience = lockstep, patience
        self._period = environment.scenario.period / speed
        self._still = zero_action(environment.action_space)
        self._readers = sensor_readers(environment)
        self._commands = {field.name: field for field in command_fields(environment.scenario)}
        self.intake = Intake([_command(field) for field in self._commands.values()], speed=None)
        self._obeyed: dict[str, Sequence[float]] = {}
        self._first, self._due = True, 0.0
        for name in environment.scenario.agent.robots:
            self._take_over(environment.controllers[name])

    def _take_over(self, controller: RobotController) -> None:
        """Let the motors of a robot follow the commands of the link instead of the messages of the supervisor."""
        prefix = controller.spec.name
        drives = [(f"{prefix}.{entry.name}", getattr(controller, f"drive_{entry.name}")) for entry in controller.spec.commands]

        def obey(_message: Any) -> None:
            for name, drive in drives:
                if name in self._obeyed:
                    drive(self._obeyed[name])

        controller.use_message_data = obey  # type: ignore[attr-defined]

    def begin(self, start: Start) -> None:
        """Forget the commands of the last episode: until the first new one the motors hold what they hold at a reset."""
        self._obeyed = {}
        self._first = True

    def act(self, observation: Any) -> Any:
        if self._first:
            self.link.take()
            self.link.reset(self.episodes, time.time())
            self.intake.begin(time.time())
            self.episodes += 1
        sent, stamp = time.monotonic(), time.time()
        values = {name: read() for name, read in self._readers.items()}
        self.link.send(values, stamp)
        if self._lockstep or self._first:
            self._wait_for_answer(values, sent, stamp)
            self._due = time.monotonic() + self._period - (time.monotonic() - sent)
        else:
            self._follow(sent)
        self._first = False
        return super().act(observation)

    def _wait_for_answer(self, values: Mapping[str, Any], sent: float, stamp: float) -> None:
        again = sent + AGAIN
        while not self._received(sent, stamp):
            now = time.monotonic()
            if now > sent + self._patience:
                raise UsageError(
                    f"no command came within {self._patience:g} s on {self.link.name}; start the policy with `deepbots serve BUNDLE`"
                )
            if now > again:
                self.link.send(values, stamp)
                again = now + AGAIN
            self.link.wait(min(AGAIN, again - now))

    def _follow(self, sent: float) -> None:
        """Take commands until the step is due; the newest ones count."""
        answered = False
        while True:
            answered |= self._received(sent, 0.0) if not answered else self._received(None, 0.0)
            left = self._due - time.monotonic()
            if left <= 0.0:
                break
            self.link.wait(left)
        self.held_steps += not answered
        self.late_steps += left < -self._period
        self._due = max(self._due + self._period, time.monotonic())

    def _received(self, sent: float | None, stamp: float) -> bool:
        """Obey what has come; whether there is now an answer of each actuator to what was sent."""
        for arrival in self.link.take():
            if arrival.kind == "fields" and (arrival.stamp is None or arrival.stamp >= stamp - 1e-6):
                self.intake.take(arrival, time.monotonic())
        if not self.intake.complete():
            return False
        for name, value in self.intake.values().items():
            self._obeyed[name] = value.tolist()
        if sent is not None:
            self.answers.append(time.monotonic() - sent)
        return True


def serve_robot(environment: Supervisor, robot: SimulatedRobot, seed: int, episodes: int | None) -> Iterator[Episode]:
    """Episode after episode, with the starts of an evaluation; without end if `episodes` is None.

    Raises:
        UsageError: No command comes.
    """
    number = 0
    while episodes is None or number < episodes:
        yield play(environment, robot, Start.of_evaluation(seed, number))
        number += 1


def sensor_readers(environment: Supervisor) -> dict[str, Reader]:
    """What reads each sensor of the robots that the agent moves, in the shape of its field."""
    readers: dict[str, Reader] = {}
    robots = {robot.name: robot for robot in environment.scenario.robots}
    for field in sensor_fields(environment.scenario):
        controller = environment.controllers[field.robot]
        sensor = next(each for each in robots[field.robot].sensors if f"{field.robot}.{each.name}" == field.name)
        if sensor.name in controller.devices:
            readers[field.name] = _delivered(controller.devices[sensor.name], field)
        elif sensor.is_direct:
            readers[field.name] = _present(environment, controller, sensor, field)
    return readers


def _delivered(device: Any, field: Field) -> Reader:
    dtype = np.uint8 if field.is_picture else float
    return lambda: np.asarray(device.reading, dtype).reshape(field.shape)


def _present(environment: Supervisor, controller: RobotController, sensor: Any, field: Field) -> Reader:
    """A sensor without errors, which the generated code reads from the engine."""
    from deepbots_cli.runtime.sensing import instrument

    read = instrument(sensor, field.robot, environment.world, environment.engine).read
    return lambda: np.asarray(read(), float).reshape(field.shape)


def _command(field: Field) -> Input:
    free = np.full(field.shape, np.inf)
    return Input(field, "float64", -free, free, np.inf)
