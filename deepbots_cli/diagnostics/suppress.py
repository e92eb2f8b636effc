"""Suppression comments: `# deepbots: ignore[DB603]` at the end of a line, or on a line of its own above.

Only warnings can be suppressed; what an error speaks of would not run. A comment that suppresses nothing is itself
a finding (DB901), so none outlives its reason.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from deepbots_cli.diagnostics.finding import Finding, Source, Span
from deepbots_cli.diagnostics.nearest import nearest
from deepbots_cli.diagnostics.registry import RETIRED, RULES

# `<!--` is how a comment begins in a robot file.
_COMMENT = re.compile(r"(?:(?<=\s)|^)(?:#|<!--)[ \t]*deepbots:[ \t]*ignore(?:\[([^\]\r\n]*)\])?", re.MULTILINE)


@dataclass(frozen=True)
class _Suppression:
    """One code of one comment, and the line that it is about."""

    code: str
    span: Span
    line: int


def suppress(findings: Iterable[Finding], sources: Iterable[Source], *, preview: bool = False) -> tuple[list[Finding], list[Finding]]:
    """The findings that no comment suppresses, and a DB901 for each comment in `sources` that is of no use.

    What a comment says of a rule in preview is of use whenever those rules do not run.
    """
    wanted: dict[tuple[Source, int, str], _Suppression] = {}
    unused: list[Finding] = []
    for source in sources:
        if "deepbots:" in source.text:
            for entry in _suppressions(source):
                if isinstance(entry, Finding):
                    unused.append(entry)
                else:
                    wanted.setdefault((source, entry.line, entry.code), entry)
    used = set()
    kept = []
    for finding in findings:
        key = (finding.span.source, finding.span.begin.line, finding.code)
        if finding.severity == "warning" and key in wanted:
            used.add(key)
        else:
            kept.append(finding)
    unused.extend(_unused(entry) for key, entry in wanted.items() if key not in used and (preview or not _is_preview(entry.code)))
    return kept, sorted(unused, key=lambda finding: finding.sort_key)


def _suppressions(source: Source) -> Iterator[_Suppression | Finding]:
    for comment in _COMMENT.finditer(source.text):
        line = source.position(comment.start()).line
        alone = not source.line(line)[: source.position(comment.start()).column - 1].strip()
        if comment[1] is None or not comment[1].strip():
            span = Span(source, *comment.span())
            yield Finding("DB901", span, "a suppression without a code", help="name what it suppresses: # deepbots: ignore[DB603]")
            continue
        for code in re.finditer(r"[^\s,]+", comment[1]):
            span = Span(source, comment.start(1) + code.start(), comment.start(1) + code.end())
            yield _Suppression(code.group(), span, line + 1 if alone else line)


def _is_preview(code: str) -> bool:
    return code in RULES and RULES[code].preview


def _unused(entry: _Suppression) -> Finding:
    rule = RULES.get(entry.code)
    if entry.code in RETIRED:
        return Finding("DB901", entry.span, f"{entry.code} is retired", help=f"remove the comment: {RETIRED[entry.code].reason}")
    if rule is None:
        return Finding("DB901", entry.span, f"there is no rule `{entry.code}`", help=_similar(entry.code))
    if rule.severity == "error":
        return Finding("DB901", entry.span, f"{entry.code} is an error, which cannot be suppressed", help="mend what it reports")
    return Finding("DB901", entry.span, f"no finding {entry.code} is suppressed here", help="remove the comment")


def _similar(code: str) -> str:
    near = nearest(code, RULES)
    return f"did you mean {near}?" if near else "codes look like DB603"
