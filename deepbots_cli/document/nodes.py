"""Nodes: YAML values that know their place.

Later passes read a tree of nodes. Merging (`extends`, `include`, `--set`) builds new trees around old nodes, so each
value keeps the place where it was written.
"""

from __future__ import annotations

import dataclasses
import re
from collections import abc
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Literal, NamedTuple

from deepbots_cli.diagnostics import Span

Path = tuple[str | int, ...]
Style = Literal["plain", "single", "double", "literal", "folded"]
Value = None | bool | int | float | str

_SEPARATING = re.compile(r"""[][{},'"#]|:\s|^\s|\s$|^$""")
_COMMENT = re.compile(r"(?:^|(?<=\s))#.*$", re.MULTILINE)
_MAX_DOTTED = 1000
"""Characters of a dotted path, which is matched against keys piece by piece."""


class Scalar(NamedTuple):
    """A single value: its text after unquoting and folding, and its value in YAML 1.2.

    `offsets[i]` is the offset in the source of character `i` of `text`, with one more for the end. It is None where the
    text stands in the source unchanged from `span.start` on.
    """

    span: Span
    text: str
    value: Value
    style: Style = "plain"
    offsets: abc.Sequence[int] | None = None

    def part(self, start: int, end: int) -> Span:
        """The span of `text[start:end]` in the source."""
        if self.offsets is None:
            return Span(self.span.source, self.span.start + start, self.span.start + end)
        last = len(self.offsets) - 1
        first = self.offsets[min(start, last)]
        if end <= start:
            return Span(self.span.source, first, first)
        return Span(self.span.source, first, max(first, self.offsets[min(end, last + 1) - 1] + 1))


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

    `partial` marks a mapping that lost a key to a finding, so a missing key may be a consequence. `keys_without_value` are the keys
    without a value.
    """

    span: Span
    entries: dict[str, Entry]
    partial: bool = False
    keys_without_value: tuple[Scalar, ...] = ()

    def get(self, key: str) -> Node | None:
        entry = self.entries.get(key)
        return entry.value if entry else None


Node = Scalar | Sequence | Mapping


# Reading trees


def walk(node: Node, path: Path = ()) -> Iterator[tuple[Path, Node]]:
    """`node` and every node below it, with its path, in file order."""
    yield path, node
    match node:
        case Sequence():
            for index, item in enumerate(node.items):
                yield from walk(item, (*path, index))
        case Mapping():
            for name, entry in node.entries.items():
                yield from walk(entry.value, (*path, name))


def to_data(node: Node) -> object:
    """The tree as plain Python values."""
    match node:
        case Scalar():
            return node.value
        case Sequence():
            return [to_data(item) for item in node.items]
        case Mapping():
            return {key: to_data(entry.value) for key, entry in node.entries.items()}


def one_line(node: Node) -> str:
    """The value on one line: as it is written, with collections in flow style and without comments."""
    match node:
        case Scalar():
            # An expression of several lines may hold comments, which would hide the lines joined behind them.
            return " ".join((_COMMENT.sub("", node.text) if "\n" in node.text else node.text).split())
        case Sequence():
            return f"[{', '.join(map(_item_on_line, node.items))}]"
        case Mapping():
            return f"{{{', '.join(f'{key}: {_item_on_line(entry.value)}' for key, entry in node.entries.items())}}}"


def _item_on_line(node: Node) -> str:
    """An item of a collection; a quoted text keeps its quotes if it holds separators."""
    quoted = isinstance(node, Scalar) and node.style in ("single", "double") and _SEPARATING.search(node.text)
    return " ".join(node.span.text.split()) if quoted else one_line(node)


def count_and_depth(node: Node) -> tuple[int, int]:
    """The number of values in a tree, itself included, and its depth in containers."""
    match node:
        case Scalar():
            return 1, 0
        case Sequence():
            below = [count_and_depth(item) for item in node.items]
        case Mapping():
            below = [count_and_depth(entry.value) for entry in node.entries.values()]
    return 1 + sum(size for size, _ in below), 1 + max((height for _, height in below), default=0)


def enclosing_entry(node: Node, name: str, start: int, end: int) -> Span | None:
    """The narrowest entry or list item that holds the piece `[start, end)` of the file `name`; None if there is none."""
    match node:
        case Mapping():
            parts = [(entry.key.span, entry.value) for entry in node.entries.values()]
        case Sequence():
            parts = [(item.span, item) for item in node.items]
        case Scalar():
            return None
    for first, value in parts:
        found = enclosing_entry(value, name, start, end)
        if found:
            return found
        last = value.span if value.span.source is first.source else first  # an included value lies in another file
        if first.source.name == name and first.start <= start and end <= max(first.end, last.end):
            return Span(first.source, first.start, max(first.end, last.end))
    return None


# Paths


def descend(node: Node, path: Path) -> tuple[Node, Scalar | None, int]:
    """Follow `path` as far as it goes: the last node reached, its key if any, and the number of steps taken."""
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


def follow_dotted(node: Node, dotted: str) -> tuple[Path, Node, str]:
    """Follow a dotted path as far as it goes: the steps taken, the node reached, and the rest of the path.

    Keys may hold dots (`observation.cart.pole_angle`): the longest key that fits is taken.
    """
    steps: Path = ()
    rest = dotted
    while rest and len(dotted) <= _MAX_DOTTED:
        for end in [len(rest), *(i for i in range(len(rest) - 1, 0, -1) if rest[i] == ".")]:
            piece = rest[:end]
            if isinstance(node, Mapping) and piece in node.entries:
                steps, node, rest = (*steps, piece), node.entries[piece].value, rest[end + 1 :]
                break
            if isinstance(node, Sequence) and piece.isascii() and piece.isdigit() and len(piece) < 6 and int(piece) < len(node.items):
                steps, node, rest = (*steps, int(piece)), node.items[int(piece)], rest[end + 1 :]
                break
        else:
            break
    return steps, node, rest


# Changed trees


def replace(node: Node, path: Path, entry: Entry) -> Node:
    """The tree with the value of `entry` at `path`; a new key is added."""
    step, rest = path[0], path[1:]
    match node:
        case Mapping() if isinstance(step, str):
            old = node.entries.get(step)
            if old is not None:
                entry = Entry(old.key, replace(old.value, rest, entry) if rest else entry.value)
            return dataclasses.replace(node, entries={**node.entries, step: entry})
        case Sequence() if isinstance(step, int):
            value = replace(node.items[step], rest, entry) if rest else entry.value
            return Sequence(node.span, (*node.items[:step], value, *node.items[step + 1 :]))
        case _:
            return node


def without(node: Node, paths: Iterable[Path]) -> Node:
    """The tree without the values at `paths`, in one walk."""
    below: dict[str | int, list[Path]] = {}
    for path in paths:
        below.setdefault(path[0], []).append(path[1:])
    removed = {step for step, rests in below.items() if () in rests}
    match node:
        case Mapping():
            kept = {key: entry for key, entry in node.entries.items() if key not in removed}
            entries = {key: Entry(entry.key, without(entry.value, below[key])) if key in below else entry for key, entry in kept.items()}
            return dataclasses.replace(node, entries=entries)
        case Sequence():
            items = [(index, item) for index, item in enumerate(node.items) if index not in removed]
            return Sequence(node.span, tuple(without(item, below[index]) if index in below else item for index, item in items))
        case Scalar():
            return node
