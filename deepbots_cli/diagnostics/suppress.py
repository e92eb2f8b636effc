"""Selection of findings: `--select DB5,DB603 --ignore DB505`, and comments that suppress warnings.

The comment `# deepbots: ignore[DB603]` suppresses warnings on its line, or on the next line if it has a line of its own. A
comment that suppresses nothing is itself a finding (DB901).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import islice

from deepbots_cli.diagnostics.findings import Edit, Finding, Fix, Source, Span
from deepbots_cli.diagnostics.nearest import nearest
from deepbots_cli.diagnostics.registry import RULES, matching_rules, unknown_rule_message
from deepbots_cli.errors import UsageError

_UNREADABLE = ("DB0", "DB1")
"""An error in the text or its shape hides most other findings, so no selection may hide it."""

# `<!--` begins a comment in a robot file.
_COMMENT = re.compile(r"(?:(?<=\s)|^)(?:#|<!--)[ \t]*deepbots:[ \t]*ignore(?:\[([^\]\r\n]*)\])?", re.MULTILINE)
# Possessive: a line of 1 MiB may hold thousands of comments.
_BLANK_TO_LINE_END = re.compile(r"[^\S\n]*+(?=\n|\Z)")
_CODE = re.compile(r"[^\s,]+")
_MAX_CODES = 1000
"""Codes that are read in one file; a file of 1 MiB may hold tens of thousands."""


@dataclass(frozen=True)
class RuleSelectors:
    """The words of `select` or `ignore`, and their source: an option or a settings file."""

    words: tuple[str, ...]
    source: Source

    def span(self, word: str) -> Span:
        found = re.search(rf"(?<![\w-]){re.escape(word)}(?![\w-])", self.source.text)
        return Span(self.source, *(found.span() if found else (0, 0)))


class Selection:
    """The findings chosen by `select` (default: all) and `ignore`, by code, by the beginning of codes, or by name.

    Where two words fit a code, the longer one counts; of equal ones `ignore`.

    Raises:
        UsageError: A word fits no finding; the message suggests one.
    """

    def __init__(
        self, select: RuleSelectors | None = None, ignore: RuleSelectors | None = None, *, preview: bool = False, deep: bool = False
    ) -> None:
        if select is not None and not select.words:
            raise UsageError(f"{select.source.name}: nothing is selected; leave 'select' out to select every rule")
        self._select = None if select is None else _codes(select)
        self._ignore = _codes(ignore) if ignore else {}
        self._preview = preview
        self._deep = deep
        self._words = select or RuleSelectors((), Source("", ""))

    @property
    def is_everything(self) -> bool:
        return self._select is None and not self._ignore

    def selects(self, finding: Finding) -> bool:
        """Whether the finding is shown: it is selected, or an error in text or shape, or a fault of deepbots."""
        unreadable = finding.severity == "error" and finding.code.startswith(_UNREADABLE)
        return unreadable or finding.is_internal_error or self._has(finding.code)

    def inactive_rules(self) -> list[Finding]:
        """A DB902 for each rule that is selected by itself and does not run: it is in preview, or needs a simulation."""
        found = []
        for word in self._words.words if "DB902" not in self._ignore else ():
            entries = matching_rules(word)
            if len(entries) != 1 or not self._has(entries[0].code):
                continue
            rule, span = entries[0], self._words.span(word)
            if rule.preview and not self._preview:
                help = "add --preview (`preview = true`), or remove the code"
                found.append(Finding("DB902", span, f"{rule.code} is in preview and does not run", help=help))
            if rule.deep == "only" and not self._deep:
                found.append(
                    Finding("DB902", span, f"{rule.code} needs a simulation and does not run", help="add --deep, or remove the code")
                )
        return found

    def _has(self, code: str) -> bool:
        chosen = 0 if self._select is None else self._select.get(code, -1)
        return chosen > self._ignore.get(code, -1)


def _codes(given: RuleSelectors) -> Mapping[str, int]:
    """The codes that the words fit, each with the length of the longest word; a name is as long as a code."""
    fitting: dict[str, int] = {}
    for word in given.words:
        entries = matching_rules(word)
        if not word.strip() or not entries:
            raise UsageError(f"{given.source.name}: {unknown_rule_message(word)}")
        for entry in entries:
            length = min(len(word.strip()), len(entry.code))
            fitting[entry.code] = max(length, fitting.get(entry.code, 0))
    return fitting


@dataclass(frozen=True)
class _Suppression:
    """One code of one comment, and the line that it applies to."""

    code: str
    span: Span
    line: int
    removal: Edit


def suppress(
    findings: Iterable[Finding], sources: Iterable[Source], *, preview: bool = False, deep: bool = False
) -> tuple[list[Finding], list[Finding]]:
    """The findings that no comment suppresses, and a DB901 for each comment in `sources` that suppresses nothing.

    A comment on a rule that did not run, in preview or for want of a simulation, is not reported.
    """
    wanted: dict[tuple[Source, int, str], _Suppression] = {}
    unused: list[Finding] = []
    for source in sources:
        for entry in islice(_suppressions(source), _MAX_CODES):
            if isinstance(entry, Finding):
                unused.append(entry)
            else:
                wanted.setdefault((source, entry.line, entry.code), entry)
    kept = []
    used = set()
    for finding in findings:
        key = (finding.span.source, finding.span.begin.line, finding.code)
        if finding.severity == "warning" and key in wanted:
            used.add(key)
        else:
            kept.append(finding)
    unused += [_unused(entry) for key, entry in wanted.items() if key not in used and _could_be_found(entry.code, preview, deep)]
    return kept, sorted(unused, key=lambda finding: finding.sort_key)


def _suppressions(source: Source) -> Iterator[_Suppression | Finding]:
    if "deepbots:" not in source.text:  # a hundred times faster than the search for comments
        return
    before = 0
    for comment in _COMMENT.finditer(source.text):
        line, column = source.position(comment.start())
        alone = line != before and not source.text[comment.start() - column + 1 : comment.start()].strip()
        before = line
        codes = list(islice(_CODE.finditer(source.text, *comment.span(1)), _MAX_CODES)) if comment[1] else []
        if not codes:
            span = Span(source, *comment.span())
            yield Finding(
                "DB901", span, "a suppression without a code", help="write the code that it suppresses: # deepbots: ignore[DB603]"
            )
        for code in codes:
            removal = _removal(source, comment, [other[0] for other in codes if other[0] != code[0]])
            yield _Suppression(code[0], Span(source, *code.span()), line + 1 if alone else line, removal)


def _could_be_found(code: str, preview: bool, deep: bool) -> bool:
    """Whether every part of the rule has run."""
    rule = RULES.get(code)
    if rule is None:
        return True
    return (preview or not rule.preview) and (rule.deep == "no" or (deep and (preview or not rule.deep_preview)))


def _unused(entry: _Suppression) -> Finding:
    rule = RULES.get(entry.code)
    if rule is None:
        near = nearest(entry.code, RULES)
        help = f"did you mean {near}?" if near else "a code has the form DB603"
        guess = Fix((Edit(entry.span, near),), safe=False) if near else None
        return Finding("DB901", entry.span, f"there is no rule `{entry.code}`", help=help, fix=guess)
    headline, help = f"this comment suppresses no finding {entry.code}", "remove the comment"
    if rule.severity == "error":
        headline, help = f"{entry.code} is an error, which cannot be suppressed", "correct the error"
    return Finding("DB901", entry.span, headline, help=help, fix=Fix((entry.removal,), safe=True))


def _removal(source: Source, comment: re.Match[str], others: list[str]) -> Edit:
    """The edit that leaves only the `others` in the list, or removes the comment but not a reason behind it."""
    if others:
        return Edit(Span(source, *comment.span(1)), ", ".join(others))
    rest = _BLANK_TO_LINE_END.match(source.text, comment.end())
    if comment[0].startswith("<") or rest is None:
        return Edit(Span(source, *comment.span()), comment[0][: comment[0].index("deepbots")].rstrip())
    line_start = source.text.rfind("\n", 0, comment.start()) + 1
    start = line_start + len(source.text[line_start : comment.start()].rstrip(" \t"))
    end = comment.end() if start > line_start else min(rest.end() + 1, len(source.text))
    return Edit(Span(source, start, end), "")
