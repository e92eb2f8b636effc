"""The observation of the policy (family DB6): values outside of their range, at its end before a failure
(DB603) and in ordinary operation (DB611), that never change, or that show too much."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping
from functools import reduce
from itertools import groupby
from math import prod
from typing import NamedTuple

from deepbots_cli.analysis import Analysis
from deepbots_cli.analysis.conditions import ConditionComparison, Threshold, comparisons, thresholds
from deepbots_cli.analysis.ranges import Ranges, bounds_text, range_text, with_unit
from deepbots_cli.compiler.robots import joint_dimension, joint_interval
from deepbots_cli.diagnostics import Edit, Finding, Fix, Label
from deepbots_cli.diagnostics.nearest import nearest_word
from deepbots_cli.document.layout import removal_fix
from deepbots_cli.expressions.dimensions import Dimension
from deepbots_cli.expressions.intervals import Interval, hull
from deepbots_cli.expressions.scalar import Const, Draw, EngineRead, Name, Op, Scalar
from deepbots_cli.expressions.scalar import children as parts_of
from deepbots_cli.lint.context import Match, RuleContext, Simulation, rule
from deepbots_cli.program import Program
from deepbots_cli.program.identity import Deployment, reading_key
from deepbots_cli.program.task import Observation
from deepbots_cli.program.values import Expression, Noise

_RELATIVE_ROUNDING = 1e-6
"""The relative difference that rounding alone may cause."""
_MIN_COVERED_SHARE = 0.25
"""The share of the range of a noisy value that an exact value covers at least."""
_MIN_STEPS = 100
"""The number of simulated steps below which nothing is concluded."""
_MIN_RANGE_SHARE = 0.32
"""The share of the range of all joints that each joint has at least; the arms that we know have 0.33 and
more."""
_MIN_SATURATED_SHARE = 0.75
"""The share of the steps of every policy in which a value is at the end of its range. Gravity on an axis
reaches 1.0; random actions saturated a speed that is clipped on purpose in 0.59."""


class RangedNumber(NamedTuple):
    """One number of the observation: its entry, its tree, its range in SI units, its place among all numbers,
    and its full name."""

    entry: Observation
    node: Scalar
    low: float
    high: float
    place: int
    full_name: str

    @property
    def name(self) -> str:
        return self.entry.value.name

    @property
    def dimension(self) -> Dimension:
        return self.entry.value.typed.type.dimension

    @property
    def slack(self) -> float:
        return _RELATIVE_ROUNDING * (self.high - self.low)

    def is_outside(self, interval: Interval) -> bool:
        """Return whether values of this range never lie in the range of the observation (DB602), except at an
        end that they touch."""
        above = interval.low >= self.high and interval.high > self.high
        below = interval.high <= self.low and interval.low < self.low
        return above or below


def ranged_numbers(analysis: Analysis, *extra_entries: Observation) -> Iterator[RangedNumber]:
    """Yield all numbers of the observation and of `extra_entries`, without pictures and truth values."""
    parts = [
        (entry, index, number)
        for entry in (*analysis.program.agent.observation, *extra_entries)
        for index, number in enumerate(entry.numbers)
    ]
    for position, (entry, index, number) in enumerate(parts):
        if not number.is_truth:
            yield RangedNumber(
                entry,
                analysis.scalars(entry.value)[index],
                number.low,
                number.high,
                position,
                number.full_name,
            )


def first_of_each_clipped(analysis: Analysis) -> Iterator[RangedNumber]:
    """Yield the first component of each clipped entry, and further components whose range differs."""
    met = set()
    for number in ranged_numbers(analysis):
        key = (id(number.entry), number.low, number.high)
        if number.entry.clip and key not in met:
            met.add(key)
            yield number


def replace_range(
    context: RuleContext, number: RangedNumber, wide: Interval, dimension: Dimension
) -> Fix | None:
    """Return a fix that writes another range; None if the components have ranges of their own."""
    is_one = len({*zip(number.entry.low, number.entry.high, strict=True)}) == 1
    return (
        Fix((Edit(context.range_span(number.entry), range_text(wide, dimension)),), safe=False)
        if is_one
        else None
    )


@rule(
    "DB614",
    "`{name}` depends on `{source}`, as the goal does, but hindsight replay replaces only `desired`",
    "remove it from the observation: the policy already sees `achieved` and `desired`",
    versions="training",
)
def goal_in_observation(context: RuleContext) -> Iterator[Match]:
    """Report an entry of the observation that depends on the goal, with hindsight replay."""
    program = context.program
    if program.agent.goal is None or program.agent.training is None or program.agent.training.replay is None:
        return
    analysis = context.analysis.ideal

    def sources(value: Expression) -> set[str]:
        return {name for node in analysis.scalars(value) for name in analysis.drawn_dependencies(node)}

    bodies = {body.name for body in program.world.objects} | {robot.name for robot in program.world.robots}
    goal_sources = sources(program.agent.goal.desired) - sources(program.agent.goal.achieved)
    goal_sources &= bodies | {value.name for value in program.parameters}
    for entry in program.agent.observation:
        shared = sources(entry.value) & goal_sources
        if shared:
            also = (Label(program.agent.goal.desired.span, f"the goal depends on `{min(shared)}`"),)
            yield Match(entry.value.span, labels=also, name=entry.value.name, source=min(shared))


class Linear(NamedTuple):
    """A sum of quantities with fixed coefficients, and a fixed offset. A measurement is a quantity by its
    identity, a product by those of its factors, and what is paid under a condition by that, too."""

    terms: Mapping[Hashable, float]
    offset: float = 0.0


@rule(
    "DB616",
    "`{name}` has noise, and the policy sees its exact value in `{exact}`",
    "declare the noise once, under `augment`, as `{{value: ..., noise: ...}}`, and use this name in both"
    " places",
)
def noise_without_effect(context: RuleContext) -> Iterator[Match]:
    """Report a value with noise whose exact value the policy sees elsewhere."""
    program, analysis = context.program, context.analysis
    if not any(
        (
            *(entry.noise for entry in program.agent.observation),
            *(value.noise for value in may_be_noisy(program)),
        )
    ):
        return
    entries = [(number, _noises(analysis, number)) for number in _seen_numbers(analysis)]
    linear_by_node: dict[int, Linear] = {}
    exact = [
        (number, linear(analysis, number.node, linear_by_node)) for number, noises in entries if not noises
    ]
    reported: set[int] = set()
    for number, noises in entries:
        hidden = linear(analysis, number.node, linear_by_node)
        exact_number = next(
            (candidate for candidate, form in exact if noises and _shows(candidate, form, number, hidden)),
            None,
        )
        if exact_number is not None and id(noises[0]) not in reported:
            reported.add(id(noises[0]))
            labels = (Label(exact_number.entry.value.span, "exact value"),)
            yield Match(noises[0].std.span, labels=labels, name=number.name, exact=exact_number.name)


def may_be_noisy(program: Program) -> tuple[Expression, ...]:
    """Return the values that may have noise of their own, whether the policy sees them or not."""
    return (*program.signals, *([program.agent.goal.achieved] if program.agent.goal else []))


def _seen_numbers(analysis: Analysis) -> Iterator[RangedNumber]:
    """Return the numbers of the observation and of the goal, without those from messages that may be late."""
    program = analysis.program
    is_late = program.timing == "delayed" or any(robot.from_route.settings for robot in program.robots)
    goal = program.agent.goal
    goal_entries = (
        [
            Observation(value, goal.low, goal.high, noise=value.noise)
            for value in (goal.achieved, goal.desired)
        ]
        if goal
        else []
    )
    return (
        number
        for number in ranged_numbers(analysis, *goal_entries)
        if not (is_late and any("." in name for name in analysis.dependencies(number.node)))
    )


def _noises(analysis: Analysis, number: RangedNumber) -> list[Noise]:
    """Return the noise that a number has, its own first."""
    names = [
        part.name
        for part in analysis.walk_definitions(number.node)
        if isinstance(part, Name) and analysis.is_noisy(part.name)
    ]
    measured = [value for name in names if (value := analysis.expression_named(name)) is not None]
    return [
        noise for noise in (number.entry.noise, *(value.noise for value in measured)) if noise is not None
    ]


def linear(analysis: Analysis, node: Scalar, linear_by_node: dict[int, Linear]) -> Linear:
    """Return the value without noise as a sum. `linear_by_node` is a cache."""
    node = analysis.resolve_aliases(node)
    number = analysis.identity(node)
    if number not in linear_by_node:
        exact = (
            analysis.definition_without_noise(node)
            if isinstance(node, Name) and analysis.is_noisy(node.name)
            else None
        )
        parts = [
            linear(analysis, part, linear_by_node)
            for part in ((exact,) if exact is not None else parts_of(node))
        ]
        match node:
            case Name() if exact is not None:
                linear_by_node[number] = parts[0]
            case Const(value):
                linear_by_node[number] = Linear({}, float(value))
            case Op("neg"):
                linear_by_node[number] = _scaled(parts[0], -1.0)
            case Op("add"):
                linear_by_node[number] = reduce(_sum, parts)
            case Op("sub"):
                linear_by_node[number] = _sum(parts[0], _scaled(parts[1], -1.0))
            case Op("mul", (Const(factor), _)) | Op("mul", (_, Const(factor))):
                linear_by_node[number] = _scaled(
                    parts[1] if isinstance(node.args[0], Const) else parts[0], float(factor)
                )
            case Op("div", (_, Const(divisor))) if divisor:
                linear_by_node[number] = _scaled(parts[0], 1.0 / float(divisor))
            case Op("mul") if all(len(part.terms) == 1 and not part.offset for part in parts):
                factors = [next(iter(part.terms.items())) for part in parts]
                product = ("mul", *(term for term, _ in factors))
                linear_by_node[number] = Linear({product: prod(factor for _, factor in factors)})
            case Op("where", (condition, _, Const(0.0))):
                paid = {None: parts[1].offset, **parts[1].terms}
                under = ("where", analysis.identity(condition))
                linear_by_node[number] = Linear({(*under, term): paid[term] for term in paid if paid[term]})
            case _:
                linear_by_node[number] = Linear({number: 1.0})
    return linear_by_node[number]


def _scaled(value: Linear, factor: float) -> Linear:
    return Linear(
        {term: factor * coefficient for term, coefficient in value.terms.items() if factor * coefficient},
        factor * value.offset,
    )


def _sum(first: Linear, second: Linear) -> Linear:
    terms = {
        term: first.terms.get(term, 0.0) + second.terms.get(term, 0.0)
        for term in (*first.terms, *second.terms)
    }
    return Linear(
        {term: coefficient for term, coefficient in terms.items() if coefficient},
        first.offset + second.offset,
    )


def _shows(exact_number: RangedNumber, exact: Linear, noisy: RangedNumber, hidden: Linear) -> bool:
    """Return whether `exact_number` is an affine function of the value under the noise in `noisy`, over a
    good part of its range."""
    if not hidden.terms or exact.terms.keys() != hidden.terms.keys():
        return False
    factors = [exact.terms[term] / coefficient for term, coefficient in hidden.terms.items()]
    if any(abs(factor - factors[0]) > _RELATIVE_ROUNDING * abs(factors[0]) for factor in factors):
        return False
    offset = exact.offset - factors[0] * hidden.offset
    ends = sorted((end - offset) / factors[0] for end in (exact_number.low, exact_number.high))
    common = min(ends[1], noisy.high) - max(ends[0], noisy.low)
    return common >= _MIN_COVERED_SHARE * (noisy.high - noisy.low)


@rule(
    "DB601",
    "`{name}` is not clipped to its range, and can be arbitrarily large",
    "remove `clip: false`, or `clamp` the value under `augment`",
)
def observation_unbounded(context: RuleContext) -> Iterator[Match]:
    """Report an entry of the observation that is not clipped to its range, and can be arbitrarily large."""
    analysis = context.analysis
    unclipped = [
        number
        for number in ranged_numbers(analysis)
        if not number.entry.clip and not analysis.ranges.of(number.node).is_finite
    ]
    for entry in {id(number.entry): number.entry for number in unclipped}.values():
        fix = removal_fix(context.values.root, ("observation", entry.value.name, "clip"))
        yield Match(context.range_span(entry), fix=fix, name=entry.value.name)


@rule("DB602")
def bounds_mismatch(context: RuleContext) -> Iterator[Finding]:
    """Report a value that never lies within its range in the observation."""
    analysis = context.analysis
    for number in first_of_each_clipped(analysis):
        interval = analysis.ranges.of(number.node)
        if number.is_outside(interval):
            headline = (
                f"`{number.name}` is {bounds_text(interval, number.dimension)}, outside of its range"
                " in the observation"
            )
            is_known = interval.is_finite and not interval.is_single
            help = "write the range of the value" + (
                f": `{range_text(interval, number.dimension)}`" if is_known else ""
            )
            fix = replace_range(context, number, interval, number.dimension) if is_known else None
            yield Finding("DB602", context.range_span(number.entry), headline, help, fix=fix)


# Measured in a simulation


@rule("DB607", simulated=True)
def outside_space(simulation: Simulation) -> Iterator[Finding]:
    """Report a number of the observation that is NaN, or outside of the observation space."""
    stop = simulation.report.stop
    if stop is not None and stop.kind == "space":
        for entry in simulation.program.agent.observation:
            full_names = {entry.value.name, *(number.full_name for number in entry.numbers)}
            names = [name for name in stop.numbers if name in full_names]
            if names:
                headline = f"`{names[0]}` is outside of the observation space"
                yield Finding(
                    "DB607",
                    entry.value.span,
                    headline,
                    "`clamp` the value, or remove `clip: false`",
                    notes=(simulation.when(),),
                )
    failed = simulation.failed
    if failed is not None and failed.section == "observation":
        help = (
            "write an expression that is always defined; keep divisors away from zero, as in `1 / max(d,"
            " 1 cm)` for a length `d`"
        )
        yield Finding(
            "DB607",
            failed.span,
            f"`{failed.name}` in the observation has no value",
            help,
            notes=failed.notes,
        )


@rule("DB608", simulated=True)
def constant_observation(simulation: Simulation) -> Iterator[Finding]:
    """Report a number that was the same in every step."""
    if not simulation.is_complete or simulation.steps < _MIN_STEPS:
        return
    constant = [
        number
        for number in ranged_numbers(simulation.analysis)
        if number.place in simulation.report.summary.constant_numbers
    ]
    # A number at an end of its range may wait for an event, such as a touch that no driver had.
    constant = [number for number in constant if -1.0 < _constant(simulation, number) < 1.0]
    for _, group in groupby(constant, key=lambda number: number.entry.value.name):
        numbers = list(group)
        entry = numbers[0].entry
        parts = max(1, len(numbers[0].entry.value.components))
        is_whole = len(numbers) == parts
        names = [entry.value.name] if is_whole and parts > 1 else [number.full_name for number in numbers]
        name = "` and `".join(names)
        verb = "never changes" if len(names) == 1 else "never change"
        value = with_unit(_number_in_units(simulation, numbers[0]), numbers[0].dimension)
        headline = f"`{name}` {verb}" + (f": it is {value} in every step" if len(numbers) == 1 else "")
        help = (
            "remove it" if is_whole else "observe only the other components"
        ) + ", or add a script under `scripts` that changes it"
        yield Finding("DB608", entry.value.span, headline, help, notes=(simulation.summary,))
    pictures = [entry for entry in simulation.program.agent.observation if entry.value.typed.type.picture]
    for position, entry in enumerate(pictures, start=len(simulation.program.agent.numbers)):
        if position in simulation.report.summary.constant_numbers:
            help = (
                "check the place and the view of its camera, or add a script under `scripts` that changes it"
            )
            yield Finding(
                "DB608",
                entry.value.span,
                f"the picture `{entry.value.name}` never changes",
                help,
                notes=(simulation.summary,),
            )


def _constant(simulation: Simulation, number: RangedNumber) -> float:
    """Return the value that it had in every step, from -1 to 1."""
    return next(iter(simulation.measured.values())).numbers[number.place].low


def _number_in_units(simulation: Simulation, number: RangedNumber) -> float:
    value = number.low + (_constant(simulation, number) + 1.0) / 2.0 * (number.high - number.low)
    return value if abs(value) > number.slack else 0.0


@rule(
    "DB611",
    "`{name}` is at the end of its range, {end}, in most of the simulated steps",
    "widen the range so that it covers the usual values",
    simulated=True,
)
def often_saturated(simulation: Simulation) -> Iterator[Match]:
    """Report a number that under every policy is at the same end of its range in most steps, and could lie
    beyond."""
    if not simulation.is_complete or simulation.steps < _MIN_STEPS:
        return
    met = set()
    for number in ranged_numbers(simulation.analysis):
        entry = number.entry
        if not entry.clip or id(entry) in met:
            continue
        interval = simulation.analysis.ranges.of(number.node)
        slack = number.slack
        for end, is_beyond in (
            (number.high, interval.high > number.high + slack),
            (number.low, interval.low < number.low - slack),
        ):
            rows = {by: (row.numbers[number.place], row.rows) for by, row in simulation.measured.items()}
            shares = {
                by: (saturation.at_high if end == number.high else saturation.at_low) / count
                for by, (saturation, count) in rows.items()
            }
            if is_beyond and min(shares.values()) >= _MIN_SATURATED_SHARE:
                met.add(id(entry))
                notes = tuple(f"{100 * share:.0f} % of the steps of {by}" for by, share in shares.items())
                at = with_unit(end, number.dimension)
                yield Match(simulation.range_span(entry), notes=notes, name=number.full_name, end=at)
                break


@rule(
    "DB318",
    "`auto` uses one range for all joints, {whole}, but `{joint}` moves only within {own}",
    "observe each joint by itself, as in `{name}.{joint}: auto`",
)
def range_of_other_parts(context: RuleContext) -> Iterator[Match]:
    """Report the range `auto` of several joints that is much wider than the limits of one of them."""
    for entry in context.program.agent.observation:
        span = context.range_span(entry)
        dimension = entry.value.typed.type.dimension
        limits = _limits_of_parts(context.program, entry) if span.text == "auto" else []
        shares = [(part.high - part.low) / (entry.high[0] - entry.low[0]) for part in limits]
        if shares and min(shares) < _MIN_RANGE_SHARE:
            narrowest = shares.index(min(shares))
            yield Match(
                span,
                whole=range_text(Interval(entry.low[0], entry.high[0]), dimension),
                joint=entry.value.components[narrowest],
                own=range_text(limits[narrowest], dimension),
                name=entry.value.name,
            )


def _limits_of_parts(program: Program, entry: Observation) -> list[Interval]:
    """Return the limits of each joint, if an entry has the positions of several; else nothing."""
    parts = entry.value.components
    dimension = entry.value.typed.type.dimension
    if len(parts) > 1:
        for body in program.world.robots:
            joints = {
                joint.name: joint for joint in body.model.moving_joints if joint_dimension(joint) == dimension
            }
            if joints.keys() >= set(parts):
                limits = [joint_interval(joints[part]) for part in parts]
                if (hull(limits).low, hull(limits).high) == (entry.low[0], entry.high[0]):
                    return limits
    return []


@rule("DB617")
def reading_not_supplied(context: RuleContext) -> Iterator[Finding]:
    """Report a reading of the world that the policy needs and that neither a robot nor `deploy` supplies."""
    spec = context.checked.spec
    if spec is None or spec.deploy is None:
        return
    deployment = Deployment(context.program)
    supplied = {reading_key(key): key for key in spec.deploy.supplied_by}
    missing = [name for name in deployment.unmeasured if name not in supplied]
    if missing:
        needed = f"{', '.join(f'`{name}`' for name in missing)}, which no robot measures"
        help = (
            f"write what supplies it, as in `deploy: {{supplied_by: {{{missing[0]}: motion capture}}}}`,"
            " or observe a sensor instead"
        )
        yield Finding(
            "DB617",
            context.values.key_span(("deploy",)),
            f"the policy needs {needed}, and `deploy` names no supplier",
            help,
        )
    readings = [*deployment.unmeasured, *deployment.goals]
    for name, key in supplied.items():
        if name not in readings:
            suggestion = nearest_word(name, readings)
            if suggestion:
                help = f"did you mean `{suggestion}`?"
            elif not readings:
                help = "remove it"
            else:
                help = f"the policy needs {', '.join(readings)}"
            span = context.values.key_span(("deploy", "supplied_by", key))
            replacement = None if suggestion in supplied else suggestion
            fix = Fix.replacing(span, key, replacement, safe=False) if replacement else None
            yield Finding("DB617", span, f"the policy does not need `{name}`", help, fix=fix)


_RANGE_FACTOR = 1.2
"""The factor by which suggested ranges are larger than needed."""
_MIN_VISIBLE_SHARE = 0.05
"""The share of the way to a limit, before the limit, in which the policy must see it come."""


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


class View(NamedTuple):
    """A number of the observation that depends on the quantity of a threshold, and whether it does not show
    that the quantity comes near."""

    number: RangedNumber
    threshold: Threshold
    is_blind: bool


def _parts(analysis: Analysis, node: Scalar) -> set[int]:
    """Return the identities of a value and of everything that it is made of."""
    return set(map(analysis.identity, analysis.walk_definitions(node)))


def _can_be_met(threshold: Threshold, ranges: Ranges) -> bool:
    interval = ranges.of(threshold.quantity)
    return interval.high > threshold.limit if threshold.above else interval.low < threshold.limit


def _blind(
    parts_by_number: list[tuple[RangedNumber, set[int]]], reachable: list[Threshold], ranges: Ranges
) -> Iterator[View]:
    """Yield for each threshold of a comparison that no number shows the first number that should."""
    views = []
    for threshold in reachable:
        quantity = ranges.analysis.identity(threshold.quantity)
        numbers = [
            View(number, threshold, _is_blind(number, threshold, ranges))
            for number, parts in parts_by_number
            if quantity in parts
        ]
        views.append((quantity, numbers))
    for quantity, own_views in views:
        # `abs(x) > 1 m` has thresholds of both `abs(x)` and `x`; the policy needs to see only one of them.
        other_views = [
            view
            for other_quantity, views_there in views
            if other_quantity != quantity
            for view in views_there
        ]
        if own_views and all(view.is_blind for view in (*own_views, *other_views)):
            yield own_views[0]


def _is_blind(number: RangedNumber, threshold: Threshold, ranges: Ranges) -> bool:
    """Return whether the range of a number ends before the limit of its quantity; of a value that depends on
    it, whether it is constant shortly before the limit, and not far from it."""
    bound, limit = threshold.bound, threshold.limit
    interval = ranges.of(threshold.quantity)
    quantity = ranges.analysis.identity(threshold.quantity)
    if not number.entry.clip:
        return False
    if quantity == ranges.analysis.identity(number.node):
        slack = _RELATIVE_ROUNDING * max(abs(bound.low), abs(bound.high))
        is_short = number.high < limit - slack if threshold.above else number.low > limit + slack
        return is_short and not number.is_outside(interval)

    def is_constant(start: float) -> bool:
        """Return whether the number is constant from `start` to the limit."""
        visible = ranges.where(quantity, Interval(min(start, limit), max(start, limit))).of(number.node)
        return min(max(visible.low, number.low), number.high) == min(
            max(visible.high, number.low), number.high
        )

    safe = -1.0 if threshold.above else 1.0
    far = 0.0 if safe * limit < 0.0 else limit + safe * (abs(limit) or 1.0)
    far = min(max(far, interval.low), interval.high)
    return is_constant(limit + _MIN_VISIBLE_SHARE * (far - limit)) and not is_constant(far)


def _unseen(
    context: RuleContext,
    analysis: Analysis,
    view: View,
    ending: Expression,
    comparison: ConditionComparison,
) -> Finding:
    number, limit = view.number, view.threshold.limit
    if analysis.identity(number.node) == analysis.identity(view.threshold.quantity):
        end, edge = ("high", number.high) if view.threshold.above else ("low", number.low)
        headline = (
            f"the {end} end of the range of `{number.name}` is {with_unit(edge, number.dimension)}, but"
            f" the episode fails only at {with_unit(limit, number.dimension)}"
        )
        beyond = limit + (_RANGE_FACTOR - 1.0) * abs(limit) * (1.0 if view.threshold.above else -1.0)
        opposite = -beyond if number.low == -number.high else beyond
        wide = Interval(min(number.low, beyond, opposite), max(number.high, beyond, opposite))
        help = f"widen the range beyond the limit, for example to `{range_text(wide, number.dimension)}`"
        fix = replace_range(context, number, wide, number.dimension)
    else:
        dimension = view.threshold.dimension
        limit_text = "its limit" if dimension is None else f"its limit, {with_unit(limit, dimension)}"
        headline = f"`{number.name}` is constant already before `{ending.name}` reaches {limit_text}"
        help = (
            f"widen the range of `{number.name}`, or the bounds of a `clamp` in its value, so that it still"
            f" changes at the limit of `{ending.name}`"
        )
        fix = None
    limit_span = ending.span
    label = f"`{ending.name}` ends the episode here"
    if comparison.value.owner:
        limit_span = context.text(comparison.value.owner).part(comparison.node.start, comparison.node.end)
        label = label if comparison.value.name == ending.name else f"the limit of `{ending.name}`"
    also = (Label(limit_span, label),)
    return Finding("DB603", context.range_span(number.entry), headline, help, labels=also, fix=fix)


@rule("DB611")
def observation_saturates(context: RuleContext) -> Iterator[Finding]:
    """Report a value that is at the end of its range in normal operation."""
    yield from _saturated_at_start(context)
    yield from _goal_out_of_range(context)


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
                "choose a start within the range, or widen it",
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
