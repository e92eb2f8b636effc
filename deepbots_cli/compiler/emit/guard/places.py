"""Where bodies begin: known bodies, bounded numbers, so that a reset ends."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import fields

from deepbots_cli import footprint
from deepbots_cli.canonical import CanonicalError
from deepbots_cli.compiler.emit.guard.expressions import nodes
from deepbots_cli.expressions.scalar import State, World
from deepbots_cli.ir import MOST_BODIES, MOST_SPOTS, Cells, CompiledScenario, Place, Region, Top
from deepbots_cli.robots.model import Box, Cylinder

MOST_ATTEMPTS = 100_000


def require_places(scenario: CompiledScenario) -> None:
    """Every placed body is in the world, every group has its copies, every region and grid is of a size that can be looked through."""
    reset = scenario.reset
    bodies = {*(robot.name for robot in scenario.world.robots), *(thing.name for thing in scenario.world.objects)}
    groups = {group.name: group.capacity for group in reset.groups}
    for name, capacity in groups.items():
        if not 1 <= capacity <= MOST_BODIES or not {f"{name}#{index + 1}" for index in range(capacity)} <= bodies:
            raise CanonicalError(f"'{name[:40]}' has not the copies that it should have")
    if not 1 <= reset.attempts <= MOST_ATTEMPTS:
        raise CanonicalError(f"{reset.attempts} attempts at a start")
    if any(not 0.0 <= layout.share < math.inf for layout in reset.layouts):
        raise CanonicalError("a layout that is taken in an impossible share of the episodes")
    drawn = (reset.places, reset.layouts, reset.joints, reset.variations, reset.groups)
    if any(isinstance(node, (State, World)) for node in nodes(drawn)) or any(isinstance(node, State) for node in nodes(reset.require)):
        raise CanonicalError("a start that depends on what has happened")
    _require_copies(scenario, groups)
    for place in _places(scenario):
        if place.body not in bodies and place.body not in groups:
            raise CanonicalError(f"'{place.body[:40]}' is placed, and is not in the world")
        if not all(map(math.isfinite, (place.clearance, *place.spacing))) or (place.at_most or 0) < 0:
            raise CanonicalError(f"'{place.body[:40]}' is placed by impossible figures")
        if any(len(triple) not in (0, 3) for triple in (place.velocity, place.angular_velocity)):
            raise CanonicalError(f"'{place.body[:40]}' moves in {len(place.velocity)} directions")
        _require_spot(place, scenario)


def _require_copies(scenario: CompiledScenario, groups: Mapping[str, int]) -> None:
    """Whether a copy is present is asked only of those that there are; cases and stages have copies of their own."""
    own = tuple(getattr(scenario, field.name) for field in fields(scenario) if field.name not in ("cases", "curriculum"))
    for node in nodes(own):
        if isinstance(node, World) and node.function == "present":
            group, _, number = node.subjects[0].partition("#")
            if not number.isdecimal() or len(number) > 4 or int(number) > groups.get(group, 0):
                raise CanonicalError(f"'{node.subjects[0][:40]}' is a copy that there is not")


def _require_spot(place: Place, scenario: CompiledScenario) -> None:
    match place.spot:
        case Region() as region if not _is_sound(region):
            raise CanonicalError(f"'{place.body[:40]}' is placed in an impossible region")
        case Top(of, region, mesh):
            thing = next((thing for thing in scenario.world.objects if thing.name == of and not thing.pooled), None)
            if thing is None or not isinstance(thing.shape, (Box, Cylinder)) or of == place.body:
                raise CanonicalError(f"'{place.body[:40]}' is placed on nothing with a flat top")
            reach = footprint.of_shape(thing.shape).radius
            if not all(map(_is_sound, (region or Region((0.0, 0.0), (0.0, 0.0)), Region((-reach, -reach), (reach, reach), mesh)))):
                raise CanonicalError(f"'{place.body[:40]}' is placed in an impossible region")
        case Cells(spots):
            if not spots or not all(math.isfinite(end) for spot in spots for end in spot):
                raise CanonicalError(f"'{place.body[:40]}' is placed in impossible cells")


def _is_sound(region: Region) -> bool:
    sides = [end - start for start, end in zip(region.low, region.high, strict=True)]
    return all(0.0 <= side < math.inf for side in sides) and (region.mesh is None or region.mesh > 0.0) and region.spots <= MOST_SPOTS


def _places(scenario: CompiledScenario) -> Iterator[Place]:
    yield from scenario.reset.places
    for layout in scenario.reset.layouts:
        yield from layout.places
