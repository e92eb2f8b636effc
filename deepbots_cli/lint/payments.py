"""What the reward is worth: in a step of an episode that goes on, and in the step that ends it, by term."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

from deepbots_cli.compiler import Checked
from deepbots_cli.expressions import intervals as iv
from deepbots_cli.expressions.intervals import Interval
from deepbots_cli.expressions.scalar import Scalar
from deepbots_cli.lint.meaning import book_of
from deepbots_cli.lint.reach import ALWAYS, NEVER, Reach, Supposing
from deepbots_cli.program import Program
from deepbots_cli.program.task import Ending
from deepbots_cli.program.values import Expression


class Payments:
    """The terms of a reward whose values can be known. `is_whole` says that these are all."""

    def __init__(self, program: Program) -> None:
        self.program = program
        self.book = book_of(program)
        self.terms = tuple((term, self.book.scalars(term)[0]) for term in program.reward if term.foreign is None)
        self.is_whole = len(self.terms) == len(program.reward)
        self._steps = (1.0, float(self.book.last))
        self._running: dict[tuple[float, float], Reach] = {}
        self._at = {ending: Supposing(self.book, self._holding(ending, ending is None), self._steps) for ending in (*program.endings, None)}

    def running(self, steps: tuple[float, float] | None = None) -> Reach:
        """In a step that ends nothing."""
        steps = steps or self._steps
        if steps not in self._running:
            self._running[steps] = Supposing(self.book, self._holding(None, False), steps)
        return self._running[steps]

    def at(self, ending: Ending | None) -> Reach:
        """In the step in which this ending holds, and no other; None for the limit that cuts an episode short."""
        return self._at[ending]

    def _holding(self, ending: Ending | None, truncated: bool) -> dict[str, Interval]:
        holds = {entry.value.name: ALWAYS if entry is ending else NEVER for entry in self.program.endings}
        flags = {"terminated": ending is not None, "truncated": truncated, "ended": truncated or ending is not None}
        return holds | {name: ALWAYS if flag else NEVER for name, flag in flags.items()}

    def split(self) -> tuple[list[tuple[Expression, Scalar]], list[tuple[Expression, Scalar]]]:
        """The terms that are paid in ordinary steps, and those that are paid by endings and limits alone."""
        running = self.running()
        ordinary: list[tuple[Expression, Scalar]] = []
        final: list[tuple[Expression, Scalar]] = []
        for term, node in self.terms:
            (final if running.of(node) == NEVER and self._is_paid_at_an_end(node) else ordinary).append((term, node))
        return ordinary, final

    def _is_paid_at_an_end(self, node: Scalar) -> bool:
        return any(self.at(ending).of(node) != NEVER for ending in (*self.program.endings, None))

    @staticmethod
    def total(terms: list[tuple[Expression, Scalar]], reach: Reach) -> Interval:
        """Of one step."""
        found = NEVER
        for _, node in terms:
            found = iv.add(found, reach.of(node))
        return found


@lru_cache(maxsize=4)
def payments_of(program: Program) -> Payments:
    """What the reward of a task is worth, for all rules that ask."""
    return Payments(program)


def versions(checked: Checked) -> Iterator[Program]:
    """The task, and what it is in each case and each stage."""
    if checked.program is not None:
        yield checked.program
        yield from (case.program for case in checked.program.cases)
        yield from (stage.program for stage in checked.program.curriculum)
