"""Values and scalar trees as text for people."""

from __future__ import annotations

from deepbots_cli.expressions.scalar import Const, Draw, EngineRead, Name, Op, Scalar, State
from deepbots_cli.expressions.targets import to_python

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
