"""A mistake in a scenario has one finding, in plain words, at its place."""

import re
from collections.abc import Callable

import pytest

from deepbots_cli.diagnostics import Finding
from deepbots_cli.scenario import Scenario
from tests.golden.cases import mistakes

Check = Callable[[str], tuple[Scenario | None, list[Finding]]]

FAULTS = mistakes("scenario")


@pytest.mark.parametrize(
    ("old", "new", "code", "marked", "headline", "help"),
    FAULTS,
    ids=[f"{f[2]}-{f[1].strip()[:40]}" for f in FAULTS],
)
def test_a_fault_is_reported_once_in_its_place(
    check: Check, cartpole: str, old: str, new: str, code: str, marked: str, headline: str, help: str | None
) -> None:
    assert old in cartpole
    _, findings = check(cartpole.replace(old, new, 1))
    (finding,) = findings
    assert (finding.code, finding.span.text, finding.headline) == (code, marked, headline)
    if help is not None:
        assert help in (finding.help or "")


def test_a_sound_scenario_has_no_findings(check: Check, cartpole: str) -> None:
    scenario, findings = check(cartpole)
    assert scenario is not None
    assert findings == []
    assert scenario.pruned == frozenset()
    assert scenario.robots["cart"].emit == ("pole_angle",)


def test_a_newer_version_of_the_language_is_refused_without_further_findings(
    check: Check, cartpole: str
) -> None:
    scenario, findings = check(cartpole.replace("deepbots: 1", "deepbots: 7").replace("world:", "wurld:"))
    assert scenario is None
    assert [finding.code for finding in findings] == ["DB105"]


def test_every_fault_of_a_file_is_found_at_once(check: Check, cartpole: str) -> None:
    text = (
        cartpole.replace("substeps: 4", "substeps: 0")
        .replace("PPO", "PBO")
        .replace("alive: 1", "alive: []")
        .replace("csv", "tsv")
    )
    _, findings = check(text)
    assert [finding.code for finding in findings] == ["DB105", "DB104", "DB103", "DB104"]


def test_what_is_sound_survives_the_faults_beside_it(check: Check, cartpole: str) -> None:
    scenario, _ = check(
        cartpole.replace("type: velocity_motor", "type: warp").replace("alive: 1", "alive: []\n  pay: 2")
    )
    assert scenario is not None
    cart = scenario.robots["cart"]
    assert list(cart.sensors) == ["pole_angle"]
    assert cart.actuators == {}
    assert scenario.reward == {"pay": 2}
    assert {("robots", "cart", "actuators", "wheels"), ("reward", "alive")} <= scenario.pruned


def test_a_required_section_with_a_fault_leaves_the_others_to_be_checked(check: Check, cartpole: str) -> None:
    scenario, findings = check(cartpole.replace("robots:\n", "robots: 5\nrobits:\n"))
    assert scenario is not None
    assert scenario.robots == {}
    assert scenario.truncation is not None
    assert ("robots",) in scenario.pruned
    assert [finding.headline for finding in findings] == [
        "expected a mapping, found the number `5`",
        "unknown key `robits` at the top level",
    ]


def test_a_key_without_a_value_is_not_also_missing(check: Check, cartpole: str) -> None:
    for old, new in (
        ("timestep: 32 ms", "timestep:"),
        ("  alive: 1", "  alive:"),
        ("type: joint_position", "type: "),
    ):
        _, findings = check(cartpole.replace(old, new))
        assert [finding.code for finding in findings] == ["DB107"], new


def test_a_value_that_the_reader_refused_is_not_also_missing(check: Check, cartpole: str) -> None:
    _, findings = check(cartpole.replace("timestep: 32 ms", "timestep: 1e999"))
    assert [finding.code for finding in findings] == ["DB105"]


def test_a_fault_in_a_list_of_stages_names_the_entry(check: Check, cartpole: str) -> None:
    _, findings = check(
        cartpole + "curriculum:\n  - {name: easy, until: success_rate > 0.7}\n  - {set: {track: 1 m}}\n"
    )
    assert [(f.code, f.span.text) for f in findings] == [
        ("DB103", "success_rate > 0.7"),
        ("DB102", "{set: {track: 1 m}}"),
    ]
    assert findings[1].headline == "missing key `name` in entry 2 of `curriculum`"


@pytest.mark.parametrize(
    "until",
    [
        "success_rate >= 7 over 40 episodes",
        "success_rate >= 0.7 over 0 episodes",
        "success_rate >= 120 % in evaluation",
    ],
)
def test_a_stage_that_can_never_end_is_refused(check: Check, cartpole: str, until: str) -> None:
    _, findings = check(cartpole + f"curriculum:\n  - {{name: easy, until: {until}}}\n")
    assert [finding.code for finding in findings] == ["DB105"]


def test_a_criterion_of_more_episodes_than_can_be_confirmed_is_refused(check: Check, cartpole: str) -> None:
    _, findings = check(
        re.sub("^solved:.*", "solved: mean_return >= 195 over 100000 episodes", cartpole, flags=re.MULTILINE)
    )
    assert [(finding.code, finding.help) for finding in findings] == [("DB105", "write at most 10000")]


def test_each_body_is_read_as_the_model_of_its_shape(check: Check, cartpole: str) -> None:
    objects = (
        "{ball: {shape: sphere, radius: 1 m}, heap: {count: 3, one_of: {a: {shape: box, size: 1 1 1 m}}}}"
    )
    scenario, findings = check(cartpole + f"objects: {objects}\n")
    assert findings == []
    assert scenario is not None
    assert [type(thing).__name__ for thing in scenario.objects.values()] == ["SphereObject", "VariedObject"]


@pytest.mark.parametrize(
    ("objects", "code", "marked"),
    mistakes("objects"),
)
def test_faults_of_bodies(check: Check, cartpole: str, objects: str, code: str, marked: str) -> None:
    _, findings = check(cartpole + f"objects: {objects}\n")
    assert [(finding.code, finding.span.text) for finding in findings] == [(code, marked)]


def test_numbers_of_extreme_size_are_out_of_range(check: Check, cartpole: str) -> None:
    for number in ("1e999", "-1e300", "9" * 400):
        _, findings = check(cartpole.replace("alive: 1", f"alive: {number}"))
        assert [finding.code for finding in findings] == ["DB105"], number


@pytest.mark.parametrize(("typed", "key", "help"), mistakes("unfinished"))
def test_a_key_without_a_value_has_a_finding_with_what_it_takes(
    check: Check, typed: str, key: str, help: str
) -> None:
    (empty,) = (
        finding for finding in check(f"deepbots: 1\nname: Line\n{typed}")[1] if finding.code == "DB107"
    )
    assert empty.span.text == key
    assert help in (empty.help or "")


def test_the_sections_that_a_new_file_lacks_are_one_finding_that_says_how_to_begin(check: Check) -> None:
    (lacking,) = check("deepbots: 1\nname: Line\nworld: {timestep: 20 ms}\n")[1]
    assert lacking.headline == "missing keys `robots`, `action`, `observation`, `reward` at the top level"
    assert lacking.help is not None
    assert lacking.help.startswith("`robots`: the robots")
    assert [note.partition(":")[0] for note in lacking.notes] == ["`action`", "`observation`", "`reward`"]


def test_digits_grouped_the_german_way_are_shown_what_a_whole_number_is(check: Check, cartpole: str) -> None:
    (finding,) = check(cartpole.replace("total_timesteps: 100_000", "total_timesteps: 100.000"))[1]
    assert finding.code == "DB103"
    assert "Example: `total_timesteps: 100_000`" in (finding.help or "")


def test_every_section_has_its_path_and_that_of_its_defaults(check: Check, cartpole: str) -> None:
    scenario, _ = check(cartpole)
    assert scenario is not None
    robot = next(iter(scenario.robots))
    assert scenario.path == ()
    assert scenario.world.ground.path == ("world", "ground")
    assert scenario.messages.to_robot.path == ("messages", "to_robot")
    assert {sensor.path for sensor in scenario.robots[robot].sensors.values()} == {
        ("robots", robot, "sensors", name) for name in scenario.robots[robot].sensors
    }
