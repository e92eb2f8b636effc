"""The measurements of each kind of sensor; the classes of `scenario.sensors` name these functions as their
readers.

In order: joints, poses and velocities, inertial measurements, contacts; distances along rays and the
brightness of the ground; pictures.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable
from math import atan2, hypot
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from deepbots_cli import frames
from deepbots_cli.frames import IDENTITY_FRAME, IDENTITY_ROTATION, Frame, Quaternion, Triple
from deepbots_cli.port import (
    CameraImage,
    Engine,
    Part,
    PoseReader,
    RayReader,
    VelocityReader,
    cast_rays,
)
from deepbots_cli.program.robots import CalibrationTable, CameraIntrinsics, RayConfig
from deepbots_cli.runtime.formulas import total
from deepbots_cli.runtime.paths import PaintedGround
from deepbots_cli.runtime.sensing import Instrument, Normals, Site, Values

if TYPE_CHECKING:
    from deepbots_cli.port import Image
    from deepbots_cli.runtime.sensing import Device


# The robot itself


def positions(site: Site) -> Instrument:
    """Measure the positions of the joints, in rad or m."""
    read = site.engine.joint_states(site.robot, site.sensor.subjects)
    return Instrument(lambda: [state[0] for state in read()])


def velocities(site: Site) -> Instrument:
    """Measure the velocities of the joints, in rad/s or m/s."""
    read = site.engine.joint_states(site.robot, site.sensor.subjects)
    return Instrument(lambda: [state[1] for state in read()])


def torques(site: Site) -> Instrument:
    """Measure the torques or forces that the motors exerted in the last physics step, in N m or N."""
    return Instrument(site.engine.joint_torques(site.robot, site.sensor.subjects))


def mounted_pose(site: Site) -> PoseReader:
    """Return a reader of position and orientation of the sensor, in the world frame."""
    read = site.engine.pose(site.robot, site.link)
    mount = site.mount
    if mount == IDENTITY_FRAME:
        return read

    def of_mount() -> tuple[Triple, Quaternion]:
        position, rotation = read()
        return frames.compose((position, rotation), mount)

    return of_mount


def mounted_velocity(site: Site) -> VelocityReader:
    """Return a reader of the linear and angular velocity of the sensor: v + w x r at the distance r from the
    link's origin."""
    arm = site.mount[0]
    if arm == IDENTITY_FRAME[0]:
        return site.engine.velocity(site.robot, site.link)
    read = site.engine.motion(site.robot, site.link)

    def of_mount() -> tuple[Triple, Triple]:
        (_, rotation), (linear, angular) = read()
        return frames.add(linear, frames.cross(angular, frames.rotate(rotation, arm))), angular

    return of_mount


def position(site: Site) -> Instrument:
    """Measure the position in the world, in m."""
    read = mounted_pose(site)
    return Instrument(lambda: read()[0])


def orientation(site: Site) -> Instrument:
    """Measure the quaternion (x, y, z, w) that turns the sensor's axes into those of the world, with w not
    negative."""
    read = mounted_pose(site)

    def turned() -> Quaternion:
        x, y, z, w = read()[1]
        # q and -q are the same rotation, and an engine may return either.
        return (x, y, z, w) if w >= 0.0 else (-x, -y, -z, -w)

    return Instrument(turned)


def velocity(site: Site) -> Instrument:
    """Measure the velocity in the world, in m/s."""
    read = mounted_velocity(site)
    return Instrument(lambda: read()[0])


def angular_velocity(site: Site) -> Instrument:
    """Measure the angular velocity about the axes of the world, in rad/s."""
    read = site.engine.velocity(site.robot, site.link)
    return Instrument(lambda: read()[1])


def compass(site: Site) -> Instrument:
    """Measure the angle in the plane from x of the world to x of the sensor, in rad, to the left positive."""
    read = mounted_pose(site)

    def heading() -> tuple[float]:
        x, y, z, w = read()[1]
        return (atan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z)),)

    return Instrument(heading)


def gyro(site: Site) -> Instrument:
    """Measure the angular velocity about the axes of the sensor, in rad/s."""
    read = site.engine.motion(site.robot, site.link)
    back = frames.inverse(site.mount[1])

    def turning() -> Triple:
        (_, rotation), (_, angular) = read()
        return frames.rotate_back(rotation, angular)

    return Instrument(
        turning if site.mount[1] == IDENTITY_ROTATION else lambda: frames.rotate(back, turning())
    )


def projected_gravity(site: Site) -> Instrument:
    """Measure the direction of gravity along the axes of the sensor, of length 1; nothing where there is no
    gravity."""
    read = mounted_pose(site)
    down: Triple = (0.0, 0.0, -1.0)

    def restart(_generator: Any) -> None:
        nonlocal down
        gravity = site.engine.gravity
        strength = hypot(*gravity)
        down = frames.scaled(gravity, 1.0 / strength) if strength else (0.0, 0.0, 0.0)

    return Instrument(lambda: frames.rotate_back(read()[1], down), restart)


def accelerometer(site: Site) -> Instrument:
    """Measure the proper acceleration along the axes of the sensor, in m/s^2."""
    imu = Accelerometer(site.engine, site.robot, site.link, site.mount, site.world.timestep)
    return Instrument(imu.read, imu.restart, imu.follow)


class Accelerometer:
    """The proper acceleration along the axes of the sensor, in m/s^2: 0 in free fall, 9.81 upwards at rest.

    Like a real accelerometer, it integrates between two readings: each tick adds its change of velocity less
    gravity, turned into the frame of the sensor halfway through the tick. That is the mean over the tick to a
    part of a^2 / 24, where a is the angle (rad) by which the sensor turns in it: 1 % at half a radian.
    Reading after every physics step instead took a tenth of the time of the physics of a rolling ball. The
    first reading of an episode is that at rest.
    """

    def __init__(self, engine: Engine, robot: str, link: str, mount: Frame, timestep: float) -> None:
        self._engine = engine
        self._motion = engine.motion(robot, link)
        self._arm = mount[0] if mount[0] != IDENTITY_FRAME[0] else None
        self._back = frames.inverse(mount[1])
        self._timestep = timestep
        self.restart()

    def restart(self, _generator: Any = None) -> None:
        self._gravity = self._engine.gravity
        self._fall = frames.scaled(self._gravity, self._timestep)
        (_, self._turned), (self._before, angular) = self._motion()
        if self._arm is not None:
            self._before = frames.add(
                self._before, frames.cross(angular, frames.rotate(self._turned, self._arm))
            )
        self._sum: Triple = (0.0, 0.0, 0.0)
        self._ticks = 0
        self._begins = True

    def follow(self) -> None:
        """Add up the change of a tick, along the axes of the link; plain arithmetic, as many scenarios have
        several ticks per step."""
        (_, rotation), (velocity, angular) = self._motion()
        if self._arm is not None:
            velocity = frames.add(velocity, frames.cross(angular, frames.rotate(rotation, self._arm)))
        vx, vy, vz = velocity
        bx, by, bz = self._before
        fx, fy, fz = self._fall
        (ax, ay, az, aw), (x, y, z, w) = self._turned, rotation
        # Opposite quaternions are the same rotation, and would cancel in the sum below.
        if ax * x + ay * y + az * z + aw * w < 0.0:
            ax, ay, az, aw = -ax, -ay, -az, -aw
        x, y, z, w = x + ax, y + ay, z + az, w + aw  # halfway between both, but for its length
        scale = 2.0 / (x * x + y * y + z * z + w * w)
        dx, dy, dz = vx - bx - fx, vy - by - fy, vz - bz - fz
        tx, ty, tz = scale * (dy * z - dz * y), scale * (dz * x - dx * z), scale * (dx * y - dy * x)
        sx, sy, sz = self._sum
        self._sum = (
            sx + dx + w * tx - y * tz + z * ty,
            sy + dy + w * ty - z * tx + x * tz,
            sz + dz + w * tz - x * ty + y * tx,
        )
        self._before = velocity
        self._turned = rotation
        self._ticks += 1

    def read(self) -> Triple:
        if self._begins:
            self._begins = False
            felt = frames.rotate_back(self._turned, frames.scaled(self._gravity, -1.0))
        else:
            self.follow()
            felt = frames.scaled(self._sum, 1.0 / (self._ticks * self._timestep))
            self._sum = (0.0, 0.0, 0.0)
            self._ticks = 0
        return felt if self._back == IDENTITY_ROTATION else frames.rotate(self._back, felt)


def touch(site: Site) -> Instrument:
    """Measure whether each link touched something in any engine step since the timestep before."""
    other_parts = None if site.sensor.against is None else [_part(name) for name in site.sensor.against]
    readers = [site.engine.contact((site.robot, link), other_parts) for link in site.sensor.subjects]
    if len(readers) == 1:
        (only,) = readers
        return Instrument(lambda: (only(),))
    return Instrument(lambda: [read() for read in readers])


def force(site: Site) -> Instrument:
    """Measure the sum of normal forces on each link, in N."""
    readers = [site.engine.contact_force((site.robot, link)) for link in site.sensor.subjects]
    return Instrument(lambda: [read() for read in readers])


def _part(name: str) -> Part:
    body, _, link = name.partition(".")
    return body, link or None


def reaction_force(site: Site) -> Instrument:
    """Measure the force of the joint that carries the link, along the axes of the sensor, in N."""
    read = site.engine.joint_wrench((site.robot, site.link))
    back = frames.inverse(site.mount[1])
    return Instrument(lambda: frames.rotate(back, read()[0]))


def reaction_torque(site: Site) -> Instrument:
    """Measure the torque of the joint that carries the link, about the origin of the sensor and along its
    axes, in N m."""
    read = site.engine.joint_wrench((site.robot, site.link))
    arm, rotation = site.mount
    back = frames.inverse(rotation)

    def torque() -> Triple:
        # A torque M about the origin of the link is M - r x F = M + F x r about a point at r.
        force, about_link = read()
        return frames.rotate(back, frames.add(about_link, frames.cross(force, arm)))

    return Instrument(torque)


# Rays


def ranging(site: Site) -> Instrument:
    """Measure the free distance along each ray from its frame, or one value for all rays, in m; or the
    reading that the lookup table gives for it."""
    beams = site.sensor.beams or RayConfig((), 0.0)
    mount = site.mount
    start = ((-beams.behind, 0.0, 0.0), IDENTITY_ROTATION)
    rays = [frames.compose(frames.compose(mount, frames.frame(ray)), start) for ray in beams.rays]
    part = (site.robot, site.link)
    cast = cast_rays(site.engine, part, rays, beams.reach, upright=beams.upright)
    read = _combined(_from_frames(cast, beams.behind), beams)
    if beams.lookup is None:
        return Instrument(read)
    table = LookupTable(beams.lookup, max(1, len(site.sensor.components)))
    return Instrument(read, table.restart, lookup=table)


def _from_frames(read: RayReader, behind: float) -> RayReader:
    """Return distances from the frames of rays that begin `behind` them."""
    return (lambda: [free - behind for free in read()]) if behind else read


def _combined(read: RayReader, beams: RayConfig) -> RayReader:
    count = len(beams.rays)
    match beams.combined:
        case "nearest":
            return lambda: (min(read()),)
        case "mean":
            return lambda: (total(read()) / count,)
        case _:
            return read


class LookupTable:
    """Readings of `width` rays by their distances, with the noise of each row."""

    def __init__(self, spec: CalibrationTable, width: int) -> None:
        distance, value = spec.distance, spec.value
        noise = spec.noise or (0.0,) * len(distance)
        self._distances = distance
        self.normals = Normals(width) if spec.noise else None
        starts = zip(distance, value, noise, _slopes(distance, value), _slopes(distance, noise), strict=True)
        first = (distance[0], value[0], noise[0], 0.0, 0.0)
        self.rows = [first, *starts]
        """Distance, value and noise at the start of a stretch, and how value and noise change along it; the
        first is before the table."""

    def restart(self, generator: Any) -> None:
        if self.normals is not None:
            self.normals.restart(generator)

    def __call__(self, distances: Values) -> Values:
        table, rows = self._distances, self.rows
        if self.normals is None:
            # `rows` has one entry more than `table`, so the index is that of the stretch that contains x.
            return [(row := rows[bisect_right(table, x)])[1] + row[3] * (x - row[0]) for x in distances]
        readings = []
        for x, normal in zip(distances, self.normals.next_row(), strict=True):
            start, value, noise, slope, growth = rows[bisect_right(table, x)]
            along = x - start
            readings.append((value + slope * along) * (1.0 + (noise + growth * along) * normal))
        return readings


def _slopes(distance: Values, column: Values) -> list[float]:
    """Return the change of a column per m after each row; 0 after the last row."""
    # The last row has no following one.
    pairs = zip(distance, distance[1:], column, column[1:], strict=False)
    return [*((d - c) / (b - a) for a, b, c, d in pairs), 0.0]


def reflectance(site: Site) -> Instrument:
    """Measure the reflectance of the plane z = 0 where -z of each ray's frame meets it; none where it looks
    level or up.

    Unpainted ground is 1. A reading is the mean over a spot, so that it goes gradually from ground to line.
    """
    beams = site.sensor.beams or RayConfig((), 0.0)
    mount = site.mount
    spot = site.parameters["spot"]
    rays = [frames.compose(mount, frames.frame(ray)) for ray in beams.rays]
    eyes = [(origin, frames.rotate(rotation, (0.0, 0.0, -1.0))) for origin, rotation in rays]
    read = site.engine.pose(site.robot, site.link)
    paint = PaintedGround(site.world.lines, spot / 2)
    rotate = frames.rotate

    def brightness() -> list[float]:
        (x, y, z), rotation = read()
        readings = []
        for origin, direction in eyes:
            right, left, up = rotate(rotation, origin)
            ahead, aside, down = rotate(rotation, direction)
            if down > -1e-6:  # an eye that looks level or up sees no ground
                readings.append(0.0)
                continue
            distance = (z + up) / -down
            readings.append(paint(x + right + distance * ahead, y + left + distance * aside))
        return readings

    return Instrument(brightness)


# Cameras

_GRAY_WEIGHTS = np.array([0.299, 0.587, 0.114], np.float32)
"""The weights of red, green and blue in the brightness (ITU-R BT.601)."""


def camera(site: Site) -> Instrument:
    """Measure a picture, uint8 of the shape of the optics; after it comes the picture of the engine, for
    `sees`."""
    optics = site.sensor.optics or CameraIntrinsics(1, 1, 1.0)
    part = (site.robot, site.link)
    read = site.engine.camera(part, site.mount, optics.width, optics.height, optics.fov)
    convert = _PICTURES[optics.channels]

    def picture() -> tuple[Image, CameraImage]:
        image = read()
        return convert(image, optics), image

    return Instrument(picture)


def sees(device: Device, body: str) -> Callable[[], bool]:
    """Measure whether the newest picture of a camera shows at least one pixel of the body."""

    def seen() -> bool:
        image: CameraImage = device.reading[1]
        return body in image.body_names and bool((image.bodies == image.body_names.index(body)).any())

    return seen


def _depth(image: CameraImage, optics: CameraIntrinsics) -> Image:
    """Return the depth: black at `near`, white at `far` and beyond."""
    share = (image.depth - optics.near) / (optics.far - optics.near)
    return _bytes(255.0 * np.clip(share, 0.0, 1.0))


def _segmentation(image: CameraImage, _optics: CameraIntrinsics) -> Image:
    """Return 0 where there is no body, else the place of the body among those of the world, from 1; 255 for
    all from there on."""
    return _bytes(np.clip(image.bodies + 1, 0, 255))


def _bytes(values: NDArray[Any]) -> Image:
    """Return one channel of whole numbers from 0 to 255."""
    return np.asarray(np.rint(values), np.uint8)[..., None]


_PICTURES: dict[str, Callable[[CameraImage, CameraIntrinsics], Image]] = {
    "rgb": lambda image, _: image.colors,
    "grayscale": lambda image, _: _bytes(np.asarray(image.colors @ _GRAY_WEIGHTS)),
    "depth": _depth,
    "segmentation": _segmentation,
}


ON_COLUMNS = frozenset(
    {
        positions,
        velocities,
        torques,
        position,
        velocity,
        angular_velocity,
        gyro,
        projected_gravity,
        touch,
        force,
        reaction_force,
        reaction_torque,
        ranging,
    }
)
"""Readers whose arithmetic is the same with a column of many worlds in the place of each number."""
