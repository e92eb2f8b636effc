"""Radars, as the module `controller` has them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from deepbots_cli import frames
from deepbots_cli.webots.device import Sensor
from deepbots_cli.webots.nodes import boolean, number

if TYPE_CHECKING:
    from deepbots_cli.webots.scene import Device as Spec
    from deepbots_cli.webots.simulation import Simulation
    from deepbots_cli.webots.syntax import Node

LIGHT_SPEED = 299_792_458.0
"""In m/s."""


@dataclass
class RadarTarget:
    """The measurement of a solid by a radar: the distance (m), the power that came back (dBm), the radial
    speed (m/s, positive for one that moves away), and the azimuth (rad, positive to the right)."""

    distance: float
    received_power: float
    speed: float
    azimuth: float


class Radar(Sensor):
    """Solids with a `radarCrossSection` within the range and the field of view."""

    def __init__(self, simulation: Simulation, spec: Spec) -> None:
        super().__init__(simulation, spec)
        self._targets: list[RadarTarget] = []
        node = spec.node
        sent = _milliwatts(number(node, "transmittedPower"))
        gain = 10 ** (number(node, "antennaGain") / 10)
        frequency = number(node, "frequency") * 1e9
        wavelength = LIGHT_SPEED / frequency if frequency > 0 else 0.0
        # The radar equation: P = Pt G^2 lambda^2 sigma / ((4 pi)^3 R^4).
        self._power = sent * gain**2 * wavelength**2 / (4 * math.pi) ** 3
        """The power (mW) that a cross section of 1 m^2 reflects from 1 m."""

    def getMinRange(self) -> float:
        return number(self._spec.node, "minRange")

    def getMaxRange(self) -> float:
        return number(self._spec.node, "maxRange")

    def getHorizontalFov(self) -> float:
        return number(self._spec.node, "horizontalFieldOfView")

    def getVerticalFov(self) -> float:
        return number(self._spec.node, "verticalFieldOfView")

    def getNumberOfTargets(self) -> int:
        return len(self._targets)

    def getTargets(self) -> list[RadarTarget]:
        return list(self._targets)

    def forget(self) -> None:
        self._targets = []

    def sample(self) -> None:
        candidates = [self._target(solid) for solid in self._simulation.scene.radar_targets]
        targets = self._merged([target for target in candidates if target is not None])
        for target in targets:
            target.received_power = 10 * math.log10(target.received_power)
        self._targets = targets

    def _target(self, solid: Node) -> RadarTarget | None:
        """Return the measurement of a solid, with the power in mW; None if the radar does not see it.

        The radar sees a solid if a part of the ball around its bounding object is within the range and the
        field of view. The measurement is that of the origin of the solid, limited to the range and the field
        of view.
        """
        node, physics = self._spec.node, self._simulation.physics
        if solid is node:
            return None
        position, rotation = self._frame()
        body, frame_in_body = self._simulation.scene.attachments[solid]
        offset = frames.subtract(physics.position(body, frame_in_body), position)
        distance, radius = math.hypot(*offset), physics.radius(solid)
        near, far = self.getMinRange(), self.getMaxRange()
        if distance == 0 or distance - radius > far or distance + radius < near:
            return None
        left, elevation = frames.azimuth_and_elevation(frames.rotate_back(rotation, offset))
        # Half the angle under which the ball appears.
        share, azimuth = math.asin(min(1.0, radius / distance)), -left
        half = self.getHorizontalFov() / 2
        if abs(azimuth) > half + share or abs(elevation) > self.getVerticalFov() / 2 + share:
            return None
        if boolean(node, "occlusion") and self._is_hidden(solid, offset, distance):
            return None
        measured = distance + self._noise(number(node, "rangeNoise"))
        measured = min(max(measured, near), far)
        power = self._power * number(solid, "radarCrossSection") / max(measured, 1e-9) ** 4
        if power <= 0 or power < _milliwatts(number(node, "minDetectableSignal")):
            return None
        velocity, target_velocity = (
            physics.velocity(*at)[0] for at in ((self._spec.body, self._spec.frame), (body, frame_in_body))
        )
        speed = frames.dot(frames.subtract(target_velocity, velocity), offset) / distance + self._noise(
            number(node, "speedNoise")
        )
        if not self._sees_speed(speed):
            return None
        azimuth = min(max(azimuth, -half), half) + self._noise(number(node, "angularNoise"))
        return RadarTarget(measured, power, speed, azimuth)

    def _sees_speed(self, speed: float) -> bool:
        node = self._spec.node
        low, high = number(node, "minRadialSpeed"), number(node, "maxRadialSpeed")
        if (low or high) and not low <= speed <= high:
            return False
        return abs(speed) >= number(node, "minAbsoluteRadialSpeed")

    def _is_hidden(self, solid: Node, offset: tuple[float, float, float], distance: float) -> bool:
        """Return whether something is between the radar and a solid."""
        physics, robot = self._simulation.physics, self._spec.body.robot
        skipped = None if robot is None else robot.index
        unit = frames.scaled(offset, 1 / distance)
        geom = physics.rays.cast(self._frame()[0], [unit], distance, skipped)[0][1]
        return geom >= 0 and physics.geoms[geom][0] is not self._simulation.scene.attachments[solid][0]

    def _merged(self, targets: list[RadarTarget]) -> list[RadarTarget]:
        """Merge targets that the radar cannot tell apart: into their means, weighted by power."""
        node = self._spec.node
        cell, cell_speed = number(node, "cellDistance"), number(node, "cellSpeed")
        if cell <= 0:
            return targets
        merged: list[RadarTarget] = []
        while targets:
            first, *others = targets
            same = [
                other
                for other in others
                if abs(other.distance - first.distance) < cell
                and (cell_speed <= 0 or abs(other.speed - first.speed) < cell_speed)
            ]
            targets = [other for other in others if other not in same]
            merged.append(_mean([first, *same]))
        return merged


def _mean(targets: list[RadarTarget]) -> RadarTarget:
    powers = [target.received_power for target in targets]
    total = sum(powers)
    distance, speed, azimuth = (
        sum(getattr(target, name) * power for target, power in zip(targets, powers, strict=True)) / total
        for name in ("distance", "speed", "azimuth")
    )
    return RadarTarget(distance, total, speed, azimuth)


def _milliwatts(dbm: float) -> float:
    return float(10 ** (dbm / 10))
