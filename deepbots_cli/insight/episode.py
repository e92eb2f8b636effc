"""The table that explains an episode: why it ended, when, with which margin and reward, and when it went
wrong."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from deepbots_cli.expressions.text import unit_named
from deepbots_cli.insight.statements import (
    MAX_LISTED,
    Numbers,
    Statement,
    StatementRule,
    list_text,
    quantity_text,
    sentence,
    statements_about,
)
from deepbots_cli.insight.trace import (
    SIGN_OF_OPERATOR,
    Array,
    Comparison,
    Trace,
    comparisons_in,
    holds,
    inner_comparisons,
    measure,
    missed_success,
    missing_comparisons,
    nearest_moment,
)
from deepbots_cli.learning.runs.episodes import agent_returns
from deepbots_cli.words import counted, number_text, rate_text


def explain(trace: Trace) -> list[Statement]:
    """Return every row of the table that applies."""
    return statements_about(ROWS, trace)


def explanation_json(trace: Trace, statements: Sequence[Statement]) -> dict[str, Any]:
    """Return the explanation as a dictionary, in SI units; `margin` is the distance of the value beyond the
    bound."""
    evidence_by_cause = {entry.cause: entry.evidence for entry in statements}
    limit, drop = evidence_by_cause.get("truncation_limit"), evidence_by_cause.get("critic")
    return {
        "episode": trace.title,
        "scenario": trace.program.name,
        "agent": trace.agent or None,
        "outcome": trace.outcome,
        **({"succeeded": list(trace.succeeded)} if trace.succeeded else {}),
        "ended_by": trace.ended_by,
        "steps": trace.steps,
        "time": trace.time,
        "return": trace.returns,
        "end": trace.end.as_json() if trace.end is not None else limit,
        "moment": {"step": drop["step"], "time": drop["at"]} if drop is not None else None,
        "statements": [statement.as_json() for statement in statements],
        "notes": list(trace.notes),
    }


def _value_text(trace: Trace, leaf: Comparison, value: float, digits: int = 4) -> str:
    """Return a value of a comparison in the unit in which the scenario writes its threshold."""
    return quantity_text(value, trace.units.of(leaf.unit, *reversed(leaf.sides)), digits)


def _seconds(time: float) -> str:
    return f"{time:.2f} s"


_WORDS = {"success": "succeeded", "failure": "failed", "time limit": "reached its time limit"}


def _ending(trace: Trace) -> Numbers:
    suffix, outcome = f" (agent {trace.agent})" if trace.agent else "", _WORDS[trace.outcome]
    if trace.outcome == "time limit" and trace.program.failures and not trace.program.defines_success:
        outcome = "reached its time limit without a failure"
    if trace.succeeded and trace.outcome != "success":
        outcome = f"was a success of {list_text(trace.succeeded, len(trace.succeeded))}"
    return {
        "what": f"{sentence(trace.title)}{suffix}",
        "outcome": outcome,
        "ending": trace.ended_by or "",
        "steps": trace.steps,
        "length": counted(trace.steps, "step"),
        "time": trace.time,
        "seconds": _seconds(trace.time),
    }


def _length(trace: Trace) -> dict[str, Any]:
    return {
        "what": trace.title,
        "steps": trace.steps,
        "length": counted(trace.steps, "step"),
        "seconds": _seconds(trace.steps * trace.program.period),  # without the step that fails
    }


def _margin(trace: Trace) -> Numbers | None:
    end = trace.end
    if end is None or end.margin is None or end.bound is None:
        return None
    value, bound = end.condition.sides
    where = {True: "over", False: "under"}[end.value > end.bound] if end.value != end.bound else "away from"
    return {
        **end.as_json(),
        "side": value,
        "shown": _value_text(trace, end.condition, end.value),
        "limit": _value_text(trace, end.condition, end.bound)
        + (f" ({bound})" if end.condition.is_bound_named else ""),
        "by": _value_text(trace, end.condition, abs(end.margin), 3),
        "where": where,
    }


def _truncation_limit(trace: Trace) -> Numbers:
    limits, is_steps = trace.program.truncation, trace.ended_by == "max_steps"
    value, bound = (trace.steps, limits.max_steps) if is_steps else (trace.time, limits.max_time)
    unit = "" if is_steps else "s"
    return {
        "condition": trace.ended_by,
        "value": value,
        "bound": bound,
        "margin": value - (bound or 0),
        "unit": unit,
        "shown": quantity_text(value, unit_named(unit)),
        "limit": quantity_text(bound or 0, unit_named(unit)),
    }


def _approach(trace: Trace) -> Numbers | None:
    if trace.end is None or trace.end.bound is None:
        return None
    leaf = trace.end.condition
    past = [measure(leaf, values) for values in trace.values]
    margins = [comparison.margin for comparison in past if comparison.margin is not None]
    start = len(margins) - 1
    while start > 0 and margins[start - 1] < margins[start]:
        start -= 1
    if start >= len(margins) - 2:
        return None
    return {
        "step": start,
        "steps": len(margins) - 1 - start,
        "at": trace.time_at(start),
        "seconds": _seconds(trace.time_at(start)),
        "from": _value_text(trace, leaf, past[start].value),
        "side": leaf.sides[0],
    }


def _nearest(trace: Trace) -> Numbers | None:
    name, condition = missed_success(trace)
    if condition is None or not any(leaf.bound is not None for leaf in comparisons_in(condition)):
        return None
    missing = [missing_comparisons(condition, values) for values in trace.values]
    fewest = min(map(len, missing))
    if not fewest:  # all comparisons were true, in a step that a failure ended
        return None
    # What is missing last decides: at the start most successes lack time or distance, which the episode gains
    # later.
    leaf = next(leaves for leaves in reversed(missing) if len(leaves) == fewest)[0]
    never = not any(measure(leaf, values).holds for values in trace.values)
    beside = [step for step, leaves in enumerate(missing) if len(leaves) == fewest and leaf in leaves]
    step, moment = nearest_moment(trace, leaf, () if never else beside)
    limit, value = (_value_text(trace, leaf, number or 0.0) for number in (moment.bound, moment.value))
    prefix = "" if never or fewest > 1 else "while the other conditions were true, "
    if leaf.bound is not None:
        needed = f"{leaf.sides[0]} {SIGN_OF_OPERATOR[leaf.operator]} {limit}"
        best = f"{prefix}the nearest value was {value}"
    else:
        needed, best = f"`{leaf.text}` true", f"{prefix}it was false"
    return {
        **moment.as_json(),
        "ending": name,
        "needed": needed,
        "step": step,
        "best": best,
        "seconds": _seconds(trace.time_at(step)),
    }


def _conditions(trace: Trace) -> Numbers | None:
    name, missed = missed_success(trace)
    outer, inner = ([], []) if missed is None else (comparisons_in(missed), inner_comparisons(missed))
    if len(inner) < 2 and not any(leaf.lasting for leaf in outer):
        return None
    measured, texts = [], []
    for leaf in inner:
        steps = sum(measure(leaf, values).holds for values in trace.values)
        beside = [
            k
            for k, values in enumerate(trace.values)
            if steps and all(measure(o, values).holds for o in inner if o is not leaf)
        ]
        step, best = nearest_moment(trace, leaf, beside)
        measured.append(
            {
                **best.as_json(),
                "step": step,
                "time": trace.time_at(step),
                "steps": steps,
                "beside_others": bool(beside),
            }
        )
        value, bound = _value_text(trace, leaf, best.value), _value_text(trace, leaf, best.bound or 0.0)
        during = " while the others were true" if beside and len(inner) > 1 else ""
        came = (
            f" (nearest value{during}: {value} at {_seconds(trace.time_at(step))}, threshold {bound})"
            if leaf.bound
            else ""
        )
        texts.append(f"`{leaf.text}` was true in {steps} of {len(trace.values)} moments{came}")
    return {"ending": name, "conditions": measured, "parts": "; ".join(texts)}


def _terms(trace: Trace) -> Numbers:
    sums = {name: float(np.nansum(values)) for name, values in trace.terms.items()}
    whole = sum(map(abs, sums.values()))
    shares = {
        name: abs(sums[name]) / whole if whole else 0.0
        for name in sorted(sums, key=lambda name: -abs(sums[name]))
    }
    return {
        "return": trace.returns,
        "total": _total(trace, sums),
        "terms": sums,
        "shares": shares,
        "parts": list_text(
            [
                f"{name} {number_text(sums[name], sign='+')} ({rate_text(share)})"
                for name, share in shares.items()
            ]
        ),
    }


def _total(trace: Trace, sums: Mapping[str, float]) -> str:
    """Return the beginning of a sentence about the return, of agents that compete the return of each."""
    if not trace.program.has_rivals:
        return f"The return is {number_text(trace.returns)}"
    returns = agent_returns(trace.program.members, sums)
    return f"The returns are {list_text([f'{name} {number_text(value)}' for name, value in returns.items()])}"


def _concentrated_rewards(trace: Trace) -> Numbers | None:
    whole, concentrated = sum(abs(float(np.nansum(values))) for values in trace.terms.values()), {}
    for name, values in trace.terms.items():
        total = float(np.nansum(values))
        grown = np.concatenate([[0.0], np.cumsum(np.maximum(0.0, np.nan_to_num(values) * np.sign(total)))])
        ends = np.searchsorted(grown, grown[:-1] + 0.8 * grown[-1] - 1e-12)
        lengths = np.where(ends <= trace.steps, ends - np.arange(len(ends)), trace.steps + 1)
        first = int(np.argmin(lengths)) if trace.steps else 0
        if whole and abs(total) >= 0.25 * whole and lengths[first] <= 0.78 * trace.steps:
            concentrated[name] = [trace.time_at(first), trace.time_at(int(ends[first]))]
    parts = [
        f"{name} from {_seconds(begin)} to {_seconds(end)}" for name, (begin, end) in concentrated.items()
    ]
    return {"spans": concentrated, "parts": list_text(parts)} if concentrated else None


def _critic_values(trace: Trace) -> Array:
    return np.zeros(0) if trace.critic is None else trace.critic


def _critic(trace: Trace) -> Numbers:
    values = _critic_values(trace)
    step = int(np.argmin(np.diff(values))) + 1
    before, after = (float(values[index]) for index in (step - 1, step))
    return {
        "step": step,
        "at": trace.time_at(step),
        "seconds": _seconds(trace.time_at(step)),
        "before": before,
        "after": after,
        "drop": before - after,
        "left": trace.steps - step,
        "distance": counted(trace.steps - step, "step"),
    }


def _shares(by_name: Mapping[str, float]) -> Numbers | None:
    """Return shares by name, the largest first. The sentence shows those that are not 0 %."""
    if not by_name:
        return None
    shares = dict(sorted(by_name.items(), key=lambda entry: -entry[1]))
    parts = [f"{name} in {rate_text(share)}" for name, share in shares.items() if share >= 0.005]
    return {"shares": shares, "parts": list_text(parts[:MAX_LISTED]) if parts else "none (0%)"}


def _choices(trace: Trace) -> Numbers:
    parts = trace.program.agent.choices
    counts = [
        Counter(column.astype(int).tolist()).most_common() for column in trace.action_array("choices").T
    ]
    options = {
        p.name: {p.options[n].name: times / trace.steps for n, times in times_by_option}
        for p, times_by_option in zip(parts, counts, strict=True)
    }
    sentences = [
        f"{name} {option} in {rate_text(share)}"
        for name, times_by_option in options.items()
        for option, share in list(times_by_option.items())[:MAX_LISTED]
    ]
    return {"options": options, "parts": list_text(sentences, len(sentences))}


def _further_endings(trace: Trace) -> list[str]:
    """Return further endings that are true at the end."""
    conditions = trace.instrumented.conditions.items()
    names = [
        name for name, condition in conditions if condition is not None and holds(condition, trace.values[-1])
    ]
    return [name for name in names if name not in (trace.ended_by, "goal_reached")]


Row = StatementRule[Trace]

ROWS: tuple[Row, ...] = (
    Row(
        name="ending",
        when=lambda trace: trace.outcome in _WORDS,
        numbers=_ending,
        text="{what} {outcome}: '{ending}' ended it after {length}, at {seconds}.",
    ),
    Row(
        name="error",
        when=lambda trace: trace.error,
        numbers=lambda trace: {"error": trace.error, **_length(trace)},
        text="After {length}, at {seconds}, {what} stopped with an error: {error}.",
    ),
    Row(
        name="not_ended",
        when=lambda trace: trace.outcome == "not ended",
        numbers=_length,
        text="The actions of {what} end after {length} ({seconds}), but the episode has not ended.",
    ),
    Row(
        name="margin",
        numbers=_margin,
        text="At the end, {side} was {shown}: {by} {where} the threshold of {limit}.",
    ),
    Row(
        name="truth_ending",
        when=lambda trace: trace.end is not None and trace.end.bound is None,
        numbers=lambda trace: {**(trace.end.as_json() if trace.end else {}), "step": trace.steps},
        text="`{condition}` became true in step {step}. It is true or false, so there is no margin.",
    ),
    Row(
        name="truncation_limit",
        when=lambda trace: (
            trace.outcome in ("time limit", "success") and trace.ended_by in ("max_steps", "max_time")
        ),
        numbers=_truncation_limit,
        text="The episode reached {shown} of at most {limit} ({condition}).",
    ),
    Row(
        name="further_endings",
        when=lambda trace: trace.end is not None and _further_endings(trace),
        numbers=lambda trace: {
            "names": list_text(_further_endings(trace), len(_further_endings(trace))),
            "count": len(_further_endings(trace)),
            "step": trace.steps,
        },
        text="Further endings that were also true in step {step} ({count}): {names}.",
    ),
    Row(
        name="approach",
        numbers=_approach,
        text="Starting at {seconds} (step {step}, {side} = {from}), it came nearer to the threshold in each"
        " of the last {steps} steps.",
    ),
    Row(
        name="nearest",
        numbers=_nearest,
        text="'{ending}' requires {needed}; {best}, at {seconds} (step {step}).",
    ),
    Row(
        name="conditions",
        numbers=_conditions,
        text="Of the conditions in '{ending}', {parts}.",
    ),
    Row(
        name="terms",
        when=lambda trace: trace.steps,
        numbers=_terms,
        text="{total}: {parts}. Percentages are shares of the sum of absolute values.",
    ),
    Row(
        name="concentrated_rewards",
        numbers=_concentrated_rewards,
        text="At least 80% of a large reward term came from a part of the episode: {parts}.",
    ),
    Row(
        name="critic",
        when=lambda trace: np.diff(_critic_values(trace)).min(initial=0.0) < 0,
        numbers=_critic,
        text="The critic's value fell most at {seconds} (step {step}), from {before} to {after}, {distance}"
        " before the end.",
    ),
    Row(
        name="unforeseen",
        when=lambda trace: (
            trace.outcome == "failure"
            and len(_critic_values(trace)) > 1
            and np.diff(_critic_values(trace)).min() >= 0
        ),
        numbers=lambda trace: {
            "steps": trace.steps,
            "first": float(_critic_values(trace)[0]),
            "last": float(_critic_values(trace)[-1]),
        },
        text="The critic did not predict this failure: its value did not fall in any of {steps} steps, and"
        " rose from {first} to {last}.",
    ),
    Row(
        name="saturation",
        numbers=lambda trace: _shares(
            {
                number.full_name: float((np.abs(trace.observations[:, index]) >= 1.0).mean())
                for index, number in enumerate(trace.program.agent.numbers)
                if number.clip and not number.is_truth
            }
        ),
        text="Observations at an end of their range, as a fraction of steps: {parts}.",
    ),
    Row(
        name="choices",
        when=lambda trace: trace.program.agent.choices and trace.steps,
        numbers=_choices,
        text="Actions, as a fraction of steps: {parts}.",
    ),
    Row(
        name="action_limits",
        when=lambda trace: trace.steps,
        numbers=lambda trace: _shares(
            {
                name: float((np.abs(trace.action_array("ranges")[:, index]) >= 0.999).mean())
                for index, name in enumerate(trace.program.agent.range_names)
            }
        ),
        text="Actions at an end of their range, as a fraction of steps: {parts}.",
    ),
)
"""The statements about an episode, in this order."""
