"""What was meant: the candidate that is most like a misspelled word, and expressions of other languages,
recognized by their form (conditionals, absolute values, calls with a dot) and translated."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from itertools import islice
from typing import NamedTuple

# A file can hold thousands of names and thousands of misspellings.
_MAX_COMPARED = 300
_MAX_LENGTH = 64

_MIN_SLIP = 4
"""The least number of letters of a word in which one slip is recognized; `x` is one slip away from `y`."""
_MIN_PREFIX = 3
"""The least number of letters of a word that may be the beginning of a longer one, as `left` of
`left_hinge`."""


_LIKE = 0.5
"""The likeness from which a word comes before others in a shortened list."""
MAX_BESIDE = 8
"""The number of words up to which a message lists all of them beside one that is almost certainly meant."""


class Replacement(NamedTuple):
    """The text to write instead of a part of a text, and whether it is certain.

    With `at` it is inserted at this offset instead, and replaces nothing.
    """

    text: str
    safe: bool
    at: int | None = None


def nearest_word(word: str, candidates: Iterable[str], cutoff: float = 0.6) -> str | None:
    """Return the candidate most like `word`, ignoring case, or else the only one that begins with it; None
    if there is none."""
    from difflib import get_close_matches  # its import takes 4 ms, and only messages need it

    by_lower = {name.lower(): name for name in islice(candidates, _MAX_COMPARED)}
    close = get_close_matches(word[:_MAX_LENGTH].lower(), by_lower, 1, cutoff)
    if close:
        return by_lower[close[0]]
    longer = (
        [name for lower, name in by_lower.items() if lower.startswith(word.lower())]
        if len(word) >= _MIN_PREFIX
        else []
    )
    return longer[0] if len(longer) == 1 else None


def nearest_first(word: str, candidates: Iterable[str], limit: int) -> list[str]:
    """Return the candidates; of more than `limit`, those like `word` come first, so that a shortened list
    has them."""
    words = list(candidates)
    if len(words) <= limit or not word:
        return words
    from difflib import SequenceMatcher  # as above

    by_likeness = {
        name: SequenceMatcher(None, name[:_MAX_LENGTH].lower(), word[:_MAX_LENGTH].lower()).ratio()
        for name in words[:_MAX_COMPARED]
    }
    ordered = sorted(by_likeness, key=by_likeness.__getitem__, reverse=True)
    like = [name for name in ordered if by_likeness[name] >= _LIKE]
    return [*like, *(name for name in words if by_likeness.get(name, 0.0) < _LIKE)]


def did_you_mean(word: str, candidates: Iterable[str]) -> str:
    """Return ` (did you mean x?)` with the nearest of the candidates; empty if there is none."""
    return f" (did you mean {near}?)" if (near := nearest_word(word, candidates)) else ""


def suggest_replacement(
    word: str, candidates: Iterable[str], *, of_language: bool = False
) -> Replacement | None:
    """Return the nearest of the candidates as a replacement.

    It is certain only among words of the language (`of_language`), and only if exactly one of them is a slip
    away. Names that a user chose may differ by a letter on purpose (`left_1`, `left_2`). A component behind a
    misspelled name stays.
    """
    words = tuple(islice(candidates, _MAX_COMPARED))
    near = nearest_word(word, words)
    if near is None:
        return None
    head, _, component = word.rpartition(".")
    end = f".{component}" if is_typo(head, near) else ""
    return Replacement(
        f"{near}{end}", of_language and [other for other in words if is_typo(word, other)] == [near]
    )


def with_owner(name: str, names: Sequence[str]) -> Replacement | None:
    """Return `cart.speed.x` for `speed.x`, if one part alone has a `speed`."""
    first, dot, suffix = name.partition(".")
    longer = [full_name for full_name in names if full_name.endswith(f".{first}")]
    return Replacement(f"{longer[0]}{dot}{suffix}", safe=False) if len(longer) == 1 else None


def is_typo(word: str, other: str) -> bool:
    """Return whether two words differ only by case, by underscores, or by one letter: replaced, missing,
    added, or two swapped."""
    word, other = (text[:_MAX_LENGTH].lower().replace("_", "").replace("-", "") for text in (word, other))
    if word == other:
        return True
    short, long = sorted((word, other), key=len)
    if len(short) < _MIN_SLIP or len(long) - len(short) > 1:
        return False
    at = next((i for i, (a, b) in enumerate(zip(short, long, strict=False)) if a != b), len(short))
    if len(short) < len(long):
        return short[at:] == long[at + 1 :]
    return short[at + 1 :] == long[at + 1 :] or (
        short[at : at + 2] == long[at : at + 2][::-1] and short[at + 2 :] == long[at + 2 :]
    )


# Modules through which other languages call functions that have no prefix here.
MODULES = frozenset({"math", "np", "numpy", "torch", "jnp", "random", "std", "Math"})

_GROUP = r"[^()]*(?:\([^()]*\)[^()]*)*"
_IF = (
    rf"\s*if\s*(?:\((?P<group>{_GROUP})\)|(?P<open>[^:{{}}]+?)(?=\s*(?::|\bthen\b)))\s*(?::|\bthen\b)?\s*"
    r"(?:\{\s*)?(?P<value>(?:(?!\bthen\b)[^{}:;])+?)\s*;?\s*\}?\s*\belse\b\s*:?\s*"
    r"(?:\{\s*)?(?P<otherwise>[^{}:;]+?)\s*;?\s*\}?\s*"
)
_SIDE = r"(?:[^?:()]|\((?:[^?:()]|\([^?:()]*\))*\))+?"
_TERNARY = (
    rf"\s*(?P<left>\()?\s*(?P<open>{_SIDE})\s*\?\s*(?P<value>{_SIDE})\s*:\s*(?P<otherwise>{_SIDE})\s*"
    r"(?P<right>(?(left)\)))\s*"
)
_MAX_FOREIGN = 200


def as_conditional(text: str) -> str | None:
    """Return `a if c else b` for `if (c) a else b`, `if c: a else: b` or `c ? a : b`; None for any other
    text."""
    if len(text) > _MAX_FOREIGN:
        return None
    text = re.sub(r"\s*\|\|\s*", " or ", re.sub(r"\s*&&\s*", " and ", text))
    match = re.fullmatch(_IF, text) or re.fullmatch(_TERNARY, text)
    if match is None:
        return None
    condition = match.groupdict().get("group") or match["open"]
    left, right = (match.groupdict().get(side) or "" for side in ("left", "right"))
    return (
        f"{left}{match['value']} if {condition.strip()} else"
        f" {as_conditional(match['otherwise']) or match['otherwise']}{right}"
    )


def without_bars(text: str) -> str | None:
    """Return the text with `abs(x)` for each `|x|`, also within another; None without bars and for an odd
    one."""
    plain, *pieces = text.split("|") if len(text) <= _MAX_FOREIGN else [text]
    open_bars = 0
    for piece in pieces:
        ends_value = re.search(r"[\w.)\]](?<!\band)(?<!\bor)(?<!\bnot)(?<!\bif)(?<!\belse)\s*$", plain)
        plain = f"{plain.rstrip()}){piece}" if ends_value else f"{plain}abs({piece.lstrip()}"
        open_bars += -1 if ends_value else 1
        if open_bars < 0:
            return None
    return plain if pieces and not open_bars else None


# The help for functions of other languages.
FOREIGN_FUNCTION_HELP = {
    "random": "a draw is `uniform(low .. high)`, or `normal(mean +- std)`",
    "rand": "a draw is `uniform(low .. high)`",
    "randn": "a draw is `normal(mean +- std)`",
    "gauss": "a draw is `normal(mean +- std)`",
    "randint": "a draw of whole numbers is `integer(low .. high)`",
    "clip": "write `clamp(x, low .. high)`",
    "fabs": "write `abs(x)`",
    "maximum": "write `max(a, b)`",
    "minimum": "write `min(a, b)`",
    "tanh": "write `1 - 2 / (exp(2 * x) + 1)`",
    "pow": "a power is `a ^ b`",
    "square": "a power is `a ^ b`: `x ^ 2`",
    "radians": "write the unit: `30 deg`",
    "degrees": "divide by the unit: `angle / deg`",
}


def foreign_call(names: tuple[str, ...]) -> str:
    """Return the call that `math.cos(` or `cart.velocity(` begins, by the dotted names before its
    parenthesis."""
    return f"{names[-1]}({'...' if names[0] in MODULES else '.'.join(names[:-1])})"
