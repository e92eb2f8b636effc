"""What keeps a robot where it is while its world settles."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from deepbots_cli.ir import Motor
from deepbots_cli.port import Engine, MotorWriter


@runtime_checkable
class Drive(Protocol):
    """An actuator with a state of its own."""

    def reset(self) -> None:
        """As before the first command: it exerts nothing."""

    def hold(self) -> None:
        """Keep what it drives where it is, as far as it can."""


def hold(engine: Engine, robot: str, motor: Motor, drive: MotorWriter | Drive) -> None:
    """Keep the joints of a motor where they are; one that commands torques lets them go."""
    if isinstance(drive, Drive):
        drive.hold()
    elif motor.kind == "velocity_motor":
        drive((0.0,) * len(motor.joints))
    elif motor.kind == "position_motor":
        drive([state[0] for state in engine.joint_states(robot, motor.joints)()])
