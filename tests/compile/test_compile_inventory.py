"""The names of a scenario, as editors offer them: complete, by kind, and each leading to where it is
defined."""

from __future__ import annotations

import json

import pytest

from deepbots_cli import api
from deepbots_cli.compiler.inventory import definition, names_at


@pytest.fixture(scope="module")
def rocking():
    return api.load("pit_escape")


@pytest.fixture(scope="module")
def searching():
    return api.load("find_ball_random")


def test_the_parts_of_a_robot_go_by_short_names_inside_of_it_and_by_full_ones_elsewhere(rocking):
    inside = names_at(rocking, "joint", ("robots", "roller", "actuators", "pitch_motor", "joint"))
    assert [entry.name for entry in inside] == ["pitch", "yaw"]
    assert {entry.description for entry in inside} == {"a continuous joint"}
    assert [entry.name for entry in names_at(rocking, "joints", ("reset", "joints"))] == [
        "roller.pitch",
        "roller.yaw",
    ]


@pytest.mark.parametrize(
    ("kind", "path", "expected"),
    [
        ("sensor", ("robots", "roller", "emit", 0), ["gyro", "accel"]),
        ("actuator", ("robots", "roller", "apply"), ["pitch_motor", "yaw_motor"]),
        ("action", ("scripts", "mine"), ["roll"]),
        ("choice", ("scripts", "mine", "roll"), ["forward", "backward", "turn_left", "turn_right"]),
        ("choice", ("action", "roll", "forbid"), ["forward", "backward", "turn_left", "turn_right"]),
        ("setting", ("curriculum", 0, "set"), ["radius", "time_limit", "speed"]),
        ("body", ("reset", "place"), ["roller"]),
        ("robot", ("agent", "each"), ["roller"]),
        ("layout", ("reset", "layout"), []),
    ],
)
def test_what_a_reference_may_name(rocking, kind, path, expected):
    assert [entry.name for entry in names_at(rocking, kind, path)] == expected


@pytest.mark.parametrize(
    ("scenario", "kind", "path", "expected"),
    [
        ("tag", "agent", ("agents", "prey", "like"), ["hunter", "prey"]),
        ("tag", "agent", ("tests", "the_prey_escapes", "agent"), ["hunter", "prey"]),
        ("tag", "agent", ("endings", "escaped", "success"), ["hunter", "prey", "all"]),
        ("tag", "driver", ("tests", "the_prey_escapes", "driver", "prey"), ["stroll", "random", "zero"]),
        (
            "tag",
            "ending",
            ("tests", "the_prey_escapes", "expect", "ends_by"),
            ["caught", "escaped", "max_time"],
        ),
        ("pit_escape", "parameter", ("curriculum", "levels", "set"), ["radius", "time_limit", "speed"]),
        ("find_ball_random", "object", ("reset", "place", "ball", "on"), ["ball", "obstacle"]),
    ],
)
def test_each_kind_of_reference_names_what_its_section_defines(scenario, kind, path, expected):
    assert [entry.name for entry in names_at(api.load(scenario), kind, path)] == expected


def test_a_robot_hears_what_others_send(tmp_path):
    scout = {"urdf": "cartpole", "sensors": {"tilt": {"type": "joint_position", "joint": "pole_hinge"}}}
    (tmp_path / "two.yaml").write_text(
        json.dumps({"deepbots": 1, "extends": "cartpole", "name": "Two", "robots": {"scout": scout}})
    )
    entries = names_at(api.load(tmp_path / "two.yaml"), "message field", ("robots", "cart", "hear", "mate"))
    assert [entry.name for entry in entries] == ["scout.tilt"]


def test_a_disturbance_may_push_links_and_a_touch_sensor_feels_bodies_and_the_ground(searching):
    assert "epuck.base_link" in [
        entry.name for entry in names_at(searching, "body or link", ("disturbances", "gust", "body"))
    ]
    against = [
        entry.name
        for entry in names_at(
            searching, "bodies or links", ("robots", "epuck", "sensors", "bumper", "against")
        )
    ]
    assert {"ball", "obstacle", "ground", "epuck.base_link"} <= set(against)


@pytest.mark.parametrize(
    ("name", "text", "place"),
    [
        ("radius", "radius: 2.7 m", "pit_escape.yaml"),
        ("roller.gyro.y", "gyro: {type: gyro", "pit_escape.yaml"),
        ("pitch", "pitch: 1,", "pit_escape.yaml"),
        ("roller.ball", 'ball">', "roller.urdf"),
        ("escaped", "escaped: reach", "pit_escape.yaml"),
    ],
)
def test_a_name_leads_to_its_definition(rocking, name, text, place):
    target = definition(rocking, name)
    assert text.startswith(target.span.text)
    assert target.span.source.text.startswith(text, target.span.start)
    assert target.span.source.name.endswith(place)


def test_on_board_the_names_of_the_robot_come_first(searching):
    assert definition(searching, "proximity", "epuck").span.location.endswith("epuck.yaml:4:3")
    assert definition(searching, "proximity") is None
    assert definition(searching, "nothing.at.all") is None


def test_a_scenario_that_cannot_be_read_has_no_names(tmp_path):
    broken = tmp_path / "broken.yaml"
    broken.write_text("deepbots: 1\nname: {")
    assert names_at(api.load(broken), "joint") == []
    assert definition(api.load(broken), "joint") is None
