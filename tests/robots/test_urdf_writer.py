"""A written robot file is read again as the same robot."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepbots_cli.diagnostics import Findings
from deepbots_cli.document import shipped
from deepbots_cli.robots.meshes import mesh_resolver
from deepbots_cli.robots.model import (
    Box,
    Capsule,
    Cylinder,
    Friction,
    Geometry,
    Inertial,
    Joint,
    Limit,
    Link,
    Mimic,
    Pose,
    RobotModel,
    Sphere,
    to_urdf,
)
from deepbots_cli.robots.reader import read, read_bytes

numbers = st.floats(-1e17, 1e17, allow_nan=False, allow_subnormal=True)
positive = st.floats(1e-300, 1e17)
not_negative = st.just(0.0) | positive
vectors = st.tuples(numbers, numbers, numbers)
poses = st.builds(Pose, vectors, vectors)
colors = st.none() | st.tuples(*[st.floats(0, 1)] * 4)
shapes = (
    st.builds(Box, st.tuples(positive, positive, positive))
    | st.builds(Sphere, positive)
    | st.builds(Cylinder, positive, positive)
    | st.builds(Capsule, positive, positive)
)
inertials = st.builds(
    Inertial, not_negative, poses, not_negative, numbers, numbers, not_negative, numbers, not_negative
)
frictions = st.builds(Friction, *[st.none() | not_negative] * 4)
names = st.text(st.characters(exclude_categories=["C", "Z"]) | st.just(" "), min_size=1, max_size=8).filter(
    str.strip
)
axes = st.sampled_from([(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.6, 0.0, 0.8), (1 / math.sqrt(3),) * 3])
optional = st.none() | positive


@st.composite
def robots(draw: st.DrawFn) -> RobotModel:
    link_names = draw(st.lists(names, min_size=1, max_size=5, unique=True))
    links = tuple(
        Link(
            name,
            draw(st.none() | inertials),
            tuple(draw(st.lists(st.builds(Geometry, shapes, poses, colors), max_size=2))),
            tuple(draw(st.lists(st.builds(Geometry, shapes, poses), max_size=2))),
            draw(frictions),
        )
        for name in link_names
    )
    joint_names = draw(st.lists(names, min_size=len(links) - 1, max_size=len(links) - 1, unique=True))
    joints = []
    for index, name in enumerate(joint_names):
        kind = draw(st.sampled_from(["revolute", "continuous", "prismatic", "fixed", "floating", "planar"]))
        bounds = (
            draw(st.just((None, None)) | st.tuples(numbers, numbers).map(sorted))
            if kind in ("revolute", "prismatic")
            else (None, None)
        )
        joints.append(
            Joint(
                name,
                kind,
                link_names[draw(st.integers(0, index))],
                link_names[index + 1],
                draw(poses),
                (1.0, 0.0, 0.0) if kind in ("fixed", "floating") else draw(axes),
                Limit(bounds[0], bounds[1], draw(optional), draw(optional)),
                draw(not_negative),
                draw(not_negative),
                Mimic(joint_names[0], draw(numbers), draw(numbers))
                if joints and joints[0].moves and draw(st.booleans())
                else None,
            )
        )
    return RobotModel(draw(names).strip(), links, tuple(joints), link_names[0])


@given(robots())
def test_any_robot_survives_writing_and_reading(model: RobotModel):
    findings = Findings()
    robot = read_bytes(
        to_urdf(model).encode(), "x.urdf", findings, resolve_mesh=mesh_resolver(Path("/nowhere"))
    )
    assert robot is not None, [finding.headline for finding in findings]
    assert robot.model == model


def test_writing_is_the_same_every_time_and_in_short_lines():
    robot = read(Path(__file__).parents[2] / "robots/urdf/cartpole.urdf", "cartpole.urdf", Findings())
    assert robot is not None
    assert to_urdf(robot.model) == to_urdf(robot.model)
    assert max(map(len, to_urdf(robot.model).splitlines())) < 200


def test_one_material_name_means_one_color():
    red, blue = (1.0, 0.0, 0.0, 1.0), (0.0, 0.0, 1.0, 1.0)
    visuals = tuple(Geometry(Sphere(1.0), Pose(), color) for color in (red, blue, red))
    text = to_urdf(RobotModel("r", (Link("a", visuals=visuals),), (), "a"))
    assert text.count('"color_0"') == 2
    assert text.count('"color_1"') == 1


@pytest.mark.parametrize("name", ['a"b', "a'b", "a<b>&", "é", "a b"])
def test_names_with_special_characters_are_escaped(name):
    model = RobotModel("r", (Link(name),), (), name)
    robot = read_bytes(to_urdf(model).encode(), "x", Findings(), resolve_mesh=mesh_resolver(Path("/nowhere")))
    assert robot is not None
    assert robot.model.root == name


# An independent reader agrees: yourdfpy sees the same joints, limits and kinematics in what we write


@pytest.fixture
def yourdfpy() -> Any:
    """Imported by the tests that need it, since the import takes two seconds."""
    return pytest.importorskip("yourdfpy")


def model_of(name: str) -> RobotModel:
    path = shipped.robot_path(name)
    assert path is not None
    robot = read(path, path.name, Findings())
    assert robot is not None
    return robot.model


@pytest.mark.parametrize("name", shipped.robot_names())
def test_another_reader_finds_the_same_joints_in_the_normalized_file(
    yourdfpy: Any, name: str, tmp_path: Path
) -> None:
    model = model_of(name)
    file = tmp_path / "robot.urdf"
    file.write_text(to_urdf(model), encoding="utf-8")
    read_by_yourdfpy = yourdfpy.URDF.load(str(file), load_meshes=False, build_scene_graph=True)
    assert read_by_yourdfpy.base_link == model.root
    assert list(read_by_yourdfpy.joint_map) == [joint.name for joint in model.joints]
    for joint in model.moving_joints:
        theirs = read_by_yourdfpy.joint_map[joint.name]
        assert theirs.type == joint.type
        np.testing.assert_allclose(theirs.axis, joint.axis)
        if joint.limit.upper is not None:
            assert (theirs.limit.lower, theirs.limit.upper) == (joint.limit.lower, joint.limit.upper)


def test_the_tip_of_the_leaning_pole_is_where_another_reader_has_it(yourdfpy: Any, tmp_path: Path) -> None:
    model = model_of("cartpole")
    file = tmp_path / "robot.urdf"
    file.write_text(to_urdf(model), encoding="utf-8")
    read_by_yourdfpy = yourdfpy.URDF.load(str(file), load_meshes=False, build_scene_graph=True)
    angle = 0.3
    read_by_yourdfpy.update_cfg({"pole_hinge": angle})
    tip = read_by_yourdfpy.get_transform("tip", model.root)[:3, 3]
    # The hinge is 0.03 m above the body's center; a pole that leans to +x has a positive angle.
    np.testing.assert_allclose(tip, [np.sin(angle), 0.0, 0.03 + np.cos(angle)], atol=1e-12)
