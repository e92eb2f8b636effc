"""Findings as text: what people and programs read."""

from __future__ import annotations

import json
import unicodedata

import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepbots_cli.diagnostics import Finding, Label, Source, Span
from deepbots_cli.diagnostics.render import render, summary


def place(source: Source, text: str) -> Span:
    start = source.text.index(text)
    return Span(source, start, start + len(text))


def finding(text: str, marked: str, name: str = "a.yaml", **more: object) -> Finding:
    return Finding("DB101", place(Source(name, text), marked), "the key is not known", **more)  # type: ignore[arg-type]


def test_the_full_form_shows_the_line_and_underlines_the_place() -> None:
    text = render(
        [
            finding(
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
    text = render([finding("y: 1", "y", labels=(Label(Span(other_file, 0, 1), "defined here"),))])
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
    lines = render([finding(text, "x")]).splitlines()

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
    source = Source("a.yaml", "a:")
    assert "1 | a:\n  |   ^\n" in render([Finding("DB101", Span(source, 2, 2), "x")])
    assert "1 |\n  | ^\n" in render([Finding("DB101", Span(Source("a.yaml", ""), 0, 0), "x")])


@pytest.mark.parametrize("before", [0, 30, 200, 5000])
def test_a_long_line_is_cropped_around_the_place(before: int) -> None:
    text = "a" * before + "XY" + "b" * 5000
    lines = render([finding(text, "XY")], width=80).splitlines()
    assert all(len(line) <= 80 for line in lines[2:5])
    start = lines[4].index("^")
    assert lines[3][start : start + 2] == "XY"
    assert lines[4].endswith("^^")


def test_color_changes_nothing_but_the_escapes() -> None:
    import re

    findings = [finding("a: 1", "a", help="b", notes=("c",))]
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
    unknown_key = finding("a:\n  b: 1", "b", help="write\nc")
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
    error = finding("a", "a")
    warning = Finding("DB003", error.span, "x")
    assert summary([error, error, warning]) == "2 errors, 1 warning"
    assert summary([warning, warning]) == "2 warnings"
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
