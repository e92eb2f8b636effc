"""Where in a scenario a place of its text is, though the text is being written and may be no YAML at the moment.

Only the text before the place is read, by a reader that goes on whatever it meets: indentation and brackets tell the
path, and what stands behind a colon is taken as it is. For a text that is sound it agrees with the parser.
"""

from __future__ import annotations

import re
from typing import Any, NamedTuple

from deepbots_cli.document.files import MAX_BYTES
from deepbots_cli.document.nodes import Path
from deepbots_cli.document.parse import MAX_DEPTH
from deepbots_cli.lsp.brackets import QUOTED, Brackets, Role, TooDeepError

_COLON = re.compile(r":(?=[ \t\r]|$)")
_COMMENT = re.compile(r"(?:^|(?<=[ \t]))#")
_BLOCK = re.compile(r"[|>][-+0-9]*[ \t\r]*(?:#.*)?")
_DASH = re.compile(r"-(?=[ \t\r]|$)[ \t]*")
_ANCHOR = re.compile(r"[&!][^\s,\[\]{}]*[ \t]*")


class Place(NamedTuple):
    """What is being written at a place.

    A `key` belongs to the mapping at `path`, which may yet turn out to be a single value; a `value` stands at `path`. What
    is `aside` is a comment, or behind a value that is complete. The piece begins at the offset `start`, `text` is what of
    it stands before the place, and `data` is what the text before it says.
    """

    path: Path
    role: Role
    start: int
    text: str
    data: Any


def place(text: str, offset: int) -> Place:
    """What is being written at `offset`."""
    reader = _Reader(text[: min(offset, MAX_BYTES)])
    try:
        reader.read()
    except TooDeepError:
        return Place((), "aside", offset, "", {})
    return Place(tuple(reader.path), reader.role, reader.start, reader.text[reader.start :], reader.root[""] or {})


class _Level(NamedTuple):
    """An open block: its column, the mapping or list, and the path to it."""

    column: int
    node: Any
    path: Path


class _Reader:
    """Reads line after line. `slot` is where the next value belongs: a container, the key or index in it, and its path."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.root: dict[str, Any] = {"": ""}
        self.levels: list[_Level] = []
        self.slot: tuple[Any, Any, Path] = (self.root, "", ())
        self.path: Path = ()
        self.role: Role = "key"
        self.start = len(text)
        self.at = 0
        self.since = 0  # where the value that was begun last begins

    def read(self) -> None:
        while self.at <= len(self.text):
            end = self.text.find("\n", self.at)
            self._line(end if end >= 0 else len(self.text), last=end < 0)
            if end < 0:
                return

    # Blocks

    def _line(self, end: int, *, last: bool) -> None:
        """One line from its beginning, or more where a value goes on behind it."""
        begin = self.at
        line = self.text[begin:end]
        body = line.lstrip(" ")
        column = len(line) - len(body)
        self.at = end + 1
        comment = _COMMENT.search(line)
        if comment and not line[: comment.start()].strip():
            if last:
                self._end("aside", self.slot[2], begin + comment.start())
            return
        if not body.strip():
            if last:
                self._settle(column, dash=False)
                self._end("key", self._here(column), len(self.text))
            return
        self._content(begin + column, column, end, last)

    def _content(self, start: int, column: int, end: int, last: bool) -> None:
        dash = _DASH.match(self.text, start, end)
        self._settle(column, dash=dash is not None)
        if dash:
            self._item(column)
            inner = column + dash.end() - dash.start()
            if dash.end() < end and self.text[dash.end() : end].strip():
                self._content(dash.end(), inner, end, last)
            elif last:
                self._end("key", self.slot[2], len(self.text))
            return
        key_end, value = self._key(start, end)
        if key_end is None:
            self._loose(start, column, end, last)
            return
        self._open_mapping(column)
        level = self.levels[-1]
        word = self.text[start:key_end].strip()
        word = word[1:-1] if QUOTED.fullmatch(word) else word
        if isinstance(level.node, dict):
            level.node[word] = ""
        self.slot = (level.node, word, (*level.path, word))
        self._value(value, end, column)

    def _key(self, start: int, end: int) -> tuple[int | None, int]:
        """Where the key that begins at `start` ends, and its value begins."""
        if self.text[start] in "{[":
            return None, start
        quoted = QUOTED.match(self.text, start, end)
        line = self.text[start:end]
        comment = _COMMENT.search(line)
        for colon in _COLON.finditer(line, quoted.end() - start if quoted else 0):
            if comment and comment.start() < colon.start():
                break
            if quoted is None or not line[quoted.end() - start : colon.start()].strip():
                return start + colon.start(), start + colon.end()
        return None, start

    def _settle(self, column: int, *, dash: bool) -> None:
        """Close the blocks that a line in this column no longer belongs to."""
        while self.levels and (
            self.levels[-1].column > column or (self.levels[-1].column == column and isinstance(self.levels[-1].node, list) and not dash)
        ):
            self.levels.pop()

    def _here(self, column: int) -> Path:
        """The mapping to which a key in this column belongs."""
        if not self.levels:
            return ()
        level = self.levels[-1]
        holder, key, path = self.slot
        deeper = level.column < column and holder is level.node and holder[key] == ""
        return path if deeper else level.path

    def _item(self, column: int) -> None:
        if not (self.levels and isinstance(self.levels[-1].node, list) and self.levels[-1].column == column):
            self._open(column, [])
        level = self.levels[-1]
        level.node.append("")
        self.slot = (level.node, len(level.node) - 1, (*level.path, len(level.node) - 1))

    def _open_mapping(self, column: int) -> None:
        if not (self.levels and isinstance(self.levels[-1].node, dict) and self.levels[-1].column == column):
            self._open(column, {})

    def _open(self, column: int, node: Any) -> None:
        """Begin a block as the value that is due."""
        holder, key, path = self.slot
        if self.levels and holder is not self.levels[-1].node:  # the text is out of order: go on from the innermost block
            holder, key, path = self.root, "", ()
            self.levels.clear()
        if len(path) > MAX_DEPTH:
            raise TooDeepError
        holder[key] = node
        self.levels.append(_Level(column, node, path))

    def _loose(self, start: int, column: int, end: int, last: bool) -> None:
        """A line without a key: more of the value above, brackets, or a key that is not complete yet."""
        holder, key, path = self.slot
        is_quote = self.text[start] in "\"'"
        if (self.text[start] in "{[" or (is_quote and not last)) and holder[key] == "":
            self._value(start, end, column if self.levels else -1)
            return
        goes_on = holder[key] != "" and bool(self.levels) and holder is self.levels[-1].node and column > self.levels[-1].column
        if not last:
            holder[key] = holder[key] or self.text[start:end].strip()
            return
        comment = _COMMENT.search(self.text, start)
        if comment:
            self._end("aside", path, comment.start())
        elif goes_on and path:
            self._end("value", path, self.since)
        else:
            here = path if isinstance(holder, list) and holder[key] == "" else self._here(column)
            self._end("key", here, start + is_quote)

    # Values

    def _value(self, start: int, end: int, column: int) -> None:
        """The value of the slot, which begins at or after `start` on the line that ends at `end`."""
        holder, key, path = self.slot
        while start < end and self.text[start] in " \t":
            start += 1
        while (anchor := _ANCHOR.match(self.text, start, end)) and anchor.end() > start:
            start = anchor.end()
        self.since = start
        rest = self.text[start:end]
        is_last = end == len(self.text)
        comment = _COMMENT.search(self.text[start - 1 : end]) if start else None
        if comment and is_last and rest[:1] not in ("{", "[", '"', "'", "|", ">"):
            self._end("aside", path, start - 1 + comment.start())
        elif rest[:1] in ("{", "["):
            self._brackets(start, self._limit(end, column))
        elif rest[:1] in ('"', "'"):
            self._quote(start, self._limit(end, column))
        elif _BLOCK.fullmatch(rest) and not (is_last and rest.strip() in ("|", ">")):
            self._block(end, column)
        else:
            holder[key] = (rest[: comment.start() - 1] if comment and comment.start() else rest).strip()
            if is_last:
                self._end("value", path, start)

    def _limit(self, end: int, column: int) -> int:
        """Where a value of several lines ends at the latest: its lines are indented further than its key."""
        found = re.compile(rf"\n {{0,{column}}}[^\s}}\]]").search(self.text, end) if column >= 0 else None
        return found.start() if found else len(self.text)

    def _quote(self, start: int, limit: int) -> None:
        holder, key, path = self.slot
        quoted = QUOTED.match(self.text, start, limit)
        if quoted is None and limit < len(self.text):
            self.at = limit + 1
        elif quoted is None:
            self._end("value", path, start + 1)
            self.at = len(self.text) + 1
        else:
            holder[key] = quoted.group()[1:-1]
            self._behind(start, quoted.end(), path)

    def _behind(self, start: int, at: int, path: Path) -> None:
        """Leave the rest of the line behind a value that is complete."""
        end = self.text.find("\n", at)
        self.at = end + 1 if end >= 0 else len(self.text) + 1
        if end < 0:
            self._end("value" if at == len(self.text) else "aside", path, start if at == len(self.text) else at)

    def _block(self, end: int, column: int) -> None:
        """A block of text: all lines that are indented further than its key."""
        holder, key, path = self.slot
        self.since = start = min(end + 1, len(self.text))
        self.at = start
        while self.at <= len(self.text):
            stop = self.text.find("\n", self.at)
            line = self.text[self.at : stop if stop >= 0 else len(self.text)]
            if line.strip() and len(line) - len(line.lstrip(" ")) <= column:
                break
            if stop < 0:
                deep_enough = len(line) > column or line.strip()
                holder[key] = self.text[start:]
                if deep_enough:
                    self._end("value", path, start)
                    self.at = len(self.text) + 1
                return
            self.at = stop + 1
        holder[key] = self.text[start : self.at]

    # Brackets

    def _brackets(self, start: int, limit: int) -> None:
        """A value in brackets, to its end or to where it has to end."""
        flow = Brackets(self.text[:limit], start, *self.slot)
        closed = flow.read()
        if closed is None and limit < len(self.text):
            self.at = limit + 1
        elif closed is None:
            self._end(flow.role, flow.path, flow.start)
            self.at = len(self.text) + 1
        else:
            self._behind(start, closed, self.slot[2])

    def _end(self, role: Role, path: Path, start: int) -> None:
        self.role, self.path, self.start = role, path, min(start, len(self.text))
