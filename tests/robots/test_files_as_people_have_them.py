"""Robot files as programs write them and other programs load them: read, with one finding for one cause.

The places where a mesh is looked for, and that nothing outside the allowed folders is opened.
"""

from __future__ import annotations

import json
import math
import os
import shlex
import tempfile
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepbots_cli import api
from deepbots_cli.compiler import check
from deepbots_cli.diagnostics import Finding, Findings
from deepbots_cli.document import loads
from deepbots_cli.robots import packages
from deepbots_cli.robots.kinematics import inertial_of_shapes, with_inertia_of_shapes, with_mass_of_shapes
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
from deepbots_cli.robots.packages import MeshElsewhere, Places, UnusableMesh, mesh_resolver
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


@pytest.mark.parametrize(
    ("limit", "read", "headlines"),
    [
        (
            'lower="-1" upper="1" effort="-1.0" velocity="-1"',
            Limit(-1.0, 1.0, None, None),
            ["a negative limit of effort; deepbots reads it as no limit"],
        ),
        ('lower="-1.79769e+308" upper="1.79769e+308" effort="1.79769e+308" velocity="inf"', Limit(), []),
    ],
)
def test_limits_of_minus_one_and_of_the_largest_number_are_no_limits(
    tmp_path: Path, limit: str, read: Limit, headlines: list[str]
):
    file, findings = opened(
        tmp_path, robot(*ARM[:2], joint("hinge", "base", "arm", inside=f"<limit {limit}/>"))
    )
    assert file is not None
    assert file.model.joint("hinge").limit == read
    assert [finding.headline for finding in findings] == headlines


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


@pytest.mark.parametrize("name", ["a b.stl", "m.gltf"])
def test_a_mesh_that_is_a_pointer_of_git_lfs_is_said_to_be_one(tmp_path: Path, name: str):
    (tmp_path / name).write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n")
    mesh = f'<collision><geometry><mesh filename="{name}"/></geometry></collision>'
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


def test_a_comment_suppresses_a_warning_also_where_the_robot_file_is_linted_alone(
    deepbots: Deepbots, tmp_path: Path
):
    arm = '<link name="arm"/> <!-- deepbots: ignore[DB305] -->'
    write(tmp_path, **{"robot.urdf": robot(link("base", MASS), arm, joint("hinge", "base", "arm"))})
    assert json.loads(deepbots("lint", "robot.urdf", "--json").out)["findings"] == []


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
    assert deepbots("lint", "robot.urdf", "--fix", "--unsafe-fixes").out == "robot.urdf: no findings\n"


NEGATIVE = robot(*ARM).replace('velocity="5"', 'velocity="-1"')


@pytest.mark.parametrize(
    ("file", "text", "linted", "said"),
    [
        ("robot.urdf", robot(*ARM).replace('lower="-1" upper="1"', 'lower="1" upper="-1"'), "robot.urdf", ""),
        ("robot.urdf.xacro", NEGATIVE.replace('effort="5"', 'effort="${-1}"'), "robot.urdf.xacro", "DB311"),
        ("robot.urdf", NEGATIVE, "t.yaml", "DB311"),
    ],
    ids=["a guess without its option", "the text of a template", "the robot file of a scenario"],
)
def test_it_is_not_fixed(deepbots: Deepbots, tmp_path: Path, file: str, text: str, linted: str, said: str):
    (tmp_path / "t.yaml").write_text(scenario())
    (tmp_path / file).write_text(text)
    assert said in deepbots("lint", linted, "--fix").out
    assert (tmp_path / file).read_text() == text


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
        _, findings = opened(tmp_path, robot(link("base"), link("leg", inside), joint("hip", "base", "leg")))
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


# The places where a mesh is looked for, and that nothing outside the allowed folders is opened


MANIFEST = "<?xml version='1.0'?><package><!-- <name>other</name> --><name> {} </name></package>"


def write(folder: Path, **files: str | bytes) -> None:
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content.encode() if isinstance(content, str) else content)


def located(robot: Path, reference: str, *allowed: Path) -> Path | None:
    """The file that a robot file names; None for a refusal."""
    place = mesh_resolver(robot, allowed)(reference)
    if isinstance(place, MeshElsewhere):
        return place.path
    return None if isinstance(place, UnusableMesh) else place


# The robot file is `ws/arm/urdf/arm.urdf`, and `ws` is allowed.
PLACES = {
    "the folder of the package": ("package://arm/meshes/m.obj", "arm/meshes/m.obj", {}),
    "a checkout of another name": ("package://robot/m.obj", "arm/m.obj", {"arm/package.xml": "robot"}),
    "a sibling": ("package://hand/m.obj", "hand/m.obj", {}),
    "a sibling by its package.xml": ("package://hand/m.obj", "x/m.obj", {"x/package.xml": "hand"}),
    "a deeper package": ("package://hand/m.obj", "a/b/x/m.obj", {"a/b/x/package.xml": "hand"}),
    "three slashes": ("package:///meshes/m.obj", "arm/meshes/m.obj", {}),
    "no name": ("package://meshes/m.obj", "arm/meshes/m.obj", {}),
    "a file alone": ("package://m.obj", "arm/m.obj", {}),
    "a name of Gazebo": ("model://arm/m.obj", "arm/m.obj", {}),
    "a name with blanks": ("package://my arm/a mesh.obj", "my arm/a mesh.obj", {}),
    "an encoded NUL": ("package://arm/a%00.obj", "arm/a\ufffd.obj", {}),
    "an encoded blank": ("package://my%20arm/a%20mesh.obj", "my arm/a mesh.obj", {}),
    "another package name": ("package://gone/meshes/m.obj", "arm/meshes/m.obj", {}),
    "a folder of the author": ("/home/x/ws/src/arm/meshes/m.obj", "arm/meshes/m.obj", {}),
    "a folder of an author with Windows": (r"C:\ws\arm\meshes\m.obj", "arm/meshes/m.obj", {}),
}


@pytest.mark.parametrize("case", PLACES)
def test_a_mesh_is_found_in(tmp_path: Path, case: str):
    reference, mesh, manifests = PLACES[case]
    write(tmp_path, **{"arm/urdf/arm.urdf": "", mesh: TETRAHEDRON})
    write(tmp_path, **{path: MANIFEST.format(name) for path, name in manifests.items()})
    assert located(tmp_path / "arm/urdf", reference, tmp_path) == Path(os.path.realpath(tmp_path / mesh))


def test_the_nearest_place_with_the_file_counts_and_not_a_namesake_without_it(tmp_path: Path):
    write(tmp_path, **{"robot/lab/arm/urdf/robot/a.txt": "", "robot/lab/arm/meshes/m.obj": TETRAHEDRON})
    write(tmp_path, **{"robot/lab/arm/package.xml": MANIFEST.format("robot")})
    place = located(tmp_path / "robot/lab/arm/urdf", "package://robot/meshes/m.obj", tmp_path)
    assert place == Path(os.path.realpath(tmp_path / "robot/lab/arm/meshes/m.obj"))


def test_of_two_packages_of_one_name_the_nearest_counts(tmp_path: Path):
    write(tmp_path, **{"arm/urdf/a.urdf": "", "hand/m.obj": TETRAHEDRON, "arm/hand/m.obj": TETRAHEDRON})
    place = located(tmp_path / "arm/urdf", "package://hand/m.obj", tmp_path)
    assert place == Path(os.path.realpath(tmp_path / "arm/hand/m.obj"))


@pytest.mark.parametrize(("variable", "folder"), [("ROS_PACKAGE_PATH", ""), ("AMENT_PREFIX_PATH", "share")])
def test_the_folders_of_ros_count_where_they_are_allowed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, variable: str, folder: str
):
    write(tmp_path / "ros" / folder, **{"hand/m.obj": TETRAHEDRON})
    write(tmp_path / "arm", **{"a.urdf": ""})
    monkeypatch.setenv(variable, f"/nowhere{os.pathsep}{tmp_path / 'ros'}")
    assert located(tmp_path / "arm", "package://hand/m.obj", tmp_path / "ros") is not None
    assert located(tmp_path / "arm", "package://hand/m.obj") is None
    write(tmp_path / "own", **{"m.obj": TETRAHEDRON})
    (tmp_path / "hand").symlink_to(tmp_path / "own")  # a folder beside that of the robot counts first
    assert str(located(tmp_path / "arm", "package://hand/m.obj", tmp_path)).endswith("own/m.obj")


def test_the_name_in_a_package_xml_of_100_mb_is_read_from_its_beginning(tmp_path: Path):
    write(tmp_path, **{"arm/urdf/a.urdf": "", "x/m.obj": TETRAHEDRON, "x/package.xml": "<package>"})
    with (tmp_path / "x/package.xml").open("r+b") as file:
        file.truncate(100 << 20)
        file.seek(99 << 20)
        file.write(b"<name>hand</name>")
    assert located(tmp_path / "arm/urdf", "package://hand/m.obj", tmp_path) is None


def test_a_link_out_of_the_allowed_folders_is_not_followed(tmp_path: Path):
    write(tmp_path, **{"secret/m.obj": TETRAHEDRON, "home/arm/a.urdf": ""})
    (tmp_path / "home/hand").symlink_to(tmp_path / "secret")
    (tmp_path / "home/arm/m.obj").symlink_to(tmp_path / "secret/m.obj")
    for reference in ("package://hand/m.obj", "m.obj", "package://arm/m.obj", "/x/y/hand/m.obj"):
        assert located(tmp_path / "home/arm", reference, tmp_path / "home") is None, reference


def test_one_message_says_how_many_meshes_are_missing_where_they_were_looked_for_and_what_to_allow(
    tmp_path: Path,
):
    names = [f"m{number}.obj" for number in range(30)]
    write(tmp_path, **{f"arm/meshes/{name}": TETRAHEDRON for name in names})
    shapes = "".join(
        f'<visual><geometry><mesh filename="package://arm/meshes/{name}"/></geometry></visual>'
        for name in names
    )
    write(tmp_path, **{"arm/urdf/arm.urdf": f'<robot name="r"><link name="a">{shapes}</link></robot>'})
    robot, findings = tmp_path / "arm/urdf/arm.urdf", Findings()
    places = Places(robot.parent, suggests=True)
    assert read(robot, "arm.urdf", findings, resolve_mesh=places.resolve) is None
    (finding,) = findings
    assert finding.headline == "the mesh lies outside the folder of the robot"
    assert "and 24 more" in " ".join(finding.notes)
    (folder,) = places.suggested
    assert f"`--allow-path {folder}`" in str(finding.help)
    assert read(robot, "arm.urdf", Findings(), resolve_mesh=mesh_resolver(robot.parent, [folder])) is not None


def test_the_whole_clone_is_to_be_allowed_since_its_other_packages_are_there(tmp_path: Path, monkeypatch):
    write(
        tmp_path,
        **{"clone/arm/meshes/m.obj": TETRAHEDRON, "clone/arm/urdf/arm.urdf": "", "clone/.git/HEAD": ""},
    )
    folder = tmp_path / "clone/arm/urdf"
    place = Places(folder, suggests=True).resolve("package://arm/meshes/m.obj")
    assert isinstance(place, UnusableMesh)
    assert place.allow == tmp_path / "clone"
    monkeypatch.chdir(tmp_path / "clone")
    place = Places(folder, suggests=True).resolve("package://arm/meshes/m.obj")
    assert isinstance(place, UnusableMesh)
    assert place.allow == tmp_path / "clone/arm"


def test_a_file_of_the_same_name_nearby_is_offered_and_not_taken(tmp_path: Path):
    write(tmp_path, **{"robot.urdf": "", "assets/body.stl": TETRAHEDRON})
    place = mesh_resolver(tmp_path)("package://body.stl")
    assert isinstance(place, UnusableMesh)
    assert 'write filename="assets/body.stl"' in str(place.help)


parts = st.sampled_from(["..", ".", "arm", "hand", "secret", "m.obj", "meshes", "", "package.xml", "a b"])
references = st.tuples(
    st.sampled_from(["package://", "model://", "file://", "", "/", "package:///", "C:\\"]),
    st.lists(parts, max_size=6).map("/".join),
).map("".join)


@given(references)
def test_nothing_outside_the_allowed_folders_is_opened_or_listed(reference: str):
    with tempfile.TemporaryDirectory() as name, pytest.MonkeyPatch.context() as patch:
        top = Path(os.path.realpath(name))
        write(
            top,
            **{"package.xml": MANIFEST.format("arm"), "secret/m.obj": TETRAHEDRON, "secret/package.xml": ""},
        )
        write(top, **{"home/arm/m.obj": TETRAHEDRON, "home/arm/package.xml": MANIFEST.format("arm")})
        (top / "home/hand").symlink_to(top / "secret")
        touched: list[Path] = []

        def read_at_most(path: Path, limit: int) -> bytes:
            touched.append(path)
            return path.read_bytes()[:limit]

        def scandir(path: Path) -> object:
            touched.append(path)
            return scan(path)

        scan = os.scandir
        patch.setattr(packages, "read_at_most", read_at_most)
        patch.setattr(os, "scandir", scandir)
        place = located(top / "home/arm", reference, top / "home")
        patch.undo()
        for path in [*touched, *([place] if place is not None else [])]:
            assert Path(os.path.realpath(path)).is_relative_to(top / "home"), path
