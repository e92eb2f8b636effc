"""Values at the end of their range in the observation, before a failure (DB603) and in ordinary operation
(DB611)."""

from __future__ import annotations

from collections.abc import Iterator
from math import isnan, nan
from typing import NamedTuple

from deepbots_cli import frames
from deepbots_cli.analysis import Analysis
from deepbots_cli.analysis.conditions import ConditionComparison, Threshold, comparisons, thresholds
from deepbots_cli.analysis.ranges import Ranges, bounds_text, range_text, with_unit
from deepbots_cli.compiler.robots import rigid_root
from deepbots_cli.diagnostics import Finding, Label
from deepbots_cli.expressions.dimensions import ACCELERATION
from deepbots_cli.expressions.intervals import SIGNED_UNIT, ZERO, Interval
from deepbots_cli.expressions.scalar import Draw, EngineRead, Name, Scalar
from deepbots_cli.expressions.types import TypedNode, walk
from deepbots_cli.lint.context import RuleContext, rule
from deepbots_cli.lint.observations import RangedNumber, first_of_each_clipped, ranged_numbers, replace_range
from deepbots_cli.program.values import Expression
from deepbots_cli.robots import kinematics

_RELATIVE_ROUNDING = 1e-6
"""The relative difference that rounding alone may cause."""
_RANGE_FACTOR = 1.2
"""The factor by which suggested ranges are larger than needed."""
_MIN_VISIBLE_SHARE = 0.05
"""The share of the way to a limit, before the limit, in which the policy must see it come."""
# 40 halvings leave 1e-12 of the interval.
_MAX_BISECTIONS = 40


@rule("DB603", versions="base")  # a stage may have wider limits on purpose
def saturates_before_termination(context: RuleContext) -> Iterator[Finding]:
    """Report a value that leaves its range in the observation before it ends the episode."""
    analysis = context.analysis.ideal
    ranges = analysis.ranges
    parts_by_number = [(number, _parts(analysis, number.node)) for number in ranged_numbers(analysis)]
    met = set()
    for ending in context.program.endings:
        if ending.name in context.program.agent.success or ending in context.analysis.shadowed:
            continue
        for comparison in comparisons(analysis, ending):
            reachable = [
                threshold for threshold in thresholds(comparison, ranges) if _can_be_met(threshold, ranges)
            ]
            for view in _blind(parts_by_number, reachable, ranges):
                if (id(view.number.entry), ending.name) not in met:
                    met.add((id(view.number.entry), ending.name))
                    yield _unseen(context, analysis, view, ending, comparison)


class BlindNumber(NamedTuple):
    """A number of the observation, and the value of a threshold's quantity from which on the number is
    constant; NaN if it never is."""

    number: RangedNumber
    threshold: Threshold
    edge: float


def _parts(analysis: Analysis, node: Scalar) -> set[int]:
    """Return the identities of a value and of everything that it is made of."""
    return set(map(analysis.identity, analysis.walk_definitions(node)))


def _can_be_met(threshold: Threshold, ranges: Ranges) -> bool:
    interval = ranges.of(threshold.quantity)
    return interval.high > threshold.limit if threshold.above else interval.low < threshold.limit


def _blind(
    parts_by_number: list[tuple[RangedNumber, set[int]]], reachable: list[Threshold], ranges: Ranges
) -> Iterator[BlindNumber]:
    """Yield for each threshold of a comparison that no number shows the first number that should."""
    views = []
    for threshold in reachable:
        quantity = ranges.analysis.identity(threshold.quantity)
        numbers = [
            BlindNumber(number, threshold, _edge(number, threshold, ranges))
            for number, parts in parts_by_number
            if quantity in parts
        ]
        views.append((quantity, numbers))
    for quantity, blind in views:
        # `abs(x) > 1 m` has thresholds of both `abs(x)` and `x`; the policy needs to see only one of them.
        other_views = [
            view
            for other_quantity, views_there in views
            if other_quantity != quantity
            for view in views_there
        ]
        if blind and not any(isnan(view.edge) for view in (*blind, *other_views)):
            yield blind[0]


def _edge(number: RangedNumber, threshold: Threshold, ranges: Ranges) -> float:
    """Return the end of the range of the quantity itself; for a value that depends on it, the point where it
    stops changing."""
    analysis = ranges.analysis
    bound = threshold.bound
    limit = threshold.limit
    interval = ranges.of(threshold.quantity)
    quantity = analysis.identity(threshold.quantity)
    if not number.entry.clip:
        return nan
    if quantity == analysis.identity(number.node):
        slack = _RELATIVE_ROUNDING * max(abs(bound.low), abs(bound.high))
        edge = number.high if threshold.above else number.low
        is_short = edge < limit - slack if threshold.above else edge > limit + slack
        return edge if is_short and not number.is_outside(interval) else nan

    def is_constant(start: float) -> bool:
        """Return whether the number is constant from `start` to the limit."""
        visible = ranges.where(quantity, Interval(min(start, limit), max(start, limit))).of(number.node)
        return min(max(visible.low, number.low), number.high) == min(
            max(visible.high, number.low), number.high
        )

    safe = -1.0 if threshold.above else 1.0
    far = 0.0 if safe * limit < 0.0 else limit + safe * (abs(limit) or 1.0)
    far = min(max(far, interval.low), interval.high)
    visible = limit + _MIN_VISIBLE_SHARE * (far - limit)
    if not is_constant(visible) or is_constant(far):
        return nan
    for _ in range(_MAX_BISECTIONS):
        half = (visible + far) / 2.0
        visible, far = (half, far) if is_constant(half) else (visible, half)
    return visible


def _unseen(
    context: RuleContext,
    analysis: Analysis,
    view: BlindNumber,
    ending: Expression,
    comparison: ConditionComparison,
) -> Finding:
    number = view.number
    name = view.number.name
    limit = view.threshold.limit
    help = (
        f"widen the range of `{name}`, or the bounds of a `clamp` in its value, so that it still changes at"
        f" the limit of `{ending.name}`"
    )
    fix = None
    if analysis.identity(number.node) == analysis.identity(view.threshold.quantity):
        end = "high" if view.threshold.above else "low"
        headline = (
            f"the {end} end of the range of `{name}` is {with_unit(view.edge, number.dimension)}, but"
            f" the episode fails only at {with_unit(limit, number.dimension)}"
        )
        beyond = limit + (_RANGE_FACTOR - 1.0) * abs(limit) * (1.0 if view.threshold.above else -1.0)
        opposite = -beyond if number.low == -number.high else beyond
        wide = Interval(min(number.low, beyond, opposite), max(number.high, beyond, opposite))
        help = f"widen the range beyond the limit, for example to `{range_text(wide, number.dimension)}`"
        fix = replace_range(context, number, wide, number.dimension)
    elif (dimension := view.threshold.dimension) is not None:
        part = _part_of(comparison, analysis, view.threshold.quantity)
        quantity_text = (
            f"`{comparison.value.text[part.start : part.end]}`"
            if part
            else f"the value that `{ending.name}` compares"
        )
        headline = (
            f"`{name}` does not change while {quantity_text} goes from {with_unit(view.edge, dimension)} to"
            f" {with_unit(limit, dimension)}, the limit of `{ending.name}`"
        )
    else:
        headline = f"`{name}` is already constant shortly before `{ending.name}` reaches its limit"
    limit_span = ending.span
    label = f"`{ending.name}` ends the episode here"
    if comparison.value.owner:
        limit_span = context.text(comparison.value.owner).part(comparison.node.start, comparison.node.end)
        label = label if comparison.value.name == ending.name else f"the limit of `{ending.name}`"
    also = (Label(limit_span, label),)
    return Finding("DB603", context.range_span(number.entry), headline, help, labels=also, fix=fix)


def _part_of(comparison: ConditionComparison, analysis: Analysis, quantity: Scalar) -> TypedNode | None:
    """Return the part of a comparison that is written for the quantity; None where nothing is."""
    identity = analysis.identity(quantity)
    for part in walk(comparison.node):
        if part is not comparison.node and identity in map(
            analysis.identity, analysis.lowered(part, comparison.value.owner)
        ):
            return part
    return None


@rule("DB611")
def observation_saturates(context: RuleContext) -> Iterator[Finding]:
    """Report a value that is at the end of its range in normal operation."""
    yield from _saturated_at_start(context)
    yield from _goal_out_of_range(context)
    yield from _saturated_by_gravity(context)


def _saturated_at_start(context: RuleContext) -> Iterator[Finding]:
    analysis = context.analysis
    for number in first_of_each_clipped(analysis):
        if number.is_outside(analysis.ranges.of(number.node)):
            continue  # DB602
        first = analysis.start.of(number.node)
        fact = analysis.resolve_aliases(number.node)
        is_beyond = first.low > number.high + number.slack or first.high < number.low - number.slack
        start_range = analysis.start.initial(fact) if isinstance(fact, EngineRead) else None
        if (
            start_range is not None and start_range.is_finite
        ):  # exactly what is drawn, not a wider range around it
            is_beyond = (
                start_range.high > number.high + number.slack or start_range.low < number.low - number.slack
            )
        if is_beyond:
            verb = "starts" if first.is_single else "can start"
            headline = (
                f"`{number.name}` {verb} outside its range: its initial value is"
                f" {bounds_text(first, number.dimension)}"
            )
            yield Finding(
                "DB611",
                context.range_span(number.entry),
                headline,
                "widen the range, or choose a start within it",
            )


def _goal_out_of_range(context: RuleContext) -> Iterator[Finding]:
    """Report a goal that is drawn from more than its range: policy, reward and endings use only the clipped
    value."""
    analysis = context.analysis
    goal = context.program.agent.goal
    if goal is None:
        return
    for node, low, high in zip(analysis.scalars(goal.desired), goal.low, goal.high, strict=True):
        quantity = analysis.resolve_aliases(node)
        start_range = analysis.start.of(quantity) if isinstance(quantity, Draw) else None
        start_range = analysis.start.initial(quantity) if isinstance(quantity, EngineRead) else start_range
        slack = _RELATIVE_ROUNDING * (high - low)
        if (
            start_range is not None
            and start_range.is_finite
            and (start_range.low < low - slack or start_range.high > high + slack)
        ):
            headline = (
                "`desired` can be outside its range: it is drawn"
                f" {bounds_text(start_range, goal.desired.typed.type.dimension)}"
            )
            yield Finding(
                "DB611",
                context.values.span(("goal", "range")),
                headline,
                "widen the range of the goal, or draw `desired` from a smaller range",
            )
            return


def _saturated_by_gravity(context: RuleContext) -> Iterator[Finding]:
    met = set()
    for number in ranged_numbers(context.analysis):
        leaf = context.analysis.resolve_aliases(number.node)
        reading = _reading_at_rest(context.analysis, leaf)
        if (
            reading is None
            or not number.entry.clip
            or id(number.entry) in met
            or number.low <= reading <= number.high
        ):
            continue
        met.add(id(number.entry))
        axis = leaf.component if isinstance(leaf, Name) else ""
        size = abs(reading) * _RANGE_FACTOR
        wide = Interval(min(number.low, -size), max(number.high, size))
        edge = f"the {'high' if reading > 0 else 'low'} end of the range of `{number.name}`"
        headline = (
            f"{edge} is {with_unit(number.high if reading > 0 else number.low, ACCELERATION)}"
            f", but at rest {f'`{number.name}.{axis}`' if axis else 'its value'} is"
            f" {with_unit(reading, ACCELERATION)}"
        )
        help = f"widen the range beyond gravity, for example to `{range_text(wide, ACCELERATION)}`"
        fix = replace_range(context, number, wide, ACCELERATION)
        yield Finding("DB611", context.range_span(number.entry), headline, help, fix=fix)


def _reading_at_rest(analysis: Analysis, leaf: Scalar) -> float | None:
    """Return the reading (m/s^2) of an axis of an accelerometer while its robot is upright and still; None if
    that is unknown."""
    reading = analysis.sensor(leaf)
    if reading is None or reading[1].kind != "accelerometer" or not isinstance(leaf, Name):
        return None
    robot, sensor = reading
    model = analysis.body(robot).model
    tilts = [analysis.start.of(EngineRead("orientation", (f"{robot}.{model.root}",), axis)) for axis in "xy"]
    if rigid_root(model, sensor.subjects[0])[0] != model.root or any(
        tilt not in (ZERO, SIGNED_UNIT) for tilt in tilts
    ):
        return None
    link = kinematics.link_frames(model)[sensor.subjects[0]]
    turn = frames.compose(link, frames.frame(sensor.mount))[1]
    # An accelerometer at rest measures the reaction to gravity, which points upward.
    x, y, z = analysis.program.world.gravity
    return frames.rotate_back(turn, (-x, -y, -z))["xyz".index(leaf.component or "x")]
