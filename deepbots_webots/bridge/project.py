"""The scenario of an exported project, compiled, with its generated classes: a supervisor in a world of
Webots, whose robots are controllers of their own.

The supervisor and each robot have a controller with the generated code; messages go through emitters and
receivers. A message of the supervisor acts in the next timestep, and the supervisor gets the message that a
robot made one timestep ago, as with `timing: delayed` of a scenario.

At the start of an episode, the supervisor sends each robot a first message: the seed of its random streams,
and its first readings by the engine of the supervisor. So robot and supervisor begin with the same values.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any, cast

from deepbots_cli import api, engines
from deepbots_cli.codegen import load_module
from deepbots_cli.codegen.names import class_name
from deepbots_cli.codegen.robot import controller_names
from deepbots_cli.port import Engine, EngineProxy
from deepbots_cli.program import Program
from deepbots_cli.program.robots import Direction, Robot
from deepbots_cli.program.world import WorldModel
from deepbots_cli.records import dataclass
from deepbots_cli.runtime import RobotController, Supervisor
from deepbots_cli.runtime.actuation import SupervisedRobots
from deepbots_cli.runtime.copies import copy_name, make_environment, world_with_copies
from deepbots_cli.runtime.messages import FieldCodec
from deepbots_cli.runtime.streams import Streams
from deepbots_webots.bridge.mirror import MirrorEngine

START = "start"
"""The first cell of the message that begins an episode."""


class ReaderLog(EngineProxy):
    """The engine as a robot controller binds it; remembers calls and readers in their order."""

    def __init__(self, engine: Engine) -> None:
        super().__init__(engine)
        self.calls: list[tuple[str, tuple[Any, ...], dict[str, Any]]] = []
        """The name, the arguments and the keywords of each call."""
        self.readers: list[Callable[[], Any]] = []

    def _pass(self, method: str, parts: int, *args: Any, **kwargs: Any) -> Any:
        self.calls.append((method, args, kwargs))
        return super()._pass(method, parts, *args, **kwargs)

    def bound(self, read: Callable[..., Any]) -> Any:
        self.readers.append(read)
        return read

    def readings(self) -> list[Any]:
        """Return the value of each reader."""
        return [read() for read in self.readers]


class RemoteRobot:
    """A robot whose controller is another program: the supervisor's side of it.

    The first message of an episode is made here, with the readings that the engine of the supervisor has.
    """

    def __init__(self, controller: Any, log: ReaderLog) -> None:
        """Take the generated controller, which is bound to the log."""
        self.controller, self.log = controller, log
        self.start: list[object] | None = None
        """The message that begins an episode, until it is sent."""
        self._is_first = False
        self._streams: Streams | None = None

    def __getattr__(self, name: str) -> Any:
        return getattr(self.controller, name)

    def begin(self, streams: Streams) -> None:
        values = {
            "root": streams.root,
            "copy": streams.copy,
            "anew": streams is not self._streams,
            "readings": self.log.readings(),
        }
        self.start = [START, *json.dumps(values, default=lambda array: array.tolist()).split(",")]
        self._streams = streams
        self.controller.begin(streams)
        self._is_first = True

    def create_message(self) -> Any:
        """Return the first message of an episode; None afterwards, when the robot makes its messages."""
        if not self._is_first:
            return None
        self._is_first = False
        return self.controller.create_message()

    def observe(self) -> None:
        """Do nothing: the robot reads its sensors."""

    def hold(self) -> None:
        """Do nothing: the robot holds its joints when the world begins again."""

    release = hold

    def use_message_data(self, message: Any) -> None:
        """Do nothing: the robot acts on its messages."""


class ToRobot:
    """The path of messages to a robot."""

    def __init__(self, wire: FieldCodec) -> None:
        self._wire = wire
        self.outbox: list[str] = []

    def begin(self, _streams: Streams) -> None:
        self.outbox.clear()

    def send(self, message: Sequence[Any]) -> None:
        self.outbox.append(self._wire.encode(message))

    def receive(self) -> list[Any]:
        """Return nothing: the robot receives its messages."""
        return []


class FromRobot:
    """The path of messages from a robot."""

    def __init__(self, wire: FieldCodec, timestep: float) -> None:
        self._wire = wire
        self.latest: str = wire.silence
        self.message_received = False
        self.age = 0.0
        self._timestep = timestep

    def begin(self, _streams: Streams) -> None:
        self.age = 0.0

    def send(self, message: Sequence[Any] | None) -> None:
        """Take the first message of an episode, which the supervisor makes."""
        if message is not None:
            self.take(self._wire.encode(message))

    def take(self, text: str | None) -> None:
        """Take the message of a timestep, or none."""
        self.message_received = text is not None
        if text is not None:
            self.latest, self.age = text, self._timestep

    def newest(self) -> Sequence[Any]:
        return self._wire.decode(self.latest)


class HasWebotsRobots(SupervisedRobots):
    """What a generated supervisor of robots in Webots has in place of controllers and channels."""

    has_varied_sensors = False
    """Whether an episode has drawn a fault of a sensor, which robots do not get."""

    def vary_sensor(self, robot: str, sensor: str, fault: str, values: Sequence[float]) -> None:
        self.has_varied_sensors = True
        super().vary_sensor(robot, sensor, fault, values)

    def begin_robots(self, streams: Streams) -> None:
        super().begin_robots(streams)
        engine = self.engine
        while isinstance(engine, EngineProxy):
            if isinstance(engine, MirrorEngine):
                engine.is_starting = False
            engine = engine.engine

    def robot(self, name: str, controller: type[Any]) -> Any:
        log = ReaderLog(self.engine)
        spec = self._spec(name)
        remote = RemoteRobot(controller(spec, self.scenario, log), log)
        self.controllers[name] = remote  # type: ignore[assignment]
        return remote

    def lossy_channel(self, name: str, direction: Direction) -> Any:
        spec, is_to_robot = self._spec(name), direction == "to_robot"
        layout = spec.to_robot if is_to_robot else spec.from_robot
        wire = FieldCodec(layout, self.scenario.format, self._rejected)
        channel = ToRobot(wire) if is_to_robot else FromRobot(wire, self.scenario.world.timestep)
        self.channels[name, direction] = channel  # type: ignore[assignment]
        return channel


def exchange(host: Any, task: Supervisor, step: Callable[[], None]) -> Callable[[], None]:
    """Return the function that lets a timestep pass: it sends, steps, and receives."""
    lines = list(lines_of(task))

    def advance() -> None:
        starting = []
        for robot, remote, outward, _ in lines:
            if remote.start is not None:
                host.send_to(robot, remote.start)
                starting.append(robot)
                remote.start = None
            for text in outward.outbox:
                host.send_to(robot, text.split(","))
            outward.outbox.clear()
        step()
        for robot, _, _, inward in lines:
            newest = None
            # The queue is emptied: a message that is left would be a timestep late in all further steps.
            while (cells := host.receive_from(robot)) is not None:
                newest = cells
            # Messages that arrive in the first timestep were sent before the world was placed.
            inward.take(None if newest is None or robot in starting else ",".join(newest))

    return advance


def lines_of(task: Supervisor) -> Any:
    """Yield each robot of the world with its two paths."""
    for copy, agent in task.agents.items():
        copies = task.scenario.agent.copies
        for name, remote in agent.controllers.items():
            if not isinstance(remote, RemoteRobot):
                continue
            of_copy = copies is not None and name == copies.robot
            outward, inward = agent.channels[name, "to_robot"], agent.channels[name, "from_robot"]
            yield (copy if of_copy else name), remote, outward, inward


SCENARIO, MODULE = "scenario.yaml", "environment.py"


@dataclass(frozen=True, eq=False)
class Project:
    """A compiled scenario, and the classes of its module by name."""

    program: Program
    classes: dict[str, Any]

    @property
    def world(self) -> WorldModel:
        """The world, with the copies of a robot."""
        copies = self.program.agent.copies
        return self.program.world if copies is None else world_with_copies(self.program.world, copies)

    @property
    def robots(self) -> dict[str, Robot]:
        """The robots by their names in the world, in the order of their channels."""
        copies = self.program.agent.copies
        robots: dict[str, Robot] = {}
        for robot in self.program.robots:
            if copies is not None and robot.name == copies.robot:
                robots |= {copy_name(copies, number + 1): robot for number in range(copies.count)}
            else:
                robots[robot.name] = robot
        return robots

    @property
    def timestep_ms(self) -> int:
        return round(self.program.world.timestep * 1000)

    def controller_class(self, robot: Robot) -> type[RobotController]:
        """Return the generated class of a robot."""
        return cast("type[RobotController]", self.classes[controller_names(self.program)[robot.name]])

    def supervisor(self, engine: Engine) -> Supervisor:
        """Return the generated supervisor over an engine, with robots that are controllers of their own."""
        kind = self.classes[f"{class_name(self.program.name)}Supervisor"]
        bridged = type(kind.__name__, (HasWebotsRobots, kind), {"__doc__": kind.__doc__})
        return make_environment(bridged, self.program, lambda _: engine)

    def task(self, supervisor: Any) -> Supervisor:
        """Return the environment of the scenario in the world of a Webots supervisor, the class in
        `webots_environment.py`, which sends by `send_to` and receives by `receive_from`."""
        mirror = MirrorEngine(engines.create("mujoco", self.world), supervisor, self.world)
        task = self.supervisor(mirror)
        mirror.let_timestep_pass = exchange(supervisor, task, mirror.wait)
        return task


@cache
def load_project(folder: Path) -> Project:
    """Return the project whose scenario and module are in a folder.

    Raises:
        ScenarioError: The scenario has errors.
    """
    compiled = api.compile(folder / SCENARIO)
    path = folder / MODULE
    module = load_module(path.read_text("utf-8"), path.stem, str(path))
    return Project(compiled.program, vars(module))


def project_of(compiled: api.Compiled) -> Project:
    """Return the project of a compiled scenario, with the module that deepbots generates."""
    module = load_module(compiled.code, MODULE.partition(".")[0], f"<deepbots {compiled.program.name}>")
    return Project(compiled.program, vars(module))
