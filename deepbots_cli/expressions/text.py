"""Scalar trees as text: for people, and as Python for one world or a batch; the units that a text is
written in.

Python text has no more parentheses than it needs, and the order of sums is that of the tree. A `Target` has
the code of each operation: on plain floats (`SCALAR`), or on the values of another column of the function
table.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

from deepbots_cli.errors import BatchError
from deepbots_cli.expressions.dimensions import ONE, UNITS, Unit
from deepbots_cli.expressions.functions import (
    Code,
    Function,
    Precedence,
    function_named,
    infix,
    number_code,
    printed,
    template,
    whole_exponent,
)
from deepbots_cli.expressions.scalar import Const, Draw, EngineRead, Name, Op, Scalar, State
from deepbots_cli.expressions.syntax import NUMBER

_MAX_LISTED = 4
"""The number of items of a list that a text shows."""

_DRAW_SIGNS = {"uniform": " .. ", "integer": " .. ", "normal": " +- ", "choice": " | "}


def value_text(value: object) -> str:
    """Return a value as text on one line: numbers short, nothing as a dash, lists with commas."""
    match value:
        case None:
            return "-"
        case Const() | Name() | EngineRead() | Op() | State() | Draw():
            return formula_text(value)
        case bool():
            return "yes" if value else "no"
        case int():
            return f"{value:,}"
        case float():
            return f"{value:.5g}"
        case list() | tuple():
            listed = value if len(value) <= _MAX_LISTED + 1 else value[:_MAX_LISTED]
            more = [] if len(listed) == len(value) else [f"... {len(value)} in all"]
            return ", ".join([*map(value_text, listed), *more]) or "-"
        case _:
            return str(value).replace("\n", " ") or "-"


def formula_text(scalar: Scalar, digits: int = 12) -> str:
    """Return an expression as the language writes it, with figures in SI units and so many digits."""
    return to_python(_rounded(scalar, digits), _read)


def _rounded(scalar: Scalar, digits: int) -> Scalar:
    match scalar:
        case Const(value=float() as value):
            rounded = float(f"{value:.{digits}g}")
            return Const(int(rounded) if rounded.is_integer() and abs(rounded) < 1e6 else rounded)
        case Op(args=args) | State(args=args) | Draw(args=args):
            return scalar._replace(args=tuple(_rounded(arg, digits) for arg in args))
        case _:
            return scalar


def _read(leaf: Name | EngineRead | State | Draw) -> str:
    match leaf:
        case Name(name, component):
            return f"{name}.{component}" if component else name
        case EngineRead(function, subjects, component):
            return f"{function}({', '.join(subjects)})" + (f".{component}" if component else "")
        case State(name, args) | Draw(name, args):
            between = _DRAW_SIGNS.get(name, ", ") if isinstance(leaf, Draw) else ", "
            return f"{name}({between.join(to_python(arg, _read) for arg in args)})"


# Python


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
    if not text and not serves_arrays(function):
        raise BatchError(f"it calls '{function.name}', which has no Python for arrays")
    return text or function.python


def serves_arrays(function: Function) -> bool:
    """Return whether the `python` of a function means the same for arrays."""
    return all(_is_same_on_columns(node) for node in ast.walk(template(function.python)))


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


# Units


_NAME = "|".join(map(re.escape, sorted(UNITS, key=len, reverse=True)))
_WORD = rf"(?:{_NAME})(?!\w)(?:\^-?\d)?"
_UNIT = rf"(?<![\w.]){NUMBER}\s*({_WORD}(?:[*/]{_WORD})*)"
_USUAL = {"rad": "deg", "rad/s": "deg/s", "rad/s^2": "deg/s^2"}
_COMPOUND = rf"(?<![\w.])(?:{NUMBER})\s*\(({_WORD}(?:[*/]{_WORD})*)\)"
MAX_TEXT = 10_000
"""The maximum number of letters of an expression that are searched for a unit."""


def written_unit(unit: str, *texts: str) -> Unit | None:
    """Return the first unit in the texts that measures the same as the SI unit `unit`, or None."""
    units = (candidate for text in texts for candidate in units_in(text))
    return next((candidate for candidate in units if str(candidate.dimension) == unit), None)


def usual_unit(unit: str) -> Unit:
    """Return the unit in which people read a quantity in the SI unit `unit` that no text writes: deg for rad,
    else the SI unit."""
    return unit_named(_USUAL.get(unit, unit))


def unit_named(text: str) -> Unit:
    """Return the unit `deg/s`; one without a dimension where a word of the text is none."""
    return ONE if text in ("", "1") else _unit(text) or Unit(text, ONE.dimension)


def units_in(text: str) -> Iterator[Unit]:
    """Yield the units that follow a number in a text, in their order."""
    text = text[:MAX_TEXT]
    matches = [*re.finditer(_UNIT, text), *re.finditer(_COMPOUND, text)]
    for match in sorted(matches, key=lambda match: match.start()):
        unit = _unit(match[1])
        if unit is not None:
            yield unit


def _unit(text: str) -> Unit | None:
    """Return `deg/s` as a unit; None if a word is not a unit."""
    unit = ONE
    divides = False
    for word in re.split(r"([*/])", text):
        if word in ("*", "/"):
            divides = word == "/"
            continue
        name, _, exponent = word.partition("^")
        if name not in UNITS:
            return None
        power = UNITS[name] if not exponent else UNITS[name].to_power(int(exponent))._replace(text=word)
        if divides:
            unit = unit.per(power)
        elif unit is ONE:
            unit = power
        else:
            unit = unit.times(power)
    return unit._replace(text=text)
