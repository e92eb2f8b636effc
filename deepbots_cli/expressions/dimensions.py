"""Dimensions of quantities, and their units.

Angle is a dimension: an angular velocity times a radius is a speed only after division by a radian. The
exception is work, see `_without_angle`. Unit
names are reserved: no parameter or signal may take one. A unit name without a number is one of the unit.
"""

from __future__ import annotations

import math
from fractions import Fraction
from typing import NamedTuple

from deepbots_cli.diagnostics.nearest import Replacement

Exponent = int | Fraction
MAX_FACTORS = 8  # of a unit behind a number; a factor has a whole power up to this, too

_WRITTEN_OUT = {
    word: unit
    for unit, words in {
        "m": "meter meters metre metres",
        "mm": "millimeter millimeters millimetre millimetres",
        "cm": "centimeter centimeters centimetre centimetres",
        "s": "sec secs second seconds",
        "ms": "msec millisecond milliseconds",
        "min": "minute minutes",
        "h": "hour hours",
        "g": "gram grams",
        "kg": "kilogram kilograms",
        "deg": "degree degrees",
        "rad": "radian radians rads",
        "m/s": "mps",
        "N*m": "Nm nm",
        "N": "newton newtons",
        "Hz": "hz hertz",
        "J": "joule",
        "W": "watt",
        "%": "percent",
    }.items()
    for word in words.split()
}
_AMBIGUOUS = frozenset({"rads", "nm"})
"""The names of units that may also mean radians per second, and nanometres."""
_PREFIXES = {"n": 1e-9, "u": 1e-6, "\u00b5": 1e-6, "m": 1e-3, "k": 1e3, "M": 1e6}


class Dimension(NamedTuple):
    """Exponents of metre, kilogram, second and radian: whole numbers, or fractions after a root.

    `*` multiplies the quantities; it does not repeat the tuple.
    """

    m: Exponent = 0
    kg: Exponent = 0
    s: Exponent = 0
    rad: Exponent = 0

    def __mul__(self, other: Dimension) -> Dimension:  # type: ignore[override]
        return _without_angle(self.m + other.m, self.kg + other.kg, self.s + other.s, self.rad + other.rad)

    def __truediv__(self, other: Dimension) -> Dimension:
        return _without_angle(self.m - other.m, self.kg - other.kg, self.s - other.s, self.rad - other.rad)

    def __pow__(self, exponent: Exponent) -> Dimension:
        return _without_angle(self.m * exponent, self.kg * exponent, self.s * exponent, self.rad * exponent)

    def __str__(self) -> str:
        """Return the SI unit of the quantity: `m/s^2`, `N*m`, `1` for a plain number."""
        if unit := physical_quantity(self).unit:
            return unit
        bases = (("kg", self.kg), ("m", self.m), ("s", self.s), ("rad", self.rad))
        above = "*".join(_power(base, exponent) for base, exponent in bases if exponent > 0)
        below = "".join(f"/{_power(base, -exponent)}" for base, exponent in bases if exponent < 0)
        return (above or "1") + below

    @property
    def description(self) -> str:
        """The dimension for a sentence: `a speed (m/s)`, `an angle (rad)`, `a plain number`."""
        if self == NUMBER:
            return "a plain number"
        noun = physical_quantity(self).noun
        return f"{noun} ({self})" if noun else f"a quantity in {self}"

    @property
    def example(self) -> str:
        """A value with its unit, for a hint."""
        return physical_quantity(self).example or f"0.5 {self.unit_behind_number}"

    @property
    def unit_behind_number(self) -> str:
        """The SI unit as it is written behind a number; as a factor where its exponents are too large, or
        fractions."""
        return str(self) if {*self} <= {*range(-MAX_FACTORS, MAX_FACTORS + 1)} else f"* {self}"


def _without_angle(m: Exponent, kg: Exponent, s: Exponent, rad: Exponent) -> Dimension:
    """Return the dimension of a product, in which work and power are not measured in radians.

    A torque times an angular velocity is a power, a moment of inertia times an angular acceleration is a
    torque: if a quantity has the metres and kilograms of these (kg*m^2, or a power of it), its radians are
    dropped. The radians of a stiffness (N*m/rad) stay.
    """
    if kg != 0 and m == 2 * kg and rad * kg > 0:
        rad = 0
    return Dimension(m, kg, s, rad)


def _power(base: str, exponent: Exponent) -> str:
    if exponent == 1:
        return base
    return f"{base}^{exponent}" if Fraction(exponent).denominator == 1 else f"{base}^({exponent})"


NUMBER = Dimension()
LENGTH = Dimension(m=1)
MASS = Dimension(kg=1)
TIME = Dimension(s=1)
ANGLE = Dimension(rad=1)
SPEED = LENGTH / TIME
ACCELERATION = SPEED / TIME
ANGULAR_VELOCITY = ANGLE / TIME
FREQUENCY = NUMBER / TIME
FORCE = MASS * ACCELERATION
TORQUE = FORCE * LENGTH
POWER = TORQUE / TIME
PRESSURE = FORCE / LENGTH**2


class PhysicalQuantity(NamedTuple):
    """The words of messages about a dimension.

    `unit` replaces a combination of base units. Values beyond `plausible_limit` (SI) get a warning: their
    unit or exponent is probably wrong.
    """

    dimension: Dimension
    noun: str = ""
    unit: str = ""
    example: str = ""
    plausible_limit: float = math.inf


_QUANTITIES = {
    quantity.dimension: quantity
    for quantity in (
        PhysicalQuantity(LENGTH, "a length", example="0.5 m", plausible_limit=1e5),
        PhysicalQuantity(LENGTH**2, "an area"),
        PhysicalQuantity(LENGTH**3, "a volume"),
        PhysicalQuantity(MASS / LENGTH**3, "a density"),
        PhysicalQuantity(MASS, "a mass", example="0.5 kg", plausible_limit=1e6),
        PhysicalQuantity(TIME, "a duration", example="20 ms", plausible_limit=1e7),
        PhysicalQuantity(ANGLE, "an angle", example="30 deg", plausible_limit=1e4),
        PhysicalQuantity(SPEED, "a speed", plausible_limit=1e4),
        PhysicalQuantity(ACCELERATION, "an acceleration", plausible_limit=1e6),
        PhysicalQuantity(ANGULAR_VELOCITY, "an angular velocity", plausible_limit=1e5),
        PhysicalQuantity(ANGULAR_VELOCITY / TIME, "an angular acceleration"),
        PhysicalQuantity(FREQUENCY, "a frequency"),
        PhysicalQuantity(FORCE, "a force", "N", plausible_limit=1e8),
        PhysicalQuantity(TORQUE, "a torque or an energy", "N*m", plausible_limit=1e8),
        PhysicalQuantity(POWER, "a power", "W"),
        PhysicalQuantity(PRESSURE, "a pressure", "Pa"),
        PhysicalQuantity(MASS * LENGTH**2, "a moment of inertia"),
        PhysicalQuantity(FORCE / LENGTH, unit="N/m"),
        PhysicalQuantity(FORCE / SPEED, unit="N*s/m"),
        PhysicalQuantity(TORQUE / ANGLE, "a rotational stiffness", "N*m/rad"),
        PhysicalQuantity(TORQUE / ANGULAR_VELOCITY, "a rotational damping", "N*m*s/rad"),
    )
}


def physical_quantity(dimension: Dimension) -> PhysicalQuantity:
    """Return noun, unit and plausible values of a dimension; empty if the messages have no word for it."""
    return _QUANTITIES.get(dimension) or PhysicalQuantity(dimension)


class Unit(NamedTuple):
    """A `value` of this unit is `value * scale / divisor` in SI units.

    The divisor is kept apart because 57 / 100 is the float 0.57 and 57 * 0.01 is not.
    """

    text: str
    dimension: Dimension
    scale: float = 1.0
    divisor: float = 1.0

    def to_si(self, value: float) -> float:
        return value * self.scale / self.divisor

    def from_si(self, value: float) -> float:
        return value * self.divisor / self.scale

    def times(self, other: Unit) -> Unit:
        return Unit(
            f"{self.text}*{other.text}",
            self.dimension * other.dimension,
            self.scale * other.scale,
            self.divisor * other.divisor,
        )

    def per(self, other: Unit) -> Unit:
        return Unit(
            f"{self.text}/{other.text}",
            self.dimension / other.dimension,
            self.scale * other.divisor,
            self.divisor * other.scale,
        )

    def to_power(self, exponent: int) -> Unit:
        """Return the unit raised to `exponent`, which the parser keeps small enough for the factors to stay
        finite."""
        scale, divisor = (self.scale, self.divisor) if exponent >= 0 else (self.divisor, self.scale)
        return Unit(
            f"{self.text}^{exponent}",
            self.dimension**exponent,
            scale ** abs(exponent),
            divisor ** abs(exponent),
        )


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


def suggest_unit(name: str) -> Replacement | None:
    """Return the unit that the unknown `name` probably means; safe where `name` is the unit written out."""
    spelling = name if name in _WRITTEN_OUT else name.lower()
    if spelling in _WRITTEN_OUT:
        return Replacement(_WRITTEN_OUT[spelling], spelling not in _AMBIGUOUS)
    if prefixed_unit(name) is not None:
        return None  # the unit without its prefix would be another value
    if len(name) > 1 and spelling in UNITS:
        return Replacement(spelling, safe=False)
    # The import costs 4 ms, and only findings need it. Case matters here: m, M.
    from difflib import get_close_matches

    close = get_close_matches(name, UNITS, n=1)
    return Replacement(close[0], safe=False) if close else None


def prefixed_unit(name: str) -> tuple[float, str] | None:
    """Return factor and unit if `name` is a known unit with a prefix that the language lacks: `mrad` is 0.001
    rad."""
    return (_PREFIXES[name[0]], name[1:]) if name[:1] in _PREFIXES and name[1:] in UNITS else None
