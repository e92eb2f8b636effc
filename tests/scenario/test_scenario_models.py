"""The shipped scenarios, and what the compiler may rely on in the models."""

import subprocess
import sys
from pathlib import Path

import pytest

from deepbots_cli.compiler.agents import divide, has_several_agents
from deepbots_cli.document import Document, descend, load
from deepbots_cli.scenario import Scenario, validate, visit_values
from deepbots_cli.scenario.documentation import key_description
from deepbots_cli.scenario.fields.names import Pattern, Reference
from deepbots_cli.scenario.fields.quantities import Expression, Quantity, Range, count_literal
from deepbots_cli.scenario.fields.training import read_schedule
from deepbots_cli.scenario.walk import walk_sections

ROOT = Path(__file__).parents[2]
SAMPLES = sorted(ROOT.glob("scenarios/*.yaml"))
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
    assert read_schedule("3e-4 -> 0") == (3e-4, 0.0)
    assert read_schedule(0.5) == (0.5, 0.5)
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
