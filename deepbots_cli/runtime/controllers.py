"""The robots of a world: their controllers, which read their sensors and act on messages, and the paths of
messages."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, TypeVar

from deepbots_cli.errors import MessageError
from deepbots_cli.port import Engine, MotorWriter
from deepbots_cli.program import Program, generated
from deepbots_cli.program.robots import Actuator, CustomActuator, Direction, MessageLayout, Motor, Robot
from deepbots_cli.runtime.actuation import CustomMotor, Site
from deepbots_cli.runtime.formulas import Memories, Memory, memory_of_vector
from deepbots_cli.runtime.messages import Channel, FieldCodec, LossyChannel, layout_error
from deepbots_cli.runtime.readers import sees
from deepbots_cli.runtime.sensing import Device, instrument
from deepbots_cli.runtime.streams import Streams

C = TypeVar("C", bound="RobotController")
M = TypeVar("M", bound=Memory)


class WithMemories:
    """Memories of stateful functions, which a new episode clears; `timestep` is in s."""

    def __init__(self, timestep: float) -> None:
        self._timestep = timestep
        self._memories: list[Memory | Memories] = []

    def memory(self, kind: type[M], *, on_message: bool = False) -> M:
        """Return a memory that begins at the reset, or else with the first message (`on_message`)."""
        memory = kind(self._timestep, on_message=on_message)
        self._memories.append(memory)
        return memory

    def memories(self, kind: type[Memory], count: int, *, on_message: bool = False) -> Memory | Memories:
        """Return one memory for each component of a vector."""
        memory = memory_of_vector(kind, count, self._timestep, on_message=on_message)
        self._memories.append(memory)
        return memory

    def clear_memories(self) -> None:
        for memory in self._memories:
            memory.reset()


class RobotController(WithMemories):
    """Base of the generated robot classes.

    A generated class adds `bind`, which takes its readers and writers from the engine, and the paper's
    pair: `use_message_data(message)` drives the actuators by the fields of a message, and `create_message()`
    reads the sensors into the fields of one. Channels encode and decode.
    """

    def __init__(self, spec: Robot, scenario: Program, engine: Engine) -> None:
        super().__init__(scenario.world.timestep)
        self.spec = spec
        self.devices: dict[str, Device] = {}
        self._world = scenario.world
        self._engine = engine
        self.bind(engine)
        drives = [
            (actuator, getattr(self, generated.drive(actuator.name), None)) for actuator in spec.actuators
        ]
        driven = [(actuator, drive) for actuator, drive in drives if drive is not None]
        self._holds: list[Callable[[], object]] = [
            drive.hold if hasattr(drive, "hold") else partial(_hold, engine, spec.name, actuator, drive)
            for actuator, drive in driven
        ]
        # Actuators with `hold` have a state of their own.
        self._releases = [drive.reset for _, drive in driven if hasattr(drive, "hold")]

    def bind(self, engine: Engine) -> None:
        """Take readers and writers from the engine; called once."""

    def device(self, name: str) -> Device:
        """Return the device behind a sensor, made on first use."""
        if name not in self.devices:
            sensor = next(sensor for sensor in self.spec.sensors if sensor.name == name)
            device = instrument(sensor, self.spec.name, self._world, self._engine)
            self.devices[name] = Device(sensor, self.spec.name, device, self._world.timestep)
        return self.devices[name]

    def actuator(self, name: str) -> CustomMotor:
        """Return an actuator of a plug-in's kind."""
        actuator = next(actuator for actuator in self.spec.actuators if actuator.name == name)
        assert isinstance(actuator, CustomActuator)  # generated code uses no other
        return CustomMotor(
            Site(self._engine, self.spec.name, actuator, self._world.timestep / self._world.substeps)
        )

    def sees(self, sensor: str, body: str) -> Callable[[], bool]:
        """Return whether the newest picture of a camera shows the body."""
        return sees(self.device(sensor), body)

    def begin(self, streams: Streams) -> None:
        """Begin an episode: discard earlier readings and take the first ones."""
        for device in self.devices.values():
            device.reset(streams)
        self.clear_memories()
        self.reset()

    def reset(self) -> None:
        """Begin the values computed on board with the first readings, and with actions of zeros."""

    def observe(self) -> None:
        """Sample the sensors that are sampled once per timestep."""

    def release(self) -> None:
        """Set the values of the actuators for this episode and discard their commands: they exert nothing
        until `hold`."""
        for release in self._releases:
            release()

    def hold(self) -> None:
        """Hold all driven joints in their reset state until the first command takes effect."""
        for hold in self._holds:
            hold()


def _hold(engine: Engine, robot: str, actuator: Actuator, drive: MotorWriter) -> None:
    """Keep the joints of a plain motor where they are; a motor that commands torques lets its joints go."""
    if isinstance(actuator, Motor) and actuator.kind == "velocity_motor":
        drive((0.0,) * len(actuator.joints))
    elif isinstance(actuator, Motor) and actuator.kind == "position_motor":
        drive([state[0] for state in engine.joint_states(robot, actuator.joints)()])


class SupervisedRobots(WithMemories):
    """The robots of a supervisor, which `bind` makes: their controllers, and the paths of messages."""

    step_count: int

    def __init__(self, scenario: Program, engine: Engine) -> None:
        super().__init__(scenario.world.timestep)
        self.scenario = scenario
        self.engine = engine
        self.controllers: dict[str, RobotController] = {}
        self.channels: dict[tuple[str, Direction], Channel | LossyChannel] = {}
        """The paths of messages, by robot and direction."""
        self.links: dict[tuple[str, str], LossyChannel] = {}
        """The paths of messages between robots, by sender and receiver."""

    def bind(self, engine: Engine) -> None:
        """Take readers from the engine."""

    def robot(self, name: str, controller: type[C]) -> C:
        """Return the controller of a robot."""
        robot_controller = controller(self._spec(name), self.scenario, self.engine)
        self.controllers[name] = robot_controller
        return robot_controller

    def channel(self, name: str, direction: Direction) -> Channel:
        """Return the path of messages to or from a robot, if it is direct."""
        spec = self._spec(name)
        channel = Channel(
            FieldCodec(
                spec.to_robot if direction == "to_robot" else spec.from_robot,
                self.scenario.format,
                self._rejected,
            )
        )
        self.channels[name, direction] = channel
        return channel

    def lossy_channel(self, name: str, direction: Direction) -> LossyChannel:
        """Return the path of messages to or from a robot, where messages come late or may be lost."""
        robot = self._spec(name)
        to_robot = direction == "to_robot"
        route, layout = (robot.to_route, robot.to_robot) if to_robot else (robot.from_route, robot.from_robot)
        channel = LossyChannel(
            f"{name}.{direction}",
            route,
            self.scenario.world.timestep,
            1 if self.scenario.timing == "delayed" else 0,
            self.engine.pose(name),
            FieldCodec(layout, self.scenario.format, self._rejected),
            first_at_once=not to_robot,
        )
        self.channels[name, direction] = channel
        return channel

    def link(self, sender: str, receiver: str) -> LossyChannel:
        """Return the path of messages from one robot to another, which take at least a timestep."""
        spec = next(
            link for link in self.scenario.links if (link.sender, link.receiver) == (sender, receiver)
        )
        sender_pose, receiver_pose = self.engine.pose(sender), self.engine.pose(receiver)

        def apart() -> tuple[tuple[float, float, float], Any]:
            (a, _), (b, _) = sender_pose(), receiver_pose()
            return (b[0] - a[0], b[1] - a[1], b[2] - a[2]), None

        channel = LossyChannel(
            f"{sender}.to_{receiver}",
            spec.route,
            self.scenario.world.timestep,
            1,
            apart,
            FieldCodec(spec.layout, self.scenario.format, self._rejected),
            first_at_once=True,
        )
        self.links[sender, receiver] = channel
        return channel

    def _spec(self, name: str) -> Robot:
        return next(robot for robot in self.scenario.robots if robot.name == name)

    def begin_robots(self, streams: Streams) -> None:
        """Make controllers, channels and memories forget the last episode."""
        for part in (*self.controllers.values(), *self.channels.values(), *self.links.values()):
            part.begin(streams)
        self.clear_memories()

    def vary_sensor(self, robot: str, sensor: str, fault: str, values: Sequence[float]) -> None:
        """Set the values of a sensor fault for this episode. A sensor that nothing reads has no device."""
        controller = self.controllers[robot]
        if sensor in controller.devices:
            controller.devices[sensor].vary(fault, values)

    def set_joints(
        self, robot: str, joints: Sequence[str], positions: Sequence[float], velocities: Sequence[float] = ()
    ) -> None:
        """Set the start positions (rad or m) and velocities (rad/s or m/s) of joints, at rest without
        them."""
        for joint, position, velocity in zip(
            joints, positions, velocities or (0.0,) * len(joints), strict=True
        ):
            self.engine.set_joint(robot, joint, position, velocity)

    def set_walls(self, bodies: Sequence[str], friction: float) -> None:
        """Let several bodies, such as the walls around an arena, have the same coefficient of friction."""
        for body in bodies:
            self.engine.set_parameter("lateral_friction", (body, ""), friction)

    def _rejected(self, layout: MessageLayout, message: Any) -> MessageError:
        self.engine.require_finite()  # not every format can carry values that are not finite
        return layout_error(layout, self.scenario.format, message, self.step_count)
