"""Findings as data: what is wrong, where exactly, and what to write instead.

A `Source` is a text with a name; a `Span` is a piece of one, kept as two offsets, so that a
position inside a scalar is as easy to name as a whole line. Rendering lives elsewhere.
"""

from __future__ import annotations

import os
import re
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, NamedTuple

Severity = Literal["error", "warning"]


class Position(NamedTuple):
    """A place in a text; both numbers count from 1, columns in code points."""

    line: int
    column: int


@dataclass(frozen=True, eq=False)
class Source:
    """A text that was read, and where it came from.

    `name` is what the user sees: the path as given on the command line, or relative to the working
    directory. `included_from` is the span of the `include` or `extends` that brought this file in.
    """

    name: str
    text: str
    included_from: Span | None = None

    @property
    def chain(self) -> Iterator[Span]:
        """The `include`s and `extends` that brought this file in, its own first."""
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
        """The text of line `number` (from 1), without its end."""
        starts = self._line_starts
        end = starts[number] - 1 if number < len(starts) else len(self.text)
        return self.text[starts[number - 1] : end].rstrip("\r")


class Span(NamedTuple):
    """The half-open piece `[start, end)` of a source, in code points.

    Reading a file makes one for each key and value, and making a tuple takes half of the time of making a frozen dataclass.
    """

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
        """`file:line:column`, as editors and terminals link it."""
        return f"{self.source.name}:{self.begin.line}:{self.begin.column}"


@dataclass(frozen=True)
class Label:
    """A further place that explains a finding, such as "first defined here"."""

    span: Span
    text: str


@dataclass(frozen=True)
class Edit:
    """`text` in the place of what stands at `span`, and nothing else changed."""

    span: Span
    text: str


@dataclass(frozen=True)
class Fix:
    """What a program may write to be rid of a finding.

    A `safe` one keeps the meaning, or puts right what can have been meant in one way only; any other is a good guess.
    """

    edits: tuple[Edit, ...]
    safe: bool

    @classmethod
    def replacing(cls, span: Span, old: str, new: str, *, safe: bool) -> Fix | None:
        """`new` for `old`, where that stands at `span` as it is, in quotes perhaps: neither folded nor written with escapes."""
        if span.text in (f'"{old}"', f"'{old}'") and not set(new) & set("\"'\\"):
            span = Span(span.source, span.start + 1, span.end - 1)
        return cls((Edit(span, new),), safe) if span.text == old else None


@dataclass(frozen=True)
class Finding:
    """One problem at one place.

    Headlines start in lower case, carry no full stop and never hold the remedy; that is `help`.
    `code` must be in the rule registry, which supplies the kebab-case name and the severity.
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
        from deepbots_cli.diagnostics.registry import rule

        return rule(self.code).severity

    @property
    def name(self) -> str:
        from deepbots_cli.diagnostics.registry import rule

        return rule(self.code).name

    @property
    def is_fault(self) -> bool:
        """Whether it reports a fault of deepbots (DB903), which says nothing about the scenario."""
        return self.code == "DB903"

    @property
    def sort_key(self) -> tuple[str, int, int, str, str]:
        return (self.span.source.name, self.span.start, self.span.end, self.code, self.headline)


def shielded(what: str, source: Source, find: Callable[[], Iterable[Finding]]) -> Iterator[Finding]:
    """The findings of `find`; if it raises an exception, the last of them says so (see `failure`)."""
    try:
        yield from find()
    except Exception as error:  # a fault of ours, which must not hide other findings
        yield failure(what, source, error)


def failure(what: str, source: Source, error: Exception) -> Finding:
    """A DB903 at the start of `source` that says which exception `what` raised; with DEEPBOTS_DEBUG=1 it is raised again."""
    if os.environ.get("DEEPBOTS_DEBUG") == "1":
        raise error
    return fault(what, source, described(error))


def fault(what: str, source: Source, description: str) -> Finding:
    """The DB903 for `what`, such as `the rule DB705`; the description is that of `described`."""
    help = "this is a fault of deepbots; report this message together with the file (DEEPBOTS_DEBUG=1 shows the traceback)"
    return Finding("DB903", Span(source, 0, 0), f"{what} failed on this file: {description}", help)


def described(error: BaseException) -> str:
    """Type and message of an exception on one line, and the innermost place in deepbots that it passed: `module:line`."""
    place, trace = "", error.__traceback__
    while trace is not None:
        module = str(trace.tb_frame.f_globals.get("__name__"))
        if not place or module.startswith("deepbots"):
            place = f"{module}:{trace.tb_lineno}"
        trace = trace.tb_next
    message = " ".join(str(error)[:_LONGEST_MESSAGE].split())
    return f"{type(error).__name__}{f': {message}' if message else ''} ({place})"


_LONGEST_MESSAGE = 200
"""Characters of the message of an exception, which may quote a whole file."""

MOST_FINDINGS = 500
"""Of one scenario. Nobody reads more, and a file of a megabyte may be wrong in 30 000 places, which took half a minute to word."""


class TooManyFindings(Exception):  # nothing failed: who asked for no more than some has them
    """Leaves whatever was looking for findings; `one` was one too many."""

    def __init__(self, one: Finding) -> None:
        super().__init__()
        self.one = one


class Findings:
    """A list that passes add to; sorted and free of repeats when it is read.

    Where it holds `most` already, another one raises `TooManyFindings`.
    """

    def __init__(self, most: int | None = None) -> None:
        self.most = most
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
        if self.most is not None and len(self._found) >= self.most and finding.sort_key not in self._found:
            raise TooManyFindings(finding)
        self._found.setdefault(finding.sort_key, finding)

    def give_up(self, too_many: TooManyFindings) -> None:
        """Say that there are more, and that nothing else was looked for."""
        help = "mend some of these first; nothing more was looked for"
        last = Finding("DB005", too_many.one.span, f"more than {self.most} findings", help)
        self._found.setdefault(last.sort_key, last)

    def advise(self, finding: Finding, help: str) -> None:
        """Give a finding that was added a better help."""
        self._found[finding.sort_key] = replace(finding, help=help)

    def __iter__(self) -> Iterator[Finding]:
        return iter(sorted(self._found.values(), key=lambda f: f.sort_key))

    def __len__(self) -> int:
        return len(self._found)

    def __repr__(self) -> str:
        """A line for each, since a finding holds the whole text of its file."""
        return f"Findings({[f'{finding.span.where}: {finding.code} {finding.headline}' for finding in self]})"

    @property
    def errors(self) -> list[Finding]:
        return [f for f in self if f.severity == "error"]
