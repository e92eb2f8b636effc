"""Robot files as programs write them and other programs load them: read, with one finding for one cause."""

from __future__ import annotations

import json
import math
import shlex
from pathlib import Path

import pytest

from deepbots_cli import api
from deepbots_cli.compiler import check
from deepbots_cli.diagnostics import Finding, Findings
from deepbots_cli.document import loads
from deepbots_cli.robots.kinematics import (
    inertial_of_shapes,
    with_inertia_of_shapes,
    with_mass_of_shapes,
)
from deepbots_cli.robots.model import (
    Box,
    Geometry,
    Inertial,
    Limit,
    Link,
    Pose,
    RobotModel,
    Sphere,
    combined,
    homogeneous_inertial,
)
from deepbots_cli.robots.reader import RobotFile, read
from tests.commands import Deepbots

MASS = '<inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01"/></inertial>'
TETRAHEDRON = "v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
BOX = '<collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision>'


def link(name: str, inside: str = MASS + BOX) -> str:
    return f'<link name="{name}">{inside}</link>'


def joint(name: str, parent: str, child: str, kind: str = "revolute", inside: str = "") -> str:
    limit = (
        '<limit lower="-1" upper="1" effort="5" velocity="5"/>' if not inside and kind == "revolute" else ""
    )
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<axis xyz="0 1 0"/>{limit}{inside}</joint>'
    )


def robot(*parts: str) -> str:
    return f'<robot name="r">\n{chr(10).join(parts)}\n</robot>'


def opened(folder: Path, text: str) -> tuple[RobotFile | None, list[Finding]]:
    (folder / "robot.urdf").write_text(text)
    findings = Findings()
    return read(folder / "robot.urdf", "robot.urdf", findings), list(findings)


def scenario(links: str = "", base: str = "fixed", engine: str = "mujoco") -> str:
    return f"""deepbots: 1
name: Mine
world: {{timestep: 20 ms, engine: {engine}}}
robots:
  r:
    urdf: robot.urdf
    base: {base}
    links: {{{links}}}
    sensors: {{angle: {{type: joint_position, joint: hinge}}}}
    actuators: {{motor: {{type: torque_motor, joint: hinge, max_torque: 1 N*m}}}}
    apply: {{motor: push * 1 N*m}}
action: {{push: -1 .. 1}}
observation: {{r.angle: -180 .. 180 deg}}
reward: {{still: 1}}
truncation: {{max_steps: 3}}
"""


def runs(folder: Path, text: str) -> None:
    """Step the scenario once."""
    (folder / "t.yaml").write_text(text)
    env = api.make(folder / "t.yaml")
    try:
        env.reset(seed=0)
        env.step(env.action_space.sample())
    finally:
        env.close()


ARM = (link("base"), link("arm"), joint("hinge", "base", "arm"))


@pytest.mark.parametrize(
    "shape", ['<sphere radius="0"/>', '<box size="0 0 0"/>', '<cylinder radius="0.1" length="0"/>']
)
def test_a_shape_without_size_is_left_out_with_one_warning(tmp_path: Path, shape: str):
    none = f"<collision><geometry>{shape}</geometry></collision>"
    file, findings = opened(tmp_path, robot(link("base", MASS + none * 5), link("arm"), ARM[2]))
    assert file is not None
    assert [finding.code for finding in findings] == ["DB311"]
    assert file.model.link("base").collisions == ()


def test_limits_of_minus_one_are_no_limits(tmp_path: Path):
    limit = '<limit lower="-1" upper="1" effort="-1.0" velocity="-1"/>'
    file, findings = opened(tmp_path, robot(*ARM[:2], joint("hinge", "base", "arm", inside=limit)))
    assert file is not None
    assert file.model.joint("hinge").limit == Limit(-1.0, 1.0, None, None)
    assert [finding.headline for finding in findings] == [
        "a negative limit of effort; deepbots reads it as no limit"
    ]


def test_limits_of_the_largest_number_are_no_limits(tmp_path: Path):
    limit = '<limit lower="-1.79769e+308" upper="1.79769e+308" effort="1.79769e+308" velocity="inf"/>'
    file, findings = opened(tmp_path, robot(*ARM[:2], joint("hinge", "base", "arm", inside=limit)))
    assert file is not None
    assert findings == []
    assert file.model.joint("hinge").limit == Limit()


def test_an_inertia_of_rounding_on_a_tool_frame_is_read(tmp_path: Path):
    rounding = '<inertial><mass value="0.1"/><inertia ixx="-5.4e-20" iyy="-5.4e-20" izz="0"/></inertial>'
    frame = '<inertial><mass value="1e-9"/><inertia ixx="0" iyy="0" izz="0"/></inertial>'
    parts = [link("tip", rounding), joint("a", "arm", "tip", "fixed")]
    parts += [link("tool", frame), joint("b", "arm", "tool", "fixed")]
    file, findings = opened(tmp_path, robot(*ARM, *parts))
    assert file is not None
    assert findings == []
    for engine in ("mujoco", "pybullet"):
        runs(tmp_path, scenario(engine=engine))


def test_a_world_that_is_not_declared_is_a_root_without_mass(tmp_path: Path):
    file, findings = opened(tmp_path, robot(*ARM, joint("weld", "world", "base", "fixed")))
    assert file is not None
    assert (file.model.root, findings) == ("world", [])
    file, findings = opened(tmp_path, robot(*ARM, joint("weld", "wrold", "base", "fixed")))
    assert file is None


def test_a_floating_joint_below_an_empty_root_is_a_free_base(tmp_path: Path):
    file, findings = opened(
        tmp_path, robot(link("world", ""), *ARM, joint("base", "world", "base", "floating"))
    )
    assert file is not None
    assert (file.model.root, [one.name for one in file.model.joints], findings) == ("base", ["hinge"], [])
    runs(tmp_path, scenario(base="free"))


def test_many_materials_and_followers_that_do_not_move_are_one_finding_each(tmp_path: Path):
    two = '<visual><geometry><box size="1 1 1"/></geometry><material name="a"/><material name="b"/></visual>'
    mimic = '<mimic joint="hinge"/>'
    parts = [link(f"l{number}", MASS + two) for number in range(16)]
    parts += [joint(f"j{number}", "base", f"l{number}", "fixed", mimic) for number in range(16)]
    file, findings = opened(tmp_path, robot(*ARM, *parts))
    assert file is not None
    assert [finding.headline for finding in findings] == [
        "deepbots ignores a second <material> in the same <visual>",
        "joint 'j0' is fixed, so it follows nothing",
    ]
    assert all("the same is true of 15 more, in lines" in finding.notes[-1] for finding in findings)


def test_a_drawing_and_a_frame_on_a_fixed_joint_need_no_mass(tmp_path: Path):
    drawn = '<visual><geometry><sphere radius="0.1"/></geometry></visual>'
    parts = [link("mark", drawn), link("tool0", "")]
    parts += [joint(name, "arm", name, "fixed") for name in ("mark", "tool0")]
    assert opened(tmp_path, robot(*ARM, *parts))[1] == []


def test_a_mesh_that_is_a_pointer_of_git_lfs_is_said_to_be_one(tmp_path: Path):
    (tmp_path / "a b.stl").write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n")
    mesh = '<collision><geometry><mesh filename="a b.stl"/></geometry></collision>'
    file, (finding,) = opened(tmp_path, robot(link("base", MASS + mesh)))
    assert file is None
    assert "Git LFS pointer" in finding.headline
    assert "git lfs pull" in str(finding.help)


def test_one_number_scales_a_mesh_along_all_axes(tmp_path: Path):
    (tmp_path / "m.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    mesh = '<visual><geometry><mesh filename="m.obj" scale="0.5"/></geometry></visual>'
    file, findings = opened(tmp_path, robot(link("base", MASS + mesh * 3)))
    assert file is not None
    assert file.model.links[0].visuals[0].shape.scale == (0.5, 0.5, 0.5)
    assert len(findings) == 1


# Masses and inertias from shapes


def test_the_inertia_of_several_solids_is_that_of_one_body_cut_into_them():
    long = homogeneous_inertial(Box((0.2, 0.1, 0.1)), 2.0)
    halves = [homogeneous_inertial(Box((0.1, 0.1, 0.1)), 1.0, Pose((x, 0.0, 0.0))) for x in (-0.05, 0.05)]
    whole = combined(halves)
    assert (whole.mass, whole.origin.xyz) == (2.0, (0.0, 0.0, 0.0))
    assert [whole.ixx, whole.iyy, whole.izz] == pytest.approx([long.ixx, long.iyy, long.izz])
    shapes = tuple(Geometry(Box((0.1, 0.1, 0.1)), Pose((x, 0.0, 0.0))) for x in (-0.05, 0.05))
    assert inertial_of_shapes(Link("a", collisions=shapes), 2.0) == whole


def test_an_automatic_inertia_is_that_of_the_shape_and_keeps_mass_and_center():
    impossible = Inertial(3.0, Pose((0.0, 0.0, 0.1)), ixx=1.0, iyy=1.0, izz=9.0)
    model = RobotModel("r", (Link("a", impossible, collisions=(Geometry(Sphere(0.2)),)),), (), "a")
    mended = with_inertia_of_shapes(model, "a").link("a").inertial
    assert (mended.mass, mended.origin.xyz) == (3.0, (0.0, 0.0, 0.1))
    assert mended.matrix[0][0] == mended.matrix[2][2] == pytest.approx(0.4 * 3.0 * 0.2**2)


@pytest.mark.parametrize(
    ("inside", "links"),
    [
        (BOX, '"*": {density: 1000 kg/m^3}'),
        (BOX + BOX, "base: {mass: 1 kg}, arm: {mass: 1 kg}"),
        (
            '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="9"/></inertial>' + BOX,
            '"*": {inertia: auto}',
        ),
    ],
    ids=["density", "mass", "inertia"],
)
def test_a_robot_without_usable_inertials_runs_with_those_of_the_scenario_and_without_findings(
    tmp_path: Path, inside: str, links: str
):
    (tmp_path / "robot.urdf").write_text(robot(link("base", inside), link("arm", inside), ARM[2]))
    text = scenario(links)
    assert [finding.code for finding in check(loads(text, "t.yaml", base=tmp_path)).findings] == []
    runs(tmp_path, text)


def test_a_mass_without_a_shape_is_a_ball_of_water():
    model = RobotModel("r", (Link("a"),), (), "a")
    radius = 0.1
    mass = 4 / 3 * math.pi * radius**3 * 1000
    ball = with_mass_of_shapes(model, "a", mass).link("a").inertial
    assert (ball.ixx, ball.iyy, ball.izz) == pytest.approx((0.4 * mass * radius**2,) * 3)


def test_an_automatic_inertia_needs_a_shape_and_a_mass(tmp_path: Path):
    (tmp_path / "robot.urdf").write_text(robot(link("base", MASS), link("arm"), ARM[2]))
    findings = list(check(loads(scenario("base: {inertia: auto}"), "t.yaml", base=tmp_path)).findings)
    assert [(finding.code, "has no shape" in finding.headline) for finding in findings] == [("DB105", True)]


def test_the_error_of_missing_meshes_is_at_one_that_the_robot_needs(tmp_path: Path):
    """The mesh of `base` alone is a warning: the link has a box to touch."""
    first, second = (
        f'<{tag}><geometry><mesh filename="{tag}.stl"/></geometry></{tag}>' for tag in ("visual", "collision")
    )
    _, findings = opened(tmp_path, robot(link("base", first + BOX), link("arm", second), ARM[2]))
    assert [finding.span.text for finding in findings if finding.severity == "error"] == ["collision.stl"]


# Commands


def test_a_robot_file_is_linted_alone(deepbots: Deepbots, tmp_path: Path):
    (tmp_path / "my robot.urdf").write_text(
        robot(link("base", MASS + BOX + BOX.replace("0.1 0.1 0.1", "0 0 0")))
    )
    ran = deepbots("lint", "my robot.urdf", "--json")
    assert '"code": "DB311"' in ran.out
    assert '"file": "my robot.urdf"' in ran.out
    (tmp_path / "my robot.urdf").write_text("<robot")
    deepbots("lint", "my robot.urdf", "--format", "github", code=1)


ORIGIN = '<origin xyz="0 0 0"/>'
COLOR = '<color rgba="0 1 0 1"/>'
FIXES = {
    "a misspelled element": ("</collision>", "</colision>", ("<collision>", "<colision>")),
    "a misspelled attribute": ('lower="-1"', 'lowr="-1"'),
    "a misspelled type": ('type="revolute"', 'type="revolut"'),
    "a misspelled link": ('<child link="arm"/>', '<child link="amr"/>'),
    "two materials": ("</visual>", '<material name="a"/>\n  <material name="b"></material></visual>'),
    "two colors": ("</visual>", f'<material name="a">{2 * COLOR}</material></visual>'),
    "limits of minus one": ('effort="5" velocity="5"', 'effort="-1" velocity="-1.0"'),
    "crossed limits": ('lower="-1" upper="1"', 'lower="1" upper="-1"'),
    "one scale": ('"m.obj"', '"m.obj" scale="0.5"'),
    "no limits": (' lower="-1" upper="1"', ""),
    "another version of XML": ("<robot", '<?xml version="1.1"?>\n<robot'),
    "an empty line before the declaration": ("<robot", '\n<?xml version="1.0"?>\n<robot'),
    "no size": ("</visual>", '</visual><collision><geometry><sphere radius="0"/></geometry></collision>'),
    "an angle in degrees": (ORIGIN, '<origin xyz="0 0 0" rpy="0 90 0"/>'),
    "a comma": ('"0 0 0"', '"0, 0, 0"'),
    "a mesh elsewhere": ('"m.obj"', '"/home/x/ws/meshes/m.obj"'),
    "an impossible inertia": ('izz="0.01"', 'izz="0.03"'),
    "a follower that is fixed": (
        "</robot>",
        link("tip") + joint("weld", "arm", "tip", "fixed", '<mimic joint="hinge"/>') + "</robot>",
    ),
}


@pytest.mark.parametrize("case", FIXES)
def test_a_robot_file_is_fixed_and_has_no_findings_then(deepbots: Deepbots, tmp_path: Path, case: str):
    (tmp_path / "m.obj").write_text(TETRAHEDRON)
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes/m.obj").write_text(TETRAHEDRON)
    drawn = '<visual><geometry><mesh filename="m.obj"/></geometry></visual>'
    moved = f'<collision>{ORIGIN}<geometry><box size="0.1 0.1 0.1"/></geometry></collision>'
    text = robot(link("base", MASS + drawn + moved), link("arm"), joint("hinge", "base", "arm"))
    right, wrong, *more = FIXES[case]
    for old, new in ((right, wrong), *more):
        text = text.replace(old, new, 1)
    path = tmp_path / "robot.urdf"
    path.write_text(text)
    (finding,) = json.loads(deepbots("lint", "robot.urdf", "--json", "--exit-zero").out)["findings"]
    assert finding["fix"]["edits"]
    assert deepbots("lint", "robot.urdf", "--diff", "--unsafe-fixes", code=1).out.startswith("--- robot.urdf")
    assert path.read_text() == text
    ran = deepbots("lint", "robot.urdf", "--fix", "--unsafe-fixes")
    assert ran.out == "robot.urdf: no findings\n"


def test_a_fix_that_is_a_guess_needs_its_option(deepbots: Deepbots, tmp_path: Path):
    crossed = robot(*ARM).replace('lower="-1" upper="1"', 'lower="1" upper="-1"')
    (tmp_path / "robot.urdf").write_text(crossed)
    deepbots("lint", "robot.urdf", "--fix")
    assert (tmp_path / "robot.urdf").read_text() == crossed


def test_no_text_of_a_template_is_fixed(deepbots: Deepbots, tmp_path: Path):
    text = robot(*ARM).replace('effort="5"', 'effort="${-1}"').replace('velocity="5"', 'velocity="-1"')
    (tmp_path / "robot.urdf.xacro").write_text(text)
    ran = deepbots("lint", "robot.urdf.xacro", "--fix")
    assert "DB311" in ran.out
    assert (tmp_path / "robot.urdf.xacro").read_text() == text


def test_the_robot_file_of_a_scenario_is_not_changed_with_it(deepbots: Deepbots, tmp_path: Path):
    text = robot(*ARM).replace('velocity="5"', 'velocity="-1"')
    (tmp_path / "robot.urdf").write_text(text)
    (tmp_path / "t.yaml").write_text(scenario())
    ran = deepbots("lint", "t.yaml", "--fix")
    assert "DB311" in ran.out
    assert (tmp_path / "robot.urdf").read_text() == text


def test_a_robot_outside_the_project_is_copied_with_its_meshes_as_the_message_offers(
    deepbots: Deepbots, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    mesh = '<collision><geometry><mesh filename="package://hand/m.obj"/></geometry></collision>'
    away, home = tmp_path / "away", tmp_path / "home"
    for folder in (away / "arm/urdf", away / "hand", home):
        folder.mkdir(parents=True)
    (home / "deepbots.toml").write_text("")
    (away / "hand/m.obj").write_text(TETRAHEDRON)
    (away / "arm/urdf/arm.urdf").write_text(robot(link("base", MASS + mesh * 4), *ARM[1:]))
    monkeypatch.chdir(home)
    ran = deepbots("new", "first", "--urdf", "../away/arm/urdf/arm.urdf", code=1)
    assert ran.err.count("error DB301") == 1
    copies, allows = (
        shlex.split(line)[1:] for line in ran.err.splitlines() if line.startswith("  deepbots ")
    )
    assert copies[-1] == "--copy"
    created = deepbots(*copies)
    assert "--allow-path" not in created.err
    assert api.lint(home / "first.yaml") == []
    copied = home / "arm/arm/urdf/arm.urdf"
    assert 'filename="../../hand/m.obj"' in copied.read_text()
    copied.write_text("mine")
    deepbots(*copies, code=2)
    assert copied.read_text() == "mine"
    created = deepbots(*allows, "--force")
    lint = next(shlex.split(line) for line in created.err.splitlines() if line.startswith("  deepbots lint"))
    deepbots(*lint[1:])


def test_new_for_a_robot_without_masses_gives_the_links_a_density(deepbots: Deepbots, tmp_path: Path):
    (tmp_path / "bare.urdf").write_text(robot(link("base", BOX), link("arm", BOX), ARM[2]))
    deepbots("new", "first", "--urdf", "bare.urdf", "--json")
    assert "density: 1000 kg/m^3" in (tmp_path / "first.yaml").read_text()
    assert api.lint(tmp_path / "first.yaml") == []


def test_a_density_is_not_offered_to_a_link_without_a_shape(tmp_path: Path):
    for inside, is_offered in (("", False), (BOX, True)):
        text = robot(link("base"), link("leg", inside), joint("hip", "base", "leg"))
        _, findings = opened(tmp_path, text)
        (finding,) = (finding for finding in findings if finding.code == "DB305")
        assert ("density" in str(finding.help)) is is_offered


def test_new_for_sixteen_hinges_with_alternating_velocity_limits_runs(deepbots: Deepbots, tmp_path: Path):
    limit = '<origin xyz="0 0 0.06"/><limit lower="-1" upper="1" effort="20" velocity="{}"/>'
    velocities = ["5.123456", "5.123456", "1.832612", "1.832612"] * 4
    links = [link(f"l{number}") for number in range(17)]
    hinges = [
        joint(f"j{number}", f"l{number}", f"l{number + 1}", inside=limit.format(velocity))
        for number, velocity in enumerate(velocities)
    ]
    (tmp_path / "arm.urdf").write_text(robot(*links, *hinges))
    deepbots("new", "first", "--urdf", "arm.urdf", "--json")
    runs(tmp_path, (tmp_path / "first.yaml").read_text())


def test_a_drawing_whose_mesh_is_missing_is_a_warning_where_the_link_has_another_shape(tmp_path: Path):
    drawn = '<visual><geometry><mesh filename="gone.stl"/></geometry></visual>'
    file, findings = opened(tmp_path, robot(link("base", MASS + BOX + drawn * 3), link("arm"), ARM[2]))
    assert file is not None
    assert file.model.link("base").visuals == ()
    assert [(finding.code, finding.headline) for finding in findings] == [
        ("DB311", "the mesh does not exist; the robot is drawn without it")
    ]
    for shape in (drawn, BOX + drawn.replace("visual", "collision")):
        file, (finding,) = opened(tmp_path, robot(link("base", MASS + shape), link("arm"), ARM[2]))
        assert (file, finding.code) == (None, "DB301")


def test_a_root_that_is_the_frame_of_the_heavy_link_bolted_to_it_needs_no_mass(tmp_path: Path):
    weld = joint("weld", "base_link", "base", "fixed")
    assert opened(tmp_path, robot(link("base_link", BOX), *ARM, weld))[1] == []
    light = robot(link("base_link", BOX), link("base", ""), *ARM[1:], weld)
    assert [finding.code for finding in opened(tmp_path, light)[1]] == ["DB305"]
