"""Numbers, units and lists in the words of messages."""

from __future__ import annotations

from collections.abc import Sequence


def counted(count: int, noun: str) -> str:
    """Return `1 start`, `1,200 starts`."""
    return f"{count:,} {noun}" if count == 1 else f"{count:,} {noun}s"


def printable(text: str, kept: str = "") -> str:
    """Return a text, which may quote a file, with control and invisible characters escaped, but for those in
    `kept`."""
    return "".join(c if c.isprintable() or c in kept else f"\\u{{{ord(c):x}}}" for c in text)


def unit_text(unit: str) -> str:
    """Return a unit as users read it: empty for a plain number, whose unit is `1`."""
    return "" if unit == "1" else unit


def sentence_list(words: Sequence[str], last: str = "and") -> str:
    """Return a list in words: `a`, `a and b`, `a, b and c`."""
    return f" {last} ".join(filter(None, [", ".join(words[:-1]), *words[-1:]]))
