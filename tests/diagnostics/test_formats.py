"""Findings for other programs: workflow commands, SARIF and reports of tests."""

from __future__ import annotations

import json
from pathlib import Path
from urllib.parse import unquote
from xml.etree import ElementTree

import jsonschema
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepbots_cli.diagnostics import Finding, Label, Source, Span
from deepbots_cli.diagnostics.findings import Fix
from deepbots_cli.diagnostics.junit import junit
from deepbots_cli.diagnostics.render import github, render, sarif
from deepbots_cli.lint.pages import pages_of

SARIF = Path(__file__).with_name("sarif.json")
"""What SARIF 2.1.0 requires of the objects that deepbots writes; any other property is an error."""
VALID = jsonschema.Draft7Validator(json.loads(SARIF.read_text(encoding="utf-8")))


def page(code: str) -> tuple[str, str]:
    (only,) = pages_of(code)
    return only.text(), only.markdown()


def finding(
    text: str = "world:\n  tmiestep: 32 ms\n", marked: str = "tmiestep", name: str = "a.yaml", **more: object
) -> Finding:
    start = text.index(marked)
    return Finding(
        "DB101", Span(Source(name, text), start, start + len(marked)), "the key is not known", **more
    )  # type: ignore[arg-type]


def warning(name: str = "a.yaml") -> Finding:
    return Finding("DB003", Span(Source(name, "a: on\n"), 3, 5), "`on` is text")


def sarif_of(findings: list[Finding]) -> dict[str, object]:
    log = json.loads(sarif(findings, page))
    VALID.validate(log)
    (run,) = log["runs"]
    assert isinstance(run, dict)
    return run


def test_a_workflow_shows_the_finding_at_its_line_with_its_code_and_help() -> None:
    assert github([finding(help="write `timestep`")]) == (
        "::error title=DB101 unknown-key,file=a.yaml,line=2,endLine=2,col=3,endColumn=11::the key is not"
        " known%0Ahelp: write `timestep`\n"
    )


def test_a_workflow_is_given_errors_first_since_it_shows_only_ten() -> None:
    output = github([warning("a.yaml"), finding(name="b.yaml"), warning("c.yaml"), finding(name="d.yaml")])
    assert output.index("b.yaml") < output.index("d.yaml") < output.index("a.yaml") < output.index("c.yaml")


def test_a_workflow_is_given_no_columns_for_a_place_over_several_lines() -> None:
    output = github([Finding("DB101", Span(Source("a.yaml", "a:\n  b\n"), 0, 6), "x")])
    assert output.startswith("::error title=DB101 unknown-key,file=a.yaml,line=1,endLine=2::")


def test_nothing_from_a_file_becomes_a_workflow_command_of_its_own() -> None:
    evil = "x\n::set-output name=a::b\r::stop-commands::y"
    hostile = Finding(
        "DB101", Span(Source("a,line=9::b%\n.yaml", "a"), 0, 1), f"100 % {evil}", help=evil, notes=(evil,)
    )
    output = github([hostile])
    assert output.count("\n") == 1
    assert "\r" not in output
    assert "file=a%2Cline=9%3A%3Ab%25\\u{a}.yaml,line=1," in output
    assert "::100 %25 x" in output


def test_sarif_has_a_result_for_each_finding_and_describes_the_rules() -> None:
    run = sarif_of([warning(), finding(help="did you mean `timestep`?"), finding(name="b.yaml")])
    results = run["results"]
    rules = run["tool"]["driver"]["rules"]  # type: ignore[index]
    assert [(result["ruleId"], result["level"]) for result in results] == [
        ("DB003", "warning"),
        ("DB101", "error"),
        ("DB101", "error"),
    ]
    assert [rules[result["ruleIndex"]]["id"] for result in results] == ["DB003", "DB101", "DB101"]
    assert results[1]["message"]["text"] == "the key is not known\nhelp: did you mean `timestep`?"
    place = results[1]["locations"][0]["physicalLocation"]
    assert place["artifactLocation"]["uri"] == "a.yaml"
    assert place["region"] == {"startLine": 2, "startColumn": 3, "endLine": 2, "endColumn": 11}
    assert rules[1]["defaultConfiguration"]["level"] == "error"
    assert rules[1]["properties"]["tags"] == ["shape"]
    assert "timestep: 50 ms" in rules[1]["help"]["markdown"]
    assert "```yaml" in rules[1]["help"]["markdown"]


def test_sarif_without_findings_is_a_run_with_no_results() -> None:
    assert sarif_of([])["results"] == []


def test_sarif_has_the_fix_of_a_finding_as_replacements() -> None:
    plain = finding()
    fixed = finding(
        fix=Fix.replacing(plain.span, "tmiestep", "timestep", safe=True), help="did you mean `timestep`?"
    )
    ((fix,),) = [result["fixes"] for result in sarif_of([fixed])["results"]]  # type: ignore[attr-defined]
    ((change,),) = [fix["artifactChanges"]]
    assert change["artifactLocation"]["uri"] == "a.yaml"
    assert change["replacements"] == [
        {
            "deletedRegion": {"startLine": 2, "startColumn": 3, "endLine": 2, "endColumn": 11},
            "insertedContent": {"text": "timestep"},
        }
    ]
    assert fix["properties"] == {"safe": True}
    assert json.loads(render([fixed], "json"))["findings"][0]["fix"] == {
        "safe": True,
        "edits": [
            {
                "file": "a.yaml",
                "start": {"line": 2, "column": 3},
                "end": {"line": 2, "column": 11},
                "text": "timestep",
            }
        ],
    }


def test_sarif_names_further_places_and_the_files_that_included_this_one() -> None:
    main = Source("main.yaml", "include: b.yaml")
    part = Source("b.yaml", "a: 1\na: 2\n", Span(main, 9, 15))
    duplicate = Finding(
        "DB002", Span(part, 5, 6), "given twice", labels=(Label(Span(part, 0, 1), "first defined here"),)
    )
    (result,) = sarif_of([duplicate])["results"]  # type: ignore[attr-defined]
    related = [
        (place["message"]["text"], place["physicalLocation"]["artifactLocation"]["uri"])
        for place in result["relatedLocations"]
    ]
    assert related == [("first defined here", "b.yaml"), ("included from here", "main.yaml")]


def test_a_file_below_the_working_directory_is_named_from_there_in_every_format(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    findings = [finding(name=str(tmp_path / "my worlds" / "a.yaml"))]
    assert "file=my worlds/a.yaml," in github(findings)
    assert "my%20worlds/a.yaml" in sarif(findings, page)
    assert 'file="my worlds/a.yaml"' in junit(findings, [], ("error",))
    elsewhere = finding(name="/elsewhere/a.yaml")
    assert '"file:///elsewhere/a.yaml"' in sarif([elsewhere], page)


def test_a_report_of_tests_has_a_suite_for_each_file_and_a_case_for_each_finding() -> None:
    root = ElementTree.fromstring(
        junit([warning(), finding(), finding(name="b.yaml")], ["c.yaml", "a.yaml"], ("error",))
    )
    assert root.attrib["tests"] == "4"
    assert root.attrib["failures"] == "2"
    suites = {suite.attrib["name"]: suite for suite in root}
    assert list(suites) == ["a.yaml", "b.yaml", "c.yaml"]
    assert [case.attrib["name"] for case in suites["a.yaml"]] == [
        "DB003 yaml11-boolean at 1:4: `on` is text",
        "DB101 unknown-key at 2:3: the key is not known",
    ]
    assert [[part.tag for part in case] for case in suites["a.yaml"]] == [["system-out"], ["failure"]]
    assert suites["a.yaml"][1][0].attrib == {"type": "DB101", "message": "the key is not known"}
    assert [(case.attrib["name"], len(case)) for case in suites["c.yaml"]] == [("no findings", 0)]


def test_two_findings_of_one_code_at_one_place_are_two_cases_of_a_report() -> None:
    span = Span(Source("a.yaml", "a: 1\n"), 0, 4)
    missing = [Finding("DB102", span, f"missing key `{key}`") for key in ("name", "world")]
    (suite,) = ElementTree.fromstring(junit(missing, ["a.yaml"], ("error",)))
    assert len({case.attrib["name"] for case in suite}) == 2


def test_a_warning_is_a_failure_of_a_report_where_warnings_fail() -> None:
    root = ElementTree.fromstring(junit([warning()], ["a.yaml"], ("error", "warning")))
    assert root.attrib["failures"] == "1"
    assert root[0][0][0].tag == "failure"


@settings(max_examples=30)
@given(
    st.text(max_size=60),
    st.integers(0, 60),
    st.integers(0, 60),
    st.text(max_size=20),
    st.text(min_size=1, max_size=20),
)
def test_any_text_whatever_makes_reports_that_programs_can_read(
    text: str, one: int, two: int, headline: str, name: str
) -> None:
    start, end = sorted((min(one, len(text)), min(two, len(text))))
    source = Source(name, text)
    reported = Finding(
        "DB101",
        Span(source, start, end),
        f"x{headline}",
        headline,
        (Label(Span(source, 0, start), headline),),
        (headline,),
    )
    assert github([reported]).count("\n") == 1
    ElementTree.fromstring(junit([reported], [name], ("error",)))
    (result,) = sarif_of([reported])["results"]  # type: ignore[attr-defined]
    uri = result["locations"][0]["physicalLocation"]["artifactLocation"]["uri"]
    assert Path(unquote(uri.removeprefix("file://"))) == Path(name) or "\\" in name or "\0" in name
