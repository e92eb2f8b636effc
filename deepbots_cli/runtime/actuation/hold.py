"""What keeps a robot where it is from a reset to its first command."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from deepbots_cli.port import Engine, MotorWriter
from deepbots_cli.program.robots import Actuator, Motor


@runtime_checkable
class Drive(Protocol):
    """An actuator with a state of its own."""

    def reset(self) -> None:
        """As before the first command: it exerts nothing."""

    def hold(self) -> None:
        """Keep what it drives where it is, as far as it can."""


def hold(engine: Engine, robot: str, actuator: Actuator, drive: MotorWriter | Drive) -> None:
    """Keep what an actuator drives where it is; a motor that commands torques lets its joints go."""
    if isinstance(drive, Drive):
        drive.hold()
    elif isinstance(actuator, Motor) and actuator.kind == "velocity_motor":
        drive((0.0,) * len(actuator.joints))
    elif isinstance(actuator, Motor) and actuator.kind == "position_motor":
        drive([state[0] for state in engine.joint_states(robot, actuator.joints)()])
