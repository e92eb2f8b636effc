"""Camera positions for a view of the whole scene."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence

from deepbots_cli.expressions.scalar import Const, Draw, Scalar
from deepbots_cli.footprint import Bounds, bounds, bounds_of_shape
from deepbots_cli.frames import Triple, add, cross, dot, scaled
from deepbots_cli.port import STILL, View
from deepbots_cli.program import Program
from deepbots_cli.program.resets import Placement, Region, Top
from deepbots_cli.program.world import ObjectBody, Picture, Pit, WorldModel
from deepbots_cli.runtime.placement import offset

_FROM = (0.25, -0.94, 0.34)  # the direction of the eye from the middle: the front right, above
_FLAT = 0.9  # how much higher the eye stands over what is flat
_MARGIN = 1.12
_LEAST = 0.05  # m; half the side of the smallest scene


def overview(scenario: Program, width: int = 480, height: int = 320) -> View:
    """A view on the arena or the ground that matters, on objects, and on robots wherever an episode may begin."""
    places = {place.body: place for place in scenario.reset.placements}
    for layout in scenario.reset.layouts:
        places = {place.body: place for place in layout.placements} | places
    around_all = [*_surroundings(scenario.world), *_robots(scenario, places), *_objects(scenario.world, places)]
    arena = scenario.world.arena
    if arena is None:
        return around(around_all, width, height)
    x, y = (side / 2 + arena.wall_thickness for side in arena.size)  # what looks for a place stays within the walls
    inside = [((max(a[0], -x), max(a[1], -y), a[2]), (min(b[0], x), min(b[1], y), b[2])) for a, b in around_all]
    return around(inside, width, height)


def around(boxes: Sequence[Bounds], width: int = 480, height: int = 320) -> View:
    """A view from the front right, above, that just holds all boxes, each given by its least and its greatest corner."""
    low = tuple(min((box[0][axis] for box in boxes), default=-0.5) for axis in range(3))
    high = tuple(max((box[1][axis] for box in boxes), default=0.5) for axis in range(3))
    middle = ((low[0] + high[0]) / 2, (low[1] + high[1]) / 2, (low[2] + high[2]) / 2)
    half = tuple(max(_LEAST, (b - a) / 2) for a, b in zip(low, high, strict=True))
    flat = max(0.0, 1.0 - 2.0 * half[2] / max(half[0], half[1]))
    back = _unit((_FROM[0], _FROM[1], _FROM[2] + _FLAT * flat))
    right = _unit(cross((0.0, 0.0, 1.0), back))
    up = cross(back, right)
    view = View(middle, middle, width, height)
    tall = math.tan(view.fov / 2)
    wide = tall * width / height
    corners = [(x * half[0], y * half[1], z * half[2]) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    distance = max(dot(corner, back) + max(abs(dot(corner, right)) / wide, abs(dot(corner, up)) / tall) for corner in corners)
    return View(add(middle, scaled(back, _MARGIN * distance)), middle, width, height)


def _surroundings(world: WorldModel) -> Iterator[Bounds]:
    """Walls, painted lines, and the part of a terrain that is not level."""
    if world.arena is not None:
        x, y = (side / 2 + world.arena.wall_thickness for side in world.arena.size)
        yield (-x, -y, 0.0), (x, y, world.arena.wall_height)
    for line in world.lines:
        xs, ys = zip(*line.points, strict=True)
        yield (min(xs), min(ys), 0.0), (max(xs), max(ys), 0.0)
    if world.terrain is not None:
        match world.terrain.shape:
            case Pit(height=height, radius=radius):
                yield (-1.1 * radius, -1.1 * radius, 0.0), (1.1 * radius, 1.1 * radius, height / 4)
            case Picture(size=(x, y), height=height):
                yield (-x / 2, -y / 2, 0.0), (x / 2, y / 2, height)
            case relief:
                x, y = getattr(relief, "size", (0.0, 0.0))
                yield (-x / 2, -y / 2, 0.0), (x / 2, y / 2, 0.0)


def _robots(scenario: Program, places: dict[str, Placement]) -> Iterator[Bounds]:
    """Robots, wherever they may stand when an episode begins; of copies the two at the ends of their row."""
    copies = scenario.policy.copies
    shifts = [offset(copies, number) for number in (1, copies.count)] if copies else [STILL]
    for robot in scenario.world.robots:
        low, high = _placed(_all_round(bounds(robot.model)), robot.pose.xyz, places.get(robot.name), scenario.world, places)
        yield from ((add(low, shift), add(high, shift)) for shift in shifts)


def _objects(world: WorldModel, places: dict[str, Placement]) -> Iterator[Bounds]:
    """Objects, wherever they may stand when an episode begins."""
    for thing in world.objects:
        yield from _object(thing, world, places)


def _object(thing: ObjectBody, world: WorldModel, places: dict[str, Placement]) -> Iterator[Bounds]:
    """An object in each of its forms, wherever it may stand."""
    place = places.get(thing.name) or places.get(thing.name.partition("#")[0])
    for shape in (thing.shape, *(variant.shape for variant in thing.variants)):
        low, high = bounds_of_shape(shape)
        yield _placed(_all_round((low, high)) if thing.pose.rpy[2] else (low, high), thing.pose.xyz, place, world, places)


def _all_round(box: Bounds) -> Bounds:
    """The box that holds the box however it is turned about the vertical through its origin."""
    low, high = box
    reach = max(math.hypot(x, y) for x in (low[0], high[0]) for y in (low[1], high[1]))
    return (-reach, -reach, low[2]), (reach, reach, high[2])


def _placed(box: Bounds, home: Triple, place: Placement | None, world: WorldModel, places: dict[str, Placement]) -> Bounds:
    low, high = box
    if place is None:
        return add(low, home), add(high, home)
    ends = [_ends(scalar) for scalar in place.xyz]
    if isinstance(place.spot, Top):
        support = next(thing for thing in world.objects if thing.name == place.spot.of)
        (x, y, _), (x_end, y_end, top) = next(_object(support, world, places))
        ends = [(x, x_end), (y, y_end), (ends[2][0] + top, ends[2][1] + top)]
        low, high = (0.0, 0.0, low[2]), (0.0, 0.0, high[2])  # it stands within the top
    elif isinstance(place.spot, Region):
        ends[:2] = list(zip(place.spot.low, place.spot.high, strict=True))
    elif place.spot is not None:
        ends[:2] = [(min(along), max(along)) for along in zip(*place.spot.spots, strict=True)]
    if place.seeks_height:
        ends[2] = (ends[2][0] - low[2], ends[2][1] - low[2])
    (x, x_end), (y, y_end), (z, z_end) = ends
    return add(low, (x, y, z)), add(high, (x_end, y_end, z_end))


def _ends(scalar: Scalar) -> tuple[float, float]:
    """Roughly the least and the greatest value of a coordinate; 0 where nothing is known of it."""
    match scalar:
        case Const(value=value):
            return float(value), float(value)
        case Draw(distribution="normal", args=(mean, _)):
            return _ends(mean)
        case Draw(args=args):
            found = [end for arg in args for end in _ends(arg)]
            return min(found), max(found)
        case _:
            return 0.0, 0.0


def moved(view: View, by: Iterable[float]) -> View:
    """The same view from elsewhere, `by` so many metres along x, y and z."""
    x, y, z = by
    return View(add(view.eye, (x, y, z)), add(view.target, (x, y, z)), view.width, view.height, view.fov, view.samples)


def _unit(v: Triple) -> Triple:
    return scaled(v, 1.0 / math.sqrt(dot(v, v)))
