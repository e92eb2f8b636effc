"""Sensors that feel how their frame turns, is accelerated, and which way is down."""

from __future__ import annotations

from math import hypot
from typing import Any

from deepbots_cli import frames
from deepbots_cli.frames import HERE, UPRIGHT, Frame, Triple
from deepbots_cli.port import Engine
from deepbots_cli.runtime.sensing.device import Instrument, Site
from deepbots_cli.runtime.sensing.frames import mounted_pose


def gyro(site: Site) -> Instrument:
    """The angular velocity about the axes of the sensor, in rad/s."""
    read, back = site.engine.motion(site.robot, site.link), frames.inverse(site.mount[1])

    def turning() -> Triple:
        (_, turned), (_, angular) = read()
        return frames.rotate_back(turned, angular)

    return Instrument(turning if site.mount[1] == UPRIGHT else lambda: frames.rotate(back, turning()))


def inclinometer(site: Site) -> Instrument:
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
