"""Unification: checks that values fit together and fit their field, and suggests corrections.

Truth values, dimensions and components must agree. A value that does not fit is reported and raises
`StopChecking`. The help in the findings of `check.py` is here too: what to write instead.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import wraps
from typing import ParamSpec, TypeVar

from deepbots_cli.diagnostics.nearest import Replacement, nearest_first
from deepbots_cli.expressions import syntax
from deepbots_cli.expressions.dimensions import (
    ANGLE,
    ANGULAR_VELOCITY,
    LENGTH,
    NUMBER,
    SPEED,
    TIME,
    Dimension,
    physical_quantity,
)
from deepbots_cli.expressions.functions import Family, Function
from deepbots_cli.expressions.types import (
    CORRECTED_LINE,
    NO_NAMES,
    Components,
    ComponentSelection,
    Constant,
    Context,
    FindingReporter,
    Invocation,
    Kind,
    Known,
    Operation,
    Reference,
    RowComponents,
    TypedNode,
    TypedRange,
    is_bare_number,
    is_bare_zero,
    shortened_list,
)
from deepbots_cli.words import sentence_list

P = ParamSpec("P")
T = TypeVar("T")
ReportedNode = syntax.Node | TypedNode | TypedRange
"""A node that a finding is about."""

ANY_SHAPE: Components = ("*",)
_PLAUSIBLE_LIMIT_FACTOR = 10  # times the plausible limit: beyond it, an engine's sums lose their digits
_MAX_VALUE = 1e30  # the limit of a dimension without a plausible one
WHOLE_TEXT = Replacement(CORRECTED_LINE, safe=False)
"""The replacement of the whole text of an expression by the right one."""
WHEEL_RADIUS = "RADIUS"
"""What stands for the radius of the wheel, which this check does not know."""
_HAND, _LARGE = 1.0, 10.0
"""The numbers from which a length without a unit may be in cm or mm, and from which it probably is."""


class StopChecking(Exception):  # noqa: N818 - no error: it carries nothing
    """The signal that a part has a finding; nothing above it is checked."""


def report_at(
    report: FindingReporter,
    code: str,
    node: ReportedNode,
    headline: str,
    help: str | None = None,
    replacement: Replacement | None = None,
    names: Mapping[str, str | None] = NO_NAMES,
    corrected: Callable[[str], str] | None = None,
) -> StopChecking:
    """Report a finding about a node; the caller raises the result."""
    report(code, node.start, node.end, headline, help, replacement, names, corrected)
    return StopChecking()


def none_after_finding(function: Callable[P, T]) -> Callable[P, T | None]:
    """Return the same function, which returns None after a finding."""

    @wraps(function)
    def checked(*args: P.args, **kwargs: P.kwargs) -> T | None:
        try:
            return function(*args, **kwargs)
        except StopChecking:
            return None

    return checked


# Whether values fit together


def require_kind(values: Sequence[TypedNode], report: FindingReporter, *, boolean: bool = False) -> None:
    """Require numbers, or truth values where `boolean`; DB403 for each of the other kind, DB404 for each
    picture."""
    wrong = [value for value in values if value.type.picture or value.type.boolean != boolean]
    if not wrong:
        return
    wrong = [value for value in wrong if value.type.picture] or wrong
    for value in wrong:
        if value.type.picture:
            report_at(
                report,
                "DB404",
                value,
                "expected a single value, found a picture",
                "a picture can be sent and observed, but not used in an expression",
            )
        elif boolean:
            report_at(
                report, "DB403", value, "expected a truth value, found a number", "compare it, as in `x > 0`"
            )
        else:
            name = value.symbol.name if isinstance(value, Reference) else "condition"
            help = (
                f"make it a number with `1 if {name} else 0`, or write the value under the condition: `5"
                f" when {name}`"
            )
            report_at(report, "DB403", value, "expected a number, found a truth value", help)
    raise StopChecking


def dimension_of(
    values: Sequence[TypedNode], node: ReportedNode, report: FindingReporter, *, is_paid: bool = False
) -> Dimension:
    """Return the one dimension of all values except bare zeros; DB502 or DB503 where they differ.

    The summands of a reward (`is_paid`) are plain numbers.
    """
    counted = [value for value in values if not is_bare_zero(value)]
    if not counted:
        return NUMBER
    first = next((value for value in counted if not is_bare_number(value)), counted[0])
    for value in counted:
        if value.type.dimension == first.type.dimension:
            continue
        if is_bare_number(value):
            is_sum = isinstance(node, syntax.Binary) and node.operator in ("+", "-")
            raise missing_unit(
                _with_other_end(value, values, node),
                first.type.dimension,
                report,
                other=first if is_sum else None,
                is_paid=is_paid,
            )
        needed = value if first.type.dimension == NUMBER else first
        help, names = _plain_names(needed.type.dimension, first, value)
        if help is None:
            help, names = _other_unit(first, value)
        headline = f"{_described(first)} is combined with {_described(value)}"
        corrected = None
        if help is None and not is_paid and _ends_with_factor(first, value):
            corrected = _sum_in_parentheses(first, value)
            help = f"if the unit belongs to the whole sum, put the sum in parentheses: {CORRECTED_LINE}"
        elif help is None and NUMBER in (first.type.dimension, value.type.dimension):
            corrected = divided_text(needed, f" / {_divisor(needed.type.dimension)}")
            help = (
                "both sides need the same dimension; for a plain number, divide by the unit:"
                f" {CORRECTED_LINE}"
            )
        help = help or "both sides need the same dimension; divide by a unit to get a plain number"
        raise report_at(report, "DB503", node, headline, help, names=names, corrected=corrected)
    return first.type.dimension


def _ends_with_factor(first: TypedNode, second: TypedNode) -> bool:
    """Return whether `first + second` is such as `gas + turn * 6 rad/s`, in which only the factor has a unit."""
    return (
        isinstance(second, Operation)
        and second.operator == "mul"
        and first.end < second.start == second.args[0].start
        and first.type.dimension == second.args[0].type.dimension == NUMBER
    )


def _sum_in_parentheses(first: TypedNode, second: TypedNode) -> Callable[[str], str]:
    end = second.args[0].end if isinstance(second, Operation) else second.end
    return lambda text: f"{text[: first.start]}({text[first.start : end]}){text[end:]}"


def _described(value: TypedNode) -> str:
    """Return the name of a value, if it has one, and its dimension."""
    name = f"`{value.symbol.name}`, " if isinstance(value, Reference) else ""
    return f"{name}{value.type.description}"


def require_dimension(
    value: TypedNode,
    dimension: Dimension,
    description: str,
    report: FindingReporter,
    unit: str | None = None,
    noun: str | None = None,
) -> None:
    """Require a dimension (a bare zero has any); otherwise report DB502 or DB503 about `description`. `unit`
    is the probable unit of a bare number."""
    if is_bare_zero(value) or value.type.dimension == dimension:
        return
    if is_bare_number(value):
        raise missing_unit(value, dimension, report, unit, noun)
    help, names = _plain_names(dimension, value)
    if help is None:
        help, names = _remedy(value, dimension)
    headline = f"{description} must be {_expected(dimension, noun)}; this is {value.type.description}"
    divisor = f"{WHEEL_RADIUS} * rad" if dimension != NUMBER else _divisor(value.type.dimension)
    corrected = divided_text(value, f" / {divisor}") if CORRECTED_LINE in help else None
    replacement = WHOLE_TEXT if corrected is not None and dimension == NUMBER else None
    raise report_at(report, "DB503", value, headline, help, replacement, names=names, corrected=corrected)


def _with_other_end(
    low: TypedNode, values: Sequence[TypedNode], node: ReportedNode
) -> TypedNode | TypedRange:
    """Return the range of which a value is the low end if the high end has no unit either, else the value."""
    arguments = node.args if isinstance(node, syntax.Call) else ()
    ends = {one.low.start: one.high.start for one in arguments if isinstance(one, syntax.Range)}
    high = next((value for value in values if value.start == ends.get(low.start)), low)
    return TypedRange(low, high, low.start, high.end) if high != low and is_bare_number(high) else low


def _expected(dimension: Dimension, noun: str | None) -> str:
    return f"{noun} ({dimension})" if noun else dimension.description


def missing_unit(
    value: TypedNode | TypedRange,
    dimension: Dimension,
    report: FindingReporter,
    unit: str | None = None,
    noun: str | None = None,
    *,
    other: TypedNode | None = None,
    is_paid: bool = False,
) -> StopChecking:
    """Report a number without a unit (DB502); the caller raises the result. If it is at least 1 it is
    probably in `unit`; otherwise the unit is proposed that its dimension usually has.

    Both numbers of a range or of a draw have the unit behind the second. In a sum, the `other` side may be
    meant as a plain number. The summands of a reward (`is_paid`) are meant as plain numbers, so the finding
    is about the `other` side.
    """
    if other is not None and is_paid:
        return report_at(
            report,
            "DB502",
            other,
            f"expected a plain number, as the other side is, found {_described(other)}",
            f"divide it by its unit: {CORRECTED_LINE}",
            WHOLE_TEXT,
            corrected=divided_text(other, f" / {_divisor(dimension)}"),
        )
    ends: Sequence[TypedNode] = (value.low, value.high) if isinstance(value, TypedRange) else (value,)
    sign = ".."
    if isinstance(value, Invocation) and value.function in ("uniform", "normal"):
        ends = value.args
        sign = ".." if value.function == "uniform" else "+-"
    help = f"write its unit, as in `{dimension.example}`"
    replacement = None
    corrected = divided_text(other, f" / {_divisor(dimension)}") if other is not None else None
    constants = [end for end in ends if isinstance(end, Constant)]
    if len(constants) == len(ends) and (
        dimension.unit_behind_number == str(dimension) or [len(end.values) for end in constants] == [1]
    ):
        numbers_text = f" {sign} ".join(" ".join(map(_number_text, end.values)) for end in constants)
        largest = max(abs(number) for end in constants for number in end.values)
        units = _probable_units(dimension, largest)
        if dimension != ANGLE and unit and largest >= 1:
            units = (unit,)
        help = "write its unit: " + " or ".join(f"`{numbers_text} {name}`" for name in units)
        is_sure = len(units) == 1 and units[0] == str(dimension) and other is None
        replacement = Replacement(f"{numbers_text} {units[0]}", safe=is_sure)
    if corrected is not None:
        help += f"; or divide the other side by its unit to get a plain number: {CORRECTED_LINE}"
    node = value._replace(start=ends[0].start, end=ends[-1].end)
    headline = f"expected {_expected(dimension, noun)}, found a number without a unit"
    return report_at(report, "DB502", node, headline, help, replacement, corrected=corrected)


def _number_text(number: float) -> str:
    short = f"{number:.10g}"
    return short if float(short) == number else repr(number)


def _plain_names(dimension: Dimension, *values: TypedNode) -> tuple[str | None, dict[str, str | None]]:
    """Return a hint for plain numbers that come from names, since a definition probably lacks a unit of
    `dimension`; and the names, with the text of each where it is clear."""
    plain = [value for value in values if value.type.dimension == NUMBER]
    names = {name: text for value in plain for name, text in _named_numbers(value) if text}
    if not names:
        return None, {}
    listed = " and ".join(f"`{name}` is {text}, without a unit" for name, text in names.items())
    location_text = "where you set the value (in the file or with `--set`)"
    if len(names) > 1:
        return f"{listed}; if one of them should have a unit, add it {location_text}", dict.fromkeys(names)
    ((name, text),) = names.items()
    if not all(map(_is_proportional, plain)):
        return f"{listed}; if it should have a unit, add it {location_text}", {name: None}
    quantities = [
        f"{text} {unit}" for unit in _probable_units(dimension, max(map(abs, map(float, text.split()))))
    ]
    assignments = " or ".join(f"`{name}: {quantity}`" for quantity in quantities)
    return f"{listed}: write {assignments} {location_text}", {name: quantities[0]}


def _other_unit(first: TypedNode, second: TypedNode) -> tuple[str | None, dict[str, str | None]]:
    """Return a hint for a named fixed value that is combined with a measured one, since its definition
    probably has the wrong unit; and the name, with its corrected text."""
    sides = ((first, second.type.dimension), (second, first.type.dimension))
    named = [
        (side, dimension)
        for side, dimension in sides
        if isinstance(side, Reference) and side.symbol.value is not None and dimension != NUMBER
    ]
    if len(named) != 1:
        return None, {}
    ((side, dimension),) = named
    name, corrected = _with_unit(side, dimension)
    if corrected is None:
        return None, {}
    help = (
        f"if the unit of `{name}` is wrong, write `{name}: {corrected}`; otherwise divide both sides by their"
        " units"
    )
    return help, {name: corrected}


def _probable_units(dimension: Dimension, largest: float) -> tuple[str, ...]:
    """Return the units that numbers up to `largest` probably have, the likeliest first."""
    if dimension == LENGTH and largest >= _HAND:
        return ("cm", "mm", "m") if largest >= _LARGE else ("m", "cm", "mm")
    if dimension != ANGLE:
        return (dimension.unit_behind_number,)
    return ("deg",) if largest > 2 * math.pi else ("deg", "rad")  # nobody writes three turns in radians


def _is_proportional(value: TypedNode) -> bool:
    """Return whether a sum or product has the unit of the numbers in it, since it divides by none."""
    if not isinstance(value, Operation):
        return True
    return value.operator != "div" and all(map(_is_proportional, value.args))


def _named_numbers(value: TypedNode) -> Iterator[tuple[str, str]]:
    """Yield the named fixed numbers in a sum or product, with the text of those without a unit."""
    for named in _references(value):
        is_plain = named.type.dimension == NUMBER
        yield named.symbol.name, " ".join(map(_number_text, named.symbol.value or ())) if is_plain else ""


def _remedy(value: TypedNode, needed: Dimension) -> tuple[str, dict[str, str | None]]:
    """Return the help for a value of another dimension, and the names whose unit may be wrong, with the
    right text if there is one name."""
    dimension = value.type.dimension
    if needed == NUMBER:
        return (
            "remove its unit"
            if isinstance(value, Constant) and value.unit
            else f"divide by the unit to get a plain number: {CORRECTED_LINE}"
        ), {}
    if dimension == NUMBER:
        return f"give one of its numbers a unit, as in `{needed.example}`", {}
    if dimension / needed == ANGLE:
        return "divide by the angle: `/ rad`", {}
    if needed / dimension == ANGLE:
        return "multiply by the angle: `* rad`", {}
    names: dict[str, str | None] = {name: None for name, text in _named_numbers(value) if not text}
    suffix = f" of {' or '.join(f'`{name}`' for name in names)}" if names else ""
    name, corrected = _with_unit(value, needed)
    line = f"{name}: {corrected}" if name else corrected
    example = f": `{line}`" if line else ""
    if name in names and len(names) == 1:
        names[name] = corrected
    if dimension == SPEED and needed == ANGULAR_VELOCITY:
        hint = "if it is the speed of a wheel's rim, divide it by the radius of this wheel"
        return f"correct the unit{suffix}{example}; or, {hint}: {CORRECTED_LINE}", names
    return f"correct the unit{suffix}{example}, or multiply by a factor in {needed / dimension}", names


def _divisor(dimension: Dimension) -> str:
    unit = str(dimension)
    return f"({unit})" if "/" in unit or "*" in unit else unit


def _with_unit(value: TypedNode, needed: Dimension) -> tuple[str, str | None]:
    """Return the name of the only named number in a value, or else of the number itself (none), and its text
    in a unit of the dimension that is needed (None for several numbers)."""
    dimension = value.type.dimension
    if isinstance(value, Constant) and value.unit:
        name = ""
        numbers = tuple(map(value.unit.from_si, value.values))
        unit = value.unit.text
    else:
        values_by_name = {
            part.symbol.name: part.symbol.value or ()
            for part in _references(value)
            if part.type.dimension == dimension
        }
        name, numbers = next(iter(values_by_name.items())) if len(values_by_name) == 1 else ("", ())
        unit = str(dimension)
        degrees = round(math.degrees(numbers[0]), 9) if dimension == ANGLE and len(numbers) == 1 else math.nan
        if len(_number_text(degrees)) < len(_number_text(numbers[0] if numbers else 0.0)) and not math.isnan(
            degrees
        ):
            numbers = (degrees,)
            unit = "deg"
    if len(numbers) != 1:
        return name, None
    is_rate = dimension / needed == TIME and "/" not in unit
    unit = f"{unit}/s" if is_rate else _probable_units(needed, abs(numbers[0]))[0]
    return name, f"{_number_text(numbers[0])} {unit}"


def _references(value: TypedNode) -> Iterator[Reference]:
    """Yield the names with fixed values in a sum or product."""
    if isinstance(value, Reference) and value.symbol.value is not None:
        yield value
    elif isinstance(value, Operation) and value.operator in ("add", "sub", "mul", "div", "neg"):
        for part in value.args:
            yield from _references(part)


def components_of(
    values: Sequence[TypedNode], node: ReportedNode, report: FindingReporter
) -> Components | None:
    """Return the components of the result, None for a single value; DB404 where vectors differ.

    A vector for each row combines with a vector that has a value for each row, or for each column.
    """
    vectors = [value.type.components for value in values if value.type.components is not None]
    if not vectors:
        return None
    largest = next(
        (components for components in vectors if isinstance(components, RowComponents)), vectors[0]
    )
    for components in vectors:
        if components != largest and not _is_part(components, largest):
            raise _differing(largest, components, node, report)
    return largest


def _is_part(components: Components | None, vector: Components | None) -> bool:
    """Return whether `components` are the rows, or the columns, of those of a `vector`."""
    return isinstance(vector, RowComponents) and components in (vector.rows, vector.columns)


def aligned(
    values: Sequence[TypedNode], node: ReportedNode, report: FindingReporter
) -> tuple[TypedNode, ...]:
    """Return the values with the same components, single values as they are; DB404 where vectors differ."""
    components = components_of(values, node, report)
    return tuple(spread(value, components) for value in values)


def spread(value: TypedNode, components: Components | None) -> TypedNode:
    """Return a value for each row, or for each column, as one for each of the components."""
    part = value.type.components
    if not isinstance(components, RowComponents) or part not in (components.rows, components.columns):
        return value
    indices = components.of_rows if part == components.rows else components.of_columns
    spread_type = value.type.selected(indices)._replace(components=components)
    return ComponentSelection(spread_type, value.start, value.end, value, indices)


def _differing(
    first: Components, second: Components, node: ReportedNode, report: FindingReporter
) -> StopChecking:
    both = [name for name in first if name in second]
    example = "".join(both) if both and all(len(name) == 1 for name in both) else "x"
    help = f"both sides need the same components; select them, as in `v.{example}`"
    if set(first) == set(second):
        help = "list the names of both groups in the same order"
        swapped = next((pair for pair in zip(first, second, strict=False) if pair[0] != pair[1]), None)
        if swapped is not None:
            help += f": the second has `{swapped[1]}` where the first has `{swapped[0]}`"
        help += "; in poses, write the same patterns first, and exceptions after them"
    return report_at(
        report,
        "DB404",
        node,
        f"a vector of {shortened_list(first)} is combined with one of {shortened_list(second)}",
        help,
    )


def warn_of_degrees(value: TypedNode, report: FindingReporter) -> None:
    """Report DB504 for radians that look like degrees, such as 30 rad.

    Wheels turn by hundreds of radians; only values up to 180 and from 270 to 360 count.
    """
    if isinstance(value, Constant) and value.unit is not None and value.unit.text == "rad":
        farthest = max(value.values, key=abs)
        if 2 * math.pi < abs(farthest) <= 180.0 or 270.0 <= abs(farthest) <= 360.0:
            headline = f"{_number_text(farthest)} rad is more than a full turn"
            degrees = f"{_number_text(farthest)} deg"
            replacement = Replacement(degrees, safe=False) if len(value.values) == 1 else None
            report_at(report, "DB504", value, headline, f"write `{degrees}` if you mean degrees", replacement)


# Whether a value fits its field


@none_after_finding
def expect_kind(value: TypedNode, report: FindingReporter, *, boolean: bool) -> TypedNode:
    """Return the value if it is a truth value (`boolean`) or a number, or None after a finding."""
    require_kind([value], report, boolean=boolean)
    return value


@none_after_finding
def expect_value(
    value: TypedNode,
    report: FindingReporter,
    description: str,
    *,
    dimension: Dimension | None = None,
    components: Components | None = None,
    boolean: bool = False,
    known: Known = Known.STEP,
    unit: str | None = None,
    noun: str | None = None,
    shape_help: str | None = None,
) -> TypedNode:
    """Return the value as a field takes it, or None after a finding.

    Args:
        what: The name of the field in a sentence (`the timestep`).
        dimension: None takes any; a bare zero has every dimension.
        components: None takes a single value only, a tuple takes those components or a single value for all
            of them, `ANY_SHAPE` takes everything.
        known: When the value must be known at the latest.
        unit: The probable unit of a bare number.
        noun: The name of the dimension in the field.
        shape_help: What to write instead of a vector of x, y and z where the components have other names.
    """
    require_kind([value], report, boolean=boolean)
    if not boolean and dimension is not None and value.type.dimension != dimension:
        require_dimension(value, dimension, description, report, unit, noun)
        value = value._replace(type=value.type._replace(dimension=dimension))
    _require_shape(value, components, description, report, shape_help)
    if value.type.known > known:
        needed, alternative = ("fixed or drawn once per episode", "that does not change within an episode")
        if known is Known.FIXED:
            needed, alternative = ("fixed", "with a fixed value")
        headline = f"{description} must be {needed}, but this value is {value.type.known.description}"
        raise report_at(report, "DB407", value, headline, f"use a fixed value, or a parameter {alternative}")
    if value.type.interval.is_finite and not boolean:
        _require_size(value, known, description, report)
    return spread(value, components)


@none_after_finding
def expect_range(
    typed_range: TypedRange,
    report: FindingReporter,
    description: str,
    *,
    dimension: Dimension | None = None,
    components: Components | None = None,
) -> TypedRange:
    """Check both ends of a range, which must be fixed, like `expect_value`."""
    if (
        dimension is not None
        and dimension != NUMBER
        and is_bare_number(typed_range.low)
        and is_bare_number(typed_range.high)
        and not is_bare_zero(typed_range.high)
    ):
        raise missing_unit(typed_range, dimension, report)  # one unit is missing, behind both ends
    # The right end first: the unit of both stands there.
    high = expect_value(
        typed_range.high, report, description, dimension=dimension, components=components, known=Known.FIXED
    )
    low = (
        expect_value(
            typed_range.low,
            report,
            description,
            dimension=dimension,
            components=components,
            known=Known.FIXED,
        )
        if high
        else None
    )
    if low is None or high is None:
        raise StopChecking
    return typed_range._replace(low=low, high=high)


def _require_shape(
    value: TypedNode,
    components: Components | None,
    description: str,
    report: FindingReporter,
    help: str | None = None,
) -> None:
    shape = value.type.components
    if components == ANY_SHAPE or shape is None or shape == components or _is_part(shape, components):
        return
    if components is None:
        functions = "`any` or `all`" if value.type.boolean else "`min`, `max`, `norm` ..."
        help = f"pick a component, such as `.{shape[0]}`, or reduce the vector with {functions}"
        raise report_at(
            report,
            "DB404",
            value,
            f"{description} must be a single value; this is {value.type.shape_description}",
            help,
        )
    if help and shape[0] == "x" and "x" not in components:
        headline = (
            f"{description} has the components {shortened_list(components)};"
            f" this is {value.type.shape_description}"
        )
        raise report_at(report, "DB404", value, headline, help)
    if len(shape) != len(components) and shape[0] in ("x", "1"):
        headline = f"{description} has {len(shape)} values, not {len(components)}"
        raise report_at(report, "DB106", value, headline, f"write {' and '.join(components)}")
    raise _differing(components, shape, value, report)


def _require_size(value: TypedNode, known: Known, description: str, report: FindingReporter) -> None:
    """Warn of implausible values; refuse values beyond an engine's precision that are known before the
    episode."""
    dimension, interval = value.type.dimension, value.type.interval
    farthest = max(interval, key=abs)
    largest = abs(farthest)
    is_or_reaches = "is" if interval.is_single else "reaches"
    plausible = physical_quantity(dimension).plausible_limit
    limit = _MAX_VALUE if plausible == math.inf else _PLAUSIBLE_LIMIT_FACTOR * plausible
    if largest > limit and known is not Known.STEP:
        unit = "" if dimension == NUMBER else f" {dimension}"
        help = f"write at most {limit:g}{unit}" if farthest > 0.0 else f"write at least {-limit:g}{unit}"
        raise report_at(report, "DB105", value, f"{description} {is_or_reaches} {farthest:g}{unit}", help)
    if dimension == ANGLE:
        warn_of_degrees(value, report)
    if largest > plausible:
        report_at(
            report,
            "DB505",
            value,
            f"{description} {is_or_reaches} {farthest:g} {dimension}",
            "check the unit",
        )


def negated_text(value: TypedNode) -> Callable[[str], str]:
    """Return a function that makes the text of the negated value from the text of the value; of `a when c`,
    `a` is negated."""
    part = _amount(value)
    length = part.end - part.start

    def turned(text: str) -> str:
        amount, remainder = text[:length], text[length:]
        if not (isinstance(part, Operation) and _is_open(part)):
            return amount[1:].lstrip() + remainder if amount.startswith("-") else f"-{amount}{remainder}"
        if part.operator != "sub":
            return f"-({amount}){remainder}"
        left, right = (amount[arg.start - part.start : arg.end - part.start] for arg in part.args)
        return f"{right} - ({left}){remainder}" if _is_open(part.args[0]) else f"{right} - {left}{remainder}"

    return turned


def divided_text(value: TypedNode, divisor: str) -> Callable[[str], str]:
    """Return a function that puts `divisor` behind the text of a value, of `a when c` behind `a`; a sum or a
    conditional is put in parentheses."""
    part = _amount(value)
    before, behind = ("(", ")") if _is_open(part) else ("", "")
    return lambda text: (
        f"{text[: part.start]}{before}{text[part.start : part.end]}{behind}{divisor}{text[part.end :]}"
    )


def _amount(value: TypedNode) -> TypedNode:
    """Return `a` of `a when c`, and any other value as it is."""
    is_when = isinstance(value, Operation) and value.operator == "where" and value.args[2].start == value.end
    return value.args[1] if is_when and isinstance(value, Operation) else value


def _is_open(value: TypedNode) -> bool:
    """Return whether it is a sum, a difference or `a if c else b` without parentheses around it, which a node
    counts as its own."""
    return (
        isinstance(value, Operation)
        and value.operator in ("add", "sub", "where")
        and any(part.start == value.start for part in value.args)
    )


# The help in findings of `check.py`


_STATIC_HELP = (
    "use a number or a parameter; the state of the world and messages are known only during an episode"
)
FAMILY_HELP = {
    Family.DRAW: "define the draw under `parameters`, and use its name here",
    Family.STATEFUL: "define it under `signals`, and use the signal where signals are available",
    Family.MESSAGE: "define the value under `receive`, and use its name here; only the supervisor receives"
    " messages of robots",
    Family.WORLD: "define the value under `receive`, and use its name here; a robot knows only its sensors"
    " and the values that it receives",
}
"""The help for a function that cannot be used, by its family."""
CONTEXT_HELP = {
    **{
        (Context.FORBID, family): "define the value under `augment`, and use its name here"
        for family in Family
    },
    **{
        (context, family): _STATIC_HELP
        for context in (Context.FIXED, Context.PARAMETER, Context.FIELD, Context.OBSERVATION, Context.RESET)
        for family in (Family.WORLD, Family.MESSAGE)
    },
    (Context.EMIT, Family.WORLD): "define the value under `augment`; a robot knows only its sensors",
    (
        Context.EMIT,
        Family.MESSAGE,
    ): "define the value under `augment`; only the supervisor receives messages of robots",
    (Context.FIXED, Family.DRAW): "write one number for all episodes",
    (Context.SCRIPT, Family.STATEFUL): "define the value under `signals`, and use its name here",
    (Context.TEST, Family.STATEFUL): "define the value under `signals`, and use its name here",
    (Context.TEST, Family.MESSAGE): "define the value under `signals`, and use its name here",
    (Context.GOAL, Family.MESSAGE): "define the value under `signals`, and use its name here",
    (Context.REQUIRE, Family.MESSAGE): "remove it: no message has arrived when the start is drawn",
}
"""The help for a function that cannot be used in a context, where it is not that of `FAMILY_HELP`."""
# A common question about a part of the world that has no position.
FUNCTION_OF_KIND = {
    Kind.JOINT: "joint_position",
    Kind.JOINTS: "joint_position",
    Kind.WALLS: "collided",
    Kind.LINE: "length",
    Kind.SENSOR: "age",
    Kind.CAMERA: "age",
}
_MAX_LISTED = 20
"""The number of names that a message lists."""
# Names that are written often, and not near to the right word.
NAME_HELP = {"pi": "half a turn is `180 deg`"}
CONTEXT_NAME_HELP = {Context.APPLY: "the choices of the agent are defined under `action`"}


def usage(function: Function) -> str:
    return f"`{function.signature}`: {function.doc}"


def known_names_help(names: list[str], none: str, like: str = "") -> str:
    """Return the names in their order; the most similar ones first, if there are too many to list."""
    ordered = nearest_first(like, sorted(names), _MAX_LISTED)
    return f"known names: {shortened_list((f'`{name}`' for name in ordered), _MAX_LISTED)}" if names else none


def one_of(kinds: frozenset[Kind]) -> str:
    """Return the kinds as alternatives, such as "a robot or an object"."""
    descriptions = [kind.description for kind in Kind if kind in kinds]
    if kinds >= {Kind.WALL, Kind.WALLS}:
        descriptions.remove(Kind.WALLS.description)
        descriptions[descriptions.index(Kind.WALL.description)] = "a wall"
    return sentence_list(descriptions, "or")


def keep_above_help(low: float) -> str:
    """Return the help for a value that can be below a domain, which begins at 0 or just above it."""
    return (
        "keep it above 0 with `max(..., 0.001)`" if low > 0.0 else "keep it at or above 0 with `max(..., 0)`"
    )


def no_zero_help(value: TypedNode) -> str:
    """Return the help for a value that can be zero: a bound in its unit."""
    dimension = value.type.dimension
    return (
        f"keep it away from zero, as in `max(..., {'0.01' if dimension == NUMBER else f'0.01 {dimension}'})`"
    )
