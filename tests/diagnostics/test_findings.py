"""Findings for other programs: workflow commands, SARIF and reports of tests.

Findings as text: what people and programs read.

Which findings are asked for.

The exceptions: one tree, drawn in the docstring of its module.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import unicodedata
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import unquote
from xml.etree import ElementTree

import jsonschema
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepbots_cli import errors
from deepbots_cli.diagnostics import Finding, Label, Source, Span
from deepbots_cli.diagnostics.findings import Fix, RuleSelectors, Selection, edited, suppress
from deepbots_cli.diagnostics.render import github, junit, render, sarif, summary
from deepbots_cli.errors import DeepbotsError, UsageError
from deepbots_cli.lint.pages import pages_of
from deepbots_cli.program import identity

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
    assert (rules[1]["defaultConfiguration"]["level"], rules[1]["properties"]["tags"]) == ("error", ["shape"])
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
    assert '"file:///elsewhere/a.yaml"' in sarif([finding(name="/elsewhere/a.yaml")], page)


def test_a_report_of_tests_has_a_suite_for_each_file_and_a_case_for_each_finding() -> None:
    root = ElementTree.fromstring(
        junit([warning(), finding(), finding(name="b.yaml")], ["c.yaml", "a.yaml"], ("error",))
    )
    assert (root.attrib["tests"], root.attrib["failures"]) == ("4", "2")
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
    assert (root.attrib["failures"], root[0][0][0].tag) == ("1", "failure")


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


def place(source: Source, text: str) -> Span:
    start = source.text.index(text)
    return Span(source, start, start + len(text))


def finding_at(text: str, marked: str, name: str = "a.yaml", **more: object) -> Finding:
    return Finding("DB101", place(Source(name, text), marked), "the key is not known", **more)  # type: ignore[arg-type]


def test_the_full_form_shows_the_line_and_underlines_the_place() -> None:
    text = render(
        [
            finding_at(
                "world:\n  tmiestep: 32 ms\n", "tmiestep", help="did you mean `timestep`?", notes=("a note",)
            )
        ]
    )
    assert text == (
        "error DB101[unknown-key]: the key is not known\n"
        " --> a.yaml:2:3\n"
        "  |\n"
        "2 |   tmiestep: 32 ms\n"
        "  |   ^^^^^^^^\n"
        "  |\n"
        "  = note: a note\n"
        "  = help: did you mean `timestep`?\n"
        "\n"
    )


def test_further_places_are_shown_in_the_order_of_the_file() -> None:
    source = Source("a.yaml", "name: x\nb: 1\nc: 1\nname: y\n")
    label = Label(Span(source, 0, 4), "first defined here")
    lines = render(
        [Finding("DB002", Span(source, 18, 22), "the key `name` is given twice", labels=(label,))]
    ).splitlines()
    assert lines[1:] == [
        " --> a.yaml:4:1",
        "  |",
        "1 | name: x",
        "  | ---- first defined here",
        "...",
        "4 | name: y",
        "  | ^^^^",
        "  |",
        "",
    ]


def test_a_place_in_another_file_is_shown_apart() -> None:
    other_file = Source("b.yaml", "x: 1")
    text = render([finding_at("y: 1", "y", labels=(Label(Span(other_file, 0, 1), "defined here"),))])
    assert " --> a.yaml:1:1\n" in text
    assert " --> b.yaml:1:1\n" in text
    assert "| - defined here" in text


def test_a_finding_in_an_included_file_shows_the_chain() -> None:
    main = Source("main.yaml", "include: b.yaml")
    middle = Source("b.yaml", "\ninclude: c.yaml", place(main, "b.yaml"))
    text = render([Finding("DB101", Span(Source("c.yaml", "x", place(middle, "c.yaml")), 0, 1), "x")])
    assert [line.strip() for line in text.splitlines()[1:4]] == [
        "--> c.yaml:1:1",
        "included from b.yaml:2:10",
        "included from main.yaml:1:10",
    ]


@pytest.mark.parametrize(
    "text", ["日本語: x", "e\u0301e\u0301: x", "\ta\t: x", "äöü: x", "😀: x", "\u202eabc\u200d: x"]
)
def test_the_underline_stands_below_the_place_whatever_is_before_it(text: str) -> None:
    lines = render([finding_at(text, "x")]).splitlines()

    def column(line: str, sign: str) -> int:
        wide = sum(unicodedata.east_asian_width(c) in "WF" for c in line[: line.index(sign)])
        combining = sum(bool(unicodedata.combining(c)) for c in line[: line.index(sign)])
        return line.index(sign) + wide - combining

    assert column(lines[3], "x") == column(lines[4], "^")
    assert lines[4].endswith("^")


def test_a_place_over_several_lines_is_underlined_to_the_end_of_its_first() -> None:
    source = Source("a.yaml", "a: |\n  one\n  two\n")
    lines = render([Finding("DB101", Span(source, 3, 16), "x")]).splitlines()
    assert lines[3:5] == ["1 | a: |", "  |    ^"]


def test_an_empty_place_gets_one_mark_also_behind_the_last_character() -> None:
    assert "1 | a:\n  |   ^\n" in render([Finding("DB101", Span(Source("a.yaml", "a:"), 2, 2), "x")])
    assert "1 |\n  | ^\n" in render([Finding("DB101", Span(Source("a.yaml", ""), 0, 0), "x")])


@pytest.mark.parametrize("before", [0, 30, 200, 5000])
def test_a_long_line_is_cropped_around_the_place(before: int) -> None:
    text = "a" * before + "XY" + "b" * 5000
    lines = render([finding_at(text, "XY")], width=80).splitlines()
    assert all(len(line) <= 80 for line in lines[2:5])
    start = lines[4].index("^")
    assert lines[3][start : start + 2] == "XY"
    assert lines[4].endswith("^^")


def test_color_changes_nothing_but_the_escapes() -> None:
    import re

    findings = [finding_at("a: 1", "a", help="b", notes=("c",))]
    colored = render(findings, color=True)
    assert "\x1b[1;31m" in colored
    assert re.sub(r"\x1b\[[0-9;]*m", "", colored) == render(findings)


@pytest.mark.parametrize("format", ["full", "concise"])
def test_nothing_from_a_file_is_obeyed_by_the_terminal(format: str) -> None:
    evil = "a: \x1b[2J\x07\u202e\x9b31m"
    hostile = Finding(
        "DB101", place(Source("\x1b]0;x\x07.yaml", evil), "a"), f"bad {evil}", f"help {evil}\n", notes=(evil,)
    )
    text = render([hostile], format)  # type: ignore[arg-type]
    assert not set("\x1b\x07\u202e\x9b").intersection(text)
    assert "\\u{1b}" in text


def test_the_concise_form_is_one_line_that_editors_can_link() -> None:
    unknown_key = finding_at("a:\n  b: 1", "b", help="write\nc")
    assert (
        render([unknown_key], "concise")
        == "a.yaml:2:3: error DB101[unknown-key] the key is not known (write\\u{a}c)\n"
    )


def test_the_json_form_is_versioned_and_complete() -> None:
    source = Source("a.yaml", "é: 1\nb: 2\n")
    reported = Finding(
        "DB003", Span(source, 5, 6), "text", "help", (Label(Span(source, 0, 1), "here"),), ("note",)
    )
    assert json.loads(render([reported], "json")) == {
        "version": 1,
        "findings": [
            {
                "code": "DB003",
                "name": "yaml11-boolean",
                "severity": "warning",
                "message": "text",
                "file": "a.yaml",
                "start": {"line": 2, "column": 1},
                "end": {"line": 2, "column": 2},
                "help": "help",
                "notes": ["note"],
                "also": [
                    {
                        "file": "a.yaml",
                        "start": {"line": 1, "column": 1},
                        "end": {"line": 1, "column": 2},
                        "message": "here",
                    }
                ],
                "fix": None,
            }
        ],
        "counts": {"error": 0, "warning": 1},
    }


def test_no_findings_are_not_text_but_still_json() -> None:
    assert render([]) == render([], "concise") == ""
    assert json.loads(render([], "json")) == {
        "version": 1,
        "findings": [],
        "counts": {"error": 0, "warning": 0},
    }


def test_the_summary_counts_by_severity() -> None:
    error = finding_at("a", "a")
    warning = Finding("DB003", error.span, "x")
    assert (summary([error, error, warning]), summary([warning, warning])) == (
        "2 errors, 1 warning",
        "2 warnings",
    )
    assert summary([]) == "no findings"


@given(
    st.text(max_size=120), st.integers(0, 120), st.integers(0, 120), st.text(max_size=20), st.integers(0, 120)
)
def test_any_place_in_any_text_can_be_drawn(text: str, one: int, two: int, headline: str, width: int) -> None:
    start, end = sorted((min(one, len(text)), min(two, len(text))))
    source = Source("a.yaml", text)
    reported = Finding(
        "DB101",
        Span(source, start, end),
        headline,
        headline,
        (Label(Span(source, 0, start), headline),),
        (headline,),
    )
    assert "^" in render([reported], width=width)
    assert render([reported], "concise").count("\n") == 1
    assert json.loads(render([reported], "json"))["findings"][0]["message"] == headline


def selectors(*words: str, option: str = "--select") -> RuleSelectors:
    return RuleSelectors(words, Source(option, ",".join(words)))


def selected_codes(selection: Selection, *codes: str) -> list[str]:
    findings = [Finding(code, Span(Source("a.yaml", "a"), 0, 1), "x") for code in codes]
    return [finding.code for finding in findings if selection.selects(finding)]


def test_without_a_word_everything_is_shown() -> None:
    assert selected_codes(Selection(), "DB003", "DB504", "DB603") == ["DB003", "DB504", "DB603"]
    assert Selection().selects_all


def test_the_beginning_of_codes_a_code_and_a_name_select() -> None:
    selection = Selection(selectors("DB5", "DB603", "never-true"))
    assert selected_codes(selection, "DB003", "DB504", "DB505", "DB603", "DB611", "DB801", "DB804") == [
        "DB504",
        "DB505",
        "DB603",
        "DB801",
    ]
    assert not selection.selects_all


def test_ignored_findings_are_not_shown() -> None:
    assert selected_codes(Selection(None, selectors("DB5")), "DB003", "DB504") == ["DB003"]


@pytest.mark.parametrize(
    ("select", "ignore", "left"),
    [
        ("DB5", "DB505", ["DB504"]),
        ("DB505", "DB5", ["DB505"]),
        ("implausible-magnitude", "DB5", ["DB505"]),
        ("DB5", "DB5", []),
    ],
)
def test_the_longer_of_two_words_counts_and_ignoring_among_equals(
    select: str, ignore: str, left: list[str]
) -> None:
    assert selected_codes(Selection(selectors(select), selectors(ignore)), "DB504", "DB505") == left


def test_an_error_in_text_or_shape_is_shown_whatever_is_asked_for() -> None:
    selection = Selection(selectors("DB7"), selectors("DB0", "DB101"))
    assert selected_codes(selection, "DB001", "DB003", "DB101", "DB402", "DB702") == [
        "DB001",
        "DB101",
        "DB702",
    ]


def test_case_and_blanks_do_not_matter() -> None:
    assert selected_codes(Selection(selectors(" db5 ")), "DB003", "DB504") == ["DB504"]


@pytest.mark.parametrize(
    ("word", "message"),
    [
        ("DB77", "--select: there is no finding 'DB77'; did you mean DB"),
        ("term-dominate", "did you mean term-dominates?"),
        ("", "there is no finding ''"),
        ("zzzzz", "deepbots explain lists them"),
        (
            "db716",
            "--select: the rule db716 is gone; `deepbots lint --exploits` finds such rewards by playing",
        ),
        ("cycle-pays", "--select: the rule cycle-pays is gone"),
    ],
)
def test_a_word_that_fits_nothing_is_refused(word: str, message: str) -> None:
    with pytest.raises(UsageError) as refused:
        Selection(selectors(word))
    assert message in str(refused.value)


def test_a_selection_of_nothing_is_refused() -> None:
    with pytest.raises(UsageError, match="nothing is selected"):
        Selection(selectors())


def test_a_rule_in_preview_that_is_selected_by_itself_is_noted() -> None:
    (doubt,) = Selection(selectors("DB5", "hidden-state-reward")).inactive_rules()
    assert (doubt.code, doubt.span.location, doubt.span.text) == (
        "DB902",
        "--select:1:5",
        "hidden-state-reward",
    )
    assert "--preview" in (doubt.help or "")


@pytest.mark.parametrize(
    "selection",
    [
        Selection(selectors("DB706"), preview=True),
        Selection(selectors("DB7")),
        Selection(selectors("DB706"), selectors("DB902", option="--ignore")),
        Selection(selectors("DB706"), selectors("DB706", option="--ignore")),
        Selection(None, selectors("DB706", option="--ignore")),
    ],
)
def test_nothing_is_noted_where_previews_run_or_one_is_not_really_selected(selection: Selection) -> None:
    assert selection.inactive_rules() == []


# Suppression comments


def warning_at(source: Source, text: str, code: str = "DB003") -> Finding:
    start = source.text.index(text)
    return Finding(code, Span(source, start, start + len(text)), "a headline")


@pytest.mark.parametrize(
    "text",
    [
        "a: on  # deepbots: ignore[DB003]\n",
        "# deepbots: ignore[DB003]\na: on\n",
        "x:\n  # deepbots: ignore[DB003] as the firmware wants it\n  a: on\n",
        "a: on # the firmware's word  # deepbots: ignore[DB004, DB003]\n",
        "<!-- deepbots: ignore[DB003] -->\n<a on/>\n",
        "<!-- deepbots: ignore[DB003] --><a on/>\n",
        "<!-- deepbots: ignore[DB003] --> <!-- a note -->\r\n<a on/>\r\n",
    ],
)
def test_a_comment_on_the_line_or_above_it_suppresses_a_warning(text: str) -> None:
    source = Source("a.yaml", text)
    kept, unused = suppress([warning_at(source, "on", "DB003")], [source])
    assert kept == []
    assert all(finding.span.text == "DB004" for finding in unused)


@pytest.mark.parametrize(
    ("text", "marked", "headline"),
    [
        (
            "b: 1 # deepbots: ignore[DB003]\na: on\n",
            "DB003",
            "this comment suppresses nothing: there is no DB003 here",
        ),
        (
            "# deepbots: ignore[DB003]\n\na: on\n",
            "DB003",
            "this comment suppresses nothing: there is no DB003 here",
        ),
        (
            "a: on # deepbots: ignore[DB004]\n",
            "DB004",
            "this comment suppresses nothing: there is no DB004 here",
        ),
        (
            "a: on # deepbots: ignore\n",
            "# deepbots: ignore",
            "the comment does not name the code to suppress",
        ),
        (
            "a: on # deepbots: ignore[ ]\n",
            "# deepbots: ignore[ ]",
            "the comment does not name the code to suppress",
        ),
        ("a: on # deepbots: ignore[DB0O3]\n", "DB0O3", "there is no rule `DB0O3`"),
        ("a: on # deepbots: ignore[DB101]\n", "DB101", "DB101 is an error, which cannot be suppressed"),
    ],
)
def test_a_comment_that_suppresses_nothing_is_reported(text: str, marked: str, headline: str) -> None:
    source = Source("a.yaml", text)
    findings = [warning_at(source, "on")]
    kept, unused = suppress(findings, [source])
    assert (kept, [(f.code, f.span.text, f.headline) for f in unused]) == (
        findings,
        [("DB901", marked, headline)],
    )


def test_one_of_two_codes_that_suppresses_nothing_is_removed_alone() -> None:
    source = Source("a.yaml", "a: on # deepbots: ignore[DB003, DB004]: why\n")
    kept, (unused,) = suppress([warning_at(source, "on", "DB003")], [source])
    assert (kept, unused.help) == ([], "remove DB004 from the comment")
    assert unused.fix is not None
    assert edited(source, unused.fix.edits) == "a: on # deepbots: ignore[DB003]: why\n"


def test_an_error_is_never_suppressed() -> None:
    source = Source("a.yaml", "a: on # deepbots: ignore[DB101]\n")
    findings = [warning_at(source, "on", "DB101")]
    kept, unused = suppress(findings, [source])
    assert (kept, len(unused)) == (findings, 1)


def test_one_comment_serves_all_warnings_of_its_line() -> None:
    source = Source("a.yaml", "a: [on, off] # deepbots: ignore[DB003]\n")
    assert suppress([warning_at(source, "on"), warning_at(source, "off")], [source]) == ([], [])


def test_text_that_only_mentions_the_words_is_not_a_comment() -> None:
    assert suppress([], [Source("a.yaml", "a: x#deepbots: ignore[DB003]\n")]) == ([], [])


def tree(kind: type[BaseException], depth: int = 0) -> Iterator[tuple[str, int]]:
    yield kind.__name__, depth
    for inner in kind.__subclasses__():
        if inner.__module__ in (errors.__name__, identity.__name__):
            yield from tree(inner, depth + 1)


def test_the_docstring_shows_every_exception_below_its_parent() -> None:
    rows = re.findall(r"^    ([│├└─ ]*)(\w+Error) ", errors.__doc__ or "", re.MULTILINE)
    assert sorted((name, len(lines) // 4) for lines, name in rows) == sorted(tree(DeepbotsError))


def test_an_extra_is_installed_from_the_clone_that_deepbots_came_from_and_from_no_index_that_may_not_have_it(
    tmp_path: Path,
) -> None:
    clone, packages = tmp_path / "my clone", tmp_path / "packages"
    metadata = packages / "deepbots_cli-0.1.0.dist-info"
    metadata.mkdir(parents=True)
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: deepbots-cli\nVersion: 0.1.0\n")
    (metadata / "direct_url.json").write_text(json.dumps({"url": clone.as_uri(), "dir_info": {}}))
    command = [
        sys.executable,
        "-c",
        "from deepbots_cli.installation import install_hint; print(install_hint('sim'))",
    ]
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join((str(packages), str(Path(errors.__file__).parents[1]))),
    }
    for there, origin in ((False, "deepbots-cli"), (True, str(clone))):
        if there:
            clone.mkdir()
            (clone / "pyproject.toml").touch()
        hint = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout
        assert hint == f"install it with: pip install '{origin}[sim]'\n"
    needed = "Provides-Extra: export\nRequires-Dist: deepbots-robot==0.1.0; extra == 'export'\n"
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: deepbots-cli\nVersion: 0.1.0\n{needed}")
    command[-1] = command[-1].replace("sim", "export")
    hint = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout
    assert hint == f"install it with: pip install '{clone}/deepbots_robot' '{clone}[export]'\n"
