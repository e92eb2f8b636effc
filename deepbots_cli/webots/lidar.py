"""Lidars, as the module `controller` has them."""

from __future__ import annotations

import math
from math import nan
from typing import TYPE_CHECKING, Any, NamedTuple

from deepbots_cli import frames
from deepbots_cli.webots.device import Sensor
from deepbots_cli.webots.nodes import integer, number, text
from deepbots_cli.webots.scene import AXES
from deepbots_cli.webots.unimplemented import NotImplementedCallError

if TYPE_CHECKING:
    from deepbots_cli.webots.scene import Device as Spec
    from deepbots_cli.webots.simulation import Simulation


class LidarPoint(NamedTuple):
    """A point that a lidar met, in its frame (m), its layer, and the simulated time (s) of its
    measurement."""

    x: float
    y: float
    z: float
    layer_id: int
    time: float


class Lidar(Sensor):
    """Distances along rays, row by row from above, each row from the left; infinite beyond the range.

    The rays of a rotating lidar cover the whole circle. In each basic time step, its head turns clockwise by
    its frequency, and measures the columns that it passes; the others keep their values. Columns that it has
    not passed yet are 0.
    """

    def __init__(self, simulation: Simulation, spec: Spec) -> None:
        super().__init__(simulation, spec)
        node = spec.node
        self._columns, self._layers = (
            max(1, integer(node, field)) for field in ("horizontalResolution", "numberOfLayers")
        )
        self._range = number(node, "minRange"), number(node, "maxRange")
        self._fov, self._high = number(node, "fieldOfView"), number(node, "verticalFieldOfView")
        self._rotates = text(node, "type") == "rotating"
        self._frequencies = number(node, "minFrequency"), number(node, "maxFrequency")
        self._frequency = number(node, "defaultFrequency")
        self._image = [0.0 if self._rotates else nan] * (self._columns * self._layers)
        self._times = [0.0] * self._columns
        self._passed = 0.0
        self._has_points = False
        self._rays: Any = None

    def _begin(self) -> None:
        import numpy as np

        if text(self._spec.node, "projection") != "cylindrical":
            raise NotImplementedCallError("a Lidar with a planar projection is not implemented")
        width = 2 * math.pi if self._rotates else self._fov
        yaws = width * (0.5 - (np.arange(self._columns) + 0.5) / self._columns)
        if self._rotates:
            yaws = -2 * math.pi * (np.arange(self._columns) + 0.5) / self._columns
        heights = np.linspace(0.5, -0.5, self._layers) if self._layers > 1 else np.zeros(1)
        pitch, yaw = np.meshgrid(
            self._high * heights + number(self._spec.node, "tiltAngle"), yaws, indexing="ij"
        )
        parts = (np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch))
        self._rays = np.stack(parts, axis=-1)
        """Shape (layers, columns, 3), in the frame of the sensor."""

    def sample(self) -> None:
        if not self._rotates:
            self._measure(list(range(self._columns)))
            return
        advance = self._frequency * self.period / 1000 * self._columns
        first, last = math.floor(self._passed), math.floor(self._passed + advance)
        self._passed = (self._passed + advance) % self._columns
        count = min(last - first, self._columns)
        self._measure([column % self._columns for column in range(last - count, last)])

    def _measure(self, columns: list[int]) -> None:
        """Measure the distances in some columns."""
        import numpy as np

        if not columns:
            return
        start, rotation = self._frame()
        axes = np.array([frames.rotate(rotation, axis) for axis in AXES])
        robot = self._spec.body.robot
        least, most = self._range
        rays = self._rays[:, columns].reshape(-1, 3) @ axes
        distances = self._simulation.physics.rays.distances(start, rays, most, robot.index if robot else None)
        noise = number(self._spec.node, "noise") * most  # Webots states it as a share of maxRange
        now = self._simulation.time / 1000
        for number_, distance in enumerate(distances):
            layer, at = divmod(number_, len(columns))
            value = self._rounded(distance + self._noise(noise)) if distance <= most else math.inf
            self._image[layer * self._columns + columns[at]] = value if value >= least else math.inf
            self._times[columns[at]] = now

    def getRangeImage(self) -> list[float]:
        return list(self._image)

    def getLayerRangeImage(self, layer: int) -> list[float]:
        return self._image[layer * self._columns : (layer + 1) * self._columns]

    def getRangeImageArray(self) -> list[list[float]]:
        return [self.getLayerRangeImage(layer) for layer in range(self._layers)]

    def enablePointCloud(self) -> None:
        self._has_points = True

    def disablePointCloud(self) -> None:
        self._has_points = False

    def isPointCloudEnabled(self) -> bool:
        return self._has_points

    def getPointCloud(self) -> list[LidarPoint]:
        """Return the points in the frame of the sensor, in the order of the range image."""
        return [point for layer in range(self._layers) for point in self.getLayerPointCloud(layer)]

    def getLayerPointCloud(self, layer: int) -> list[LidarPoint]:
        if not self._has_points or self._rays is None:
            return []
        points = zip(self.getLayerRangeImage(layer), self._rays[layer].tolist(), self._times, strict=True)
        return [
            LidarPoint(distance * x, distance * y, distance * z, layer, time)
            for distance, (x, y, z), time in points
        ]

    def getNumberOfPoints(self) -> int:
        return self._columns * self._layers

    def getHorizontalResolution(self) -> int:
        return self._columns

    def getNumberOfLayers(self) -> int:
        return self._layers

    def getMinRange(self) -> float:
        return self._range[0]

    def getMaxRange(self) -> float:
        return self._range[1]

    def getFov(self) -> float:
        return self._fov

    def getVerticalFov(self) -> float:
        return self._high

    def getFrequency(self) -> float:
        """Return the rotations of the head per second."""
        return self._frequency

    def setFrequency(self, frequency: float) -> None:
        low, high = self._frequencies
        if not low <= frequency <= high:
            self._warn(f"the frequency {frequency:g} Hz is outside {low:g} .. {high:g}, and is limited")
        self._frequency = min(max(float(frequency), low), high)

    def getMinFrequency(self) -> float:
        return self._frequencies[0]

    def getMaxFrequency(self) -> float:
        return self._frequencies[1]
