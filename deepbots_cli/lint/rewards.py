"""The size of the reward: terms without bound, terms that dominate or never pay, and the value of an episode
(family DB7, DB810); rewards of two agents that compete (DB718)."""

from __future__ import annotations

from collections.abc import Hashable, Iterator
from itertools import accumulate, combinations
from math import isclose
from typing import Literal, NamedTuple

from deepbots_cli.analysis import Analysis
from deepbots_cli.analysis.conditions import comparisons, thresholds
from deepbots_cli.analysis.ranges import Ranges, return_range
from deepbots_cli.diagnostics import Finding, Label
from deepbots_cli.document.nodes import NodePath
from deepbots_cli.expressions.dimensions import NUMBER
from deepbots_cli.expressions.intervals import INF, TRUTH, ZERO, Interval
from deepbots_cli.expressions.scalar import walk
from deepbots_cli.expressions.types import Constant, Invocation, Operation, Reference, TypedNode, children
from deepbots_cli.lint.context import Match, RuleContext, Simulation, rule
from deepbots_cli.lint.endings import impossible_contact
from deepbots_cli.lint.observations import linear
from deepbots_cli.program import Member
from deepbots_cli.program.values import Expression
from deepbots_cli.words import number_text

_DOMINANCE_RATIO = 100.0
"""The ratio of a term to the payment of an ending above which the term hides the ending."""
_RELATIVE_ROUNDING = 1e-9
_MIN_STEPS = 200
"""The number of simulated steps below which nothing is concluded."""
_MAX_SHOWN_CHARACTERS = 40
"""The length of the longest divisor that the help of a finding repeats."""


# Without bound


class Singularity(NamedTuple):
    """The part of an expression that makes a term unbounded: a divisor or the argument of a logarithm, which
    may be zero, or the argument of an exponential."""

    value: Expression
    node: TypedNode
    kind: Literal["divisor", "logarithm", "exponential"]


@rule("DB701")
def reward_unbounded(context: RuleContext) -> Iterator[Finding]:
    """Report a term of the reward without bound."""
    analysis = context.analysis
    search = _PoleSearch(analysis)
    for term in context.program.agent.reward:
        if term.foreign is None and not search.ranges.of(analysis.scalars(term)[0]).is_finite:
            singularity = search.pole(term)
            if singularity is not None:
                yield _unbounded(context, term, singularity)
            elif search.ranges.of(analysis.scalars(term)[0]).is_single:
                yield Finding(
                    "DB701",
                    term.span,
                    f"`{term.name}` is infinite in every step",
                    "bound it, as in `min(x, 1)`, or use a `distance` in place of a `clearance` to what"
                    " nothing touches",
                )


def _unbounded(context: RuleContext, term: Expression, singularity: Singularity) -> Finding:
    text = context.text(singularity.value.owner)
    span = text.part(singularity.node.start, singularity.node.end)
    part = text.text[singularity.node.start : singularity.node.end]
    also = () if singularity.value is term else (Label(term.span, f"`{term.name}` depends on it"),)
    if singularity.kind == "exponential":
        headline = f"`{term.name}` grows with the exponential of `{part}`, which has no upper bound"
        return Finding("DB701", span, headline, "bound the argument, as in `min(x, 3)`", labels=also)
    headline = f"`{term.name}` grows without bound as `{part}` approaches zero"
    unit = "" if singularity.node.type.dimension == NUMBER else f" {singularity.node.type.dimension}"
    depths = list(accumulate((character == "(") - (character == ")") for character in part))
    # In `(a) * (b)`, the first parenthesis closes before the end.
    divisor = part[1:-1] if part.startswith("(") and depths.index(0) == len(part) - 1 else part
    lowest = f"`max({divisor if len(divisor) <= _MAX_SHOWN_CHARACTERS else 'd'}, 0.1{unit})`"
    if singularity.kind == "logarithm":
        help = f"keep the argument of `log` away from zero, as in {lowest}"
    else:
        help = (
            f"keep the divisor away from zero, as in {lowest}, or use an exponential, as in `exp(-d / 10"
            " cm)` for a length `d`"
        )
    return Finding("DB701", span, headline, help, labels=also)


class _PoleSearch:
    """Searches a term and the values that it refers to. Branches of `where` are left alone."""

    def __init__(self, analysis: Analysis) -> None:
        self._analysis = analysis
        self.ranges = analysis.ranges_in(1.0, float(analysis.last_step))
        compared = [
            entry
            for ending in analysis.program.endings
            for entry in comparisons(analysis, ending, ("or",), in_durations=False)
        ]
        self._guarded = {
            analysis.identity(threshold.quantity)
            for entry in compared
            for threshold in thresholds(entry, self.ranges)
            if threshold.decides
            and (threshold.bound.high < 0.0 if threshold.above else threshold.bound.low > 0.0)
        }
        """The quantities that end the episode before they come near zero."""

    def pole(self, term: Expression) -> Singularity | None:
        """Return the first part of a term that is infinite because of a pole or an exponential."""
        return self._pole(term, term.typed, set())

    def _pole(self, value: Expression, node: TypedNode, met: set[str]) -> Singularity | None:
        if node.type.boolean or all(interval.is_finite for interval in self._known(value, node)):
            return None
        match node:
            case Operation(operator="div", args=(_, below)) if self._may_be_zero(value, below):
                return Singularity(value, below, "divisor")
            case Operation(operator="pow", args=(base, exponent)) if exponent.type.interval.high < 0.0:
                return Singularity(value, base, "divisor") if self._may_be_zero(value, base) else None
            case Invocation(function="log", args=(inner,)) if self._may_be_zero(value, inner):
                return Singularity(value, inner, "logarithm")
            case Invocation(function="exp", args=(inner,)):
                grows = any(
                    interval.low > -INF and interval.high == INF for interval in self._known(value, inner)
                )
                return Singularity(value, inner, "exponential") if grows else None
            case Operation(operator="where"):
                return None
            case Reference(symbol=symbol) if (
                definition := self._analysis.expression_named(symbol.name)
            ) is not None and symbol.name not in met:
                met.add(symbol.name)
                if "." in symbol.name or definition.foreign:
                    return None
                return self._pole(definition, definition.typed, met)
        poles = (self._pole(value, part, met) for part in children(node))
        return next((pole for pole in poles if pole is not None), None)

    def _known(self, value: Expression, node: TypedNode) -> list[Interval]:
        return [self.ranges.of(part) for part in self._analysis.lowered(node, value.owner)]

    def _may_be_zero(self, value: Expression, node: TypedNode) -> bool:
        """Return whether a divisor may be zero; one whose type has two finite bounds is DB405.

        The ranges known here are narrower than that of the type: `step` ends at the time limit.
        """
        for part in self._analysis.lowered(node, value.owner):
            if (
                0.0 in self.ranges.of(part)
                and not node.type.interval.is_finite
                and self._guarded.isdisjoint(map(self._analysis.identity, walk(part)))
            ):
                return True
        return False


# Too large, too small


@rule(
    "DB702",
    "summed over an episode, `{term}` is at least {ratio} times as large as all other terms together",
    "scale `{term}` down, or the other terms up",
    simulated=True,
)
def term_dominated(simulation: Simulation) -> Iterator[Match]:
    """Report a term that under every policy adds up to more than a hundred times all other terms and
    endings."""
    if not simulation.is_complete or not simulation.measured:
        return
    reward = simulation.analysis.reward
    prize = reward.largest_final(reward.split_by_end()[1])
    prize = prize if prize < INF else 0.0
    terms = list(simulation.terms())
    for term, rows in terms:
        ratios, notes = [], []
        for by, row in rows.items():
            episodes = max(1, simulation.measured[by].episodes)
            other_sum = (
                sum(statistics[by].absolute_total for other, statistics in terms if other is not term)
                / episodes
            )
            size = row.absolute_total / episodes
            rival = max(other_sum, prize)
            ratios.append(size / rival if rival > 0.0 and row.low < row.high else 0.0)
            note = (
                f"{by}: `{term.name}` adds up to {number_text(size, 3)} per episode, all other terms to"
                f" {number_text(other_sum, 3)}"
            )
            notes.append(f"{note}, and an ending pays up to {number_text(prize, 3)}" if prize else note)
        if min(ratios) > _DOMINANCE_RATIO:
            yield Match(term.span, notes=tuple(notes), term=term.name, ratio=number_text(min(ratios), 3))


@rule("DB704", versions="every")
def inactive_term(context: RuleContext) -> Iterator[Finding]:
    """Report a term of the reward that is zero in every step."""
    analysis = context.analysis
    # An ending that never holds is DB801.
    endings = {ending.name: TRUTH for ending in context.program.endings}
    ranges = Ranges(analysis, endings, (1.0, float(analysis.last_step)))
    for term, node in analysis.reward.terms:
        if why := impossible_contact(analysis, node):
            yield Finding("DB704", term.span, *why)
        elif ranges.of(node) == ZERO and not _is_turned_off(term.typed, analysis):
            is_conditional = isinstance(term.typed, Operation) and term.typed.operator == "where"
            yield Finding(
                "DB704",
                term.span,
                f"`{term.name}` is zero in every step",
                f"remove the term, or correct its {'condition' if is_conditional else 'expression'}",
            )


def _is_turned_off(node: TypedNode, analysis: Analysis) -> bool:
    """Return whether an expression is 0, or has a factor 0, as a number or as a parameter."""

    def is_off(part: TypedNode) -> bool:
        return _is_turned_off(part, analysis)

    match node:
        case Constant(values=values):
            return not any(values)
        case Reference(symbol=symbol):
            # The names in the definition of a value of a message are those of a robot.
            definition = None if "." in symbol.name else analysis.expression_named(symbol.name)
            return (symbol.value is not None and not any(symbol.value)) or (
                definition is not None and is_off(definition.typed)
            )
        case Operation(operator="where", args=(_, paid, otherwise)):
            return is_off(paid) and is_off(otherwise)
        case Operation(operator="div", args=(above, _)):
            return is_off(above)
        case Operation(operator="add" | "sub", args=args):
            return all(map(is_off, args))
        case Invocation(function=function, args=args) if len(args) > 1:
            parts = [is_off(part) for part in args if not isinstance(part, Constant)]
            # One 0 of a `max` is no factor, and the bound in `max(0 * x, -1)` keeps nothing on.
            return bool(parts) and all(parts) if function in ("min", "max") else any(parts)
    return any(map(is_off, children(node)))


@rule(
    "DB704",
    "`{term}` was zero in all {steps} simulated steps",
    "correct the term, or add a script under `scripts` in which it is not zero",
    simulated=True,
)
def term_was_zero(simulation: Simulation) -> Iterator[Match]:
    """Report a term without a condition that was 0 in every step."""
    if not simulation.is_complete or simulation.steps < _MIN_STEPS:
        return
    analysis = simulation.analysis
    final = {term.name for term, _ in analysis.reward.split_by_end()[1]}
    for index, term in enumerate(simulation.program.agent.reward):
        if (
            index not in simulation.report.summary.zero_terms
            or term.name in final
            or term.foreign is not None
        ):
            continue
        if not _is_turned_off(term.typed, analysis) and not _is_conditional(term.typed, analysis, set()):
            yield Match(term.span, notes=(simulation.summary,), term=term.name, steps=simulation.steps)


def _is_conditional(node: TypedNode, analysis: Analysis, met: set[str]) -> bool:
    """Return whether a value depends on a condition, through any names."""
    if node.type.boolean:
        return True
    if isinstance(node, Reference) and node.symbol.name not in met:
        met.add(node.symbol.name)
        definition = analysis.expression_named(node.symbol.name)
        return definition is not None and (
            definition.foreign is not None or _is_conditional(definition.typed, analysis, met)
        )
    return any(_is_conditional(part, analysis, met) for part in children(node))


@rule(
    "DB707",
    "`{term}` is not finite",
    "against a division by zero, write `1 / max(d, 1 cm)` for a length `d`; against an overflow, `exp(min(n,"
    " 3))` for a number",
    simulated=True,
)
def non_finite_reward(simulation: Simulation) -> Iterator[Match]:
    """Report a term that is NaN or infinite."""
    failed = simulation.failed
    if failed is not None and failed.section == "reward":
        yield Match(failed.span, notes=failed.notes, term=failed.name)


# Returns


@rule("DB711", versions="every")
def nothing_to_learn(context: RuleContext) -> Iterator[Finding]:
    """Report that every episode has the same return, whatever the policy does."""
    possible = return_range(context.analysis.reward)
    if context.program.agent.training is None or not possible.is_single:
        return
    worth = possible.low
    headline = f"every episode has the return {number_text(worth)}, whatever the policy does"
    help = (
        "reward the goal, as in `1 when goal_reached`"
        if context.program.agent.goal
        else "reward the intended behavior"
    )
    if worth > 0.0:
        help += ", or add a failure that ends a bad episode early"
    elif worth < 0.0:  # a failure would end the costs (DB705)
        help += ", or add a success that ends a good episode early"
    yield Finding("DB711", context.program.agent.reward[0].span, headline, help)


@rule("DB810", versions="base")
def return_out_of_reach(context: RuleContext) -> Iterator[Finding]:
    """Report that no episode can reach the required mean return, or that every episode does."""
    for analysis, required, path in _wanted_returns(context):
        possible = return_range(analysis.reward)
        if required > possible.high + _RELATIVE_ROUNDING * abs(possible.high):
            headline = (
                f"no episode reaches the required return of {required:g}: the highest possible return"
                f" is {number_text(possible.high)}"
            )
            pays = "let good steps earn a positive reward, or " if required > 0.0 >= possible.high else ""
            yield Finding("DB810", context.values.span(path), headline, f"{pays}require a smaller return")
        elif required <= possible.low:
            headline = (
                f"every episode reaches the required return of {required:g}: the lowest possible return"
                f" is {number_text(possible.low)}"
            )
            yield Finding("DB810", context.values.span(path), headline, "require a larger return")


def _wanted_returns(context: RuleContext) -> Iterator[tuple[Analysis, float, NodePath]]:
    """Yield the required mean returns of the scenario, each with the version of the scenario and its
    place."""
    program = context.program
    if program.agent.solved is not None and program.agent.solved.mean_return is not None:
        yield context.analysis, program.agent.solved.mean_return, ("solved",)
    for index, stage in enumerate(program.curriculum):
        if stage.until is not None and stage.until.metric == "mean_return":
            yield Analysis(stage.program), stage.until.threshold, ("curriculum", index, "until")


@rule("DB718", versions="training")
def nearly_zero_sum(context: RuleContext) -> Iterator[Finding]:
    """Two agents get opposite multiples of the same value that do not cancel."""
    program = context.program
    if not program.has_rivals:
        return
    for member, rival in combinations(program.members.values(), 2):
        factors, rival_factors = (_factors(context.analysis, agent) for agent in (member, rival))
        for quantity in factors.keys() & rival_factors.keys():
            (factor, term), (rival_factor, rival_term) = factors[quantity], rival_factors[quantity]
            if factor * rival_factor >= 0.0 or isclose(factor, -rival_factor, rel_tol=1e-9):
                continue
            yield Finding(
                "DB718",
                rival_term.span,
                f"`{rival_term.name}` of `{rival.name}` pays {_number(rival_factor)} where `{term.name}` of"
                f" `{member.name}` pays {_number(factor)}, so the rewards of the two do not add up to zero",
                f"write {_number(-factor)} here if one agent should gain what the other loses",
                labels=(Label(term.span, "the same value for the other agent"),),
            )


def _factors(analysis: Analysis, member: Member) -> dict[Hashable, tuple[float, Expression]]:
    """Return what an agent gets for each quantity, the sum of the factors of its terms, with the first
    term; its own names are replaced by those of the whole scenario."""
    factors: dict[Hashable, tuple[float, Expression]] = {}
    for term in member.program.agent.reward:
        if term.foreign is None:
            tree = member.names.expression(term, of_agent=False).scalar
            for quantity, factor in linear(analysis, tree, {}).terms.items():
                sum_before, first = factors.get(quantity, (0.0, term))
                factors[quantity] = sum_before + factor, first
    return factors


def _number(value: float) -> str:
    return f"{value:.4g}"
