"""Small pieces of layout for generated code."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Iterable, Sequence

from deepbots_cli.program.task import ActionRange, Choices
from deepbots_cli.program.values import Expression, NamedScalars


def indent(lines: Iterable[str], depth: int = 1) -> list[str]:
    return [f"{'    ' * depth}{line}" if line else "" for line in lines]


def block(head: str, body: Sequence[str]) -> list[str]:
    """A function or class with its body, and an empty line after it."""
    return [head, *indent(body), ""]


def tuple_code(items: Sequence[str]) -> str:
    return f"({', '.join(items)}{',' if len(items) == 1 else ''})"


def targets_code(names: Sequence[str]) -> str:
    """The left side of an assignment that takes a sequence apart."""
    return ", ".join(names) if len(names) > 1 else tuple_code(names)


def quoted(text: str) -> str:
    """A string literal in double quotes and ASCII.

    The escapes of JSON are a subset of Python's, but for what lies beyond 16 bits: there JSON writes two halves, which Python
    does not join.
    """
    return json.dumps(text, ensure_ascii=False).encode("ascii", "backslashreplace").decode()


def docstring(text: str) -> list[str]:
    """A string in triple quotes, over as many lines as it needs; the escapes leave no quote and no backslash of its own."""
    lines = textwrap.wrap(quoted(text)[1:-1], 100, break_long_words=False, break_on_hyphens=False) or [""]
    return [f'"""{lines[0]}"""'] if len(lines) == 1 else [f'"""{lines[0]}', *lines[1:], '"""']


def quoted_tuple(names: Sequence[str]) -> str:
    return tuple_code([quoted(name) for name in names])


def sentence_list(words: Sequence[str], last: str = "and") -> str:
    """`a`, `a and b`, `a, b and c`."""
    return f" {last} ".join(filter(None, [", ".join(words[:-1]), *words[-1:]]))


def flat(values: Iterable[NamedScalars | Expression]) -> list[tuple[str, str | None]]:
    """Name and component of every single number, in order."""
    return [(entry.name, component) for entry in values for component in (entry.components or (None,))]


def action_variables(part: Choices | ActionRange) -> list[tuple[str, str | None]]:
    """Name and component of every number that a part of the action sets."""
    if isinstance(part, Choices):
        return [(variable, None) for variable in part.variables]
    return [(part.name, component) for component in (part.components or (None,))]
