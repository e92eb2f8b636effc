"""The classes Driver and Car of the module `vehicle`: a robot of the PROTO Car, whose front wheels steer.

Angles and speeds of wheels and the torque of engines follow the reference of Webots for automobiles. Speeds of
the car are in km/h, and positive angles (rad) steer right.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from math import atan2, copysign, hypot, inf, pi, tan
from typing import Any

from deepbots_cli.records import dataclass
from deepbots_webots.devices import device_object
from deepbots_webots.scene import Device
from deepbots_webots.sensors import returns
from deepbots_webots.simulation import Simulation
from deepbots_webots.supervisor import Robot, Supervisor

_WHEELS = ("right_front", "left_front", "right_rear", "left_rear")
_MIN_SPEED = 1e-3
"""The speed of a wheel (rad/s) below which its brake has less torque."""


@dataclass(eq=False)
class _Wheel:
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


class _Vehicle:
    """The numbers of a car, which are the words of its customData, and what its driver asked for."""

    def __init__(self, words: list[str], simulation: Simulation, devices: Mapping[str, Device]) -> None:
        """Read the numbers.

        Raises:
            LookupError, ValueError: The robot is no car.
        """
        self.engine = "CEPS".index(words[7])
        values = [float(word) for word in (*words[:7], *words[8 : 20 + int(words[18])])]
        self.wheelbase, self.track_front, self.track_rear, self.front_radius, self.rear_radius = values[:5]
        self.brake_coefficient = values[5]
        self.max_torque, self.max_power, self.min_rpm, self.max_rpm = values[7:11]
        self.coefficients, self.split_ratio, self.split_rpm = values[11:14], values[14], values[15]
        self.gears = values[19:]
        parts = {name: device_object(simulation, spec) for name, spec in devices.items() if spec.joint}
        self.steering: tuple[Any, Any] = parts["right_steer"], parts["left_steer"]
        front = self.wheelbase, self.track_front / 2, self.front_radius
        rear = 0.0, self.track_rear / 2, self.rear_radius
        self.wheels = [
            _Wheel(ahead, side * left, radius, parts[f"{name}_brake"], parts.get(f"{name}_wheel"))
            for name, side, (ahead, left, radius) in zip(
                _WHEELS, (-1, 1, -1, 1), (front, front, rear, rear), strict=True
            )
        ]
        self.driven = [wheel for wheel in self.wheels if wheel.motor is not None]
        self.drive = 2 if len(self.driven) == 4 else int(self.wheels[0].motor is None)
        self.angle = self.speed = self.throttle = self.brake = 0.0
        self.mode, self.gear, self.indicator, self.wiper = -1, 0, 0, 0
        self.hazard = self.beams = self.antifog = False
        self.period = 0.34

    def shares(self) -> list[float]:
        """Return the path of each driven wheel, as a share of their mean."""
        paths = [wheel.path(tan(self.angle) / self.wheelbase) for wheel in self.driven]
        return [path * len(paths) / sum(paths) for path in paths]

    def torque(self, rpm: float) -> float:
        """Return the torque of the engine at full throttle, N m."""
        torque = 0.0
        if self.engine == 0 or (self.engine > 1 and rpm >= self.min_rpm):
            rate = max(rpm, self.min_rpm) if self.engine < 3 else self.split_rpm
            share = 1.0 if self.engine < 3 else 1 - self.split_ratio
            torque += share * sum(factor * rate**power for power, factor in enumerate(self.coefficients))
        if self.engine > 0:
            torque += min(self.max_torque, self.max_power * 30 / pi / max(rpm, 1e-9))
        return torque if rpm < self.max_rpm else 0.0


class Driver(Supervisor):
    """A car, as a person drives it."""

    INDICATOR_OFF, INDICATOR_RIGHT, INDICATOR_LEFT = 0, 1, 2
    SPEED, TORQUE = 0, 1
    DOWN, SLOW, NORMAL, FAST = 0, 1, 2, 3

    def __init__(self) -> None:
        Robot.__init__(self)  # a driver need not be a supervisor
        words, devices = self.getCustomData().split(), self._webots_robot.devices
        try:
            self._webots_car = _Vehicle(words, self._webots_simulation, devices)
        except (LookupError, ValueError):
            raise RuntimeError(
                f"'{self.getName()}' is no car; Driver and Car need a robot of the PROTO Car, such as BmwX5"
            ) from None
        for wheel in self._webots_car.driven:
            wheel.motor.setPosition(inf)
            wheel.motor.setVelocity(0.0)

    def step(self, timeStep: int | float | None = None) -> int:
        self._act()
        return super().step(timeStep)

    def _act(self) -> None:
        """Let the engine and the brakes act on the wheels, by their present speeds."""
        car = self._webots_car
        if car.mode == self.TORQUE:
            ratio = 0.0 if car.gear == 0 else car.gears[max(car.gear, 0)]
            torque = car.torque(self.getRpm()) * car.throttle * ratio / len(car.driven)
            for wheel, share in zip(car.driven, car.shares(), strict=True):
                wheel.motor.setTorque(torque * share)
        for wheel in car.wheels:
            speed = max(abs(self._wheel_speed(wheel)), _MIN_SPEED)
            wheel.brake.setDampingConstant(car.brake * car.brake_coefficient / speed)

    def _wheel_speed(self, wheel: _Wheel) -> float:
        return self._webots_simulation.physics.joint_velocity(wheel.brake._spec.joint)

    # Motion

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
        return (self._angle(0) + self._angle(1)) / 2

    def _angle(self, side: int) -> float:
        """Return the angle of the right front wheel, or of the left one."""
        return self._webots_simulation.physics.joint_position(self._webots_car.steering[side]._spec.joint)

    def setCruisingSpeed(self, speed: float) -> None:
        """Let the driven wheels turn with the speeds that belong to a speed of the car."""
        car = self._webots_car
        if min(car.front_radius, car.rear_radius) <= 0:
            print("Warning: the wheels of the car have no field tireRadius", file=sys.stderr)
            return
        car.speed, car.mode = float(speed), self.SPEED
        for wheel, share in zip(car.driven, car.shares(), strict=True):
            wheel.motor.setPosition(inf)
            wheel.motor.setVelocity(car.speed / 3.6 * share / wheel.radius)

    getTargetCruisingSpeed = returns("_webots_car.speed")

    def getCurrentSpeed(self) -> float:
        """Return the speed by the driven wheels, km/h."""
        driven = self._webots_car.driven
        return 3.6 * sum(self._wheel_speed(wheel) * wheel.radius for wheel in driven) / len(driven)

    def setThrottle(self, throttle: float) -> None:
        """Let the engine drive the wheels, with a share from 0 to 1 of its torque."""
        self._webots_car.throttle, self._webots_car.mode = min(max(float(throttle), 0.0), 1.0), self.TORQUE
        self._act()

    def setBrakeIntensity(self, intensity: float) -> None:
        """Brake all wheels, with a share from 0 to 1 of the largest torque."""
        self._webots_car.brake = min(max(float(intensity), 0.0), 1.0)
        self._act()

    def setGear(self, gear: int) -> None:
        """Engage a gear: -1 is the reverse gear, and 0 none."""
        self._webots_car.gear = min(max(int(gear), -1), self.getGearNumber() - 1)

    def getRpm(self) -> float:
        """Return the speed of the engine by that of the wheels, 1/min."""
        car = self._webots_car
        ratio = 0.0 if car.gear == 0 else car.gears[max(car.gear, 0)]
        speed = sum(self._wheel_speed(wheel) for wheel in car.wheels) / len(car.wheels)
        return min(abs(speed * ratio) * 30 / pi, car.max_rpm)

    getThrottle = returns("_webots_car.throttle")
    getBrakeIntensity = returns("_webots_car.brake")
    getGear = returns("_webots_car.gear")
    getControlMode = returns("_webots_car.mode")

    def getGearNumber(self) -> int:
        return len(self._webots_car.gears)

    # Lamps and wipers, without effect

    def setIndicator(self, state: int) -> None:
        self._webots_car.indicator = int(state)

    def setHazardFlashers(self, state: bool) -> None:
        self._webots_car.hazard = bool(state)

    def setDippedBeams(self, state: bool) -> None:
        self._webots_car.beams = bool(state)

    def setAntifogLights(self, state: bool) -> None:
        self._webots_car.antifog = bool(state)

    def setWiperMode(self, mode: int) -> None:
        self._webots_car.wiper = int(mode)

    getIndicator = returns("_webots_car.indicator")
    getHazardFlashers = returns("_webots_car.hazard")
    getDippedBeams = returns("_webots_car.beams")
    getAntifogLights = returns("_webots_car.antifog")
    getWiperMode = returns("_webots_car.wiper")


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
    getIndicatorPeriod = returns("_webots_car.period")

    def setIndicatorPeriod(self, period: float) -> None:
        self._webots_car.period = float(period)

    def getWheelEncoder(self, wheel_index: int) -> float:
        """Return the angle of a wheel, rad."""
        joint = self._webots_car.wheels[wheel_index].brake._spec.joint
        return self._webots_simulation.physics.joint_position(joint)

    def getWheelSpeed(self, wheel_index: int) -> float:
        """Return the speed of a wheel, rad/s."""
        return self._wheel_speed(self._webots_car.wheels[wheel_index])

    def setRightSteeringAngle(self, angle: float) -> None:
        self._webots_car.steering[0].setPosition(angle)

    def setLeftSteeringAngle(self, angle: float) -> None:
        self._webots_car.steering[1].setPosition(angle)

    def getRightSteeringAngle(self) -> float:
        return self._angle(0)

    def getLeftSteeringAngle(self) -> float:
        return self._angle(1)
