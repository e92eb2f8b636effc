"""What the reward pays for: its sign (DB703), hidden state (DB706), what leads into a failure (DB710),
failing early (DB705), and staying short of the success (DB708)."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from itertools import chain, repeat
from math import ceil, floor, log10, nextafter

from deepbots_cli.analysis import Analysis
from deepbots_cli.analysis.conditions import (
    ConditionComparison,
    Threshold,
    comparisons,
    is_clock,
    only_comparison,
    thresholds,
)
from deepbots_cli.analysis.ranges import (
    RangeAnalysis,
    Ranges,
    RewardTerms,
    Terms,
    break_even,
    total_range,
    with_unit,
)
from deepbots_cli.diagnostics import Finding, Fix, Label
from deepbots_cli.expressions import intervals as iv
from deepbots_cli.expressions.dimensions import ANGLE, LENGTH
from deepbots_cli.expressions.functions import function_named
from deepbots_cli.expressions.intervals import INF, NEVER, TRUTH, ZERO, Interval
from deepbots_cli.expressions.scalar import EngineRead, Name, Op, Scalar, State
from deepbots_cli.expressions.types import referenced_names
from deepbots_cli.expressions.unification import negated_text
from deepbots_cli.lint.context import Match, RuleContext, rule
from deepbots_cli.program.values import Expression
from deepbots_cli.scenario.sensors import SENSORS
from deepbots_cli.words import number_text

_RATE_FUNCTIONS = frozenset({"velocity", "angular_velocity", "joint_velocity"})
"""The facts that are 0 while nothing moves."""
_CLOCKS = frozenset({"time", "step"})
_MIN_FACTOR = 1e-12
"""The largest factor that is left by rounding when factors cancel."""
MIN_BREAK_EVEN = 0.5
"""The share of episodes that would have to succeed, above which a scenario whose success pays is reported."""
MIN_WORTH = 0.25
"""The share of the value of success below which payments, after discounting, are not reported."""


# Failing early

LIVING_HELP = "raise the cost of a failure above the cost of all steps together, or lower the cost of a step"


@rule("DB705", versions="training")
def rewards_early_death(context: RuleContext) -> Iterator[Finding]:
    """Report that failing early costs less than an episode that goes on to its time limit."""
    program = context.program
    reward = context.analysis.reward
    ordinary, final = reward.split_by_end()
    running = _short_of_the_goal(reward)
    last = (reward.analysis.last_step - 1) * program.action_repeat
    at_limit = total_range(final, reward.ranges_at(None)).high
    if not reward.is_complete or _total_sum(ordinary, running, last) + at_limit >= 0.0:
        return
    # No term can refer to the failure, so its price is whatever the other terms pay in its step.
    if program.agent.goal is not None:
        if total_range(ordinary, reward.ranges_while_running()).high > 0.0:
            return
        final = [*ordinary, *final]
    failure = _cheapest_failure(reward, final)
    if failure is None:
        return
    cost, ending = failure
    steps = _steps_that_count(reward, ending) * program.action_repeat
    living = _total_sum(ordinary, running, steps) + at_limit
    prizes = [(total_range(final, reward.ranges_at(ending)).high, ending) for ending in program.successes]
    prize, success = max(prizes, key=lambda entry: entry[0], default=(0.0, None))
    if cost <= living or living >= 0.0:
        return
    dearest = min(ordinary, key=lambda term: _total_sum([term], running, steps))[0]
    also = (Label(ending.span, "the cheaper ending"),)
    total_cost = f"{number_text(-_total_sum(ordinary, running, last) - at_limit, 3)}"
    price = _price(cost)
    if success is not None and prize > 0.0:
        share = break_even(living, cost, prize + max(0.0, _total_sum(ordinary, running, 0)))
        if share >= MIN_BREAK_EVEN:
            headline = (
                f"an episode that lasts until the time limit costs at least {total_cost}, but"
                f" `{ending.name}` {price}"
            )
            headline += f"; `{success.name}` pays {number_text(prize, 3)}"
            yield Finding(
                "DB705",
                dearest.span,
                headline,
                LIVING_HELP,
                notes=_share_notes(reward, share, success),
                labels=also,
            )
        return
    headline = f"continuing an episode costs at least {total_cost}, but `{ending.name}` {price}"
    help = "reward each good step, as in `alive: 1`, or make a failure cost more than all steps together"
    if program.agent.goal is not None:
        headline = (
            f"an episode that misses the goal costs at least {total_cost}, but one that ends with"
            f" `{ending.name}` {price} or less"
        )
        help = f"reward the goal instead, as in `1 when goal_reached`, or remove `{ending.name}`"
    yield Finding("DB705", dearest.span, headline, help, labels=also)


def _price(cost: float) -> str:
    if cost == 0.0:
        return "costs nothing"
    if cost < 0.0:
        return f"costs {number_text(-cost, 3)}"
    return f"even pays {number_text(cost, 3)}"


def _share_notes(reward: RewardTerms, share: float, success: Expression) -> tuple[str, ...]:
    less = horizon(reward) < reward.analysis.last_step - 1
    horizon_note = (
        f"with the discount factor of the training, only about {horizon(reward):.0f} steps matter: over"
        " these, "
        if less
        else ""
    )
    return (
        f"{horizon_note}failing at once gives a higher return unless more than {100.0 * share:.0f} % of the"
        f" episodes end with `{success.name}`",
    )


def horizon(reward: RewardTerms) -> float:
    """Return the steps of the agent that matter: those of an episode, or the horizon of the discount factor
    if it is shorter."""
    gamma = reward.program.agent.discount
    # The sum of gamma^k over all k is 1 / (1 - gamma).
    return min(float(reward.analysis.last_step), INF if gamma >= 1.0 else 1.0 / (1.0 - gamma))


def _steps_that_count(reward: RewardTerms, ending: Expression) -> float:
    """Return the steps of the agent after the first one in which an ending may hold, at most the horizon of
    the discount factor."""
    return max(
        0.0, min(reward.analysis.last_step - 1.0 - _first_step(reward.analysis, ending), horizon(reward))
    )


def _cheapest_failure(reward: RewardTerms, final: Terms) -> tuple[float, Expression] | None:
    """Return the smallest reward for certain, and its failure, of the failure for which this is largest."""
    failed = reward.program.failures
    costs = [
        (total_range(final, reward.ranges_at(ending)).low, ending)
        for ending in reward.program.endings
        if ending.name in failed
    ]
    return max(costs, key=lambda entry: entry[0], default=None)


def _total_sum(terms: Terms, ranges: Ranges, steps: float) -> float:
    """Return the largest sum of terms over the first steps of an episode."""
    total = ZERO
    for _, node in terms:
        total = iv.add(total, _sum_over_steps(ranges, node, steps))
    return total.high


def _sum_over_steps(ranges: Ranges, node: Scalar, steps: float) -> Interval:
    """Return the range of the sum of a value over the first steps of an episode. The sum of `delta(x)` is the
    change of x from its start."""
    node = ranges.analysis.resolve_aliases(node)
    match node:
        case State("delta", (quantity, *start)):
            begin = iv.hull([ranges.analysis.start.of(part) for part in (quantity, *start)])
            return iv.subtract(ranges.of(quantity), begin)
        case Op("neg", (inner,)):
            return iv.negate(_sum_over_steps(ranges, inner, steps))
        case Op("add" | "sub" as op, (a, b)):
            combine = iv.add if op == "add" else iv.subtract
            return combine(_sum_over_steps(ranges, a, steps), _sum_over_steps(ranges, b, steps))
        case Op("mul" | "div" as op, (a, b)) if ranges.of(b).is_single:
            combine = iv.multiply if op == "mul" else iv.divide
            return combine(_sum_over_steps(ranges, a, steps), ranges.of(b))
        case Op("mul", (a, b)) if ranges.of(a).is_single:
            return iv.multiply(ranges.of(a), _sum_over_steps(ranges, b, steps))
        case _:
            return iv.multiply(ranges.of(node), iv.single(steps))


def _short_of_the_goal(reward: RewardTerms) -> Ranges:
    """Return ranges in a step that ends nothing and, if there is a goal, does not reach it."""
    goal = reward.program.agent.goal
    running = reward.ranges_while_running()
    reached = reward.analysis.resolve_aliases(Name("goal_reached"))
    if goal is None or not isinstance(reached, Op):
        return running
    return running.where(
        reward.analysis.identity(reached.args[0]), Interval(nextafter(goal.tolerance, INF), INF)
    )


# Staying short of the success


def lower_help(
    term: Expression,
    lowered: str = "",
    raised: str = "success pay more than an episode without it can collect",
) -> str:
    """Return the help for a term that pays more than the success; `lowered` is its text with which it does
    not."""
    line = term.span.start_position.line
    return f"lower `{term.name}`, line {line}{lowered and f', to `{lowered}` or less'}, or make {raised}"


def _lowered(text: str, factor: float) -> str:
    """Return the text of a term times a factor, which is rounded down."""
    value, when, condition = text.partition(" when ")
    if value.count("(") != value.count(")"):
        value, when, condition = text, "", ""
    is_number = re.fullmatch(r"\d+(\.\d+)?", value) is not None
    lower = factor * float(value) if is_number else factor
    digit = 10.0 ** (floor(log10(lower)) - 1)
    rounded = f"{floor(lower / digit) * digit:.6g}"
    return f"{rounded if is_number else f'{rounded} * ({value})'}{when}{condition}"


class _StillRanges(Ranges):
    """Ranges while nothing moves: speeds are 0, and values that are compared with the step before do not
    change."""

    def _world(self, node: EngineRead) -> Interval:
        return ZERO if node.function in _RATE_FUNCTIONS else super()._world(node)

    def _state(self, node: State) -> Interval:
        match node.function:
            case "delta" | "rising_edge":
                return NEVER
            case "previous":
                return self.of(node.args[0])
            case _:
                return super()._state(node)

    def _op(self, op: str, args: Sequence[Scalar]) -> Interval:
        if op in ("add", "sub") and any(_has_memory(self.analysis, arg) for arg in args):
            return self._sum(op, args)
        if op == "and":
            return super()._op(op, [self._now(arg) for arg in args])
        return super()._op(op, args)

    def _sum(self, op: str, args: Sequence[Scalar]) -> Interval:
        """Return a sum or difference, in which a quantity and its value one step ago are the same."""
        shares: dict[int, tuple[Scalar, float]] = {}
        for node, share in ((args[0], 1.0), (args[1], 1.0 if op == "add" else -1.0)):
            for part, factor in self._parts(self._now(node), share):
                key = self.analysis.identity(part)
                shares[key] = part, factor + shares.get(key, (part, 0.0))[1]
        total = ZERO
        for part, factor in shares.values():
            if abs(factor) > _MIN_FACTOR:
                total = iv.add(total, iv.multiply(self.of(part), iv.single(factor)))
        return total

    def _parts(self, node: Scalar, share: float) -> Iterator[tuple[Scalar, float]]:
        """Yield the summands of a sum, each with its factor."""
        match self.analysis.resolve_aliases(node):
            case Op("neg", (inner,)):
                yield from self._parts(inner, -share)
            case Op("add" | "sub" as op, (a, b)):
                yield from self._parts(a, share)
                yield from self._parts(b, share if op == "add" else -share)
            case Op("mul", (a, b)) if self.of(a).is_single:
                yield from self._parts(b, share * self.of(a).low)
            case Op("mul", (a, b)) if self.of(b).is_single:
                yield from self._parts(a, share * self.of(b).low)
            case Op("div", (a, b)) if self.of(b).is_single and self.of(b) != ZERO:
                yield from self._parts(a, share / self.of(b).low)
            case part:
                yield part, share

    def _now(self, node: Scalar) -> Scalar:
        """Return the same value, with each quantity one step ago replaced by the quantity."""
        if not _has_memory(self.analysis, node):
            return node
        match self.analysis.resolve_aliases(node):
            case State("previous", (inner, *_)):
                return self._now(inner)
            case Op(op, args):
                return Op(op, tuple(self._now(arg) for arg in args))
            case meaning:
                return meaning


def _has_memory(analysis: RangeAnalysis, node: Scalar) -> bool:
    """Return whether a value depends on earlier timesteps."""
    return any(isinstance(part, State) for part in analysis.walk_definitions(node))


@rule("DB708", versions="training")
def hovering_pays(context: RuleContext) -> Iterator[Finding]:
    """Report that an episode can collect more reward without success than success pays."""
    analysis = context.analysis
    reward = context.analysis.reward
    ordinary, final = reward.split_by_end()
    successes = context.program.successes
    if not reward.is_complete or len(successes) != 1 or not ordinary:
        return
    success = successes[0]
    running = reward.ranges_while_running()
    possible = (
        TRUTH
        if success.foreign
        else analysis.ranges_in(0.0, float(analysis.last_step)).of(analysis.scalars(success)[0])
    )
    if possible == NEVER or success in analysis.shadowed:
        return  # DB801, DB804
    repeat, steps = context.program.action_repeat, _steps_from(analysis, success)
    fine = min(0.0, total_range(final, reward.ranges_at(None)).high)
    has_no_choice = [*comparisons(analysis, success)] == [*comparisons(analysis, success, ["and"])]
    for threshold in _ways_to_avoid(analysis, success):
        waiting = _just_before(running, threshold)
        is_open = threshold is None or has_no_choice
        # A step of the agent sums the reward of its timesteps.
        paid = {term: repeat * _pay(waiting, node, is_open=is_open) for term, node in reward.terms}
        pay = sum(paid.values())
        if not 0.0 < pay < INF:
            continue
        # A quantity that a success remembers, as in `hold`, may have any value when it holds.
        is_near = threshold is None or threshold.now or threshold.one_of_two
        at_success = _just_before(reward.ranges_at(success), threshold if is_near else None)
        prize = total_range(reward.terms, at_success).high
        if pay * steps + fine > prize and pay * min(steps, horizon(reward)) > MIN_WORTH * prize:
            last = total_range(final, at_success).high
            raised = f"`{success.name}` pay more than {number_text(pay * steps + fine - prize + last)}"
            best, node = max(ordinary, key=lambda term: paid[term[0]])
            once = at_success.of(node).high
            share = (prize - once - fine - (pay - paid[best]) * steps) / (paid[best] * steps - once or INF)
            lowered = _lowered(best.text, share) if 0.0 < share < 1.0 else ""
            yield Finding(
                "DB708",
                best.span,
                f"an episode that avoids `{success.name}` can collect up to {number_text(pay, 3)} per step,"
                f" {number_text(pay * steps)} in all, but `{success.name}` pays"
                f" {f'{number_text(prize, 3)} only once' if last > 0.0 else 'nothing'}",
                f"{lower_help(best, lowered, raised)}{_end_at_one_time(analysis, success)}",
                labels=(Label(success.span, "ends these payments"),),
                fix=Fix.replacing(best.span, best.text, lowered, safe=False) if lowered else None,
            )
            return


def _end_at_one_time(analysis: Analysis, success: Expression) -> str:
    """Return the help for a success that may wait for the time limit, of a scenario with one."""
    limit = analysis.last_step * analysis.period
    if not limit < INF:
        return ""
    return (
        f", or let all episodes last equally long, with `{success.name}: time >"
        f" {limit - analysis.period / 2.0:.6g} s and ...`"
    )


def _pay(waiting: Ranges, node: Scalar, *, is_open: bool) -> float:
    """Return the reward of a term in each step of waiting. If other facts are open (`is_open`), this is the
    largest value that they allow, and for memories the value that is certain.

    A memory such as `running_max` may have any value of its range, but does not pay its rise in each step.
    """
    paid = waiting.of(node)
    return paid.high if is_open and not _has_memory(waiting.analysis, node) else paid.low


def _ways_to_avoid(analysis: Analysis, success: Expression) -> list[Threshold | None]:
    """Return the thresholds of a success, at each of which it may barely not hold; None for one that compares
    nothing, such as a contact."""
    running = analysis.reward.ranges_while_running()
    compared = list(comparisons(analysis, success))
    ways: list[Threshold | None] = [
        threshold
        for entry in compared
        for threshold in thresholds(entry, running)
        if not is_clock(analysis, threshold.quantity)
    ]
    return ways if compared else [None]


def _first_step(analysis: RangeAnalysis, ending: Expression) -> float:
    """Return the first step in which an ending may hold, as in `time > 5 s and still`, or `duration(still) >
    5 s`."""
    first = 0.0
    ranges = analysis.ranges_in(0.0, float(analysis.last_step))
    if ending.foreign is None:
        for node in analysis.conjuncts(*analysis.scalars(ending)[:1]):
            match node:
                case Op("greater" | "greater_equal", (late, limit)) | Op(
                    "less" | "less_equal", (limit, late)
                ):
                    clock = analysis.resolve_aliases(late)
                    if isinstance(clock, State) and clock.function == "duration":
                        clock = Name("time")
                    if isinstance(clock, Name) and clock.name in _CLOCKS:
                        first = max(
                            first, ranges.of(limit).low / (analysis.period if clock.name == "time" else 1.0)
                        )
    return min(first, float(analysis.last_step))


def _steps_from(analysis: RangeAnalysis, ending: Expression) -> float:
    """Return the steps of the agent after the first one in which an ending may hold."""
    return max(0.0, analysis.last_step - ceil(_first_step(analysis, ending)))


def _just_before(ranges: Ranges, threshold: Threshold | None) -> Ranges:
    """Return the ranges while nothing moves, within a fifth of a threshold, on the side where the episode
    goes on."""
    restriction = None
    if threshold is not None:
        low, high = threshold.bound
        side = (
            Interval(low - 0.2 * abs(low), low) if threshold.above else Interval(high, high + 0.2 * abs(high))
        )
        restriction = (ranges.analysis.identity(threshold.quantity), side)
    return _StillRanges(ranges.analysis, ranges.assumed, ranges.steps, restriction)


_MAX_SHOWN = 60
"""The number of characters of an expression in a help text."""
_EDGE_SHARE = 0.1
"""Near the middle, and near the failure, as a share of the way between both."""
_RATES = frozenset({"velocity", "angular_velocity", "angular_momentum"})
"""The facts that do not depend on the place of a body."""


@rule("DB703", versions="training")
def suspicious_sign(context: RuleContext) -> Iterator[Finding]:
    """Report a reward with the wrong sign: a failure pays, a success costs, or progress towards success
    costs."""
    reward = context.analysis.reward
    program = context.program
    ordinary, final = reward.split_by_end()
    for term, node in final:
        for ending in program.endings:
            paid = reward.ranges_at(ending).of(node)
            failed = ending.name in program.failures
            other_ends = (
                end
                for end in reward.endings_and_truncation
                if end is None or (end.name in program.failures) != failed
            )
            if any(reward.ranges_at(end).of(node) != ZERO for end in other_ends):
                continue  # paid at ends of another kind as well, so its sign has no meaning for this one
            if paid.low > 0.0 if failed else paid.high < 0.0:
                verb = (
                    f"pays {number_text(paid.low, 3)}"
                    if paid.low > 0.0
                    else f"costs {number_text(-paid.high, 3)}"
                )
                kind = "a failure" if failed else "a success"
                also = (Label(ending.span, f"{kind} here"),)
                yield _wrong_sign(term, f"`{ending.name}` is {kind}, but {verb}", also)
                break
    if reward.is_complete and len(program.successes) == 1:
        yield from _away_from_success(reward, ordinary, program.successes[0])


def _wrong_sign(term: Expression, headline: str, also: tuple[Label, ...]) -> Finding:
    opposite = negated_text(term.typed)(term.text)
    fix = Fix.replacing(term.span, term.text, opposite, safe=False)
    help = f"reverse the sign: `{opposite}`" if len(opposite) <= _MAX_SHOWN else "reverse the sign"
    return Finding("DB703", term.span, headline, help, labels=also, fix=fix)


def _away_from_success(reward: RewardTerms, ordinary: Terms, ending: Expression) -> Iterator[Finding]:
    """Report terms that pay for the opposite of the one comparison of a success."""
    analysis = reward.analysis
    running = reward.ranges_while_running()
    compared = only_comparison(analysis, ending)
    if compared:
        for threshold in thresholds(compared, running):
            if is_clock(analysis, threshold.quantity) or threshold.one_of_two:
                continue
            slope = Slope(running, threshold)
            wrong = -1.0 if threshold.above else 1.0
            slopes = [slope.of(node) for _, node in ordinary]
            if all(sign in (wrong, 0.0) for sign in slopes) and wrong in slopes:
                for (term, _), sign in zip(ordinary, slopes, strict=True):
                    if sign == wrong:
                        headline = f"`{term.name}` pays less as the episode approaches `{ending.name}`"
                        yield _wrong_sign(
                            term, headline, (Label(ending.span, "success requires the opposite"),)
                        )
                return


class Slope:
    """The sign of the slope of a value over the quantity of a threshold: 1, -1, 0 if it does not depend on
    it, None if unknown.

    The slope of a condition is 0 or None; the slope of `where` is that of its branches.
    """

    def __init__(self, ranges: Ranges, threshold: Threshold) -> None:
        self._analysis = ranges.analysis
        self._ranges = ranges
        self._quantity = self._analysis.identity(threshold.quantity)
        self._pair = self._analysis.distance_pair(threshold.quantity)
        self._known: dict[Name, float | None] = {}

    def of(self, node: Scalar) -> float | None:
        if self._analysis.identity(node) == self._quantity:
            return 1.0
        if self._pair is not None and self._analysis.distance_pair(node) == self._pair:
            return 1.0  # another measure of the same distance
        match node:
            case Name():
                if node not in self._known:
                    meaning = self._analysis.resolve_aliases(node)
                    self._known[node] = 0.0 if isinstance(meaning, Name) else self.of(meaning)
                return self._known[node]
            case State("previous", _):
                return 0.0
            case State(function, args):
                return self._call(function, args)
            case Op(op, args):
                return self._op(op, args)
            case _:
                return 0.0

    def _call(self, function: str, args: tuple[Scalar, ...]) -> float | None:
        slopes = function_named(function).slopes
        if not slopes:
            return self._independent(args)
        signs = chain(slopes, repeat(slopes[-1]))
        return _sum([_times(self.of(arg), sign) for arg, sign in zip(args, signs, strict=False)])

    def _op(self, op: str, args: tuple[Scalar, ...]) -> float | None:
        match op:
            case "where":
                # Two constant branches still make a jump where the condition depends on the quantity.
                slope = _sum([self.of(arg) for arg in args[1:]])
                return slope if slope or self.of(args[0]) == 0.0 else None
            # The product rule: (a b)' = a' b + a b'.
            case "mul":
                a, b = args
                return _sum([_times(self.of(a), self._sign(b)), _times(self.of(b), self._sign(a))])
            # The quotient rule without its divisor b^2, which is positive: a' b - a b'.
            case "div":
                a, b = args
                return _sum(
                    [_times(self.of(a), self._sign(b)), _times(_times(self.of(b), self._sign(a)), -1.0)]
                )
            case "abs":
                return _times(self.of(args[0]), self._sign(args[0]))
            case "pow":
                # Above 0, x^n rises for a positive n and falls for a negative one; 0^n has no value for that.
                base, exponent = self._ranges.of(args[0]), self._ranges.of(args[1])
                if base.low >= 0.0 and exponent.low > 0.0:
                    sign = 1.0
                elif base.low > 0.0 and exponent.high < 0.0:
                    sign = -1.0
                else:
                    sign = None
                return _times(self.of(args[0]), sign)
            case _:
                return self._call(op, args)

    def _sign(self, node: Scalar) -> float | None:
        interval = self._ranges.of(node)
        if interval.low >= 0.0:
            return 1.0
        if interval.high <= 0.0:
            return -1.0
        return None

    def _independent(self, args: tuple[Scalar, ...]) -> float | None:
        return 0.0 if all(self.of(arg) == 0.0 for arg in args) else None


def _times(slope: float | None, sign: float | None) -> float | None:
    if 0.0 in (slope, sign):
        return 0.0
    return None if slope is None or sign is None else slope * sign


def _sum(slopes: list[float | None]) -> float | None:
    """Return the slope in which all parts agree that are not 0."""
    nonzero = {slope for slope in slopes if slope != 0.0}
    if not nonzero:
        return 0.0
    if len(nonzero) == 1:
        return nonzero.pop()
    return None


@rule(
    "DB706",
    "`{term}` depends on the {kind} `{source}`, which the policy does not observe",
    "add an entry that uses `{source}` under `augment`, and list this entry under `observation`",
    versions="training",
)
def hidden_state_reward(context: RuleContext) -> Iterator[Match]:
    """Report a reward that depends on a value that differs between episodes and that the policy does not
    observe."""
    analysis = context.analysis.ideal
    program = context.program
    observed = [entry.value for entry in program.agent.observation]
    observed += (
        [program.agent.goal.achieved, program.agent.goal.desired] if program.agent.goal is not None else []
    )
    observed_names = {
        dependency
        for value in observed
        for node in analysis.scalars(value)
        for dependency in analysis.drawn_dependencies(node)
    }
    perceives = any(SENSORS[sensor.kind].perceives for robot in program.robots for sensor in robot.sensors)
    perceives = perceives or any(entry.value.typed.type.picture for entry in program.agent.observation)
    drawn_names = {value.name for value in program.parameters}
    walls = set(context.namespace.walls)  # their pieces, such as `bay 1`, never move
    objects = {body.name for body in program.world.objects if body.name.partition(" ")[0] not in walls}
    bodies = set() if perceives else objects | {robot.name for robot in program.world.robots}
    for term, node in analysis.reward.terms:
        hidden = sorted((analysis.drawn_dependencies(node) - observed_names) & (drawn_names | bodies))
        if hidden:
            used = set(referenced_names(term.typed))
            between = [
                value
                for value in program.signals
                if value.name in used and hidden[0] in referenced_names(value.typed)
            ]
            labels = tuple(Label(value.span, f"depends on `{hidden[0]}`") for value in between)
            kind = "drawn parameter" if hidden[0] in drawn_names else "body"
            yield Match(term.span, labels=labels, term=term.name, kind=kind, source=hidden[0])


@rule(
    "DB710",
    "`{term}` pays more as the episode approaches `{ending}`",
    "reward the opposite, as in `{opposite}`",
    versions="training",
)
def pays_towards_failure(context: RuleContext) -> Iterator[Match]:
    """Report a term that pays more as the episode approaches a failure."""
    analysis = context.analysis
    reward = context.analysis.reward
    if context.program.agent.goal is not None or not reward.is_complete:
        return
    ordinary, _ = reward.split_by_end()
    for ending in context.program.endings:
        compared = only_comparison(analysis, ending) if ending.name in context.program.failures else None
        threshold = next(thresholds(compared, reward.ranges_while_running()), None) if compared else None
        if compared is None or threshold is None or not _counts_from_middle(reward, threshold):
            continue
        labels, opposite = (Label(ending.span, "a failure"),), _opposite(compared, threshold)
        for term in _towards(reward, threshold, ordinary):
            yield Match(term.span, labels=labels, term=term.name, ending=ending.name, opposite=opposite)


def _counts_from_middle(reward: RewardTerms, threshold: Threshold) -> bool:
    """Return whether a quantity counts from a middle up to a limit, and depends on the present alone."""
    interval = reward.ranges_while_running().of(threshold.quantity)
    is_place = (
        threshold.dimension in (LENGTH, ANGLE)
        and threshold.above
        and interval.low == 0.0 < threshold.bound.low
    )
    return is_place and not any(
        isinstance(part, State) for part in reward.analysis.walk_definitions(threshold.quantity)
    )


def _towards(reward: RewardTerms, threshold: Threshold, terms: Terms) -> list[Expression]:
    """Return the terms that pay more just before the failure than in the middle; none where another term or a
    success concerns the same."""
    analysis = reward.analysis
    running = reward.ranges_while_running()
    slope = Slope(reward.ranges_while_running(), threshold)
    limit = threshold.bound.low
    quantity = analysis.identity(threshold.quantity)
    middle = running.where(quantity, Interval(0.0, _EDGE_SHARE * limit))
    edge = running.where(quantity, Interval((1.0 - _EDGE_SHARE) * limit, limit))
    # The ranges are disjoint: each value near the failure is above each one in the middle.
    wrong = [
        term for term, node in terms if slope.of(node) == 1.0 and edge.of(node).low > middle.of(node).high
    ]
    if any(ending.foreign for ending in reward.program.endings):
        return []
    right_nodes = [node for term, node in terms if term not in wrong]
    right_nodes += [analysis.scalars(ending)[0] for ending in reward.program.successes]
    concerned = _concerns(analysis, threshold.quantity)
    return [] if any(concerned & _concerns(analysis, node) for node in right_nodes) else wrong


def _concerns(analysis: RangeAnalysis, node: Scalar) -> set[str]:
    """Return the names without definition that a value depends on, and the bodies on whose places it
    depends."""
    bodies: set[str] = set()
    for part in analysis.walk_definitions(node):
        match part:
            case Name(name):
                bodies.add(name)
            case EngineRead(function, subjects) if function not in _RATES:
                bodies |= {subject.partition(".")[0] for subject in subjects}
    return bodies


def _opposite(compared: ConditionComparison, threshold: Threshold) -> str:
    """Return a term that pays less as a quantity approaches its limit."""
    side = compared.node.args[0 if compared.node.operator.startswith("greater") else 1]
    quantity = compared.value.text[side.start : side.end]
    assert threshold.dimension is not None  # a length or an angle
    return f"exp(-{quantity} / {with_unit(threshold.bound.low / 2, threshold.dimension)})"
