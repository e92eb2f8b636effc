"""The robots that the reader makes of files, and its findings about wrong ones."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from deepbots_cli.diagnostics import Finding, Findings
from deepbots_cli.robots.model import Box, Cylinder, Friction, Limit, Mimic, Pose
from deepbots_cli.robots.reader import read
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
    assert elbow.axis == pytest.approx((0, 0.6, 0.8))
    assert (elbow.damping, elbow.friction) == (0.1, 0.2)


def test_a_velocity_or_effort_of_zero_means_that_none_is_stated(read_text):
    robot, _ = read_text(ARM)
    assert robot.model.joint("elbow").limit == Limit(-1.0, 2.0, None, 5.0)


def test_links_and_joints_know_where_they_are_named(read_text):
    robot, _ = read_text(ARM)
    assert robot.link_spans["hand"].text == "hand"
    assert robot.link_spans["hand"].start_position == (8, 15)
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
    finding = single(findings)
    assert finding.span.text == "1 2 bad"


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
    assert label.text == "first defined here"
    assert label.span.start_position == (13, 16)


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


def test_unknown_names_suggest_the_nearest(read_text):
    _, findings = read_text(broken('child link="hand"', 'child link="hnd"'))
    assert single(findings).help == "did you mean 'hand'? the links are: base, hand"


def warning(read_text, text: str) -> Finding:
    robot, findings = read_text(text)
    assert robot is not None
    finding = single(findings)
    assert finding.severity == "warning"
    return finding


def test_an_unusual_xml_version_is_a_warning(read_text):
    finding = warning(read_text, broken('version="1.0"', 'version="0.0" '))
    assert (finding.code, finding.span.text) == ("DB311", '<?xml version="0.0" ?>')


def test_what_belongs_to_other_tools_is_passed_over(read_text):
    extra = (
        '<gazebo reference="hand"><mu1>0.2</mu1></gazebo><transmission name="t"><joint'
        ' name="elbow"/></transmission></robot>'
    )
    robot, findings = read_text(broken("</robot>", extra))
    assert robot is not None
    assert findings == []


def test_misspelled_elements_and_attributes_are_warned_about(read_text):
    finding = warning(
        read_text,
        broken(
            '<contact><lateral_friction value="0.7"/></contact>',
            '<contact><lateral_fricton value="0.7"/></contact>',
        ),
    )
    assert (finding.code, finding.help) == ("DB311", "did you mean 'lateral_friction'?")
    finding = warning(read_text, broken('lower="-1"', 'lowr="-1"'))
    assert (finding.headline, finding.span.text) == ("deepbots ignores the attribute 'lowr'", "-1")


def test_a_moving_link_without_inertia_is_warned_about_by_itself(read_text):
    finding = warning(read_text, ARM.replace(f'<link name="hand">\n    {INERTIAL}', '<link name="hand">'))
    assert (finding.code, finding.headline) == ("DB305", "link 'hand' moves but has no <inertial>")


FRAMES = {
    "a tool": '<link name="tool0"/><joint name="tool" type="fixed"><parent link="hand"/><child'
    ' link="tool0"/></joint>',
    "the world": '<link name="world"/><joint name="weld" type="fixed"><parent link="world"/><child'
    ' link="base"/></joint>',
}


@pytest.mark.parametrize("frame", FRAMES)
def test_a_frame_without_any_shape_needs_no_inertia(read_text, frame):
    robot, findings = read_text(broken("</robot>", f"{FRAMES[frame]}</robot>"))
    assert robot is not None
    assert findings == []


def test_links_without_inertia_that_do_not_move_share_one_warning(read_text):
    shape = "<visual><geometry><sphere radius='0.1'/></geometry></visual>"
    frames = "".join(
        f'<link name="f{i}">{shape}</link><joint name="to_f{i}" type="fixed"><parent link="hand"/><child'
        f' link="f{i}"/></joint>'
        for i in range(3)
    )
    finding = warning(read_text, broken("</robot>", frames + "</robot>"))
    assert finding.code == "DB305"
    assert finding.notes == ("they are: f0, f1, f2",)


@pytest.mark.parametrize(
    "moments",
    [
        'ixx="1" iyy="1" izz="2.5"',
        'ixx="0" iyy="0" izz="0"',
        'ixx="1" iyy="1" izz="1" ixy="2"',
        'ixx="1e-9" iyy="1e-9" izz="1e-8"',
    ],
)
def test_an_inertia_that_no_body_can_have_is_warned_about(read_text, moments):
    finding = warning(read_text, broken('ixx="1" iyy="1" izz="1"', moments))
    assert finding.code == "DB306"
    assert finding.span.start_position.line == 5


def test_a_mass_of_zero_is_warned_about(read_text):
    assert warning(read_text, broken('mass value="1"', 'mass value="0"')).headline == "link 'base' has mass 0"


@pytest.mark.parametrize(
    "limit", ["", '<limit effort="5" velocity="1"/>', '<limit lower="2" upper="-1" effort="5" velocity="1"/>']
)
def test_a_joint_without_usable_limits_is_unlimited_and_warned_about(read_text, limit):
    text = broken('<limit lower="-1" upper="2" effort="5" velocity="0"/>', limit)
    assert warning(read_text, text).code == "DB307"
    robot, _ = read_text(text)
    assert (robot.model.joint("elbow").limit.lower, robot.model.joint("elbow").limit.upper) == (None, None)


def test_a_single_bound_leaves_the_other_at_zero_as_urdf_says(read_text):
    robot, findings = read_text(broken('lower="-1" ', ""))
    assert findings == []
    assert robot.model.joint("elbow").limit.lower == 0.0


@pytest.mark.parametrize(
    "limit", ['lower="0" upper="0"', 'lower="1" upper="-1"', 'lower="-1e16" upper="1e16"', ""]
)
def test_limits_of_a_continuous_joint_that_mean_none_are_not_a_fault(read_text, limit):
    _, findings = read_text(broken("revolute", "continuous").replace('lower="-1" upper="2"', limit))
    assert findings == []


@pytest.mark.parametrize(("limit", "place"), [('lower="-1" upper="2"', "-1"), ('upper="2"', "2")])
def test_limits_of_a_continuous_joint_that_have_no_effect_are_warned_about(read_text, limit, place):
    finding = warning(read_text, broken("revolute", "continuous").replace('lower="-1" upper="2"', limit))
    assert (finding.code, finding.span.text) == ("DB307", place)
    assert finding.headline.startswith("joint 'elbow' is continuous, so its limits from ")
    assert finding.help == 'write type="revolute" to limit the joint, or remove lower and upper'


def test_a_continuous_joint_keeps_its_effort_and_has_no_bounds(read_text):
    robot, _ = read_text(broken("revolute", "continuous"))
    assert robot.model.joint("elbow").limit == Limit(effort=5.0)


def test_a_further_element_of_the_same_kind_is_not_read(read_text):
    finding = warning(read_text, broken('<axis xyz="0 3 4"/>', '<axis xyz="0 3 4"/><axis xyz="1 0 0"/>'))
    assert finding.headline == "deepbots ignores a second <axis> in the same <joint>"


def test_a_mimic_joint_is_read(read_text):
    second = f"""<link name="b">{INERTIAL}</link>
<joint name="j" type="continuous"><parent link="hand"/><child link="b"/><mimic joint="elbow" multiplier="-1"/></joint>"""
    robot, findings = read_text(broken("</robot>", second + "</robot>"))
    assert findings == []
    assert robot.model.joint("j").mimic == Mimic("elbow", -1.0, 0.0)


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


BAD_MIMICS = {
    "itself": ('<mimic joint="j"/>', "these joints follow each other in a circle: 'j'", "j"),
    "not a number": ('<mimic joint="elbow" multiplier="nan"/>', "'nan' is not a finite number", "nan"),
    "infinite": ('<mimic joint="elbow" offset="inf"/>', "'inf' is not a finite number", "inf"),
    "too large": ('<mimic joint="elbow" multiplier="1e30"/>', "'multiplier' is larger than 1e+18", "1e30"),
    "no joint": ("<mimic/>", "<mimic> without the attribute 'joint'", "<mimic/>"),
}


@pytest.mark.parametrize("case", BAD_MIMICS)
def test_a_bad_mimic_is_one_error_at_its_place(read_text, case):
    mimic, headline, place = BAD_MIMICS[case]
    robot, findings = read_text(follower(mimic, 'lower="-0.1" upper="0.1"'))
    assert robot is None
    finding = single(findings)
    assert (finding.code, finding.headline, finding.span.text) == ("DB301", headline, place)


def test_a_mimic_of_a_fixed_joint_is_an_error(read_text):
    text = follower('<mimic joint="elbow"/>', 'lower="-9" upper="9"').replace(
        'name="elbow" type="revolute"', 'name="elbow" type="fixed"'
    )
    finding = single(read_text(text)[1])
    assert (finding.code, finding.headline) == ("DB301", "joint 'j' follows 'elbow', which is fixed")


def test_a_fixed_joint_follows_nothing(read_text):
    finding = warning(read_text, follower('<mimic joint="elbow"/>', kind="fixed"))
    assert finding.headline == "joint 'j' is fixed, so it follows nothing"


def test_a_follower_whose_limits_stop_its_leader_is_a_warning(read_text):
    assert (
        read_text(follower('<mimic joint="elbow" multiplier="-0.1"/>', 'lower="-0.2" upper="0.1"'))[1] == []
    )
    finding = warning(read_text, follower('<mimic joint="elbow"/>', 'lower="-0.1" upper="0.1"'))
    assert finding.headline == "joint 'j' reaches its limit before 'elbow' does, and then blocks 'elbow'"
    assert finding.help == 'set lower="-1" upper="2" (m) in the <limit> of \'j\''


def test_an_unexpanded_default_of_xacro_is_read_with_a_warning(read_text):
    finding = warning(read_text, broken('<origin xyz="1 0 0"/>', '<origin xyz="$(optenv WHERE 0.5 0 1)"/>'))
    assert finding.help == "expand it with xacro; until then deepbots uses its default, 0.5 0 1"
