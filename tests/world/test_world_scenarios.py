"""Every shipped scenario lints clean and runs, however it is driven."""

from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from deepbots_cli import api
from deepbots_cli.cli.sources import open_robot
from deepbots_cli.document import shipped
from tests.few import every, few


def drive(name: str, steps: int) -> None:
    """Random steps, with a reset at each ending; all that comes back is finite."""
    with closing(api.make(name)) as environment:
        environment.action_space.seed(0)
        environment.reset(seed=0)
        for _ in range(steps):
            observation, reward, terminated, truncated, _ = environment.step(
                environment.action_space.sample()
            )
            parts = observation.values() if isinstance(observation, dict) else [observation]
            assert all(np.isfinite(part).all() for part in parts)
            assert np.isfinite(reward)
            if terminated or truncated:
                environment.reset()


@pytest.mark.parametrize("name", shipped.scenario_names())
def test_a_shipped_scenario_has_no_findings(name: str) -> None:
    assert [f"{finding.span.location}: {finding.headline}" for finding in api.lint(name, preview=True)] == []


@pytest.mark.parametrize("name", few(shipped.scenario_names()))
def test_a_shipped_scenario_runs_under_random_actions(name: str) -> None:
    drive(name, 100)


@pytest.mark.slow
@pytest.mark.parametrize("name", shipped.scenario_names())
def test_a_shipped_scenario_runs_for_long_under_random_actions(name: str) -> None:
    drive(name, 10_000)


# Robots of an installed package


ROBOTS = {
    "franka_panda/panda.urdf": "fixed",
    "a1/a1.urdf": "free",
    "laikago/laikago_toes.urdf": "free",
    "husky/husky.urdf": "free",
    "r2d2.urdf": "free",
    "quadruped/minitaur.urdf": "free",
    "kuka_iiwa/model.urdf": "fixed",
}

SCENARIO = """
deepbots: 1
name: Tour
world: {{timestep: 20 ms, substeps: 5}}
robots:
  robot:
    urdf: package://pybullet_data/{file}
    base: {base}
    pose: {{z: 0.6 m}}
    groups: {{all: [{links}]}}
    sensors:
      place: {{type: position, link: {last}}}
      speed: {{type: velocity, link: {last}}}
      gyro:  {{type: gyro, link: {last}}}
      accel: {{type: accelerometer, link: {last}}}
      feel:  {{type: touch, links: all}}
      angle: {{type: joint_position, joint: {joint}, noise: 1 %}}
    actuators:
      motor: {{type: velocity_motor, joint: {joint}, max_torque: 1 {torque}}}
    emit: [place, speed, gyro, accel, feel, angle]
    apply: {{motor: push * 1 {rate}}}
action: {{push: -1 .. 1}}
observation:
  robot.place: -5 .. 5 m
  robot.speed: -5 .. 5 m/s
  robot.gyro:  -9 .. 9 rad/s
  robot.accel: -20 .. 20 m/s^2
  robot.feel:  auto
  robot.angle: -7 .. 7 {unit}
reward: {{r: push}}
truncation: {{max_steps: 1000}}
"""


@pytest.mark.parametrize("file", every(7, ROBOTS))
def test_a_robot_of_a_package_runs_with_sensors_on_any_link(tmp_path: Path, file: str) -> None:
    robot, findings = open_robot(f"package://pybullet_data/{file}")
    assert {finding.severity for finding in findings} <= {"warning"}
    joint = robot.model.moving_joints[0]
    slides = joint.type == "prismatic"
    text = SCENARIO.format(
        file=file,
        base=ROBOTS[file],
        links=", ".join(f'"{link.name}"' for link in robot.model.links if link.collisions),
        last=robot.model.links[-1].name,
        joint=joint.name,
        torque="N" if slides else "N*m",
        rate="m/s" if slides else "rad/s",
        unit="m" if slides else "rad",
    )
    path = tmp_path / "tour.yaml"
    path.write_text(text, encoding="utf-8")
    assert [finding.headline for finding in api.lint(path) if finding.severity == "error"] == []
    assert [finding for finding in api.lint(path) if finding.span.source.name.endswith(".urdf")] == []
    with closing(api.make(path)) as environment:
        environment.action_space.seed(0)
        environment.reset(seed=0)
        for _ in range(1000):
            observation, *_ = environment.step(environment.action_space.sample())
        assert np.isfinite(observation).all()
