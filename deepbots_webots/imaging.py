"""Cameras, range finders and lidars, as the module `controller` has them."""

from __future__ import annotations

import math
from functools import partialmethod
from itertools import product
from math import nan
from operator import attrgetter, itemgetter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deepbots_cli import frames
from deepbots_cli.errors import EngineError
from deepbots_cli.frames import Frame, Triple
from deepbots_cli.records import dataclass
from deepbots_cli.robots.kinematics import bounds_of_shape
from deepbots_webots.nodes import axis_angle, boolean, child, integer, number, numbers, real, text, walk
from deepbots_webots.scene import AXES
from deepbots_webots.scene import Device as Spec
from deepbots_webots.sensors import (
    NotImplementedCallError,
    Sensor,
    returns,
    returns_number,
)
from deepbots_webots.shapes import Grid, Mesh, Plane, Shape, compose, inverse, visible_shape
from deepbots_webots.simulation import Simulation
from deepbots_webots.syntax import Node
from deepbots_webots.tree import number_of

Floats = NDArray[np.float64]


class _HasRange(Sensor):
    """A device that measures distances within a range, m."""

    getMinRange = returns_number("minRange")
    getMaxRange = returns_number("maxRange")


class _Optics(Sensor):
    """A device with a picture, planar and with square pixels."""

    def __init__(self, simulation: Simulation, spec: Spec) -> None:
        super().__init__(simulation, spec)
        self._size = max(1, integer(spec.node, "width")), max(1, integer(spec.node, "height"))
        self._fov = number(spec.node, "fieldOfView")

    def _begin(self) -> None:
        """Check that pictures can be drawn, so that an error is raised where the device is enabled."""
        from deepbots_webots.rendering import MAX_PIXELS, require_opengl

        node = self._spec.node
        is_planar = text(node, "projection") == "planar" and not boolean(node, "spherical")
        if not (is_planar and 0 < self._fov < math.pi):
            raise NotImplementedCallError(
                f"a {self._spec.type} with a projection that is not planar is not implemented"
            )
        if max(self._size) > MAX_PIXELS:
            raise ValueError(f"{self._spec.type} '{self._spec.name}' is larger than {MAX_PIXELS} pixels")
        try:
            require_opengl()
        except EngineError as error:
            raise EngineError(f"{self._spec.type} '{self._spec.name}' cannot draw: {error}") from error

    getFov = returns("_fov")
    getWidth, getHeight = (returns("_size", itemgetter(index)) for index in range(2))

    def _noises(self, deviation: float, shape: tuple[int, ...]) -> Floats:
        """Return noise for a picture, which numpy draws at once; its seed comes from the world, so that runs
        repeat."""
        generator = np.random.default_rng(self._simulation.random.getrandbits(64))
        return generator.normal(0.0, deviation, shape)

    def _save(self, picture: Any, filename: str, quality: int) -> int:
        """Write a picture by the suffix of the file, such as .png or .jpg; returns 0, or -1 if that fails."""
        from PIL import Image

        try:
            Image.fromarray(picture).save(filename, quality=min(max(int(quality), 1), 100))
        except (OSError, ValueError) as error:  # Pillow has a ValueError for an unknown suffix
            self._warn(f"saveImage(): {error}")
            return -1
        return 0


def _gets_channel(channel: int) -> Any:
    """Return the static method that returns a channel of a pixel in a picture of a camera."""
    return staticmethod(lambda image, width, x, y: image[4 * (y * width + x) + channel])


class Camera(_Optics):
    """A camera; its picture is BGRA, row by row from above."""

    def __init__(self, simulation: Simulation, spec: Spec) -> None:
        super().__init__(simulation, spec)
        self._picture: NDArray[np.uint8] | None = None
        self._recognition = _Recognition(simulation, spec, self)

    def sample(self) -> None:
        colors = self._simulation.pictures.colors(self._frame(), self._size, self._fov, self.getNear())
        noise = number(self._spec.node, "noise") * 255  # Webots states it as a share of a channel's range
        if noise > 0:
            colors = np.rint(colors + self._noises(noise, colors.shape)).clip(0, 255).astype(np.uint8)
        self._picture = colors

    def getNear(self) -> float:
        return max(number(self._spec.node, "near"), 1e-3)

    def getImage(self) -> bytes | None:
        """Return the picture; None before the first step, and a black one until the first measurement."""
        if self._picture is None and self._simulation.ticks > self.due - self.period:
            return bytes(4 * self._size[0] * self._size[1])
        if self._picture is None:
            return None
        opaque = np.full((*self._picture.shape[:2], 1), 255, np.uint8)
        return np.concatenate((self._picture[..., ::-1], opaque), axis=-1).tobytes()

    def getImageArray(self) -> list[list[list[int]]] | None:
        """Return red, green and blue of the pixel x, y at `[x][y]`; None before the first picture."""
        return None if self._picture is None else self._picture.swapaxes(0, 1).tolist()

    imageGetBlue, imageGetGreen, imageGetRed = map(_gets_channel, range(3))

    @staticmethod
    def imageGetGray(image: bytes, width: int, x: int, y: int) -> float:
        at = 4 * (y * width + x)
        return (image[at] + image[at + 1] + image[at + 2]) / 3

    imageGetGrey = imageGetGray

    def saveImage(self, filename: str, quality: int) -> int:
        return -1 if self._picture is None else self._save(self._picture, filename, quality)

    def hasRecognition(self) -> bool:
        return child(self._spec.node, "recognition") is not None

    def recognitionEnable(self, samplingPeriod: int) -> None:
        if self.hasRecognition():
            self._recognition.enable(samplingPeriod)
        else:
            self._warn("recognitionEnable() has no effect: the camera has no Recognition node")

    recognitionDisable = property(attrgetter("_recognition.disable"))
    getRecognitionSamplingPeriod = returns("_recognition._asked")
    getRecognitionObjects = returns("_recognition.objects", list)

    getRecognitionNumberOfObjects = returns("_recognition.objects", len)


@dataclass(frozen=True)
class CameraRecognitionObject:
    """A solid that a camera recognizes: the id of its node; the middle of its outline (m) and its rotation
    (axis, angle) in the frame of the camera; its width and height there, m; and its place in the picture,
    pixels."""

    id: int
    position: list[float]
    orientation: list[float]
    size: list[float]
    position_on_image: list[int]
    size_on_image: list[int]
    number_of_colors: int
    colors: list[float]
    model: str


for _name in CameraRecognitionObject.__annotations__:
    # Releases before R2022b have `get_id`, and later ones `getId`.
    for _getter in (f"get_{_name}", f"get{_name.title().replace('_', '')}"):
        setattr(CameraRecognitionObject, _getter, returns(_name))


class _Recognition(Sensor):
    """The solids with `recognitionColors` that a camera sees."""

    def __init__(self, simulation: Simulation, spec: Spec, camera: Camera) -> None:
        super().__init__(simulation, spec)
        self._camera = camera
        self.objects: list[CameraRecognitionObject] = []

    def forget(self) -> None:
        self.objects = []

    def sample(self) -> None:
        node = child(self._spec.node, "recognition")
        assert node is not None
        candidates = [
            self._recognized(solid, numbers(solid, "recognitionColors"), node)
            for solid, (body, _) in self._simulation.scene.attachments.items()
            if "recognitionColors" in solid.fields and body.robot is not self._spec.body.robot
        ]
        objects, most = [each for each in candidates if each is not None], integer(node, "maxObjects")
        if 0 <= most < len(objects):
            objects = sorted(objects, key=lambda each: -math.prod(each.size_on_image))[:most]
        self.objects = objects

    def _recognized(
        self, solid: Node, colors: list[float], recognition: Node
    ) -> CameraRecognitionObject | None:
        """Return what the camera recognizes of a solid: the box around its outline in the frame of the
        camera, and in the picture; None if it does not see it."""
        to_camera, parts = inverse(self._frame()), {real(node) for node in walk([solid])}
        spans = [_span(shape, compose(to_camera, frame)) for shape, frame in self._outline(parts)]
        if not (spans and colors):
            return None
        low, high = np.min(spans, axis=0)[0], np.max(spans, axis=0)[1]
        middle, corners = (low + high) / 2, np.array([*product(*zip(low, high, strict=True))])
        if high[0] <= 0 or np.linalg.norm(middle) > number(recognition, "maxRange"):
            return None
        pixels = self._project(corners)
        first, last = pixels.min(axis=0), pixels.max(axis=0)
        occlusion = integer(recognition, "occlusion")
        targets = [*corners[: 8 * (occlusion == 2)], middle] if occlusion else []
        is_hidden = bool(targets) and all(
            self._is_hidden(frames.rotate(self._frame()[1], tuple(target)), parts) for target in targets
        )
        if is_hidden or min(last - first) < 1:
            return None
        frame = compose(to_camera, self._simulation.physics.frame(*self._simulation.scene.attachments[solid]))
        return CameraRecognitionObject(
            id=number_of(self._simulation, solid),
            position=middle.tolist(),
            orientation=axis_angle(frame[1]),
            size=(high - low)[1:].tolist(),
            position_on_image=np.rint((first + last) / 2).astype(int).tolist(),
            size_on_image=(last - first).tolist(),
            number_of_colors=len(colors) // 3,
            colors=colors,
            model=text(solid, "model"),
        )

    def _is_hidden(self, offset: Triple, parts: set[Node]) -> bool:
        """Return whether something else than these solids is before a point, at an offset in the world."""
        distance, physics = math.hypot(*offset), self._simulation.physics
        unit = frames.scaled(offset, 1 / distance)
        geom = physics.cast(self._frame()[0], [unit], distance, self._spec.body.robot)[0][1]
        return geom >= 0 and physics.geoms[geom][1].owner not in parts

    def _outline(self, parts: set[Node]) -> list[tuple[Shape, Frame]]:
        """Return the bounding objects of nodes with their frames in the world; without any, what is seen."""
        scene, physics = self._simulation.scene, self._simulation.physics
        bounding = [
            (geometry.shape, physics.frame(body, geometry.frame))
            for body, geometry in physics.geoms
            if geometry.owner in parts
        ]
        seen = [
            (visible_shape(visual, scene.files), physics.frame(visual.body, visual.frame))
            for visual in scene.visuals
            if not bounding and visual.node in parts and visual.body is not None
        ]
        return bounding or [(shape, frame) for shape, frame in seen if shape is not None]

    def _project(self, points: Floats) -> Floats:
        """Return the pixels of points in the frame of the camera, within the picture, shape (points, 2)."""
        (width, height), half = self._camera._size, math.tan(self._camera.getFov() / 2)
        depth = np.maximum(points[:, 0], self._camera.getNear())
        across, up = -points[:, 1] / depth / half, points[:, 2] / depth / half * width / height
        places = np.stack(((across + 1) / 2 * width, (1 - up) / 2 * height), axis=1)
        return np.clip(places, 0, (width - 1, height - 1)).astype(int)


def _span(shape: Shape, frame: Frame) -> tuple[Floats, Floats]:
    """Return the lowest and the highest coordinates of a shape in a frame; the origin of one without end."""
    match shape:
        case Mesh(vertices):
            axes = np.array([frames.rotate(frame[1], axis) for axis in AXES])
            points = vertices @ axes + frame[0]
            return points.min(axis=0), points.max(axis=0)
        case Plane() | Grid():
            return np.array(frame[0]), np.array(frame[0])
    low, high = bounds_of_shape(shape, frame)
    return np.array(low), np.array(high)


class RangeFinder(_Optics, _HasRange):
    """A depth camera: distances along its axis (m), row by row from above; infinite beyond its range."""

    _depths: NDArray[np.float32] | None = None

    def sample(self) -> None:
        node = self._spec.node
        depths = self._simulation.pictures.depths(self._frame(), self._size, self._fov).astype(np.float32)
        least, most = self.getMinRange(), self.getMaxRange()
        # Before the noise, which would move depths across the limits.
        is_seen = (depths >= least) & (depths <= most)
        noise, resolution = number(node, "noise") * most, number(node, "resolution")
        if noise > 0:
            depths += self._noises(noise, depths.shape).astype(np.float32)
        if resolution > 0:
            depths = np.round(depths / resolution) * np.float32(resolution)
        depths[~is_seen] = np.inf
        self._depths = depths

    def getRangeImage(self, data_type: str = "list") -> Any:
        """Return the distances as a list, or as bytes of float32 for `buffer`; None before the first."""
        if self._depths is None:
            return None
        return self._depths.tobytes() if data_type == "buffer" else self._depths.ravel().tolist()

    def getRangeImageArray(self) -> list[list[float]] | None:
        """Return the distances, a list for each row."""
        return None if self._depths is None else self._depths.tolist()

    @staticmethod
    def rangeImageGetDepth(image: Any, width: int, x: int, y: int) -> float:
        return float(image[y * width + x])

    def saveImage(self, filename: str, quality: int) -> int:
        """Write a gray picture: white at the largest range."""
        if self._depths is None:
            return -1
        gray = np.clip(self._depths / self.getMaxRange(), 0.0, 1.0) * 255
        return self._save(gray.astype(np.uint8), filename, quality)


# Lidars


class LidarPoint(NamedTuple):
    """A point that a lidar met, in its frame (m), its layer, and the simulated time (s) of its
    measurement."""

    x: float
    y: float
    z: float
    layer_id: int
    time: float


class Lidar(_HasRange):
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
        self._fov, self._high = number(node, "fieldOfView"), number(node, "verticalFieldOfView")
        self._rotates = text(node, "type") == "rotating"
        self._frequency = number(node, "defaultFrequency")
        self._image = [0.0 if self._rotates else nan] * (self._columns * self._layers)
        self._times = [0.0] * self._columns
        self._passed = 0.0
        self._has_points = False
        self._rays: Any = None

    def _begin(self) -> None:
        node, tilt = self._spec.node, number(self._spec.node, "tiltAngle")
        heights = np.linspace(0.5, -0.5, self._layers) if self._layers > 1 else np.zeros(1)
        if text(node, "projection") == "planar" or not boolean(node, "spherical"):
            self._rays = self._planar_rays(heights, tilt)
            return
        width = 2 * math.pi if self._rotates else self._fov
        yaws = width * (0.5 - (np.arange(self._columns) + 0.5) / self._columns)
        if self._rotates:
            yaws = -2 * math.pi * (np.arange(self._columns) + 0.5) / self._columns
        pitch, yaw = np.meshgrid(self._high * heights + tilt, yaws, indexing="ij")
        parts = (np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch))
        self._rays = np.stack(parts, axis=-1)
        """Shape (layers, columns, 3), in the frame of the sensor. A distance times its ray is a point."""

    def _planar_rays(self, heights: Floats, tilt: float) -> Floats:
        """Return rays to evenly spaced points of a plane at a distance of 1; so distances are those along the
        axis, as in a depth picture."""
        if self._rotates or not (self._fov < math.pi and self._high < math.pi):
            raise NotImplementedCallError(
                "a planar Lidar that rotates or sees half a circle is not implemented"
            )
        columns = np.tan(self._fov / 2) * (1 - 2 * (np.arange(self._columns) + 0.5) / self._columns)
        up, left = np.meshgrid(2 * np.tan(self._high / 2) * heights, columns, indexing="ij")
        sine, cosine = math.sin(tilt), math.cos(tilt)
        return np.stack((cosine - sine * up, left, sine + cosine * up), axis=-1)

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
        if not columns:
            return
        start, rotation = self._frame()
        axes = np.array([frames.rotate(rotation, axis) for axis in AXES])
        least, most = self.getMinRange(), self.getMaxRange()
        rays = self._rays[:, columns].reshape(-1, 3)
        lengths = np.linalg.norm(rays, axis=1)
        hits = self._simulation.physics.cast(
            start, rays / lengths[:, None] @ axes, most * float(lengths.max()), self._spec.body.robot
        )
        met = np.array([distance if geom >= 0 else math.inf for distance, geom, _ in hits])
        distances = (met / lengths).tolist()
        noise = number(self._spec.node, "noise") * most  # Webots states it as a share of maxRange
        now = self._simulation.time / 1000
        for number_, distance in enumerate(distances):
            layer, at = divmod(number_, len(columns))
            value = self._rounded(distance + self._noise(noise)) if distance <= most else math.inf
            self._image[layer * self._columns + columns[at]] = value if value >= least else math.inf
            self._times[columns[at]] = now

    getRangeImage = returns("_image", list)

    def getLayerRangeImage(self, layer: int) -> list[float]:
        return self._image[layer * self._columns : (layer + 1) * self._columns]

    def getRangeImageArray(self) -> list[list[float]]:
        return [self.getLayerRangeImage(layer) for layer in range(self._layers)]

    def enablePointCloud(self, has_points: bool = True) -> None:
        self._has_points = has_points

    disablePointCloud = partialmethod(enablePointCloud, False)
    isPointCloudEnabled = returns("_has_points")

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

    getNumberOfPoints = returns("_image", len)
    getHorizontalResolution = returns("_columns")
    getNumberOfLayers = returns("_layers")
    getFov = returns("_fov")
    getVerticalFov = returns("_high")

    getFrequency = returns("_frequency")

    getMinFrequency = returns_number("minFrequency")
    getMaxFrequency = returns_number("maxFrequency")
