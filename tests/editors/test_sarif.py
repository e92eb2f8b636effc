"""What `--format sarif` writes, against the schema of the standard; `make editors` says where that is."""

from __future__ import annotations

import json
import os
from pathlib import Path

import jsonschema
import pytest

from deepbots_cli import api
from deepbots_cli.cli.commands.lint import Format, report
from deepbots_cli.diagnostics import Finding
from tests.golden.cases import write

pytestmark = pytest.mark.editors


@pytest.fixture(scope="session")
def schema() -> jsonschema.Draft7Validator:
    place = os.environ.get("SARIF_SCHEMA")
    if place is None:
        pytest.skip("`make editors` installs the schema and runs this")
    return jsonschema.Draft7Validator(json.loads(Path(place).read_text(encoding="utf-8")))


def sarif(findings: list[Finding]) -> object:
    return json.loads(report(findings, Format.sarif, (), ("error",)))


def test_every_mistake_of_the_golden_cases_becomes_valid_sarif(
    schema: jsonschema.Draft7Validator, tmp_path: Path
) -> None:
    (tmp_path / "deepbots.toml").touch()
    findings = [
        finding
        for path in sorted(write(tmp_path / "golden").glob("lint/err/*.yaml"))
        for finding in api.lint(path, preview=True)
    ]
    assert len(findings) > 200
    assert [error.message for error in schema.iter_errors(sarif(findings))] == []


def test_no_findings_become_valid_sarif(schema: jsonschema.Draft7Validator) -> None:
    assert [error.message for error in schema.iter_errors(sarif([]))] == []
