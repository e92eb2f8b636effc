"""Edits of a scenario file that keep its other text: an entry removed, moved or set."""

from __future__ import annotations

import re
from itertools import islice

from deepbots_cli.diagnostics import Edit, Fix, Source, Span
from deepbots_cli.document.layout import plain_or_quoted
from deepbots_cli.document.nodes import (
    Entry,
    MappingNode,
    Node,
    NodePath,
    ScalarNode,
    SequenceNode,
    descend,
    node_at,
)

_REST_OF_LINE = re.compile(r"[ \t]*(?:,?[ \t]+#[^\n]*|\r?)(?:\n|$)")
_COMMA = re.compile(r"[ \t]*,[ \t]*")
_SPECIAL_IN_BRACKETS = re.compile(r"[,{}\[\]#\n]|: ")
_END_OF_LINE = re.compile(r"\r?\n|\Z")


# Removing or moving an entry


def removal_fix(root: Node, path: NodePath) -> Fix | None:
    """Return the fix that removes the entry at `path`, with its lines or with a comma beside it.

    None for the only entry of its mapping, a list item, and an entry that shares its lines or its comma with
    other text.
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
        start = text.rfind("\n", 0, start) + 1
        rest_of_line = _REST_OF_LINE.match(text, end)
        end = rest_of_line.end() if rest_of_line and not text[start : entry.key.span.start].strip() else start
    elif comma := _COMMA.match(text, end):
        end = comma.end()
    else:
        before = text[:start].rstrip()
        start = len(before) - 1 if before.endswith(",") else end
    return Fix((Edit(Span(source, start, end), ""),), safe=False) if start < end else None


def move_to_augment_fix(root: MappingNode, name: str) -> Fix | None:
    """Return the fix that moves an entry from `signals` to `augment`, its comment with it.

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
    """Return the lines of an entry with its comment, ended by a newline; an entry in braces as one line."""
    start, end = entry.key.span.start, entry.value.span.end
    if holder.value.span.text.startswith("{"):
        return f"  {source.text[start:end]}{_newline(source)}"
    rest_of_line = _REST_OF_LINE.match(source.text, end)
    lines = source.text[source.text.rfind("\n", 0, start) + 1 : rest_of_line.end() if rest_of_line else end]
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
        if _SPECIAL_IN_BRACKETS.search(plain.partition(": ")[2]):
            return None
        return Span(source, max(ends), max(ends)), f", {plain}"
    starts = [entry.key.span.start for entry in entries if entry.key.span.source is source]
    column = min(source.position(start).column for start in starts) - 1
    is_aligned = len(line) - len(line.lstrip(" ")) == column
    if not is_aligned and line.count("\n") > 1:
        return None
    rest_of_line = _REST_OF_LINE.match(text, max(ends))
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
    innermost section that it has. A comment that begins with the same word is replaced. None where the text
    does not allow it.
    """
    node, _, steps = descend(root, path)
    if steps == len(path) and node.span.source is source:
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
    return _with_comment(
        source.text[:start] + new.rstrip(), new[len(new.rstrip()) :] + source.text[end:], comment
    )


def _with_comment(before: str, behind: str, comment: str) -> str:
    """Return a text with a comment at the end of the line that `behind` continues, in place of one with the
    same first word."""
    if not comment:
        return before + behind
    line_end = _END_OF_LINE.search(behind)
    assert line_end is not None  # it also matches the end of the text
    line = re.sub(rf"\s+# {re.escape(comment.split()[0])} [^\n]*", "", behind[: line_end.start()])
    return f"{before}{line}  # {comment}{behind[line_end.start() :]}"


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
    rest_of_line = _REST_OF_LINE.match(source.text, max(ends))
    at = rest_of_line.end() if rest_of_line else source.text.find("\n", max(ends)) + 1 or len(source.text)
    newline = _newline(source)
    before = "" if source.text[at - 1 : at] == "\n" else newline
    return at, before + newline.join(" " * column + line for line in entry.split("\n")) + newline
