"""The JSON Schema for editors says what the models say."""

import json
from pathlib import Path

import jsonschema
import pytest

from deepbots_cli.diagnostics import Findings, Source
from deepbots_cli.schema.export import FILE_NAME, json_schema, to_text
from deepbots_cli.source import load, to_data
from deepbots_cli.source.parse import parse

ROOT = Path(__file__).parents[2]
SAMPLES = sorted(ROOT.glob("scenarios/*.yaml"))


@pytest.fixture(scope="module")
def validator() -> jsonschema.Draft202012Validator:
    return jsonschema.Draft202012Validator(json_schema())


def test_the_committed_schema_is_up_to_date() -> None:
    committed = (ROOT / "schemas" / FILE_NAME).read_text(encoding="utf-8")
    assert committed == to_text(), "run: python -m deepbots_cli.schema.export"


def test_the_schema_is_a_schema() -> None:
    jsonschema.Draft202012Validator.check_schema(json_schema())
    assert json_schema()["$id"] == FILE_NAME


def test_the_schema_is_written_the_same_on_every_run() -> None:
    assert to_text() == to_text()


@pytest.mark.parametrize("path", SAMPLES, ids=lambda path: path.stem)
def test_editors_accept_every_sample_as_it_is_written(validator: jsonschema.Draft202012Validator, path: Path) -> None:
    root = parse(Source(path.name, path.read_text(encoding="utf-8")), Findings())
    assert root is not None
    assert [error.message for error in validator.iter_errors(to_data(root))] == []


@pytest.mark.parametrize("path", SAMPLES, ids=lambda path: path.stem)
def test_editors_accept_every_sample_with_all_that_it_includes(validator: jsonschema.Draft202012Validator, path: Path) -> None:
    root = load(path).root
    assert root is not None
    assert [error.message for error in validator.iter_errors(to_data(root))] == []


def test_no_path_of_this_machine_is_in_the_schema() -> None:
    assert str(ROOT) not in to_text()
    assert json.loads(to_text()) == json_schema()
