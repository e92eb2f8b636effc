"""The JSON Schema for one scenario has its names, even when the file is damaged."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from deepbots_cli import api
from deepbots_cli.compiler.inventory import scenario_names
from deepbots_cli.diagnostics import Findings, Source
from deepbots_cli.document import to_data
from deepbots_cli.document.parse import parse
from deepbots_cli.scenario.json_schema import json_schema, schema_text
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
        assert faults(schema, data(path.read_text(encoding="utf-8"))) == []
        assert faults(schema, to_data(checked.document.root)) == []


def test_its_own_schema_is_a_schema_and_the_same_on_every_run() -> None:
    schema = schema_text(scenario_names(api.load("cartpole")))
    jsonschema.Draft202012Validator.check_schema(json.loads(schema))
    assert schema == schema_text(scenario_names(api.load("cartpole")))


def test_joints_are_listed_with_their_type_and_limits(own: Own) -> None:
    joints = listed(own(CARTPOLE), "JointSensor.cart", "joint")
    assert list(joints) == JOINTS
    assert joints["wheel_rear_left"] == "continuous"
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
    assert descriptions["fall_angle"] == "a parameter: 15 deg"
    assert descriptions["fallen"] == "an ending"
    assert {"x", "cart.pole_angle", "time"} <= set(descriptions)


def test_each_robot_has_its_own_names(own: Own) -> None:
    two = CARTPOLE.replace("robots:\n", "robots:\n  rolling: {urdf: rover}\n")
    schema = own(two)
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
