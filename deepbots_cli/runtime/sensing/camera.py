"""Cameras: what the engine sees becomes a picture of bytes."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from deepbots_cli.port import Sight
from deepbots_cli.program.robots import CameraIntrinsics
from deepbots_cli.runtime.sensing.device import Instrument, Site

if TYPE_CHECKING:
    from deepbots_cli.port import Image
    from deepbots_cli.runtime.sensing.device import Device

_GREY = np.array([0.299, 0.587, 0.114], np.float32)
"""How bright red, green and blue are (ITU-R BT.601)."""


def camera(site: Site) -> Instrument:
    """A picture, uint8 of the shape of the optics; behind it what the engine saw, for `sees`."""
    optics, part = site.sensor.optics or CameraIntrinsics(1, 1, 1.0), (site.robot, site.link)
    read, taken = site.engine.camera(part, site.mount, optics.width, optics.height, optics.fov), _PICTURES[optics.channels]

    def picture() -> tuple[Image, Sight]:
        sight = read()
        return taken(sight, optics), sight

    return Instrument(picture)


def sees(device: Device, body: str) -> Callable[[], bool]:
    """Whether the newest picture of a camera shows at least one pixel of the body."""

    def seen() -> bool:
        sight: Sight = device.reading[1]
        return body in sight.names and bool((sight.bodies == sight.names.index(body)).any())

    return seen


def _colours(sight: Sight, _optics: CameraIntrinsics) -> Image:
    return sight.colours


def _grayscale(sight: Sight, _optics: CameraIntrinsics) -> Image:
    return _bytes(np.asarray(sight.colours @ _GREY))


def _depth(sight: Sight, optics: CameraIntrinsics) -> Image:
    """Black at `near`, white at `far` and beyond."""
    share = (sight.depth - optics.near) / (optics.far - optics.near)
    return _bytes(255.0 * np.clip(share, 0.0, 1.0))


def _segmentation(sight: Sight, _optics: CameraIntrinsics) -> Image:
    """0 where there is no body, else the place of the body among those of the world, from 1; 255 for all from there on."""
    return _bytes(np.clip(sight.bodies + 1, 0, 255))


def _bytes(figures: NDArray[Any]) -> Image:
    """One channel of whole figures from 0 to 255."""
    return np.asarray(np.rint(figures), np.uint8)[..., None]


_PICTURES: dict[str, Callable[[Sight, CameraIntrinsics], Image]] = {
    "rgb": _colours,
    "grayscale": _grayscale,
    "depth": _depth,
    "segmentation": _segmentation,
}
