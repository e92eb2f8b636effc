"""Scalar trees to Python text.

The text has no more parentheses than it needs, and the order of sums is that of the tree. A `Target` has the
code of each operation: on plain floats (`SCALAR`), or on the values of another column of the function table.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Sequence
from typing import NamedTuple

from deepbots_cli.errors import BatchError
from deepbots_cli.expressions.code import Code, Precedence, infix, number_code, printed, template
from deepbots_cli.expressions.functions import Function, function_named, whole_exponent
from deepbots_cli.expressions.scalar import Const, Draw, EngineRead, Name, Op, Scalar, State

Leaf = Callable[[Name | EngineRead | State | Draw], str]

_COLUMN_FUNCTIONS = {
    **{name: f"{name}(x)" for name in ("exp", "log")},
    **{name: f"{name}(angle)" for name in ("sin", "cos", "tan")},
    "atan2": "atan2(y, x)",
    "hypot": "hypot(x, *y)",
    "pow": "pow(a, b)",
    "min": "minimum(*x)",
    "max": "maximum(*x)",
}
"""The operations with a function of their own in `runtime.columns`; numpy rounds many of these differently
from `math`."""


class Target(NamedTuple):
    """The kind of values that generated code computes with: `function_code` gives the Python of an operation
    over its arguments."""

    name: str
    function_code: Callable[[Function], str]


def _scalar_code(function: Function) -> str:
    if function.method:
        return f"self.{function.method}({', '.join(function.arguments)})"
    return f"{function.helper}({', '.join(function.arguments)})" if function.helper else function.python


SCALAR = Target("scalar", _scalar_code)


def _column_code(function: Function) -> str:
    if function.helper or function.method:
        return _scalar_code(function)
    text = _COLUMN_FUNCTIONS.get(function.name) or function.array
    if not text and not all(_is_same_on_columns(node) for node in ast.walk(template(function.python))):
        raise BatchError(f"it calls '{function.name}', which has no Python for arrays")
    return text or function.python


def _is_same_on_columns(node: ast.AST) -> bool:
    """Return whether a part of a function's Python means the same for a column: arithmetic, comparisons and
    `abs`."""
    if isinstance(node, ast.Call):
        return isinstance(node.func, ast.Name) and node.func.id == "abs"
    return not isinstance(node, (ast.IfExp, ast.BoolOp, ast.Not, ast.Starred))


BATCH = Target("batch", _column_code)
"""The target for many worlds at once: each value is a column with one number per world."""


def to_python(scalar: Scalar, leaf: Leaf) -> str:
    """Return the tree as one Python expression; `leaf` gives the code of what is read, as an atom."""
    return _code(scalar, leaf, SCALAR).text


def operation_code(
    name: str, args: Sequence[Code], scalars: Sequence[Scalar], target: Target = SCALAR
) -> Code:
    """Return the code of an operation on arguments with this code; `scalars` are the trees of the
    arguments."""
    function = function_named(name)
    integer = whole_exponent(scalars[1].value) if name == "pow" and isinstance(scalars[1], Const) else None
    # Over columns, `a**2` would be a product, which rounds differently from the power of a single world.
    if integer is not None and (target is SCALAR or _is_product(integer, scalars[0])):
        return _power(args[0], integer, scalars[0])
    names = function.arguments
    text = target.function_code(function)
    if len(args) > len(names) and not names[-1].startswith("*"):  # `a + b` of more than two
        if isinstance(template(text), ast.Call):
            return operation_code(
                name, [operation_code(name, args[:-1], scalars[:-1], target), args[-1]], scalars[:2], target
            )
        return infix(template(text).op, args)  # type: ignore[attr-defined]
    if names[-1].startswith("*"):
        fixed_count = len(names) - 1
        args = [*args[:fixed_count], Code(", ".join(arg.text for arg in args[fixed_count:]))]
    return printed(template(text), dict(zip(names, args, strict=True)))


def _code(scalar: Scalar, leaf: Leaf, target: Target) -> Code:
    match scalar:
        case Const(value=value):
            return number_code(value)
        case Op(op=name, args=args):
            return operation_code(name, [_code(arg, leaf, target) for arg in args], args, target)
        case Name() | EngineRead() | State() | Draw():
            return Code(leaf(scalar))


def _is_product(exponent: int, scalar: Scalar) -> bool:
    """Return whether a power is written as a product; the C library's pow may round a square differently from
    a product."""
    return exponent == 2 and isinstance(scalar, (Name, State, Const))


def _power(base: Code, exponent: int, scalar: Scalar) -> Code:
    if _is_product(exponent, scalar):
        text = base.within(Precedence.SIGN)
        return Code(f"{text} * {text}", Precedence.PRODUCT)
    text = base.within(Precedence.ATOM)
    sign = "**" if re.fullmatch(r"[\w.]+", text) and exponent > 0 else " ** "  # like a formatter
    return Code(f"{text}{sign}{exponent}", Precedence.POWER)
