"""Numbers, units and lists in the words of messages."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from shlex import quote


def counted(count: int, noun: str) -> str:
    """Return `1 start`, `1,200 starts`."""
    return f"{count:,} {noun}" if count == 1 else f"{count:,} {noun}s"


def number_text(value: float, digits: int = 4, *, sign: str = "") -> str:
    """Return a number with so many digits, or a larger one as a whole number: `12.35`, `12,346`. `sign` is
    `+` for a sum or a difference."""
    text = f"{value:{sign}z.{digits}g}"
    return f"{value:{sign},.0f}" if "e+" in text and abs(value) < 1e15 else text


def rate_text(rate: float, decimals: int = 0) -> str:
    """Return a rate or a share in percent, such as `52%`; `less than 1%` and `more than 99%` where rounding
    would say none or all."""
    text, step = f"{rate:.{decimals}%}", 10**-decimals
    if not 0 < rate < 1 or float(text[:-1]) not in (0, 100):
        return text
    return f"less than {step:g}%" if rate < 0.5 else f"more than {100 - step:g}%"


def beside(value: float, bar: float, digits: int = 4) -> tuple[str, str]:
    """Return a value and the bar that it should reach as texts: the value with so many digits, or as many as
    show on which side of the bar it lies."""
    texts = [number_text(value, more) for more in range(digits, 18)]
    apart = (text for text in texts if (value - bar) * (float(text.replace(",", "")) - bar) > 0)
    return next(apart, number_text(value, 12)), number_text(bar, 12)


def rate_beside(rate: float, bar: float) -> str:
    """Return a rate in percent beside the bar that it should reach: `89.6%` where 90% is needed, so that
    rounding shows no other side of the bar."""
    is_same_side = (rate < bar) == (round(rate, 2) < bar)
    return rate_text(rate) if is_same_side else f"{beside(100 * rate, 100 * bar)[0]}%"


def printable(text: str, kept: str = "") -> str:
    """Return a text, which may quote a file, with control and invisible characters escaped, but for those in
    `kept`."""
    return "".join(c if c.isprintable() or c in kept else f"\\u{{{ord(c):x}}}" for c in text)


def shell_word(word: Path | str) -> str:
    """Return a path or a name as one word of a command that a shell reads: `'my runs/a'`, and `./-a.yaml`,
    since `-a.yaml` would be an option."""
    text = str(word)
    return quote(f"./{text}" if text.startswith("-") else text)


def unit_text(unit: str) -> str:
    """Return a unit as users read it: empty for a plain number, whose unit is `1`."""
    return "" if unit == "1" else unit


def sentence_list(words: Sequence[str], last: str = "and") -> str:
    """Return a list in words: `a`, `a and b`, `a, b and c`."""
    return f" {last} ".join(filter(None, [", ".join(words[:-1]), *words[-1:]]))
