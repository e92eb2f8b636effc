"""The section `tests` of a scenario with several agents."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from deepbots_cli import api
from deepbots_cli.cli import main
from tests.agents.carts import CARTS

TESTS = """\
tests:
  left_falls:
    driver: {left: ahead, right: zero}
    episodes: 3
    expect: {failure_rate: 100 %, ends_by: left_fell, eventually: speed > 10 cm/s}
  right_wins:
    agent: right
    driver: {left: ahead, right: zero}
    expect: {success_rate: 100 %, always: abs(speed) < 20 cm/s}
  both_lean:
    driver: lean
    max_steps: 5
    expect: {always: not left_fell and apart < 2 m}
  pushed:
    agent: right
    actions: [{right: 1}, {left: {drive: -1}, right: {drive: 1}}, {left: 1}]
    expect: {eventually: speed > 1 cm/s}
"""


@pytest.fixture
def carts(tmp_path: Path) -> Path:
    file = tmp_path / "carts.yaml"
    file.write_text(CARTS + TESTS)
    return file


def test_a_test_expects_the_results_of_one_agent(carts: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert not [finding for finding in api.lint(carts) if finding.severity == "error"]
    assert main(["test", str(carts), "--json"]) == 0
    (scenario,) = json.loads(capsys.readouterr().out)["scenarios"]
    assert [test["test"] for test in scenario["tests"]] == ["left_falls", "right_wins", "both_lean", "pushed"]
    assert [test["steps"] for test in scenario["tests"]][2:] == [5, 3]


def test_a_failed_test_shows_the_command_with_both_drivers(
    carts: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    carts.write_text((CARTS + TESTS).replace("success_rate: 100 %", "success_rate: 0 .. 10 %"))
    assert main(["test", str(carts), "-k", "right_wins", "--json"]) == 1
    (scenario,) = json.loads(capsys.readouterr().out)["scenarios"]
    ((miss,),) = [test["misses"] for test in scenario["tests"]]
    assert miss["measured"].startswith("1 of 1 episodes")
    words = miss["command"].split()
    assert words[:2] == ["deepbots", "view"]
    assert main(["try", *words[2:-2], "--episodes", "1", "--json"]) == 0
    (episode,) = json.loads(capsys.readouterr().out)["episodes"]
    assert episode["ended_by"] == "left_fell"
    assert episode["success"]


def test_a_failed_sequence_of_actions_is_repeated_by_its_command(
    carts: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    carts.write_text((CARTS + TESTS).replace("speed > 1 cm/s", "speed > 1 m/s"))
    assert main(["test", str(carts), "-k", "pushed", "--json"]) == 1
    (scenario,) = json.loads(capsys.readouterr().out)["scenarios"]
    ((miss,),) = [test["misses"] for test in scenario["tests"]]
    assert "--driver=0:1,-1:1,1:0 --steps 3" in miss["command"]
    assert main(miss["command"].split()[1:]) == 0


def test_an_agent_may_have_the_name_of_a_column(carts: Path, capsys: pytest.CaptureFixture[str]) -> None:
    named = re.sub(r"\bleft\b", "length", re.sub(r"\bright\b", "success", CARTS))
    carts.write_text(named)
    assert main(["try", str(carts), "--driver", "zero", "--episodes", "1", "--steps", "3"]) == 0
    _, columns, _, row = capsys.readouterr().out.splitlines()[:4]
    assert columns.split("  ")[1:] == [
        "episode",
        "return of length",
        "return of success",
        "length",
        "ended_by",
        "success",
    ]
    assert row.split()[0] == "0"
    assert row.split()[3] == "3"


@pytest.mark.parametrize(
    ("old", "new", "headline"),
    [
        ("agent: right", "agent: middle", "there is no agent `middle`"),
        ("{left: ahead, right: zero}", "{left: ahead, middle: zero}", "there is no agent `middle`"),
        ("{left: ahead, right: zero}", "{left: behind, right: zero}", "there is no script `behind`"),
        ("driver: lean", "driver: leen", "there is no script `leen`"),
        ("[{right: 1}, ", "[{middle: 1}, ", "there is no agent `middle`"),
        ("[{right: 1}, ", "[1, ", "one action for several agents"),
        ("{drive: -1}", "{drve: -1}", "`drve`"),
        ("eventually: speed > 1 cm/s", "eventually: sped > 1 cm/s", "`sped`"),
    ],
)
def test_a_mistake_in_a_test_is_one_finding(carts: Path, old: str, new: str, headline: str) -> None:
    carts.write_text((CARTS + TESTS).replace(old, new, 1))
    errors = [finding.headline for finding in api.lint(carts) if finding.severity == "error"]
    assert len(errors) == 1
    assert headline in errors[0]


@pytest.mark.parametrize(
    ("test", "headline"),
    [
        ("{driver: {cart: zero}, expect: {mean_return: 1}}", "a driver of each agent belongs"),
        ("{agent: cart, driver: zero, expect: {mean_return: 1}}", "`agent` of a test belongs"),
    ],
)
def test_the_form_for_several_agents_is_refused_for_one(tmp_path: Path, test: str, headline: str) -> None:
    file = tmp_path / "one.yaml"
    file.write_text(f"deepbots: 1\nextends: cartpole\nname: One\ntests: {{some: {test}}}\n")
    errors = [finding.headline for finding in api.lint(file) if finding.severity == "error"]
    assert len(errors) == 1
    assert headline in errors[0]


def test_tests_of_a_file_with_a_role_are_about_all_agents(carts: Path) -> None:
    carts.write_text(CARTS + TESTS + "role: {agent: right}\n")
    assert main(["test", str(carts)]) == 0
