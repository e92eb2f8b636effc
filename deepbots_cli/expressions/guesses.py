"""What to write instead of a piece of an expression, made of that piece: good guesses, which nothing makes certain."""

from __future__ import annotations

import re

from deepbots_cli.expressions import syntax
from deepbots_cli.expressions.dimensions import Dimension
from deepbots_cli.expressions.typed import Invocation, Operation, Typed
from deepbots_cli.expressions.types import Rewriting

_SUMS = frozenset({"add", "sub"})
_NUMBER = r"[-+]?[0-9.][0-9_.]*(?:[eE][-+]?[0-9]+)?"
_LITERAL = re.compile(rf"({_NUMBER}(?:\s+{_NUMBER})*)\s*([A-Za-z%][\w*/^%-]*)?")


def swapped(low: Typed | syntax.Node, high: Typed | syntax.Node) -> Rewriting:
    """The ends of a range the other way round; a unit that stands behind the last of them goes behind the new last one."""
    start, middle, end = low.start, low.end - low.start, high.start - low.start

    def rewriting(piece: str) -> str:
        first, between, last = piece[:middle], piece[middle:end], piece[end : high.end - start]
        bare, united = _LITERAL.fullmatch(first), _LITERAL.fullmatch(last)
        if bare and united and united[2] and not bare[2]:
            return f"{united[1]}{between}{first} {united[2]}"
        return f"{last}{between}{first}"

    return rewriting


def divided(value: Typed, dimension: Dimension) -> Rewriting:
    """The value over a unit of its dimension; of `a when c` it is `a` that is divided."""
    part = _amount(value)

    def rewriting(piece: str) -> str:
        before, inner, after = _split(piece, value, part)
        return f"{before}{_factor(inner, part)} / {over(dimension)}{after}"

    return rewriting


def over(dimension: Dimension) -> str:
    """The unit of a dimension as a divisor."""
    unit = str(dimension)
    return f"({unit})" if "/" in unit or "*" in unit else unit


def negated(value: Typed) -> Rewriting:
    """The value with its sign turned: a minus goes or comes, and a difference is taken the other way round."""
    part = _amount(value)

    def rewriting(piece: str) -> str:
        before, inner, after = _split(piece, value, part)
        return f"{before}{_turned(inner, part)}{after}"

    return rewriting


def _turned(text: str, value: Typed) -> str:
    if not _is_sum(value):
        return text[1:].lstrip() if text.startswith("-") else f"-{text}"
    assert isinstance(value, Operation)  # as any sum
    if value.operator == "add":
        return f"-({text})"
    left, right = (text[part.start - value.start : part.end - value.start] for part in value.args)
    between = text[len(left) : len(text) - len(right)]
    return f"{right}{between}{_factor(left, value.args[0])}"


def _amount(value: Typed) -> Typed:
    """What `a when c` gives where the condition holds; any other value itself."""
    is_when = isinstance(value, Invocation) and value.function == "where" and value.args[1].start == value.start
    return value.args[1] if is_when and isinstance(value, Invocation) else value


def _split(piece: str, whole: Typed, part: Typed) -> tuple[str, str, str]:
    start, end = part.start - whole.start, part.end - whole.start
    return piece[:start], piece[start:end], piece[end:]


def _factor(text: str, value: Typed) -> str:
    return f"({text})" if _is_sum(value) else text


def _is_sum(value: Typed) -> bool:
    """Whether it is a sum or a difference without parentheses around it, which a node counts as its own."""
    return isinstance(value, Operation) and value.operator in _SUMS and value.args[0].start == value.start
