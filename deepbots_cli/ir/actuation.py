"""What a robot can drive, and how promptly and strongly that answers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

MotorKind = Literal["velocity_motor", "position_motor", "torque_motor"]


@dataclass(frozen=True)
class Response:
    """How an actuator answers its commands; `delay` and `lag` in s.

    Whatever torque, force or thrust it would exert is multiplied by `strength`. A command takes effect `delay` after
    it was given, and is followed with the time constant `lag`.
    """

    strength: float = 1.0
    delay: float = 0.0
    lag: float = 0.0


@dataclass(frozen=True)
class Motor:
    """Joints that are driven. Limits in N m or N, rad/s or m/s, one per joint; None is unlimited.

    `max_velocity` bounds the targets of a velocity motor, and how fast those of a position motor move;
    `max_acceleration` (rad/s^2 or m/s^2) how fast those of a velocity motor change.
    """

    name: str
    kind: MotorKind
    joints: tuple[str, ...]
    max_torque: tuple[float | None, ...]
    max_velocity: tuple[float | None, ...]
    stiffness: float | None = None
    damping: float | None = None
    max_acceleration: float | None = None
    response: Response = Response()

    @property
    def parts(self) -> tuple[str, ...]:
        """What it drives, each with figures of its own."""
        return self.joints

    @property
    def components(self) -> tuple[str, ...]:
        """What its command has one number for."""
        return self.joints


@dataclass(frozen=True)
class Thrust:
    """Links that are pushed along their z axis with `low` to `high` N, as by a rotor.

    Each is turned about that axis with `drag` (m) times thrust times its `spin`.
    """

    name: str
    links: tuple[str, ...]
    low: float
    high: float
    drag: float
    spin: tuple[float, ...]
    response: Response = Response()

    @property
    def parts(self) -> tuple[str, ...]:
        return self.links

    @property
    def components(self) -> tuple[str, ...]:
        return self.links


@dataclass(frozen=True)
class Cartesian:
    """Joints that bring the origin of a link to a commanded position (m, world frame), in the attitude `rpy` (rad) or any.

    They are driven by the servo of the engine, within the ranges that the robot file gives them.
    """

    name: str
    link: str
    joints: tuple[str, ...]
    rpy: tuple[float, float, float] | None
    max_torque: tuple[float | None, ...]
    max_velocity: tuple[float | None, ...]
    response: Response = Response()

    @property
    def parts(self) -> tuple[str, ...]:
        return self.joints

    @property
    def components(self) -> tuple[str, ...]:
        return ("x", "y", "z")


Actuator = Motor | Thrust | Cartesian
