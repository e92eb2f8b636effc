"""Units: the names that may stand behind a number.

Unit names are reserved: no parameter or signal may take one. In an expression a unit name that
stands alone is a constant of one such unit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from deepbots_cli.diagnostics.nearest import Meant
from deepbots_cli.expressions.dimensions import (
    ANGLE,
    ANGULAR_VELOCITY,
    FORCE,
    FREQUENCY,
    LENGTH,
    MASS,
    NUMBER,
    POWER,
    PRESSURE,
    TIME,
    TORQUE,
    Dimension,
)


@dataclass(frozen=True)
class Unit:
    """`value` of this unit is `value * scale / divisor` in SI.

    The divisor is kept apart because 57 / 100 is the float 0.57 and 57 * 0.01 is not.
    """

    text: str
    dimension: Dimension
    scale: float = 1.0
    divisor: float = 1.0

    def to_si(self, value: float) -> float:
        return value * self.scale / self.divisor

    def times(self, other: Unit) -> Unit:
        return Unit(f"{self.text}*{other.text}", self.dimension * other.dimension, self.scale * other.scale, self.divisor * other.divisor)

    def per(self, other: Unit) -> Unit:
        return Unit(f"{self.text}/{other.text}", self.dimension / other.dimension, self.scale * other.divisor, self.divisor * other.scale)

    def to_power(self, exponent: int) -> Unit:
        """Raised to `exponent`, which the parser keeps small enough for the factors to stay finite."""
        if exponent < 0:
            return Unit(f"{self.text}^{exponent}", self.dimension**exponent, self.divisor**-exponent, self.scale**-exponent)
        return Unit(f"{self.text}^{exponent}", self.dimension**exponent, self.scale**exponent, self.divisor**exponent)


ONE = Unit("1", NUMBER)
UNITS = {
    unit.text: unit
    for unit in (
        Unit("m", LENGTH),
        Unit("mm", LENGTH, divisor=1000.0),
        Unit("cm", LENGTH, divisor=100.0),
        Unit("km", LENGTH, scale=1000.0),
        Unit("s", TIME),
        Unit("ms", TIME, divisor=1000.0),
        Unit("us", TIME, divisor=1e6),
        Unit("min", TIME, scale=60.0),
        Unit("h", TIME, scale=3600.0),
        Unit("kg", MASS),
        Unit("g", MASS, divisor=1000.0),
        Unit("rad", ANGLE),
        Unit("deg", ANGLE, scale=math.pi / 180.0),
        Unit("rpm", ANGULAR_VELOCITY, scale=math.pi / 30.0),
        Unit("Hz", FREQUENCY),
        Unit("kHz", FREQUENCY, scale=1000.0),
        Unit("N", FORCE),
        Unit("mN", FORCE, divisor=1000.0),
        Unit("kN", FORCE, scale=1000.0),
        Unit("J", TORQUE),
        Unit("W", POWER),
        Unit("Pa", PRESSURE),
        Unit("kPa", PRESSURE, scale=1000.0),
        Unit("%", NUMBER, divisor=100.0),
    )
}

_MEANT = {
    "meter": "m",
    "meters": "m",
    "metre": "m",
    "metres": "m",
    "millimeter": "mm",
    "millimeters": "mm",
    "millimetre": "mm",
    "millimetres": "mm",
    "centimeter": "cm",
    "centimeters": "cm",
    "centimetre": "cm",
    "centimetres": "cm",
    "sec": "s",
    "secs": "s",
    "second": "s",
    "seconds": "s",
    "msec": "ms",
    "millisecond": "ms",
    "milliseconds": "ms",
    "minute": "min",
    "minutes": "min",
    "hour": "h",
    "hours": "h",
    "gram": "g",
    "grams": "g",
    "kilogram": "kg",
    "kilograms": "kg",
    "degree": "deg",
    "degrees": "deg",
    "radian": "rad",
    "radians": "rad",
    "rads": "rad/s",
    "mps": "m/s",
    "Nm": "N*m",
    "nm": "N*m",
    "newton": "N",
    "newtons": "N",
    "hz": "Hz",
    "hertz": "Hz",
    "joule": "J",
    "watt": "W",
    "percent": "%",
}


_LOOSE = frozenset({"rads", "nm"})
"""More than one radian, or nanometres, may be meant as well."""


_PREFIXES = {"n": 1e-9, "u": 1e-6, "\u00b5": 1e-6, "m": 1e-3, "k": 1e3, "M": 1e6}


def suggest_unit(name: str) -> Meant | None:
    """The unit that was probably meant by the unknown `name`; certain where that is its name written out."""
    known = name if name in _MEANT else name.lower()
    if known in _MEANT:
        return Meant(_MEANT[known], known not in _LOOSE)
    if multiple(name) is not None:
        return None  # the unit without its prefix would be another figure
    if len(name) > 1 and known in UNITS:
        return Meant(known, safe=False)
    from difflib import get_close_matches  # only on the way to a finding: its import costs 4 ms; here case tells apart: m, M

    close = get_close_matches(name, UNITS, n=1)
    return Meant(close[0], safe=False) if close else None


def multiple(name: str) -> tuple[float, str] | None:
    """The multiple of a known unit that `name` is, as `mrad` is 0.001 rad; the language has a few of them only."""
    return (_PREFIXES[name[0]], name[1:]) if name[:1] in _PREFIXES and name[1:] in UNITS else None
