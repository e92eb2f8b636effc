"""Robots as controllers: what they sense, drive, and say."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from deepbots_cli.ir.channels import Route
from deepbots_cli.ir.sensing import Sensor
from deepbots_cli.ir.values import NamedValues

MessageFormat = Literal["csv", "json", "struct", "msgpack", "none"]
Timing = Literal["immediate", "paper"]
Direction = Literal["to_robot", "from_robot"]
ActuatorKind = Literal["velocity_motor", "position_motor", "torque_motor"]


@dataclass(frozen=True)
class Field:
    """One named entry of a message; a vector lists its components."""

    name: str
    unit: str
    components: tuple[str, ...] = ()
    dtype: Literal["float64", "bool"] = "float64"


@dataclass(frozen=True)
class MessageLayout:
    """Fields in order, and a stamp (32 bits) that changes whenever they do."""

    robot: str
    direction: Direction
    fields: tuple[Field, ...]
    stamp: int


@dataclass(frozen=True)
class Actuator:
    """What a robot can drive. Limits in N m or N, rad/s or m/s, one per joint; None is unlimited."""

    name: str
    kind: ActuatorKind
    joints: tuple[str, ...]
    max_torque: tuple[float | None, ...]
    max_velocity: tuple[float | None, ...]
    stiffness: float | None = None
    damping: float | None = None


@dataclass(frozen=True)
class Robot:
    """A controller. `receive` holds supervisor expressions; `emit` and `apply` see sensors and received fields.

    Each entry of `apply` names an actuator and has one target per joint.
    """

    name: str
    sensors: tuple[Sensor, ...]
    actuators: tuple[Actuator, ...]
    receive: tuple[NamedValues, ...]
    emit: tuple[NamedValues, ...]
    apply: tuple[NamedValues, ...]
    to_robot: MessageLayout
    from_robot: MessageLayout
    to_route: Route = Route()
    from_route: Route = Route()
