"""Pictures of the world: PyBullet's software renderer draws bodies, this module draws floor and sky.

A software renderer shades a floor pixel by pixel (22 ms of a 30 ms picture of 480 x 320, measured), although
it looks the same in every picture of one view.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, hypot, tan
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from deepbots_cli.engines.pybullet import pybullet as p
from deepbots_cli.frames import add, cross, rotate, scaled, subtract
from deepbots_cli.port import CAMERA_RANGE_M, CameraImage

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from deepbots_cli.frames import Frame, Triple
    from deepbots_cli.port import Image, View
    from deepbots_cli.program.world import Line

    FloatArray = NDArray[np.float32]
    Color = tuple[float, float, float, float]

TILE_SIZE_M = 0.25
_LIGHT_TILE = np.array([222, 227, 232], np.float32)
_DARK_TILE = np.array([198, 206, 214], np.float32)
_DARK_TILE_SHARE = 0.9  # the brightness of the darker tiles of a floor with a color of its own
# The side of a cell of paint in m, and the number of cells along a side from which on they grow.
_PAINT_CELL_M = 0.002
_MAX_PAINT_CELLS = 2000
_MAX_PAINTS = 255
_HORIZON_COLOR = np.array([236, 241, 246], np.float32)
_ZENITH_COLOR = np.array([150, 186, 222], np.float32)
_HAZE_DISTANCE_M = 12.0  # m; the distance over which the floor fades into the horizon
NEAR_CLIP_M = 0.01
# m by which the eye is moved ahead. The renderer counts pixels of corners that lie in the plane of the eye,
# as those of a flat side do on whose link the camera sits, beyond the range of its integers, and then goes
# through all of them: minutes a picture.
EYE_OFFSET_M = 1.7e-5


class Floor:
    """Colors of points of the plane z = 0."""

    def __init__(self, color: Color | None, lines: Sequence[Line]) -> None:
        self.default_color = color
        self.color(color)
        self._paint = PaintMap(lines) if lines else None

    def color(self, color: Color | None) -> None:
        """Use tiles of this color, or of two grays for None."""
        self.tiles = color
        self._light = _LIGHT_TILE if color is None else np.array(color[:3], np.float32) * np.float32(255.0)
        self._dark = _DARK_TILE if color is None else self._light * np.float32(_DARK_TILE_SHARE)

    def __call__(self, x: FloatArray, y: FloatArray, across: FloatArray) -> FloatArray:
        """Return colors, shape (n, 3), 0 to 255, seen in pixels `across` m long; tiles too small for a pixel
        melt into their mean."""
        sharp = np.clip(1.5 - across * np.float32(1 / TILE_SIZE_M), 0.0, 1.0)
        odd = (np.floor(x * np.float32(1 / TILE_SIZE_M)) + np.floor(y * np.float32(1 / TILE_SIZE_M))).astype(
            np.int32
        ) & 1
        shade = 0.5 + (odd - np.float32(0.5)) * sharp
        colors = self._light + (self._dark - self._light) * shade[:, None]
        return colors if self._paint is None else self._paint.paint(colors, x, y)


class PaintMap:
    """Painted lines as a picture from above: cells of 2 mm, or larger for paint that covers more than 4 m."""

    def __init__(self, lines: Sequence[Line]) -> None:
        edges = [
            (x + s * line.width, y + s * line.width)
            for line in lines
            for x, y in line.points
            for s in (-0.5, 0.5)
        ]
        xs, ys = zip(*edges, strict=True)
        self._corner = min(xs), min(ys)
        size = max(max(xs) - min(xs), max(ys) - min(ys))
        self._cell = max(_PAINT_CELL_M, size / _MAX_PAINT_CELLS)
        shape = tuple(ceil((max(values) - min(values)) / self._cell) + 1 for values in (xs, ys))
        self._cells = np.zeros(shape, np.uint8)
        self._colors = np.zeros((_MAX_PAINTS + 1, 3), np.float32)
        for number, line in enumerate(lines[:_MAX_PAINTS], start=1):
            self._colors[number] = np.array(line.color[:3], np.float32) * 255.0
            for start, end in line.pieces:
                self._stroke(start, end, line.width / 2, number)

    def _stroke(self, start: tuple[float, float], end: tuple[float, float], half: float, paint: int) -> None:
        """Paint all cells whose center is within `half` m of a straight piece."""
        spans = []
        for axis in (0, 1):
            ends = sorted((start[axis], end[axis]))
            first = max(int((ends[0] - half - self._corner[axis]) / self._cell), 0)
            last = min(int((ends[1] + half - self._corner[axis]) / self._cell) + 1, self._cells.shape[axis])
            spans.append(slice(first, last))
        x, y = (
            self._corner[axis] + self._cell * (np.arange(span.start, span.stop) + 0.5)
            for axis, span in enumerate(spans)
        )
        dx, dy = end[0] - start[0], end[1] - start[1]
        length = hypot(dx, dy) or 1.0
        ahead = ((x[:, None] - start[0]) * dx + (y[None, :] - start[1]) * dy) / length
        foot = np.clip(ahead, 0.0, length)
        apart = np.hypot(
            x[:, None] - start[0] - foot * dx / length, y[None, :] - start[1] - foot * dy / length
        )
        self._cells[spans[0], spans[1]][apart <= half] = paint

    def paint(self, colors: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return the colors with the paint at points over them."""
        column, row = (
            (values - np.float32(low)) * np.float32(1 / self._cell)
            for values, low in zip((x, y), self._corner, strict=True)
        )
        inside = np.flatnonzero(
            (column >= 0) & (row >= 0) & (column < self._cells.shape[0]) & (row < self._cells.shape[1])
        )
        paints = self._cells[column[inside].astype(np.int32), row[inside].astype(np.int32)]
        painted = inside[paints > 0]
        colors[painted] = self._colors[paints[paints > 0]]
        return colors


def fill_background(
    picture: Image,
    where: NDArray[np.bool_],
    eye: Triple,
    rays: NDArray[np.float32],
    pixel: float,
    floor: Floor | None,
) -> None:
    """Draw the background into the pixels `where` of a picture, in which there is no body.

    `rays` have a length of 1 along the line of sight (world frame), `pixel` is the width of a pixel at a
    distance of 1 m.
    """
    # Rays closer to the horizon would meet the floor so far away that the division loses its meaning.
    down = rays[..., 2] < -1e-6 if floor is not None and eye[2] > 0.0 else np.zeros_like(where)
    sky = where & ~down
    if sky.any():
        x, y, z = rays[sky].T
        picture[sky] = (
            _HORIZON_COLOR
            + (_ZENITH_COLOR - _HORIZON_COLOR)
            * np.clip(2.0 * z / np.sqrt(x * x + y * y + z * z), 0.0, 1.0)[:, None]
        )
    ground = where & down
    if floor is not None and ground.any():
        x, y, z = rays[ground].T
        times = np.float32(-eye[2]) / z
        reach = times * np.sqrt(x * x + y * y + z * z)
        colors = floor(
            np.float32(eye[0]) + x * times,
            np.float32(eye[1]) + y * times,
            np.float32(pixel / eye[2]) * reach * reach,
        )
        picture[ground] = (
            _HORIZON_COLOR
            + (colors - _HORIZON_COLOR) * np.exp(reach * np.float32(-1 / _HAZE_DISTANCE_M))[:, None]
        )


def downsampled(picture: Image, samples: int) -> Image:
    """Return the picture with each block of `samples` x `samples` pixels as one of their mean."""
    if samples == 1:
        return picture
    height, width, _ = picture.shape
    # A sum of slices takes 1 ms for 640 x 480 pixels; a sum over reshaped axes takes 11 ms.
    total = np.zeros((height // samples, width // samples, 3), np.uint16)
    for row in range(samples):
        for column in range(samples):
            total += picture[row::samples, column::samples]
    return np.asarray(total // samples**2, dtype=np.uint8)


def brightened(picture: Image, brightness: float) -> Image:
    """Return the picture in another light; 1 leaves it as it is."""
    return (
        picture
        if brightness == 1.0
        else np.asarray(np.clip(picture * np.float32(brightness), 0.0, 255.0), dtype=np.uint8)
    )


class CameraPose(NamedTuple):
    """The position (m) of a camera, and unit vectors ahead, left and up."""

    eye: Triple
    ahead: Triple
    left: Triple
    up: Triple


def pose_along(frame: Frame) -> CameraPose:
    """Return the pose that looks along the x axis of a frame, z up."""
    ahead, left, up = (rotate(frame[1], axis) for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
    return CameraPose(frame[0], ahead, left, up)


def pose_of_view(view: View) -> CameraPose:
    """Return the pose that looks from the eye of a view at its target; straight down, up is the x axis."""
    ahead = _unit(subtract(view.target, view.eye))
    left = cross((0.0, 0.0, 1.0), ahead)
    left = (0.0, 1.0, 0.0) if _length(left) < 1e-9 else _unit(left)
    return CameraPose(view.eye, ahead, left, cross(ahead, left))


class Camera:
    """A camera with `height` x `width` pixels; `fov` is the vertical angle (rad). Each pixel is sampled at
    its center."""

    def __init__(self, client: int, width: int, height: int, fov: float, floor: Floor | None) -> None:
        self._pixel = 2 * tan(fov / 2) / height
        self._client = client
        self._size = (width, height)
        self._floor = floor
        across, upward = width * self._pixel / 2, height * self._pixel / 2
        self._rays = np.ones((height, width, 3), np.float32)
        self._rays[..., 1] = across - self._pixel * (np.arange(width) + 0.5)[None, :]
        self._rays[..., 2] = upward - self._pixel * (np.arange(height) + 0.5)[:, None]
        # The renderer samples a pixel at its upper left corner, turned upside down.
        shift = self._pixel / 2
        near = NEAR_CLIP_M
        frustum = (near * edge for edge in (shift - across, shift + across, shift - upward, shift + upward))
        self._projection = p.computeProjectionMatrix(*frustum, near, CAMERA_RANGE_M)

    def _rendered(self, aim: CameraPose) -> tuple[Image, NDArray[np.float32], NDArray[np.int32]]:
        """Return colors, the buffer of depths, and the numbers of bodies (-1 for none), of bodies alone."""
        width, height = self._size
        eye = add(aim.eye, scaled(aim.ahead, EYE_OFFSET_M))
        _, _, pixels, buffer, numbers = p.getCameraImage(
            width,
            height,
            p.computeViewMatrix(eye, add(eye, aim.ahead), aim.up),
            self._projection,
            lightDirection=(1.0, -1.5, 3.0),
            lightColor=(1.0, 1.0, 1.0),
            lightAmbientCoeff=0.55,
            lightDiffuseCoeff=0.5,
            lightSpecularCoeff=0.05,
            shadow=0,
            renderer=p.ER_TINY_RENDERER,  # on the CPU, without OpenGL or a display
            physicsClientId=self._client,
        )
        shape = (height, width)
        colors = np.asarray(pixels, np.uint8).reshape(*shape, 4)[..., :3]
        return (
            colors,
            np.asarray(buffer, np.float32).reshape(shape),
            np.asarray(numbers, np.int32).reshape(shape),
        )

    def _world_rays(self, aim: CameraPose) -> NDArray[np.float32]:
        """Return the line of sight of each pixel in the world frame, with a length of 1 ahead."""
        return (self._rays.reshape(-1, 3) @ np.array(aim[1:], np.float32)).reshape(self._rays.shape)

    def render(self, aim: CameraPose, background: Image) -> Image:
        """Return the colors of bodies, before a background."""
        colors, _, numbers = self._rendered(aim)
        return np.where((numbers < 0)[..., None], background, colors)

    def background(self, aim: CameraPose) -> Image:
        """Return the colors of floor and sky."""
        width, height = self._size
        picture = np.zeros((height, width, 3), np.uint8)
        fill_background(
            picture,
            np.ones((height, width), np.bool_),
            aim.eye,
            self._world_rays(aim),
            self._pixel,
            self._floor,
        )
        return picture

    def camera_image(
        self, aim: CameraPose, name_indices: NDArray[np.int32], ground: int, names: tuple[str, ...]
    ) -> CameraImage:
        """Return the whole picture; `name_indices` are the indices of PyBullet's numbers among `names`,
        `ground` is that of the floor."""
        picture, buffer, numbers = self._rendered(aim)
        colors = picture.copy()
        bare = numbers < 0
        rays = self._world_rays(aim)
        # The inverse of OpenGL's perspective, in which the buffer is nonlinear in the distance.
        depth = CAMERA_RANGE_M * NEAR_CLIP_M / (
            CAMERA_RANGE_M - (CAMERA_RANGE_M - NEAR_CLIP_M) * buffer
        ) + np.float32(EYE_OFFSET_M)
        bodies = np.where(bare, np.int32(-1), name_indices[numbers])
        depth[bare] = CAMERA_RANGE_M
        if self._floor is not None and aim.eye[2] > 0.0:
            floor = bare & (rays[..., 2] < -1e-6)
            bodies[floor] = ground
            depth[floor] = np.minimum(np.float32(-aim.eye[2]) / rays[floor][:, 2], CAMERA_RANGE_M)
        fill_background(colors, bare, aim.eye, rays, self._pixel, self._floor)
        return CameraImage(colors, depth, bodies, names)


def _length(v: Triple) -> float:
    return float(np.linalg.norm(v))


def _unit(v: Triple) -> Triple:
    return scaled(v, 1.0 / _length(v))
