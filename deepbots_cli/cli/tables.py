"""Aligned columns of text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from deepbots_cli.cli.terminal import printable
from deepbots_cli.diagnostics.render import columns
from deepbots_cli.expressions.printer import python
from deepbots_cli.expressions.scalar import Const, Draw, Name, Op, Scalar, State, World

Row = Mapping[str, object]

_NUMBERS = (int, float, type(None))
_LISTED = 4  # items of a list in one cell, beyond which there are too many to read
_NOTHING: tuple[object, ...] = (None, "", [], ())


def table(rows: Sequence[Row], indent: str = "  ") -> str:
    """Rows under the names of their keys; columns of numbers are aligned to the right.

    The keys of the first row are the columns. A column that is empty in every row is left out.
    """
    names = [name for name in rows[0] if any(row.get(name) not in _NOTHING for row in rows)] if rows else []
    cells = [[cell(row.get(name)) for name in names] for row in rows]
    right = [all(type(row.get(name)) in _NUMBERS for row in rows) for name in names]
    widths = [max(map(columns, column)) for column in zip(names, *cells, strict=True)]
    lines = [_line(line, widths, right) for line in (names, ["-" * width for width in widths], *cells)]
    return "\n".join(f"{indent}{line}".rstrip() for line in lines)


def pairs(row: Row, indent: str = "  ") -> str:
    """One row as lines of name and value; empty values are left out."""
    shown = {name: cell(value) for name, value in row.items() if value not in _NOTHING}
    width = max(map(columns, shown), default=0)
    return "\n".join(f"{indent}{name}{' ' * (width - columns(name))}  {value}" for name, value in shown.items())


def cell(value: object) -> str:
    """A value as the text of a cell: numbers short, nothing as a dash, lists with commas."""
    match value:
        case None:
            return "-"
        case Const() | Name() | World() | Op() | State() | Draw():
            return formula(value)
        case bool():
            return "yes" if value else "no"
        case int():
            return f"{value:,}"
        case float():
            return f"{value:.5g}"
        case list() | tuple():
            shown = value if len(value) <= _LISTED + 1 else value[:_LISTED]
            rest = [] if len(shown) == len(value) else [f"... {len(value)} in all"]
            return ", ".join([*map(cell, shown), *rest]) or "-"
        case _:
            return printable(str(value).replace("\n", " ")) or "-"


def formula(scalar: Scalar, digits: int = 12) -> str:
    """An expression as the language writes it, with figures in SI units and so many digits."""
    return python(_rounded(scalar, digits), _read)


def _rounded(scalar: Scalar, digits: int) -> Scalar:
    match scalar:
        case Const(value=float() as value):
            shown = float(f"{value:.{digits}g}")
            return Const(int(shown) if shown.is_integer() and abs(shown) < 1e6 else shown)
        case Op(args=args) | State(args=args) | Draw(args=args):
            return scalar._replace(args=tuple(_rounded(arg, digits) for arg in args))
        case _:
            return scalar


_BETWEEN = {"uniform": " .. ", "integer": " .. ", "normal": " +- ", "choice": " | "}


def _read(leaf: Name | World | State | Draw) -> str:
    match leaf:
        case Name(name, component):
            return f"{name}.{component}" if component else name
        case World(function, subjects, component):
            return f"{function}({', '.join(subjects)})" + (f".{component}" if component else "")
        case State(name, args) | Draw(name, args):
            between = _BETWEEN.get(name, ", ") if isinstance(leaf, Draw) else ", "
            return f"{name}({between.join(python(arg, _read) for arg in args)})"


def _line(cells: Sequence[str], widths: Sequence[int], right: Sequence[bool]) -> str:
    padded = []
    for text, width, to_right in zip(cells, widths, right, strict=True):
        gap = " " * (width - columns(text))
        padded.append(gap + text if to_right else text + gap)
    return "  ".join(padded)
