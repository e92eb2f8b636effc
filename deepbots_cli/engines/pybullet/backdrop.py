"""Floor and sky of a picture, drawn here rather than by the engine.

A software renderer shades a floor pixel by pixel (22 ms of a 30 ms picture of 480 x 320, measured), although it
looks the same in every picture of one view.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from deepbots_cli.engines.pybullet.floor import Floor
    from deepbots_cli.frames import Triple
    from deepbots_cli.port import Image

_HORIZON, _ZENITH = np.array([236, 241, 246], np.float32), np.array([150, 186, 222], np.float32)
_HAZE = 12.0  # m; the distance over which the floor fades into the horizon


def fill(picture: Image, where: NDArray[np.bool_], eye: Triple, rays: NDArray[np.float32], pixel: float, floor: Floor | None) -> None:
    """Draw what is seen where no body is into the pixels `where` of a picture.

    `rays` have a length of 1 along the line of sight (world frame), `pixel` is the width of a pixel at a distance of
    1 m.
    """
    down = rays[..., 2] < -1e-6 if floor is not None and eye[2] > 0.0 else np.zeros_like(where)
    sky = where & ~down
    if sky.any():
        x, y, z = rays[sky].T
        picture[sky] = _HORIZON + (_ZENITH - _HORIZON) * np.clip(2.0 * z / np.sqrt(x * x + y * y + z * z), 0.0, 1.0)[:, None]
    ground = where & down
    if floor is not None and ground.any():
        x, y, z = rays[ground].T
        times = np.float32(-eye[2]) / z
        reach = times * np.sqrt(x * x + y * y + z * z)
        colours = floor(np.float32(eye[0]) + x * times, np.float32(eye[1]) + y * times, np.float32(pixel / eye[2]) * reach * reach)
        picture[ground] = _HORIZON + (colours - _HORIZON) * np.exp(reach * np.float32(-1 / _HAZE))[:, None]


def smoothed(picture: Image, samples: int) -> Image:
    """Each block of `samples` x `samples` pixels as one of their mean."""
    if samples == 1:
        return picture
    height, width, _ = picture.shape
    total = np.zeros((height // samples, width // samples, 3), np.uint16)
    for row in range(samples):
        for column in range(samples):
            total += picture[row::samples, column::samples]
    return np.asarray(total // samples**2, dtype=np.uint8)


def lit(picture: Image, brightness: float) -> Image:
    """The picture in another light; 1 leaves it as it is."""
    return picture if brightness == 1.0 else np.asarray(np.clip(picture * np.float32(brightness), 0.0, 255.0), dtype=np.uint8)
