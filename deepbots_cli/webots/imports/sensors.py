"""Devices of a robot as sensors of a scenario."""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot
from typing import TYPE_CHECKING

from deepbots_cli.webots.imports.robots import pose_of
from deepbots_cli.webots.imports.world import plain
from deepbots_cli.webots.nodes import integer, number, text, vectors

if TYPE_CHECKING:
    from deepbots_cli.webots.imports.robots import RobotParts
    from deepbots_cli.webots.scene import Device

_RAYS = {"infra-red": "infrared", "sonar": "sonar", "laser": "laser", "generic": "laser"}
_VECTORS = {
    "Gyro": ("gyro", "rad/s"),
    "Accelerometer": ("accelerometer", "m/s^2"),
    "GPS": ("position", "m"),
}


SENSING = frozenset(
    ["Altimeter", "Camera", "DistanceSensor", "Lidar", "LightSensor", "Microphone", "Radar", "RangeFinder"]
)
"""The devices that measure, and of which at least some have no counterpart."""


@dataclass(frozen=True)
class SensorEntry:
    """A sensor: its YAML text, the unit of its reading ("" for a plain number), its components."""

    text: str
    unit: str = ""
    components: tuple[str, ...] = ()
    is_truth: bool = False


def sensor_entry(device: Device, parts: RobotParts) -> SensorEntry | None:
    """Return the sensor for a device; None where the language has no counterpart."""
    if device.type == "PositionSensor" and device.joint is not None:
        name = parts.joints[id(device.joint)]
        unit = "m" if device.joint.kind == "slide" else "rad"
        return SensorEntry(f"{{type: joint_position, joint: {name}{_accuracy(device, unit)}}}", unit)
    mount = f"link: {parts.link_of(device.body)}{_pose(device, parts)}"
    if device.type in _VECTORS:
        kind, unit = _VECTORS[device.type]
        return SensorEntry(f"{{type: {kind}, {mount}}}", unit, ("x", "y", "z"))
    match device.type:
        case "InertialUnit":
            return SensorEntry(f"{{type: orientation, {mount}}}", "", ("x", "y", "z", "w"))
        case "Compass":
            return SensorEntry(f"{{type: compass, {mount}}}", "rad")
        case "TouchSensor":
            is_bumper = text(device.node, "type") == "bumper"
            link = parts.link_of(device.body)
            kind = "touch" if is_bumper else "force"
            return SensorEntry(f"{{type: {kind}, link: {link}}}", "" if is_bumper else "N", (), is_bumper)
        case "DistanceSensor" if text(device.node, "type") in _RAYS:
            return _distance(device, mount)
    return None


def _accuracy(device: Device, unit: str) -> str:
    parts = ""
    if (noise := number(device.node, "noise")) > 0:
        parts += f", noise: {plain(noise)} {unit}"
    if (resolution := number(device.node, "resolution")) > 0:
        parts += f", resolution: {plain(resolution)} {unit}"
    return parts


def _pose(device: Device, parts: RobotParts) -> str:
    pose = pose_of(parts.frame_in_link(device.body, device.frame))
    pose_entries = []
    if hypot(*pose.xyz) > 1e-9:
        pose_entries.append(f"xyz: {plain(*pose.xyz)} m")
    if hypot(*pose.rpy) > 1e-9:
        pose_entries.append(f"rpy: {plain(*pose.rpy)} rad")
    return f", pose: {{{', '.join(pose_entries)}}}" if pose_entries else ""


def _distance(device: Device, mount: str) -> SensorEntry | None:
    """Return a sensor of rays with its table; readings of Webots are those of the table."""
    node = device.node
    kind = _RAYS[text(node, "type")]
    table = vectors(node, "lookupTable")
    distances = [row[0] for row in table]
    if len(table) < 2 or distances != sorted(set(distances)) or distances[0] < 0:
        return None
    parts = [f"type: {kind}", mount]
    count = min(integer(node, "numberOfRays"), 100)
    aperture = number(node, "aperture")
    if count > 1 and aperture > 0:
        half = plain(aperture / 2)
        measure = "nearest" if kind == "sonar" else "mean"
        parts.append(f"rays: {count}, angle_range: {half} .. -{half} rad, measure: {measure}")
    values, noises = [row[1] for row in table], [row[2] for row in table]
    lookup = f"distance: {plain(*distances)} m, value: {plain(*values)}"
    if any(noises):
        lookup += f", noise: {plain(*(100 * abs(noise) for noise in noises))} %"
    parts.append(f"lookup: {{{lookup}}}")
    return SensorEntry(f"{{{', '.join(parts)}}}")
