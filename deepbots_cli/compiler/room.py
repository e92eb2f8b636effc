"""Whether a body can find room at all: what no draw could ever place is a finding before anything runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import hypot

from deepbots_cli import footprint
from deepbots_cli.compiler.namespace import Namespace
from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions.lower import constant
from deepbots_cli.footprint import Footprint, Patch
from deepbots_cli.program.resets import Layout, Placement, Region, Top
from deepbots_cli.program.world import ObjectBody, WorldModel
from deepbots_cli.robots.model import Box, Cylinder, Mesh

_DWARFS = 16.0
"""Times the area of a top that a body covers whose unit has slipped."""


def check_room(place: Placement, region: Region, world: WorldModel, namespace: Namespace, path: Path) -> None:
    """DB105 where the region is too small or beyond the walls: for one body with its clearance, the grid, all copies together."""
    values = namespace.values
    kinds = _footprints_of(place, world, namespace)
    if not kinds:
        return
    least = min(kinds, key=lambda kind: kind.narrowest)
    is_fixed = _is_fixed(place, world, namespace)
    needed = 2 * least.narrowest + (0.0 if is_fixed else 2 * place.clearance)
    width, depth = (region.high[axis] - region.low[axis] for axis in (0, 1))
    arena = world.arena
    span = values.key_span((*path, "region"))
    copies = _copies(place, namespace)
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


def has_top(thing: ObjectBody) -> bool:
    """Whether other bodies can stand on an object: a single one with a level top that is solid."""
    return thing.solid and not thing.pooled and not thing.variants and isinstance(thing.shape, (Box, Cylinder))


def check_surroundings(common: Sequence[Placement], layouts: Sequence[Layout], world: WorldModel, namespace: Namespace) -> None:
    """What stands around leaves no room in any layout: the top that a body shall stand on, or a body that covers its region."""
    for layout in layouts or (Layout("", 1.0, ()),):
        standing = {place.body: place for place in (*common, *layout.placements)}
        for place in standing.values():
            path: Path = tuple(place.owner.split("."))
            match place.spot:
                case Top() as spot:
                    _check_top(place, spot, standing, world, namespace, path)
                case Region() as region:
                    _check_covered(place, region, standing, world, namespace, path)


def _check_top(place: Placement, spot: Top, standing: Mapping[str, Placement], world: WorldModel, namespace: Namespace, path: Path) -> None:
    """DB207 for bodies that stand on each other, DB203 for a top that is not level, DB105 for one that is too small or elsewhere."""
    add, span = namespace.values.findings.add, namespace.values.span((*path, "on"))
    support, stack = standing[spot.of], [place.body]
    below: Placement | None = support
    while below is not None and below.body not in stack:
        stack.append(below.body)
        below = standing.get(below.spot.of) if isinstance(below.spot, Top) else None
    if below is not None and below.body != next(body for body in standing if body in stack):
        return  # the circle is reported once, of the first of its bodies
    if below is not None and below.body == place.body:
        notes = (f"the circle is {' -> '.join((*stack, place.body))}",) if len(stack) > 1 else ()
        add("DB207", span, f"`{place.body}` stands on itself", help="let one of them stand on the ground", notes=notes)
        return
    if any(_figure(support, turn) != 0.0 for turn in ("roll", "pitch")):
        add("DB203", span, f"the top of `{spot.of}` is not level", help="let it stand upright, without `roll` and `pitch`")
        return
    kinds = _footprints_of(place, world, namespace)
    top = footprint.of_shape(next(thing.shape for thing in world.objects if thing.name == spot.of))
    margin = 0.0 if _is_fixed(place, world, namespace) else place.clearance
    turns = None if _is_tilted(place) else _turn_between(place, support)
    copies = _copies(place, namespace)
    if kinds and not any(_fits(top, kind, turns, margin) for kind in kinds) and not _is_tilted(place):
        edge = f" and keeps {margin:.3g} m from its edge" if margin else ""
        covers = f"`{place.body}`, which covers {_size(min(kinds, key=lambda kind: kind.area))}{edge}"
        ways = [
            *(["less clearance"] if margin else []),
            *(["another `yaw`"] if any(_fits(top, kind, None, margin) for kind in kinds) else []),
        ]
        help = " or ".join(["give a larger top", *ways])
        if min(kind.area for kind in kinds) > _DWARFS * top.area:
            help = f"check the size of `{place.body}`: a length without a unit is in metres"
        add("DB105", span, f"the top of `{spot.of}`, {_size(top)}, is too small for {covers}", help=help)
    elif kinds and not _is_tilted(place) and copies * (area := min(kind.area for kind in kinds)) > top.area:
        headline = f"{copies} copies of {area:.3g} m^2 cannot stand on the {top.area:.3g} m^2 of `{spot.of}`"
        add("DB105", span, headline, help="give a larger top, or fewer copies")
    elif spot.region is not None and (patch := _patch(support, top)) is not None and _misses(spot.region, patch):
        (reach_x, reach_y), span = patch.extent, namespace.values.key_span((*path, "region"))
        sides = f"x = {patch.x - reach_x:g} .. {patch.x + reach_x:g} m and y = {patch.y - reach_y:g} .. {patch.y + reach_y:g} m"
        help = f"leave out `region` to use the whole top, which covers {sides}"
        add("DB105", span, f"no spot of the region lies on the top of `{spot.of}`", help=help)


def _check_covered(
    place: Placement, region: Region, standing: Mapping[str, Placement], world: WorldModel, namespace: Namespace, path: Path
) -> None:
    """DB105 where a body that stands at known coordinates covers the whole region, so that no spot of it is ever free.

    The distance from a convex patch is greatest at a corner of the region: it is enough to look there.
    """
    kinds = _footprints_of(place, world, namespace)
    if not kinds or world.terrain is not None:
        return
    inner = 0.0 if _is_tilted(place) else min(kind.narrowest - hypot(*kind.middle) for kind in kinds)
    corners = [(x, y) for x in (region.low[0], region.high[0]) for y in (region.low[1], region.high[1])]
    for thing in world.objects:
        other = standing.get(thing.name)
        if other is place or thing.pooled or thing.variants or isinstance(thing.shape, Mesh):
            continue
        patch = _standing_patch(thing, other)
        least = inner + max(place.clearance, other.clearance if other else 0.0)
        if patch is not None and all(patch.distance(*corner) < least - 1e-6 for corner in corners):
            headline = f"`{place.body}` finds no place: what `{thing.name}` covers leaves no free spot in the region"
            onto = f"write `on: {thing.name}` to put it on the top of `{thing.name}`, or " if has_top(thing) and other else ""
            namespace.values.findings.add(
                "DB105", namespace.values.key_span((*path, "region")), headline, help=f"{onto}move the region clear of it"
            )
            return


def _standing_patch(thing: ObjectBody, place: Placement | None) -> Patch | None:
    """What an object covers that rises above level ground; None where it does not, or where it stands is not fixed."""
    low, high = footprint.bounds_of_shape(thing.shape)
    if place is None:  # a piece of a wall
        (x, y, z), rpy = thing.pose.xyz, thing.pose.rpy
        return footprint.of_shape(thing.shape).at(x, y, rpy[2]) if z + high[2] > 1e-6 else None
    height = -low[2] if place.rests else _figure(place, "z")
    if _is_tilted(place) or height is None or height + high[2] < 1e-6:
        return None
    return _patch(place, footprint.of_shape(thing.shape))


def _patch(place: Placement, covered: Footprint) -> Patch | None:
    """What a body covers that stands upright at fixed coordinates; None where they are drawn."""
    x, y, yaw = (_figure(place, key) for key in ("x", "y", "yaw"))
    yaw = 0.0 if covered.half is None else yaw
    return None if place.spot is not None or x is None or y is None or yaw is None else covered.at(x, y, yaw + place.heading)


def _figure(place: Placement, key: str) -> float | None:
    """A coordinate in m or rad; None where it is drawn."""
    coordinate = place.coordinates.get(key)
    if coordinate is None:
        return 0.0
    found = constant(coordinate.typed)
    return None if found is None else float(found[0])


def _is_tilted(place: Placement) -> bool:
    return any(_figure(place, turn) != 0.0 for turn in ("roll", "pitch"))


def _turn_between(place: Placement, support: Placement) -> float | None:
    """By how much a body is turned against what it stands on, rad; None where that is drawn."""
    yaw, below = _figure(place, "yaw"), _figure(support, "yaw")
    return None if yaw is None or below is None else yaw + place.heading - below - support.heading


def _fits(top: Footprint, kind: Footprint, turn: float | None, margin: float) -> bool:
    """Whether a body fits on a top: in the middle, at this turn, or as far as is known at any."""
    if turn is not None or top.half is None or kind.half is None:
        middle = kind._replace(middle=(0.0, 0.0))
        return top.at(0.0, 0.0, 0.0).holds(middle.at(0.0, 0.0, turn or 0.0), margin - 1e-6)
    return kind.narrowest + margin <= top.narrowest + 1e-6 and kind.radius + margin <= top.radius + 1e-6


def _misses(region: Region, patch: Patch) -> bool:
    reach = patch.extent
    return any(
        region.low[axis] > middle + reach[axis] or region.high[axis] < middle - reach[axis] for axis, middle in ((0, patch.x), (1, patch.y))
    )


def _size(covered: Footprint) -> str:
    return f"{2 * covered.half[0]:.3g} by {2 * covered.half[1]:.3g} m" if covered.half else f"{2 * covered.radius:.3g} m across"


def _copies(place: Placement, namespace: Namespace) -> int:
    """How many copies are placed at most."""
    group = namespace.groups.get(place.body)
    return 1 if group is None else min(group.capacity, group.capacity if place.at_most is None else place.at_most)


def _is_fixed(place: Placement, world: WorldModel, namespace: Namespace) -> bool:
    group = namespace.groups.get(place.body)
    return any(thing.name in (place.body, *(group.copies if group else ())) and thing.fixed for thing in world.objects)


def _footprints_of(place: Placement, world: WorldModel, namespace: Namespace) -> list[Footprint]:
    group = namespace.groups.get(place.body)
    return _footprints(place.body, world, group.copies[0] if group else place.body)


def _footprints(body: str, world: WorldModel, first: str) -> list[Footprint]:
    """Of each form that a body may take; none that is known for a mesh."""
    for robot in world.robots:
        if robot.name in (body, first):
            return [footprint.of_robot(robot.model)]
    for thing in world.objects:
        if thing.name == first:
            shapes = [variant.shape for variant in thing.variants] or [thing.shape]
            return [] if any(isinstance(shape, Mesh) for shape in shapes) else [footprint.of_shape(shape) for shape in shapes]
    return []
