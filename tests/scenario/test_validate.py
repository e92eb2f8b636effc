"""What is wrong with a scenario is said once, in our words, at the place where it is."""

import re
from collections.abc import Callable

import pytest

from deepbots_cli.diagnostics import Finding
from deepbots_cli.scenario import Scenario

Check = Callable[[str], tuple[Scenario | None, list[Finding]]]

# What is replaced, by what; then the code, the text that is marked, the headline, a piece of the help.
FAULTS = [
    # unknown keys
    (
        "  timestep: 32 ms",
        "  timstep: 32 ms",
        "DB101",
        "timstep",
        "unknown key `timstep` in `world`",
        "did you mean `timestep`?",
    ),
    (
        "name: C",
        "timestep: 1 s\nname: C",
        "DB101",
        "timestep",
        "unknown key `timestep` at the top level",
        "write `  timestep: 1 s` below `world:` (line 9)",
    ),
    (
        "name: C",
        "agents: {}\nname: C",
        "DB101",
        "agents",
        "unknown key `agents` at the top level",
        "not supported yet",
    ),
    ("PPO,", "PPO, gama: 0.9,", "DB101", "gama", "unknown key `gama` in `train`", "did you mean `gamma`?"),
    ("PPO,", "PPO, tau: 0.9,", "DB101", "tau", "unknown key `tau` in `train`", "only `DQN`, `SAC`"),
    ("PPO,", "PPO, seed: 1,", "DB101", "seed", "unknown key `seed` in `train`", "--seed 1"),
    (
        "joint: pole_hinge",
        "joint: p, rays: 3",
        "DB101",
        "rays",
        "unknown key `rays` in `pole_angle`",
        "only `infrared`, `sonar`",
    ),
    (
        "joint: pole_hinge",
        "joint: p, joints: q",
        "DB101",
        "joints",
        "`joints` cannot be combined with `joint`",
        "keep one",
    ),
    (
        "x:               -0.4 .. 0.4 m",
        "x: {range: 0 .. 1 m, histori: 2}",
        "DB101",
        "histori",
        "unknown key `histori` in `x`",
        "`history`",
    ),
    # missing keys
    ("deepbots: 1\n", "", "DB102", "name: CartPole", "missing key `deepbots` at the top level", "version"),
    (
        "reward:\n  alive: 1\n",
        "",
        "DB102",
        "deepbots: 1",
        "missing key `reward` at the top level",
        "terms of the reward",
    ),
    (
        "  timestep: 32 ms\n",
        "",
        "DB102",
        "world",
        "missing key `timestep` in `world`",
        "duration of one control step",
    ),
    ("type: joint_position, ", "", "DB102", "pole_angle", "missing key `type` in `pole_angle`", "`gyro`"),
    (
        "joints: [wheel_*], ",
        "",
        "DB102",
        "wheels",
        "missing key `joint` or `joints` in `wheels`",
        "write one",
    ),
    (
        "{max_steps: 200}",
        "{}",
        "DB102",
        "truncation",
        "missing key `max_steps` or `max_time` in `truncation`",
        "write one",
    ),
    # wrong types
    (
        "substeps: 4",
        "substeps: many",
        "DB103",
        "many",
        "expected a whole number, found the text `many`",
        "physics steps",
    ),
    (
        "substeps: 4",
        "substeps: true",
        "DB103",
        "true",
        "expected a whole number, found the truth value `true`",
        None,
    ),
    (
        "joints: [wheel_*]",
        "joints: 5",
        "DB103",
        "5",
        "expected a list of joint names, found the number `5`",
        None,
    ),
    (
        "joints: [wheel_*]",
        "joints: [w, 5]",
        "DB103",
        "5",
        "expected the name of a joint, found the number `5`",
        None,
    ),
    (
        "emit: [pole_angle]",
        "emit: x",
        "DB103",
        "x",
        "expected a list of sensor names or a mapping, found the text `x`",
        None,
    ),
    (
        "size: 1 1 m",
        "size: [1, 1]",
        "DB103",
        "[1, 1]",
        "expected a length with 2 components, found a list",
        "in one text: `1 1 m`",
    ),
    (
        "alive: 1",
        "alive:1",
        "DB103",
        "alive:1",
        "expected a mapping, found the text `alive:1`",
        "put a space after the colon: `alive: 1`",
    ),
    (
        "x:               -0.4 .. 0.4 m",
        "x: [-0.4, 0.4]",
        "DB103",
        "[-0.4, 0.4]",
        "expected a mapping or a range, found a list",
        "write `-0.4 .. 0.4`, or `auto`",
    ),
    ("alive: 1", "alive: [1]", "DB103", "[1]", "expected a mapping or an expression, found a list", None),
    (
        "{wheels: drive * wheel_speed}",
        "{wheels: [1, 2]}",
        "DB103",
        "[1, 2]",
        "expected an expression, found a list",
        "one actuator for each joint",
    ),
    (
        "fallen:    abs(cart.pole_angle) > fall_angle",
        "fallen: 3",
        "DB103",
        "3",
        "expected a condition, found the number `3`",
        "`abs(x) > 0.4 m`",
    ),
    (
        "drive: {choices: {forward: 1, backward: -1}}",
        "drive: 3",
        "DB103",
        "3",
        "expected a range, found the number `3`",
        "`-1 .. 1`",
    ),
    (
        "-0.8 .. 0.8 m/s",
        "0.8 m/s",
        "DB103",
        "0.8 m/s",
        "expected a range, found the text `0.8 m/s`",
        "or `auto`",
    ),
    (
        "urdf: ../robots/urdf/cartpole.urdf",
        "urdf: 3",
        "DB103",
        "3",
        "expected the path of a robot file, found the number `3`",
        "shipped",
    ),
    (
        "{type: joint_position, joint: pole_hinge}",
        "5",
        "DB103",
        "5",
        "expected a mapping, found the number `5`",
        "{type: joint_position}",
    ),
    (
        "PPO,",
        "PPO, gamma: high,",
        "DB103",
        "high",
        "expected a number from 0 to 1, found the text `high`",
        "`0.9`",
    ),
    (
        "PPO,",
        "PPO, learning_rate: 1 to 0,",
        "DB103",
        "1 to 0",
        "expected a number or a schedule, found the text `1 to 0`",
        "`3e-4 -> 0`",
    ),
    ("deepbots: 1", "deepbots: one", "DB103", "one", "expected a whole number, found the text `one`", None),
    # unknown words
    (
        "joint_position,",
        "joint_positon,",
        "DB104",
        "joint_positon",
        "unknown type `joint_positon`",
        "did you mean `joint_position`?",
    ),
    ("PPO,", "ppo,", "DB104", "ppo", "unknown algorithm `ppo`", "did you mean `PPO`?"),
    ("csv", "xml", "DB104", "xml", "unknown word `xml`", "known names: `csv`, `json`"),
    ("relu", "rellu", "DB104", "rellu", "unknown word `rellu`", "did you mean `relu`?"),
    # out of range
    (
        "substeps: 4",
        "substeps: 0",
        "DB105",
        "0",
        "`0` is below the smallest allowed value",
        "write at least 1",
    ),
    (
        "friction: 1.0",
        "friction: -1.0",
        "DB105",
        "-1.0",
        "`-1.0` is below the smallest allowed value",
        "write at least 0",
    ),
    (
        "PPO,",
        "PPO, gamma: 1.5,",
        "DB105",
        "1.5",
        "`1.5` is above the largest allowed value",
        "write at most 1",
    ),
    ("  track:", "  m: 1\n  track:", "DB202", "m", "the name `m` is reserved: it is a unit", "another"),
    (
        "  track:",
        "  step: 1\n  track:",
        "DB202",
        "step",
        "the name `step` is reserved: it is built in",
        "another",
    ),
    (
        "  track:",
        "  topSpeed: 1\n  track:",
        "DB105",
        "topSpeed",
        "`topSpeed` cannot be a name",
        "write `top_speed`: a name has only",
    ),
    (
        "name: CartPole",
        "name: Cart/Pole",
        "DB105",
        "Cart/Pole",
        "`Cart/Pole` cannot be the name of a scenario",
        "letters",
    ),
    ("deepbots: 1", "deepbots: 0", "DB105", "0", "`0` is below the smallest allowed value", None),
    (
        "deepbots: 1",
        "deepbots: 2",
        "DB105",
        "2",
        "this file uses version 2 of the language, but this deepbots reads version 1",
        "newer",
    ),
    # wrong length
    ("size: 1 1 m", "size: 1 m", "DB106", "1 m", "expected 2 numbers, found 1", "`0.5 0.5 m`"),
    ("timestep: 32 ms", "timestep: 32 32 ms", "DB106", "32 32 ms", "expected 1 number, found 2", "`32 ms`"),
    (
        "{forward: 1, backward: -1}",
        "{forward: 1}",
        "DB106",
        "{forward: 1}",
        "expected at least 2 choices, found 1",
        None,
    ),
    # empty values
    ("  alive: 1\n", "  alive: ''\n", "DB107", "alive", "`alive` is empty", None),
    ("joints: [wheel_*]", "joints: []", "DB107", "joints", "`joints` is empty", None),
    ("reward:\n  alive: 1\n", "reward: {}\n", "DB107", "reward", "`reward` is empty", "at least 1 term"),
]


@pytest.mark.parametrize(
    ("old", "new", "code", "marked", "headline", "help"),
    FAULTS,
    ids=[f"{f[2]}-{f[1].strip()[:40]}" for f in FAULTS],
)
def test_a_fault_is_said_once_where_it_is(
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


def test_each_body_is_told_by_its_shape(check: Check, cartpole: str) -> None:
    objects = (
        "{ball: {shape: sphere, radius: 1 m}, heap: {count: 3, one_of: {a: {shape: box, size: 1 1 1 m}}}}"
    )
    scenario, findings = check(cartpole + f"objects: {objects}\n")
    assert findings == []
    assert scenario is not None
    assert [type(thing).__name__ for thing in scenario.objects.values()] == ["SphereObject", "VariedObject"]


@pytest.mark.parametrize(
    ("objects", "code", "marked"),
    [
        ("{ball: {shape: spere, radius: 1}}", "DB104", "spere"),
        ("{ball: {radius: 1}}", "DB102", "ball"),
        ("{ball: {shape: box}}", "DB102", "ball"),
        ("{ball: {shape: sphere, radius: 0}}", "DB105", "0"),
        ("{ball: {shape: sphere, radius: 1, color: rot}}", "DB104", "rot"),
        ("{ball: {shape: sphere, radius: 1, count: 1.5}}", "DB103", "1.5"),
        ("{heap: {one_of: {}}}", "DB107", "one_of"),
        ("{heap: {one_of: {a: {shape: box, size: 1 1 1 m, count: 2}}}}", "DB101", "count"),
        ("{ball: {shape: sphere, radius: 1, pose: {x: 1 m, xyz: 1 1 1 m}}}", "DB101", "x"),
    ],
)
def test_faults_of_bodies(check: Check, cartpole: str, objects: str, code: str, marked: str) -> None:
    _, findings = check(cartpole + f"objects: {objects}\n")
    assert [(finding.code, finding.span.text) for finding in findings] == [(code, marked)]


def test_numbers_that_no_machine_can_hold_are_out_of_range(check: Check, cartpole: str) -> None:
    for number in ("1e999", "-1e300", "9" * 400):
        _, findings = check(cartpole.replace("alive: 1", f"alive: {number}"))
        assert [finding.code for finding in findings] == ["DB105"], number


UNFINISHED = [
    # what is typed so far, the key without a value, what its help says
    ("reward:\n", "reward", "Example: `reward: {alive: 1}`"),
    ("reward:\n  near:\n", "near", "write it like `2 * speed`"),
    ("robots:\n  bot:\n    urdf: rover\n    emit:\n", "emit", "Example: `emit: [pole_angle]`"),
    (
        "robots:\n  bot:\n    urdf: rover\n    sensors: {eye: }\n",
        "eye",
        "write it like `{type: joint_position}`",
    ),
    ("world:\n  lines: {track: }\n", "track", "allowed keys: `points`, `closed`, `width`"),
    (
        "robots:\n  bot:\n    urdf: rover\n    sensors:\n      eye:\n        type:\n",
        "type",
        "one of `joint_position`, `joint_velocity`",
    ),
]


@pytest.mark.parametrize(("typed", "key", "help"), UNFINISHED)
def test_a_key_without_a_value_is_told_what_it_takes(check: Check, typed: str, key: str, help: str) -> None:
    (empty,) = (found for found in check(f"deepbots: 1\nname: Line\n{typed}")[1] if found.code == "DB107")
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


def test_every_section_knows_its_path_and_that_of_its_defaults(check: Check, cartpole: str) -> None:
    scenario, _ = check(cartpole)
    assert scenario is not None
    robot = next(iter(scenario.robots))
    assert scenario.path == ()
    assert scenario.world.ground.path == ("world", "ground")
    assert scenario.messages.to_robot.path == ("messages", "to_robot")
    assert {sensor.path for sensor in scenario.robots[robot].sensors.values()} == {
        ("robots", robot, "sensors", name) for name in scenario.robots[robot].sensors
    }
