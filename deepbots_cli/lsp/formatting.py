"""Formatting: what `deepbots fmt` would make of the document, as one edit of what differs."""

from __future__ import annotations

from lsprotocol import types

from deepbots_cli.document.layout import tidy
from deepbots_cli.lsp.documents import Document


def formatting(document: Document) -> list[types.TextEdit]:
    """The edit to the canonical layout; none where the document is in it, or cannot be laid out as it stands."""
    _, root, findings = document.read()
    before = document.plain
    after = tidy(before) if root is not None and not findings.errors else None
    return rewritten(document, after) if after is not None else []


def rewritten(document: Document, after: str) -> list[types.TextEdit]:
    """The edit that makes `after` of a document; what is the same at both ends stays, with the cursor and the marks in it."""
    before = document.plain
    if after == before:
        return []
    start = _same(before, after)
    end = min(_same(before[::-1], after[::-1]), len(before) - start, len(after) - start)
    # Between the two characters of a line end there is no place.
    start -= before[max(0, start - 1) : start + 1] == "\r\n"
    end -= before[len(before) - end - 1 : len(before) - end + 1] == "\r\n"
    return [types.TextEdit(document.lines.range(start, len(before) - end), after[start : len(after) - end])]


def _same(one: str, other: str) -> int:
    """How many characters the two have in common from their beginnings."""
    return next((index for index, (a, b) in enumerate(zip(one, other, strict=False)) if a != b), min(len(one), len(other)))
