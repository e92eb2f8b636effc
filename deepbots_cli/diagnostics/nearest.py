"""The word that was probably meant."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice
from typing import NamedTuple

# A file of thousands of names and thousands of misspellings would take minutes otherwise.
_COMPARED = 300
_LONGEST = 64

_SHORTEST = 4
"""Letters that a word needs for one slip to be told from another word; `x` is one slip away from `y`."""

_BEGUN = 3
"""Letters from which on a word may be the beginning of the one that is meant: `left` of `left_hinge`."""


class Meant(NamedTuple):
    """What to write instead of a word or a sign, and whether nothing else can have been meant."""

    text: str
    safe: bool


def nearest(word: str, known: Iterable[str], cutoff: float = 0.6) -> str | None:
    """The one of the `known` words that is most like `word`, whatever its case, or the only one that begins so; None where none is."""
    from difflib import get_close_matches  # only on the way to a message: its import costs 4 ms

    by_lower = {name.lower(): name for name in islice(known, _COMPARED)}
    close = get_close_matches(word[:_LONGEST].lower(), by_lower, 1, cutoff)
    if close:
        return by_lower[close[0]]
    longer = [name for lower, name in by_lower.items() if lower.startswith(word.lower())] if len(word) >= _BEGUN else []
    return longer[0] if len(longer) == 1 else None


def meant(word: str, known: Iterable[str], *, ours: bool = False) -> Meant | None:
    """The nearest of the `known` words, as something to write.

    It is certain only among words of the language (`ours`), and only if no other of them is a slip away. Names that a
    user chose may be alike on purpose (`left_1`, `left_2`), and a misspelt one may be that of something still to be written.
    """
    words = tuple(islice(known, _COMPARED))
    near = nearest(word, words)
    if near is None:
        return None
    return Meant(near, ours and [other for other in words if is_slip(word, other)] == [near])


def is_slip(word: str, other: str) -> bool:
    """Whether the two differ by case or underscores alone, or by one letter: another, a missing, a further, or two swapped."""
    word, other = (text[:_LONGEST].lower().replace("_", "").replace("-", "") for text in (word, other))
    if word == other:
        return True
    short, long = sorted((word, other), key=len)
    if len(short) < _SHORTEST or len(long) - len(short) > 1:
        return False
    at = next((i for i, (a, b) in enumerate(zip(short, long, strict=False)) if a != b), len(short))
    if len(short) < len(long):
        return short[at:] == long[at + 1 :]
    return short[at + 1 :] == long[at + 1 :] or (short[at : at + 2] == long[at : at + 2][::-1] and short[at + 2 :] == long[at + 2 :])
