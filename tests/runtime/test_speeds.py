"""An episode in which the physics is unstable ends in an error that names the joint."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from deepbots_cli import api
from deepbots_cli.errors import EngineError

ROBOT = """<robot name="arm">
  <link name="base"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="tip">
    <inertial><origin xyz="0.05 0 0"/><mass value="0.001"/><inertia ixx="1e-6" iyy="1e-6" izz="1e-6" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <joint name="ankle" type="revolute">
    <parent link="base"/><child link="tip"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="50" velocity="20"/>
  </joint>
</robot>
"""
SCENARIO = """\
deepbots: 1
name: Gram
world: {timestep: 20 ms, substeps: 5}
robots:
  arm:
    urdf: arm.urdf
    base: fixed
    sensors: {angle: {type: joint_position, joint: ankle}}
    actuators: {spring: {type: position_motor, joint: ankle, stiffness: 1_000_000 N*m/rad}}
    apply: {spring: bend * 0.5 rad}
action: {bend: -1 .. 1}
observation: {arm.angle: auto}
reward: {up: cos(arm.angle)}
truncation: {max_steps: 50}
"""
STIFF = 1_000_000


def steps(folder: Path, engine: str, stiffness: float = STIFF) -> None:
    """Run an episode with a spring of this stiffness (N m/rad) on 1 g."""
    (folder / "arm.urdf").write_text(ROBOT)
    file = folder / "gram.yaml"
    file.write_text(SCENARIO.replace("1_000_000", str(stiffness)))
    environment = api.make(str(file), engine=engine)
    try:
        environment.reset(seed=0)
        ended = False
        while not ended:
            _, _, _, ended, _ = environment.step(np.ones(1, np.float32))
    finally:
        environment.close()


@pytest.mark.parametrize("engine", ["pybullet", "mujoco"])
def test_a_spring_that_is_too_strong_ends_the_episode_with_the_name_of_its_joint(tmp_path, engine):
    pytest.importorskip(engine)
    with pytest.raises(EngineError, match=r"joint 'ankle' of 'arm' turns at \S+ rad/s, which no motor"):
        steps(tmp_path, engine)


@pytest.mark.parametrize("engine", ["pybullet", "mujoco"])
def test_the_stiffness_that_the_finding_names_is_stable(tmp_path, engine):
    pytest.importorskip(engine)
    (tmp_path / "arm.urdf").write_text(ROBOT)
    file = tmp_path / "gram.yaml"
    file.write_text(SCENARIO)
    (finding,) = [finding for finding in api.lint(file) if finding.code == "DB325"]
    stable = float(finding.help.partition("below ")[2].partition(" ")[0])
    steps(tmp_path, engine, stable)
    file.write_text(SCENARIO.replace("1_000_000", str(stable)))
    assert "DB325" not in {finding.code for finding in api.lint(file)}


def test_a_world_of_a_batch_whose_joint_is_too_fast_is_lost(tmp_path):
    pytest.importorskip("mujoco")
    (tmp_path / "arm.urdf").write_text(ROBOT)
    file = tmp_path / "gram.yaml"
    file.write_text(SCENARIO.replace("substeps: 5", "substeps: 5, engine: mujoco"))
    environment = api.make_vec(str(file), num_envs=2)
    try:
        environment.reset(seed=0)
        with pytest.warns(RuntimeWarning, match=r"'ankle' of 'arm' turns at .* spring of 1e\+06"):
            _, reward, _, truncated, _ = environment.step(np.array([[1.0], [0.0]], np.float32))
        assert truncated.tolist() == [True, False]
        assert reward[0] == 0.0
    finally:
        environment.close()
