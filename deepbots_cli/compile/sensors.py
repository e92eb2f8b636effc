"""The sensor kinds of this version: what each reads, in which unit, with which components.

One entry per kind. `of` says what a sensor is mounted on: its joints, or a link. A joint sensor on one
joint is a number, on several a vector with a component per joint.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from deepbots_cli.ir import Sensor
from deepbots_cli.lang.scalar import Scalar, World


@dataclass(frozen=True)
class SensorKind:
    """`fact` is the world function that the sensor measures; `unit` is per rad (or m, for a sliding joint) where of joints."""

    fact: str
    of: Literal["joints", "link"]
    unit: str
    sliding_unit: str = ""
    components: tuple[str, ...] = ()


SENSOR_KINDS: dict[str, SensorKind] = {
    "joint_position": SensorKind("joint_position", "joints", "rad", "m"),
    "joint_velocity": SensorKind("joint_velocity", "joints", "rad/s", "m/s"),
    "joint_torque": SensorKind("joint_torque", "joints", "N*m", "N"),
    "position": SensorKind("position", "link", "m", components=("x", "y", "z")),
    "velocity": SensorKind("velocity", "link", "m/s", components=("x", "y", "z")),
    "angular_velocity": SensorKind("angular_velocity", "link", "rad/s", components=("x", "y", "z")),
}


def reading(robot: str, sensor: Sensor, component: str | None) -> Scalar:
    """The fact that one component of a sensor measures."""
    kind = SENSOR_KINDS[sensor.kind]
    if kind.of == "joints":
        return World(kind.fact, (f"{robot}.{component or sensor.subjects[0]}",))
    return World(kind.fact, (f"{robot}.{sensor.subjects[0]}",), component)
