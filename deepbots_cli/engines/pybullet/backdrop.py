"""Floor and sky of a picture, drawn here rather than by the engine.

A software renderer shades a floor pixel by pixel (22 ms of a 30 ms picture of 480 x 320, measured), although it
looks the same in every picture of one view.
"""

from __future__ import annotations

from math import tan
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from deepbots_cli.port import Image, View

TILE = 0.25  # m
_LIGHT, _DARK = np.array([222, 227, 232.0]), np.array([198, 206, 214.0])
_HORIZON, _ZENITH = np.array([236, 241, 246.0]), np.array([150, 186, 222.0])
_HAZE = 12.0  # m; the distance over which the floor fades into the horizon


def backdrop(view: View, floor: bool) -> Image:
    """What is seen where no body is: uint8, shape (height, width, 3)."""
    rays = _rays(view)
    height = rays[..., 2]
    picture = _HORIZON + (_ZENITH - _HORIZON) * np.clip(2.0 * height, 0.0, 1.0)[..., None]
    if floor and view.eye[2] > 0.0:
        seen = height < -1e-6
        reach = view.eye[2] / -height[seen]
        picture[seen] = _floor(np.asarray(view.eye)[:2] + rays[seen][:, :2] * reach[:, None], reach, view)
    return np.asarray(picture, dtype=np.uint8)


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


def axes(view: View) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Unit vectors of a view: ahead, right and up. Looking straight down, up is the x axis."""
    ahead = np.subtract(view.target, view.eye).astype(np.float64)
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, (0.0, 0.0, 1.0))
    right = np.array([0.0, -1.0, 0.0]) if np.linalg.norm(right) < 1e-9 else right / np.linalg.norm(right)
    return ahead, right, np.cross(right, ahead)


def _rays(view: View) -> NDArray[np.float64]:
    """A unit vector per pixel, shape (height, width, 3)."""
    ahead, right, up = axes(view)
    half = tan(view.fov / 2)
    rows = (1.0 - (2.0 * np.arange(view.height) + 1.0) / view.height) * half
    columns = ((2.0 * np.arange(view.width) + 1.0) / view.width - 1.0) * half * view.width / view.height
    rays = ahead + columns[None, :, None] * right + rows[:, None, None] * up
    return np.asarray(rays / np.linalg.norm(rays, axis=2, keepdims=True))


def _floor(at: NDArray[np.float64], reach: NDArray[np.float64], view: View) -> NDArray[np.float64]:
    """Colours of tiles at points of the plane; tiles too small for a pixel melt into their mean."""
    pixel = reach * 2 * tan(view.fov / 2) / view.height * (reach / view.eye[2])
    sharp = np.clip(1.5 - pixel / TILE, 0.0, 1.0)
    odd = np.sum(np.floor(at / TILE), axis=1) % 2.0
    shade = 0.5 + (odd - 0.5) * sharp
    colour = _LIGHT + (_DARK - _LIGHT) * shade[:, None]
    return np.asarray(_HORIZON + (colour - _HORIZON) * np.exp(-reach / _HAZE)[:, None])
