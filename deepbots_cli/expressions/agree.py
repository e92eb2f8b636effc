"""Whether values fit together: truth with truth, dimension with dimension, component with component.

Each function reports what does not fit and returns None then, so that its caller stops there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from deepbots_cli.diagnostics.nearest import Meant
from deepbots_cli.expressions.dimensions import ANGLE, LENGTH, MASS, NUMBER, TIME, Dimension
from deepbots_cli.expressions.guesses import divided, over
from deepbots_cli.expressions.typed import Constant, Reference, Typed, TypedRange, bare, zero
from deepbots_cli.expressions.types import Components, Report, shown

_EXAMPLE = {LENGTH: "0.5 m", MASS: "0.5 kg", TIME: "20 ms", ANGLE: "30 deg"}


def numbers(values: Sequence[Typed], report: Report) -> bool:
    """Whether all are numbers; DB403 for each that is a truth value, DB404 for each picture."""
    if not _pictureless(values, report):
        return False
    wrong = [value for value in values if value.type.boolean]
    for value in wrong:
        name = value.symbol.name if isinstance(value, Reference) else "condition"
        help = f"make it a number with `where({name}, 1, 0)`, or write what a whole value is then: `5 when {name}`"
        report("DB403", value.start, value.end, "a truth value where a number belongs", help)
    return not wrong


def truths(values: Sequence[Typed], report: Report) -> bool:
    """Whether all are truth values; DB403 for each number, DB404 for each picture."""
    if not _pictureless(values, report):
        return False
    wrong = [value for value in values if not value.type.boolean]
    for value in wrong:
        report("DB403", value.start, value.end, "a number where a truth value belongs", "compare it, as in `x > 0`")
    return not wrong


def _pictureless(values: Sequence[Typed], report: Report) -> bool:
    pictures = [value for value in values if value.type.picture]
    for value in pictures:
        report("DB404", value.start, value.end, "a picture where a single value belongs", "pictures are sent and observed as they are")
    return not pictures


def dimension_of(values: Sequence[Typed], start: int, end: int, report: Report) -> Dimension | None:
    """The one dimension of all values, bare zeros apart; otherwise DB502 or DB503."""
    counted = [value for value in values if not zero(value)]
    if not counted:
        return NUMBER
    first = next((value for value in counted if not bare(value)), counted[0])
    for value in counted:
        if value.type.dimension == first.type.dimension:
            continue
        if bare(value):
            missing_unit(value, first.type.dimension, report)
        else:
            help = "both sides must measure the same; divide by a unit where a plain number is meant"
            report("DB503", start, end, f"{first.type.words} meets {value.type.words}", _without_unit((first, value)) or help)
        return None
    return first.type.dimension


def has_dimension(value: Typed, dimension: Dimension, what: str, report: Report, *, alone: bool = True, unit: str | None = None) -> bool:
    """Whether `value` has `dimension` (a bare zero has any); otherwise DB502 or DB503 about `what`.

    `alone` says that no operator stands beside it, which would take hold of what is written behind it. `unit` is what a bare number is
    probably in.
    """
    if zero(value) or value.type.dimension == dimension:
        return True
    if bare(value):
        missing_unit(value, dimension, report, unit)
    else:
        help = _without_unit([value]) or _remedy(value, dimension)
        meant = divided(value, value.type.dimension) if alone and dimension == NUMBER and not isinstance(value, Constant) else None
        report("DB503", value.start, value.end, f"{what} is {value.type.words}, not {dimension.words}", help, meant=meant)
    return False


def missing_unit(value: Typed | TypedRange, dimension: Dimension, report: Report, unit: str | None = None) -> None:
    """DB502 for a bare number; `unit` is what it is probably in if it is at least 1, otherwise the dimension tells."""
    ends = (value.low, value.high) if isinstance(value, TypedRange) else (value,)
    constants = [end for end in ends if isinstance(end, Constant)]
    if len(constants) == len(ends):
        written = " .. ".join(" ".join(f"{number:.10g}" for number in end.values) for end in constants)
        largest = max(abs(number) for end in constants for number in end.values)
        help = "write its unit: " + " or ".join(f"`{written} {name}`" for name in _probable_units(dimension, largest, unit))
    else:
        help = f"write its unit, as in `{example(dimension)}`"
    report("DB502", value.start, value.end, f"a number without unit where {dimension.words} is needed", help)


def _probable_units(dimension: Dimension, largest: float, unit: str | None) -> tuple[str, ...]:
    """What a bare number may have been meant in: nobody writes an angle beyond a turn in radians, or a latency of 20 s."""
    if dimension == ANGLE:
        return ("deg",) if largest > 2 * math.pi else ("deg", "rad")
    return (unit if unit and largest >= 1 else str(dimension),)


def example(dimension: Dimension) -> str:
    return _EXAMPLE.get(dimension) or f"0.5 {dimension}"


def _without_unit(values: Sequence[Typed]) -> str | None:
    """Where a plain number comes from a name that stands for one: its definition probably lacks a unit."""
    for value in values:
        if isinstance(value, Reference) and value.symbol.value is not None and value.type.dimension == NUMBER:
            figures = " ".join(f"{figure:g}" for figure in value.symbol.value)
            return f"`{value.symbol.name}` is {figures}, a plain number; if it has a unit, write it where it is defined"
    return None


def _remedy(value: Typed, needed: Dimension) -> str | None:
    """What to write instead of a literal or a name of another dimension; otherwise what to do with the whole."""
    if isinstance(value, Constant) and value.unit is not None and needed == NUMBER:
        return "leave out its unit"
    if isinstance(value, Reference) and value.type.dimension == NUMBER:
        return f"give it a unit where it is defined, or multiply: `{value.symbol.name} * {example(needed)}`"
    return _towards(value.type.dimension, needed)


def _towards(given: Dimension, needed: Dimension) -> str | None:
    """What would turn one into the other, where the difference is one plain unit."""
    if needed == NUMBER:
        return f"divide by the unit: `/ {over(given)}`"
    if given == NUMBER:
        return f"give one of its numbers a unit, as in `{example(needed)}`"
    excess = given / needed
    if excess == ANGLE:
        return "the angle cancels only on division: `/ rad`"
    if needed / given == ANGLE:
        return "the angle is missing: `* rad`"
    return f"one of its units is wrong, or a factor in {needed / given} is missing"


def components_of(values: Sequence[Typed], start: int, end: int, report: Report) -> tuple[Components | None] | None:
    """The components of the result (in a tuple of one, None inside for a single value), or DB404."""
    found: Components | None = None
    for value in values:
        components = value.type.components
        if components is None or components == found:
            continue
        if found is not None:
            differing(found, components, start, end, report)
            return None
        found = components
    return (found,)


def differing(first: Components, second: Components, start: int, end: int, report: Report) -> None:
    help = "components are paired by name; pick those that match, as in `v.x`"
    if set(first) == set(second):
        help = "the names are the same in another order; give both groups one order"
    report("DB404", start, end, f"a vector of {shown(first)} meets one of {shown(second)}", help)


def warn_of_degrees(value: Typed, report: Report) -> None:
    """DB504: nobody writes 30 rad for an angle that is compared or given to a sine, nor degrees beyond a full turn.

    Wheels that turn on come to hundreds of radians, which are left alone.
    """
    if isinstance(value, Constant) and value.unit is not None and value.unit.text == "rad":
        largest = max(abs(number) for number in value.values)
        if 2 * math.pi < largest <= 180.0 or 270.0 <= largest <= 360.0:
            report(
                "DB504",
                value.start,
                value.end,
                f"{largest:g} rad is more than a full turn",
                f"if degrees are meant, write `{largest:g} deg`",
                meant=Meant(f"{value.values[0]:g} deg", safe=False) if len(value.values) == 1 else None,
            )
