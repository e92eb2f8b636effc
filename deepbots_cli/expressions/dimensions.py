"""Dimensions: what a quantity measures, as exponents of metre, kilogram, second and radian.

Angle is a dimension of its own, so that an angular velocity times a radius is no speed until the
radian is divided out.
"""

from __future__ import annotations

from fractions import Fraction
from typing import NamedTuple

Exponent = int | Fraction


class Dimension(NamedTuple):
    """Exponents of the base units; whole numbers, or fractions after a root.

    A tuple, since checking expressions is comparing dimensions; `*` is not that of tuples, though, which would repeat it.
    """

    m: Exponent = 0
    kg: Exponent = 0
    s: Exponent = 0
    rad: Exponent = 0

    def __mul__(self, other: Dimension) -> Dimension:  # type: ignore[override]
        return Dimension(self.m + other.m, self.kg + other.kg, self.s + other.s, self.rad + other.rad)

    def __truediv__(self, other: Dimension) -> Dimension:
        return Dimension(self.m - other.m, self.kg - other.kg, self.s - other.s, self.rad - other.rad)

    def __pow__(self, exponent: Exponent) -> Dimension:
        return Dimension(self.m * exponent, self.kg * exponent, self.s * exponent, self.rad * exponent)

    def __str__(self) -> str:
        """The unit in which the quantity is kept: `m/s^2`, `N*m`, `1` for a plain number."""
        return _UNIT_TEXT.get(self) or self._spelled()

    @property
    def words(self) -> str:
        """For a sentence: `a speed (m/s)`, `an angle (rad)`, `a plain number`."""
        if self == NUMBER:
            return "a plain number"
        noun = _NOUNS.get(self)
        return f"{noun} ({self})" if noun else f"a quantity in {self}"

    def _spelled(self) -> str:
        bases = (("kg", self.kg), ("m", self.m), ("s", self.s), ("rad", self.rad))
        above = "*".join(_power(base, exponent) for base, exponent in bases if exponent > 0)
        below = "".join(f"/{_power(base, -exponent)}" for base, exponent in bases if exponent < 0)
        return (above or "1") + below


def _power(base: str, exponent: Exponent) -> str:
    if exponent == 1:
        return base
    whole = Fraction(exponent).denominator == 1
    return f"{base}^{exponent}" if whole else f"{base}^({exponent})"


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

_UNIT_TEXT = {
    FORCE: "N",
    TORQUE: "N*m",
    POWER: "W",
    PRESSURE: "Pa",
    FORCE / LENGTH: "N/m",
    FORCE / SPEED: "N*s/m",
    TORQUE / ANGLE: "N*m/rad",
    TORQUE / ANGULAR_VELOCITY: "N*m*s/rad",
}
_NOUNS = {
    LENGTH: "a length",
    LENGTH**2: "an area",
    LENGTH**3: "a volume",
    MASS: "a mass",
    MASS / LENGTH**3: "a density",
    TIME: "a duration",
    ANGLE: "an angle",
    SPEED: "a speed",
    ACCELERATION: "an acceleration",
    ANGULAR_VELOCITY: "an angular velocity",
    ANGULAR_VELOCITY / TIME: "an angular acceleration",
    FREQUENCY: "a frequency",
    FORCE: "a force",
    TORQUE: "a torque or an energy",
    POWER: "a power",
    PRESSURE: "a pressure",
    MASS * LENGTH**2: "a moment of inertia",
    TORQUE / ANGLE: "a rotational stiffness",
    TORQUE / ANGULAR_VELOCITY: "a rotational damping",
}
