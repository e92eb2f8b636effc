"""Servos: how fast an engine's own is, and springs with dampers for all of them."""

from __future__ import annotations

from collections.abc import Sequence

from deepbots_cli.port import JointReader, MotorWriter

SERVO_TIME = 0.02  # s in which an engine's own servo, without stiffness, closes all but 1/e of its error


class Servo:
    """Exerts `stiffness * (target - position) - damping * velocity` once it has targets; `act` renews it."""

    def __init__(self, read: JointReader, exert: MotorWriter, stiffness: Sequence[float], damping: Sequence[float] | None) -> None:
        self.targets: Sequence[float] | None = None
        self._read, self._exert = read, exert
        self._gains = tuple(zip(stiffness, damping or (0.0,) * len(stiffness), strict=True))

    def aim(self, targets: Sequence[float]) -> None:
        self.targets = tuple(targets)

    def act(self) -> None:
        if self.targets is not None:
            sides = zip(self._gains, self.targets, self._read(), strict=True)
            self._exert([stiffness * (target - state[0]) - damping * state[1] for (stiffness, damping), target, state in sides])
