"""Objects and walls as robots of one link, which engines load like robots; bodies by name, and pooled ones in
one of several forms."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Generic, ParamSpec, Protocol, TypeVar

from deepbots_cli import frames
from deepbots_cli.errors import EngineError
from deepbots_cli.frames import IDENTITY_FRAME, Frame
from deepbots_cli.program.world import ARENA_WALLS, WALL_COLOR, Arena, ObjectBody
from deepbots_cli.robots.model import (
    Box,
    Friction,
    Geometry,
    Inertial,
    Link,
    Pose,
    RobotModel,
    homogeneous_inertial,
    with_link,
)

LINK_COLORS = (
    (0.84, 0.44, 0.24, 1.0),
    (0.27, 0.45, 0.66, 1.0),
    (0.30, 0.32, 0.36, 1.0),
    (0.86, 0.70, 0.32, 1.0),
    (0.42, 0.60, 0.46, 1.0),
)
"""The colors that links without a color of their own get, in turn."""
ROOT_MASS_FRACTION = 1e-6
"""The mass of a root without mass, as a share of the mass that is attached to it. Its inertia is that of this
mass at a distance of 1 m."""


def is_movable(body: ObjectBody) -> bool:
    """Return whether physics moves the object. One without mass, or that is only seen, stays where it is
    put."""
    return body.solid and not body.fixed and body.mass > 0.0


def forms_of(body: ObjectBody) -> dict[str, ObjectBody]:
    """Return the object in each of its variants, by their names; by its own if it has none."""
    fields = ("shape", "mass", "color", "friction", "fixed")
    forms = {
        v.name: replace(body, variants=(), **{field: getattr(v, field) for field in fields})
        for v in body.variants
    }
    return forms or {body.name: body}


def as_robot(body: ObjectBody) -> RobotModel:
    """Return the object as a robot of one link with the object's name; the inertia of a mesh is 0, for the
    engine to find."""
    geometry = Geometry(body.shape, color=body.color)
    link = Link(
        name=body.name,
        inertial=homogeneous_inertial(body.shape, body.mass) or Inertial(body.mass),
        visuals=(geometry,),
        collisions=(geometry,) if body.solid else (),
        friction=Friction(body.friction, body.spinning_friction, body.rolling_friction, body.restitution),
    )
    return RobotModel(name=body.name, links=(link,), joints=(), root=body.name)


def arena_walls(arena: Arena) -> tuple[ObjectBody, ...]:
    """Return four fixed boxes around the inner size of the arena. They are not one body of four parts, since
    an engine discards distant boxes cheaply."""
    x, y = arena.size
    height = arena.wall_height
    thick = arena.wall_thickness
    sides = (
        ((x + thick) / 2, 0.0, thick, y + 2 * thick),
        (-(x + thick) / 2, 0.0, thick, y + 2 * thick),
        (0.0, (y + thick) / 2, x, thick),
        (0.0, -(y + thick) / 2, x, thick),
    )
    return tuple(
        ObjectBody(
            name=name,
            shape=Box((along_x, along_y, height)),
            pose=Pose((at_x, at_y, height / 2)),
            color=arena.color or WALL_COLOR,
            friction=arena.friction,
            fixed=True,
        )
        for name, (at_x, at_y, along_x, along_y) in zip(ARENA_WALLS, sides, strict=True)
    )


# Robots


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


# Bodies by name

T = TypeVar("T")
P = ParamSpec("P")
R = TypeVar("R")


def find(table: dict[str, T], name: str, message: str) -> T:
    """Return the entry called `name`; `message` is the beginning of the error, which lists the existing
    names."""
    try:
        return table[name]
    except KeyError:
        raise EngineError(f"{message} '{name}'; there are {', '.join(table)}") from None


class Form(Protocol):
    """A body in an engine."""

    def deactivate(self) -> None:
        """Make the body absent: touched and seen by nothing."""

    def activate(self) -> None:
        """Make the body present."""


Body = TypeVar("Body", bound=Form)


class Pool(Generic[Body]):
    """The forms of one name. A body that is not pooled has one form and is always present."""

    def __init__(self, name: str, forms: Sequence[tuple[str, Body]], pooled: bool) -> None:
        self.name = name
        self.pooled = pooled
        self.present = not pooled
        self.current = forms[0][1]
        self._forms = dict(forms)

    def __iter__(self) -> Iterator[Body]:
        return iter(self._forms.values())

    def choose(self, form: str) -> None:
        self.current = find(self._forms, form, f"'{self.name}' has no variant")

    def deactivate(self) -> None:
        """Make the body absent, in the first form."""
        if self.pooled:
            self.present = False
            self.current = next(iter(self))
            for body in self:
                body.deactivate()

    def activate(self) -> Body:
        """Make the body present, in the chosen form."""
        self.present = True
        self.current.activate()
        return self.current

    def bind_current(self, bind: Callable[[Body], Callable[P, R]]) -> Callable[P, R]:
        """Bind a function to the form that is present when it is called. A body with a single form is bound
        directly, without a look-up."""
        if len(self._forms) == 1:
            return bind(self.current)
        table = {id(body): bind(body) for body in self}

        def call_current(*args: P.args, **kwargs: P.kwargs) -> R:
            return table[id(self.current)](*args, **kwargs)

        return call_current
