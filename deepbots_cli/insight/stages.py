"""Causes in the stage of a curriculum, in the starts of episodes, or in missing success."""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from decimal import ROUND_FLOOR, Context
from statistics import fmean, median
from typing import Any

import numpy as np

from deepbots_cli.document.nodes import entries_at, inline_text
from deepbots_cli.errors import DeepbotsError
from deepbots_cli.insight.statements import (
    Numbers,
    Percentage,
    StatementRule,
    SuccessRate,
    list_text,
    quantity_text,
)
from deepbots_cli.insight.trace import (
    SIGN_OF_OPERATOR,
    Comparison,
    Trace,
    inner_comparisons,
    measure,
    missed_success,
    nearest_moment,
)
from deepbots_cli.insight.training import (
    MIN_EPISODES,
    MIN_QUARTER,
    TrainingEvidence,
    Trend,
    last_quarter,
)
from deepbots_cli.learning.runs.evaluations import DrawLabel, DrawnPart, draw_labels, drawn_effects
from deepbots_cli.program.task import SUCCESS, Criterion
from deepbots_cli.records import dataclass
from deepbots_cli.rollout import Episode
from deepbots_cli.rollout.source import Source
from deepbots_cli.words import number_text, rate_text

_RARE = 0.03  # a success rate that is as good as none
_MAX_SORTED = 2_000  # episodes of a training that are sorted by what they draw
_CHANCE = 1e-4  # of a value that has nothing to do with success to be named, over all values

# The present stage


def _present(evidence: TrainingEvidence) -> Numbers:
    late = evidence.late_success
    evaluated = "" if evidence.evaluations else "It was not evaluated in this stage yet. "
    if late.episodes:
        evaluated = f"At the end of this stage, the policy succeeds in {late}. "
    until, value = criterion(evidence), criterion_value(evidence)
    now = "" if value is None or until is None else f"; now it is {criterion_number(until, value)}"
    return {
        "stage": evidence.stage,
        "number": evidence.stage_index + 1,
        "count": len(evidence.stages),
        "since": evidence.first_step,
        "steps": evidence.steps,
        "success": late if late.episodes else None,
        "evaluated": evaluated,
        "ends": f"The stage ends at {criterion_text(until)}{now}." if until else "It is the last stage.",
        "value": value,
    }


PRESENT_STAGE = StatementRule[TrainingEvidence](
    name="present_stage",
    when=lambda evidence: evidence.stages,
    numbers=_present,
    text="The training is in stage '{stage}' ({number} of {count}), which began at step {since} of {steps}."
    " {evaluated}{ends}",
)


def criterion(evidence: TrainingEvidence) -> Criterion | None:
    """Return the criterion that ends the present stage; None in the last one."""
    return (
        evidence.stages[evidence.stage_index].until
        if evidence.stages and not evidence.is_last_stage
        else None
    )


def criterion_number(until: Criterion, value: float) -> str:
    if until.metric == "success_rate":
        return f"{100 * value:.4g}%"
    return f"{value:,.0f} steps" if until.metric == "steps" else f"{number_text(value)}"


def criterion_text(until: Criterion) -> str:
    if until.metric == "steps":
        return criterion_number(until, until.threshold)
    counted = "in an evaluation" if until.episodes is None else f"over {until.episodes} training episodes"
    return f"a {until.metric.replace('_', ' ')} of {criterion_number(until, until.threshold)} {counted}"


def criterion_value(evidence: TrainingEvidence) -> float | None:
    """Return the present value that the criterion of the present stage compares."""
    until = criterion(evidence)
    if until is None:
        return None
    if until.metric == "steps":
        return float(evidence.stage_steps)
    if until.episodes is None:
        outcomes = "successes" if until.metric == "success_rate" else "returns"
        values = evidence.evaluations[-1][outcomes] if evidence.evaluations else []
    else:
        # The log of a training does not name worlds: with several, this is near what the training counts.
        training = evidence.program.agent.training
        count = max(until.episodes, training.environments if training else 1)
        values = _measured(evidence.episodes, until)[-count:].tolist()
    return fmean(values) if values else None


def _measured(episodes: Any, until: Criterion) -> Any:
    return episodes.successes if until.metric == "success_rate" else episodes.returns


def _until(until: Criterion, value: float, *, in_evaluation: bool = False) -> str:
    """Return the key with another threshold, in the syntax of the scenario."""
    # A higher threshold than the value was not reached.
    threshold = (
        f"{math.floor(100 * value + 1e-9)} %"
        if until.metric == "success_rate"
        else f"{Context(prec=4, rounding=ROUND_FLOOR).create_decimal(str(value)):f}"
    )
    counted = (
        "in evaluation" if in_evaluation or until.episodes is None else f"over {until.episodes} episodes"
    )
    return f"`until: {until.metric} >= {threshold} {counted}`"


def stage_changes(evidence: TrainingEvidence) -> str:
    """Return the settings of the present stage that differ from the one before, such as `near: 4 cm -> 1 mm`;
    "" if they are unknown."""
    try:
        root = Source.kept(evidence.run.path).document().root
    except DeepbotsError:
        return ""
    before, now = (
        {
            name: inline_text(entry.value)
            for name, entry in entries_at(root, "curriculum", index, "set").items()
        }
        for index in (evidence.stage_index - 1, evidence.stage_index)
    )
    usual = "the value of the scenario"
    return list_text(
        [
            f"{name}: {before.get(name, usual)} -> {now.get(name, usual)}"
            for name in before | now
            if before.get(name) != now.get(name)
        ]
    )


def stage_too_hard(evidence: TrainingEvidence) -> Numbers | None:
    before = evidence.stages[evidence.stage_index - 1].name
    was = SuccessRate(evidence.episodes_of(before).successes[-100:])
    now = SuccessRate(evidence.episodes_by_steps(0.5, 1.0).successes)
    is_much_lower = was.rate >= 0.5 and now.rate <= 0.1 and now.high <= 0.6 * was.low
    rises = evidence.success_trend.direction == "rises" or evidence.late_success.rate > 0.3
    if min(was.episodes, now.episodes) < MIN_EPISODES or not is_much_lower or rises:
        return None
    changes = stage_changes(evidence)
    return {
        "stage": evidence.stage,
        "before": before,
        "success_before": was,
        "success": now,
        "steps": evidence.stage_steps,
        "changes": f" ({changes})" if changes else "",
    }


def easy_stage_counted(evidence: TrainingEvidence) -> Numbers | None:
    until, late = criterion(evidence), evidence.late_success
    if until is None or late.episodes < MIN_EPISODES or late.rate < 0.8:
        return None
    asks_more = until.metric == "success_rate" and late.high < until.threshold
    if _rate(evidence.late) < late.rate - 0.3 or asks_more:
        return None
    final, value = SuccessRate.of(evidence.final_episodes), criterion_value(evidence)
    task = (
        f", and in the scenario itself in {final}"
        if final.episodes
        else "; the task itself was not evaluated"
    )
    threshold, reached = until, f"the training made {evidence.stage_steps:,} steps there"
    if until.metric == "steps":
        threshold = Criterion("success_rate", 0.8, None)
    elif value is not None:
        threshold = replace(until, threshold=min(until.threshold, value))
        reached = f"it was at {criterion_number(until, value)}"
    ends = _until(threshold, threshold.threshold, in_evaluation=True)
    return {
        "stage": evidence.stage,
        "number": evidence.stage_index + 1,
        "count": len(evidence.stages),
        "success": late,
        "task": task,
        "criterion": criterion_text(until),
        "reached": reached,
        "remedy": f"Let the stage end when the policy has learned it, for example with {ends}.",
        "value": value,
    }


def levels_stay_lowest(evidence: TrainingEvidence) -> Numbers | None:
    levels, means, late = evidence.program.levels, evidence.curve("curriculum/mean_level"), evidence.late
    if levels is None or levels.count < 2 or len(means) < 4 or last_quarter(means).max() > 0.0:
        return None
    raises = np.isin(late.endings, sorted(levels.up)) | ((late.successes > 0) & (SUCCESS in levels.up))
    return {
        "highest": levels.count - 1,
        "up": list_text([f"`{name}`" for name in sorted(levels.up)]),
        "share": Percentage(float(raises.mean())),
    }


def stuck_in_stage(evidence: TrainingEvidence) -> Numbers | None:
    until = criterion(evidence)
    is_long = evidence.stages and evidence.stage_steps >= evidence.planned / len(evidence.stages)
    if until is None or until.metric == "steps" or not is_long:
        return None
    third, last = (_measured(evidence.episodes_by_steps(*span), until) for span in ((0.5, 0.75), (0.75, 1.0)))
    if min(len(third), len(last)) < MIN_QUARTER or last.mean() >= until.threshold:
        return None
    trend = evidence.success_trend if until.metric == "success_rate" else evidence.return_trend
    # A stage that is learned is an easy stage that counts.
    is_learned = evidence.late_success.episodes >= MIN_EPISODES and evidence.late_success.rate >= 0.95
    never = evidence.program.defines_success and is_rare(evidence)
    if trend.direction == "rises" or is_learned or never or hides_success(evidence) is not None:
        return None
    before, late = (criterion_number(until, float(values.mean())) for values in (third, last))
    reached = float(np.mean(np.concatenate([third, last])))
    target = 0.9 * reached if until.metric == "success_rate" else reached - 0.1 * abs(reached)
    remedy = "Put an easier stage before it"
    if until.metric == "mean_return" or target >= 0.2:
        remedy = (
            f"Lower the criterion to a value that the stage reaches, such as {_until(until, target)}; or put"
            " an easier stage before it"
        )
    return {
        "stage": evidence.stage,
        "number": evidence.stage_index + 1,
        "count": len(evidence.stages),
        "since": evidence.first_step,
        "metric": until.metric.replace("_", " "),
        "before": before,
        "late": late,
        "value": float(last.mean()),
        "threshold": criterion_number(until, until.threshold),
        "remedy": remedy,
    }


# Success that does not rise


def _rate(episodes: Any) -> float:
    return float(episodes.successes.mean()) if len(episodes) else 0.0


def is_rare(evidence: TrainingEvidence) -> bool:
    """Return whether there was hardly any success in the present stage, including its late episodes and
    evaluations."""
    rate, last = SuccessRate(evidence.episodes.successes), evidence.episodes.successes[-100:]
    seldom = not rate["successes"] or (
        len(last) and float(last.mean()) <= _RARE and (rate.high <= _RARE or _stays_rare(evidence))
    )
    return bool(seldom) and evidence.late_success.rate <= 0.1


def _stays_rare(evidence: TrainingEvidence) -> bool:
    """Return whether the last half of a mature stage has hardly more successes than a random policy may
    have."""
    third, last = evidence.episodes_by_steps(0.5, 0.75), evidence.episodes_by_steps(0.75, 1.0)
    return (
        evidence.is_mature
        and min(len(third), len(last)) >= MIN_QUARTER
        and max(_rate(third), _rate(last)) <= _RARE
    )


def plateau(evidence: TrainingEvidence) -> Trend | None:
    """Return the trend of the success rate of the present stage if it does not rise, by `trend_of`; None if
    success is rare, or nearly certain, and in the first half of the planned steps."""
    if not evidence.program.defines_success or not evidence.is_mature or is_rare(evidence):
        return None
    trend = evidence.success_trend
    if trend == Trend() or trend.direction == "rises" or _rate(evidence.episodes_by_steps(0.5, 1.0)) > 0.9:
        return None
    return trend


def success_plateau(evidence: TrainingEvidence) -> Numbers | None:
    trend, others = plateau(evidence), (some_starts_fail, stuck_in_stage, hides_success)
    if trend is None or any(other(evidence) is not None for other in others):
        return None
    return {
        "likelihood": 0.6 if trend.direction else 0.45,
        "verdict": f"The success rate {trend.direction or 'may still rise'}",
        "before": Percentage(trend.before),
        "late": Percentage(trend.late),
        "change": f"{100 * trend.gain:+.1f} percentage points (95 % interval {100 * trend.low:+.1f} to"
        f" {100 * trend.high:+.1f})",
        "whole": f"stage '{evidence.stage}'" if evidence.stage else "the training",
        "success": SuccessRate(evidence.episodes_by_steps(0.5, 1.0).successes),
        "more": " More steps alone are unlikely to help." if trend.direction else " More steps may help.",
    }


def some_starts_fail(evidence: TrainingEvidence) -> Numbers | None:
    trend = plateau(evidence)
    is_flat = trend is not None or stuck_in_stage(evidence) is not None
    if not is_flat and not evidence.final_episodes:  # they may still be learned
        return None
    source, episodes = _episodes_with_draws(evidence)
    effects = drawn_effects(episodes, draw_labels(evidence.program, evidence.facts.units)).values
    # A value whose middle fails has no trend, but its parts differ.
    differing = (
        value
        for value in effects.values()
        if value.has_effect or _chance(value.parts) < _CHANCE / len(effects)
    )
    apart = (
        value  # whose worst part succeeds less than half as often as the best one, by their intervals
        for value in differing
        if min(part.success_interval[1] for part in value.parts)
        < 0.5 * max(part.success_interval[0] for part in value.parts)
    )
    if (drawn := next(apart, None)) is None:
        return None
    worst, best = (choose(drawn.parts, key=lambda part: part.success_rate) for choose in (min, max))
    shares = [f"{_range(part, drawn.label)} {rate_text(part.success_rate)}" for part in drawn.parts]
    sees = evidence.facts.observes(drawn.name.removeprefix("parameters."))
    return {
        "likelihood": 0.92 if is_flat else 0.55,
        "flat": f"The success rate {trend.direction}, and it" if trend and trend.direction else "Success",
        "observed": "" if sees else f", and that the policy observes `{drawn.name}` or its effect",
        "drawn": drawn.name,
        "worst": _range(worst, drawn.label),
        "failing": str(SuccessRate.counted(worst.successes, worst.episodes)),
        "best": _range(best, drawn.label),
        "succeeding": str(SuccessRate.counted(best.successes, best.episodes)),
        "source": source,
        "parts": "; ".join(shares),
        "bins": [
            {
                "low": part.low,
                "high": part.high,
                "episodes": part.episodes,
                "rate": part.success_rate,
                "interval": part.success_interval,
            }
            for part in drawn.parts
        ],
    }


def _episodes_with_draws(evidence: TrainingEvidence) -> tuple[str, Sequence[Episode]]:
    """Return the episodes that are sorted by their drawn values: those of the quoted evaluation, else late
    ones of the present stage."""
    if evidence.is_last_stage and len(evidence.final_episodes) >= 40:
        return "the evaluation", evidence.final_episodes
    episodes = []
    for row in evidence.episodes_by_steps(0.5, 1.0)[-_MAX_SORTED:]:
        try:
            drawn = json.loads(row.drawn) if row.drawn else {}
        except ValueError:
            continue
        if isinstance(drawn, Mapping):
            episodes.append(
                Episode(row.returns, int(row.lengths), bool(row.successes), row.endings, drawn=drawn)
            )
    return "late episodes of the training", episodes


def _chance(parts: Sequence[DrawnPart]) -> float:
    """Return the probability that success differs as much between the parts if it does not depend on them
    (chi-squared test)."""
    from scipy.special import chdtrc  # here, since commands that only read runs work without scipy

    counts = np.array([[part.successes, part.episodes - part.successes] for part in parts], float)
    expected = np.outer(counts.sum(axis=1), counts.sum(axis=0)) / counts.sum()
    return (
        float(chdtrc(len(parts) - 1, ((counts - expected) ** 2 / expected).sum())) if expected.all() else 1.0
    )


def _range(part: DrawnPart, label: DrawLabel) -> str:
    text = label.range_text(part)
    return f"from {text.replace(' .. ', ' to ')}" if " .. " in text else text


def hides_success(evidence: TrainingEvidence) -> tuple[SuccessRate, SuccessRate] | None:
    """Return the success rates of late evaluations and of late episodes of the training, if exploration hides
    most of the success."""
    return _far_apart(evidence.late_success, SuccessRate(evidence.late.successes[-100:]))


def needs_exploration(evidence: TrainingEvidence) -> tuple[SuccessRate, SuccessRate] | None:
    """Return the success rates of late episodes of the training and of late evaluations, if most of the
    success needs exploration."""
    return _far_apart(SuccessRate(evidence.late.successes[-100:]), evidence.late_success)


def _far_apart(better: SuccessRate, worse: SuccessRate) -> tuple[SuccessRate, SuccessRate] | None:
    """Return both rates if the first one is much higher, and both are of enough episodes."""
    if min(better.episodes, worse.episodes) < MIN_EPISODES or better.rate < max(0.5, worse.rate + 0.3):
        return None
    return better, worse


def success_never_seen(evidence: TrainingEvidence) -> Numbers | None:
    returns, count = evidence.episodes.returns, int(evidence.episodes.successes.sum())
    late = {name: float(last_quarter(curve).mean()) for name, curve in evidence.term_curves.items()}
    paid = {name: max(0.0, mean) for name, mean in late.items()}
    name, whole = max(paid, key=lambda term: paid[term], default=""), sum(paid.values())
    share = paid[name] / whole if whole else 0.0
    facts, program, is_flat = evidence.facts, evidence.program.agent, float(np.ptp(returns)) < 1e-9
    terms, title, though = facts.terms_towards_success, "the training has seen hardly any success", ""
    likelihood, settings = 0.7 if evidence.is_mature else 0.45, dict[str, str]()
    remedy = "Add a reward term for progress towards success"
    if facts.unpaid_quantity is not None:
        quantity, pays = facts.unpaid_quantity
        title, term = f"no reward term depends on `{quantity}`", f"towards_{program.success[0]}"
        though, remedy = f", and {title}", f"Add `{term}: {pays}` to `reward`"
        likelihood, settings = 0.94 if evidence.is_mature else likelihood, {f"reward.{term}": pays}
    elif share >= 0.8 and evidence.return_trend.direction != "rises":
        though = (
            f", and '{name}' gives {rate_text(share)} of the positive reward of late episodes: the policy is"
            " in a local optimum of this term"
        )
        text = next(term.text for term in program.reward if term.name == name)
        lead = f"Make '{name}' lead around obstacles, for example with path_distance"
        leads_straight = re.search(r"\b(delta|distance)\(", text) and "path_distance" not in text
        remedy = lead if leads_straight else f"Make success earn more than '{name}' can"
    elif terms:
        remedy = f"Compare '{terms[0]}', which leads towards success, with the other terms"
        if terms[0] in late:
            others = sum(mean for term, mean in late.items() if term != terms[0])
            mean, rest = number_text(late[terms[0]], 3), number_text(others, 3)
            remedy += f" (per late episode it gives {mean}, and they give {rest})"
        remedy += " and raise it"
    return {
        "likelihood": max(likelihood, 0.93 if is_flat else 0.0),
        "title": title,
        "settings": settings,
        "episodes": len(evidence.episodes),
        "count": count,
        "seen": f"Only {count}" if count else "None",
        "verb": "are" if count > 1 else "is",
        "where": f" in stage '{evidence.stage}'" if evidence.stage else "",
        "ending": " or ".join(program.success or ("goal_reached",)),
        "spread": float(returns.std()),
        "mean": float(returns.mean()),
        "term": name if whole else None,
        "term_share": share,
        "though": though,
        "remedy": remedy,
    }


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
    # Comparisons of the time are true at the end of each long episode.
    pairs = [
        (trace, [leaf for leaf in leaves if not any(map(_CLOCKS.fullmatch, leaf.sides))])
        for trace, name, leaves in missed
        if name == ending
    ]
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


def missed_condition(evidence: TrainingEvidence) -> Numbers | None:
    played = [trace for trace in evidence.policy if trace.outcome in ("failure", "time limit")]
    miss = common_miss(evidence.failed or played)
    if miss is None:
        return None
    leaf, unit = miss.condition, evidence.facts.units.of(miss.condition.unit, *reversed(miss.condition.sides))
    near, aim = "", f"`{leaf.text}`"
    if miss.nearest is not None and miss.bound is not None:
        value, bound = (quantity_text(number, unit, 3) for number in (miss.nearest, miss.bound))
        near = f"; the nearest value is {value} in the median, and the threshold {bound}"
        aim = f"`{leaf.sides[0]}` {SIGN_OF_OPERATOR[leaf.operator]} the threshold"
    terms = evidence.facts.terms_about(leaf.text)
    names = list_text([f"'{term}'" for term in terms])
    remedy = f"Raise what {names} pays for" if terms else "Reward what brings"
    return {
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
        "others": list_text([f"`{text}` is true in {count:,}" for text, count in miss.others.items()]),
        "terms": list(terms),
        "remedy": f"{remedy} {aim}" if terms else f"{remedy} {aim} where the other conditions hold",
    }
