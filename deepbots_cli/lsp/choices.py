"""The choices of a completion."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from lsprotocol.types import CompletionItemKind


class Choice(NamedTuple):
    """A completion: its text, what it is in a few words (`detail`), and its documentation in Markdown."""

    text: str
    kind: CompletionItemKind
    detail: str
    doc: str = ""


def unique(choices: Iterable[Choice]) -> Iterable[Choice]:
    """Return the first choice of each text."""
    first: dict[str, Choice] = {}
    for choice in choices:
        first.setdefault(choice.text, choice)
    return first.values()
