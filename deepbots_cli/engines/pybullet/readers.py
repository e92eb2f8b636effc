"""Readers of poses and velocities, in frames of links rather than of their inertia."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from deepbots_cli import frames
from deepbots_cli.engines.pybullet.library import BASE
from deepbots_cli.engines.pybullet.library import pybullet as p
from deepbots_cli.port import STILL

if TYPE_CHECKING:
    from deepbots_cli.engines.pybullet.body import Body
    from deepbots_cli.frames import Triple
    from deepbots_cli.port import PoseReader, VelocityReader


def pose(client: int, owner: Body, index: int) -> PoseReader:
    number = owner.number
    if index != BASE:
        read_link: Callable[[], tuple[Triple, ...]] = partial(p.getLinkState, number, index, 0, 1, client)
        return lambda: read_link()[4:6]  # type: ignore[return-value]
    read: PoseReader = partial(p.getBasePositionAndOrientation, number, client)
    return read if owner.centred else lambda: owner.of_origin(*read())


def velocity(client: int, owner: Body, index: int) -> VelocityReader:
    number = owner.number
    if index != BASE:
        return _link_velocity(partial(p.getLinkState, number, index, 1, 1, client))
    read: VelocityReader = partial(p.getBaseVelocity, number, client)
    if owner.centre == STILL:
        return read
    read_pose = partial(p.getBasePositionAndOrientation, number, client)

    def of_origin() -> tuple[Triple, Triple]:
        (linear, angular), (centre, turned) = read(), read_pose()
        arm = frames.subtract(owner.of_origin(centre, turned)[0], centre)
        return frames.add(linear, frames.cross(angular, arm)), angular

    return of_origin


def _link_velocity(read: Callable[[], tuple[Triple, ...]]) -> VelocityReader:
    def of_origin() -> tuple[Triple, Triple]:
        centre, _, _, _, origin, _, linear, angular = read()
        return frames.add(linear, frames.cross(angular, frames.subtract(origin, centre))), angular

    return of_origin
