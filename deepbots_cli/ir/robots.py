"""Robots as controllers: what they sense, drive, and say."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from deepbots_cli.ir.actuation import Actuator
from deepbots_cli.ir.channels import Route
from deepbots_cli.ir.sensing import Sensor
from deepbots_cli.ir.values import NamedValues

MessageFormat = Literal["csv", "json", "struct", "msgpack", "none"]
Timing = Literal["immediate", "paper"]
Direction = Literal["to_robot", "from_robot"]


@dataclass(frozen=True)
class Field:
    """One named entry of a message; a vector lists its components, a picture (`uint8`) its rows, columns and channels."""

    name: str
    unit: str
    components: tuple[str, ...] = ()
    dtype: Literal["float64", "bool", "uint8"] = "float64"
    shape: tuple[int, ...] = ()


@dataclass(frozen=True)
class MessageLayout:
    """Fields in order, and a stamp (32 bits) that changes whenever they do."""

    robot: str
    direction: Direction
    fields: tuple[Field, ...]
    stamp: int


@dataclass(frozen=True)
class Robot:
    """A controller. `receive` holds supervisor expressions; `emit` and `apply` see sensors and received fields.

    Each entry of `apply` names an actuator and has one target per component of it.
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
