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
from typing import Any, Literal
from urllib.parse import unquote
from xml.etree import ElementTree

import jsonschema
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepbots_cli import errors
from deepbots_cli.diagnostics import Finding, Label, Source, Span
from deepbots_cli.diagnostics.findings import Fix, RuleSelectors, Selection, edited, suppress
from deepbots_cli.diagnostics.render import github, junit, render, sarif, summary
from deepbots_cli.document.layout import quoted
from deepbots_cli.errors import DeepbotsError, UsageError
from deepbots_cli.lint.pages import pages_of
from deepbots_cli.program import identity

SARIF = Path(__file__).with_name("sarif.json")
"""What SARIF 2.1.0 requires of the objects that deepbots writes; any other property is an error."""
VALID = jsonschema.Draft7Validator(json.loads(SARIF.read_text(encoding="utf-8")))


def page(code: str) -> tuple[str, str]:
    (only,) = pages_of(code)
    return only.text(), only.markdown()


TEXT = "world:\n  tmiestep: 32 ms\n"


def finding(
    text: str = TEXT, marked: str = "tmiestep", name: str = "a.yaml", code: str = "DB101", **more: Any
) -> Finding:
    start = text.index(marked)
    return Finding(code, Span(Source(name, text), start, start + len(marked)), "the key is not known", **more)


def warning(name: str = "a.yaml") -> Finding:
    return Finding("DB003", Span(Source(name, "a: on\n"), 3, 5), "`on` is text")


def sarif_of(findings: list[Finding]) -> dict[str, Any]:
    log = json.loads(sarif(findings, page))
    VALID.validate(log)
    (run,) = log["runs"]
    assert isinstance(run, dict)
    return run


MAIN, OTHER = Source("main.yaml", "include: b.yaml"), Source("b.yaml", "x: 1")
PART = Source("b.yaml", "a: 1\na: 2\n", Span(MAIN, 9, 15))
NAMES = Source("a.yaml", "name: x\nb: 1\nc: 1\nname: y\n")
LINES = Source("a.yaml", "a: |\n  one\n  two\n")
DUPLICATE = Finding(
    "DB002", Span(PART, 5, 6), "given twice", labels=(Label(Span(PART, 0, 1), "first defined here"),)
)


@pytest.mark.parametrize(
    ("findings", "shown"),
    [
        (
            [finding(help="write `timestep`")],
            "::error title=DB101 unknown-key,file=a.yaml,line=2,endLine=2,col=3,endColumn=11::the key is not"
            " known%0Ahelp: write `timestep`\n",
        ),
        # Without columns, for a place over several lines.
        (
            [Finding("DB101", Span(Source("a.yaml", "a:\n  b\n"), 0, 6), "x")],
            "::error title=DB101 unknown-key,file=a.yaml,line=1,endLine=2::x\n",
        ),
        # Errors first, since a workflow shows only ten; nothing from a file becomes a command of its own.
        (
            [
                warning(),
                Finding(
                    "DB101",
                    Span(Source("a,line=9::b%\n.yaml", "a"), 0, 1),
                    "100 % x\n::set-output name=a::b\r::stop-commands::y",
                ),
            ],
            "::error title=DB101 unknown-key,file=a%2Cline=9%3A%3Ab%25\\u{a}.yaml,line=1,endLine=1,col=1,endColumn=2"
            "::100 %25 x\\u{a}::set-output name=a::b\\u{d}::stop-commands::y\n"
            "::warning title=DB003 yaml11-boolean,file=a.yaml,line=1,endLine=1,col=4,endColumn=6::`on` is text\n",
        ),
    ],
)
def test_a_workflow_shows_findings_at_their_lines(findings: list[Finding], shown: str) -> None:
    assert github(findings) == shown


def test_sarif_has_a_result_for_each_finding_and_describes_the_rules() -> None:
    run = sarif_of([warning(), finding(help="did you mean `timestep`?"), finding(name="b.yaml")])
    results = run["results"]
    rules = run["tool"]["driver"]["rules"]
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

    assert sarif_of([])["results"] == []


def test_sarif_has_the_fix_of_a_finding_and_further_places() -> None:
    plain = finding()
    fixed = finding(
        fix=Fix.replacing(plain.span, "tmiestep", "timestep", safe=True), help="did you mean `timestep`?"
    )
    ((fix,),) = [result["fixes"] for result in sarif_of([fixed])["results"]]
    ((change,),) = [fix["artifactChanges"]]
    assert change["artifactLocation"]["uri"] == "a.yaml"
    assert change["replacements"] == [
        {
            "deletedRegion": {"startLine": 2, "startColumn": 3, "endLine": 2, "endColumn": 11},
            "insertedContent": {"text": "timestep"},
        }
    ]
    assert fix["properties"] == {"safe": True}
    (result,) = sarif_of([DUPLICATE])["results"]
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

    # A warning is a failure where warnings fail; two findings of one code at one place are two cases.
    span = Span(Source("a.yaml", "a: 1\n"), 0, 4)
    missing = [Finding("DB102", span, f"missing key `{key}`") for key in ("name", "world")]
    root = ElementTree.fromstring(junit([warning(), *missing], ["a.yaml"], ("error", "warning")))
    assert (root.attrib["failures"], len({case.attrib["name"] for case in root[0]})) == ("3", 3)


@given(
    st.text(max_size=120),
    st.integers(0, 120),
    st.integers(0, 120),
    st.text(max_size=20),
    st.text(min_size=1, max_size=20),
    st.integers(0, 120),
)
def test_any_place_in_any_text_can_be_shown_in_every_form(
    text: str, one: int, two: int, headline: str, name: str, width: int
) -> None:
    start, end = sorted((min(one, len(text)), min(two, len(text))))
    source = Source(name, text)
    label = Label(Span(source, 0, start), headline)
    reported = Finding("DB101", Span(source, start, end), f"x{headline}", headline, (label,), (headline,))
    assert "^" in render([reported], width=width)
    assert (render([reported], "concise").count("\n"), github([reported]).count("\n")) == (1, 1)
    assert json.loads(render([reported], "json"))["findings"][0]["message"] == f"x{headline}"
    ElementTree.fromstring(junit([reported], [name], ("error",)))
    (result,) = sarif_of([reported])["results"]
    uri = result["locations"][0]["physicalLocation"]["artifactLocation"]["uri"]
    assert Path(unquote(uri.removeprefix("file://"))) == Path(name) or "\\" in name or "\0" in name


@pytest.mark.parametrize(
    ("reported", "format", "shown"),
    [
        (
            finding(help="did you mean `timestep`?", notes=("a note",)),
            "full",
            "error DB101[unknown-key]: the key is not known\n"
            " --> a.yaml:2:3\n"
            "  |\n"
            "2 |   tmiestep: 32 ms\n"
            "  |   ^^^^^^^^\n"
            "  |\n"
            "  = note: a note\n"
            "  = help: did you mean `timestep`?\n"
            "\n",
        ),
        (
            finding(help="write\nc"),
            "concise",
            "a.yaml:2:3: error DB101[unknown-key] the key is not known (write\\u{a}c)\n",
        ),
        # Further places, in the order of the file.
        (
            Finding(
                "DB002", Span(NAMES, 18, 22), "x", labels=(Label(Span(NAMES, 0, 4), "first defined here"),)
            ),
            "full",
            "error DB002[duplicate-key]: x\n"
            " --> a.yaml:4:1\n"
            "  |\n"
            "1 | name: x\n"
            "  | ---- first defined here\n"
            "...\n"
            "4 | name: y\n"
            "  | ^^^^\n"
            "  |\n"
            "\n",
        ),
        # Another file, apart.
        (
            finding("y: 1", "y", labels=(Label(Span(OTHER, 0, 1), "defined here"),)),
            "full",
            "error DB101[unknown-key]: the key is not known\n"
            " --> a.yaml:1:1\n"
            "  |\n"
            "1 | y: 1\n"
            "  | ^\n"
            "  |\n"
            " --> b.yaml:1:1\n"
            "  |\n"
            "1 | x: 1\n"
            "  | - defined here\n"
            "  |\n"
            "\n",
        ),
        # An included file, with the chain, and an empty place behind the last character.
        (
            Finding("DB101", Span(Source("c.yaml", "x", Span(PART, 5, 6)), 1, 1), "x"),
            "full",
            "error DB101[unknown-key]: x\n"
            " --> c.yaml:1:2\n"
            "     included from b.yaml:2:1\n"
            "     included from main.yaml:1:10\n"
            "  |\n"
            "1 | x\n"
            "  |  ^\n"
            "  |\n"
            "\n",
        ),
        # A place over several lines, underlined to the end of its first; an empty one in an empty text.
        (
            Finding("DB101", Span(LINES, 3, 16), "x"),
            "full",
            "error DB101[unknown-key]: x\n --> a.yaml:1:4\n  |\n1 | a: |\n  |    ^\n  |\n\n",
        ),
        (
            Finding("DB101", Span(Source("a.yaml", ""), 0, 0), "x"),
            "full",
            "error DB101[unknown-key]: x\n --> a.yaml:1:1\n  |\n1 |\n  | ^\n  |\n\n",
        ),
    ],
)
def test_a_finding_is_shown_with_its_places(
    reported: Finding, format: Literal["full", "concise"], shown: str
) -> None:
    colored = render([reported], format, color=True)
    assert (render([reported], format), re.sub(r"\x1b\[[0-9;]*m", "", colored)) == (shown, shown)
    assert ("\x1b[1;31m" in colored) == (format == "full")


@pytest.mark.parametrize(
    "text", ["日本語: x", "e\u0301e\u0301: x", "\ta\t: x", "äöü: x", "😀: x", "\u202eabc\u200d: x"]
)
def test_the_underline_stands_below_the_place_whatever_is_before_it(text: str) -> None:
    lines = render([finding(text, "x")]).splitlines()

    def column(line: str, sign: str) -> int:
        wide = sum(unicodedata.east_asian_width(c) in "WF" for c in line[: line.index(sign)])
        combining = sum(bool(unicodedata.combining(c)) for c in line[: line.index(sign)])
        return line.index(sign) + wide - combining

    assert column(lines[3], "x") == column(lines[4], "^")
    assert lines[4].endswith("^")


@pytest.mark.parametrize("before", [0, 30, 200, 5000])
def test_a_long_line_is_cropped_around_the_place(before: int) -> None:
    text = "a" * before + "XY" + "b" * 5000
    lines = render([finding(text, "XY")], width=80).splitlines()
    assert all(len(line) <= 80 for line in lines[2:5])
    start = lines[4].index("^")
    assert lines[3][start : start + 2] == "XY"
    assert lines[4].endswith("^^")


@pytest.mark.parametrize("after", [0, 1, 2, 5000])
def test_a_long_line_shows_all_that_is_marked(after: int) -> None:
    marked = "X" * 50
    lines = render([finding("a" * 60 + marked + "b" * after, marked)], width=80).splitlines()
    assert all(len(line) <= 80 for line in lines[2:5])
    assert lines[3].count("X") == lines[4].count("^") == 50


@pytest.mark.parametrize("format", ["full", "concise"])
def test_nothing_from_a_file_is_obeyed_by_the_terminal(format: str) -> None:
    evil = "a: \x1b[2J\x07\u202e\x9b31m"
    hostile = Finding(
        "DB101", Span(Source("\x1b]0;x\x07.yaml", evil), 0, 1), f"bad {evil}", f"help {evil}\n", notes=(evil,)
    )
    text = render([hostile], format)  # type: ignore[arg-type]
    assert not set("\x1b\x07\u202e\x9b").intersection(text)
    assert "\\u{1b}" in text


def test_the_json_form_is_versioned_and_complete() -> None:
    source = Source("a.yaml", "é: 1\nb: 2\n")
    reported = Finding(
        "DB003",
        Span(source, 5, 6),
        "text",
        "help",
        (Label(Span(source, 0, 1), "here"),),
        ("note",),
        Fix.replacing(Span(source, 5, 6), "b", "c", safe=True),
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
                "fix": {
                    "safe": True,
                    "edits": [
                        {
                            "file": "a.yaml",
                            "start": {"line": 2, "column": 1},
                            "end": {"line": 2, "column": 2},
                            "text": "c",
                        }
                    ],
                },
            }
        ],
        "counts": {"error": 0, "warning": 1},
    }


def test_no_findings_are_not_text_but_still_json_and_the_summary_counts_by_severity() -> None:
    assert render([]) == render([], "concise") == ""
    counts = {"error": 0, "warning": 0}
    assert json.loads(render([], "json")) == {"version": 1, "findings": [], "counts": counts}
    assert [summary(found) for found in ([], [finding(), finding(), warning()], [warning()])] == [
        "no findings",
        "2 errors, 1 warning",
        "1 warning",
    ]


def selectors(*words: str, option: str = "--select") -> RuleSelectors:
    return RuleSelectors(words, Source(option, ",".join(words)))


@pytest.mark.parametrize(
    ("select", "ignore", "selected"),
    [
        (None, None, "DB001 DB003 DB101 DB402 DB504 DB505 DB603 DB702 DB801"),
        # The beginning of codes, a code and a name; errors in text or shape are always shown.
        (["DB5", "DB603", "never-true"], None, "DB001 DB101 DB504 DB505 DB603 DB801"),
        ([" db5 "], None, "DB001 DB101 DB504 DB505"),
        (None, ["DB5", "DB0", "DB101"], "DB001 DB101 DB402 DB603 DB702 DB801"),
        # The longer of two words counts, and ignoring among equals.
        (["DB5"], ["DB505"], "DB001 DB101 DB504"),
        (["DB505"], ["DB5"], "DB001 DB101 DB505"),
        (["implausible-magnitude"], ["DB5"], "DB001 DB101 DB505"),
        (["DB5"], ["DB5"], "DB001 DB101"),
    ],
)
def test_findings_are_selected_by_words(
    select: list[str] | None, ignore: list[str] | None, selected: str
) -> None:
    selection = Selection(*(None if words is None else selectors(*words) for words in (select, ignore)))
    codes = ["DB001", "DB003", "DB101", "DB402", "DB504", "DB505", "DB603", "DB702", "DB801"]
    assert [code for code in codes if selection.selects(finding(code=code))] == selected.split()
    assert selection.selects_all == (select is ignore is None)


@pytest.mark.parametrize(
    ("word", "message"),
    [
        ("DB77", "--select: there is no finding 'DB77'; did you mean DB"),
        ("term-dominate", "did you mean term-dominates?"),
        ("", "there is no finding ''"),
        ("zzzzz", "`deepbots explain` lists them"),
        (
            "db716",
            "--select: the rule db716 is gone; `deepbots lint --exploits` finds such rewards by playing",
        ),
        (None, "nothing is selected"),
        ("cycle-pays", "--select: the rule cycle-pays is gone"),
    ],
)
def test_a_word_that_fits_nothing_is_refused(word: str | None, message: str) -> None:
    with pytest.raises(UsageError) as refused:
        Selection(selectors(*[] if word is None else [word]))
    assert message in str(refused.value)


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

NOTHING = "this comment suppresses nothing: there is no {} here"
NO_CODE = "the comment does not name the code to suppress"


@pytest.mark.parametrize(
    ("text", "kept", "reported", "runs"),
    [
        # A comment on the line, or on the one above.
        ("a: on  # deepbots: ignore[DB003]\n", 0, {}, {}),
        ("# deepbots: ignore[DB003]\na: on\n", 0, {}, {}),
        ("a: on # deepbots: ignore[db003]\n", 0, {}, {}),
        ("a: on # deepbots: ignore[yaml11-boolean]\n", 0, {}, {}),
        ("x:\n  # deepbots: ignore[DB003] as the firmware wants it\n  a: on\n", 0, {}, {}),
        ("a: [on, on] # the firmware's word  # deepbots: ignore[DB003]\n", 0, {}, {}),
        ("<!-- deepbots: ignore[DB003] -->\n<a on/>\n", 0, {}, {}),
        ("<!-- deepbots: ignore[DB003] --><a on/>\n", 0, {}, {}),
        ("<!-- deepbots: ignore[DB003] --> <!-- a note -->\r\n<a on/>\r\n", 0, {}, {}),
        # One that suppresses nothing is reported; one of two codes is removed alone.
        ("b: 1 # deepbots: ignore[DB003]\na: on\n", 1, {"DB003": NOTHING}, {}),
        ("# deepbots: ignore[DB003]\n\na: on\n", 1, {"DB003": NOTHING}, {}),
        ("a: on # deepbots: ignore[DB003, DB004]: why\n", 0, {"DB004": NOTHING}, {}),
        ("a: on # deepbots: ignore\n", 1, {"# deepbots: ignore": NO_CODE}, {}),
        ("a: on # deepbots: ignore[ ]\n", 1, {"# deepbots: ignore[ ]": NO_CODE}, {}),
        ("a: on # deepbots: ignore[DB0O3]\n", 1, {"DB0O3": "there is no rule `{}`"}, {}),
        (
            "a: bad # deepbots: ignore[DB101]\n",
            1,
            {"DB101": "{} is an error, which cannot be suppressed"},
            {},
        ),
        (
            "a: 1 # deepbots: ignore[DB716]\n",
            0,
            {"DB716": "the rule {} is gone; `deepbots lint --exploits` finds such rewards by playing"},
            {},
        ),
        ("a: x#deepbots: ignore[DB003]\n", 0, {}, {}),
        ('a: ["on # deepbots: ignore[DB003]",\n  on] # deepbots: ignore[DB003]\n', 1, {}, {}),
        ("a: |  # deepbots: ignore[DB003]\n  on # deepbots: ignore[DB003]\n", 1, {"DB003": NOTHING}, {}),
        # A comment about what did not run, or is hidden by an error, is of use.
        ("a: 1 # deepbots: ignore[DB608]\n", 0, {}, {"preview": True}),
        ("a: 1 # deepbots: ignore[DB608]\n", 0, {"DB608": NOTHING}, {"preview": True, "deep": True}),
        ("a: 1 # deepbots: ignore[DB713]\n", 0, {}, {"preview": True, "deep": True}),
        ("a: 1 # deepbots: ignore[DB713]\n", 0, {"DB713": NOTHING}, {"exploits": True}),
        ("a: 1 # deepbots: ignore[DB706]\n", 0, {}, {}),
        ("a: 1 # deepbots: ignore[DB706]\n", 0, {"DB706": NOTHING}, {"preview": True}),
        ("a: 1 # deepbots: ignore[DB703]\n", 0, {"DB703": NOTHING}, {}),
        ("a: bad # deepbots: ignore[DB703]\n", 1, {}, {}),
    ],
)
def test_a_comment_suppresses_the_warnings_of_its_line(
    text: str, kept: int, reported: dict[str, str], runs: dict[str, bool]
) -> None:
    """`on` has a warning, and `bad` an error."""
    source = Source("a.yaml", text)
    findings = [
        Finding({"on": "DB003", "bad": "DB101"}[match[0]], Span(source, *match.span()), "x")
        for match in re.finditer(r"\b(on|bad)\b", text)
    ]
    left, unused = suppress(findings, [source], quoted, **runs)
    assert len(left) == kept
    assert [(f.code, f.span.text, f.headline) for f in unused] == [
        ("DB901", marked, headline.format(marked)) for marked, headline in reported.items()
    ]
    if "DB004" in reported:
        assert unused[0].help == "remove DB004 from the comment"
        assert unused[0].fix is not None
        assert edited(source, unused[0].fix.edits) == "a: on # deepbots: ignore[DB003]: why\n"


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
    command[-1] = command[-1].replace("sim", "webots")  # the metadata is older than this extra
    hint = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout
    assert hint == f"install it with: pip install '{clone}/deepbots_webots' '{clone}[webots]'\n"
    needed = "Provides-Extra: export\nRequires-Dist: deepbots-robot==0.1.0; extra == 'export'\n"
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: deepbots-cli\nVersion: 0.1.0\n{needed}")
    command[-1] = command[-1].replace("webots", "export")
    hint = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout
    assert hint == f"install it with: pip install '{clone}/deepbots_robot' '{clone}[export]'\n"
