"""Robots whose masses and inertias are those of the textbooks.

Small scenarios whose motion has a closed form: from text to what the policy sees, so that a figure is what
a user gets.

Experiments on what slides, rolls, bounces and lies on the ground.

Experiments on what robots feel and measure: inertial sensors and rays.

Experiments on what flies, swings, turns and is driven, without contacts.

All experiments whose outcome is known in closed form, by name.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from math import cos, degrees, hypot, pi, radians, sin, sqrt, tan
from pathlib import Path
from typing import Any

import numpy as np

from deepbots_cli import api
from deepbots_cli.runtime import Supervisor
from tests.worlds import SCENARIOS
from tools.benchmarks.report import Row

BRICK = """<robot name="brick">
  <link name="brick">
    <inertial>
      <mass value="2"/>
      <inertia ixx="0.0216666666666667" iyy="0.0166666666666667" izz="0.00833333333333333" ixy="0" ixz="0" iyz="0"/>
    </inertial>
    <collision><geometry><box size="0.1 0.2 0.3"/></geometry></collision>
  </link>
</robot>
"""
"""A homogeneous box of 2 kg, 10 x 20 x 30 cm."""

PENDULUM = """<robot name="pendulum">
  <link name="stand"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="rod">
    <inertial>
      <origin xyz="0 0 -0.5"/><mass value="0.3"/>
      <inertia ixx="0.025" iyy="0.025" izz="1e-6" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
  <joint name="hinge" type="continuous"><parent link="stand"/><child link="rod"/><axis xyz="0 1 0"/></joint>
</robot>
"""
"""A thin rod of 1 m and 0.3 kg, which hangs from its end."""

BALL_PENDULUM = PENDULUM.replace('type="continuous"', 'type="spherical"').replace("hinge", "ball")
"""The same rod on a ball joint."""

ARM = """<robot name="arm">
  <link name="stand"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="arm">
    <inertial><origin xyz="0.25 0 0"/><mass value="1"/><inertia ixx="0.01" iyy="0.05" izz="0.05" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <joint name="hinge" type="continuous">
    <parent link="stand"/><child link="arm"/><axis xyz="0 0 1"/><limit effort="1000" velocity="100"/>
  </joint>
</robot>
"""
"""A link on a vertical hinge."""

CART = """<robot name="cart">
  <link name="rail"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="cart"><inertial><mass value="1.5"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="slider" type="prismatic">
    <parent link="rail"/><child link="cart"/><axis xyz="1 0 0"/><limit lower="-100" upper="100" effort="1000000" velocity="10000"/>
  </joint>
</robot>
"""
"""A mass of 1.5 kg on a rail."""


TEXT = """\
deepbots: 1
name: Trial
world: {{timestep: {timestep}, substeps: {substeps}{world}}}
objects: {{{objects}}}
robots: {{{robots}}}
action: {{push: -1 .. 1}}
augment: {{{augment}}}
observation: {{{observation}}}
reward: {{one: 1}}
truncation: {{max_steps: 1_000_000}}
reset: {{{reset}}}
disturbances: {{{disturbances}}}
"""
ENGINE = ContextVar("engine", default="pybullet")
"""The engine of all trials."""
BYSTANDER = (
    "bystander: {urdf: cartpole_rail, base: fixed, pose: {x: 50 m, z: 50 m},"
    " actuators: {motor: {type: torque_motor, joint: slider}}, apply: {motor: push * 0 N}}"
)
"""The one that acts where nobody else does: a scenario has an action."""


@dataclass(frozen=True)
class Trial:
    """A scenario that is running; its rows are in the units that the scenario names, one column for each
    thing seen."""

    environment: Supervisor
    timestep: float

    def run(self, ticks: int, push: float = 0.0, seed: int = 0) -> np.ndarray[Any, Any]:
        """The observations after the reset and after each of some ticks, float64[ticks + 1, columns]."""
        action = np.array([push], np.float32)
        rows = [self.environment.reset(seed=seed)[0]]
        rows += [self.environment.step(action)[0] for _ in range(ticks)]
        return np.array(rows, np.float64)

    def times(self, ticks: int) -> np.ndarray[Any, Any]:
        return self.timestep * np.arange(ticks + 1)


def flow(entries: dict[str, str]) -> str:
    return ", ".join(f"{name}: {value}" for name, value in entries.items())


def off(measured: float, expected: float, scale: float | None = None) -> float:
    """By how many percent of `scale`, or else of what is expected, a figure is off."""
    return float(100 * abs(measured - expected) / abs(expected if scale is None else scale))


@contextmanager
def trial(
    see: dict[str, tuple[str, str]],
    *,
    timestep: float = 0.02,
    substeps: int = 4,
    world: str = "",
    objects: str = "",
    robot: str = "",
    reset: str = "",
    disturbances: str = "",
    files: dict[str, str] | None = None,
) -> Iterator[Trial]:
    """Opens a scenario with a robot `subject`, or without one.

    `see` gives each thing that is seen its expression and unit; one whose name has a dot is a field of a
    message.
    """
    text = TEXT.format(
        timestep=f"{timestep!r} s",
        substeps=substeps,
        world=world and f", {world}",
        objects=objects,
        robots=", ".join(
            [*([f"subject: {{{robot}}}"] if robot else []), *([] if "apply:" in robot else [BYSTANDER])]
        ),
        augment=flow({name: f"'{expression}'" for name, (expression, _) in see.items() if "." not in name}),
        observation=flow(
            {name: f"{{range: -1 .. 1{unit and ' ' + unit}, clip: false}}" for name, (_, unit) in see.items()}
        ),
        reset=reset,
        disturbances=disturbances,
    )
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "pyproject.toml").touch()
        for file, content in {"trial.yaml": text, **(files or {})}.items():
            (folder / file).write_text(content, encoding="utf-8")
        with closing(api.make(folder / "trial.yaml", engine=ENGINE.get())) as environment:
            yield Trial(environment, timestep)


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
                files={"brick.urdf": BRICK},
            ) as world:
                distance = world.run(1)[0, 0]
                above = world.environment.engine.pose("subject")()[0][2]
            worst = max(worst, abs(above - distance - expected(x, y)))
        yield Row(f"heights of {what}, of its height", 100 * worst / tall, "%", 1.0)


INERTIAL = (
    "sensors: {accel: {type: accelerometer, link: brick}, gyro: {type: gyro, link: brick}, down: {type:"
    " projected_gravity, link: brick}},"
    " emit: [accel, gyro, down]"
)
SEEN = {"subject.accel": ("", "m/s^2"), "subject.gyro": ("", "rad/s"), "subject.down": ("", "")}
FILES = {"brick.urdf": BRICK, "arm.urdf": ARM}


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


FLOATING = "ground: {}, gravity: 0 0 0 m/s^2"
BRICK_ALOFT = "urdf: brick.urdf, pose: {z: 5 m}"
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
        files={"pendulum.urdf": PENDULUM},
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
        files={"pendulum.urdf": BALL_PENDULUM},
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
        files={"arm.urdf": ARM},
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
            files={"cart.urdf": CART},
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
        {"v": ("joint_velocity(subject.slider)", "m/s")}, robot=subject, files={"cart.urdf": CART}
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
        robot=f"{BRICK_ALOFT}, {changes}" if changes else BRICK_ALOFT,
        disturbances=f"push: {{body: subject, {disturbance}, at: 0 s, duration: 0.1 s}}",
        files={"brick.urdf": BRICK},
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


EXPERIMENTS: dict[str, Callable[[], Iterable[Row]]] = {
    experiment.__name__: experiment
    for experiment in (
        free_fall,
        pendulum,
        conical_pendulum,
        circular_motion,
        torque_limit,
        lag,
        momentum,
        changed_bodies,
        hover,
        at_rest,
        in_free_fall,
        on_a_slope,
        on_a_turning_arm,
        gyro_of_a_floating_body,
        inclination,
        rays,
        rays_while_turning,
        friction,
        rolling,
        wheels,
        restitution,
        heights,
    )
}
