"""Tables as plain text, CSV and LaTeX."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from io import StringIO
from itertools import chain, starmap
from pathlib import Path

from rich.cells import cell_len
from rich.console import Console
from rich.table import Table
from rich.text import Text

from deepbots_cli.cli import terminal
from deepbots_cli.expressions.text import value_text
from deepbots_cli.files import atomic_write, csv_text

Row = Mapping[str, object]


class Measured(str):
    """The text of a cell, and the `number` or the two ends of the interval that it shows, for CSV."""

    number: object

    def __new__(cls, text: str, number: object) -> Measured:
        cell = super().__new__(cls, text)
        cell.number = number
        return cell


_MIN_TEXT_WIDTH = 12
"""The smallest width of a column of text; below it, most words are broken."""
_NUMBERS = (int, float, type(None))
_EMPTY_VALUES: tuple[object, ...] = (None, "", [], ())


def table(rows: Sequence[Row], indent: str = "  ", *, is_prose: bool = False) -> str:
    """Format rows under the names of their keys. Columns of numbers are aligned to the right.

    The keys of the first row are the columns. A column that is empty in every row is left out. On a terminal
    that is too narrow, long cells continue on further lines; with `is_prose`, also without a terminal.
    """
    names, cells, right = _columns(rows)
    widths = [max(map(cell_len, column)) for column in zip(names, *cells, strict=True)]
    min_widths = [
        width if is_number else min(width, _MIN_TEXT_WIDTH)
        for width, is_number in zip(widths, right, strict=True)
    ]
    grid = Table.grid(padding=(0, 2))
    for width, is_number in zip(min_widths, right, strict=True):
        grid.add_column(
            justify="right" if is_number else "left", no_wrap=is_number, overflow="fold", min_width=width
        )
    for line in (names, *cells):
        # In a plain string, rich takes brackets such as `[red]` for markup.
        grid.add_row(*(Text(text) for text in line))
        if line is names:
            grid.add_row(*(Text("-" * width, no_wrap=True, overflow="crop") for width in widths))
    min_width, width = (sum(column_widths) + 2 * len(column_widths) for column_widths in (min_widths, widths))
    return _lines(grid, min_width, width, indent, fits_terminal=is_prose or sys.stdout.isatty())


def _columns(rows: Sequence[Row]) -> tuple[list[str], list[list[str]], list[bool]]:
    """Return the names of the columns, the cells of each row, and which columns have numbers only."""
    columns = [*rows[0]] if rows else []
    names = [name for name in columns if any(row.get(name) not in _EMPTY_VALUES for row in rows)] or columns
    cells = [[cell_text(row.get(name)) for name in names] for row in rows]
    return names, cells, [all(type(row.get(name)) in _NUMBERS for row in rows) for name in names]


_LATEX = str.maketrans(
    {
        "\\": r"\textbackslash{}",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
        # Without T1 fonts, these print other marks.
        "<": r"\textless{}",
        ">": r"\textgreater{}",
        "|": r"\textbar{}",
        # At the beginning of a row, these are arguments of the command before.
        "[": "{[}",
        "*": "{*}",
        **{mark: f"\\{mark}" for mark in "&%$#_{}"},
    }
)


def write_tables(
    rows: Sequence[Row], csv: Path | None, latex: Path | None, *more_rows: Sequence[Row]
) -> None:
    """Write rows as CSV, with numbers in full, and as a table of LaTeX with the rules of `booktabs`, which
    further tables follow."""
    if csv is not None:
        numbers = [dict(chain.from_iterable(starmap(_numbers, row.items()))) for row in rows]
        with atomic_write(csv) as draft:
            draft.write_text(csv_text(numbers), encoding="utf-8", newline="")
    if latex is not None:
        with atomic_write(latex) as draft:
            draft.write_text("\n".join(map(_tabular, (rows, *more_rows))), encoding="utf-8")


def _numbers(name: str, cell: object) -> Iterable[tuple[str, object]]:
    """Return the columns of CSV for a cell: an interval has one for each end."""
    number = getattr(cell, "number", cell)
    if not isinstance(number, tuple):
        return [(name, number)]
    stem = name.removesuffix("_95 %")
    return zip((f"{stem}_low", f"{stem}_high"), number, strict=True)


def _tabular(rows: Sequence[Row]) -> str:
    names, cells, right = _columns(rows)
    head, *lines = (" & ".join(cell.translate(_LATEX) for cell in row) + r" \\" for row in (names, *cells))
    columns = "".join("r" if is_number else "l" for is_number in right)
    parts = [rf"\begin{{tabular}}{{{columns}}}", r"\toprule", head, r"\midrule", *lines, r"\bottomrule"]
    return "\n".join([*parts, r"\end{tabular}", ""])


def row_as_lines(row: Row, indent: str = "  ") -> str:
    """Format one row as lines of name and value; empty values are left out."""
    cells = {name: cell_text(value) for name, value in row.items() if value not in _EMPTY_VALUES}
    grid = Table.grid(padding=(0, 2))
    grid.add_column(no_wrap=True)
    grid.add_column(overflow="fold")
    for name, value in cells.items():
        grid.add_row(Text(name), Text(value))
    name_width, value_width = (max(map(cell_len, column), default=0) for column in (cells, cells.values()))
    widths = name_width + _MIN_TEXT_WIDTH + 4, name_width + value_width + 4
    return _lines(grid, *widths, indent, fits_terminal=sys.stdout.isatty())


def _lines(grid: Table, min_width: int, needed: int, indent: str, *, fits_terminal: bool) -> str:
    """A grid as text, no wider than the terminal if it `fits_terminal`, unless that leaves less than the
    `min_width`."""
    room = terminal.width() - len(indent) if fits_terminal else needed
    out = StringIO()
    console = Console(
        file=out,
        width=min(needed, room) if room >= min_width else needed,
        color_system=None,
        legacy_windows=False,
    )
    console.print(grid)
    return "\n".join(f"{indent}{line}".rstrip() for line in out.getvalue().splitlines())


def cell_text(value: object) -> str:
    """Return a value as the text of a cell."""
    return terminal.printable(value_text(value))
