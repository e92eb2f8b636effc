"""Episodes on a robot at the other end of a link. The supervisor scores the measurements, and drivers act as
in the simulation.

The environment is that of the scenario, whose engine does not step: it sends the commands of a step, and
waits for the next measurements of the robot. Measurements replace the state of the simulated world wherever
an expression reads it. Reward terms and endings that need other facts are left out. `deepbots_robot.server`
keeps time, checks messages and limits commands, as for a bundle; the environment runs in its own thread,
since a step of it ends with the next message of the robot.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from functools import partial
from queue import SimpleQueue
from typing import Any

import numpy as np

from deepbots_cli import api, rollout
from deepbots_cli.document import Permissions
from deepbots_cli.errors import UsageError
from deepbots_cli.expressions.scalar import Const, EngineRead, Name, Scalar
from deepbots_cli.insight.export.devices import Reading, Watch, output
from deepbots_cli.insight.robot import robot_program, sent_readings
from deepbots_cli.port import (
    ClearanceReader,
    ContactReader,
    Engine,
    EngineProxy,
    ForceReader,
    JointReader,
    MotionReader,
    Part,
    PoseReader,
    TorqueReader,
    VelocityReader,
)
from deepbots_cli.program import Program, identity
from deepbots_cli.program.identity import Deployment
from deepbots_cli.program.topics import mapping
from deepbots_cli.rollout import Driver, Episode, Start
from deepbots_cli.rollout.episode import Step
from deepbots_cli.runtime import Supervisor
from deepbots_robot.link import About, pace
from deepbots_robot.server import Server
from deepbots_robot.serving import (
    Notes,
    ServeError,
    Transport,
    field_of,
    inputs_of_entries,
    mapped,
    outputs_of_entries,
    stopping,
    until,
)
from deepbots_robot.topics import ACTION, action_field

RESET_BY_ROBOT = "robot_reset"
"""The `ended_by` of an episode in which the robot began the next one."""
SILENT = "robot_silent"
"""The `ended_by` of an episode in which the robot stopped sending values."""
_OF_LINES = ("cross_track_error", "arc_length")
"""The facts that follow from the position of a body."""
_OVERLAID = (
    "position",
    "orientation",
    "velocity",
    "angular_velocity",
    "joint_position",
    "joint_velocity",
    "joint_torque",
    "contact",
    "collided",
    "contact_force",
    "clearance",
)
_XYZW = "xyzw"

Fact = tuple[str, tuple[str, ...], str | None]
"""A function of the world, the parts that it is about, and the component."""


# What can be measured


class Measurable:
    """The reward terms, endings and scripts of a program that need only measured facts."""

    def __init__(self, program: Program, readings: Sequence[Reading]) -> None:
        self._deployment = Deployment(program)
        self._changing = {value.name for value in program.parameters if value.redraw is not None}
        self._facts = {fact for reading in readings for fact in self.facts_by_number(reading) if fact}

    def facts_by_number(self, reading: Reading) -> Iterator[Fact | None]:
        """Yield the fact that each number of a reading measures; None if it measures none."""
        for tree in reading.trees:
            if isinstance(tree, EngineRead) and tree.function in _OVERLAID:
                yield self.fact(tree)
            else:
                yield None

    def fact(self, read: EngineRead) -> Fact:
        return read.function, self._deployment.subjects(read), read.component

    def missing(self, trees: Sequence[Scalar]) -> list[str]:
        """Return the names of the facts behind expressions that nothing measures, in order of first use."""
        missing: dict[str, None] = {}
        for robot, node in self._deployment.definitions.nodes(trees):
            if isinstance(node, EngineRead) and robot is None and not self._is_measured(node):
                missing[self._deployment.name(node)] = None
            elif isinstance(node, Name) and node.name in self._changing:
                missing[f"{node.name} after it changes"] = None
        return [*missing]

    def _is_measured(self, read: EngineRead) -> bool:
        if read.function in ("age", "message_received"):
            return True
        if read.function in _OF_LINES:
            return all(
                ("position", self._deployment.subjects(read)[:1], axis) in self._facts for axis in "xyz"
            )
        return self.fact(read) in self._facts


def scored(program: Program, readings: Sequence[Reading]) -> tuple[Program, list[str]]:
    """Return the program without the reward terms and endings that nothing measures, and a sentence for each
    of them.

    If no term is left, the first one is 0.
    """
    measurable = Measurable(program, readings)
    lacks = {
        f"reward.{term.name}": measurable.missing(term.scalars)
        for term in program.agent.reward
        if term.foreign is None
    }
    lacks |= {
        f"termination.{ending.name}": measurable.missing(ending.scalars)
        for ending in program.endings
        if ending.foreign is None
    }
    dropped = {name: lacking for name, lacking in lacks.items() if lacking}
    rewards = tuple(term for term in program.agent.reward if f"reward.{term.name}" not in dropped)
    if not rewards:
        rewards = (replace(program.agent.reward[0], lowered=(Const(0.0),)),)
    endings = tuple(ending for ending in program.endings if f"termination.{ending.name}" not in dropped)
    names = {ending.name for ending in endings}
    program = program.with_agent(
        reward=rewards,
        success=tuple(name for name in program.agent.success if name in names),
    )
    notes = [f"{name} is left out: nothing measures {_listed(lacking)}" for name, lacking in dropped.items()]
    return replace(program, endings=endings), notes


def _listed(names: Sequence[str], most: int = 3) -> str:
    return ", ".join(names[:most]) + (f", and {len(names) - most} more" if len(names) > most else "")


# The world as messages describe it


class MeasuredWorld(EngineProxy):
    """An engine whose steps are those of the robot, and in which measured facts replace simulated ones."""

    def __init__(self, engine: Engine, program: Program, step: Callable[[], None]) -> None:
        super().__init__(engine)
        self.facts: dict[Fact, Any] = {}
        self._step, self._repeat, self._calls = step, program.action_repeat, 0
        self._runs = False
        self._roots = {f"{body.name}.{body.model.root}": body.name for body in program.world.robots}

    def reset(self) -> None:
        self._runs = False  # the robot does not move in steps of the reset, in which a simulated one settles
        super().reset()

    def begin(self) -> None:
        """Begin an episode, after the reset is done."""
        self._runs, self._calls = True, 0

    def step(self, substeps: int) -> None:
        self._calls += 1
        if self._runs and self._calls % self._repeat == 0:
            self._step()

    def _name(self, body: str, link: str | None = None) -> str:
        name = f"{body}.{link}" if link else body
        return self._roots.get(name, name)

    def _vector(self, function: str, name: str, numbers: Sequence[float]) -> Any:
        return tuple(
            self.facts.get((function, (name,), component), number)
            # A position has three numbers, a quaternion four.
            for component, number in zip(_XYZW, numbers, strict=False)
        )

    def pose(self, body: str, link: str | None = None) -> PoseReader:
        read, name = super().pose(body, link), self._name(body, link)
        return lambda: self._posed(name, *read())

    def _posed(self, name: str, position: Any, orientation: Any) -> Any:
        return self._vector("position", name, position), self._vector("orientation", name, orientation)

    def velocity(self, body: str, link: str | None = None) -> VelocityReader:
        read, name = super().velocity(body, link), self._name(body, link)
        return lambda: self._moving(name, *read())

    def _moving(self, name: str, velocity: Any, turning: Any) -> Any:
        return self._vector("velocity", name, velocity), self._vector("angular_velocity", name, turning)

    def motion(self, body: str, link: str | None = None) -> MotionReader:
        pose, velocity = self.pose(body, link), self.velocity(body, link)
        return lambda: (pose(), velocity())

    def joint_states(self, robot: str, joints: Sequence[str]) -> JointReader:
        read, names = super().joint_states(robot, joints), [(f"{robot}.{joint}",) for joint in joints]
        get = self.facts.get
        return lambda: [
            (
                get(("joint_position", name, None), row[0]),
                get(("joint_velocity", name, None), row[1]),
                *row[2:],
            )
            for name, row in zip(names, read(), strict=True)
        ]

    def joint_torques(self, robot: str, joints: Sequence[str]) -> TorqueReader:
        read, names = super().joint_torques(robot, joints), [(f"{robot}.{joint}",) for joint in joints]
        return lambda: [
            self.facts.get(("joint_torque", name, None), torque)
            for name, torque in zip(names, read(), strict=True)
        ]

    def contact(
        self, one: Part, others: Sequence[Part] | None = None, *, ground: bool = True
    ) -> ContactReader:
        read = super().contact(one, others, ground=ground)
        names = (self._name(*one), *(self._name(*other) for other in others or ()))
        return lambda: self._fact("contact" if others else "collided", names, read)

    def contact_force(self, one: Part) -> ForceReader:
        read, names = super().contact_force(one), (self._name(*one),)
        return lambda: self._fact("contact_force", names, read)

    def clearance(self, one: Part, other: Part) -> ClearanceReader:
        read, names = super().clearance(one, other), (self._name(*one), self._name(*other))
        return lambda: self._fact("clearance", names, read)

    def _fact(self, function: str, names: tuple[str, ...], read: Callable[[], Any]) -> Any:
        fact = self.facts.get((function, names, None))
        return read() if fact is None else fact


class _LinkClosed(Exception):  # noqa: N818  not an error
    """The end of the link."""


class RobotEpisodes:
    """Episodes of an environment whose steps are those of a robot; the `Policy` of a `Server`.

    Each `step` passes the measurements to the environment, and returns the commands of its next step; None
    while no episode runs. An episode begins with the first values, and a further one when the robot begins
    it.
    """

    def __init__(
        self, program: Program, readings: Sequence[Reading], *, engine: str | None, permissions: Permissions
    ) -> None:
        self._measured, self._answers = SimpleQueue[Any](), SimpleQueue[Any]()
        self._readings = readings
        self._measurable = Measurable(program, readings)
        self._restarted, self._is_silent = False, False
        self._action: Any = None
        self._thread: threading.Thread | None = None
        self.done: list[Episode] = []
        self.error: BaseException | None = None
        self.is_over = False
        """Whether all episodes have ended."""

        def wrap(engine: Engine) -> Engine:
            return MeasuredWorld(engine, program, self._exchange)

        self.environment: Supervisor = api.build(program, engine=engine, permissions=permissions, wrap=wrap)
        assert isinstance(self.environment.engine, MeasuredWorld)
        self._world = self.environment.engine
        outputs = [
            output(program, robot, command)
            for robot in program.robots
            if robot.name in program.agent.robots
            for command in robot.commands
        ]
        self.outputs = outputs
        self._watch = Watch(self.environment, (), outputs)
        for drive in self._watch.drives:
            drive.switch(notes=True, acts=False)
        self._devices = {
            reading.info.name: self.environment.controllers[reading.device[0]].device(reading.device[1])
            for reading in readings
            if reading.device is not None
        }
        self._values: Mapping[str, Any] = {}
        for name, device in self._devices.items():
            device.follow(partial(self._of_device, name))

    # In the thread of the server

    def begin(
        self, driver: Driver, *, count: int, seed: int, options: Mapping[str, Any], max_steps: int | None
    ) -> None:
        """Let `driver` act in so many episodes, once the robot sends values."""
        arguments = (driver, count, seed, options, max_steps)
        self._thread = threading.Thread(target=self._run, args=arguments, daemon=True)
        self._thread.start()

    def step(self, values: Mapping[str, Any]) -> Mapping[str, Any] | None:
        if self.is_over:
            return None
        self._measured.put(dict(values))
        answer: Mapping[str, Any] | None = self._answers.get()
        return answer

    def reset(self) -> None:
        self._measured.put(None)

    def close(self, *, is_silent: bool = False) -> None:
        """End a running episode. It counts as an episode if it ends because the robot `is_silent`."""
        self._is_silent = is_silent
        # The first entry ends the step that waits for values, the second the wait for another episode.
        self._measured.put(None if is_silent else _LinkClosed())
        self._measured.put(_LinkClosed())
        if self._thread is not None:
            self._thread.join(5.0)

    # In the thread of the environment

    def _run(
        self, driver: Driver, count: int, seed: int, options: Mapping[str, Any], max_steps: int | None
    ) -> None:
        left = max_steps
        try:
            for number in range(count):
                self._take(self._first_values(waiting=number > 0 and not self._restarted))
                self._restarted = False
                start = Start(seed if number == 0 else None, {**self._goals(), **options})
                steps = self._until_restart(
                    rollout.steps(self.environment, self._noting(driver), start), left
                )
                episode = rollout.result_of(steps, start.seed)
                if self._is_silent:
                    cut = SILENT
                elif self._restarted:
                    cut = RESET_BY_ROBOT
                else:
                    cut = "--steps"
                self.done.append(episode if episode.ended_by else replace(episode, ended_by=cut))
                left = None if left is None else left - episode.length
                if left == 0 or self._is_silent:
                    break
                if number + 1 < count and not self._restarted:
                    self._answers.put(None)
        except _LinkClosed:
            pass
        except BaseException as error:  # noqa: BLE001  it is raised again where the server runs
            self.error = error
        self.is_over = True
        self._answers.put(None)

    def _until_restart(self, steps: Iterator[Step], most: int | None) -> Iterator[Step]:
        for step in steps:
            if not step.number:
                self._world.begin()
            yield step
            if (self._restarted and not step.is_last) or step.number == most:
                return

    def _noting(self, driver: Driver) -> Driver:
        """Return the driver, whose action is sent beside the commands."""

        def act(observation: Any) -> Any:
            self._action = driver.act(observation)
            return self._action

        noting = Driver(act)
        noting.begin = driver.begin  # type: ignore[method-assign]
        return noting

    def _first_values(self, *, waiting: bool) -> Mapping[str, Any]:
        """Return the values at the start of an episode. With `waiting`, the robot has to begin it, and gets
        no commands until then."""
        while True:
            values = self._measured.get()
            if isinstance(values, _LinkClosed):
                raise values
            if values is None:
                waiting = False
            elif waiting:
                self._answers.put(None)
            else:
                return dict(values)

    def _exchange(self) -> None:
        """Make a step of the robot: send the commands, and wait for its next measurements. Nothing changes if
        it starts again."""
        action = (
            {} if isinstance(self._action, dict) else {ACTION: np.asarray(self._action, float).reshape(-1)}
        )
        self._answers.put({**action, **self._watch.commands()})
        values = self._measured.get()
        if isinstance(values, _LinkClosed):
            raise values
        if values is None:
            self._restarted = True
        else:
            self._take(values)

    def _take(self, values: Mapping[str, Any]) -> None:
        self._values = values
        for reading in self._readings:
            if reading.device is None and reading.info.name in values:
                numbers = np.asarray(values[reading.info.name]).reshape(-1).tolist()
                facts = zip(self._measurable.facts_by_number(reading), numbers, strict=True)
                self._world.facts.update((fact, number) for fact, number in facts if fact is not None)

    def _of_device(self, name: str) -> Sequence[Any]:
        value = self._values[name]
        return (value,) if value.dtype == np.uint8 else value.reshape(-1).tolist()

    def _goals(self) -> dict[str, Any]:
        """Return the values of inputs with the source `goal`, as options of `reset`."""
        goals = {}
        for reading in self._readings:
            if reading.info.source == "goal" and reading.info.name in self._values:
                numbers = self._values[reading.info.name].tolist()
                goals[reading.info.name] = numbers if reading.info.components else numbers[0]
        return goals


class _Silence:
    """Called in every turn of a server; returns whether the robot is silent.

    Raises:
        UsageError: The fields of the other end do not fit.
    """

    def __init__(self, server: Server, seconds: float) -> None:
        self._server, self._seconds = server, seconds
        self._received, self._since = 0, time.monotonic()
        self.is_over = False
        """Whether the robot was silent for too long."""

    def __call__(self) -> bool:
        misfit = next((remark.text for remark in self._server.link.remarks() if remark.is_misfit), "")
        if misfit:
            raise UsageError(misfit)
        if self._server.intake.received != self._received:
            self._received, self._since = self._server.intake.received, time.monotonic()
        self.is_over = time.monotonic() > self._since + self._seconds
        return self.is_over


def try_robot(
    program: Program,
    transport: Transport,
    make_driver: Callable[[Supervisor], Driver],
    *,
    episodes: int = 1,
    seed: int = 0,
    options: Mapping[str, Any] | None = None,
    max_steps: int | None = None,
    seconds: float = 60.0,
    lockstep: bool = False,
    speed: float = 1.0,
    engine: str | None = None,
    permissions: Permissions = Permissions(),
    note: Callable[[str], object] = lambda text: None,
) -> tuple[list[Episode], dict[str, Any]]:
    """Run episodes on a robot. Returns the episodes that ended, and the report of the server.

    Args:
        make_driver: Returns the driver for the environment.
        seconds: The longest silence of the robot, in s.

    Raises:
        UsageError: The link cannot be opened, the robot is silent, or it does not fit the scenario.
    """
    bare = robot_program(program)
    readings = sent_readings(bare)
    scored_program, notes = scored(bare, readings)
    topics = mapping(program)
    player = RobotEpisodes(scored_program, readings, engine=engine, permissions=permissions)
    with closing(player.environment):
        driver = make_driver(player.environment)
        outputs = outputs_of_entries(player.outputs)
        inputs = inputs_of_entries(
            [reading.info for reading in readings], 1.0 / bare.period, needs_goals=False
        )
        try:
            receives = mapped([field_of(reading.info) for reading in readings], topics)
            sends = [
                action_field(len(program.agent.choices) or len(program.agent.range_names)),
                *mapped([entry.field for entry in outputs], topics, commands=True),
            ]
            about = About(
                "policy",
                program.name,
                identity.task_digest(program),
                pace(lockstep=lockstep, speed=speed),
                rate=1.0 / bare.period,
                scores=True,
            )
            link = transport.open(receives, sends, robot=False, about=about)
        except ServeError as error:
            raise UsageError(str(error)) from None
        for text in notes:
            note(text)
        with closing(link), stopping() as stopped:
            server = Server(
                player,
                inputs,
                outputs,
                link,
                1.0 / bare.period,
                lockstep=lockstep,
                speed=speed,
                log=Notes(None, note),
            )
            note(f"{program.name} acts at {1.0 / bare.period:g} Hz over {link.name}")
            player.begin(driver, count=episodes, seed=seed, options=options or {}, max_steps=max_steps)
            silence, is_stopped = _Silence(server, seconds), until(stopped, None, server, note)
            try:
                server.run(lambda: is_stopped() or player.is_over or silence())
            finally:
                player.close(is_silent=silence.is_over)
            if stopped():
                raise KeyboardInterrupt
        if player.error is not None:
            raise player.error
        if not player.done:
            missing = ", ".join(server.intake.missing()[:5])
            raise UsageError(f"no value of {missing or 'any input'} came in {seconds:g} s over {link.name}")
        return player.done, server.report()
