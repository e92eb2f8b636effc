"""The classes Driver and Car of the module `vehicle`: a robot of the PROTO Car, whose front wheels steer.

Angles and speeds of wheels and the torque of engines follow the reference of Webots for automobiles. Speeds of
the car are in km/h, and positive angles (rad) steer right.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import atan2, copysign, hypot, inf, pi, tan
from typing import Any, NamedTuple

from deepbots_webots.devices import device_object
from deepbots_webots.scene import Device
from deepbots_webots.sensors import returns, returns_count
from deepbots_webots.simulation import Simulation
from deepbots_webots.supervisor import Robot, Supervisor

_MIN_SPEED = 1e-3  # of a wheel, rad/s; the brake of a slower one has less torque


class _Wheel(NamedTuple):
    """A wheel: how far it is ahead of the middle of the rear axle and to the left (m), its radius (m), its brake,
    and its motor if it is driven."""

    ahead: float
    left: float
    radius: float
    brake: Any
    motor: Any

    def path(self, curvature: float) -> float:
        """Return the length of the path of the wheel while the middle of the rear axle moves by 1 m."""
        across = 1 + curvature * self.left
        return copysign(hypot(across, curvature * self.ahead), across)

    @property
    def speed(self) -> float:
        """The speed, rad/s."""
        return float(self.brake._simulation.physics.joint_velocity(self.brake._spec.joint))


class _Vehicle:
    """The numbers of a car, which are the words of its customData, its wheels, and what its driver asked for."""

    def __init__(self, words: list[str], simulation: Simulation, devices: Mapping[str, Device]) -> None:
        """Read the numbers.

        Raises:
            LookupError, ValueError: The robot is no car.
        """
        self.engine = "CEPS".index(words[7])
        values = [float(word) for word in (*words[:7], *words[8 : 20 + int(words[18])])]
        self.wheelbase, self.track_front, self.track_rear, self.front_radius, self.rear_radius = values[:5]
        self.brake_torque, self.max_torque, self.max_power, self.min_rpm, self.max_rpm = (
            values[5],
            *values[7:11],
        )
        self.coefficients, (self.split_ratio, self.split_rpm) = values[11:14], values[14:16]
        self.gears = values[19:]
        parts = {name: device_object(simulation, spec) for name, spec in devices.items() if spec.joint}
        self.steering: tuple[Any, Any] = parts["right_steer"], parts["left_steer"]
        front = "front", self.wheelbase, self.track_front / 2, self.front_radius
        rear = "rear", 0.0, self.track_rear / 2, self.rear_radius
        self.wheels = [
            _Wheel(ahead, sign * left, radius, parts[f"{side}_{end}_brake"], parts.get(f"{side}_{end}_wheel"))
            for end, ahead, left, radius in (front, rear)
            for side, sign in (("right", -1), ("left", 1))
        ]
        self.driven = [wheel for wheel in self.wheels if wheel.motor is not None]
        self.drive = 2 if len(self.driven) == 4 else self.wheels.index(self.driven[0]) // 2
        self.angle = self.speed = self.throttle = self.brake = 0.0
        self.mode, self.gear = -1, 0

    def paths(self) -> list[tuple[_Wheel, float]]:
        """Return the driven wheels with their paths, as shares of the mean."""
        paths = [wheel.path(tan(self.angle) / self.wheelbase) for wheel in self.driven]
        return [
            (wheel, path * len(paths) / sum(paths)) for wheel, path in zip(self.driven, paths, strict=True)
        ]

    def ratio(self) -> float:
        return self.gears[max(self.gear, 0)] if self.gear else 0.0

    def rpm(self) -> float:
        """Return the speed of the engine by that of the wheels, 1/min."""
        speed = sum(wheel.speed for wheel in self.wheels) / len(self.wheels)
        return min(abs(speed * self.ratio()) * 30 / pi, self.max_rpm)

    def engine_torque(self, rpm: float) -> float:
        """Return the torque at full throttle, N m. A hybrid engine (2, 3) burns above its lowest speed only."""
        rate, share = (self.split_rpm, 1 - self.split_ratio) if self.engine == 3 else (rpm, 1.0)
        burned = sum(factor * max(rate, self.min_rpm) ** at for at, factor in enumerate(self.coefficients))
        electric = min(self.max_torque, self.max_power * 30 / pi / max(rpm, 1e-9))
        burns = self.engine == 0 or (self.engine > 1 and rpm >= self.min_rpm)
        return share * burned * burns + electric * (self.engine > 0)

    def act(self) -> None:
        """Let the engine and the brakes act on the wheels, by their present speeds."""
        if self.mode == Driver.TORQUE:
            rpm = self.rpm()
            torque = self.engine_torque(rpm) * self.throttle * self.ratio() * (rpm < self.max_rpm)
            for wheel, path in self.paths():
                wheel.motor.setTorque(torque * path / len(self.driven))
        for wheel in self.wheels:
            wheel.brake.setDampingConstant(self.brake * self.brake_torque / max(abs(wheel.speed), _MIN_SPEED))


def _keeps(name: str, initial: Any) -> tuple[Callable[[Any, Any], None], Callable[[Any], Any]]:
    """Return the methods that set and return what has no effect, such as a lamp."""
    return (
        lambda driver, value: driver._webots_kept.update({name: value}),
        lambda driver: driver._webots_kept.get(name, initial),
    )


class Driver(Supervisor):
    """A car, as a person drives it."""

    INDICATOR_OFF, INDICATOR_RIGHT, INDICATOR_LEFT = 0, 1, 2
    SPEED, TORQUE = 0, 1
    DOWN, SLOW, NORMAL, FAST = 0, 1, 2, 3

    def __init__(self) -> None:
        Robot.__init__(self)  # a driver need not be a supervisor
        words, devices = self.getCustomData().split(), self._webots_robot.devices
        self._webots_kept: dict[str, Any] = {}
        try:
            self._webots_car = _Vehicle(words, self._webots_simulation, devices)
        except (LookupError, ValueError):
            raise RuntimeError(
                f"'{self.getName()}' is no car; Driver and Car need a robot of the PROTO Car, such as BmwX5"
            ) from None
        self.setCruisingSpeed(0.0)
        self._webots_car.mode = -1

    def step(self, timeStep: int | float | None = None) -> int:
        self._webots_car.act()
        return super().step(timeStep)

    def setSteeringAngle(self, steeringAngle: float) -> None:
        """Turn the front wheels so that all wheels move around one point."""
        car = self._webots_car
        car.angle = float(steeringAngle)
        curvature = tan(car.angle) / car.wheelbase
        for motor, wheel in zip(car.steering, car.wheels, strict=False):
            motor.setPosition(atan2(curvature * wheel.ahead, 1 + curvature * wheel.left))
        if car.mode == self.SPEED:
            self.setCruisingSpeed(car.speed)

    def getSteeringAngle(self) -> float:
        """Return the mean of the angles of the front wheels."""
        position = self._webots_simulation.physics.joint_position
        return sum(position(motor._spec.joint) for motor in self._webots_car.steering) / 2

    def setCruisingSpeed(self, speed: float) -> None:
        """Let the driven wheels turn with the speeds that belong to a speed of the car."""
        self._webots_car.speed, self._webots_car.mode = float(speed), self.SPEED
        for wheel, path in self._webots_car.paths():
            wheel.motor.setPosition(inf)
            wheel.motor.setVelocity(speed / 3.6 * path / wheel.radius)

    def getCurrentSpeed(self) -> float:
        """Return the speed by the driven wheels, km/h."""
        driven = self._webots_car.driven
        return 3.6 * sum(wheel.speed * wheel.radius for wheel in driven) / len(driven)

    def setThrottle(self, throttle: float) -> None:
        """Let the engine drive the wheels, with a share from 0 to 1 of its torque."""
        self._webots_car.throttle, self._webots_car.mode = min(max(float(throttle), 0.0), 1.0), self.TORQUE
        self._webots_car.act()

    def setBrakeIntensity(self, intensity: float) -> None:
        """Brake all wheels, with a share from 0 to 1 of the largest torque."""
        self._webots_car.brake = min(max(float(intensity), 0.0), 1.0)
        self._webots_car.act()

    def setGear(self, gear: int) -> None:
        """Engage a gear: -1 is the reverse gear, and 0 none."""
        self._webots_car.gear = min(max(int(gear), -1), len(self._webots_car.gears) - 1)

    def getRpm(self) -> float:
        return self._webots_car.rpm()

    getTargetCruisingSpeed = returns("_webots_car.speed")
    getThrottle = returns("_webots_car.throttle")
    getBrakeIntensity = returns("_webots_car.brake")
    getGear = returns("_webots_car.gear")
    getGearNumber = returns_count("_webots_car.gears")
    getControlMode = returns("_webots_car.mode")
    setIndicator, getIndicator = _keeps("indicator", INDICATOR_OFF)
    setHazardFlashers, getHazardFlashers = _keeps("hazard flashers", False)
    setDippedBeams, getDippedBeams = _keeps("dipped beams", False)
    setAntifogLights, getAntifogLights = _keeps("antifog lights", False)
    setWiperMode, getWiperMode = _keeps("wiper mode", DOWN)


class Car(Driver):
    """A car with its dimensions and wheels."""

    TRACTION, PROPULSION, FOUR_BY_FOUR = 0, 1, 2
    COMBUSTION_ENGINE, ELECTRIC_ENGINE, PARALLEL_HYBRID_ENGINE, POWER_SPLIT_HYBRID_ENGINE = range(4)
    WHEEL_FRONT_RIGHT, WHEEL_FRONT_LEFT, WHEEL_REAR_RIGHT, WHEEL_REAR_LEFT, WHEEL_NB = range(5)

    getType = returns("_webots_car.drive")
    getEngineType = returns("_webots_car.engine")
    getWheelbase = returns("_webots_car.wheelbase")
    getTrackFront = returns("_webots_car.track_front")
    getTrackRear = returns("_webots_car.track_rear")
    getFrontWheelRadius = returns("_webots_car.front_radius")
    getRearWheelRadius = returns("_webots_car.rear_radius")
    setIndicatorPeriod, getIndicatorPeriod = _keeps("indicator period", 0.34)

    def getWheelEncoder(self, wheel_index: int) -> float:
        """Return the angle of a wheel, rad."""
        joint = self._webots_car.wheels[wheel_index].brake._spec.joint
        return self._webots_simulation.physics.joint_position(joint)

    def getWheelSpeed(self, wheel_index: int) -> float:
        return self._webots_car.wheels[wheel_index].speed
