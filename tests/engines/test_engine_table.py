"""What engines owe the port, as ONE table: worlds, calls, and the numbers that readers then give.

Each row is tried in every engine that has what it needs. Its courses follow each other in one engine, and the
first one comes again at last, since what an episode draws holds until the next reset.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from math import cos, exp, inf, pi, sin, sqrt
from typing import Any

import pytest

from deepbots_cli.port import Engine
from deepbots_cli.program.world import Arena, Ground, ObjectBody, RobotBody, WorldModel
from deepbots_cli.robots.model import (
    Box,
    Capsule,
    Cylinder,
    Geometry,
    Inertial,
    Joint,
    Limit,
    Link,
    Mimic,
    Pose,
    RobotModel,
    Shape,
    Sphere,
    with_joint,
    with_link,
)
from tests.engines.conftest import Worlds, block

Call = Callable[[Engine], Any]
Calls = Sequence[Call]
Vector = tuple[float, float, float]


def drawn(what: str, place: tuple[str, ...], *values: float) -> Call:
    """A parameter that varies by episode."""
    return lambda engine: engine.set_parameter(what, place, *values)


def joint(name: str, position: float, velocity: float = 0.0) -> Call:
    return lambda engine: engine.set_joint("robot", name, position, velocity)


def motor(kind: str, joints: str, *options: Any, to: float | Sequence[float], **curve: Any) -> Call:
    """A motor, or one for several joints, and its command."""
    command = [to] if isinstance(to, float) else to
    return lambda engine: getattr(engine, kind)("robot", joints.split(), *options, **curve)(command)


def push(body: tuple[str, str | None], force: Vector, torque: Vector, *frame: str) -> Call:
    return lambda engine: engine.pusher(body, *frame)(force, torque)


def state(joints: str, *parts: int) -> Call:
    """Reads positions (0) and velocities (1) of joints."""

    def bound(engine: Engine) -> Callable[[], list[float]]:
        read = engine.joint_states("robot", joints.split())
        return lambda: [one[part] for one in read() for part in parts]

    return bound


def torques(joints: str) -> Call:
    return lambda engine: engine.joint_torques("robot", joints.split())


def flat(method: str, *place: Any) -> Call:
    """Reads the numbers of vectors in a row, such as those of a velocity."""

    def bound(engine: Engine) -> Callable[[], list[float]]:
        read = getattr(engine, method)(*place)
        return lambda: [number for part in read() for number in part]

    return bound


@dataclass(frozen=True)
class Row:
    """What follows from `begin` after some timesteps; by course, the calls before it and the numbers of all
    readers."""

    world: WorldModel
    begin: Calls
    timesteps: int
    read: Calls
    courses: Sequence[tuple[Calls, Iterable[float]]]
    rel: float = 0.01
    abs: float = 0.0
    needs: str = ""
    """What some engines lack."""
    only: str = ""
    """The one engine that keeps it."""


def fixed(*links: Link, joints: Sequence[Joint], substeps: int = 5, **figures: Any) -> WorldModel:
    """A robot whose first link stands in the air."""
    model = RobotModel("robot", links, tuple(joints), root=links[0].name)
    return WorldModel(0.02, substeps, ground=None, robots=(RobotBody("robot", model, True),), **figures)


def with_figures(world: WorldModel, change: Callable[[RobotModel], RobotModel]) -> WorldModel:
    (robot,) = world.robots
    return replace(world, robots=(replace(robot, model=change(robot.model)),))


WEIGHTLESS = (0.0, 0.0, 0.0)
BASE = block("base")
CART, POLE, ARM = (("robot", name) for name in ("cart", "pole", "arm"))
LEVEL = joint("hinge", pi / 2)
"""The pole of `Worlds.rail` hands no force on along the rail: a force there moves 1.1 kg."""
ARM_MASS, ARM_INERTIA = 2.0, 0.02
ABOUT_HINGE = ARM_INERTIA + ARM_MASS * (0.3**2 + 0.1**2)
"""Of the link of `Worlds.rotor`: kg, and kg m^2 about its center and about its hinge."""
STALL, NO_LOAD, MOST = 8.0, 10.0, 5.0
"""Stall torque (N m), no-load speed (rad/s) and limit (N m) of a motor on this hinge."""
CURVE = {"stall_torque": [STALL], "no_load_speed": [NO_LOAD]}
SPIN_UP = motor("torque_motor", "hinge", [10.0], to=2.0)


def spun_up(inertia: float) -> list[float]:
    """The speed that `SPIN_UP` gives in 1 ms."""
    return [2.0 * 0.001 / inertia]


def turning(x: float, y: float) -> float:
    """The inertia about the hinge of `Worlds.rotor` with the center of mass there."""
    return ARM_INERTIA + ARM_MASS * (x * x + y * y)


def curved(kind: str, velocity: float, wanted: float, expected: float) -> Row:
    """The torque of a motor falls with its speed."""
    spring = kind == "position_motor"
    target = 0.3 + (wanted + 0.5 * velocity) / 10.0 if spring else wanted
    gains = ([10.0], [0.5]) if spring else ()
    return Row(
        Worlds.rotor(0.0001, 1),
        (motor(kind, "hinge", [MOST], *gains, to=target, **CURVE), joint("hinge", 0.3, velocity)),
        1,
        (torques("hinge"), state("hinge", 1)),
        [((), (expected, velocity + expected / ABOUT_HINGE * 0.0001))],
        abs=2e-6,
        rel=0.0,
    )


def sliding(crate: float, ground: float) -> list[float]:
    """The speed after 0.5 s on 30 degrees."""
    return [max(0.0, 9.81 * (sin(pi / 6) - crate * ground * cos(pi / 6)) * 0.5)]


def slope(friction: float) -> WorldModel:
    return replace(Worlds.slope(pi / 6, friction), timestep=0.01, substeps=10)


def pooled() -> WorldModel:
    thing = ObjectBody("thing", Sphere(0.05), mass=0.3, pooled=True)
    return WorldModel(0.01, 1, WEIGHTLESS, None, objects=(thing,))


def arm_link(name: str) -> Link:
    return Link(name, Inertial(0.5, Pose((0.2, 0, 0)), 0.001, iyy=0.005, izz=0.005))


SWING = 0.005 + 0.5 * 0.2**2
"""The inertia of such an arm about its joint, kg m^2."""


def hinged(damping: float, kind: str = "continuous", limit: Limit | None = None) -> WorldModel:
    hinge = Joint("hinge", kind, "base", "arm", axis=(0, 0, 1), limit=limit or Limit(), damping=damping)
    return fixed(BASE, arm_link("arm"), joints=[hinge])


def almost_weightless(inertia: float) -> WorldModel:
    tip = Link("tip", Inertial(1e6 * inertia, ixx=inertia, iyy=inertia, izz=inertia))
    hinge = Joint("hinge", "continuous", "base", "tip", axis=(0, 0, 1), damping=0.1)
    return fixed(BASE, tip, joints=[hinge])


def geared() -> WorldModel:
    """A joint with a range, and one that follows it at twice its speed."""
    leader = Joint("leader", "revolute", "base", "arm", axis=(0, 0, 1), limit=Limit(-1.0, 0.5))
    follower = Joint("follower", "continuous", "base", "other", axis=(0, 0, 1), mimic=Mimic("leader", 2.0))
    return fixed(BASE, arm_link("arm"), arm_link("other"), joints=[leader, follower])


def locked() -> WorldModel:
    """An arm of two parts, between which damping leaves no motion."""
    wrist = Joint("wrist", "continuous", "arm", "hand", Pose((0.4, 0, 0)), (0, 0, 1), damping=1e3)
    hinge = Joint("hinge", "continuous", "base", "arm", axis=(0, 0, 1), damping=3.0)
    return fixed(BASE, arm_link("arm"), arm_link("hand"), joints=[hinge, wrist])


def beside() -> WorldModel:
    """A damped arm beside one that is free."""
    hinge = Joint("hinge", "continuous", "base", "arm", axis=(0, 0, 1), damping=5.0)
    other = Joint("other", "continuous", "base", "load", Pose((0, 1, 0)), (0, 0, 1))
    return fixed(BASE, arm_link("arm"), arm_link("load"), joints=[hinge, other], substeps=1)


def halves(damping: float) -> WorldModel:
    """A free body of two halves on a hinge, with 0.01 and 0.03 kg m^2."""
    links = tuple(
        Link(name, Inertial(1.0, ixx=0.02, iyy=0.02, izz=izz)) for name, izz in (("a", 0.01), ("b", 0.03))
    )
    hinge = Joint("hinge", "continuous", "a", "b", Pose((0, 0, 0.1)), (0, 0, 1), damping=damping)
    return WorldModel(
        0.02, 5, WEIGHTLESS, None, robots=(RobotBody("robot", RobotModel("pair", links, (hinge,), root="a")),)
    )


def weight(
    kind: str,
    axis: Vector,
    turned: Vector = WEIGHTLESS,
    gravity: float = -9.81,
    leaning: Vector = (0.3, 0.2, 0.1),
) -> WorldModel:
    """A weight beside the axis of a joint on a fixed base."""
    arm = Link("arm", Inertial(2.0, Pose((0.3, 0.1, 0), leaning), 0.02, iyy=0.03, izz=0.04))
    held = Joint("hinge", kind, "base", "arm", Pose((0.2, 0, 0), turned), axis)
    return fixed(BASE, arm, joints=[held], substeps=4, gravity=(0, 0, gravity))


WEIGHT = 2.0 * 9.81


def carrying(kind: str, axis: Vector, driven: str) -> Row:
    """The wrench in a joint includes what its motor exerts."""
    load = WEIGHT if kind == "prismatic" else -0.3 * WEIGHT
    gains, start, to = {
        "velocity_motor": ((), 0.0, 0.0),
        "torque_motor": ((), 0.0, load),
        "position_motor": (([2000.0], [200.0]), load / 2000.0, load / 1000.0),
    }[driven]
    return Row(
        weight(kind, axis),
        (motor(driven, "hinge", [1000.0], *gains, to=to), joint("hinge", start)),
        1,
        (flat("joint_wrench", ARM),),
        [((), (0.0, 0.0, WEIGHT, 0.1 * WEIGHT, -0.3 * WEIGHT, 0.0))],
        abs=0.3,
    )


def lead(
    multiplier: float,
    offset: float,
    limit: Limit | None = None,
    a: float = 0.1,
    b: float = 0.1,
    **figures: Any,
) -> WorldModel:
    """A joint, one that follows it, and one that follows the follower with the opposite sign."""
    masses = {"base": 1.0, "a": a, "b": b, "c": 1e-3}
    links = [Link(name, Inertial(m, ixx=1e-3 * m, iyy=1e-3 * m, izz=1e-3 * m)) for name, m in masses.items()]
    slides = [
        Joint("second", "prismatic", "base", "c", axis=(0, 0, 1), mimic=Mimic("first", -1.0)),
        Joint("lead", "prismatic", "base", "a", Pose((0, 0.2, 0)), (0, 0, 1), Limit(-0.5, 0.5)),
        Joint(
            "first",
            "prismatic",
            "base",
            "b",
            Pose((0, -0.2, 0)),
            (0, 0, 1),
            limit or Limit(),
            mimic=Mimic("lead", multiplier, offset),
        ),
    ]
    return fixed(*links, joints=slides, **({"substeps": 4} | figures))


def pushed(name: str, multiplier: float, offset: float) -> Row:
    """A force on one side moves both as a gear does: the mass that it moves is that of the leader + multiplier^2
    * that of the follower."""
    pace = (1.0 if name == "lead" else multiplier) / (0.2 + multiplier**2 * (0.3 + 1e-3))
    way = 0.5 * pace * 0.2**2
    return Row(
        lead(multiplier, offset, a=0.2, b=0.3, substeps=20, gravity=WEIGHTLESS),
        (motor("torque_motor", name, [100.0], to=1.0),),
        10,
        (state("lead", 0, 1), state("first", 0)),
        [((), (way, 0.2 * pace, multiplier * way + offset))],
        rel=0.02,
        abs=1e-3,
    )


def thing(name: str, shape: Shape, at: Vector, **figures: Any) -> ObjectBody:
    return ObjectBody(name, shape, Pose(at), **figures)


def things(
    *objects: ObjectBody, slope: tuple[float, float] = (0, 0), arena: Arena | None = None
) -> WorldModel:
    """Objects on ground that leans, as gravity does instead of it."""
    return WorldModel(0.02, 4, (*slope, -9.81), arena=arena, objects=objects)


CRATE, ROLLER = Box((0.1, 0.1, 0.1)), Sphere(0.05)
SOLIDS: dict[str, tuple[Shape, float]] = {
    "sphere": (Sphere(0.1), 0.1),
    "box": (Box((0.2, 0.3, 0.4)), 0.1),
    "cylinder": (Cylinder(0.1, 0.3), 0.1),
    "capsule": (Capsule(0.1, 0.3), 0.1),
}
"""Solids, and half their width along x."""


def gap(one: str, other: str) -> Call:
    return lambda engine: lambda: [engine.clearance((one, None), (other, None))()]


def gap_between(one: str, other: str, apart: float) -> Row:
    (shape, half), (other_shape, other_half) = SOLIDS[one], SOLIDS[other]
    world = things(
        thing("one", shape, (0, 0, 1), fixed=True),
        thing("other", other_shape, (half + other_half + apart, 0, 1), fixed=True),
    )
    return Row(world, (), 0, (gap("one", "other"),), [((), [apart])], rel=0.0, abs=1e-6)


def tray() -> WorldModel:
    """A lever whose weight is at its axis; frames beside it have none."""
    frames = [Link(f"frame_{i}") for i in range(5)]
    joints = [Joint(f"hold_{i}", "fixed", "body", f"frame_{i}", Pose((0.3, 0, 0))) for i in range(5)]
    hinge = Joint("hinge", "continuous", "wall", "body", axis=(0, 1, 0))
    return fixed(Link("wall"), block("body"), *frames, joints=[*joints, hinge], substeps=4)


def spinner() -> WorldModel:
    """A wheel of 80 g in the air, with a range of half a turn."""
    tire = (Geometry(Cylinder(0.03, 0.02), Pose(rpy=(pi / 2, 0, 0))),)
    wheel = Link("wheel", Inertial(0.08, ixx=2e-5, iyy=3.6e-5, izz=2e-5), tire, tire)
    axle = Joint("axle", "revolute", "base", "wheel", Pose((0, 0, 1)), (0, 1, 0), Limit(-pi / 2, pi / 2))
    return replace(fixed(BASE, wheel, joints=[axle], substeps=1), timestep=0.016)


BALL = ObjectBody("ball", Sphere(0.05), mass=0.1, restitution=0.8)


def fastest(engine: Engine) -> Callable[[], list[float]]:
    """Lets the ball fall by 25 cm, and reads the largest speed upwards of 0.4 s."""
    read = engine.velocity("ball")

    def speed() -> float:
        engine.step(1)
        return read()[0][2]

    def fall() -> list[float]:
        engine.place("ball", (0, 0, 0.3), (0, 0, 0, 1))
        return [max(speed() for _ in range(400))]

    return fall


ROWS: dict[str, Row] = {
    f"a torque acts alike over any number of substeps ({substeps})": Row(
        Worlds.rail(0.01, substeps),
        (LEVEL, motor("torque_motor", "slide", [5.0], to=2.0)),
        1,
        (state("slide", 1), torques("slide")),
        [((), (2.0 / 1.1 * 0.01, 2.0))],
    )
    for substeps in (1, 2, 4, 8)
}
ROWS |= {
    f"the torque of a {kind} falls with its speed ({velocity}, {wanted})": curved(
        kind, velocity, wanted, expected
    )
    for kind in ("torque_motor", "position_motor")
    for velocity, wanted, expected in (
        (0.0, 99.0, MOST),
        (2.0, 99.0, MOST),
        (6.0, 99.0, STALL * 0.4),
        (6.0, 1.5, 1.5),
        (12.0, 99.0, 0.0),
        (6.0, -99.0, -MOST),
        (-4.0, 99.0, MOST),
        (-6.0, -99.0, -STALL * 0.4),
    )
}
ROWS |= {
    f"the torque of a spring is limited and damped ({velocity}, {target})": Row(
        Worlds.rail(0.001, 1),
        (
            joint("slide", 0.0, velocity),
            motor("position_motor", "slide", [5.0], [20.0], [3.0], to=target),
        ),
        1,
        (torques("slide"),),
        [((), (expected,))],
    )
    for velocity, target, expected in ((0.0, 0.1, 2.0), (0.5, 0.1, 0.5), (0.0, -9.0, -5.0), (0.0, 9.0, 5.0))
}
ROWS |= {
    f"the wrench in a {kind} joint includes what its {driven} exerts": carrying(kind, axis, driven)
    for driven in ("velocity_motor", "torque_motor", "position_motor")
    for kind, axis in (("revolute", (0, 1, 0)), ("prismatic", (0, 0, 1)))
}
ROWS |= {
    f"a push on a link turns its joint, in the frame of the {frame}": Row(
        Worlds.rotor(0.001, 1),
        (joint("hinge", 0.6), push(ARM, (3.0, 2.0, 0.0), (0.0, 0.0, 0.4), frame)),
        1,
        (state("hinge", 1),),
        [((), [0.4 / ABOUT_HINGE * 0.001])],  # the force acts on the axis and turns nothing
        rel=1e-3,
    )
    for frame in ("world", "link")
}
ROWS |= {
    f"a damped hinge of a free body takes the turn of both its halves ({share})": Row(
        halves(share * 0.0075 / 0.004),
        (joint("hinge", 0.0, 2.0),),
        40,
        (state("hinge", 0), flat("velocity", "robot")),
        [((), (2.0 * 0.004 / share, 0, 0, 0, 0, 0, 2.0 * 0.03 / 0.04))],
        abs=1e-6,
    )
    for share in (0.1, 10.0)
}
ROWS |= {
    f"a damped joint of a frame that weighs almost nothing comes to rest ({inertia})": Row(
        almost_weightless(inertia),
        (joint("hinge", 0.0, 2.0),),
        1,
        (state("hinge", 1),),
        [((), [0.0])],
        abs=1e-6,
    )
    for inertia in (1e-12, 1e-14)
}
ROWS |= {
    f"a force on {name} moves leader and follower ({multiplier}, {offset})": pushed(name, multiplier, offset)
    for name in ("lead", "first")
    for multiplier, offset in ((1.0, 0.0), (-1.0, 0.0), (0.5, 0.1), (-2.0, 0.05))
}
ROWS |= {
    f"the gap between a {one} and a {other} is {apart}": gap_between(one, other, apart)
    for one in SOLIDS
    for other in SOLIDS
    for apart in (0.003, 0.5, 30.0)
}
ROWS |= {
    f"a strong motor on a light wheel is stable, and its range is in radians ({timesteps})": Row(
        spinner(),
        (motor("velocity_motor", "axle", [10.0], to=5.0),),
        timesteps,
        (state("axle", *parts),),
        [((), expected)],
        rel=1e-3,
        abs=0.05 if timesteps > 10 else 0.0,
    )
    for timesteps, parts, expected in ((10, (1,), [5.0]), (60, (0,), [pi / 2]))
}
ROWS |= {
    "the gap to the ground, to what overlaps and to nothing solid": Row(
        things(
            thing("ball", ROLLER, (0, 0, 1), mass=0.2),
            thing("inside", ROLLER, (0.05, 0, 1), mass=0.2),
            thing("ghost", Sphere(0.1), (1, 0, 1), solid=False),
        ),
        (),
        0,
        (gap("ball", "ground"), gap("ball", "inside"), gap("ball", "ghost")),
        [((), (0.95, 0.0, inf))],
        abs=1e-6,
        rel=0.0,
    ),
    "the gap to a corner, which a margin of 1 mm rounds": Row(
        things(
            thing("ball", ROLLER, (0, 0, 1), mass=0.2),
            ObjectBody("turned", Box((0.2, 0.2, 0.2)), Pose((1, 0, 1), (0, 0, pi / 4)), fixed=True),
        ),
        (),
        0,
        (gap("ball", "turned"),),
        [((), [0.95 - 0.1 * sqrt(2)])],
        abs=5e-4,
        rel=0.0,
    ),
    "a body that stays where it is has no velocity": Row(
        things(
            thing("post", Box((1, 1, 1)), (0, 0, 0), fixed=True),
            thing("mark", Box((1, 1, 1)), (0, 0, 0), mass=1.0, solid=False),
        ),
        [
            lambda engine, body=body: engine.place(body, (9, 0, 1), (0, 0, 0, 1), (1, 2, 3), (4, 5, 6))
            for body in ("post", "mark")
        ],
        0,
        (flat("velocity", "post"), flat("velocity", "mark")),
        [((), (0.0,) * 12)],
    ),
    "an object stays within the walls": Row(
        things(thing("ball", ROLLER, (0, 0, 0.05), mass=0.2), slope=(6, 2), arena=Arena((0.6, 0.4), 0.1)),
        (),
        200,
        (lambda engine: lambda: engine.pose("ball")()[0],),
        [((), (0.25, 0.15, 0.05))],
        abs=2e-3,
    ),
    "a fixed object stands, also where it was placed, and one that is not solid stops nothing": Row(
        things(
            thing("wall", CRATE, (0.5, 0, 0.05), fixed=True),
            thing("ghost", CRATE, (0.5, 1, 0.05), solid=False),
            thing("stopped", ROLLER, (0, 0, 0.05), mass=0.2),
            thing("passes", ROLLER, (0, 1, 0.05), mass=0.2),
            slope=(3, 0),
        ),
        (),
        150,
        [
            lambda engine, name=name: lambda: [engine.pose(name)()[0][0]]
            for name in ("stopped", "passes", "wall")
        ],
        [
            ((), (0.4, 0.5 * 5 / 7 * 3.0 * 9.0, 0.5)),
            (
                [lambda engine: engine.place("wall", (0.8, 0, 0.05), (0, 0, 0, 1))],
                (0.7, 0.5 * 5 / 7 * 3.0 * 9.0, 0.8),
            ),
        ],
        rel=0.01,
    ),
    "a joint may turn fast": Row(
        Worlds.rotor(), (joint("hinge", 0.0, 500.0),), 1, (state("hinge", 1),), [((), [500.0])], rel=1e-6
    ),
    "links without inertial weigh nothing": Row(
        tray(), (), 1, (state("hinge", 1),), [((), [0.0])], abs=1e-12
    ),
    "a strong velocity motor reaches its target within a timestep, on several joints": Row(
        Worlds.rail(),
        (motor("velocity_motor", "slide hinge", [1000.0, 1000.0], to=(0.7, -0.4)),),
        1,
        (state("slide hinge", 1),),
        [((), (0.7, -0.4))],
        abs=1e-3,
    ),
    "a servo settles on its target": Row(
        Worlds.rail(),
        (motor("position_motor", "slide", [100.0], None, None, to=0.3),),
        25,
        (state("slide", 0),),
        [((), [0.3])],
    ),
    "a motor that is bound again replaces the earlier": Row(
        Worlds.rail(0.01, 1),
        (
            LEVEL,
            motor("position_motor", "slide", [1000.0], [100.0], None, to=0.1),
            motor("position_motor", "slide", [4.0], [100.0], [0.0], to=0.1),
        ),
        1,
        (torques("slide"),),
        [((), [4.0])],
    ),
    "a motor without a curve takes over from one with a curve, and the other way around": Row(
        Worlds.rotor(0.001, 1),
        (),
        1,
        (torques("hinge"),),
        [
            (calls, [torque])
            for plain, weak in [
                (
                    motor("torque_motor", "hinge", [4.0], to=100.0),
                    motor("torque_motor", "hinge", [5.0], to=100.0, stall_torque=[1.0], no_load_speed=[1.0]),
                )
            ]
            for calls, torque in (((plain, weak), 1.0), ((plain, weak, plain), 4.0))
        ],
        only="mujoco",
    ),
    "a motor approaches its no-load speed by an exponential": Row(
        Worlds.rotor(0.2, 2000),
        (motor("torque_motor", "hinge", [100.0], to=100.0, **CURVE),),
        1,
        (state("hinge", 1),),
        [((), [NO_LOAD * (1.0 - exp(-STALL / NO_LOAD / ABOUT_HINGE * 0.2))])],
        rel=1e-3,
    ),
    "a velocity motor's limit moves a joint with the armature of the episode": Row(
        Worlds.rotor(0.001, 1),
        (motor("velocity_motor", "hinge", [2.0], to=1000.0),),
        10,
        (state("hinge", 1), torques("hinge")),
        [
            ([drawn("joint_armature", ("robot", "hinge"), armature)], (0.02 / (ABOUT_HINGE + armature), 2.0))
            for armature in (0.5, 0.1)
        ],
        rel=1e-3,
        needs="armature",
    ),
    "an armature adds to the inertia at its joint": Row(
        with_figures(Worlds.rotor(0.001, 1), lambda model: with_joint(model, "hinge", armature=0.3)),
        (SPIN_UP,),
        1,
        (state("hinge", 1),),
        [
            ((), spun_up(ABOUT_HINGE + 0.3)),
            ([drawn("joint_armature", ("robot", "hinge"), 0.1)], spun_up(ABOUT_HINGE + 0.1)),
            ([drawn("joint_armature", ("robot", "hinge"), 0.0)], spun_up(ABOUT_HINGE)),
        ],
        rel=1e-3,
        needs="armature",
    ),
    "a factor scales the inertia beside the mass": Row(
        Worlds.rotor(0.001, 1),
        (SPIN_UP,),
        1,
        (state("hinge", 1),),
        [
            ((), spun_up(ABOUT_HINGE)),
            ([drawn("inertia", ARM, 5.0)], spun_up(ABOUT_HINGE + 4.0 * ARM_INERTIA)),
            (
                [drawn("inertia", ARM, 5.0), drawn("mass", ARM, 3.0)],
                spun_up(1.5 * (ABOUT_HINGE + 4.0 * ARM_INERTIA)),
            ),
            ([drawn("mass", ARM, 3.0)], spun_up(1.5 * ABOUT_HINGE)),
        ],
        rel=1e-3,
    ),
    "the center of mass moves": Row(
        with_figures(
            Worlds.rotor(0.001, 1),
            lambda model: with_link(model, replace(model.link("arm"), center_varies=True)),
        ),
        (SPIN_UP,),
        1,
        (state("hinge", 1),),
        [
            ((), spun_up(ABOUT_HINGE)),
            ([drawn("center_of_mass", ARM, -0.3, -0.1, 0.0)], spun_up(turning(0.0, 0.0))),
            ([drawn("center_of_mass", ARM, 0.2, -0.4, 0.0)], spun_up(turning(0.5, -0.3))),
        ],
        rel=1e-3,
        needs="center_of_mass",
    ),
    "a new mass moves the cart as Newton says": Row(
        Worlds.rail(0.01, 1),
        (LEVEL, motor("torque_motor", "slide", [10.0], to=2.0)),
        1,
        (state("slide", 1),),
        [((), [2.0 / 1.1 * 0.01]), ([drawn("mass", CART, 3.0)], [2.0 / 3.1 * 0.01])],
    ),
    "a new mass scales the inertia along, so a pendulum swings alike": Row(
        Worlds.rail(0.001, 1),
        (drawn("mass", CART, 1e6), joint("hinge", 0.3)),
        1,
        (state("hinge", 1),),
        [(draws, [1.5 * 9.81 * sin(0.3) * 0.001]) for draws in ((), [drawn("mass", POLE, 5.0)])],
        rel=1e-3,
    ),
    "the mass of an absent body is kept for its entrance": Row(
        pooled(),
        (
            lambda engine: engine.place("thing", (0, 0, 0), (0, 0, 0, 1)),
            push(("thing", None), (3.0, 0, 0), (0, 0, 0.01)),
        ),
        1,
        (flat("velocity", "thing"),),
        [
            (draws, (0.03 / mass, 0, 0, 0, 0, 1e-4 / (0.4 * mass * 0.05**2)))
            for draws, mass in (((), 0.3), ([drawn("mass", ("thing", ""), 1.5)], 1.5))
        ],
        rel=1e-6,
    ),
    "another gravity is felt": Row(
        Worlds.ball(),
        (),
        1,
        (flat("velocity", "ball"),),
        [
            ((), (0.0, 0.0, -0.1962, 0, 0, 0)),
            ([drawn("gravity", (), 1.0, 0.0, -2.0)], (0.02, 0.0, -0.04, 0, 0, 0)),
        ],
        rel=1e-9,
    ),
    "friction of a joint slows": Row(
        replace(Worlds.rail(0.01), gravity=WEIGHTLESS),
        (joint("slide", 0.0, 1.0), LEVEL),
        10,
        (state("slide", 1),),
        [((), [1.0]), ([drawn("joint_friction", ("robot", "slide"), 2.2)], [1.0 - 2.2 / 1.1 * 0.1])],
    ),
    "friction of a joint holds what is weaker": Row(
        Worlds.rail(friction=5.0),
        (joint("hinge", pi), joint("slide", 0.0, 1.0)),
        30,
        (state("slide", 1),),
        [((), [0.0])],
        abs=1e-3,
    ),
    "damping of a joint brings it to rest": Row(
        replace(hinged(0.05), gravity=WEIGHTLESS),
        (joint("hinge", 0.0, 2.0),),
        50,
        (state("hinge", 0),),
        [
            ((), [2.0 * SWING / 0.05 * (1.0 - exp(-0.05 / SWING))]),
            ([drawn("joint_damping", ("robot", "hinge"), 40.0)], [2.0 * SWING / 40.0]),
        ],
    ),
    "a damped joint of another mass does not speed up": Row(
        hinged(100.0),
        (joint("hinge", 0.0, 2.0),),
        1,
        (state("hinge", 0, 1),),
        [(draws, (0.0, 0.0)) for draws in ((), *([drawn("mass", ARM, mass)] for mass in (0.1, 2.5)))],
        abs=0.05,
    ),
    "a damped joint comes to rest beside a link that an episode makes heavier": Row(
        beside(),
        (joint("hinge", 0.0, 2.0),),
        20,
        (state("hinge", 0),),
        [(draws, [2.0 * SWING / 5.0]) for draws in ((), [drawn("mass", ("robot", "load"), 3.0)])],
    ),
    "a joint beyond one that damping locks moves as one body": Row(
        locked(),
        (joint("hinge", 0.0, 2.0),),
        50,
        (state("hinge wrist", 0),),
        [((), (2.0 * (SWING + 0.005 + 0.5 * 0.6**2) / 3.0, 0.0))],
        abs=0.002,
    ),
    "a spring moves a joint whose own damping a step cannot follow": Row(
        hinged(20.0),
        (motor("position_motor", "hinge", [1e3], [100.0], None, to=0.5),),
        10,
        (state("hinge", 0),),
        [((), [0.5 * (1.0 - exp(-100.0 * 0.2 / 20.0))])],
        rel=0.02,
    ),
    "a servo rests at a limit that its target lies beyond": Row(
        hinged(0.0, "revolute", Limit(-1.0, 0.5)),
        (motor("position_motor", "hinge", [50.0], None, None, to=3.0),),
        50,
        (state("hinge", 0), torques("hinge")),
        [((), (0.5, 0.0))],
        abs=0.01,
    ),
    "a joint that holds a weight exerts its force and torque": Row(
        weight("fixed", (0, 0, 1), (0, pi / 2, 0)),  # x of the arm points down
        (),
        1,
        (flat("joint_wrench", ARM),),
        [((), (-WEIGHT, 0.0, 0.0, 0.0, 0.0, 0.1 * WEIGHT))],
        abs=1e-6,
    ),
    "a joint holds a weight on a circle": Row(
        weight("continuous", (0, 0, 1), gravity=0.0, leaning=WEIGHTLESS),
        (joint("hinge", 0.7, 5.0),),
        1,
        (flat("joint_wrench", ARM),),
        [((), (-50.0 * 0.3, -50.0 * 0.1, 0.0, 0.0, 0.0, 0.0))],
        abs=0.05,
    ),
    "a leg carries what is above its joint": Row(
        Worlds.stand(0.0),
        (motor("velocity_motor", "knee", [100.0], to=0.0),),
        50,
        (flat("joint_wrench", ("robot", "leg")),),
        [((), (0.0, 0.0, -5.0 * 9.81, 0.0, 0.0, 0.0))],
        abs=0.1,
    ),
    "a follower with the multiplier 0 stays at its offset": Row(
        lead(0.0, 0.1),
        (motor("position_motor", "lead", [20.0], None, None, to=0.3),),
        40,
        (state("lead first", 0),),
        [((), (0.3, 0.1))],
        abs=1e-3,
    ),
    "a start of the leader is one of its followers too": Row(
        lead(-2.0, 0.1, Limit(-0.9, 1.1)),
        (),
        0,
        (state("lead first second", 0, 1),),
        [
            ((), (0.0, 0.0, 0.1, 0.0, -0.1, 0.0)),
            ([joint("lead", 0.2, 0.5)], (0.2, 0.5, -0.3, -1.0, 0.3, 1.0)),
        ],
        abs=1e-9,
    ),
    "the follower of a joint that began far beyond its limit does not jolt it": Row(
        geared(),
        (joint("leader", 1.0),),
        1,
        (state("leader follower", 0, 1),),
        [((), (0.5, 0.0, 1.0, 0.0))],
        abs=1e-3,
        only="pybullet",
    ),
    "a crate slides as its friction says": Row(
        slope(1.0),
        (),
        50,
        (lambda engine: lambda: [engine.velocity("crate")()[0][0]],),
        [
            ((), sliding(1.0, 1.0)),
            ([drawn("lateral_friction", ("crate", ""), 0.4)], sliding(0.4, 1.0)),
            ([drawn("lateral_friction", ("ground", ""), 0.3)], sliding(1.0, 0.3)),
        ],
        rel=0.05,
        abs=5e-3,
    ),
    "the friction of a pair is the product": Row(
        slope(0.5),
        (),
        50,
        (lambda engine: lambda: [engine.velocity("crate")()[0][0]],),
        [((), sliding(0.5, 1.0)), ([drawn("lateral_friction", ("ground", ""), 0.6)], sliding(0.5, 0.6))],
        rel=0.05,
    ),
    "a ball bounces as its restitution says": Row(
        WorldModel(0.001, 1, ground=Ground(1.0, 1.0), objects=(BALL,)),
        (),
        0,
        (fastest,),
        [
            (draws, [share * sqrt(2 * 9.81 * 0.25)])
            for draws, share in (((), 0.8), ([drawn("restitution", ("ball", ""), 0.4)], 0.4))
        ],
        rel=0.02,
    ),
}


@pytest.mark.parametrize("name", ROWS)
def test_the_calls_of_a_row_give_its_numbers(engine_name, name, build):
    row = ROWS[name]
    engine = build(engine_name, Worlds.ball())
    if row.only not in ("", engine_name) or not {row.needs} <= {"", *engine.capabilities}:
        pytest.skip("it is of other engines")
    engine = build(engine_name, row.world)
    readers = [bind(engine) for bind in row.read]
    for before, expected in (*row.courses, row.courses[0]):
        engine.reset()
        for call in (*before, *row.begin):
            call(engine)
        for _ in range(row.timesteps):
            engine.step(row.world.substeps)
        numbers = [number for read in readers for number in read()]
        assert numbers == pytest.approx(list(expected), rel=row.rel, abs=row.abs)
