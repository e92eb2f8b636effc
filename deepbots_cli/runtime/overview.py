"""Camera positions for a view of the whole scene."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

from deepbots_cli.expressions.functions import interval_of
from deepbots_cli.expressions.intervals import Interval
from deepbots_cli.expressions.scalar import Const, Draw, Name, Op, Scalar
from deepbots_cli.frames import Triple, add, cross, dot, scaled
from deepbots_cli.geometry import terrain_bounds
from deepbots_cli.port import ZERO_VECTOR, Engine, View
from deepbots_cli.program import Program
from deepbots_cli.program.resets import Placement, Region, Top
from deepbots_cli.program.world import ObjectBody, Pit, WorldModel
from deepbots_cli.robots.kinematics import bounds_of_shape, box_around, robot_bounds
from deepbots_cli.robots.meshes import Bounds
from deepbots_cli.robots.model import Pose
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
_ROBOT_ROOM = 0.15
"""The room for limbs around a robot outside of an arena, as a share of its largest side."""
_UPRIGHT = 0.4
"""The roll and pitch in rad up to which a body is as tall as an upright one."""
_CROP_MARGIN = 3.0
"""The part of a cropped box that is shown on each side of the robots, as a multiple of the same side."""

Parameters = Mapping[tuple[str, str | None], Scalar]
"""The tree of each component of a parameter."""


def overview(scenario: Program, width: int = 480, height: int = 320) -> View:
    """Return a view on the arena or the ground that matters, on objects, and on robots wherever an episode
    may begin."""
    return view_around(extent(scenario), width, height)


def extent(scenario: Program) -> list[Bounds]:
    """Return boxes (m) around everything that an overview shows."""
    world = scenario.world
    starts = _Starts(scenario)
    robots = list(starts.robots())
    around = [*_surroundings(world), *(box for body in world.objects for box in starts.boxes(body))]
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
        shape = world.terrain.shape
        if isinstance(shape, Pit):
            yield (
                (-1.1 * shape.radius, -1.1 * shape.radius, 0.0),
                (1.1 * shape.radius, 1.1 * shape.radius, shape.height / 4),
            )
        else:
            yield terrain_bounds(shape)


def follows_robot(world: WorldModel) -> bool:
    """Return whether a view follows the first free robot: nothing else shows where it is."""
    return (
        world.arena is None
        and world.terrain is None
        and not world.lines
        and any(not robot.fixed_base for robot in world.robots)
    )


class _Starts:
    """The boxes of bodies, wherever they may be when an episode begins."""

    def __init__(self, scenario: Program) -> None:
        self._scenario, self._world = scenario, scenario.world
        layouts = [place for layout in scenario.reset.layouts for place in layout.placements]
        self._places = {place.body: place for place in (*layouts, *scenario.reset.placements)}
        self._parameters: Parameters = {
            (parameter.name, component): scalar
            for parameter in scenario.parameters
            for component, scalar in zip(
                parameter.typed.type.components or (None,), parameter.scalars, strict=True
            )
        }

    def robots(self) -> Iterator[Bounds]:
        """Yield the boxes of robots with room for legs and arms; of copies, those at the ends of their row."""
        copies = self._scenario.agent.copies
        shifts = [copy_offset(copies, number) for number in (1, copies.count)] if copies else [ZERO_VECTOR]
        for robot in self._world.robots:
            starts = [start for start in self._scenario.reset.joint_starts if start.robot == robot.name]
            states = [state for start in starts for state in start.states]
            joints = {joint: sum(self._range(position)) / 2 for joint, position, _ in states}
            low, high = robot_bounds(robot.model, joints)
            if robot.model.moving_joints and self._world.arena is None:
                room = _ROBOT_ROOM * max(b - a for a, b in zip(low, high, strict=True))
                low, high = add(low, (-room, -room, 0.0)), add(high, (room, room, room))
            place = self._places.get(robot.name)
            low, high = self._placed((low, high), robot.pose, place, moves=place is not None)
            yield from ((add(low, shift), add(high, shift)) for shift in shifts)

    def boxes(self, body: ObjectBody) -> Iterator[Bounds]:
        """Yield an object in each of its forms."""
        place = self._places.get(body.name) or self._places.get(body.name.partition("#")[0])
        for shape in (body.shape, *(variant.shape for variant in body.variants)):
            yield self._placed(bounds_of_shape(shape), body.pose, place)

    def _placed(self, box: Bounds, pose: Pose, place: Placement | None, *, moves: bool = False) -> Bounds:
        """Return the box around a body wherever it may be, however it is turned, or turns if it `moves`."""
        low, high = box
        turns = [(angle, angle) for angle in pose.rpy] if place is None else list(map(self._range, place.rpy))
        if moves or any(map(any, turns)) or (place is not None and place.heading):
            is_upright = max(abs(angle) for turn in turns[:2] for angle in turn) < _UPRIGHT
            axes = 2 if is_upright else 3
            reach = max(math.hypot(*corner[:axes]) for corner in _corners([box]))
            low = (-reach, -reach, low[2] if is_upright else -reach)
            high = (reach, reach, high[2] if is_upright else reach)
        if place is None:
            return add(low, pose.xyz), add(high, pose.xyz)
        ends = list(map(self._range, place.xyz))
        if isinstance(place.spot, Top):
            support = next(body for body in self._world.objects if body.name == place.spot.of)
            (x, y, _), (x_end, y_end, top) = next(self.boxes(support))
            ends = [(x, x_end), (y, y_end), (ends[2][0] + top, ends[2][1] + top)]
            low, high = (0.0, 0.0, low[2]), (0.0, 0.0, high[2])  # it stands within the top
        elif isinstance(place.spot, Region):
            ends[:2] = list(zip(place.spot.low, place.spot.high, strict=True))
        elif place.spot is not None:
            ends[:2] = [(min(along), max(along)) for along in zip(*place.spot.spots, strict=True)]
        if self._world.terrain is not None and not isinstance(self._world.terrain.shape, Pit):
            (_, _, ground), (_, _, hill) = terrain_bounds(self._world.terrain.shape)
            ends[2] = (ends[2][0] + ground, ends[2][1] + hill)
        if place.seeks_height:
            ends[2] = (ends[2][0] - low[2], ends[2][1] - low[2])
        (x, x_end), (y, y_end), (z, z_end) = ends
        box = add(low, (x, y, z)), add(high, (x_end, y_end, z_end))
        # Bodies that look for a place stay within the walls.
        walls = next(_surroundings(self._world)) if self._world.arena is not None else box
        return box if place.spot is None else _cut(box, (walls[0], (*walls[1][:2], box[1][2])))

    def _range(self, scalar: Scalar) -> tuple[float, float]:
        """Return roughly the least and the greatest value of a coordinate; 0 if nothing is known of it."""
        match scalar:
            case Const(value=value):
                return float(value), float(value)
            case Draw(distribution="normal", args=(mean, _)):
                return self._range(mean)
            case Draw(args=args):
                ends = [end for arg in args for end in self._range(arg)]
                return min(ends), max(ends)
            case Name(name, component) if (name, component) in self._parameters:
                return self._range(self._parameters[name, component])
            case Op():
                interval = interval_of(scalar, lambda argument: Interval(*self._range(argument)))
                return (interval.low, interval.high) if interval.is_finite else (0.0, 0.0)
            case _:
                return 0.0, 0.0


def _crop_to_robots(robots: Sequence[Bounds], boxes: Iterable[Bounds]) -> Iterator[Bounds]:
    """Yield the boxes, of which those that dwarf the robots are cut to the part around them: on a field of 20
    m, a robot is a dot."""
    side = max(high - low for box in robots for low, high in zip(*box, strict=True))
    low, high = box_around(robots)
    room = (_CROP_MARGIN * side,) * 3
    near = add(low, scaled(room, -1.0)), add(high, room)
    for start, end in boxes:
        is_large = max(b - a for a, b in zip(start, end, strict=True)) > _LARGE * side
        yield _cut((start, end), near) if is_large else (start, end)


def _cut(box: Bounds, limits: Bounds) -> Bounds:
    """Return the part of a box within limits, or the whole box if no part is."""
    x, y, z = map(max, box[0], limits[0])
    x_end, y_end, z_end = map(min, box[1], limits[1])
    return ((x, y, z), (x_end, y_end, z_end)) if x <= x_end and y <= y_end and z <= z_end else box


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
        self._boxes: list[Bounds] = []

    def restart(self) -> None:
        """Begin an episode: the robot is where it shall be seen."""
        self._origin = None

    def view(self, width: int, height: int) -> View:
        self._boxes = self._boxes or extent(self._scenario)  # a terrain takes time
        return moved_view(view_around(self._boxes, width, height), self._shift())

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
