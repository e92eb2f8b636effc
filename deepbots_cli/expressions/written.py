"""The units that a text of the file is written in, and the unit of a quantity that no text writes."""

from __future__ import annotations

import re
from collections.abc import Iterator

from deepbots_cli.expressions.dimensions import ONE, UNITS, Unit
from deepbots_cli.expressions.syntax import NUMBER

_NAME = "|".join(map(re.escape, sorted(UNITS, key=len, reverse=True)))
_WORD = rf"(?:{_NAME})(?!\w)(?:\^-?\d)?"
_UNIT = re.compile(rf"(?<![\w.]){NUMBER}\s*({_WORD}(?:[*/]{_WORD})*)")
_USUAL = {"rad": "deg", "rad/s": "deg/s", "rad/s^2": "deg/s^2"}
_COMPOUND = re.compile(rf"(?<![\w.])(?:{NUMBER})\s*\(({_WORD}(?:[*/]{_WORD})*)\)")
MAX_TEXT = 10_000
"""The maximum number of letters of an expression that are searched for a unit."""


def written_unit(unit: str, *texts: str) -> Unit | None:
    """Return the first unit in the texts that measures the same as the SI unit `unit`, or None."""
    units = (candidate for text in texts for candidate in units_in(text))
    return next((candidate for candidate in units if str(candidate.dimension) == unit), None)


def usual_unit(unit: str) -> Unit:
    """Return the unit in which people read a quantity in the SI unit `unit` that no text writes: deg for rad,
    else the SI unit."""
    return unit_named(_USUAL.get(unit, unit))


def unit_named(text: str) -> Unit:
    """Return the unit `deg/s`; one without a dimension where a word of the text is none."""
    return ONE if text in ("", "1") else _unit(text) or Unit(text, ONE.dimension)


def units_in(text: str) -> Iterator[Unit]:
    """Yield the units that follow a number in a text, in their order."""
    text = text[:MAX_TEXT]
    matches = [*_UNIT.finditer(text), *_COMPOUND.finditer(text)]
    for match in sorted(matches, key=lambda match: match.start()):
        unit = _unit(match[1])
        if unit is not None:
            yield unit


def _unit(text: str) -> Unit | None:
    """Return `deg/s` as a unit; None if a word is not a unit."""
    unit = ONE
    divides = False
    for word in re.split(r"([*/])", text):
        if word in ("*", "/"):
            divides = word == "/"
            continue
        name, _, exponent = word.partition("^")
        if name not in UNITS:
            return None
        power = UNITS[name] if not exponent else UNITS[name].to_power(int(exponent))._replace(text=word)
        if divides:
            unit = unit.per(power)
        elif unit is ONE:
            unit = power
        else:
            unit = unit.times(power)
    return unit._replace(text=text)
