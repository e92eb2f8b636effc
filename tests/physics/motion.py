"""Bodies that fall and turn freely, and joints: swinging, damped, sprung, at their limits, and driven."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from math import cos, cosh, log1p, pi, radians, sqrt
from pathlib import Path
from typing import Any

import numpy as np

from deepbots_cli import frames
from deepbots_cli.program.world import ObjectBody, RobotBody, WorldModel
from deepbots_cli.robots.model import Inertial, Joint, Limit, Link, Mimic, Pose, RobotModel, Sphere, Vector
from tests.physics.case import ALL, PORT, Array, Bench, Case, G, Quantity, most, near, opened

STAND = Link("stand", Inertial(1.0, ixx=1.0, iyy=1.0, izz=1.0))
WEIGHTLESS: Vector = (0.0, 0.0, 0.0)
REST = (0.0, 0.0)
H = 0.004
"""The usual step of physics, s."""


def rod(name: str) -> Link:
    """A thin rod of 1 m and 0.3 kg, which hangs from its frame."""
    return Link(name, Inertial(0.3, Pose((0, 0, -0.5)), ixx=0.025, iyy=0.025, izz=1e-5))


def disk(name: str) -> Link:
    """1 kg with moments of inertia of 1 kg m^2 about its frame."""
    return Link(name, Inertial(1.0, ixx=1.0, iyy=1.0, izz=1.0))


def joint(
    kind: Any, child: str, parent: str = "stand", z: float = 0.0, axis: Vector = (0, 1, 0), **more: Any
) -> Joint:
    """A joint with the name of its child."""
    return Joint(child, kind, parent, child, Pose((0, 0, z)), axis, **more)


def robot(
    links: Sequence[Link],
    joints: Sequence[Joint],
    gravity: Vector = (0, 0, -G),
    h: float = H,
    substeps: int = 1,
) -> WorldModel:
    """Links on a stand that is fixed at 3 m; `h` is the time (s) of a step of physics."""
    model = RobotModel("robot", (STAND, *links), tuple(joints), root="stand")
    body = RobotBody("robot", model, fixed_base=True, pose=Pose((0, 0, 3)))
    return WorldModel(h * substeps, substeps, gravity, None, robots=(body,))


def flying(link: Link, gravity: Vector, h: float = H) -> WorldModel:
    body = RobotBody("robot", RobotModel("robot", (link,), (), root=link.name))
    return WorldModel(h, 1, gravity, None, robots=(body,))


def started(bench: Bench, **starts: tuple[float, float]) -> Callable[[], Any]:
    """Set joints to positions and velocities; returns the reader of their states."""
    for name, start in starts.items():
        bench.engine.set_joint("robot", name, *start)
    return bench.read("joint_states", "robot", list(starts))


def mechanics(bench: Bench, world: WorldModel) -> Callable[[], Array]:
    """Return a reader of the energy (J) of a robot and of its angular momentum (N m s) about the origin."""
    links = [
        (link.inertial, bench.read("pose", "robot", link.name), bench.read("velocity", "robot", link.name))
        for link in world.robots[0].model.links
        if link.inertial is not None
    ]

    def look() -> Array:
        total = np.zeros(4)
        for inertial, pose, velocity in links:
            (position, turn), (linear, spin) = pose(), velocity()
            arm = frames.rotate(turn, inertial.origin.xyz)
            center, v = np.add(position, arm), np.add(linear, frames.cross(spin, arm))
            axes = frames.multiply(turn, frames.frame(inertial.origin)[1])
            a, b, c = np.array(inertial.matrix) @ frames.rotate_back(axes, spin)
            turning = np.array(frames.rotate(axes, (a, b, c)))
            energy = inertial.mass * (v @ v / 2 - np.dot(world.gravity, center)) + turning @ spin / 2
            total += (energy, *inertial.mass * np.cross(center, v) + turning)
        return total

    return look


def percent(change: Any, scale: Any) -> float:
    return 100 * float(np.linalg.norm(change) / np.linalg.norm(scale))


# Free bodies

STONE = Link(
    "stone", Inertial(0.7, Pose((0.1, -0.2, 0.05), (0.3, 0.2, -0.4)), 0.01, 0.002, 0.001, 0.02, -0.001, 0.025)
)
"""Its center of mass and principal axes are not those of its frame."""
BRICK = Link("brick", Inertial(2.0, ixx=0.0216667, iyy=0.0166667, izz=0.0083333))
"""A homogeneous box of 10 x 20 x 30 cm."""
TOP = Link("top", Inertial(1.0, ixx=0.02, iyy=0.02, izz=0.03))


def tumble(link: Link, spin: Vector, h: float, engine: str) -> tuple[float, float]:
    world = flying(link, WEIGHTLESS, h)
    with opened(engine, world) as bench:
        bench.place("robot", spin=spin)
        look = mechanics(bench, world)
        before = look()
        after = bench.record(round(2 / h), look)[-1]
    return percent(after[0] - before[0], before[0]), percent(after[1:] - before[1:], before[1:])


def precession(engine: str) -> tuple[float]:
    """The rate at which the axis of rotation goes round a symmetric body."""
    with opened(engine, flying(TOP, WEIGHTLESS, 0.001)) as bench:
        bench.place("robot", spin=(1, 0, 10))
        pose, velocity = bench.read("pose", "robot"), bench.read("velocity", "robot")
        x, y, _ = bench.record(1000, lambda: frames.rotate_back(pose()[1], velocity()[1])).T
    return (np.unwrap(np.arctan2(y, x))[-1],)


def falls(engine: str) -> tuple[float, float]:
    with opened(engine, flying(STONE, (0, 0, -G))) as bench:
        pose = bench.read("pose", "robot")
        bench.place("robot", (0, 0, 10), (0.5, 0.2, 0))
        _, start = pose()
        bench.step(250)
        place, turn = pose()
    return 10 - place[2], abs(
        2 * np.degrees(np.linalg.norm(frames.multiply(turn, frames.inverse(start))[:3]))
    )


def throw(engine: str) -> tuple[float, float]:
    ball = ObjectBody("ball", Sphere(0.05), Pose((0, 0, 5)), 0.2)
    with opened(engine, WorldModel(H, 1, ground=None, objects=(ball,))) as bench:
        pose = bench.read("pose", "ball")
        bench.place("ball", (0, 0, 5), velocity=(3, 0, 4), spin=(0, 20, 0))
        bench.step(200)
        x, _, z = pose()[0]
    return x, z - 5


def after(
    world: WorldModel,
    seconds: float,
    number: int,
    engine: str,
    motor: tuple[Any, ...] = (),
    **starts: tuple[float, float],
) -> tuple[float]:
    """The position (0) or velocity (1) of the last of the started joints after some time; `motor` is the name
    of a motor on the first one, its limit and its target."""
    with opened(engine, world) as bench:
        states = started(bench, **starts)
        if motor:
            bench.motor(motor[0], "robot", [next(iter(starts))], [motor[1]])([motor[2]])
        bench.step(round(seconds / world.timestep))
        return (states()[-1][number],)


def hinged(
    link: Link, gravity: Vector = WEIGHTLESS, h: float = H, substeps: int = 1, **of_joint: Any
) -> WorldModel:
    """A link on a hinge; one with a limit is revolute."""
    kind = "revolute" if "limit" in of_joint else "continuous"
    return robot([link], [joint(kind, link.name, **of_joint)], gravity, h, substeps)


# Joints without motors


def period(amplitude: float, engine: str) -> tuple[float]:
    """Mean time between two passages downwards through the lowest point, s."""
    with opened(engine, hinged(rod("arm"), (0, 0, -G), 0.002, 5)) as bench:
        states = started(bench, arm=(radians(amplitude), 0.0))
        angle = bench.record(1500, lambda: states()[0][0])
    passages = np.flatnonzero((angle[:-1] > 0) & (angle[1:] <= 0))
    moments = passages + angle[passages] / (angle[passages] - angle[passages + 1])
    return (0.01 * float(np.mean(np.diff(moments))),)


def swing(amplitude: float) -> float:
    """2 pi sqrt(2 L / 3 g) / agm(1, cos(amplitude / 2)): the complete elliptic integral."""
    a, b = 1.0, cos(radians(amplitude) / 2)
    while abs(a - b) > 1e-15:
        a, b = (a + b) / 2, sqrt(a * b)
    return float(2 * pi * sqrt(2 / (3 * G)) / a)


def topples(engine: str) -> tuple[float]:
    """The rate of a rod that falls from 0.1 rad beside its upright position, when it is level."""
    with opened(engine, hinged(rod("arm"), (0, 0, -G), 0.001)) as bench:
        states = started(bench, arm=(pi - 0.1, 0.0))
        angle, rate = bench.record(1500, lambda: states()[0][:2]).T
    level = int(np.flatnonzero(angle < pi / 2)[0])
    return (float(np.interp(pi / 2, angle[[level, level - 1]], -rate[[level, level - 1]])),)


def largest_gain(world: WorldModel, seconds: float, engine: str, **starts: tuple[float, float]) -> float:
    """The largest energy above that of the start, in percent of the largest change."""
    with opened(engine, world) as bench:
        started(bench, **starts)
        names = [one.name for one in world.robots[0].model.moving_joints]
        bench.motor("torque_motor", "robot", names, [1.0] * len(names))([0.0] * len(names))
        look = mechanics(bench, world)
        first = look()[0]
        energy = bench.record(round(seconds / world.timestep), look)[:, 0] - first
    return float(100 * max(0.0, energy.max()) / np.abs(energy).max())


def free_energy(world: WorldModel, engine: str) -> tuple[float]:
    """The largest change of the energy of a pendulum within 4 s, in percent of m g L."""
    with opened(engine, world) as bench:
        started(bench, arm=(pi / 2, 0.0))
        look = mechanics(bench, world)
        first = look()[0]
        energy = bench.record(round(4 / world.timestep), look)[:, 0]
    return (100 * float(np.abs(energy - first).max()) / (0.3 * G),)


def damped(x: float, engine: str) -> tuple[float, ...]:
    """A disk on a hinge whose damping is x I / h: its way, by how much it gets faster and, for a small x, the
    error of its speed; in percent of the speed at the start."""
    world = hinged(disk("arm"), damping=x / H)
    with opened(engine, world) as bench:
        states = started(bench, arm=(0.0, 2.0))
        bench.motor("torque_motor", "robot", ["arm"], [1.0])([0.0])
        angle, speed = bench.record(max(50, round(12 / log1p(x))), lambda: states()[0][:2]).T
    error = 50 * np.abs(speed - 2 * np.exp(-x * np.arange(1, len(speed) + 1))).max()
    return (angle[-1], max(0.0, 50 * np.abs(speed).max() - 100), *([error] if x <= 0.1 else []))


def arm_file(name: str, h: float, engine: str) -> tuple[float]:
    """The energy that an arm of pybullet_data gains while it falls, with the damping of its file."""
    import pybullet_data

    from deepbots_cli.diagnostics import Findings
    from deepbots_cli.robots import reader

    file = reader.read(Path(pybullet_data.getDataPath()) / name, name, Findings())
    assert file is not None
    links = tuple(replace(link, collisions=(), visuals=()) for link in file.model.links)
    body = RobotBody("robot", replace(file.model, links=links), fixed_base=True)
    return (largest_gain(WorldModel(h, 1, ground=None, robots=(body,)), 2.0, engine),)


def spring(x: float, engine: str) -> tuple[float]:
    """The largest error of a step response within 1 s, in percent of the step; the damping is x I / h, and
    the stiffness a fifth of it per s."""
    d = x / H
    k = 5 * d
    with opened(engine, hinged(disk("arm"))) as bench:
        states = started(bench, arm=(0.0, 0.0))
        bench.motor("position_motor", "robot", ["arm"], [1e9], [k], [d])([1.0])
        angle = bench.record(250, lambda: states()[0][0])
    roots = np.roots([1, d, k]).astype(complex)
    time = H * np.arange(1, 251)
    truth = 1 - (roots[1] * np.exp(roots[0] * time) - roots[0] * np.exp(roots[1] * time)) / (
        roots[1] - roots[0]
    )
    return (100 * float(np.abs(angle - truth.real).max()),)


def at_limit(motor: str, target: float, engine: str) -> tuple[float, float]:
    """The largest torque, and the angle at last, of a motor of 50 N m that drives a rod against its limit."""
    world = hinged(rod("arm"), limit=Limit(-1, 0.5, effort=50.0))
    gains = [None, None] if motor == "position_motor" else []
    with opened(engine, world) as bench:
        states = started(bench, arm=(0.0, 0.0))
        torque = bench.read("joint_torques", "robot", ["arm"])
        bench.motor(motor, "robot", ["arm"], [50.0], *gains)([target])
        rows = bench.record(250, lambda: (abs(torque()[0]), states()[0][0]))
    return rows[:, 0].max(), rows[-1, 1]


# Motors and machines


TURNTABLE = robot(
    [disk("arm"), Link("bead", Inertial(1.0, ixx=1e-3, iyy=1e-3, izz=1e-3))],
    [joint("continuous", "arm", axis=(0, 0, 1)), joint("prismatic", "bead", "arm", axis=(1, 0, 0))],
    h=0.001,
)


def skater(engine: str) -> tuple[float, float]:
    """Changes of energy and angular momentum (%) while a bead flies outwards on a free turntable for 1 s."""
    with opened(engine, TURNTABLE) as bench:
        started(bench, arm=(0.0, 2.0), bead=(0.2, 0.5))
        look = mechanics(bench, TURNTABLE)
        before = look()
        bench.step(1000)
        after = look()
    moving = (1 + 0.2**2) * 2**2 / 2 + 0.5**2 / 2
    return percent(after[0] - before[0], moving), percent(after[3] - before[3], before[3])


def mimics(engine: str) -> tuple[float, float]:
    """The largest errors (mrad) of a joint that follows another one, and of one that follows it."""
    links = [disk("arm"), disk("one"), disk("two")]
    joints = [
        joint("continuous", "arm"),
        joint("continuous", "one", mimic=Mimic("arm", -0.5, 0.2)),
        joint("continuous", "two", mimic=Mimic("one", 2.0, -0.1)),
    ]
    with opened(engine, robot(links, joints, WEIGHTLESS)) as bench:
        states = bench.read("joint_states", "robot", ["arm", "one", "two"])
        bench.motor("velocity_motor", "robot", ["arm"], [100.0])([1.0])
        arm, one, two = bench.record(250, lambda: [state[0] for state in states()]).T
    return 1000 * np.abs(one - (0.2 - 0.5 * arm)).max(), 1000 * np.abs(two - (2 * one - 0.1)).max()


# The table

T = 1.0 + H
CASES = (
    Case(
        "a body whose center of mass is beside its frame falls for 1 s",
        falls,
        (near("height lost, g t (t + h) / 2", G * T / 2, "m", 0.1), most("turned", 0.01, "deg")),
    ),
    Case(
        "a ball is thrown with 3 m/s forwards and 4 m/s upwards, for 0.8 s",
        throw,
        (
            near("distance, v t", 2.4, "m", 0.1),
            Quantity("height, v t - g t (t + h) / 2", 3.2 - G * 0.4 * 0.804, "m", 0.003),
        ),
        ALL,
    ),
    *(
        Case(
            f"{name} tumbles freely for 2 s, steps of {1000 * h:g} ms",
            partial(tumble, link, spin, h),
            (most("change of energy", 2.0, "%"), most("change of angular momentum", 2.0, "%")),
        )
        for name, link, spin in (
            ("a brick", BRICK, (0.1, 5.0, 0.1)),
            ("a body whose center of mass is beside its frame", STONE, (3.0, 1.0, -2.0)),
        )
        for h in (0.001, H)
    ),
    Case(
        "a symmetric top turns at 10 rad/s, leaning",
        precession,
        (near("its axis goes round by (I₃/I₁ - 1) ω t", 5.0, "rad", 1),),
    ),
    *(
        Case(
            f"a rod that swings by {amplitude:g} deg",
            partial(period, amplitude),
            (near("period, 2π √(2L/3g) / agm(1, cos a/2)", swing(amplitude), "s", 0.5),),
        )
        for amplitude in (5.0, 90.0, 150.0)
    ),
    Case(
        "a rod topples",
        topples,
        (near("rate when level, √(3g cos a / L)", sqrt(3 * G * cos(0.1)), "rad/s", 0.5),),
    ),
    *(
        Case(
            f"a free {name} for 4 s, steps of {1000 * h:g} ms",
            partial(free_energy, robot(links, joints, h=h)),
            (most("change of energy, of m g L", bar, "%"),),
        )
        for name, h, bar, links, joints in (
            ("pendulum", 0.004, 1.0, [rod("arm")], [joint("continuous", "arm")]),
            (
                "double pendulum",
                0.001,
                5.0,
                [rod("arm"), rod("end")],
                [joint("continuous", "arm"), joint("continuous", "end", "arm", -1)],
            ),
        )
    ),
    *(
        Case(
            f"a hinge with damping d = x I/h, x = {x:g}",
            partial(damped, x),
            (
                near("end angle, ω I/d", 2 * H / x, "rad", 1),
                most("gain of speed", 0.1, "%"),
                *([most("error of the speed", 2.0, "%")] if x <= 0.1 else []),
            ),
        )
        for x in (0.01, 0.1, 1.0, 10.0, 1000.0)
    ),
    *(
        Case(
            f"{name} falls for 2 s, motors exert 0, steps of {1000 * h:g} ms",
            partial(arm_file, file, h),
            (most("energy gained, of that which moves", 1.0, "%"),),
            engines,
        )
        for name, file, h, engines in (
            ("KUKA iiwa", "kuka_iiwa/model.urdf", H, PORT),
            # MuJoCo refuses an inertia of its file.
            ("xArm6", "xarm/xarm6_robot.urdf", 0.001, PORT[:1]),
        )
    ),
    *(
        Case(
            f"a spring with damping d = x I/h, x = {x:g}, and stiffness d / 0.2 s",
            partial(spring, x),
            (most("error of the step response, of the step", 2.0, "%"),),
        )
        for x in (0.01, 0.1, 1.0, 10.0)
    ),
    Case(
        "a hinge with friction of 0.5 N m and 1 kg m²",
        partial(after, hinged(disk("arm"), friction=0.5), 1.0, 1, arm=(0.0, 2.0)),
        (near("speed after 1 s, of 2 rad/s", 1.5, "rad/s", 0.5),),
    ),
    Case(
        "2 N m on 1 kg m² and an armature of 3 kg m²",
        partial(
            after, hinged(disk("arm"), armature=3.0), 1.0, 1, motor=("torque_motor", 10.0, 2.0), arm=REST
        ),
        (near("speed after 1 s", 0.5, "rad/s", 0.1),),
        PORT[1:],
    ),
    *(
        Case(
            f"a joint 0.5 rad beyond its limit of 1 rad, pressed by {torque:g} N m, steps of {20 / substeps:g} ms",
            partial(
                after,
                hinged(rod("arm"), h=0.02 / substeps, substeps=substeps, limit=Limit(-3, 1)),
                0.5,
                0,
                motor=("torque_motor", torque, torque),
                arm=(1.5, 0.0),
            ),
            (near("angle after 0.5 s", 1.0, "rad", 0.5),),
        )
        for substeps, torque in ((1, 5.0), (2, 5.0), (4, 5.0), (16, 5.0), (4, 0.0))
    ),
    *(
        Case(
            f"a {motor.replace('_', ' ')} of 50 N m drives a rod against its limit of 0.5 rad",
            partial(at_limit, motor, target),
            (near("largest torque", 50.0, "N m", 0.1), near("angle after 1 s", 0.5, "rad", 1)),
        )
        for motor, target in (("torque_motor", 80.0), ("velocity_motor", 10.0), ("position_motor", 3.0))
    ),
    *(
        Case(
            f"a motor at its limit of 10 N pulls 1 kg for 0.4 s, steps of {20 / substeps:g} ms",
            partial(
                after,
                robot(
                    [disk("arm")],
                    [joint("prismatic", "arm", axis=(1, 0, 0))],
                    h=0.02 / substeps,
                    substeps=substeps,
                ),
                0.4,
                1,
                motor=("velocity_motor", 10.0, 1000.0),
                arm=REST,
            ),
            (near("speed, F t / m", 4.0, "m/s", 0.1),),
        )
        for substeps in (1, 8, 32)
    ),
    Case(
        "a bead at 10 cm on a turntable at 2 rad/s",
        partial(
            after, TURNTABLE, 1.0, 0, motor=("velocity_motor", 1e6, 2.0), arm=(0.0, 2.0), bead=(0.1, 0.0)
        ),
        (near("radius after 1 s, r cosh ωt", 0.1 * cosh(2), "m", 0.5),),
    ),
    Case(
        "a bead flies outwards on a free turntable for 1 s",
        skater,
        (most("change of energy", 1.0, "%"), most("change of angular momentum", 1.0, "%")),
    ),
    Case(
        "a joint follows another one, and a third one follows it",
        mimics,
        (most("error of the second", 5.0, "mrad"), most("error of the third", 5.0, "mrad")),
    ),
)
