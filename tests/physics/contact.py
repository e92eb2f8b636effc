"""Experiments on what slides, rolls, bounces and lies on the ground."""

from __future__ import annotations

from collections.abc import Iterator
from math import cos, degrees, pi, radians, sin, sqrt, tan

import numpy as np

from tests.physics import robots
from tests.physics.lab import off, trial
from tools.benchmarks.report import Row

G = 9.81


def slides(angle: float, crate: float, ramp: float) -> bool:
    """Whether a crate gets faster within a second on a ramp of a given angle (degrees), with the friction of
    both."""
    lean = radians(angle)
    x = 0.15 * sin(lean)
    z = 3 + 0.15 * cos(lean)
    objects = (
        f"ramp: {{shape: box, size: 8 2 0.2 m, fixed: true, friction: {ramp}, pose: {{z: 3 m, pitch:"
        f" {angle!r} deg}}}},"
        f" crate: {{shape: box, size: 0.2 0.2 0.1 m, mass: 1 kg, friction: {crate},"
        f" pose: {{x: {x!r} m, z: {z!r} m, pitch: {angle!r} deg}}}}"
    )
    with trial({"v": ("norm(velocity(crate))", "m/s")}, objects=objects) as world:
        speeds = world.run(100)[:, 0]
    return bool(speeds[100] > 0.02 and speeds[100] > speeds[50])


def friction() -> Iterator[Row]:
    """The angle from which on a crate slides is atan(mu1 mu2), found by bisection."""
    for crate, ramp in ((0.5, 1.0), (0.8, 0.7)):
        low, high = 5.0, 60.0
        while high - low > 0.05:
            middle = (low + high) / 2
            low, high = (low, middle) if slides(middle, crate, ramp) else (middle, high)
        coefficient = tan(radians((low + high) / 2))
        yield Row(
            f"friction {crate:g} on {ramp:g}: a crate slides from {degrees(np.arctan(coefficient)):.2f} deg on",
            off(coefficient, crate * ramp),
            "%",
            1.0,
        )


def rolling() -> Iterator[Row]:
    """Down a slope of angle a, what rolls without slipping gains g sin(a) / (1 + I / m r^2).

    A drum sinks into the ground by what the solver leaves of an overlap, and so rolls on less than its
    radius; a ball does not.
    """
    angle = radians(10)
    gravity = f"ground: {{}}, gravity: {G * sin(angle)!r} 0 {-G * cos(angle)!r} m/s^2"
    ball = "shape: sphere, radius: 10 cm, mass: 1 kg, pose: {z: 10 cm}"
    drum = "shape: cylinder, radius: 10 cm, height: 20 cm, mass: 1 kg, pose: {z: 10 cm, roll: 90 deg}"
    for what, shape, share, substeps, bar in (
        ("ball, physics steps of 5 ms", ball, 2 / 5, 4, 0.1),
        ("drum, physics steps of 2.5 ms (it sinks in a little)", drum, 1 / 2, 8, 1.5),
        ("drum, physics steps of 0.6 ms", drum, 1 / 2, 32, 1.0),
    ):
        with trial(
            {"v": ("velocity(thing).x", "m/s")},
            world=gravity,
            objects=f"thing: {{{shape}}}",
            substeps=substeps,
        ) as world:
            v = world.run(50)[-1, 0]
        yield Row(f"speed after rolling down for 1 s: {what}", off(v, G * sin(angle) / (1 + share)), "%", bar)


def wheels() -> Iterator[Row]:
    """The shipped rover drives at radius times rate, and turns at the difference of its wheels over its
    track.

    A tire of 2 cm may grip anywhere across its width. Where both grip on their outer edge of the turn, the
    turning rate is the same and the middle of the axle faster or slower by that rate times 1 cm, which is 3.7
    % in this arc.
    """
    track, radius, right = 0.136, 0.04, 5.0
    for what, left, bar in (
        ("straight on", 5.0, 0.1),
        ("in an arc (tires 2 cm wide grip anywhere)", 3.0, 4.0),
    ):
        robot = (
            "urdf: rover, sensors: {pace: {type: velocity, link: base_link}, gyro: {type: gyro, link:"
            " base_link}}, emit: [pace, gyro],"
            " actuators: {left: {type: velocity_motor, joint: left_wheel, max_torque: 1 N*m},"
            " right: {type: velocity_motor, joint: right_wheel, max_torque: 1 N*m}},"
            f" apply: {{left: push * {left} rad/s, right: push * {right} rad/s}}"
        )
        see = {"subject.pace": ("", "m/s"), "subject.gyro": ("", "rad/s")}
        with trial(see, robot=robot, reset="place: {subject: {z: 40 mm}}", substeps=8) as world:
            rows = world.run(100, push=1.0)[50:]
        speed, turn = float(np.mean(np.hypot(rows[:, 0], rows[:, 1]))), float(np.mean(rows[:, 5]))
        yield Row(f"wheels that roll {what}: speed", off(speed, radius * (left + right) / 2), "%", bar)
        if left != right:
            yield Row(
                "wheels that roll in an arc: turning rate",
                off(turn, radius * (right - left) / track),
                "%",
                0.1,
            )


def restitution() -> Iterator[Row]:
    """Share of the speed that a ball keeps, of what both bodies state: a little more, the longer the physics
    step."""
    for share, step, bar in ((0.5, 1, 2.0), (0.8, 1, 2.0), (0.8, 4, 5.0)):
        ball = f"ball: {{shape: sphere, radius: 5 cm, mass: 100 g, restitution: {share}, pose: {{z: 30 cm}}}}"
        with trial(
            {"v": ("velocity(ball).z", "m/s")},
            timestep=step / 1000,
            substeps=1,
            world="ground: {restitution: 1}",
            objects=ball,
        ) as world:
            v = world.run(400 // step)[:, 0]
        left = share * sqrt(2 * G * 0.25)
        yield Row(
            f"a ball that keeps {share:g} of its speed, physics steps of {step} ms",
            off(float(v.max()), left),
            "%",
            bar,
        )


def heights() -> Iterator[Row]:
    """Where rays downwards meet the ground: of hills as their formula says, and of a pit, h g (1 - g) with g
    = 2^-(r/R)^2."""
    robot = (
        "urdf: brick.urdf, base: fixed, sensors: {eye: {type: laser, link: brick, pose: {pitch: 90 deg},"
        " range: 0 .. 20 m}}, emit: [eye]"
    )

    def hills(x: float, y: float) -> float:
        return 0.5 * sin(x * pi / 3) * cos(y * pi / 4)

    def pit(x: float, y: float) -> float:
        bell = 0.5 ** ((x * x + y * y) / 2.7**2)
        return 3.2 * bell * (1 - bell)

    for what, terrain, tall, expected in (
        (
            "hills of 0.5 m",
            "formula, heights: 0.5 m * sin(x / m * 60 deg) * cos(y / m * 45 deg), size: 8 8 m",
            0.5,
            hills,
        ),
        ("a pit of 0.8 m", "pit, height: 3.2 m, radius: 2.7 m", 0.8, pit),
    ):
        worst = 0.0
        for x, y in ((0.33, 0.21), (-1.47, 0.9), (2.05, -1.13), (1.5, 0.0)):
            with trial(
                {"subject.eye": ("", "m")},
                world=f"terrain: {{type: {terrain}}}",
                robot=robot,
                reset=f"place: {{subject: {{x: {x} m, y: {y} m, z: 5 m}}}}",
                files={"brick.urdf": robots.BRICK},
            ) as world:
                distance = world.run(1)[0, 0]
                above = world.environment.engine.pose("subject")()[0][2]
            worst = max(worst, abs(above - distance - expected(x, y)))
        yield Row(f"heights of {what}, of its height", 100 * worst / tall, "%", 1.0)
