"""Sensors of motion, of light and of the surroundings, as the module `controller` has them, and what all
devices share: their node, sampling, lookup tables, and the error of a function that is not implemented.

A sensor returns NaN until its first sampling period has passed. The names of missing functions are facts of
the reference manual of Webots; a name that is neither there nor implemented does not exist in Webots either.
"""

from __future__ import annotations

import math
import sys
from abc import ABCMeta, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from itertools import chain, pairwise
from math import nan
from operator import attrgetter
from typing import TYPE_CHECKING, Any

from deepbots_cli import frames
from deepbots_cli.diagnostics.nearest import did_you_mean
from deepbots_cli.frames import IDENTITY_ROTATION, Frame, Quaternion, Triple
from deepbots_webots.nodes import boolean, integer, number, parameters, text, vector, vectors
from deepbots_webots.scene import AXES, NORTH, UP
from deepbots_webots.scene import Device as Spec
from deepbots_webots.shapes import compose

if TYPE_CHECKING:
    from deepbots_webots.simulation import Packet, Simulation
    from deepbots_webots.syntax import Node


class NotImplementedCallError(NotImplementedError, AttributeError):
    """A controller uses a part of Webots' interface that deepbots does not have."""

    __module__ = "controller"


MISSING: Mapping[str, str] = {
    "Robot": "batterySensorDisable batterySensorEnable batterySensorGetSamplingPeriod batterySensorGetValue"
    " getJoystick getMouse getUrdf stepBegin stepEnd waitForUserInputEvent wwiReceiveText wwiSendText"
    " setMode",
    "Supervisor": "animationStartRecording animationStopRecording exportImage getSelected movieFailed"
    " movieIsReady movieStartRecording movieStopRecording simulationRevert"
    " virtualRealityHeadsetGetOrientation virtualRealityHeadsetGetPosition virtualRealityHeadsetIsUsed"
    " worldLoad worldReload worldSave",
    "Node": "exportString getNumberOfFields getFieldByIndex getNumberOfBaseNodeFields getBaseNodeFieldByIndex"
    " getProtoFieldByIndex getProtoNumberOfFields getProto getStaticBalance"
    " moveViewpoint setVisibility enableContactPointsTracking"
    " disableContactPointsTracking enablePoseTracking disablePoseTracking getFromProtoDef",
    "Field": "disableSFTracking enableSFTracking importSFNode importSFNodeFromString removeSF insertMFBool"
    " insertMFColor insertMFFloat insertMFInt32 insertMFRotation insertMFString insertMFVec2f insertMFVec3f",
    "GPS": "convertToDegreesMinutesSeconds",
    "Camera": "setFov getMinFov getMaxFov"
    " getExposure getFocalDistance getFocalLength getMaxFocalDistance getMinFocalDistance"
    " setExposure setFocalDistance getRecognitionSegmentationImage getRecognitionSegmentationImageArray"
    "  hasRecognitionSegmentation isRecognitionSegmentationEnabled"
    " disableRecognitionSegmentation enableRecognitionSegmentation saveRecognitionSegmentationImage",
    "Display": "attachCamera detachCamera imageCopy imageDelete imageLoad imageNew imagePaste imageSave",
    "Lidar": "setFrequency",
    "Motor": "getBrake",
    "PositionSensor": "getBrake",
    "Brake": "setDampingConstant getMotor getPositionSensor getType",
    "Altimeter": "enable disable getSamplingPeriod getValue",
    "Speaker": "getEngine getLanguage",
    "Connector": "disablePresence enablePresence getPresence getPresenceSamplingPeriod isLocked lock unlock",
    "Pen": "write",
    "Microphone": "enable getSampleData getSampleSize",
    "VacuumGripper": "turnOn turnOff isOn enablePresence disablePresence getPresence",
    "Skin": "getBoneCount getBoneName getBoneOrientation getBonePosition setBoneOrientation setBonePosition",
    "Radar": "enable disable getSamplingPeriod getMinRange getMaxRange getHorizontalFov getVerticalFov"
    " getNumberOfTargets getTargets",
    "Radio": "enable send setAddress setChannel setFrequency setTxPower",
}
"""The functions of each class that deepbots does not have."""


class Unimplemented:
    """A class of Webots that controllers may name, such as in type hints, and that has no function here."""

    def __init__(self, *_: Any, **__: Any) -> None:
        raise NotImplementedCallError(f"controller.{type(self).__name__} is not implemented")


def missing_attribute(owner: type, name: str) -> AttributeError:
    """Return the error for an attribute that an object of the module `controller` does not have."""
    for base in owner.__mro__:
        if name in MISSING.get(base.__name__, "").split():
            return NotImplementedCallError(f"{base.__name__}.{name} is not implemented")
    public = [word for base in owner.__mro__ for word in vars(base) if not word.startswith("_")]
    return AttributeError(f"'{owner.__name__}' has no attribute '{name}'{did_you_mean(name, public)}")


# What devices share


def returns(attribute: str, convert: Callable[[Any], Any] = lambda value: value) -> Callable[[Any], Any]:
    """Return a method that returns an attribute of its object, such as `_state.acceleration`, as a `list` or
    by its number of items, `len`."""
    read = attrgetter(attribute)
    return lambda instance: convert(read(instance))


def returns_number(field: str, convert: Callable[[float], float] = float) -> Callable[[Any], float]:
    """Return a method of a device that returns a number of its node, a whole one with `int`."""
    return lambda device: convert(number(device._spec.node, field))


class _NamedDevices(ABCMeta):
    """Returns a device of the robot for its name, such as `GPS("gps", 32)`. As in Webots, a sensor is
    enabled, without a period for each basic time step."""

    def __call__(cls, *arguments: Any, **named: Any) -> Any:
        if not (arguments and isinstance(arguments[0], str)):
            return super().__call__(*arguments, **named)
        from deepbots_webots.supervisor import Robot

        robot = Robot()
        name, *periods = *arguments, *named.values()
        device = robot.getDevice(name)
        if isinstance(device, Sensor):
            device.enable(*(periods or [robot.getBasicTimeStep()]))
        return device


class Device(metaclass=_NamedDevices):
    """A device of a robot."""

    def __init__(self, simulation: Simulation, spec: Spec) -> None:
        self._simulation, self._spec = simulation, spec
        self.renew()

    def __getattr__(self, name: str) -> Any:
        raise missing_attribute(type(self), name)

    def renew(self) -> None:
        """Read the fields of the node, also after a supervisor set one."""

    getName = returns("_spec.name")

    def getModel(self) -> str:
        return text(self._spec.node, "model") if "model" in parameters(self._spec.node) else ""

    def _frame(self) -> Frame:
        return self._simulation.physics.frame(self._spec.body, self._spec.frame)

    def _warn(self, message: str) -> None:
        print(f"Warning: {self._spec.name}: {message}", file=sys.stderr)

    def _noise(self, deviation: float) -> float:
        # A device without noise draws nothing, so that it does not shift the draws of others.
        return self._simulation.random.gauss(0.0, deviation) if deviation else 0.0

    def _rounded(self, value: float) -> float:
        resolution = number(self._spec.node, "resolution")
        return round(value / resolution) * resolution if resolution > 0 else value


class Sampled:
    """What measures once in each sampling period, ms, from the end of the first one on."""

    _simulation: Simulation
    period: int = 0
    """The sampling period in whole basic time steps; `due` is the time of the next measurement."""
    due: int = 0
    _asked: int = 0

    def enable(self, samplingPeriod: int) -> None:
        self._asked = int(samplingPeriod)
        self._begin()
        self._simulation.enable(self, self._asked)

    def disable(self) -> None:
        self._asked = 0
        self._simulation.disable(self)

    getSamplingPeriod = returns("_asked")

    def _begin(self) -> None:
        """Prepare the first measurement."""

    @abstractmethod
    def sample(self) -> None:
        """Measure."""

    def hear(self, packet: Packet) -> None:
        """Take a message that is sent."""

    def forget(self) -> None:
        """Discard the state from before a reset of the world."""


class Sensor(Device, Sampled):
    """A device that measures once in each sampling period."""

    def enable(self, samplingPeriod: int) -> None:
        if not 1 <= samplingPeriod < math.inf:
            raise ValueError(
                f"enable({samplingPeriod:g}) of '{self._spec.name}': a sampling period is at least 1 ms;"
                f" write {self._simulation.basic_step} for each basic time step"
            )
        super().enable(samplingPeriod)


class ScalarSensor(Sensor):
    """A sensor of one number."""

    _value = nan
    getValue = returns("_value")


class HasLookupTable(Sensor):
    """A sensor with a lookup table: rows of a measurement, the response, and the share of noise in it."""

    def renew(self) -> None:
        self._table = vectors(self._spec.node, "lookupTable")

    getLookupTable = returns("_table", lambda table: [*chain(*table)])

    def _response(self, value: float) -> float:
        """Return the response to a measurement, with noise; the measurement without a table."""
        answer, share = look_up(self._table, value)
        return self._rounded(answer * (1.0 + self._noise(share)))


class VectorSensor(HasLookupTable):
    """A sensor of three numbers, in its own frame; an axis that is switched off reads NaN."""

    _values: Triple = (nan, nan, nan)

    def renew(self) -> None:
        super().renew()
        self._axes = tuple(boolean(self._spec.node, f"{axis}Axis") for axis in "xyz")

    getValues = returns("_values", list)

    @abstractmethod
    def _measure(self) -> Triple:
        """Return the three numbers of now."""

    def sample(self) -> None:
        x, y, z = (
            self._response(value) if is_on else nan
            for value, is_on in zip(self._measure(), self._axes, strict=True)
        )
        self._values = x, y, z


def look_up(table: Sequence[Triple], value: float) -> tuple[float, float]:
    """Interpolate the response and its share of noise between the rows of a lookup table. Beyond the ends of
    the table, the nearest row applies."""
    if not table:
        return value, 0.0
    if value <= table[0][0]:
        return table[0][1], table[0][2]
    for (low, first, quiet), (high, last, loud) in pairwise(table):
        if value <= high:
            share = (value - low) / (high - low) if high > low else 1.0
            return first + share * (last - first), quiet + share * (loud - quiet)
    return table[-1][1], table[-1][2]


SONAR_CONE = math.cos(math.pi / 8)
"""The cosine of the largest angle of incidence at which a sonar hears its echo."""


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
        # A sensor that is due measures right after the reset, in the same basic time step.
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
        return frames.rotate_back(self._frame()[1], self._simulation.scene.directions[NORTH])


class InertialUnit(Sensor):
    """Orientation in the world; a quaternion is x, y, z, w."""

    # In libController, this memory alone is not set to NaN; projects read it before their first step.
    _angles: Triple = (0.0, 0.0, 0.0)
    _turned: Quaternion = (0.0, 0.0, 0.0, 0.0)
    getRollPitchYaw = returns("_angles", list)
    getQuaternion = returns("_turned", list)
    getNoise = returns_number("noise")

    def sample(self) -> None:
        rotation = self._frame()[1]
        noise, node = self.getNoise(), self._spec.node
        x, y, z = (
            self._rounded(angle + self._noise(noise)) if boolean(node, f"{axis}Axis") else nan
            for axis, angle in zip("xyz", self._roll_pitch_yaw(rotation), strict=True)
        )
        self._angles = x, y, z
        self._turned = self._rotation(x, y, z) if noise else rotation

    def _rotation(self, roll: float, pitch: float, yaw: float) -> Quaternion:
        """Return the rotation with these angles, of which `_roll_pitch_yaw` is the inverse."""
        if self._simulation.scene.directions[UP] == AXES[UP]:
            return frames.quaternion(roll, pitch, yaw)
        x, y, z, w = frames.quaternion(roll, -pitch, yaw)
        return x, z, -y, w

    def _roll_pitch_yaw(self, rotation: Quaternion) -> Triple:
        """Return the angles about x, about the axis to its left, and about the upward one."""
        if self._simulation.scene.directions[UP] == AXES[UP]:
            return frames.roll_pitch_yaw(rotation)
        x, y, z, w = rotation
        roll, pitch, yaw = frames.roll_pitch_yaw((x, -z, y, w))
        return roll, -pitch, yaw


class GPS(Sensor):
    """Position (m) and velocity (m/s) in the world."""

    LOCAL, WGS84 = 0, 1
    _values: Triple = (nan, nan, nan)
    _speed: Triple = (nan, nan, nan)
    getValues = returns("_values", list)

    getSpeed = returns("_speed", lambda speed: math.hypot(*speed))
    getSpeedVector = returns("_speed", list)
    getCoordinateSystem = returns("LOCAL")

    def sample(self) -> None:
        spec, node = self._spec, self._spec.node
        accuracy, blur = number(node, "accuracy"), number(node, "speedNoise")
        x, y, z = (self._rounded(coordinate + self._noise(accuracy)) for coordinate in self._frame()[0])
        self._values = x, y, z
        moving = self._simulation.physics.velocity(spec.body, spec.frame)[0]
        u, v, w = (component + self._noise(blur) for component in moving)
        self._speed = u, v, w


# Surroundings


class DistanceSensor(ScalarSensor, HasLookupTable):
    """The response of a lookup table to the distance along rays. Rays pass through the robot of the
    sensor."""

    GENERIC, INFRA_RED, SONAR, LASER = 0, 1, 2, 3

    def renew(self) -> None:
        super().renew()
        node = self._spec.node
        self._type = text(node, "type")
        self._reach = max((row[0] for row in self._table), default=0.0)
        count, aperture = integer(node, "numberOfRays"), number(node, "aperture")
        self._directions = ray_directions(1 if self._type == "laser" else max(1, count), aperture)
        self._weights = _ray_weights(self._directions, aperture, number(node, "gaussianWidth"))

    getType = returns("_type", lambda kind: {"infra-red": 1, "sonar": 2, "laser": 3}.get(kind, 0))
    getMaxValue = returns("_table", lambda table: max((row[1] for row in table), default=nan))
    getMinValue = returns("_table", lambda table: min((row[1] for row in table), default=nan))
    getAperture = returns_number("aperture")

    def sample(self) -> None:
        self._value = self._response(self._distance())

    def _distance(self) -> float:
        """Return the distance that the lookup table gets, m."""
        start, rotation = self._frame()
        physics = self._simulation.physics
        directions = [frames.rotate(rotation, direction) for direction in self._directions]
        reach = self._reach or 1e3
        hits = physics.cast(start, directions, reach, self._spec.body.robot)
        if self._type in ("sonar", "laser"):
            return min(
                reach if self._type == "sonar" and cosine < SONAR_CONE else distance
                for distance, _, cosine in hits
            )
        # A surface that reflects less looks farther away to an infra-red sensor of Webots.
        if self._type == "infra-red":
            distances = [
                distance / physics.geoms[geom][1].reflection if geom >= 0 else distance
                for distance, geom, _ in hits
            ]
        else:
            distances = [distance for distance, _, _ in hits]
        return sum(map(math.prod, zip(self._weights, distances, strict=True)))


class TouchSensor(ScalarSensor, HasLookupTable):
    """A bumper (0 or 1), or the contact force on its bounding object, N."""

    BUMPER, FORCE, FORCE3D = 0, 1, 2
    _values: Triple = (nan, nan, nan)
    getValues = returns("_values", list)

    def getType(self) -> int:
        return {"force": 1, "force-3d": 2}.get(text(self._spec.node, "type"), 0)

    def sample(self) -> None:
        physics, node = self._simulation.physics, self._spec.node
        total: Triple = (0.0, 0.0, 0.0)
        touches = False
        for first, second, _, force in physics.contacts():
            for geom, sign in ((second, 1.0), (first, -1.0)):
                if physics.geoms[geom][1].owner is node:
                    touches, total = True, frames.add(total, frames.scaled(force, sign))
        self._values = frames.rotate_back(self._frame()[1], total)
        self._value = self._response(abs(self._values[0])) if self.getType() else float(touches)


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


SUN_DISTANCE_M = 1000.0
"""The distance of a DirectionalLight in the search for obstacles, m."""


class LightSensor(ScalarSensor, HasLookupTable):
    """The response of a lookup table to the irradiance, W/m^2."""

    def sample(self) -> None:
        self._value = self._response(self._irradiance())

    def _irradiance(self) -> float:
        """Return the mean over the colors of the light that arrives, through the color filter."""
        node, physics = self._spec.node, self._simulation.physics
        position, rotation = self._frame()
        normal = frames.rotate(rotation, (1.0, 0.0, 0.0))
        total = 0.0
        for light in self._simulation.scene.lights:
            if not boolean(light.node, "on") or light.node.type == "SpotLight":
                continue
            frame = light.frame if light.body is None else physics.frame(light.body, light.frame)
            direction, distance, attenuation = _beam(light.node, frame, position)
            direct = number(light.node, "intensity") * max(0.0, frames.dot(normal, direction))
            if direct and boolean(node, "occlusion"):
                hits = physics.cast(position, [direction], distance, self._spec.body.robot)
                direct *= hits[0][1] < 0
            color = frames.dot(vector(light.node, "color"), vector(node, "colorFilter")) / 3
            # As in Webots, a source with an attenuation has no ambient intensity.
            has_ambient = (
                light.node.type == "DirectionalLight" or vector(light.node, "attenuation") == AXES[0]
            )
            ambient = number(light.node, "ambientIntensity") if has_ambient else 0.0
            total += attenuation * (ambient + direct) * color
        return total


def _beam(node: Node, frame: Frame, position: Triple) -> tuple[Triple, float, float]:
    """Return the direction to a source and its distance from a position, m; and the share of its intensity
    that arrives there, 1 / (a + b d + c d^2)."""
    if node.type == "DirectionalLight":
        back = frames.scaled(_unit(vector(node, "direction")), -1.0)
        return frames.rotate(frame[1], back), SUN_DISTANCE_M, 1.0
    source = compose(frame, (vector(node, "location"), IDENTITY_ROTATION))[0]
    offset = frames.subtract(source, position)
    distance = math.hypot(*offset)
    constant, linear, square = vector(node, "attenuation")
    weakened = constant + linear * distance + square * distance**2
    return _unit(offset), distance, 1 / weakened if weakened > 0 else 0.0


def _unit(values: Triple) -> Triple:
    length = math.hypot(*values)
    return frames.scaled(values, 1 / length) if length else values
