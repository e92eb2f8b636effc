"""`inspect` of robot files: tables, warnings, pictures."""

from __future__ import annotations

import json
import struct

import pytest

from deepbots_cli.document import shipped
from tests.few import few

BROKEN = '<robot name="r"><link name="a"/><link name="a"/></robot>'
ODD = """<robot name="odd"><link name="base"><collision><geometry><box size="2 1 0.5"/></geometry></collision></link>
<link name="arm"><inertial><mass value="3"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
<joint name="hinge" type="continuous"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/></joint></robot>"""


def test_a_robot_file_is_shown_in_tables(deepbots):
    ran = deepbots("inspect", "epuck", "--json")
    tables = json.loads(ran.out)
    assert tables["robot"]["mass_kg"] == pytest.approx(0.162)
    assert tables["robot"]["size_m"] == pytest.approx([0.076, 0.074, 0.05], abs=2e-3)
    assert [row["link"] for row in tables["links"]] == [
        "base_link",
        "left_wheel",
        "right_wheel",
        "caster_front",
        "caster_rear",
    ]
    assert tables["links"][1]["collides_as"] == ["cylinder r 0.02 l 0.004"]
    assert {row["joint"]: row["type"] for row in tables["joints"]}["caster_front_mount"] == "fixed"
    assert "findings" not in tables


def test_a_warning_about_a_robot_file_is_printed_with_its_place(deepbots, tmp_path):
    file = tmp_path / "odd.urdf"
    file.write_text(ODD, encoding="utf-8")
    ran = deepbots("inspect", str(file))
    assert "box 2 1 0.5" in ran.out
    assert "DB305" in ran.err
    assert "odd.urdf:1:31" in ran.err
    findings = json.loads(deepbots("inspect", str(file), "--json").out)["findings"]
    assert [row["code"] for row in findings] == ["DB305"]


def test_warnings_about_a_file_of_a_package_are_one_line(deepbots):
    pytest.importorskip("pybullet_data")
    ran = deepbots("inspect", "package://pybullet_data/laikago/laikago.urdf")
    assert (
        ran.err
        == "13 warnings about a file of a package, which you cannot change (13 DB306); --json lists them\n"
    )
    assert (
        len(
            json.loads(deepbots("inspect", "package://pybullet_data/laikago/laikago.urdf", "--json").out)[
                "findings"
            ]
        )
        == 13
    )


def test_a_robot_file_that_cannot_be_read_is_an_error(deepbots, tmp_path):
    file = tmp_path / "broken.urdf"
    file.write_text(BROKEN, encoding="utf-8")
    ran = deepbots("inspect", str(file), code=1)
    assert "DB301" in ran.err


@pytest.mark.parametrize(
    "name", ["none.urdf", "package://pybullet_data/none.urdf", "package://no_such_package/x.urdf"]
)
def test_a_robot_file_that_is_not_there_is_one_line_that_lists_the_shipped_ones(deepbots, name):
    ran = deepbots("inspect", name, code=2)
    assert "cartpole_rail, epuck" in ran.err


HUSKY = "package://pybullet_data/husky/husky.urdf"


@pytest.mark.parametrize(
    "name", few([*(n for n in shipped.robot_names() if n != "cartpole"), HUSKY], ("epuck", HUSKY))
)
def test_a_robot_is_drawn_so_that_it_fills_the_picture(deepbots, tmp_path, name):
    reference = str(shipped.robot_path(name) or name)
    deepbots("render", reference, "-o", str(tmp_path / "robot.png"))
    data = (tmp_path / "robot.png").read_bytes()
    assert struct.unpack(">II", data[16:24]) == (640, 480)


def test_a_scenario_goes_before_a_robot_of_the_same_name(deepbots):
    assert "scenario" in json.loads(deepbots("inspect", "cartpole", "--json").out)
