"""Ways to write one text in YAML, each telling where every character of the text then stands.

Written from the YAML 1.2 specification and not from our reader, whose places they check.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Written:
    """`text` as it stands in the file; `places[i]` is the offset in it of character i of the value, and one
    more for the end.

    `head` goes to the end of the line of the key and `text` below it, where the value is a block; otherwise
    `head` is empty.
    """

    text: str
    places: tuple[int, ...]
    head: str = ""


@dataclass(frozen=True)
class Wish:
    """A value to write, the place of its fault in it, and the blanks that a line below it begins with."""

    value: str
    fault: int
    indent: str

    @property
    def break_at(self) -> int | None:
        """The last single blank before the fault: there a line may end."""
        at = self.value.rfind(" ", 0, self.fault)
        return at if at > 0 and self.value[at - 1] != " " else None


Style = Callable[[Wish], Written]


def _joined(pieces: Sequence[str], head: str = "") -> Written:
    """`pieces[0]` stands before the value, each further one for a character of it, the last behind it."""
    places = []
    offset = len(pieces[0])
    for piece in pieces[1:]:
        places.append(offset)
        offset += len(piece)
    return Written("".join(pieces), tuple(places), head)


def plain(wish: Wish) -> Written:
    return _joined(["", *wish.value, ""])


def single(wish: Wish) -> Written:
    return _joined(["'", *(letter * 2 if letter == "'" else letter for letter in wish.value), "'"])


def double(wish: Wish) -> Written:
    return _joined(['"', *("\\" + letter if letter in '\\"' else letter for letter in wish.value), '"'])


def escaped(wish: Wish) -> Written:
    """Every other character before the fault as an escape, in the three lengths in turn."""
    forms = ("\\x{:02x}", "\\u{:04x}", "\\U{:08x}")
    pieces = [
        forms[index // 2 % 3].format(ord(letter))
        if index < wish.fault and index % 2 == 0
        else "\\" + letter
        if letter in '\\"'
        else letter
        for index, letter in enumerate(wish.value)
    ]
    return _joined(['"', *pieces, '"'])


def breaks_escaped(wish: Wish) -> Written:
    """Blanks before the fault written as line feeds and tabs, which are escapes of one letter."""
    pieces = [
        ("\\n", "\\t")[index % 2] if index < wish.fault and letter == " " else letter
        for index, letter in enumerate(wish.value)
    ]
    return _joined(['"', *pieces, '"'])


def plain_over_lines(wish: Wish) -> Written:
    return _joined(["", *_broken(wish, f"\n{wish.indent}"), ""])


def double_over_lines(wish: Wish) -> Written:
    return _joined(['"', *_broken(wish, f"\n{wish.indent}"), '"'])


def double_continued(wish: Wish) -> Written:
    """A backslash at the end of the line keeps it from becoming a blank."""
    return _joined(['"', *_broken(wish, f" \\\n{wish.indent}"), '"'])


def folded(wish: Wish) -> Written:
    return _joined([wish.indent, *_broken(wish, f"\n{wish.indent}"), ""], head=">-")


def literal(wish: Wish) -> Written:
    return _joined([wish.indent, *_broken(wish, f"\n{wish.indent}"), ""], head="|-")


def literal_among_lines(wish: Wish) -> Written:
    """With lines more that hold nothing, and a deeper one."""
    return _joined([f"\n{wish.indent}", *_broken(wish, f"\n\n{wish.indent}  "), f"\n{wish.indent}"], head="|")


def _broken(wish: Wish, ending: str) -> list[str]:
    return [ending if index == wish.break_at else letter for index, letter in enumerate(wish.value)]


ANYWHERE: dict[str, Style] = {
    "plain": plain,
    "single-quoted": single,
    "double-quoted": double,
    "escaped": escaped,
    "breaks as escapes": breaks_escaped,
    "double-quoted over lines": double_over_lines,
    "double-quoted, continued": double_continued,
}
IN_BLOCKS: dict[str, Style] = {
    "plain over lines": plain_over_lines,
    "folded": folded,
    "literal": literal,
    "literal among lines": literal_among_lines,
}
OF_KEYS = ("plain", "single-quoted", "double-quoted", "escaped")
