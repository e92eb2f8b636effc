"""The sensor kinds, and what each measures.

One entry per kind. A sensor that reads one fact of the engine, sits in the origin of its link and has no
faults is that fact, read where it is needed; every other is a device of the runtime (`runtime.sensing`),
which is sampled once per tick.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

from deepbots_cli.expressions import intervals as iv
from deepbots_cli.expressions.dimensions import ACCELERATION, ANGLE, ANGULAR_VELOCITY, FORCE, LENGTH, NUMBER, SPEED, Dimension
from deepbots_cli.expressions.intervals import Interval
from deepbots_cli.expressions.scalar import Scalar, World
from deepbots_cli.expressions.types import QUATERNION, SPACE, Components
from deepbots_cli.program.robots import Sensor
from deepbots_cli.robots.model import Pose

Mounting = Literal["joints", "link", "links", "rays", "camera"]


class SensorKind(NamedTuple):
    """`of` says what it sits on; the others what it measures there, `fact` the world function that says the same.

    What joints measure depends on whether they turn or slide; kinds of joints leave `dimension` open.
    """

    of: Mounting
    dimension: Dimension = NUMBER
    components: Components = ()
    interval: Interval = iv.EVERYTHING
    truth: bool = False
    fact: str | None = None


SENSOR_KINDS: dict[str, SensorKind] = {
    "joint_position": SensorKind("joints", fact="joint_position"),
    "joint_velocity": SensorKind("joints", fact="joint_velocity"),
    "joint_torque": SensorKind("joints", fact="joint_torque"),
    "position": SensorKind("link", LENGTH, SPACE, fact="position"),
    "velocity": SensorKind("link", SPEED, SPACE, fact="velocity"),
    "orientation": SensorKind("link", NUMBER, QUATERNION, iv.SIGNED_UNIT, fact="orientation"),
    "angular_velocity": SensorKind("link", ANGULAR_VELOCITY, SPACE, fact="angular_velocity"),
    "compass": SensorKind("link", ANGLE, interval=iv.TURN),
    "gyro": SensorKind("link", ANGULAR_VELOCITY, SPACE),
    "accelerometer": SensorKind("link", ACCELERATION, SPACE),
    "inclinometer": SensorKind("link", NUMBER, SPACE, iv.SIGNED_UNIT),
    "touch": SensorKind("links", truth=True),
    "force": SensorKind("links", FORCE, interval=iv.POSITIVE),
    "infrared": SensorKind("rays", LENGTH),
    "sonar": SensorKind("rays", LENGTH),
    "laser": SensorKind("rays", LENGTH),
    "lidar": SensorKind("rays", LENGTH),
    "reflectance": SensorKind("rays", interval=Interval(0.0, 1.0)),
    "camera": SensorKind("camera"),
}


def is_fact(sensor: Sensor) -> bool:
    """Whether reading the sensor is reading the engine."""
    return SENSOR_KINDS[sensor.kind].fact is not None and sensor.faults is None and sensor.mount == Pose()


def reading(robot: str, sensor: Sensor, component: str | None) -> Scalar:
    """The fact that one component of such a sensor measures."""
    kind = SENSOR_KINDS[sensor.kind]
    if kind.of == "joints":
        return World(kind.fact or "", (f"{robot}.{component or sensor.subjects[0]}",))
    return World(kind.fact or "", (f"{robot}.{sensor.subjects[0]}",), component)
