"""Text of a file where a terminal or a program reads it: what they would obey or hide is shown as an escape."""

from __future__ import annotations

import re

_LONGEST = 600
# Control characters, the marks that reverse or hide the text after them, and what no XML may hold.
_UNSAFE = re.compile("[\x00-\x1f\x7f-\x9f\u200b-\u200f\u2028-\u202e\u2060-\u206f\ud800-\udfff\ufeff\ufffe\uffff]")
# What the log of a workflow takes for a command of ours: GitHub at the beginning of a line, and Azure and older GitHub anywhere.
_COMMAND = re.compile(r"^([ \t]*):(?=:)|(#)(?=#(?:vso)?\[)", re.MULTILINE)


def safe(text: str) -> str:
    """`text` on one line."""
    return _UNSAFE.sub(lambda found: f"\\u{{{ord(found.group()):x}}}", text)


def said(text: str) -> str:
    """A sentence of ours for one line; what it quotes from a file may have any length."""
    return safe(text if len(text) <= _LONGEST else text[:_LONGEST] + "…")


def inert(text: str) -> str:
    """Lines for a log that obeys some of what is written to it: a file may be called `::stop-commands::x.yaml`."""
    if "::" not in text and "##" not in text:
        return text
    return _COMMAND.sub(lambda found: f"{found[1] or ''}\\u{{{'23' if found[2] else '3a'}}}", text)
