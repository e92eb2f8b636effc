"""Motors, brakes and sensors of joints, as the module `controller` has them."""

from __future__ import annotations

import math
import sys
from typing import TYPE_CHECKING, Any

from deepbots_cli.webots.device import Device, ScalarSensor
from deepbots_cli.webots.nodes import number

if TYPE_CHECKING:
    from deepbots_cli.webots.scene import Device as Spec
    from deepbots_cli.webots.simulation import Simulation


class JointDevice(Device):
    """A device of a joint."""

    def getType(self) -> int:
        return 1 if self._spec.joint is not None and self._spec.joint.kind == "slide" else 0

    def _sibling(self, *types: str) -> Any:
        from deepbots_cli.webots.devices import device_object

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
        self._value = physics.motors.torque(physics.motors[self._spec.node])


class Motor(JointDevice):
    """A motor of a joint: position (rad or m), velocity (per s), or torque (N m or N)."""

    ROTATIONAL, LINEAR = 0, 1

    def __init__(self, simulation: Simulation, spec: Spec) -> None:
        super().__init__(simulation, spec)
        self._state = simulation.physics.motors[spec.node]
        self._feedback = _Feedback(simulation, spec)
        self._range = number(spec.node, "minPosition"), number(spec.node, "maxPosition")

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
