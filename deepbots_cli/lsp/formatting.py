"""Formatting: what `deepbots fmt` would make of the document, as one edit of what differs."""

from __future__ import annotations

from lsprotocol import types

from deepbots_cli.lsp.documents import Document
from deepbots_cli.source.layout import tidy


def formatting(document: Document) -> list[types.TextEdit]:
    """The edit to the canonical layout; none where the document is in it, or cannot be laid out as it stands."""
    _, root, findings = document.read()
    before = document.plain
    after = tidy(before) if root is not None and not findings.errors else None
    if after is None or after == before:
        return []
    start = _same(before, after)
    most = min(len(before), len(after)) - start
    end = min(most, _same(before[::-1], after[::-1]))
    return [types.TextEdit(document.lines.range(start, len(before) - end), after[start : len(after) - end])]


def _same(one: str, other: str) -> int:
    """How many characters the two have in common from their beginnings."""
    return next((index for index, (a, b) in enumerate(zip(one, other, strict=False)) if a != b), min(len(one), len(other)))
