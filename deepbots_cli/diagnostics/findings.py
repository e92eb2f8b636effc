"""Findings as data: a problem, its exact place, and the correction.

A `Source` is a text with a name. A `Span` is a piece of it, given by two offsets, so a place inside a scalar is as
easy to name as a whole line.
"""

from __future__ import annotations

import os
import re
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

from deepbots_cli.diagnostics.registry import RULES, Severity

MAX_FINDINGS = 500
"""Findings of one scenario. A file of 1 MiB can have 30 000 errors, and their messages take half a minute."""

_MAX_MESSAGE = 200
"""Characters quoted from the message of an exception, which may quote a whole file."""


class Position(NamedTuple):
    """A place in a text; line and column count from 1, columns in code points."""

    line: int
    column: int


@dataclass(frozen=True, eq=False)
class Source:
    """A text and where it came from.

    `name` is what the user sees: the path as given on the command line, or relative to the working directory.
    `included_from` is the span of the `include` or `extends` that brought this file in.
    """

    name: str
    text: str
    included_from: Span | None = None

    @property
    def chain(self) -> Iterator[Span]:
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
        """The text of line `number` (from 1), without its line end."""
        starts = self._line_starts
        end = starts[number] - 1 if number < len(starts) else len(self.text)
        return self.text[starts[number - 1] : end].rstrip("\r")


class Span(NamedTuple):
    """The half-open piece `[start, end)` of a source, in code points."""

    source: Source
    start: int
    end: int

    @property
    def begin(self) -> Position:
        return self.source.position(self.start)

    @property
    def finish(self) -> Position:
        return self.source.position(self.end)

    @property
    def text(self) -> str:
        return self.source.text[self.start : self.end]

    @property
    def where(self) -> str:
        """`file:line:column`, which editors and terminals link."""
        return f"{self.source.name}:{self.begin.line}:{self.begin.column}"


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


@dataclass(frozen=True)
class Fix:
    """Edits that remove a finding.

    A `safe` fix keeps the meaning, or corrects a mistake that has only one possible meaning. Any other is a guess.
    """

    edits: tuple[Edit, ...]
    safe: bool

    @classmethod
    def replacing(cls, span: Span, old: str, new: str, *, safe: bool) -> Fix | None:
        """`new` for `old`; None if the source does not hold `old` at `span` literally, plain or in quotes."""
        if span.text in (f'"{old}"', f"'{old}'") and not set(new) & set("\"'\\"):
            span = Span(span.source, span.start + 1, span.end - 1)
        return cls((Edit(span, new),), safe) if span.text == old else None


@dataclass(frozen=True)
class Finding:
    """One problem at one place.

    A headline starts in lower case, has no full stop and does not hold the remedy, which is `help`.
    `code` is in the rule registry, which supplies name and severity.
    """

    code: str
    span: Span
    headline: str
    help: str | None = None
    also: tuple[Label, ...] = ()
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
        """Whether it reports a fault of deepbots (DB903) and not of the scenario."""
        return self.code == "DB903"

    @property
    def sort_key(self) -> tuple[str, int, int, str, str]:
        return (self.span.source.name, self.span.start, self.span.end, self.code, self.headline)


def faults_as_findings(what: str, source: Source, find: Callable[[], Iterable[Finding]]) -> Iterator[Finding]:
    """The findings of `find`; an exception ends them with a DB903 (see `failure`)."""
    try:
        yield from find()
    except Exception as error:  # noqa: BLE001  # a fault of deepbots must not hide other findings
        yield exception_finding(what, source, error)


def exception_finding(what: str, source: Source, error: Exception) -> Finding:
    """A DB903 at the start of `source` for an exception in `what`, such as `the rule DB705`; DEEPBOTS_DEBUG=1 raises it again."""
    if os.environ.get("DEEPBOTS_DEBUG") == "1":
        raise error
    return internal_error(what, source, describe_exception(error))


def internal_error(what: str, source: Source, description: str) -> Finding:
    """The DB903 for `what`; `describe_exception` gives the description."""
    help = "this is a fault of deepbots; report this message together with the file (DEEPBOTS_DEBUG=1 shows the traceback)"
    return Finding("DB903", Span(source, 0, 0), f"{what} failed on this file: {description}", help)


def describe_exception(error: BaseException) -> str:
    """Type and message of an exception on one line, and the innermost place in deepbots of its traceback: `module:line`."""
    place, trace = "", error.__traceback__
    while trace is not None:
        module = str(trace.tb_frame.f_globals.get("__name__"))
        if not place or module.startswith("deepbots"):
            place = f"{module}:{trace.tb_lineno}"
        trace = trace.tb_next
    message = " ".join(str(error)[:_MAX_MESSAGE].split())
    return f"{type(error).__name__}{f': {message}' if message else ''} ({place})"


class TooManyFindings(Exception):  # noqa: N818  # reaching the limit that was asked for is no error
    """A list of findings has reached its limit; `one` did not fit."""

    def __init__(self, one: Finding) -> None:
        super().__init__()
        self.one = one


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
        *,
        help: str | None = None,
        also: tuple[Label, ...] = (),
        notes: tuple[str, ...] = (),
        fix: Fix | None = None,
    ) -> None:
        self.append(Finding(code, span, headline, help, also, notes, fix))

    def append(self, finding: Finding) -> None:
        if self.limit is not None and len(self._found) >= self.limit and finding.sort_key not in self._found:
            raise TooManyFindings(finding)
        self._found.setdefault(finding.sort_key, finding)

    def give_up(self, too_many: TooManyFindings) -> None:
        """Report that the limit is reached and the search ended."""
        help = "correct some of these first; the rest was not checked"
        last = Finding("DB005", too_many.one.span, f"more than {self.limit} findings", help)
        self._found.setdefault(last.sort_key, last)

    def replace_help(self, finding: Finding, help: str) -> None:
        """Replace the help of a finding that was added."""
        self._found[finding.sort_key] = replace(finding, help=help)

    def __iter__(self) -> Iterator[Finding]:
        return iter(sorted(self._found.values(), key=lambda f: f.sort_key))

    def __len__(self) -> int:
        return len(self._found)

    def __repr__(self) -> str:
        """One line for each finding, since its source holds the whole text of a file."""
        return f"Findings({[f'{finding.span.where}: {finding.code} {finding.headline}' for finding in self]})"

    @property
    def errors(self) -> list[Finding]:
        return [f for f in self if f.severity == "error"]
