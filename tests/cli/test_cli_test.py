"""`deepbots test`: passing tests, the output of a failed test, and that tests change nothing else."""

from __future__ import annotations

import json
import shlex
from contextlib import closing
from pathlib import Path
from xml.etree import ElementTree

import pytest

from deepbots_cli import api
from deepbots_cli.document import shipped
from deepbots_cli.learning.scenario_tests import run_tests
from deepbots_cli.program.identity import digest
from deepbots_cli.runtime.streams import derive_seed
from tests.cli.conftest import Deepbots, Ran
from tests.few import few

# The exact engine moves the cart by 0.4 mm in a step at full drive.
WORLD = """\
deepbots: 1
name: Small
parameters: {start: uniform(-1 .. 1 m), edge: 3 mm}
world: {timestep: 20 ms, substeps: 4}
robots:
  cart:
    urdf: cartpole_rail
    base: fixed
    sensors: {place: {type: joint_position, joint: slider}}
    actuators: {motor: {type: velocity_motor, joint: slider, max_torque: 10 N}}
    emit: [place]
    apply: {motor: drive * 0.02 m/s}
augment: {driven: cart.place - start}
observation: {cart.place: -2.4 .. 2.4 m, driven: auto}
action: {drive: -1 .. 1}
reward: {pay: 2}
termination:
  success: {there: driven > edge}
  failure: {back: driven < -3 mm}
truncation: {max_steps: 50}
reset: {joints: {cart.slider: start}}
scripts:
  onward: {drive: 1}
  homeward: {drive: -1}
  uncertain: {drive: "1 if start > 0 m else -1"}
evaluation: {cases: {near: {set: {edge: 1 mm}}}}
curriculum: [{name: far, set: {edge: 10 mm}, until: 100 steps}, {name: usual}]
"""


@pytest.fixture
def small(deepbots: Deepbots, tmp_path: Path):
    """Writes that world with tests, and runs them on the exact engine."""

    def run(tests: str, *words: object, world: str = WORLD) -> Ran:
        (tmp_path / "small.yaml").write_text(f"{world}tests:\n{tests}")
        return deepbots("test", "small.yaml", "--engine", "exact", *words, code=None)

    return run


@pytest.mark.parametrize(
    "test",
    [
        "{driver: onward, episodes: 3, expect: {success_rate: 100 %, failure_rate: 0 .. 0, ends_by: there,"
        " mean_return: 16 .. 16}}",
        "{driver: homeward, expect: {ends_by: [there, back], failure_rate: 100 %, eventually: back and time"
        " < 0.2 s}}",
        "{driver: zero, expect: {ends_by: max_steps, mean_return: 100, always: abs(driven) < 0.01 mm}}",
        "{driver: zero, max_time: 0.1 s, expect: {mean_return: 10 .. 10}}",
        "{driver: random, max_steps: 3, expect: {mean_return: 6, always: [abs(driven) < 1.3 mm,"
        " previous_reward == 2]}}",
        "{actions: [1, {drive: 1}, -1, 0.5], expect: {mean_return: 8 .. 8, eventually: driven > 0.7 mm,"
        " always: driven < 0.9 mm}}",
        "{driver: onward, case: near, expect: {mean_return: 6 .. 6, always: edge < 2 mm}}",
        "{driver: onward, stage: far, expect: {mean_return: 52 .. 52, eventually: driven > 9 mm}}",
        "{driver: uncertain, episodes: 20, expect: {success_rate: 20 .. 80 %, ends_by: [there, back]}}",
    ],
)
def test_an_expectation_that_is_met_passes(small, test: str) -> None:
    ran = small(f"  one: {test}\n")
    assert ran.code == 0, ran.out
    assert "1 passed in" in ran.out


@pytest.mark.parametrize(
    ("expect", "measured"),
    [
        ("always: driven < 2.1 mm", "; seed 0, episode 0, step 6 (0.12 s)"),
        ("always: cart.place - start < 2.1 mm", "cart.place - start is 0.0023"),
        ("eventually: driven < -1 mm", "never in 8 steps (0.16 s); at the end, driven is 0.00"),
        ("ends_by: back", "ended by `there` after 8 steps (0.16 s); in 2 of 2 episodes; seed 0, episode 0"),
        ("ends_by: max_steps", "ended by `there` after 8 steps"),
        ("failure_rate: 50 %", "0 of 2 episodes (0 %)"),
        ("success_rate: 0 .. 0.5", "2 of 2 episodes (100 %)"),
        ("mean_return: 17 .. 20", "16 over 2 episodes, the lowest is 16; seed 0, episode 0"),
    ],
)
def test_a_failed_test_shows_what_was_expected_and_measured(small, expect: str, measured: str) -> None:
    ran = small(f"  one: {{driver: onward, episodes: 2, expect: {{{expect}}}}}\n")
    assert ran.code == 1
    place = WORLD.count("\n") + 2
    assert "FAILED one" in ran.out
    assert f"expected  {expect} (small.yaml:{place}:" in ran.out
    assert measured in ran.out


def test_expectations_are_listed_as_they_are_missed(small) -> None:
    expect = '{always: ["driven < -1 m", "time < 0 s"], mean_return: 1000 .. 2000}'
    ran = small(f"  one: {{driver: onward, episodes: 2, expect: {expect}}}\n", "--json")
    misses = json.loads(ran.out)["scenarios"][0]["tests"][0]["misses"]
    assert [miss["expected"].split(" (")[0] for miss in misses] == [
        "always: driven < -1 m",
        "always: time < 0 s",
        "mean_return: 1000 .. 2000",
    ]


def test_the_command_of_a_failed_test_shows_its_episode(small, deepbots: Deepbots) -> None:
    """`view` begins an episode as the evaluation does; a sequence of actions is for `run`."""
    ran = small(
        "  one: {driver: uncertain, episodes: 9, seed: 4, case: near, expect: {ends_by: there}}\n", "--json"
    )
    (miss,) = json.loads(ran.out)["scenarios"][0]["tests"][0]["misses"]
    assert miss["command"] == (
        "deepbots view small.yaml --case near --engine exact --driver uncertain --seed 4 --episode"
        f" {miss['episode']}"
    )
    with closing(api.make("small.yaml", engine="exact")) as environment:
        starts = [
            environment.reset(seed=derive_seed(4, "evaluation", k))[1]["drawn"]["start"] for k in range(9)
        ]
    assert starts[miss["episode"]] < 0
    assert all(start > 0 for start in starts[: miss["episode"]])

    ran = small("  one: {actions: [0.5, -1, 1], episodes: 2, expect: {always: driven > -0.1 mm}}\n", "--json")
    (miss,) = json.loads(ran.out)["scenarios"][0]["tests"][0]["misses"]
    assert (miss["step"], miss["episode"]) == (2, 0)
    repeated = json.loads(deepbots(*shlex.split(miss["command"])[1:], "--json").out)
    assert [(episode["length"], episode["return"]) for episode in repeated["episodes"]] == [(3, 6.0)]


def test_an_episode_that_breaks_off_fails_its_test_alone(small) -> None:
    world = WORLD.replace("reward: {pay: 2}", "reward: {pay: 1 / (step - 3)}")
    tests = (
        "  one: {driver: zero, expect: {ends_by: max_steps}}\n  two: {driver: zero, max_steps: 2,"
        " expect: {mean_return: -2}}\n"
    )
    ran = small(tests, world=world)
    assert ran.code == 1
    assert "1 passed, 1 failed" in ran.out
    assert "step 3: no value for" in ran.out


def test_a_test_with_a_warning_runs(small) -> None:
    ran = small("  one: {driver: zero, max_steps: 2, expect: {always: step < 10 ^ 400}}\n", "--json")
    assert [test["test"] for test in json.loads(ran.out)["scenarios"][0]["tests"]] == ["one"]
    assert "see: deepbots lint small.yaml" in ran.err


def test_junit_that_cannot_be_written_is_reported_before_a_test_runs(small, tmp_path: Path) -> None:
    ran = small("  one: {driver: zero, expect: {ends_by: max_steps}}\n", "--junit", tmp_path)
    assert ran.code == 2
    assert ran.out == ""
    assert "it is a directory" in ran.err


def test_k_selects_tests_by_a_part_of_their_names(small) -> None:
    tests = (
        "  drives: {driver: onward, expect: {ends_by: back}}\n  rests: {driver: zero, expect: {ends_by:"
        " max_steps}}\n"
    )
    assert small(tests).code == 1
    assert small(tests, "-k", "rest").code == 0
    nothing = small(tests, "-k", "sleeps")
    assert nothing.code == 2
    assert "there is no test whose name contains 'sleeps' in small.yaml" in nothing.err


def test_junit_has_a_suite_for_each_scenario_and_a_case_for_each_test(
    small, deepbots: Deepbots, tmp_path: Path
) -> None:
    tests = (
        "  drives: {driver: onward, expect: {ends_by: back}}\n  rests: {driver: zero, expect: {ends_by:"
        " max_steps}}\n"
    )
    assert small(tests, "--junit", "one.xml").code == 1
    suite = ElementTree.parse(tmp_path / "one.xml").getroot()
    assert (suite.tag, suite.attrib["tests"], suite.attrib["failures"]) == ("testsuite", "2", "1")
    assert [(case.attrib["name"], case.find("failure") is None) for case in suite] == [
        ("drives", False),
        ("rests", True),
    ]

    (tmp_path / "broken.yaml").write_text(
        "deepbots: 1\nextends: small.yaml\ntests: {one: {driver: nobody, expect: {mean_return: 1}}}\n"
    )
    ran = deepbots("test", ".", "--engine", "exact", "--junit", "both.xml", code=1)
    assert "there is no script `nobody`" in ran.err
    assert "1 passed, 1 failed, 1 scenario with errors" in ran.out
    suites = ElementTree.parse(tmp_path / "both.xml").getroot()
    assert [suite.attrib["name"] for suite in suites] == [
        "deepbots test broken.yaml",
        "deepbots test small.yaml",
    ]


def test_tests_change_neither_the_scenario_nor_one_that_extends_it(small, tmp_path: Path) -> None:
    small("  one: {driver: onward, expect: {ends_by: there, always: driven < 1 m}}\n")
    (tmp_path / "plain.yaml").write_text(WORLD)
    (tmp_path / "other.yaml").write_text(
        "deepbots: 1\nextends: small.yaml\nname: Other\nremove: [scripts.onward]\n"
    )
    tested, plain, extending = (
        api.compile(api.load(tmp_path / name)) for name in ("small.yaml", "plain.yaml", "other.yaml")
    )
    assert (tested.digest, tested.code, digest(tested.program)) == (plain.digest, plain.code, plain.digest)
    assert api.load(tmp_path / "small.yaml").tests
    assert api.load(tmp_path / "other.yaml").tests == ()
    assert [finding.code for finding in extending.findings] == [finding.code for finding in plain.findings]


def test_an_assignment_leaves_tests_out_except_of_a_test(small, deepbots: Deepbots) -> None:
    """`--set` may take away what a test names; `test --set` asks for the tests under this setting."""
    assert small("  one: {driver: onward, expect: {ends_by: there}}\n", "--set", "edge=40mm").code == 1
    deepbots("try", "small.yaml", "--engine", "exact", "--set", "scripts={rest: {drive: 0}}", "--steps", "2")


def test_a_condition_holds_only_if_it_holds_for_every_copy(tmp_path: Path) -> None:
    (tmp_path / "team.yaml").write_text(
        f"deepbots: 1\nextends: {shipped.scenario_path('multi_cartpole')}\n"
        "reset: {place: {cart: {x: uniform(-5 .. 5 cm), z: 0.04 m}}}\n"
        "tests:\n"
        "  some: {driver: zero, max_steps: 2, expect: {always: x > 0 m}}\n"
        "  all: {driver: zero, max_steps: 2, expect: {always: abs(x) < 10 cm}}\n"
    )
    checked = api.load(tmp_path / "team.yaml")
    assert checked.program is not None
    assert [result.passed for result in run_tests(checked.program, checked.tests)] == [False, True]


@pytest.mark.parametrize("name", few(shipped.scenario_names(), ("cartpole", "quadrotor", "panda_reach")))
def test_the_tests_of_a_shipped_scenario_pass(deepbots: Deepbots, name: str) -> None:
    deepbots("test", name)
    assert len(api.load(name).tests) >= 2
