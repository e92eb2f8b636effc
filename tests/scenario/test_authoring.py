"""A scenario may be written in Python: a mistake is raised at once, and the scenario compiles as the file
does.

The JSON Schema for editors agrees with the models.

The shipped scenarios, and what the compiler may rely on in the models.

A mistake in a scenario has one finding, in plain words, at its place.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from pydantic import ValidationError

import deepbots_cli
from deepbots_cli import Scenario
from deepbots_cli.compiler.agents import divide, has_several_agents
from deepbots_cli.diagnostics import Finding, Findings, Source
from deepbots_cli.document import Document, descend, load, to_data
from deepbots_cli.document.load import LEVELS_OF_NAMES
from deepbots_cli.document.parse import parse
from deepbots_cli.engine_kinds import ENGINES
from deepbots_cli.errors import ScenarioError
from deepbots_cli.scenario import validate, visit_values
from deepbots_cli.scenario.actuators import ACTUATORS, VelocityMotor
from deepbots_cli.scenario.base import Forms, MappingOf, Section, section_fields, unit_of, walk_sections
from deepbots_cli.scenario.documentation import key_description
from deepbots_cli.scenario.fields import Pattern, Reference
from deepbots_cli.scenario.json_schema import FILE_NAME, definition_of, json_schema, schema_text
from deepbots_cli.scenario.objects import OBJECTS
from deepbots_cli.scenario.quantities import Expression, Quantity, Range, count_literal, read_schedule
from deepbots_cli.scenario.sensors import SENSORS
from deepbots_cli.scenario.terrains import TERRAINS
from deepbots_cli.scenario.training import ALGORITHMS, AUTO
from deepbots_cli.scenario.world import Arena, World
from tests.files import written
from tests.golden.cases import mistakes

ROOT = Path(__file__).parents[2]
SAMPLES = sorted(ROOT.glob("scenarios/*.yaml"))


def cartpole(**changes: Any) -> Scenario:
    sections: dict[str, Any] = {
        "deepbots": 1,
        "name": "Built",
        "world": World(timestep="32 ms", arena=Arena(size="1 1 m")),
        "robots": {
            "cart": {
                "urdf": "cartpole",
                "sensors": {"pole": {"type": "joint_position", "joint": "pole_hinge"}},
                "actuators": {
                    "wheels": VelocityMotor(type="velocity_motor", joints=["wheel_*"], max_torque="10 N*m")
                },
                "emit": ["pole"],
                "apply": {"wheels": "drive * 5 rad/s"},
            }
        },
        "action": {"drive": {"choices": {"forward": 1, "backward": -1}}},
        "observation": {"cart.pole": "-20 .. 20 deg"},
        "reward": {"alive": 1},
        "termination": {"failure": {"fallen": "abs(cart.pole) > 15 deg"}},
        "truncation": {"max_steps": 200},
    }
    return Scenario(**sections | changes)


@pytest.mark.parametrize(
    ("changes", "place", "message"),
    [
        ({"wurld": {}}, ("wurld",), "not permitted"),
        ({"world": {"timestep": 0.032j}}, ("world", "timestep"), "expected a duration"),
        ({"world": {"timestep": "10 parsec"}}, ("world", "timestep"), "unknown unit `parsec`"),
        ({"world": {"timestep": "10 kg"}}, ("world", "timestep"), "not a duration"),
        ({"world": {"timestep": "32 * (ms"}}, ("world", "timestep"), "parenthesis"),
        ({"world": {"timestep": "32 ms", "substeps": 4.5}}, ("world", "substeps"), "expected a whole number"),
        (
            {"world": {"timestep": "32 ms", "terrain": {"type": "hills"}}},
            ("world", "terrain", "type"),
            "unknown type `hills`",
        ),
        (
            {"world": {"timestep": "32 ms", "ground": {}, "terrain": {"type": "pit", "height": "1 m"}}},
            ("world", "terrain"),
            "be combined",
        ),
        ({"truncation": {}}, ("truncation",), "missing key `max_steps` or `max_time`"),
        ({"reward": {"alive": "1 +"}}, ("reward", "alive"), ""),
        ({"reward": {}}, ("reward",), "is empty"),
    ],
)
def test_a_mistake_is_raised_at_once_with_its_place(
    changes: dict[str, Any], place: tuple[str, ...], message: str
) -> None:
    with pytest.raises(ValidationError) as caught:
        cartpole(**changes)
    (error,) = caught.value.errors()
    assert error["loc"] == place
    assert message in error["msg"]


def test_a_scenario_cannot_be_changed() -> None:
    with pytest.raises(ValidationError):
        cartpole().name = "Other"


def test_a_mistake_that_only_the_whole_scenario_shows_is_a_finding_at_its_line() -> None:
    with pytest.raises(ScenarioError, match=r"<Scenario Built>:\d+:\d+: DB402"):
        deepbots_cli.compile(cartpole(reward={"alive": "2 * nothing"}))


def test_the_copy_of_a_scenario_in_python_has_the_name_of_a_file_on_every_system() -> None:
    name, *_ = deepbots_cli.compile(cartpole()).inputs
    assert name == "Scenario Built.yaml"


def test_without_agents_the_sections_of_one_agent_are_required() -> None:
    with pytest.raises(ValidationError, match="reward"):
        Scenario(**cartpole().model_dump(exclude_unset=True, exclude={"reward"}))


def test_a_file_with_mistakes_is_not_read(tmp_path: Path) -> None:
    file = written(tmp_path / "broken.yaml", "deepbots: 1\nname: Broken\n")
    with pytest.raises(ScenarioError, match="missing keys"):
        Scenario.from_yaml(file)


def test_a_file_with_a_mistake_in_an_expression_is_not_read(tmp_path: Path) -> None:
    file = written(tmp_path / "broken.yaml", "deepbots: 1\nextends: cartpole\nparameters: {reach: 1 m kg}\n")
    with pytest.raises(ScenarioError, match=r"broken.yaml:3:\d+: DB401 an operator is missing"):
        Scenario.from_yaml(file)


def test_files_that_only_a_case_or_a_stage_names_are_found_from_anywhere(tmp_path: Path) -> None:
    (tmp_path / "cart.urdf").write_text((ROOT / "robots/urdf/cartpole.urdf").read_text())
    file = written(
        tmp_path / "two.yaml",
        "deepbots: 1\nextends: cartpole\nevaluation: {cases: {same: {set: {robots.cart.urdf: cart.urdf}}}}\n"
        "curriculum: [{name: first, set: {robots.cart: {urdf: cart.urdf}}, until: 9 steps}, {name: last}]\n",
    )
    scenario = Scenario.from_yaml(file)
    assert scenario.evaluation.cases["same"].set == {"robots.cart.urdf": str(tmp_path / "cart.urdf")}
    assert scenario.stages[0].set == {"robots.cart": {"urdf": str(tmp_path / "cart.urdf")}}


def test_the_json_schema_of_the_model_is_the_one_for_editors() -> None:
    assert Scenario.model_json_schema()["title"] == "deepbots scenario"


COMMITTED = ROOT / "schemas" / FILE_NAME
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
    monkeypatch.setattr(ENGINES, "_all", None)
    assert COMMITTED.read_text(encoding="utf-8") == schema_text(), (
        "run: python -m deepbots_cli.scenario.json_schema"
    )


def test_the_schema_is_a_schema_to_a_checker_of_schemas() -> None:
    """It has copies of the standard's own schemas, and goes to no network for them."""
    committed = json.loads(COMMITTED.read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator.check_schema(committed)
    assert committed["$schema"] == jsonschema.Draft202012Validator.META_SCHEMA["$id"]
    assert committed["$id"] == FILE_NAME


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


BY_NAME = {path.stem: path for path in SAMPLES}


def documents(path: Path) -> list[Document]:
    """The file itself, or the scenario of each of several agents."""
    document = load(path)
    if not has_several_agents(document):
        return [document]
    divided = divide(document)
    assert divided is not None
    return [*divided.documents.values()]


def read(document: Document) -> Scenario:
    assert document.root is not None
    scenario = validate(document.root, document.findings)
    assert [f"{finding.span.location} {finding.headline}" for finding in document.findings] == []
    assert scenario is not None
    return scenario


@pytest.mark.parametrize("path", SAMPLES, ids=lambda path: path.stem)
def test_every_sample_of_the_language_is_valid(path: Path) -> None:
    for document in documents(path):
        assert read(document).deepbots == 1


@pytest.mark.parametrize("path", SAMPLES, ids=lambda path: path.stem)
def test_every_value_that_is_visited_stands_where_its_path_says(path: Path) -> None:
    for document in documents(path):
        assert document.root is not None
        visited = list(visit_values(read(document)))
        for place, kind, value in visited:
            node, _, depth = descend(document.root, place)
            assert depth == len(place), (place, kind)
            if isinstance(kind, (Quantity, Expression, Range)):
                assert node.value == value  # type: ignore[union-attr]
        assert len(visited) > 40


def test_the_visit_hands_out_kinds_with_what_they_mean() -> None:
    visited = {
        (place, type(kind)): (kind, value)
        for place, kind, value in visit_values(read(load(BY_NAME["cartpole"])))
    }
    assert visited[("world", "timestep"), Quantity] == (
        Quantity("time", minimum=0, exclusive=True, usual_unit="ms"),
        "32 ms",
    )
    assert visited[("reward", "alive"), Expression] == (Expression("reward"), 1)
    assert visited[("observation", "speed"), Range] == (
        Range("any", auto=True, vector=True),
        "-0.8 .. 0.8 m/s",
    )
    assert visited[("observation", "speed"), Reference] == (Reference("value"), "speed")
    assert visited[("robots", "cart", "actuators", "wheels", "joints", 0), Reference] == (
        Reference("joints"),
        "wheel_*",
    )
    assert visited[("reset", "joints", "cart.pole_hinge"), Quantity] == (
        Quantity("angle or length", known="episode"),
        "uniform(-1 .. 1 deg)",
    )


def test_extends_merges_as_names_of_users_what_the_models_take_as_names() -> None:
    def levels(shape: object) -> int:
        match shape:
            case MappingOf(value=value):
                return 1 + levels(value)
            case Forms(options=options):
                return max(map(levels, options))
            case _:
                return 0

    sections = {section for _, section, _ in walk_sections(Scenario) if isinstance(section, type)}
    fields = [field for section in sections for field in section_fields(section).items()]
    taken = {key: levels(shape) for key, shape in fields if levels(shape)}
    assert taken == LEVELS_OF_NAMES


def test_patterns_of_links_are_visited_as_keys() -> None:
    places = {
        place: value
        for place, kind, value in visit_values(read(load(BY_NAME["quadruped"])))
        if kind == Pattern("link")
    }
    assert places == {
        ("robots", "dog", "links", "trunk"): "trunk",
        ("robots", "dog", "links", "*_toe"): "*_toe",
    }


def test_the_hyperparameters_of_a_training_are_those_that_were_given() -> None:
    training = read(load(BY_NAME["pit_escape"])).train
    assert training is not None
    assert dict(training.hyperparameters) == {
        "learning_rate": 1e-3,
        "n_steps": 64,
        "gamma": 0.98,
        "gae_lambda": 0.95,
        "batch_size": 128,
    }
    assert training.network.hidden == (60, 60)


def test_every_key_has_a_sentence_for_the_editor() -> None:
    sections = {section for _, section, _ in walk_sections(Scenario) if isinstance(section, type)}
    assert len(sections) > 50
    for section in sections:
        for key in section.model_fields:
            assert key_description(section, key).endswith("."), f"{section.__name__}.{key}"


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("1 1 m", 2),
        ("0 0 -9.81 m/s^2", 3),
        ("0.6 -0.4 m", 2),
        ("88 %", 1),
        ("1e-3", 1),
        ("1 1 scale", None),
        ("a + 1", None),
        ("-top .. top", None),
    ],
)
def test_a_literal_is_numbers_with_one_unit(text: str, count: int | None) -> None:
    assert count_literal(text) == count


def test_a_schedule_is_read_into_its_ends() -> None:
    assert (read_schedule("3e-4 -> 0"), read_schedule(0.5)) == ((3e-4, 0.0), (0.5, 0.5))
    assert [
        read_schedule(text) for text in ("high -> low", "3 ->", "1 -> 2 -> 3", "", "0x10", True, 10**400)
    ] == [None] * 7


def test_reading_a_scenario_needs_no_simulator_and_no_numbers_library() -> None:
    heavy = "numpy pybullet mujoco torch gymnasium stable_baselines3 difflib"
    code = (
        f"import sys, deepbots_cli.scenario; print([name for name in {heavy.split()} if name in sys.modules])"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"


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
    assert (list(cart.sensors), cart.actuators, scenario.reward) == (["pole_angle"], {}, {"pay": 2})
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


def test_every_section_has_its_path_and_that_of_its_defaults(check: Check, cartpole: str) -> None:
    scenario, _ = check(cartpole)
    assert scenario is not None
    robot = next(iter(scenario.robots))
    assert (scenario.path, scenario.world.ground.path) == ((), ("world", "ground"))
    assert scenario.messages.to_robot.path == ("messages", "to_robot")
    assert {sensor.path for sensor in scenario.robots[robot].sensors.values()} == {
        ("robots", robot, "sensors", name) for name in scenario.robots[robot].sensors
    }
