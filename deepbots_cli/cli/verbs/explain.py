"""`deepbots explain`."""

from __future__ import annotations

import re
from collections.abc import Iterator
from textwrap import fill
from typing import Annotated

import typer

from deepbots_cli.cli import terminal
from deepbots_cli.cli.glossary import explained, unknown
from deepbots_cli.cli.options import Json
from deepbots_cli.cli.tables import Row, table
from deepbots_cli.diagnostics import Rule
from deepbots_cli.diagnostics.registry import unknown as unknown_finding
from deepbots_cli.diagnostics.registry import with_prefix
from deepbots_cli.errors import UsageError
from deepbots_cli.lint.pages import pages_of

_FINDING = re.compile(r"db\d|.*-", re.IGNORECASE)
"""Codes begin like this; of all words, only names of findings hold hyphens."""


def command(
    finding: Annotated[
        str,
        typer.Argument(metavar="[CODE|NAME|WORD]", help="A code, the beginning of codes such as DB6, a word of the language, a concept."),
    ] = "",
    as_json: Json = False,
) -> None:
    """Explain a finding: what it means, and what to write instead.

    Without a code, all findings are listed. Words of the language are explained as well: keys, functions, units, kinds of sensors,
    actuators, objects and algorithms; and concepts such as HER, domain randomisation or checkpoint.

    \b
      deepbots explain DB603
      deepbots explain saturates-before-termination
      deepbots explain DB7
      deepbots explain clearance
      deepbots explain gyro
      deepbots explain HER
      deepbots explain
    """
    found = with_prefix(finding)
    if not found:
        lines = explained(finding)
        if not lines:
            raise UsageError(unknown_finding(finding) if _FINDING.match(finding) else unknown(finding))
        if as_json:
            raise UsageError(f"--json tells of findings, and '{finding}' is none; leave it out")
        terminal.say("\n".join(map(_wrapped, lines)))
    elif as_json:
        terminal.show_json({"version": 1, "rules": [_data(entry) for entry in found]})
    elif len(found) > 1:
        terminal.say(table([_row(entry) for entry in found], indent=""))
    else:
        terminal.say("\n".join(_lines(found[0])))


def _row(entry: Rule) -> Row:
    return {"code": entry.code, "name": entry.name, "severity": _severity(entry), "about": entry.summary}


def _severity(rule: Rule) -> str:
    return f"{rule.severity}, in preview" if rule.preview else rule.severity


def _data(entry: Rule) -> Row:
    pages = [{"about": page.about, "example": page.example, "instead": page.instead} for page in pages_of(entry.code)]
    named: Row = {"code": entry.code, "name": entry.name, "severity": entry.severity, "preview": entry.preview, "deep": entry.deep}
    return {**named, "summary": entry.summary, "pages": pages}


def _lines(entry: Rule) -> Iterator[str]:
    row = _row(entry)
    yield f"{row['code']} {row['name']} ({row['severity']})"
    yield _wrapped(str(row["about"]))
    for page in pages_of(entry.code):
        yield from ("", page.text(_width()))
    yield from _suppression(entry)


def _suppression(rule: Rule) -> Iterator[str]:
    """How to suppress a finding, or why it cannot be suppressed."""
    yield ""
    if rule.preview:
        yield "It may still misfire, and is looked for with --preview only."
    if rule.deep == "only":
        yield "Only a simulation can tell: it is looked for with --deep."
    if rule.severity == "error":
        yield "It cannot be suppressed." if rule.deep == "only" else "A scenario with it cannot be compiled."
    else:
        yield f"A comment on the line of the finding, or on the line above, suppresses it: # deepbots: ignore[{rule.code}]"


def _wrapped(text: str) -> str:
    if text.startswith(" "):
        return text  # of an example
    return fill(text, _width(), break_long_words=False, break_on_hyphens=False)


def _width() -> int:
    return min(terminal.width(), 100)
