"""The sensor kinds of this version, and what each reads.

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
    """`fact` is the world function that the sensor measures."""

    fact: str
    of: Literal["joints", "link"]


SENSOR_KINDS: dict[str, SensorKind] = {
    "joint_position": SensorKind("joint_position", "joints"),
    "joint_velocity": SensorKind("joint_velocity", "joints"),
    "joint_torque": SensorKind("joint_torque", "joints"),
    "position": SensorKind("position", "link"),
    "velocity": SensorKind("velocity", "link"),
}


def reading(robot: str, sensor: Sensor, component: str | None) -> Scalar:
    """The fact that one component of a sensor measures."""
    kind = SENSOR_KINDS[sensor.kind]
    if kind.of == "joints":
        return World(kind.fact, (f"{robot}.{component or sensor.subjects[0]}",))
    return World(kind.fact, (f"{robot}.{sensor.subjects[0]}",), component)
