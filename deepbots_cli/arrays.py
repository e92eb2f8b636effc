"""Scalar trees over arrays: the same expression for many values at once.

Generated code computes one value after the other. Where thousands are wanted together (rewards that hindsight
replay asks for, the heights of a terrain), the tree is walked once and each operation is numpy's.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deepbots_cli.errors import DeepbotsError
from deepbots_cli.expressions.scalar import Const, Name, Op, Scalar

Array = NDArray[Any]


def evaluate(scalar: Scalar, values: Mapping[Name, Array]) -> Array:
    """The value of a tree for arrays of one shape; float64, or truth values.

    `values` holds the array of each name that the tree reads. What has no value (a division by zero) is inf or NaN, as
    numpy has it.

    Raises:
        DeepbotsError: The tree holds what is not computed from names and numbers alone.
    """
    with np.errstate(all="ignore"):
        return np.asarray(_evaluate(scalar, values))


def _evaluate(scalar: Scalar, values: Mapping[Name, Array]) -> Any:
    match scalar:
        case Const(value=value):
            return value
        case Name() if scalar in values:
            return values[scalar]
        case Op(op=operation, args=args) if operation in _OPERATIONS:
            return _OPERATIONS[operation](*(_evaluate(arg, values) for arg in args))
    raise DeepbotsError(f"{str(scalar)[:60]} has no value over arrays")


def _gathering(function: Callable[[Any, Any], Any]) -> Callable[..., Any]:
    """An operation of two that takes any number of arguments, from left to right."""
    return lambda *terms: reduce(function, terms)


def _hypot(*sides: Any) -> Any:
    """By the function that generated code calls, which rounds otherwise than numpy's: 0.1 us per value."""
    return np.asarray(np.frompyfunc(math.hypot, len(sides), 1)(*sides), float)


def _wrap(angle: Any) -> Any:
    return np.pi - np.mod(np.pi - angle, 2 * np.pi)


def _power(base: Any, exponent: Any) -> Any:
    return np.power(np.asarray(base, float), exponent)


_OPERATIONS: dict[str, Callable[..., Any]] = {
    "neg": np.negative,
    "add": _gathering(np.add),
    "sub": np.subtract,
    "mul": np.multiply,
    "div": np.true_divide,
    "pow": _power,
    "abs": np.abs,
    "min": _gathering(np.minimum),
    "max": _gathering(np.maximum),
    "hypot": _hypot,
    "sqrt": np.sqrt,
    "exp": np.exp,
    "log": np.log,
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "atan2": np.arctan2,
    "clamp": lambda x, low, high: np.minimum(np.maximum(x, low), high),
    "wrap": _wrap,
    "where": np.where,
    "less": np.less,
    "less_equal": np.less_equal,
    "greater": np.greater,
    "greater_equal": np.greater_equal,
    "equal": np.equal,
    "not_equal": np.not_equal,
    "and": _gathering(np.logical_and),
    "or": _gathering(np.logical_or),
    "not": np.logical_not,
}
