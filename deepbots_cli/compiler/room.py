"""Whether a body can find room at all: what no draw could ever place is a finding before anything runs."""

from __future__ import annotations

from deepbots_cli import footprint, ir
from deepbots_cli.compiler.namespace import Namespace
from deepbots_cli.footprint import Footprint
from deepbots_cli.source.nodes import Path
from deepbots_cli.task import Placement
from deepbots_cli.urdf.model import Mesh


def check_room(place: Placement, region: ir.Region, world: ir.WorldModel, namespace: Namespace, path: Path) -> None:
    """DB105 where the region is too small or beyond the walls: for one body with its clearance, the grid, all copies together."""
    values, group = namespace.values, namespace.groups.get(place.body)
    kinds = _footprints(place.body, world, group.copies[0] if group else place.body)
    if not kinds:
        return
    least = min(kinds, key=lambda kind: kind.narrowest)
    is_fixed = any(thing.name in (place.body, *(group.copies if group else ())) and thing.fixed for thing in world.objects)
    needed = 2 * least.narrowest + (0.0 if is_fixed else 2 * place.clearance)
    width, depth = (region.high[axis] - region.low[axis] for axis in (0, 1))
    arena = world.arena
    span = values.key_span((*path, "region"))
    copies = 1 if group is None else min(group.capacity, group.capacity if place.at_most is None else place.at_most)
    if arena is not None and needed > min(arena.size):
        headline = (
            f"`{place.body}` needs {needed:.3g} m{'' if is_fixed else ' with its clearance'}, and the arena is {min(arena.size):.3g} m wide"
        )
        values.findings.add("DB105", span, headline, help="give a larger arena, or less clearance")
    elif arena is not None and any(
        region.low[axis] > arena.size[axis] / 2 - needed / 2 or region.high[axis] < needed / 2 - arena.size[axis] / 2 for axis in (0, 1)
    ):
        headline = f"no spot of the region is far enough within the walls of the arena for `{place.body}`"
        values.findings.add("DB105", span, headline, help="let it reach into the arena, which lies about the origin")
    elif region.mesh and (cells := int(width / region.mesh + 1e-9) * int(depth / region.mesh + 1e-9)) < copies:
        headline = f"a grid of {cells} cells for {'one body' if copies == 1 else f'up to {copies} copies'}"
        values.findings.add("DB105", values.key_span((*path, "grid")), headline, help="give a larger region, or a smaller mesh")
    elif arena is not None and copies * (area := min(kind.area for kind in kinds)) > arena.size[0] * arena.size[1]:
        headline = f"{copies} copies of {area:.3g} m^2 cannot stand in {arena.size[0] * arena.size[1]:.3g} m^2"
        values.findings.add("DB105", span, headline, help="give a larger arena, or fewer copies")


def _footprints(body: str, world: ir.WorldModel, first: str) -> list[Footprint]:
    """Of each form that a body may take; none that is known for a mesh."""
    for robot in world.robots:
        if robot.name in (body, first):
            return [footprint.of_robot(robot.model)]
    for thing in world.objects:
        if thing.name == first:
            shapes = [variant.shape for variant in thing.variants] or [thing.shape]
            return [] if any(isinstance(shape, Mesh) for shape in shapes) else [footprint.of_shape(shape) for shape in shapes]
    return []
