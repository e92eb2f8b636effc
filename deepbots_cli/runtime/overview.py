"""Camera positions for a view of the whole scene."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache

from deepbots_cli.expressions.functions import interval_of
from deepbots_cli.expressions.intervals import Interval
from deepbots_cli.expressions.scalar import Const, Draw, Name, Op, Scalar
from deepbots_cli.frames import Triple, add, cross, dot, quaternion, rotate, scaled
from deepbots_cli.geometry import ground_height, terrain_bounds
from deepbots_cli.port import ZERO_VECTOR, Engine, View
from deepbots_cli.program import Program
from deepbots_cli.program.resets import Placement, Region, Top
from deepbots_cli.program.world import ObjectBody, Picture, Pit, Terrain, WorldModel
from deepbots_cli.robots.kinematics import bounds_of_shape, box_around, robot_bounds
from deepbots_cli.robots.meshes import Bounds
from deepbots_cli.runtime.placement import copy_offset

# The direction of the eye from the middle: the right, a little to the front, above.
_EYE_DIRECTION = (0.25, -0.94, 0.34)
_MIN_FRONT_ASPECT = 2.0  # how many times as long as wide a scene is that is seen from the front
_FLAT_EYE_RISE = 0.9  # how much higher the eye is over flat scenes
_VIEW_MARGIN = 1.08
_SCENE_GAP = 0.1
"""The gap between two scenes that stand side by side, as a share of the wider one."""
_MIN_HALF_SIDE_M = 0.05  # m; half the side of the smallest scene
_LARGE = 15.0
"""The size of a box that is cropped to the robots, as a multiple of the largest side of a robot."""
_CROP_MARGIN = 3.0
"""The part of a cropped box that is shown on each side of the robots, as a multiple of the same side."""
_LEG_ROOM = 0.2
"""The room around a robot that the view follows, as a share of its largest side."""
_ARM_ROOM = 0.12
"""The room around a robot with a fixed base, as a share of its largest side."""
_GROUND_SAMPLES = 9
"""The number of samples of the ground along x and y, within the area where a body may begin."""

Parameters = Mapping[tuple[str, str | None], Scalar]
"""The tree of each component of a parameter."""


def overview(scenario: Program, width: int = 480, height: int = 320) -> View:
    """Return a view on the arena or the ground that matters, on objects, and on robots wherever an episode
    may begin."""
    return view_around(extent(scenario), width, height)


def extent(scenario: Program) -> list[Bounds]:
    """Return boxes (m) around everything that an overview shows."""
    places = {place.body: place for place in scenario.reset.placements}
    for layout in scenario.reset.layouts:
        places = {place.body: place for place in layout.placements} | places
    parameters = {
        (parameter.name, component): scalar
        for parameter in scenario.parameters
        for component, scalar in zip(
            parameter.typed.type.components or (None,), parameter.scalars, strict=True
        )
    }
    world = scenario.world
    robots = list(_robot_boxes(scenario, places, parameters))
    around = [
        *_surroundings(world),
        *(box for body in world.objects for box in _object_boxes(body, world, places, parameters)),
    ]
    if world.arena is None and robots:
        around = list(_crop_to_robots(robots, around))
    return [*robots, *around]


def view_around(boxes: Sequence[Bounds], width: int = 480, height: int = 320) -> View:
    """Return a view that just contains all boxes, each given by its least and its greatest corner: from the
    right, above, or from the front if the boxes extend far to the sides.
    """
    middle, (right, up, back) = _axes(boxes)
    corners = _corners(
        [*boxes, (add(middle, (-_MIN_HALF_SIDE_M,) * 3), add(middle, (_MIN_HALF_SIDE_M,) * 3))]
    )
    tall = math.tan(View(ZERO_VECTOR, ZERO_VECTOR).fov / 2) / _VIEW_MARGIN
    # A corner is in the picture if |(corner - eye) * side| <= slope * (eye - corner) * back, for both sides
    # of the picture.
    eye = ZERO_VECTOR
    distance = -math.inf
    for side, slope in ((right, tall * width / height), (up, tall)):
        ahead = max(dot(corner, side) + slope * dot(corner, back) for corner in corners)
        behind = max(slope * dot(corner, back) - dot(corner, side) for corner in corners)
        eye = add(eye, scaled(side, (ahead - behind) / 2))
        distance = max(distance, (ahead + behind) / (2 * slope))
    eye = add(eye, scaled(back, distance))
    return View(eye, add(eye, scaled(back, dot(middle, back) - distance)), width, height)


def shift_beside(boxes: Sequence[Bounds], other_boxes: Sequence[Bounds]) -> Triple:
    """Return the shift (m) that puts other boxes to the right of boxes, as `view_around` sees these."""
    _, (right, _, _) = _axes(boxes)
    (left_start, left_end), (right_start, right_end) = (
        (min(along), max(along))
        for along in (
            [dot(corner, right) for corner in _corners([box_around(scene)])] for scene in (boxes, other_boxes)
        )
    )
    gap = _SCENE_GAP * max(left_end - left_start, right_end - right_start)
    return scaled(right, left_end - right_start + gap)


def _axes(boxes: Sequence[Bounds]) -> tuple[Triple, tuple[Triple, Triple, Triple]]:
    """Return the middle of all boxes, and the directions right, up and back of the viewer at them."""
    (x, y, z), (x_end, y_end, z_end) = box_around(boxes)
    wide, deep, tall = (max(2 * _MIN_HALF_SIDE_M, extent) for extent in (x_end - x, y_end - y, z_end - z))
    away, aside, above = _EYE_DIRECTION
    if deep > _MIN_FRONT_ASPECT * wide:
        away, aside = -aside, away
    back = _unit((away, aside, above + _FLAT_EYE_RISE * max(0.0, 1.0 - 2.0 * tall / max(wide, deep))))
    right = _unit(cross((0.0, 0.0, 1.0), back))
    return ((x + x_end) / 2, (y + y_end) / 2, (z + z_end) / 2), (right, cross(back, right), back)


def _corners(boxes: Iterable[Bounds]) -> list[Triple]:
    return [(x, y, z) for a, b in boxes for x in (a[0], b[0]) for y in (a[1], b[1]) for z in (a[2], b[2])]


def _surroundings(world: WorldModel) -> Iterator[Bounds]:
    """Yield walls, painted lines, and a terrain, of a pit its uneven part."""
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
                yield terrain_bounds(relief)


def follows_robot(world: WorldModel) -> bool:
    """Return whether a view follows the first free robot: nothing else shows where it is."""
    return (
        world.arena is None
        and world.terrain is None
        and not world.lines
        and any(not robot.fixed_base for robot in world.robots)
    )


def _robot_boxes(scenario: Program, places: dict[str, Placement], parameters: Parameters) -> Iterator[Bounds]:
    """Yield robots, wherever they may be when an episode begins; for copies the two at the ends of their
    row."""
    copies = scenario.agent.copies
    shifts = [copy_offset(copies, number) for number in (1, copies.count)] if copies else [ZERO_VECTOR]
    for robot in scenario.world.robots:
        states = [
            state
            for start in scenario.reset.joint_starts
            if start.robot == robot.name
            for state in start.states
        ]
        joints = {joint: sum(_value_range(position, parameters)) / 2 for joint, position, _ in states}
        box = _tilted(robot_bounds(robot.model, joints), robot.pose.rpy, places.get(robot.name), parameters)
        turns = robot.name in places or robot.pose.rpy[2] != 0.0
        box = _all_round(box) if turns else box
        # Legs and arms swing out.
        if follows_robot(scenario.world) or (robot.fixed_base and robot.model.moving_joints):
            room = (_ARM_ROOM if robot.fixed_base else _LEG_ROOM) * max(
                high - low for low, high in zip(*box, strict=True)
            )
            box = add(box[0], (-room, -room, 0.0)), add(box[1], (room, room, room))
        low, high = _box_where_placed(
            box, robot.pose.xyz, places.get(robot.name), scenario.world, places, parameters
        )
        yield from ((add(low, shift), add(high, shift)) for shift in shifts)


def _object_boxes(
    body: ObjectBody, world: WorldModel, places: dict[str, Placement], parameters: Parameters
) -> Iterator[Bounds]:
    """Yield an object in each of its forms, wherever it may be."""
    place = places.get(body.name) or places.get(body.name.partition("#")[0])
    for shape in (body.shape, *(variant.shape for variant in body.variants)):
        low, high = _tilted(bounds_of_shape(shape), body.pose.rpy, place, parameters)
        yield _box_where_placed(
            _all_round((low, high)) if body.pose.rpy[2] else (low, high),
            body.pose.xyz,
            place,
            world,
            places,
            parameters,
        )


def _crop_to_robots(robots: Sequence[Bounds], boxes: Iterable[Bounds]) -> Iterator[Bounds]:
    """Yield the boxes, of which those that dwarf the robots are cut to the part around them: on a field of 20
    m, a robot is a dot."""
    side = max(high - low for box in robots for low, high in zip(*box, strict=True))
    low, high = box_around(robots)
    room = (_CROP_MARGIN * side,) * 3
    low, high = add(low, scaled(room, -1.0)), add(high, room)
    for start, end in boxes:
        cut = tuple(map(max, start, low)), tuple(map(min, end, high))
        is_large = max(b - a for a, b in zip(start, end, strict=True)) > _LARGE * side
        is_cut = is_large and all(a <= b for a, b in zip(*cut, strict=True))
        yield (
            ((cut[0][0], cut[0][1], cut[0][2]), (cut[1][0], cut[1][1], cut[1][2])) if is_cut else (start, end)
        )


def _tilted(box: Bounds, rpy: Triple, place: Placement | None, parameters: Parameters) -> Bounds:
    """Return the box that contains the box as it lies by its roll and pitch (rad)."""
    if place is None:
        roll, pitch, _ = rpy
    else:
        roll, pitch = (sum(_value_range(angle, parameters)) / 2 for angle in place.rpy[:2])
    if roll == pitch == 0.0:
        return box
    rotation = quaternion(roll, pitch, 0.0)
    corners = [rotate(rotation, corner) for corner in _corners([box])]
    (x, y, z), (x_end, y_end, z_end) = (
        [end(corner[axis] for corner in corners) for axis in range(3)] for end in (min, max)
    )
    return (x, y, z), (x_end, y_end, z_end)


def _all_round(box: Bounds) -> Bounds:
    """Return the box that contains the box however it is turned about the vertical through its origin."""
    low, high = box
    reach = max(math.hypot(x, y) for x in (low[0], high[0]) for y in (low[1], high[1]))
    return (-reach, -reach, low[2]), (reach, reach, high[2])


def _box_where_placed(
    box: Bounds,
    own_position: Triple,
    place: Placement | None,
    world: WorldModel,
    places: dict[str, Placement],
    parameters: Parameters,
) -> Bounds:
    low, high = box
    if place is None:
        return add(low, own_position), add(high, own_position)
    ends = [_value_range(scalar, parameters) for scalar in place.xyz]
    if isinstance(place.spot, Top):
        support = next(body for body in world.objects if body.name == place.spot.of)
        (x, y, _), (x_end, y_end, top) = next(_object_boxes(support, world, places, parameters))
        ends = [(x, x_end), (y, y_end), (ends[2][0] + top, ends[2][1] + top)]
        low, high = (0.0, 0.0, low[2]), (0.0, 0.0, high[2])  # it stands within the top
    elif isinstance(place.spot, Region):
        ends[:2] = list(zip(place.spot.low, place.spot.high, strict=True))
    elif place.spot is not None:
        ends[:2] = [(min(along), max(along)) for along in zip(*place.spot.spots, strict=True)]
    if world.terrain is not None and not isinstance(place.spot, Top):
        ground_low, ground_high = _ground_range(world.terrain, ends[0], ends[1])
        ends[2] = (ends[2][0] + ground_low, ends[2][1] + ground_high)
    if place.seeks_height:
        ends[2] = (ends[2][0] - low[2], ends[2][1] - low[2])
    (x, x_end), (y, y_end), (z, z_end) = ends
    box = add(low, (x, y, z)), add(high, (x_end, y_end, z_end))
    return box if place.spot is None else _within_walls(box, world)


def _within_walls(box: Bounds, world: WorldModel) -> Bounds:
    """Return the part of a box within the walls of the arena: bodies that look for a place stay there."""
    if world.arena is None:
        return box
    low, high = box
    x, y = (side / 2 + world.arena.wall_thickness for side in world.arena.size)
    return (max(low[0], -x), max(low[1], -y), low[2]), (min(high[0], x), min(high[1], y), high[2])


@lru_cache(maxsize=1000)  # a view that follows a robot is computed in every frame
def _ground_range(terrain: Terrain, xs: tuple[float, float], ys: tuple[float, float]) -> tuple[float, float]:
    """Return the lowest and the highest sample (m) of the ground in a rectangle; 0 for a pit, whose box has
    room for bodies on its sides."""
    if isinstance(terrain.shape, Pit):
        return 0.0, 0.0
    height = ground_height(terrain)
    along_x, along_y = (
        {low + (high - low) * step / (_GROUND_SAMPLES - 1) for step in range(_GROUND_SAMPLES)}
        for low, high in (xs, ys)
    )
    heights = [height(x, y) for x in along_x for y in along_y]
    return min(heights), max(heights)


def _value_range(scalar: Scalar, parameters: Parameters) -> tuple[float, float]:
    """Return roughly the least and the greatest value of a coordinate; 0 if nothing is known of it."""
    match scalar:
        case Const(value=value):
            return float(value), float(value)
        case Draw(distribution="normal", args=(mean, _)):
            return _value_range(mean, parameters)
        case Draw(args=args):
            ends = [end for arg in args for end in _value_range(arg, parameters)]
            return min(ends), max(ends)
        case Name(name, component) if (name, component) in parameters:
            return _value_range(parameters[name, component], parameters)
        case Op():
            interval = interval_of(scalar, lambda argument: Interval(*_value_range(argument, parameters)))
            return (interval.low, interval.high) if interval.is_finite else (0.0, 0.0)
        case _:
            return 0.0, 0.0


def moved_view(view: View, by: Iterable[float]) -> View:
    """Return the view shifted by `by` (m) along x, y and z."""
    x, y, z = by
    return replace(view, eye=add(view.eye, (x, y, z)), target=add(view.target, (x, y, z)))


class FollowingView:
    """The view of `Supervisor.render`: it shows the whole scene, and follows a robot that may leave it."""

    def __init__(self, scenario: Program, engine: Engine) -> None:
        self._scenario = scenario
        self._engine = engine
        self._origin: tuple[float, float] | None = None

    def restart(self) -> None:
        """Begin an episode: the robot is where it shall be seen."""
        self._origin = None

    def view(self, width: int, height: int) -> View:
        return moved_view(overview(self._scenario, width, height), self._shift())

    def _shift(self) -> Triple:
        """Return the shift of the view: none within an arena or on terrain, else the way of the first free
        robot."""
        world = self._scenario.world
        if not follows_robot(world):
            return ZERO_VECTOR
        robot = next(robot.name for robot in world.robots if not robot.fixed_base)
        x, y, _ = self._engine.pose(robot)()[0]
        self._origin = self._origin or (x, y)
        return x - self._origin[0], y - self._origin[1], 0.0


def _unit(v: Triple) -> Triple:
    return scaled(v, 1.0 / math.sqrt(dot(v, v)))
