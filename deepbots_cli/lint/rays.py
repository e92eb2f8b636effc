"""DB615: rays that pass over everything in the world."""

from __future__ import annotations

from collections.abc import Iterator
from math import hypot, inf, pi
from typing import NamedTuple

from deepbots_cli import footprint, frames
from deepbots_cli.compiler import Checked
from deepbots_cli.compiler.values import Values
from deepbots_cli.diagnostics import Finding, Label
from deepbots_cli.expressions.dimensions import LENGTH
from deepbots_cli.frames import Frame, quaternion
from deepbots_cli.lint.meaning import book_of
from deepbots_cli.lint.start import AtStart, is_level
from deepbots_cli.lint.wording import figure
from deepbots_cli.program import Program
from deepbots_cli.program.robots import Sensor, Thrust
from deepbots_cli.program.world import ObjectBody, RobotBody, WorldModel
from deepbots_cli.robots.meshes import extent
from deepbots_cli.robots.model import Joint, Mesh, RobotModel

CLEAR = 0.001
"""m; engines let bodies sink in by less, and round what rays meet."""
_SAME = 1e-4
"""m; two heights that differ by less are one."""
_FOOT = 0.005
"""m; wheels and casters that end within so much of the lowest carry the robot."""
_NEAR = 0.05
"""m; a robot that is placed so close to the height at which it rests comes to rest there."""
_ATTITUDES = 12
"""Positions of all joints together that are tried."""
_ROOM = 1.2
_LOWEST, _HIGHEST = 0, 1
ARENA = "arena walls"
"""With a blank, which no name of an object has."""


class Aim(NamedTuple):
    """Where the rays of a sensor pass: the lowest point of any within its range, and the top and the name of the tallest body, m."""

    lowest: float
    top: float
    tallest: str


def rays_meet_nothing(checked: Checked) -> Iterator[Finding]:
    """DB615: the rays of a lidar, a sonar, an infrared or a laser sensor pass over everything in the world.

    Rays that look level from above the walls never meet them: every reading stays at the far end of the range, and the policy
    learns nothing from it. The walls of an arena are 10 cm high unless you say otherwise. The rule compares the height of the rays
    with the top of all that is solid. It needs a robot that stands level on flat ground, or has a fixed base, and a sensor that no
    joint raises or tilts; rays that meet the ground within their range are not meant.

    Example::

        world: {arena: {size: 12 2 m}}
        robots: {cart: {sensors: {ahead: {type: sonar, link: body, pose: {z: 20 cm}, range: 0 .. 8 m}}, emit: [pole_angle, ahead]}}
        observation: {cart.ahead: auto}

    Instead::

        world: {arena: {size: 12 2 m, wall_height: 50 cm}}
        robots: {cart: {sensors: {ahead: {type: sonar, link: body, pose: {z: 20 cm}, range: 0 .. 8 m}}, emit: [pole_angle, ahead]}}
        observation: {cart.ahead: auto}
    """
    program = checked.program
    if program is None or checked.namespace is None:
        return
    variants = (*(case.program for case in program.cases), *(stage.program for stage in program.curriculum))
    here = Heights(program)
    for robot in program.robots:
        for sensor in robot.sensors:
            aim = here.over_all(robot.name, sensor.name) if casts_rays(sensor) else None
            if aim is not None and all(Heights(variant).over_all(robot.name, sensor.name) for variant in variants):
                yield over_all(checked.namespace.values, robot.name, sensor.name, aim)


def casts_rays(sensor: Sensor) -> bool:
    return sensor.beams is not None and sensor.beams.reach > 0.0


class Heights:
    """How high sensors and all that is solid are, as far as a task tells."""

    def __init__(self, program: Program) -> None:
        self._task = program
        self._start = AtStart(book_of(program))

    def over_all(self, robot: str, sensor: str) -> Aim | None:
        """Where the rays of a sensor pass, if that is over everything; None if they meet the ground or a body, or it is not known."""
        world = self._task.world
        gravity = world.gravity
        if world.ground is None or gravity[0] or gravity[1] or gravity[2] >= 0.0:
            return None
        lowest = self._lowest(robot, sensor)
        if lowest is None:
            return None
        tallest, highest = "", -inf
        for name, top in self._tops(robot):
            if top + CLEAR >= lowest:
                return None  # before meshes of other robots are read
            if top > highest:
                tallest, highest = name, top
        return Aim(lowest, highest, tallest) if tallest else None

    def is_left_to_simulation(self, robot: str, sensor: str) -> bool:
        """Whether the text does not tell how high the rays are, and nobody flies or may lift an object above them later."""
        loose = any(thing.solid and not kind.fixed for thing in self._task.world.objects for kind in (thing.variants or (thing,)))
        return not (self._flies or (loose and _can_lift(self._task.world))) and self._lowest(robot, sensor) is None

    @property
    def _flies(self) -> bool:
        return any(isinstance(command.actuator, Thrust) for each in self._task.robots for command in each.commands)

    def _lowest(self, robot: str, name: str) -> float | None:
        """The lowest point of any ray within its range, m above the ground; None where it is not known or a ray meets the ground."""
        body = next((body for body in self._task.world.robots if body.name == robot), None)
        sensor = next((found for each in self._task.robots if each.name == robot for found in each.sensors if found.name == name), None)
        root = self._root(body) if body is not None else None
        if body is None or root is None or sensor is None or sensor.beams is None:
            return None
        mount = frames.frame(sensor.mount)
        rays = [frames.inside(mount, frames.frame(ray)) for ray in sensor.beams.rays]
        tried = [
            [_looks(frames.inside(frames.inside(root, link), ray)) for ray in rays]
            for positions in _attitudes(body.model)
            for link in (footprint.link_frames(body.model, positions)[sensor.subjects[0]],)
        ]
        for other in tried[1:]:
            for (height, slope), (known, known_slope) in zip(other, tried[0], strict=True):
                if abs(height - known) > _SAME or abs(slope - known_slope) > _SAME:
                    return None
        lowest = min(height + min(0.0, slope * sensor.beams.reach) for height, slope in tried[0])
        return lowest if lowest > 0.0 else None

    def _root(self, body: RobotBody) -> Frame | None:
        """The frame of a robot's root, turned by no yaw: of one with a fixed base, or of one that stands level on the ground."""
        if self._flies:
            return None
        height = None if body.fixed_base else _stands_at(body.model)
        found: set[Frame] = set()
        for place, pose in self._start.poses(body.name):
            known = [pose[key] for key in ("z", "roll", "pitch")]
            if body.fixed_base and all(interval.single for interval in known):
                found.add(((0.0, 0.0, pose["z"].low), quaternion(pose["roll"].low, pose["pitch"].low, 0.0)))
            elif height is not None and is_level(pose) and (place.rests or all(abs(end - height) < _NEAR for end in pose["z"])):
                found.add(((0.0, 0.0, height), frames.UPRIGHT))
            else:
                return None
        return found.pop() if len(found) == 1 else None

    def _tops(self, robot: str) -> Iterator[tuple[str, float]]:
        """The name and the top of everything solid but the robot, m; infinite where it is not known."""
        world = self._task.world
        if world.arena is not None:
            yield ARENA, world.arena.wall_height
        may_be_lifted = _can_lift(world)
        for thing in world.objects:
            if thing.solid:
                yield thing.name, self._top(thing, may_be_lifted=may_be_lifted)
        for other in world.robots:
            if other.name != robot or self._task.agent.each is not None:
                yield other.name, self._top_of_robot(other)

    def _top(self, thing: ObjectBody, *, may_be_lifted: bool) -> float:
        """Of an object that moves, with its longest side upright."""
        kinds = [(kind.shape, kind.fixed) for kind in thing.variants] or [(thing.shape, thing.fixed)]
        if any((isinstance(shape, Mesh) and extent(shape) is None) or (may_be_lifted and not fixed) for shape, fixed in kinds):
            return inf
        top = -inf
        for shape, fixed in kinds:
            size = footprint.sides(footprint.bounds_of_shape(shape))
            top = max(top, -inf if fixed else max(size))
            high = footprint.bounds_of_shape(shape)[1][2]
            poses = list(self._start.poses(thing.name))
            if not poses:  # a wall
                top = max(top, size[2], thing.pose.xyz[2] + high)
            for place, pose in poses:
                if place.velocity is not None or place.angular_velocity is not None or (fixed and not is_level(pose)):
                    return inf  # it may fly, or robots may drive up on it
                reach = high if is_level(pose) else hypot(*size)
                top = max(top, (size[2] if is_level(pose) else reach) if place.rests else pose["z"].high + reach)
        return top

    def _top_of_robot(self, body: RobotBody) -> float:
        root = self._root(body)
        if root is None or root[1] != frames.UPRIGHT or not _keeps(body.model, _HIGHEST):
            return inf
        return root[0][2] + footprint.bounds(body.model)[1][2]


def _looks(ray: Frame) -> tuple[float, float]:
    """The height at which a ray begins, and by how much it rises per m."""
    return ray[0][2], frames.rotate(ray[1], (1.0, 0.0, 0.0))[2]


def _attitudes(model: RobotModel) -> Iterator[dict[str, float]]:
    """All joints at 0, then at positions that differ from joint to joint, spread evenly over their ranges (golden ratio)."""
    yield {}
    for number in range(1, _ATTITUDES):
        yield {joint.name: _at(joint, (number * (0.618034 + 0.1 * index)) % 1.0) for index, joint in enumerate(model.moving_joints)}


def _at(joint: Joint, share: float) -> float:
    low = -pi if joint.limit.lower is None or joint.type == "continuous" else joint.limit.lower
    high = pi if joint.limit.upper is None or joint.type == "continuous" else joint.limit.upper
    return low + share * (high - low)


def _keeps(model: RobotModel, end: int) -> bool:
    """Whether no joint moves the lowest (0) or the highest (1) point of a robot: wheels do not, legs move both, arms the highest.

    Meshes do not count.
    """
    plain = footprint.without_meshes(model)
    known, *others = [footprint.bounds(plain, positions)[end][2] for positions in _attitudes(model)]
    return all(abs(other - known) <= _SAME for other in others)


def _can_lift(world: WorldModel) -> bool:
    return not all(_keeps(robot.model, _HIGHEST) for robot in world.robots)


def _stands_at(model: RobotModel) -> float | None:
    """The height (m) of the root's origin of a robot on level ground; None for one that joints raise, or that has to balance."""
    feet, centre = footprint.feet(model, _FOOT), _centre_of_mass(model)
    stands = feet and all(min(foot[axis] for foot in feet) < centre[axis] < max(foot[axis] for foot in feet) for axis in (0, 1))
    return footprint.resting(model) if stands and _keeps(model, _LOWEST) else None


def _centre_of_mass(model: RobotModel) -> tuple[float, float]:
    """With all joints at 0, in the frame of the root."""
    where = footprint.link_frames(model)
    known = [
        (link.inertial.mass, frames.inside(where[link.name], frames.frame(link.inertial.origin))[0])
        for link in model.links
        if link.inertial
    ]
    mass = sum(weight for weight, _ in known)
    if mass <= 0.0:
        return 0.0, 0.0
    return sum(weight * at[0] for weight, at in known) / mass, sum(weight * at[1] for weight, at in known) / mass


def over_all(values: Values, robot: str, sensor: str, aim: Aim, notes: tuple[str, ...] = ()) -> Finding:
    """The finding, at the sensor."""
    base = aim.tallest.partition("#")[0]
    height, top, lower = (figure(length, LENGTH) for length in (aim.lowest, aim.top, aim.lowest - aim.top))
    help = f"lower the `pose` of the sensor by more than {lower}"
    if aim.tallest == ARENA:
        named, place = "the walls of the arena", ("world", "arena", "wall_height")
        span = values.span(place) if values.stands(place) else values.key_span(place[:2])
        help = f"write `wall_height: {figure(float(f'{_ROOM * aim.lowest:.2g}'), LENGTH)}` for the arena, or {help}"
    else:
        wall = base.rpartition(" ")[0]  # `stub 1` is a piece of the wall `stub`
        places = ("objects", base), ("robots", base), ("world", "walls", wall), ("reset", "layouts", wall)
        named, span = f"`{wall or base}`", values.key_span(next((place for place in places if values.stands(place)), ("world",)))
    also = (Label(span, f"{top} high"),)
    headline = (
        f"the rays of `{sensor}` meet nothing: they stay {height} above the ground or higher, and the tallest thing, {named}, ends at {top}"
    )
    return Finding("DB615", values.key_span(("robots", robot, "sensors", sensor)), headline, help=help, notes=notes, also=also)


RULES = (rays_meet_nothing,)
