"""`try --driver` and `try --start`, and the summary of `try` over many episodes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from deepbots_cli import api
from deepbots_cli.learning.runs.statistics import mean_interval, wilson

BASE = Path(__file__).parents[1] / "golden" / "lint" / "cartpole.yaml"
SCRIPTED = """\
deepbots: 1
extends: cartpole.yaml
name: Scripted
scripts:
  onward: {drive: forward}
  catch: {drive: {forward: cart.pole_angle > 0 rad, backward: true}}
evaluation: {cases: {back: {set: {scripts.onward.drive: backward}}}}
reward: {far: 300 when far}
termination: {success: {far: x > 0.1 m}}
"""


@pytest.fixture
def scripted(tmp_path):
    (tmp_path / "cartpole.yaml").write_bytes(BASE.read_bytes())
    (tmp_path / "scripted.yaml").write_text(SCRIPTED)
    return "scripted.yaml"


def report_of(deepbots, *words):
    result = deepbots("try", *words, "--json")
    return json.loads(result.out)


def test_a_script_drives_every_episode(deepbots, scripted):
    onward = report_of(deepbots, scripted, "--driver", "onward")
    assert onward["driver"] == "onward"
    assert onward["episodes"] == report_of(deepbots, scripted, "--driver", "forward")["episodes"]
    assert onward["episodes"] != report_of(deepbots, scripted, "--driver", "catch")["episodes"]


def test_a_script_may_be_another_in_a_case(deepbots, scripted):
    words = (scripted, "--case", "back")
    assert (
        report_of(deepbots, *words, "--driver", "onward")["episodes"]
        == report_of(deepbots, *words, "--driver", "backward")["episodes"]
    )


def test_actions_are_repeated_and_may_be_those_of_a_script(deepbots, scripted):
    once = report_of(deepbots, scripted, "--driver", "forward,forward,forward,backward")["episodes"]
    assert report_of(deepbots, scripted, "--driver", "onward*3,backward*1")["episodes"] == once
    assert report_of(deepbots, scripted, "--driver", "forward*3,backward")["episodes"] == once


KNOWN = "the drivers are onward, catch, random, zero, and actions such as forward,backward\n"


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("cach", f"error: there is no driver 'cach' (did you mean catch?); {KNOWN}"),
        ("best", f"error: there is no driver 'best'; {KNOWN}"),
        ("foward,backward", "error: 'drive' has no option 'foward'; its options are: forward, backward\n"),
        (
            "onward*x",
            "error: 'onward*x' is not valid; write the number of steps after the asterisk, such as"
            " onward*8\n",
        ),
        (
            "catch*0",
            "error: 'catch*0' is not valid; write the number of steps after the asterisk, such as catch*8\n",
        ),
        (
            "policy",
            "error: only a run has a policy; train one with `deepbots train`, and name the run instead of"
            " the scenario\n",
        ),
        ("you", "error: you can drive in the browser only; use `deepbots play`\n"),
    ],
)
def test_a_driver_that_cannot_act_is_refused_with_those_that_can(deepbots, scripted, name, message):
    result = deepbots("try", scripted, "--driver", name, code=2)
    assert result.err.endswith(message)


def test_a_scenario_without_scripts_says_so(deepbots):
    result = deepbots("try", "cartpole", "--driver", "catch", code=2)
    assert (
        result.err == "error: there is no driver 'catch'; the drivers are random, zero, and actions such as"
        " forward,backward\n"
    )


def test_few_episodes_are_shown_one_by_one_and_summed_up(deepbots, scripted):
    result = deepbots("try", scripted, "--driver", "onward", "--episodes", "20")
    assert result.out.startswith(
        "13 of 20 episodes succeeded, mean return 316.00, ended by far 13, fallen 7\n\n"
    )
    assert "summary of 20 episodes" in result.out
    assert "\n       19 " in result.out
    assert "more" not in result.out
    assert result.err == ""
    assert "summary" not in deepbots("try", scripted, "--episodes", "1").out


def test_of_many_episodes_the_first_are_shown_and_all_are_counted(deepbots, scripted):
    words = ("try", scripted, "--driver", "onward", "--episodes", "21")
    ran = deepbots(*words)
    assert "\n        4 " in ran.out
    assert "\n        5 " not in ran.out
    assert "\n  and 16 more\n" in ran.out
    assert "of 21 episodes\n" in ran.err
    data = json.loads(deepbots(*words, "--json").out)
    assert len(data["episodes"]) == 21


def test_the_summary_is_that_of_the_episodes_with_intervals(deepbots, scripted):
    data = report_of(deepbots, scripted, "--driver", "random", "--episodes", "8")
    summary = data["summary"]
    returns = [episode["return"] for episode in data["episodes"]]
    successes = sum(episode["success"] for episode in data["episodes"])
    assert summary["success_defined"] is True
    assert summary["episodes"] == 8
    assert summary["mean_return"] == pytest.approx(sum(returns) / 8)
    assert summary["return_interval"] == pytest.approx(list(mean_interval(returns)))
    assert summary["successes"] == successes
    assert summary["success_interval"] == pytest.approx(list(wilson(successes, 8)))
    assert sum(summary["endings"].values()) == 8
    assert {episode["ended_by"] for episode in data["episodes"]} == set(summary["endings"])


def test_a_success_that_the_scenario_does_not_know_is_not_counted(deepbots):
    assert "success rate" not in deepbots("try", "cartpole", "--episodes", "2").out
    assert report_of(deepbots, "cartpole", "--episodes", "2")["summary"]["success_defined"] is False


def test_a_limit_of_steps_holds_for_all_episodes_of_a_script(deepbots, scripted):
    data = report_of(deepbots, scripted, "--driver", "catch", "--episodes", "50", "--steps", "30")
    assert sum(episode["length"] for episode in data["episodes"]) == 30
    assert data["episodes"][-1]["ended_by"] == "--steps"


def test_inspect_shows_the_action_of_each_script(deepbots, scripted):
    rows = json.loads(deepbots("inspect", scripted, "--json").out)["scripts"]
    assert rows == [
        {"script": "onward", "action": "drive", "is": "forward"},
        {"script": "catch", "action": "drive", "is": "{forward: cart.pole_angle > 0 rad, backward: true}"},
    ]
    assert "onward" in deepbots("inspect", scripted, "--full").out


def test_compile_prints_a_method_for_each_script(deepbots, scripted):
    code = deepbots("compile", scripted).out
    assert code == api.compile(scripted).code
    assert "    def script_catch(self) -> Any:\n" in code
    assert "        if cart_pole_angle > 0.0:\n            drive_pick = 0  # forward\n" in code


def test_a_start_is_set_on_the_command_line(deepbots, scripted):
    words = (scripted, "--driver", "onward", "--episodes", "2")
    upright = report_of(deepbots, *words, "--start", "reset.joints.cart.pole_hinge=0.01")
    assert upright["start"] == {"reset.joints.cart.pole_hinge": 0.01}
    first, second = upright["episodes"]
    assert first == second


@pytest.mark.parametrize(
    ("start", "message"),
    [
        ("pole=0.01", "cannot set 'pole': "),
        ("reset.joints.cart.pole_hinge=far", "it is a single number"),
        ("reset.joints.cart.pole_hinge=nan", "it is not finite"),
        (
            "mark=[0.01,0.05]",
            "separate the numbers by commas, without spaces or brackets: --start mark=0.01,0.05",
        ),
        ("reset.joints.cart.pole_hinge", "write NAME=VALUE, such as --start mark.x=0.5"),
    ],
)
def test_a_start_that_no_episode_has_ends_in_one_line(deepbots, scripted, start, message):
    result = deepbots("try", scripted, "--start", start, code=2)
    assert message in result.err
    assert len(result.err.strip().splitlines()) == 1
