"""Robots that drive, park, hold something, stand on what moves, and rest on wheels, feet and meshes."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from functools import partial
from math import asin, atan, cos, degrees, hypot, inf, pi, radians, sin, tan
from pathlib import Path
from typing import Any

import numpy as np

from deepbots_cli.program.world import ObjectBody, RobotBody, WorldModel
from deepbots_cli.robots.model import (
    Box,
    Cylinder,
    Friction,
    Geometry,
    Inertial,
    Joint,
    Link,
    Pose,
    RobotModel,
    Vector,
)
from tests.physics.case import Array, Bench, Case, G, most, near, opened, trial
from tests.physics.contacts import CUBE
from tests.physics.motion import H, joint, robot
from tests.webots.exported_projects import FLOOR, device, node, run, simulate

DOCS = Path(__file__).parents[2] / "docs"
RADIUS, LENGTH, TRACK = 0.04, 0.2, 0.24
"""Of the wagon, m: of its wheels, between its axles, and between its wheels."""


def solid(name: str, mass: float, size: Vector, friction: float = 1.0, at: Vector = (0, 0, 0)) -> Link:
    """A homogeneous box."""
    x, y, z = (side * side * mass / 12 for side in size)
    box = Geometry(Box(size), Pose(at))
    return Link(
        name, Inertial(mass, Pose(at), ixx=y + z, iyy=x + z, izz=x + y), (), (box,), Friction(friction)
    )


def wheel(name: str, mass: float = 0.05) -> Link:
    """A tire of 2 cm, which rolls along x."""
    tire = Geometry(Cylinder(RADIUS, 0.02), Pose(rpy=(pi / 2, 0, 0)))
    across, along = mass * (3 * RADIUS**2 + 0.02**2) / 12, mass * RADIUS**2 / 2
    return Link(name, Inertial(mass, ixx=across, iyy=along, izz=across), (), (tire,), Friction(1.0))


CORNERS = {
    f"{end}_{side}": (x, y, 0.0)
    for end, x in (("front", LENGTH / 2), ("rear", -LENGTH / 2))
    for side, y in (("left", TRACK / 2), ("right", -TRACK / 2))
}


def wagon(
    mass: float = 1.0, tires: float = 0.05, steers: bool = False, gravity: Vector = (0, 0, -G)
) -> WorldModel:
    """A body on four wheels; the front ones steer about vertical axes if they shall."""
    links: list[Link] = [solid("body", mass, (0.2, 0.1, 0.04))]
    joints: list[Joint] = []
    for name, at in CORNERS.items():
        parent, place = "body", Pose(at)
        if steers and name.startswith("front"):
            parent, place = f"steer_{name}", Pose()
            links.append(Link(parent, Inertial(0.02, ixx=1e-5, iyy=1e-5, izz=1e-5)))
            joints.append(Joint(parent, "continuous", "body", parent, Pose(at), (0, 0, 1)))
        links.append(wheel(name, tires))
        joints.append(Joint(name, "continuous", parent, name, place, (0, 1, 0)))
    model = RobotModel("robot", tuple(links), tuple(joints), root="body")
    return WorldModel(H, 1, gravity, robots=(RobotBody("robot", model, pose=Pose((0, 0, RADIUS))),))


def driven(bench: Bench, rates: Mapping[str, float], seconds: float) -> Array:
    """Drive wheels at rates (rad/s); returns x, y, z, speed and turning rate of the body after each step."""
    bench.motor("velocity_motor", "robot", [*rates], [1.0] * len(rates))([*rates.values()])
    pose, velocity = bench.read("pose", "robot"), bench.read("velocity", "robot")
    return bench.record(round(seconds / H), lambda: (*pose()[0], hypot(*velocity()[0][:2]), velocity()[1][2]))


def skid(engine: str) -> tuple[float, float, float]:
    """All four wheels slip, each with its friction against its slip: their torques about the center cancel
    at w r b / (a^2 + b^2), with a and b half of length and track."""
    with opened(engine, wagon()) as bench:
        rows = driven(bench, {name: 5.0 if name.endswith("right") else -5.0 for name in CORNERS}, 6.0)
    rates = rows[250:, 4]
    return float(rates.mean()), float(np.ptp(rates)), 1000 * max(0.0, float(rows[250:, 2].max()) - RADIUS)


def ackermann(angle: float, engine: str) -> tuple[float, float]:
    """The turning rate of a car whose axes of wheels meet in one point, and the speed of its rear axle."""
    turn = LENGTH / tan(angle)
    sides = {"left": turn - TRACK / 2, "right": turn + TRACK / 2}
    with opened(engine, wagon(steers=True)) as bench:
        steers = [f"steer_front_{side}" for side in sides]
        write = bench.motor("position_motor", "robot", steers, [2.0, 2.0], None, None)
        write([atan(LENGTH / radius) for radius in sides.values()])
        rates = {f"rear_{side}": 10 * radius / turn for side, radius in sides.items()}
        rows = driven(bench, rates, 4.0)[500:]
    return float(rows[:, 4].mean()), float(rows[:, 3].mean())


def parked(engine: str) -> tuple[float]:
    lean = radians(10)
    with opened(engine, wagon(gravity=(G * sin(lean), 0, -G * cos(lean)))) as bench:
        rows = driven(bench, dict.fromkeys(CORNERS, 0.0), 10.5)
    return (1000 * float(np.linalg.norm(rows[-1, :3] - rows[125, :3])),)


def set_down(engine: str) -> tuple[float, float]:
    """The wheels of a wagon that slides at 1 m/s spin up: its momentum loses their I / r each."""
    with opened(engine, wagon(mass=2.0, tires=0.02)) as bench:
        bench.place("robot", (0, 0, RADIUS), velocity=(1, 0, 0))
        pose, velocity = bench.read("pose", "robot"), bench.read("velocity", "robot")
        rows = bench.record(100, lambda: (velocity()[0][0], pose()[0][2]))
    return rows[-1, 0], 1000 * max(0.0, rows[:, 1].max() - RADIUS)


# Robots as texts

(BUGGY,) = re.findall(r"```xml buggy.urdf\n(.*?)```", (DOCS / "own-robot.md").read_text("utf-8"), re.DOTALL)


def buggy(part: int, left: float, right: float, engine: str) -> tuple[float]:
    """The distance (m) or the turning (rad) of the robot of docs/own-robot.md within 1 s, after 2 s."""
    robot_text = (
        "urdf: buggy.urdf, actuators: {left: {type: velocity_motor, joint: left_motor}, right: {type:"
        f" velocity_motor, joint: right_motor}}}}, apply: {{left: push * {left} rad/s, right: push * {right} rad/s}}"
    )
    see = {
        "x": ("position(subject).x", "m"),
        "y": ("position(subject).y", "m"),
        "turn": ("yaw(subject)", "rad"),
    }
    with trial(engine, see, substeps=5, robot=robot_text, files={"buggy.urdf": BUGGY}) as running:
        rows = running.run(150, push=1.0)[100:]
    turned = np.unwrap(rows[:, 2])
    return ((hypot(*(rows[-1, :2] - rows[0, :2])), turned[-1] - turned[0])[part],)


def rover(left: float, engine: str) -> tuple[float, float]:
    """Speed (m/s) and turning rate (rad/s) of the shipped rover, whose right wheel turns at 5 rad/s."""
    robot_text = (
        "urdf: rover, sensors: {pace: {type: velocity, link: base_link}, gyro: {type: gyro, link: base_link}},"
        " emit: [pace, gyro], actuators: {left: {type: velocity_motor, joint: left_wheel, max_torque: 1 N*m},"
        " right: {type: velocity_motor, joint: right_wheel, max_torque: 1 N*m}},"
        f" apply: {{left: push * {left} rad/s, right: push * 5 rad/s}}"
    )
    see = {"subject.pace": ("", "m/s"), "subject.gyro": ("", "rad/s")}
    start = "place: {subject: {z: 40 mm}}"
    with trial(engine, see, robot=robot_text, reset=start, substeps=8) as running:
        rows = running.run(100, push=1.0)[50:]
    return float(np.mean(np.hypot(rows[:, 0], rows[:, 1]))), float(np.mean(rows[:, 5]))


def epuck(x: float, y: float, _engine: str) -> tuple[float, float]:
    """Speed (m/s) and largest pitch (deg) of the e-puck of Webots, whose wheels turn at 5 rad/s, from 1 to
    3 s."""
    simulation = simulate(f"{FLOOR} DEF ROBOT E-puck {{ translation {x} {y} 0 }}", 32)
    for side in ("left", "right"):
        motor = device(simulation, f"{side} wheel motor")
        motor.setPosition(inf)
        motor.setVelocity(5)
    run(simulation, 1.024)
    body, places, pitches = node(simulation, "ROBOT"), [], []
    for _ in range(63):
        places.append(body.getPosition())
        pitches.append(degrees(asin(body.getOrientation()[6])))
        simulation.run_step()
    return hypot(*np.subtract(places[-1], places[0])[:2]) / (62 * 0.032), float(np.abs(pitches).max())


def starts(urdf: str, files: Mapping[str, str], engine: str) -> tuple[float, float]:
    """How far a robot is after 1 s from the height where an episode begins (mm), and its fastest way up
    (m/s)."""
    see = {"height": ("position(subject).z", "m"), "up": ("velocity(subject).z", "m/s")}
    with trial(engine, see, timestep=H, substeps=1, robot=f"urdf: {urdf}", files=files) as running:
        rows = running.run(250)
    return 1000 * abs(rows[-1, 0] - rows[0, 0]), rows[:, 1].max()


def meshed(*bodies: tuple[str, str]) -> str:
    """A robot file: a trunk with legs on hinges; each has a collision shape at a place."""
    inertial = '<inertial><mass value="0.5"/><inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial>'
    parts = []
    for index, (place, shape) in enumerate(bodies):
        parts.append(
            f'<link name="l{index}">{inertial}<collision><geometry>{shape}</geometry></collision></link>'
        )
        if index:
            parts.append(
                f'<joint name="j{index}" type="fixed"><parent link="l0"/><child link="l{index}"/>'
                f'<origin xyz="{place}"/></joint>'
            )
    return f'<robot name="meshed">{"".join(parts)}</robot>'


DIE = '<mesh filename="cube.obj" scale="0.02 0.02 0.02"/>'
FEET = ("0.1 0.1 -0.1", "0.1 -0.1 -0.1", "-0.1 0.1 -0.1", "-0.1 -0.1 -0.1")
RESTING: tuple[tuple[str, str, Mapping[str, str]], ...] = (
    ("the rover", "rover", {}),
    ("the quadrotor", "quadrotor", {}),
    ("the buggy of own-robot.md", "buggy.urdf", {"buggy.urdf": BUGGY}),
    ("a cube as a collision mesh", "it.urdf", {"it.urdf": meshed(("0 0 0", DIE)), "cube.obj": CUBE}),
    (
        "a box on feet as collision meshes",
        "it.urdf",
        {
            "it.urdf": meshed(("0 0 0", '<box size="0.2 0.2 0.04"/>'), *((at, DIE) for at in FEET)),
            "cube.obj": CUBE,
        },
    ),
)

# Holding and carrying


def grip(mass: float, engine: str) -> tuple[float, float]:
    """How far a box slips (mm) between two fingers, held for 10 s and then shaken at 0.25 g for 4 s; their
    friction carries 1.6 times its weight."""
    links = [
        Link("hand", Inertial(0.5, ixx=1e-3, iyy=1e-3, izz=1e-3)),
        solid("left", 0.05, (0.02, 0.01, 0.04), 0.8, (0, 0.02, 0)),
        solid("right", 0.05, (0.02, 0.01, 0.04), 0.8, (0, -0.02, 0)),
    ]
    joints = [
        joint("prismatic", "hand", axis=(0, 0, 1)),
        Joint("left", "fixed", "hand", "left"),
        joint("prismatic", "right", "hand"),
    ]
    nut = ObjectBody("nut", Box((0.02, 0.03, 0.04)), Pose((0, 0, 3)), mass)
    world = robot(links, joints)
    world = WorldModel(H, 1, world.gravity, None, robots=world.robots, objects=(nut,))
    swing = 2 * pi * 2
    with opened(engine, world) as bench:
        lift = bench.motor("velocity_motor", "robot", ["hand"], [1000.0])
        close = bench.motor("torque_motor", "robot", ["right"], [100.0])
        held, hand = bench.read("pose", "nut"), bench.read("pose", "robot", "hand")

        def look() -> float:
            return float(held()[0][2] - hand()[0][2])

        lift([0.0])
        close([mass * G])
        bench.step(125)
        before = look()
        bench.step(2500)
        after = look()
        for step in range(1000):
            lift([0.25 * G / swing * sin(swing * H * step)])
            bench.step()
        return 1000 * abs(after - before), 1000 * abs(look() - before)


def on_plate(
    body: ObjectBody, lift: float, motor: Sequence[Any], target: Any, engine: str
) -> tuple[float, float]:
    """The share (%) of the timesteps of 10 ms in which a body touches a plate that moves below it, and their
    mean difference in speed (m/s), between 1 and 4 s; `lift` is the force (N) that rotors take off it."""
    plate = solid("plate", 2.0, (4.0, 0.5, 0.04))
    world = robot([plate], [joint("prismatic", "plate", axis=(1, 0, 0))])
    world = WorldModel(0.01, 4, world.gravity, None, robots=world.robots, objects=(body,))
    with opened(engine, world) as bench:
        write = bench.motor(motor[0], "robot", ["plate"], *motor[1:])
        touches = bench.read("contact", (body.name, None), [("robot", "plate")])
        mine, its = bench.read("velocity", body.name), bench.read("velocity", "robot", "plate")
        push = bench.engine.pusher((body.name, None))
        bench.engine.before_substep(lambda: push((0.0, 0.0, lift), (0.0, 0.0, 0.0)))
        rows = []
        for step in range(400):
            write([target(0.01 * step)])
            bench.step()
            rows.append((touches(), abs(mine()[0][0] - its()[0][0])))
    return 100 * np.mean([row[0] for row in rows[100:]]), float(np.mean([row[1] for row in rows[100:]]))


FOOT = ObjectBody("foot", Box((0.04, 0.04, 0.02)), Pose((-1, 0, 3.03)), 0.02)
DRONE = ObjectBody("drone", Box((0.1, 0.1, 0.03)), Pose((0, 0, 3.035)), 0.0277)

# The table

CASES = (
    *(
        case
        for rate in (6, 12)
        for case in (
            Case(
                f"the buggy of own-robot.md drives at {rate} rad/s for 1 s",
                partial(buggy, 0, rate, rate),
                (near("distance, ω r t", 0.035 * rate, "m", 2),),
            ),
            Case(
                f"the buggy of own-robot.md turns on the spot at {rate} rad/s for 1 s",
                partial(buggy, 1, -rate, rate),
                (near("angle, 2 ω r t / track", 0.07 * rate / 0.12, "rad", 3),),
            ),
        )
    ),
    Case(
        "the rover drives straight on at 5 rad/s",
        lambda engine: rover(5, engine)[:1],
        (near("speed, ω r", 0.2, "m/s", 0.2),),
    ),
    Case(
        "the rover drives in an arc; its tires of 2 cm grip anywhere",
        partial(rover, 3),
        (
            near("speed, (ω₁ + ω₂) r/2", 0.16, "m/s", 4),
            near("turning rate, (ω₂ - ω₁) r / track", 0.08 / 0.136, "rad/s", 0.2),
        ),
    ),
    Case(
        "a car with four driven wheels turns on the spot, skidding",
        skid,
        (
            near("rate, ω r b / (a² + b²)", 2 * 5 * RADIUS * TRACK / (LENGTH**2 + TRACK**2), "rad/s", 5),
            most("change of this rate", 0.1, "rad/s"),
            most("rides higher", 0.3, "mm"),
        ),
    ),
    *(
        Case(
            f"a car that steers by {angle:g} rad",
            partial(ackermann, angle),
            (
                near("turning rate, v tan a / L", 0.4 * tan(angle) / LENGTH, "rad/s", 2),
                near("speed of its middle", 0.4 * hypot(1, tan(angle) / 2), "m/s", 2),
            ),
        )
        for angle in (0.1, 0.4)
    ),
    Case("a car parks on 10 deg for 10 s", parked, (most("creep", 0.3, "mm"),)),
    Case(
        "a wagon with light wheels is set down at 1 m/s",
        set_down,
        (near("speed, v M / (M + Σ I/r²)", 2.08 / 2.12, "m/s", 0.5), most("hop", 0.3, "mm")),
    ),
    *(
        Case(
            f"a box of {mass:g} kg between two fingers, held by 1.6 times its weight in friction",
            partial(grip, mass),
            (most("slips in 10 s", 0.2, "mm"), most("and shaken at 0.25 g", 0.2, "mm")),
        )
        for mass in (0.2, 1.0)
    ),
    Case(
        "a foot of 20 g on a belt at 0.2 m/s",
        partial(on_plate, FOOT, 0.0, ("velocity_motor", [200.0]), lambda _: 0.2),
        (near("timesteps in contact", 100.0, "%", 2), most("slip", 0.01, "m/s")),
    ),
    Case(
        "a drone of 27.7 g, 91 % of its weight lifted, on a plate that slides 0.2 m to and fro in 4 s",
        lambda engine: on_plate(
            DRONE,
            0.91 * 0.0277 * G,
            ("position_motor", [200.0], None, None),
            lambda time: 0.2 * sin(2 * pi * time / 4),
            engine,
        )[:1],
        (near("timesteps in contact", 100.0, "%", 2),),
    ),
    *(
        Case(
            f"an e-puck of Webots drives at 5 rad/s from ({x:g}, {y:g})",
            partial(epuck, x, y),
            (near("speed, ω r", 0.1, "m/s", 2), most("pitch", 0.5, "deg")),
            ("webots",),
        )
        for x, y in ((0.0, 0.0), (0.2, 0.1), (-1.0, 0.0), (-4.0, 2.0))
    ),
    *(
        Case(
            f"{name} begins at rest",
            partial(starts, urdf, files),
            (most("off its height", 0.5, "mm"), most("speed upwards", 0.01, "m/s")),
        )
        for name, urdf, files in RESTING
    ),
)
