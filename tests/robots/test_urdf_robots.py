"""The robots that are shipped, and published ones as they are."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

from deepbots_cli.compiler.robots import matching_names
from deepbots_cli.diagnostics import Findings
from deepbots_cli.robots.meshes import mesh_resolver
from deepbots_cli.robots.model import Box, Cylinder, Sphere, homogeneous_inertial, to_urdf
from deepbots_cli.robots.reader import RobotFile, read, read_bytes

SHIPPED = Path(__file__).parents[2] / "robots/urdf"
PUBLISHED = {
    "r2d2.urdf": {"DB307"},  # its head is continuous, from -0.38 to 0 rad
    "husky/husky.urdf": {"DB305", "DB311"},
    "quadruped/minitaur.urdf": {"DB307", "DB311"},
    "laikago/laikago.urdf": {"DB306"},
    "laikago/laikago_toes.urdf": {"DB306", "DB311"},
    "kuka_iiwa/model.urdf": {"DB306"},
    "franka_panda/panda.urdf": {"DB306"},
    "a1/a1.urdf": set(),
    "bicycle/bike.urdf": {"DB311"},
    "biped/biped2d_pybullet.urdf": {"DB306", "DB307", "DB311"},
    "differential/diff_ring.urdf": {"DB311"},
    "quadruped/microtaur/microtaur.urdf": {"DB311"},
    "racecar/racecar_differential.urdf": {
        "DB307",
        "DB311",
    },  # one of its steering hinges is continuous, from -1 to 1 rad
    "humanoid/humanoid.urdf": {"DB311"},
    "spherical_joint_limit.urdf": {"DB306", "DB311"},
}


def shipped(name: str) -> RobotFile:
    findings = Findings()
    robot = read(SHIPPED / name, name, findings)
    assert list(findings) == []
    assert robot is not None
    return robot


def moments(link, shape, origin):
    """The moments of the file, and those of the closed form."""
    inertial = link.inertial
    expected = homogeneous_inertial(shape, link.inertial.mass, origin)
    return [inertial.ixx, inertial.iyy, inertial.izz], pytest.approx(
        [expected.ixx, expected.iyy, expected.izz], rel=1e-9
    )


@pytest.mark.parametrize("path", sorted(SHIPPED.glob("*.urdf")), ids=lambda path: path.stem)
def test_a_shipped_robot_is_silent_and_survives_the_round_trip(path: Path):
    robot = shipped(path.name)
    again = read_bytes(to_urdf(robot.model).encode(), "x", Findings(), resolve_mesh=Path)
    assert again is not None
    assert again.model == robot.model


def test_the_cart_of_the_paper_has_the_names_that_scenarios_use():
    model = shipped("cartpole.urdf").model
    assert model.root == "body"
    wheels = matching_names((joint.name for joint in model.moving_joints), "wheel_*")
    assert wheels == ("wheel_front_left", "wheel_front_right", "wheel_rear_left", "wheel_rear_right")
    hinge = model.joint("pole_hinge")
    assert hinge.limit.lower == -1.3
    assert hinge.limit.upper == 1.3
    assert hinge.limit.effort is None
    assert hinge.axis == (0.0, 1.0, 0.0)
    assert hinge.origin.xyz == (0.0, 0.0, 0.03)
    assert hinge.damping == 0.0
    assert hinge.friction == 0.0


def test_the_cart_of_the_paper_weighs_and_resists_turning_as_its_shapes_do():
    model = shipped("cartpole.urdf").model
    assert sum(link.inertial.mass for link in model.links) == pytest.approx(2 + 4 * 0.1005 + 0.2 + 0.02)
    for name in ("body", "pole", "tip"):
        link = model.link(name)
        actual, expected = moments(link, link.visuals[0].shape, link.visuals[0].origin)
        assert actual == expected
        assert link.inertial.origin == link.visuals[0].origin
    for name in matching_names((link.name for link in model.links), "wheel_*"):
        link = model.link(name)
        (across, along, third), expected = moments(link, link.visuals[0].shape, link.visuals[0].origin)
        assert [across, third, along] == expected  # the cylinder lies along y
    assert isinstance(model.link("body").visuals[0].shape, Box)
    assert model.link("tip").visuals[0].shape == Sphere(0.01)


def test_the_cart_stands_on_its_wheels_and_on_nothing_else():
    model = shipped("cartpole.urdf").model
    body = model.link("body").collisions[0]
    assert body.origin.xyz[2] - body.shape.size[2] / 2 > -0.03
    for joint in model.joints[:4]:
        wheel = model.link(joint.child).collisions[0].shape
        assert isinstance(wheel, Cylinder)
        assert wheel.radius == 0.04
        assert joint.origin.xyz[2] == 0.0
        assert joint.axis == (0.0, 1.0, 0.0)


def test_the_cart_on_a_rail_is_that_of_the_textbooks():
    model = shipped("cartpole_rail.urdf").model
    assert model.root == "rail"
    assert [joint.name for joint in model.moving_joints] == ["slider", "hinge"]
    cart, pole = model.link("cart").inertial, model.link("pole").inertial
    assert cart.mass == 1.0
    assert pole.mass == 0.1
    assert pole.origin.xyz == (0.0, 0.0, 0.5)
    assert pole.iyy == pytest.approx(0.1 * 1.0**2 / 12)
    assert model.joint("slider").limit.effort == 10.0
    assert not any(link.collisions for link in model.links)


REFUSED = {
    "kuka_iiwa/model_for_sdf.urdf": "the mesh does not exist",  # nor does PyBullet load it
    "plane_implicit.urdf": "<geometry> contains no known shape",  # an endless plane
    "random_urdfs/168/168.urdf": "the OBJ file contains a vertex that is not finite",
    "torus_deform.urdf": "the robot has no links",  # a soft body; nor does PyBullet load it
    # a file that is not there; nor does PyBullet load it
    "toys/concave_box.urdf": "<geometry> contains no known shape",
}


@pytest.fixture(scope="module")
def library() -> Path:
    spec = importlib.util.find_spec("pybullet_data")
    if spec is None or not spec.submodule_search_locations:
        pytest.skip("pybullet_data is not installed")
    return Path(spec.submodule_search_locations[0])


def published(library: Path, name: str) -> tuple[RobotFile | None, Findings]:
    findings = Findings()
    return read(
        library / name, name, findings, resolve_mesh=mesh_resolver((library / name).parent, [library])
    ), findings


@pytest.mark.parametrize("name", PUBLISHED)
def test_a_published_robot_is_read_with_warnings_at_most(library, name):
    robot, findings = published(library, name)
    assert findings.errors == []
    assert robot is not None
    assert {finding.code for finding in findings} == PUBLISHED[name]
    again = read_bytes(to_urdf(robot.model).encode(), "x", Findings(), resolve_mesh=Path)
    assert again is not None
    assert again.model == robot.model


@pytest.mark.slow
def test_of_the_robots_of_pybullet_data_only_these_are_refused(library):
    names = sorted(str(path.relative_to(library)) for path in library.rglob("*.urdf"))
    refused = {}
    for name in names:
        robot, findings = published(library, name)
        if robot is None:
            refused[name] = findings.errors[0].headline
    assert refused == REFUSED
    assert len(names) > 1000


def test_patterns_keep_the_order_of_the_file_and_mind_case():
    names = ("b_1", "a_1", "B_1", "c")
    assert matching_names(names, "*_1") == ("b_1", "a_1", "B_1")
    assert matching_names(names, "b_?") == ("b_1",)
    assert matching_names(names, "[ab]_1") == ("b_1", "a_1")
    assert matching_names(names, "x*") == ()
    assert matching_names(["a" * 5000], "*a" * 30 + "b") == ()
