"""The inputs of an exported policy: sensors of robots, readings of the world, and goals, each with all facts
that a robot needs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from deepbots_cli.expressions.dimensions import ANGLE, LENGTH, NUMBER
from deepbots_cli.expressions.functions import FUNCTIONS
from deepbots_cli.expressions.intervals import Interval
from deepbots_cli.expressions.scalar import EngineRead, Name, Scalar
from deepbots_cli.expressions.types import SPACE
from deepbots_cli.program import Program
from deepbots_cli.program.identity import Deployment, reading_key
from deepbots_cli.program.robots import Link, MessageField, NoiseModel, Robot, Sensor
from deepbots_cli.program.topics import components_of
from deepbots_cli.program.values import Expression
from deepbots_cli.robots.model import Pose
from deepbots_cli.scenario.sensors import SENSORS, JointSensor
from deepbots_robot.model import Input, Mount

_AGES_WITHIN = 3
"""The number of its periods after which a value without a new one is too old."""


@dataclass(frozen=True)
class Reading:
    """An input, and where a simulation has its value.

    `trees` are the expressions of the supervisor, one per component. For a sampled sensor, `device` names
    robot and sensor.
    """

    info: Input
    trees: tuple[Scalar, ...] = ()
    device: tuple[str, str] | None = None


class Readings:
    """Describes the inputs of a program."""

    def __init__(self, program: Program, timestep: float | None = None) -> None:
        """Create the inputs. `timestep` is the time between two calls of the policy in s, by default that
        between two actions."""
        self._program = program
        self._timestep = timestep or program.period
        self.deployment = Deployment(program)
        self._supplied_by = {reading_key(key): text for key, text in program.supplied_by}
        self.direct = self.deployment.sensed
        """The readings of the world that are components of a sensor."""

    def sensor(self, robot: Robot, sensor: Sensor) -> Reading:
        """Describe a sensor of a robot with the values that the supervisor gets."""
        kind, faults = SENSORS[sensor.kind], sensor.faults or NoiseModel()
        of_joints = issubclass(kind, JointSensor)
        name = f"{robot.name}.{sensor.name}"
        world = kind.world_function is not None and bool(components_of(kind.world_function))
        number_type = "bool" if sensor.boolean else "float64"
        own_frame = sensor.subjects[0] if sensor.components == SPACE and not of_joints else None
        info = self._input(
            name,
            robot=robot.name,
            source="sensor",
            sensor=sensor.kind,
            joints=sensor.subjects if of_joints else (),
            link=None if of_joints else sensor.subjects[0],
            mount=Mount(xyz=sensor.mount.xyz, rpy=sensor.mount.rpy) if sensor.mount != Pose() else None,
            shape=sensor.optics.shape if sensor.optics else (len(sensor.components) or 1,),
            dtype="uint8" if sensor.optics else number_type,
            components=sensor.components,
            unit=unit_text(sensor.unit),
            frame="world" if world else own_frame,
            range=_sensor_range(sensor, faults, kind.interval),
            period=faults.period * self._program.world.timestep,
            latency=faults.latency,
        )
        if not self._program.is_direct(robot, "from_robot"):
            return Reading(
                info,
                tuple(
                    Name(f"{robot.name}.{_field(robot, sensor)}", component)
                    for component in sensor.components or (None,)
                ),
            )
        if sensor.is_direct:
            return Reading(
                info,
                tuple(
                    sensor.world_value(robot.name, component) for component in sensor.components or (None,)
                ),
            )
        return Reading(info, device=(robot.name, sensor.name))

    def of_world(self, read: EngineRead) -> tuple[Reading, int]:
        """Describe a reading of the world by the supervisor, with the index of the number in it."""
        components = components_of(read.function)
        function = FUNCTIONS.get(read.function)
        joint = self.deployment.joints.get(read.subjects[0])
        if joint is None:
            shared = NUMBER
        elif joint.type == "prismatic":
            shared = LENGTH
        else:
            shared = ANGLE
        truth = function is None or function.boolean
        name = self.deployment.name(read)
        interval = function.interval() if function is not None and read.function == "orientation" else None
        robot = read.subjects[0].partition(".")[0]
        robots = {entry.name for entry in self._program.robots}
        info = self._input(
            name,
            robot=robot if robot in robots else None,
            source="sensor" if self.deployment.is_measured(read) else "supervisor",
            supplied_by=self._supplied_by.get(name),
            sensor=read.function,
            joints=(joint.name,) if joint is not None else (),
            shape=(len(components) or 1,),
            dtype="bool" if truth else "float64",
            components=components,
            unit="" if truth or function is None else unit_text(function.result(shared)),
            frame="world" if components else None,
            range=None
            if truth
            else _ends([interval or Interval(-math.inf, math.inf)] * (len(components) or 1)),
        )
        whole = [EngineRead(read.function, read.subjects, component) for component in components] or [read]
        return Reading(info, tuple(whole)), components.index(read.component) if read.component else 0

    def parameter(self, value: Expression) -> Reading:
        """Describe a parameter that an episode draws. On a robot, a person or program sets it."""
        value_type = value.typed.type
        parts = value.components or (None,)
        info = self._input(
            value.name,
            source="goal",
            supplied_by=self._supplied_by.get(value.name),
            shape=(len(parts),),
            dtype="bool" if value_type.boolean else "float64",
            components=value.components,
            unit="" if value_type.boolean else unit_text(value_type.dimension),
            range=None
            if value_type.boolean
            else _ends([value_type.interval_of(component) for component in parts]),
            max_age_s=None,
        )
        return Reading(info, tuple(Name(value.name, component) for component in parts))

    def heard(self, link: Link, value: Expression) -> Reading:
        """Describe what a robot hears from another one. It arrives a timestep after it was sent, and after
        the latency of the link."""
        entry, route = MessageField.from_expression(value), link.route
        slowest = 0.0 if route.latency is None else route.latency.typed.type.interval.high
        name, parts = f"{link.receiver}.{value.name}", value.components or (None,)
        info = self._input(
            name,
            robot=link.receiver,
            source="supervisor",
            supplied_by=self._supplied_by.get(name, f"messages of {link.sender}"),
            shape=(len(parts),),
            dtype=entry.dtype,
            components=value.components,
            unit=unit_text(entry.unit),
            range=None,
            latency=self._program.world.timestep + (slowest if math.isfinite(slowest) else 0.0),
        )
        return Reading(info, tuple(Name(name, component) for component in parts))

    def _input(
        self,
        name: str,
        *,
        period: float | None = None,
        latency: float = 0.0,
        components: Sequence[str] = (),
        **fields: object,
    ) -> Input:
        step = self._timestep
        values: dict[str, Any] = {
            "robot": None,
            "supplied_by": None,
            "sensor": None,
            "joints": (),
            "link": None,
            "mount": None,
            "frame": None,
            "rate_hz": round(1.0 / (period or step), 9),
            "latency_s": latency,
            "max_age_s": round(latency + _AGES_WITHIN * max(period or step, step), 9),
        }
        return Input(name=name, components=tuple(components), **{**values, **fields})


def _field(robot: Robot, sensor: Sensor) -> str:
    """Return the field of a message that carries a sensor as it is."""
    parts = tuple(Name(sensor.name, component) for component in sensor.components or (None,))
    return next((entry.name for entry in robot.emit if entry.scalars == parts), sensor.name)


def _sensor_range(
    sensor: Sensor, faults: NoiseModel, interval: Interval
) -> tuple[tuple[float | None, ...], ...] | None:
    """Return the range of the readings: the one that the sensor clips to, or that of its kind where nothing
    is added to the value."""
    count = len(sensor.components) or 1
    if sensor.optics is not None or sensor.boolean:
        return None
    if faults.low:
        return _ends([Interval(low, high) for low, high in zip(faults.low, faults.high, strict=True)])
    exact = sensor.faults is None and sensor.beams is None
    return _ends([interval if exact else Interval(-math.inf, math.inf)] * count)


def _ends(intervals: Sequence[Interval]) -> tuple[tuple[float | None, ...], tuple[float | None, ...]]:
    """Return the lower and the upper ends, None where there is none."""
    return tuple(finite(interval.low) for interval in intervals), tuple(
        finite(interval.high) for interval in intervals
    )


def finite(number: float | None) -> float | None:
    """Return the number; None for one that is infinite."""
    return number if number is not None and math.isfinite(number) else None


def unit_text(unit: object) -> str:
    """Return the unit of a dimension; empty for a plain number."""
    return "" if str(unit) == "1" else str(unit)
