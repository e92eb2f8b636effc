"""Laws of frames: the laws of mechanics know no place, no direction of the compass, and no left and right.

A world is turned about z, shifted, and mirrored as a compiled program: each pose, axis and tensor of it by
the matrices of a `Change`. `SENSED` and `COMPUTED` say how the readings of each kind change with it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from deepbots_cli import frames
from deepbots_cli.expressions.scalar import Name, Op, Scalar, children
from deepbots_cli.program import Program
from deepbots_cli.program.resets import OfWalls
from deepbots_cli.program.robots import Robot, Thrust
from deepbots_cli.program.world import (
    ARENA_WALLS,
    Arena,
    Formula,
    Ground,
    Line,
    Pit,
    RobotBody,
    Terrain,
    WorldModel,
)
from deepbots_cli.robots.model import Geometry, Inertial, Joint, Link, Pose, RobotModel
from deepbots_cli.runtime import Supervisor
from tests.laws.expressions import chance, pick
from tests.laws.law import Case, law, reference
from tests.laws.readings import (
    LEVER,
    Array,
    Call,
    Reader,
    Readings,
    Source,
    Start,
    beginning,
    contact_reader,
    lively,
    opened,
    prepared,
    readings,
)
from tests.laws.scenarios import PLAIN
from tests.laws.shapes import line_distance

MIRROR = np.diag((1.0, -1.0, 1.0))
"""Left and right exchanged, in the frame of a body."""


@dataclass(frozen=True)
class Change:
    """How a world changes: it is mirrored or not, turned about z by `angle` rad, and shifted in the plane.

    A position p becomes Mp + t, a velocity Mv, and an angular velocity det(M) Mw, because a mirror image
    turns the other way round. Frames of bodies are mirrored in themselves, so that they stay right-handed.
    """

    mirrored: bool
    angle: float
    shift: tuple[float, float, float]

    @property
    def own(self) -> Array:
        """F: how a vector in the frame of a body changes."""
        return MIRROR if self.mirrored else np.eye(3)

    @property
    def world(self) -> Array:
        """M: how a vector of the world changes."""
        c, s = np.cos(self.angle), np.sin(self.angle)
        return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ self.own

    @property
    def sign(self) -> float:
        """The determinant, the sign of angles seen from above."""
        return -1.0 if self.mirrored else 1.0

    def point(self, p: Any) -> Array:
        return self.world @ p + self.shift

    def spin(self, w: Any) -> Array:
        return self.sign * self.world @ w

    def own_spin(self, w: Any) -> Array:
        return self.sign * self.own @ w

    def own_pose(self, pose: Pose) -> Pose:
        """Return a frame in the frame of a body: roll and yaw change their signs in a mirror."""
        (roll, pitch, yaw), sign = pose.rpy, self.sign
        return Pose(_triple(self.own @ pose.xyz), (sign * roll, pitch, sign * yaw))

    def pose(self, pose: Pose) -> Pose:
        """Return a frame in the world."""
        roll, pitch, yaw = self.own_pose(pose).rpy
        return Pose(_triple(self.point(pose.xyz)), (roll, pitch, yaw + self.angle))

    def rotation(self, q: Any) -> Array:
        """Return the quaternion of a body in the world: F mirrors its axis, and the turn comes last."""
        x, y, z, w = q
        mirrored = (self.sign * x, y, self.sign * z, w)
        return np.array(frames.multiply(frames.quaternion(0.0, 0.0, self.angle), mirrored))


def _triple(vector: Any) -> tuple[float, float, float]:
    x, y, z = map(float, vector)
    return x, y, z


# The world


def changed_program(program: Program, change: Change) -> Program:
    """Return the program of the changed world; its start is changed by `changed_start`."""
    return replace(
        program,
        world=_world(program.world, change),
        robots=tuple(_robot(robot, change) for robot in program.robots),
    )


def _world(world: WorldModel, change: Change) -> WorldModel:
    return replace(
        world,
        robots=tuple(_body(body, change) for body in world.robots),
        objects=tuple(replace(body, pose=change.pose(body.pose)) for body in world.objects),
        lines=tuple(_line(line, change) for line in world.lines),
        arena=world.arena and _arena(world.arena, change),
        terrain=world.terrain and _terrain(world.terrain),
    )


def _line(line: Line, change: Change) -> Line:
    points = (change.point((x, y, 0.0)) for x, y in line.points)
    return replace(line, points=tuple((float(x), float(y)) for x, y, _ in points))


def _arena(arena: Arena, change: Change) -> Arena:
    """Return the arena, which stays in its place but for turns by quarters."""
    x, y = arena.size
    return replace(arena, size=(y, x) if round(change.angle / (np.pi / 2)) % 2 else (x, y))


def _terrain(terrain: Terrain) -> Terrain:
    """Return the terrain after half a turn."""
    if not isinstance(terrain.shape, Formula):
        return terrain
    return replace(terrain, shape=replace(terrain.shape, heights=_half_turned(terrain.shape.heights)))


def _half_turned(heights: Scalar) -> Scalar:
    if isinstance(heights, Name):
        return Op("neg", (heights,))
    if not children(heights):
        return heights
    return heights._replace(args=tuple(map(_half_turned, children(heights))))  # type: ignore[union-attr]


def _body(body: RobotBody, change: Change) -> RobotBody:
    return replace(body, model=_model(body.model, change), pose=change.pose(body.pose))


def _model(model: RobotModel, change: Change) -> RobotModel:
    if not change.mirrored:
        return model
    return replace(
        model,
        links=tuple(_link(link, change) for link in model.links),
        joints=tuple(_joint(joint, change) for joint in model.joints),
    )


def _link(link: Link, change: Change) -> Link:
    def placed(part: Geometry) -> Geometry:
        return replace(part, origin=change.own_pose(part.origin))

    def inertial(part: Inertial) -> Inertial:
        return replace(part, origin=change.own_pose(part.origin), ixy=-part.ixy, iyz=-part.iyz)

    return replace(
        link,
        inertial=link.inertial and inertial(link.inertial),
        visuals=tuple(map(placed, link.visuals)),
        collisions=tuple(map(placed, link.collisions)),
    )


def _joint(joint: Joint, change: Change) -> Joint:
    """Return a joint whose positions keep their signs."""
    axis = change.own @ joint.axis if joint.type == "prismatic" else change.own_spin(joint.axis)
    return replace(joint, origin=change.own_pose(joint.origin), axis=_triple(axis))


def _robot(robot: Robot, change: Change) -> Robot:
    sensors = tuple(
        replace(
            sensor,
            mount=change.own_pose(sensor.mount),
            beams=sensor.beams and replace(sensor.beams, rays=tuple(map(change.own_pose, sensor.beams.rays))),
        )
        for sensor in robot.sensors
    )
    actuators = tuple(
        replace(actuator, spin=tuple(change.sign * spin for spin in actuator.spin))
        if isinstance(actuator, Thrust)
        else actuator
        for actuator in robot.actuators
    )
    return replace(robot, sensors=sensors, actuators=actuators)


def changed_start(start: Start, change: Change) -> Start:
    bodies = {}
    for name, ((position, rotation), (velocity, turning)) in start.bodies.items():
        frame = (_triple(change.point(position)), tuple(change.rotation(rotation)))
        bodies[name] = (frame, (_triple(change.world @ velocity), _triple(change.spin(turning))))
    return Start(bodies, start.joints)


# How readings change

Rule = Callable[[Change, Array], Array]


def _same(_change: Change, values: Array) -> Array:
    return values


def _angle(change: Change, values: Array) -> Array:
    return change.sign * values


def _heading(change: Change, values: Array) -> Array:
    return change.sign * values + change.angle


VECTOR: Rule = lambda change, v: change.world @ v  # noqa: E731
SPIN: Rule = Change.spin
OWN_VECTOR: Rule = lambda change, v: change.own @ v  # noqa: E731
OWN_SPIN: Rule = Change.own_spin
SENSED: Mapping[str, Rule] = {
    "position": Change.point,
    "velocity": VECTOR,
    "orientation": Change.rotation,
    "angular_velocity": SPIN,
    "compass": _heading,
    "gyro": OWN_SPIN,
    "accelerometer": OWN_VECTOR,
    "projected_gravity": OWN_VECTOR,
    "reaction_force": OWN_VECTOR,
    "reaction_torque": OWN_SPIN,
    **dict.fromkeys(("joint_position", "joint_velocity", "joint_torque", "touch", "force"), _same),
    **dict.fromkeys(("infrared", "sonar", "laser", "lidar", "height_scan", "reflectance"), _same),
}
"""How the reading of each kind of sensor changes."""
COMPUTED: Mapping[str, Rule] = {
    "position": Change.point,
    "velocity": VECTOR,
    "contact_force_vector": VECTOR,
    "orientation": Change.rotation,
    "angular_velocity": SPIN,
    "angular_momentum": SPIN,
    "yaw": _heading,
    "to_body_frame": OWN_VECTOR,
    **dict.fromkeys(("roll", "bearing", "cross_track_error"), _angle),
    **dict.fromkeys(("pitch", "tilt", "height", "distance", "ground_distance", "clearance"), _same),
    **dict.fromkeys(("arc_length", "contact", "collided", "contact_force"), _same),
    **dict.fromkeys(("joint_position", "joint_velocity", "joint_torque"), _same),
}
"""How the value of each function of the world changes."""
WITHOUT_RULE = {
    "camera": "a picture has the edges of its pixels, and pictures have tests of their own",
    "visible": "a body that is smaller than a pixel may be seen or not",
    **dict.fromkeys(
        ("path_distance", "path_bearing", "reachable"),
        "paths lead along a grid with the axes of the world, and their lengths depend on its directions",
    ),
}
"""Kinds of sensors and functions without a rule, and the reason."""


# The laws

JITTER = 1e-6
"""The size of a disturbance of the start, in m and rad."""
TOLERANCES = {"mujoco": (1e-8, 1e-6), "pybullet": (2e-6, 2e-5)}
"""Of a reading that a disturbed start does not change, at the start and in motion: in SI units, relative to
large values. PyBullet reads the poses of links in single precision."""
SMALL_LEVER = 0.01
"""The distance, in m, at which an angle has the tolerance of a position; that of a bearing is known."""
CLEARANCE_SCALE = 100.0
"""Engines look for the nearest points of two bodies step by step."""
FACTOR = 50.0
"""A reading may differ by so many times the difference that a disturbed start makes: rounding is smaller than
the disturbance, but has another direction. A wheel of an e-puck that a strong motor spun up met 26."""
STEPS = 5


def difference(source: Source, actual: Array, expected: Array) -> float:
    """Return the largest difference of two readings: of angles within half a turn, and of quaternions but for
    their sign."""
    # Infinite values, such as the clearance of a body without a surface, have no difference.
    apart = np.abs(np.where(actual == expected, 0.0, actual) - np.where(actual == expected, 0.0, expected))
    name = name_of(source)
    if name == "orientation":
        apart = min((apart, np.abs(actual + expected)), key=np.max)
    if name in ANGLES:
        apart = np.abs((apart + np.pi) % (2 * np.pi) - np.pi)
    return float(apart.max(initial=0.0))


OF_LINES = ("cross_track_error", "arc_length")
"""Functions of the nearest point of a line."""
ANGLES = ("roll", "yaw", "bearing", "compass")


def scale_of(name: str, source: Source, values: Readings) -> float:
    """Return the size of a reading, by which its tolerance grows."""
    if name_of(source) == "clearance":
        return CLEARANCE_SCALE
    finite = np.abs(values[name][np.isfinite(values[name])])
    scale = float(1.0 + finite.max(initial=0.0))
    if name_of(source) not in ANGLES:
        return scale
    return scale / (
        min(SMALL_LEVER, values[name + LEVER][0] + 1e-12) if name_of(source) == "bearing" else SMALL_LEVER
    )


def disturbed(start: Start, sign: float) -> Start:
    """Return a start that is moved a little in a fixed direction, or in the opposite one."""
    random = np.random.default_rng(1)

    def near(vector: Any) -> Any:
        step = random.standard_normal(len(vector))
        return np.asarray(vector) + sign * JITTER * step / np.linalg.norm(step)

    bodies = {
        name: ((_triple(near(position)), frames.normalized(near(rotation))), motion)
        for name, ((position, rotation), motion) in start.bodies.items()
    }
    joints = {
        key: (position + sign * JITTER * random.standard_normal(), speed)
        for key, (position, speed) in start.joints.items()
    }
    return Start(bodies, joints)


def compare(
    program: Program, start: Start, changed: Program, change: Change, sources: Mapping[str, Source]
) -> None:
    """Require the readings of the changed world to be the changed readings: at the start, and in some steps
    without contacts."""
    with ExitStack() as stack:
        worlds = [
            stack.enter_context(opened(beginning(of_world, from_start)))
            for of_world, from_start in (
                (program, start),
                (changed, changed_start(start, change)),
                (program, disturbed(start, 1.0)),
                (program, disturbed(start, -1.0)),
            )
        ]
        worlds[0].action_space.seed(0)
        tolerance = TOLERANCES[worlds[0].engine.name]
        touched = [contact_reader(world) for world in worlds]
        for world in worlds:
            world.reset(seed=0)
        for step in range(STEPS + 1):
            before, after, *beside = (readings(world, sources) for world in worlds)
            for name, source in sources.items():
                if name_of(source) in OF_LINES and not has_side(worlds[0], source):
                    continue
                expected = rule_of(source)(change, before[name])
                spread = max(difference(source, other[name], before[name]) for other in beside)
                allowed = tolerance[step > 0] * scale_of(name, source, before) + FACTOR * spread
                error = difference(source, after[name], expected)
                assert error <= allowed, (
                    step,
                    name,
                    source,
                    change,
                    before[name],
                    after[name],
                    expected,
                    allowed,
                )
            action = worlds[0].action_space.sample()
            with reference():  # a body that spins ever faster blows up in one world a step before the others
                for world in worlds:
                    world.step(action)
            if any(reader() for reader in touched):
                return


def has_side(world: Supervisor, source: Source) -> bool:
    """Return whether it is clear on which side of a line a body is: beside a corner, it may be on both."""
    assert isinstance(source, Call)
    name, line = source.subjects
    body, _, link = name.partition(".")
    model = world.scenario.world
    if f"{name} 1" in {thing.name for thing in model.objects}:
        body = f"{name} 1"  # the only piece of a wall
    position, _ = world.engine.pose(body, link or None)()
    return line_distance(model.line(line), np.array(position[:2]))[1] != 0.0


def name_of(source: Source) -> str:
    return source.kind if isinstance(source, Reader) else source.function


def rule_of(source: Source) -> Rule:
    return (SENSED if isinstance(source, Reader) else COMPUTED)[name_of(source)]


def _change_of(case: Case, program: Program, mirrored: bool) -> tuple[Change, WorldModel]:
    """Draw a change, and return the world without what cannot follow it.

    Terrain is a grid, of which half a turn is another one; an arena has the axes of the world.
    """
    world, still = program.world, (0.0, 0.0, 0.0)
    varied = [variation.of for variation in program.reset.variations]
    shape = world.terrain and world.terrain.shape
    if (
        not mirrored
        and chance(case.draw, 70)
        and (isinstance(shape, Formula) or (isinstance(shape, Pit) and not shape.noise))
    ):
        return Change(False, np.pi, still), world
    if shape:
        world = replace(world, terrain=None, ground=Ground())
    if world.arena and (OfWalls(ARENA_WALLS) in varied or chance(case.draw, 50)):
        return Change(mirrored, pick(case.draw, (np.pi / 2, -np.pi / 2, np.pi, 0.0)), still), world
    angle = pick(case.draw, (1.0, -2.0, np.pi / 2, np.pi, 0.0))
    shift = pick(case.draw, (still, (0.5, -3.0, 0.0), (4.0, 7.0, 0.0)))
    return Change(mirrored, angle, shift), replace(world, arena=None)


def _require_same(case: Case, mirrored: bool) -> None:
    def prepare(data: dict[str, Any]) -> None:
        for robot in data["robots"].values():
            for name, actuator in list(robot.get("actuators", {}).items()):
                if actuator["type"] == "cartesian":  # its commands are positions in the world
                    del robot["actuators"][name], robot["apply"][name]
                if mirrored:
                    actuator.pop("axis", None)
            for link in robot.get("links", {}).values():
                if mirrored:
                    link.pop("com", None)

    program, sources, start = prepared(case, tuple(WITHOUT_RULE), prepare)
    change, world = _change_of(case, program, mirrored)
    program = replace(program, world=world)
    compare(program, lively(case, program, start), changed_program(program, change), change, sources)


@law(cost=240, profile=PLAIN)
def a_turned_world_is_the_same(case: Case) -> None:
    """The laws of mechanics have no direction of the compass and no place: in a world that is turned about z
    and shifted, bodies see in their own frames what they saw before, scalars are the same, and vectors of the
    world are turned.

    Readings agree to 1e-8, or to 50 times what a start changes that is off by 1e-7 m and rad: an edge that a
    ray meets, or a bearing to a near body, makes rounding large. Contacts end the comparison, since the
    friction of engines has directions.
    """
    _require_same(case, mirrored=False)


@law(cost=220, profile=PLAIN)
def a_mirrored_world_is_the_mirror_image(case: Case) -> None:
    """The laws of mechanics know no left and right: a mirrored robot in a mirrored world moves as the mirror
    image, so velocities change their y, and angles and angular velocities the sense of rotation.

    The tolerance is that of a turned world.
    """
    _require_same(case, mirrored=True)
