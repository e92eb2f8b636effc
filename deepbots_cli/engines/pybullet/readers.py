"""Readers of joints, poses and velocities, in frames of links; a reading is kept while the world stands still."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar

from deepbots_cli import frames
from deepbots_cli.engines.pybullet import BASE
from deepbots_cli.engines.pybullet import pybullet as p
from deepbots_cli.port import STILL

if TYPE_CHECKING:
    from deepbots_cli.engines.pybullet.body import Body
    from deepbots_cli.frames import Frame, Triple
    from deepbots_cli.port import JointReader, Motion, MotionReader, PoseReader, VelocityReader

Told = TypeVar("Told")
FEW = 3  # joints, which are read for less than it takes to ask whether they were


class Moments:
    """Counts the states of a world. Several sensors, a signal and a reward may ask for the same pose in one of them.

    `now` holds the number of the present one as its only item; whatever changes what may be read goes on to the next.
    """

    def __init__(self) -> None:
        self.now = [0]
        self._readers: dict[Hashable, Callable[[], Any]] = {}

    def go_on(self) -> None:
        self.now[0] += 1

    def kept(self, key: Hashable, read: Callable[[], Told]) -> Callable[[], Told]:
        """A reader that calls `read` once per moment, however many ask; all that go by one key are one.

        Asking costs 0.07 us, so it is for what takes several times as long.
        """
        if key not in self._readers:
            self._readers[key] = _keeping(self.now, read)
        return self._readers[key]


def _keeping(now: list[int], read: Callable[[], Told]) -> Callable[[], Told]:
    moment, told = -1, None

    def reader() -> Told | None:
        nonlocal moment, told
        if moment != now[0]:
            told = read()
            moment = now[0]
        return told

    return reader  # type: ignore[return-value]


def joints(client: int, number: int, indices: tuple[int, ...], moments: Moments) -> JointReader:
    read: JointReader = partial(p.getJointStates, number, indices, client)
    return read if len(indices) <= FEW else moments.kept(("joints", number, indices), read)


def pose(client: int, owner: Body, index: int, moments: Moments) -> PoseReader:
    number = owner.number
    if index != BASE:
        read_link: Callable[[], tuple[Triple, ...]] = partial(p.getLinkState, number, index, 0, 1, client)
        return moments.kept(("pose", number, index), lambda: read_link()[4:6])  # type: ignore[return-value, arg-type]
    if owner.centred:
        return partial(p.getBasePositionAndOrientation, number, client)
    placed = _placed(client, owner, moments)
    return lambda: placed()[1]


def velocity(client: int, owner: Body, index: int, moments: Moments) -> VelocityReader:
    if index == BASE and owner.centre == STILL:
        read: VelocityReader = partial(p.getBaseVelocity, owner.number, client)
        return read
    read_motion = motion(client, owner, index, moments)
    return lambda: read_motion()[1]


def motion(client: int, owner: Body, index: int, moments: Moments) -> MotionReader:
    number = owner.number
    if index != BASE:
        return moments.kept(("motion", number, index), _link_motion(partial(p.getLinkState, number, index, 1, 1, client)))
    read_velocity = partial(p.getBaseVelocity, number, client)
    if owner.centred:
        read_pose = partial(p.getBasePositionAndOrientation, number, client)
        return moments.kept(("motion", number, index), lambda: (read_pose(), read_velocity()))
    placed = _placed(client, owner, moments)

    def of_origin() -> Motion:
        centre, pose = placed()
        linear, angular = read_velocity()
        return pose, (frames.add(linear, frames.cross(angular, frames.subtract(pose[0], centre))), angular)

    return moments.kept(("motion", number, index), of_origin)


def _placed(client: int, owner: Body, moments: Moments) -> Callable[[], tuple[Triple, Frame]]:
    """Where the centre of mass of a root link is, and the pose of the link."""
    read = partial(p.getBasePositionAndOrientation, owner.number, client)

    def placed() -> tuple[Triple, Frame]:
        centre, turned = read()
        return centre, owner.of_origin(centre, turned)

    return moments.kept(("placed", owner.number), placed)


def _link_motion(read: Callable[[], tuple[Any, ...]]) -> MotionReader:
    def of_origin() -> Motion:
        centre, _, _, _, origin, turned, linear, angular = read()
        return (origin, turned), (frames.add(linear, frames.cross(angular, frames.subtract(origin, centre))), angular)

    return of_origin
