"""Findings about elements, and the numbers and vectors that elements hold.

A value that cannot be read is reported once and replaced by a harmless one, so that it raises no
second finding further on; `Report.errors` says whether anything was replaced.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable

from deepbots_cli.diagnostics import Findings, Label
from deepbots_cli.diagnostics.nearest import nearest
from deepbots_cli.robots.xml import Element

MAX_TOLD = 100
# PyBullet was seen to answer with NaN at 1e200 and to work at 1e18.
MAX_MAGNITUDE = 1e18
MAX_LENIENT = 40  # words, and characters of one, of a vector that is shown corrected

_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]{1,4})?")

_OPTIONAL = re.compile(r"\$\(optenv [A-Za-z0-9_]{1,80} ([-+.0-9eE ]{1,120})\)")


def quoted(text: str) -> str:
    """`text` as it may stand in a message: in quotes, on one line, not longer than 60 characters."""
    return repr(text if len(text) <= 60 else text[:57] + "...")


def known_names(word: str, known: Iterable[str], kind: str) -> str:
    """The help for an unknown name: the nearest one, and what there is."""
    names = list(known)
    match = nearest(word, names)
    shown = ", ".join(names[:20]) + (f" and {len(names) - 20} more" if len(names) > 20 else "")
    listing = f"the {kind} are: {shown}" if names else f"there are no {kind}"
    return f"did you mean {quoted(match)}? {listing}" if match else listing


class Report:
    """Collects what is wrong with one file. Silent after a hundred errors and a hundred warnings: nobody reads more."""

    def __init__(self, findings: Findings) -> None:
        self._findings = findings
        self.errors = 0
        self._warnings = 0

    def error(
        self,
        element: Element,
        headline: str,
        *,
        attribute: str | None = None,
        help: str | None = None,
        also: tuple[Label, ...] = (),
        code: str = "DB301",
    ) -> None:
        self.errors += 1
        if self.errors <= MAX_TOLD:
            span = element.value_span(attribute) if attribute else element.span
            self._findings.add(code, span, headline, help=help, also=also)

    def warn(
        self,
        code: str,
        element: Element,
        headline: str,
        *,
        attribute: str | None = None,
        help: str | None = None,
        notes: tuple[str, ...] = (),
    ) -> None:
        self._warnings += 1
        if self._warnings <= MAX_TOLD:
            span = element.value_span(attribute) if attribute else element.span
            self._findings.add(code, span, headline, help=help, notes=notes)

    def only(self, element: Element, tag: str) -> Element | None:
        """The child called `tag`; further ones are reported and not read."""
        found = element.all(tag)
        for extra in found[1:]:
            self.warn("DB311", extra, f"a further <{tag}> in the same <{element.tag}> is not read", help="remove it")
        return found[0] if found else None

    def required(self, element: Element, tag: str) -> Element | None:
        """The child called `tag`, which must be there."""
        child = self.only(element, tag)
        if child is None:
            self.error(element, f"<{element.tag}> without <{tag}>", help=f"add <{tag} .../> inside it")
        return child

    def text(self, element: Element, name: str) -> str | None:
        """A required attribute that is not empty."""
        value = element.attributes.get(name)
        if value is None:
            self.error(element, f"<{element.tag}> without the attribute '{name}'", help=f'write <{element.tag} {name}="..."/>')
        elif not value.strip():
            self.error(element, f"the attribute '{name}' is empty", attribute=name)
            value = None
        return value

    def vector(self, element: Element, name: str, default: tuple[float, ...] | None, size: int) -> tuple[float, ...]:
        """`size` numbers apart by blanks; where `default` is None the attribute is required, and 1 stands in for it."""
        stand_in = default or (1.0,) * size
        if name not in element.attributes:
            if default is None:
                self.text(element, name)
            return stand_in
        words = self._expanded(element, name).split()
        if len(words) <= MAX_LENIENT and all(len(word) <= MAX_LENIENT for word in words):
            words = self._as_pybullet_reads(words, element, name, size)
        wrong = next((word for word in words if not _NUMBER.fullmatch(word)), None)
        if wrong is not None:
            help = "numbers are apart by blanks, without commas" if "," in wrong else None
            self.error(element, f"{quoted(wrong)} is not a finite number", attribute=name, help=help)
            return stand_in
        if len(words) != size:
            wanted = "one number" if size == 1 else f"{size} numbers"
            self.error(element, f"'{name}' needs {wanted}, not {len(words)}", attribute=name)
            return stand_in
        values = tuple(float(word) for word in words)
        if not all(math.isfinite(value) and abs(value) <= MAX_MAGNITUDE for value in values):
            self.error(element, f"'{name}' is larger than {MAX_MAGNITUDE:g}", attribute=name)
            return stand_in
        return values

    def _as_pybullet_reads(self, words: list[str], element: Element, name: str, size: int) -> list[str]:
        """The words as PyBullet reads them, with a warning for each difference; a word that is no number even so is kept.

        It skips a comma or a point after a number, but splits at blanks only, so that `1,2,3` would be one number to it. Of four
        numbers for three it takes the first three.
        """
        plain = [word if _NUMBER.fullmatch(word) else word.rstrip(",.") for word in words]
        if not all(map(_NUMBER.fullmatch, plain)):
            return words
        odd = next((word for word, number in zip(words, plain, strict=True) if word != number), None)
        if odd is not None:
            headline = f"{quoted(odd)} is not a number; {odd.rstrip(',.')} is read, as PyBullet does"
            self.warn("DB311", element, headline, attribute=name, help=f'write {name}="{" ".join(plain)}"')
        if size == 3 and len(plain) == 4:
            headline = f"'{name}' needs 3 numbers, not 4; the first 3 are read, as PyBullet does"
            self.warn("DB311", element, headline, attribute=name, help=f'write {name}="{" ".join(plain[:3])}"')
            return plain[:3]
        return plain

    def _expanded(self, element: Element, name: str) -> str:
        """The value, where `$(optenv NAME default)` of an unexpanded xacro file stands for its default."""
        value = element.attributes[name]
        found = _OPTIONAL.fullmatch(value.strip())
        if found is None:
            return value
        self.warn(
            "DB311", element, "a xacro substitution that has not been expanded", attribute=name, help=f"its default is read: {found[1]}"
        )
        return found[1]

    def number(self, element: Element, name: str, default: float | None = None) -> float:
        """One number; where `default` is None the attribute is required."""
        return self.vector(element, name, None if default is None else (default,), 1)[0]

    def not_negative(self, element: Element, name: str, default: float | None = None) -> float:
        """A number of at least 0."""
        value = self.number(element, name, default)
        if value < 0:
            self.error(element, f"'{name}' must not be negative", attribute=name)
            return default or 0.0
        return value
