"""Bodies that slide, roll, bounce, rest, stand on each other, and are held."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from math import atan, cos, degrees, hypot, pi, radians, sin, sqrt
from typing import Any

import numpy as np

from deepbots_cli import frames
from deepbots_cli.program.world import Ground, ObjectBody, WorldModel
from deepbots_cli.robots.model import Box, Capsule, Cylinder, Pose, Shape, Sphere
from tests.physics.case import ALL, PORT, Case, G, Quantity, mesh, most, near, opened

CRATE = ObjectBody("crate", Box((0.2, 0.2, 0.1)), Pose((0, 0, 0.05)), 1.0)
BALL = ObjectBody("ball", Sphere(0.1), Pose((0, 0, 0.1)), 2.0)
SPEEDS = (0.3, 1.0, 2.0, 4.0)
CUBE = "".join(f"v {x} {y} {z}\n" for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)) + (
    "f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n"
)
"""A cube of 2 x 2 x 2 as an OBJ file."""


def lowest(crate: ObjectBody, pose: tuple[Sequence[float], frames.Quaternion]) -> float:
    """Return the height of the lowest corner of a box, m."""
    down = frames.rotate_back(pose[1], (0.0, 0.0, 1.0))
    return pose[0][2] - float(np.abs(np.multiply(down, crate.shape.size)).sum()) / 2  # type: ignore[union-attr]


# Sliding and rolling


def slide(friction: float, h: float, engine: str) -> tuple[float, ...]:
    """A box on the floor slides v^2 / (2 mu g) - v h / 2 far; the second term is that of semi-implicit steps
    of h."""
    crate = replace(CRATE, friction=friction)
    ratios, hops, gaps, forces = [], [], [], []
    for speed in SPEEDS:
        with opened(engine, WorldModel(h, 1, objects=(crate,))) as bench:
            pose, force = bench.read("pose", "crate"), bench.read("contact_force", ("crate", None))
            bench.step(round(0.3 / h))
            rest = pose()[0][2]
            bench.reset()
            bench.place("crate", (0, 0, rest), velocity=(speed, 0, 0))
            time = speed / friction / G
            look = partial(_sliding, crate, pose, force)
            x, z, low, normal = bench.record(round((time + 0.2) / h), look).T
        ratios.append(x[-1] / (speed**2 / (2 * friction * G) - speed * h / 2))
        hops.append(1000 * max(0.0, z.max() - rest))
        gaps.extend(low > 1e-4)
        forces.extend(normal[: int(time / h)] / G)
    furthest = max(ratios, key=lambda ratio: abs(ratio - 1))
    return furthest, max(hops[:-1]), hops[-1], 100 * float(np.mean(gaps)), float(np.mean(forces))


def _sliding(crate: ObjectBody, pose: Callable[[], Any], force: Callable[[], float]) -> tuple[float, ...]:
    now = pose()
    return now[0][0], now[0][2], lowest(crate, now), force()


def slides_askew(engine: str) -> tuple[float, float]:
    """Way (m) and sideways drift (mm) of a box that slides at 45 deg to the axes of the world."""
    with opened(engine, WorldModel(0.004, 1, objects=(replace(CRATE, friction=0.3),))) as bench:
        pose = bench.read("pose", "crate")
        bench.place("crate", (0, 0, 0.05), (0, 0, pi / 4), velocity=(sqrt(0.5), sqrt(0.5), 0))
        bench.step(200)
        x, y, _ = pose()[0]
    return hypot(x, y), 1000 * abs(x - y) * sqrt(0.5)


def slope(angle: float, *objects: ObjectBody, friction: float = 1.0, h: float = 0.004) -> WorldModel:
    """Objects whose poses are those on a ramp that falls towards x, by an angle in degrees."""
    lean = radians(angle)
    ramp = ObjectBody("ramp", Box((8, 2, 0.2)), Pose((0, 0, 3), (0, lean, 0)), friction=friction, fixed=True)
    tilt = frames.quaternion(0, lean, 0)
    placed = []
    for item in objects:
        x, y, z = frames.rotate(tilt, frames.add(item.pose.xyz, (0.0, 0.0, 0.1)))
        placed.append(replace(item, pose=Pose((x, y, z + 3), (0, lean, 0))))
    return WorldModel(h, 1, ground=None, objects=(ramp, *placed))


def creep(world: WorldModel, engine: str) -> tuple[float]:
    """The longest way of an object in 10 s, after 0.5 s, in mm."""
    with opened(engine, world) as bench:
        poses = [bench.read("pose", body.name) for body in world.objects if not body.fixed]
        bench.step(round(0.5 / bench.timestep))
        before = np.array([pose()[0] for pose in poses])
        bench.step(round(10 / bench.timestep))
        moved = np.array([pose()[0] for pose in poses]) - before
    return (1000 * float(np.linalg.norm(moved, axis=1).max()),)


def stack(count: int, friction: float) -> tuple[ObjectBody, ...]:
    return tuple(
        replace(CRATE, name=f"crate{k}", friction=friction, pose=Pose((0, 0, 0.05 + 0.1 * k)))
        for k in range(count)
    )


def downhill(engine: str) -> tuple[float]:
    """A box on a slope beyond its angle of friction gains g (sin a - mu cos a)."""
    with opened(engine, slope(30, replace(CRATE, friction=0.3))) as bench:
        velocity = bench.read("velocity", "crate")
        bench.step(250)
        return (float(np.linalg.norm(velocity()[0])),)


def threshold(holds: Callable[[str, float], bool], low: float, high: float, engine: str) -> tuple[float]:
    """The angle (degrees) between one where something holds and one where it does not, by bisection."""
    while high - low > 0.1:
        middle = (low + high) / 2
        low, high = (middle, high) if holds(engine, middle) else (low, middle)
    return ((low + high) / 2,)


def sticks(crate: float, ramp: float, engine: str, angle: float) -> bool:
    with opened(engine, slope(angle, replace(CRATE, friction=crate), friction=ramp)) as bench:
        velocity = bench.read("velocity", "crate")
        speeds = bench.record(400, lambda: np.linalg.norm(velocity()[0]))
    return bool(speeds[-1] < max(0.02, speeds[199]))


def stands(engine: str, angle: float) -> bool:
    tall = ObjectBody("tall", Box((0.2, 0.2, 0.4)), Pose((0, 0, 0.2)), 1.0)
    with opened(engine, slope(angle, tall)) as bench:
        pose = bench.read("pose", "tall")
        bench.step(500)
        return frames.rotate(pose()[1], (0.0, 0.0, 1.0))[2] > cos(radians(angle + 10))


def ball_slides(engine: str) -> tuple[float, ...]:
    """A ball that slides begins to roll at 5/7 of its speed, after 2 v / (7 mu g)."""
    with opened(engine, WorldModel(0.004, 1, objects=(replace(BALL, friction=0.2),))) as bench:
        pose, velocity = bench.read("pose", "ball"), bench.read("velocity", "ball")
        bench.place("ball", (0, 0, 0.1), velocity=(2, 0, 0))
        rows = bench.record(200, lambda: (velocity()[0][0], velocity()[1][1], pose()[0][2]))
    v, w, z = rows.T
    slides = np.flatnonzero(v - 0.1 * w < 0.02)
    return v[-1], 0.004 * (slides[0] + 1) / 0.99 if len(slides) else 0.8, 1000 * max(0.0, z.max() - 0.1)


def rolls_down(thing: ObjectBody, h: float, engine: str) -> tuple[float]:
    """Down a slope of angle a, what rolls without slipping gains g sin(a) / (1 + I / m r^2)."""
    down = (G * sin(radians(10)), 0.0, -G * cos(radians(10)))
    with opened(engine, WorldModel(h, 1, down, objects=(thing,))) as bench:
        velocity = bench.read("velocity", thing.name)
        bench.step(round(1 / h))
        return (velocity()[0][0],)


def resisted(ball: ObjectBody, ground: float, engine: str) -> tuple[float, float]:
    """Speeds that a ball loses within 1 s: rolling with 1 m/s, and spinning with 5 rad/s."""
    lost = []
    for velocity, spin, part, axis in (((1, 0, 0), (0, 10, 0), 0, 0), ((0, 0, 0), (0, 0, 5), 1, 2)):
        with opened(engine, WorldModel(0.004, 1, ground=Ground(ground), objects=(ball,))) as bench:
            read = bench.read("velocity", "ball")
            bench.place("ball", (0, 0, 0.1), velocity=velocity, spin=spin)
            bench.step(250)
            lost.append((velocity, spin)[part][axis] - read()[part][axis])
    return lost[0], lost[1]


# Bounces and forces


def bounce(share: float, fall: float, h: float, engine: str) -> tuple[float]:
    """The speed upwards (m/s) of a ball that falls by some m onto ground that keeps all speed."""
    ball = ObjectBody("ball", Sphere(0.05), Pose((0, 0, fall + 0.05)), 0.1, restitution=share)
    with opened(engine, WorldModel(h, 1, ground=Ground(restitution=1), objects=(ball,))) as bench:
        velocity = bench.read("velocity", "ball")
        return (bench.record(round(0.5 / h), lambda: velocity()[0][2]).max(),)


def collision(engine: str) -> tuple[float, float]:
    """Of 1 kg with 2 m/s against 3 kg: the momentum stays, and half of the relative speed."""
    pair = [
        ObjectBody(name, Sphere(0.1), Pose((x, 0, 1)), mass, restitution=sqrt(0.5))
        for name, x, mass in (("one", 0, 1.0), ("other", 0.3, 3.0))
    ]
    with opened(engine, WorldModel(0.001, 1, (0, 0, 0), None, objects=tuple(pair))) as bench:
        velocities = [bench.read("velocity", name) for name in ("one", "other")]
        bench.place("one", (0, 0, 1), velocity=(2, 0, 0))
        bench.step(200)
        one, other = (read()[0][0] for read in velocities)
    return one + 3 * other, other - one


def forces(engine: str) -> tuple[float, ...]:
    """Normal forces on a box, a ball, and the lower one of two boxes; the force along the slope of a ramp."""
    objects = (
        replace(CRATE, pose=Pose((3, 0, 0.05))),
        replace(BALL, pose=Pose((-3, 0, 0.1))),
        replace(CRATE, name="lower"),
        replace(CRATE, name="upper", pose=Pose((0, 0, 0.15))),
    )
    numbers = []
    with opened(engine, WorldModel(0.004, 1, objects=objects)) as bench:
        reads = [bench.read("contact_force", (name, None)) for name in ("crate", "ball", "lower", "ground")]
        bench.step(250)
        numbers += [read() for read in reads]
    with opened(engine, slope(20, CRATE)) as bench:
        force = bench.read("contact_force_vector", ("crate", None))
        bench.step(250)
        along, _, across = frames.rotate_back(frames.quaternion(0, radians(20), 0), force())
    return *numbers, -along, across


# Heights at rest


def rest(shape: Shape, rpy: tuple[float, float, float], height: float, engine: str) -> tuple[float, float]:
    """How far a body of 0.5 kg is from its height after 1 s (mm), and how fast it rose before (m/s)."""
    body = ObjectBody("thing", shape, Pose((0, 0, height), rpy), 0.5)
    with opened(engine, WorldModel(0.004, 1, objects=(body,))) as bench:
        pose, velocity = bench.read("pose", "thing"), bench.read("velocity", "thing")
        rows = bench.record(250, lambda: (pose()[0][2], velocity()[0][2]))
    return 1000 * abs(rows[-1, 0] - height), rows[:, 1].max()


SHAPES: tuple[tuple[str, Shape, tuple[float, float, float], float], ...] = (
    ("a box", Box((0.1, 0.08, 0.06)), (0, 0, 0), 0.03),
    ("a ball", Sphere(0.05), (0, 0, 0), 0.05),
    ("a drum on its end", Cylinder(0.04, 0.1), (0, 0, 0), 0.05),
    ("a drum on its side", Cylinder(0.04, 0.1), (pi / 2, 0, 0), 0.04),
    ("a capsule on its side", Capsule(0.03, 0.1), (pi / 2, 0, 0), 0.03),
    ("a cube as a mesh", mesh("cube.obj", CUBE, 0.02), (0, 0, 0), 0.02),
)


# The table

CASES = (
    *(
        Case(
            f"a box with friction {friction:g} slides from {SPEEDS[0]:g} to {SPEEDS[-1]:g} m/s, steps of {1000 * h:g} ms",
            partial(slide, friction, h),
            (
                Quantity("distance / (v²/2µg - vh/2)", 1.0, "", 0.03),
                most("hop, up to 2 m/s", 0.3, "mm"),
                most("hop, from 4 m/s", 1.0, "mm"),
                most("physics steps with a gap above 0.1 mm", 1.0, "%"),
                Quantity("mean normal force / weight", 1.0, "", 0.02, PORT),
            ),
            ALL,
        )
        for friction in (1.0, 0.3)
        for h in (0.001, 0.002, 0.004, 0.008)
    ),
    Case(
        "a box with friction 0.3 slides from 1 m/s at 45 deg to the axes of the world",
        slides_askew,
        (near("distance, v²/2µg - vh/2", 1 / (0.6 * G) - 0.002, "m", 3), most("drift sideways", 0.3, "mm")),
        ALL,
    ),
    *(
        Case(
            f"a box with friction 0.5 on {angle:g} deg for 10 s",
            partial(creep, slope(angle, replace(CRATE, friction=0.5))),
            (most("creep", 0.3, "mm"),),
            ALL,
        )
        for angle in (10, 20)
    ),
    *(
        Case(
            f"five boxes on each other on {angle:g} deg for 10 s",
            partial(creep, slope(angle, *stack(5, sqrt(0.5)), friction=sqrt(0.5))),
            (most("creep", 0.3, "mm"),),
            ALL,
        )
        for angle in (0, 5)
    ),
    Case(
        "a box with friction 0.3 slides down 30 deg for 1 s",
        downhill,
        (near("speed, g (sin a - µ cos a) t", G * (sin(pi / 6) - 0.3 * cos(pi / 6)), "m/s", 2),),
        ALL,
    ),
    *(
        Case(
            f"a box with friction {crate:g} on a ramp with {ramp:g}",
            partial(threshold, partial(sticks, crate, ramp), 5.0, 60.0),
            (near("slides from atan(µ₁µ₂) on", degrees(atan(crate * ramp)), "deg", 1.5),),
            ALL,
        )
        for crate, ramp in ((0.5, 1.0), (0.8, 0.7))
    ),
    Case(
        "a box twice as tall as wide on a slope",
        partial(threshold, stands, 15.0, 40.0),
        (near("tips from atan(1/2) on", degrees(atan(0.5)), "deg", 2),),
        ALL,
    ),
    Case(
        "a ball with friction 0.2 is set down at 2 m/s",
        ball_slides,
        (
            near("speed at last, 5/7 v", 10 / 7, "m/s", 1),
            near("rolls after 2v/7µg", 4 / (1.4 * G), "s", 3),
            most("hop", 0.3, "mm"),
        ),
        ALL,
    ),
    *(
        Case(
            f"a {what} rolls down 10 deg for 1 s, steps of {1000 * h:g} ms",
            partial(rolls_down, replace(BALL, shape=shape, pose=pose), h),
            (near("speed, g sin(a) t / (1 + I/mr²)", G * sin(radians(10)) / (1 + share), "m/s", bar),),
        )
        for what, shape, pose, share, h, bar in (
            ("ball", Sphere(0.1), BALL.pose, 0.4, 0.005, 0.2),
            ("drum", Cylinder(0.1, 0.2), Pose((0, 0, 0.1), (pi / 2, 0, 0)), 0.5, 0.0025, 1.5),
            ("drum", Cylinder(0.1, 0.2), Pose((0, 0, 0.1), (pi / 2, 0, 0)), 0.5, 0.000625, 1.0),
        )
    ),
    *(
        Case(
            f"a ball of 10 cm with rolling friction 5 mm and spinning friction 1 mm, on ground with {ground:g}",
            partial(resisted, replace(BALL, rolling_friction=0.005, spinning_friction=0.001), ground),
            (
                near("rolling, loses 5/7 ρµg/r t", 5 / 7 * 0.005 * ground * G / 0.1, "m/s", 2),
                near("spinning, loses 5/2 σµg/r² t", 2.5 * 0.001 * ground * G / 0.01, "rad/s", 2),
            ),
            ALL,
        )
        for ground in (1.0, 0.5)
    ),
    *(
        Case(
            f"a ball that keeps {share:g} of its speed falls {fall:g} m, steps of {1000 * h:g} ms",
            partial(bounce, share, fall, h),
            (near("speed upwards", share * sqrt(2 * G * fall), "m/s", bar),),
            ALL,
        )
        for share, fall, h, bar in (
            (0.5, 0.25, 0.001, 2),
            (0.8, 0.25, 0.001, 2),
            (0.8, 0.25, 0.004, 5),
            (0.5, 1.0, 0.001, 2),
            (0.5, 1.0, 0.008, 5),
        )
    ),
    Case(
        "two balls of 1 and 3 kg collide and keep half of their relative speed",
        collision,
        (near("momentum", 2.0, "kg m/s", 0.1), near("relative speed", 1.0, "m/s", 3)),
    ),
    Case(
        "forces at rest",
        forces,
        (
            near("a box of 1 kg", G, "N", 0.5),
            near("a ball of 2 kg", 2 * G, "N", 0.5),
            near("a box that carries another one", 3 * G, "N", 0.5),
            near("the ground below all", 5 * G, "N", 0.5),
            near("along 20 deg, mg sin a", G * sin(radians(20)), "N", 1),
            near("across 20 deg, mg cos a", G * cos(radians(20)), "N", 1),
        ),
    ),
    *(
        Case(
            f"{name} at rest",
            partial(rest, shape, rpy, height),
            (most("off its height", 0.5, "mm"), most("speed upwards", 0.01, "m/s")),
            ALL,
        )
        for name, shape, rpy, height in SHAPES
    ),
)
