"""The JSON Schema for one scenario has its names, even when the file is damaged.

Whatever is written, the schema answers with findings that have a place.

The search spaces of `tune`: how they are written, and which values are refused.
"""

from __future__ import annotations

import copy
import inspect
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from deepbots_cli import api
from deepbots_cli.compiler import CheckedScenario
from deepbots_cli.compiler.inventory import scenario_names
from deepbots_cli.diagnostics import Finding, Findings, Source
from deepbots_cli.document import load, to_data
from deepbots_cli.document.parse import parse
from deepbots_cli.scenario import Scenario
from deepbots_cli.scenario.json_schema import json_schema, schema_text
from deepbots_cli.scenario.search import SearchSpace
from deepbots_cli.scenario.training import ALGORITHMS, SET_ELSEWHERE_HELP, Training
from tests.few import every
from tests.fuzz.mutations import case
from tests.fuzz.workbench import Workbench
from tests.golden.cases import mistakes

ROOT = Path(__file__).parents[2]
SAMPLES = sorted(ROOT.glob("scenarios/*.yaml"))
UNUSUAL = sorted(ROOT.glob("tests/golden/lint/ok/*.yaml"))
CARTPOLE = (
    (ROOT / "scenarios" / "cartpole.yaml")
    .read_text(encoding="utf-8")
    .replace("../robots/urdf/cartpole.urdf", "cartpole")
)
JOINTS = ["wheel_front_left", "wheel_front_right", "wheel_rear_left", "wheel_rear_right", "pole_hinge"]

Step = str | int
Json = dict[str, Any]
Own = Callable[[str], Json]


@pytest.fixture
def own(tmp_path: Path) -> Own:
    """The schema for a text."""

    def of(text: str) -> Json:
        file = tmp_path / "mine.yaml"
        file.write_text(text, encoding="utf-8")
        return json_schema(scenario_names(api.load(file)))

    return of


def data(text: str) -> Any:
    root = parse(Source("mine.yaml", text), Findings())
    assert root is not None
    return to_data(root)


def faults(schema: Json, scenario: object) -> list[tuple[Step, ...]]:
    return [
        tuple(error.absolute_path) for error in jsonschema.Draft202012Validator(schema).iter_errors(scenario)
    ]


def listed(schema: Json, definition: str, key: str) -> dict[str, str]:
    """The names that are listed for a key, with the description of each."""
    described = schema["$defs"][definition]["properties"][key]
    forms = [
        form
        for form in (
            described,
            *described.get("anyOf", ()),
            *described.get("propertyNames", {}).get("anyOf", ()),
        )
        if "enum" in form
    ]
    return {
        name: about
        for form in forms
        for name, about in zip(form["enum"], form["enumDescriptions"], strict=True)
    }


@pytest.mark.parametrize("path", every(15, [*SAMPLES, *UNUSUAL], lambda path: path.stem))
def test_every_right_scenario_fits_its_own_schema_and_the_general_one(path: Path) -> None:
    checked = api.load(path)
    assert checked.document.root is not None
    for schema in (json_schema(scenario_names(checked)), json_schema()):
        assert (
            faults(schema, data(path.read_text(encoding="utf-8"))),
            faults(schema, to_data(checked.document.root)),
        ) == ([], [])


def test_its_own_schema_is_a_schema_and_the_same_on_every_run() -> None:
    schema = schema_text(scenario_names(api.load("cartpole")))
    jsonschema.Draft202012Validator.check_schema(json.loads(schema))
    assert schema == schema_text(scenario_names(api.load("cartpole")))


def test_joints_are_listed_with_their_type_and_limits(own: Own) -> None:
    joints = listed(own(CARTPOLE), "JointSensor.cart", "joint")
    assert (list(joints), joints["wheel_rear_left"]) == (JOINTS, "continuous")
    assert joints["pole_hinge"].startswith("revolute, -1.")


@pytest.mark.parametrize(
    ("definition", "key", "names"),
    [
        ("VelocityMotor.cart", "joints", {"pole_hinge", "wheel_rear_left"}),
        ("LinkSensor.cart", "link", {"pole", "tip"}),
        ("Robot.cart", "links", {"pole", "tip"}),
        ("Robot.cart", "joints", {"pole_hinge"}),
        ("Robot.cart", "apply", {"wheels"}),
        ("Scenario", "observation", {"cart.pole_angle", "speed", "tip_speed", "previous_action"}),
        ("Reset", "joints", {"cart.pole_hinge", "cart.wheel_rear_left"}),
        ("Reset", "place", {"cart"}),
        ("Disturbance", "body", {"cart", "cart.pole"}),
        ("Stage", "set", {"fall_angle", "track", "wheel_speed"}),
        ("JointSensor.cart", "latency", set()),
        ("ContinuousAction", "each", {"cart.wheels"}),
    ],
)
def test_names_are_listed_where_they_may_stand(own: Own, definition: str, key: str, names: set[str]) -> None:
    assert names <= set(listed(own(CARTPOLE), definition, key))
    assert names or not listed(own(CARTPOLE), definition, key)


def test_expressions_are_offered_the_names_that_they_may_use(own: Own) -> None:
    schema = own(CARTPOLE)
    reward = schema["$defs"]["Scenario"]["properties"]["reward"]["additionalProperties"]["anyOf"][0]
    descriptions = dict(zip(reward["enum"], reward["enumDescriptions"], strict=True))
    assert (descriptions["fall_angle"], descriptions["fallen"]) == ("a parameter: 15 deg", "an ending")
    assert {"x", "cart.pole_angle", "time"} <= set(descriptions)


def test_each_robot_has_its_own_names(own: Own) -> None:
    schema = own(CARTPOLE.replace("robots:\n", "robots:\n  rolling: {urdf: rover}\n"))
    assert "pole_hinge" not in listed(schema, "JointSensor.rolling", "joint")
    assert set(listed(schema, "JointSensor.cart", "joint")) == set(JOINTS)


def test_a_robot_that_is_added_later_is_not_a_mistake(own: Own) -> None:
    later = CARTPOLE.replace(
        "robots:\n",
        "robots:\n  rolling: {urdf: rover, sensors: {turn: {type: joint_position, joint: other}}}\n",
    )
    assert faults(own(CARTPOLE), data(later)) == []


def test_names_that_are_added_later_are_not_a_mistake(own: Own) -> None:
    later = CARTPOLE.replace("    apply: {", "    emit: [pole_angle, turn]\n    apply: {").replace(
        "  cart.pole", "  cart.turn: auto\n  cart.pole"
    )
    assert faults(own(CARTPOLE), data(later)) == []


@pytest.mark.parametrize(
    ("old", "new", "place"), [pytest.param(*row[1:], id=row[0]) for row in mistakes("own_schema")]
)
def test_a_fault_is_reported_once_and_in_its_place(own: Own, old: str, new: str, place: list[Step]) -> None:
    assert old in CARTPOLE
    assert faults(own(CARTPOLE), data(CARTPOLE.replace(old, new, 1))) == [tuple(place)]


@pytest.mark.parametrize(
    "patterns",
    [
        "wheel_*",
        "'*_left'",
        "wheel_?????_left",
        "'wheel_[fr]*'",
        "[wheel_front_left, 'wheel_rear_*']",
        "[rear]",
        "rear",
    ],
)
def test_patterns_and_groups_are_not_a_mistake(own: Own, patterns: str) -> None:
    text = CARTPOLE.replace("    apply:", "    groups: {rear: [wheel_rear_*]}\n    apply:").replace(
        "[wheel_*]", patterns
    )
    assert faults(own(text), data(text)) == []


def test_a_group_of_links_is_no_link(own: Own) -> None:
    text = CARTPOLE.replace("    apply:", "    groups: {ends: [tip]}\n    apply:")
    schema = own(text)
    taken = [key for key in ("link", "links") if "ends" in listed(schema, "Touch.cart", key)]
    assert (taken, "cart.ends" in listed(schema, "Disturbance", "body")) == (["links"], False)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "robots: [",
        "deepbots: 1",
        "deepbots: 1\nrobots: {cart: {urdf: nowhere}}",
        "deepbots: 1\nrobots: {cart: 3, wagon: {urdf: cartpole}}\nobservation: 4",
        "deepbots: 9\nrobots: {cart: {urdf: cartpole}}",
        "extends: nowhere.yaml",
        "deepbots: 1\nparameters: {a: b, b: a, c: 3 parsecs}\nrobots: {cart: {urdf: cartpole, groups: {all:"
        " [none]}}}",
        'deepbots: 1\nparameters: {a: "\\ud800", b: "\\x00"}\nrobots: {"\\u202e": {urdf: cartpole}}',
        "a: &a [*a]",
        CARTPOLE.replace("cartpole\n", "cartpole\n    groups: {}\n    poses: 3\n"),
    ],
    ids=range(11),
)
def test_of_a_broken_file_what_can_be_read_is_listed(own: Own, text: str) -> None:
    schema = own(text)
    assert json.dumps(schema).encode()
    assert faults(schema, data(CARTPOLE)) == []


def test_a_joint_that_does_not_exist_leaves_the_others_listed(own: Own) -> None:
    schema = own(CARTPOLE.replace("joint: pole_hinge", "joint: pole_hing"))
    assert list(listed(schema, "JointSensor.cart", "joint")) == JOINTS


def test_where_a_robot_could_not_be_read_the_names_of_all_are_not_a_mistake(own: Own) -> None:
    schema = own(CARTPOLE.replace("robots:\n", "robots:\n  other: {urdf: nowhere}\n"))
    later = CARTPOLE.replace("cart.pole_hinge: uniform", "other.hinge: uniform")
    assert faults(schema, data(later)) == []


def test_more_names_than_anyone_reads_are_not_listed(own: Own) -> None:
    text = CARTPOLE.replace("signals:", "").replace(
        "  track:", "".join(f"  p{i}: {i} m\n" for i in range(600)) + "  track:"
    )
    assert listed(own(text), "Stage", "set") == {}


@pytest.mark.slow
def test_whatever_became_of_a_file_what_has_no_error_fits_its_schema(tmp_path: Path) -> None:
    """Damaged files, as `make fuzz` lints them: every one gets a schema, and an editor marks nothing that the
    compiler takes."""
    sound = 0
    with Workbench(tmp_path):
        for number in range(80):
            damaged = case(number)
            whole = damaged.file.read_bytes()
            damaged.file.write_bytes(damaged.data)
            checked = api.load(damaged.main)
            schema = json_schema(scenario_names(checked))
            if not checked.findings.errors and checked.document.root is not None:
                sound += 1
                assert faults(schema, to_data(checked.document.root)) == [], number
                assert faults(json_schema(), data(damaged.main.read_text(encoding="utf-8"))) == [], number
            damaged.file.write_bytes(whole)
    assert sound > 5


Check = Callable[[str], tuple[Scenario | None, list[Finding]]]
Place = tuple[str | int, ...]

FILES = sorted(ROOT.glob("scenarios/*.yaml"))
SAMPLE_DATA: list[Any] = [to_data(root) for path in FILES if (root := load(path).root) is not None]
VALIDATOR = jsonschema.Draft202012Validator(json_schema())

ODD_SCALARS = st.sampled_from(
    [0, -1, 3, 1.5, True, "", "x", "1 m", "1 2 3 m", "0 .. 1", "[key]", "type", "list", "a when b"]
) | st.text(max_size=8)
ODD_KEYS = st.sampled_from(
    ["type", "shape", "map", "[key]", "list", "0", "include", "range", "choices", "one_of", "joint"]
) | st.text(max_size=6)
ODD = st.recursive(
    ODD_SCALARS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(ODD_KEYS, inner, max_size=3),
    max_leaves=6,
)


def places(data: Any, path: Place = ()) -> Iterator[Place]:
    yield path
    if isinstance(data, dict):
        for key, value in data.items():
            yield from places(value, (*path, key))
    elif isinstance(data, list):
        for index, value in enumerate(data):
            yield from places(value, (*path, index))


PLACES = [[place for place in places(sample) if place] for sample in SAMPLE_DATA]


def at(data: Any, path: Place) -> Any:
    for step in path:
        data = data[step]
    return data


@st.composite
def mutated(
    draw: st.DrawFn, values: st.SearchStrategy[Any], changes: int = 3, insert: bool = True
) -> tuple[Any, list[Place]]:
    number = draw(st.integers(0, len(SAMPLE_DATA) - 1))
    data = copy.deepcopy(SAMPLE_DATA[number])
    changed = []
    for _ in range(draw(st.integers(1, changes))):
        place = draw(st.sampled_from(PLACES[number]))
        try:
            holder = at(data, place[:-1])
            holder[place[-1]]
        except (KeyError, IndexError, TypeError):
            continue  # an earlier change took it away
        if not isinstance(holder, (dict, list)):
            continue
        what = draw(st.sampled_from(["delete", "replace", "insert"])) if insert else "replace"
        if what == "delete":
            del holder[place[-1]]
        elif what == "insert" and isinstance(holder, dict):
            holder[draw(ODD_KEYS)] = draw(values)
        else:
            holder[place[-1]] = draw(values)
        changed.append(place)
    return data, changed


@given(case=mutated(st.sampled_from([True, [[]], {"odd": 3}, 0, "x"]), changes=1, insert=False))
def test_one_wrong_value_is_one_finding(check: Check, case: tuple[Any, list[Place]]) -> None:
    data, _ = case
    _, findings = check(json.dumps(data))
    # Beside an unknown key, all that is required there is missing as well.
    assert len([finding for finding in findings if finding.code != "DB102"]) <= 1, [
        finding.headline for finding in findings
    ]


@given(case=mutated(ODD, changes=1))
def test_what_an_editor_marks_is_a_finding_too(check: Check, case: tuple[Any, list[Place]]) -> None:
    data, _ = case
    assume(not VALIDATOR.is_valid(data))
    _, findings = check(json.dumps(data))
    assert findings


def with_search(search: str) -> CheckedScenario:
    return api.load("cartpole", overrides=[f"tune.search={{{search}}}"], tests=True)


def spaces(search: str) -> dict[str, SearchSpace]:
    checked = with_search(search)
    assert list(checked.findings) == []
    return dict(checked.search)


def test_a_range_has_units_and_a_logarithm():
    search = "fall_angle: 10..20deg, track: 30 cm .. 0.39 m, train.learning_rate: 1e-4..1e-2:log"
    assert spaces(search) == {
        "fall_angle": SearchSpace(low=10, high=20, unit="deg"),
        "track": SearchSpace(low=0.3, high=0.39, unit="m"),
        "train.learning_rate": SearchSpace(low=1e-4, high=1e-2, log=True),
    }


@pytest.mark.parametrize("search", ["track: 7 mm .. 39 cm", "fall_angle: 0.5 deg .. 1 rad"])
def test_the_low_end_in_another_unit_than_the_high_end_is_a_value_of_the_space(search: str):
    (space,) = spaces(search).values()
    assert space.value_of(space.text(space.low)) == space.low


def test_a_key_of_whole_numbers_gets_whole_numbers_and_any_other_key_fractions():
    by_key = spaces("train.n_epochs: 5 .. 20, train.ent_coef: 0 .. 1")
    assert [space.whole for space in by_key.values()] == [True, False]
    assert [space.text(value) for space, value in zip(by_key.values(), (7.0, 0.12345), strict=True)] == [
        "7",
        "0.123",
    ]


def test_choices_are_written_with_bars_or_as_a_list():
    by_key = spaces(
        "train.network.activation: tanh | relu, train.network.hidden: [[10, 10], [64, 64]], train.gamma:"
        " [0.9, 0.99]"
    )
    assert [space.choices for space in by_key.values()] == [
        ("tanh", "relu"),
        ("[10, 10]", "[64, 64]"),
        ("0.9", "0.99"),
    ]


def test_a_value_is_rounded_and_stays_in_its_range():
    space = SearchSpace(low=0.99996, high=0.99998, unit="m")
    assert [space.text(value) for value in (0.99996, 0.999973456, 0.99998)] == [
        "0.99996 m",
        "0.99997346 m",
        "0.99998 m",
    ]
    assert SearchSpace(low=1e-5, high=1e-2, log=True).text(0.000123456) == "0.0001235"
    assert SearchSpace(low=0, high=10).text(0.005, is_exact=True) == "0.005"


def test_a_text_of_the_scenario_is_a_value_of_the_space_or_none():
    assert SearchSpace(low=10, high=20, unit="deg").value_of("15 deg") == 15
    assert SearchSpace(choices=("0.005", "1e-3")).value_of("5e-3") == "0.005"
    assert SearchSpace(choices=("10 deg", "on")).value_of("off") is None
    space = SearchSpace(low=0.1, high=0.5, unit="m")
    assert list(map(space.value_of, ("39 cm", "0.7 m", "uniform(0.1 .. 0.2 m)"))) == [0.39, None, None]
    assert SearchSpace(choices=("tanh", "relu")).value_of("relu") == "relu"


@pytest.mark.parametrize(("search", "finding"), mistakes("search"))
def test_a_space_that_cannot_be_searched_is_a_finding(search: str, finding: str):
    assert [f"{found.code} {found.headline}" for found in with_search(search).findings] == [finding]


def test_a_run_keeps_the_scenario_without_the_search():
    compiled = api.compile(with_search("fall_angle: 10 .. 20 deg"))
    assert "tune" not in compiled.resolved
    assert compiled.digest == api.compile("cartpole").digest


# The table of hyperparameters says what the learning libraries take


EXCLUDED = {
    "self",
    "policy",
    "env",
    "verbose",
    "device",
    "seed",
    "tensorboard_log",
    "policy_kwargs",
    "_init_setup_model",
    "optimize_memory_usage",
} | {f"{kind}_buffer_{what}" for kind in ("rollout", "replay") for what in ("class", "kwargs")}
OURS = {"replay", "lstm", "init_std"}
"""Hyperparameters that are arguments of other classes of the library."""


def signature(algorithm: str) -> inspect.Signature:
    library = "sb3_contrib" if algorithm in ("MaskablePPO", "RecurrentPPO", "TQC") else "stable_baselines3"
    return inspect.signature(getattr(pytest.importorskip(library), algorithm).__init__)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_the_table_has_what_the_algorithm_takes(algorithm: str) -> None:
    assert (
        set(ALGORITHMS[algorithm].hyperparameter_names()) - OURS
        == set(signature(algorithm).parameters) - EXCLUDED
    )


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_the_defaults_of_the_algorithm_may_be_written(algorithm: str, check: Check, cartpole: str) -> None:
    parameters = signature(algorithm).parameters
    own = {
        name: parameters[name].default
        for name in ALGORITHMS[algorithm].hyperparameter_names()
        if name not in OURS
    }
    train = {"algorithm": algorithm, "total_timesteps": 1000} | {
        name: value for name, value in own.items() if value is not None
    }
    text = (
        "\n".join(line for line in cartpole.splitlines() if not line.startswith("train:"))
        + f"\ntrain: {json.dumps(train)}\n"
    )
    scenario, findings = check(text)
    assert [finding.headline for finding in findings] == []
    assert scenario is not None
    assert isinstance(scenario.train, Training)
    assert set(scenario.train.hyperparameters) == set(train) - {"algorithm", "total_timesteps"}


def test_what_is_said_elsewhere_is_not_a_hyperparameter() -> None:
    assert not [
        name
        for name in SET_ELSEWHERE_HELP
        if any(name in model.model_fields for model in ALGORITHMS.values())
    ]


@pytest.mark.parametrize(
    ("algorithm", "entry", "sound"),
    [
        ("SAC", "ent_coef: auto_0.1", True),
        ("SAC", "ent_coef: often", False),
        ("PPO", "ent_coef: auto", False),
        ("SAC", "train_freq: 1 episode", True),
        ("SAC", "train_freq: 0", False),
        ("TD3", "action_noise: {type: ornstein_uhlenbeck, sigma: 0.5 -> 0.1}", True),
        ("TD3", "action_noise: {type: pink, sigma: 0.5}", False),
        ("SAC", "replay: her", True),
        ("SAC", "replay: {type: her, n_sampled_goal: 8}", True),
        ("SAC", "replay: hers", False),
        ("PPO", "clip_range: 0.2 -> 0.1", True),
        ("PPO", "gamma: 98 %", True),
        ("PPO", "gamma: 101 %", False),
        ("PPO", "gamma: 98", False),
        ("PPO", "learning_rate: -1e-3", False),
        ("PPO", "learning_rate: 1e-3 -> -1", False),
    ],
)
def test_hyperparameters_are_checked_by_their_kind(
    check: Check, cartpole: str, algorithm: str, entry: str, sound: bool
) -> None:
    _, findings = check(cartpole.replace("algorithm: PPO,", f"algorithm: {algorithm}, {entry},"))
    assert (not findings) == sound
    assert len(findings) <= 1


def test_a_percentage_becomes_a_number(check: Check, cartpole: str) -> None:
    scenario, _ = check(cartpole.replace("algorithm: PPO,", "algorithm: PPO, gamma: 57 %,"))
    assert scenario is not None
    assert scenario.train is not None
    assert scenario.train.hyperparameters["gamma"] == 0.57


def test_an_assignment_of_a_key_that_stands_elsewhere_names_its_place() -> None:
    (finding,) = api.load("cartpole", overrides=["train.hidden=8"]).findings.errors
    assert finding.help == "write `--set train.network.hidden=8`"
