"""The JSON Schema for editors agrees with the models."""

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from deepbots_cli.diagnostics import Findings, Source
from deepbots_cli.document import load, to_data
from deepbots_cli.document.parse import parse
from deepbots_cli.scenario import Scenario
from deepbots_cli.scenario.actuators import ACTUATORS
from deepbots_cli.scenario.base import Section, section_fields, unit_of
from deepbots_cli.scenario.json_schema import FILE_NAME, definition_of, json_schema, schema_text
from deepbots_cli.scenario.sensors import SENSORS
from deepbots_cli.scenario.training import ALGORITHMS, AUTO
from deepbots_cli.scenario.walk import walk_sections
from deepbots_cli.scenario.world import OBJECTS, TERRAINS
from tests.golden.cases import mistakes

ROOT = Path(__file__).parents[2]
COMMITTED = ROOT / "schemas" / FILE_NAME
SAMPLES = sorted(ROOT.glob("scenarios/*.yaml"))
CARTPOLE = (ROOT / "scenarios" / "cartpole.yaml").read_text(encoding="utf-8")

Json = dict[str, Any]
Step = str | int


@pytest.fixture(scope="module")
def schema() -> Json:
    """The schema as an editor reads it: sections share equal keys by reference, here they are copied."""
    written = json_schema()
    for section in written["$defs"].values():
        keys = section.get("properties", {})
        for key, value in keys.items():
            if "/properties/" in value.get("$ref", ""):
                _, _, home, _, shared = value["$ref"].split("/")
                keys[key] = written["$defs"][home]["properties"][shared]
    return written


@pytest.fixture(scope="module")
def validator(schema: Json) -> jsonschema.Draft202012Validator:
    return jsonschema.Draft202012Validator(schema)


def data(text: str) -> object:
    root = parse(Source("cartpole.yaml", text), Findings())
    assert root is not None
    return to_data(root)


def subschemas(node: object, path: tuple[Step, ...] = ()) -> Iterator[tuple[tuple[Step, ...], Json]]:
    """Every mapping within a schema, with its path, without those that only distinguish forms (`if`,
    `not`)."""
    if isinstance(node, dict):
        yield path, node
        for key, value in node.items():
            if key not in ("if", "not"):
                yield from subschemas(value, (*path, key))
    elif isinstance(node, list):
        for index, value in enumerate(node):
            yield from subschemas(value, (*path, index))


def properties(schema: Json) -> Iterator[tuple[str, Json]]:
    """The path of every key that is described somewhere, with its description."""
    for path, node in subschemas(schema):
        if path[-2:-1] == ("properties",) and path[-3:-2] != ("properties",):
            described = schema["$defs"]["include"] if node.get("$ref") == "#/$defs/include" else node
            yield "/".join(map(str, path)), described


SECTIONS = list(
    dict.fromkeys(section for _, section, _ in walk_sections(Scenario) if isinstance(section, type))
)


def test_the_committed_schema_is_up_to_date(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        sys, "path", [folder for folder in sys.path if Path(folder).name != "exact"]
    )  # an engine of the tests
    assert COMMITTED.read_text(encoding="utf-8") == schema_text(), (
        "run: python -m deepbots_cli.scenario.json_schema"
    )


def test_the_schema_is_a_schema_to_a_checker_of_schemas() -> None:
    """It has copies of the standard's own schemas, and goes to no network for them."""
    command = [sys.executable, "-m", "check_jsonschema", "--check-metaschema", str(COMMITTED)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    assert json_schema()["$id"] == FILE_NAME


@pytest.mark.slow
def test_a_checker_on_the_command_line_accepts_all_scenarios() -> None:
    command = [sys.executable, "-m", "check_jsonschema", "--schemafile", str(COMMITTED), *map(str, SAMPLES)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


def test_the_schema_is_written_the_same_on_every_run() -> None:
    assert schema_text() == schema_text()


@pytest.mark.parametrize("path", SAMPLES, ids=lambda path: path.stem)
def test_editors_accept_every_sample_as_it_is_written(
    validator: jsonschema.Draft202012Validator, path: Path
) -> None:
    root = parse(Source(path.name, path.read_text(encoding="utf-8")), Findings())
    assert root is not None
    assert [error.message for error in validator.iter_errors(to_data(root))] == []


@pytest.mark.parametrize("path", SAMPLES, ids=lambda path: path.stem)
def test_editors_accept_every_sample_with_all_that_it_includes(
    validator: jsonschema.Draft202012Validator, path: Path
) -> None:
    root = load(path).root
    assert root is not None
    assert [error.message for error in validator.iter_errors(to_data(root))] == []


def test_every_key_says_what_it_is_and_shows_an_example(schema: Json) -> None:
    silent = [
        path
        for path, described in properties(schema)
        if f"Example: {path.rpartition('/')[2]}: " not in described.get("description", "")
    ]
    assert silent == []
    assert sum(1 for _ in properties(schema)) > 500


@pytest.mark.parametrize("section", SECTIONS, ids=lambda section: section.__name__)
def test_every_quantity_says_its_unit(schema: Json, section: type[Section]) -> None:
    declared = schema["$defs"][definition_of(section).__name__]["properties"]
    assert [
        key
        for key, shape in section_fields(section).items()
        if bool(unit_of(shape)) != ("Unit: " in declared[key]["description"])
    ] == []


@pytest.mark.parametrize(
    ("section", "key", "part"),
    [
        ("World", "timestep", "Unit: s. Required. Example: timestep: 32 ms"),
        ("Arena", "wall_height", "Unit: m. Default: 0.1 m. Example: wall_height: 20 cm"),
        ("PositionMotor", "stiffness", "Unit: N*m/rad or N/m. Example: stiffness: 40 N*m/rad"),
        ("World", "light", "Unit: none, a plain number. Default: 1.0."),
        ("JointSensor", "noise", "Unit: of the sensor. Default: 0. Example: noise: 2 %"),
        ("Wall", "closed", "Default: false. Example: closed: true"),
    ],
)
def test_a_description_has_unit_default_and_example(schema: Json, section: str, key: str, part: str) -> None:
    assert part in schema["$defs"][section]["properties"][key]["description"]


def test_the_schema_is_small_enough_for_editors() -> None:
    assert len(schema_text()) < 240_000


def test_kinds_are_distinguished_by_conditions_and_never_by_trial(schema: Json) -> None:
    """An editor shows the problems of every branch of `oneOf` and `anyOf` over mappings."""
    assert [path for path, node in subschemas(schema) if "oneOf" in node] == []
    tried = [node["anyOf"] for _, node in subschemas(schema) if "anyOf" in node]
    assert all(any("enum" in form for form in forms) for forms in tried)
    assert not any(form.keys() & {"$ref", "properties", "required"} for forms in tried for form in forms)


@pytest.mark.parametrize(
    ("key", "kinds"),
    [
        ("type", SENSORS),
        ("type", ACTUATORS),
        ("type", TERRAINS),
        ("shape", OBJECTS),
        ("algorithm", [*ALGORITHMS, AUTO]),
    ],
    ids=["sensors", "actuators", "terrains", "objects", "algorithms"],
)
def test_every_kind_is_listed_and_has_its_condition(schema: Json, key: str, kinds: dict[str, object]) -> None:
    nodes = [
        node
        for _, node in subschemas(schema)
        if node.get("properties", {}).get(key, {}).get("enum") == list(kinds)
    ]
    assert nodes
    for node in nodes:
        conditions = [
            branch["if"]["properties"][key]["const"]
            for branch in node["allOf"]
            if key in branch["if"].get("properties", {})
        ]
        assert conditions == list(kinds)
        descriptions = node["properties"][key]["enumDescriptions"]
        assert len(set(descriptions)) == len(kinds)
        assert all(sentence.endswith(".") for sentence in descriptions)


@pytest.mark.parametrize("line", ["total_timesteps: 100_000", "learning_rate: 1_000", "n_steps: 1_024"])
def test_numbers_in_groups_of_three_which_editors_take_for_text_are_not_a_mistake(
    validator: jsonschema.Draft202012Validator, line: str
) -> None:
    scenario: Any = data(CARTPOLE)
    key, number = line.split(": ")
    scenario["train"][key] = number
    assert [error.message for error in validator.iter_errors(scenario)] == []


@pytest.mark.parametrize(
    ("old", "new", "place"), [pytest.param(*row[1:], id=row[0]) for row in mistakes("schema")]
)
def test_a_fault_is_reported_once_and_in_its_place(
    validator: jsonschema.Draft202012Validator, old: str, new: str, place: list[Step]
) -> None:
    assert old in CARTPOLE
    places = [
        tuple(error.absolute_path) for error in validator.iter_errors(data(CARTPOLE.replace(old, new, 1)))
    ]
    assert places == [tuple(place)]


def test_a_file_that_extends_another_may_leave_out_anything(
    validator: jsonschema.Draft202012Validator,
) -> None:
    changes = {
        "deepbots": 1,
        "extends": "cartpole.yaml",
        "robots": {"cart": {"sensors": {"pole_angle": {"noise": "0.2 deg"}}}},
    }
    assert [error.message for error in validator.iter_errors(changes)] == []


def test_a_file_of_its_own_lacks_no_section(validator: jsonschema.Draft202012Validator) -> None:
    scenario: Any = data(CARTPOLE)
    del scenario["world"]
    assert [error.message for error in validator.iter_errors(scenario)] == ["'world' is a required property"]


def test_a_file_that_is_included_may_bring_what_is_missing(
    validator: jsonschema.Draft202012Validator,
) -> None:
    scenario: Any = data(CARTPOLE)
    scenario["world"] = {"include": "world.yaml", "substeps": 8}
    scenario["robots"]["cart"]["sensors"]["pole_angle"] = {"include": "sensor.yaml"}
    assert [error.message for error in validator.iter_errors(scenario)] == []


def test_no_path_of_this_machine_is_in_the_schema() -> None:
    assert str(ROOT) not in schema_text()
    assert json.loads(schema_text()) == json_schema()
