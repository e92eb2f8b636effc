"""Tables of the page, and figures in them."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

WIDTH = 150


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[str]:
    """The lines of a table in Markdown."""
    yield f"| {' | '.join(head)} |"
    yield "|" + "---|" * len(head)
    for row in rows:
        yield f"| {' | '.join(row)} |"


def wrapped(text: str) -> list[str]:
    """A paragraph in lines of the width of the other pages."""
    return textwrap.wrap(text, WIDTH, break_long_words=False, break_on_hyphens=False)


def number(value: float, digits: int = 4) -> str:
    """`0.2301`, `25 890`, `281 000`."""
    return f"{value:,.0f}".replace(",", " ") if abs(value) >= 10_000 else f"{value:.{digits}g}"


def count(value: int) -> str:
    return f"{value:,}".replace(",", " ") if value >= 10_000 else str(value)


def measured_on(entries: Iterable[Mapping[str, Any]]) -> list[str]:
    """When, on what and with which versions; a line for each machine and set of versions."""
    dates: dict[str, list[str]] = {}
    for entry in entries:
        versions = ", ".join(f"{name} {version}" for name, version in entry["versions"].items())
        dates.setdefault(f"{entry['machine']}, {versions}", []).append(entry["date"])
    lines = []
    for circumstances, days in dates.items():
        span = min(days) if min(days) == max(days) else f"{min(days)} to {max(days)}"
        lines += wrapped(f"Measured {span} on {circumstances}.")
    return lines
