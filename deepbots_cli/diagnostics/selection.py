"""Which findings are asked for: `--select DB5,DB603 --ignore DB505`, by code, by the beginning of codes or by name.

Where two words fit a code the longer one counts, and `ignore` if they are alike.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from deepbots_cli.diagnostics.finding import Finding, Source, Span
from deepbots_cli.diagnostics.registry import Retired, Rule, unknown, with_prefix
from deepbots_cli.errors import UsageError

_UNREADABLE = ("DB0", "DB1")
"""After an error in the text or its shape little else can be looked at, so nothing may hide it."""


@dataclass(frozen=True)
class Words:
    """What was written, and where: an option, or a file with settings."""

    words: tuple[str, ...]
    source: Source

    def span(self, word: str) -> Span:
        found = re.search(rf"(?<![\w-]){re.escape(word)}(?![\w-])", self.source.text)
        return Span(self.source, *(found.span() if found else (0, 0)))


class Selection:
    """What `select` and `ignore` leave; without `select` that is everything.

    Raises:
        UsageError: A word fits no finding; says what was probably meant.
    """

    def __init__(self, select: Words | None = None, ignore: Words | None = None, *, preview: bool = False, deep: bool = False) -> None:
        if select is not None and not select.words:
            raise UsageError(f"{select.source.name}: nothing is selected; leave 'select' out to look for everything")
        self._select = None if select is None else _codes(select)
        self._ignore = _codes(ignore) if ignore else {}
        self._preview = preview
        self._deep = deep
        self._select_by_word = select or Words((), Source("", ""))

    @property
    def is_everything(self) -> bool:
        return self._select is None and not self._ignore

    def wants(self, finding: Finding) -> bool:
        """Whether it is to be shown: it is selected, or it keeps the rest from being looked at, as a fault of deepbots does too."""
        unreadable = finding.severity == "error" and finding.code.startswith(_UNREADABLE)
        return unreadable or finding.is_fault or self._has(finding.code)

    def doubts(self) -> list[Finding]:
        """A DB902 for each rule that is selected by itself, and does not run: it is in preview, or asks a simulation."""
        select = self._select_by_word
        if "DB902" in self._ignore:
            return []
        chosen = [(word, entry) for word in select.words for entry in _alone(word) if self._has(entry.code)]
        return [doubt for word, entry in chosen for doubt in self._doubts(entry, select.span(word))]

    def _doubts(self, entry: Rule, span: Span) -> Iterator[Finding]:
        if entry.preview and not self._preview:
            help = "add --preview (`preview = true`), or take it out"
            yield Finding("DB902", span, f"{entry.code} is in preview, and does not run", help=help)
        if entry.deep == "only" and not self._deep:
            yield Finding("DB902", span, f"{entry.code} asks a simulation, and does not run", help="add --deep, or take it out")

    def _has(self, code: str) -> bool:
        chosen = 0 if self._select is None else self._select.get(code, -1)
        return chosen > self._ignore.get(code, -1)


def _alone(word: str) -> tuple[Rule, ...]:
    """The rule that `word` names, and not only as one of many."""
    match with_prefix(word):
        case (Rule() as entry,):
            return (entry,)
        case _:
            return ()


def _codes(given: Words) -> Mapping[str, int]:
    """The codes that the words fit, each with the length of the longest; a name is as long as a code."""
    fitting: dict[str, int] = {}
    for word in given.words:
        entries = with_prefix(word)
        if not word.strip() or not entries:
            raise UsageError(f"{given.source.name}: {unknown(word)}")
        if len(entries) == 1 and isinstance(entries[0], Retired):
            raise UsageError(f"{given.source.name}: {entries[0].code} is retired, take it out: {entries[0].reason}")
        for entry in entries:
            length = min(len(word.strip()), len(entry.code))
            fitting[entry.code] = max(length, fitting.get(entry.code, 0))
    return fitting
