"""Strategies for single values: one entry for each class of `scenario/fields.py` and `scenario/quantities.py`.

`value_of` fails for a class without an entry, so a new field type needs a strategy the day it is entered.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from hypothesis import strategies as st

from deepbots_cli.expressions.dimensions import NUMBER, Dimension
from deepbots_cli.expressions.types import Context, Known, ValueType
from deepbots_cli.scenario.fields import (
    COLORS,
    ArgumentValue,
    ColorValue,
    FieldType,
    FilePath,
    Flag,
    Name,
    Pattern,
    Reference,
    Text,
    Word,
)
from deepbots_cli.scenario.quantities import (
    NUMBER_PATTERN,
    Bounds,
    Column,
    Expression,
    Number,
    Quantity,
    Range,
    Setting,
    Solved,
    Until,
    WholeNumber,
    dimension_of,
)
from deepbots_cli.scenario.search import SearchField
from tests.laws.expressions import (
    Draw,
    Expressions,
    Names,
    UnavailableError,
    chance,
    literal,
    literal_range,
    number_text,
    pick,
)

SPANS: dict[str, tuple[float, float]] = {
    "length": (0.02, 0.4),
    "time": (0.01, 0.2),
    "angle": (0.1, 1.5),
    "mass": (0.05, 2.0),
    "density": (200.0, 2000.0),
    "number": (0.1, 1.0),
    "speed": (0.1, 2.0),
    "angular speed": (0.1, 5.0),
    "acceleration": (1.0, 10.0),
    "angular acceleration or acceleration": (1.0, 20.0),
    "force": (0.1, 2.0),
    "torque": (0.01, 0.5),
    "torque or force": (0.1, 5.0),
    "stiffness": (1.0, 20.0),
    "damping": (0.01, 0.5),
    "moment of inertia or mass": (0.001, 0.01),
    "angle or length": (0.05, 0.5),
    "angular speed or speed": (0.5, 5.0),
    "reading": (0.001, 0.1),
    "any": (0.1, 1.0),
}
"""Plausible magnitudes of each measure, in SI units: of a robot as large as a hand or a dog."""


@dataclass(frozen=True)
class Place:
    """Where a value stands.

    Attributes:
        kind: The type of what the section measures or changes, for `reading` and `any`.
        second: Whether measures of two dimensions take the second one: those of a sliding joint.
        robot: The robot to which the section belongs.
        joint: The joint to which the section belongs, as `cart.hinge`.
        body: The body, or another name, under which the section is.
    """

    kind: ValueType = field(default_factory=ValueType)
    second: bool = False
    robot: str = ""
    joint: str = ""
    body: str = ""


class Values:
    """Draws single values. `Author` adds the names of the scenario."""

    def __init__(self, draw: Draw) -> None:
        self.draw = draw

    def names(self, context: Context, robot: str = "") -> Names:
        raise NotImplementedError

    def new_name(self) -> str:
        raise NotImplementedError

    def references(self, kind: str, robot: str) -> list[str]:
        raise NotImplementedError

    def value_of(self, kind: FieldType, place: Place) -> Any:
        """Draw a value of a field type.

        Raises:
            UnavailableError: The scenario has nothing that could stand here.
            KeyError: The class of the field type has no entry in `FIELDS`.
        """
        return plain(FIELDS[type(kind)](self, kind, place))

    def expression(
        self, context: Context, kind: ValueType, robot: str = "", latest: Known = Known.STEP
    ) -> str:
        """Draw an expression of a type, from values that are known by `latest`."""
        return plain(Expressions(self.draw, self.names(context, robot).known_by(latest)).text(kind))

    def dimension(self, quantity: Quantity | Range, place: Place) -> Dimension:
        own = dimension_of(quantity.measure, place.kind.dimension, second=place.second)
        return place.kind.dimension if own is None else own


def plain(value: Any) -> Any:
    """Return the number or the truth value that a text is, since a scenario writes these without quotes."""
    if value in ("true", "false"):
        return value == "true"
    if isinstance(value, str) and re.fullmatch(NUMBER_PATTERN, value):
        return float(value)
    return value


# Numbers


def _whole(values: Values, kind: WholeNumber, _place: Place) -> int:
    low = int(kind.minimum if kind.minimum is not None else 0)
    high = int(kind.maximum if kind.maximum is not None else 10)
    if low < 0:  # -1 is another word for all
        return pick(values.draw, (-1, 1, 2))
    return values.draw(st.integers(low, min(high, low + 6)))


def _number(values: Values, kind: Number, _place: Place) -> float:
    low = kind.minimum if kind.minimum is not None else 0.0
    high = kind.maximum if kind.maximum is not None else low + 1.0
    parts = values.draw(st.integers(1, 4))
    return float(number_text(low + (high - low) * parts / 5))


def _bounds_of(quantity: Quantity) -> tuple[float, float]:
    """Return plausible bounds within those of the quantity."""
    low, high = SPANS[quantity.measure]
    minimum = -math.inf if quantity.minimum is None else quantity.minimum
    maximum = math.inf if quantity.maximum is None else quantity.maximum
    return min(max(low, minimum), maximum), max(min(high, maximum), minimum)


def _quantity(values: Values, quantity: Quantity, place: Place) -> Any:
    draw = values.draw
    low, high = _bounds_of(quantity)
    if quantity.whole:
        whole = range(max(math.ceil(low), 1), max(math.ceil(high), 1) + 3)
        numbers = [str(draw(st.sampled_from(whole))) for _ in range(quantity.components or 1)]
        if quantity.components:
            return " ".join(numbers)
        if quantity.known != "fixed" and chance(draw, 40):
            return f"integer(1 .. {numbers[0]})"
        return int(numbers[0])
    dimension = values.dimension(quantity, place)
    signed = quantity.minimum is None
    if quantity.words and chance(draw, 10):
        return pick(draw, quantity.words)
    if quantity.relative and place.kind.dimension != NUMBER and chance(draw, 25):
        return f"{draw(st.integers(1, 5))} %"
    if signed and dimension == NUMBER and not quantity.components and chance(draw, 20):
        return draw(st.sampled_from((0.5, 1, 2)))
    if quantity.components:
        return _vector(values, quantity, dimension, low, high)
    # A robot file need not state the limits of joints.
    if quantity.urdf and quantity.measure in ("mass", "damping") and chance(draw, 50):
        return f"urdf * {draw(st.sampled_from(('1.2', '0.8', '1')))}"
    return _scalar(values, quantity, dimension, low, high)


def _vector(values: Values, quantity: Quantity, dimension: Dimension, low: float, high: float) -> str:
    count = quantity.components or 1
    text = literal(values.draw, dimension, low=low, high=high, count=count)
    if quantity.known == "fixed" or chance(values.draw, 60):
        return text
    *numbers, unit = text.split() if dimension != NUMBER else [*text.split(), ""]
    ends = " ".join(number_text(1.2 * float(number)) for number in numbers)
    return f"uniform({' '.join(numbers)} .. {ends} {unit})".replace(" )", ")")


def _scalar(values: Values, quantity: Quantity, dimension: Dimension, low: float, high: float) -> str:
    draw = values.draw
    text = literal(draw, dimension, low=low, high=high)
    way = draw(st.integers(0, 9))
    latest = {"fixed": Known.FIXED, "episode": Known.EPISODE, "step": Known.STEP}[quantity.known]
    if way >= 8:
        context = Context.FIXED if latest is Known.FIXED else Context.PARAMETER
        names = [
            name
            for name, kind in values.names(context).known_by(latest).values.items()
            if (kind.dimension, kind.components, kind.boolean) == (dimension, None, False)
        ]
        if names:
            ends = literal_range(draw, dimension, low, high)
            return f"clamp({pick(draw, names)}, {ends})"
    if latest is Known.FIXED or way < 5:
        return text
    drawn = pick(
        draw,
        (
            f"uniform({literal_range(draw, dimension, low, high)})",
            f"choice({text} | {literal(draw, dimension, low=low, high=high)})",
        ),
    )
    if latest is Known.STEP and chance(draw, 50):
        return f"{drawn} {pick(draw, ('each step', 'every 0.1 s'))}"
    return drawn


def _column(values: Values, column: Column, place: Place) -> str:
    numbers = "0 2 5"
    return f"{numbers} cm" if column.measure == "length" else "3 2 1"


def _range(values: Values, kind: Range, place: Place) -> str:
    draw = values.draw
    if kind.auto and place.kind.known == Known.FIXED and chance(draw, 30):
        return "auto"
    low, high = (-1.0, 1.0) if kind.measure in ("any", "reading") else SPANS[kind.measure]
    return literal_range(draw, values.dimension(kind, place), low, high)


def _expectation(values: Values, _kind: Bounds, _place: Place) -> Any:
    return pick(values.draw, (0, 0.5, "0 .. 100 %"))


# Texts


def _text(values: Values, kind: Text, _place: Place) -> str:
    return kind.example or pick(values.draw, ("a text", "another: text", "1", "true", "it's"))


def _reference(values: Values, kind: Reference | Pattern, place: Place) -> Any:
    names = values.references(kind.kind, place.robot)
    name = pick(values.draw, names)
    if isinstance(kind, Reference) and kind.several and chance(values.draw, 30):
        return [name]
    return name


def _color(values: Values, _kind: ColorValue, _place: Place) -> str:
    return pick(values.draw, [*list(COLORS)[:4], "#ffa500"])


_CONTEXTS = {context.name.lower(): context for context in Context}


def _expression(values: Values, kind: Expression, place: Place) -> Any:
    context = _CONTEXTS[kind.context]
    if kind.boolean:
        return Expressions(values.draw, values.names(context, place.robot)).condition()
    # An expression need not have the intervals of what the section measures.
    wanted = ValueType(place.kind.dimension, place.kind.components, place.kind.boolean)
    if wanted.dimension == NUMBER and chance(values.draw, 10):
        return pick(values.draw, (1, 0.5, 0))
    return values.expression(context, wanted, place.robot)


def _unavailable(values: Values, kind: FieldType, _place: Place) -> Any:
    raise UnavailableError(kind.noun)


def _until(values: Values, kind: Until, _place: Place) -> str:
    return pick(values.draw, (kind.example, *kind.other_examples))


FIELDS: dict[type[FieldType], Callable[[Values, Any, Place], Any]] = {
    Number: _number,
    WholeNumber: _whole,
    Quantity: _quantity,
    Column: _column,
    Range: _range,
    Bounds: _expectation,
    Expression: _expression,
    Flag: lambda values, _kind, _place: values.draw(st.booleans()),
    Text: _text,
    Word: lambda values, kind, _place: pick(values.draw, kind.words),
    ColorValue: _color,
    Name: lambda values, _kind, _place: values.new_name(),
    Reference: _reference,
    Pattern: _reference,
    FilePath: _unavailable,
    ArgumentValue: _unavailable,
    Until: _until,
    Solved: _until,
    Setting: _unavailable,
    SearchField: _unavailable,
}
