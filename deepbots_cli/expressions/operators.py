"""Typing of operators: `not`, unary minus, arithmetic, powers, comparisons, `and`, `or`."""

from __future__ import annotations

import math
from fractions import Fraction

from deepbots_cli.expressions import agree, syntax
from deepbots_cli.expressions import intervals as iv
from deepbots_cli.expressions.dimensions import ANGLE, NUMBER, Dimension, Exponent
from deepbots_cli.expressions.intervals import TRUTH, Interval
from deepbots_cli.expressions.typed import Constant, Operation, Typed
from deepbots_cli.expressions.types import Components, Report, Type

_COMPARISONS = {"<": "less", "<=": "less_equal", ">": "greater", ">=": "greater_equal", "==": "equal", "!=": "not_equal"}
_MOST_EXPONENT = 12
# Roots that physics meets: halves, thirds and quarters. A float stands for one if it is the nearest.
_MOST_DENOMINATOR = 4


def unary(node: syntax.Unary, operand: Typed, report: Report) -> Typed | None:
    if node.operator == "not":
        if not agree.truths([operand], report):
            return None
        return Operation(operand.type, node.start, node.end, "not", (operand,))
    if not agree.numbers([operand], report):
        return None
    result = operand.type._replace(interval=iv.negate(operand.type.interval))
    if isinstance(operand, Constant):
        return operand._replace(type=result, start=node.start, values=tuple(-value for value in operand.values))
    return Operation(result, node.start, node.end, "neg", (operand,))


def binary(node: syntax.Binary, left: Typed, right: Typed, report: Report) -> Typed | None:
    components = agree.components_of((left, right), node.start, node.end, report)
    if components is None:
        return None
    if node.operator in ("and", "or"):
        return _join(node, left, right, components[0], report)
    if node.operator in _COMPARISONS:
        return _compare(node, left, right, components[0], report)
    if not agree.numbers((left, right), report):
        return None
    match node.operator:
        case "+" | "-":
            result = _sum(node, left, right, components[0], report)
        case "^":
            result = _power(node, left, right, components[0], report)
        case _:
            result = _product(node, left, right, components[0], report)
    if result is not None and _overflows(result):
        report("DB406", node.start, node.end, "a result too large to be kept")
    return result


def _overflows(result: Operation) -> bool:
    """Whether known numbers give an infinite one; a division by zero is told apart."""
    known = all(arg.type.interval.finite and arg.type.interval.single for arg in result.args)
    return known and math.inf in (abs(result.type.interval.low), abs(result.type.interval.high)) and result.type.interval.single


def _join(node: syntax.Binary, left: Typed, right: Typed, components: Components | None, report: Report) -> Typed | None:
    if not agree.truths((left, right), report):
        return None
    return _operation(node, node.operator, left, right, Type(components=components, boolean=True, interval=TRUTH))


def _compare(node: syntax.Binary, left: Typed, right: Typed, components: Components | None, report: Report) -> Typed | None:
    result = Type(components=components, boolean=True, interval=TRUTH)
    operator = _COMPARISONS[node.operator]
    if left.type.boolean and right.type.boolean and operator in ("equal", "not_equal"):
        return _operation(node, operator, left, right, result)
    if not agree.numbers((left, right), report):
        return None
    shared = agree.dimension_of((left, right), node.start, node.end, report)
    if shared is None:
        return None
    if shared == ANGLE:
        agree.warn_of_degrees(left, report)
        agree.warn_of_degrees(right, report)
    return _operation(node, operator, left, right, result)


def _sum(node: syntax.Binary, left: Typed, right: Typed, components: Components | None, report: Report) -> Operation | None:
    shared = agree.dimension_of((left, right), node.start, node.end, report)
    if shared is None:
        return None
    plus = node.operator == "+"
    interval = (iv.add if plus else iv.subtract)(left.type.interval, right.type.interval)
    return _operation(node, "add" if plus else "sub", left, right, Type(shared, components, interval=interval))


def _product(node: syntax.Binary, left: Typed, right: Typed, components: Components | None, report: Report) -> Operation:
    a, b = left.type, right.type
    if node.operator == "*":
        return _operation(
            node, "mul", left, right, Type(a.dimension * b.dimension, components, interval=iv.multiply(a.interval, b.interval))
        )
    if b.interval.finite and 0.0 in b.interval:
        headline = (
            "a division by zero"
            if b.interval.single
            else f"the divisor lies between {b.interval.low:g} and {b.interval.high:g}, and can be zero"
        )
        report("DB405", right.start, right.end, headline, "keep it away from zero, as in `max(x, 0.01 m)`")
    return _operation(node, "div", left, right, Type(a.dimension / b.dimension, components, interval=iv.divide(a.interval, b.interval)))


def _power(node: syntax.Binary, left: Typed, right: Typed, components: Components | None, report: Report) -> Operation | None:
    if not agree.has_dimension(right, NUMBER, "the exponent", report, alone=False):
        return None
    dimension = _raised(left.type.dimension, right, report)
    if dimension is None:
        return None
    base, exponent = left.type.interval, right.type.interval
    if base.finite and base.low < 0.0 and exponent.single and not exponent.low.is_integer():
        report(
            "DB406",
            left.start,
            left.end,
            f"a broken power of a value that can be as low as {base.low:g}",
            "keep it above with `max(x, ...)`",
        )
    if 0.0 in base and base.finite and exponent.high < 0.0:
        report(
            "DB405", left.start, left.end, "a negative power of a value that can be zero", "keep it away from zero, as in `max(x, 0.01 m)`"
        )
    interval = iv.power(base, exponent)
    return _operation(node, "pow", left, right, Type(dimension, components, interval=interval))


def _raised(base: Dimension, exponent: Typed, report: Report) -> Dimension | None:
    """The dimension of a power: a quantity takes only exponents that are known and simple."""
    if base == NUMBER:
        return NUMBER
    known = exponent.type.interval
    fraction = _simple(known) if known.single and exponent.type.components is None else None
    if fraction is None:
        headline = f"{base.words} to a power that is not a known, simple number"
        report("DB503", exponent.start, exponent.end, headline, "divide by a unit first: only a plain number takes any exponent")
        return None
    return base**fraction


def _simple(known: Interval) -> Exponent | None:
    value = known.low
    if abs(value) > _MOST_EXPONENT:
        return None
    if value.is_integer():
        return int(value)
    near = Fraction(value).limit_denominator(_MOST_DENOMINATOR)
    return near if float(near) == value else None


def _operation(node: syntax.Binary, operator: str, left: Typed, right: Typed, result: Type) -> Operation:
    stage = max(left.type.stage, right.type.stage)
    return Operation(result._replace(stage=stage), node.start, node.end, operator, (left, right))
