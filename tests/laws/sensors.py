"""Laws of sensors and functions of the world: a second implementation has the same values.

The second implementation knows the numbers of the start, as a placement states them, and the robot file. It
moves links with yourdfpy, velocities are numerical derivatives, and rays meet shapes in closed form.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import yourdfpy
from hypothesis import reject
from scipy.spatial.transform import Rotation

from deepbots_cli.engines.mechanics import arena_walls
from deepbots_cli.program import Program
from deepbots_cli.program.robots import RayConfig, Sensor
from deepbots_cli.robots.model import Mesh, Pose, RobotModel, Shape, to_urdf
from tests.laws import shapes
from tests.laws.frames import ANGLES, SMALL_LEVER, difference, name_of
from tests.laws.law import Case, law
from tests.laws.readings import (
    LEVER,
    Array,
    Call,
    Reader,
    Readings,
    Source,
    Start,
    beginning,
    lively,
    opened,
    prepared,
    readings,
)
from tests.laws.scenarios import PLAIN

EDGE = 2e-3
"""rad: engines round an edge that is so near to a ray."""
H = 1e-6
"""The time, in s, of numerical derivatives."""


def matrix(position: Any, rotation: Rotation) -> Array:
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = rotation.as_matrix(), position
    return frame


def of_pose(pose: Pose) -> Array:
    return matrix(pose.xyz, Rotation.from_euler("xyz", pose.rpy))


@dataclass(frozen=True)
class Solid:
    """A shape in the world, and the body to which it belongs."""

    body: str
    shape: Shape
    frame: Array


class Mechanism:
    """The links of a robot, moved by yourdfpy."""

    def __init__(self, model: RobotModel) -> None:
        text = to_urdf(model).encode()
        self.model = model
        self._urdf = yourdfpy.URDF.load(
            io.BytesIO(text), load_meshes=False, build_scene_graph=True, load_collision_meshes=False
        )

    def links(self, joints: Mapping[str, float]) -> dict[str, Array]:
        """Return the frames of all links in that of the root."""
        # yourdfpy ignores a change of a joint below 1e-8 rad: a larger one comes before it.
        for step in (1.0, 0.0):
            self._urdf.update_cfg({name: joints[name] + step for name in self._urdf.actuated_joint_names})
        return {link.name: self._urdf.get_transform(link.name, self.model.root) for link in self.model.links}


class Truth:
    """What a start implies."""

    def __init__(self, program: Program, start: Start, gravity: Array) -> None:
        self.program, self.start, self.gravity = program, start, gravity
        self.world = program.world
        self.robots = {robot.name: robot for robot in self.world.robots}
        self._mechanisms = {name: Mechanism(robot.model) for name, robot in self.robots.items()}

    # Frames

    def _at(self, time: float) -> dict[str, Array]:
        """Return the frames of all bodies and links a little later or earlier, by their full names."""
        frames: dict[str, Array] = {}
        for name, ((position, rotation), (velocity, turning)) in self.start.bodies.items():
            still = name in self.robots and self.robots[name].fixed_base
            v, w = (np.zeros(3), np.zeros(3)) if still else (np.array(velocity), np.array(turning))
            turned = Rotation.from_rotvec(time * w) * Rotation.from_quat(rotation)
            root = matrix(np.array(position) + time * v, turned)
            frames[name] = root
            if name in self.robots:
                joints = {
                    joint: angle + time * speed
                    for (robot, joint), (angle, speed) in self.start.joints.items()
                    if robot == name
                }
                for joint, mimic in self.robots[name].model.followers.items():
                    joints[joint] = mimic.position(joints[mimic.joint])
                links = self._mechanisms[name].links(joints)
                frames |= {f"{name}.{link}": root @ frame for link, frame in links.items()}
        for body in self.world.objects:
            frames.setdefault(body.name, of_pose(body.pose))
            if body.name.endswith(" 1"):  # a wall has the name of its only piece
                frames[body.name[:-2]] = frames[body.name]
        return frames

    @cached_property
    def frames(self) -> dict[str, Array]:
        return self._at(0.0)

    @cached_property
    def _beside(self) -> tuple[dict[str, Array], dict[str, Array]]:
        return self._at(-H), self._at(H)

    def twist(self, name: str, mount: Array | None = None) -> tuple[Array, Array]:
        """Return the velocity and the angular velocity of a link, or of a frame on it."""
        mount = np.eye(4) if mount is None else mount
        before, after = (frames[name] @ mount for frames in self._beside)
        turned = Rotation.from_matrix(after[:3, :3] @ before[:3, :3].T).as_rotvec()
        return (after[:3, 3] - before[:3, 3]) / (2 * H), turned / (2 * H)

    # Shapes

    @cached_property
    def solids(self) -> list[Solid]:
        """All shapes that stop a ray, but for the ground."""
        solids = []
        for body in self.world.objects:
            if body.variants or isinstance(body.shape, Mesh):
                reject()  # the drawn one is not known here, and a mesh has no closed form
            if body.solid:
                solids.append(Solid(body.name, body.shape, self.frames[body.name]))
        for wall in arena_walls(self.world.arena) if self.world.arena else ():
            solids.append(Solid(wall.name, wall.shape, of_pose(wall.pose)))
        for name, robot in self.robots.items():
            for link in robot.model.links:
                for part in link.collisions:
                    frame = self.frames[f"{name}.{link.name}"] @ of_pose(part.origin)
                    solids.append(Solid(name, part.shape, frame))
        return solids

    def free(self, origin: Array, way: Array, body: str, reach: float) -> float:
        """Return the free distance along a ray that passes through its own body; NaN where it begins within
        another one, or below the ground."""
        distance = reach if way[2] >= 0.0 else min(reach, -origin[2] / way[2])
        if origin[2] < 1e-4:
            return np.nan
        for solid in self.solids:
            if solid.body == body:
                continue
            back = solid.frame[:3, :3].T
            start, direction = back @ (origin - solid.frame[:3, 3]), back @ way
            if shapes.depth(solid.shape, start) > -1e-4:
                return np.nan
            distance = min(distance, shapes.met(solid.shape, start, direction))
        return float(distance)


# Sensors

Second = Callable[[Truth, Reader, Sensor], Any]


def _frame(truth: Truth, reader: Reader, sensor: Sensor) -> Array:
    """Return the frame of a sensor in the world."""
    return truth.frames[_link(reader, sensor)] @ of_pose(sensor.mount)


def _link(reader: Reader, sensor: Sensor) -> str:
    return f"{reader.robot}.{sensor.subjects[0]}"


def _turning(truth: Truth, reader: Reader, sensor: Sensor) -> Array:
    return truth.twist(_link(reader, sensor))[1]


def _joints(index: int) -> Second:
    return lambda truth, reader, sensor: [
        truth.start.joints[reader.robot, joint][index] for joint in sensor.subjects
    ]


def _zeros(_truth: Truth, _reader: Reader, sensor: Sensor) -> Array:
    return np.zeros(max(1, len(sensor.components)))


def _along_axes(truth: Truth, reader: Reader, sensor: Sensor, vector: Array) -> Array:
    return _frame(truth, reader, sensor)[:3, :3].T @ vector


def _compass(truth: Truth, reader: Reader, sensor: Sensor) -> float:
    forward = _frame(truth, reader, sensor)[:3, 0]
    return float(np.arctan2(forward[1], forward[0]))


def _ranges(truth: Truth, reader: Reader, sensor: Sensor) -> Array:
    """Return the distances of all rays, their least or their mean, or what the table says of it."""
    beams = sensor.beams
    assert beams is not None
    link = truth.frames[_link(reader, sensor)]
    if beams.upright:
        yaw = np.arctan2(link[1, 0], link[0, 0])
        link = matrix(link[:3, 3], Rotation.from_euler("z", yaw))
    distances = np.array(
        [_ray(truth, reader, beams, link @ of_pose(sensor.mount) @ of_pose(r)) for r in beams.rays]
    )
    if beams.combined != "each":
        distances = np.atleast_1d(distances.min() if beams.combined == "nearest" else distances.mean())
    if beams.lookup is not None:
        distances = np.interp(distances, beams.lookup.distance, beams.lookup.value)
    return distances


def _ray(truth: Truth, reader: Reader, beams: RayConfig, frame: Array) -> float:
    """Return the distance of one ray; NaN where it is not between those beside it, as at an edge."""
    values = {}
    for left, up in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)):
        way = frame[:3, 0] + EDGE * (left * frame[:3, 1] + up * frame[:3, 2])
        way /= np.linalg.norm(way)
        values[left, up] = truth.free(frame[:3, 3] - beams.behind * way, way, reader.robot, beams.reach)
    bends = [2 * values[0, 0] - values[a, b] - values[-a, -b] for a, b in ((1, 0), (0, 1))]
    return values[0, 0] - beams.behind if np.abs(bends).max() < 1e-4 else np.nan


def _reflectance(truth: Truth, reader: Reader, sensor: Sensor) -> Array:
    """Return the reflectance of the paint, or of the ground, where the whole spot is on it."""
    assert sensor.beams is not None
    spot = dict(sensor.parameters)["spot"]
    readings = []
    for ray in sensor.beams.rays:
        frame = _frame(truth, reader, sensor) @ of_pose(ray)
        down = -frame[:3, 2]
        if down[2] > -1e-3:
            readings.append(0.0 if down[2] > 1e-3 else np.nan)
            continue
        point = frame[:2, 3] - frame[2, 3] / down[2] * down[:2]
        beyond = [shapes.line_distance(line, point)[0] - line.width / 2 for line in truth.world.lines]
        painted = [line for line, apart in zip(truth.world.lines, beyond, strict=True) if apart < spot]
        if not painted:
            readings.append(1.0)
        elif len(painted) == 1 and max(a for a in beyond if a < spot) < -spot:
            readings.append(painted[0].reflectance)
        else:
            readings.append(np.nan)
    return np.array(readings)


RAYS = ("infrared", "sonar", "laser", "lidar", "height_scan")
SENSED: Mapping[str, Second] = {
    "joint_position": _joints(0),
    "joint_velocity": _joints(1),
    "joint_torque": _zeros,
    "position": lambda t, r, s: _frame(t, r, s)[:3, 3],
    "velocity": lambda t, r, s: t.twist(_link(r, s), of_pose(s.mount))[0],
    "angular_velocity": _turning,
    "orientation": lambda t, r, s: Rotation.from_matrix(_frame(t, r, s)[:3, :3]).as_quat(),
    "gyro": lambda t, r, s: _along_axes(t, r, s, _turning(t, r, s)),
    "accelerometer": lambda t, r, s: _along_axes(t, r, s, -t.gravity),
    "projected_gravity": lambda t, r, s: _along_axes(t, r, s, t.gravity / np.linalg.norm(t.gravity)),
    "compass": _compass,
    "reflectance": _reflectance,
    **dict.fromkeys(("reaction_force", "reaction_torque", "touch", "force"), _zeros),
    **dict.fromkeys(RAYS, _ranges),
}
"""The reading of each kind of sensor at the start: of forces and contacts there are none yet."""


# Functions

SecondFunction = Callable[[Truth, Call], Any]


def _rotation(truth: Truth, name: str) -> Array:
    return truth.frames[name][:3, :3]


def _apart(truth: Truth, call: Call) -> Array:
    first, second = (truth.frames[name][:3, 3] for name in call.subjects)
    return second - first


def _euler(axis: int) -> SecondFunction:
    return lambda truth, call: Rotation.from_matrix(_rotation(truth, call.subjects[0])).as_euler("xyz")[axis]


def _bearing(truth: Truth, call: Call) -> float:
    forward, apart = _rotation(truth, call.subjects[0])[:, 0], _apart(truth, call)
    return float(np.arctan2(apart[1], apart[0]) - np.arctan2(forward[1], forward[0]))


def _to_body_frame(truth: Truth, call: Call) -> Array:
    body, other = call.subjects
    return _rotation(truth, body).T @ truth.twist(other)[0]


def _cross_track_error(truth: Truth, call: Call) -> float:
    body, line = call.subjects
    distance, side = shapes.line_distance(truth.world.line(line), truth.frames[body][:2, 3])
    return side * distance if side else np.nan


def _angular_momentum(truth: Truth, call: Call) -> Array:
    """Return the sum of m r x v and I w of all links, about the center of mass."""
    (name,) = call.subjects
    varied = {getattr(v.of, "body", "") for v in truth.program.reset.variations}
    if name in varied:
        return np.full(3, np.nan)
    masses, centers, speeds, spins = [], [], [], []
    for link in truth.robots[name].model.links:
        inertial = link.inertial
        if inertial is None or not inertial.mass:
            continue
        full = f"{name}.{link.name}"
        frame = truth.frames[full] @ of_pose(inertial.origin)
        speed, turning = truth.twist(full, of_pose(inertial.origin))
        tensor = frame[:3, :3] @ np.array(inertial.matrix) @ frame[:3, :3].T
        masses.append(inertial.mass)
        centers.append(frame[:3, 3])
        speeds.append(speed)
        spins.append(tensor @ turning)
    m, r, v = np.array(masses)[:, None], np.array(centers), np.array(speeds)
    arms = r - (m * r).sum(0) / m.sum()
    return np.asarray((np.array(spins) + np.cross(arms, m * v)).sum(0))


def _joint(index: int) -> SecondFunction:
    def read(truth: Truth, call: Call) -> float:
        robot, _, joint = call.subjects[0].partition(".")
        return truth.start.joints[robot, joint][index]

    return read


COMPUTED: Mapping[str, SecondFunction] = {
    "position": lambda t, c: t.frames[c.subjects[0]][:3, 3],
    "velocity": lambda t, c: t.twist(c.subjects[0])[0],
    "angular_velocity": lambda t, c: t.twist(c.subjects[0])[1],
    "angular_momentum": _angular_momentum,
    "orientation": lambda t, c: Rotation.from_matrix(_rotation(t, c.subjects[0])).as_quat(),
    "roll": _euler(0),
    "pitch": _euler(1),
    "yaw": _euler(2),
    "tilt": lambda t, c: np.arccos(np.clip(_rotation(t, c.subjects[0])[2, 2], -1.0, 1.0)),
    "to_body_frame": _to_body_frame,
    "distance": lambda t, c: np.linalg.norm(_apart(t, c)),
    "ground_distance": lambda t, c: np.linalg.norm(_apart(t, c)[:2]),
    "bearing": _bearing,
    "height": lambda t, c: 0.0,
    "cross_track_error": _cross_track_error,
    "joint_position": _joint(0),
    "joint_velocity": _joint(1),
    "contact_force_vector": lambda t, c: np.zeros(3),
    **dict.fromkeys(("joint_torque", "contact", "collided", "contact_force", "arc_length"), lambda t, c: 0.0),
}
"""The value of each function of the world at the start."""
WITHOUT_SECOND = {
    "camera": "pictures have tests of their own",
    "visible": "a picture decides",
    "clearance": "two engines compute it, and are compared",
    **dict.fromkeys(
        ("path_distance", "path_bearing", "reachable"), "paths on a grid are approximate, and have tests"
    ),
}
"""Kinds of sensors and functions without a second implementation, and the reason."""
TOLERANCES = {"mujoco": 1e-6, "pybullet": 1e-5}
"""In SI units: numerical derivatives are exact to 1e-8, and PyBullet reads links in single precision."""


def second_value(truth: Truth, source: Source) -> Array:
    """Return the value of a signal by the second implementation; NaN where it has none."""
    if isinstance(source, Reader):
        robot = next(robot for robot in truth.program.robots if robot.name == source.robot)
        sensor = next(sensor for sensor in robot.sensors if sensor.name == source.sensor)
        values = np.atleast_1d(np.asarray(SENSED[source.kind](truth, source, sensor), float))
        if sensor.faults is not None and sensor.faults.low:
            values = np.clip(values, sensor.faults.low, sensor.faults.high)
        return values
    return np.atleast_1d(np.asarray(COMPUTED[source.function](truth, source), float))


@law(cost=190, profile=PLAIN)
def sensors_agree_with_a_second_implementation(case: Case) -> None:
    """A start has numbers, from which kinematics and geometry give each reading.

    An angle may be off by more where it is ill-conditioned: the tolerance is that of a length of 1 cm, or of
    the distance at which a bearing is measured.
    """
    program, sources, start = prepared(case, tuple(WITHOUT_SECOND), _on_a_plane)
    start = lively(case, program, start)
    with opened(beginning(program, start)) as world:
        world.reset(seed=0)
        truth = Truth(program, start, np.array(world.engine.gravity))
        values = readings(world, sources)
        for name, source in sources.items():
            expected = second_value(truth, source)
            has_value = ~np.isnan(expected)
            allowed = TOLERANCES[world.engine.name] * _scale(name, source, values)
            error = difference(source, values[name][has_value], expected[has_value])
            assert error <= allowed, (name, source, values[name], expected, allowed)


def _on_a_plane(data: dict[str, Any]) -> None:
    """Remove the terrain, of which engines have a grid."""
    data["world"].pop("terrain", None)


def _scale(name: str, source: Source, values: Readings) -> float:
    scale = float(1.0 + np.abs(values[name]).max(initial=0.0))
    if name_of(source) == "bearing":
        return scale / min(SMALL_LEVER, values[name + LEVER][0] + 1e-12)
    return scale / SMALL_LEVER if name_of(source) in ANGLES else scale
