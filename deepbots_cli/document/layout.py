"""Nodes and YAML text: the canonical layout of a file, and a tree written as YAML.

The canonical layout changes white space between tokens, and nothing else. Two passes make it: `_spaced` sets
the blanks within lines, `_indented` the indentation. The text inside a scalar moves with its line and stays
as it is. Deliberate alignment is kept: two blanks or more stay if the token behind them is below or above the
beginning of another.
"""

from __future__ import annotations

import json
import re
from bisect import bisect_right
from collections.abc import Iterator
from typing import Any, NamedTuple

import yaml

from deepbots_cli.diagnostics import Findings, Source
from deepbots_cli.document.nodes import (
    MappingNode,
    Node,
    ScalarNode,
    SequenceNode,
    to_data,
)
from deepbots_cli.document.parse import parse
from deepbots_cli.document.syntax_hints import LOADER

_MAX_PASSES = 6
_OPENING, _CLOSING = frozenset("{["), frozenset("}]")
_COMMENT = re.compile(r"#[^\n]*")
_BLANK_LINES = re.compile(r"\n\n\n+")
_BLOCKS = {"<block mapping start>": "map", "<block sequence start>": "list", "<block end>": "end"}


class Token(NamedTuple):
    """A piece of YAML's syntax: a sign (`{`, `:`, `-`), `<scalar>`, or, without text, the `?` of a key,
    `map`, `list` and `end`."""

    kind: str
    start: int
    end: int


def _tokens(text: str) -> Iterator[Token]:
    token: Any
    for token in yaml.scan(text, Loader=LOADER):
        yield Token(_BLOCKS.get(token.id, token.id), token.start_mark.index, token.end_mark.index)


def canonical_text(text: str) -> str | None:
    """Return `text`, which must parse without findings, in the canonical layout; None if that would change
    its meaning.

    All lines get the line end of the first.
    """
    plain = text.replace("\r\n", "\n")
    result = plain
    for _ in range(_MAX_PASSES):
        before, result = result, _indented(_spaced(result))
        if result == before:
            break
    else:
        return None
    if _meaning(result) != _meaning(plain) or _comments(result) != _comments(plain):
        return None
    first = text.find("\n")
    return result.replace("\n", "\r\n") if first > 0 and text[first - 1] == "\r" else result


def _meaning(text: str) -> object:
    root = parse(Source("", text), Findings())
    return root and to_data(root)


def _comments(text: str) -> list[str]:
    return [comment.rstrip() for gap, _, _ in _gaps(text) for comment in _COMMENT.findall(gap)]


def _visible(text: str) -> list[Token]:
    """Return the tokens that have text, without the white space at their ends."""
    return [
        token._replace(end=token.start + len(text[token.start : token.end].rstrip()))
        for token in _tokens(text)
        if token.end > token.start
    ]


def _gaps(text: str) -> Iterator[tuple[str, Token | None, Token | None]]:
    """Yield the text between tokens, with the tokens before and behind it."""
    before: Token | None = None
    for token in _visible(text):
        yield text[before.end if before else 0 : token.start], before, token
        before = token
    yield text[before.end if before else 0 :], before, None


# Blanks within lines


def _spaced(text: str) -> str:
    columns = _Columns(text)
    pieces: list[str] = []
    moved = 0  # how far the rest of the line has moved to the right
    for gap, before, behind in _gaps(text):
        if before is not None:
            token = text[before.start : before.end]
            pieces.append(token)
            moved = 0 if "\n" in token else moved
        if "\n" in gap or behind is None or before is None:
            pieces.append(_between_lines(gap, moved, first=before is None, last=behind is None))
            moved = 0
        else:
            blanks = _blanks(gap, before, behind, columns)
            moved += len(blanks) - len(gap)
            pieces.append(blanks)
    return "".join(pieces)


def _blanks(gap: str, before: Token, behind: Token, columns: _Columns) -> str:
    """Return the blanks between two tokens of a line."""
    if before.kind in _OPENING or behind.kind in _CLOSING or behind.kind in (",", ":"):
        return ""
    if before.kind == "-":
        return gap  # the lines below may be aligned with the text behind the dash
    return gap if len(gap) > 1 and columns.aligned(behind.start) else " "


def _between_lines(gap: str, moved: int, *, first: bool, last: bool) -> str:
    """Return the text between two tokens of different lines: a comment behind the first, blank lines,
    comments, the indentation."""
    head, *rest = gap.replace("\t", " ").split("\n")
    # A file may end behind a comment, without a line break.
    inner, indentation = [line.rstrip() for line in rest[:-1]], rest[-1] if rest else ""
    if head.strip() and not first:
        blanks = len(head) - len(head.lstrip())
        head = " " * max(blanks - moved, min(blanks, 2)) + head.lstrip()
    joined = "\n".join([head.rstrip(), *inner, "" if last else indentation])
    joined = _BLANK_LINES.sub("\n\n", joined)
    if first:
        joined = joined.lstrip("\n")
    if not last:
        return joined
    if indentation.strip():
        joined += indentation
    return f"{joined.rstrip()}\n"


class _Columns:
    """The columns in which the tokens of each line begin."""

    def __init__(self, text: str) -> None:
        self._source = Source("", text)
        self._columns: dict[int, set[int]] = {}
        for token in _visible(text):
            if token.kind not in (",", ":"):
                line, column = self._source.position(token.start)
                self._columns.setdefault(line, set()).add(column)
        lines = sorted(self._columns)
        self._neighbors = {
            line: {*lines[max(0, i - 1) : i], *lines[i + 1 : i + 2]} for i, line in enumerate(lines)
        }

    def aligned(self, offset: int) -> bool:
        """Return whether a token of the line above or below begins in the same column."""
        line, column = self._source.position(offset)
        return any(column in self._columns[neighbor] for neighbor in self._neighbors[line])


# Indentation


def _indented(text: str) -> str:
    shifts, inside, dashes = _structure(text)
    beginnings = sorted(shifts)
    lines: list[str] = []
    shift = 0
    for number, line in enumerate(text.split("\n"), 1):
        shift = line_shift = shifts.get(number, shift)
        # A comment belongs to the entry below it.
        if number not in shifts and number not in inside and line.strip():
            index = bisect_right(beginnings, number)
            line_shift = shifts[beginnings[index]] if index < len(beginnings) else shift
        lines.append(_shifted(line, line_shift, dashes.get(number, ())))
    return "\n".join(lines)


def _shifted(line: str, shift: int, dashes: tuple[int, ...]) -> str:
    # From the right, so that the places of the other dashes stay valid.
    for dash in reversed(dashes):  # `-   a: 1` becomes `- a: 1`
        line = f"{line[: dash + 1]} {line[dash + 1 :].lstrip(' ')}"
    if not line.strip(" "):
        return line if shift >= 0 else line[-shift:]
    blanks = len(line) - len(line.lstrip(" "))
    return " " * max(0, blanks + shift) + line.lstrip(" ")


def _structure(text: str) -> tuple[dict[int, int], set[int], dict[int, tuple[int, ...]]]:
    """Return by line number (from 1) how far the lines that begin an entry move, the lines inside a value,
    and the dashes with text behind.

    A line moves by blanks to the right; a dash is given by the number of blanks before it.
    """
    source = Source("", text)
    shifts: dict[int, int] = {}
    inside: set[int] = set()
    dashes: dict[int, tuple[int, ...]] = {}
    levels: list[str] = []
    flow, is_key, opened, settled_to = 0, False, 1, 0
    for token in _tokens(text):
        line, column = source.position(token.start)
        blanks = column - 1
        if flow == 0:
            _nest(levels, token.kind)
            begins = token.kind == "-" or (is_key and token.end > token.start)
            if begins and line not in shifts and not text[token.start - blanks : token.start].strip():
                shifts[line] = 2 * (len(levels) - 1) - blanks
            if (
                token.kind == "-"
                and text[token.end : token.end + 2].strip(" ") == ""
                and "\n" not in text[token.end : token.end + 2]
            ):
                dashes[line] = (*dashes.get(line, ()), blanks)
            opened = line
        is_key = token.kind == "?" or (is_key and token.end == token.start)
        flow += (token.kind in _OPENING) - (token.kind in _CLOSING)
        last = line + text.count("\n", token.start, token.start + len(text[token.start : token.end].rstrip()))
        if flow:
            first = max(opened + 1, settled_to)
        elif token.kind in _CLOSING:
            first = line
        else:
            first = line + 1
        inside.update(range(first, last + 1))
        settled_to = last + 1  # the lines above are done
    return shifts, inside, dashes


def _nest(levels: list[str], kind: str) -> None:
    """Update `levels`, the open blocks. A list in the column of its key has no tokens for its beginning and
    end."""
    if kind in ("map", "list"):
        levels.append(kind)
    elif kind == "-" and levels and levels[-1] == "map":
        levels.append("flush")
    elif kind in ("?", "end") and levels and levels[-1] == "flush":
        levels.pop()
    if kind == "end" and levels:
        levels.pop()


# Writing a tree

_PLAIN = re.compile(r"[A-Za-z_][A-Za-z0-9_./ -]*[A-Za-z0-9_]|[A-Za-z_]")
# YAML 1.1, which other programs read, takes `yes` and `on` for truth values.
_WORDS = frozenset({"null", "true", "false", "yes", "no", "on", "off", "y", "n"})
_UNSAFE_IN_QUOTES = re.compile(r"[\x7f-\x9f\u2028\u2029\ufeff]")
"""Characters that YAML does not read, or reads as line breaks, and that JSON does not escape."""


def to_yaml(node: Node) -> str:
    """Return block-style YAML that reads back as the same values, without comments."""
    return ("\n".join(_lines(node, "")) or "{}") + "\n"


def _lines(node: Node, pad: str) -> Iterator[str]:
    match node:
        case ScalarNode():
            yield pad + (plain_or_quoted(node.text) if isinstance(node.value, str) else node.text)
        case MappingNode(entries=entries):
            for key, entry in entries.items():
                yield from _under(f"{pad}{plain_or_quoted(key)}:", entry.value, pad)
        case SequenceNode(items=items):
            for item in items:
                yield from _under(f"{pad}-", item, pad)


def _under(head: str, value: Node, pad: str) -> Iterator[str]:
    """Yield the lines of an entry; a scalar or an empty collection follows its key on the same line."""
    lines = list(_lines(value, f"{pad}  "))
    if isinstance(value, ScalarNode) or not lines:
        empty = "{}" if isinstance(value, MappingNode) else "[]"
        yield f"{head} {lines[0].strip() if lines else empty}"
    else:
        yield head
        yield from lines


def plain_or_quoted(text: str) -> str:
    """Return a plain word where that is safe, else a text in double quotes with the escapes of JSON."""
    if _PLAIN.fullmatch(text) and text.lower() not in _WORDS:
        return text
    quoted = json.dumps(text, ensure_ascii=False)
    return _UNSAFE_IN_QUOTES.sub(lambda match: f"\\u{ord(match[0]):04x}", quoted)
