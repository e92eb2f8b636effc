"""Suppression comments: `# deepbots: ignore[DB603]` at the end of a line, or on a line of its own above.

Only warnings can be suppressed; what an error speaks of would not run. A comment that suppresses nothing is itself
a finding (DB901), so none outlives its reason.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import islice

from deepbots_cli.diagnostics.finding import Edit, Finding, Fix, Source, Span
from deepbots_cli.diagnostics.nearest import nearest
from deepbots_cli.diagnostics.registry import RETIRED, RULES

# `<!--` is how a comment begins in a robot file.
_COMMENT = re.compile(r"(?:(?<=\s)|^)(?:#|<!--)[ \t]*deepbots:[ \t]*ignore(?:\[([^\]\r\n]*)\])?", re.MULTILINE)


_NOTHING_MORE = re.compile(r"[^\S\n]*+(?=\n|\Z)")
"""Up to the end of the line. To look for that end first would take a second, where a line of a megabyte holds thousands of comments."""

_MOST_CODES = 50
"""In one comment."""
_MOST_COMPARED = 100
"""Unknown codes that are compared with the known ones; a file of a megabyte may hold tens of thousands."""


@dataclass(frozen=True)
class _Suppression:
    """One code of one comment, and the line that it is about."""

    code: str
    span: Span
    line: int
    removal: Edit


def suppress(
    findings: Iterable[Finding], sources: Iterable[Source], *, preview: bool = False, deep: bool = False
) -> tuple[list[Finding], list[Finding]]:
    """The findings that no comment suppresses, and a DB901 for each comment in `sources` that is of no use.

    What a comment says of a rule in preview is of use whenever those rules do not run, and so is what it says of one that
    asks a simulation, where there was none.
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
    left = [entry for key, entry in wanted.items() if key not in used and _had_its_chance(entry.code, preview, deep)]
    compared = {id(entry) for entry in islice((entry for entry in left if entry.code not in RULES), _MOST_COMPARED)}
    unused.extend(_unused(entry, compare=id(entry) in compared) for entry in left)
    return kept, sorted(unused, key=lambda finding: finding.sort_key)


def _suppressions(source: Source) -> Iterator[_Suppression | Finding]:
    if "ignore" not in source.text:  # a hundred times faster than to look for comments, and true of most files
        return
    before = 0
    for comment in _COMMENT.finditer(source.text):
        line, column = source.position(comment.start())
        alone = line != before and not source.text[comment.start() - column + 1 : comment.start()].strip()
        before = line
        if comment[1] is None or not comment[1].strip():
            span = Span(source, *comment.span())
            yield Finding("DB901", span, "a suppression without a code", help="name what it suppresses: # deepbots: ignore[DB603]")
            continue
        codes = list(re.finditer(r"[^\s,]+", comment[1]))
        if len(codes) > _MOST_CODES:
            help = f"at most {_MOST_CODES} are read; name those that its line has findings of"
            yield Finding("DB901", Span(source, *comment.span(1)), f"a suppression of {len(codes):_} codes", help=help)
            continue
        for code in codes:
            span = Span(source, comment.start(1) + code.start(), comment.start(1) + code.end())
            yield _Suppression(code.group(), span, line + 1 if alone else line, _removal(source, comment, code.group()))


def _had_its_chance(code: str, preview: bool, deep: bool) -> bool:
    """Whether everything has run that could find it."""
    rule = RULES.get(code)
    if rule is None:
        return True
    return (preview or not rule.preview) and (rule.deep == "no" or (deep and (preview or not rule.deep_preview)))


def _unused(entry: _Suppression, *, compare: bool) -> Finding:
    rule, removed = RULES.get(entry.code), Fix((entry.removal,), safe=True)
    if entry.code in RETIRED:
        help = f"remove the comment: {RETIRED[entry.code].reason}"
        return Finding("DB901", entry.span, f"{entry.code} is retired", help=help, fix=removed)
    if rule is None:
        near = nearest(entry.code, RULES) if compare else None
        return Finding("DB901", entry.span, f"there is no rule `{entry.code}`", help=_similar(near), fix=_respelt(entry, near))
    if rule.severity == "error":
        return Finding(
            "DB901", entry.span, f"{entry.code} is an error, which cannot be suppressed", help="mend what it reports", fix=removed
        )
    return Finding("DB901", entry.span, f"no finding {entry.code} is suppressed here", help="remove the comment", fix=removed)


def _removal(source: Source, comment: re.Match[str], code: str) -> Edit:
    """The edit that takes `code` out: of the list, or with the whole comment, unless a reason behind it is worth keeping."""
    others = [other for other in re.findall(r"[^\s,]+", comment[1]) if other != code]
    if others:
        return Edit(Span(source, *comment.span(1)), ", ".join(others))
    rest = _NOTHING_MORE.match(source.text, comment.end())
    if comment[0].startswith("<") or rest is None:
        return Edit(Span(source, *comment.span()), comment[0][: comment[0].index("deepbots")].rstrip())
    line_start = source.text.rfind("\n", 0, comment.start()) + 1
    start = line_start + len(source.text[line_start : comment.start()].rstrip(" \t"))
    if start == line_start:
        return Edit(Span(source, start, min(rest.end() + 1, len(source.text))), "")
    return Edit(Span(source, start, comment.end()), "")


def _respelt(entry: _Suppression, near: str | None) -> Fix | None:
    return Fix((Edit(entry.span, near),), safe=False) if near else None


def _similar(near: str | None) -> str:
    return f"did you mean {near}?" if near else "codes look like DB603"
