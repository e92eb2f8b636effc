"""`deepbots new --urdf` for robots on legs: they stand where episodes begin, walk ahead, and lint clean."""

from __future__ import annotations

import re
from contextlib import closing
from math import hypot, radians
from pathlib import Path

import numpy as np
import pytest
import yaml

from deepbots_cli import api, frames
from deepbots_cli.robots.kinematics import center_of_mass, link_frames, min_spring_inertia
from deepbots_cli.robots.model import Inertial, Joint, Link, Pose, RobotModel
from tests.few import few

pytest.importorskip("deepbots_cli.engines.mujoco")  # first chooses the OpenGL library of `mujoco`

HINGE = 'lower="{}" upper="{}" effort="60" velocity="10"'


def link(name: str, size: str, mass: float, at: str = "0 0 0", inertia: float | None = None) -> str:
    x, y, z = map(float, size.split())
    moments = (
        (inertia, inertia, inertia)
        if inertia is not None
        else [mass / 12 * (a * a + b * b) for a, b in ((y, z), (x, z), (x, y))]
    )
    ixx, iyy, izz = moments
    return (
        f'<link name="{name}"><inertial><origin xyz="{at}"/><mass value="{mass}"/>'
        f'<inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="0" ixz="0" iyz="0"/></inertial>'
        f'<collision><origin xyz="{at}"/><geometry><box size="{size}"/></geometry></collision></link>'
    )


def joint(
    name: str, parent: str, child: str, at: str, axis: str, low: float = -1.5, high: float = 1.5
) -> str:
    return (
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{at}"/><axis xyz="{axis}"/><limit {HINGE.format(low, high)}/></joint>'
    )


def humanoid(toes: float = 0.05, ankle: float = 0.0, root_z: float = 0.0) -> str:
    """A humanoid of 0.9 m; its feet reach `toes` m farther to the front than to the back, stand at `ankle`
    rad to the ground with all joints at 0, and the origin of its root is `root_z` m below its hips."""
    parts = [link("trunk", "0.12 0.2 0.1", 4.0, f"0 0 {root_z}")]
    for side, y in (("left", 0.1), ("right", -0.1)):
        parts += [
            joint(f"{side}_hip_roll", "trunk", f"{side}_hip", f"0 {y} {root_z - 0.05}", "1 0 0", -0.5, 0.5),
            link(f"{side}_hip", "0.04 0.04 0.04", 0.5),
            joint(f"{side}_hip_pitch", f"{side}_hip", f"{side}_thigh", "0 0 0", "0 -1 0"),
            link(f"{side}_thigh", "0.06 0.06 0.3", 2.0, "0 0 -0.15"),
            joint(f"{side}_knee", f"{side}_thigh", f"{side}_shin", "0 0 -0.3", "0 1 0", 0.0, 2.3),
            link(f"{side}_shin", "0.05 0.05 0.3", 1.5, "0 0 -0.15"),
            joint(f"{side}_ankle", f"{side}_shin", f"{side}_foot", "0 0 -0.3", "0 1 0", -1.0, 1.0),
            link(f"{side}_foot", "0.18 0.08 0.02", 0.4, f"{toes / 2} 0 -0.04").replace(
                f'xyz="{toes / 2} 0 -0.04"', f'xyz="{toes / 2} 0 -0.04" rpy="0 {ankle} 0"'
            ),
            joint(f"{side}_shoulder", "torso", f"{side}_upper", f"0 {1.7 * y} 0.3", "0 1 0", -2.5, 2.5),
            link(f"{side}_upper", "0.04 0.04 0.2", 0.8, "0 0 -0.1"),
            joint(f"{side}_elbow", f"{side}_upper", f"{side}_lower", "0 0 -0.2", "0 1 0", -2.0, -0.1),
            link(f"{side}_lower", "0.03 0.03 0.2", 0.4, "0 0 -0.1"),
            joint(f"{side}_wrist", f"{side}_lower", f"{side}_hand", "0 0 -0.2", "1 0 0"),
            link(f"{side}_hand", "0.03 0.03 0.06", 0.1, "0 0 -0.03"),
        ]
    parts += [
        joint("waist", "trunk", "torso", f"0 0 {root_z + 0.06}", "0 0 1"),
        link("torso", "0.14 0.26 0.34", 8.0, "0.01 0 0.17"),
        joint("neck", "torso", "head", "0 0 0.36", "0 0 1"),
        link("head", "0.1 0.1 0.12", 1.0, "0 0 0.07"),
    ]
    return f'<robot name="humanoid">{"".join(parts)}</robot>'


def lying_quadruped() -> str:
    """A quadruped whose file has y up: x forward, z to the right; its legs end in shins without feet."""
    parts = [link("trunk", "0.4 0.1 0.2", 8.0)]
    for name, x, z in (("FL", 0.18, -0.1), ("FR", 0.18, 0.1), ("RL", -0.18, -0.1), ("RR", -0.18, 0.1)):
        parts += [
            joint(f"{name}_hip", "trunk", f"{name}_hip_link", f"{x} 0 {z}", "1 0 0", -0.8, 0.8),
            link(f"{name}_hip_link", "0.05 0.05 0.05", 0.5),
            joint(f"{name}_thigh", f"{name}_hip_link", f"{name}_thigh_link", "0 0 0", "0 0 1"),
            link(f"{name}_thigh_link", "0.04 0.2 0.04", 0.8, "0 -0.1 0"),
            joint(f"{name}_knee", f"{name}_thigh_link", f"{name}_shin", "0 -0.2 0", "0 0 1", -2.5, 2.5),
            link(f"{name}_shin", "0.02 0.22 0.02", 0.2, "0 -0.11 0"),
        ]
    return f'<robot name="dog">{"".join(parts)}</robot>'


def hexapod() -> str:
    """A robot on six legs of 0.24 m, drawn stretched out level."""
    parts = [link("body", "0.24 0.12 0.05", 1.5)]
    for number in range(6):
        side = 1 if number < 3 else -1
        x, y = 0.1 * (number % 3 - 1), 0.06 * side
        parts += [
            joint(f"coxa_{number}", "body", f"c{number}", f"{x} {y} 0", "0 0 1", -0.8, 0.8),
            link(f"c{number}", "0.03 0.03 0.03", 0.1),
            joint(f"femur_{number}", f"c{number}", f"f{number}", f"0 {0.04 * side} 0", f"{side} 0 0"),
            link(f"f{number}", "0.02 0.08 0.02", 0.1, f"0 {0.04 * side} 0"),
            joint(
                f"tibia_{number}", f"f{number}", f"t{number}", f"0 {0.08 * side} 0", f"{side} 0 0", -2.4, 2.4
            ),
            link(f"t{number}", "0.015 0.12 0.015", 0.05, f"0 {0.06 * side} 0"),
        ]
    return f'<robot name="hexapod">{"".join(parts)}</robot>'


@pytest.fixture
def written(deepbots, tmp_path):
    """Write a robot file and the scenario of `deepbots new`; return the text of the scenario."""

    def write(urdf: str) -> str:
        (tmp_path / "robot.urdf").write_text(urdf)
        deepbots("new", "first", "--urdf", "robot.urdf", "--json")
        return (tmp_path / "first.yaml").read_text(encoding="utf-8")

    return write


def stood(path: Path) -> tuple[float, float, float]:
    """Return the seconds that the first episode lasts with zero actions, how far the robot tilts meanwhile
    (rad) and how far it sinks (m)."""
    with closing(api.make(path)) as environment:
        environment.reset(seed=0)
        read = environment.engine.pose("robot")
        place, turn = read()
        tilt, sunk, steps, ended = 0.0, 0.0, 0, False
        while not ended:
            _, _, terminated, truncated, _ = environment.step(
                np.zeros(environment.action_space.shape, np.float32)
            )
            steps += 1
            ended = terminated or truncated
            moved = frames.multiply(tuple(read()[1]), frames.inverse(tuple(turn)))
            tilt = max(tilt, float(np.arccos(np.clip(frames.rotate(moved, (0.0, 0.0, 1.0))[2], -1.0, 1.0))))
            sunk = max(sunk, place[2] - read()[0][2])
        return steps * 0.02, tilt, sunk


ROBOTS = {
    "humanoid": humanoid(),
    "humanoid with feet that are not level": humanoid(ankle=0.2),
    "humanoid with its root on the ground": humanoid(root_z=0.7),
    "quadruped on its side": lying_quadruped(),
    "hexapod drawn stretched out": hexapod(),
}


@pytest.mark.parametrize(
    "name",
    few(
        ROBOTS,
        ("humanoid with feet that are not level", "quadruped on its side", "hexapod drawn stretched out"),
    ),
)
def test_a_robot_on_legs_stands_for_ten_seconds_without_a_policy(written, tmp_path, name):
    written(ROBOTS[name])
    assert api.lint(tmp_path / "first.yaml", preview=True) == []
    seconds, tilt, sunk = stood(tmp_path / "first.yaml")
    assert seconds == pytest.approx(10.0)
    assert tilt < radians(8.0)
    assert sunk < 0.02


def test_arms_waist_and_head_of_a_humanoid_hold_a_pose(written):
    groups = yaml.safe_load(written(humanoid()))["robots"]["robot"]["groups"]
    sides = ("left", "right")
    assert set(groups["legs"]) == {
        f"{side}_{name}" for side in sides for name in ("hip_roll", "hip_pitch", "knee", "ankle")
    }
    held = {f"{side}_{name}" for side in sides for name in ("shoulder", "elbow", "wrist")}
    assert set(groups["held_hinges"]) == held | {"waist", "neck"}


@pytest.mark.parametrize("ankle", [0.0, 0.2])
def test_soles_are_level_below_the_center_of_mass(written, tmp_path, ankle):
    poses = yaml.safe_load(written(humanoid(ankle=ankle)))["robots"]["robot"]["poses"]
    degrees = {name: float(text.split()[0]) for pose in poses.values() for name, text in pose.items()}
    for side in ("left", "right"):
        turned = -degrees[f"{side}_hip_pitch"] + degrees[f"{side}_knee"] + degrees[f"{side}_ankle"]
        assert turned == pytest.approx(-np.degrees(ankle), abs=1.0)
    model = api.compile(tmp_path / "first.yaml").program.world.robots[0].model
    where = link_frames(model, {name: radians(value) for name, value in degrees.items()})
    # The middle of the sole is 25 mm ahead of the ankle. Half a degree of a leg of 0.6 m is 5 mm.
    middle = frames.compose(where["left_foot"], ((0.025, 0.0, -0.04), frames.IDENTITY_ROTATION))[0]
    assert center_of_mass(model, where)[0] == pytest.approx(middle[0], abs=0.006)


@pytest.mark.parametrize(("toes", "ahead"), [(0.05, "v.x"), (-0.05, "-v.x"), (0.0, "v.x")])
def test_a_biped_walks_across_its_hips_toward_its_toes(written, toes, ahead):
    assert yaml.safe_load(written(humanoid(toes)))["signals"]["ahead"] == ahead


def test_a_robot_that_lies_in_its_file_walks_in_the_frame_of_its_root(written):
    text = written(lying_quadruped())
    assert yaml.safe_load(text)["signals"]["ahead"] == "v.x"
    assert "(ahead - speed)^2 + v.z^2" in text
    assert "roll: 90 deg" in text


def test_a_hexapod_stands_on_one_of_two_tripods_at_a_time(written):
    groups = yaml.safe_load(written(hexapod()))["robots"]["robot"]["groups"]
    assert sorted(sorted(groups[name]) for name in ("feet_a", "feet_b")) == [
        ["t0", "t2", "t4"],
        ["t1", "t3", "t5"],
    ]


HEAD = link("head", "0.1 0.1 0.12", 1.0, "0 0 0.07")
IMPOSSIBLE = HEAD.replace('izz="', 'izz="1')
"""An inertia that no body can have."""
FRAME = link("tool", "0.01 0.01 0.01", 1e-9, inertia=0.0)
FIXED = '<joint name="t" type="fixed"><parent link="head"/><child link="tool"/></joint>'


@pytest.mark.parametrize(
    ("part", "other", "words"),
    [
        (HEAD, IMPOSSIBLE, ["head: {inertia: auto}", "engine: mujoco"]),
        # Without a shape that tells the inertia, an engine that takes it.
        (HEAD, re.sub("<collision>.*</collision>", "", IMPOSSIBLE), ["engine: pybullet"]),
        ("</robot>", f"{FRAME}{FIXED}</robot>", ["engine: mujoco"]),
    ],
    ids=["of the shape", "without a shape", "a frame of a billionth of a kilogram"],
)
def test_a_mass_that_mujoco_refuses_does_not_stop_a_robot(written, tmp_path, part, other, words):
    pytest.importorskip("pybullet")
    urdf = humanoid()
    assert part in urdf
    text = written(urdf.replace(part, other))
    assert [word for word in words if word not in text] == []
    assert stood(tmp_path / "first.yaml")[0] == pytest.approx(10.0)


def test_the_center_of_mass_of_a_bent_arm_is_the_mean_of_its_links_by_mass():
    """Of 3 kg at (1, 0, 0) and 1 kg at (0, 0, 2) + R(90 deg about y) (0, 0, 1) = (1, 0, 2)."""
    arm = RobotModel(
        "arm",
        (
            Link("base", Inertial(3.0, Pose((1.0, 0.0, 0.0)))),
            Link("tip", Inertial(1.0, Pose((0.0, 0.0, 1.0)))),
        ),
        (Joint("hinge", "continuous", "base", "tip", Pose((0.0, 0.0, 2.0)), (0.0, 1.0, 0.0)),),
        "base",
    )
    where = link_frames(arm, {"hinge": radians(90.0)})
    assert center_of_mass(arm, where) == pytest.approx((1.0, 0.0, 0.5))


@pytest.mark.parametrize(("factor", "grows"), [(0.98, True), (1.02, False)])
def test_a_spring_shakes_an_inertia_below_the_least_one(factor, grows):
    """Semi-implicit Euler steps of k = 80 N m/rad, d = 2 N m s/rad and h = 5 ms."""
    stiffness, damping, step = 80.0, 2.0, 0.005
    inertia = factor * min_spring_inertia(stiffness, damping, step)
    position, velocity = 1.0, 0.0
    for _ in range(3000):
        velocity += step * (-stiffness * position - damping * velocity) / inertia
        position += step * velocity
    assert (hypot(position, velocity * step) > 1.0) is grows
