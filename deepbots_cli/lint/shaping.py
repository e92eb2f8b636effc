"""The direction of the reward: its sign (DB703), hidden state (DB706), reward that leads into a failure
(DB710)."""

from __future__ import annotations

from collections.abc import Iterator

from deepbots_cli.analysis import Analysis
from deepbots_cli.analysis.conditions import (
    ORDER_PRESERVING,
    ConditionComparison,
    Threshold,
    is_clock,
    only_comparison,
    thresholds,
)
from deepbots_cli.analysis.ranges import Ranges, with_unit
from deepbots_cli.analysis.returns import RewardTerms, Terms
from deepbots_cli.diagnostics import Finding, Fix, Label
from deepbots_cli.expressions.dimensions import ANGLE, LENGTH
from deepbots_cli.expressions.intervals import ZERO, Interval
from deepbots_cli.expressions.scalar import EngineRead, Name, Op, Scalar, State
from deepbots_cli.expressions.types import referenced_names
from deepbots_cli.expressions.unification import negated_text
from deepbots_cli.lint.context import Match, RuleContext, rule
from deepbots_cli.program.values import Expression
from deepbots_cli.scenario.sensors import SENSORS
from deepbots_cli.words import number_text

_RISING_FUNCTIONS = ORDER_PRESERVING | {"delta", "integral", "accumulate", "exp", "log", "sqrt", "clamp"}
"""The functions that rise with their first argument."""
_MAX_SHOWN = 60
"""The number of characters of an expression in a help text."""
_EDGE_SHARE = 0.1
"""Near the middle, and near the failure, as a share of the way between both."""
_RATE_FUNCTIONS = frozenset({"velocity", "angular_velocity", "angular_momentum"})
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
            if is_clock(analysis, threshold.quantity):
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
                return self.of(args[0]) if function in _RISING_FUNCTIONS else self._independent(args)
            case Op(op, args):
                return self._op(op, args)
            case _:
                return 0.0

    def _op(self, op: str, args: tuple[Scalar, ...]) -> float | None:
        match op:
            case "neg":
                return _times(self.of(args[0]), -1.0)
            case "add" | "min" | "max":
                return _sum([self.of(arg) for arg in args])
            case "sub":
                return _sum([self.of(args[0]), _times(self.of(args[1]), -1.0)])
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
            case _ if op in _RISING_FUNCTIONS:
                return _sum([self.of(arg) for arg in args])
            case _:
                return self._independent(args)

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
    if slope == 0.0:
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


def _concerns(analysis: Analysis, node: Scalar) -> set[str]:
    """Return the names without definition that a value depends on, and the bodies on whose places it
    depends."""
    bodies: set[str] = set()
    for part in analysis.walk_definitions(node):
        match part:
            case Name(name):
                bodies.add(name)
            case EngineRead(function, subjects) if function not in _RATE_FUNCTIONS:
                bodies |= {subject.partition(".")[0] for subject in subjects}
    return bodies


def _opposite(compared: ConditionComparison, threshold: Threshold) -> str:
    """Return a term that pays less as a quantity approaches its limit."""
    side = compared.node.args[0 if compared.node.operator.startswith("greater") else 1]
    quantity = compared.value.text[side.start : side.end]
    assert threshold.dimension is not None  # a length or an angle
    return f"exp(-{quantity} / {with_unit(threshold.bound.low / 2, threshold.dimension)})"
