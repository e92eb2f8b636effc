"""Floor and sky of a picture, drawn here rather than by the engine.

A software renderer shades a floor pixel by pixel (22 ms of a 30 ms picture of 480 x 320, measured), although it
looks the same in every picture of one view.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from deepbots_cli.frames import Triple
    from deepbots_cli.port import Image

    Colours = NDArray[np.float32]
    Rays = NDArray[np.float32]
    """Shape (height, width, 3), world frame, and 1 along the line of sight."""

TILE = 0.25  # m
_LIGHT, _DARK = np.array([222, 227, 232], np.float32), np.array([198, 206, 214], np.float32)
_HORIZON, _ZENITH = np.array([236, 241, 246], np.float32), np.array([150, 186, 222], np.float32)
_HAZE = 12.0  # m; the distance over which the floor fades into the horizon


def backdrop(eye: Triple, rays: Rays, pixel: float, floor: NDArray[np.bool_]) -> Image:
    """What is seen where no body is: uint8, shape (height, width, 3).

    `pixel` is the width of a pixel at a distance of 1 m, `floor` says which rays meet the floor.
    """
    length = np.linalg.norm(rays, axis=2)
    picture = _HORIZON + (_ZENITH - _HORIZON) * np.clip(2.0 * rays[..., 2] / length, 0.0, 1.0)[..., None]
    if floor.any():
        down = rays[floor]
        times = eye[2] / -down[:, 2]
        at = np.asarray(eye[:2], np.float32) + down[:, :2] * times[:, None]
        reach = times * length[floor]
        picture[floor] = _tiles(at, pixel * reach * reach / eye[2], reach)
    return np.asarray(picture, dtype=np.uint8)


def _tiles(at: NDArray[np.float32], across: NDArray[np.float32], reach: NDArray[np.float32]) -> Colours:
    """Colours at points of the plane, seen from `reach` m in pixels `across` m long; tiles too small for a pixel melt into their mean."""
    sharp = np.clip(1.5 - across / TILE, 0.0, 1.0)
    odd = np.sum(np.floor(at / TILE), axis=1) % 2.0
    shade = 0.5 + (odd - 0.5) * sharp
    colour = _LIGHT + (_DARK - _LIGHT) * shade[:, None]
    return np.asarray(_HORIZON + (colour - _HORIZON) * np.exp(-reach / _HAZE)[:, None], np.float32)


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
