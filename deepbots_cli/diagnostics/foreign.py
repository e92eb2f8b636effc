"""Expressions of other languages, recognized by their form (conditionals, absolute values, calls with a dot)
and translated."""

from __future__ import annotations

import re

MODULES = frozenset({"math", "np", "numpy", "torch", "jnp", "std", "Math"})
"""Modules through which other languages call functions that have no prefix here."""

_GROUP = r"[^()]*(?:\([^()]*\)[^()]*)*"
_IF = re.compile(
    rf"\s*if\s*(?:\((?P<group>{_GROUP})\)|(?P<open>[^:{{}}]+?)(?=\s*(?::|\bthen\b)))\s*(?::|\bthen\b)?\s*"
    r"(?:\{\s*)?(?P<value>[^{}:;]+?)\s*;?\s*\}?\s*\belse\b\s*:?\s*"
    r"(?:\{\s*)?(?P<otherwise>[^{}:;]+?)\s*;?\s*\}?\s*"
)
_TERNARY = re.compile(r"\s*(?P<open>[^?:]+?)\s*\?\s*(?P<value>[^?:]+?)\s*:\s*(?P<otherwise>[^?:]+?)\s*")
_ENCLOSED = re.compile(rf"\s*\({_GROUP}\)\s*")
_BARS = re.compile(r"\|([^|]+)\|")
_MAX_LENGTH = 200


def conditional(text: str) -> str | None:
    """Return `a if c else b` for `if (c) a else b`, `if c: a else: b` or `c ? a : b`; None for any other
    text."""
    if len(text) > _MAX_LENGTH:
        return None
    if _ENCLOSED.fullmatch(text):
        inner = conditional(text.strip()[1:-1])
        return inner and f"({inner})"
    match = _IF.fullmatch(text) or _TERNARY.fullmatch(text)
    if match is None:
        return None
    condition = match.groupdict().get("group") or match["open"]
    parts = (match["value"], condition.strip(), match["otherwise"])
    if any(part.count("(") != part.count(")") for part in parts):
        return None
    return "{} if {} else {}".format(*parts)


def without_bars(text: str) -> str | None:
    """Return the text with `abs(x)` for each `|x|`; None if the text has none."""
    if len(text) > _MAX_LENGTH or not _BARS.search(text):
        return None
    return _BARS.sub(lambda match: f"abs({match[1].strip()})", text)


def call(names: tuple[str, ...]) -> str:
    """Return the call that `math.cos(` or `cart.velocity(` begins, by the dotted names before its
    parenthesis."""
    *owner, function = names
    return f"{function}(...)" if owner[0] in MODULES else f"{function}({'.'.join(owner)})"
