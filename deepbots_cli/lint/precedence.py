"""Which ending always finds another one there before it: `abs(x) > 45 cm` where `abs(x) > 39 cm` has ended the episode."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

from deepbots_cli.expressions.intervals import INF, Interval
from deepbots_cli.expressions.scalar import Const, Name, Op, Scalar, World
from deepbots_cli.lint.meaning import Book, book_of
from deepbots_cli.lint.reach import ALWAYS, Kept, reach_of
from deepbots_cli.lint.thresholds import has_choice, is_clock, thresholds
from deepbots_cli.program import Program
from deepbots_cli.program.task import Ending

_BEFORE = 0.02
"""How far ahead of its limit, as a share of that, another ending has to hold: a value may pass both within a tick."""
_MANY = 32
"""Of more endings not each is held against each other."""
_GRADUAL = frozenset({"position", "orientation", "joint_position", "gap", "beside", "along"})
"""Facts that do not jump, as speeds and forces do when bodies meet."""


@lru_cache(maxsize=4)
def forestalled(program: Program) -> Mapping[Ending, Ending]:
    """Endings that have no effect, each with the one that holds already when it could.

    A failure beats a success, so that one behind a success is not meant.
    """
    book = book_of(program)
    reach = reach_of(book, (0.0, INF))
    own = [ending for ending in program.endings if ending.value.foreign is None and not reach.of(book.scalars(ending.value)[0]).single]
    found: dict[Ending, Ending] = {}
    for late in own if 1 < len(own) <= _MANY else ():
        others = [other for other in own if other is not late and late.outcome in (other.outcome, "success")]
        if not others or has_choice(book, late.value):
            continue
        for comparison in book.comparisons(late.value):
            for asked in thresholds(comparison, book, reach):
                if not asked.now or not _is_gradual(book, asked.quantity):
                    continue
                ahead = asked.limit - (1.0 if asked.above else -1.0) * _BEFORE * abs(asked.limit)
                there = Kept(reach, book.identity(asked.quantity), Interval(ahead, INF) if asked.above else Interval(-INF, ahead))
                first = next((other for other in others if there.of(book.scalars(other.value)[0]) == ALWAYS), None)
                if first is not None:
                    found.setdefault(late, first)
    return found


def _is_gradual(book: Book, quantity: Scalar) -> bool:
    parameters = {value.name for value in book.program.parameters}
    for node in book.unfold(quantity):
        match node:
            case World(function) if function in _GRADUAL:
                continue
            case Name(name) if name in parameters or is_clock(book, node):
                continue
            case Const() | Op():
                continue
            case _:
                return False
    return True
