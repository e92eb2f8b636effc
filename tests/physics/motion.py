"""Experiments on what flies, swings, turns and is driven, without contacts."""

from __future__ import annotations

from collections.abc import Iterator
from math import cos, hypot, pi, radians, sin, sqrt

import numpy as np

from deepbots_cli import api
from tests.physics import robots
from tests.physics.lab import ENGINE, off, trial
from tests.worlds import SCENARIOS
from tools.benchmarks.report import Row

G = 9.81
FLOATING = "ground: {}, gravity: 0 0 0 m/s^2"
BRICK = "urdf: brick.urdf, pose: {z: 5 m}"
MASS = 2.0
SIDES = (0.1, 0.2, 0.3)


def free_fall() -> Iterator[Row]:
    ball = "ball: {shape: sphere, radius: 5 cm, mass: 1 kg, pose: {z: 10 m}}"
    with trial({"z": ("position(ball).z", "m"), "v": ("velocity(ball).z", "m/s")}, objects=ball) as world:
        z, v = world.run(50)[-1]
    yield Row("free fall for 1 s, physics steps of 5 ms: height lost", off(10 - z, G / 2), "%", 1.0)
    yield Row("free fall for 1 s: speed", off(v, -G), "%", 0.1)


def period(amplitude: float, substeps: int) -> float:
    """Mean time between two passages downwards through the lowest point, s, of a rod let go at an angle
    (degrees)."""
    subject = "urdf: pendulum.urdf, base: fixed, pose: {z: 3 m}"
    with trial(
        {"angle": ("joint_position(subject.hinge)", "rad")},
        timestep=0.01,
        substeps=substeps,
        robot=subject,
        reset=f"joints: {{subject.hinge: {amplitude} deg}}",
        files={"pendulum.urdf": robots.PENDULUM},
    ) as world:
        angle = world.run(1500)[:, 0]
        time = world.times(1500)
    passages = np.flatnonzero((angle[:-1] > 0) & (angle[1:] <= 0))
    moments = time[passages] + 0.01 * angle[passages] / (angle[passages] - angle[passages + 1])
    return float(np.mean(np.diff(moments)))


def pendulum() -> Iterator[Row]:
    """A rod of length L swings with 2 pi sqrt(2 L / 3 g) / agm(1, cos(amplitude / 2)): the complete elliptic
    integral."""
    for amplitude in (5.0, 90.0, 150.0):
        a = 1.0
        b = cos(radians(amplitude) / 2)
        while abs(a - b) > 1e-15:
            a, b = (a + b) / 2, sqrt(a * b)
        yield Row(
            f"period of a rod that swings by {amplitude:g} deg",
            off(period(amplitude, 5), 2 * pi * sqrt(2 / (3 * G)) / a),
            "%",
            0.5,
        )


def conical_pendulum() -> Iterator[Row]:
    """A rod of length L on a ball joint goes round at an angle a to the vertical, at w = sqrt(3 g / (2 L cos
    a)), in 2 pi / w."""
    angle = radians(30.0)
    tick = 0.01
    rate = sqrt(1.5 * G / cos(angle))
    subject = (
        "urdf: pendulum.urdf, base: fixed, pose: {z: 3 m}, sensors: {end: {type: position, link: rod,"
        " pose: {z: -1 m}}}, emit: [end]"
    )
    start = (
        f"subject.ball_x: {angle} rad, subject.ball_y: {{position: 0 deg, velocity: {rate * sin(angle)}"
        f" rad/s}}"
    )
    with trial(
        {"subject.end": ("", "m")},
        timestep=tick,
        substeps=10,
        robot=subject,
        reset=f"joints: {{{start}}}",
        files={"pendulum.urdf": robots.BALL_PENDULUM},
    ) as world:
        ticks = 400
        x, y, z = world.run(ticks)[:, :3].T
    turned = np.unwrap(np.arctan2(y, x))[-1] - np.arctan2(y[0], x[0])
    yield Row("conical pendulum on a ball joint: rate", off(abs(turned) / (ticks * tick), rate), "%", 0.5)
    yield Row(
        "conical pendulum on a ball joint: height of its end, of 13 cm",
        100 * float(np.ptp(z)) / (1 - cos(angle)),
        "%",
        2.0,
    )


def circular_motion() -> Iterator[Row]:
    """A point at 0.5 m of an arm that turns freely: it stays on its circle, and its velocity turns at w^2
    r."""
    rate, arm, tick = 3.0, 0.5, 0.01
    subject = (
        "urdf: arm.urdf, base: fixed, sensors: {spot: {type: position, link: arm, pose: {x: 50 cm}},"
        " pace: {type: velocity, link: arm, pose: {x: 50 cm}}}, emit: [spot, pace]"
    )
    with trial(
        {"subject.spot": ("", "m"), "subject.pace": ("", "m/s")},
        timestep=tick,
        robot=subject,
        reset=f"joints: {{subject.hinge: {{position: 0 deg, velocity: {rate} rad/s}}}}",
        files={"arm.urdf": robots.ARM},
    ) as world:
        rows = world.run(300)
        time = world.times(300)
    circle = arm * np.array([np.cos(rate * time), np.sin(rate * time)]).T
    yield Row(
        "a turning arm: the way of a point on it, of its radius",
        100 * np.abs(rows[:, :2] - circle).max() / arm,
        "%",
        0.1,
    )
    change = (rows[2:, 3:5] - rows[:-2, 3:5]) / (2 * tick)
    inwards = -np.sum(change * circle[1:-1], axis=1) / arm
    yield Row(
        "a turning arm: centripetal acceleration", off(float(np.mean(inwards)), rate**2 * arm), "%", 0.1
    )


def torque_limit() -> Iterator[Row]:
    """A motor that may exert 10 N accelerates 1.5 kg by 10 / 1.5 m/s^2, however many substeps there are."""
    for substeps in (1, 2, 8, 32):
        subject = (
            "urdf: cart.urdf, base: fixed, pose: {z: 3 m},"
            " actuators: {motor: {type: velocity_motor, joint: slider, max_torque: 10 N}}, apply: {motor:"
            " push * 1000 m/s}"
        )
        with trial(
            {"v": ("joint_velocity(subject.slider)", "m/s")},
            substeps=substeps,
            robot=subject,
            files={"cart.urdf": robots.CART},
        ) as world:
            v = world.run(20, push=1.0)[-1, 0]
        yield Row(
            f"a motor at its limit, {substeps} substeps: speed gained", off(v, 10 / 1.5 * 0.4), "%", 0.1
        )


def lag() -> Iterator[Row]:
    subject = (
        "urdf: cart.urdf, base: fixed, pose: {z: 3 m},"
        " actuators: {motor: {type: velocity_motor, joint: slider, max_torque: 100 kN, time_constant: 100"
        " ms}},"
        " apply: {motor: push * 1 m/s}"
    )
    with trial(
        {"v": ("joint_velocity(subject.slider)", "m/s")}, robot=subject, files={"cart.urdf": robots.CART}
    ) as world:
        v = world.run(30, push=1.0)[:, 0]
        time = world.times(30)
    worst = np.abs(v - (1 - np.exp(-time / 0.1))).max()
    yield Row("a motor with a lag of 100 ms: step response, of the step", 100 * float(worst), "%", 0.1)


def pushed(changes: str, disturbance: str, ticks: int = 30) -> tuple[float, float]:
    """The gain of a brick in speed along x (m/s) and in turning about z (rad/s) from a push."""
    with trial(
        {"v": ("velocity(subject).x", "m/s"), "w": ("angular_velocity(subject).z", "rad/s")},
        world=FLOATING,
        robot=f"{BRICK}, {changes}" if changes else BRICK,
        disturbances=f"push: {{body: subject, {disturbance}, at: 0 s, duration: 0.1 s}}",
        files={"brick.urdf": robots.BRICK},
    ) as world:
        v, w = world.run(ticks)[-1]
    return float(v), float(w)


def momentum() -> Iterator[Row]:
    v, _ = pushed("", "force: 4 0 0 N")
    yield Row("a push of 4 N for 0.1 s: momentum", off(MASS * v, 0.4), "%", 0.1)
    _, w = pushed("", "torque: 0 0 0.01 N*m", ticks=6)
    yield Row(
        "a twist of 10 mN m for 0.1 s: angular momentum", off(MASS / 12 * (0.01 + 0.04) * w, 0.001), "%", 0.1
    )


def changed_bodies() -> Iterator[Row]:
    """Mass and inertia of a homogeneous box with other sides or another mass, felt as answers to a force and
    to a torque."""
    for what, changes, mass, sides in (
        ("scale: 2 1 1.5", "links: {brick: {scale: 2 1 1.5}}", 3 * MASS, (0.2, 0.2, 0.45)),
        ("scale: 1 3 1, mass: 5 kg", "links: {brick: {scale: 1 3 1, mass: 5 kg}}", 5.0, (0.1, 0.6, 0.3)),
        ("mass: urdf * 0.4", "links: {brick: {mass: urdf * 0.4}}", 0.4 * MASS, SIDES),
        ("a drawn mass", "links: {brick: {mass: urdf * uniform(3 .. 3.0001)}}", 3 * MASS, SIDES),
    ):
        v, _ = pushed(changes, "force: 4 0 0 N")
        _, w = pushed(changes, "torque: 0 0 0.01 N*m", ticks=6)
        yield Row(f"{what}: mass", off(0.4 / v, mass), "%", 0.1)
        yield Row(
            f"{what}: moment of inertia",
            off(0.001 / w, mass / 12 * (sides[0] ** 2 + sides[1] ** 2)),
            "%",
            0.1,
        )


def hover() -> Iterator[Row]:
    """Thrust that balances the weight: what is left to fall, of what a fall would be."""
    scenario = SCENARIOS / "drone.yaml"
    weight = (0.02572680943 + 4 * 0.0005) * G
    overrides = (
        "disturbances={}",
        "reset={place: {drone: {z: 1 m}}}",
        f"parameters.hover={weight / 4!r} N",
        "robots.drone.actuators.rotors={type: thrust, links: [prop_*], range: 0 .. 0.15 N}",
    )
    environment = api.make(str(scenario), overrides=overrides, engine=ENGINE.get())
    try:
        environment.reset(seed=0)
        for _ in range(100):
            environment.step(np.zeros(4, np.float32))
        (x, y, z), _ = environment.engine.pose("drone")()
    finally:
        environment.close()
    yield Row("hovering for 1 s: drift, of a fall", 100 * hypot(x, y, z - 1) / (G / 2), "%", 0.01)
