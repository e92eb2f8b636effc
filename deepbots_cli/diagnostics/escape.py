"""Text of a file where a terminal or a program reads it: what they would obey or hide is shown as an escape."""

from __future__ import annotations

import re

_LONGEST = 600
# Control characters, the marks that reverse or hide the text after them, and what no XML may hold.
_UNSAFE = re.compile("[\x00-\x1f\x7f-\x9f\u200b-\u200f\u2028-\u202e\u2060-\u206f\ud800-\udfff\ufeff\ufffe\uffff]")


def safe(text: str) -> str:
    """`text` on one line."""
    return _UNSAFE.sub(lambda found: f"\\u{{{ord(found.group()):x}}}", text)


def said(text: str) -> str:
    """A sentence of ours for one line; what it quotes from a file may have any length."""
    return safe(text if len(text) <= _LONGEST else text[:_LONGEST] + "…")
