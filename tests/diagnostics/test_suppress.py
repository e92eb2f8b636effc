"""Suppression comments."""

from __future__ import annotations

import pytest

from deepbots_cli.diagnostics import Finding, Source, Span
from deepbots_cli.diagnostics.findings import suppress


def warning(source: Source, text: str, code: str = "DB003") -> Finding:
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
    ],
)
def test_a_comment_on_the_line_or_above_it_suppresses_a_warning(text: str) -> None:
    source = Source("a.yaml", text)
    kept, unused = suppress([warning(source, "on", "DB003")], [source])
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
    found = [warning(source, "on")]
    kept, unused = suppress(found, [source])
    assert kept == found
    assert [(f.code, f.span.text, f.headline) for f in unused] == [("DB901", marked, headline)]


def test_an_error_is_never_suppressed() -> None:
    source = Source("a.yaml", "a: on # deepbots: ignore[DB101]\n")
    found = [warning(source, "on", "DB101")]
    kept, unused = suppress(found, [source])
    assert kept == found
    assert len(unused) == 1


def test_one_comment_serves_all_warnings_of_its_line() -> None:
    source = Source("a.yaml", "a: [on, off] # deepbots: ignore[DB003]\n")
    assert suppress([warning(source, "on"), warning(source, "off")], [source]) == ([], [])


def test_text_that_only_mentions_the_words_is_no_comment() -> None:
    source = Source("a.yaml", "a: x#deepbots: ignore[DB003]\n")
    assert suppress([], [source]) == ([], [])
