"""The devices of robots, as the module `controller` has them.

Names and meanings are those of Webots' reference. A sensor returns NaN until its first sampling period has
passed. An attribute of Webots that is missing here raises `NotImplementedCallError` with its name.
"""

from __future__ import annotations

import math
import struct
import sys
from collections.abc import Sequence
from functools import cached_property
from itertools import pairwise
from math import nan
from typing import TYPE_CHECKING, Any, NamedTuple

from deepbots_cli import frames
from deepbots_cli.webots.api import NotImplementedCallError, missing_attribute
from deepbots_cli.webots.nodes import boolean, integer, number, numbers, parameters, text, vectors

if TYPE_CHECKING:
    from deepbots_cli.frames import Frame, Triple
    from deepbots_cli.webots.scene import Device as Spec
    from deepbots_cli.webots.simulation import Packet, Simulation

SONAR_CONE = math.cos(math.pi / 8)
"""The cosine of the largest angle of incidence at which a sonar hears its echo."""


class Device:
    """A device of a robot."""

    def __init__(self, simulation: Simulation, spec: Spec) -> None:
        self._simulation, self._spec = simulation, spec

    def __getattr__(self, name: str) -> Any:
        raise missing_attribute(type(self), name)

    def renew(self) -> None:
        """Read the fields of the node again, after a supervisor set one."""

    def getName(self) -> str:
        return self._spec.name

    def getModel(self) -> str:
        return text(self._spec.node, "model") if "model" in parameters(self._spec.node) else ""

    def _frame(self) -> Frame:
        return self._simulation.physics.frame(self._spec.body, self._spec.frame)

    def _warn(self, message: str) -> None:
        print(f"Warning: {self._spec.name}: {message}", file=sys.stderr)

    def _noise(self, deviation: float) -> float:
        return self._simulation.random.gauss(0.0, deviation) if deviation else 0.0

    def _rounded(self, value: float) -> float:
        resolution = number(self._spec.node, "resolution")
        return round(value / resolution) * resolution if resolution > 0 else value


class Sensor(Device):
    """A device that measures once in each sampling period (ms)."""

    def __init__(self, simulation: Simulation, spec: Spec) -> None:
        super().__init__(simulation, spec)
        self.period = self.due = self._asked = 0

    def enable(self, samplingPeriod: int) -> None:
        if samplingPeriod <= 0:
            raise ValueError(f"enable() of '{self._spec.name}': the sampling period must be positive")
        self._asked = int(samplingPeriod)
        self._begin()
        self._simulation.enable(self, self._asked)

    def disable(self) -> None:
        self._asked = 0
        self._simulation.disable(self)

    def getSamplingPeriod(self) -> int:
        return self._asked

    def _begin(self) -> None:
        """Prepare the first measurement."""

    def sample(self) -> None:
        raise NotImplementedError

    def forget(self) -> None:
        """Do what a reset of the world needs."""


class ScalarSensor(Sensor):
    """A sensor of one number."""

    def __init__(self, simulation: Simulation, spec: Spec) -> None:
        super().__init__(simulation, spec)
        self._value = nan

    def getValue(self) -> float:
        return self._value


class VectorSensor(Sensor):
    """A sensor of three numbers, in its own frame; an axis that is switched off reads NaN."""

    def __init__(self, simulation: Simulation, spec: Spec) -> None:
        super().__init__(simulation, spec)
        self._values: Triple = (nan, nan, nan)
        self._axes = tuple(boolean(spec.node, f"{axis}Axis") for axis in "xyz")
        self._table = vectors(spec.node, "lookupTable")

    def getValues(self) -> list[float]:
        return list(self._values)

    def getLookupTable(self) -> list[float]:
        return [part for row in self._table for part in row]

    def _measure(self) -> Triple:
        raise NotImplementedError

    def sample(self) -> None:
        x, y, z = (
            self._rounded(self._response(value)) if is_on else nan
            for value, is_on in zip(self._measure(), self._axes, strict=True)
        )
        self._values = x, y, z

    def _response(self, value: float) -> float:
        if not self._table:
            return value
        answer, share = look_up(self._table, value)
        return answer * (1.0 + self._noise(share))


# Joints


class JointDevice(Device):
    """A device of a joint."""

    def getType(self) -> int:
        return 1 if self._spec.joint is not None and self._spec.joint.kind == "slide" else 0

    def _sibling(self, *types: str) -> Any:
        robot = self._spec.body.robot
        if robot is None:
            return None
        for spec in robot.devices.values():
            if spec.joint is self._spec.joint and spec.type in types:
                return device_object(self._simulation, spec)
        return None

    def getMotor(self) -> Any:
        return self._sibling("RotationalMotor", "LinearMotor")

    def getPositionSensor(self) -> Any:
        return self._sibling("PositionSensor")

    def getBrake(self) -> Any:
        return self._sibling("Brake")


class PositionSensor(JointDevice, ScalarSensor):
    """The position of a joint, rad or m."""

    ROTATIONAL, LINEAR = 0, 1

    def sample(self) -> None:
        joint = self._spec.joint
        if joint is not None:
            position = self._simulation.physics.joint_position(joint)
            self._value = self._rounded(position + self._noise(number(self._spec.node, "noise")))


class Brake(JointDevice):
    """Damping that a controller adds to a joint, N m s/rad or N s/m."""

    ROTATIONAL, LINEAR = 0, 1

    def setDampingConstant(self, dampingConstant: float) -> None:
        if self._spec.joint is not None:
            self._simulation.physics.set_damping(self._spec.joint, float(dampingConstant))


class _Feedback(ScalarSensor):
    """The torque of a motor."""

    def sample(self) -> None:
        physics = self._simulation.physics
        self._value = physics.motor_torque(physics.motors[self._spec.node])


class Motor(JointDevice):
    """A motor of a joint: position (rad or m), velocity (per s), or torque (N m or N)."""

    ROTATIONAL, LINEAR = 0, 1

    def __init__(self, simulation: Simulation, spec: Spec) -> None:
        super().__init__(simulation, spec)
        self._state = simulation.physics.motors[spec.node]
        self._feedback = _Feedback(simulation, spec)
        self._range = number(spec.node, "minPosition"), number(spec.node, "maxPosition")

    def setPosition(self, position: float) -> None:
        position = float(position)
        if math.isnan(position):
            raise ValueError(f"setPosition() of '{self._spec.name}': NaN is no position")
        low, high = self._range
        if low != high and not math.isinf(position) and not low <= position <= high:
            self._warn(f"position {position:g} is outside {low:g} .. {high:g}, and is limited")
            position = min(max(position, low), high)
        state = self._state
        if position != state.target_position or state.torque is not None:
            state.target_position, state.integral, state.last_error = position, 0.0, 0.0
            self._leave_torque()

    def setVelocity(self, velocity: float) -> None:
        velocity, state = float(velocity), self._state
        if math.isnan(velocity):
            raise ValueError(f"setVelocity() of '{self._spec.name}': NaN is no velocity")
        if abs(velocity) > state.max_velocity:
            if math.isfinite(velocity):
                self._warn(
                    f"velocity {velocity:g} exceeds maxVelocity {state.max_velocity:g}, and is limited"
                )
            velocity = math.copysign(state.max_velocity, velocity)
        state.target_velocity = velocity if math.isinf(state.target_position) else abs(velocity)
        self._leave_torque()

    def _leave_torque(self) -> None:
        if self._state.torque is not None:
            self._state.torque = None
            self._simulation.physics.renew_motors()

    def setAcceleration(self, acceleration: float) -> None:
        self._state.acceleration = float(acceleration)

    def setTorque(self, torque: float) -> None:
        limit = self._state.max_torque
        self._state.torque = min(max(float(torque), -limit), limit)
        if self._state.torque != torque:
            self._warn(f"{torque:g} exceeds the limit {limit:g}, and is limited")
        self._simulation.physics.renew_motors()

    def setAvailableTorque(self, torque: float) -> None:
        self._state.available_torque = min(max(float(torque), 0.0), self._state.max_torque)
        self._simulation.physics.renew_motors()

    setForce = setTorque
    setAvailableForce = setAvailableTorque

    def setControlPID(self, p: float, i: float, d: float) -> None:
        self._state.gains = float(p), float(i), float(d)
        self._state.integral = self._state.last_error = 0.0

    def getTargetPosition(self) -> float:
        return self._state.target_position

    def getVelocity(self) -> float:
        return self._state.target_velocity

    def getMaxVelocity(self) -> float:
        return self._state.max_velocity

    def getAcceleration(self) -> float:
        return self._state.acceleration

    def getMinPosition(self) -> float:
        return self._range[0]

    def getMaxPosition(self) -> float:
        return self._range[1]

    def getAvailableTorque(self) -> float:
        return self._state.available_torque

    def getMaxTorque(self) -> float:
        return self._state.max_torque

    getAvailableForce = getAvailableTorque
    getMaxForce = getMaxTorque

    def getMultiplier(self) -> float:
        return number(self._spec.node, "multiplier")

    def enableTorqueFeedback(self, samplingPeriod: int) -> None:
        self._feedback.enable(samplingPeriod)

    def disableTorqueFeedback(self) -> None:
        self._feedback.disable()

    def getTorqueFeedback(self) -> float:
        return self._feedback.getValue()

    def getTorqueFeedbackSamplingPeriod(self) -> int:
        return self._feedback.getSamplingPeriod()

    enableForceFeedback = enableTorqueFeedback
    disableForceFeedback = disableTorqueFeedback
    getForceFeedback = getTorqueFeedback
    getForceFeedbackSamplingPeriod = getTorqueFeedbackSamplingPeriod


# Motion


class Gyro(VectorSensor):
    """Angular velocity, rad/s."""

    def _measure(self) -> Triple:
        spec = self._spec
        angular = self._simulation.physics.velocity(spec.body, spec.frame)[1]
        return frames.rotate_back(self._frame()[1], angular)


class Accelerometer(VectorSensor):
    """Acceleration without that of gravity, m/s^2: upward 9.81 at rest. It is the change of velocity since
    the last measurement."""

    def _begin(self) -> None:
        self._before, self._since = self._velocity(), self._simulation.ticks

    def forget(self) -> None:
        self._before, self._since = self._velocity(), self._simulation.ticks - self.period

    def _velocity(self) -> Triple:
        return self._simulation.physics.velocity(self._spec.body, self._spec.frame)[0]

    def _measure(self) -> Triple:
        now, ticks = self._velocity(), self._simulation.ticks
        seconds = max(1, ticks - self._since) / 1000
        change = frames.scaled(frames.subtract(now, self._before), 1 / seconds)
        self._before, self._since = now, ticks
        felt = frames.subtract(change, self._simulation.scene.gravity)
        return frames.rotate_back(self._frame()[1], felt)


class Compass(VectorSensor):
    """The direction of north in the frame of the sensor."""

    def _measure(self) -> Triple:
        north = self._simulation.scene.north
        length = math.hypot(*north) or 1.0
        return frames.rotate_back(self._frame()[1], frames.scaled(north, 1 / length))


class InertialUnit(Sensor):
    """Orientation in the world."""

    def __init__(self, simulation: Simulation, spec: Spec) -> None:
        super().__init__(simulation, spec)
        self._angles: Triple = (nan, nan, nan)
        self._turned = (nan, nan, nan, nan)

    def getRollPitchYaw(self) -> list[float]:
        return list(self._angles)

    def getQuaternion(self) -> list[float]:
        """Return the quaternion x, y, z, w."""
        return list(self._turned)

    def getNoise(self) -> float:
        return number(self._spec.node, "noise")

    def sample(self) -> None:
        turned = self._frame()[1]
        noise, node = self.getNoise(), self._spec.node
        x, y, z = (
            self._rounded(angle + self._noise(noise)) if boolean(node, f"{axis}Axis") else nan
            for axis, angle in zip("xyz", frames.roll_pitch_yaw(turned), strict=True)
        )
        self._angles = x, y, z
        self._turned = frames.quaternion(x, y, z) if noise else turned


class GPS(Sensor):
    """Position (m) and velocity (m/s) in the world."""

    LOCAL, WGS84 = 0, 1

    def __init__(self, simulation: Simulation, spec: Spec) -> None:
        super().__init__(simulation, spec)
        self._values: Triple = (nan, nan, nan)
        self._speed: Triple = (nan, nan, nan)

    def getValues(self) -> list[float]:
        return list(self._values)

    def getSpeed(self) -> float:
        return math.hypot(*self._speed)

    def getSpeedVector(self) -> list[float]:
        return list(self._speed)

    def getCoordinateSystem(self) -> int:
        return self.LOCAL

    def sample(self) -> None:
        spec, node = self._spec, self._spec.node
        accuracy, blur = number(node, "accuracy"), number(node, "speedNoise")
        x, y, z = (self._rounded(part + self._noise(accuracy)) for part in self._frame()[0])
        self._values = x, y, z
        moving = self._simulation.physics.velocity(spec.body, spec.frame)[0]
        u, v, w = (part + self._noise(blur) for part in moving)
        self._speed = u, v, w


class Altimeter(ScalarSensor):
    """Height in the world, m."""

    def sample(self) -> None:
        height = self._frame()[0][2] + self._noise(number(self._spec.node, "accuracy"))
        self._value = self._rounded(height)


# Surroundings


class DistanceSensor(ScalarSensor):
    """The response of a lookup table to the distance along rays. The own robot stops no ray."""

    GENERIC, INFRA_RED, SONAR, LASER = 0, 1, 2, 3

    def __init__(self, simulation: Simulation, spec: Spec) -> None:
        super().__init__(simulation, spec)
        self.renew()

    def renew(self) -> None:
        """Read the fields of the node, which a supervisor may have set."""
        node = self._spec.node
        self._type = text(node, "type")
        self._table = vectors(node, "lookupTable")
        self._reach = max((row[0] for row in self._table), default=0.0)
        count, aperture = integer(node, "numberOfRays"), number(node, "aperture")
        self._directions = ray_directions(1 if self._type == "laser" else max(1, count), aperture)
        self._weights = _ray_weights(self._directions, aperture, number(node, "gaussianWidth"))

    def getType(self) -> int:
        return {"infra-red": 1, "sonar": 2, "laser": 3}.get(self._type, 0)

    def getMaxValue(self) -> float:
        return max((row[1] for row in self._table), default=nan)

    def getMinValue(self) -> float:
        return min((row[1] for row in self._table), default=nan)

    def getAperture(self) -> float:
        return number(self._spec.node, "aperture")

    def getLookupTable(self) -> list[float]:
        return [part for row in self._table for part in row]

    def sample(self) -> None:
        if not self._table:
            self._value = self._distance()
            return
        answer, share = look_up(self._table, self._distance())
        self._value = self._rounded(answer * (1.0 + self._noise(share)))

    def _distance(self) -> float:
        """Return the distance that the table is asked for, m."""
        start, turned = self._frame()
        physics, robot = self._simulation.physics, self._spec.body.robot
        directions = [frames.rotate(turned, direction) for direction in self._directions]
        reach = self._reach or 1e3
        hits = physics.rays(start, directions, reach, robot.index if robot else None)
        if self._type in ("sonar", "laser"):
            return min(
                reach if self._type == "sonar" and cosine < SONAR_CONE else distance
                for distance, _, cosine in hits
            )
        if self._type == "infra-red":
            distances = [
                distance / physics.geoms[geom][1].reflection if geom >= 0 else distance
                for distance, geom, _ in hits
            ]
        else:
            distances = [distance for distance, _, _ in hits]
        return sum(map(math.prod, zip(self._weights, distances, strict=True)))


class TouchSensor(Sensor):
    """A bumper (0 or 1), or the contact force on its bounding object, N."""

    BUMPER, FORCE, FORCE3D = 0, 1, 2

    def __init__(self, simulation: Simulation, spec: Spec) -> None:
        super().__init__(simulation, spec)
        self._type = text(spec.node, "type")
        self._value, self._values = nan, (nan, nan, nan)

    def getType(self) -> int:
        return {"force": 1, "force-3d": 2}.get(self._type, 0)

    def getValue(self) -> float:
        return self._value

    def getValues(self) -> list[float]:
        return list(self._values)

    def sample(self) -> None:
        physics, node = self._simulation.physics, self._spec.node
        total: Triple = (0.0, 0.0, 0.0)
        touches = False
        for one, other, _, force in physics.contacts():
            for geom, sign in ((other, 1.0), (one, -1.0)):
                if physics.geoms[geom][1].owner is node:
                    touches, total = True, frames.add(total, frames.scaled(force, sign))
        local = frames.rotate_back(self._frame()[1], total)
        self._values = local
        if self._type == "bumper":
            self._value = float(touches)
        else:
            answer, share = look_up(vectors(node, "lookupTable"), abs(local[0]))
            self._value = self._rounded(answer * (1.0 + self._noise(share)))


# Messages


class Emitter(Device):
    """Sends messages to the receivers of other robots."""

    CHANNEL_BROADCAST = -1

    def __init__(self, simulation: Simulation, spec: Spec) -> None:
        super().__init__(simulation, spec)
        self._channel = integer(spec.node, "channel")
        self._range = number(spec.node, "range")
        self._size = integer(spec.node, "bufferSize")

    def send(self, message: str | bytes | Sequence[float]) -> int:
        """Send a text, bytes or numbers; returns 1, or 0 if the message is larger than the buffer."""
        if isinstance(message, str):
            data = message.encode("utf-8") + b"\0"
        elif isinstance(message, bytes | bytearray | memoryview):
            data = bytes(message)
        else:
            data = struct.pack(f"{len(message)}d", *message)
        if 0 <= self._size < len(data):
            return 0
        self._simulation.send(self._spec, data, self._channel, self._range)
        return 1

    def getChannel(self) -> int:
        return self._channel

    def setChannel(self, channel: int) -> None:
        allowed = numbers(self._spec.node, "allowedChannels")
        if allowed and channel not in allowed:
            self._warn(f"channel {channel} is not allowed")
            return
        self._channel = int(channel)

    def getRange(self) -> float:
        return self._range

    def setRange(self, range: float) -> None:
        most = number(self._spec.node, "maxRange")
        if most >= 0 and not 0 <= range <= most:
            self._warn(f"range {range:g} exceeds maxRange {most:g}, and is limited")
            range = most
        self._range = float(range)

    def getBufferSize(self) -> int:
        return self._size


class Receiver(Sensor):
    """Messages of other robots, in the order in which they were sent."""

    CHANNEL_BROADCAST = -1

    def __init__(self, simulation: Simulation, spec: Spec) -> None:
        super().__init__(simulation, spec)
        self._inbox = simulation.inboxes[spec]
        self._size = integer(spec.node, "bufferSize")

    def _begin(self) -> None:
        self._inbox.is_enabled = True

    def disable(self) -> None:
        super().disable()
        self._inbox.is_enabled = False

    def sample(self) -> None:
        inbox = self._inbox
        if not inbox.arrived:
            return
        size = self._size
        for packet in inbox.arrived:
            if size < 0 or sum(len(one.data) for one in inbox.queue) + len(packet.data) <= size:
                inbox.queue.append(packet)
        inbox.arrived.clear()

    def getQueueLength(self) -> int:
        return len(self._inbox.queue)

    def nextPacket(self) -> None:
        self._head("nextPacket")
        self._inbox.queue.popleft()

    def _head(self, function: str) -> Packet:
        if not self._inbox.queue:
            raise RuntimeError(f"Receiver.{function}: the queue of '{self._spec.name}' is empty")
        return self._inbox.queue[0]

    def getBytes(self) -> bytes:
        return self._head("getBytes").data

    def getData(self) -> bytes:
        return self._head("getData").data

    def getString(self) -> str:
        return self._head("getString").data.partition(b"\0")[0].decode("utf-8")

    def getFloats(self) -> list[float]:
        data = self._head("getFloats").data
        return list(struct.unpack(f"{len(data) // 8}d", data[: len(data) // 8 * 8]))

    def getDataSize(self) -> int:
        return len(self._head("getDataSize").data)

    def getSignalStrength(self) -> float:
        return self._head("getSignalStrength").strength()

    def getEmitterDirection(self) -> list[float]:
        return list(self._head("getEmitterDirection").direction())

    def getChannel(self) -> int:
        return self._inbox.channel

    def setChannel(self, channel: int) -> None:
        self._inbox.channel = int(channel)


# Others


class LED(Device):
    """A lamp: 0 is off, n its n-th color; a gradual one takes an RGB number."""

    def __init__(self, simulation: Simulation, spec: Spec) -> None:
        super().__init__(simulation, spec)
        self._value = 0

    def set(self, value: int) -> None:
        self._value = int(value)

    def get(self) -> int:
        return self._value


class Camera(Device):
    """A camera: no function of it is implemented."""


class RangeFinder(Device):
    """A range finder: no function of it is implemented."""


class LidarPoint(NamedTuple):
    """A point that a lidar met, in its frame (m); the time is 0 in a layer that is measured at once."""

    x: float
    y: float
    z: float
    layer_id: int
    time: float


class Lidar(Sensor):
    """Distances along rays, row by row from above, each row from the left; infinite beyond the range."""

    def __init__(self, simulation: Simulation, spec: Spec) -> None:
        super().__init__(simulation, spec)
        node = spec.node
        self._columns, self._layers = (
            max(1, integer(node, field)) for field in ("horizontalResolution", "numberOfLayers")
        )
        self._range = number(node, "minRange"), number(node, "maxRange")
        self._fov, self._high = number(node, "fieldOfView"), number(node, "verticalFieldOfView")
        self._image: list[float] = [nan] * (self._columns * self._layers)
        self._has_points = False

    @cached_property
    def _directions(self) -> Any:
        """The rays in the frame of the sensor, shape (rays, 3)."""
        import numpy as np

        if text(self._spec.node, "type") != "fixed" or text(self._spec.node, "projection") != "cylindrical":
            raise NotImplementedCallError("a Lidar that rotates, or is planar, is not implemented")
        yaws = self._fov * (0.5 - (np.arange(self._columns) + 0.5) / self._columns)
        heights = np.linspace(0.5, -0.5, self._layers) if self._layers > 1 else np.zeros(1)
        pitch, yaw = np.meshgrid(
            self._high * heights + number(self._spec.node, "tiltAngle"), yaws, indexing="ij"
        )
        parts = (np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch))
        return np.stack(parts, axis=-1).reshape(-1, 3)

    def _begin(self) -> None:
        len(self._directions)  # an error where it is enabled

    def sample(self) -> None:
        import numpy as np

        start, turned = self._frame()
        axes = np.array([frames.rotate(turned, axis) for axis in ((1.0, 0, 0), (0, 1.0, 0), (0, 0, 1.0))])
        robot = self._spec.body.robot
        least, most = self._range
        image = self._simulation.physics.distances(
            start, self._directions @ axes, most, robot.index if robot else None
        )
        noise = number(self._spec.node, "noise") * most
        self._image = [
            max(self._rounded(distance + self._noise(noise)), least) if distance <= most else distance
            for distance in image
        ]

    def getRangeImage(self) -> list[float]:
        return list(self._image)

    def getLayerRangeImage(self, layer: int) -> list[float]:
        return self._image[layer * self._columns : (layer + 1) * self._columns]

    def enablePointCloud(self) -> None:
        self._has_points = True

    def disablePointCloud(self) -> None:
        self._has_points = False

    def isPointCloudEnabled(self) -> bool:
        return self._has_points

    def getPointCloud(self) -> list[LidarPoint]:
        """Return the points in the frame of the sensor, in the order of the range image."""
        if not self._has_points:
            return []
        points = zip(self._image, self._directions.tolist(), strict=True)
        return [
            LidarPoint(distance * x, distance * y, distance * z, number // self._columns, 0.0)
            for number, (distance, (x, y, z)) in enumerate(points)
        ]

    def getNumberOfPoints(self) -> int:
        return self._columns * self._layers

    def getHorizontalResolution(self) -> int:
        return self._columns

    def getNumberOfLayers(self) -> int:
        return self._layers

    def getMinRange(self) -> float:
        return self._range[0]

    def getMaxRange(self) -> float:
        return self._range[1]

    def getFov(self) -> float:
        return self._fov

    def getVerticalFov(self) -> float:
        return self._high


class Radar(Device):
    """A radar: no function of it is implemented."""


class LightSensor(Device):
    """A light sensor: no function of it is implemented."""


class Display(Device):
    """A display that nobody sees: what is drawn has no effect."""

    def _draw(self, *_: Any) -> None:
        """Do nothing."""

    setColor = setAlpha = setOpacity = setFont = _draw
    drawPixel = drawLine = drawRectangle = drawOval = drawPolygon = drawText = _draw
    fillRectangle = fillOval = fillPolygon = _draw

    def getWidth(self) -> int:
        return integer(self._spec.node, "width")

    def getHeight(self) -> int:
        return integer(self._spec.node, "height")


class Speaker(Device):
    """A speaker that nobody hears: sounds have no effect, and end at once."""

    def _sound(self, *_: Any, **__: Any) -> None:
        """Do nothing."""

    speak = stop = setEngine = setLanguage = _sound

    @staticmethod
    def playSound(left: Any, right: Any, *_: Any, **__: Any) -> None:
        """Do nothing."""

    def isSoundPlaying(self, sound: str = "") -> bool:
        return False

    def isSpeaking(self) -> bool:
        return False


class Connector(Device):
    """A connector: no function of it is implemented."""


class Pen(Device):
    """A pen: no function of it is implemented."""


class Microphone(Device):
    """A microphone: no function of it is implemented."""


class VacuumGripper(Device):
    """A vacuum gripper: no function of it is implemented."""


class Skin(Device):
    """A skin: no function of it is implemented."""


class Radio(Device):
    """A radio: no function of it is implemented."""


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
    found = simulation.objects[spec]
    assert isinstance(found, Device)
    return found


def look_up(table: Sequence[Triple], value: float) -> tuple[float, float]:
    """Return the response and its share of noise, between the rows of a lookup table; beyond its ends, those
    of the nearest row."""
    if not table:
        return value, 0.0
    if value <= table[0][0]:
        return table[0][1], table[0][2]
    for (low, first, quiet), (high, last, loud) in pairwise(table):
        if value <= high:
            share = (value - low) / (high - low) if high > low else 1.0
            return first + share * (last - first), quiet + share * (loud - quiet)
    return table[-1][1], table[-1][2]


def ray_directions(count: int, aperture: float) -> list[Triple]:
    """Return unit vectors around x: one along it, two to the sides, and more on a circle around the first."""
    half = min(aperture, 2 * math.pi) / 2
    if count == 1:
        return [(1.0, 0.0, 0.0)]
    if count == 2:
        return [(math.cos(half), side * math.sin(half), 0.0) for side in (1.0, -1.0)]
    ring = count - 1
    angles = [2 * math.pi * number / ring for number in range(ring)]
    around = [(math.cos(half), math.sin(half) * math.cos(a), math.sin(half) * math.sin(a)) for a in angles]
    return [(1.0, 0.0, 0.0), *around]


def _ray_weights(directions: Sequence[Triple], aperture: float, width: float) -> list[float]:
    """Return the weights of rays, a Gaussian of their angle to the axis."""
    spread = aperture * width
    angles = [math.acos(min(1.0, x)) for x, _, _ in directions]
    weights = [math.exp(-((angle / spread) ** 2)) if spread > 0 else 1.0 for angle in angles]
    total = sum(weights) or 1.0
    return [weight / total for weight in weights]
