"""A xacro file is the robot that ROS' own tool makes of it; what it cannot be is one finding at its place,
and no file runs code, reads outside, or takes long."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from deepbots_cli import api
from deepbots_cli.diagnostics import Finding, Findings, Source
from deepbots_cli.robots.elements import Element, parse
from deepbots_cli.robots.model import to_urdf
from deepbots_cli.robots.packages import mesh_resolver
from deepbots_cli.robots.reader import RobotFile, read
from deepbots_cli.robots.xacro import expand
from deepbots_cli.robots.xacro_expressions import Budget, Evaluator, XacroError
from tests.robots.meshes import block

NAMESPACE = 'xmlns:xacro="http://www.ros.org/wiki/xacro"'
LINK = """<link name="{name}"><inertial><mass value="1"/>
  <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
  <collision><geometry><box size="{size}"/></geometry></collision></link>"""
WHEEL = f"""<robot {NAMESPACE}><xacro:macro name="wheel" params="prefix">
  {LINK.format(name="${prefix}_wheel", size="0.1 0.02 0.1")}
  <joint name="${{prefix}}_axle" type="continuous"><parent link="base"/><child link="${{prefix}}_wheel"/>
  <axis xyz="0 1 0"/><limit effort="1" velocity="9"/></joint></xacro:macro></robot>"""


def robot(body: str, name: str = "r") -> str:
    return f'<robot name="{name}" {NAMESPACE}>{body}</robot>'


def expansion(
    text: str, folder: Path, arguments: Mapping[str, str] | None = None
) -> tuple[Element | None, list[Finding]]:
    """Return the expanded robot, or None, and the findings."""
    findings = Findings()
    root = parse(Source("robot.xacro", text), findings)
    assert root is not None, list(findings)
    expanded = expand(root, mesh_resolver(folder), arguments or {}, findings)
    return expanded and expanded.root, list(findings)


def names(
    text: str, folder: Path = Path("/nowhere"), arguments: Mapping[str, str] | None = None
) -> list[str]:
    """Return the names of the links of an expanded robot."""
    expanded, findings = expansion(robot(text), folder, arguments)
    assert findings == []
    assert expanded is not None
    return [link.attributes["name"] for link in expanded.find_all("link")]


def refusal(
    text: str, folder: Path = Path("/nowhere"), arguments: Mapping[str, str] | None = None
) -> Finding:
    """Return the only finding about a robot that cannot be expanded."""
    expanded, findings = expansion(robot(text), folder, arguments)
    assert expanded is None
    assert len(findings) == 1, findings
    return findings[0]


def value(expression: str, definitions: str = "") -> str:
    return names(f'{definitions}<link name="{expression}"/>')[0]


# Files that people have


def read_file(path: Path, **arguments: str) -> tuple[RobotFile | None, list[Finding]]:
    findings = Findings()
    return read(path, path.name, findings, arguments=arguments), list(findings)


def test_a_property_that_is_defined_below_its_use_is_to_be_moved_above_it(tmp_path):
    (tmp_path / "r.urdf").write_text(
        robot(LINK.format(name="base", size="${w} ${2 * w} ${w}") + '<xacro:property name="w" value="0.1"/>')
    )
    # ROS reads from top to bottom, too
    file, findings = read_file(tmp_path / "r.urdf")
    assert file is None
    assert findings[0].headline == "there is no property or function 'w'"
    assert [label.text for label in findings[0].labels] == ["defined here: move it above its first use"]
    (tmp_path / "r.urdf").write_text(
        robot('<xacro:property name="w" value="0.1"/>' + LINK.format(name="base", size="${w} ${2 * w} ${w}"))
    )
    file, findings = read_file(tmp_path / "r.urdf")
    assert findings == []
    assert file is not None
    assert file.model.links[0].collisions[0].shape.size == (0.1, 0.2, 0.1)


def test_a_robot_of_an_included_macro_has_its_wheel(tmp_path):
    (tmp_path / "parts.xacro").write_text(WHEEL)
    body = LINK.format(name="base", size="0.1 0.1 0.1") + '<xacro:wheel prefix="left"/>'
    (tmp_path / "r.urdf").write_text(robot(f'<xacro:include filename="parts.xacro"/>{body}'))
    file, findings = read_file(tmp_path / "r.urdf")
    assert findings == []
    assert file is not None
    assert [joint.name for joint in file.model.joints] == ["left_axle"]


def test_a_missing_include_is_named_at_its_place(tmp_path):
    finding = refusal('<xacro:include filename="parts.xacro"/>', tmp_path)
    assert finding.headline == "the file 'parts.xacro' cannot be read"
    assert finding.span.text == "parts.xacro"


def test_a_missing_argument_names_the_option(tmp_path):
    finding = refusal('<link name="$(arg side)"/>')
    assert finding.headline == "the argument 'side' has no value"
    assert "--xacro-arg side:=VALUE" in str(finding.help)
    assert names('<link name="$(arg side)"/>', arguments={"side": "left"}) == ["left"]


def test_a_finding_about_a_part_of_an_included_file_stands_in_that_file(tmp_path):
    (tmp_path / "parts.xacro").write_text(WHEEL.replace('value="1"', 'value="-1"'))
    text = f'<xacro:include filename="parts.xacro"/>{LINK.format(name="base", size="1 1 1")}<xacro:wheel prefix="a"/>'
    (tmp_path / "r.xacro").write_text(robot(text))
    file, findings = read_file(tmp_path / "r.xacro")
    assert file is None
    assert [Path(finding.span.source.name).name for finding in findings] == ["parts.xacro"]
    assert findings[0].span.text == "-1"


def test_a_plain_file_is_read_as_it_is(tmp_path):
    text = robot(LINK.format(name="base", size="1 1 1"))
    (tmp_path / "r.urdf").write_text(text)
    file, _ = read_file(tmp_path / "r.urdf")
    assert file is not None
    assert file.xacro is None
    assert file.source.text == text


# Constructs

PROPERTIES = """<xacro:property name="a" value="2"/><xacro:property name="b" value="${a * 1.5}"/>
  <xacro:property name="t" value="left_"/><xacro:property name="n" value="'0'"/>
  <xacro:property name="list" value="${[1, [2, 3]]}"/><xacro:property name="map" value="${dict(x=1, y=dict(z=2))}"/>"""


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("${a}", "2"),
        ("${b}", "3.0"),
        ("${a / 4}", "0.5"),
        ("${a ** 3 - -1}", "9"),
        ("${7 // a} ${7 % a}", "3 1"),
        ("x${t}y", "xleft_y"),
        ("${t + 'wheel'}", "left_wheel"),
        ("$${a} $$(arg x)", "${a} $(arg x)"),
        ("costs 3 $ and $a", "costs 3 $ and $a"),
        ("${1 if a == 2 and not b > 4 else 0}", "1"),
        ("${0 &lt; a &lt;= 2 or c}", "True"),
        ("${'f' in t} ${'z' not in t}", "True True"),
        ("${list[1][0]} ${list[-1][1:]}", "2 [3]"),
        ("${map['y']['z']} ${map.x}", "2 1"),
        ("${pi / 2}", "1.5707963267948966"),
        ("${math.sin(radians(90))} ${sqrt(16)}", "1.0 4.0"),
        ("${max(1, a)} ${abs(-3)} ${len(t)} ${int('7') + float('0.5')} ${round(2.567, 1)}", "2 3 5 7.5 2.6"),
        ("${t.upper()} ${t.strip('_')} ${'a b'.split()[1]}", "LEFT_ left b"),
        ("${python.range(3)} ${sum(range(4))} ${python.isinstance(a, int)}", "[0, 1, 2] 6 True"),
        ("${'%0.2f' % a} ${round(5, -10**9)}", "2.00 0"),
        ("${None} ${True} ${(1, 2)}", "None True (1, 2)"),
        ("$(optenv WHERE 0 0 1)", "0 0 1"),
        ("$(eval 1 + 2)", "3"),
        ("$(dirname)/x", "./x"),
        ("file://$(find my_robot)/a.stl", "package://my_robot/a.stl"),
    ],
)
def test_an_expression_has_the_value_of_ros(expression, expected):
    assert value(expression, PROPERTIES) == expected


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        ('<xacro:if value="${1 == 1}"><link name="a"/></xacro:if>', ["a"]),
        ('<xacro:unless value="false"><link name="a"/></xacro:unless>', ["a"]),
        ('<xacro:if value="$(arg on)"><link name="a"/></xacro:if><link name="b"/>', ["b"]),
        ('<xacro:property name="p" default="x"/><xacro:property name="p" default="y"/><link name="${p}"/>', ["x"]),
        ('<xacro:property name="p" value="1"/><xacro:property name="q" value="${p}"/><xacro:property name="p"'
         ' value="2"/><link name="${q}"/>', ["2"]),
        ('<xacro:property name="p" value="1"/><xacro:property name="p" remove="true"/><xacro:property name="p"'
         ' default="2"/><link name="${p}"/>', ["2"]),
        ('<xacro:property name="p" value="1"/><xacro:property name="q" value="${p}" lazy_eval="false"/>'
         '<xacro:property name="p" value="2"/><link name="${q}"/>', ["1"]),
        ('<xacro:property name="block"><link name="a"/><link name="b"/></xacro:property>'
         '<xacro:insert_block name="block"/>', ["a", "b"]),
        ('<xacro:macro name="m" params="p q:=2 r:=^|3 s:=\'\'"><link name="${p}${q}${r}${s}"/></xacro:macro>'
         '<xacro:property name="r" value="up"/><xacro:m p="1"/>', ["12up"]),
        ('<xacro:macro name="m" params="p:=^|3"><link name="${p}"/></xacro:macro><xacro:m/><xacro:call macro="m"'
         ' p="4"/>', ["3", "4"]),
        ('<xacro:macro name="m" params="*one **all"><xacro:insert_block name="all"/><xacro:insert_block name="one"/>'
         '</xacro:macro><xacro:m><link name="a"/><x><link name="b"/><link name="c"/></x></xacro:m>', ["b", "c", "a"]),
        ('<xacro:macro name="m"><xacro:property name="p" value="in" scope="parent"/></xacro:macro><xacro:m/>'
         '<link name="${p}"/>', ["in"]),
        ('<xacro:macro name="m"><xacro:macro name="n"><xacro:property name="p" value="top" scope="global"/>'
         '</xacro:macro><xacro:n/></xacro:macro><xacro:m/><link name="${p}"/>', ["top"]),
        ('<xacro:macro name="count" params="n"><link name="l${n}"/><xacro:if value="${n > 0}"><xacro:count n="${n - 1}"/>'
         '</xacro:if></xacro:macro><xacro:count n="2"/>', ["l2", "l1", "l0"]),
        ('<xacro:arg name="on" default="x"/><xacro:arg name="d" default="y"/><link name="$(arg on)$(arg d)"/>',
         ["falsey"]),
        ('<gazebo reference="${1}"><x>${undefined}</x></gazebo><link name="a"/>', ["a"]),
    ],
)  # fmt: skip
def test_a_construct_expands_as_in_ros(body, expected):
    assert names(body, arguments={"on": "false"}) == expected


def test_properties_of_a_namespace_are_read_after_a_dot(tmp_path):
    (tmp_path / "p.xacro").write_text(
        robot('<xacro:property name="w" value="3"/><xacro:macro name="m"><link name="m${w}"/></xacro:macro>')
    )
    body = '<xacro:include filename="p.xacro" ns="part"/><link name="${part.w + 1}"/><xacro:part.m/>'
    assert names(body, tmp_path) == ["4", "m3"]


def test_paths_in_an_included_file_begin_at_that_file(tmp_path):
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "a.xacro").write_text(robot('<xacro:include filename="b.xacro"/>'))
    (tmp_path / "sub" / "b.xacro").write_text(robot('<link name="b"/>'))
    assert names('<xacro:include filename="sub/a.xacro"/>', tmp_path) == ["b"]


def test_values_of_a_yaml_file(tmp_path):
    (tmp_path / "p.yaml").write_text("limits: {elbow: {max: !degrees 90}}\nlist: [1, 2]\n")
    load = '<xacro:property name="p" value="${xacro.load_yaml(\'p.yaml\')}"/>'
    body = f"{load}<link name=\"${{p['limits']['elbow']['max']}} ${{p.list[1]}}\"/>"
    assert names(body, tmp_path) == ["1.5707963267948966 2"]


def test_an_optional_include_may_be_missing(tmp_path):
    urdf, findings = expansion(
        robot('<xacro:include filename="p.xacro" optional="true"/><link name="a"/>'), tmp_path
    )
    assert urdf is not None
    assert [finding.severity for finding in findings] == ["warning"]


CAMERA = '<xacro:include filename="$(find camera)/camera.xacro"/>'


def test_a_robot_without_the_camera_whose_package_is_not_there_is_read(tmp_path):
    macro = '<xacro:macro name="camera_mount" params=""><xacro:camera/></xacro:macro>'
    urdf, (finding,) = expansion(robot(f'{CAMERA}{macro}<link name="a"/>'), tmp_path)
    assert urdf is not None
    assert finding.severity == "warning"
    assert finding.headline == "the file 'package://camera/camera.xacro' cannot be read"
    assert "a package called camera" in str(finding.help)


def test_a_robot_with_the_camera_whose_package_is_not_there_names_the_package_and_not_its_macro(tmp_path):
    finding = refusal(f"{CAMERA}<xacro:camera/>", tmp_path)
    assert finding.headline == "the file 'package://camera/camera.xacro' cannot be read"
    assert [label.text for label in finding.labels] == ["there is no macro 'camera'"]
    (tmp_path / "package.xml").write_text("<package><name>camera</name></package>")
    finding = refusal(CAMERA, tmp_path)
    assert "deepbots looked for camera.xacro; put the file" in str(finding.help)


def test_statements_without_their_prefix_are_read_as_before_ros_noetic(tmp_path):
    (tmp_path / "wheel.xacro").write_text(
        robot(
            '<property name="w" value="front"/><property name="" value="1"/>'
            '<macro name="wheel" params="p"><if value="${p}"><link name="${w}"/></if></macro>'
        )
    )
    urdf, (finding,) = expansion(
        robot('<include filename="wheel.xacro"/><xacro:wheel p="1"/><gazebo><include/></gazebo>'), tmp_path
    )
    assert urdf is not None
    assert [link.attributes["name"] for link in urdf.find_all("link")] == ["front"]
    assert [element.tag for element in urdf.find_all("gazebo")[0].children] == ["include"]
    assert finding.severity == "warning"
    assert "write <xacro:include>" in str(finding.help)


# Findings


@pytest.mark.parametrize(
    ("body", "headline", "place"),
    [
        ('<link name="${widht}"/>', "there is no property or function 'widht'", "${widht}"),
        ('<xacro:property name="a" value="${b}"/><xacro:property name="b" value="${a}"/><link name="${a}"/>',
         "the value of this property refers to itself", "${a}"),
        ('<xacro:weel/>', "there is no macro 'weel'", "<xacro:weel/>"),
        ('<xacro:wheel/>', "the macro 'wheel' needs a value for 'p'", "<xacro:wheel/>"),
        ('<xacro:wheel p="1" q="2"/>', "the macro 'wheel' has no parameter 'q'", "2"),
        ('<xacro:wheel p="1"><link name="a"/></xacro:wheel>', "the macro 'wheel' takes 0 elements, not 1",
         '<xacro:wheel p="1">'),
        ('<xacro:insert_block name="o"/>', "there is no block 'o'", "o"),
        ('<xacro:if value="maybe"/>', "'maybe' is neither true nor false", "maybe"),
        ('<link name="${1 / 0}"/>', "'1 / 0' has no value: division by zero", "${1 / 0}"),
        ('<link name="${1 +}"/>', "'1 +' is not an expression: invalid syntax", "${1 +}"),
        ('<link name="${1"/>', "'${1' has ${ without an end", "${1"),
        ('<link name="${[x for x in [1]]}"/>', "deepbots does not support ListComp (of Python) in an expression",
         "${[x for x in [1]]}"),
        ('<link name="$(env HOME)"/>', "deepbots reads no variables of the environment", "$(env HOME)"),
        ('<link name="$(cwd)"/>', "deepbots does not support $(cwd)", "$(cwd)"),
        ('<xacro:property name="a b" value="1"/>', "'a b' is not a name for a property", "a b"),
        ('<xacro:property value="1"/>', "<xacro:property> without the attribute 'name'",
         '<xacro:property value="1"/>'),
        ('<link name="a"><xacro:attribute name="type" value="b"/></link>',
         "deepbots does not support <xacro:attribute>", '<xacro:attribute name="type" value="b"/>'),
        ('<xacro:include filename="https://example.org/a.xacro"/>',
         "the file 'https://example.org/a.xacro' cannot be read", "https://example.org/a.xacro"),
    ],
)  # fmt: skip
def test_a_mistake_is_one_finding_at_its_place(body, headline, place):
    wheel = '<xacro:property name="width" value="1"/><xacro:macro name="wheel" params="p"/>'
    finding = refusal(wheel + body)
    assert finding.headline == headline
    assert finding.span.text == place


def test_an_unknown_name_is_followed_by_the_nearest():
    finding = refusal('<xacro:property name="width" value="1"/><link name="${widht}"/>')
    assert str(finding.help).startswith("did you mean 'width'?")


def test_a_mistake_in_a_macro_names_the_call():
    finding = refusal('<xacro:macro name="m"><link name="${x}"/></xacro:macro><xacro:m/>')
    assert finding.span.text == "${x}"
    assert [label.span.text for label in finding.labels] == ["<xacro:m/>"]


def test_python_that_is_not_supported_names_the_way_out():
    assert "xacro robot.urdf.xacro > robot.urdf" in str(refusal('<link name="${lambda: 1}"/>').help)


# Hostile files


@pytest.mark.parametrize(
    "expression",
    [
        "__import__('os').system('id')",
        "().__class__.__bases__[0].__subclasses__()",
        "str.__class__",
        "'{0.__class__}'.format(1)",
        "'{0[0]}'.format([1])",
        "map('{0.__class__}'.format, [1])",
        "'{:>999999999}'.format(1)",
        "'{:{}}'.format(1, 9)",
        "'%999999999d' % 1",
        "eval('1')",
        "open('/etc/passwd')",
        "(lambda: 1)()",
        "math.__loader__",
        "xacro.load_yaml.__globals__",
        "f'{1}'",
        "9**9**9",
        "(1 - 2) ** 0.5",
        "'a' * 10**10",
        "[0] * 10**10",
        "range(10**12)",
        "list(map(range, [10**12]))[0][0] + sum(range(10**9))",
        "-" * 1500 + "1",
        "(" * 900 + ")" * 900,
        "1 if " * 300 + "1",
        "{**{}}",
        "[*[1]]",
        "len",
        "1j",
        "x" * 3000,
        "math",
    ],
)
@pytest.mark.timeout(60)
def test_an_expression_runs_no_code_and_ends(expression):
    with pytest.raises(XacroError):
        Evaluator({}, Budget()).value(expression)


LAUGHS = "".join(f'<xacro:property name="a{n + 1}" value="${{a{n}}}${{a{n}}}"/>' for n in range(40))
DOUBLES = "".join(f'<xacro:macro name="m{n + 1}"><xacro:m{n}/><xacro:m{n}/></xacro:macro>' for n in range(40))
LISTS = "".join(f'<xacro:property name="l{n + 1}" value="${{[l{n}, l{n}]}}"/>' for n in range(40))


@pytest.mark.parametrize(
    "body",
    [
        '<xacro:macro name="m"><xacro:m/></xacro:macro><xacro:m/>',
        '<xacro:macro name="m"><link name="a"/><xacro:m/><xacro:m/></xacro:macro><xacro:m/>',
        '<xacro:include filename="loop.xacro"/>',
        f'<xacro:property name="a0" value="laugh"/>{LAUGHS}<link name="${{a40}}"/>',
        f'<xacro:property name="l0" value="${{[1]}}"/>{LISTS}<link name="${{l40}}"/>',
        f'<xacro:macro name="m0"><link name="a"/></xacro:macro>{DOUBLES}<xacro:m40/>',
        f'<xacro:macro name="m0"/>{DOUBLES}<xacro:m40/>',
        '<xacro:property name="p"><xacro:insert_block name="p"/></xacro:property><xacro:insert_block name="p"/>',
        "<link name=\"${xacro.load_yaml('laughs.yaml')}\"/>",
        "<link name=\"${xacro.load_yaml('deep.yaml')}\"/>",
        "<link name=\"${xacro.load_yaml('large.yaml')}\"/>",
        "<link name=\"${xacro.load_yaml('code.yaml')}\"/>",
    ],
)
@pytest.mark.timeout(60)
def test_what_never_ends_or_explodes_ends_in_one_finding(body, tmp_path):
    (tmp_path / "loop.xacro").write_text(robot('<xacro:include filename="loop.xacro"/>'))
    (tmp_path / "laughs.yaml").write_text(
        "a: &a [x, x]\n" + "".join(f"b{n}: &a [*a, *a]\n" for n in range(40))
    )
    (tmp_path / "deep.yaml").write_text("[" * 100_000)
    (tmp_path / "large.yaml").write_text("[" + "1, " * 80_000 + "]")
    (tmp_path / "code.yaml").write_text("!!python/object/apply:os.system [id]")
    assert refusal(body, tmp_path).severity == "error"


def test_a_file_outside_of_the_allowed_folders_is_not_read(tmp_path):
    (tmp_path / "secret.xacro").write_text(robot('<link name="secret"/>'))
    (tmp_path / "secret.yaml").write_text("secret")
    inside = tmp_path / "robot"
    inside.mkdir()
    (inside / "link.xacro").symlink_to(tmp_path / "secret.xacro")
    for body in (
        '<xacro:include filename="../secret.xacro"/>',
        f'<xacro:include filename="{tmp_path}/secret.xacro"/>',
        f'<xacro:include filename="file://{tmp_path}/secret.xacro"/>',
        '<xacro:include filename="link.xacro"/>',
        '<xacro:include filename="$(find x)/../../secret.xacro"/>',
        "<link name=\"${xacro.load_yaml('../secret.yaml')}\"/>",
    ):
        assert "--allow-path" in str(refusal(body, inside).help)
    findings = Findings()
    root = parse(Source("r", robot('<xacro:include filename="../secret.xacro"/>')), findings)
    assert root is not None
    assert expand(root, mesh_resolver(inside, [tmp_path]), {}, findings) is not None


WORD_TEXT = """a list map t 1 2.5 'x' "y" + - * / ** // % ( ) [ ] : , . .upper() .format .split( if else and or not in is
    == < > lambda for None True len str int float range max sum math.pi xacro.load_yaml __class__ $ $(arg x) #
    \\ ; = := @ ! ~ { e9 0x 1_0 j"""
WORDS = st.lists(
    st.sampled_from(WORD_TEXT.split()),
    max_size=12,
).map(" ".join)


@given(st.one_of(st.text(max_size=60), WORDS))
@example("a" * 2500)
@example("'\\ud800'")
@example("'\\x00'")
def test_any_text_in_an_expression_has_a_value_or_is_one_finding(text):
    escaped = "".join(f"&#{ord(c)};" for c in text if c.isprintable() or c in " \t\n")
    expanded, findings = expansion(robot(f'{PROPERTIES}<link name="${{{escaped}}}"/>'), Path("/nowhere"))
    assert len(findings) == (expanded is None)
    if expanded is not None:
        expanded.children[0].attributes["name"].encode()


# Scenarios and runs

SCENARIO = """\
deepbots: 1
name: Two
robots:
  one: {urdf: arm.urdf.xacro, base: fixed, xacro: {side: left, with_mesh: true}, actuators: {m: {type: torque_motor,
    joint: axle}}, apply: {m: push * 0.1 N*m}}
  two: {urdf: arm.urdf.xacro, base: fixed, pose: {x: 2 m}, xacro: {side: right, size: 0.2}}
action: {push: -1 .. 1}
world: {timestep: 16 ms}
augment: {angle: joint_position(one.axle)}
observation: {angle: -180 .. 180 deg}
reward: {still: -abs(angle) / rad}
truncation: {max_steps: 10}
"""


def write_robot(folder: Path) -> None:
    """Write a xacro file with a mesh, an include, and arguments."""
    (folder / "meshes").mkdir()
    (folder / "meshes" / "left block.stl").write_bytes(block("x.stl", (0.1, 0.1, 0.1)))
    (folder / "parts.xacro").write_text(WHEEL.replace("${prefix}_axle", "axle"))
    mesh = '<visual><geometry><mesh filename="meshes/$(arg side) block.stl"/></geometry></visual></link>'
    extra = LINK.format(name="extra", size="1 1 1").replace("</link>", mesh)
    body = [
        '<xacro:arg name="size" default="0.1"/><xacro:arg name="with_mesh" default="false"/>',
        '<xacro:include filename="parts.xacro"/>',
        LINK.format(name="base", size="$(arg size) 0.1 0.1"),
        f'<xacro:wheel prefix="$(arg side)"/><xacro:if value="$(arg with_mesh)">{extra}',
        '<joint name="j" type="fixed"><parent link="base"/><child link="extra"/></joint></xacro:if>',
    ]
    (folder / "arm.urdf.xacro").write_text(robot("".join(body)))


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    write_robot(tmp_path)
    (tmp_path / "two.yaml").write_text(SCENARIO)
    return tmp_path / "two.yaml"


def test_a_run_compiles_to_the_same_robots_from_its_copy_without_the_xacro_file(scenario, tmp_path_factory):
    checked = api.load(scenario)
    assert list(checked.findings) == []
    assert checked.robots is not None
    assert [link.name for link in checked.robots["one"].model.links] == ["base", "left_wheel", "extra"]
    copy = tmp_path_factory.mktemp("copy")
    checked.inputs.write(copy)
    assert not list(copy.rglob("*.xacro"))
    again = api.load(copy / "resolved.yaml")
    assert list(again.findings) == []
    assert again.robots is not None
    for name, robot_of_file in checked.robots.items():
        # the copy of the mesh has another path
        of_file, of_run = (to_urdf(read.model) for read in (robot_of_file, again.robots[name]))
        assert re.sub(r'filename="[^"]*"', "", of_run) == re.sub(r'filename="[^"]*"', "", of_file)


@pytest.mark.parametrize(
    ("old", "new", "headline", "place"),
    [
        ("size: 0.2", "siez: 0.2", "there is no xacro argument `siez`", "siez"),
        ("side: right, ", "", "the argument 'side' has no value", "$(arg side)"),
        ("size: 0.2", "size: [1]", "expected a text, a number, `true` or `false`, found a list", "[1]"),
    ],
)
def test_a_wrong_argument_in_a_scenario_is_one_finding(scenario, old, new, headline, place):
    scenario.write_text(SCENARIO.replace(old, new))
    (finding,) = (finding for finding in api.load(scenario).findings if finding.severity == "error")
    assert finding.headline == headline
    assert finding.span.text == place


@pytest.mark.parametrize(
    "setting",
    [
        "robots.two.xacro.size: 0.3",
        "robots.bare.xacro: {size: 0.3}",
        "robots.bare: {urdf: a, xacro: {size: 0.3}}",
    ],
)
def test_a_case_cannot_change_the_arguments_of_a_robot_which_may_have_none_before(scenario, setting):
    robots = SCENARIO.replace("action:", "  bare: {urdf: cartpole}\naction:")
    scenario.write_text(f"{robots}evaluation: {{cases: {{wide: {{set: {{{setting}}}}}}}}}\n")
    (finding,) = (finding for finding in api.load(scenario).findings if finding.severity == "error")
    assert finding.headline == "a case cannot change `xacro`"


def test_new_writes_the_arguments_and_a_scenario_without_findings(tmp_path, deepbots):
    write_robot(tmp_path)
    deepbots(
        "new", "first", "--urdf", "arm.urdf.xacro", "--xacro-arg", "side:=left", "--xacro-arg", "size=0.20"
    )
    assert 'xacro: {side: left, size: "0.20"}' in (tmp_path / "first.yaml").read_text()
    assert api.lint(tmp_path / "first.yaml") == []


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--xacro-arg", "sid:=left"], "has no xacro argument sid (did you mean side?)"),
        (["--xacro-arg", "side"], "write NAME:=VALUE"),
        (["--xacro-arg", "side:=b"], "gives side twice"),
    ],
)
@pytest.mark.parametrize("command", [["new", "first", "--urdf"], ["inspect"], ["lint"]])
def test_a_wrong_argument_of_a_command_is_named(tmp_path, deepbots, command, words, message):
    write_robot(tmp_path)
    assert message in deepbots(*command, "arm.urdf.xacro", "--xacro-arg", "side:=a", *words, code=2).err


def test_each_command_that_reads_a_robot_file_takes_the_argument_that_the_file_needs(tmp_path, deepbots):
    write_robot(tmp_path)
    deepbots("lint", "arm.urdf.xacro", code=1)
    for command in ("inspect", "lint", "render"):
        deepbots(command, "arm.urdf.xacro", "--xacro-arg", "side:=left")
        assert (
            "--xacro-arg goes with a robot file"
            in deepbots(command, "cartpole", "--xacro-arg", "side:=left", code=2).err
        )


def test_a_color_that_remains_in_an_expanded_file_is_a_warning():
    visual = '<visual><geometry><box size="1 1 1"/></geometry><xacro:gray/></visual>'
    findings = Findings()
    root = parse(Source("r.urdf", robot(f'<link name="a">{visual}{visual}</link>')), findings)
    assert root is not None
    assert expand(root, mesh_resolver(Path(".")), {}, findings) is not None
    root.report.report_repeated()
    assert [finding.headline for finding in findings] == [
        "deepbots ignores the macro 'gray', because the file defines none"
    ]


def test_an_unknown_attribute_of_a_statement_is_a_warning_as_in_ros(tmp_path):
    findings = Findings()
    source = Source("r.urdf", robot('<xacro:property name="a" value="1" valeu="2"/><link name="l${a}"/>'))
    root = parse(source, findings)
    assert root is not None
    expanded = expand(root, mesh_resolver(tmp_path), {}, findings)
    assert expanded is not None
    root.report.report_repeated()
    assert [link.attributes["name"] for link in expanded.root.find_all("link")] == ["l1"]
    assert [(finding.severity, finding.span.text) for finding in findings] == [("warning", "2")]
