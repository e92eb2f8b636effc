"""The canonical layout of a scenario: white space between tokens, and nothing else.

Two passes. `_spaced` sets the blanks within lines, `_indented` the indentation; what is inside a scalar moves with its line and
stays as it is. Columns that were aligned on purpose stay aligned: two blanks or more are kept where the token behind them
stands below or above the beginning of another one. So are the places of comments.
"""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass

from deepbots_cli.diagnostics import Findings, Source
from deepbots_cli.document.nodes import to_data
from deepbots_cli.document.parse import parse
from deepbots_cli.document.parsers import Token, tokens

_PASSES = 6
_OPENING, _CLOSING = frozenset("{["), frozenset("}]")
_COMMENT = re.compile(r"#[^\n]*")
_BLANK_LINES = re.compile(r"\n\n\n+")


def tidy(text: str) -> str | None:
    """`text`, which is read without findings, in the canonical layout; None if it cannot be had without changing what it says.

    The end of the first line counts for all lines.
    """
    plain = text.replace("\r\n", "\n")
    done = plain
    for _ in range(_PASSES):
        before, done = done, _indented(_spaced(done))
        if done == before:
            break
    else:
        return None
    if _meaning(done) != _meaning(plain) or _comments(done) != _comments(plain):
        return None
    first = text.find("\n")
    return done.replace("\n", "\r\n") if first > 0 and text[first - 1] == "\r" else done


def _meaning(text: str) -> object:
    root = parse(Source("", text), Findings())
    return root and to_data(root)


def _comments(text: str) -> list[str]:
    return [comment.rstrip() for gap, _, _ in _gaps(text) for comment in _COMMENT.findall(gap)]


def _visible(text: str) -> list[Token]:
    """The tokens that take room, without the white space at their ends."""
    return [
        token._replace(end=token.start + len(text[token.start : token.end].rstrip())) for token in tokens(text) if token.end > token.start
    ]


def _gaps(text: str) -> Iterator[tuple[str, Token | None, Token | None]]:
    """What stands between tokens, with the tokens before and behind."""
    before: Token | None = None
    for token in _visible(text):
        yield text[before.end if before else 0 : token.start], before, token
        before = token
    yield text[before.end if before else 0 :], before, None


# Blanks within lines


def _spaced(text: str) -> str:
    columns = _Columns(text)
    done: list[str] = []
    moved = 0  # how far the rest of the line has moved to the right
    for gap, before, behind in _gaps(text):
        if before is not None:
            token = text[before.start : before.end]
            done.append(token)
            moved = 0 if "\n" in token else moved
        if "\n" in gap or behind is None or before is None:
            done.append(_between_lines(gap, moved, first=before is None, last=behind is None))
            moved = 0
        else:
            wanted = _blanks(gap, before, behind, columns)
            moved += len(wanted) - len(gap)
            done.append(wanted)
    return "".join(done)


def _blanks(gap: str, before: Token, behind: Token, columns: _Columns) -> str:
    """The blanks between two tokens of a line."""
    if before.kind in _OPENING or behind.kind in _CLOSING or behind.kind in (",", ":"):
        return ""
    if before.kind == "-":
        return gap  # the lines below may be aligned with what stands behind it
    return gap if len(gap) > 1 and columns.aligned(behind.start) else " "


def _between_lines(gap: str, moved: int, *, first: bool, last: bool) -> str:
    """What stands between two tokens of different lines: a comment behind the first, blank lines, comments, the indentation."""
    lines = gap.replace("\t", " ").split("\n")
    head, inner, indentation = lines[0], [line.rstrip() for line in lines[1:-1]], lines[-1]
    if head.strip() and not first:
        blanks = len(head) - len(head.lstrip())
        head = " " * max(blanks - moved, min(blanks, 2)) + head.lstrip()
    joined = "\n".join([head.rstrip(), *inner, "" if last else indentation])
    joined = _BLANK_LINES.sub("\n\n", joined)
    if first:
        joined = joined.lstrip("\n")
    return f"{(joined + indentation if indentation.strip() and last else joined).rstrip()}\n" if last else joined


class _Columns:
    """In which columns the tokens of each line begin."""

    def __init__(self, text: str) -> None:
        self._starts = [0, *(match.end() for match in re.finditer("\n", text))]
        self._columns: dict[int, set[int]] = {}
        for token in _visible(text):
            if token.kind not in (",", ":"):
                line, column = self._place(token.start)
                self._columns.setdefault(line, set()).add(column)
        lines = sorted(self._columns)
        self._neighbours = {line: {*lines[max(0, i - 1) : i], *lines[i + 1 : i + 2]} for i, line in enumerate(lines)}

    def _place(self, offset: int) -> tuple[int, int]:
        line = bisect_right(self._starts, offset) - 1
        return line, offset - self._starts[line]

    def aligned(self, offset: int) -> bool:
        """Whether the token there stands right above or below the beginning of another one."""
        line, column = self._place(offset)
        return any(column in self._columns[other] for other in self._neighbours[line])


# Indentation


@dataclass
class _Line:
    """Where a line that begins an entry begins, and where it shall."""

    old: int
    new: int


def _indented(text: str) -> str:
    structure, inside, dashes = _structure(text)
    beginnings = sorted(structure)
    lines = text.split("\n")
    done: list[str] = []
    shift = 0
    for number, line in enumerate(lines):
        if number in structure:
            shift = structure[number].new - structure[number].old
        own = shift
        if number not in structure and number not in inside and line.strip():  # a comment belongs to what it stands above
            index = bisect_right(beginnings, number)
            following = structure[beginnings[index]] if index < len(beginnings) else None
            own = following.new - following.old if following else shift
        done.append(_shifted(line, own, dashes.get(number, ())))
    return "\n".join(done)


def _shifted(line: str, shift: int, dashes: tuple[int, ...]) -> str:
    for dash in reversed(dashes):  # `-   a: 1` becomes `- a: 1`
        line = f"{line[: dash + 1]} {line[dash + 1 :].lstrip(' ')}"
    if not line.strip(" "):
        return line if shift >= 0 else line[-shift:]
    blanks = len(line) - len(line.lstrip(" "))
    return " " * max(0, blanks + shift) + line.lstrip(" ")


def _structure(text: str) -> tuple[dict[int, _Line], set[int], dict[int, tuple[int, ...]]]:
    """By number: the lines that begin an entry of a block, those inside a value, and the dashes of a line with something behind them."""
    starts = [0, *(match.end() for match in re.finditer("\n", text))]
    structure: dict[int, _Line] = {}
    inside: set[int] = set()
    dashes: dict[int, tuple[int, ...]] = {}
    levels: list[str] = []
    line, flow, is_key, opened, known = 0, 0, False, 0, 0
    for token in tokens(text):
        while line + 1 < len(starts) and starts[line + 1] <= token.start:
            line += 1
        if flow == 0:
            _nest(levels, token.kind)
            begins = token.kind == "-" or (is_key and token.end > token.start)
            if begins and line not in structure and not text[starts[line] : token.start].strip():
                structure[line] = _Line(token.start - starts[line], 2 * (len(levels) - 1))
            if token.kind == "-" and text[token.end : token.end + 2].strip(" ") == "" and "\n" not in text[token.end : token.end + 2]:
                dashes[line] = (*dashes.get(line, ()), token.start - starts[line])
            opened = line
        is_key = token.kind == "?" or (is_key and token.end == token.start)
        flow += (token.kind in _OPENING) - (token.kind in _CLOSING)
        last = line + text.count("\n", token.start, token.start + len(text[token.start : token.end].rstrip()))
        if flow:
            inside.update(range(max(opened + 1, known), last + 1))
        else:
            inside.update(range((line if token.kind in _CLOSING else line + 1), last + 1))
        known = last + 1  # of the lines above, all is known that lie within brackets
    return structure, inside, dashes


def _nest(levels: list[str], kind: str) -> None:
    """Keep `levels`, the open blocks. A list in the column of its key has no beginning and no end among the tokens."""
    if kind in ("map", "list"):
        levels.append(kind)
    elif kind == "-" and levels and levels[-1] == "map":
        levels.append("flush")
    elif kind in ("?", "end") and levels and levels[-1] == "flush":
        levels.pop()
    if kind == "end" and levels:
        levels.pop()
