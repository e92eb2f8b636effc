"""`deepbots new --urdf` for robots that are unlike those that come with deepbots."""

from __future__ import annotations

import json
import re
from itertools import product
from math import cos, dist, pi, sin
from pathlib import Path

import pytest

from deepbots_cli import api, frames
from deepbots_cli.cli.starters.build import Build
from deepbots_cli.cli.starters.first_scenario import Draft
from tests.few import few

pytestmark = pytest.mark.usefixtures("simulated_here")

FREE = 'lower="-1" upper="1" effort="40" velocity="6"'


def link(name: str, shape: str, mass: float = 1.0, middle: str = "0 0 0") -> str:
    moments = " ".join(
        f'{key}="{0.01 * mass if key[1] == key[2] else 0}"'
        for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    )
    geometry = f'<origin xyz="{middle}"/><geometry>{shape}</geometry>'
    inertial = f'<inertial><origin xyz="{middle}"/><mass value="{mass}"/><inertia {moments}/></inertial>'
    return (
        f'<link name="{name}">{inertial}<visual>{geometry}</visual><collision>{geometry}</collision></link>'
    )


def box(size: str) -> str:
    return f'<box size="{size}"/>'


def joint(
    name: str, parent: str, child: str, xyz: str, axis: str = "0 1 0", limit: str = FREE, yaw: float = 0.0
) -> str:
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    kind = "revolute" if limit else "fixed"
    moves = f'<axis xyz="{axis}"/><limit {limit}/>' if limit else ""
    return f'<joint name="{name}" type="{kind}"><origin xyz="{xyz}" rpy="0 0 {yaw}"/>{ends}{moves}</joint>'


def tall_foot() -> str:
    """An arm on a pillar of 1 m, whose root link has its origin in the middle of the pillar."""
    wide = 'lower="-2.5" upper="2.5" effort="100" velocity="3"'
    links = [
        link("pillar", '<cylinder radius="0.2" length="1.0"/>', 40.0),
        link("upper", box("0.05 0.05 0.4"), middle="0 0 0.2"),
    ]
    links += [
        link("lower", box("0.05 0.05 0.4"), middle="0 0 0.2"),
        link("wrist", box("0.05 0.05 0.05")),
        link("hand", box("0.05 0.05 0.05")),
    ]
    joints = [
        joint("turn", "pillar", "upper", "0 0 0.5", "0 0 1", wide),
        joint("shoulder", "upper", "lower", "0 0 0.1", limit=wide),
    ]
    joints += [
        joint("elbow", "lower", "wrist", "0 0 0.4", limit=wide),
        joint("mount", "wrist", "hand", "0 0 0.3", limit=""),
    ]
    return "".join([*links, *joints])


def flat_arm(axis: str = "0 0 1") -> str:
    """Two hinges with parallel axes on a heavy foot: an arm that moves in a plane."""
    wide = 'lower="-2.5" upper="2.5" effort="20" velocity="3"'
    links = [link("foot", box("0.2 0.2 0.2"), 20.0), link("upper", box("0.3 0.04 0.04"), 0.5, "0.15 0 0")]
    links.append(link("lower", box("0.2 0.04 0.04"), 0.3, "0.1 0 0"))
    links.append(link("tip", box("0.02 0.02 0.02"), 0.05))
    joints = [
        joint("shoulder", "foot", "upper", "0 0 0.2", axis, wide),
        joint("elbow", "upper", "lower", "0.3 0 0.05", axis, wide),
    ]
    return "".join([*links, *joints, joint("mount", "lower", "tip", "0.2 0 0", limit="")])


def hoist() -> str:
    """The same in a vertical plane."""
    return flat_arm("0 1 0")


def snake() -> str:
    """Twelve joints in a row along the ground."""
    links = [link(f"l{number}", box("0.08 0.06 0.06"), 0.2) for number in range(13)]
    axes = ("0 1 0", "0 0 1")
    return "".join(
        [*links, *(joint(f"j{n}", f"l{n}", f"l{n + 1}", "0.1 0 0", axes[n % 2]) for n in range(12))]
    )


def spider() -> str:
    """A box on four legs whose joints cannot be at 0, where the legs would be level."""
    corners = [(0.15 * x, 0.15 * y, (2 * y - x * y) * pi / 4) for x, y in product((1, -1), (1, -1))]
    bent = 'lower="0.6" upper="1.4" effort="40" velocity="6"'
    links = [
        link("trunk", box("0.3 0.3 0.1"), 5.0),
        *(link(f"leg{n}", box("0.4 0.03 0.03"), 0.3, "0.2 0 0") for n in range(4)),
    ]
    return "".join(
        [
            *links,
            *(
                joint(f"hip{n}", "trunk", f"leg{n}", f"{x} {y} 0", limit=bent, yaw=yaw)
                for n, (x, y, yaw) in enumerate(corners)
            ),
        ]
    )


def hexacopter() -> str:
    around = [(0.3 * cos(n * pi / 3), 0.3 * sin(n * pi / 3)) for n in range(6)]
    links = [
        link("trunk", box("0.3 0.2 0.05"), 2.0),
        *(link(f"rotor{n}", box("0.1 0.1 0.01"), 0.05) for n in range(6)),
    ]
    return "".join(
        [
            *links,
            *(
                joint(f"m{n}", "trunk", f"rotor{n}", f"{x} {y} 0.05", limit="")
                for n, (x, y) in enumerate(around)
            ),
        ]
    )


def locked() -> str:
    """A hinge whose limits are the same, and one behind it that moves."""
    links = [
        link("foot", box("0.3 0.3 0.1"), 20.0),
        link("a", box("0.05 0.05 0.3"), middle="0 0 0.15"),
        link("b", box("0.05 0.05 0.3")),
    ]
    stuck = 'lower="0" upper="0" effort="40" velocity="6"'
    return "".join(
        [*links, joint("stuck", "foot", "a", "0 0 0.05", limit=stuck), joint("free", "a", "b", "0 0 0.45")]
    )


def gripper() -> str:
    """Two fingers that can only open from 0, of which one follows the other."""
    opening = 'lower="0" upper="0.8" effort="10" velocity="1"'
    right = joint("right", "palm", "b", "0 -0.1 0.1", "1 0 0", opening).replace(
        "</joint>", '<mimic joint="left"/></joint>'
    )
    links = [
        link("palm", box("0.3 0.3 0.1"), 20.0),
        link("a", box("0.1 0.05 0.1")),
        link("b", box("0.1 0.05 0.1")),
    ]
    return "".join([*links, joint("left", "palm", "a", "0 0.1 0.1", "1 0 0", opening), right])


def odd_names() -> str:
    names = [
        "on",
        "null",
        "1e3",
        "~",
        "-",
        "a b",
        "ü",
        "x: y",
        "[0]",
        "*",
        "&amp;",
        "&quot;",
        "-1",
        ".inf",
        "!t",
        "# c",
        "%",
        "@",
        "robot",
        "pi",
    ]
    around = [(name, 0.3 * cos(n), 0.3 * sin(n)) for n, name in enumerate(names)]
    links = [
        link("trunk", box("0.1 0.1 0.1"), 10.0),
        *(link(f"{name} link", box("0.05 0.05 0.05"), 0.1) for name in names),
    ]
    return "".join([*links, *(joint(name, "trunk", f"{name} link", f"{x} {y} 0.1") for name, x, y in around)])


ROBOTS = {
    make.__name__: make
    for make in (tall_foot, flat_arm, hoist, snake, spider, hexacopter, locked, gripper, odd_names)
}


@pytest.fixture
def robot(request, tmp_path):
    (tmp_path / f"{request.param}.urdf").write_text(
        f'<robot name="r">{ROBOTS[request.param]()}</robot>', encoding="utf-8"
    )
    return request.param


@pytest.mark.parametrize("robot", few(ROBOTS, ("tall_foot",)), indirect=True)
def test_a_new_scenario_has_no_findings_even_when_it_is_simulated(deepbots, robot):
    deepbots("new", "first", "--urdf", f"{robot}.urdf")
    ran = deepbots("lint", "first.yaml", "--deep", "--preview")
    assert ran.out == "first.yaml: no findings, including the simulation\n"


def test_groups_and_poses_have_names_of_their_own():
    model = api.compile("cartpole").program.world.robots[0].model
    draft = Draft(Build(model), "cartpole.urdf")
    hinges = [joint for joint in model.joints if joint.type == "continuous"]
    positions = {joint.name: 0.0 for joint in hinges}
    groups = [draft.add_group("parts", hinges[:1]), draft.add_links("parts", ["pole"])]
    assert groups == ["parts", "parts_2"]
    assert draft.groups == {"parts": [hinges[0].name], "parts_2": ["pole"]}
    poses = [draft.add_start(group, "rest", positions, hinges[:count]) for count, group in enumerate(groups)]
    assert poses == ["rest", "rest_2"]
    assert draft.starts == dict(zip(groups, poses, strict=True))
    assert [len(draft.poses[pose]) for pose in poses] == [0, 1]


@pytest.mark.parametrize("robot", ["tall_foot", "snake"], indirect=True)
def test_an_arm_that_was_lifted_out_of_the_ground_reaches_for_places_that_were_lifted_with_it(
    deepbots, tmp_path, robot
):
    deepbots("new", "first", "--urdf", f"{robot}.urdf", "--json")
    text = (tmp_path / "first.yaml").read_text(encoding="utf-8")
    low, high = (
        [float(word) for word in end.split()]
        for end in re.findall(r"target: uniform\((.*) \.\. (.*) m\)", text)[0]
    )
    lift = float(re.findall(r"robot: \{z: (\S+) m", text)[0])
    limb = Build(api.compile("first.yaml").program.world.robots[0].model).limbs[0]
    assert lift > 0.1
    for x, y, z in product(*zip(low, high, strict=True)):
        assert limb.positions_for((x, y, z - lift))[1] < 0.03 * limb.reach


@pytest.mark.parametrize(("robot", "across"), [("flat_arm", 2), ("hoist", 1)], indirect=["robot"])
def test_an_arm_that_moves_in_a_plane_reaches_for_places_in_it_and_starts_beside_them(
    deepbots, robot, across
):
    deepbots("new", "first", "--urdf", f"{robot}.urdf", "--json")
    world = api.make("first.yaml")
    limb = Build(world.scenario.world.robots[0].model).limbs[0]
    for seed in range(20):
        world.reset(seed=seed)
        target, tip = world.engine.pose("mark")()[0], world.engine.pose("robot", limb.tip)()[0]
        assert abs(target[across] - tip[across]) < 1e-3
        offset = frames.subtract(target, world.engine.pose("robot")()[0])
        assert (
            min(limb.positions_for(offset, joints)[1] for joints in (limb.joints, limb.joints[::-1]))
            < 0.03 * limb.reach
        )
        assert dist(target, tip) > 0.03 * limb.reach
    world.close()


@pytest.mark.parametrize(("lower", "upper"), [(-1.0, -0.999), (-3.0, -2.9), (0.0001, 0.0007), (2.9999, 9.0)])
def test_no_position_is_rounded_beyond_a_limit(deepbots, tmp_path, lower, upper):
    limit = f'lower="{lower}" upper="{upper}" effort="40" velocity="6"'
    text = joint("a", "foot", "arm", "0 0 0.1", limit=limit) + joint(
        "b", "arm", "tip", "0 0 0.4", limit=limit
    )
    links = (
        link("foot", box("0.3 0.3 0.1"), 20.0)
        + link("arm", box("0.1 0.1 0.4"), middle="0 0 0.2")
        + link("tip", box("0.1 0.1 0.1"))
    )
    (tmp_path / "narrow.urdf").write_text(f'<robot name="r">{links}{text}</robot>')
    deepbots("new", "first", "--urdf", "narrow.urdf", "--json")
    assert api.lint(tmp_path / "first.yaml", preview=True) == []


def test_a_package_of_ros_has_its_meshes_beside_the_folder_of_its_robot_file(deepbots, tmp_path, monkeypatch):
    for name in ("urdf", "meshes"):
        (tmp_path / "my_arm" / name).mkdir(parents=True)
    (tmp_path / "my_arm" / "meshes" / "foot.stl").write_text(
        "solid x\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\n"
        "endfacet\nendsolid x\n"
    )
    mesh = '<mesh filename="package://my_arm/meshes/foot.stl"/>'
    robot = f'<robot name="r">{link("base", mesh)}{tall_foot()}{joint("bolt", "base", "pillar", "0 0 0", limit="")}</robot>'
    (tmp_path / "my_arm" / "urdf" / "arm.urdf").write_text(robot)
    deepbots("inspect", "my_arm/urdf/arm.urdf")
    deepbots("new", "first", "--urdf", "my_arm/urdf/arm.urdf", "--json")
    assert [
        finding.code for finding in api.lint(tmp_path / "first.yaml") if finding.severity == "error"
    ] == []
    monkeypatch.chdir(tmp_path / "my_arm" / "urdf")
    assert "allow its folder with --allow-path" in deepbots("inspect", "arm.urdf", code=1).err
    deepbots("inspect", "arm.urdf", "--allow-path", "..")


@pytest.mark.parametrize("robot", ["locked"], indirect=True)
def test_a_joint_whose_limits_are_the_same_gets_no_motor(deepbots, tmp_path, robot):
    deepbots("new", "first", "--urdf", f"{robot}.urdf", "--json")
    assert [motor.joints for motor in api.compile(tmp_path / "first.yaml").program.robots[0].actuators] == [
        ("free",)
    ]


@pytest.mark.parametrize("robot", ["gripper"], indirect=True)
def test_a_joint_that_follows_another_gets_no_motor(deepbots, tmp_path, robot):
    deepbots("new", "first", "--urdf", f"{robot}.urdf", "--json")
    assert "2 of 2 joints move, 2 limbs, 1 follows another joint;" in (tmp_path / "first.yaml").read_text(
        encoding="utf-8"
    )
    assert [motor.joints for motor in api.compile(tmp_path / "first.yaml").program.robots[0].actuators] == [
        ("left",)
    ]


def test_a_robot_that_no_simulation_can_begin_with_gets_no_scenario(deepbots, tmp_path):
    massless = f'<link name="a"/>{link("foot", box("1 1 0.1"))}{joint("j", "foot", "a", "0 0 1")}'
    (tmp_path / "light.urdf").write_text(f'<robot name="r">{massless}</robot>')
    created = deepbots("new", "first", "--urdf", "light.urdf", code=2)
    assert "joint 'j' of light.urdf moves no mass; add an <inertial> with a mass to link 'a'" in created.err
    assert not (tmp_path / "first.yaml").exists()


def test_of_a_robot_file_that_is_not_there_the_nearest_shipped_one_is_suggested(deepbots):
    assert "did you mean rover?" in deepbots("new", "first", "--urdf", "rovr", code=2).err


ODD = (
    "bicycle/bike",
    "biped/biped2d_pybullet",
    "differential/diff_ring",
    "quadruped/microtaur/microtaur",
    "racecar/racecar_differential",
)


@pytest.mark.slow
@pytest.mark.parametrize("name", few(ODD, ODD[:2]))
def test_a_robot_with_an_unusual_file_gets_a_scenario_that_simulates_a_hundred_steps(deepbots, name):
    pytest.importorskip("pybullet_data")
    deepbots("new", "first", "--urdf", f"package://pybullet_data/{name}.urdf")
    assert deepbots("lint", "first.yaml").out == "first.yaml: no findings\n"
    ran = deepbots("try", "first.yaml", "--steps", "100")
    assert ran.err == ""
    assert "term" in ran.out


RACECAR = ("new", "car", "--urdf", "package://pybullet_data/racecar/racecar.urdf")


def test_the_script_of_a_steered_robot_reaches_marks_behind_it(deepbots):
    """It failed in the third of these episodes."""
    pytest.importorskip("pybullet_data")
    deepbots(*RACECAR)
    ran = deepbots(
        "try", "car.yaml", "--driver", "towards", "--episodes", "3", "--engine", "mujoco", "--json"
    )
    assert json.loads(ran.out)["summary"]["successes"] == 3


def test_wheels_of_a_car_push_with_at_most_its_weight(deepbots):
    """Its robot file allows 10 N*m for each of four wheels of 5 cm, which is 14 times its weight."""
    pytest.importorskip("pybullet_data")
    deepbots(*RACECAR)
    text = Path("car.yaml").read_text()
    assert "max_torque: 0.723 N*m" in text  # 5.89 kg * 9.81 m/s^2 * 5 cm / 4
    assert "14 times the weight" in text
    assert "`chassis` has no collision shape" in text


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["pybullet", "mujoco"])
def test_the_script_of_a_steered_robot_reaches_its_mark_from_fifty_starts(deepbots, engine):
    pytest.importorskip("pybullet_data")
    deepbots(*RACECAR)
    ran = deepbots("try", "car.yaml", "--driver", "towards", "--episodes", "50", "--engine", engine, "--json")
    assert json.loads(ran.out)["summary"]["successes"] == 50


def test_the_comment_about_a_tricycle_says_that_one_joint_steers(deepbots, tmp_path):
    tire = '<cylinder radius="0.05" length="0.02"/>'
    level = f'<collision><origin rpy="1.5707963 0 0"/><geometry>{tire}</geometry></collision></link>'
    links = [link("base", box("0.4 0.2 0.05")), link("fork", box("0.02 0.02 0.02"), 0.1)]
    axles = [
        ("fork", "front", "0 0 0"),
        ("base", "left", "-0.2 0.1 -0.03"),
        ("base", "right", "-0.2 -0.1 -0.03"),
    ]
    for parent, name, at in axles:
        links.append(re.sub("<visual>.*", level, link(name, tire, 0.1)))
        links.append(joint(f"{name}_wheel", parent, name, at).replace("revolute", "continuous"))
    links.append(joint("steering", "base", "fork", "0.2 0 -0.03", "0 0 1"))
    (tmp_path / "trike.urdf").write_text(f'<robot name="trike">{"".join(links)}</robot>', encoding="utf-8")
    deepbots("new", "first", "--urdf", "trike.urdf", "--json")
    text = (tmp_path / "first.yaml").read_text(encoding="utf-8")
    assert "4 of 4 joints move, 3 of them carry wheels, 1 steers;" in text
