"""Pieces of Python, and how strongly they bind: text with no more parentheses than it needs."""

from __future__ import annotations

import ast
import math
from collections.abc import Mapping, Sequence
from enum import IntEnum
from functools import cache
from typing import NamedTuple


class Precedence(IntEnum):
    """The precedence of Python's operators, from loose to tight."""

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
    precedence: Precedence = Precedence.ATOM

    def within(self, min_precedence: int) -> str:
        """Return the text, in parentheses where it binds less than `min_precedence`."""
        return self.text if self.precedence >= min_precedence else f"({self.text})"


def number_code(value: float | bool) -> Code:
    """Return the code of a constant."""
    # `value < 0` is false for -0.0.
    negative = not isinstance(value, bool) and str(value).startswith("-")
    code = repr(value).replace(repr(math.pi), "pi") if abs(value) == math.pi else repr(value)
    return Code(code, Precedence.SIGN if negative else Precedence.ATOM)


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
def template(text: str) -> ast.expr:
    """Return the syntax tree of the Python of a function."""
    return ast.parse(text, mode="eval").body


def names_in(text: str) -> list[str]:
    """Return the names in the Python of a function, each as often as it occurs."""
    return [node.id for node in ast.walk(template(text)) if isinstance(node, ast.Name)]


def printed(node: ast.expr, args: Mapping[str, Code]) -> Code:
    """Return the Python code of a function, with the code of its arguments in place of their names.

    Raises:
        ValueError: It contains more than names, numbers, operators, comparisons of two, calls and `a if c
            else b`.
    """
    match node:
        case ast.Name(id=name):
            return args.get(name) or Code(name)
        case ast.Constant(value=bool() | int() | float() as value):
            return number_code(value)
        case ast.Call(func=ast.Name(id=name), args=parts, keywords=[]):
            return Code(f"{name}({', '.join(printed(part, args).text for part in parts)})")
        case ast.Call(
            func=ast.Attribute(value=ast.Name(id="np" | "self" as owner), attr=name), args=parts, keywords=[]
        ):
            return Code(f"{owner}.{name}({', '.join(printed(part, args).text for part in parts)})")
        case ast.Starred(value=ast.Name(id=name)):
            return args[f"*{name}"]
        case (
            ast.BinOp(op=sign, left=left, right=right)
            | ast.Compare(ops=[sign], left=left, comparators=[right])
        ) if type(sign) in _SIGNS:
            return infix(sign, [printed(left, args), printed(right, args)])
        case ast.BoolOp(op=sign, values=parts):
            return infix(sign, [printed(part, args) for part in parts])
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            negated = printed(inner, args)
            return Code(
                f"-({negated.text})"
                if negated.precedence is Precedence.POWER
                else f"-{negated.within(Precedence.SIGN)}",
                Precedence.SIGN,
            )
        case ast.UnaryOp(op=ast.Not(), operand=inner):
            return Code(f"not {printed(inner, args).within(Precedence.NOT)}", Precedence.NOT)
        case ast.IfExp(test=test, body=a, orelse=b):
            condition = printed(test, args).within(Precedence.OR)
            # `if else` groups to the right, so its last part needs no parentheses.
            return Code(
                f"{printed(a, args).within(Precedence.OR)} if {condition} else"
                f" {printed(b, args).within(Precedence.TERNARY)}",
                Precedence.TERNARY,
            )
    raise ValueError(f"{ast.unparse(node)[:60]!r} is not part of the Python of functions")


def infix(operator: ast.AST, codes: Sequence[Code]) -> Code:
    """Return the code of an infix operation. Operators group to the left, so the right sides bind more
    tightly; Python chains comparisons, so both sides do."""
    sign, bind = _SIGNS[type(operator)]
    left = codes[0].within(bind + 1 if bind is Precedence.COMPARISON else bind)
    return Code(f" {sign} ".join([left, *(code.within(bind + 1) for code in codes[1:])]), bind)
