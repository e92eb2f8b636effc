"""Nodes and YAML text: the canonical layout of a file, a tree written as YAML, an entry removed or moved.

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

from deepbots_cli.diagnostics import Edit, Findings, Fix, Source, Span
from deepbots_cli.document.hints import LOADER
from deepbots_cli.document.nodes import (
    Entry,
    MappingNode,
    Node,
    NodePath,
    ScalarNode,
    SequenceNode,
    descend,
    node_at,
    to_data,
)
from deepbots_cli.document.parse import parse

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
    done = plain
    for _ in range(_MAX_PASSES):
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
    """Return the blanks between two tokens of a line."""
    if before.kind in _OPENING or behind.kind in _CLOSING or behind.kind in (",", ":"):
        return ""
    if before.kind == "-":
        return gap  # the lines below may be aligned with the text behind the dash
    return gap if len(gap) > 1 and columns.aligned(behind.start) else " "


def _between_lines(gap: str, moved: int, *, first: bool, last: bool) -> str:
    """Return the text between two tokens of different lines: a comment behind the first, blank lines,
    comments, the indentation."""
    lines = gap.replace("\t", " ").split("\n")
    head, inner, indentation = lines[0], [line.rstrip() for line in lines[1:-1]], lines[-1]
    if head.strip() and not first:
        blanks = len(head) - len(head.lstrip())
        head = " " * max(blanks - moved, min(blanks, 2)) + head.lstrip()
    joined = "\n".join([head.rstrip(), *inner, "" if last else indentation])
    joined = _BLANK_LINES.sub("\n\n", joined)
    if first:
        joined = joined.lstrip("\n")
    return (
        f"{(joined + indentation if indentation.strip() and last else joined).rstrip()}\n" if last else joined
    )


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
        return any(column in self._columns[other] for other in self._neighbors[line])


# Indentation


def _indented(text: str) -> str:
    shifts, inside, dashes = _structure(text)
    beginnings = sorted(shifts)
    done: list[str] = []
    shift = 0
    for number, line in enumerate(text.split("\n"), 1):
        shift = own = shifts.get(number, shift)
        # A comment belongs to the entry below it.
        if number not in shifts and number not in inside and line.strip():
            index = bisect_right(beginnings, number)
            own = shifts[beginnings[index]] if index < len(beginnings) else shift
        done.append(_shifted(line, own, dashes.get(number, ())))
    return "\n".join(done)


def _shifted(line: str, shift: int, dashes: tuple[int, ...]) -> str:
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
_WORDS = frozenset({"null", "true", "false", "yes", "no", "on", "off", "y", "n", "~"})


def to_yaml(node: Node) -> str:
    """Return block-style YAML that reads back as the same values, without comments."""
    return "\n".join(_lines(node, "")) + "\n"


def _lines(node: Node, pad: str) -> Iterator[str]:
    match node:
        case ScalarNode():
            yield pad + (_text(node.text) if isinstance(node.value, str) else node.text)
        case MappingNode(entries=entries):
            for key, entry in entries.items():
                yield from _under(f"{pad}{_text(key)}:", entry.value, pad)
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


def _text(text: str) -> str:
    """Return a plain word where that is safe, else a text in double quotes with the escapes of JSON."""
    if _PLAIN.fullmatch(text) and text.lower() not in _WORDS:
        return text
    return json.dumps(text, ensure_ascii=False)


# Removing or moving an entry

_REST_OF_LINE = re.compile(r"[ \t]*(?:,?[ \t]+#[^\n]*|\r?)(?:\n|$)")
_COMMA = re.compile(r"[ \t]*,[ \t]*")


def removal_fix(root: Node, path: NodePath) -> Fix | None:
    """Return the fix that removes the entry at `path`, with its lines or with a comma beside it.

    None for the only entry of its mapping, a list item, and an entry that shares its lines or its comma with
    other text.
    """
    holder, _, steps = descend(root, path[:-1])
    if steps < len(path) - 1 or not isinstance(holder, MappingNode) or len(holder.entries) < 2:
        return None
    entry = holder.entries.get(str(path[-1]))
    if entry is None or not entry.key.span.source is entry.value.span.source is holder.span.source:
        return None
    source, start, _ = entry.key.span
    text, end = source.text, entry.value.span.end
    if not holder.span.text.startswith("{"):
        start = text.rfind("\n", 0, start) + 1
        rest = _REST_OF_LINE.match(text, end)
        end = rest.end() if rest and not text[start : entry.key.span.start].strip() else start
    elif comma := _COMMA.match(text, end):
        end = comma.end()
    else:
        before = text[:start].rstrip()
        start = len(before) - 1 if before.endswith(",") else end
    return Fix((Edit(Span(source, start, end), ""),), safe=False) if start < end else None


_SPECIAL_IN_BRACKETS = re.compile(r"[,{}\[\]#\n]|: ")


def move_fix(root: MappingNode, name: str, section: str, target: str) -> Fix | None:
    """Return the fix that moves the entry `name` from one section of the scenario to another, its comment
    with it.

    The name is added to a target that is a list of names. None where the text does not allow it.
    """
    holder, new = root.entries.get(section), root.entries.get(target)
    entry = holder.value.entries.get(name) if holder and isinstance(holder.value, MappingNode) else None
    if (
        holder is None
        or entry is None
        or not entry.key.span.source is holder.key.span.source is holder.value.span.source
    ):
        return None
    source = holder.key.span.source
    is_only = isinstance(holder.value, MappingNode) and len(holder.value.entries) == 1
    if new is not None and isinstance(new.value, MappingNode) and new.key.span.source is not source:
        new = None  # that of an extended file, to which a section of this one adds
    if new is None and is_only:
        return Fix((Edit(holder.key.span, target),), safe=False)
    if new is not None and isinstance(new.value, SequenceNode):
        last = new.value.items[-1].span if new.value.items and new.value.span.text.startswith("[") else None
        at = Span(last.source, last.end, last.end) if last else None
        return Fix((Edit(at, f", {name}"),), safe=False) if at else None
    removal = removal_fix(root, (section,) if is_only else (section, name))
    if removal is None:
        return None
    removed = removal.edits[0].span
    in_block = removed.text.endswith("\n") and not holder.value.span.text.startswith("{")
    lines = (
        [removed.text]
        if in_block and not is_only
        else [f"  {source.text[entry.key.span.start : entry.value.span.end]}\n"]
    )
    written = _insertion(source, lines[0], holder.key.span, target, new)
    return Fix((Edit(*written), *removal.edits), safe=False) if written else None


def _insertion(
    source: Source, line: str, section: Span, target: str, new: Entry | None
) -> tuple[Span, str] | None:
    """Return the place for the `line` of an entry and its text: below the last entry of a section, or in a
    new section above another one."""
    text = source.text
    if new is None:
        start = text.rfind("\n", 0, section.start) + 1
        return (Span(source, start, start), f"{target}:\n{line}") if start == section.start else None
    entries = new.value.entries.values() if isinstance(new.value, MappingNode) else ()
    ends = [
        entry.value.span.end
        for entry in entries
        if entry.key.span.source is entry.value.span.source is source
    ]
    if not ends or new.value.span.source is not source:
        return None
    if new.value.span.text.startswith("{"):
        plain = line.strip()
        return (
            None
            if _SPECIAL_IN_BRACKETS.search(plain.partition(": ")[2])
            else (Span(source, max(ends), max(ends)), f", {plain}")
        )
    column = (
        min(source.position(entry.key.span.start)[1] for entry in entries if entry.key.span.source is source)
        - 1
    )
    is_aligned = len(line) - len(line.lstrip(" ")) == column
    if not is_aligned and line.count("\n") > 1:
        return None
    rest = _REST_OF_LINE.match(text, max(ends))
    end = rest.end() if rest else text.find("\n", max(ends)) + 1
    return (
        (Span(source, end, end), " " * column + line.lstrip(" ")) if end and text[end - 1] == "\n" else None
    )


# Setting a value


def assigned_text(root: MappingNode, source: Source, path: NodePath, value: str, comment: str) -> str | None:
    """Return the text of a file with another value at `path`, and a comment, if any, behind it on its line;
    everything else stays as it is.

    A key that the file does not have, because it extends another one or has a default, is added to the
    innermost section that it has. A comment that begins with the same word is replaced. None where the text
    does not allow it.
    """
    node, _, steps = descend(root, path)
    if steps == len(path) and node.span.source is source:
        start, end, new = node.span.start, node.span.end, value
    else:
        # `descend` has gone through these nodes.
        while steps and node_at(root, *path[:steps]).span.source is not source:  # type: ignore[union-attr]
            steps -= 1
        holder = node_at(root, *path[:steps])
        keys = [_text(str(key)) for key in path[steps:]]
        if not isinstance(holder, MappingNode):
            return None
        entry = f"{keys[-1]}: {value}"
        for key in reversed(keys[steps == 0 : -1]):
            entry = f"{key}: {{{entry}}}"
        added = _addition(source, holder, f"{keys[0]}:\n  {entry}" if steps == 0 and len(keys) > 1 else entry)
        if added is None:
            return None
        start, end, new = added
    text = source.text[:start] + new + source.text[end:]
    if not comment:
        return text
    line_start = text.rfind("\n", 0, start + len(new.rstrip())) + 1
    line_end = _END_OF_LINE.search(text, start + len(new.rstrip()))
    assert line_end is not None  # it also matches the end of the text
    line = re.sub(rf"\s+# {re.escape(comment.split()[0])} [^\n]*", "", text[line_start : line_end.start()])
    return f"{text[:line_start]}{line}  # {comment}{text[line_end.start() :]}"


_END_OF_LINE = re.compile(r"\r?\n|\Z")


def _addition(source: Source, holder: MappingNode, entry: str) -> tuple[int, int, str] | None:
    """Return the place for an entry in a mapping of a file and its indentation: behind the last entry."""
    own = [each for each in holder.entries.values() if each.key.span.source is source]
    ends = [
        max(each.key.span.end, each.value.span.end if each.value.span.source is source else 0) for each in own
    ]
    if holder.span.text.startswith("{"):
        at = max(ends, default=holder.span.start + 1)
        return at, at, f", {entry}" if ends else entry
    if not ends:
        return None
    column = min(source.position(each.key.span.start).column for each in own) - 1
    rest = _REST_OF_LINE.match(source.text, max(ends))
    at = rest.end() if rest else source.text.find("\n", max(ends)) + 1 or len(source.text)
    before = "" if source.text[at - 1 : at] == "\n" else "\n"
    return at, at, before + "\n".join(" " * column + line for line in entry.split("\n")) + "\n"
