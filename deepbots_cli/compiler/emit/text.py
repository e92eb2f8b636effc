"""Small pieces of layout for generated code."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence

from deepbots_cli.ir import NamedValues


def indent(lines: Iterable[str], depth: int = 1) -> list[str]:
    return [f"{'    ' * depth}{line}" if line else "" for line in lines]


def block(head: str, body: Sequence[str]) -> list[str]:
    """A function or class with its body, and an empty line after it."""
    return [head, *indent(body), ""]


def tuple_code(items: Sequence[str]) -> str:
    return f"({', '.join(items)}{',' if len(items) == 1 else ''})"


def quoted(text: str) -> str:
    """A string literal in double quotes; the escapes of JSON are a subset of Python's."""
    return json.dumps(text)


def quoted_tuple(names: Sequence[str]) -> str:
    return tuple_code([quoted(name) for name in names])


def sentence_list(words: Sequence[str]) -> str:
    """`a`, `a and b`, `a, b and c`."""
    return " and ".join(filter(None, [", ".join(words[:-1]), *words[-1:]]))


def flat(values: Iterable[NamedValues]) -> list[tuple[str, str | None]]:
    """Name and component of every single number, in order."""
    return [(entry.name, component) for entry in values for component in (entry.components or (None,))]
