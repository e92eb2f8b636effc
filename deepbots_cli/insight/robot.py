"""The simulation as a robot: a world that sends the measurements of its sensors over a link, and whose motors
follow the commands that arrive.

The link replaces the channels of the scenario, and commands reach the motors as on a robot: the computations
of robot controllers under `apply` do not run. The readings of the world that the policy uses are sent too, as
by a tracker. The reward and the endings are those of the scenario; terms that use the action read the action
that the policy sends beside its commands, else the middle of its range.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from statistics import fmean
from typing import Any

import numpy as np
from gymnasium import spaces

from deepbots_cli import api
from deepbots_cli.codegen.robot import sampled_sensors
from deepbots_cli.document import Permissions
from deepbots_cli.errors import UsageError
from deepbots_cli.expressions.scalar import Const, EngineRead, Name, Scalar, State
from deepbots_cli.insight.export.devices import Reading, Readings, Watch, output, with_probes
from deepbots_cli.program import Program, generated, identity
from deepbots_cli.program.robots import Robot, Route
from deepbots_cli.program.topics import mapping, sensor_fields
from deepbots_cli.rollout import Driver, Episode, Start, play
from deepbots_cli.rollout.drivers import zero_action
from deepbots_cli.runtime import Supervisor
from deepbots_cli.words import counted, number_text, rate_text
from deepbots_robot.link import About, Link, pace
from deepbots_robot.model import Output
from deepbots_robot.server import Input, Intake
from deepbots_robot.serving import ServeError, Transport, field_of, mapped, outputs_of_entries
from deepbots_robot.topics import ACTION

AGAIN = 0.25
"""The time without an answer, in s, after which a robot that waits sends its sensors again."""
SILENT_STEPS = 5
"""The number of steps without a command after which the simulated robot prints a note."""
_LAST = 1.0
"""The time that a robot waits for an answer to the last values of an episode, in s."""
MOST_REMARKS = 100
PATIENCE = 60.0
"""The time that a robot waits for the first command of an episode, and in lockstep for every command, in
s."""


# What a robot sends


def robot_program(program: Program) -> Program:
    """Return the scenario without the parts that the link replaces: messages arrive at once, and none is
    lost.

    Raises:
        UsageError: The scenario has copies of a robot.
    """
    if program.agent.copies is not None:
        raise UsageError(
            f"{program.name} has copies of a robot (`agent.each`), which cannot be served one by one"
        )
    moved = program.agent.robots
    robots = tuple(
        replace(robot, to_route=Route(), from_route=Route()) if robot.name in moved else robot
        for robot in program.robots
    )
    return replace(program, robots=robots, timing="immediate")


def sent_readings(program: Program) -> list[Reading]:
    """Return the readings that a robot sends: its sensors, and the readings of the world that a policy of the
    scenario uses. `program` is a result of `robot_program`.

    Raises:
        UsageError: A policy needs values between two actions.
    """
    describe = Readings(program)
    moved = [robot for robot in program.robots if robot.name in program.agent.robots]
    sampled = {robot.name: sampled_sensors(program, robot) for robot in moved}
    sensors = ((robot, sensor) for robot in moved for sensor in robot.sensors)
    readings = [
        describe.sensor(robot, sensor)
        for robot, sensor in sensors
        if sensor.is_direct or sensor.name in sampled[robot.name]
    ]
    nodes = describe.deployment.nodes
    if program.action_repeat > 1 and any(isinstance(node, State) for _, node in nodes):
        raise UsageError(
            f"{program.name} has `action_repeat: {program.action_repeat}` and an observation with a memory:"
            " its bundle needs values in"
            " every timestep, and a simulated robot sends them once per action"
        )
    readings += [
        reading for robot, node in nodes if (reading := _reading(program, describe, robot, node)) is not None
    ]
    return [*{reading.info.name: reading for reading in readings}.values()]


def _reading(program: Program, describe: Readings, robot: Robot | None, node: Scalar) -> Reading | None:
    """Return the reading that a robot sends for a node of an expression, of its own or of the supervisor."""
    parameters = describe.deployment.definitions.parameters
    match node:
        case EngineRead("age" | "message_received"):
            return replace(describe.of_world(node)[0], trees=(_of_channel(program, node),))
        case EngineRead() if node in describe.direct:
            return describe.sensor(*describe.direct[node][:2])
        case EngineRead():
            return describe.of_world(node)[0]
        case Name(name) if robot is not None:
            return next(
                (describe.sensor(robot, sensor) for sensor in robot.sensors if sensor.name == name), None
            )
        case Name(name) if name in parameters:
            return describe.parameter(parameters[name])
    return None


def _of_channel(program: Program, leaf: EngineRead) -> Scalar:
    """Return the age of a sensor, as its robot sends it. The values themselves are new in every step."""
    robot, _, sensor = leaf.subjects[0].partition(".")
    fields = {
        f"{entry.name}.{name}": f"{entry.name}.{field}"
        for entry in program.robots
        for name, field in entry.ages
    }
    return Name(fields[f"{robot}.{sensor}"]) if sensor else Const(leaf.function == "message_received")


# The robot


class SimulatedRobot(Driver):
    """Drives an environment by the commands that come over a link.

    In real time a step lasts a period of the policy divided by `speed`, and the newest commands are obeyed;
    the time of an episode begins with its first command. With `lockstep` each step waits for commands that
    answer its sensors.
    """

    note = "commands of a policy at the other end of a link"

    def __init__(
        self,
        environment: Supervisor,
        readings: Sequence[Reading],
        outputs: Sequence[Output],
        link: Link,
        *,
        lockstep: bool = False,
        speed: float = 1.0,
        patience: float = PATIENCE,
        note: Callable[[str], object] = lambda text: None,
    ) -> None:
        """Create the robot. `environment` is made from `with_probes(robot_program(program), readings)`."""
        super().__init__(lambda _: self._action)
        self.link = link
        self.answers: list[float] = []
        self.steps = self.late_steps = self.held_steps = self.episodes = 0
        self.intake = Intake([_without_limits(entry) for entry in outputs], speed=None)
        self._limits = {entry.field.name: (entry.low, entry.high) for entry in outputs_of_entries(outputs)}
        self._lockstep, self._patience = lockstep, patience
        self._period = environment.scenario.period / speed
        self._space = environment.action_space
        self._action = self._still = zero_action(self._space)
        self._watch = Watch(environment, readings, ())
        self._obeyed: dict[str, list[float]] = {}
        self._first, self._due = True, 0.0
        self._note, self._silent_steps = note, 0
        self._reported_kinds: set[str] = set()
        self._looked_at = -np.inf
        for robot in {entry.robot for entry in outputs}:
            self._take_over(environment, robot)

    def _take_over(self, environment: Supervisor, robot: str) -> None:
        """Make the motors of a robot follow the commands of the link instead of the messages of the
        supervisor."""
        controller = environment.controllers[robot]
        drives = [
            (f"{robot}.{entry.name}", getattr(controller, generated.drive(entry.name)))
            for entry in controller.spec.commands
        ]

        def obey(_message: Any) -> None:
            for name, drive in drives:
                if name in self._obeyed:
                    drive(self._obeyed[name])

        controller.use_message_data = obey  # type: ignore[attr-defined]

    def begin(self, start: Start) -> None:
        """Forget the commands of the last episode. Until the first new one, the motors keep their commands of
        a reset."""
        self._obeyed = {}
        self._action = self._still
        self._first = True

    def act(self, observation: Any) -> Any:
        if self._first:
            self._announce()
        sent, stamp = time.monotonic(), time.time()
        values = self._watch.inputs()
        self.link.send(values, stamp)
        self.steps += 1
        if self._lockstep or self._first:
            # In real time, commands have the time of the policy.
            self._wait_for_answer(values, sent, stamp if self._lockstep else -np.inf)
        if self._first:
            self._due = time.monotonic() + self._period
        if not self._lockstep:
            self._follow(None if self._first else sent)
        self._first = False
        return super().act(observation)

    def finish(self) -> None:
        """Send the result of the last step of an episode, if the other end scores it. The other end answers
        before the next episode begins."""
        if any(other.scores for other in self.link.others()):
            self._obeyed = {}
            sent, stamp = time.monotonic(), time.time()
            self.link.send(self._watch.inputs(), stamp)
            while (
                not self._received(None, stamp if self._lockstep else -np.inf)
                and time.monotonic() < sent + _LAST
            ):
                self.link.wait(0.1)

    def _announce(self) -> None:
        """Announce the beginning of an episode to a connected policy."""
        until = time.monotonic() + self._patience
        while not self.link.connected():
            self._look()
            if time.monotonic() > until:
                raise UsageError(
                    f"nobody listens on {self.link.name}; start the policy first: deepbots serve BUNDLE"
                )
            time.sleep(0.01)
        # Commands that answer the last episode may still have arrived since.
        self.link.take()
        self.link.reset(self.episodes, time.time())
        self.episodes += 1

    def _wait_for_answer(self, values: Mapping[str, Any], sent: float, since: float) -> None:
        """Wait for commands that are not older than `since`. The values are sent again if none come."""
        again = sent + AGAIN
        while not self._received(sent, since):
            self._look()
            now = time.monotonic()
            if now > sent + self._patience:
                refused = "; ".join(self.intake.examples.values()) or "is the policy one of this scenario?"
                raise UsageError(
                    f"no command came within {self._patience:g} s on {self.link.name}: {refused}"
                )
            if now > again:
                self.link.send(values, time.time() if since == -np.inf else since)
                again = now + AGAIN
            self.link.wait(max(0.0, again - now))

    def _look(self) -> None:
        """Report misfits at the other end, each sentence once.

        Raises:
            UsageError: The other end cannot be used at all.
        """
        self._looked_at = time.monotonic()
        for remark in self.link.remarks():
            if remark.is_misfit:
                raise UsageError(remark.text)
            if remark.text not in self._reported_kinds and len(self._reported_kinds) < MOST_REMARKS:
                self._reported_kinds.add(remark.text)
                self._note(remark.text)

    def _follow(self, sent: float | None) -> None:
        """Take commands until the step is due; the newest ones are used. `sent` is None if the values that
        were sent are already answered."""
        answered = sent is None
        is_late = time.monotonic() > self._due
        while True:
            answered |= self._received(None if answered else sent, -np.inf)
            left = self._due - time.monotonic()
            if left <= 0.0:
                break
            self.link.wait(left)
        self.held_steps += not answered
        if answered and self._silent_steps >= SILENT_STEPS:
            self._note("commands come again")
        self._silent_steps = 0 if answered else self._silent_steps + 1
        if self._silent_steps == SILENT_STEPS:
            self._note(f"no command for {SILENT_STEPS} steps: the motors keep the last one")
        if time.monotonic() > self._looked_at + 1.0:
            self._look()
        self.late_steps += is_late
        # A robot that is late does not catch up by faster steps.
        self._due = (time.monotonic() if is_late else self._due) + self._period

    def _received(self, sent: float | None, since: float) -> bool:
        """Follow the commands that have arrived. Returns whether there is now a command of each actuator that
        answers the sent values."""
        for arrival in self.link.take():
            # A stamp in whole nanoseconds may lie just before `since`, a float.
            if arrival.kind == "fields" and (arrival.stamp is None or arrival.stamp >= since - 1e-6):
                if ACTION in arrival.fields and self._space.shape is not None:
                    self._action = _fitting(arrival.fields[ACTION], self._space, self._still)
                else:
                    refusal = self.intake.take(arrival, time.monotonic())
                    if (
                        refusal is not None
                        and not refusal.is_harmless
                        and refusal.kind not in self._reported_kinds
                    ):
                        self._reported_kinds.add(refusal.kind)
                        self._note(f"a command is refused: {arrival.source}: {refusal.text}")
        if not self.intake.complete():
            return False
        for name, value in self.intake.values().items():
            self._obeyed[name] = np.clip(value, *self._limits[name]).tolist()
        if sent is not None:
            self.answers.append(time.monotonic() - sent)
        return True


def _fitting(value: Any, space: Any, fallback: Any) -> Any:
    """Return an action of the space from the numbers of a message; `fallback` if they do not fit the
    space."""
    size = int(np.prod(space.shape))
    if value.size != size or not np.isfinite(value).all():
        return fallback
    if isinstance(space, spaces.Box):
        return np.clip(value.reshape(space.shape), space.low, space.high).astype(space.dtype)
    fitted = value.astype(np.int64).reshape(space.shape)[()]
    return fitted if space.contains(fitted) else fallback


def _without_limits(entry: Output) -> Input:
    """Return a command as an input of the robot, which takes any finite one and keeps it within its
    limits."""
    free = np.full(entry.shape, np.inf)
    return Input(field_of(entry), "float64", -free, free, np.inf)


def serve_robot(
    program: Program,
    transport: Transport,
    *,
    episodes: int | None = None,
    seed: int = 0,
    engine: str | None = None,
    lockstep: bool = False,
    speed: float = 1.0,
    patience: float = PATIENCE,
    permissions: Permissions = Permissions(),
    note: Callable[[str], object] = lambda text: None,
) -> Iterator[tuple[Episode, SimulatedRobot]]:
    """Run episode after episode, with the starts of an evaluation with this seed; without end if `episodes`
    is None.

    `note` is called with messages for the user, such as one about a policy that has become silent.

    Raises:
        UsageError: The link cannot be opened, or no command comes.
    """
    bare = robot_program(program)
    readings = sent_readings(bare)
    outputs = [
        output(bare, robot, command)
        for robot in bare.robots
        if robot.name in bare.agent.robots
        for command in robot.commands
    ]
    topics = mapping(program)
    sensors = {field.name: field for field in sensor_fields(program)}  # with the angles of scans
    try:
        sends = mapped(
            [sensors.get(reading.info.name) or field_of(reading.info) for reading in readings], topics
        )
        receives = mapped([field_of(entry) for entry in outputs], topics, commands=True)
        about = About(
            "robot",
            program.name,
            identity.task_digest(program),
            pace(lockstep=lockstep, speed=speed),
            rate=1.0 / bare.period,
        )
        link = transport.open(receives, sends, robot=True, about=about)
    except ServeError as error:
        raise UsageError(str(error)) from None
    with (
        closing(link),
        closing(
            api.build(with_probes(bare, readings), engine=engine, permissions=permissions)
        ) as environment,
    ):
        robot = SimulatedRobot(
            environment, readings, outputs, link, lockstep=lockstep, speed=speed, patience=patience, note=note
        )
        number = 0
        while episodes is None or number < episodes:
            episode = play(environment, robot, Start.of_evaluation(seed, number))
            robot.finish()
            yield episode, robot
            number += 1


# The report


def report(episodes: Sequence[Episode], robot: SimulatedRobot, *, success_defined: bool) -> dict[str, Any]:
    """Return the results of the episodes, and the times of commands in s, from sending sensors to the last of
    their commands."""
    answers = np.array(robot.answers or [np.nan])
    endings = Counter(episode.ended_by for episode in episodes)
    return {
        "link": robot.link.name,
        "episodes": len(episodes),
        "success_rate": fmean(episode.is_success for episode in episodes) if success_defined else None,
        "mean_return": fmean(episode.total_return for episode in episodes),
        "endings": dict(endings.most_common()),
        "steps": robot.steps,
        "steps_without_new_command": robot.held_steps,
        "late_steps": robot.late_steps,
        "answer_median": float(np.median(answers)),
        "answer_p99": float(np.quantile(answers, 0.99)),
        "answer_max": float(answers.max()),
        "refused": dict(robot.intake.refused),
    }


def report_lines(record: Mapping[str, Any]) -> list[str]:
    """Return the lines of a report for people."""
    rate = "" if record["success_rate"] is None else f", success {rate_text(record['success_rate'], 1)}"
    endings = ", ".join(f"{count} {name}" for name, count in record["endings"].items())
    times = ", ".join(f"{word} {record[key] * 1e3:.2f} ms" for word, key in _TIMES.items())
    held_steps, late_steps = record["steps_without_new_command"], record["late_steps"]
    return [
        record["link"],
        f"  episodes  {record['episodes']:,}{rate}, mean return {number_text(record['mean_return'], 6)};"
        " ended by:"
        f" {endings}",
        f"  steps     {record['steps']:,}; {held_steps:,} without a new command, {late_steps:,} that began"
        " late",
        f"  answer    {times}",
        *(f"  refused   {counted(count, 'command')}: {kind}" for kind, count in record["refused"].items()),
    ]


_TIMES = {"median": "answer_median", "99th percentile": "answer_p99", "longest": "answer_max"}
