"""Thresholds in conditions: `abs(x) > 0.4 m` needs x above 0.4 m, or below -0.4 m. Which ending always holds before another."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, NamedTuple

from deepbots_cli.expressions import intervals as iv
from deepbots_cli.expressions.dimensions import Dimension
from deepbots_cli.expressions.intervals import ALWAYS, INF, Interval
from deepbots_cli.expressions.scalar import Const, Name, Op, Scalar, State, World
from deepbots_cli.expressions.types import Stage
from deepbots_cli.lint.ranges import Ranges
from deepbots_cli.program.task import Ending
from deepbots_cli.program.values import Expression

if TYPE_CHECKING:
    from deepbots_cli.lint.analysis import Analysis, Comparison

FOLLOWING = frozenset({"running_max", "running_min", "smooth", "hold"})
"""Functions with a memory that rise with their argument."""
_CLOCK = frozenset({"time", "step", "episode_return", "previous_reward"})
_MARGIN = 0.02
"""By this share of its limit another ending has to hold first: a value may pass both limits within a step."""
_MAX_ENDINGS = 32
"""With more endings, not all pairs are compared."""
_GRADUAL = frozenset({"position", "orientation", "joint_position", "gap", "beside", "along"})
"""Facts that do not jump, unlike speeds and forces when bodies collide."""


class Threshold(NamedTuple):
    """A condition needs `quantity` above (or below) some value in `bound`; `dimension` is None where it is unknown.

    `now` is false where the condition may hold without: `running_max(x) > 1 m` holds for ever after, and `abs(x) > 1 m` needs one of
    two things.
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


def is_clock(analysis: Analysis, quantity: Scalar) -> bool:
    """Whether a quantity is the time or the return, which advance by themselves."""
    meaning = analysis.meaning(quantity)
    return isinstance(meaning, Name) and meaning.name in _CLOCK


def has_choice(analysis: Analysis, condition: Expression) -> bool:
    """Whether one part of a condition may hold without the others."""
    met: set[int] = set()
    waiting = [analysis.scalars(condition)[0]]
    while waiting:
        node = analysis.meaning(waiting.pop())
        if isinstance(node, Op) and node.op == "or":
            return True
        if isinstance(node, Op) and node.op == "and" and analysis.identity(node) not in met:
            met.add(analysis.identity(node))
            waiting += node.args
    return False


def thresholds(comparison: Comparison, ranges: Ranges) -> Iterator[Threshold]:
    """What a comparison needs of each quantity that its sides are made of, for each component."""
    analysis, node = ranges.analysis, comparison.node
    left, right = (analysis.lowered(arg, comparison.value.owner) for arg in node.args)
    count = max(len(left), len(right))
    rising = node.operator.startswith("greater")
    dimension = node.args[0].type.dimension
    for a, b in zip(left * (count // len(left)), right * (count // len(right)), strict=True):
        for side, other, typed, above in ((a, b, node.args[0], rising), (b, a, node.args[1], not rising)):
            bound = ranges.of(other)
            if bound.finite and typed.type.stage is Stage.STEP:
                yield from _derived(Threshold(side, above, bound, dimension), ranges)


def _derived(asked: Threshold, ranges: Ranges) -> Iterator[Threshold]:
    """A threshold, and those of the quantities that its quantity is made of."""
    yield asked
    meaning = ranges.analysis.meaning(asked.quantity)
    match meaning:
        case Op("abs", (inner,)) if asked.above or ranges.of(inner).low >= 0.0:
            now = asked.now and ranges.of(inner).low >= 0.0
            yield from _derived(asked._replace(quantity=inner, now=now), ranges)
            if asked.above:
                yield from _derived(Threshold(inner, False, iv.negate(asked.bound), asked.dimension, False), ranges)
        case Op("neg", (inner,)):
            yield from _derived(asked._replace(quantity=inner, above=not asked.above, bound=iv.negate(asked.bound)), ranges)
        case Op("add" | "sub" | "mul" | "div" as op, (a, b)):
            yield from _solved(op, a, b, asked, ranges)
        case State(function, (inner, *_)) if function in FOLLOWING:
            yield from _derived(asked._replace(quantity=inner, now=False), ranges)
        case Name() if meaning != asked.quantity:
            yield asked._replace(quantity=meaning)


def _solved(op: str, a: Scalar, b: Scalar, asked: Threshold, ranges: Ranges) -> Iterator[Threshold]:
    """`a + b > c` needs a > c - b, where b is known."""
    known, unknown = (ranges.of(b), a) if ranges.of(b).finite else (ranges.of(a), b)
    if not known.finite or ranges.of(unknown).single:
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
        case _:
            solve = iv.divide if op == "mul" else iv.multiply
            bound, above = solve(asked.bound, known), above == (known.low > 0.0)
    dimension = asked.dimension if op in ("add", "sub") else None
    yield from _derived(Threshold(unknown, above, bound, dimension, asked.now), ranges)


def shadowed(analysis: Analysis) -> Mapping[Ending, Ending]:
    """Endings that have no effect, each with the ending that always holds first: `abs(x) > 45 cm` after `abs(x) > 39 cm`.

    A failure has precedence over a success, so a failure behind a success still counts.
    """
    program, ranges = analysis.program, analysis.ranges_in(0.0, INF)
    own = [ending for ending in program.endings if ending.foreign is None and not ranges.of(analysis.scalars(ending.value)[0]).single]
    found: dict[Ending, Ending] = {}
    for late in own if 1 < len(own) <= _MAX_ENDINGS else ():
        others = [other for other in own if other is not late and late.outcome in (other.outcome, "success")]
        if not others or has_choice(analysis, late.value):
            continue
        for comparison in analysis.comparisons(late.value):
            for asked in thresholds(comparison, ranges):
                if not asked.now or not _is_gradual(analysis, asked.quantity):
                    continue
                ahead = asked.limit - (1.0 if asked.above else -1.0) * _MARGIN * abs(asked.limit)
                there = ranges.where(analysis.identity(asked.quantity), Interval(ahead, INF) if asked.above else Interval(-INF, ahead))
                first = next((other for other in others if there.of(analysis.scalars(other.value)[0]) == ALWAYS), None)
                if first is not None:
                    found.setdefault(late, first)
    return found


def _is_gradual(analysis: Analysis, quantity: Scalar) -> bool:
    parameters = {value.name for value in analysis.program.parameters}
    for node in analysis.unfold(quantity):
        match node:
            case World(function) if function in _GRADUAL:
                continue
            case Name(name) if name in parameters or is_clock(analysis, node):
                continue
            case Const() | Op():
                continue
            case _:
                return False
    return True
