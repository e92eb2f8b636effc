"""A generated robot controller on the devices of a robot in Webots."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from math import inf
from typing import Any

from deepbots_cli import frames
from deepbots_cli.errors import MessageError
from deepbots_cli.frames import Frame, Quaternion, Triple
from deepbots_cli.port import SERVO_TIME, MotorWriter, Part
from deepbots_cli.program.robots import MessageLayout
from deepbots_cli.runtime.messages import FieldCodec, layout_error
from deepbots_cli.runtime.streams import Streams
from deepbots_webots.bridge import names
from deepbots_webots.bridge.project import START, Project

Reader = Callable[[], Any]


class RobotDevices:
    """The devices of a robot in Webots, as the engine that a generated controller binds.

    `first` has the readings at the start of an episode, in the order in which the readers were bound; while
    it is set, readers return them.
    """

    def __init__(self, robot: Any, timestep: float, gravity: Triple) -> None:
        """Take the devices.

        Args:
            robot: The `controller.Robot`.
            timestep: The timestep of the scenario, s.
            gravity: m/s^2 in the world.
        """
        self.gravity = gravity
        self.first: list[Any] | None = None
        self._robot, self._timestep, self._period = robot, timestep, round(timestep * 1000)
        self._count = self._rays = 0
        self._joints: dict[str, _Joint] = {}
        self._frames: dict[str, _LinkSensors] = {}

    def device(self, name: str) -> Any:
        """Return a device.

        Raises:
            LookupError: The robot has none of this name.
        """
        device = self._robot.getDevice(name)
        if device is None:
            raise LookupError(f"the robot has no device '{name}'; export the scenario again")
        return device

    def sample(self) -> None:
        """Take over the positions of joints, once in each timestep."""
        for joint in self._joints.values():
            joint.sample()

    def start(self, readings: list[Any]) -> None:
        """Begin an episode with the readings of its start."""
        self.first = readings
        for joint in self._joints.values():
            reader, index = joint.reading
            position, velocity = readings[reader][index]
            joint.state = (position, velocity)

    def _bound(self, read: Reader) -> Reader:
        number = self._count
        self._count += 1
        return lambda: read() if self.first is None else _as_tuple(self.first[number])

    # Readers

    def joint_states(self, _robot: str, joints: Sequence[str]) -> Reader:
        sensors = [self._joint(joint) for joint in joints]
        for index, sensor in enumerate(sensors):
            sensor.reading = (self._count, index)
        return self._bound(lambda: [sensor.state for sensor in sensors])

    def joint_torques(self, _robot: str, joints: Sequence[str]) -> Reader:
        motors = [self.device(joint) for joint in joints]
        for motor in motors:
            motor.enableTorqueFeedback(self._period)
        return self._bound(lambda: [motor.getTorqueFeedback() for motor in motors])

    def pose(self, _body: str, link: str | None = None) -> Reader:
        sensors = self._link(link)
        return self._bound(lambda: (sensors.position(), sensors.orientation()))

    def velocity(self, _body: str, link: str | None = None) -> Reader:
        sensors = self._link(link)
        return self._bound(sensors.velocity)

    def motion(self, _body: str, link: str | None = None) -> Reader:
        sensors = self._link(link)
        return self._bound(lambda: ((sensors.position(), sensors.orientation()), sensors.velocity()))

    def rays(self, _part: Part, rays: Sequence[Frame], _reach: float, *, upright: bool = False) -> Reader:
        sensors = [self.device(names.distance_sensor(self._rays + index)) for index in range(len(rays))]
        self._rays += len(rays)
        for sensor in sensors:
            sensor.enable(self._period)
        return self._bound(lambda: [sensor.getValue() for sensor in sensors])

    # Motors

    def velocity_motor(self, _robot: str, joints: Sequence[str], max_torque: Sequence[float]) -> MotorWriter:
        motors = self._motors(joints, max_torque)

        def write(targets: Sequence[float]) -> None:
            for motor, target in zip(motors, targets, strict=True):
                motor.setPosition(inf)  # a reset of the world lets motors keep their position
                motor.setVelocity(target)

        return write

    def position_motor(
        self,
        _robot: str,
        joints: Sequence[str],
        max_torque: Sequence[float],
        _stiffness: object = None,
        _damping: object = None,
        **_curve: object,
    ) -> MotorWriter:
        motors = self._motors(joints, max_torque)
        for motor in motors:
            # Webots drives a motor at P times its error, which falls to 1/e in `SERVO_TIME` with this P.
            motor.setControlPID(1.0 / SERVO_TIME, 0.0, 0.0)
            motor.setVelocity(motor.getMaxVelocity())

        def write(targets: Sequence[float]) -> None:
            for motor, target in zip(motors, targets, strict=True):
                motor.setPosition(target)

        return write

    def torque_motor(
        self, _robot: str, joints: Sequence[str], max_torque: Sequence[float], **_curve: object
    ) -> MotorWriter:
        motors = [(self.device(joint), limit) for joint, limit in zip(joints, max_torque, strict=True)]

        def write(targets: Sequence[float]) -> None:
            for (motor, limit), target in zip(motors, targets, strict=True):
                motor.setTorque(min(max(target, -limit), limit))  # also the force of a linear motor

        return write

    def _motors(self, joints: Sequence[str], limits: Sequence[float]) -> list[Any]:
        motors = [self.device(joint) for joint in joints]
        for motor, limit in zip(motors, limits, strict=True):
            if limit < inf:
                motor.setAvailableTorque(limit)
        return motors

    # Devices

    def _joint(self, name: str) -> _Joint:
        if name not in self._joints:
            sensor = self.device(names.position_sensor(name))
            sensor.enable(self._period)
            self._joints[name] = _Joint(sensor, self._timestep)
        return self._joints[name]

    def _link(self, link: str | None) -> _LinkSensors:
        key = link or ""
        if key not in self._frames:
            self._frames[key] = _LinkSensors(self, key, self._period)
        return self._frames[key]


class _Joint:
    """A joint: its position, and its velocity by the position of a timestep ago."""

    def __init__(self, sensor: Any, timestep: float) -> None:
        self._sensor, self._timestep = sensor, timestep
        self.reading = (0, 0)
        """The index of the reader that has it, and its index in the readings of this reader."""
        self.state = (0.0, 0.0)

    def sample(self) -> None:
        position = self._sensor.getValue()
        self.state = (position, (position - self.state[0]) / self._timestep)


class _LinkSensors:
    """The sensors of pose and motion at the origin of a link."""

    def __init__(self, devices: RobotDevices, link: str, period: int) -> None:
        self._gps, self._unit, self._gyro = (
            devices.device(name(link)) for name in (names.gps, names.inertial_unit, names.gyro)
        )
        for device in (self._gps, self._unit, self._gyro):
            device.enable(period)

    def position(self) -> Triple:
        x, y, z = self._gps.getValues()
        return x, y, z

    def orientation(self) -> Quaternion:
        x, y, z, w = self._unit.getQuaternion()
        return x, y, z, w

    def velocity(self) -> tuple[Triple, Triple]:
        x, y, z = self._gps.getSpeedVector()
        u, v, w = self._gyro.getValues()
        # A Gyro measures in the frame of the link, but both velocities are in the world frame.
        return (x, y, z), frames.rotate(self.orientation(), (u, v, w))


def _as_tuple(value: Any) -> Any:
    return tuple(map(_as_tuple, value)) if isinstance(value, list) else value


class WebotsRobot:
    """A robot of a scenario: the generated controller, and the course of a timestep."""

    def __init__(self, project: Project, robot: Any) -> None:
        """Bind the generated controller to the devices.

        Args:
            project: The scenario.
            robot: The `controller.Robot`, whose name is that of the robot in the scenario.
        """
        program = project.program
        self._name, self._robot = robot.getName(), robot
        spec = project.robots[self._name]
        self.devices = RobotDevices(robot, program.world.timestep, program.world.gravity)
        kind: Any = project.controller_class(spec)
        self.controller = kind(spec, program, self.devices)
        self.controller.hold()
        self._emitted = FieldCodec(spec.from_robot, program.format, self._rejected)
        self._received = FieldCodec(spec.to_robot, program.format, self._rejected)
        self._streams: Streams | None = None
        self._time = -1.0
        self._has_begun = False
        self.message: Sequence[str] = self._emitted.silence.split(",")
        """The cells of the message of this timestep."""

    def observe(self) -> None:
        """Read the sensors and make the message of this timestep, before the new commands act."""
        time = self._robot.getTime()
        if time < self._time:
            self._has_begun = False
        self._time = time
        self.devices.sample()
        if not self._has_begun:
            self.controller.hold()
        else:
            self.controller.observe()
            self.message = self._emitted.encode(self.controller.create_message()).split(",")

    def begins_with(self, cells: Sequence[str]) -> bool:
        """Begin an episode, if this is the message that begins one; return whether it is."""
        if cells[0] != START:
            return False
        # deepbots splits a message at its commas, so the JSON is joined again.
        start = json.loads(",".join(cells[1:]))
        if self._streams is None or start["anew"]:
            self._streams = Streams(start["root"], start["copy"])
        self.devices.start(start["readings"])
        self.controller.begin(self._streams)
        # The supervisor makes the first message by the same call, and random streams and memories agree.
        self.controller.create_message()
        self.devices.first = None
        self._has_begun = True
        self.observe()
        return True

    def use(self, cells: Sequence[str]) -> None:
        """Drive the actuators by a message."""
        if self._has_begun:
            self.controller.use_message_data(self._received.decode(",".join(cells)))

    def _rejected(self, layout: MessageLayout, message: Any) -> MessageError:
        return layout_error(layout, "csv", message, 0)
