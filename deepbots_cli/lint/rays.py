"""DB615: rays that pass over everything in the world."""

from __future__ import annotations

from collections.abc import Iterator
from math import hypot, inf, pi

from deepbots_cli import footprint, frames
from deepbots_cli.compiler.values import Values
from deepbots_cli.diagnostics import Finding, Label
from deepbots_cli.expressions.dimensions import LENGTH
from deepbots_cli.frames import Frame, quaternion
from deepbots_cli.lint.analysis import Analysis
from deepbots_cli.lint.context import Context
from deepbots_cli.lint.ranges import is_level, with_unit
from deepbots_cli.lint.simulation import ARENA, SINK, Clearance, Simulation, casts_rays
from deepbots_cli.program.robots import Thrust
from deepbots_cli.program.world import ObjectBody, RobotBody, WorldModel
from deepbots_cli.robots.meshes import extent
from deepbots_cli.robots.model import Joint, Mesh, RobotModel

_SAME = 1e-4
"""m; heights that differ by less are equal."""
_FOOT = 0.005
"""m; wheels and casters that end within so much of the lowest one carry the robot."""
_NEAR = 0.05
"""m; a robot that is placed so close to its resting height comes to rest there."""
_ATTITUDES = 12
"""Positions of all joints together that are tried."""
_ROOM = 1.2
_LOWEST, _HIGHEST = 0, 1


def rays_meet_nothing(context: Context) -> Iterator[Finding]:
    """DB615: the rays of a lidar, a sonar, an infrared or a laser sensor pass over everything in the world.

    Level rays above the walls never meet them: every reading is the far end of the range, and the policy learns nothing from it. The
    walls of an arena are 10 cm high by default. The rule compares the height of the rays with the top of all solid bodies. It needs a
    robot that stands level on flat ground or has a fixed base, and a sensor that no joint raises or tilts; rays that meet the ground
    within their range are not reported.

    Example::

        world: {arena: {size: 12 2 m}}
        robots: {cart: {sensors: {ahead: {type: sonar, link: body, pose: {z: 20 cm}, range: 0 .. 8 m}}, emit: [pole_angle, ahead]}}
        observation: {cart.ahead: auto}

    Instead::

        world: {arena: {size: 12 2 m, wall_height: 50 cm}}
        robots: {cart: {sensors: {ahead: {type: sonar, link: body, pose: {z: 20 cm}, range: 0 .. 8 m}}, emit: [pole_angle, ahead]}}
        observation: {cart.ahead: auto}
    """
    here, variants = Heights(context.analysis), [Heights(analysis) for analysis in context.versions[1:]]
    for robot in context.program.robots:
        for sensor in robot.sensors:
            clearance = here.clearance(robot.name, sensor.name) if casts_rays(sensor) else None
            if clearance is not None and all(variant.clearance(robot.name, sensor.name) for variant in variants):
                yield _passing_over(context.values, robot.name, sensor.name, clearance)


def measured_rays_meet_nothing(simulation: Simulation) -> Iterator[Finding]:
    """DB615: the same for robots whose height the text does not tell."""
    heights = Heights(simulation.analysis)
    for (robot, sensor), clearance in simulation.report.clearances.items() if simulation.is_complete else ():
        if heights.needs_simulation(robot, sensor):
            yield _passing_over(simulation.values, robot, sensor, clearance, notes=(simulation.summary,))


class Heights:
    """The heights of rays and of all solid bodies, as far as a scenario tells."""

    def __init__(self, analysis: Analysis) -> None:
        self._analysis = analysis
        self._program = analysis.program
        self._world = analysis.program.world

    def clearance(self, robot: str, sensor: str) -> Clearance | None:
        """Where the rays of a sensor pass, if that is over everything; None if they meet the ground or a body, or that is unknown."""
        gravity = self._world.gravity
        if self._world.ground is None or gravity[0] or gravity[1] or gravity[2] >= 0.0:
            return None
        lowest = self._lowest(robot, sensor)
        if lowest is None:
            return None
        tallest, highest = "", -inf
        for name, top in self._tops(robot):
            if top + SINK >= lowest:
                return None  # before the meshes of other robots are read
            if top > highest:
                tallest, highest = name, top
        return Clearance(lowest, highest, tallest) if tallest else None

    def needs_simulation(self, robot: str, sensor: str) -> bool:
        """Whether the text does not tell the height of the rays, and no robot flies or may lift an object above them later."""
        loose = any(thing.solid and not kind.fixed for thing in self._world.objects for kind in (thing.variants or (thing,)))
        return not (self._flies or (loose and _can_lift(self._world))) and self._lowest(robot, sensor) is None

    @property
    def _flies(self) -> bool:
        return any(isinstance(command.actuator, Thrust) for robot in self._program.robots for command in robot.commands)

    def _lowest(self, robot: str, name: str) -> float | None:
        """The lowest point of any ray within its range, m above the ground; None where it is unknown or a ray meets the ground."""
        sensors = next((each.sensors for each in self._program.robots if each.name == robot), ())
        sensor = next((sensor for sensor in sensors if sensor.name == name), None)
        body = self._analysis.body(robot)
        root = self._root(body)
        if root is None or sensor is None or sensor.beams is None:
            return None
        mount = frames.frame(sensor.mount)
        rays = [frames.inside(mount, frames.frame(ray)) for ray in sensor.beams.rays]
        tried: list[list[tuple[float, float]]] = []
        """The height at which each ray begins, and its rise per m, in each attitude."""
        for positions in _attitudes(body.model):
            link = frames.inside(root, footprint.link_frames(body.model, positions)[sensor.subjects[0]])
            placed = [frames.inside(link, ray) for ray in rays]
            tried.append([(place[2], frames.rotate(turn, (1.0, 0.0, 0.0))[2]) for place, turn in placed])
        for other in tried[1:]:
            for (height, slope), (known, known_slope) in zip(other, tried[0], strict=True):
                if abs(height - known) > _SAME or abs(slope - known_slope) > _SAME:
                    return None
        lowest = min(height + min(0.0, slope * sensor.beams.reach) for height, slope in tried[0])
        return lowest if lowest > 0.0 else None

    def _root(self, body: RobotBody) -> Frame | None:
        """The frame of a robot's root, without yaw: of a fixed base, or of a robot that stands level on the ground."""
        if self._flies:
            return None
        height = None if body.fixed_base else _standing_height(body.model)
        found: set[Frame] = set()
        for place, pose in self._analysis.start.poses(body.name):
            known = [pose[key] for key in ("z", "roll", "pitch")]
            if body.fixed_base and all(interval.single for interval in known):
                found.add(((0.0, 0.0, pose["z"].low), quaternion(pose["roll"].low, pose["pitch"].low, 0.0)))
            elif height is not None and is_level(pose) and (place.rests or all(abs(end - height) < _NEAR for end in pose["z"])):
                found.add(((0.0, 0.0, height), frames.UPRIGHT))
            else:
                return None
        return found.pop() if len(found) == 1 else None

    def _tops(self, robot: str) -> Iterator[tuple[str, float]]:
        """The name and the top of everything solid except the robot, m; infinite where it is unknown."""
        if self._world.arena is not None:
            yield ARENA, self._world.arena.wall_height
        may_be_lifted = _can_lift(self._world)
        for thing in self._world.objects:
            if thing.solid:
                yield thing.name, self._top(thing, may_be_lifted=may_be_lifted)
        for other in self._world.robots:
            if other.name != robot or self._program.policy.copies is not None:
                yield other.name, self._top_of_robot(other)

    def _top(self, thing: ObjectBody, *, may_be_lifted: bool) -> float:
        """The top of an object; of a movable one with its longest side upright."""
        kinds = [(kind.shape, kind.fixed) for kind in thing.variants] or [(thing.shape, thing.fixed)]
        if any((isinstance(shape, Mesh) and extent(shape) is None) or (may_be_lifted and not fixed) for shape, fixed in kinds):
            return inf
        poses = list(self._analysis.start.poses(thing.name))
        top = -inf
        for shape, fixed in kinds:
            box = footprint.bounds_of_shape(shape)
            size, high = footprint.sides(box), box[1][2]
            top = max(top, -inf if fixed else max(size))
            if not poses:  # a wall
                top = max(top, size[2], thing.pose.xyz[2] + high)
            for place, pose in poses:
                if place.velocity is not None or place.angular_velocity is not None or (fixed and not is_level(pose)):
                    return inf  # it may fly, or robots may drive up on it
                half = high if is_level(pose) else hypot(*size)
                top = max(top, (size[2] if is_level(pose) else half) if place.rests else pose["z"].high + half)
        return top

    def _top_of_robot(self, body: RobotBody) -> float:
        root = self._root(body)
        if root is None or root[1] != frames.UPRIGHT or not _keeps(body.model, _HIGHEST):
            return inf
        return root[0][2] + footprint.bounds(body.model)[1][2]


def _attitudes(model: RobotModel) -> Iterator[dict[str, float]]:
    """All joints at 0, then at positions that differ from joint to joint, spread evenly over their ranges (golden ratio)."""
    yield {}
    for number in range(1, _ATTITUDES):
        yield {joint.name: _position(joint, (number * (0.618034 + 0.1 * index)) % 1.0) for index, joint in enumerate(model.moving_joints)}


def _position(joint: Joint, share: float) -> float:
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


def _standing_height(model: RobotModel) -> float | None:
    """The height (m) of the root's origin on level ground; None for a robot that joints raise, or that has to balance."""
    feet, centre = footprint.feet(model, _FOOT), _centre_of_mass(model)
    stands = feet and all(min(foot[axis] for foot in feet) < centre[axis] < max(foot[axis] for foot in feet) for axis in (0, 1))
    return footprint.resting(model) if stands and _keeps(model, _LOWEST) else None


def _centre_of_mass(model: RobotModel) -> tuple[float, float]:
    """(x, y) in the frame of the root, m, with all joints at 0."""
    where = footprint.link_frames(model)
    inertials = [(link.name, link.inertial) for link in model.links if link.inertial]
    known = [(inertial.mass, frames.inside(where[name], frames.frame(inertial.origin))[0]) for name, inertial in inertials]
    mass = sum(weight for weight, _ in known)
    if mass <= 0.0:
        return 0.0, 0.0
    return sum(weight * at[0] for weight, at in known) / mass, sum(weight * at[1] for weight, at in known) / mass


def _passing_over(values: Values, robot: str, sensor: str, clearance: Clearance, notes: tuple[str, ...] = ()) -> Finding:
    base = clearance.tallest.partition("#")[0]
    height, top, lower = (with_unit(length, LENGTH) for length in (clearance.lowest, clearance.top, clearance.lowest - clearance.top))
    help = f"lower the `pose` of the sensor by more than {lower}"
    if clearance.tallest == ARENA:
        named, place = "the walls of the arena", ("world", "arena", "wall_height")
        span = values.span(place) if values.stands(place) else values.key_span(place[:2])
        help = f"write `wall_height: {with_unit(float(f'{_ROOM * clearance.lowest:.2g}'), LENGTH)}` for the arena, or {help}"
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
MEASURED = (measured_rays_meet_nothing,)
