"""Sensors that feel how their frame turns, is accelerated, and which way is down."""

from __future__ import annotations

from math import hypot
from typing import Any

from deepbots_cli import frames
from deepbots_cli.frames import UPRIGHT, Frame, Quaternion, Triple
from deepbots_cli.port import Engine
from deepbots_cli.runtime.sensing.device import Instrument
from deepbots_cli.runtime.sensing.frames import mounted_pose, mounted_velocity


def gyro(engine: Engine, robot: str, link: str, mount: Frame) -> Instrument:
    """The angular velocity about the axes of the sensor, in rad/s."""
    read, read_pose = engine.velocity(robot, link), engine.pose(robot, link)
    back = frames.inverse(mount[1])

    def turning() -> Triple:
        return frames.rotate(frames.inverse(read_pose()[1]), read()[1])

    return Instrument(turning if mount[1] == UPRIGHT else lambda: frames.rotate(back, turning()))


def inclinometer(engine: Engine, robot: str, link: str, mount: Frame) -> Instrument:
    """The direction of gravity along the axes of the sensor, of length 1; nothing where there is no gravity."""
    read = mounted_pose(engine, robot, link, mount)
    down: Triple = (0.0, 0.0, -1.0)

    def restart(_generator: Any) -> None:
        nonlocal down
        strength = hypot(*engine.gravity)
        down = frames.scaled(engine.gravity, 1.0 / strength) if strength else (0.0, 0.0, 0.0)

    return Instrument(lambda: frames.rotate(frames.inverse(read()[1]), down), restart)


class Accelerometer:
    """The proper acceleration along the axes of the sensor, in m/s^2: 0 in free fall, 9.81 upwards at rest.

    As a real one does, it integrates between two readings: each engine step adds its change of velocity
    less gravity, turned into the frame as it stands halfway through the step. Before the first step of
    an episode it reads as at rest.
    """

    def __init__(self, engine: Engine, robot: str, link: str, mount: Frame, substep: float) -> None:
        self._engine = engine
        self._pose = mounted_pose(engine, robot, link, mount)
        self._velocity = mounted_velocity(engine, robot, link, mount)
        self._substep = substep
        self.restart()
        engine.after_substep(self._look)

    def restart(self, _generator: Any = None) -> None:
        self._gravity = self._engine.gravity
        self._before, self._turned = self._velocity()[0], self._pose()[1]
        self._sum: Triple = (0.0, 0.0, 0.0)
        self._steps = 0

    def _look(self) -> None:
        velocity, turned = self._velocity()[0], self._pose()[1]
        change = frames.subtract(velocity, self._before)
        fall = frames.scaled(self._gravity, self._substep)
        self._sum = frames.add(self._sum, frames.rotate(frames.inverse(_halfway(self._turned, turned)), frames.subtract(change, fall)))
        self._before, self._turned = velocity, turned
        self._steps += 1

    def read(self) -> Triple:
        if not self._steps:
            return frames.rotate(frames.inverse(self._turned), frames.scaled(self._gravity, -1.0))
        mean = frames.scaled(self._sum, 1.0 / (self._steps * self._substep))
        self._sum, self._steps = (0.0, 0.0, 0.0), 0
        return mean


def _halfway(a: Quaternion, b: Quaternion) -> Quaternion:
    """The attitude between two that are near each other."""
    sign = 1.0 if a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3] >= 0.0 else -1.0
    return frames.normalised((a[0] + sign * b[0], a[1] + sign * b[1], a[2] + sign * b[2], a[3] + sign * b[3]))
