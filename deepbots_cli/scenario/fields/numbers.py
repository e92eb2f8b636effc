"""Plain numbers: what a text is as a number, bounds, and the types of numbers without a unit."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import AfterValidator

from deepbots_cli.diagnostics.nearest import Replacement
from deepbots_cli.scenario.fields.base import FieldType, JsonSchema, Scalar, error

MAX_MAGNITUDE = 1e30
"""The magnitude beyond which a number has no physical meaning, and arithmetic on it overflows."""
NUMBER_PATTERN = r"[-+]?(?:[0-9]+(?:_[0-9]{3})*\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
PERCENT_PATTERN = rf"\s*({NUMBER_PATTERN}\s*%)\s*"
GROUPED_DIGITS = r"[-+]?[0-9]{1,3}(_[0-9]{3})+"
"""Digits in groups of three: a number in a scenario, but a text in editors, which read YAML 1.2."""
_MAX_NUMBER_LENGTH = 40


# Reading


def read_fraction(value: str | float) -> float:
    """Return the number that `0.8` or `80 %` is. Divided, since 57 * 0.01 is not 0.57."""
    percent = re.fullmatch(PERCENT_PATTERN, value) if isinstance(value, str) else None
    if percent:
        return float(percent[1].rstrip("%").rstrip()) / 100
    if isinstance(value, str):
        return float(value)
    return value


def count_replacement(value: object) -> str | None:
    """Return the whole number that `200k` or `1e5` was meant to be."""
    # Below 1,000, the point may be a thousands separator.
    if isinstance(value, float) and value.is_integer() and 1_000 <= value < 1e15:
        return f"{int(value):_}"
    match = re.fullmatch(r"([0-9]{1,6})([kKM])", value) if isinstance(value, str) else None
    return f"{int(match[1]) * (1_000_000 if match[2] == 'M' else 1_000):_}" if match else None


def number_replacement(value: object) -> Replacement | None:
    """Return the number that a text in quotes, or with a decimal comma, was meant to be; a comma may also
    group thousands."""
    # The pattern takes quadratic time in the number of digits.
    text = value.strip() if isinstance(value, str) and len(value) <= _MAX_NUMBER_LENGTH else ""
    if re.fullmatch(NUMBER_PATTERN, text):
        return Replacement(text, safe=True)
    if match := re.fullmatch(r"([-+]?[0-9]+),([0-9]+(?:[eE][-+]?[0-9]+)?)", text):
        return Replacement(f"{match[1]}.{match[2]}", safe=len(match[2]) != 3 or match[1].lstrip("+-") == "0")
    return None


def number_help(value: object) -> str | None:
    near = number_replacement(value)
    if near is None:
        return None
    is_quoted = isinstance(value, str) and "," not in value
    return (
        f"write `{near.text}` without quotes" if is_quoted else f"write `{near.text}`: decimals need a point"
    )


# Checks of numbers


def check_bounds(
    value: float,
    minimum: float | None = None,
    maximum: float | None = None,
    *,
    exclusive: bool = False,
    is_share: bool = False,
    written: str = "",
) -> None:
    """Raise DB105 unless `value` is finite and inside; with `exclusive` the minimum itself is outside. The
    message has the text as `written`, by default the value."""
    if not -MAX_MAGNITUDE <= value <= MAX_MAGNITUDE:
        is_nan = isinstance(value, float) and math.isnan(value)
        raise error("DB105", "the value is not a number" if is_nan else "the number is implausibly large")
    if minimum is not None and (value < minimum or (exclusive and value == minimum)):
        help = f"write {'more than' if exclusive else 'at least'} {_number_text(minimum)}"
        raise error("DB105", f"`{written or value}` is below the smallest allowed value", help)
    if maximum is not None and value > maximum:
        help = f"write at most {_number_text(maximum)}"
        if is_share and written.endswith("%"):
            help = "write at most 100 %"
        elif is_share and value <= 100:
            help += f", or a percentage: `{value:g} %`"
        raise error("DB105", f"`{written or value}` is above the largest allowed value", help)


def _number_text(number: float) -> str:
    """Return a number as a scenario may have it: a whole one without an exponent."""
    if not float(number).is_integer() or abs(number) >= MAX_MAGNITUDE:
        return repr(number)
    # The pattern of `over 10000 episodes` has no underscores.
    return f"{int(number):_}" if abs(number) >= 1_000_000 else str(int(number))


# Field types


@dataclass(frozen=True)
class Number(FieldType):
    """A plain number within bounds, or a text that matches `pattern`, whose groups are such numbers or
    percentages.

    With `exclusive` the minimum itself is refused.
    """

    minimum: float | None = None
    maximum: float | None = None
    exclusive: bool = False
    pattern: str = ""
    noun: str = "a number"
    example: str | None = None

    @property
    def accepted_types(self) -> tuple[type, ...]:
        return (int, float)

    def has_form(self, value: object) -> bool:
        return (
            re.fullmatch(self.pattern, value) is not None
            if isinstance(value, str)
            else super().has_form(value)
        )

    def check(self, value: Any) -> None:
        match = re.fullmatch(self.pattern, value) if isinstance(value, str) else None
        for text in match.groups() if match else [""]:
            check_bounds(
                read_fraction(text) if text else value,
                self.minimum,
                self.maximum,
                exclusive=self.exclusive,
                is_share=self.maximum == 1,
                written=text,
            )

    def help_for(self, value: object) -> str | None:
        return number_help(value) or super().help_for(value)

    def replacement_for(self, value: object) -> Replacement | None:
        return number_replacement(value)

    def json_schema(self) -> JsonSchema:
        bounds = {"exclusiveMinimum" if self.exclusive else "minimum": self.minimum, "maximum": self.maximum}
        schema = self._matching(
            f"^({self.pattern}|{GROUPED_DIGITS})$" if self.pattern else f"^{GROUPED_DIGITS}$"
        )
        schema["type"] = [super().json_schema()["type"], "string"]
        return schema | {word: bound for word, bound in bounds.items() if bound is not None}


@dataclass(frozen=True)
class WholeNumber(Number):
    """A whole number within bounds."""

    noun: str = "a whole number"

    @property
    def accepted_types(self) -> tuple[type, ...]:
        return (int,)

    def help_for(self, value: object) -> str | None:
        near = count_replacement(value)
        return f"write `{near}`; digits are grouped as in `100_000`" if near else super().help_for(value)

    def replacement_for(self, value: object) -> Replacement | None:
        near = count_replacement(value)
        if near:
            return Replacement(near, safe=isinstance(value, str))
        replacement = super().replacement_for(value)
        return replacement if replacement and re.fullmatch(r"[-+]?[0-9_]+", replacement.text) else None


PositiveInt = Annotated[int, WholeNumber(1, 1_000_000_000)]
SmallInt = Annotated[int, WholeNumber(1, 1000)]
Fraction = Annotated[
    Scalar,
    Number(0, 1, pattern=PERCENT_PATTERN, noun="a number from 0 to 1", example="0.9"),
    AfterValidator(read_fraction),
]
