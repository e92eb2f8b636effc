"""Nodes: YAML values that know their place.

A tree of nodes is what every later pass reads. Merging (`extends`, `include`, `--set`) builds new
trees out of old nodes, so each value keeps the place where it was written.
"""

from __future__ import annotations

import re
from collections import abc
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal, NamedTuple

from deepbots_cli.diagnostics import Span

_SEPARATING = re.compile(r"""[][{},'"#]|:\s|^\s|\s$|^$""")
_COMMENT = re.compile(r"(?:^|(?<=\s))#.*$", re.MULTILINE)

Path = tuple[str | int, ...]
Style = Literal["plain", "single", "double", "literal", "folded"]
Value = None | bool | int | float | str


class Scalar(NamedTuple):
    """A single value: its text after unquoting and folding, and what YAML 1.2 makes of it.

    `offsets()[i]` is the offset in the source of character `i` of `text` (with one more for the end),
    so that a piece of an expression has a place; `offsets` is None when the text stands in the source unchanged
    from `span.start` on. They are worked out when they are first asked for, since only findings do.
    """

    span: Span
    text: str
    value: Value
    style: Style = "plain"
    offsets: Callable[[], abc.Sequence[int]] | None = None

    def part(self, start: int, end: int) -> Span:
        """The span of `text[start:end]` in the source."""
        if self.offsets is None:
            return Span(self.span.source, self.span.start + start, self.span.start + end)
        offsets = self.offsets()
        first = offsets[min(start, len(offsets) - 1)]
        if end <= start:
            return Span(self.span.source, first, first)
        return Span(self.span.source, first, max(first, offsets[min(end, len(offsets)) - 1] + 1))


@dataclass(frozen=True)
class Sequence:
    """A list of nodes."""

    span: Span
    items: tuple[Node, ...]


class Entry(NamedTuple):
    """One key with its value."""

    key: Scalar
    value: Node


@dataclass(frozen=True)
class Mapping:
    """Keys in file order, each with its value.

    `partial` says that a key was left out because of a finding: that another one is missing here may
    be a consequence, and is not worth a second finding. `hollow` are the keys that stand there without a value.
    """

    span: Span
    entries: dict[str, Entry]
    partial: bool = False
    hollow: tuple[Scalar, ...] = ()

    def get(self, key: str) -> Node | None:
        entry = self.entries.get(key)
        return entry.value if entry else None


Node = Scalar | Sequence | Mapping


def descend(node: Node, path: Path) -> tuple[Node, Scalar | None, int]:
    """Follow `path` as far as it goes: the last node reached, its key if any, and the steps taken."""
    key: Scalar | None = None
    for depth, step in enumerate(path):
        match node:
            case Mapping() if isinstance(step, str) and step in node.entries:
                key, node = node.entries[step].key, node.entries[step].value
            case Sequence() if isinstance(step, int) and 0 <= step < len(node.items):
                key, node = None, node.items[step]
            case _:
                return node, key, depth
    return node, key, len(path)


def to_data(node: Node) -> object:
    """The tree as plain Python values, as the schema reads it."""
    match node:
        case Scalar():
            return node.value
        case Sequence():
            return [to_data(item) for item in node.items]
        case Mapping():
            return {key: to_data(entry.value) for key, entry in node.entries.items()}


def one_line(node: Node) -> str:
    """The value on one line: as it is written, but collections in flow style and without comments."""
    match node:
        case Scalar():
            # An expression of several lines may hold comments, which on one line would hide what follows.
            return " ".join((_COMMENT.sub("", node.text) if "\n" in node.text else node.text).split())
        case Sequence():
            return f"[{', '.join(map(_inside, node.items))}]"
        case Mapping():
            return f"{{{', '.join(f'{key}: {_inside(entry.value)}' for key, entry in node.entries.items())}}}"


def _inside(node: Node) -> str:
    """An item of a collection; a quoted text keeps its quotes where it holds what separates items."""
    quoted = isinstance(node, Scalar) and node.style in ("single", "double") and _SEPARATING.search(node.text)
    return " ".join(node.span.text.split()) if quoted else one_line(node)


def walk(node: Node, path: Path = ()) -> Iterator[tuple[Path, Node]]:
    """Every node below and including `node`, with its path, in file order."""
    yield path, node
    match node:
        case Sequence():
            for index, item in enumerate(node.items):
                yield from walk(item, (*path, index))
        case Mapping():
            for name, entry in node.entries.items():
                yield from walk(entry.value, (*path, name))


def around(node: Node, name: str, start: int, end: int) -> Span | None:
    """The narrowest entry, or item of a list, that holds this piece of the file `name`; None if none does."""
    match node:
        case Mapping():
            parts = [(entry.key.span, entry.value) for entry in node.entries.values()]
        case Sequence():
            parts = [(item.span, item) for item in node.items]
        case Scalar():
            return None
    for first, value in parts:
        found = around(value, name, start, end)
        if found:
            return found
        last = value.span if value.span.source is first.source else first  # a file of its own stands behind `include`
        if first.source.name == name and first.start <= start and end <= max(first.end, last.end):
            return Span(first.source, first.start, max(first.end, last.end))
    return None
