"""Pictures of the world: bodies by PyBullet's software renderer, floor and sky by ours."""

from __future__ import annotations

from math import tan
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from deepbots_cli.engines.pybullet.backdrop import backdrop
from deepbots_cli.engines.pybullet.library import pybullet as p
from deepbots_cli.frames import add, cross, rotate, scaled, subtract
from deepbots_cli.port import SIGHT

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from deepbots_cli.frames import Frame, Triple
    from deepbots_cli.port import Image, View

NEAREST = 0.01  # m


class Aim(NamedTuple):
    """From where (m), and unit vectors ahead, left and up."""

    eye: Triple
    ahead: Triple
    left: Triple
    up: Triple


def along(frame: Frame) -> Aim:
    """Along the x axis of a frame, z up."""
    ahead, left, up = (rotate(frame[1], axis) for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
    return Aim(frame[0], ahead, left, up)


def at(view: View) -> Aim:
    """From the eye of a view at its target; straight down, up is the x axis."""
    ahead = _unit(subtract(view.target, view.eye))
    left = cross((0.0, 0.0, 1.0), ahead)
    left = (0.0, 1.0, 0.0) if _length(left) < 1e-9 else _unit(left)
    return Aim(view.eye, ahead, left, cross(ahead, left))


class Shot(NamedTuple):
    """`colours` and `depth` as in `Sight`, of bodies alone, whose `numbers` they are (-1 for none); rays, and which meet the floor."""

    colours: Image
    depth: NDArray[np.float32]
    numbers: NDArray[np.int32]
    rays: NDArray[np.float32]
    floor: NDArray[np.bool_]


class Camera:
    """`height` x `width` pixels; `fov` is the vertical angle (rad). A pixel is what its centre sees."""

    def __init__(self, client: int, width: int, height: int, fov: float, has_floor: bool) -> None:
        self.pixel = 2 * tan(fov / 2) / height
        self._client, self._size, self._has_floor = client, (width, height), has_floor
        across, upward = width * self.pixel / 2, height * self.pixel / 2
        self._rays = np.ones((height, width, 3), np.float32)
        self._rays[..., 1] = across - self.pixel * (np.arange(width) + 0.5)[None, :]
        self._rays[..., 2] = upward - self.pixel * (np.arange(height) + 0.5)[:, None]
        shift, near = self.pixel / 2, NEAREST  # the renderer looks through the upper left corner of a pixel, turned upside down
        frustum = (near * edge for edge in (shift - across, shift + across, shift - upward, shift + upward))
        self._projection = p.computeProjectionMatrix(*frustum, near, SIGHT)

    def shoot(self, aim: Aim) -> Shot:
        width, height = self._size
        _, _, pixels, buffer, numbers = p.getCameraImage(
            width,
            height,
            p.computeViewMatrix(aim.eye, add(aim.eye, aim.ahead), aim.up),
            self._projection,
            lightDirection=(1.0, -1.5, 3.0),
            lightColor=(1.0, 1.0, 1.0),
            lightAmbientCoeff=0.55,
            lightDiffuseCoeff=0.5,
            lightSpecularCoeff=0.05,
            shadow=0,
            renderer=p.ER_TINY_RENDERER,
            physicsClientId=self._client,
        )
        shape = (height, width)
        near = np.asarray(buffer, np.float32).reshape(shape)
        depth = SIGHT * NEAREST / (SIGHT - (SIGHT - NEAREST) * near)
        rays = self._rays @ np.array(aim[1:], np.float32)
        floor = (rays[..., 2] < -1e-6) if self._has_floor and aim.eye[2] > 0.0 else np.zeros(shape, np.bool_)
        return Shot(
            np.asarray(pixels, np.uint8).reshape(*shape, 4)[..., :3], depth, np.asarray(numbers, np.int32).reshape(shape), rays, floor
        )

    def behind(self, aim: Aim, shot: Shot) -> Image:
        """Floor and sky."""
        return backdrop(aim.eye, shot.rays, self.pixel, shot.floor)


def depths(aim: Aim, shot: Shot) -> NDArray[np.float32]:
    """Of bodies and floor along the line of sight, m, at most `SIGHT`."""
    depth = np.where(shot.numbers >= 0, shot.depth, np.float32(SIGHT))
    bare = shot.floor & (shot.numbers < 0)
    depth[bare] = np.minimum(aim.eye[2] / -shot.rays[bare][:, 2], SIGHT)
    return depth


def _length(v: Triple) -> float:
    return float(np.linalg.norm(v))


def _unit(v: Triple) -> Triple:
    return scaled(v, 1.0 / _length(v))
