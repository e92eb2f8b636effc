"""Pieces of the text of generated code: blocks, tuples, quotes, comments and templates."""

from __future__ import annotations

import json
import re
import textwrap
from collections.abc import Iterable, Sequence

from deepbots_cli.codegen.lines import WIDTH

_DEPTH = 8
"""The indent of a statement in a method."""


def indent(lines: Iterable[str], depth: int = 1) -> list[str]:
    return [f"{'    ' * depth}{line}" if line else "" for line in lines]


def block(head: str, body: Sequence[str]) -> list[str]:
    """Return a function or class with its body, and an empty line after it."""
    return [head, *indent(body), ""]


def tuple_code(items: Sequence[str]) -> str:
    return f"({', '.join(items)}{',' if len(items) == 1 else ''})"


def targets_code(names: Sequence[str]) -> str:
    """Return the left side of an assignment that takes a sequence apart."""
    return ", ".join(names) if len(names) > 1 else tuple_code(names)


def quoted(text: str) -> str:
    """Return a string literal in double quotes and ASCII.

    The escapes of JSON are a subset of Python's, except for characters beyond 16 bits: JSON writes two
    halves, which Python does not join.
    """
    return json.dumps(text, ensure_ascii=False).encode("ascii", "backslashreplace").decode()


def docstring(text: str) -> list[str]:
    """Return a string in triple quotes, over as many lines as it needs; quotes and backslashes are
    escaped, so that the text cannot end it."""
    lines = textwrap.wrap(quoted(text)[1:-1], 100, break_long_words=False, break_on_hyphens=False) or [""]
    return [f'"""{lines[0]}"""'] if len(lines) == 1 else [f'"""{lines[0]}', *lines[1:], '"""']


def quoted_tuple(names: Sequence[str]) -> str:
    return tuple_code([quoted(name) for name in names])


def fill_template(template: str, **gaps: str | Sequence[str]) -> list[str]:
    """Return the lines of a template; `{name}` alone on a line is replaced by lines, which take its indent,
    and vanishes for none."""
    lines: list[str] = []
    for line in template.strip("\n").split("\n"):
        alone = re.fullmatch(r"( *)\{(\w+)\}", line)
        filling = gaps[alone[2]] if alone else None
        if alone and filling is not None and not isinstance(filling, str):
            lines += [f"{alone[1]}{inner}" if inner else "" for inner in filling]
        else:
            lines.append(line.format(**gaps))
    return lines


def comment(text: str) -> str:
    """Return a text of the scenario as a comment: on one line, in ASCII."""
    return "# " + " ".join(text.split()).encode("ascii", "backslashreplace").decode()


def with_comment(line: str, text: str) -> list[str]:
    """Return a statement of a method with a text of the scenario beside it, or above it where it is long."""
    note = comment(text)
    if not note[2:] or not note.isprintable() or line.partition(" = ")[2] == note[2:]:
        return [line]
    if _DEPTH + len(line) + 2 + len(note) <= WIDTH:
        return [f"{line}  {note}"]
    return [note, line] if _DEPTH + len(note) <= WIDTH else [line]


def constants_tuple_code(items: Sequence[str]) -> str:
    """Return a tuple of constants; runs of equal ones are written as a product where that is shorter."""
    runs: list[list[str]] = []
    for item in items:
        if runs and runs[-1][0] == item:
            runs[-1].append(item)
        else:
            runs.append([item])
    plain = tuple_code(items)
    short = " + ".join(f"({run[0]},) * {len(run)}" if len(run) > 1 else f"({run[0]},)" for run in runs)
    return short if len(items) > 3 and len(short) < len(plain) else plain
