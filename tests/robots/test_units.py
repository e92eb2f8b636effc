"""A robot from a CAD program in millimeters, grams or g mm^2 is named with the factor; a right one is not.

Robots whose numbers are in other units, made from right ones.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from deepbots_cli.diagnostics import Finding, Findings
from deepbots_cli.robots.model import (
    Box,
    Capsule,
    Cylinder,
    Geometry,
    Inertial,
    Joint,
    Limit,
    Link,
    Mesh,
    Pose,
    RobotModel,
    Shape,
    Sphere,
    Vector,
    homogeneous_inertial,
    to_urdf,
    volume,
)
from deepbots_cli.robots.packages import package_file
from deepbots_cli.robots.reader import read, read_bytes
from tests.robots.meshes import block


def with_lengths(model: RobotModel, factor: float) -> RobotModel:
    """The robot with all lengths of its shapes, joints and centers of mass times a factor."""

    def link(old: Link) -> Link:
        return replace(
            old,
            inertial=old.inertial and replace(old.inertial, origin=_pose(old.inertial.origin, factor)),
            visuals=tuple(_geometry(part, factor) for part in old.visuals),
            collisions=tuple(_geometry(part, factor) for part in old.collisions),
        )

    def joint(old: Joint) -> Joint:
        return replace(old, origin=_pose(old.origin, factor))

    return replace(model, links=tuple(map(link, model.links)), joints=tuple(map(joint, model.joints)))


def with_visuals(model: RobotModel, factor: float) -> RobotModel:
    """The robot with the lengths of its visuals times a factor."""
    links = tuple(
        replace(link, visuals=tuple(_geometry(part, factor) for part in link.visuals or link.collisions))
        for link in model.links
    )
    return replace(model, links=links)


def with_masses(model: RobotModel, mass: float, inertia: float) -> RobotModel:
    """The robot with all masses and inertias times factors."""
    links = tuple(
        replace(link, inertial=link.inertial and _inertial(link.inertial, mass, inertia))
        for link in model.links
    )
    return replace(model, links=links)


def with_identities(model: RobotModel) -> RobotModel:
    """The robot with an inertia of 1 of each link."""
    links = tuple(
        replace(link, inertial=Inertial(link.mass, link.inertial.origin, ixx=1.0, iyy=1.0, izz=1.0))
        if link.inertial
        else link
        for link in model.links
    )
    return replace(model, links=links)


def _inertial(old: Inertial, mass: float, inertia: float) -> Inertial:
    return Inertial(
        old.mass * mass,
        old.origin,
        *(inertia * moment for moment in (old.ixx, old.ixy, old.ixz, old.iyy, old.iyz, old.izz)),
    )


def _vector(old: Vector, factor: float) -> Vector:
    x, y, z = old
    return factor * x, factor * y, factor * z


def _pose(old: Pose, factor: float) -> Pose:
    return replace(old, xyz=_vector(old.xyz, factor))


def _geometry(old: Geometry, factor: float) -> Geometry:
    return replace(old, shape=_shape(old.shape, factor), origin=_pose(old.origin, factor))


def _shape(old: Shape, factor: float) -> Shape:
    match old:
        case Box(size):
            return Box(_vector(size, factor))
        case Sphere(radius):
            return Sphere(factor * radius)
        case Cylinder(radius, length):
            return Cylinder(factor * radius, factor * length)
        case Capsule(radius, length):
            return Capsule(factor * radius, factor * length)
        case Mesh(scale=scale):
            return replace(old, scale=_vector(scale, factor))


# A robot from a CAD program in millimeters, grams or g mm^2 is named with the factor; a right one is not


ROOT = Path(__file__).parents[2]
SHIPPED = [
    *sorted((ROOT / "robots/urdf").glob("*.urdf")),
    ROOT / "tools/results/teacher/car.urdf",
    ROOT / "tools/results/teacher/arm.urdf",
    ROOT / "deepbots_cli/cli/starters/arm.urdf",
]
_INSTALLED = """
    TwoJointRobot_w_fixedJoints TwoJointRobot_wo_fixedJoints a1/a1 aliengo/aliengo bicycle/bike
    biped/biped2d_pybullet franka_panda/panda humanoid/humanoid husky/husky kuka_iiwa/model
    kuka_iiwa/model_free_base kuka_iiwa/model_vr_limits laikago/laikago laikago/laikago_toes
    laikago/laikago_toes_zup mini_cheetah/mini_cheetah pendulum5 quadruped/minitaur_derpy
    quadruped/minitaur_rainbow_dash quadruped/spirit40 quadruped/spirit40newer quadruped/vision60
    racecar/racecar sphere2 spherical_joint_limit xarm/base xarm/link1 xarm/link6 xarm/xarm6_robot
    xarm/xarm6_with_gripper
"""
INSTALLED = _INSTALLED.split()
SHAPES: dict[str, Shape] = {
    "a plate": Box((0.3, 0.2, 0.002)),
    "a rod": Cylinder(0.002, 1.5),
    "a bead": Sphere(0.002),
    "a ball": Sphere(0.3),
    "a wheel": Cylinder(0.1, 0.02),
    "a limb": Capsule(0.03, 0.4),
    "a hall": Box((8.0, 6.0, 0.5)),
    "a beam": Box((12.0, 0.1, 0.1)),
}
DENSITIES = {"foam": 20.0, "steel": 7800.0}


def part(shape: Shape, density_factor: float) -> RobotModel:
    inertial = homogeneous_inertial(shape, 1.0)
    assert inertial is not None
    model = RobotModel("part", (Link("part", inertial, (), (Geometry(shape),)),), (), "part")
    return with_masses(model, density_factor, density_factor)


PRIMITIVES = {
    f"{name} of {material}": part(shape, density * (volume(shape) or 0.0))
    for name, shape in SHAPES.items()
    for material, density in DENSITIES.items()
}


def about_units(findings: Findings) -> list[Finding]:
    words = ("probably", "placeholder")
    return [finding for finding in findings if any(word in finding.headline for word in words)]


def judged(model: RobotModel) -> list[Finding]:
    findings = Findings()
    read_bytes(to_urdf(model).encode(), "robot.urdf", findings, resolve_mesh=Path)
    return about_units(findings)


# Right files


def test_the_right_files_are_sixty() -> None:
    assert (len(SHIPPED), len(INSTALLED), len(PRIMITIVES)) == (14, 30, 16)


@pytest.mark.parametrize("file", SHIPPED, ids=lambda file: file.stem)
def test_a_shipped_robot_has_the_right_units(file: Path) -> None:
    findings = Findings()
    assert read(file, file.name, findings) is not None
    assert about_units(findings) == []


@pytest.mark.parametrize("name", INSTALLED)
def test_a_published_robot_has_the_right_units(name: str) -> None:
    file = package_file(f"package://pybullet_data/{name}.urdf")
    if file is None:
        pytest.skip("pybullet_data is not installed")
    test_a_shipped_robot_has_the_right_units(file)


@pytest.mark.parametrize("name", PRIMITIVES)
def test_a_part_of_one_material_has_the_right_units(name: str) -> None:
    assert judged(PRIMITIVES[name]) == []


# Wrong files

ROBOTS = ("a1", "cartpole", "epuck", "panda")
FAULTS: dict[str, tuple[Callable[[RobotModel], RobotModel], list[tuple[str, str]]]] = {
    "millimeters": (lambda model: with_lengths(model, 1e3), [("DB507", "in millimeters, 1000 times")]),
    "grams": (lambda model: with_masses(model, 1e3, 1.0), [("DB507", "in grams, 1000 times")]),
    "g mm^2": (
        lambda model: with_masses(model, 1.0, 1e9),
        [("DB306", "in g*mm^2, 1,000,000,000 times")],
    ),
    "kg mm^2": (lambda model: with_masses(model, 1.0, 1e6), [("DB306", "in kg*mm^2, 1,000,000 times")]),
    "g cm^2": (lambda model: with_masses(model, 1.0, 1e7), [("DB306", "in g*cm^2, 10,000,000 times")]),
    "kg cm^2": (lambda model: with_masses(model, 1.0, 1e4), [("DB306", "in kg*cm^2, 10,000 times")]),
    "g m^2": (lambda model: with_masses(model, 1.0, 1e3), [("DB306", "in g*m^2, 1,000 times")]),
    "grams and g mm^2": (
        lambda model: with_masses(model, 1e3, 1e9),
        [("DB507", "in grams, 1000 times"), ("DB306", "in g*mm^2, 1,000,000,000 times")],
    ),
    "all of millimeters, grams and g mm^2": (
        lambda model: with_masses(with_lengths(model, 1e3), 1e3, 1e9),
        [("DB507", "in millimeters, 1000 times")],
    ),
    "visuals in millimeters": (
        lambda model: with_visuals(model, 1e3),
        [("DB507", "in millimeters, 1000 times")],
    ),
    "lengths scaled once too often": (
        lambda model: with_lengths(model, 1e-3),
        [("DB507", "probably 1000 times too small")],
    ),
    "identities": (with_identities, [("DB306", "1 kg*m^2 about each axis, a placeholder")]),
}


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("fault", FAULTS)
def test_a_wrong_unit_is_named_with_its_factor(robot: str, fault: str) -> None:
    damage, expected = FAULTS[fault]
    file = read(ROOT / f"robots/urdf/{robot}.urdf", robot, Findings())
    assert file is not None
    findings = judged(damage(file.model))
    assert [finding.code for finding in findings] == [code for code, _ in expected]
    assert all(words in finding.headline for finding, (_, words) in zip(findings, expected, strict=True))


def wagon(body: str, mass: str, moment: str) -> str:
    """A body and a wheel; only the body is wrong."""
    inertia = f'<inertia ixx="{moment}" iyy="{moment}" izz="{moment}"/>'
    return f"""<robot name="wagon">
  <link name="body">
    <inertial><mass value="{mass}"/>{inertia}</inertial>
    {body}
  </link>
  <link name="wheel">
    <inertial><mass value="0.05"/><inertia ixx="2e-5" iyy="3e-5" izz="2e-5"/></inertial>
    <collision>
      <origin rpy="1.5708 0 0"/><geometry><cylinder radius="0.035" length="0.02"/></geometry>
    </collision>
  </link>
  <joint name="axle" type="continuous">
    <parent link="body"/><child link="wheel"/><origin xyz="-0.03 0.06 0"/><axis xyz="0 1 0"/>
  </joint>
</robot>"""


BOX = '<geometry><box size="0.14 0.1 0.04"/></geometry>'
MESH = '<geometry><mesh filename="body.stl"/></geometry>'
RIGHT = '<geometry><mesh filename="body.stl" scale="0.001 0.001 0.001"/></geometry>'
TWICE = '<geometry><mesh filename="body.stl" scale="1e-6 1e-6 1e-6"/></geometry>'


@pytest.mark.parametrize(
    ("text", "place"),
    [
        (wagon(f"<collision>{BOX}</collision>", "500", "1.1e-3"), '<mass value="500"/>'),
        (wagon(f"<collision>{BOX}</collision>", "0.5", "1100"), '<inertia ixx="1100"'),
        (wagon(f"<collision>{MESH}</collision>", "0.5", "1.1e-3"), 'body">\n    <inertial>'),
        (wagon(f"<visual>{MESH}</visual><collision>{RIGHT}</collision>", "0.5", "1.1e-3"), "<visual>"),
        (wagon(f"<visual>{RIGHT}</visual><collision>{MESH}</collision>", "0.5", "1.1e-3"), "<collision>"),
        (wagon(f"<visual>{RIGHT}</visual><collision>{TWICE}</collision>", "0.5", "1.1e-3"), "<collision>"),
    ],
)
def test_one_wrong_link_is_found_at_its_place(tmp_path: Path, text: str, place: str) -> None:
    (tmp_path / "body.stl").write_bytes(block("body.stl", (140.0, 100.0, 40.0)))
    (tmp_path / "robot.urdf").write_text(text)
    findings = Findings()
    assert read(tmp_path / "robot.urdf", "robot.urdf", findings) is not None
    (finding,) = about_units(findings)
    assert text[finding.span.start :].startswith(
        place.removeprefix("<link name=") if "link" in place else place
    )


def test_links_that_are_wrong_in_different_elements_have_a_finding_each() -> None:
    small, large = Geometry(Box((0.3, 0.2, 0.1))), Geometry(Box((300.0, 200.0, 100.0)))
    inertial = homogeneous_inertial(small.shape, 2.0)
    links = (Link("a", inertial, (large,), (small,)), Link("b", inertial, (small,), (large,)))
    joint = Joint("weld", "fixed", "a", "b")
    texts = [finding.headline for finding in judged(RobotModel("two", links, (joint,), "a"))]
    assert texts == [
        "the <visual> of link 'a' is 1,000 times as large as the <collision>: it is probably in millimeters,"
        " 1000 times too large",
        "the <collision> of link 'b' is 1,000 times as large as the <visual>: it is probably in millimeters,"
        " 1000 times too large",
    ]


def test_an_inertia_is_compared_with_that_of_the_box() -> None:
    (finding,) = judged(with_masses(part(Box((0.3, 0.2, 0.1)), 3.0), 1.0, 1e6))
    assert "is about 1,000,000 times that of a box of this mass and size" in finding.headline


# The text of a model


@pytest.mark.parametrize("limit", [Limit(None, 0.1), Limit(-0.1, None), Limit(-0.1, 0.2), Limit(effort=3.0)])
def test_a_joint_with_one_limit_is_read_back_with_that_limit(limit: Limit) -> None:
    links = (Link("a"), Link("b", homogeneous_inertial(Box((1.0, 1.0, 1.0)), 1.0)))
    model = RobotModel("r", links, (Joint("j", "prismatic", "a", "b", limit=limit),), "a")
    robot = read_bytes(to_urdf(model).encode(), "robot.urdf", Findings(), resolve_mesh=Path)
    assert robot is not None
    assert robot.model.joints[0].limit == limit
