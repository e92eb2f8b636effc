"""The motors of a world.

A motor is a constraint with a limited force that reaches its velocity at the end of the basic time step. It
is the dry friction of the joint with a velocity of its own, so that MuJoCo solves it together with the
contacts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isinf
from typing import TYPE_CHECKING, Any

import numpy as np

from deepbots_cli.webots.nodes import number, numbers

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from deepbots_cli.webots.scene import Joint
    from deepbots_cli.webots.syntax import Node

    Floats = NDArray[np.float64]

MAX_TORQUE = 1e8


@dataclass(eq=False)
class MotorState:
    """The state of a motor: its commands, and its motion in the present basic time step.

    Positions in rad or m, velocities per s, torques in N m or N.
    """

    joint: Joint
    dof: int
    position_address: int
    max_velocity: float
    max_torque: float
    gains: tuple[float, float, float]
    acceleration: float
    target_position: float = 0.0
    target_velocity: float = 0.0
    available_torque: float = 0.0
    torque: float | None = None
    velocity: float = 0.0
    integral: float = 0.0
    last_error: float = 0.0

    def reset(self, position: float) -> None:
        """Set the state in which Webots starts a motor: it keeps its position."""
        self.target_position, self.target_velocity = position, self.max_velocity
        self.available_torque, self.torque = self.max_torque, None
        self.velocity = self.integral = self.last_error = 0.0

    def next_velocity(self, position: float, step: float) -> float:
        """Return the target velocity in a basic time step of `step` s, from the present position."""
        velocity = self.target_velocity
        if not isinf(self.target_position):
            p, i, d = self.gains
            error = self.target_position - position
            self.integral += error * step
            velocity = p * error + i * self.integral + d * (error - self.last_error) / step
            self.last_error = error
            velocity = min(max(velocity, -self.target_velocity), self.target_velocity)
        if self.acceleration >= 0:
            max_change = self.acceleration * step
            velocity = min(max(velocity, self.velocity - max_change), self.velocity + max_change)
        self.velocity = velocity
        return velocity


class Motors:
    """The motors of a world, by node. Those without a torque control and with a torque are active."""

    def __init__(self, model: Any, data: Any, joint_ids: Mapping[Joint, int]) -> None:
        self._model, self._data = model, data
        self._states = {
            joint.motor: self._state(joint, joint.motor, index)
            for joint, index in joint_ids.items()
            if joint.motor is not None
        }
        self._active: list[MotorState] = []

    def __getitem__(self, node: Node) -> MotorState:
        return self._states[node]

    def _state(self, joint: Joint, node: Node, index: int) -> MotorState:
        strength = "maxTorque" if node.type == "RotationalMotor" else "maxForce"
        p, i, d = (*numbers(node, "controlPID"), 0.0, 0.0, 0.0)[:3]
        return MotorState(
            joint,
            int(self._model.jnt_dofadr[index]),
            int(self._model.jnt_qposadr[index]),
            max(0.0, number(node, "maxVelocity")),
            min(max(0.0, number(node, strength)), MAX_TORQUE),
            (p, i, d),
            number(node, "acceleration"),
        )

    def reset(self) -> None:
        """Let all motors keep the present positions of their joints."""
        for motor in self._states.values():
            motor.reset(float(self._data.qpos[motor.position_address]))
        self.renew()

    def stop(self) -> None:
        """Set velocities to 0, and the torques of motors under torque control."""
        for motor in self._states.values():
            motor.velocity = 0.0
            if motor.torque is not None:
                self._data.qfrc_applied[motor.dof] = 0.0
                motor.torque = 0.0

    def renew(self) -> None:
        """Apply limits and modes after a change."""
        self._active = []
        for motor in sorted(self._states.values(), key=lambda motor: motor.dof):
            is_active = motor.torque is None and motor.available_torque > 0
            limit = motor.available_torque if is_active else motor.joint.friction
            self._model.dof_frictionloss[motor.dof] = limit
            self._data.qfrc_applied[motor.dof] = motor.torque or 0.0
            if is_active:
                self._active.append(motor)
        # MuJoCo has a row of friction for each of these, in this order, after the rows of equalities (`ne`).
        rows = np.flatnonzero(self._model.dof_frictionloss > 0).tolist()
        self._rows = np.array([rows.index(motor.dof) for motor in self._active], np.intp)
        self._dofs = np.array([motor.dof for motor in self._active], np.intp)

    def target_velocities(self, step: float) -> Floats:
        """Return the velocity of each active motor at the end of a basic time step of `step` s."""
        positions = self._data.qpos
        return np.array(
            [motor.next_velocity(float(positions[motor.position_address]), step) for motor in self._active]
        )

    def drive(self, targets: Floats, time: float) -> None:
        """Let the active motors reach their target velocities in `time` s. The rows of constraints exist
        after the first half of a substep."""
        if self._active:
            # A row of friction exerts at most `dof_frictionloss`; this reference makes it drive, not brake.
            velocity_change = targets - self._data.qvel[self._dofs]
            self._data.efc_aref[self._rows + self._data.ne] = velocity_change / time

    def torque(self, motor: MotorState) -> float:
        """Return the torque or force of a motor in the last substep."""
        if motor.torque is not None:
            return motor.torque
        if motor not in self._active:
            return 0.0
        row = int(self._rows[self._active.index(motor)]) + self._data.ne
        return float(self._data.efc_force[row]) if row < self._data.nefc else 0.0
