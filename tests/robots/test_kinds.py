"""What kind of robot a file describes: decided by structure, whatever its parts are called, whichever end
comes first in the file, and however large it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from math import cos, pi, sin

import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepbots_cli.robots.build import Build
from deepbots_cli.robots.kinds import Kind, judge
from deepbots_cli.robots.model import (
    Box,
    Cylinder,
    Geometry,
    Inertial,
    Joint,
    JointType,
    Limit,
    Link,
    Pose,
    RobotModel,
    Vector,
    with_scale,
)

LIMITED = Limit(-1.5, 1.5, 5.0, 20.0)
ENDLESS = Limit(None, None, 20.0, 5.0)
FREE = Limit()
X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


def part(name: str, size: Vector, mass: float = 0.3, at: Vector = (0.0, 0.0, 0.0)) -> Link:
    """Return a box with the moments of a ball of about its size."""
    moment = mass * max(size) ** 2 / 6
    inertial = Inertial(mass, Pose(at), ixx=moment, ixy=0.0, ixz=0.0, iyy=moment, iyz=0.0, izz=moment)
    return Link(name, inertial, (), (Geometry(Box(size), Pose(at)),))


def tire(name: str, radius: float = 0.05) -> Link:
    inertial = Inertial(0.1, Pose(), ixx=1e-4, ixy=0.0, ixz=0.0, iyy=1e-4, iyz=0.0, izz=1e-4)
    return Link(name, inertial, (), (Geometry(Cylinder(radius, 0.02), Pose(rpy=(pi / 2, 0.0, 0.0))),))


def hinge(
    parent: str,
    child: str,
    at: Vector,
    axis: Vector = Y,
    limit: Limit = LIMITED,
    kind: JointType = "revolute",
    rpy: Vector = (0.0, 0.0, 0.0),
) -> Joint:
    return Joint(f"{child}_joint", kind, parent, child, Pose(at, rpy), axis, limit)


def wheel(parent: str, child: str, at: Vector, limit: Limit = ENDLESS, yaw: float = 0.0) -> Joint:
    return hinge(parent, child, at, Y, limit, "continuous", (0.0, 0.0, yaw))


def assembled(parts: Sequence[Link | Joint], name: str = "robot") -> RobotModel:
    links = tuple(piece for piece in parts if isinstance(piece, Link))
    joints = tuple(piece for piece in parts if isinstance(piece, Joint))
    return RobotModel(name, links, joints, links[0].name)


def chain(
    parent: str, prefix: str, at: Vector, step: Vector, count: int, axes: Sequence[Vector] = (Y,)
) -> list[Link | Joint]:
    """Return `count` equal links in a row, each on a hinge at the end of the one before."""
    size = (max(abs(step[0]), 0.03), max(abs(step[1]), 0.03), max(abs(step[2]), 0.03))
    middle = (step[0] / 2, step[1] / 2, step[2] / 2)
    pieces: list[Link | Joint] = []
    for number in range(count):
        child = f"{prefix}_{number}"
        pieces += [part(child, size, 0.2, middle), hinge(parent, child, at, axes[number % len(axes)])]
        parent, at = child, step
    return pieces


def legs(places: Sequence[tuple[float, float]], length: float = 0.2, count: int = 2) -> list[Link | Joint]:
    step = (0.0, 0.0, -length / count)
    return [
        piece
        for number, (x, y) in enumerate(places)
        for piece in chain("base", f"limb{number}", (x, y, -0.05), step, count)
    ]


BASE = part("base", (0.3, 0.2, 0.1), 4.0)
CORNERS = tuple(product((0.12, -0.12), (0.1, -0.1)))
LOW = (0.0, 0.0, -0.1)


def propellers(axes: Sequence[Vector]) -> list[Link | Joint]:
    pieces: list[Link | Joint] = []
    for number, axis in enumerate(axes):
        angle = 2 * pi * number / len(axes)
        thin = (0.1, 0.1, 0.005) if axis == Z else (0.005, 0.1, 0.1)
        at = (0.3 * cos(angle), 0.3 * sin(angle), 0.1)
        pieces += [
            part(f"p{number}", thin, 0.01),
            hinge("base", f"p{number}", at, axis, ENDLESS, "continuous"),
        ]
    return pieces


def four_wheels(limit: Limit = ENDLESS) -> list[Link | Joint]:
    return [
        piece
        for number, (x, y) in enumerate(CORNERS)
        for piece in (tire(f"w{number}"), wheel("base", f"w{number}", (x, y, -0.05), limit))
    ]


def two_wheels() -> list[Link | Joint]:
    return [
        tire("w0"),
        tire("w1"),
        wheel("base", "w0", (0.0, 0.12, -0.05)),
        wheel("base", "w1", (0.0, -0.12, -0.05)),
    ]


def car(front: Limit) -> list[Link | Joint]:
    """Return a car that its rear wheels drive; `front` is the limit of the wheels that are steered."""
    pieces: list[Link | Joint] = [BASE]
    for number, (x, y) in enumerate(CORNERS):
        parent, at = "base", (x, y, -0.05)
        if x > 0:
            knuckle = f"k{number}"
            pieces += [part(knuckle, (0.02, 0.02, 0.02), 0.05), hinge("base", knuckle, at, Z)]
            parent, at = knuckle, (0.0, 0.0, 0.0)
        pieces += [tire(f"w{number}"), wheel(parent, f"w{number}", at, front if x > 0 else ENDLESS)]
    return pieces


def rover() -> list[Link | Joint]:
    pieces: list[Link | Joint] = [BASE]
    for side, y in (("l", 0.15), ("r", -0.15)):
        pieces += [
            part(f"bogie_{side}", (0.3, 0.02, 0.02)),
            hinge("base", f"bogie_{side}", (0.0, y, 0.0), Y, FREE),
        ]
        for number, x in enumerate((0.15, 0.0, -0.15)):
            name = f"w{side}{number}"
            pieces += [tire(name), wheel(f"bogie_{side}", name, (x, 0.02, -0.06))]
    return pieces


def kiwi() -> list[Link | Joint]:
    pieces: list[Link | Joint] = [BASE]
    for number in range(3):
        angle = 2 * pi * number / 3
        at = (0.12 * cos(angle), 0.12 * sin(angle), -0.05)
        pieces += [tire(f"w{number}"), wheel("base", f"w{number}", at, yaw=angle + pi / 2)]
    return pieces


def arm(
    parent: str = "base", at: Vector = (0.0, 0.0, 0.05), prefix: str = "a", count: int = 5
) -> list[Link | Joint]:
    return chain(parent, prefix, at, (0.0, 0.0, 0.15), count, (Z, Y, Y, X))


def slides(parent: str) -> list[Link | Joint]:
    limit = Limit(0.0, 0.04, 0.1, 10.0)
    return [
        part("f0", (0.01, 0.01, 0.05), 0.02),
        part("f1", (0.01, 0.01, 0.05), 0.02),
        hinge(parent, "f0", (0.0, 0.02, 0.15), Y, limit, "prismatic"),
        hinge(parent, "f1", (0.0, -0.02, 0.15), (0.0, -1.0, 0.0), limit, "prismatic"),
    ]


def hand() -> list[Link | Joint]:
    pieces: list[Link | Joint] = [part("base", (0.03, 0.1, 0.1), 0.4)]
    for number, y in enumerate((-0.035, 0.0, 0.035)):
        pieces += chain("base", f"d{number}", (0.0, y, 0.05), (0.0, 0.0, 0.03), 3)
    return pieces + chain("base", "d3", (0.03, 0.03, -0.02), (0.0, 0.02, 0.02), 3, (Z, X))


def standing(arms: int) -> list[Link | Joint]:
    pieces: list[Link | Joint] = [
        part("base", (0.15, 0.2, 0.1), 4.0),
        *legs([(0.0, 0.08), (0.0, -0.08)], 0.6, 3),
    ]
    if arms:
        pieces += [
            part("chest", (0.15, 0.25, 0.3), 5.0, (0.0, 0.0, 0.2)),
            hinge("base", "chest", (0.0, 0.0, 0.05), Z),
        ]
        for number, y in enumerate((0.2, -0.2)):
            pieces += chain("chest", f"u{number}", (0.0, y, 0.3), (0.0, 0.0, -0.12), 4)
    return pieces


def spread(places: Sequence[tuple[float, float]]) -> list[Link | Joint]:
    """Return legs that are drawn stretched out to the sides."""
    pieces: list[Link | Joint] = [BASE]
    for number, (x, y) in enumerate(places):
        pieces += chain(
            "base", f"limb{number}", (x, y, 0.0), (0.0, 0.1 if y > 0 else -0.1, 0.0), 3, (Z, X, X)
        )
    return pieces


def lying() -> list[Link | Joint]:
    """Return a quadruped that is drawn with its legs along -y."""
    pieces: list[Link | Joint] = [part("base", (0.4, 0.1, 0.2), 6.0)]
    for number, (x, z) in enumerate(product((0.15, -0.15), (0.08, -0.08))):
        pieces += chain("base", f"limb{number}", (x, -0.05, z), (0.0, -0.15, 0.0), 2, (Z,))
    return pieces


SHAPED: dict[str, tuple[Kind, list[Link | Joint]]] = {
    "four propellers": (Kind.drone, [BASE, *propellers([Z] * 4)]),
    "thrusters in different directions": (Kind.underwater, [BASE, *propellers([X, Z, X, X, Z, X])]),
    "two wheels alone": (Kind.balance, [part("base", (0.1, 0.1, 0.3), 2.0, (0.0, 0.0, 0.2)), *two_wheels()]),
    "two wheels and a skid": (
        Kind.differential,
        [
            BASE,
            part("skid", (0.02, 0.02, 0.08), 0.1, (0.1, 0.0, -0.06)),
            Joint("s", "fixed", "base", "skid", Pose(), X, FREE),
            *two_wheels(),
        ],
    ),
    "four wheels": (Kind.skid, [BASE, *four_wheels()]),
    "wheels without limits, and a camera with an effort": (
        Kind.skid,
        [
            BASE,
            *four_wheels(FREE),
            part("camera", (0.03, 0.03, 0.03), 0.05),
            hinge("base", "camera", (0.1, 0.0, 0.1), Z),
        ],
    ),
    "steered wheels with motors": (Kind.car, car(ENDLESS)),
    "steered wheels without motors": (Kind.car, car(FREE)),
    "six wheels on bogies": (Kind.rover, rover()),
    "three crossed axles": (Kind.omni, kiwi()),
    "an arm on wheels": (Kind.arm_on_base, [BASE, *four_wheels(), *arm()]),
    "four legs": (Kind.quadruped, [BASE, *legs(CORNERS)]),
    "four legs and an arm": (Kind.quadruped, [BASE, *legs(CORNERS), *arm()]),
    "four legs on a side": (Kind.quadruped, lying()),
    "six legs stretched out": (
        Kind.hexapod,
        spread([(x, y) for x in (0.12, 0.0, -0.12) for y in (0.1, -0.1)]),
    ),
    "two legs": (Kind.biped, standing(0)),
    "two legs, a waist and two arms": (Kind.humanoid, standing(2)),
    "four fingers": (Kind.hand, hand()),
    "a chain that stands": (Kind.arm, [BASE, *arm()]),
    "a chain with two jaws": (Kind.arm_with_gripper, [BASE, *arm(), *slides("a_4")]),
    "two chains": (Kind.two_arms, [BASE, *arm(), *arm("base", (0.0, 0.3, 0.05), "b")]),
    "twelve links on the ground": (
        Kind.snake,
        [
            part("base", (0.1, 0.05, 0.05), 0.2),
            *chain("base", "s", (0.05, 0.0, 0.0), (0.1, 0.0, 0.0), 12, (Y, Z)),
        ],
    ),
}
"""Robots whose parts have names that say nothing, with their kinds."""


@pytest.mark.parametrize("name", SHAPED)
def test_the_kind_follows_from_the_structure(name: str):
    kind, parts = SHAPED[name]
    judgment = judge(Build(assembled(parts)))
    assert judgment.kind == kind, judgment


@given(st.sampled_from(sorted(SHAPED)), st.randoms(use_true_random=False))
def test_the_order_of_links_and_joints_does_not_matter(name, random):
    kind, parts = SHAPED[name]
    model = assembled(parts)
    links, joints = list(model.links), list(model.joints)
    random.shuffle(links)
    random.shuffle(joints)
    assert judge(Build(replace(model, links=tuple(links), joints=tuple(joints)))).kind == kind


@given(st.sampled_from(sorted(SHAPED)), st.floats(0.7, 1.4))
def test_a_larger_or_smaller_robot_is_of_the_same_kind(name, factor):
    kind, parts = SHAPED[name]
    model = assembled(parts)
    for link in model.links:
        scaled = with_scale(model, link.name, (factor, factor, factor))
        assert isinstance(scaled, RobotModel)
        model = scaled
    assert judge(Build(model)).kind == kind


def test_links_called_rotors_on_the_legs_of_a_dog_are_no_propellers():
    pieces = [BASE, *legs(CORNERS)]
    for number in range(4):
        pieces += [
            part(f"limb{number}_rotor", (0.02, 0.02, 0.02), 0.05),
            Joint(f"r{number}", "fixed", f"limb{number}_0", f"limb{number}_rotor", Pose(), X, FREE),
        ]
    assert judge(Build(assembled(pieces))).kind == Kind.quadruped


def test_a_jaw_that_is_named_so_is_the_gripper_and_not_the_tip():
    pieces = [
        BASE,
        *arm(count=4),
        part("jaw", (0.02, 0.02, 0.06), 0.05),
        hinge("a_3", "jaw", (0.0, 0.02, 0.15)),
    ]
    build = Build(assembled(pieces))
    assert judge(build).kind == Kind.arm_with_gripper
    (limb,) = build.arms
    assert (limb.tip, [joint.child for joint in limb.fingers]) == ("a_3", ["jaw"])


def test_two_arms_that_hang_are_no_legs():
    pieces = [part("base", (0.2, 0.3, 0.3), 8.0)]
    for side, y in (("left", 0.2), ("right", -0.2)):
        pieces += chain("base", f"{side}_shoulder", (0.0, y, 0.1), (0.0, 0.0, -0.15), 5)
    assert judge(Build(assembled(pieces))).kind == Kind.two_arms


def test_where_no_kind_is_sure_the_judgment_says_what_is_there():
    pieces = [BASE, part("lid", (0.1, 0.1, 0.02)), hinge("base", "lid", (0.0, 0.0, 0.1))]
    pieces += [part("flap", (0.1, 0.1, 0.02)), hinge("base", "flap", (0.1, 0.0, 0.1))]
    judgment = judge(Build(assembled(pieces)))
    assert judgment.kind is None
    assert "2 joints move, without wheels, legs, propellers or an arm" in str(judgment)
