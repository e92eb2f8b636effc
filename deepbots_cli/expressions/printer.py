"""Scalar trees to Python text.

The text holds no more parentheses than it needs, and computes what the tree says: the order of sums is kept. A `Target` says how each
operation is written: on plain floats (`SCALAR`), or on whatever else a column of the function table is for.
"""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Callable, Mapping, Sequence
from enum import IntEnum
from functools import cache
from typing import NamedTuple

from deepbots_cli.errors import BatchError
from deepbots_cli.expressions.functions import Function, operation, whole_exponent
from deepbots_cli.expressions.scalar import Const, Draw, Name, Op, Scalar, State, World

Leaf = Callable[[Name | World | State | Draw], str]


class Precedence(IntEnum):
    """How strongly Python binds, from loose to tight."""

    TERNARY = 0
    OR = 1
    AND = 2
    NOT = 3
    COMPARISON = 4
    SUM = 5
    PRODUCT = 6
    SIGN = 7
    POWER = 8
    ATOM = 9


class Code(NamedTuple):
    """A piece of Python and how strongly its outermost operator binds."""

    text: str
    bind: Precedence = Precedence.ATOM

    def within(self, min_precedence: int) -> str:
        """The text, in parentheses where it binds less than `min_precedence`."""
        return self.text if self.bind >= min_precedence else f"({self.text})"


class Target(NamedTuple):
    """The kind of values that generated code computes with: `written` gives the Python of an operation over its arguments."""

    name: str
    written: Callable[[Function], str]


def _on_floats(function: Function) -> str:
    return f"{function.helper}({', '.join(function.arguments)})" if function.helper else function.python


SCALAR = Target("scalar", _on_floats)

_ON_COLUMNS = {
    **{name: f"{name}(x)" for name in ("exp", "log")},
    **{name: f"{name}(angle)" for name in ("sin", "cos", "tan")},
    "atan2": "atan2(y, x)",
    "hypot": "hypot(x, *y)",
    "pow": "pow(a, b)",
    "min": "minimum(*x)",
    "max": "maximum(*x)",
}
"""What has a function of its own in `runtime.columns`; numpy rounds many of these otherwise than `math` does."""


def _on_columns(function: Function) -> str:
    if function.helper:
        return _on_floats(function)
    text = _ON_COLUMNS.get(function.name) or function.array
    if not text and not all(_is_same_on_columns(node) for node in ast.walk(_template(function.python))):
        raise BatchError(f"it calls '{function.name}', which has no Python for arrays")
    return text or function.python


def _is_same_on_columns(node: ast.AST) -> bool:
    """Whether a part of a function's Python means the same for a column: arithmetic, comparisons and `abs`."""
    if isinstance(node, ast.Call):
        return isinstance(node.func, ast.Name) and node.func.id == "abs"
    return not isinstance(node, (ast.IfExp, ast.BoolOp, ast.Not, ast.Starred))


BATCH = Target("batch", _on_columns)
"""For many worlds at once: each value is a column with one number per world."""


def python(scalar: Scalar, leaf: Leaf, target: Target = SCALAR) -> str:
    """The tree as one Python expression; `leaf` gives the code of what is read, as an atom."""
    return _code(scalar, leaf, target).text


def number(value: float | bool) -> Code:
    """The code of a constant."""
    negative = not isinstance(value, bool) and str(value).startswith("-")
    code = repr(value).replace(repr(math.pi), "pi") if abs(value) == math.pi else repr(value)
    return Code(code, Precedence.SIGN if negative else Precedence.ATOM)


def applied(name: str, args: Sequence[Code], scalars: Sequence[Scalar], target: Target = SCALAR) -> Code:
    """The code of an operation on arguments with this code; `scalars` are the trees of the arguments."""
    function = operation(name)
    whole = whole_exponent(scalars[1].value) if name == "pow" and isinstance(scalars[1], Const) else None
    # Over columns, `a**2` would be a product, which rounds otherwise than the power of a single world.
    if whole is not None and (target is SCALAR or _is_product(whole, scalars[0])):
        return _power(args[0], whole, scalars[0])
    names = function.arguments
    text = target.written(function)
    if len(args) > len(names) and not names[-1].startswith("*"):  # `a + b` of more than two
        if isinstance(_template(text), ast.Call):
            return applied(name, [applied(name, args[:-1], scalars[:-1], target), args[-1]], scalars[:2], target)
        return _infix(_template(text).op, args)  # type: ignore[attr-defined]
    if names[-1].startswith("*"):
        rest = len(names) - 1
        args = [*args[:rest], Code(", ".join(arg.text for arg in args[rest:]))]
    return _printed(_template(text), dict(zip(names, args, strict=True)))


def require_printable(function: Function) -> None:
    """Try the Python of a function.

    Raises:
        ValueError: It holds more than names, numbers, operators, comparisons of two, calls and `a if c else b`.
    """
    if function.python:
        _printed(_template(function.python), dict.fromkeys(function.arguments, Code("x")))


def operand(code: str) -> str:
    """The code as one side of any operator: in parentheses unless it is a name, an attribute, an item or a number."""
    return code if re.sub(r"[._\[\]]", "", code).isalnum() else f"({code})"


def _code(scalar: Scalar, leaf: Leaf, target: Target) -> Code:
    match scalar:
        case Const(value=value):
            return number(value)
        case Op(op=name, args=args):
            return applied(name, [_code(arg, leaf, target) for arg in args], args, target)
        case Name() | World() | State() | Draw():
            return Code(leaf(scalar))


def _is_product(exponent: int, scalar: Scalar) -> bool:
    """Whether a power is written as a product; the C library's pow may round a square otherwise than a product does."""
    return exponent == 2 and isinstance(scalar, (Name, State, Const))


def _power(base: Code, exponent: int, scalar: Scalar) -> Code:
    if _is_product(exponent, scalar):
        text = base.within(Precedence.SIGN)
        return Code(f"{text} * {text}", Precedence.PRODUCT)
    text = base.within(Precedence.ATOM)
    sign = "**" if re.fullmatch(r"[\w.]+", text) and exponent > 0 else " ** "  # as a formatter has it
    return Code(f"{text}{sign}{exponent}", Precedence.POWER)


# The Python of a function, with the code of its arguments in place of their names

_SIGNS: dict[type[ast.AST], tuple[str, Precedence]] = {
    ast.Add: ("+", Precedence.SUM),
    ast.Sub: ("-", Precedence.SUM),
    ast.Mult: ("*", Precedence.PRODUCT),
    ast.Div: ("/", Precedence.PRODUCT),
    ast.FloorDiv: ("//", Precedence.PRODUCT),
    ast.Mod: ("%", Precedence.PRODUCT),
    ast.And: ("and", Precedence.AND),
    ast.Or: ("or", Precedence.OR),
    ast.Lt: ("<", Precedence.COMPARISON),
    ast.LtE: ("<=", Precedence.COMPARISON),
    ast.Gt: (">", Precedence.COMPARISON),
    ast.GtE: (">=", Precedence.COMPARISON),
    ast.Eq: ("==", Precedence.COMPARISON),
    ast.NotEq: ("!=", Precedence.COMPARISON),
}


@cache
def _template(text: str) -> ast.expr:
    return ast.parse(text, mode="eval").body


def _printed(node: ast.expr, args: Mapping[str, Code]) -> Code:
    match node:
        case ast.Name(id=name):
            return args.get(name) or Code(name)
        case ast.Constant(value=bool() | int() | float() as value):
            return number(value)
        case ast.Call(func=ast.Name(id=name), args=parts, keywords=[]):
            return Code(f"{name}({', '.join(_printed(part, args).text for part in parts)})")
        case ast.Call(func=ast.Attribute(value=ast.Name(id="np"), attr=name), args=parts, keywords=[]):
            return Code(f"np.{name}({', '.join(_printed(part, args).text for part in parts)})")
        case ast.Starred(value=ast.Name(id=name)):
            return args[f"*{name}"]
        case ast.BinOp(op=sign, left=left, right=right) | ast.Compare(ops=[sign], left=left, comparators=[right]) if type(sign) in _SIGNS:
            return _infix(sign, [_printed(left, args), _printed(right, args)])
        case ast.BoolOp(op=sign, values=parts):
            return _infix(sign, [_printed(part, args) for part in parts])
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            negated = _printed(inner, args)
            return Code(
                f"-({negated.text})" if negated.bind is Precedence.POWER else f"-{negated.within(Precedence.SIGN)}", Precedence.SIGN
            )
        case ast.UnaryOp(op=ast.Not(), operand=inner):
            return Code(f"not {_printed(inner, args).within(Precedence.NOT)}", Precedence.NOT)
        case ast.IfExp(test=test, body=a, orelse=b):
            condition = _printed(test, args).within(Precedence.OR)
            return Code(
                f"{_printed(a, args).within(Precedence.OR)} if {condition} else {_printed(b, args).within(Precedence.TERNARY)}",
                Precedence.TERNARY,
            )
    raise ValueError(f"{ast.unparse(node)[:60]!r} is not part of the Python of functions")


def _infix(operator: ast.AST, codes: Sequence[Code]) -> Code:
    """Operators group to the left, so the right sides bind more tightly; Python chains comparisons, so both sides do."""
    sign, bind = _SIGNS[type(operator)]
    left = codes[0].within(bind + 1 if bind is Precedence.COMPARISON else bind)
    return Code(f" {sign} ".join([left, *(code.within(bind + 1) for code in codes[1:])]), bind)
