"""Text to tokens, each with its offsets; the signs of other languages become tokens of their own, to be refused kindly."""

from __future__ import annotations

import re
from enum import Enum, auto
from typing import NamedTuple

MAX_LENGTH = 10_000


class TokenKind(Enum):
    NUMBER = auto()
    NAME = auto()
    SIGN = auto()
    STRANGE = auto()
    END = auto()


class Token(NamedTuple):
    kind: TokenKind
    text: str
    start: int
    end: int


# What YAML takes for a comment is gone by now; in a text of several lines (`|`) a comment is still there.
_TOKEN = re.compile(
    r"(?:\s++|#[^\n]*+)*+(?:"
    r"(?P<NUMBER>(?:\d+(?:_\d{3})*(?:\.\d+)?|\.\d+)(?:[eE][+-]?\d+)?)"
    r"|(?P<NAME>[A-Za-z_][A-Za-z0-9_]*)"
    r"|(?P<FOREIGN>\.{3,}+|\*\*|&&|\|\||->|=>|//|<>)"
    r"|(?P<SIGN>\.\.|\+-|<=|>=|==|!=|[-+*/^().,<>|%])"
    r"|(?P<STRANGE>.)"
    r"|$)",
    re.DOTALL | re.ASCII,
)
_KINDS = {
    "NUMBER": TokenKind.NUMBER,
    "NAME": TokenKind.NAME,
    "SIGN": TokenKind.SIGN,
    "FOREIGN": TokenKind.STRANGE,
    "STRANGE": TokenKind.STRANGE,
}


def tokens(text: str) -> list[Token]:
    """All tokens of `text`, closed by one END."""
    found: list[Token] = []
    position = 0
    while match := _TOKEN.match(text, position):
        kind = match.lastgroup
        if kind is None:
            break
        found.append(Token(_KINDS[kind], match[kind], match.start(kind), match.end()))
        position = match.end()
    end = len(text.rstrip())
    found.append(Token(TokenKind.END, "", end, end))
    return found
