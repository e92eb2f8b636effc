"""Nodes and YAML text: the canonical layout of a file, a tree written as YAML, and edits of a file that keep
its other text: an entry removed, moved or set.

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
from itertools import islice, takewhile
from typing import Any, NamedTuple

import yaml

from deepbots_cli.diagnostics import Edit, Findings, Fix, Source, Span
from deepbots_cli.document.nodes import (
    Entry,
    MappingNode,
    Node,
    NodePath,
    ScalarNode,
    SequenceNode,
    descend,
    entries_at,
    node_at,
    to_data,
    without_paths,
)
from deepbots_cli.document.parse import has_same_values, parse
from deepbots_cli.document.syntax_hints import LOADER

_MAX_PASSES = 6
_OPENING, _CLOSING = frozenset("{["), frozenset("}]")
_COMMENT = r"#[^\n]*"
_BLANK_LINES = r"\n\n\n+"
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
    if not has_same_values(Source("", plain), result) or _comments(result) != _comments(plain):
        return None
    return result.replace("\n", "\r\n") if text.partition("\n")[0].endswith("\r") else result


def _comments(text: str) -> list[str]:
    return [comment.rstrip() for gap, _, _ in _gaps(text) for comment in re.findall(_COMMENT, gap)]


def quoted(source: Source) -> list[int]:
    """Return the offsets at which quoted values and the lines of block values (`|`, `>`) of a file begin and
    end, in turn; none if YAML cannot read the file."""
    try:
        return [
            offset
            for token in _tokens(source.text)
            if token.kind == "<scalar>" and source.text[token.start] in "\"'|>"
            # A comment may be behind the sign of a block.
            for offset in (
                source.text.find("\n", token.start) if source.text[token.start] in "|>" else token.start,
                token.end,
            )
        ]
    except yaml.YAMLError:
        return []


def _visible(text: str) -> Iterator[Token]:
    """Yield the tokens that have text, without the empty lines at their ends. Blanks at the end of the last
    line are a part of a text."""
    for token in _tokens(text):
        line_end = text.find("\n", token.start + len(text[token.start : token.end].rstrip()), token.end)
        if token.end > token.start:
            yield token._replace(end=token.end if line_end < 0 else line_end)


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
    head, *rest = re.sub(rf"({_COMMENT})|\t", lambda match: match[1] or " ", gap).split("\n")
    # A file may end behind a comment, without a line break.
    inner, indentation = [line.rstrip() for line in rest[:-1]], rest[-1] if rest else ""
    if head.strip() and not first:
        blanks = len(head) - len(head.lstrip())
        head = " " * max(blanks - moved, min(blanks, 2)) + head.lstrip()
    joined = "\n".join([head.rstrip(), *inner, indentation])
    joined = re.sub(_BLANK_LINES, "\n\n", joined)
    if first:
        joined = joined.lstrip("\n")
    return f"{joined.rstrip()}\n" if last else joined


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
    rows, beginnings = text.split("\n"), sorted(shifts)
    lines, above, shift = list[str](), dict[int, int](), 0
    for number, line in enumerate(rows, 1):
        shift = line_shift = shifts.get(number, shift)
        blanks, index = _blanks_before(line), bisect_right(beginnings, number)
        if number in shifts:
            above = {column: moved for column, moved in above.items() if column < blanks} | {blanks: shift}
        # A comment belongs to the entry below it, or to one above it if it is deeper than the one below.
        elif number not in inside and line.strip():
            if index < len(beginnings) and blanks <= _blanks_before(rows[beginnings[index] - 1]):
                line_shift = shifts[beginnings[index]]
            else:
                line_shift = next((above[column] for column in reversed(above) if column <= blanks), shift)
        lines.append(_shifted(line, line_shift, dashes.get(number, ())))
    return "\n".join(lines)


def _blanks_before(line: str) -> int:
    return len(line) - len(line.lstrip(" "))


def _shifted(line: str, shift: int, dashes: tuple[int, ...]) -> str:
    # From the right, so that the places of the other dashes stay valid.
    for dash in reversed(dashes):  # `-   a: 1` becomes `- a: 1`
        line = f"{line[: dash + 1]} {line[dash + 1 :].lstrip(' ')}"
    if not line.strip(" "):
        return line if shift >= 0 else line[-shift:]
    return " " * max(0, _blanks_before(line) + shift) + line.lstrip(" ")


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
        first = max(opened + 1, settled_to) if flow else line + (token.kind not in _CLOSING)
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

_PLAIN = r"[A-Za-z_][A-Za-z0-9_./ -]*[A-Za-z0-9_]|[A-Za-z_]"
# YAML 1.1, which other programs read, takes `yes` and `on` for truth values.
_WORDS = frozenset({"null", "true", "false", "yes", "no", "on", "off", "y", "n"})
_UNSAFE_IN_QUOTES = r"[\x7f-\x9f\u2028\u2029\ufeff\ufffe\uffff]"
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
    if re.fullmatch(_PLAIN, text) and text.lower() not in _WORDS:
        return text
    quoted = json.dumps(text, ensure_ascii=False)
    return re.sub(_UNSAFE_IN_QUOTES, lambda match: f"\\u{ord(match[0]):04x}", quoted)


_REST_OF_LINE = r"[ \t]*(?:,?[ \t]+#[^\n]*|\r?)(?:\n|$)"
_SPECIAL_IN_BRACKETS = r"[,{}\[\]#\n]|: "
_ANCHOR, _ALIAS = (rf"{sign}([^\s,\[\]{{}}]+)" for sign in ("&", r"\*"))


# Removing or moving an entry


def removal_fix(root: Node, path: NodePath) -> Fix | None:
    """Return the fix that removes the entry at `path`, with its lines and comments or with a comma beside it.

    None for the only entry of its mapping, a list item, an entry that shares its lines or its comma with
    other text, and one with an anchor that the rest of the file uses.
    """
    holder, _, steps = descend(root, path[:-1])
    if steps < len(path) - 1 or not isinstance(holder, MappingNode):
        return None
    # The signals of an agent have those of all agents before them, which are written elsewhere.
    source, start, end = holder.span
    written = (
        entry
        for entry in holder.entries.values()
        if entry.key.span.source is source and start <= entry.key.span.start < end
    )
    if len([*islice(written, 2)]) < 2:  # of thousands, two are enough
        return None
    entry = holder.entries.get(str(path[-1]))
    if entry is None or not entry.key.span.source is entry.value.span.source is holder.span.source:
        return None
    source, start, _ = entry.key.span
    text, end = source.text, entry.value.span.end
    if not holder.span.text.startswith("{"):
        start = _start_of_lines(text, start)
        rest_of_line, before = re.compile(_REST_OF_LINE).match(text, end), text[start : entry.key.span.start]
        end = rest_of_line.end() if rest_of_line and not before.rpartition("\n")[2].strip() else start
    elif comma := re.compile(r"[ \t]*,[ \t]*").match(text, end):
        end = comma.end()
    else:
        before = text[:start].rstrip()
        ends_in_comment = "#" in before.rpartition("\n")[2]
        start = len(before) - 1 if before.endswith(",") and not ends_in_comment else end
    if set(re.findall(_ANCHOR, text[start:end])) & set(re.findall(_ALIAS, text[end:])):
        return None
    return Fix((Edit(Span(source, start, end), ""),), safe=False) if start < end else None


def _start_of_lines(text: str, key: int) -> int:
    """Return the offset of the line of a key, or of the comments directly above it in its column."""
    *lines, indentation = text[:key].split("\n")
    comments = takewhile(lambda line: line.startswith(f"{indentation}#"), reversed(lines))
    return key - len(indentation) - sum(len(line) + 1 for line in comments)


def move_to_augment_fix(root: MappingNode, name: str) -> Fix | None:
    """Return the fix that moves an entry from `signals` to `augment`, its comments with it.

    The name is added to an `augment` that is a list of names. None where the text does not allow it.
    """
    holder, new = root.entries.get("signals"), root.entries.get("augment")
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
        return Fix((Edit(holder.key.span, "augment"),), safe=False)
    if new is not None and isinstance(new.value, SequenceNode):
        last = new.value.items[-1].span if new.value.items and new.value.span.text.startswith("[") else None
        at = Span(last.source, last.end, last.end) if last else None
        return Fix((Edit(at, f", {name}"),), safe=False) if at else None
    removal = removal_fix(root, ("signals",) if is_only else ("signals", name))
    if removal is None:
        return None
    insertion = _insertion(source, _moved_lines(source, holder, entry), holder.key.span, new)
    return Fix((Edit(*insertion), *removal.edits), safe=False) if insertion else None


def _moved_lines(source: Source, holder: Entry, entry: Entry) -> str:
    """Return the lines of an entry with its comments, ended by a newline; an entry in braces as one line."""
    start, end = entry.key.span.start, entry.value.span.end
    if holder.value.span.text.startswith("{"):
        return f"  {source.text[start:end]}{_newline(source)}"
    rest_of_line = re.compile(_REST_OF_LINE).match(source.text, end)
    lines = source.text[_start_of_lines(source.text, start) : rest_of_line.end() if rest_of_line else end]
    return lines if lines.endswith("\n") else f"{lines}{_newline(source)}"


def _insertion(source: Source, line: str, section: Span, new: Entry | None) -> tuple[Span, str] | None:
    """Return the span for the `line` of an entry and the text: below the last entry of `augment`, or in a new
    `augment` above the `section`."""
    text = source.text
    if new is None:
        start = text.rfind("\n", 0, section.start) + 1
        section_text = f"augment:{_newline(source)}{line}"
        return (Span(source, start, start), section_text) if start == section.start else None
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
        if "\n" in plain or re.search(_SPECIAL_IN_BRACKETS, plain.partition(": ")[2]):
            return None
        return Span(source, max(ends), max(ends)), f", {plain}"
    starts = [entry.key.span.start for entry in entries if entry.key.span.source is source]
    column = min(source.position(start).column for start in starts) - 1
    if _blanks_before(line) != column and line.count("\n") > 1:
        return None
    rest_of_line = re.compile(_REST_OF_LINE).match(text, max(ends))
    end = rest_of_line.end() if rest_of_line else text.find("\n", max(ends)) + 1
    if not end or text[end - 1] != "\n":
        return None
    return Span(source, end, end), " " * column + line.lstrip(" ")


def _newline(source: Source) -> str:
    """Return the line end of the first line."""
    return "\r\n" if source.text.partition("\n")[0].endswith("\r") else "\n"


# Setting a value


def assigned_text(root: MappingNode, source: Source, path: NodePath, value: str, comment: str) -> str | None:
    """Return the text of a file with another value at `path`, and a comment, if any, behind it on its line;
    everything else stays as it is.

    A key that the file does not have, because it extends another one or has a default, is added to the
    innermost section that it has. A comment that begins with the same word is replaced. A value with an
    anchor changes wherever it is used, and an alias becomes the value. None where the text does not allow it.
    """
    node, _, steps = descend(root, path)
    alias = _alias(root, source, path)
    if alias is not None:
        start, end, new = *alias.span(1), value
    elif steps == len(path) and node.span.source is source:
        if comment and isinstance(node, ScalarNode) and node.style in ("literal", "folded"):
            return None  # a comment would be a part of the value
        start, end, new = node.span.start, node.span.end, value
    else:
        # `descend` has gone through these nodes.
        while steps and node_at(root, *path[:steps]).span.source is not source:  # type: ignore[union-attr]
            steps -= 1
        holder = node_at(root, *path[:steps])
        if not isinstance(holder, MappingNode):
            return None
        keys = [plain_or_quoted(str(key)) for key in path[steps:]]
        addition = _addition(source, holder, keys, value, is_section=steps == 0 and len(keys) > 1)
        if addition is None:
            return None
        start, new = addition
        end = start
    text = _with_comment(
        source.text[:start] + new.rstrip(), new[len(new.rstrip()) :] + source.text[end:], comment
    )
    return text if _differs_in_value(source.text, text, path, value) else None


def _differs_in_value(before: str, after: str, path: NodePath, value: str) -> bool:
    """Return whether a text has `value` at `path`, and everything else as before; what an anchor names may
    differ too."""
    new_findings, old_findings = Findings(), Findings()
    new, old = parse(Source("", after), new_findings), parse(Source("", before), old_findings)
    node, written = node_at(new, *path), parse(Source("", value), Findings())
    if not (old and new and node and len(new_findings.errors) <= len(old_findings.errors)):
        return False
    place = [path[: descend(old, path)[2] + 1]]  # with the sections that are new
    is_written = to_data(node) == (written and to_data(written))
    return is_written and (
        "&" in before or to_data(without_paths(new, place)) == to_data(without_paths(old, place))
    )


def _alias(root: MappingNode, source: Source, path: NodePath) -> re.Match[str] | None:
    """Return the alias that a file has in place of the value at a path."""
    entry = entries_at(root, *path[:-1]).get(str(path[-1])) if path else None
    if entry is None or not entry.key.span.source is entry.value.span.source is source:
        return None
    alias = re.compile(rf"\s*:\s*({_ALIAS})").match(source.text, entry.key.span.end)
    return alias if entry.value.span.start < entry.key.span.start else None  # an anchor is before its aliases


def _with_comment(before: str, behind: str, comment: str) -> str:
    """Return a text with a comment at the end of the line that `behind` continues, in place of one with the
    same first word."""
    if not comment:
        return before + behind
    rest_of_line = re.split(r"\r?\n", behind, maxsplit=1)[0]
    line = re.sub(rf"\s+# {re.escape(comment.split()[0])} [^\n]*", "", rest_of_line)
    return f"{before}{line}  # {comment}{behind[len(rest_of_line) :]}"


def _addition(
    source: Source, holder: MappingNode, keys: list[str], value: str, *, is_section: bool
) -> tuple[int, str] | None:
    """Return the offset and the text of a new last entry of a mapping, with the value below further keys; a
    section has its entry on a line of its own."""
    entry = f"{keys[-1]}: {value}"
    for key in reversed(keys[1:-1] if is_section else keys[:-1]):
        entry = f"{key}: {{{entry}}}"
    if is_section:
        entry = f"{keys[0]}:\n  {entry}"
    neighbors = [neighbor for neighbor in holder.entries.values() if neighbor.key.span.source is source]
    ends = [
        max(neighbor.key.span.end, neighbor.value.span.end if neighbor.value.span.source is source else 0)
        for neighbor in neighbors
    ]
    if holder.span.text.startswith("{"):
        at = max(ends, default=holder.span.start + 1)
        return at, f", {entry}" if ends else entry
    if not ends:
        return None
    column = min(source.position(neighbor.key.span.start).column for neighbor in neighbors) - 1
    rest_of_line = re.compile(_REST_OF_LINE).match(source.text, max(ends))
    at = rest_of_line.end() if rest_of_line else source.text.find("\n", max(ends)) + 1 or len(source.text)
    lines = [" " * column + line for line in entry.split("\n")]
    return at, _newline(source).join([*[""] * (source.text[at - 1 : at] != "\n"), *lines, ""])
