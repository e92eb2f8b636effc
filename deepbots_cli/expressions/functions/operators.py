"""The operators of scalar trees, in the form of functions. They are not functions of the language."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from deepbots_cli.expressions import intervals as iv
from deepbots_cli.expressions.functions.record import Family, Function, Param
from deepbots_cli.expressions.intervals import Interval

_MAX_WHOLE_EXPONENT = 1000
"""Of a power that is printed with `**`. `math.pow` computes larger ones, which overflow for most bases."""

_A = Param("a")
_B = Param("b")
_MANY = (_A, Param("b", variadic=True))
_CONDITION = Param("condition", boolean=True)


def _operator(
    name: str, params: tuple[Param, ...], python: str, interval: Callable[..., Interval], array: str = ""
) -> Function:
    return Function(name, Family.PURE, params, interval=interval, python=python, array=array)


OPERATORS: Mapping[str, Function] = {
    function.name: function
    for function in (
        _operator("neg", (_A,), "-a", iv.negate),
        _operator("add", _MANY, "a + b", iv.add),
        _operator("sub", (_A, _B), "a - b", iv.subtract),
        _operator("mul", (_A, _B), "a * b", iv.multiply),
        _operator("div", (_A, _B), "a / b", iv.divide, "np.true_divide(a, b)"),
        _operator("pow", (_A, _B), "pow(a, b)", iv.power, "np.power(np.asarray(a, float), b)"),
        _operator("less", (_A, _B), "a < b", iv.less),
        _operator("less_equal", (_A, _B), "a <= b", iv.less_equal),
        _operator("greater", (_A, _B), "a > b", lambda a, b: iv.less(b, a)),
        _operator("greater_equal", (_A, _B), "a >= b", lambda a, b: iv.less_equal(b, a)),
        _operator("equal", (_A, _B), "a == b", iv.equal),
        _operator("not_equal", (_A, _B), "a != b", lambda a, b: iv.subtract(iv.ALWAYS, iv.equal(a, b))),
        _operator("not", (_A,), "not a", lambda a: iv.subtract(iv.ALWAYS, a), "np.logical_not(a)"),
        _operator("and", _MANY, "a and b", iv.minimum, "np.logical_and(a, b)"),
        _operator("or", _MANY, "a or b", iv.maximum, "np.logical_or(a, b)"),
        _operator(
            "where", (_CONDITION, _A, _B), "a if condition else b", iv.where, "np.where(condition, a, b)"
        ),
    )
}


def whole_exponent(exponent: float) -> int | None:
    """Return the exponent as Python's `**` takes it; others go to `math.pow`, which never turns complex."""
    return int(exponent) if float(exponent).is_integer() and abs(exponent) <= _MAX_WHOLE_EXPONENT else None


def power(base: float, exponent: float) -> float:
    """Compute a power as `lower` prints it: `x * x`, `x ** n`, `pow(x, y)`."""
    integer = whole_exponent(exponent)
    if integer == 2:
        return base * base
    return math.pow(base, exponent) if integer is None else float(base) ** integer
