"""The masses of a robot, and its groups of links that are rigid."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

from deepbots_cli import frames
from deepbots_cli.errors import EngineError
from deepbots_cli.frames import IDENTITY_FRAME, Frame
from deepbots_cli.robots.model import (
    Inertial,
    RobotModel,
    with_link,
)

ROOT_MASS_FRACTION = 1e-6
"""The mass of a root without mass, as a share of the mass that is attached to it. Its inertia is that of this
mass at a distance of 1 m."""


def rigid_group(model: RobotModel, first: str) -> dict[str, Frame]:
    """Return the links that fixed joints attach to `first`, itself included, and their frames in its
    frame."""
    members = {first: IDENTITY_FRAME}
    waiting = [first]
    while waiting:
        parent = waiting.pop()
        for joint in model.joints:
            if joint.parent == parent and joint.type == "fixed":
                members[joint.child] = frames.compose(members[parent], frames.frame(joint.origin))
                waiting.append(joint.child)
    return members


def self_collision_pairs(model: RobotModel) -> Iterator[tuple[str, str]]:
    """Yield the pairs of links of a robot that may touch each other: no rigid group has both, and no joint
    joins their groups."""
    group = {link.name: link.name for link in model.links}
    for joint in model.joints:
        if not joint.moves:
            members = rigid_group(model, group[joint.parent])
            group |= dict.fromkeys(members, group[joint.parent])
    joined = {frozenset((group[joint.parent], group[joint.child])) for joint in model.joints}
    for first, second in combinations(group, 2):
        if group[first] != group[second] and frozenset((group[first], group[second])) not in joined:
            yield first, second


def with_explicit_masses(name: str, model: RobotModel, fixed_base: bool) -> RobotModel:
    """Return the model with a mass on each link: 0 where the file states none, for which a loader would
    invent 1 kg.

    Raises:
        EngineError: A joint or a free base moves nothing that has mass, or a joint is of a kind that is not
            supported.
    """
    subtree_mass = model.subtree_mass()
    for joint in model.joints:
        if joint.type in ("floating", "planar"):
            raise EngineError(
                f"the engine does not support {joint.type} joints, such as '{joint.name}' of '{name}'"
            )
        if joint.moves and subtree_mass[joint.child] <= 0.0:
            raise EngineError(
                f"joint '{joint.name}' of '{name}' moves no mass; add an <inertial> with a mass to link"
                f" '{joint.child}'"
            )
    root = model.link(model.root).inertial
    if not fixed_base and (root is None or root.mass <= 0.0):
        model = _with_trace_mass_at_root(name, model)
    return replace(
        model, links=tuple(replace(link, inertial=link.inertial or Inertial(0.0)) for link in model.links)
    )


def _with_trace_mass_at_root(name: str, model: RobotModel) -> RobotModel:
    """Return the model whose root is a mere frame, as `base_footprint` is, with a trace of the mass that
    fixed joints attach to it.

    The engine would take a free root without mass for one that is bolted to the world.

    Raises:
        EngineError: No link that is rigidly attached to the root has a mass.
    """
    links = [model.link(link).inertial for link in rigid_group(model, model.root)]
    mass = sum(link_mass.mass for link_mass in links if link_mass)
    if mass <= 0.0:
        raise EngineError(
            f"root link '{model.root}' of '{name}' has no mass; add an <inertial>, or write `base: fixed`"
        )
    trace = ROOT_MASS_FRACTION * mass
    return with_link(
        model, replace(model.link(model.root), inertial=Inertial(trace, ixx=trace, iyy=trace, izz=trace))
    )
