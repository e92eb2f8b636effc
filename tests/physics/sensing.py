"""Scenarios as texts, up to what a policy sees: sensors, rays, changed bodies, pushes, thrusts and lagging
motors."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from math import cos, hypot, pi, radians, sin, sqrt
from typing import Any

import numpy as np

from tests.physics.case import Array, Case, G, most, near, trial

_STAND = '<link name="stand"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
FILES = {
    # A homogeneous box of 2 kg, 10 x 20 x 30 cm.
    "brick.urdf": """<robot name="brick"><link name="brick">
    <inertial><mass value="2"/><inertia ixx="0.0216666666666667" iyy="0.0166666666666667" izz="0.00833333333333333" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><geometry><box size="0.1 0.2 0.3"/></geometry></collision></link></robot>""",
    # A thin rod of 1 m and 0.3 kg, which hangs from its end on a ball joint.
    "pendulum.urdf": f"""<robot name="pendulum">{_STAND}<link name="rod">
    <inertial><origin xyz="0 0 -0.5"/><mass value="0.3"/><inertia ixx="0.025" iyy="0.025" izz="1e-6" ixy="0" ixz="0" iyz="0"/></inertial></link>
    <joint name="ball" type="spherical"><parent link="stand"/><child link="rod"/><axis xyz="0 1 0"/></joint></robot>""",
    # A mass on a rail.
    "cart.urdf": f"""<robot name="cart">{_STAND}<link name="cart">
    <inertial><mass value="1.5"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
    <joint name="slider" type="prismatic"><parent link="stand"/><child link="cart"/><axis xyz="1 0 0"/><limit lower="-100" upper="100" effort="1000000" velocity="10000"/></joint></robot>""",
    # A link on a vertical hinge.
    "arm.urdf": f"""<robot name="arm">{_STAND}<link name="arm">
    <inertial><origin xyz="0.25 0 0"/><mass value="1"/><inertia ixx="0.01" iyy="0.05" izz="0.05" ixy="0" ixz="0" iyz="0"/></inertial></link>
    <joint name="hinge" type="continuous"><parent link="stand"/><child link="arm"/><axis xyz="0 0 1"/><limit effort="1000" velocity="100"/></joint></robot>""",
}
BRICK = "urdf: brick.urdf"
INERTIAL = (
    f"{BRICK}, sensors: {{accel: {{type: accelerometer, link: brick}}, gyro: {{type: gyro, link: brick}},"
    " down: {type: projected_gravity, link: brick}}, emit: [accel, gyro, down]"
)
SEEN = {"subject.accel": ("", "m/s^2"), "subject.gyro": ("", "rad/s"), "subject.down": ("", "")}
MASS, SIDES = 2.0, (0.1, 0.2, 0.3)


def largest(values: Any, scale: float = 1.0) -> float:
    """Return the largest absolute value, in percent of a scale."""
    return 100 * float(np.abs(values).max()) / scale


def inertial(ticks: int, engine: str, **world: str) -> Array:
    """What a brick feels after the reset and in some timesteps: accelerations, rates, and the direction
    downwards."""
    with trial(engine, SEEN, robot=INERTIAL, files=FILES, **world) as running:  # type: ignore[arg-type]
        return running.run(ticks)


# Inertial sensors


def felt(columns: slice, truth: Any, scale: float, rows: slice, engine: str, **world: str) -> tuple[float]:
    """The largest error of what a brick feels in some rows of 101, in percent of a scale."""
    return (largest(inertial(100, engine, **world)[rows, columns] - truth, scale),)


def on_a_slope(engine: str) -> tuple[float, float]:
    """A brick on a ramp that falls towards its left."""
    angle = radians(20)
    ramp = "ramp: {shape: box, size: 4 4 0.2 m, fixed: true, friction: 1, pose: {z: 0.5 m, roll: -20 deg}}"
    place = (
        f"place: {{subject: {{y: {0.25 * sin(angle)!r} m, z: {0.5 + 0.25 * cos(angle)!r} m, roll: -20 deg}}}}"
    )
    rows = inertial(150, engine, objects=ramp, reset=place)
    upwards = np.array([0, -sin(angle), cos(angle)])
    return largest(rows[100:, :3].mean(axis=0) / G - upwards), largest(rows[-1, 6:9] + upwards)


def on_a_turning_arm(engine: str) -> tuple[float, float]:
    """At 0.5 m from the hinge: w^2 r inwards and g upwards; a gyro that lies on its side feels w about its
    own x axis."""
    robot = (
        "urdf: arm.urdf, base: fixed, pose: {z: 2 m}, emit: [accel, gyro], sensors: {accel: {type:"
        " accelerometer, link: arm, pose: {x: 50 cm}}, gyro: {type: gyro, link: arm, pose: {pitch: 90 deg}}}"
    )
    start = "joints: {subject.hinge: {position: 0 deg, velocity: 4 rad/s}}"
    see = {"subject.accel": ("", "m/s^2"), "subject.gyro": ("", "rad/s")}
    with trial(engine, see, robot=robot, reset=start, files=FILES) as running:
        rows = running.run(50)
    return (
        largest(rows[1:, :3].mean(axis=0) - (-8, 0, G), hypot(8, G)),
        largest(rows[1:, 3:] - (-4, 0, 0), 4),
    )


# Rays


def fan(robot: str, reset: str, objects: str, expected: Array, engine: str) -> tuple[float]:
    eye = "emit: [eye], sensors: {eye: {type: lidar, link: %s, angle_range: 15 .. -15 deg, rays: 7, range: 0 .. 5 m}}"
    with trial(
        engine,
        {"subject.eye": ("", "m")},
        objects=objects,
        robot=f"{robot}, {eye % robot[6:-1].split('.')[0]}",
        reset=reset,
        files=FILES,
    ) as running:
        return (largest(running.run(1)[0] / expected - 1),)


def ray_while_turning(engine: str) -> tuple[float]:
    """A ray on an arm that turns by 1 rad/s, in front of a wall: the distance grows with the angle."""
    robot = (
        "urdf: arm.urdf, base: fixed, pose: {z: 0.5 m}, emit: [eye],"
        " sensors: {eye: {type: laser, link: arm, pose: {x: 30 cm}, range: 0 .. 5 m}}"
    )
    start = "joints: {subject.hinge: {position: 0 deg, velocity: 1 rad/s}}"
    with trial(
        engine, {"subject.eye": ("", "m")}, objects=WALL, robot=robot, reset=start, files=FILES
    ) as running:
        distances, time = running.run(50)[:, 0], running.times(50)
    return (largest(distances / (1 / np.cos(time) - 0.3) - 1),)


def heights(terrain: str, formula: Callable[[float, float], float], engine: str) -> tuple[float]:
    """The largest error (cm) of the heights that a ray downwards meets."""
    robot = (
        f"{BRICK}, base: fixed, emit: [eye], sensors: {{eye: {{type: laser, link: brick, pose: {{pitch: 90 deg}},"
        " range: 0 .. 20 m}}"
    )
    see = {"subject.eye": ("", "m"), "above": ("position(subject).z", "m")}
    errors = []
    for x, y in ((0.33, 0.21), (-1.47, 0.9), (2.05, -1.13), (1.5, 0.0)):
        start = f"place: {{subject: {{x: {x} m, y: {y} m, z: 5 m}}}}"
        with trial(
            engine, see, world=f"terrain: {{type: {terrain}}}", robot=robot, reset=start, files=FILES
        ) as running:
            distance, above = running.run(1)[0]
        errors.append(above - distance - formula(x, y))
    return (largest(errors),)


def hills(x: float, y: float) -> float:
    return 0.5 * sin(x * pi / 3) * cos(y * pi / 4)


def pit(x: float, y: float) -> float:
    bell = 2 ** -((x * x + y * y) / 2.7**2)
    return float(3.2 * bell * (1 - bell))


# Motion


def conical(engine: str) -> tuple[float, float]:
    """A rod of length L on a ball joint goes round at an angle a to the vertical; the rate, and by how much
    its end rises and falls, in cm."""
    robot = (
        "urdf: pendulum.urdf, base: fixed, pose: {z: 3 m}, emit: [end],"
        " sensors: {end: {type: position, link: rod, pose: {z: -1 m}}}"
    )
    angle = radians(30)
    start = f"subject.ball_x: {angle} rad, subject.ball_y: {{position: 0 deg, velocity: {CONE * sin(angle)} rad/s}}"
    with trial(
        engine,
        {"subject.end": ("", "m")},
        timestep=0.01,
        substeps=10,
        robot=robot,
        reset=f"joints: {{{start}}}",
        files=FILES,
    ) as running:
        x, y, z = running.run(400)[:, :3].T
    turned = np.unwrap(np.arctan2(y, x))
    return abs(turned[-1] - turned[0]) / 4, 100 * float(np.ptp(z))


def circle(engine: str) -> tuple[float, float]:
    """A point at 0.5 m of an arm that turns freely: it stays on its circle, and its velocity turns at w^2
    r."""
    robot = (
        "urdf: arm.urdf, base: fixed, emit: [spot, pace], sensors: {spot: {type: position, link: arm, pose:"
        " {x: 50 cm}}, pace: {type: velocity, link: arm, pose: {x: 50 cm}}}"
    )
    start = "joints: {subject.hinge: {position: 0 deg, velocity: 3 rad/s}}"
    see = {"subject.spot": ("", "m"), "subject.pace": ("", "m/s")}
    with trial(engine, see, timestep=0.01, robot=robot, reset=start, files=FILES) as running:
        rows, time = running.run(300), running.times(300)
    way = 0.5 * np.array([np.cos(3 * time), np.sin(3 * time)]).T
    change = (rows[2:, 3:5] - rows[:-2, 3:5]) / 0.02
    return largest(rows[:, :2] - way, 0.5), float(np.mean(-np.sum(change * way[1:-1], axis=1) / 0.5))


def lag(urdf: str, engine: str) -> tuple[float]:
    robot = (
        f"urdf: {urdf}, base: fixed, pose: {{z: 3 m}}, actuators: {{motor: {{type: velocity_motor, joint:"
        " slider, max_torque: 100 kN, time_constant: 100 ms}}, apply: {motor: push * 1 m/s}"
    )
    see = {"v": ("joint_velocity(subject.slider)", "m/s")}
    with trial(engine, see, robot=robot, files=FILES) as running:
        v, time = running.run(30, push=1.0)[:, 0], running.times(30)
    return (largest(v - (1 - np.exp(-time / 0.1))),)


def pushed(changes: str, disturbance: str, engine: str, ticks: int = 6) -> tuple[float, float]:
    """The gain of a brick in speed along x (m/s) and in turning about z (rad/s) from a push of 0.1 s."""
    with trial(
        engine,
        {"v": ("velocity(subject).x", "m/s"), "w": ("angular_velocity(subject).z", "rad/s")},
        world="ground: {}, gravity: 0 0 0 m/s^2",
        robot=f"{BRICK}, pose: {{z: 5 m}}{changes and ', '}{changes}",
        disturbances=f"push: {{body: subject, {disturbance}, at: 0 s, duration: 0.1 s}}",
        files=FILES,
    ) as running:
        return tuple(running.run(ticks)[-1])


def inertia_felt(changes: str, engine: str) -> tuple[float, float]:
    """Mass (kg) and moment of inertia (g m^2) as answers to a force and to a torque."""
    v, _ = pushed(changes, "force: 4 0 0 N", engine)
    _, w = pushed(changes, "torque: 0 0 0.01 N*m", engine)
    return 0.4 / v, 1.0 / w


def thrust(engine: str) -> tuple[float, float, float]:
    """A brick that leans by 30 deg, under a thrust of its weight for 0.1 s: its speeds forwards and
    downwards, and the rate at which the drag of the rotor turns it about the axis of the thrust."""
    robot = (
        f"{BRICK}, actuators: {{jet: {{type: thrust, links: [brick], range: 0 .. 40 N, moment_constant: 1 mm,"
        f" spin: {{brick: 1}}}}}}, apply: {{jet: push * {MASS * G!r} N}}"
    )
    see = {
        "v": ("velocity(subject).x", "m/s"),
        "w": ("velocity(subject).z", "m/s"),
        "a": ("angular_velocity(subject).z", "rad/s"),
    }
    start = "place: {subject: {z: 5 m, pitch: 30 deg}}"
    with trial(engine, see, substeps=20, robot=robot, reset=start, files=FILES) as running:
        return tuple(running.run(5, push=1.0)[-1])


def hover(engine: str) -> tuple[float]:
    """How far a drone drifts in 1 s (mm) whose thrust balances its weight."""
    weight = (0.02572680943 + 4 * 0.0005) * G
    robot = (
        "urdf: quadrotor, actuators: {rotors: {type: thrust, links: [prop_*], range: 0 .. 0.15 N}},"
        f" apply: {{rotors: push * {weight / 4!r} N}}"
    )
    see = {"drift": ("hypot(norm(position(subject).xy), position(subject).z - 1 m)", "m")}
    with trial(engine, see, robot=robot, reset="place: {subject: {z: 1 m}}") as running:
        return (1000 * running.run(50, push=1.0)[-1, 0],)


# The table

ACCELERATION = slice(3)
LEAN = radians(25), radians(-40)
TUMBLING = (
    "place: {subject: {z: 50 m, rpy: 20 30 40 deg, velocity: 1 2 3 m/s, angular_velocity: 0 0 0 rad/s}}"
)
WALL = "wall: {shape: box, size: 0.2 20 2 m, fixed: true, pose: {x: 1.1 m, z: 0.5 m}}"
AHEAD = "ball: {shape: sphere, radius: 30 cm, fixed: true, pose: {x: 1 m, z: 0.5 m}}"
ANGLES = np.radians(np.linspace(15, -15, 7))
CONE = sqrt(1.5 * G / cos(radians(30)))
CASES = (
    Case(
        "a brick rests on the ground",
        partial(felt, ACCELERATION, (0, 0, G), G, slice(50, None), reset="place: {subject: {z: 0.15 m}}"),
        (most("error of its accelerometer, of g", 0.1, "%"),),
    ),
    Case(
        "a brick falls freely",
        partial(felt, ACCELERATION, 0, G, slice(1, None), reset=TUMBLING),
        (most("reading of its accelerometer, of g", 0.1, "%"),),
    ),
    Case(
        "a brick rests on 20 deg",
        on_a_slope,
        (most("error of its accelerometer, of g", 1.0, "%"), most("error of its inclinometer", 1.0, "%")),
    ),
    Case(
        "a brick spins freely",
        partial(
            felt,
            slice(3, 6),
            (0, 0, 2),
            2,
            slice(None),
            world="gravity: 0 0 0 m/s^2, ground: {}",
            reset="place: {subject: {z: 5 m, rpy: 0 0 30 deg, angular_velocity: 0 0 2 rad/s}}",
        ),
        (most("error of its gyro", 0.1, "%"),),
    ),
    Case(
        "a brick at an attitude",
        partial(
            felt,
            slice(6, 9),
            (sin(LEAN[1]), -sin(LEAN[0]) * cos(LEAN[1]), -cos(LEAN[0]) * cos(LEAN[1])),
            1,
            slice(1, 2),
            world="gravity: 0 0 -1 mm/s^2",
            reset="place: {subject: {z: 5 m, rpy: 25 -40 100 deg}}",
        ),
        (most("error of its inclinometer", 0.1, "%"),),
    ),
    Case(
        "sensors at 0.5 m on an arm that turns at 4 rad/s",
        on_a_turning_arm,
        (most("error of the accelerometer", 1.0, "%"), most("error of the gyro", 0.1, "%")),
    ),
    *(
        Case(
            f"rays from {whence} to {what}",
            partial(fan, robot, reset, objects, expected),
            (most("largest error", 0.1, "%"),),
        )
        for what, objects, expected in (
            ("a wall", WALL, 1 / np.cos(ANGLES)),
            ("a ball", AHEAD, np.cos(ANGLES) - np.sqrt(0.3**2 - np.sin(ANGLES) ** 2)),
        )
        for whence, robot, reset in (
            ("a base", "urdf: brick.urdf, base: fixed, pose: {z: 0.5 m}", ""),
            (
                "a link that turns",
                "urdf: arm.urdf, base: fixed, pose: {z: 0.5 m, yaw: -50 deg}",
                "joints: {subject.hinge: 50 deg}",
            ),
        )
    ),
    Case("a ray from an arm while it turns", ray_while_turning, (most("largest error", 0.1, "%"),)),
    *(
        Case(f"rays onto {name}", partial(heights, terrain, formula), (most("largest error", bar, "cm"),))
        for name, terrain, formula, bar in (
            (
                "hills of 0.5 m",
                "formula, heights: 0.5 m * sin(x / m * 60 deg) * cos(y / m * 45 deg), size: 8 8 m",
                hills,
                0.5,
            ),
            ("a pit of 0.8 m", "pit, height: 3.2 m, radius: 2.7 m", pit, 0.8),
        )
    ),
    Case(
        "a rod of 1 m on a ball joint goes round at 30 deg",
        conical,
        (near("rate, √(3g / 2L cos a)", CONE, "rad/s", 0.5), most("rise and fall of its end", 0.27, "cm")),
    ),
    Case(
        "a point at 0.5 m of an arm that turns freely at 3 rad/s",
        circle,
        (
            most("way beside its circle, of the radius", 0.1, "%"),
            near("acceleration, ω² r", 4.5, "m/s²", 0.1),
        ),
    ),
    *(
        Case(
            f"a motor with a lag of 100 ms drives {name}",
            partial(lag, urdf),
            (most("error of the step response", 0.1, "%"),),
        )
        for name, urdf in (("1.5 kg", "cart.urdf"), ("the cart of cartpole_rail", "cartpole_rail"))
    ),
    Case(
        "4 N for 0.1 s on 2 kg",
        lambda engine: pushed("", "force: 4 0 0 N", engine, 30)[:1],
        (near("speed, F t / m", 0.2, "m/s", 0.1),),
    ),
    *(
        Case(
            f"a brick with `{changes or 'no change'}` is pushed and twisted",
            partial(inertia_felt, f"links: {{brick: {{{changes}}}}}" if changes else ""),
            (
                near("mass", mass, "kg", 0.1),
                near("moment of inertia, m (a² + b²) / 12", 1000 * mass / 12 * (a * a + b * b), "g m²", 0.1),
            ),
        )
        for changes, mass, (a, b, _) in (
            ("", MASS, SIDES),
            ("scale: 2 1 1.5", 3 * MASS, (0.2, 0.2, 0.45)),
            ("scale: 1 3 1, mass: 5 kg", 5.0, (0.1, 0.6, 0.3)),
            ("mass: urdf * 0.4", 0.4 * MASS, SIDES),
            ("mass: urdf * uniform(3 .. 3.0001)", 3 * MASS, SIDES),
        )
    ),
    Case(
        "a brick that leans by 30 deg under a thrust of its weight for 0.1 s, drag at 1 mm",
        thrust,
        (
            near("speed forwards, g t sin a", G * 0.1 * 0.5, "m/s", 0.5),
            near("speed downwards, g t (cos a - 1)", G * 0.1 * (cos(pi / 6) - 1), "m/s", 1),
            near(
                "rate about z, F t d cos a / I",
                cos(pi / 6) * MASS * G * 0.1 * 0.001 / (MASS / 12 * 0.05),
                "rad/s",
                0.5,
            ),
        ),
    ),
    Case("a drone hovers for 1 s", hover, (most("drift", 0.5, "mm"),)),
)
