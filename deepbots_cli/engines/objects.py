"""Objects and walls as robots of one link, which engines load like robots; bodies by name."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

from deepbots_cli.errors import EngineError
from deepbots_cli.program.world import ARENA_WALLS, WALL_COLOUR, Arena, ObjectBody
from deepbots_cli.robots import inertia
from deepbots_cli.robots.model import Box, Friction, Geometry, Inertial, Link, Pose, RobotModel


def moves(body: ObjectBody) -> bool:
    """Whether physics moves the object. One without mass, or that is only seen, stays where it is put."""
    return body.solid and not body.fixed and body.mass > 0.0


def forms(body: ObjectBody) -> dict[str, ObjectBody]:
    """The object in each of its variants, by their names; by its own if it has none."""
    figures = ("shape", "mass", "colour", "friction", "fixed")
    shown = {v.name: replace(body, variants=(), **{what: getattr(v, what) for what in figures}) for v in body.variants}
    return shown or {body.name: body}


def as_robot(body: ObjectBody) -> RobotModel:
    """The object as a robot of one link with the object's name; the inertia of a mesh is 0, for the engine to find."""
    seen = Geometry(body.shape, colour=body.colour)
    link = Link(
        name=body.name,
        inertial=inertia.homogeneous(body.shape, body.mass) or Inertial(body.mass),
        visuals=(seen,),
        collisions=(seen,) if body.solid else (),
        friction=Friction(body.friction, body.spinning_friction, body.rolling_friction, body.restitution),
    )
    return RobotModel(name=body.name, links=(link,), joints=(), root=body.name)


def walls(arena: Arena) -> tuple[ObjectBody, ...]:
    """Four fixed boxes around the inner size of the arena. Four, not one of four parts: an engine sorts out far boxes cheaply."""
    (x, y), height, thick = arena.size, arena.wall_height, arena.wall_thickness
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
            colour=arena.colour or WALL_COLOUR,
            friction=arena.friction,
            fixed=True,
        )
        for name, (at_x, at_y, along_x, along_y) in zip(ARENA_WALLS, sides, strict=True)
    )


Found = TypeVar("Found")


def find(table: dict[str, Found], name: str, lacking: str) -> Found:
    """The entry called `name`; `lacking` opens the sentence of the error that lists what there is."""
    try:
        return table[name]
    except KeyError:
        raise EngineError(f"{lacking} '{name}'; there are {', '.join(table)}") from None
