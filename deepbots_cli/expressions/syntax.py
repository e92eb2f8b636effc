"""The syntax tree of an expression, before names have a meaning.

Every node knows its place in the text, `[start, end)`. Named tuples throughout the package: declaring
one takes 0.04 ms, a frozen dataclass 0.3 ms, and a linter starts often.
"""

from __future__ import annotations

from typing import NamedTuple

from deepbots_cli.expressions.units import Unit


class Number(NamedTuple):
    """A number as written, `value` in `unit`; None is a bare number."""

    start: int
    end: int
    value: float
    unit: Unit | None = None


class Truth(NamedTuple):
    start: int
    end: int
    value: bool


class Vector(NamedTuple):
    """Numbers side by side with one unit behind them, as `0 0 1 m`.

    A name may take the place of a number (`1 1 pole`); two items of which the second is a name are
    kept for the checker, which knows whether the name is a value or a misspelt unit.
    """

    start: int
    end: int
    items: tuple[Number | Name, ...]
    unit: Unit | None = None


class Name(NamedTuple):
    """A dotted name: `x`, `cart.pole_angle`, `epuck.proximity.ps0`."""

    start: int
    end: int
    parts: tuple[str, ...]

    @property
    def dotted(self) -> str:
        return ".".join(self.parts)


class Member(NamedTuple):
    """A component of something that is no name: `position(cart).x`."""

    start: int
    end: int
    value: Node
    member: str


class Unary(NamedTuple):
    """`-` or `not`."""

    start: int
    end: int
    operator: str
    operand: Node


class Binary(NamedTuple):
    start: int
    end: int
    operator: str
    left: Node
    right: Node


class Call(NamedTuple):
    """`name_end` closes the function's name, which begins at `start`."""

    start: int
    end: int
    function: str
    args: tuple[Node, ...]
    name_end: int


class Range(NamedTuple):
    """`low .. high`."""

    start: int
    end: int
    low: Node
    high: Node


class Spread(NamedTuple):
    """`mean +- deviation`."""

    start: int
    end: int
    mean: Node
    deviation: Node


class Options(NamedTuple):
    """`a | b | c`."""

    start: int
    end: int
    items: tuple[Node, ...]


class When(NamedTuple):
    """`value when condition`: the value, or zero."""

    start: int
    end: int
    value: Node
    condition: Node


class Redrawn(NamedTuple):
    """`value every period`, or `value each step` where `period` is None."""

    start: int
    end: int
    value: Node
    period: Node | None


Node = Number | Truth | Vector | Name | Member | Unary | Binary | Call | Range | Spread | Options | When | Redrawn


def children(node: Node) -> tuple[Node, ...]:
    """The nodes directly below `node`, in the order of the text."""
    match node:
        case Member(value=value):
            return (value,)
        case Unary(operand=operand):
            return (operand,)
        case Binary(left=left, right=right):
            return (left, right)
        case Call(args=args):
            return args
        case Range(low=low, high=high):
            return (low, high)
        case Spread(mean=mean, deviation=deviation):
            return (mean, deviation)
        case Options(items=items):
            return items
        case When(value=value, condition=condition):
            return (value, condition)
        case Redrawn(value=value, period=period):
            return (value,) if period is None else (value, period)
        case _:
            return ()


def depth(tree: Node) -> int:
    """The number of levels; without recursion, since a hostile text may have thousands."""
    levels = 0
    level: list[Node] = [tree]
    while level:
        levels += 1
        level = [child for node in level for child in children(node)]
    return levels
