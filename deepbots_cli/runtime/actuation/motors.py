"""Motors with a strength, and with a delay, a lag or a limited rate of change."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf

from deepbots_cli.port import Engine, MotorWriter
from deepbots_cli.program.robots import MotorKind
from deepbots_cli.runtime.actuation.response import Response

PerJoint = float | Sequence[float]
"""One for all joints, or one for each."""


class Motor:
    """Joints that are driven together; called with one target per joint.

    What `strength` multiplies is the torque or force that the motor would exert without it: its limit, the gains of
    its spring, the target of a torque motor. Strength, limits and gains may be set between two episodes and are in
    force from the next `reset`.
    """

    def __init__(
        self,
        engine: Engine,
        kind: MotorKind,
        robot: str,
        joints: Sequence[str],
        max_torque: PerJoint,
        *,
        stiffness: PerJoint | None = None,
        damping: PerJoint | None = None,
        strength: PerJoint = 1.0,
        substep: float | None = None,
        delay: float = 0.0,
        lag: float = 0.0,
        rates: Sequence[float] = (),
    ) -> None:
        """`rates` bounds how fast targets change, in their unit per s.

        With `substep`, the length of one in s, the motor follows its commands in every substep; without, at once.
        """
        self.max_torque = max_torque
        self.stiffness = stiffness
        self.damping = damping
        self.strength = strength
        self._engine, self._kind, self._robot, self._joints = engine, kind, robot, joints
        self._states = engine.joint_states(robot, joints)
        self._bound: object = None
        self.response = None if substep is None else Response(substep, self._rest, delay, lag, rates)
        self.reset()
        if self.response is not None:
            engine.before_substep(self._act)

    def __call__(self, targets: Sequence[float]) -> None:
        if self.response is None:
            self._exert(targets)
        else:
            self.response.send(targets)

    def reset(self) -> None:
        """Take strength, limits and gains as they are now, and forget all commands."""
        bound = (self.max_torque, self.stiffness, self.damping, self.strength)
        if bound != self._bound:
            self._bound = bound
            self._bind()
        if self.response is not None:
            self.response.reset()

    def hold(self) -> None:
        """Keep the joints where they are, as far as a motor of this kind can."""
        if self._kind != "torque_motor":
            rest = self._rest()
            self._exert(rest)
            if self.response is not None:
                self.response.start(rest)

    def _rest(self) -> Sequence[float]:
        """The targets at which the joints stay where they are."""
        if self._kind == "position_motor":
            return [state[0] for state in self._states()]
        return [0.0] * len(self._joints)

    def _act(self) -> None:
        targets = self.response.advance() if self.response is not None else None
        if targets is not None:
            self._exert(targets)

    def _exert(self, targets: Sequence[float]) -> None:
        if self._kind == "torque_motor":
            targets = [share * target for share, target in zip(self._shares, targets, strict=True)]
        self._write(targets)

    def _bind(self) -> None:
        self._shares = [max(0.0, strength) for strength in self._each(self.strength)]
        limits = [share * limit if limit < inf else inf for share, limit in zip(self._shares, self._each(self.max_torque), strict=True)]
        engine, robot, joints = self._engine, self._robot, self._joints
        if self._kind == "velocity_motor":
            self._write: MotorWriter = engine.velocity_motor(robot, joints, limits)
        elif self._kind == "torque_motor":
            self._write = engine.torque_motor(robot, joints, limits)
        else:
            self._write = engine.position_motor(robot, joints, limits, self._scaled(self.stiffness), self._scaled(self.damping))

    def _scaled(self, gain: PerJoint | None) -> list[float] | None:
        """A gain of the spring in each joint, as strong as that motor is."""
        return None if gain is None else [share * max(0.0, each) for share, each in zip(self._shares, self._each(gain), strict=True)]

    def _each(self, values: PerJoint) -> Sequence[float]:
        return (values,) * len(self._joints) if isinstance(values, (int, float)) else values
