"""Sensors of the robot itself: joints, poses and velocities, inertial measurements, contacts."""

from __future__ import annotations

from math import atan2, hypot
from typing import Any

from deepbots_cli import frames
from deepbots_cli.frames import HERE, UPRIGHT, Frame, Quaternion, Triple
from deepbots_cli.port import Engine, Part, PoseReader, VelocityReader
from deepbots_cli.runtime.sensing.device import Instrument, Site


def positions(site: Site) -> Instrument:
    """In rad or m."""
    read = site.engine.joint_states(site.robot, site.sensor.subjects)
    return Instrument(lambda: [state[0] for state in read()])


def velocities(site: Site) -> Instrument:
    """In rad/s or m/s."""
    read = site.engine.joint_states(site.robot, site.sensor.subjects)
    return Instrument(lambda: [state[1] for state in read()])


def torques(site: Site) -> Instrument:
    """What the motors exerted in the last physics step, in N m or N."""
    return Instrument(site.engine.joint_torques(site.robot, site.sensor.subjects))


def mounted_pose(site: Site) -> PoseReader:
    """Where the sensor is, and how it is turned."""
    read, mount = site.engine.pose(site.robot, site.link), site.mount
    if mount == HERE:
        return read

    def of_mount() -> tuple[Triple, Quaternion]:
        position, turned = read()
        return frames.inside((position, turned), mount)

    return of_mount


def mounted_velocity(site: Site) -> VelocityReader:
    """How the sensor moves and turns: v + w x r at the distance r from the link's origin."""
    arm = site.mount[0]
    if arm == HERE[0]:
        return site.engine.velocity(site.robot, site.link)
    read = site.engine.motion(site.robot, site.link)

    def of_mount() -> tuple[Triple, Triple]:
        (_, turned), (linear, angular) = read()
        return frames.add(linear, frames.cross(angular, frames.rotate(turned, arm))), angular

    return of_mount


def position(site: Site) -> Instrument:
    """In m, in the world."""
    read = mounted_pose(site)
    return Instrument(lambda: read()[0])


def orientation(site: Site) -> Instrument:
    """The quaternion (x, y, z, w) that turns the sensor's axes into those of the world, with w not negative."""
    read = mounted_pose(site)

    def turned() -> Quaternion:
        x, y, z, w = read()[1]
        return (x, y, z, w) if w >= 0.0 else (-x, -y, -z, -w)

    return Instrument(turned)


def velocity(site: Site) -> Instrument:
    """In m/s, in the world."""
    read = mounted_velocity(site)
    return Instrument(lambda: read()[0])


def angular_velocity(site: Site) -> Instrument:
    """In rad/s, about the axes of the world."""
    read = site.engine.velocity(site.robot, site.link)
    return Instrument(lambda: read()[1])


def compass(site: Site) -> Instrument:
    """The angle in the plane from x of the world to x of the sensor, in rad, to the left positive."""
    read = mounted_pose(site)

    def heading() -> tuple[float]:
        x, y, z, w = read()[1]
        return (atan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z)),)

    return Instrument(heading)


def gyro(site: Site) -> Instrument:
    """The angular velocity about the axes of the sensor, in rad/s."""
    read, back = site.engine.motion(site.robot, site.link), frames.inverse(site.mount[1])

    def turning() -> Triple:
        (_, turned), (_, angular) = read()
        return frames.rotate_back(turned, angular)

    return Instrument(turning if site.mount[1] == UPRIGHT else lambda: frames.rotate(back, turning()))


def projected_gravity(site: Site) -> Instrument:
    """The direction of gravity along the axes of the sensor, of length 1; nothing where there is no gravity."""
    read = mounted_pose(site)
    down: Triple = (0.0, 0.0, -1.0)

    def restart(_generator: Any) -> None:
        nonlocal down
        gravity = site.engine.gravity
        strength = hypot(*gravity)
        down = frames.scaled(gravity, 1.0 / strength) if strength else (0.0, 0.0, 0.0)

    return Instrument(lambda: frames.rotate_back(read()[1], down), restart)


def accelerometer(site: Site) -> Instrument:
    """Proper acceleration along the axes of the sensor, in m/s^2."""
    imu = Accelerometer(site.engine, site.robot, site.link, site.mount, site.world.timestep)
    return Instrument(imu.read, imu.restart, imu.follow)


class Accelerometer:
    """The proper acceleration along the axes of the sensor, in m/s^2: 0 in free fall, 9.81 upwards at rest.

    As a real one does, it integrates between two readings: each tick adds its change of velocity less gravity, turned into
    the frame as it stands halfway through the tick. That is the mean over the tick to a part of a^2 / 24, where a is the angle
    (rad) by which the sensor turns in it: 1 % at half a radian. Looking after every physics step instead took a tenth of what
    the physics of a rolling ball takes. The first reading of an episode is as at rest.
    """

    def __init__(self, engine: Engine, robot: str, link: str, mount: Frame, timestep: float) -> None:
        self._engine = engine
        self._motion = engine.motion(robot, link)
        self._arm = mount[0] if mount[0] != HERE[0] else None
        self._back = frames.inverse(mount[1])
        self._timestep = timestep
        self.restart()

    def restart(self, _generator: Any = None) -> None:
        self._gravity = self._engine.gravity
        self._fall = frames.scaled(self._gravity, self._timestep)
        (_, self._turned), (self._before, angular) = self._motion()
        if self._arm is not None:
            self._before = frames.add(self._before, frames.cross(angular, frames.rotate(self._turned, self._arm)))
        self._sum: Triple = (0.0, 0.0, 0.0)
        self._ticks = 0
        self._begins = True

    def follow(self) -> None:
        """Add up the change of a tick, along the axes of the link; plain arithmetic, as many scenarios have several ticks per step."""
        (_, turned), (velocity, angular) = self._motion()
        if self._arm is not None:
            velocity = frames.add(velocity, frames.cross(angular, frames.rotate(turned, self._arm)))
        (vx, vy, vz), (bx, by, bz), (fx, fy, fz) = velocity, self._before, self._fall
        (ax, ay, az, aw), (x, y, z, w) = self._turned, turned
        if ax * x + ay * y + az * z + aw * w < 0.0:
            ax, ay, az, aw = -ax, -ay, -az, -aw
        x, y, z, w = x + ax, y + ay, z + az, w + aw  # halfway between both, but for its length
        scale = 2.0 / (x * x + y * y + z * z + w * w)
        dx, dy, dz = vx - bx - fx, vy - by - fy, vz - bz - fz
        tx, ty, tz = scale * (dy * z - dz * y), scale * (dz * x - dx * z), scale * (dx * y - dy * x)
        sx, sy, sz = self._sum
        self._sum = (sx + dx + w * tx - y * tz + z * ty, sy + dy + w * ty - z * tx + x * tz, sz + dz + w * tz - x * ty + y * tx)
        self._before, self._turned = velocity, turned
        self._ticks += 1

    def read(self) -> Triple:
        if self._begins:
            self._begins = False
            felt = frames.rotate_back(self._turned, frames.scaled(self._gravity, -1.0))
        else:
            self.follow()
            felt = frames.scaled(self._sum, 1.0 / (self._ticks * self._timestep))
            self._sum, self._ticks = (0.0, 0.0, 0.0), 0
        return felt if self._back == UPRIGHT else frames.rotate(self._back, felt)


def touch(site: Site) -> Instrument:
    """Whether each link touched something in any engine step since the tick before."""
    others = None if site.sensor.against is None else [_part(name) for name in site.sensor.against]
    readers = [site.engine.contact((site.robot, link), others) for link in site.sensor.subjects]
    if len(readers) == 1:
        (only,) = readers
        return Instrument(lambda: (only(),))
    return Instrument(lambda: [read() for read in readers])


def force(site: Site) -> Instrument:
    """The sum of normal forces on each link, in N."""
    readers = [site.engine.contact_force((site.robot, link)) for link in site.sensor.subjects]
    return Instrument(lambda: [read() for read in readers])


def _part(name: str) -> Part:
    body, _, link = name.partition(".")
    return body, link or None
