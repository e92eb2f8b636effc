"""Which findings are asked for."""

from __future__ import annotations

import pytest

from deepbots_cli.diagnostics import Finding, Source, Span
from deepbots_cli.diagnostics.findings import RuleSelectors, Selection, suppress
from deepbots_cli.errors import UsageError


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
    assert doubt.code == "DB902"
    assert doubt.span.location == "--select:1:5"
    assert doubt.span.text == "hidden-state-reward"
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
    findings = [warning(source, "on")]
    kept, unused = suppress(findings, [source])
    assert kept == findings
    assert [(f.code, f.span.text, f.headline) for f in unused] == [("DB901", marked, headline)]


def test_an_error_is_never_suppressed() -> None:
    source = Source("a.yaml", "a: on # deepbots: ignore[DB101]\n")
    findings = [warning(source, "on", "DB101")]
    kept, unused = suppress(findings, [source])
    assert kept == findings
    assert len(unused) == 1


def test_one_comment_serves_all_warnings_of_its_line() -> None:
    source = Source("a.yaml", "a: [on, off] # deepbots: ignore[DB003]\n")
    assert suppress([warning(source, "on"), warning(source, "off")], [source]) == ([], [])


def test_text_that_only_mentions_the_words_is_not_a_comment() -> None:
    source = Source("a.yaml", "a: x#deepbots: ignore[DB003]\n")
    assert suppress([], [source]) == ([], [])
