"""The typed tree: an expression whose names, dimensions, shapes, intervals and stages are settled.

Every node holds its type and its place in the text, `[start, end)`.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from deepbots_cli.expressions.types import Subject, Symbol, Type
from deepbots_cli.expressions.units import Unit


class Constant(NamedTuple):
    """SI values, one per component; `unit` as written, None for bare numbers and truth values."""

    type: Type
    start: int
    end: int
    values: tuple[float | bool, ...]
    unit: Unit | None = None


class Reference(NamedTuple):
    """The value of a symbol."""

    type: Type
    start: int
    end: int
    symbol: Symbol


class Pick(NamedTuple):
    """Some components of a vector, by position."""

    type: Type
    start: int
    end: int
    value: Typed
    indices: tuple[int, ...]


class Operation(NamedTuple):
    """An operator applied elementwise: `add`, `less`, `and` ... (the names of `scalar.Op`)."""

    type: Type
    start: int
    end: int
    operator: str
    args: tuple[Typed, ...]


class Vector(NamedTuple):
    """Single values put together."""

    type: Type
    start: int
    end: int
    items: tuple[Typed, ...]


class Invocation(NamedTuple):
    """A function of the table; ranges and the like are flattened into `args`.

    `occurrence` counts the stateful calls and draws of one text, in its order; None for others.
    """

    type: Type
    start: int
    end: int
    function: str
    subjects: tuple[Subject, ...]
    args: tuple[Typed, ...]
    occurrence: int | None = None


Typed = Constant | Reference | Pick | Operation | Vector | Invocation


_DRAWS = ("uniform", "normal", "choice")


def bare(value: Typed) -> bool:
    """Whether this is made of numbers without units alone."""
    match value:
        case Constant(unit=unit):
            return unit is None and not value.type.boolean
        case Operation(args=parts) | Vector(items=parts):
            return not value.type.boolean and all(bare(part) for part in parts)
        case Invocation(function=function, args=parts) if function in _DRAWS:
            return all(bare(part) for part in parts)
        case _:
            return False


def zero(value: Typed) -> bool:
    """Whether this is a bare zero, which fits every dimension."""
    return isinstance(value, Constant) and bare(value) and not any(value.values)


class TypedRange(NamedTuple):
    """A range with both ends; they agree in dimension, and in components where both are vectors."""

    low: Typed
    high: Typed
    start: int
    end: int


class Redraw(NamedTuple):
    """How often the draws of an expression are repeated; `period` None means in each step."""

    period: Typed | None


def children(node: Typed) -> tuple[Typed, ...]:
    match node:
        case Constant() | Reference():  # first, since most are
            return ()
        case Pick(value=value):
            return (value,)
        case Operation(args=args) | Invocation(args=args):
            return args
        case Vector(items=items):
            return items


def walk(node: Typed) -> Iterator[Typed]:
    """Every node, each before its children."""
    yield node
    for child in children(node):
        yield from walk(child)
