"""Beyond which value of a quantity a condition can hold: `abs(x) > 0.4 m` asks for x above 0.4 m, or below -0.4 m."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from deepbots_cli.expressions import intervals as iv
from deepbots_cli.expressions.dimensions import Dimension
from deepbots_cli.expressions.intervals import Interval
from deepbots_cli.expressions.scalar import Name, Op, Scalar, State
from deepbots_cli.expressions.types import Stage
from deepbots_cli.lint.meaning import Book, Comparison
from deepbots_cli.lint.reach import Reach
from deepbots_cli.program.values import Expression

FOLLOWING = frozenset({"running_max", "running_min", "smooth", "hold"})
"""Functions with a memory that rise where their argument does."""


_CLOCK = frozenset({"time", "step", "episode_return", "previous_reward"})


class Threshold(NamedTuple):
    """The condition needs `quantity` above (or below) some value in `bound`; `dimension` None where that is not known.

    `now` is false where it may hold without: after `running_max(x) > 1 m` did once, x may be anything, and `abs(x) > 1 m` asks for
    one of two things.
    """

    quantity: Scalar
    above: bool
    bound: Interval
    dimension: Dimension | None = None
    now: bool = True

    @property
    def limit(self) -> float:
        """The first value of the quantity at which the condition may hold."""
        return self.bound.low if self.above else self.bound.high


def is_clock(book: Book, quantity: Scalar) -> bool:
    """Whether it is the time or the account, which go on by themselves."""
    meaning = book.meaning(quantity)
    return isinstance(meaning, Name) and meaning.name in _CLOCK


def thresholds(comparison: Comparison, book: Book, reach: Reach) -> Iterator[Threshold]:
    """What a comparison asks of each quantity that either side is made of, for each component."""
    node = comparison.node
    left, right = (book.lowered(arg, comparison.value.owner) for arg in node.args)
    count = max(len(left), len(right))
    rising = node.operator.startswith("greater")
    dimension = node.args[0].type.dimension
    for a, b in zip(left * (count // len(left)), right * (count // len(right)), strict=True):
        for side, other, typed, above in ((a, b, node.args[0], rising), (b, a, node.args[1], not rising)):
            bound = reach.of(other)
            if bound.finite and typed.type.stage is Stage.STEP:
                yield from _asked(Threshold(side, above, bound, dimension), book, reach)


def has_choice(book: Book, condition: Expression) -> bool:
    """Whether one part of the condition may hold without the others."""
    met: set[int] = set()
    waiting = [book.scalars(condition)[0]]
    while waiting:
        node = book.meaning(waiting.pop())
        if isinstance(node, Op) and node.op == "or":
            return True
        if isinstance(node, Op) and node.op == "and" and book.identity(node) not in met:
            met.add(book.identity(node))
            waiting += node.args
    return False


def _asked(asked: Threshold, book: Book, reach: Reach) -> Iterator[Threshold]:
    """What is asked of a side, and of what that is made of."""
    yield asked
    meaning = book.meaning(asked.quantity)
    match meaning:
        case Op("abs", (inner,)) if asked.above or reach.of(inner).low >= 0.0:
            surely = asked.now and reach.of(inner).low >= 0.0
            yield from _asked(asked._replace(quantity=inner, now=surely), book, reach)
            if asked.above:
                yield from _asked(Threshold(inner, False, iv.negate(asked.bound), asked.dimension, False), book, reach)
        case Op("neg", (inner,)):
            yield from _asked(asked._replace(quantity=inner, above=not asked.above, bound=iv.negate(asked.bound)), book, reach)
        case Op("add" | "sub" | "mul" | "div" as op, (a, b)):
            yield from _balanced(op, a, b, asked, book, reach)
        case State(function, (inner, *_)) if function in FOLLOWING:
            yield from _asked(asked._replace(quantity=inner, now=False), book, reach)
        case Name() if meaning != asked.quantity:
            yield asked._replace(quantity=meaning)
        case _:
            return


def _balanced(op: str, a: Scalar, b: Scalar, asked: Threshold, book: Book, reach: Reach) -> Iterator[Threshold]:
    """`a + b > c` asks a > c - b, where b is known."""
    known, unknown = (reach.of(b), a) if reach.of(b).finite else (reach.of(a), b)
    if not known.finite or reach.of(unknown).single:
        return
    if op in ("mul", "div") and (known.low <= 0.0 <= known.high or (op == "div" and unknown is b)):
        return
    above = asked.above
    match op:
        case "add":
            bound = iv.subtract(asked.bound, known)
        case "sub" if unknown is a:
            bound = iv.add(asked.bound, known)
        case "sub":
            bound, above = iv.subtract(known, asked.bound), not above
        case "mul":
            bound, above = iv.divide(asked.bound, known), above == (known.low > 0.0)
        case _:
            bound, above = iv.multiply(asked.bound, known), above == (known.low > 0.0)
    dimension = asked.dimension if op in ("add", "sub") else None
    yield from _asked(Threshold(unknown, above, bound, dimension, asked.now), book, reach)
