"""Two carts as two agents: the scenario that tests of several agents change."""

from pathlib import Path
from typing import Any

import pytest

WORLD = """\
deepbots: 1
name: Carts
world: {timestep: 32 ms, arena: {size: 4 4 m}}
robots:
  left:
    urdf: cartpole
    sensors: {angle: {type: joint_position, joint: pole_hinge}}
    actuators: {wheels: {type: velocity_motor, joints: [wheel_*]}}
    apply: {wheels: LEFT * 5 rad/s}
  right:
    urdf: cartpole
    pose: {y: 1 m}
    sensors: {angle: {type: joint_position, joint: pole_hinge}}
    actuators: {wheels: {type: velocity_motor, joints: [wheel_*]}}
    apply: {wheels: RIGHT * 5 rad/s}
signals: {apart: "distance(left, right)"}
truncation: {max_steps: 60}
reset: {joints: {left.pole_hinge: uniform(-5 .. 5 deg), right.pole_hinge: uniform(-5 .. 5 deg)}}
"""
"""The world, without agents. LEFT and RIGHT stand for the variables of the action."""
OF_TWO = WORLD.replace("LEFT", "drive").replace("RIGHT", "drive")
"""The world of two agents, each of which has a variable `drive`."""
OF_ONE = WORLD.replace("LEFT", "drive_left").replace("RIGHT", "drive_right")
"""The world of one agent that drives both carts."""
CARTS = (
    OF_TWO
    + """\
agents:
  left:
    robots: [left]
    action: {drive: -1 .. 1}
    augment: {speed: velocity(left).x}
    observation: {left.angle: -1 .. 1 rad, speed: -1 .. 1 m/s}
    reward: {upright: cos(left.angle), near: -0.1 * apart / m}
    scripts: {lean: {drive: 5 * left.angle / rad}, ahead: {drive: 1}}
  right: {like: left, robots: [right]}
endings:
  left_fell:  {when: tilt(left.pole) > 30 deg, success: right, failure: left}
  right_fell: {when: tilt(right.pole) > 30 deg, success: left, failure: right}
"""
)


def write_scenario(folder: Path, text: str) -> Path:
    file = folder / "several.yaml"
    file.write_text(text)
    return file


def scenario_fixture(text: str) -> Any:
    """Return a fixture: the path of a file with this scenario."""

    @pytest.fixture
    def scenario(tmp_path: Path) -> Path:
        return write_scenario(tmp_path, text)

    return scenario
