"""Sensors: their kinds, as many figures as components, and nothing so large that building it would take minutes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise

from deepbots_cli.canonical import CanonicalError
from deepbots_cli.compiler.emit.guard.expressions import nodes
from deepbots_cli.compiler.sensors import SENSOR_KINDS
from deepbots_cli.expressions.scalar import World
from deepbots_cli.ir import (
    FINEST,
    MOST_PIXELS,
    MOST_RAYS,
    MOST_SENSED_RAYS,
    Beams,
    CompiledScenario,
    Faults,
    Lookup,
    Optics,
    Robot,
    Sensor,
    Variation,
)
from deepbots_cli.robots.model import Pose

_MOST_TICKS = 1e5
_LATEST = 60.0  # s
_LARGEST = 1e30
_FARTHEST = 1e6  # m
_NONE = Beams((), 0.0)
_FAULTS = ("noise", "relative_noise", "bias", "relative_bias", "drift")


def require_sensors(scenario: CompiledScenario) -> None:
    """Refuse sensors that the compiler would never have written, and variations of faults that no sensor has."""
    for robot in scenario.robots:
        for sensor in robot.sensors:
            if not _is_sound(sensor, scenario.world.timestep):
                raise CanonicalError(f"'{robot.name[:40]}.{sensor.name[:40]}' is no sensor that can be built")
        if sum(len(sensor.beams.rays) for sensor in robot.sensors if sensor.beams) > MOST_SENSED_RAYS:
            raise CanonicalError(f"'{robot.name[:40]}' senses more than {MOST_SENSED_RAYS} rays")
    robots = {robot.name: robot for robot in scenario.robots}
    for node in nodes(scenario):
        if isinstance(node, World) and node.function == "visible" and not _sees(robots, *node.subjects):
            raise CanonicalError(f"{node.subjects[0][:40]!r} is no camera")
    for variation in scenario.reset.variations:
        if variation.what == "sensor" and not _varies(robots.get(variation.of[0]), variation):
            raise CanonicalError(f"{'.'.join(variation.of)[:80]!r} is no fault of a sensor")


def _sees(robots: Mapping[str, Robot], camera: str, _body: str) -> bool:
    robot, _, name = camera.partition(".")
    return robot in robots and any(sensor.name == name and sensor.kind == "camera" for sensor in robots[robot].sensors)


def _is_sound(sensor: Sensor, timestep: float) -> bool:
    kind, count = SENSOR_KINDS.get(sensor.kind), max(1, len(sensor.components))
    if kind is None or not sensor.subjects or not all(_is_near(pose) for pose in (sensor.mount, *(sensor.beams or _NONE).rays)):
        return False
    match kind.of:
        case "joints" | "links":
            fits = sensor.components in ((), sensor.subjects) and len(sensor.subjects) == count
        case "link":
            fits = sensor.components == kind.components
        case "camera":
            fits = sensor.optics is not None and not sensor.components and _are_optics(sensor.optics)
        case _:
            fits = sensor.beams is not None and _are_beams(sensor.beams, sensor)
    return fits and (sensor.faults is None or _are_faults(sensor.faults, count, timestep))


def _is_near(pose: Pose) -> bool:
    return all(abs(figure) < _FARTHEST for figure in (*pose.xyz, *pose.rpy))


def _are_beams(beams: Beams, sensor: Sensor) -> bool:
    count, each = len(beams.rays), beams.combined == "each"
    named = each and len(sensor.components) == count if sensor.components else count == 1 or not each
    sound = 0 < count <= MOST_RAYS and named and 0.0 <= beams.spot < 1e3
    return sound and (sensor.kind == "reflectance" or 0.0 < beams.reach < 1e6) and (beams.lookup is None or _is_table(beams.lookup))


def _are_optics(optics: Optics) -> bool:
    sides = 1 <= min(optics.width, optics.height) <= max(optics.width, optics.height) <= MOST_PIXELS
    return sides and 0.0 < optics.fov < math.pi and optics.near < optics.far


def _is_table(lookup: Lookup) -> bool:
    lengths = {len(lookup.distance), len(lookup.value), len(lookup.noise) or len(lookup.value)}
    return len(lengths) == 1 and len(lookup.distance) > 0 and all(a < b for a, b in pairwise(lookup.distance))


def _are_faults(faults: Faults, count: int, timestep: float) -> bool:
    figures = [getattr(faults, name) for name in (*_FAULTS, "low", "high", "quantise")]
    return (
        1 <= faults.period <= _MOST_TICKS
        and 0.0 <= faults.latency <= _LATEST
        and len(faults.low) == len(faults.high)
        and all(len(values) in (0, count) for values in figures)
        and all(abs(value) <= _LARGEST for values in figures for value in values)
        and all(step >= FINEST for step in faults.quantise)
    )


def _varies(robot: Robot | None, variation: Variation) -> bool:
    """Whether the robot has such a fault of such a sensor, with as many figures."""
    _, name, fault = variation.of
    sensor = next((sensor for sensor in robot.sensors if sensor.name == name), None) if robot else None
    if sensor is None or sensor.faults is None:
        return False
    wanted = len(getattr(sensor.faults, fault)) if fault in _FAULTS else int(fault == "latency")
    return wanted == len(variation.values) > 0
