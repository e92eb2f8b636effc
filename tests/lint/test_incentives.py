"""Rewards that pay beside the success are found in the text, whatever the term looks like, and rewards that
sum to zero are not; limits of speed bound the return."""

from __future__ import annotations

import shutil
from math import hypot
from pathlib import Path

import pytest
import yaml

from deepbots_cli import api
from deepbots_cli.analysis import Analysis, possible_returns
from deepbots_cli.analysis.speeds import base_speed, highest_return

HERE = Path(__file__).parent

TABLES = yaml.safe_load((HERE / "incentives.yaml").read_text(encoding="utf-8"))
EXPLOITED, SOUND = TABLES["exploited"], TABLES["sound"]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for file in (HERE / "course.yaml", HERE.parents[1] / "robots" / "urdf" / "epuck.urdf"):
        shutil.copy(file, tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def write(folder: Path, text: str) -> Path:
    file = folder / "planted.yaml"
    file.write_text(f"deepbots: 1\nextends: course.yaml\nname: Planted\n{text}\n", encoding="utf-8")
    return file


@pytest.mark.parametrize("name", EXPLOITED)
def test_a_reward_that_pays_more_for_avoiding_the_success_is_found_before_training(
    name: str, folder: Path
) -> None:
    assert [finding.code for finding in api.lint(write(folder, EXPLOITED[name]))] == ["DB708"]


@pytest.mark.parametrize("name", SOUND)
def test_a_reward_that_pays_no_state_beside_the_success_is_silent(name: str, folder: Path) -> None:
    assert api.lint(write(folder, SOUND[name])) == []


# Limits of speed

FORWARD = """
truncation: {max_steps: 200}
reward: {there: 0, forward: velocity(epuck).x / (m/s)}
solved: mean_return >= 60 over 100 episodes
train: {algorithm: PPO, total_timesteps: 1000}
"""


@pytest.mark.parametrize(
    ("term", "highest"),
    [
        ("velocity(epuck).x / (m/s)", 200 * 0.1256),
        ("norm(velocity(epuck)) / (m/s)", 200 * 0.1256),
        ("100 * (position(epuck).x - previous(position(epuck).x)) / m", 100 * 20 * 0.1256),
        ("-100 * delta(ground_distance(epuck, post)) / m", 100 * 0.4),
        ("20 * max(0 m, -delta(ground_distance(epuck, post))) / m", 20 * 20 * 0.1256),
    ],
)
def test_a_required_return_beyond_the_limits_of_speed_is_out_of_reach(
    term: str, highest: float, folder: Path
) -> None:
    """200 steps of 0.1 s, and wheels that drive at 6.28 rad/s times 2 cm: 10 % above that the bound allows
    for tilting."""
    text = FORWARD.replace("velocity(epuck).x / (m/s)", f'"{term}"')
    program = api.compile(write(folder, text)).program
    bound = highest_return(Analysis(program))
    assert highest <= bound <= 1.101 * highest + 0.1
    (out,) = [
        finding
        for finding in api.lint(write(folder, text.replace(">= 60", f">= {1.01 * bound:.4f}")))
        if finding.code == "DB810"
    ]
    assert "limits of speed" in out.headline
    within = api.lint(write(folder, text.replace(">= 60", f">= {0.99 * bound:.4f}")))
    assert "DB810" not in {finding.code for finding in within}


@pytest.mark.parametrize(
    "change",
    [
        "disturbances: {push: {body: epuck, force: 1 0 0 N, at: 1 s, duration: 1 s}}",
        'world: {terrain: {type: formula, heights: "1 cm * sin(x / m * 900 deg)", size: 20 20 m}}',
        "reset: {place: {epuck: {velocity: 3 0 0 m/s}}}",
        "world: {gravity: 1 0 -9.81 m/s^2}",
    ],
)
def test_what_else_may_move_a_robot_leaves_its_return_without_bound(change: str, folder: Path) -> None:
    findings = api.lint(write(folder, FORWARD + change))
    assert "DB810" not in {finding.code for finding in findings}
    assert not any(finding.severity == "error" for finding in findings), findings


def test_statistics_take_no_bound_that_a_fall_may_exceed(folder: Path) -> None:
    program = api.compile(write(folder, FORWARD)).program
    assert possible_returns(program)[1] == float("inf")


@pytest.mark.parametrize("name", ["cartpole", "balancer", "quadrotor", "panda_reach"])
def test_robots_that_balance_fly_or_stand_fixed_have_no_limit_from_wheels(name: str) -> None:
    program = api.compile(name).program
    assert all(base_speed(Analysis(program), body.name) == float("inf") for body in program.world.robots)


TWO_WHEELS = """
<robot name="cart">
  <link name="base">
    <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <link name="arm"/>
  <link name="caster"><collision><geometry><sphere radius="0.01"/></geometry></collision></link>
  <joint name="bends" type="fixed"><parent link="base"/><child link="arm"/>
    <origin xyz="{back} {y} 0" rpy="0 1.5707963267948966 0"/></joint>
  <joint name="ends" type="fixed"><parent link="arm"/><child link="caster"/><origin xyz="{drop} 0 0"/></joint>
  {wheels}
</robot>
"""
WHEEL = """
  <link name="{name}_wheel">
    <inertial><mass value="0.1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin rpy="1.5707963267948966 0 0"/>
      <geometry><cylinder radius="0.05" length="0.01"/></geometry></collision>
  </link>
  <joint name="{name}" type="continuous"><parent link="base"/><child link="{name}_wheel"/>
    <origin xyz="{x} {y} 0"/><axis xyz="0 1 0"/></joint>
"""
SPEED, TRACK = 4 * 0.05, 0.2
"""m/s and m."""


def wheel_bound(folder: Path, x: float, y: float, *, behind: float = 0.1, rear_axle: bool = False) -> float:
    """Return the limit of speed (m/s) of a robot on two driven wheels; x and y (m) are the middle of their
    axle, from the origin of the robot."""
    places = {"left": (x, y + TRACK / 2), "right": (x, y - TRACK / 2)}
    if rear_axle:
        places |= {"left2": (x - 0.3, y + TRACK / 2), "right2": (x - 0.3, y - TRACK / 2)}
    wheels = "".join(WHEEL.format(name=name, x=at[0], y=at[1]) for name, at in places.items())
    urdf = TWO_WHEELS.format(back=x - behind, y=y, drop=0.04, wheels=wheels)
    (folder / "cart.urdf").write_text(urdf, encoding="utf-8")
    motors = {name: f"{{type: velocity_motor, joint: {name}, max_torque: 1 N*m}}" for name in places}
    text = (
        "deepbots: 1\nname: Cart\nworld: {timestep: 50 ms}\nrobots:\n  cart:\n    urdf: cart.urdf\n"
        f"    actuators: {{{', '.join(f'{name}: {motor}' for name, motor in motors.items())}}}\n"
        f"    apply: {{{', '.join(f'{name}: {name[0]} * 4 rad/s' for name in places)}}}\n"
        "action: {l: -1 .. 1, r: -1 .. 1}\naugment: {vx: velocity(cart).x}\n"
        "observation: {vx: -1 .. 1 m/s}\nreward: {fast: norm(velocity(cart)) / (m/s)}\n"
        "truncation: {max_steps: 100}\n"
    )
    (folder / "cart.yaml").write_text(text, encoding="utf-8")
    return base_speed(Analysis(api.compile(folder / "cart.yaml").program), "cart")


@pytest.mark.parametrize(("x", "y"), [(0, 0), (0, 0.2), (-0.2, 0), (-0.2, 0.2), (0.05, 0.05), (0, -0.15)])
def test_the_limit_of_two_wheels_is_that_of_a_rigid_robot_that_never_slides(
    x: float, y: float, folder: Path
) -> None:
    """Velocities of the wheels move the middle of the axle and turn the robot about it."""

    def speed(left: float, right: float) -> float:
        forward, turn = (left + right) / 2, (right - left) / TRACK
        return hypot(forward + turn * y, turn * x)

    commands = [SPEED * share / 10 for share in range(-10, 11)]
    fastest = max(speed(left, right) for left in commands for right in commands)
    assert wheel_bound(folder, x, y) == pytest.approx(1.1 * fastest)


def test_wheels_on_two_axles_or_without_a_caster_set_no_limit(folder: Path) -> None:
    """Where such a robot turns depends on which of its wheels slide."""
    assert wheel_bound(folder, 0, 0, rear_axle=True) == float("inf")
    assert wheel_bound(folder, 0, 0, behind=0) == float("inf")
