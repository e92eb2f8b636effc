"""Whatever the file holds: findings, and never an exception, a hang or an expanded entity."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from deepbots_cli.diagnostics import Findings
from deepbots_cli.robots.meshes import UnusableMesh
from deepbots_cli.robots.model import to_urdf
from deepbots_cli.robots.reader import read, read_bytes

CARTPOLE = (Path(__file__).parents[2] / "robots/urdf/cartpole.urdf").read_bytes()
LAUGHS = (
    b'<?xml version="1.0"?><!DOCTYPE robot [<!ENTITY a "ha">'
    + b"".join(b'<!ENTITY a%d "%s">' % (i, b"&a%d;" % (i - 1) * 10 if i else b"&a;") for i in range(20))
    + b']><robot name="&a19;"/>'
)


def headline_of(data: bytes) -> str:
    findings = Findings()
    started = time.process_time()
    assert read_bytes(data, "x.urdf", findings, resolve_mesh=lambda _: UnusableMesh("no meshes here")) is None
    assert time.process_time() - started < 5
    return next(iter(findings.errors)).headline


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
def test_a_hostile_file_is_refused_in_time(case):
    data, expected = HOSTILE[case]
    assert expected in headline_of(data)


def test_of_a_hundred_thousand_findings_only_some_are_reported():
    findings = Findings()
    joints = b"<joint/>" * 99_000
    assert (
        read_bytes(b"<robot>" + joints + b"</robot>", "x", findings, resolve_mesh=lambda _: UnusableMesh(""))
        is None
    )
    assert 0 < len(findings) <= 110
    findings = Findings()
    axes = b'<axis xyz="1 0 0"/>' * 99_000
    read_bytes(
        b'<robot><link name="a"/><joint name="j">' + axes + b"</joint></robot>",
        "x",
        findings,
        resolve_mesh=lambda _: UnusableMesh(""),
    )
    assert 0 < len(findings) <= 110


def test_a_long_chain_of_joints_needs_no_recursion():
    links = b"".join(b'<link name="l%d"/>' % i for i in range(1000))
    joints = b"".join(
        b'<joint name="j%d" type="fixed"><parent link="l%d"/><child link="l%d"/></joint>' % (i, i, i + 1)
        for i in range(999)
    )
    robot = read_bytes(
        b"<robot>" + links + joints + b"</robot>", "x", Findings(), resolve_mesh=lambda _: UnusableMesh("")
    )
    assert robot is not None
    assert robot.model.root == "l0"


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


def check(data: bytes) -> None:
    """Reading ends in a robot that survives the round trip, or in at least one error; every span lies in its
    text."""
    findings = Findings()
    robot = read_bytes(data, "x.urdf", findings, resolve_mesh=lambda _: UnusableMesh("no meshes here"))
    for finding in findings:
        text = finding.span.source.text
        assert 0 <= finding.span.start <= finding.span.end <= len(text)
        assert finding.span.location
        assert (
            finding.headline[0].islower()
            or not finding.headline[0].isalpha()
            or finding.headline.startswith("XML")
        )
        assert "\n" not in finding.headline
    if robot is None:
        assert findings.errors
        return
    again = read_bytes(
        to_urdf(robot.model).encode(), "y.urdf", Findings(), resolve_mesh=lambda _: UnusableMesh("")
    )
    assert again is not None
    assert again.model == robot.model


@given(
    st.binary(max_size=300) | st.text(max_size=300).map(lambda text: text.encode("utf-8", "surrogatepass"))
)
@example(b"\xef\xbb\xbf<robot/>")
@example(b"<!DOCTYPE")
@example(b"<robot><link name='\xc3\xa4'/><!DOCTYPE x></robot>")
def test_any_bytes_give_findings(data: bytes):
    check(data)


PIECES = [
    b'"',
    b"<",
    b">",
    b"/",
    b"",
    b"nan",
    b"-1",
    b"0",
    b"1e400",
    b"1e-320",
    b"0 0 0",
    b"1 2",
    b"body",
    b"pole",
    b"&#10;",
    b"&x;",
    b"\xff",
    b"\xc3\xa4",
    b"fixed",
    b"floating",
    b"<!--",
    b"]]>",
    b"<link name='body'/>",
    b"<!DOCTYPE a>",
    b"\0",
    b"<axis xyz='0 0 0'/>",
    b"1e18",
]


@settings(suppress_health_check=[HealthCheck.too_slow])
@given(
    st.lists(
        st.tuples(
            st.integers(0, len(CARTPOLE)), st.integers(0, 40), st.sampled_from(PIECES) | st.binary(max_size=4)
        ),
        min_size=1,
        max_size=4,
    )
)
def test_a_damaged_robot_gives_findings_or_still_reads(cuts: list[tuple[int, int, bytes]]):
    data = CARTPOLE
    for at, length, piece in cuts:
        data = data[:at] + piece + data[at + length :]
    check(data)


TOKENS = sorted(
    {token for token in CARTPOLE.replace(b"<", b' "').replace(b">", b'" ').split(b'"') if 0 < len(token) < 30}
)


@given(st.lists(st.tuples(st.sampled_from(TOKENS), st.sampled_from(PIECES + TOKENS)), min_size=1, max_size=2))
def test_exchanged_words_give_findings_or_still_read(exchanges: list[tuple[bytes, bytes]]):
    data = CARTPOLE
    for old, new in exchanges:
        data = data.replace(old, new, 1)
    check(data)
