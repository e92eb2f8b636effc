"""Robots without what PyBullet's loader would misread, invent or crash on."""

from __future__ import annotations

from dataclasses import replace

from deepbots_cli import frames
from deepbots_cli.errors import EngineError
from deepbots_cli.frames import HERE, Frame
from deepbots_cli.robots import inertia
from deepbots_cli.robots.edits import with_link
from deepbots_cli.robots.meshes import checked_bytes
from deepbots_cli.robots.model import Inertial, Joint, Limit, Mesh, RobotModel

PALETTE = ((0.84, 0.44, 0.24, 1.0), (0.27, 0.45, 0.66, 1.0), (0.30, 0.32, 0.36, 1.0), (0.86, 0.70, 0.32, 1.0), (0.42, 0.60, 0.46, 1.0))
NOWHERE = 1e9  # rad or m; the open end of a range with one end
MOST_JOINTS = 127  # of one robot; a larger one loads, but its joints cannot be read
TRACE = 1e-6  # the mass of a root that has none, of what is held to it; its inertia as of a mass 1 m away
UNLIMITED = (1.0, -1.0)  # the loader takes a missing figure for 0, and lower > upper for no limits


def movable(name: str, model: RobotModel, fixed_base: bool) -> RobotModel:
    """The model with a mass on each link: 0 where the file states none, for which a loader would invent 1 kg.

    Raises:
        EngineError: There are too many joints; a joint or a free base moves nothing that has mass, or is of a kind that is
            not supported.
    """
    if len(model.joints) > MOST_JOINTS:
        raise EngineError(f"'{name}' has {len(model.joints)} joints, and PyBullet holds {MOST_JOINTS} at most, fixed ones included")
    carried = inertia.carried(model)
    for joint in model.joints:
        if joint.type in ("floating", "planar"):
            raise EngineError(f"the engine has no {joint.type} joints such as '{joint.name}' of '{name}'")
        if joint.moves and carried[joint.child] <= 0.0:
            raise EngineError(f"joint '{joint.name}' of '{name}' moves nothing that has mass; give link '{joint.child}' an inertial")
    root = model.link(model.root).inertial
    if not fixed_base and (root is None or root.mass <= 0.0):
        model = _with_heavy_root(name, model)
    return replace(model, links=tuple(replace(link, inertial=link.inertial or Inertial(0.0)) for link in model.links))


def _with_heavy_root(name: str, model: RobotModel) -> RobotModel:
    """The model whose root is a mere frame, as `base_footprint` is, with a trace of what fixed joints hold to it.

    The engine would take a free root without mass for one that is bolted to the world.
    """
    links = [model.link(link).inertial for link in held_by(model, model.root)]
    mass = sum(known.mass for known in links if known)
    if mass <= 0.0:
        raise EngineError(f"root link '{model.root}' of '{name}' has no mass; give it an inertial or fix the base")
    trace = TRACE * mass
    return with_link(model, replace(model.link(model.root), inertial=Inertial(trace, ixx=trace, iyy=trace, izz=trace)))


def held_by(model: RobotModel, first: str) -> dict[str, Frame]:
    """The links that fixed joints hold to `first`, itself included, and where they are in its frame."""
    members = {first: HERE}
    waiting = [first]
    while waiting:
        parent = waiting.pop()
        for joint in model.joints:
            if joint.parent == parent and joint.type == "fixed":
                members[joint.child] = frames.inside(members[parent], frames.frame(joint.origin))
                waiting.append(joint.child)
    return members


def dressed(model: RobotModel) -> RobotModel:
    """The model with both ends on each range of a joint, a colour on all that is seen, and meshes still as they were checked.

    A link without visuals shows what it collides with.

    Raises:
        EngineError: A mesh cannot be read or has changed.
    """
    links = []
    for index, link in enumerate(model.links):
        for geometry in (*link.visuals, *link.collisions):
            if isinstance(geometry.shape, Mesh):
                checked_bytes(geometry.shape)
        colour = PALETTE[index % len(PALETTE)]
        visuals = tuple(replace(seen, colour=seen.colour or colour) for seen in link.visuals or link.collisions)
        links.append(replace(link, visuals=visuals))
    return replace(model, links=tuple(links), joints=tuple(replace(joint, limit=_closed(joint)) for joint in model.joints))


def _closed(joint: Joint) -> Limit:
    limit = joint.limit
    lower, upper = limit.lower, limit.upper
    if joint.type == "continuous" or (lower is None and upper is None):
        lower, upper = UNLIMITED
    return Limit(
        lower=-NOWHERE if lower is None else lower,
        upper=NOWHERE if upper is None else upper,
        velocity=limit.velocity or 0.0,
        effort=limit.effort or 0.0,
    )
