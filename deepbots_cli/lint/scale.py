"""DB507: bodies whose size or mass is out of all proportion to the rest of the world."""

from __future__ import annotations

import re
from collections.abc import Iterator
from math import hypot

from deepbots_cli import footprint
from deepbots_cli.compiler import Checked
from deepbots_cli.compiler.values import Values
from deepbots_cli.diagnostics import Finding, Span
from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions.dimensions import LENGTH, MASS
from deepbots_cli.expressions.intervals import exact
from deepbots_cli.footprint import sides
from deepbots_cli.lint.meaning import book_of
from deepbots_cli.lint.start import AtStart, is_level
from deepbots_cli.lint.wording import figure
from deepbots_cli.program.world import ObjectBody, RobotBody, Variant
from deepbots_cli.robots.inertia import volume
from deepbots_cli.robots.model import Capsule, Cylinder, Mesh, RobotModel, Shape, Sphere

_LIGHTEST, _HEAVIEST = 0.1, 25_000.0
"""kg/m^3; air has 1.2, osmium 22 600, and a toy balloon weighs 0.2 for each m^3."""
_DWARFS = 4.0
"""Times the size of a robot that begins within an object."""
_INSIDE = 0.01
"""m; by so much the heights of two bodies overlap that do not stand on each other."""
_OUTWEIGHS = 1e5
"""Times the mass of all robots together."""
_WATER = 1000.0
"""kg/m^3"""
_METRES = re.compile(r"([\d.]+(?: [\d.]+)*)(?: *m)?")
_Robots = list[tuple[RobotBody, float]]
"""With the size of each, m."""


def odd_scale(checked: Checked) -> Iterator[Finding]:
    """DB507: the size or the mass of an object is out of all proportion: a unit has slipped.

    A bare number is a length in metres or a mass in kilograms, and a puck with `radius: 4` is 8 m across. The rule reports an object
    within which a robot begins that is four times smaller or more; a movable object of less than 0.1 or more than 25 000 kg/m^3, where
    air has 1.2 and osmium 22 600; and a movable object that is 100 000 times as heavy as all robots together. For an object that
    nothing may move write `fixed: true` instead of a large mass.

    Example::

        objects: {puck: {shape: cylinder, radius: 4, height: 0.03, mass: 0.2, pose: {x: 0.5, z: 0.1}}}

    Instead::

        objects: {puck: {shape: cylinder, radius: 4 cm, height: 3 cm, mass: 200 g, pose: {x: 50 cm, z: 10 cm}}}
    """
    if checked.program is None or checked.namespace is None:
        return
    world, values = checked.program.world, checked.namespace.values
    robots = [(robot, size) for robot in world.robots if (size := _size_of_robot(robot.model)) > 0.0]
    start = AtStart(book_of(checked.program))
    met: set[Path] = set()
    for thing in world.objects:
        for path, kind in _forms(thing):
            if path in met or not values.stands(path):
                continue  # another copy of a group, or a wall
            met.add(path)
            found = _around(start, thing, kind, robots, path, values) or _heavy_or_light(thing, kind, robots, path, values)
            if found is not None:
                yield found


def _forms(thing: ObjectBody) -> Iterator[tuple[Path, Variant]]:
    """Each form that a body may take, and where the scenario tells of it."""
    path: Path = ("objects", thing.name.partition("#")[0])
    if thing.variants:
        yield from (((*path, "one_of", kind.name), kind) for kind in thing.variants)
    else:
        yield path, Variant(thing.name, thing.shape, thing.mass, fixed=thing.fixed)


def _size_of_robot(model: RobotModel) -> float:
    """The longest side of the box around its links, m; meshes do not count."""
    return max(sides(footprint.bounds(footprint.without_meshes(model))))


# Size


def _around(start: AtStart, thing: ObjectBody, kind: Variant, robots: _Robots, path: Path, values: Values) -> Finding | None:
    """An object with a small robot inside of it, wherever both are put."""
    if not thing.solid or isinstance(kind.shape, Mesh):
        return None
    width = 2.0 * footprint.of_shape(kind.shape).narrowest
    for robot, size in robots:
        if width >= _DWARFS * size and _is_within(start, robot, thing, kind.shape):
            headline = f"`{path[-1]}` is {figure(width, LENGTH)} across, and `{robot.name}`, {figure(size, LENGTH)} in size, begins in it"
            return Finding("DB507", _span(path, ("radius", "size"), values), headline, help=_smaller(path, values))
    return None


def _is_within(start: AtStart, robot: RobotBody, thing: ObjectBody, shape: Shape) -> bool:
    """Whether the origin of a robot is within the outline of an object, seen from above, and part of the robot at the same height."""
    reach, half = _core(shape)
    high = footprint.bounds(footprint.without_meshes(robot.model))[1][2]
    standing, lying = footprint.resting(robot.model), footprint.resting(shape)
    pairs = [(one, other) for one in start.poses(thing.name) for other in start.poses(robot.name)]
    for (place, here), (stand, there) in pairs:
        if not (is_level(here) and is_level(there)):
            return False
        middle = exact(lying) if place.rests else here["z"]
        root = exact(standing) if stand.rests else there["z"]
        apart = [max(here[axis].high - there[axis].low, there[axis].high - here[axis].low) for axis in "xy"]
        shared = min(root.low + high, middle.low + half) - max(root.high - standing, middle.high - half)
        if hypot(*apart) >= reach or shared < _INSIDE:
            return False
    return bool(pairs)


def _core(shape: Shape) -> tuple[float, float]:
    """The radius and half the height of an upright cylinder within a shape, m."""
    match shape:
        case Sphere(radius):
            return 0.86 * radius, 0.5 * radius
        case Capsule(radius, length) | Cylinder(radius, length):
            return radius, length / 2
        case _:
            return footprint.of_shape(shape).narrowest, footprint.resting(shape)


# Mass


def _heavy_or_light(thing: ObjectBody, kind: Variant, robots: _Robots, path: Path, values: Values) -> Finding | None:
    """A movable object that is of no material, or that outweighs all robots by far."""
    size = volume(kind.shape)
    if not thing.solid or kind.fixed or not size or kind.mass <= 0.0:
        return None
    weight, density = figure(kind.mass, MASS), kind.mass / size
    water = f"as much water weighs {figure(_WATER * size, MASS)}"
    if not _LIGHTEST <= density <= _HEAVIEST:
        beyond = "more than any metal" if density > _HEAVIEST else "less than a tenth of air"
        shown = f"{density:.0f}" if density > 1000.0 else f"{density:.2g}"
        headline = f"`{path[-1]}` has {shown} kg/m^3, {beyond}: {weight} in {size:.3g} m^3"
        help = f"check the units of its mass and its size: {water}" + ("; or write `fixed: true`" if density > _HEAVIEST else "")
        return Finding("DB507", _span(path, ("mass",), values), headline, help=help)
    carried = sum(link.inertial.mass for robot, _ in robots for link in robot.model.links if link.inertial is not None)
    if carried <= 0.0 or kind.mass < _OUTWEIGHS * carried:
        return None
    headline = f"`{path[-1]}` weighs {weight}, and all robots together {figure(carried, MASS)}"
    return Finding("DB507", _span(path, ("mass", "radius", "size"), values), headline, help=_smaller(path, values))


# Words


def _span(path: Path, keys: tuple[str, ...], values: Values) -> Span:
    """The value of the first of these keys that the object has, or else its name."""
    place = next(((*path, key) for key in keys if values.stands((*path, key))), None)
    return values.span(place) if place else values.key_span(path)


def _smaller(path: Path, values: Values) -> str:
    """What its size would be in centimetres, where it is in metres so far."""
    written = _span(path, ("radius", "size"), values).text
    found = _METRES.fullmatch(written)
    if found is None:
        return "check the unit of its size"
    return f"write `{found[1]} cm` if that is meant" + ("" if "m" in written else ": a number without a unit is in metres")


RULES = (odd_scale,)
