"""A rule or the compiler that raises an exception on one file: a finding of that file, and everything else is
linted all the same."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import pytest

from deepbots_cli import api
from deepbots_cli.diagnostics import Finding
from deepbots_cli.diagnostics import Source as SourceText
from deepbots_cli.lint import run
from deepbots_cli.lint.context import RuleContext, Simulation, rule
from deepbots_cli.lsp.server import diagnostics
from deepbots_cli.lsp.workspace import Document, analyze
from deepbots_cli.rollout.source import Source


@rule("DB801")
def breaking(context: RuleContext) -> Iterator[Finding]:
    """Fails on the scenario that is named Broken."""
    if context.program.name == "Broken":
        raise IndexError("tuple index\nout of range")
    yield from ()


@rule("DB702")
def breaking_too(simulation: Simulation) -> Iterator[Finding]:
    """Fails on every scenario."""
    raise KeyError(simulation.checked.document.path.name)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two scenarios, each with a warning; a rule fails on the first."""
    (tmp_path / "a.yaml").write_text(scenario("Broken"))
    (tmp_path / "b.yaml").write_text(scenario("Whole"))
    monkeypatch.setattr(run, "STATIC_RULES", (breaking, *run.STATIC_RULES))
    return tmp_path


def scenario(name: str) -> str:
    text = (
        Source.open("cartpole")
        .path.read_text(encoding="utf-8")
        .replace("../robots/urdf/cartpole.urdf", "cartpole")
    )
    return text.replace("name: CartPole", f"name: {name}") + "\nsignals: {spare: abs(x)}\n"


def test_a_rule_that_fails_hides_neither_other_findings_nor_other_files(deepbots, folder) -> None:
    ran = deepbots("lint", ".", "--format", "concise", code=3)
    rows = [line.split()[:3] for line in ran.out.splitlines()]
    assert rows == [
        ["a.yaml:1:1:", "error", "DB903[rule-failed]"],
        [rows[1][0], "warning", "DB205[unused-definition]"],
        [rows[1][0].replace("a.", "b."), "warning", "DB205[unused-definition]"],
    ]
    assert "the rule DB801 failed on this file: IndexError: tuple index out of range" in ran.out
    assert re.search(r" \(deepbots_cli\.lint\.run:\d+\)", ran.out), "the innermost place in deepbots"
    assert "Traceback" not in ran.out + ran.err


@pytest.mark.parametrize(
    "words", [("--select", "DB7"), ("--ignore", "DB903"), ("--exit-zero",), ("--jobs", "2")]
)
def test_no_option_hides_a_rule_that_failed(deepbots, folder, words) -> None:
    ran = deepbots("lint", ".", *words, code=3)
    assert "DB903" in ran.out


def test_those_who_debug_get_the_exception_of_a_rule(deepbots, folder, monkeypatch) -> None:
    monkeypatch.setenv("DEEPBOTS_DEBUG", "1")
    with pytest.raises(IndexError):
        deepbots("lint", "a.yaml")


def test_every_format_reports_a_rule_that_failed_at_the_start_of_the_file(deepbots, folder) -> None:
    (finding, _) = json.loads(deepbots("lint", "a.yaml", "--json", code=3).out)["findings"]
    assert finding["code"] == "DB903"
    assert finding["severity"] == "error"
    assert finding["start"] == {"line": 1, "column": 1}
    assert "report this message" in finding["help"]
    assert deepbots("lint", "a.yaml", "--format", "github", code=3).out.startswith(
        "::error title=DB903 rule-failed,file=a.yaml,line=1,"
    )
    (run,) = json.loads(deepbots("lint", "a.yaml", "--format", "sarif", code=3).out)["runs"]
    assert [(result["ruleId"], result["level"]) for result in run["results"]] == [
        ("DB903", "error"),
        ("DB205", "warning"),
    ]
    report = ElementTree.fromstring(deepbots("lint", "a.yaml", "--format", "junit", code=3).out)
    assert (report.get("errors"), report.get("failures")) == ("1", "0")
    assert [error.get("type") for error in report.iter("error")] == ["DB903"]


def test_an_exception_of_the_compiler_on_one_file_is_a_finding_of_it(deepbots, folder, monkeypatch) -> None:
    load = api.load
    monkeypatch.setattr(api, "load", lambda name, **options: load(name, **options) if "b" in name else 1 // 0)
    ran = deepbots("lint", ".", "--format", "concise", code=3)
    assert ran.out.startswith(
        "a.yaml:1:1: error DB903[rule-failed] the compiler failed on this file: ZeroDivisionError"
    )
    assert "b.yaml" in ran.out


def test_a_scenario_on_which_a_rule_fails_still_compiles(folder) -> None:
    compiled = api.compile(folder / "a.yaml")
    assert [finding.code for finding in compiled.findings] == ["DB903", "DB205"]


def test_an_editor_shows_a_rule_that_failed_beside_the_other_findings(folder) -> None:
    path = folder / "a.yaml"
    document = Document(path.as_uri(), 1, path.read_text(encoding="utf-8"), path)
    (diagnostic, _) = diagnostics(analyze(document, {}), {})[path.as_uri()]
    assert diagnostic.code == "DB903"
    assert diagnostic.range.start.line == 0
    assert diagnostic.range.start.character == 0


@pytest.mark.slow
def test_a_rule_that_fails_after_a_simulation_does_not_hide_what_the_others_measure(
    deepbots, folder, monkeypatch
) -> None:
    monkeypatch.setattr(run, "SIMULATED_RULES", (breaking_too, *run.SIMULATED_RULES))
    ran = deepbots(
        "lint",
        "b.yaml",
        "--deep",
        "--preview",
        "--set",
        "observation={cart.pole_angle: -20 .. 20 deg, x: 5 .. 6 m}",
        code=3,
    )
    assert "the rule DB702 failed on this file: KeyError: 'b.yaml'" in ran.out
    assert "DB611" in ran.out


def test_the_message_of_an_exception_is_cut(folder, monkeypatch) -> None:
    from deepbots_cli.diagnostics.findings import exception_finding

    assert (
        len(
            exception_finding(
                "the rule DB801", SourceText("a.yaml", ""), ValueError("long " * 10_000)
            ).headline
        )
        < 300
    )
