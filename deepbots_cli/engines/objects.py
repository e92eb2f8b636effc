"""Objects and walls as robots of one link, which engines load like robots."""

from __future__ import annotations

from dataclasses import replace

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
)

LINK_COLORS = (
    (0.84, 0.44, 0.24, 1.0),
    (0.27, 0.45, 0.66, 1.0),
    (0.30, 0.32, 0.36, 1.0),
    (0.86, 0.70, 0.32, 1.0),
    (0.42, 0.60, 0.46, 1.0),
)
"""The colors that links without a color of their own get, in turn."""


def is_movable(body: ObjectBody) -> bool:
    """Return whether physics moves the object. One without mass, or that is only seen, stays where it is
    put."""
    return body.solid and not body.fixed and body.mass > 0.0


def forms_of(body: ObjectBody) -> dict[str, ObjectBody]:
    """Return the object in each of its variants, by their names; by its own if it has none."""
    fields = ("shape", "mass", "color", "friction", "fixed")
    forms = {
        variant.name: replace(body, variants=(), **{field: getattr(variant, field) for field in fields})
        for variant in body.variants
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
