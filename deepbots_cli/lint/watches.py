"""Watches of simulated episodes: speeds, wheels, tilts, arms and rays."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from math import acos, atan2, dist, hypot, inf, radians, remainder, tau
from typing import NamedTuple

from deepbots_cli import frames
from deepbots_cli.frames import Triple
from deepbots_cli.lint.simulation import (
    ARENA,
    MAX_SINK,
    TOPPLING_S,
    Clearance,
    FastestBody,
    Rolling,
    Stop,
    UnreachedPose,
    casts_rays,
    driven_wheels,
)
from deepbots_cli.port import Engine, JointReader, MotionReader, PoseReader, cast_rays
from deepbots_cli.program import Program, generated
from deepbots_cli.program.robots import Cartesian as CartesianActuator
from deepbots_cli.program.robots import Sensor
from deepbots_cli.program.world import ObjectBody
from deepbots_cli.robots import kinematics
from deepbots_cli.robots.meshes import Bounds
from deepbots_cli.robots.model import RobotModel
from deepbots_cli.runtime import Supervisor
from deepbots_cli.runtime.actuation import Cartesian

# Speeds

_MAX_SPEED = 300.0
"""The largest plausible speed, in m/s; near the speed of sound. A falling body may become faster."""
_HALF_TURN = math.pi
"""Half a turn, in rad in one physics step; beyond it, an engine cannot determine the direction of a turn."""
_MAX_SPIN = 1000.0
"""The rotation, in rad/s, below which turns are plausible, however long the physics step."""
_MIN_SPEED_GROWTH = 4.0


class _WatchedBody(NamedTuple):
    body: str
    motion: MotionReader
    joints: tuple[str, ...]
    revolute: tuple[bool, ...]
    states: JointReader | None


class SpeedWatch:
    """Checks the speeds of robots and of movable objects. `new_maximum` is the fastest body, when its speed
    has grown a lot."""

    def __init__(self, environment: Supervisor) -> None:
        world, engine = environment.world, environment.engine
        self._substep = world.timestep / world.substeps
        self._fall = math.hypot(*engine.gravity)
        self._watched = []
        for robot in world.robots:
            moving = robot.model.moving_joints
            names = tuple(joint.name for joint in moving)
            reader = engine.joint_states(robot.name, names) if names else None
            turns = tuple(joint.type != "prismatic" for joint in moving)
            self._watched.append(_WatchedBody(robot.name, engine.motion(robot.name), names, turns, reader))
        self._watched += [
            _WatchedBody(body.name, engine.motion(body.name), (), (), None)
            for body in world.objects
            if not body.fixed
        ]
        self._fastest = 1.0
        self.new_maximum: FastestBody | None = None

    def check(self, time: float) -> Stop | None:
        """The first implausible speed after `time` seconds; None if there is none."""
        self.new_maximum = None
        for watched in self._watched:
            velocity, spin = (math.hypot(*part) for part in watched.motion()[1])
            if not math.isfinite(velocity + spin):
                return Stop("speed", body=watched.body, motion="nan")
            if velocity > self._fastest * _MIN_SPEED_GROWTH:
                self._fastest = velocity
                self.new_maximum = FastestBody(watched.body, velocity)
            if velocity > _MAX_SPEED + self._fall * time:
                return Stop("speed", body=watched.body, motion="velocity", value=velocity)
            if spin > _MAX_SPIN and spin * self._substep > _HALF_TURN:
                return Stop("speed", body=watched.body, motion="spin", value=spin)
            speed = self._joint(watched)
            if speed:
                return speed
        return None

    def _joint(self, watched: _WatchedBody) -> Stop | None:
        states: Sequence[Sequence[float]] = watched.states() if watched.states else ()
        for name, turns, state in zip(watched.joints, watched.revolute, states, strict=True):
            speed = abs(state[1])
            if not math.isfinite(state[0] + speed):
                return Stop("speed", body=watched.body, joint=name, motion="nan")
            if speed > (max(_MAX_SPIN, _HALF_TURN / self._substep) if turns else _MAX_SPEED):
                return Stop("speed", body=watched.body, joint=name, motion="joint", value=speed)
        return None

    def lost(self) -> list[str]:
        """Return the bodies whose motion is no longer a number."""
        return [
            watched.body
            for watched in self._watched
            if not math.isfinite(sum(map(sum, (*watched.motion()[0], *watched.motion()[1]))))
        ]


# Wheels


class WheelWatch:
    """Measures the motion of robots on driven wheels. `robots` maps each to its largest motion so far; it is
    empty for teams."""

    def __init__(self, scenario: Program) -> None:
        models = {
            body.name: body.model
            for body in scenario.world.robots
            if not body.fixed_base and scenario.agent.copies is None
        }
        self._wheels = {
            robot.name: driven_wheels(robot, models[robot.name])
            for robot in scenario.robots
            if robot.name in models
        }
        self.robots = {name: Rolling(0.0, 0.0, 0.0) for name, wheels in self._wheels.items() if wheels}

    def watch(self, engine: Engine) -> Callable[[], None]:
        """Return a function that compares with the present state of an engine, to be called in each step."""
        checks = [self._watched(engine, robot) for robot in self.robots]

        def check() -> None:
            for compare in checks:
                compare()

        return check

    def _watched(self, engine: Engine, robot: str) -> Callable[[], None]:
        pose = engine.pose(robot)
        states = engine.joint_states(robot, self._wheels[robot])
        (x, y, _), attitude = pose()
        heading = frames.roll_pitch_yaw(attitude)[2]
        positions = [state[0] for state in states()]

        def check() -> None:
            position, attitude = pose()
            # `remainder` gives the difference of two angles from -pi to pi.
            turn = abs(remainder(frames.roll_pitch_yaw(attitude)[2] - heading, tau))
            wheel = max(abs(state[0] - before) for state, before in zip(states(), positions, strict=True))
            rolling = self.robots[robot]
            self.robots[robot] = Rolling(
                max(rolling.distance, hypot(position[0] - x, position[1] - y)),
                max(rolling.turn, turn),
                max(rolling.wheel, wheel),
            )

        return check


class TiltWatch:
    """Measures how far robots with a free base tilt while no action moves them. Teams are not watched.

    `tilts` maps each to the time (s) for which it was watched, and to how far it tilted (rad) from its
    attitude at the reset. Both are taken from the episode with the smallest tilt, among the longest ones: an
    episode counts for `TOPPLING_S` at most.
    """

    def __init__(self, scenario: Program) -> None:
        is_free = {body.name: not body.fixed_base for body in scenario.world.robots}
        robots = [robot for robot in scenario.robots if is_free[robot.name] and scenario.agent.copies is None]
        self._robots = {robot.name: bool(robot.variables or robot.receive) for robot in robots}
        """Whether the action moves each robot."""
        self.tilts: dict[str, tuple[float, float]] = {}
        self._watched: dict[str, tuple[PoseReader, Triple]] = {}
        """The pose of each robot, and the direction of up in its frame at the reset."""
        self._time = 0.0
        self._now: dict[str, float] = {}

    def begin(self, engine: Engine, *, is_idle: bool) -> None:
        """Watch an episode from its present state on."""
        poses = {
            name: engine.pose(name) for name, is_moved in self._robots.items() if is_idle or not is_moved
        }
        self._watched = {
            name: (pose, frames.rotate_back(pose()[1], (0.0, 0.0, 1.0))) for name, pose in poses.items()
        }
        self._now = dict.fromkeys(poses, 0.0)

    def check(self, time: float) -> None:
        """Compare with the state after a step, which ended so long (s) after the reset."""
        if time > TOPPLING_S:
            return
        self._time = time
        for name, (pose, upward) in self._watched.items():
            # Rounding may take the cosine beyond 1, where `acos` raises ValueError.
            tilt = acos(max(-1.0, min(1.0, frames.rotate(pose()[1], upward)[2])))
            self._now[name] = max(self._now[name], tilt)

    def close(self) -> None:
        """End the episode."""
        for name, tilt in self._now.items():
            longest, smallest = self.tilts.get(name, (0.0, inf))
            if self._time == longest:
                tilt = min(tilt, smallest)
            if self._time >= longest:
                self.tilts[name] = self._time, tilt
        self._watched = {}
        self._now = {}
        self._time = 0.0


# Arms

_DISTANCE_TOLERANCE_M = 0.005  # a search that succeeds ends within 0.1 um
_ANGLE_TOLERANCE = radians(1.0)
"""The tolerance of the angle of a pose, in rad."""
_LARGE_TURN = radians(90.0)
_MAX_TURNING_DISTANCE_M = 0.2
"""The distance (m) beyond which the start of an arm, such as stretched out, makes it turn on its way."""
_LIMIT_TOLERANCE = 1e-6  # rad or m; the search clips positions to the limits exactly


class ArmWatch:
    """Watches the commands to the `cartesian` actuators of an environment."""

    def __init__(self, environment: Supervisor) -> None:
        self.is_watching = False
        self.commands: dict[tuple[str, str], int] = {}
        """The number of commands since the last `take_misses`, by robot and actuator."""
        self._misses: dict[tuple[str, str], UnreachedPose] = {}
        self.actuators = [arm for world in environment.agents.values() for arm in self._watched(world)]

    def _watched(self, world: Supervisor) -> Iterator[str]:
        """Watch the commands of a supervisor; yields the names of the actuators."""
        models = {body.name: body.model for body in world.scenario.world.robots}
        for robot in world.scenario.robots:
            for actuator in robot.actuators:
                drive = getattr(world.controllers[robot.name], generated.drive(actuator.name), None)
                if isinstance(actuator, CartesianActuator) and isinstance(drive, Cartesian):
                    drive.watch = partial(self._check, world, robot.name, models[robot.name], actuator, drive)
                    yield actuator.name

    def take_misses(self, policy: str, seed: int) -> list[UnreachedPose]:
        """Return the first miss of each actuator since the last call; later misses start from where it
        brought the arm."""
        misses = [
            replace(miss, policy=policy, seed=seed, commands=self.commands[key])
            for key, miss in self._misses.items()
        ]
        self.commands.clear()
        self._misses.clear()
        return misses

    def _check(
        self,
        world: Supervisor,
        robot: str,
        model: RobotModel,
        actuator: CartesianActuator,
        drive: Cartesian,
        target: Triple,
        solution: Sequence[float],
    ) -> None:
        if not self.is_watching:
            return
        key = (robot, actuator.name)
        self.commands[key] = self.commands.get(key, 0) + 1
        positions = dict(zip(actuator.joints, solution, strict=True))
        undriven = [
            joint.name
            for joint in model.moving_joints
            if joint.name not in positions and joint.name not in model.followers
        ]
        now = (
            {
                name: state[0]
                for name, state in zip(undriven, world.engine.joint_states(robot, undriven)(), strict=True)
            }
            if undriven
            else {}
        )
        position, rotation = frames.compose(
            world.engine.pose(robot)(), kinematics.link_frames(model, now | positions)[actuator.link]
        )
        distance = dist(position, target)
        angle = (
            0.0
            if drive.attitude is None
            else _angle(frames.multiply(drive.attitude, frames.inverse(rotation)))
        )
        if distance <= _DISTANCE_TOLERANCE_M and angle <= _ANGLE_TOLERANCE:
            self._check_turn(world, key, actuator, drive, target)
            return
        if key not in self._misses:
            at_limit = {
                name: end
                for name, joint_position in positions.items()
                for end in (model.joint(name).limit.lower, model.joint(name).limit.upper)
                if end is not None and abs(joint_position - end) < _LIMIT_TOLERANCE
            }
            self._misses[key] = UnreachedPose(
                robot, actuator.name, distance, angle, at_limit, step=world.step_count
            )
        self._misses[key] = replace(
            self._misses[key], unreached_commands=self._misses[key].unreached_commands + 1
        )

    def _check_turn(
        self,
        world: Supervisor,
        key: tuple[str, str],
        actuator: CartesianActuator,
        drive: Cartesian,
        target: Triple,
    ) -> None:
        """Check whether the first command of an episode turns a link in place."""
        if drive.attitude is None or self.commands[key] > 1 or key in self._misses:
            return
        position, attitude = world.engine.pose(key[0], actuator.link)()
        turn = _angle(frames.multiply(drive.attitude, frames.inverse(attitude)))
        if turn > _LARGE_TURN and dist(position, target) < _MAX_TURNING_DISTANCE_M:
            start = frames.roll_pitch_yaw(attitude)
            self._misses[key] = UnreachedPose(
                *key, 0.0, 0.0, {}, turn=turn, start=start, step=world.step_count
            )


def _angle(q: frames.Quaternion) -> float:
    """Return the angle of a rotation, rad from 0 to half a turn."""
    # q and -q are the same rotation. `acos` of the last component loses digits for small angles.
    return 2.0 * atan2(hypot(q[0], q[1], q[2]), abs(q[3]))


# Rays


class RayWatch:
    """Finds sensors whose rays have met nothing so far, because they pass above all solid bodies or begin
    below the ground.

    `clearances` maps robot and sensor to where their rays pass, `depths` to the smallest depth (m) at which
    they began; both are empty for teams and above terrain.
    """

    def __init__(self, scenario: Program) -> None:
        self._world = scenario.world
        is_asked = scenario.world.terrain is None and scenario.agent.copies is None
        entries = [
            (robot.name, sensor)
            for robot in scenario.robots
            for sensor in robot.sensors
            if is_asked and casts_rays(sensor)
        ]
        self._sensors = {(robot, sensor.name): sensor for robot, sensor in entries}
        self.clearances: dict[tuple[str, str], Clearance] = dict.fromkeys(
            self._sensors, Clearance(inf, -inf, "")
        )
        self.depths: dict[tuple[str, str], float] = dict.fromkeys(
            self._sensors if scenario.world.ground is not None else (), inf
        )

    def watch(self, environment: Supervisor) -> Callable[[], None]:
        """Return a function that checks an environment, to be called in each step. The world of a case that
        differs may lack bodies, and is not checked."""
        if environment.world != self._world or not (self.clearances or self.depths):
            return lambda: None
        engine = environment.engine
        tops = {body.name: _top_of(engine, body) for body in self._world.objects if body.solid}
        tops |= {
            body.name: _top_of_robot(engine, body.name, kinematics.robot_bounds(body.model))
            for body in self._world.robots
        }
        if self._world.arena is not None:
            wall = self._world.arena.wall_height
            tops[ARENA] = lambda: wall
        heights = {
            key: _ray_heights(engine, key[0], self._sensors[key])
            for key in self.clearances.keys() | self.depths.keys()
        }

        def check() -> None:
            top_heights = [(top(), name) for name, top in tops.items()] if self.clearances else []
            for key in [key for key in self._sensors if key in self.clearances or key in self.depths]:
                highest = max((top for top in top_heights if top[1] != key[0]), default=(inf, ""))
                low, begin = heights[key]()
                if key in self.clearances and low > highest[0] + MAX_SINK:
                    before = self.clearances[key]
                    self.clearances[key] = Clearance(
                        min(low, before.lowest), *max(highest, (before.top, before.tallest))
                    )
                else:
                    self.clearances.pop(key, None)
                if key in self.depths and begin < -MAX_SINK:
                    self.depths[key] = min(self.depths[key], -begin)
                else:
                    self.depths.pop(key, None)

        return check


def _top_of(engine: Engine, body: ObjectBody) -> Callable[[], float]:
    """Return a reader of the height of the top, m; of an object that moves, with its longest side upright."""
    shapes = [variant.shape for variant in body.variants] or [body.shape]
    longest = (
        0.0
        if body.fixed
        else max(max(kinematics.box_sides(kinematics.bounds_of_shape(shape))) for shape in shapes)
    )
    pose = engine.pose(body.name)
    return lambda: max(longest, *(kinematics.bounds_of_shape(shape, pose())[1][2] for shape in shapes))


def _top_of_robot(engine: Engine, name: str, box: Bounds) -> Callable[[], float]:
    """Return a reader of an upper bound of the height in any attitude of the root, m."""
    pose = engine.pose(name)
    reach = hypot(*(max(-low, high) for low, high in zip(*box, strict=True)))
    return lambda: pose()[0][2] + reach


def _ray_heights(engine: Engine, robot: str, sensor: Sensor) -> Callable[[], tuple[float, float]]:
    """Return a reader of the lowest point of any ray within its range, and the highest at which one begins,
    in m; (-inf, inf) while a ray meets something."""
    assert sensor.beams is not None  # only sensors that cast rays get here
    mount = frames.frame(sensor.mount)
    reach = sensor.beams.reach
    part = (robot, sensor.subjects[0])
    rays = [frames.compose(mount, frames.frame(ray)) for ray in sensor.beams.rays]
    begins = [ray[0] for ray in rays]
    ends = [*begins, *(frames.compose(ray, ((reach, 0.0, 0.0), frames.IDENTITY_ROTATION))[0] for ray in rays)]
    upright = sensor.beams.upright
    pose = engine.pose(*part)
    cast = cast_rays(engine, part, rays, reach, upright=upright)

    def measured() -> tuple[float, float]:
        (_, _, height), turn = pose()
        turn = frames.yaw_only(turn) if upright else turn
        if min(cast()) < reach:
            return -inf, inf
        return height + min(frames.rotate(turn, end)[2] for end in ends), height + max(
            frames.rotate(turn, begin)[2] for begin in begins
        )

    return measured
