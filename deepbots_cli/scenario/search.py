"""The search space of `tune`: the values of one key that trials try.

1e-4 .. 1e-2 :log     a range, of which trials are drawn by its logarithm
0.5 .. 1.5 m          a range with a unit
16 .. 256             a range; of a key that takes whole numbers, only whole numbers
tanh | relu           choices
[[64, 64], [10, 10]]  choices, as a list
"""

import math
import re

from pydantic import BaseModel, ConfigDict
from pydantic_core import PydanticCustomError

from deepbots_cli.expressions.dimensions import ONE, Unit
from deepbots_cli.expressions.syntax import Number
from deepbots_cli.expressions.syntax import Range as RangeTree
from deepbots_cli.records import dataclass
from deepbots_cli.scenario.fields import FieldType, JsonSchema, error, mismatch
from deepbots_cli.scenario.quantities import Parsed

MAX_CHOICES = 64
_DIGITS = 4
"""Significant digits of a value that a trial tries, relative to the width of its range. They keep a file
readable that is written later."""


class SearchSpace(BaseModel):
    """The values that a key may take: `choices` as they are written, or else numbers from `low` to `high` in
    `unit`."""

    model_config = ConfigDict(frozen=True, strict=True, allow_inf_nan=False, defer_build=True)

    low: float = 0.0
    high: float = 0.0
    unit: str = ""
    log: bool = False
    whole: bool = False
    choices: tuple[str, ...] = ()

    def text(self, value: float | str, *, is_exact: bool = False) -> str:
        """Return a value as it is written in a scenario, rounded unless `is_exact`; never outside the
        range."""
        if isinstance(value, str):
            return value
        if self.whole:
            return str(round(value))
        size = abs(value) if self.log else self.high - self.low
        rounded = value if is_exact else round(value, _DIGITS - 1 - math.floor(math.log10(size)))
        return f"{min(max(rounded, self.low), self.high):.12g} {self.unit}".rstrip()

    def value_of(self, text: str) -> float | str | None:
        """Return the value that a text writes; None if it is none of these."""
        if self.choices:
            return next((choice for choice in self.choices if _is_same(choice, text)), None)
        tree, unit = _number(text), _number(f"1 {self.unit}")
        if tree is None or unit is None:
            return None
        value = _converted(tree, unit.unit or ONE)
        return (
            value
            if value is not None and self.low <= value <= self.high and (value.is_integer() or not self.whole)
            else None
        )

    @property
    def middle(self) -> float:
        """The middle of the range; with `log`, of the logarithms."""
        return math.sqrt(self.low * self.high) if self.log else (self.low + self.high) / 2

    def __str__(self) -> str:
        if self.choices:
            return " | ".join(self.choices)
        return f"{self.low:.12g} .. {self.high:.12g} {self.unit}".rstrip() + " :log" * self.log


def split_choices(text: str) -> tuple[str, ...]:
    """Return the choices of `a | b | c`; a single one if there is no `|`."""
    # Between the choices, but not within brackets.
    return tuple(part.strip() for part in re.split(r"\|(?![^\[\](){}]*[\])}])", text))


def read_range(text: str) -> SearchSpace:
    """Return the range that a text writes.

    Raises:
        PydanticCustomError: It is not a range of numbers, or is empty.
    """
    field = SearchField()
    marked = re.fullmatch(r"(?s)(.*?)\s*:\s*log\s*", text)
    tree = Parsed.tree(marked[1] if marked else text)
    if not (isinstance(tree, RangeTree) and isinstance(tree.low, Number) and isinstance(tree.high, Number)):
        raise mismatch(field.noun, field.help_for(text), value=text)
    low, high = tree.low, tree.high
    start = _converted(low, high.unit or ONE)
    if start is None:
        raise error(
            "DB503",
            f"the ends of `{text[:60]}` have different units",
            "write one unit behind both: `0.5 .. 1.5 m`",
        )
    if start >= high.value:
        raise error("DB105", f"the range `{text[:60]}` is empty", "write the low end first")
    if marked and start <= 0:
        raise error(
            "DB105", f"`{text[:60]}` has no logarithm at its low end", "begin above 0, or leave out `:log`"
        )
    return SearchSpace(
        low=start, high=float(high.value), unit=high.unit.text if high.unit else "", log=marked is not None
    )


def _number(text: str) -> Number | None:
    try:
        tree = Parsed.tree(text)
    except PydanticCustomError:
        return None
    return tree if isinstance(tree, Number) else None


def _is_same(text: str, other: str) -> bool:
    """Return whether two texts are the same, or write the same quantity."""
    number, other_number = _number(text), _number(other)
    if text == other or number is None or other_number is None:
        return text == other
    return _converted(other_number, number.unit or ONE) == number.value


def _converted(number: Number, unit: Unit) -> float | None:
    """Return a number in another unit, in the digits in which a range is written; None if this has another
    dimension."""
    number_unit = number.unit or ONE
    if number_unit.text == unit.text:
        return float(number.value)
    return (
        float(f"{number_unit.to_si(number.value) * unit.divisor / unit.scale:.12g}")
        if number_unit.dimension == unit.dimension
        else None
    )


@dataclass(frozen=True)
class SearchField(FieldType):
    """A search space; a range, or choices as a list or with `|` between them."""

    noun = "a range or choices"
    example = "1e-4 .. 1e-2 :log"
    accepted_types = (str, list, tuple)

    def help_for(self, value: object) -> str:
        return f"write a range like `{self.example}` or `0.5 .. 1.5 m`, or choices like `64 | 128 | 256`"

    def check(self, value: str | list[object] | tuple[object, ...]) -> None:
        count = len(split_choices(value) if isinstance(value, str) else value)
        if isinstance(value, str) and count == 1:
            read_range(value)
        elif not 2 <= count <= MAX_CHOICES:
            raise error("DB106", f"{count} choices", f"write 2 to {MAX_CHOICES} choices")

    def json_schema(self) -> JsonSchema:
        return {
            "type": ["string", "array"],
            "pattern": r"\.\.|\|",
            "patternErrorMessage": self.help_for(None),
            "minItems": 2,
        }
