"""Where each character of a scalar stands in the file.

Quoting, folding and escapes change a text on its way from the file; a finding inside an expression must point at
what the user wrote. Folding only ever changes white space, so matching the visible characters in order is enough.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Callable, Iterator, Sequence
from functools import cache, partial

from deepbots_cli.document.nodes import Style

_ESCAPE = re.compile(r"\\(?:x[0-9A-Fa-f]{2}|u[0-9A-Fa-f]{4}|U[0-9A-Fa-f]{8}|\r\n|[\s\S])")
_NAMED = {"0": "\0", "a": "\a", "b": "\b", "t": "\t", "\t": "\t", "n": "\n", "v": "\v", "f": "\f", "r": "\r", "e": "\x1b"} | {
    "N": "\x85",
    "_": "\xa0",
    "L": "\u2028",
    "P": "\u2029",
}


def offsets(raw: str, start: int, text: str, style: Style) -> Callable[[], Sequence[int]] | None:
    """Gives the offset of each character of `text`, and of its end, in a file that holds `raw` at `start`.

    None if `text` stands there as it is.
    """
    if style == "plain" and raw == text:
        return None
    return cache(partial(_offsets, raw, start, text, style))


def _offsets(raw: str, start: int, text: str, style: Style) -> Sequence[int]:
    quotes = 1 if style in ("single", "double") else 0
    if quotes and raw[1:-1] == text:
        return range(start + 1, start + len(raw))
    body = raw.find("\n") + 1 if style in ("literal", "folded") else quotes
    end = len(raw) - quotes
    return array("Q", _matched(text, _Written(raw, body, end, style), start, end))


def _atoms(raw: str, position: int, end: int, style: Style) -> Iterator[tuple[int, str]]:
    """What was written, character by character, with escapes read."""
    while position < end:
        character, width = raw[position], 1
        if style == "single" and character == "'":
            width = 2
        elif style == "double" and character == "\\" and (escape := _ESCAPE.match(raw, position)):
            width = len(escape.group())
            character = _unescape(escape.group()[1:])
        if character:
            yield position, character
        position += width


def _unescape(escape: str) -> str:
    """The character of an escape without its backslash; empty for a line break, which joins two lines."""
    if len(escape) > 1 and escape[0] in "xuU":
        return chr(int(escape[1:], 16))
    return "" if escape in ("\n", "\r\n") else _NAMED.get(escape, escape)


class _Written:
    """The characters that were written, and their places in the text; kept in arrays, since a text may have a million."""

    def __init__(self, raw: str, position: int, end: int, style: Style) -> None:
        self.characters: list[str] = []
        self.places = array("Q")
        for place, character in _atoms(raw, position, end, style):
            self.characters.append(character)
            self.places.append(place)


def _matched(text: str, written: _Written, start: int, end: int) -> Iterator[int]:
    at, characters, places = 0, written.characters, written.places
    count = len(characters)
    for character in text:
        if not character.isspace():
            while at < count - 1 and characters[at] != character:
                at += 1
        yield start + (places[at] if at < count else end)
        if at < count and (not character.isspace() or characters[at].isspace()):
            at += 1
    yield start + (places[at] if at < count else end)
