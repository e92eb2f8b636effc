"""YAML values with their position in the file.

Later passes read a tree of nodes. Merging (`extends`, `include`, `--set`) builds new trees around old nodes,
so each value keeps its position in the file.
"""

from __future__ import annotations

import dataclasses
import re
from collections import abc
from collections.abc import Iterable, Iterator
from typing import Literal, NamedTuple

from deepbots_cli.diagnostics import Span
from deepbots_cli.records import dataclass

NodePath = tuple[str | int, ...]
Style = Literal["plain", "single", "double", "literal", "folded"]
Value = None | bool | int | float | str

_NEEDS_QUOTES = r"""[][{},'"#]|:\s|^\s|\s$|^$"""
_COMMENT = r"(?m)(?:^|(?<=\s))#.*$"
_MAX_DOTTED = 1000
"""The maximum number of characters of a dotted path, which is matched against keys piece by piece."""


class ScalarNode(NamedTuple):
    """A single value: its text after unquoting and folding, and its value in YAML 1.2.

    `offsets[i]` is the offset in the source of character `i` of `text`, with one more for the end. It is None
    if the text is in the source unchanged from `span.start` on.
    """

    span: Span
    text: str
    value: Value
    style: Style = "plain"
    offsets: abc.Sequence[int] | None = None

    def part(self, start: int, end: int) -> Span:
        """Return the span of `text[start:end]` in the source."""
        if self.offsets is None:
            return Span(self.span.source, self.span.start + start, self.span.start + end)
        last = len(self.offsets) - 1
        first = self.offsets[min(start, last)]
        if end <= start:
            return Span(self.span.source, first, first)
        return Span(self.span.source, first, max(first, self.offsets[min(end, last + 1) - 1] + 1))


@dataclass(frozen=True)
class SequenceNode:
    """A list of nodes."""

    span: Span
    items: tuple[Node, ...]


class Entry(NamedTuple):
    """One key with its value."""

    key: ScalarNode
    value: Node


@dataclass(frozen=True)
class MappingNode:
    """Keys in file order, each with its value.

    `partial` marks a mapping that lost a key to a finding, so a missing key may be a consequence.
    `keys_without_value` are the keys without a value.
    """

    span: Span
    entries: dict[str, Entry]
    partial: bool = False
    keys_without_value: tuple[ScalarNode, ...] = ()

    def get(self, key: str) -> Node | None:
        entry = self.entries.get(key)
        return entry.value if entry else None


Node = ScalarNode | SequenceNode | MappingNode


# Reading trees


def walk(node: Node, path: NodePath = ()) -> Iterator[tuple[NodePath, Node]]:
    """Yield `node` and every node below it, with its path, in file order."""
    yield path, node
    match node:
        case SequenceNode():
            for index, item in enumerate(node.items):
                yield from walk(item, (*path, index))
        case MappingNode():
            for name, entry in node.entries.items():
                yield from walk(entry.value, (*path, name))


def to_data(node: Node) -> object:
    """Return the tree as plain Python values."""
    match node:
        case ScalarNode():
            return node.value
        case SequenceNode():
            return [to_data(item) for item in node.items]
        case MappingNode():
            return {key: to_data(entry.value) for key, entry in node.entries.items()}


def inline_text(node: Node) -> str:
    """Return the value on one line: as it is written, with collections in flow style and without comments."""
    match node:
        case ScalarNode():
            # An expression of several lines may hold comments, which would hide the lines joined behind them.
            return " ".join((re.sub(_COMMENT, "", node.text) if "\n" in node.text else node.text).split())
        case SequenceNode():
            return f"[{', '.join(map(_item_on_line, node.items))}]"
        case MappingNode():
            entries = (f"{key}: {_item_on_line(entry.value)}" for key, entry in node.entries.items())
            return f"{{{', '.join(entries)}}}"


def _item_on_line(node: Node) -> str:
    """Return an item of a collection; a quoted text keeps its quotes if it contains separators."""
    quoted = (
        isinstance(node, ScalarNode)
        and node.style in ("single", "double")
        and re.search(_NEEDS_QUOTES, node.text)
    )
    return " ".join(node.span.text.split()) if quoted else inline_text(node)


def count_and_depth(node: Node) -> tuple[int, int]:
    """Return the number of values in a tree, itself included, and its depth in containers."""
    match node:
        case ScalarNode():
            return 1, 0
        case SequenceNode():
            below = [count_and_depth(item) for item in node.items]
        case MappingNode():
            below = [count_and_depth(entry.value) for entry in node.entries.values()]
    return 1 + sum(size for size, _ in below), 1 + max((height for _, height in below), default=0)


def enclosing_entry(node: Node, name: str, start: int, end: int) -> Span | None:
    """Return the narrowest entry or list item that contains the piece `[start, end)` of the file `name`; None
    if there is none."""
    match node:
        case MappingNode():
            parts = [(entry.key.span, entry.value) for entry in node.entries.values()]
        case SequenceNode():
            parts = [(item.span, item) for item in node.items]
        case ScalarNode():
            return None
    for first, value in parts:
        inner = enclosing_entry(value, name, start, end)
        if inner:
            return inner
        # An included value is in another file, so the entry ends with its key.
        last = value.span if value.span.source is first.source else first
        if first.source.name == name and first.start <= start and end <= max(first.end, last.end):
            return Span(first.source, first.start, max(first.end, last.end))
    return None


# Paths


def descend(node: Node, path: NodePath) -> tuple[Node, ScalarNode | None, int]:
    """Follow `path` as far as it goes: the last node reached, its key if any, and the number of steps
    taken."""
    key: ScalarNode | None = None
    for depth, step in enumerate(path):
        match node:
            case MappingNode() if isinstance(step, str) and step in node.entries:
                key, node = node.entries[step].key, node.entries[step].value
            case SequenceNode() if isinstance(step, int) and 0 <= step < len(node.items):
                key, node = None, node.items[step]
            case _:
                return node, key, depth
    return node, key, len(path)


def node_at(root: Node | None, *path: str | int) -> Node | None:
    """Return the node at `path`, if there is one."""
    node, _, reached = descend(root, path) if root else (None, None, 0)
    return node if reached == len(path) else None


def text_at(root: Node | None, *path: str | int) -> str:
    """Return the text that is written at `path`, on one line; empty if there is none."""
    node = node_at(root, *path)
    return "" if node is None else inline_text(node)


def entries_at(root: Node | None, *path: str | int) -> dict[str, Entry]:
    """Return the entries of the mapping at `path`; none where there is no mapping."""
    node = node_at(root, *path)
    return node.entries if isinstance(node, MappingNode) else {}


def follow_dotted(node: Node, dotted: str) -> tuple[NodePath, Node, str]:
    """Follow a dotted path as far as it goes: the steps taken, the node reached, and the rest of the path.

    Keys may contain dots (`observation.cart.pole_angle`): the longest key that fits is taken.
    """
    steps: NodePath = ()
    unresolved = dotted
    while unresolved and len(dotted) <= _MAX_DOTTED:
        for end in [len(unresolved), *(i for i in range(len(unresolved) - 1, 0, -1) if unresolved[i] == ".")]:
            piece = unresolved[:end]
            if isinstance(node, MappingNode) and piece in node.entries:
                steps, node, unresolved = (*steps, piece), node.entries[piece].value, unresolved[end + 1 :]
                break
            # int() of a long text takes quadratic time; no list has 100 000 items.
            if (
                isinstance(node, SequenceNode)
                # `isdigit` alone accepts `²`, which `int` refuses.
                and piece.isascii()
                and piece.isdigit()
                and len(piece) < 6
                and int(piece) < len(node.items)
            ):
                steps, node, unresolved = (*steps, int(piece)), node.items[int(piece)], unresolved[end + 1 :]
                break
        else:
            break
    return steps, node, unresolved


# Changed trees


def with_entry(node: Node, path: NodePath, entry: Entry) -> Node:
    """Return the tree with the value of `entry` at `path`; a new key is added."""
    step, inner_path = path[0], path[1:]
    match node:
        case MappingNode() if isinstance(step, str):
            old = node.entries.get(step)
            if old is not None:
                entry = Entry(
                    old.key, with_entry(old.value, inner_path, entry) if inner_path else entry.value
                )
            return dataclasses.replace(node, entries={**node.entries, step: entry})
        case SequenceNode() if isinstance(step, int):
            value = with_entry(node.items[step], inner_path, entry) if inner_path else entry.value
            return SequenceNode(node.span, (*node.items[:step], value, *node.items[step + 1 :]))
        case _:
            return node


def without_paths(node: Node, paths: Iterable[NodePath]) -> Node:
    """Return the tree without the values at `paths`, in one walk."""
    below: dict[str | int, list[NodePath]] = {}
    for path in paths:
        below.setdefault(path[0], []).append(path[1:])
    removed = {step for step, rests in below.items() if () in rests}
    match node:
        case MappingNode():
            remaining = {key: entry for key, entry in node.entries.items() if key not in removed}
            entries = {
                key: Entry(entry.key, without_paths(entry.value, below[key])) if key in below else entry
                for key, entry in remaining.items()
            }
            return dataclasses.replace(node, entries=entries)
        case SequenceNode():
            items = [(index, item) for index, item in enumerate(node.items) if index not in removed]
            return SequenceNode(
                node.span,
                tuple(without_paths(item, below[index]) if index in below else item for index, item in items),
            )
        case ScalarNode():
            return node
