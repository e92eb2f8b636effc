"""The robot controller: reads its sensors, acts on messages, knows nothing else of the world."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Protocol, TypeVar, runtime_checkable

from deepbots_cli.port import Engine, MotorWriter
from deepbots_cli.program import Program
from deepbots_cli.program.robots import Actuator, CustomActuator, Motor, Robot
from deepbots_cli.runtime.actuation import CustomMotor, Site
from deepbots_cli.runtime.formulas import Memories, Memory
from deepbots_cli.runtime.readers import sees
from deepbots_cli.runtime.sensing import Device, instrument
from deepbots_cli.runtime.streams import Streams

M = TypeVar("M", bound=Memory)


@runtime_checkable
class Drive(Protocol):
    """An actuator with a state of its own."""

    def reset(self) -> None:
        """As before the first command: it exerts nothing."""

    def hold(self) -> None:
        """Keep what it drives where it is, as far as it can."""


class RobotController:
    """Base of the generated robot classes.

    A generated class adds `bind`, which takes its readers and writers from the engine, and the paper's
    pair: `use_message_data(message)` drives the actuators by the fields of a message, and `create_message()`
    reads the sensors into the fields of one. Channels encode and decode.
    """

    def __init__(self, spec: Robot, scenario: Program, engine: Engine) -> None:
        self.spec = spec
        self.devices: dict[str, Device] = {}
        self._world, self._engine = scenario.world, engine
        self._memories: list[Memory | Memories] = []
        self.bind(engine)
        drives = [(actuator, getattr(self, f"drive_{actuator.name}", None)) for actuator in spec.actuators]
        found = [(actuator, drive) for actuator, drive in drives if drive is not None]
        # Each look at a protocol takes as long as a physics step of a light robot.
        self._holds: list[Callable[[], object]] = [
            drive.hold if isinstance(drive, Drive) else partial(_hold, engine, spec.name, actuator, drive) for actuator, drive in found
        ]
        self._releases = [drive.reset for _, drive in found if isinstance(drive, Drive)]

    def bind(self, engine: Engine) -> None:
        """Take readers and writers from the engine; called once."""

    def device(self, name: str) -> Device:
        """The device behind a sensor, made when it is first asked for."""
        if name not in self.devices:
            sensor = next(sensor for sensor in self.spec.sensors if sensor.name == name)
            made = instrument(sensor, self.spec.name, self._world, self._engine)
            self.devices[name] = Device(sensor, self.spec.name, made, self._world.timestep)
        return self.devices[name]

    def actuator(self, name: str) -> CustomMotor:
        """An actuator of a plug-in's kind."""
        actuator = next(actuator for actuator in self.spec.actuators if actuator.name == name)
        assert isinstance(actuator, CustomActuator)  # generated code asks for no other
        return CustomMotor(Site(self._engine, self.spec.name, actuator, self._world.timestep / self._world.substeps))

    def memory(self, kind: type[M]) -> M:
        """A memory that a new episode clears."""
        made = kind(self._world.timestep)
        self._memories.append(made)
        return made

    def memories(self, kind: type[Memory], count: int) -> Memories:
        """One memory for each component of a vector."""
        made = Memories(kind, count, self._world.timestep)
        self._memories.append(made)
        return made

    def sees(self, sensor: str, body: str) -> Callable[[], bool]:
        """Whether the newest picture of a camera shows the body."""
        return sees(self.device(sensor), body)

    def begin(self, streams: Streams) -> None:
        """Begin an episode: first readings are taken, and nothing is left of earlier ones."""
        for device in self.devices.values():
            device.reset(streams)
        for memory in self._memories:
            memory.reset()
        self.reset()

    def reset(self) -> None:
        """Begin what is computed on board with the first readings, and with messages of zeros."""

    def observe(self) -> None:
        """Sample what is sampled once per tick."""

    def release(self) -> None:
        """Let the actuators take the figures of this episode and forget their commands: they exert nothing until `hold`."""
        for release in self._releases:
            release()

    def hold(self) -> None:
        """Hold everything that is driven in its reset state until the first command takes effect."""
        for hold in self._holds:
            hold()


def _hold(engine: Engine, robot: str, actuator: Actuator, drive: MotorWriter) -> None:
    """Keep what a plain motor drives where it is; one that commands torques lets its joints go."""
    if isinstance(actuator, Motor) and actuator.kind == "velocity_motor":
        drive((0.0,) * len(actuator.joints))
    elif isinstance(actuator, Motor) and actuator.kind == "position_motor":
        drive([state[0] for state in engine.joint_states(robot, actuator.joints)()])
