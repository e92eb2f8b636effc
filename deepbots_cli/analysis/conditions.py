"""Conditions: the comparisons in them, the thresholds that these set for quantities, and endings that hide
others."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import NamedTuple

from deepbots_cli.analysis.ranges import RangeAnalysis, Ranges
from deepbots_cli.expressions import intervals as iv
from deepbots_cli.expressions.dimensions import Dimension
from deepbots_cli.expressions.functions import function_named
from deepbots_cli.expressions.intervals import ALWAYS, INF, Interval
from deepbots_cli.expressions.scalar import Const, EngineRead, Name, Op, Scalar, State
from deepbots_cli.expressions.types import INEQUALITIES, Invocation, Known, Operation, Reference, TypedNode
from deepbots_cli.program.values import Expression

ORDER_PRESERVING = frozenset({"running_max", "running_min", "low_pass", "hold"})
"""The functions with a memory that rise with their argument."""
_CLOCK_NAMES = frozenset({"time", "step", "episode_return", "previous_reward"})
_LEAD_SHARE = 0.05
"""The share of its limit by which an ending without precedence has to hold first: a value may pass both
limits within a step."""
_MAX_ENDINGS = 32
"""The number of endings up to which all pairs are compared."""
_CONTINUOUS_FUNCTIONS = frozenset(
    {"position", "orientation", "joint_position", "clearance", "cross_track_error", "arc_length"}
)
"""The facts that do not jump, unlike speeds and forces when bodies collide."""
_JUMPING_FUNCTIONS = frozenset({"atan2", "wrap", "where"})
"""The functions whose value may jump where their arguments do not, beside those with a truth value."""


class ConditionComparison(NamedTuple):
    """A comparison in a condition, and the named value whose text contains it."""

    value: Expression
    node: Operation


def comparisons(
    analysis: RangeAnalysis,
    condition: Expression,
    operators: Collection[str] = ("and", "or"),
    *,
    in_durations: bool = True,
) -> Iterator[ConditionComparison]:
    """Yield the comparisons of which at least one must hold for the condition to hold, or all with the
    operator `and` alone; with `in_durations`, also those within `duration(...)`.

    With the operator `or` alone and without durations, each of them alone makes the condition hold, as soon
    as it is true.
    """
    if condition.foreign is None:
        yield from _compared(analysis, condition, condition.typed, operators, in_durations, set())


def _compared(
    analysis: RangeAnalysis,
    value: Expression,
    node: TypedNode,
    operators: Collection[str],
    in_durations: bool,
    met: set[str],
) -> Iterator[ConditionComparison]:
    match node:
        case Operation(operator=operator) if operator in INEQUALITIES:
            long, short = node.args if node.operator.startswith("greater") else node.args[::-1]
            is_long = (
                in_durations
                and isinstance(long, Invocation)
                and long.function == "duration"
                and not isinstance(short, Invocation)
            )
            condition = long.args[0] if is_long and isinstance(long, Invocation) else None
            yield from (
                _compared(analysis, value, condition, operators, in_durations, met)
                if condition
                else (ConditionComparison(value, node),)
            )
        case Operation(operator=operator, args=args) if operator in operators:
            for arg in args:
                yield from _compared(analysis, value, arg, operators, in_durations, met)
        case Reference(symbol=symbol) if (
            value.owner not in analysis.robot_of
            and (definition := analysis.expression_named(symbol.name)) is not None
            and definition.typed.type.boolean
        ):
            if symbol.name not in met and definition.foreign is None:
                met.add(symbol.name)
                yield from _compared(analysis, definition, definition.typed, operators, in_durations, met)


def only_comparison(analysis: RangeAnalysis, condition: Expression) -> ConditionComparison | None:
    """Return the comparison that a condition is; None for a conjunction, a disjunction and others."""
    meaning = analysis.resolve_aliases(analysis.scalars(condition)[0])
    compared = list(comparisons(analysis, condition))
    return (
        compared[0] if len(compared) == 1 and isinstance(meaning, Op) and meaning.op in INEQUALITIES else None
    )


class Threshold(NamedTuple):
    """The requirement of a condition that `quantity` is above (or below) some value in `bound`; `dimension`
    is None if it is unknown.

    `now` is false if the condition may hold without the requirement at present: `running_max(x) > 1 m` holds
    for ever after. `one_of_two` is true for each requirement of `abs(x) > 1 m`, which needs only one of them.
    `decides` is false if the condition may fail while the quantity is beyond all of `bound`:
    `running_max(x) < 1 m` fails for ever after a larger x.
    """

    quantity: Scalar
    above: bool
    bound: Interval
    dimension: Dimension | None = None
    now: bool = True
    one_of_two: bool = False
    decides: bool = True

    @property
    def limit(self) -> float:
        """The first value of the quantity at which the condition may hold."""
        return self.bound.low if self.above else self.bound.high


def is_clock(analysis: RangeAnalysis, quantity: Scalar) -> bool:
    """Return whether a quantity is the time or the return, which advance by themselves."""
    meaning = analysis.resolve_aliases(quantity)
    return isinstance(meaning, Name) and meaning.name in _CLOCK_NAMES


def thresholds(comparison: ConditionComparison, ranges: Ranges) -> Iterator[Threshold]:
    """Yield the thresholds that a comparison sets for each quantity of its sides, for each component."""
    analysis = ranges.analysis
    node = comparison.node
    left, right = (analysis.lowered(arg, comparison.value.owner) for arg in node.args)
    count = max(len(left), len(right))
    rising = node.operator.startswith("greater")
    dimension = node.args[0].type.dimension
    # A single number is compared with each component of a vector.
    for a, b in zip(left * (count // len(left)), right * (count // len(right)), strict=True):
        for side, bound_side, typed, above in (
            (a, b, node.args[0], rising),
            (b, a, node.args[1], not rising),
        ):
            bound = ranges.of(bound_side)
            if bound.is_finite and typed.type.known is Known.STEP:
                yield from _derived(Threshold(side, above, bound, dimension), ranges)


def _derived(threshold: Threshold, ranges: Ranges) -> Iterator[Threshold]:
    """Yield a threshold, and the thresholds of the quantities that its quantity is made of."""
    yield threshold
    meaning = ranges.analysis.resolve_aliases(threshold.quantity)
    match meaning:
        case Op("abs", (inner,)) if threshold.above or ranges.of(inner).low >= 0.0:
            has_two_sides = ranges.of(inner).low < 0.0
            yield from _derived(
                threshold._replace(
                    quantity=inner,
                    now=threshold.now and not has_two_sides,
                    one_of_two=threshold.one_of_two or has_two_sides,
                ),
                ranges,
            )
            if threshold.above:
                yield from _derived(
                    threshold._replace(
                        quantity=inner,
                        above=False,
                        bound=iv.negate(threshold.bound),
                        now=False,
                        one_of_two=True,
                    ),
                    ranges,
                )
        case Op("neg", (inner,)):
            yield from _derived(
                threshold._replace(
                    quantity=inner, above=not threshold.above, bound=iv.negate(threshold.bound)
                ),
                ranges,
            )
        case Op("add" | "sub" | "mul" | "div" as op, (a, b)):
            yield from _solved(op, a, b, threshold, ranges)
        case State(function, (inner, *_)) if function in ORDER_PRESERVING:
            yield from _derived(
                threshold._replace(
                    quantity=inner,
                    now=False,
                    decides=threshold.decides
                    and function == ("running_max" if threshold.above else "running_min"),
                ),
                ranges,
            )
        case Name() if meaning != threshold.quantity:
            yield threshold._replace(quantity=meaning)


def _solved(op: str, a: Scalar, b: Scalar, threshold: Threshold, ranges: Ranges) -> Iterator[Threshold]:
    """Yield the thresholds of the parts of a sum: `a + b > c` needs a > c - b, if b is known."""
    is_left = ranges.of(b).is_finite and not ranges.of(a).is_single
    limit, unknown = (ranges.of(b), a) if is_left else (ranges.of(a), b)
    if not limit.is_finite or ranges.of(unknown).is_single:
        return
    # The side of the threshold depends on the sign of the factor; a / b jumps where b passes 0.
    if op in ("mul", "div") and (limit.low <= 0.0 <= limit.high or (op == "div" and unknown is b)):
        return
    above = threshold.above
    match op:
        case "add":
            bound = iv.subtract(threshold.bound, limit)
        case "sub" if unknown is a:
            bound = iv.add(threshold.bound, limit)
        case "sub":
            bound = iv.subtract(limit, threshold.bound)
            above = not above
        case _:
            solve = iv.divide if op == "mul" else iv.multiply
            bound = solve(threshold.bound, limit)
            above = above == (limit.low > 0.0)
    yield from _derived(
        threshold._replace(
            quantity=unknown,
            above=above,
            bound=bound,
            dimension=threshold.dimension if op in ("add", "sub") else None,
        ),
        ranges,
    )


def shadowed_endings(analysis: RangeAnalysis) -> Mapping[Expression, Expression]:
    """Return the endings that have no effect, each with the ending that always holds first: `abs(x) > 45 cm`
    after `abs(x) > 39 cm`.

    A failure has precedence over a success, so a failure behind a success still counts.
    """
    program = analysis.program
    success = analysis.program.agent.success
    ranges = analysis.ranges_in(0.0, INF)
    endings = [
        ending
        for ending in program.endings
        if ending.foreign is None and not ranges.of(analysis.scalars(ending)[0]).is_single
    ]
    shadowed: dict[Expression, Expression] = {}
    for late in endings if 1 < len(endings) <= _MAX_ENDINGS else ():
        for comparison in comparisons(analysis, late, ["and"]):
            for threshold in thresholds(comparison, ranges):
                if not threshold.now or not _is_gradual(analysis, threshold.quantity):
                    continue
                leads = (0.0, _LEAD_SHARE * abs(threshold.limit))
                late_ranges = [_beyond(threshold, lead, ranges) for lead in leads]
                for ending in endings:
                    if ending is late or (ending.name in success and late.name not in success):
                        continue
                    is_failure_first = late.name in success and ending.name not in success
                    has_precedence = is_failure_first or endings.index(ending) < endings.index(late)
                    if not has_precedence and threshold.limit == 0.0:
                        continue
                    if late_ranges[not has_precedence].of(analysis.scalars(ending)[0]) == ALWAYS:
                        shadowed.setdefault(late, ending)
    return shadowed


def _beyond(threshold: Threshold, lead: float, ranges: Ranges) -> Ranges:
    """Return the ranges where a quantity is beyond its limit, or closer to it than `lead`."""
    side = (
        Interval(threshold.limit - lead, INF) if threshold.above else Interval(-INF, threshold.limit + lead)
    )
    return ranges.where(ranges.analysis.identity(threshold.quantity), side)


def _is_gradual(analysis: RangeAnalysis, quantity: Scalar) -> bool:
    parameters = {value.name for value in analysis.program.parameters}
    for node in analysis.walk_definitions(quantity):
        match node:
            case EngineRead(function) if function in _CONTINUOUS_FUNCTIONS:
                continue
            case Name(name) if name in parameters or name in ("time", "step"):
                continue
            case Op(op) if op not in _JUMPING_FUNCTIONS and not function_named(op).boolean:
                continue
            case Const():
                continue
            case _:
                return False
    return True
