"""Unification: whether values fit together and fit their place, and what to write where they do not.

Truth with truth, dimension with dimension, component with component. Each function reports what does not fit;
its caller stops there.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from deepbots_cli.diagnostics.nearest import Meant
from deepbots_cli.expressions import syntax
from deepbots_cli.expressions.dimensions import ANGLE, NUMBER, QUANTITIES, Dimension
from deepbots_cli.expressions.types import (
    Components,
    Constant,
    Invocation,
    Operation,
    Reference,
    Report,
    Rewriting,
    Stage,
    Typed,
    TypedRange,
    bare,
    shown,
    zero,
)

ANY_SHAPE: Components = ("*",)
_BEYOND = 10  # times what is plausible: an engine's sums lose their digits
_LARGEST = 1e30  # of a dimension without a plausible limit


# Whether values fit together


def numbers(values: Sequence[Typed], report: Report) -> bool:
    """Whether all are numbers; DB403 for each that is a truth value, DB404 for each picture."""
    return _are(False, values, report)


def truths(values: Sequence[Typed], report: Report) -> bool:
    """Whether all are truth values; DB403 for each number, DB404 for each picture."""
    return _are(True, values, report)


def _are(boolean: bool, values: Sequence[Typed], report: Report) -> bool:
    pictures = [value for value in values if value.type.picture]
    for value in pictures:
        report("DB404", value.start, value.end, "a picture where a single value belongs", "pictures are sent and observed as they are")
    if pictures:
        return False
    wrong = [value for value in values if value.type.boolean != boolean]
    for value in wrong:
        if boolean:
            report("DB403", value.start, value.end, "a number where a truth value belongs", "compare it, as in `x > 0`")
        else:
            name = value.symbol.name if isinstance(value, Reference) else "condition"
            help = f"make it a number with `where({name}, 1, 0)`, or write what a whole value is then: `5 when {name}`"
            report("DB403", value.start, value.end, "a truth value where a number belongs", help)
    return not wrong


def dimension_of(values: Sequence[Typed], start: int, end: int, report: Report) -> Dimension | None:
    """The one dimension of all values except bare zeros; otherwise None after DB502 or DB503."""
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
            report("DB503", start, end, f"{first.type.words} meets {value.type.words}", _plain_name((first, value)) or help)
        return None
    return first.type.dimension


def has_dimension(value: Typed, dimension: Dimension, what: str, report: Report, *, alone: bool = True, unit: str | None = None) -> bool:
    """Whether `value` has `dimension` (a bare zero has any); otherwise DB502 or DB503 about `what`.

    Args:
        alone: No operator stands beside the value, so that text written behind it applies to all of it.
        unit: The probable unit of a bare number.
    """
    if zero(value) or value.type.dimension == dimension:
        return True
    if bare(value):
        missing_unit(value, dimension, report, unit)
    else:
        help = _plain_name([value]) or _remedy(value, dimension)
        meant = divided(value, value.type.dimension) if alone and dimension == NUMBER and not isinstance(value, Constant) else None
        report("DB503", value.start, value.end, f"{what} is {value.type.words}, not {dimension.words}", help, meant=meant)
    return False


def missing_unit(value: Typed | TypedRange, dimension: Dimension, report: Report, unit: str | None = None) -> None:
    """DB502 for a bare number; it is probably in `unit` if it is at least 1, otherwise the dimension tells."""
    ends = (value.low, value.high) if isinstance(value, TypedRange) else (value,)
    constants = [end for end in ends if isinstance(end, Constant)]
    if len(constants) == len(ends):
        written = " .. ".join(" ".join(f"{number:.10g}" for number in end.values) for end in constants)
        largest = max(abs(number) for end in constants for number in end.values)
        units: tuple[str, ...] = (unit if unit and largest >= 1 else str(dimension),)
        if dimension == ANGLE:  # nobody writes an angle beyond a turn in radians
            units = ("deg",) if largest > 2 * math.pi else ("deg", "rad")
        help = "write its unit: " + " or ".join(f"`{written} {name}`" for name in units)
    else:
        help = f"write its unit, as in `{dimension.example}`"
    report("DB502", value.start, value.end, f"a number without unit where {dimension.words} is needed", help)


def _plain_name(values: Sequence[Typed]) -> str | None:
    """A hint for a plain number that comes from a name: its definition probably lacks a unit."""
    for value in values:
        if isinstance(value, Reference) and value.symbol.value is not None and value.type.dimension == NUMBER:
            known = " ".join(f"{number:g}" for number in value.symbol.value)
            return f"`{value.symbol.name}` is {known}, a plain number; if it has a unit, write it where it is defined"
    return None


def _remedy(value: Typed, needed: Dimension) -> str:
    """What to write instead of a value of another dimension."""
    given = value.type.dimension
    if isinstance(value, Constant) and value.unit is not None and needed == NUMBER:
        return "leave out its unit"
    if isinstance(value, Reference) and given == NUMBER:
        return f"give it a unit where it is defined, or multiply: `{value.symbol.name} * {needed.example}`"
    if needed == NUMBER:
        return f"divide by the unit: `/ {_divisor(given)}`"
    if given == NUMBER:
        return f"give one of its numbers a unit, as in `{needed.example}`"
    if given / needed == ANGLE:
        return "the angle cancels only on division: `/ rad`"
    if needed / given == ANGLE:
        return "the angle is missing: `* rad`"
    return f"one of its units is wrong, or a factor in {needed / given} is missing"


def components_of(values: Sequence[Typed], start: int, end: int, report: Report) -> tuple[Components | None] | None:
    """The components of the result (in a tuple of one, None inside for a single value), or None after DB404."""
    found: Components | None = None
    for value in values:
        components = value.type.components
        if components is None or components == found:
            continue
        if found is not None:
            _report_differing(found, components, start, end, report)
            return None
        found = components
    return (found,)


def _report_differing(first: Components, second: Components, start: int, end: int, report: Report) -> None:
    help = "components are paired by name; pick those that match, as in `v.x`"
    if set(first) == set(second):
        help = "the names are the same in another order; give both groups one order"
    report("DB404", start, end, f"a vector of {shown(first)} meets one of {shown(second)}", help)


def warn_of_degrees(value: Typed, report: Report) -> None:
    """DB504 for radians that look like degrees, such as 30 rad.

    Wheels turn by hundreds of radians; only values up to 180 and from 270 to 360 count.
    """
    if isinstance(value, Constant) and value.unit is not None and value.unit.text == "rad":
        largest = max(abs(number) for number in value.values)
        if 2 * math.pi < largest <= 180.0 or 270.0 <= largest <= 360.0:
            headline, help = f"{largest:g} rad is more than a full turn", f"if degrees are meant, write `{largest:g} deg`"
            meant = Meant(f"{value.values[0]:g} deg", safe=False) if len(value.values) == 1 else None
            report("DB504", value.start, value.end, headline, help, meant=meant)


# Whether a value fits its field


def expect(
    value: Typed,
    report: Report,
    what: str,
    *,
    dimension: Dimension | None = None,
    components: Components | None = None,
    boolean: bool = False,
    stage: Stage = Stage.STEP,
    unit: str | None = None,
) -> Typed | None:
    """The value as a field takes it, or None after a finding.

    Args:
        what: The field, for a sentence (`the timestep`).
        dimension: None takes any. A bare number counts as SI where a length or a mass is due, a bare zero everywhere.
        components: None takes a single value only, a tuple takes those components or a single value for all of them,
            `ANY_SHAPE` takes everything.
        stage: The latest at which the value may be settled.
        unit: The probable unit of a bare number.
    """
    if boolean != value.type.boolean or value.type.picture:
        (truths if boolean else numbers)([value], report)
        return None
    if not boolean and dimension is not None and value.type.dimension != dimension:
        if not (bare(value) and _bare_is_si(dimension)) and not has_dimension(value, dimension, what, report, unit=unit):
            return None
        value = value._replace(type=value.type._replace(dimension=dimension))
    fits = _has_shape(value, components, what, report) and _has_stage(value, stage, what, report)
    return value if fits and _has_size(value, stage, what, report) else None


def expect_range(
    found: TypedRange,
    report: Report,
    what: str,
    *,
    dimension: Dimension | None = None,
    components: Components | None = None,
    stage: Stage = Stage.FIXED,
    unit: str | None = None,
) -> TypedRange | None:
    """As `expect`, for both ends of a range."""
    needs_unit = dimension is not None and dimension != NUMBER and not _bare_is_si(dimension)
    if dimension and needs_unit and bare(found.low) and bare(found.high) and not zero(found.high):
        missing_unit(found, dimension, report, unit)  # one unit is missing, behind both ends
        return None
    # The right end first: the unit of both stands there.
    high = expect(found.high, report, what, dimension=dimension, components=components, stage=stage)
    low = expect(found.low, report, what, dimension=dimension, components=components, stage=stage) if high else None
    return None if low is None or high is None else found._replace(low=low, high=high)


def _bare_is_si(dimension: Dimension) -> bool:
    return dimension in QUANTITIES and QUANTITIES[dimension].bare_is_si


def _has_shape(value: Typed, components: Components | None, what: str, report: Report) -> bool:
    found = value.type.components
    if components == ANY_SHAPE or found is None or found == components:
        return True
    if components is None:
        help = f"pick a component, or reduce it with {'`any` or `all`' if value.type.boolean else '`norm`, `sum`, `max` ...'}"
        report("DB404", value.start, value.end, f"{what} is {value.type.shape_words}, not a single value", help)
    elif len(found) != len(components) and found[0] in ("x", "1"):
        headline = f"{what} has {len(found)} values, not {len(components)}"
        report("DB106", value.start, value.end, headline, f"give {' and '.join(components)}")
    else:
        _report_differing(components, found, value.start, value.end, report)
    return False


def _has_stage(value: Typed, stage: Stage, what: str, report: Report) -> bool:
    if value.type.stage <= stage:
        return True
    allowed = "may be drawn once per episode, but not change within it" if stage is Stage.EPISODE else "must be fixed"
    report("DB407", value.start, value.end, f"{what} is {value.type.stage.words}", f"it {allowed}")
    return False


def _has_size(value: Typed, stage: Stage, what: str, report: Report) -> bool:
    """Warns of implausible values; refuses those settled before the episode that no engine computes with."""
    interval, dimension = value.type.interval, value.type.dimension
    largest = max(abs(interval.low), abs(interval.high))
    plausible = QUANTITIES[dimension].plausible if dimension in QUANTITIES else math.inf
    limit = _LARGEST if plausible == math.inf else _BEYOND * plausible
    counts = interval.finite and not value.type.boolean
    if counts and largest > limit and stage is not Stage.STEP:
        unit = "" if dimension == NUMBER else f" {dimension}"
        report("DB105", value.start, value.end, f"{what} of {largest:g}{unit}", f"give at most {limit:g}{unit}")
        return False
    if dimension == ANGLE:
        warn_of_degrees(value, report)
    if counts and largest > plausible:
        report("DB505", value.start, value.end, f"{what} of {largest:g} {dimension}", "check the unit")
    return True


# Corrections made from the text of a value: good guesses, never certain

_SIGNED = rf"[-+]?{syntax.NUMBER}"
_LITERAL = re.compile(rf"({_SIGNED}(?:\s+{_SIGNED})*)\s*([A-Za-z%][\w*/^%-]*)?", re.ASCII)


def swapped(low: Typed | syntax.Node, high: Typed | syntax.Node) -> Rewriting:
    """The ends of a range in the other order; a unit behind the last moves behind the new last."""
    start, middle, end = low.start, low.end - low.start, high.start - low.start

    def rewriting(piece: str) -> str:
        first, between, last = piece[:middle], piece[middle:end], piece[end : high.end - start]
        bare, united = _LITERAL.fullmatch(first), _LITERAL.fullmatch(last)
        if bare and united and united[2] and not bare[2]:
            return f"{united[1]}{between}{first} {united[2]}"
        return f"{last}{between}{first}"

    return rewriting


def divided(value: Typed, dimension: Dimension) -> Rewriting:
    """The value over a unit of its dimension; of `a when c`, `a` is divided."""
    part = _amount(value)
    start, end = part.start - value.start, part.end - value.start
    return lambda piece: f"{piece[:start]}{_factor(piece[start:end], part)} / {_divisor(dimension)}{piece[end:]}"


def negated(value: Typed) -> Rewriting:
    """The value with its sign turned: a minus comes or goes, and a difference is taken in the other order."""
    part = _amount(value)
    start, end = part.start - value.start, part.end - value.start
    return lambda piece: f"{piece[:start]}{_negative(piece[start:end], part)}{piece[end:]}"


def _negative(text: str, value: Typed) -> str:
    if not (isinstance(value, Operation) and _is_sum(value)):
        return text[1:].lstrip() if text.startswith("-") else f"-{text}"
    if value.operator == "add":
        return f"-({text})"
    left, right = (text[part.start - value.start : part.end - value.start] for part in value.args)
    between = text[len(left) : len(text) - len(right)]
    return f"{right}{between}{_factor(left, value.args[0])}"


def _amount(value: Typed) -> Typed:
    """`a` of `a when c`; any other value itself."""
    is_when = isinstance(value, Invocation) and value.function == "where" and value.args[1].start == value.start
    return value.args[1] if is_when and isinstance(value, Invocation) else value


def _factor(text: str, value: Typed) -> str:
    return f"({text})" if _is_sum(value) else text


def _is_sum(value: Typed) -> bool:
    """Whether it is a sum or a difference without parentheses around it, which a node counts as its own."""
    return isinstance(value, Operation) and value.operator in ("add", "sub") and value.args[0].start == value.start


def _divisor(dimension: Dimension) -> str:
    unit = str(dimension)
    return f"({unit})" if "/" in unit or "*" in unit else unit
