"""Experiments on what robots feel and measure: inertial sensors and rays."""

from __future__ import annotations

from collections.abc import Iterator
from math import cos, radians, sin

import numpy as np

from tests.physics import robots
from tests.physics.lab import off, trial
from tools.benchmarks.report import Row

G = 9.81
INERTIAL = (
    "sensors: {accel: {type: accelerometer, link: brick}, gyro: {type: gyro, link: brick}, down: {type:"
    " projected_gravity, link: brick}},"
    " emit: [accel, gyro, down]"
)
SEEN = {"subject.accel": ("", "m/s^2"), "subject.gyro": ("", "rad/s"), "subject.down": ("", "")}
FILES = {"brick.urdf": robots.BRICK, "arm.urdf": robots.ARM}


def at_rest() -> Iterator[Row]:
    with trial(
        SEEN, robot=f"urdf: brick.urdf, {INERTIAL}", reset="place: {subject: {z: 0.15 m}}", files=FILES
    ) as world:
        rows = world.run(100)
    error = np.abs(rows[50:, :3] - (0, 0, G)).max()
    yield Row("accelerometer at rest, of g", 100 * float(error) / G, "%", 0.1)


def in_free_fall() -> Iterator[Row]:
    tumbling = (
        "place: {subject: {z: 50 m, rpy: 20 30 40 deg, velocity: 1 2 3 m/s, angular_velocity: 0 0 0 rad/s}}"
    )
    with trial(SEEN, robot=f"urdf: brick.urdf, {INERTIAL}", reset=tumbling, files=FILES) as world:
        rows = world.run(100)
    yield Row("accelerometer in free fall, of g", 100 * float(np.abs(rows[1:, :3]).max()) / G, "%", 0.1)


def on_a_slope() -> Iterator[Row]:
    """A brick that lies still on a ramp that falls towards its left feels g leaning by the angle of the
    ramp."""
    angle = radians(20)
    ramp = "ramp: {shape: box, size: 4 4 0.2 m, fixed: true, friction: 1, pose: {z: 0.5 m, roll: -20 deg}}"
    y = 0.25 * sin(angle)
    z = 0.5 + 0.25 * cos(angle)
    place = f"place: {{subject: {{y: {y!r} m, z: {z!r} m, roll: -20 deg}}}}"
    with trial(SEEN, objects=ramp, robot=f"urdf: brick.urdf, {INERTIAL}", reset=place, files=FILES) as world:
        rows = world.run(150)
    accel = rows[100:, :3].mean(axis=0)
    down = rows[-1, 6:9]
    upwards = np.array([0, -sin(angle), cos(angle)])
    yield Row(
        "accelerometer on a slope of 20 deg, of g", 100 * float(np.linalg.norm(accel / G - upwards)), "%", 1.0
    )
    yield Row("inclinometer on a slope of 20 deg", 100 * float(np.linalg.norm(down + upwards)), "%", 1.0)


def on_a_turning_arm() -> Iterator[Row]:
    """At 0.5 m from the hinge: w^2 r inwards and g upwards; a gyro that lies on its side feels w about its
    own x axis."""
    rate = 4.0
    subject = (
        "urdf: arm.urdf, base: fixed, pose: {z: 2 m},"
        " sensors: {accel: {type: accelerometer, link: arm, pose: {x: 50 cm}}, gyro: {type: gyro, link: arm,"
        " pose: {pitch: 90 deg}}},"
        " emit: [accel, gyro]"
    )
    start = f"joints: {{subject.hinge: {{position: 0 deg, velocity: {rate} rad/s}}}}"
    with trial(
        {"subject.accel": ("", "m/s^2"), "subject.gyro": ("", "rad/s")},
        robot=subject,
        reset=start,
        files=FILES,
    ) as world:
        rows = world.run(50)
    expected = np.array([-(rate**2) * 0.5, 0, G])
    error = float(np.linalg.norm(rows[1:, :3].mean(axis=0) - expected) / np.linalg.norm(expected))
    yield Row("accelerometer on a turning arm", 100 * error, "%", 1.0)
    yield Row(
        "gyro on a turning arm", 100 * float(np.abs(rows[1:, 3:] - (-rate, 0, 0)).max()) / rate, "%", 0.1
    )


def gyro_of_a_floating_body() -> Iterator[Row]:
    spin = "place: {subject: {z: 5 m, rpy: 0 0 30 deg, angular_velocity: 0 0 2 rad/s}}"
    with trial(
        SEEN,
        world="gravity: 0 0 0 m/s^2, ground: {}",
        robot=f"urdf: brick.urdf, {INERTIAL}",
        reset=spin,
        files=FILES,
    ) as world:
        rows = world.run(50)
    yield Row(
        "gyro of a body that spins freely", 100 * float(np.abs(rows[:, 3:6] - (0, 0, 2)).max()) / 2, "%", 0.1
    )


def inclination() -> Iterator[Row]:
    lean = "joints: {}, place: {subject: {z: 5 m, rpy: 25 -40 100 deg}}"
    with trial(
        SEEN, world="gravity: 0 0 -1 mm/s^2", robot=f"urdf: brick.urdf, {INERTIAL}", reset=lean, files=FILES
    ) as world:
        down = world.run(1)[0, 6:9]
    roll, pitch = radians(25), radians(-40)
    expected = (sin(pitch), -sin(roll) * cos(pitch), -cos(roll) * cos(pitch))
    yield Row("inclinometer at any attitude", 100 * float(np.abs(down - expected).max()), "%", 0.1)


def rays() -> Iterator[Row]:
    """Fans of rays to a wall 1 m away and to a ball of 0.3 m whose center is 1 m away, from a base and from a
    link that turns."""
    wall = "wall: {shape: box, size: 0.2 20 2 m, fixed: true, pose: {x: 1.1 m, z: 0.5 m}}"
    ball = "ball: {shape: sphere, radius: 30 cm, fixed: true, pose: {x: 1 m, z: 0.5 m}}"
    angles = np.radians(np.linspace(15, -15, 7))
    to_wall = 1 / np.cos(angles)
    to_ball = np.cos(angles) - np.sqrt(0.3**2 - np.sin(angles) ** 2)
    fan = (
        "emit: [eye], sensors: {eye: {type: lidar, link: %s, angle_range: 15 .. -15 deg, rays: 7, range: 0"
        " .. 5 m}}"
    )
    base = "urdf: brick.urdf, base: fixed, pose: {z: 0.5 m}, " + fan % "brick"
    link = "urdf: arm.urdf, base: fixed, pose: {z: 0.5 m, yaw: -50 deg}, " + fan % "arm"
    for what, objects, expected in (("a wall", wall, to_wall), ("a ball", ball, to_ball)):
        for whence, robot, reset in (
            ("a base", base, ""),
            ("a link that turns", link, "joints: {subject.hinge: 50 deg}"),
        ):
            with trial(
                {"subject.eye": ("", "m")}, objects=objects, robot=robot, reset=reset, files=FILES
            ) as world:
                distances = world.run(1)[0]
            yield Row(f"rays from {whence} to {what}", max(map(off, distances, expected)), "%", 0.1)


def rays_while_turning() -> Iterator[Row]:
    """A ray on an arm that turns by 1 rad/s, in front of a wall: the distance grows with the angle."""
    wall = "wall: {shape: box, size: 0.2 20 2 m, fixed: true, pose: {x: 1.1 m, z: 0.5 m}}"
    robot = (
        "urdf: arm.urdf, base: fixed, pose: {z: 0.5 m},"
        " sensors: {eye: {type: laser, link: arm, pose: {x: 30 cm}, range: 0 .. 5 m}}, emit: [eye]"
    )
    start = "joints: {subject.hinge: {position: 0 deg, velocity: 1 rad/s}}"
    with trial({"subject.eye": ("", "m")}, objects=wall, robot=robot, reset=start, files=FILES) as world:
        distances = world.run(50)[:, 0]
        time = world.times(50)
    expected = 1 / np.cos(time) - 0.3
    yield Row("a ray from an arm while it turns", max(map(off, distances, expected)), "%", 0.1)
