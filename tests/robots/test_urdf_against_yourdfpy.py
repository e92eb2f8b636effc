"""An independent reader agrees: yourdfpy sees the same joints, limits and kinematics in what we write."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deepbots_cli.diagnostics import Findings
from deepbots_cli.document import shipped
from deepbots_cli.robots.model import RobotModel, to_urdf
from deepbots_cli.robots.reader import read


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
    other = yourdfpy.URDF.load(str(file), load_meshes=False, build_scene_graph=True)
    assert other.base_link == model.root
    assert list(other.joint_map) == [joint.name for joint in model.joints]
    for joint in model.moving_joints:
        theirs = other.joint_map[joint.name]
        assert theirs.type == joint.type
        np.testing.assert_allclose(theirs.axis, joint.axis)
        if joint.limit.upper is not None:
            assert (theirs.limit.lower, theirs.limit.upper) == (joint.limit.lower, joint.limit.upper)


def test_the_tip_of_the_leaning_pole_is_where_another_reader_has_it(yourdfpy: Any, tmp_path: Path) -> None:
    model = model_of("cartpole")
    file = tmp_path / "robot.urdf"
    file.write_text(to_urdf(model), encoding="utf-8")
    other = yourdfpy.URDF.load(str(file), load_meshes=False, build_scene_graph=True)
    angle = 0.3
    other.update_cfg({"pole_hinge": angle})
    tip = other.get_transform("tip", model.root)[:3, 3]
    # The hinge is 0.03 m above the body's center; a pole that leans to +x has a positive angle.
    np.testing.assert_allclose(tip, [np.sin(angle), 0.0, 0.03 + np.cos(angle)], atol=1e-12)
