"""`deepbots explain`: rules, words of the language, and the terms in `glossary.yaml`."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from textwrap import fill
from typing import Annotated

import typer

from deepbots_cli.cli import terminal
from deepbots_cli.cli.command import Json
from deepbots_cli.cli.explanations import explain_word, misspelled_word, unknown_word_message
from deepbots_cli.cli.tables import Row, table
from deepbots_cli.diagnostics import Rule
from deepbots_cli.diagnostics.registry import (
    RULES,
    matching_rules,
    retired_rule_message,
    unknown_rule_message,
)
from deepbots_cli.errors import UsageError
from deepbots_cli.lint.pages import pages_of

_CODE = re.compile(r"db\d", re.IGNORECASE)
"""The form of the codes of findings."""
_OTHERWISE = "; `deepbots explain` lists all findings"


def command(
    words: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="WORD",
            help="Code or name of a finding, prefix of codes, word of the scenario language, or term; by"
            " default all findings.",
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Explain a finding of lint, a key of scenario files, or a term."""
    finding = " ".join(words or ())
    codes = words if words and all(map(_CODE.match, words)) else [finding]
    rules = list(dict.fromkeys(rule for code in codes for rule in matching_rules(code)))
    if unknown := [code for code in codes if not matching_rules(code)]:
        finding = unknown[0]
        if (retired := retired_rule_message(finding)) is not None:
            raise UsageError(retired)
        explained = explain_word(finding)
        if not explained.entries and not _CODE.match(finding) and (word := misspelled_word(finding)):
            terminal.note(f"there is no entry '{finding}'; this is the entry '{word}'\n")
            explained = explain_word(word)
        if not explained.entries:
            raise UsageError(
                unknown_rule_message(finding)
                if _CODE.match(finding)
                else unknown_word_message(finding, _OTHERWISE)
            )
        if as_json:
            entries = [{"title": title, "text": "\n".join(text)} for title, *text in explained.entries]
            terminal.show_json({"version": 1, "entries": entries, "see_also": explained.others})
        else:
            terminal.print_result("\n".join(map(_wrapped, explained.lines())))
    elif as_json:
        terminal.show_json(rules_data(rules))
    elif len(rules) > 1:
        terminal.print_result(table([_row(entry) for entry in rules], indent=""))
    else:
        terminal.print_result("\n".join(_lines(rules[0])))


def _row(entry: Rule) -> Row:
    severity = f"{entry.severity}, in preview" if entry.preview else entry.severity
    return {"code": entry.code, "name": entry.name, "severity": severity, "about": entry.summary}


def rules_data(rules: Iterable[Rule] = tuple(RULES.values())) -> dict[str, object]:
    """Return the registry of findings with their pages, as `deepbots explain --json` prints it."""
    return {"version": 1, "rules": [_data(entry) for entry in rules]}


def _data(entry: Rule) -> Row:
    pages = [
        {"about": page.about, "example": page.example, "instead": page.instead}
        for page in pages_of(entry.code)
    ]
    row: Row = {
        "code": entry.code,
        "name": entry.name,
        "severity": entry.severity,
        "preview": entry.preview,
        "deep": entry.deep,
    }
    return {**row, "summary": entry.summary, "pages": pages}


def _lines(entry: Rule) -> Iterator[str]:
    row = _row(entry)
    yield f"{row['code']} {row['name']} ({row['severity']})"
    yield _wrapped(str(row["about"]))
    for page in pages_of(entry.code):
        yield from ("", page.text(_width()))
    yield from _suppression(entry)


def _suppression(rule: Rule) -> Iterator[str]:
    """Yield how to suppress a finding, or why it cannot be suppressed."""
    yield ""
    is_about_linting = rule.family == "linting"
    if rule.preview:
        yield "The rule is in preview: it can report false findings, and runs only with --preview."
    if rule.deep == "only":
        yield "The rule needs a simulation, and runs only with --deep."
    if rule.deep == "too":
        flags = "--deep --preview" if rule.deep_preview else "--deep"
        yield f"A part of the rule needs a simulation, and runs only with {flags}."
    if rule.deep == "exploits":
        yield "The rule needs episodes of many drivers, and runs only with --exploits."
    if rule.severity == "error" and rule.deep != "only" and not is_about_linting:
        yield "A scenario with this error cannot be compiled."
    if rule.severity == "error" and rule.deep == "too":
        yield "If only --deep finds the error, the scenario can be compiled."
    if rule.severity == "error":
        yield "The finding cannot be suppressed."
    elif is_about_linting:
        yield f"No comment suppresses the finding; --ignore {rule.code} leaves it out."
    else:
        yield (
            "A comment on the line of the finding, or on the line above, suppresses it: # deepbots:"
            f" ignore[{rule.code}]"
        )


def _wrapped(text: str) -> str:
    if text.startswith(" "):
        return text  # the text is part of an example
    indent = "  " if text.startswith("- ") else ""
    return fill(text, _width(), subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


def _width() -> int:
    return min(terminal.width(), 100)
