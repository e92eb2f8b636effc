"""A sentence and its evidence: the form of every row in the two tables.

A row has one template of a sentence, and one function that finds the numbers for it. A sentence is printed only with its numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np

Numbers = Mapping[str, Any]
T = TypeVar("T")


@dataclass(frozen=True)
class Row(Generic[T]):
    """A row of a table.

    `text` has a field in braces for each piece of the evidence; `advice` is what to try, with the same fields. `find` returns the evidence,
    or None where the row does not apply. Evidence may hold more than the sentence shows; `--json` has all of it. Its entry `likelihood`
    (0 to 1) orders causes.
    """

    cause: str
    text: str
    find: Callable[[T], Numbers | None]
    advice: str = ""

    def state(self, about: T) -> Statement | None:
        evidence = self.find(about)
        if evidence is None:
            return None
        shown = {key: _shown(value) for key, value in evidence.items()}
        return Statement(self.cause, self.text.format(**shown), self.advice.format(**shown), _plain(evidence))


@dataclass(frozen=True)
class Statement:
    """A sentence with the numbers that it rests on."""

    cause: str
    text: str
    advice: str
    evidence: Mapping[str, Any]

    def as_json(self) -> dict[str, Any]:
        return {"cause": self.cause, "text": self.text, **({"advice": self.advice} if self.advice else {}), "evidence": self.evidence}


@dataclass(frozen=True)
class Share:
    """A share, shown in per cent."""

    value: float


def state_all(rows: Sequence[Row[T]], about: T) -> list[Statement]:
    return [found for row in rows if (found := row.state(about)) is not None]


def _plain(value: Any) -> Any:
    match value:
        case Share(value=share):
            return float(share)
        case Mapping():
            return {key: _plain(part) for key, part in value.items()}
        case list() | tuple():
            return [_plain(part) for part in value]
        case np.floating() | np.integer() | np.bool_():
            return value.item()
        case _:
            return value


def _shown(value: Any) -> str:
    match value:
        case Share(value=share):
            return f"{share:.0%}" if share in (0.0, 1.0) or 0.005 <= share < 0.995 else "less than 1%" if share < 0.5 else "more than 99%"
        case bool() | str():
            return str(value)
        case float() | np.floating():
            return f"{value:.4g}"
        case int() | np.integer():
            return f"{value:,}"
        case _:
            return str(value)


_DEGREES = {"rad": "deg", "rad/s": "deg/s", "rad/s^2": "deg/s^2"}


def quantity(value: float, unit: str) -> str:
    """`15.3 deg`: a number in the unit that people use, given in SI units."""
    if unit in _DEGREES:
        value, unit = float(np.degrees(value)), _DEGREES[unit]
    return f"{value:.4g}{'' if unit in ('', '1') else f' {unit}'}"


def listed(parts: Sequence[str]) -> str:
    """`a, b and c`."""
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"
