"""Springs on light joints: DB325 against the motion in the engines."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from deepbots_cli import api

STEP = 0.005
INERTIA = 1e-3 + 0.1 * 0.1**2
"""About the joint, in kg m^2: that of the link, and its mass times the square of its distance."""
LINK = """\
<robot name="arm">
  <link name="base"><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <link name="foot">
    <inertial>
      <origin xyz="0.1 0 0"/>
      <mass value="0.1"/>
      <inertia ixx="1e-3" ixy="0" ixz="0" iyy="1e-3" iyz="0" izz="1e-3"/>
    </inertial>
  </link>
  <joint name="ankle" type="continuous">
    <parent link="base"/>
    <child link="foot"/>
    <axis xyz="0 0 1"/>
    <limit effort="1e6" velocity="1e6"/>
  </joint>
</robot>
"""
SCENARIO = f"""\
deepbots: 1
name: Spring
world: {{timestep: {4 * STEP} s, substeps: 4}}
robots:
  arm:
    urdf: arm.urdf
    base: fixed
    sensors: {{angle: {{type: joint_position, joint: ankle}}}}
    actuators: {{ankle: {{type: position_motor, joint: ankle, stiffness: STIFFNESS, damping: DAMPING}}}}
    apply: {{ankle: 10 deg * bend}}
action: {{bend: -1 .. 1}}
observation: {{arm.angle: -180 .. 180 deg}}
reward: {{up: cos(arm.angle)}}
truncation: {{max_steps: 1000}}
reset: {{joints: {{arm.ankle: 9.9 deg}}, settle: 0 s}}
train: {{algorithm: PPO, total_timesteps: 10_000}}
"""
GAINS = {
    "spring": (4.0 * INERTIA / STEP**2, 0.0),
    "damper": (0.004 * INERTIA / STEP**2, 1.998 * INERTIA / STEP),
}
"""Stiffness (N m/rad) and damping (N m s/rad) at which the motion ceases to be stable; a damper without any
stiffness would not begin to move."""
FAST = 50.0
"""In rad/s; a stable spring that begins 0.1 deg off its target is slower than 1 rad/s."""


@pytest.mark.parametrize("engine", ["pybullet", "mujoco"])
@pytest.mark.parametrize("kind", list(GAINS))
@pytest.mark.parametrize("share", [0.8, 1.25])
def test_a_spring_is_reported_exactly_where_its_joint_shakes(
    tmp_path: Path, engine: str, kind: str, share: float
) -> None:
    pytest.importorskip(engine)
    stiffness, damping = (share * gain for gain in GAINS[kind])
    (tmp_path / "arm.urdf").write_text(LINK)
    text = SCENARIO.replace("STIFFNESS", f"{stiffness} N*m/rad").replace("DAMPING", f"{damping} N*m*s/rad")
    file = tmp_path / "spring.yaml"
    file.write_text(text.replace("substeps: 4", f"substeps: 4, engine: {engine}"))

    is_reported = "DB325" in {finding.code for finding in api.lint(file)}

    with closing(api.make(api.compile(file))) as environment:
        environment.reset(seed=0)
        motion = environment.engine.joint_states("arm", ["ankle"])
        for _ in range(40):
            environment.step(np.ones(1, np.float32))
        shakes = abs(motion()[0][1]) > FAST
    assert is_reported == shakes == (share > 1.0)
