"""The meaning of every pure operator, and operations that are computed while compiling.

Arithmetic is Python's: a division by zero, an overflow or a bad domain is an ArithmeticError or a
ValueError. Folding never meets one, it leaves such an operation to fail where it runs.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from functools import reduce

from deepbots_cli.expressions.scalar import Const, Op, Scalar

Number = float | bool


def _wrap(angle: float) -> float:
    """The same angle in (-pi, pi]; Python's `%` takes the sign of its right side."""
    return math.pi - (math.pi - angle) % math.tau


def _choose(condition: Number, a: Number, b: Number) -> Number:
    return a if condition else b


def _total(*terms: float) -> float:
    return reduce(operator.add, terms)


def _clamp(x: float, low: float, high: float) -> float:
    return min(max(x, low), high)


# The operators that take any number of arguments, and are the argument itself if there is one.
GATHERING = frozenset({"add", "min", "max", "and", "or"})
OPERATORS: dict[str, Callable[..., Number]] = {
    "neg": operator.neg,
    "add": _total,
    "sub": operator.sub,
    "mul": operator.mul,
    "div": operator.truediv,
    "pow": math.pow,
    "abs": abs,
    "min": min,
    "max": max,
    "hypot": math.hypot,
    "sqrt": math.sqrt,
    "exp": math.exp,
    "log": math.log,
    "sin": math.sin,
    "cos": math.cos,
    "tan": math.tan,
    "atan2": math.atan2,
    "clamp": _clamp,
    "wrap": _wrap,
    "where": _choose,
    "less": operator.lt,
    "less_equal": operator.le,
    "greater": operator.gt,
    "greater_equal": operator.ge,
    "equal": operator.eq,
    "not_equal": operator.ne,
    "and": lambda *terms: all(terms),
    "or": lambda *terms: any(terms),
    "not": operator.not_,
}

# What leaves the other argument as it is: x + 0, x - 0, x * 1, x / 1, x ^ 1. Units become such factors.
_NEUTRAL_RIGHT = {"add": 0.0, "sub": 0.0, "mul": 1.0, "div": 1.0, "pow": 1.0}
_NEUTRAL_LEFT = {"add": 0.0, "mul": 1.0}


def op(name: str, *args: Scalar) -> Scalar:
    """The operation, or what it comes to where that is known now."""
    if len(args) == 1 and name in GATHERING:
        return args[0]
    values = [arg.value for arg in args if isinstance(arg, Const)]
    if len(values) == len(args):
        return _computed(name, values) or Op(name, args)
    if name == "where" and isinstance(args[0], Const):
        return args[1] if args[0].value else args[2]
    if len(args) == 2:
        left, right = args
        if isinstance(right, Const) and right.value == _NEUTRAL_RIGHT.get(name):
            return left
        if isinstance(left, Const) and left.value == _NEUTRAL_LEFT.get(name):
            return right
    return Op(name, args)


def _computed(name: str, values: list[Number]) -> Const | None:
    try:
        value = OPERATORS[name](*values)
    except (ArithmeticError, ValueError):
        return None
    if isinstance(value, bool):
        return Const(value)
    return Const(value) if math.isfinite(value) else None
