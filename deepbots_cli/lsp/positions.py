"""Offsets in a text, and the positions by which the protocol speaks of it.

The protocol counts lines and columns from 0, and columns in units of UTF-16 unless client and server agree on another
encoding; a finding counts code points. Lines end as the protocol says: in `\\n`, `\\r\\n` or `\\r`.
"""

from __future__ import annotations

import re
from bisect import bisect_right
from typing import Literal

from lsprotocol import types

Encoding = Literal["utf-8", "utf-16", "utf-32"]

_LINE_END = re.compile(r"\r\n|\n|\r")
_BOM = "\ufeff"


class Lines:
    """The lines of a text. A byte order mark takes a column, but offsets count from behind it, as in a `Source`."""

    def __init__(self, text: str, encoding: Encoding = "utf-16") -> None:
        self._text = text
        self._encoding = encoding
        self._mark = len(_BOM) if text.startswith(_BOM) else 0
        ends = list(_LINE_END.finditer(text))
        self._starts = [0, *(end.end() for end in ends)]
        self._ends = [*(end.start() for end in ends), len(text)]

    def position(self, offset: int) -> types.Position:
        """Where the character at `offset` stands; beyond the end, where the text ends."""
        index = min(max(0, offset) + self._mark, len(self._text))
        line = bisect_right(self._starts, index) - 1
        return types.Position(line, self._width(self._text[self._starts[line] : index]))

    def range(self, start: int, end: int) -> types.Range:
        return types.Range(self.position(start), self.position(end))

    def offset(self, position: types.Position) -> int:
        """The offset of a position. Beyond a line or the text it is where that ends, inside of a character where that begins."""
        if position.line >= len(self._starts):
            return len(self._text) - self._mark
        line = max(0, position.line)
        start, end = self._starts[line], self._ends[line]
        return max(0, start + self._count(self._text[start:end], max(0, position.character)) - self._mark)

    def _width(self, piece: str) -> int:
        """How many units the piece takes."""
        if self._encoding == "utf-32" or piece.isascii():
            return len(piece)
        return sum(map(self._units, piece))

    def _count(self, line: str, units: int) -> int:
        """How many whole characters of the line fit into so many units."""
        if self._encoding == "utf-32" or line.isascii():
            return min(units, len(line))
        taken = 0
        for index, character in enumerate(line):
            taken += self._units(character)
            if taken > units:
                return index
        return len(line)

    def _units(self, character: str) -> int:
        point = ord(character)
        if self._encoding == "utf-16":
            return 1 + (point > 0xFFFF)
        return 1 + (point > 0x7F) + (point > 0x7FF) + (point > 0xFFFF)
