"""Values in brackets, as far as they are written; the part of `cursor.py` that reads across lines."""

from __future__ import annotations

import re
from typing import Any, Literal

from deepbots_cli.document.nodes import Path
from deepbots_cli.document.parse import MAX_DEPTH

Role = Literal["key", "value", "aside"]

QUOTED = re.compile(r""""(?:[^"\\]|\\.)*+"|'(?:[^']|'')*+'""", re.DOTALL)
_PIECE = re.compile(
    r"""(?P<space>[\s]+)|(?P<comment>(?<=\s)\#[^\n]*)|(?P<sign>[\[\]{},]|:(?=[\s,\[\]{}]|$))|(?P<open>["'])|(?P<plain>.)""", re.DOTALL
)
_PLAIN = re.compile(r"(?:[^\s,\[\]{}:]|:(?![\s,\[\]{}]|$)|[ \t]+(?![\s#]|$|:(?:[\s,\[\]{}]|$)))+")


class TooDeepError(Exception):
    """Values are nested deeper than a scenario can be."""


class Brackets:
    """Reads what stands in brackets, from the opening one, into the value of `key` in `holder`, which has this path.

    `slot` is where the next value belongs: a container, the key or index in it, None where a key is due, and its path. At the
    end of the text `role`, `path` and `start` say what is being written there.
    """

    def __init__(self, text: str, start: int, holder: Any, key: Any, path: Path) -> None:
        self.text = text
        self.at = start
        self.open: list[tuple[Any, Any, Path]] = []
        self.slot = (holder, key, path)
        self.role: Role = "key"
        self.path = path
        self.start = start
        self.begin = -1  # where the piece that is being read begins; what of it was read is `word`
        self.word = ""

    def read(self) -> int | None:
        """The offset behind the closing bracket; None where the text ends before it."""
        while self.at < len(self.text):
            found = _PIECE.match(self.text, self.at)
            assert found is not None  # its last branch takes any character
            self.at = found.end()
            kind = found.lastgroup
            if kind == "comment" and self.at == len(self.text):
                self.role, self.path, self.start = "aside", self.slot[2], found.start()
                return None
            if kind == "open":
                if not self._quoted(found.start()):
                    return None
            elif kind == "plain":
                self._plain(found.start())
            elif kind == "sign" and self._sign(found.group()):
                return self.at
        self._unfinished()
        return None

    def _sign(self, sign: str) -> bool:
        """Take a bracket, comma or colon; whether it closes the whole."""
        holder, key, path = self.slot
        if sign in "{[":
            node: Any = {} if sign == "{" else [""]
            if len(path) > MAX_DEPTH:
                raise TooDeepError
            holder["" if key is None else key] = node
            self.open.append(self.slot)
            self.slot = (node, None if sign == "{" else 0, path if sign == "{" else (*path, 0))
        elif sign in "}]":
            self.slot = self.open.pop()
            if not self.open:
                return True
        elif sign == ",":
            self._next(holder, key, path)
        elif isinstance(holder, dict) and key is None:
            word = self.word
            holder[word] = ""
            self.slot = (holder, word, (*path, word))
        self.begin, self.word = -1, ""
        return False

    def _next(self, holder: Any, key: Any, path: Path) -> None:
        if isinstance(holder, list):
            holder.append("")
            self.slot = (holder, len(holder) - 1, (*path[:-1], len(holder) - 1))
        else:
            self.slot = (holder, None, path if key is None else path[:-1])

    def _plain(self, start: int) -> None:
        found = _PLAIN.match(self.text, start)
        end = found.end() if found else start + 1
        self._take(start, end, self.text[start:end])
        self.at = max(end, self.at)

    def _quoted(self, start: int) -> bool:
        found = QUOTED.match(self.text, start)
        if found is None:
            self.begin = start + 1
            self._unfinished()
            return False
        self._take(start, found.end(), found.group()[1:-1])
        self.at = found.end()
        return True

    def _take(self, start: int, end: int, word: str) -> None:
        holder, key, _ = self.slot
        self.begin = start if self.begin < 0 else self.begin
        self.word = self.text[self.begin : end] if self.begin < start else word
        if key is not None:
            holder[key] = self.word

    def _unfinished(self) -> None:
        """The text ends inside of the brackets."""
        holder, key, path = self.slot
        self.path = path
        self.role = "key" if isinstance(holder, dict) and key is None else "value"
        self.start = self.begin if self.begin >= 0 else len(self.text)
