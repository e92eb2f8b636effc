"""What stands under the cursor: a piece of an expression, or a key or a single value of the scenario."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple

from deepbots_cli.compiler.namespace import RobotScope
from deepbots_cli.compiler.values import Reading, Text
from deepbots_cli.document.nodes import Path
from deepbots_cli.expressions import parser, syntax
from deepbots_cli.expressions.check import check
from deepbots_cli.expressions.functions import FUNCTIONS, Form
from deepbots_cli.expressions.types import Kind, Type, Typed, children
from deepbots_cli.lsp.desk import View

_KEY = re.compile(r"[^\s:,\[\]{}#\"']*")
_COLON = re.compile(r"[\"']?[ \t]*:")
_VALUE = re.compile(r"(?:[^\s,\[\]{}]|[ \t]+(?![#\s]))*")


class Piece(NamedTuple):
    """A node of the tree of an expression, `[start, end)` in its text; `kinds` where it names a part of the world.

    `cursor` is where in the text the cursor is.
    """

    reading: Reading
    cursor: int
    node: syntax.Node
    kinds: frozenset[Kind] | None = None

    @property
    def name(self) -> str | None:
        """The dotted name under the cursor, up to the word that it is on."""
        if not isinstance(self.node, syntax.Name):
            return None
        end = self.node.start
        text = self.reading.text.text
        for word in self.node.parts:
            end = text.index(word, end) + len(word)
            if self.cursor <= end:
                break
        return "".join(text[self.node.start : end].split())

    @property
    def robot(self) -> str | None:
        """The robot on board of which it is computed."""
        return self.reading.scope.robot if isinstance(self.reading.scope, RobotScope) else None

    @property
    def type(self) -> Type | None:
        """What is known of the value of the node."""
        for tree in self.reading.trees:
            for node in _below(tree):
                if (node.start, node.end) == (self.node.start, self.node.end):
                    return node.type
        if isinstance(self.node, (syntax.Range, syntax.Spread, syntax.Options)):
            return None
        typed = check(self.node, self.reading.scope, ignored)
        return typed.type if typed else None


class Pointed(NamedTuple):
    """A key, or a value, at a path of the scenario; `start` and `end` are offsets in the document as it is now."""

    path: Path
    text: str
    start: int
    end: int
    is_key: bool


def piece(view: View) -> Piece | None:
    """The innermost node of the expression under the cursor."""
    if view.analysis is None or view.source is None or view.then is None:
        return None
    found = [(size, reading) for reading in view.analysis.readings if (size := _held(view, reading)) is not None]
    if not found:
        return None
    reading = min(found, key=lambda one: one[0])[1]
    index = _index(reading.text, view.then)
    text = reading.text.text
    tree = parser.parse(text, ignored)
    if tree is None or not tree.start <= index <= tree.end or "#" in text[text.rfind("\n", 0, index) + 1 : index]:  # a comment
        return None
    return _innermost(Piece(reading, index, tree))


def pointed(view: View) -> Pointed | None:
    """The key or the single value under the cursor."""
    place, text = view.place, view.document.plain
    if place.role == "aside":
        return None
    if place.role == "key":
        end = _end(_KEY, text, view.offset)
        again = view.placed(end)
        word = text[again.start : end]
        is_key = _COLON.match(text, end) is not None  # else it may be a value on a line of its own
        return Pointed((*again.path, word) if is_key else again.path, word, again.start, end, is_key)
    end = _end(_VALUE, text, view.offset)
    return Pointed(place.path, text[place.start : end].strip("\"'"), place.start, end, is_key=False)


def _end(pattern: re.Pattern[str], text: str, start: int) -> int:
    found = pattern.match(text, start)
    return found.end() if found else start


def _held(view: View, reading: Reading) -> int | None:
    """How long the text of the reading is, if the cursor is in it; a default stands nowhere."""
    text, then = reading.text, view.then
    first, last = text.part(0, 1), text.part(max(0, len(text.text) - 1), len(text.text))
    if first.source is not view.source or then is None or not first.start <= then <= last.end:
        return None
    is_default = first == last and first.end - first.start > 1
    return None if is_default else last.end - first.start


def _index(text: Text, offset: int) -> int:
    """Which character of the text stands at the offset of its file."""
    return next((index for index in range(len(text.text)) if text.part(index, index + 1).end > offset), len(text.text))


def _innermost(piece: Piece) -> Piece:
    """The smallest node that holds the cursor; at the end of a name it is still that name."""
    node, index = piece.node, piece.cursor
    if isinstance(node, syntax.Call) and index <= node.name_end:
        return piece
    for child, kinds in _inside(node):
        if child.start <= index <= child.end and not (child.start == index and isinstance(child, syntax.Binary)):
            return _innermost(piece._replace(node=child, kinds=kinds))
    return piece


def _inside(node: syntax.Node) -> Iterator[tuple[syntax.Node, frozenset[Kind] | None]]:
    """The nodes below; of arguments that name a part of the world, which kinds it may be of."""
    function = FUNCTIONS.get(node.function) if isinstance(node, syntax.Call) else None
    for index, child in enumerate(syntax.children(node)):
        param = function.params[min(index, len(function.params) - 1)] if function and function.params else None
        yield child, param.kinds if param is not None and param.form is Form.SUBJECT else None


def _below(tree: Typed) -> Iterator[Typed]:
    yield tree
    for child in children(tree):
        yield from _below(child)


def ignored(*_finding: object, **_more: object) -> None:
    """Findings are told elsewhere."""
