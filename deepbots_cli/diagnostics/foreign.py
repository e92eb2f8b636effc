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
_SIDE = r"(?:[^?:()]|\((?:[^?:()]|\([^?:()]*\))*\))+?"
_TERNARY = re.compile(
    rf"\s*(?P<left>\()?\s*(?P<open>{_SIDE})\s*\?\s*(?P<value>{_SIDE})\s*:\s*(?P<otherwise>{_SIDE})\s*"
    r"(?P<right>(?(left)\)))\s*"
)
_BARS = re.compile(r"\|([^|]+)\|")
_MAX_LENGTH = 200


def conditional(text: str) -> str | None:
    """Return `a if c else b` for `if (c) a else b`, `if c: a else: b` or `c ? a : b`; None for any other
    text."""
    if len(text) > _MAX_LENGTH:
        return None
    match = _IF.fullmatch(text) or _TERNARY.fullmatch(text)
    if match is None:
        return None
    condition = match.groupdict().get("group") or match["open"]
    left, right = (match.groupdict().get(side) or "" for side in ("left", "right"))
    return f"{left}{match['value']} if {condition.strip()} else {match['otherwise']}{right}"


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
