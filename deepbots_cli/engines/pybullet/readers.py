"""Readers of poses and velocities, in frames of links rather than of their inertia."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from deepbots_cli import frames
from deepbots_cli.engines.pybullet.library import BASE
from deepbots_cli.engines.pybullet.library import pybullet as p
from deepbots_cli.port import STILL

if TYPE_CHECKING:
    from deepbots_cli.engines.pybullet.body import Body
    from deepbots_cli.frames import Triple
    from deepbots_cli.port import Motion, MotionReader, PoseReader, VelocityReader


def pose(client: int, owner: Body, index: int) -> PoseReader:
    number = owner.number
    if index != BASE:
        read_link: Callable[[], tuple[Triple, ...]] = partial(p.getLinkState, number, index, 0, 1, client)
        return lambda: read_link()[4:6]  # type: ignore[return-value]
    read: PoseReader = partial(p.getBasePositionAndOrientation, number, client)
    return read if owner.centred else lambda: owner.of_origin(*read())


def velocity(client: int, owner: Body, index: int) -> VelocityReader:
    if index == BASE and owner.centre == STILL:
        read: VelocityReader = partial(p.getBaseVelocity, owner.number, client)
        return read
    read_motion = motion(client, owner, index)
    return lambda: read_motion()[1]


def motion(client: int, owner: Body, index: int) -> MotionReader:
    number = owner.number
    if index != BASE:
        return _link_motion(partial(p.getLinkState, number, index, 1, 1, client))
    read_pose = partial(p.getBasePositionAndOrientation, number, client)
    read_velocity = partial(p.getBaseVelocity, number, client)
    if owner.centred:
        return lambda: (read_pose(), read_velocity())

    def of_origin() -> Motion:
        centre, turned = read_pose()
        linear, angular = read_velocity()
        pose = owner.of_origin(centre, turned)
        return pose, (frames.add(linear, frames.cross(angular, frames.subtract(pose[0], centre))), angular)

    return of_origin


def _link_motion(read: Callable[[], tuple[Any, ...]]) -> MotionReader:
    def of_origin() -> Motion:
        centre, _, _, _, origin, turned, linear, angular = read()
        return (origin, turned), (frames.add(linear, frames.cross(angular, frames.subtract(origin, centre))), angular)

    return of_origin
