"""Findings as data: a problem, its exact place, and the correction.

A `Source` is a text with a name. A `Span` is a piece of it, given by two offsets, so a place inside a scalar
is as easy to name as a whole line.

A `Selection` chooses findings: `--select DB5,DB603 --ignore DB505`. The comment `# deepbots: ignore[DB603]`
suppresses warnings on its line, or on the next line if it has a line of its own. A comment that suppresses
nothing is itself a finding (DB901).
"""

from __future__ import annotations

import os
import re
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from itertools import islice
from typing import NamedTuple

from deepbots_cli.diagnostics.nearest import nearest_word
from deepbots_cli.diagnostics.registry import (
    RULES,
    Severity,
    matching_rules,
    retired_rule_message,
    unknown_rule_message,
)
from deepbots_cli.errors import UsageError
from deepbots_cli.records import dataclass

MAX_FINDINGS = 500
"""The maximum number of findings of one scenario. A file of 1 MiB can have 30 000 errors, and their messages
take half a minute."""

_MAX_MESSAGE = 200
"""The number of characters quoted from the message of an exception, which may quote a whole file."""


class Position(NamedTuple):
    """A place in a text; line and column count from 1, columns in code points."""

    line: int
    column: int


@dataclass(frozen=True, eq=False)
class Source:
    """A text and where it came from.

    `name` is the name that the user sees: the path as given on the command line, or relative to the working
    directory. `included_from` is the span of the `include` or `extends` that brought this file in. `assigned`
    is the path that the text assigns a value to, with dots, if the text is a `--set`.
    """

    name: str
    text: str
    included_from: Span | None = None
    assigned: str | None = None

    @property
    def inclusion_chain(self) -> Iterator[Span]:
        """The `include`s and `extends` that brought this file in, innermost first."""
        above = self.included_from
        while above is not None:
            yield above
            above = above.source.included_from

    @cached_property
    def _line_starts(self) -> list[int]:
        return [0, *(end.end() for end in re.finditer("\n", self.text))]

    def position(self, offset: int) -> Position:
        line = bisect_right(self._line_starts, offset)
        return Position(line, offset - self._line_starts[line - 1] + 1)

    def line(self, number: int) -> str:
        """Return the text of line `number` (from 1), without its line end."""
        starts = self._line_starts
        end = starts[number] - 1 if number < len(starts) else len(self.text)
        return self.text[starts[number - 1] : end].rstrip("\r")


class Span(NamedTuple):
    """The half-open piece `[start, end)` of a source, in code points."""

    source: Source
    start: int
    end: int

    @property
    def start_position(self) -> Position:
        return self.source.position(self.start)

    @property
    def end_position(self) -> Position:
        return self.source.position(self.end)

    @property
    def text(self) -> str:
        return self.source.text[self.start : self.end]

    @property
    def location(self) -> str:
        """`file:line:column`, which editors and terminals link."""
        return f"{self.source.name}:{self.start_position.line}:{self.start_position.column}"


@dataclass(frozen=True)
class Label:
    """A further place that explains a finding, such as "first defined here"."""

    span: Span
    text: str


@dataclass(frozen=True)
class Edit:
    """Replaces the text at `span` by `text`."""

    span: Span
    text: str


def edited(source: Source, edits: Iterable[Edit]) -> str:
    """Return the text of a source after edits that do not overlap."""
    text = source.text
    # Of edits with the same start, the insertion is applied last, since its text is not to be removed.
    for edit in sorted(edits, key=lambda edit: (edit.span.start, edit.span.end), reverse=True):
        text = text[: edit.span.start] + edit.text + text[edit.span.end :]
    return text


@dataclass(frozen=True)
class Fix:
    """Edits that remove a finding.

    A `safe` fix keeps the meaning, or corrects a mistake that has only one possible meaning. Any other is a
    guess.
    """

    edits: tuple[Edit, ...]
    safe: bool

    @classmethod
    def replacing(cls, span: Span, old: str, new: str, *, safe: bool) -> Fix | None:
        """Return a fix that writes `new` for `old`; None if the source does not have `old` at `span`
        literally, plain or in quotes."""
        if span.text in (f'"{old}"', f"'{old}'") and not set(new) & set("\"'\\"):
            span = Span(span.source, span.start + 1, span.end - 1)
        return cls((Edit(span, new),), safe) if span.text == old else None


@dataclass(frozen=True)
class Finding:
    """One problem at one place.

    A headline starts in lower case, has no full stop and does not contain what to write instead, which is
    `help`. `code` is in the rule registry, which supplies name and severity.
    """

    code: str
    span: Span
    headline: str
    help: str | None = None
    labels: tuple[Label, ...] = ()
    notes: tuple[str, ...] = ()
    fix: Fix | None = None

    @property
    def severity(self) -> Severity:
        return RULES[self.code].severity

    @property
    def name(self) -> str:
        return RULES[self.code].name

    @property
    def is_internal_error(self) -> bool:
        """Whether the finding reports a fault of deepbots (DB903) and not of the scenario."""
        return self.code == "DB903"

    @property
    def sort_key(self) -> tuple[str, int, int, str, str]:
        return (self.span.source.name, self.span.start, self.span.end, self.code, self.headline)


def exceptions_as_findings(
    what: str, source: Source, find: Callable[[], Iterable[Finding]]
) -> Iterator[Finding]:
    """Yield the findings of `find`; an exception ends them with a DB903 (see `failure`)."""
    try:
        yield from find()
    except Exception as error:  # noqa: BLE001  # a fault of deepbots must not hide other findings
        yield exception_finding(what, source, error)


def exception_finding(what: str, source: Source, error: Exception) -> Finding:
    """Return a DB903 at the start of `source` for an exception in `what`, such as `the rule DB705`;
    DEEPBOTS_DEBUG=1 raises it again."""
    if os.environ.get("DEEPBOTS_DEBUG") == "1":
        raise error
    return internal_error_finding(what, source, describe_exception(error))


def internal_error_finding(what: str, source: Source, description: str) -> Finding:
    """Return the DB903 for `what`; `describe_exception` gives the description."""
    help = (
        "this is a bug in deepbots; report this message together with the file (DEEPBOTS_DEBUG=1 shows"
        " the traceback)"
    )
    return Finding("DB903", Span(source, 0, 0), f"{what} failed on this file: {description}", help)


def describe_exception(error: BaseException) -> str:
    """Return type and message of an exception on one line, and the innermost place in deepbots of its
    traceback: `module:line`."""
    place = ""
    trace = error.__traceback__
    while trace is not None:
        module = str(trace.tb_frame.f_globals.get("__name__"))
        if not place or module.startswith("deepbots"):
            place = f"{module}:{trace.tb_lineno}"
        trace = trace.tb_next
    message = " ".join(str(error)[:_MAX_MESSAGE].split())
    return f"{type(error).__name__}{f': {message}' if message else ''} ({place})"


class TooManyFindings(Exception):  # noqa: N818  # reaching the limit that was asked for is not an error
    """The signal that a list of findings has reached its limit; `finding` did not fit."""

    def __init__(self, finding: Finding) -> None:
        super().__init__()
        self.finding = finding


class Findings:
    """A list that passes add to; iteration is sorted and free of repeats.

    Beyond `limit` findings, another one raises `TooManyFindings`.
    """

    def __init__(self, limit: int | None = None) -> None:
        self.limit = limit
        self._found: dict[tuple[str, int, int, str, str], Finding] = {}

    def add(
        self,
        code: str,
        span: Span,
        headline: str,
        help: str | None = None,
        *,
        labels: tuple[Label, ...] = (),
        notes: tuple[str, ...] = (),
        fix: Fix | None = None,
    ) -> None:
        self.append(Finding(code, span, headline, help, labels, notes, fix))

    def append(self, finding: Finding) -> None:
        if self.limit is not None and len(self._found) >= self.limit and finding.sort_key not in self._found:
            raise TooManyFindings(finding)
        self._found.setdefault(finding.sort_key, finding)

    def report_limit(self, too_many: TooManyFindings) -> None:
        """Report that the limit is reached and the search ended."""
        help = "correct some of these first; the rest was not checked"
        last = Finding("DB005", too_many.finding.span, f"more than {self.limit} findings", help)
        self._found.setdefault(last.sort_key, last)

    def replace(self, finding: Finding, other: Finding) -> None:
        """Replace a finding that was added by another one."""
        del self._found[finding.sort_key]
        self._found[other.sort_key] = other

    def __iter__(self) -> Iterator[Finding]:
        return iter(sorted(self._found.values(), key=lambda f: f.sort_key))

    def __len__(self) -> int:
        return len(self._found)

    def __repr__(self) -> str:
        """Return one line for each finding, since its source contains the whole text of a file."""
        return (
            f"Findings({[f'{finding.span.location}: {finding.code} {finding.headline}' for finding in self]})"
        )

    @property
    def errors(self) -> list[Finding]:
        return [f for f in self if f.severity == "error"]


# Selection and suppression

_UNREADABLE = ("DB0", "DB1")
"""An error in the text or its shape hides most other findings, so no selection may hide it."""

FILL_IN = "# FILL IN"
"""How a comment about a place begins that a command leaves to the author of a scenario."""
# `<!--` begins a comment in a robot file.
_COMMENT = re.compile(
    r"(?:(?<=\s)|^)(?:#|<!--)[ \t]*deepbots:[ \t]*ignore\b(?:\[([^\]\r\n]*)\])?", re.MULTILINE
)
# Possessive: a line of 1 MiB may hold thousands of comments.
_BLANK_TO_LINE_END = r"[^\S\n]*+(?=\n|\Z)"
# No group is possessive: Python before 3.11.5 does not go back where one fails.
_IN_COMMENT = r"[^\n-]*+(?:-(?!->)[^\n-]*+)*"
_COMMENTS_TO_LINE_END = rf"(?m){_IN_COMMENT}(?:-->(?:[ \t]|<!--{_IN_COMMENT}-->)*)?\r?$"
_CODE = r"[^\s,]+"
_MAX_CODES = 1000
"""The maximum number of codes that are read in one file; a file of 1 MiB may have tens of thousands."""


@dataclass(frozen=True)
class RuleSelectors:
    """The words of `select` or `ignore`, and their source: an option or a settings file."""

    words: tuple[str, ...]
    source: Source

    def span(self, word: str) -> Span:
        match = re.search(rf"(?<![\w-]){re.escape(word)}(?![\w-])", self.source.text)
        return Span(self.source, *(match.span() if match else (0, 0)))


class Selection:
    """The findings chosen by `select` (default: all) and `ignore`, by code, by the beginning of codes, or by
    name.

    If two words fit a code, the longer one applies; of equal ones `ignore`.

    Raises:
        UsageError: A word fits no finding; the message suggests one.
    """

    def __init__(
        self,
        select: RuleSelectors | None = None,
        ignore: RuleSelectors | None = None,
        *,
        preview: bool = False,
        deep: bool = False,
        exploits: bool = False,
    ) -> None:
        if select is not None and not select.words:
            raise UsageError(
                f"{select.source.name}: nothing is selected; leave 'select' out to select every rule"
            )
        self._select = None if select is None else _codes(select)
        self._ignore = _codes(ignore) if ignore else {}
        self._preview = preview
        self._ran = {"only": deep, "exploits": exploits}
        self._words = select or RuleSelectors((), Source("", ""))

    @property
    def selects_all(self) -> bool:
        return self._select is None and not self._ignore

    def selects(self, finding: Finding) -> bool:
        """Return whether the finding is shown: it is selected, or an error in text or shape, or a fault of
        deepbots."""
        unreadable = finding.severity == "error" and finding.code.startswith(_UNREADABLE)
        return unreadable or finding.is_internal_error or self._has(finding.code)

    def inactive_rules(self) -> list[Finding]:
        """Return a DB902 for each rule that is selected by itself and does not run: it is in preview, or
        needs a simulation."""
        inactive = []
        for word in self._words.words if "DB902" not in self._ignore else ():
            entries = matching_rules(word)
            if len(entries) != 1 or not self._has(entries[0].code):
                continue
            rule = entries[0]
            span = self._words.span(word)
            if rule.preview and not self._preview:
                help = "add --preview (`preview = true`), or remove the code"
                inactive.append(
                    Finding("DB902", span, f"{rule.code} is in preview and does not run", help=help)
                )
            if not self._ran.get(rule.deep, True):
                option = "--deep" if rule.deep == "only" else "--exploits"
                headline = f"{rule.code} needs a simulation and does not run"
                inactive.append(Finding("DB902", span, headline, help=f"add {option}, or remove the code"))
        return inactive

    def _has(self, code: str) -> bool:
        rank = 0 if self._select is None else self._select.get(code, -1)
        return rank > self._ignore.get(code, -1)


def _codes(selectors: RuleSelectors) -> Mapping[str, int]:
    """Return the codes that the words fit, each with the length of the longest word; a name is as long as a
    code."""
    fitting: dict[str, int] = {}
    for word in selectors.words:
        entries = matching_rules(word)
        if not word.strip() or not entries:
            raise UsageError(f"{selectors.source.name}: {unknown_rule_message(word)}")
        for entry in entries:
            fitting[entry.code] = max(min(len(word.strip()), len(entry.code)), fitting.get(entry.code, 0))
    return fitting


@dataclass(frozen=True)
class _Suppression:
    """One code of one comment, and the line that it applies to."""

    code: str
    span: Span
    line: int
    removal: Edit
    help: str


def suppress(
    findings: Iterable[Finding],
    sources: Iterable[Source],
    quoted: Callable[[Source], Sequence[int]],
    *,
    preview: bool = False,
    deep: bool = False,
    exploits: bool = False,
) -> tuple[list[Finding], list[Finding]]:
    """Return the findings that no comment suppresses, and a DB901 for each comment in `sources` that
    suppresses nothing. `quoted` returns the offsets at which quoted values begin and end, in turn.

    A comment on a rule that did not run, in preview, for want of a simulation or because of errors, is not
    reported.
    """
    suppressions: dict[tuple[Source, int, str], _Suppression] = {}
    unused: list[Finding] = []
    for source in sources:
        for entry in islice(_suppressions(source, quoted), _MAX_CODES):
            if isinstance(entry, Finding):
                unused.append(entry)
            elif suppressions.setdefault((source, entry.line, entry.code), entry) is not entry:
                headline = f"an earlier comment suppresses {entry.code} here"
                fix = Fix((entry.removal,), safe=True)
                unused.append(Finding("DB901", entry.span, headline, help=entry.help, fix=fix))
    remaining = []
    used = set()
    has_errors = False
    for finding in findings:
        has_errors = has_errors or finding.severity == "error"
        key = (finding.span.source, finding.span.start_position.line, finding.code)
        if finding.severity == "warning" and key in suppressions:
            used.add(key)
        else:
            remaining.append(finding)
    unused += [
        _unused(entry)
        for key, entry in suppressions.items()
        if key not in used and _could_be_found(entry.code, preview, deep, exploits, has_errors)
    ]
    return remaining, sorted(unused, key=lambda finding: finding.sort_key)


def _suppressions(
    source: Source, quoted: Callable[[Source], Sequence[int]]
) -> Iterator[_Suppression | Finding]:
    # The test is a hundred times faster than the search for comments.
    comments = [*_COMMENT.finditer(source.text)] if "deepbots:" in source.text else []
    ends = quoted(source) if comments else ()
    before = 0
    for comment in comments:
        if comment[0][0] == "#" and bisect_right(ends, comment.start()) % 2:
            continue
        line, column = source.position(comment.start())
        alone = (
            line != before
            and not source.text[comment.start() - column + 1 : comment.start()].strip()
            and (comment[0][0] != "<" or re.compile(_COMMENTS_TO_LINE_END).match(source.text, comment.end()))
        )
        before = line
        codes = (
            list(islice(re.compile(_CODE).finditer(source.text, *comment.span(1)), _MAX_CODES))
            if comment[1]
            else []
        )
        if not codes:
            yield Finding(
                "DB901",
                Span(source, *comment.span()),
                "the comment does not name the code to suppress",
                help="write the code: # deepbots: ignore[DB603]",
            )
        for code in codes:
            others = [other[0] for other in codes if other is not code]
            rules = matching_rules(code[0])
            yield _Suppression(
                rules[0].code if len(rules) == 1 else code[0],
                Span(source, *code.span()),
                line + 1 if alone else line,
                _removal(source, comment, others),
                help=f"remove {code[0]} from the comment" if others else "remove the comment",
            )


def _could_be_found(code: str, preview: bool, deep: bool, exploits: bool, has_errors: bool) -> bool:
    """Return whether every part of the rule has run."""
    rule = RULES.get(code)
    if rule is None or rule.severity == "error":
        return True
    if has_errors:
        return False
    if rule.deep == "exploits":
        return exploits
    return (preview or not rule.preview) and (
        rule.deep == "no" or (deep and (preview or not rule.deep_preview))
    )


def _unused(entry: _Suppression) -> Finding:
    rule = RULES.get(entry.code)
    if (retired := retired_rule_message(entry.code)) is not None:
        return Finding("DB901", entry.span, retired, entry.help, fix=Fix((entry.removal,), safe=True))
    if rule is None:
        near = nearest_word(entry.code, RULES)
        help = f"did you mean {near}?" if near else "a code has the form DB603"
        guess = Fix((Edit(entry.span, near),), safe=False) if near else None
        return Finding("DB901", entry.span, f"there is no rule `{entry.code}`", help=help, fix=guess)
    headline, help = f"this comment suppresses nothing: there is no {entry.code} here", entry.help
    if rule.severity == "error":
        headline, help = f"{entry.code} is an error, which cannot be suppressed", "correct the error"
    return Finding("DB901", entry.span, headline, help=help, fix=Fix((entry.removal,), safe=True))


def _removal(source: Source, comment: re.Match[str], others: list[str]) -> Edit:
    """Return the edit that leaves only the `others` in the list, or removes the comment but not a reason
    behind it."""
    if others:
        return Edit(Span(source, *comment.span(1)), ", ".join(others))
    rest = re.compile(_BLANK_TO_LINE_END).match(source.text, comment.end())
    if comment[0].startswith("<") or rest is None:
        return Edit(Span(source, *comment.span()), comment[0][: comment[0].index("deepbots")].rstrip())
    line_start = source.text.rfind("\n", 0, comment.start()) + 1
    start = line_start + len(source.text[line_start : comment.start()].rstrip(" \t"))
    end = comment.end() if start > line_start else min(rest.end() + 1, len(source.text))
    return Edit(Span(source, start, end), "")
