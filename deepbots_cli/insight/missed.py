"""The condition of the success that episodes without success have in common because they miss it."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import median

from deepbots_cli.insight.conditions import (
    SIGN_OF_OPERATOR,
    Comparison,
    Condition,
    MeasuredComparison,
    comparisons_in,
    measure,
)
from deepbots_cli.insight.statements import Numbers, list_text, quantity_text, statement
from deepbots_cli.insight.trace import Trace
from deepbots_cli.insight.training import TrainingEvidence

_MIN_EPISODES = 3
_COMMON = 0.75
"""The share of the episodes that miss a condition most from which it is common to them."""
_SELDOM, _OFTEN = 0.25, 0.1
"""The limits of a condition that prevents a success: it is true in less than `_SELDOM` times as many moments
as each other one, and each other one is true in `_OFTEN` of all moments."""
_CLOCKS = re.compile(r"\s*(?:time|step)\s*")


@dataclass(frozen=True)
class MissedCondition:
    """A condition of a success in episodes without this success.

    Attributes:
        ending: The success.
        condition: The condition, one of several.
        true: The number of moments in which it is true; `moments` is the number of all moments.
        nearest: The median, over the episodes, of the value that is nearest to the threshold, in SI units;
            None for a truth value.
        bound: The threshold, in SI units.
        others: The number of moments in which each other condition is true, by its text.
        episodes: The number of episodes that miss it most; `of` is the number of all episodes.
    """

    ending: str
    condition: Comparison
    true: int
    moments: int
    nearest: float | None
    bound: float | None
    others: Mapping[str, int]
    episodes: int
    of: int


def missed_success(trace: Trace) -> tuple[str, Condition | None]:
    """Return the first success with a bound that an episode without a success missed, and its condition."""
    if trace.outcome not in ("success", "error"):
        for name in (*trace.program.agent.success, "goal_reached"):
            condition = trace.instrumented.conditions.get(name)
            if condition is not None and any(leaf.bound is not None for leaf in comparisons_in(condition)):
                return name, condition
    return "", None


def inner_comparisons(condition: Condition) -> list[Comparison]:
    """Return the comparisons of a condition, including those that must be true for a time."""
    outer = comparisons_in(condition)
    return [
        comparison
        for leaf in outer
        for comparison in (comparisons_in(leaf.lasting) if leaf.lasting else [leaf])
    ]


def nearest_moment(
    trace: Trace, leaf: Comparison, moments: Sequence[int] = ()
) -> tuple[int, MeasuredComparison]:
    """Return the first of the moments in which a comparison came nearest to its bound, or went farthest
    beyond it."""
    past = {step: measure(leaf, trace.values[step]) for step in moments or range(len(trace.values))}
    step = max(
        past, key=lambda step: float(past[step].holds if (margin := past[step].margin) is None else margin)
    )
    return step, past[step]


def common_miss(traces: Sequence[Trace]) -> MissedCondition | None:
    """Return the success condition that all episodes without success miss, None if they differ."""
    misses = [(trace, *missed_success(trace)) for trace in traces]
    missed = [
        (trace, name, inner_comparisons(condition))
        for trace, name, condition in misses
        if condition is not None
    ]
    if len(missed) < _MIN_EPISODES:
        return None
    ending = Counter(name for _, name, _ in missed).most_common(1)[0][0]
    pairs = [(trace, _without_clocks(leaves)) for trace, name, leaves in missed if name == ending]
    leaves = pairs[0][1]
    if len(leaves) < 2 or len(pairs) < _MIN_EPISODES:
        return None
    counts = [
        [sum(measure(leaf, values).holds for values in trace.values) for leaf in leaves] for trace, _ in pairs
    ]
    worst = Counter(row.index(min(row)) for row in counts)
    index, episodes = worst.most_common(1)[0]
    moments = sum(len(trace.values) for trace, _ in pairs)
    totals = [sum(row[k] for row in counts) for k in range(len(leaves))]
    others = {
        leaf.text: total for k, (leaf, total) in enumerate(zip(leaves, totals, strict=True)) if k != index
    }
    fewest = min(others.values(), default=0)
    if episodes < _COMMON * len(pairs) or fewest < _OFTEN * moments or totals[index] > _SELDOM * fewest:
        return None
    leaf = leaves[index]
    values = [nearest_moment(trace, leaf)[1] for trace, _ in pairs]
    bounds = [comparison.bound for comparison in values if comparison.bound is not None]
    return MissedCondition(
        ending=ending,
        condition=leaf,
        true=totals[index],
        moments=moments,
        nearest=median(comparison.value for comparison in values) if bounds else None,
        bound=median(bounds) if bounds else None,
        others=others,
        episodes=episodes,
        of=len(pairs),
    )


def _without_clocks(leaves: Sequence[Comparison]) -> list[Comparison]:
    """Return the comparisons without those of the time, which are true at the end of each long episode."""
    return [leaf for leaf in leaves if not any(_CLOCKS.fullmatch(side) for side in leaf.sides)]


@statement(
    "missed_condition",
    "Episodes without success miss the same condition of '{ending}': in {episodes} of {of}, `{condition}` is"
    " true least often, in {true} of {moments} moments{nearest}. {others}.",
    advice="{remedy}, or loosen the threshold. `deepbots diagnose RUN --episode failed` shows one of these"
    " episodes.",
)
def missed_condition(evidence: TrainingEvidence) -> Numbers | None:
    failed = evidence.failed or [
        trace for trace in evidence.policy if trace.outcome in ("failure", "time limit")
    ]
    miss = common_miss(failed)
    if miss is None or not evidence.is_mature:
        return None
    leaf, unit = miss.condition, evidence.facts.units.of(miss.condition.unit, *reversed(miss.condition.sides))
    near = ""
    if miss.nearest is not None and miss.bound is not None:
        value, bound = (quantity_text(number, unit, 3) for number in (miss.nearest, miss.bound))
        near = f"; the nearest value is {value} in the median, and the threshold {bound}"
    terms = evidence.facts.terms_about(leaf.text)
    aim = (
        f"`{leaf.sides[0]}` {SIGN_OF_OPERATOR[leaf.operator]} the threshold"
        if leaf.bound
        else f"`{leaf.text}`"
    )
    remedy = f"Reward what brings {aim} where the other conditions hold"
    if terms:
        names = list_text([f"'{term}'" for term in terms])
        remedy = f"Raise what {names} pays for {aim}"
    sentences = [f"`{text}` is true in {count:,}" for text, count in miss.others.items()]
    return {
        "likelihood": 0.69,
        "ending": miss.ending,
        "condition": leaf.text,
        "episodes": miss.episodes,
        "of": miss.of,
        "true": miss.true,
        "moments": miss.moments,
        "nearest": near,
        "nearest_value": miss.nearest,
        "threshold": miss.bound,
        "unit": leaf.unit,
        "others": list_text(sentences),
        "terms": list(terms),
        "remedy": remedy,
    }
