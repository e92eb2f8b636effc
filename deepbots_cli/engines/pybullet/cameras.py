"""Pictures of the world: bodies by PyBullet's software renderer, floor and sky by ours."""

from __future__ import annotations

from math import tan
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from deepbots_cli.engines.pybullet.backdrop import fill
from deepbots_cli.engines.pybullet.library import pybullet as p
from deepbots_cli.frames import add, cross, rotate, scaled, subtract
from deepbots_cli.port import SIGHT, Sight

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from deepbots_cli.engines.pybullet.floor import Floor
    from deepbots_cli.frames import Frame, Triple
    from deepbots_cli.port import Image, View

NEAREST = 0.01  # m
# m by which the eye is moved ahead. The renderer counts pixels of corners that lie in the plane of the eye, as those of a flat
# side do on whose link the camera sits, beyond the range of its integers, and then goes through all of them: minutes a picture.
AHEAD = 1.7e-5


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
    """`colours` and `depth` as in `Sight`, of bodies alone, whose `numbers` they are (-1 for none), and the rays of the pixels."""

    colours: Image
    depth: NDArray[np.float32]
    numbers: NDArray[np.int32]
    rays: NDArray[np.float32]


class Camera:
    """`height` x `width` pixels; `fov` is the vertical angle (rad). A pixel is what its centre sees."""

    def __init__(self, client: int, width: int, height: int, fov: float, floor: Floor | None) -> None:
        self._pixel = 2 * tan(fov / 2) / height
        self._client, self._size, self._floor = client, (width, height), floor
        across, upward = width * self._pixel / 2, height * self._pixel / 2
        self._rays = np.ones((height, width, 3), np.float32)
        self._rays[..., 1] = across - self._pixel * (np.arange(width) + 0.5)[None, :]
        self._rays[..., 2] = upward - self._pixel * (np.arange(height) + 0.5)[:, None]
        shift, near = self._pixel / 2, NEAREST  # the renderer looks through the upper left corner of a pixel, turned upside down
        frustum = (near * edge for edge in (shift - across, shift + across, shift - upward, shift + upward))
        self._projection = p.computeProjectionMatrix(*frustum, near, SIGHT)

    def shoot(self, aim: Aim) -> Shot:
        width, height = self._size
        eye = add(aim.eye, scaled(aim.ahead, AHEAD))
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
            renderer=p.ER_TINY_RENDERER,
            physicsClientId=self._client,
        )
        shape = (height, width)
        depth = SIGHT * NEAREST / (SIGHT - (SIGHT - NEAREST) * np.asarray(buffer, np.float32).reshape(shape)) + np.float32(AHEAD)
        rays = self._rays.reshape(-1, 3) @ np.array(aim[1:], np.float32)
        colours = np.asarray(pixels, np.uint8).reshape(*shape, 4)[..., :3].copy()
        return Shot(colours, depth, np.asarray(numbers, np.int32).reshape(shape), rays.reshape(*shape, 3))

    def picture(self, aim: Aim, behind: Image | None = None) -> Image:
        """Colours with what is behind all bodies, drawn unless it is given."""
        shot = self.shoot(aim)
        bare = shot.numbers < 0
        if behind is not None:
            return np.where(bare[..., None], behind, shot.colours)
        fill(shot.colours, bare, aim.eye, shot.rays, self._pixel, self._floor)
        return shot.colours

    def behind(self, aim: Aim) -> Image:
        """Floor and sky."""
        width, height = self._size
        rays = (self._rays.reshape(-1, 3) @ np.array(aim[1:], np.float32)).reshape(height, width, 3)
        picture = np.zeros((height, width, 3), np.uint8)
        fill(picture, np.ones((height, width), np.bool_), aim.eye, rays, self._pixel, self._floor)
        return picture

    def sight(self, aim: Aim, places: NDArray[np.int32], ground: int, names: tuple[str, ...]) -> Sight:
        """All that is seen; `places` are those of PyBullet's numbers among `names`, `ground` is that of the floor."""
        shot = self.shoot(aim)
        bare = shot.numbers < 0
        bodies = np.where(bare, np.int32(-1), places[shot.numbers])
        shot.depth[bare] = SIGHT
        if self._floor is not None and aim.eye[2] > 0.0:
            floor = bare & (shot.rays[..., 2] < -1e-6)
            bodies[floor] = ground
            shot.depth[floor] = np.minimum(np.float32(-aim.eye[2]) / shot.rays[floor][:, 2], SIGHT)
        fill(shot.colours, bare, aim.eye, shot.rays, self._pixel, self._floor)
        return Sight(shot.colours, shot.depth, bodies, names)


def _length(v: Triple) -> float:
    return float(np.linalg.norm(v))


def _unit(v: Triple) -> Triple:
    return scaled(v, 1.0 / _length(v))
