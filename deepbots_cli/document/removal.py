"""Taking an entry out of the text of a file, as a fix does it."""

from __future__ import annotations

import re

from deepbots_cli.diagnostics import Edit, Fix, Span
from deepbots_cli.document.nodes import Entry, Mapping, Node, Path, descend

_REST_OF_LINE = re.compile(r"[ \t]*(?:,?[ \t]+#[^\n]*|\r?)(?:\n|$)")


def removing(root: Node, path: Path) -> Fix | None:
    """The fix that takes out the entry at `path`, with its lines or between its brackets.

    None where that is not sure to leave the rest as it is: the only entry of its mapping, an item of a list, or brackets with
    a comment or a line break beside the entry.
    """
    holder, _, steps = descend(root, path[:-1])
    if steps < len(path) - 1 or not isinstance(holder, Mapping) or len(holder.entries) < 2:
        return None
    entry = holder.entries.get(str(path[-1]))
    if entry is None or not entry.key.span.source is entry.value.span.source is holder.span.source:
        return None
    span = _in_brackets(holder, entry) if holder.span.text.startswith("{") else _lines(entry)
    return Fix((Edit(span, ""),), safe=False) if span else None


def _lines(entry: Entry) -> Span | None:
    source, text = entry.key.span.source, entry.key.span.source.text
    start = text.rfind("\n", 0, entry.key.span.start) + 1
    rest = _REST_OF_LINE.match(text, entry.value.span.end)
    return Span(source, start, rest.end()) if rest and not text[start : entry.key.span.start].strip() else None


def _in_brackets(holder: Mapping, entry: Entry) -> Span | None:
    source = holder.span.source
    entries = sorted(holder.entries.values(), key=lambda other: other.key.span.start)
    at = next(index for index, other in enumerate(entries) if other is entry)
    if at + 1 < len(entries):
        span = Span(source, entry.key.span.start, entries[at + 1].key.span.start)
    else:
        span = Span(source, entries[at - 1].value.span.end, entry.value.span.end)
    return None if set(span.text) & set("#\n") else span
