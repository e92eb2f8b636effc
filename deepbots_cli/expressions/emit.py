"""Scalar trees to Python text, over a table of operators.

The text holds no more parentheses than it needs, and computes exactly what the tree says: the order
of sums is kept. Another table (arrays) prints the same trees for another target.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from enum import IntEnum
from typing import NamedTuple

from deepbots_cli.expressions.scalar import Const, Draw, Name, Op, Scalar, State, World

Leaf = Callable[[Name | World | State | Draw], str]


class Bind(IntEnum):
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
    bind: Bind = Bind.ATOM

    def within(self, least: int) -> str:
        """The text, in parentheses where it binds less than `least`."""
        return self.text if self.bind >= least else f"({self.text})"

    @property
    def simple(self) -> bool:
        """Whether it may be written twice: a name, an attribute, a number."""
        return self.text.replace(".", "").replace("_", "").replace("-", "").isalnum()


def operand(code: str) -> str:
    """The code as one side of any operator: in parentheses unless it is a name, an attribute, an item or a number."""
    return code if re.sub(r"[._\[\]]", "", code).isalnum() else f"({code})"


Form = Callable[[tuple[Code, ...]], Code]
Table = Mapping[str, Form]


def python(scalar: Scalar, leaf: Leaf, table: Table | None = None) -> str:
    """The tree as one Python expression; `leaf` gives the code of what is read, as an atom."""
    return _code(scalar, leaf, PYTHON if table is None else table).text


def _code(scalar: Scalar, leaf: Leaf, table: Table) -> Code:
    match scalar:
        case Const(value=value):
            return _number(value)
        case Op(op="pow", args=(base, exponent)) if (whole := _whole(exponent)) is not None:
            return _power(_code(base, leaf, table), whole)
        case Op(op=name, args=args):
            return table[name](tuple([_code(arg, leaf, table) for arg in args]))
        case Name() | World() | State() | Draw():
            return Code(leaf(scalar))


def _number(value: float | bool) -> Code:
    negative = not isinstance(value, bool) and str(value).startswith("-")
    return Code(repr(value), Bind.SIGN if negative else Bind.ATOM)


def _whole(exponent: Scalar) -> int | None:
    """The exponent as Python's `**` takes it; others go to `math.pow`, which never turns complex."""
    if isinstance(exponent, Const) and float(exponent.value).is_integer() and abs(exponent.value) <= 1000:
        return int(exponent.value)
    return None


def _power(base: Code, exponent: int) -> Code:
    if exponent == 2 and base.simple:
        text = base.within(Bind.SIGN)
        return Code(f"{text} * {text}", Bind.PRODUCT)
    return Code(f"{base.within(Bind.ATOM)} ** {exponent}", Bind.POWER)


def _infix(sign: str, bind: Bind) -> Form:
    """Operators that group to the left: only the right sides need to bind more tightly."""

    def form(args: tuple[Code, ...]) -> Code:
        first, *rest = args
        return Code(f" {sign} ".join([first.within(bind), *(arg.within(bind + 1) for arg in rest)]), bind)

    return form


def _comparison(sign: str) -> Form:
    """Python would chain comparisons, so both sides must bind more tightly."""

    def form(args: tuple[Code, ...]) -> Code:
        left, right = (arg.within(Bind.COMPARISON + 1) for arg in args)
        return Code(f"{left} {sign} {right}", Bind.COMPARISON)

    return form


def _call(function: str) -> Form:
    return lambda args: Code(f"{function}({', '.join(arg.text for arg in args)})")


def _negative(args: tuple[Code, ...]) -> Code:
    return Code(f"-{args[0].within(Bind.SIGN)}", Bind.SIGN)


def _not(args: tuple[Code, ...]) -> Code:
    return Code(f"not {args[0].within(Bind.NOT)}", Bind.NOT)


def _where(args: tuple[Code, ...]) -> Code:
    condition, a, b = args
    return Code(f"{a.within(Bind.OR)} if {condition.within(Bind.OR)} else {b.within(Bind.TERNARY)}", Bind.TERNARY)


def _clamp(args: tuple[Code, ...]) -> Code:
    """A conditional where its parts may be repeated: 25 ns where two calls take 110."""
    x, low, high = args
    if x.simple and low.simple and high.simple:
        return Code(f"{low.text} if {x.text} < {low.text} else {high.text} if {x.text} > {high.text} else {x.text}", Bind.TERNARY)
    return Code(f"min(max({x.text}, {low.text}), {high.text})")


def _wrap(args: tuple[Code, ...]) -> Code:
    return Code(f"pi - (pi - {args[0].within(Bind.PRODUCT)}) % tau", Bind.SUM)


PYTHON: Table = {
    "neg": _negative,
    "add": _infix("+", Bind.SUM),
    "sub": _infix("-", Bind.SUM),
    "mul": _infix("*", Bind.PRODUCT),
    "div": _infix("/", Bind.PRODUCT),
    "pow": _call("pow"),
    "less": _comparison("<"),
    "less_equal": _comparison("<="),
    "greater": _comparison(">"),
    "greater_equal": _comparison(">="),
    "equal": _comparison("=="),
    "not_equal": _comparison("!="),
    "and": _infix("and", Bind.AND),
    "or": _infix("or", Bind.OR),
    "not": _not,
    "where": _where,
    "clamp": _clamp,
    "wrap": _wrap,
    **{name: _call(name) for name in ("abs", "min", "max", "hypot", "sqrt", "exp", "log", "sin", "cos", "tan", "atan2")},
}
