"""The units that a text of the file is written in, so that a quantity is shown in them."""

from __future__ import annotations

import re
from collections.abc import Iterator

from deepbots_cli.expressions.dimensions import ONE, UNITS, Unit
from deepbots_cli.expressions.syntax import NUMBER

_WORD = r"(?:[A-Za-z]+|%)(?:\^-?\d)?"
_UNIT = re.compile(rf"{NUMBER}\s*({_WORD}(?:[*/]{_WORD})*)")
_COMPOUND = re.compile(rf"(?:{NUMBER})\s*\(({_WORD}(?:[*/]{_WORD})*)\)")
MAX_TEXT = 10_000
"""Letters of an expression that are searched for a unit."""


def written_unit(unit: str, *texts: str) -> Unit | None:
    """The first unit in the texts that measures the same as the SI unit `unit`, or None."""
    units = (found for text in texts for found in _units_in(text))
    return next((found for found in units if str(found.dimension) == unit), None)


def _units_in(text: str) -> Iterator[Unit]:
    """The units that follow a number in a text, in their order."""
    text = text[:MAX_TEXT]
    matches = [*_UNIT.finditer(text), *_COMPOUND.finditer(text)]
    for match in sorted(matches, key=lambda each: each.start()):
        unit = _unit(match[1])
        if unit is not None:
            yield unit


def _unit(text: str) -> Unit | None:
    """`deg/s` as a unit; None where a word is none."""
    whole, divides = ONE, False
    for word in re.split(r"([*/])", text):
        if word in ("*", "/"):
            divides = word == "/"
            continue
        name, _, exponent = word.partition("^")
        if name not in UNITS:
            return None
        power = UNITS[name] if not exponent else UNITS[name].to_power(int(exponent))._replace(text=word)
        whole = whole.per(power) if divides else power if whole is ONE else whole.times(power)
    return whole._replace(text=text)
