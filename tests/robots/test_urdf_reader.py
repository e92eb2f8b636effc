"""The robots that the reader makes of files, and its findings about wrong ones.

Whatever the file holds: findings, and never an exception, a hang or an expanded entity.

The robots that are shipped, and published ones as they are.

A written robot file is read again as the same robot.
"""

from __future__ import annotations

import hashlib
import importlib.util
import math
import os
from pathlib import Path

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from deepbots_cli.compiler.robots import matching_names
from deepbots_cli.diagnostics import Finding, Findings
from deepbots_cli.robots.model import (
    Box,
    Capsule,
    Cylinder,
    Friction,
    Geometry,
    Inertial,
    Joint,
    Limit,
    Link,
    Mimic,
    Pose,
    RobotModel,
    Sphere,
    homogeneous_inertial,
    to_urdf,
)
from deepbots_cli.robots.packages import mesh_resolver
from deepbots_cli.robots.reader import RobotFile, read, read_bytes
from tests.golden.cases import mistakes

INERTIAL = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial>'
ARM = f"""<?xml version="1.0"?>
<robot name="arm">
  <material name="red"><color rgba="1 0 0 1"/></material>
  <link name="base">
    {INERTIAL}
    <visual><geometry><box size="1 2 3"/></geometry><material name="red"/></visual>
  </link>
  <link name="hand">
    {INERTIAL}
    <collision><origin xyz="0 0 0.5" rpy="0.1 0 0"/><geometry><cylinder radius="0.1" length="2"/></geometry></collision>
    <contact><lateral_friction value="0.7"/></contact>
  </link>
  <joint name="elbow" type="revolute">
    <parent link="base"/>
    <child link="hand"/>
    <origin xyz="1 0 0"/>
    <axis xyz="0 3 4"/>
    <limit lower="-1" upper="2" effort="5" velocity="0"/>
    <dynamics damping="0.1" friction="0.2"/>
  </joint>
</robot>
"""


def single(findings: list[Finding]) -> Finding:
    assert len(findings) == 1, [f.headline for f in findings]
    return findings[0]


def test_a_sound_robot_is_read_without_a_word(read_text):
    robot, findings = read_text(ARM)
    assert findings == []
    assert robot is not None
    model = robot.model
    assert (model.name, model.root) == ("arm", "base")
    assert model.link("base").visuals[0].shape == Box((1.0, 2.0, 3.0))
    assert model.link("base").visuals[0].color == (1.0, 0.0, 0.0, 1.0)
    assert model.link("hand").collisions[0].shape == Cylinder(0.1, 2.0)
    assert model.link("hand").collisions[0].origin == Pose((0.0, 0.0, 0.5), (0.1, 0.0, 0.0))
    assert model.link("hand").friction == Friction(lateral=0.7)
    elbow = model.joint("elbow")
    assert (elbow.axis, elbow.damping, elbow.friction) == (pytest.approx((0, 0.6, 0.8)), 0.1, 0.2)


def test_an_axis_that_was_rounded_when_it_was_written_has_the_length_1(read_text):
    """PyBullet prints a warning for another one."""
    robot, _ = read_text(ARM.replace('"0 3 4"', '"4.80973e-07 -0.999999999999 1.207713e-06"'))
    assert abs(math.hypot(*robot.model.joint("elbow").axis) - 1) < 3e-16


def test_a_velocity_or_effort_of_zero_means_that_none_is_stated(read_text):
    robot, _ = read_text(ARM)
    assert robot.model.joint("elbow").limit == Limit(-1.0, 2.0, None, 5.0)


def test_links_and_joints_know_where_they_are_named(read_text):
    robot, _ = read_text(ARM)
    assert (robot.link_spans["hand"].text, robot.link_spans["hand"].start_position) == ("hand", (8, 15))
    assert robot.joint_spans["elbow"].location == "robot.urdf:13:16"


def test_the_digest_is_that_of_the_file(tmp_path: Path):
    path = tmp_path / "arm.urdf"
    path.write_bytes(ARM.encode())
    robot = read(path, "arm.urdf", Findings())
    assert robot is not None
    assert robot.digest == hashlib.sha256(ARM.encode()).hexdigest()


def test_columns_count_characters_and_not_bytes(read_text):
    text = ARM.replace('<axis xyz="0 3 4"/>', '<!-- äöü → 🤖 --><axis xyz="0 3 x"/>').replace(
        'name="arm"', 'name="ärm"'
    )
    _, findings = read_text(text)
    finding = single(findings)
    assert finding.span.text == "0 3 x"
    assert finding.span.start_position.column == 1 + text.splitlines()[
        finding.span.start_position.line - 1
    ].index("0 3 x")


def test_an_attribute_is_found_even_if_another_value_looks_like_it(read_text):
    _, findings = read_text(
        ARM.replace('<axis xyz="0 3 4"/>', "<axis note='a xyz=\"1\" >' \n xyz = '1 2 bad'/>")
    )
    assert single(findings).span.text == "1 2 bad"


def broken(old: str, new: str, text: str = ARM) -> str:
    assert old in text
    return text.replace(old, new, 1)


@pytest.mark.parametrize("mistake", mistakes("robot"), ids=lambda row: row[0])
def test_an_error_is_reported_once_and_at_its_place(read_text, mistake):
    case, changes, headline, place = mistake
    text = changes if isinstance(changes, str) else ARM
    for old, new in () if isinstance(changes, str) else changes:
        text = broken(old, new, text)
    robot, findings = read_text(text)
    assert robot is None
    first = findings[0]
    assert first.severity == "error"
    assert headline in first.headline
    if place is not None:
        assert first.span.text.startswith(place)
    if case not in ("line break in a name",):
        single(findings)


@pytest.mark.parametrize("oddity", mistakes("odd_robot"), ids=lambda row: row[0])
def test_what_pybullet_reads_with_certainty_is_read_with_a_warning_at_its_place(read_text, oddity):
    _, ((old, new),), headline, place, position = oddity
    robot, findings = read_text(broken(old, new))
    finding = single(findings)
    assert (finding.code, finding.headline) == ("DB311", headline)
    assert (finding.span.text, finding.span.start_position) == (place, tuple(position))
    assert robot.model == read_text(ARM)[0].model


def test_a_ball_joint_is_read_as_three_hinges_with_a_warning_at_its_type(read_text):
    robot, findings = read_text(broken('"revolute"', '"spherical"'))
    finding = single(findings)
    assert finding.code == "DB311"
    assert (
        finding.headline
        == "deepbots models ball joint 'elbow' as three hinges at the same point: elbow_x, elbow_y, elbow_z"
    )
    assert finding.span.location == "robot.urdf:13:29"
    hinges = [robot.model.joint(f"elbow_{axis}") for axis in "xyz"]
    assert [hinge.axis for hinge in hinges] == [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)]
    assert [(hinge.parent, hinge.child) for hinge in hinges] == [
        ("base", "elbow_x"),
        ("elbow_x", "elbow_y"),
        ("elbow_y", "hand"),
    ]
    assert [hinge.origin for hinge in hinges] == [
        read_text(ARM)[0].model.joint("elbow").origin,
        Pose(),
        Pose(),
    ]


def test_blank_lines_before_the_declaration_shift_no_place(read_text):
    text = "\n \n" + ARM.replace('name="arm"', 'name="ärm"').replace('xyz="0 3 4"', 'xyz="0 3 x"')
    _, findings = read_text(text)
    assert [finding.span.location for finding in findings if finding.severity == "error"] == [
        "robot.urdf:19:16"
    ]
    robot, _ = read_text(text.replace("0 3 x", "0 3 4"))
    assert robot.link_spans["hand"].start_position == (10, 15)


def test_all_errors_of_a_file_are_found_at_once(read_text):
    text = (
        broken('damping="0.1"', 'damping="x"')
        .replace('size="1 2 3"', 'size="0 1 1"')
        .replace('mass value="1"', 'mass value="-2"')
    )
    text = text.replace("</robot>", '<link name="free"/></robot>')
    _, findings = read_text(text)
    assert len(findings) == 5  # both links had the mass


def test_a_duplicate_shows_the_first_place(read_text):
    _, findings = read_text(
        ARM.replace(
            "</robot>",
            '<joint name="elbow" type="fixed"><parent link="base"/><child link="hand"/></joint></robot>',
        )
    )
    label = findings[0].labels[0]
    assert (label.text, label.span.start_position) == ("first defined here", (13, 16))


def test_two_parents_and_a_circle_are_named(read_text):
    links = "".join(f'<link name="{name}">{INERTIAL}</link>' for name in "abcd")

    def joint(name: str, parent: str, child: str) -> str:
        return (
            f'<joint name="{name}" type="continuous"><parent link="{parent}"/><child link="{child}"/></joint>'
        )

    _, findings = read_text(
        f'<robot name="r">{links}{joint("1", "a", "b")}{joint("2", "a", "c")}{joint("3", "b", "c")}{joint("4", "a", "d")}</robot>'
    )
    assert single(findings).headline == "link 'c' has two parents, 'a' and 'b'"
    _, findings = read_text(
        f'<robot name="r">{links}{joint("1", "a", "b")}{joint("2", "d", "c")}{joint("3", "c", "d")}</robot>'
    )
    assert single(findings).headline == "these links form a closed loop: 'c', 'd'"


def warning(read_text, text: str) -> Finding:
    robot, findings = read_text(text)
    assert robot is not None
    finding = single(findings)
    assert finding.severity == "warning"
    return finding


@pytest.mark.parametrize(("changes", "code", "place", "headline", "help"), mistakes("robot_warning"))
def test_a_warning_is_at_its_place_and_says_what_to_write(read_text, changes, code, place, headline, help):
    text = ARM
    for old, new in changes:
        text = broken(old, new, text)
    finding = warning(read_text, text)
    assert (finding.code, finding.span.text) == (code, place)
    assert headline in finding.headline
    assert help in (finding.help or "")


PASSED_OVER = {
    "a tool": '<link name="tool0"/><joint name="tool" type="fixed"><parent link="hand"/><child link="tool0"/></joint>',
    "the world": '<link name="world"/><joint name="weld" type="fixed"><parent link="world"/><child link="base"/></joint>',
    "other programs": '<gazebo reference="hand"><mu1>0.2</mu1></gazebo><transmission name="t"><joint name="elbow"/></transmission>',
}


@pytest.mark.parametrize("part", PASSED_OVER)
def test_frames_without_shapes_and_what_belongs_to_other_programs_have_no_finding(read_text, part):
    robot, findings = read_text(broken("</robot>", f"{PASSED_OVER[part]}</robot>"))
    assert robot is not None
    assert findings == []


def test_links_without_inertia_that_do_not_move_share_one_warning(read_text):
    shape = "<collision><geometry><sphere radius='0.1'/></geometry></collision>"
    frames = "".join(
        f'<link name="f{i}">{shape}</link><joint name="to_f{i}" type="fixed"><parent link="hand"/><child'
        f' link="f{i}"/></joint>'
        for i in range(3)
    )
    finding = warning(read_text, broken("</robot>", frames + "</robot>"))
    assert (finding.code, finding.notes) == ("DB305", ("they are: f0, f1, f2",))


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_a_joint_that_slides_is_not_advised_to_turn_without_limits(read_text, kind):
    finding = warning(read_text, broken('"-1" upper="2"', '"2" upper="-1"').replace("revolute", kind))
    assert ("continuous" in finding.help) == (kind == "revolute")


LIMIT = '<limit lower="-1" upper="2" effort="5" velocity="0"/>'


@pytest.mark.parametrize(
    ("kind", "limit", "codes", "expected"),
    [
        ("revolute", "", ["DB307"], Limit()),
        ("revolute", '<limit effort="5" velocity="1"/>', ["DB307"], Limit(None, None, 1.0, 5.0)),
        ("revolute", '<limit lower="2" upper="-1" effort="5"/>', ["DB307"], Limit(effort=5.0)),
        ("revolute", '<limit upper="2" effort="5"/>', [], Limit(0.0, 2.0, effort=5.0)),
        ("continuous", '<limit lower="0" upper="0" effort="5"/>', [], Limit(effort=5.0)),
        ("continuous", '<limit lower="1" upper="-1" effort="5"/>', [], Limit(effort=5.0)),
        ("continuous", '<limit lower="-1e16" upper="1e16" effort="5"/>', [], Limit(effort=5.0)),
        ("continuous", '<limit effort="5"/>', [], Limit(effort=5.0)),
        ("continuous", LIMIT, ["DB307"], Limit(effort=5.0)),
        ("continuous", '<limit lower="-1e300" upper="2" effort="5"/>', [], Limit(effort=5.0)),
        ("continuous", '<limit lower="-1" upper="inf" effort="5"/>', [], Limit(effort=5.0)),
    ],
)
def test_a_joint_has_the_limits_that_its_file_states_or_none(read_text, kind, limit, codes, expected):
    robot, findings = read_text(broken(LIMIT, limit).replace("revolute", kind))
    assert ([finding.code for finding in findings], robot.model.joint("elbow").limit) == (codes, expected)


def test_a_color_inside_a_visual_is_one_warning_and_not_one_more_in_the_same_line(read_text):
    own = '<material name="x"><color rgba="0 200 0 1"/></material>'
    assert warning(read_text, broken('<material name="red"/>', own)).notes == ()


def follower(mimic: str, limit: str = "", kind: str = "prismatic") -> str:
    """The arm with a joint `j` that follows."""
    text = f"""<link name="b">{INERTIAL}</link>
<joint name="j" type="{kind}"><parent link="hand"/><child link="b"/><limit {limit}/>{mimic}</joint>"""
    return broken("</robot>", text + "</robot>")


def test_a_chain_of_mimic_joints_follows_the_joint_at_its_end(read_text):
    text = follower('<mimic joint="elbow" multiplier="2" offset="0.5"/>', 'lower="-9" upper="9"').replace(
        "</robot>",
        f'<link name="c">{INERTIAL}</link><joint name="k" type="continuous"><parent link="b"/><child'
        ' link="c"/>'
        '<mimic joint="j" multiplier="-3" offset="1"/></joint></robot>',
    )
    robot, findings = read_text(text)
    assert findings == []
    assert robot.model.followers == {"j": Mimic("elbow", 2.0, 0.5), "k": Mimic("elbow", -6.0, -0.5)}


def test_a_joint_still_follows_one_that_follows_an_unknown_joint(read_text):
    text = follower('<mimic joint="elbow" multiplier="2"/>').replace(
        'name="elbow" type="revolute">', 'name="elbow" type="revolute"><mimic joint="nowhere"/>'
    )
    assert read_text(text)[0].model.followers == {"j": Mimic("elbow", 2.0)}


@pytest.mark.parametrize(
    ("mimic", "headline", "place"),
    [
        ('<mimic joint="j"/>', "these joints follow each other in a circle: 'j'", "j"),
        ('<mimic joint="elbow" multiplier="nan"/>', "'nan' is not a finite number", "nan"),
        ('<mimic joint="elbow" offset="inf"/>', "'inf' is not a finite number", "inf"),
        ('<mimic joint="elbow" multiplier="1e30"/>', "'multiplier' is larger than 1e+18", "1e30"),
        ("<mimic/>", "<mimic> without the attribute 'joint'", "<mimic/>"),
        ('<mimic joint="bolt"/>', "joint 'j' follows 'bolt', which is fixed", "bolt"),
    ],
)
def test_a_bad_mimic_is_one_error_at_its_place(read_text, mimic, headline, place):
    bolt = '<link name="end"/><joint name="bolt" type="fixed"><parent link="hand"/><child link="end"/></joint></robot>'
    robot, findings = read_text(follower(mimic, 'lower="-0.1" upper="0.1"').replace("</robot>", bolt))
    finding = single(findings)
    assert (robot, finding.code, finding.headline, finding.span.text) == (None, "DB301", headline, place)


def test_a_follower_whose_limits_stop_its_leader_is_a_warning(read_text):
    assert (
        read_text(follower('<mimic joint="elbow" multiplier="-0.1"/>', 'lower="-0.2" upper="0.1"'))[1] == []
    )
    finding = warning(read_text, follower('<mimic joint="elbow"/>', 'lower="-0.1" upper="0.1"'))
    assert finding.headline == "joint 'j' reaches its limit before 'elbow' does, and then blocks 'elbow'"
    assert finding.help == 'set lower="-1" upper="2" (m) in the <limit> of \'j\''


LAUGHS = (
    b'<?xml version="1.0"?><!DOCTYPE robot [<!ENTITY a "ha">'
    + b"".join(b'<!ENTITY a%d "%s">' % (i, b"&a%d;" % (i - 1) * 10 if i else b"&a;") for i in range(20))
    + b']><robot name="&a19;"/>'
)


HOSTILE = {
    "billion laughs": (LAUGHS, "a DOCTYPE is not allowed"),
    "external entity": (b'<!DOCTYPE r SYSTEM "file:///etc/passwd"><robot/>', "a DOCTYPE is not allowed"),
    "unknown entity": (b'<robot name="&lol;"/>', "undefined entity"),
    "deep": (b"<robot>" + b"<a>" * 100_000, "nested more than 64 deep"),
    "many": (b"<robot>" + b"<a/>" * 200_000 + b"</robot>", "more than 100000 elements"),
    "many links": (
        b"<robot>" + b"".join(b'<link name="%d"/>' % i for i in range(5000)) + b"</robot>",
        "more than 1000 links",
    ),
    "large": (b"<robot>" + b" " * 5_000_000 + b"</robot>", "larger than 4 MiB"),
    "empty": (b"", "the file is empty"),
    "blank": (b" \n\t", "the file is empty"),
    "binary": (bytes(range(256)), "not UTF-8"),
    "zeros": (b"\0" * 1000, "this is not XML"),
    "zero in the middle": (b'<robot><link name="a"/>\0</robot>', "this is not XML: not well-formed"),
    "a second document": (
        b'<robot><link name="a"/></robot><robot/>',
        "this is not XML: junk after document element",
    ),
    "a second document behind a zero": (b'<robot><link name="a"/></robot>\0<robot/>', "this is not XML"),
    "DOCTYPE behind blanks": (b'\n<?xml version="1.0"?><!DOCTYPE robot><robot/>', "a DOCTYPE is not allowed"),
    "only a declaration and zeros": (b'\n<?xml version="1.0"?>\0', "this is not XML"),
    "many commas": (
        b'<robot><link name="a"><visual><origin xyz="' + b"1, " * 300_000 + b'"/></visual></link></robot>',
        "<geometry>",
    ),
    "utf-16": ("<robot/>".encode("utf-16"), "not UTF-8"),
    "brackets": (b"<" * 100_000, "this is not XML"),
    "open tag": (b'<robot name="' + b"x" * 1_000_000, "this is not XML"),
    "long name": (
        b'<robot><link name="' + b"x" * 1_000_000 + b'"/></robot>',
        "is longer than 200 characters",
    ),
    "long tag": (b"<robot><" + b"l" * 1_000_000 + b"/></robot>", "the robot has no links"),
    "many wrong words": (
        b"<robot>" + b"".join(b"<lin%d/>" % i for i in range(50_000)) + b"</robot>",
        "the robot has no links",
    ),
    "many digits": (
        b'<robot><link name="a"><visual><origin xyz="' + b"9" * 1_000_000 + b'"/></visual></link></robot>',
        "<geometry>",
    ),
    "many attributes": (
        b"<robot " + b" ".join(b'a%d="1"' % i for i in range(50_000)) + b"/>",
        "the robot has no links",
    ),
}


@pytest.mark.parametrize("case", HOSTILE)
@pytest.mark.timeout(60)
def test_a_hostile_file_is_refused_in_time(read_text, case):
    data, expected = HOSTILE[case]
    robot, findings = read_text(data)
    assert robot is None
    assert expected in next(finding.headline for finding in findings if finding.severity == "error")


@pytest.mark.parametrize(
    "text",
    [
        "<joint/>" * 99_000,
        '<link name="a"/><joint name="j">' + '<axis xyz="1 0 0"/>' * 99_000 + "</joint>",
    ],
    ids=["joints", "axes"],
)
def test_of_a_hundred_thousand_findings_only_some_are_reported(read_text, text):
    robot, findings = read_text(f"<robot>{text}</robot>")
    assert robot is None
    assert 0 < len(findings) <= 110


def test_a_long_chain_of_joints_needs_no_recursion(read_text):
    links = "".join(f'<link name="l{i}"/>' for i in range(1000))
    joints = "".join(
        f'<joint name="j{i}" type="fixed"><parent link="l{i}"/><child link="l{i + 1}"/></joint>'
        for i in range(999)
    )
    assert read_text(f"<robot>{links}{joints}</robot>")[0].model.root == "l0"


def test_missing_files_folders_and_pipes_are_findings(tmp_path: Path):
    os.mkfifo(tmp_path / "pipe.urdf")
    for name, expected in (
        ("none.urdf", "does not exist"),
        (".", "not a regular file"),
        ("pipe.urdf", "not a regular file"),
        ("a\0b", "not exist"),
    ):
        findings = Findings()
        assert read(tmp_path / name, name, findings) is None
        assert expected in findings.errors[0].headline


SHIPPED = Path(__file__).parents[2] / "robots/urdf"


def shipped_robot(name: str) -> RobotFile:
    findings = Findings()
    robot = read(SHIPPED / name, name, findings)
    assert list(findings) == []
    assert robot is not None
    return robot


def moments(link, shape, origin):
    """The moments of the file, and those of the closed form."""
    inertial = link.inertial
    expected = homogeneous_inertial(shape, link.inertial.mass, origin)
    return [inertial.ixx, inertial.iyy, inertial.izz], pytest.approx(
        [expected.ixx, expected.iyy, expected.izz], rel=1e-9
    )


@pytest.mark.parametrize("path", sorted(SHIPPED.glob("*.urdf")), ids=lambda path: path.stem)
def test_a_shipped_robot_is_silent_and_survives_the_round_trip(path: Path):
    robot = shipped_robot(path.name)
    again = read_bytes(to_urdf(robot.model).encode(), "x", Findings(), resolve_mesh=Path)
    assert again is not None
    assert again.model == robot.model


def test_the_cart_of_the_paper_weighs_and_resists_turning_as_its_shapes_do():
    model = shipped_robot("cartpole.urdf").model
    assert sum(link.inertial.mass for link in model.links) == pytest.approx(2 + 4 * 0.1005 + 0.2 + 0.02)
    for name in ("body", "pole", "tip"):
        link = model.link(name)
        actual, expected = moments(link, link.visuals[0].shape, link.visuals[0].origin)
        assert (actual, link.inertial.origin) == (expected, link.visuals[0].origin)
    for name in matching_names((link.name for link in model.links), "wheel_*"):
        link = model.link(name)
        (across, along, third), expected = moments(link, link.visuals[0].shape, link.visuals[0].origin)
        assert [across, third, along] == expected  # the cylinder lies along y
    assert isinstance(model.link("body").visuals[0].shape, Box)
    assert model.link("tip").visuals[0].shape == Sphere(0.01)


def test_the_cart_stands_on_its_wheels_and_on_nothing_else():
    model = shipped_robot("cartpole.urdf").model
    body = model.link("body").collisions[0]
    assert body.origin.xyz[2] - body.shape.size[2] / 2 > -0.03
    for joint in model.joints[:4]:
        wheel = model.link(joint.child).collisions[0].shape
        assert isinstance(wheel, Cylinder)
        assert (wheel.radius, joint.origin.xyz[2], joint.axis) == (0.04, 0.0, (0.0, 1.0, 0.0))


def test_the_cart_on_a_rail_is_that_of_the_textbooks():
    model = shipped_robot("cartpole_rail.urdf").model
    assert (model.root, [joint.name for joint in model.moving_joints]) == ("rail", ["slider", "hinge"])
    cart, pole = model.link("cart").inertial, model.link("pole").inertial
    assert (cart.mass, pole.mass, pole.origin.xyz, pole.iyy) == (
        1.0,
        0.1,
        (0.0, 0.0, 0.5),
        pytest.approx(0.1 * 1.0**2 / 12),
    )
    assert model.joint("slider").limit.effort == 10.0
    assert not any(link.collisions for link in model.links)


REFUSED = {
    "kuka_iiwa/model_for_sdf.urdf": "the mesh does not exist",  # nor does PyBullet load it
    "plane_implicit.urdf": "<geometry> contains no known shape",  # an endless plane
    "random_urdfs/168/168.urdf": "the OBJ file contains a vertex that is not finite",
    "torus_deform.urdf": "the robot has no links",  # a soft body; nor does PyBullet load it
    # a file that is not there; nor does PyBullet load it
    "toys/concave_box.urdf": "<geometry> contains no known shape",
}


@pytest.fixture(scope="module")
def library() -> Path:
    spec = importlib.util.find_spec("pybullet_data")
    if spec is None or not spec.submodule_search_locations:
        pytest.skip("pybullet_data is not installed")
    return Path(spec.submodule_search_locations[0])


def published(library: Path, name: str) -> tuple[RobotFile | None, Findings]:
    findings = Findings()
    return read(
        library / name, name, findings, resolve_mesh=mesh_resolver((library / name).parent, [library])
    ), findings


@pytest.mark.slow
def test_of_the_robots_of_pybullet_data_only_these_are_refused(library):
    names = sorted(str(path.relative_to(library)) for path in library.rglob("*.urdf"))
    refused = {}
    for name in names:
        robot, findings = published(library, name)
        if robot is None:
            refused[name] = findings.errors[0].headline
    assert refused == REFUSED
    assert len(names) > 1000


def test_patterns_keep_the_order_of_the_file_and_mind_case():
    names = ("b_1", "a_1", "B_1", "c")
    assert (matching_names(names, "*_1"), matching_names(names, "b_?")) == (("b_1", "a_1", "B_1"), ("b_1",))
    assert (matching_names(names, "[ab]_1"), matching_names(names, "x*")) == (("b_1", "a_1"), ())
    assert matching_names(["a" * 5000], "*a" * 30 + "b") == ()


numbers = st.floats(-1e17, 1e17, allow_nan=False, allow_subnormal=True)
positive = st.floats(1e-300, 1e17)
not_negative = st.just(0.0) | positive
vectors = st.tuples(numbers, numbers, numbers)
poses = st.builds(Pose, vectors, vectors)
colors = st.none() | st.tuples(*[st.floats(0, 1)] * 4)
shapes = (
    st.builds(Box, st.tuples(positive, positive, positive))
    | st.builds(Sphere, positive)
    | st.builds(Cylinder, positive, positive)
    | st.builds(Capsule, positive, positive)
)
inertials = st.builds(
    Inertial, not_negative, poses, not_negative, numbers, numbers, not_negative, numbers, not_negative
)
frictions = st.builds(Friction, *[st.none() | not_negative] * 4)
names = st.text(st.characters(exclude_categories=["C", "Z"]) | st.just(" "), min_size=1, max_size=8).filter(
    str.strip
)
axes = st.sampled_from([(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.6, 0.0, 0.8), (1 / math.sqrt(3),) * 3])
optional = st.none() | positive


@st.composite
def robots(draw: st.DrawFn) -> RobotModel:
    link_names = draw(st.lists(names, min_size=1, max_size=5, unique=True))
    links = tuple(
        Link(
            name,
            draw(st.none() | inertials),
            tuple(draw(st.lists(st.builds(Geometry, shapes, poses, colors), max_size=2))),
            tuple(draw(st.lists(st.builds(Geometry, shapes, poses), max_size=2))),
            draw(frictions),
        )
        for name in link_names
    )
    joint_names = draw(st.lists(names, min_size=len(links) - 1, max_size=len(links) - 1, unique=True))
    joints = []
    for index, name in enumerate(joint_names):
        kind = draw(st.sampled_from(["revolute", "continuous", "prismatic", "fixed", "floating", "planar"]))
        bounds = (
            draw(st.just((None, None)) | st.tuples(numbers, numbers).map(sorted))
            if kind in ("revolute", "prismatic")
            else (None, None)
        )
        joints.append(
            Joint(
                name,
                kind,
                link_names[draw(st.integers(0, index))],
                link_names[index + 1],
                draw(poses),
                (1.0, 0.0, 0.0) if kind in ("fixed", "floating") else draw(axes),
                Limit(bounds[0], bounds[1], draw(optional), draw(optional)),
                draw(not_negative),
                draw(not_negative),
                Mimic(joint_names[0], draw(numbers), draw(numbers))
                if joints and joints[0].moves and draw(st.booleans())
                else None,
            )
        )
    return RobotModel(draw(names).strip(), links, tuple(joints), link_names[0])


@given(robots())
def test_any_robot_survives_writing_and_reading(model: RobotModel):
    # A floating joint below an empty root is a free base, which `to_urdf` never writes.
    assume(not any(joint.type == "floating" and joint.parent == model.root for joint in model.joints))
    findings = Findings()
    robot = read_bytes(
        to_urdf(model).encode(), "x.urdf", findings, resolve_mesh=mesh_resolver(Path("/nowhere"))
    )
    assert robot is not None, [finding.headline for finding in findings]
    assert robot.model == model


def test_writing_is_the_same_every_time_and_in_short_lines():
    robot = read(Path(__file__).parents[2] / "robots/urdf/cartpole.urdf", "cartpole.urdf", Findings())
    assert robot is not None
    assert to_urdf(robot.model) == to_urdf(robot.model)
    assert max(map(len, to_urdf(robot.model).splitlines())) < 200


def test_one_material_name_means_one_color():
    red, blue = (1.0, 0.0, 0.0, 1.0), (0.0, 0.0, 1.0, 1.0)
    visuals = tuple(Geometry(Sphere(1.0), Pose(), color) for color in (red, blue, red))
    text = to_urdf(RobotModel("r", (Link("a", visuals=visuals),), (), "a"))
    assert (text.count('"color_0"'), text.count('"color_1"')) == (2, 1)


@pytest.mark.parametrize("name", ['a"b', "a'b", "a<b>&", "é", "a b"])
def test_names_with_special_characters_are_escaped(read_text, name):
    assert read_text(to_urdf(RobotModel("r", (Link(name),), (), name)))[0].model.root == name
