"""The word that was probably meant."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice

# A file of thousands of names and thousands of misspellings would take minutes otherwise.
_COMPARED = 300
_LONGEST = 64


def nearest(word: str, known: Iterable[str], cutoff: float = 0.6) -> str | None:
    """The one of the `known` words that is most like `word`, whatever its case; None where none is."""
    from difflib import get_close_matches  # only on the way to a message: its import costs 4 ms

    by_lower = {name.lower(): name for name in islice(known, _COMPARED)}
    close = get_close_matches(word[:_LONGEST].lower(), by_lower, 1, cutoff)
    return by_lower[close[0]] if close else None
