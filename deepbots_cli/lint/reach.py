"""How far values reach: intervals of scalar trees, sharper than those of their types.

A type knows an expression apart from where it stands. Here names are followed to their definitions, component by component,
and leaves are narrowed by what a scenario says of its episodes: their limits, their start, which endings hold. Truth values
are 0 and 1, so that [0, 0] is never true and [1, 1] always. What is infinite is not known.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from types import MappingProxyType

from deepbots_cli.expressions import intervals as iv
from deepbots_cli.expressions.functions import FUNCTIONS, operation
from deepbots_cli.expressions.intervals import EVERYTHING, INF, TRUTH, Interval, exact, hull
from deepbots_cli.expressions.scalar import Const, Draw, Name, Op, Scalar, State, World
from deepbots_cli.lint.meaning import Book

NEVER, ALWAYS = iv.NEVER, iv.ALWAYS
_MANY = 64
"""Conditions that are held against each other."""
_NOTHING: Mapping[str, Interval] = MappingProxyType({})


class Reach:
    """What values can be in the given steps of an episode, where the names in `given` have these values."""

    def __init__(self, book: Book, given: Mapping[str, Interval] = _NOTHING, steps: tuple[float, float] | None = None) -> None:
        self.book = book
        first, last = steps or (0.0, float(book.last))
        before = max(0.0, first - 1.0) * book.period + (book.program.world.timestep if first else 0.0)
        self._time = Interval(before, last * book.period)
        self.given = {"step": Interval(first, last), "time": self._time, **given}
        self._known: dict[Name, Interval] = {}
        self._seen: dict[int, tuple[Scalar, Interval]] = {}

    def of(self, node: Scalar) -> Interval:
        # Rules ask for the same trees over and over. By identity, since to hash a tree is to walk it; a tree that is kept keeps its id.
        seen = self._seen.get(id(node))
        if seen is None:
            seen = self._seen[id(node)] = (node, self._of(node))
        return seen[1]

    def _of(self, node: Scalar) -> Interval:
        if isinstance(node, Op):
            return self._op(node.op, node.args)
        if isinstance(node, Const):
            return exact(float(node.value))
        match node:
            case Name():
                return self._name(node)
            case World():
                return self._world(node)
            case State():
                return self._state(node)
            case Draw(distribution, args):
                return FUNCTIONS[distribution].interval(*(self.of(arg) for arg in args))

    def _name(self, node: Name) -> Interval:
        if node.name in self.given:
            return self.given[node.name]
        if node not in self._known:
            meaning = self.book.meaning(node)
            self._known[node] = self._clipped(node, self._leaf(meaning) if isinstance(meaning, Name) else self.of(meaning))
        return self._known[node]

    def _clipped(self, node: Name, known: Interval) -> Interval:
        """Of a goal, what is left of it within its range."""
        goal = self.book.program.goal
        if goal is None or node.name not in ("achieved", "desired"):
            return known
        names = goal.achieved.components or (None,)
        at = names.index(node.component) if node.component in names else 0
        return iv.clamped(known, exact(goal.low[at]), exact(goal.high[at]))

    def _leaf(self, node: Name) -> Interval:
        if node.name in self.given:
            return self.given[node.name]
        if self.book.is_noisy(node.name):
            return EVERYTHING
        foreign = self.book.named(node.name)
        return foreign.typed.type.interval if foreign is not None else self.book.leaves.get(node.name, EVERYTHING)

    def _world(self, node: World) -> Interval:
        """What is so of a fact wherever and whenever it is asked for."""
        if node.function == "joint_position":
            return self._travel(node.subjects[0])
        if node.function in ("contact", "collided") and not self.book.marks.isdisjoint(node.subjects):
            return NEVER
        function = FUNCTIONS.get(node.function)
        if function is None or function.boolean:
            return TRUTH
        return function.interval()

    def _travel(self, joint: str) -> Interval:
        """Between the stops of a joint."""
        robot, _, name = joint.partition(".")
        model = next(body.model for body in self.book.program.world.robots if body.name == robot)
        limit = model.joint(name).limit
        return EVERYTHING if limit.lower is None or limit.upper is None else Interval(limit.lower, limit.upper)

    def _state(self, node: State) -> Interval:
        args = [self.of(arg) for arg in node.args]
        match node.function:
            case "duration":
                return NEVER if args[0] == NEVER else Interval(0.0, self._time.high)
            case "integral":
                return hull((NEVER, iv.multiply(args[0], Interval(0.0, self._time.high))))
            case "rising":
                return NEVER if args[0] == NEVER else TRUTH
            case function:
                return FUNCTIONS[function].interval(*args)

    def _op(self, op: str, args: Sequence[Scalar]) -> Interval:
        if op == "where":
            condition = self.of(args[0])
            chosen = args[1:2] if condition.low > 0.0 else args[2:] if condition.high <= 0.0 else args[1:]
            return hull([self.of(arg) for arg in chosen])
        if op == "mul" and args[0] == args[1]:
            return iv.power(self.of(args[0]), exact(2.0))
        if op == "sub" and self.book.identity(args[0]) == self.book.identity(args[1]):
            return NEVER
        if op == "and" and self._is_contradictory(args):
            return NEVER
        values = [self.of(arg) for arg in args]
        return operation(op).interval(*values)

    def _is_contradictory(self, conditions: Sequence[Scalar]) -> bool:
        """Whether one quantity would have to be above and below: `x > 20 cm and x < 10 cm`."""
        within: dict[int, Interval] = {}
        for quantity, asked in self._asked(conditions):
            known = within.get(quantity, EVERYTHING)
            low, high = max(known.low, asked.low), min(known.high, asked.high)
            if low > high:
                return True
            within[quantity] = Interval(low, high)
        return False

    def _asked(self, conditions: Sequence[Scalar]) -> Iterator[tuple[int, Interval]]:
        """Within what each quantity must lie for all these conditions to hold; of very many only the first count."""
        met: set[int] = set()
        waiting = list(conditions)
        while waiting and len(met) < _MANY:
            condition = self.book.meaning(waiting.pop())
            if self.book.identity(condition) in met:
                continue
            met.add(self.book.identity(condition))
            match condition:
                case Op("and", parts):
                    waiting += parts
                case Op("less" | "less_equal", (small, large)) | Op("greater" | "greater_equal", (large, small)):
                    most = self.of(large).high
                    most = math.nextafter(most, -INF) if condition.op in ("less", "greater") else most
                    yield self.book.identity(small), Interval(-INF, most)
                    if isinstance(inner := self.book.meaning(small), Op) and inner.op == "abs":
                        yield self.book.identity(inner.args[0]), Interval(-most, most)
                    yield self.book.identity(large), Interval(self.of(small).low, INF)


class Kept(Reach):
    """What values are where a quantity stays within `kept`."""

    def __init__(self, there: Reach, quantity: int, kept: Interval) -> None:
        super().__init__(there.book, there.given)
        self._time = there._time
        self._quantity = quantity
        self._kept = kept

    def _of(self, node: Scalar) -> Interval:
        return self._kept if self.book.identity(node) == self._quantity else super()._of(node)


@lru_cache(maxsize=16)
def reach_of(book: Book, steps: tuple[float, float] | None = None) -> Reach:
    """How far values reach in the given steps, for all rules that ask no more."""
    return Reach(book) if steps is None else Supposing(book, _NOTHING, steps)


class Supposing(Reach):
    """What values are in these steps if the names in `given` have these values.

    What neither has a part in is worked out once, whatever is supposed.
    """

    def __init__(self, book: Book, given: Mapping[str, Interval], steps: tuple[float, float]) -> None:
        super().__init__(book, given, steps)
        self._anyhow = reach_of(book)

    def _of(self, node: Scalar) -> Interval:
        return self._anyhow.of(node) if self.book.names_behind(node).isdisjoint(self.given) else super()._of(node)
