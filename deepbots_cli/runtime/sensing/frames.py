"""Where a sensor sits on its link, and what is read there: all in the world frame, in plain floats."""

from __future__ import annotations

from math import atan2

from deepbots_cli import frames
from deepbots_cli.frames import HERE, Quaternion, Triple
from deepbots_cli.port import PoseReader, VelocityReader
from deepbots_cli.runtime.sensing.device import Instrument, Site


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
