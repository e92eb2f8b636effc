"""Figures of the world that an engine is built with, beyond the bodies, which are read as robot files are."""

from __future__ import annotations

from collections.abc import Iterator

from deepbots_cli.canonical import CanonicalError
from deepbots_cli.ir import MOST_POINTS, CompiledScenario, Formula, Picture, Pit
from deepbots_cli.ir.records import members
from deepbots_cli.robots.model import Mesh

_SMALLEST, _LARGEST = 1e-4, 1e5  # m


def require_world(scenario: CompiledScenario) -> None:
    """Terrain and lines of sizes that can be built, and colours that can be seen."""
    world = scenario.world
    for name, size in _sizes(scenario):
        if not _SMALLEST <= abs(size) <= _LARGEST:
            raise CanonicalError(f"{name[:40]} of {size:g} m")
    if sum(len(line.points) for line in world.lines) > MOST_POINTS:
        raise CanonicalError(f"lines of more than {MOST_POINTS} points")
    for line in world.lines:
        if len(line.points) < 2 or not all(abs(number) <= _LARGEST for point in line.points for number in point):
            raise CanonicalError(f"a line '{line.name[:40]}' that goes nowhere")
    shares = [line.reflectance for line in world.lines] + [share for colour in _colours(world) for share in colour]
    shares += [world.terrain.relief.noise] if world.terrain and isinstance(world.terrain.relief, Pit) else []
    if not all(0.0 <= share <= 1.0 for share in shares):
        raise CanonicalError("a colour or a share beyond 0 to 1")


def _sizes(scenario: CompiledScenario) -> Iterator[tuple[str, float]]:
    world = scenario.world
    yield from (("line", line.width) for line in world.lines)
    match world.terrain.relief if world.terrain else None:
        case Pit(height=height, radius=radius):
            yield from (("pit", height), ("pit", radius))
        case Picture(size=size, height=height):
            yield from (("picture", side) for side in (*size, height))
        case Formula(size=size):
            yield from (("formula", side) for side in size)
        case Mesh(scale=scale):
            yield from (("mesh", factor) for factor in scale)


def _colours(value: object) -> Iterator[tuple[float, ...]]:
    """Every colour that something in the world has."""
    inside = members(value)
    if inside is not None:
        for name, member in inside.items():
            if name == "colour" and member is not None:
                yield member
            else:
                yield from _colours(member)
    elif isinstance(value, tuple):
        for item in value:
            yield from _colours(item)
