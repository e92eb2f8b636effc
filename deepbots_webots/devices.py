"""The devices of robots, as the module `controller` has them: motors and sensors of joints, emitters,
receivers, those that do little, and the class of each.

Names and meanings are those of Webots' reference. An attribute of Webots that is missing here raises
`NotImplementedCallError` with its name.
"""

from __future__ import annotations

import math
import struct
import sys
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from functools import partialmethod
from operator import attrgetter
from typing import Any

from deepbots_cli import frames
from deepbots_webots.imaging import Camera, Lidar, RangeFinder
from deepbots_webots.nodes import integer, number, numbers, text
from deepbots_webots.scene import Device as Spec
from deepbots_webots.sensors import (
    GPS,
    Accelerometer,
    Compass,
    Device,
    DistanceSensor,
    Gyro,
    InertialUnit,
    LightSensor,
    ScalarSensor,
    Sensor,
    TouchSensor,
    Unimplemented,
    returns,
    returns_number,
)
from deepbots_webots.simulation import Packet, Simulation

# Joints


class JointDevice(Device):
    """A device of a joint."""

    ROTATIONAL, LINEAR = 0, 1

    def getType(self) -> int:
        return 1 if self._spec.joint is not None and self._spec.joint.kind == "slide" else 0

    def _sibling(self, *types: str) -> Any:
        robot, joint = self._spec.body.robot, self._spec.joint
        for spec in robot.devices.values() if robot is not None else ():
            if spec.joint is joint and spec.type in types:
                return device_object(self._simulation, spec)
        return None

    getMotor = partialmethod(_sibling, "RotationalMotor", "LinearMotor")
    getPositionSensor = partialmethod(_sibling, "PositionSensor")


class PositionSensor(JointDevice, ScalarSensor):
    """The position of a joint, rad or m."""

    def sample(self) -> None:
        joint = self._spec.joint
        if joint is not None:
            position = self._simulation.physics.joint_position(joint)
            self._value = self._rounded(position + self._noise(number(self._spec.node, "noise")))


class _Feedback(ScalarSensor):
    """The torque of a motor."""

    def sample(self) -> None:
        physics = self._simulation.physics
        self._value = physics.motors.torque(physics.motors[self._spec.node])


class Motor(JointDevice):
    """A motor of a joint: position (rad or m), velocity (per s), or torque (N m or N)."""

    def __init__(self, simulation: Simulation, spec: Spec) -> None:
        super().__init__(simulation, spec)
        self._state = simulation.physics.motors[spec.node]
        self._feedback = _Feedback(simulation, spec)

    def renew(self) -> None:
        self._range = number(self._spec.node, "minPosition"), number(self._spec.node, "maxPosition")

    def setPosition(self, position: float) -> None:
        position, state = float(position), self._state
        if self._ignores(math.isnan(position), "the position is NaN"):
            return
        low, high = self._range
        if low != high and not math.isinf(position) and not low <= position <= high:
            self._warn(f"position {position:g} is outside {low:g} .. {high:g}, and is limited")
            position = min(max(position, low), high)
        state.target_position = position
        if state.torque is not None:
            state.torque = None
            self._simulation.physics.motors.renew()

    def setVelocity(self, velocity: float) -> None:
        velocity, state = float(velocity), self._state
        if self._ignores(math.isnan(velocity), "the velocity is NaN"):
            return
        is_wrong = velocity < 0 and not math.isinf(state.target_position)
        if self._ignores(is_wrong, f"the velocity {velocity:g} is negative under position control"):
            return
        if abs(velocity) > state.max_velocity:
            if math.isfinite(velocity):
                self._warn(
                    f"velocity {velocity:g} exceeds maxVelocity {state.max_velocity:g}, and is limited"
                )
            velocity = math.copysign(state.max_velocity, velocity)
        state.target_velocity = velocity

    def _ignores(self, is_wrong: bool, reason: str) -> bool:
        """Print why a wrong call has no effect. Webots prints an error too, and goes on."""
        if is_wrong:
            print(f"Error: {self._spec.name}: {reason}, so the call is ignored", file=sys.stderr)
        return is_wrong

    def setAcceleration(self, acceleration: float) -> None:
        is_wrong = acceleration != -1 and not acceleration >= 0
        if self._ignores(is_wrong, f"the acceleration {acceleration:g} is neither -1 nor at least 0"):
            return
        self._state.acceleration = float(acceleration)

    def setTorque(self, torque: float) -> None:
        torque, limit = float(torque), self._state.available_torque
        if self._ignores(math.isnan(torque), "the torque or force is NaN"):
            return
        if abs(torque) > limit:
            self._warn(f"{torque:g} exceeds the limit {limit:g}, and is limited")
        self._state.torque = min(max(torque, -limit), limit)
        self._simulation.physics.motors.renew()

    def setAvailableTorque(self, torque: float) -> None:
        limit = self._state.max_torque
        if self._ignores(not torque >= 0, f"the available torque or force {torque:g} is not at least 0"):
            return
        if torque > limit:
            self._warn(f"available torque {torque:g} exceeds the limit {limit:g}, and is limited")
        self._state.available_torque = min(float(torque), limit)
        self._simulation.physics.motors.renew()

    setForce = setTorque
    setAvailableForce = setAvailableTorque

    def setControlPID(self, p: float, i: float, d: float) -> None:
        is_wrong = not (p > 0 and i >= 0 and d >= 0)
        if self._ignores(is_wrong, f"the gains {p:g}, {i:g}, {d:g} must be positive; i and d may be 0"):
            return
        self._state.gains = float(p), float(i), float(d)
        self._state.integral = self._state.last_error = 0.0

    getTargetPosition = returns("_state.target_position")
    getVelocity = returns("_state.target_velocity")
    getMaxVelocity = returns("_state.max_velocity")
    getAcceleration = returns("_state.acceleration")
    getMinPosition = returns_number("minPosition")
    getMaxPosition = returns_number("maxPosition")

    getAvailableTorque = returns("_state.available_torque")
    getMaxTorque = returns("_state.max_torque")
    getAvailableForce = getAvailableTorque
    getMaxForce = getMaxTorque

    getMultiplier = returns_number("multiplier")

    enableTorqueFeedback = property(attrgetter("_feedback.enable"))
    disableTorqueFeedback = property(attrgetter("_feedback.disable"))
    getTorqueFeedback = returns("_feedback._value")
    getTorqueFeedbackSamplingPeriod = returns("_feedback._asked")
    enableForceFeedback = enableTorqueFeedback
    disableForceFeedback = disableTorqueFeedback
    getForceFeedback = getTorqueFeedback
    getForceFeedbackSamplingPeriod = getTorqueFeedbackSamplingPeriod


# Messages, and devices that do little


class _ChannelDevice(Device):
    """An emitter or a receiver."""

    CHANNEL_BROADCAST = -1

    def __init__(self, simulation: Simulation, spec: Spec) -> None:
        super().__init__(simulation, spec)
        self._channel, self._size = integer(spec.node, "channel"), integer(spec.node, "bufferSize")

    getChannel = returns("_channel")

    def setChannel(self, channel: int) -> None:
        allowed = numbers(self._spec.node, "allowedChannels")
        if allowed and channel not in allowed:
            self._warn(f"channel {channel} is not allowed")
            return
        self._channel = int(channel)


class Emitter(_ChannelDevice):
    """Sends messages to the receivers of other robots."""

    def __init__(self, simulation: Simulation, spec: Spec) -> None:
        super().__init__(simulation, spec)
        self._range = number(spec.node, "range")

    def send(self, message: str | bytes | Sequence[float]) -> int:
        """Send a text, bytes or numbers; returns 1, or 0 if the buffer has no room for it."""
        if isinstance(message, str):
            # A C string, as in Webots; it counts for the size of the buffer.
            data = message.encode("utf-8") + b"\0"
        elif isinstance(message, bytes | bytearray | memoryview):
            data = bytes(message)
        else:
            data = struct.pack(f"{len(message)}d", *message)
        if 0 <= self._size < self._simulation.waiting_bytes(self._spec) + len(data):
            return 0
        self._simulation.send(self._spec, data, self._channel, self._range)
        return 1

    getRange = returns("_range")

    def setRange(self, range: float) -> None:
        most = number(self._spec.node, "maxRange")
        if most >= 0 and not 0 <= range <= most:
            self._warn(f"range {range:g} exceeds maxRange {most:g}, and is limited")
            range = most
        self._range = float(range)

    getBufferSize = returns("_size")


class Receiver(_ChannelDevice, Sensor):
    """Messages of other robots, in the order in which they were sent."""

    def __init__(self, simulation: Simulation, spec: Spec) -> None:
        super().__init__(simulation, spec)
        self._arrived: list[Packet] = []
        self._queue: deque[Packet] = deque()

    def forget(self) -> None:
        self._arrived.clear()
        self._queue.clear()

    def hear(self, packet: Packet) -> None:
        spec, sender = self._spec, packet.emitter
        is_infra_red, is_light = (text(device.node, "type") == "infra-red" for device in (spec, sender))
        fits = packet.channel in (-1, self._channel) or self._channel == -1
        if not fits or is_infra_red != is_light or sender.body.robot is spec.body.robot:
            return
        position, rotation = self._frame()
        start = self._simulation.physics.position(sender.body, sender.frame)
        arrived = replace(packet, offset=frames.subtract(start, position), rotation=rotation)
        if 0 <= packet.range < arrived.distance:
            return
        arrived.noise = 1 + self._noise(number(spec.node, "signalStrengthNoise"))
        self._arrived.append(arrived)

    def sample(self) -> None:
        for packet in self._arrived:
            waiting = sum(len(entry.data) for entry in self._queue)
            if self._size < 0 or waiting + len(packet.data) <= self._size:
                self._queue.append(packet)
        self._arrived.clear()

    getQueueLength = returns("_queue", len)

    def nextPacket(self) -> None:
        self._queue.remove(self._head)

    @property
    def _head(self) -> Packet:
        if not self._queue:
            raise RuntimeError(f"the queue of the receiver '{self._spec.name}' is empty")
        return self._queue[0]

    getBytes = getData = returns("_head.data")
    getSignalStrength = returns("_head.strength")
    getEmitterDirection = returns("_head.direction", list)

    def getString(self) -> str:
        return str(self.getBytes().partition(b"\0")[0], "utf-8")

    def getFloats(self) -> list[float]:
        return list(struct.unpack_from(f"{self.getDataSize() // 8}d", self._head.data))

    getDataSize = returns("_head.data", len)


class LED(Device):
    """A lamp: 0 is off, n its n-th color; a gradual one takes an RGB number."""

    _value = 0

    def set(self, value: int) -> None:
        self._value = int(value)

    get = returns("_value")


class Display(Device):
    """A display that nobody sees: what is drawn has no effect."""

    def _draw(self, *_: Any) -> None:
        """Do nothing."""

    setColor = setAlpha = setOpacity = setFont = _draw
    drawPixel = drawLine = drawRectangle = drawOval = drawPolygon = drawText = _draw
    fillRectangle = fillOval = fillPolygon = _draw

    getWidth = returns_number("width", int)
    getHeight = returns_number("height", int)


class Speaker(Device):
    """A speaker that nobody hears: sounds have no effect, and end at once."""

    @staticmethod
    def _sound(*_: Any, **__: Any) -> bool:
        """Do nothing."""
        return False

    playSound = speak = stop = setEngine = setLanguage = isSoundPlaying = isSpeaking = _sound


class Pen(Device):
    """A pen that draws nothing."""

    def setInkColor(self, *_: Any) -> None:
        """Do nothing."""


def _stubs(base: Any, *names: str) -> list[Any]:
    """Return classes of which no function is implemented."""
    return [type(base)(name, (base,), {"__module__": __name__}) for name in names]


Altimeter, Brake, Connector, Microphone, VacuumGripper, Skin, Radio, Radar = _stubs(
    Device, "Altimeter", "Brake", "Connector", "Microphone", "VacuumGripper", "Skin", "Radio", "Radar"
)
Joystick, Motion, Mouse, MouseState, RadarTarget, Proto = _stubs(
    Unimplemented, "Joystick", "Motion", "Mouse", "MouseState", "RadarTarget", "Proto"
)

_CLASSES: dict[str, type[Device]] = {
    "RotationalMotor": Motor,
    "LinearMotor": Motor,
    **{
        kind.__name__: kind
        for kind in (
            *(PositionSensor, Brake, Gyro, Accelerometer, Compass, InertialUnit, GPS, Altimeter),
            *(DistanceSensor, TouchSensor, Emitter, Receiver, LED),
            *(Camera, RangeFinder, Lidar, Radar, LightSensor, Display, Speaker, Connector, Pen),
            *(Microphone, VacuumGripper, Skin, Radio),
        )
    },
}


def device_object(simulation: Simulation, spec: Spec) -> Device:
    """Return the object of a device; the same one each time."""
    if spec not in simulation.objects:
        simulation.objects[spec] = _CLASSES[spec.type](simulation, spec)
    device = simulation.objects[spec]
    assert isinstance(device, Device)
    return device
