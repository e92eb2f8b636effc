"""Forces on links, for the next engine step."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Literal

from deepbots_cli import frames
from deepbots_cli.engines.pybullet.library import BASE
from deepbots_cli.engines.pybullet.library import pybullet as p
from deepbots_cli.port import STILL

if TYPE_CHECKING:
    from deepbots_cli.engines.pybullet.body import Body
    from deepbots_cli.frames import Triple
    from deepbots_cli.port import Pusher


def pusher(client: int, owner: Body, index: int, frame: Literal["world", "link"]) -> Pusher:
    """PyBullet's own frame of a link is that of its inertia, and of links that it last moved: both are settled here."""
    return _in_link(client, owner, index) if frame == "link" else _in_world(client, owner, index)


def _in_link(client: int, owner: Body, index: int) -> Pusher:
    number = owner.number
    centre, principal = owner.dynamics(index).inertia_frame
    back = frames.inverse(principal)
    origin = frames.rotate(back, frames.scaled(centre, -1.0))
    force_it, turn_it, mode = p.applyExternalForce, p.applyExternalTorque, p.LINK_FRAME
    straight = back == frames.UPRIGHT
    refresh = _refresher(client, number, index)

    def push(force: Triple, torque: Triple) -> None:
        refresh()
        if force != STILL:
            force_it(number, index, force if straight else frames.rotate(back, force), origin, mode, client)
        if torque != STILL:
            turn_it(number, index, torque if straight else frames.rotate(back, torque), mode, client)

    return push


def _in_world(client: int, owner: Body, index: int) -> Pusher:
    number = owner.number
    force_it, turn_it, mode = p.applyExternalForce, p.applyExternalTorque, p.WORLD_FRAME
    read_base, read_link = partial(p.getBasePositionAndOrientation, number, client), partial(p.getLinkState, number, index, 0, 1, client)

    def push(force: Triple, torque: Triple) -> None:
        if force != STILL:
            origin = owner.of_origin(*read_base())[0] if index == BASE else read_link()[4]
            force_it(number, index, force, origin, mode, client)
        if torque != STILL:
            turn_it(number, index, torque, mode, client)

    return push


def _refresher(client: int, number: int, index: int) -> Callable[[], object]:
    return (lambda: None) if index == BASE else partial(p.getLinkState, number, index, 0, 1, client)
