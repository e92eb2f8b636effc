"""The table that explains an episode: why it ended, when and by how much, what it earned, and when it went wrong."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from deepbots_cli.insight.conditions import SIGNS, Comparison, Measured, as_json, deciding, leaves, measure
from deepbots_cli.insight.statements import Finder, Numbers, Statement, listed, quantity, state_all
from deepbots_cli.insight.trace import Trace

_SHOWN = 4
"""Terms, options and numbers of the observation in one sentence."""


class Explained:
    """A trace with what several rows of the table need."""

    def __init__(self, trace: Trace) -> None:
        self.trace = trace

    @cached_property
    def end(self) -> Measured | None:
        """The comparison or fact that ended the episode; None where an episode limit did, or the ending has no tree."""
        trace = self.trace
        at_limit = trace.outcome == "success" and trace.ended_by in ("max_steps", "max_time")  # of a scenario with a goal
        condition = trace.watch.conditions.get("goal_reached" if at_limit else trace.ended_by or "")
        if condition is None or trace.outcome in ("time limit", "error", "not ended"):
            return None
        before = trace.values[-2] if len(trace.values) > 1 else None
        return deciding(condition, before, trace.values[-1])

    def history(self, condition: Comparison) -> list[Measured]:
        """The comparison in each moment."""
        return [measure(condition, values) for values in self.trace.values]


def explain(trace: Trace) -> list[Statement]:
    """Every row of the table that applies."""
    return state_all(ROWS, Explained(trace))


def explanation_json(trace: Trace, statements: Sequence[Statement]) -> dict[str, Any]:
    """The explanation as a dictionary, in SI units; `margin` is how far the value was beyond the bound."""
    end, drop = Explained(trace).end, next((each for each in statements if each.cause == "critic"), None)
    limit = next((each for each in statements if each.cause == "limit"), None)
    return {
        "episode": trace.what,
        "scenario": trace.program.name,
        "agent": trace.agent or None,
        "outcome": trace.outcome,
        "ended_by": trace.ended_by,
        "steps": trace.steps,
        "time": trace.time,
        "return": trace.returns,
        "end": as_json(end) if end is not None else dict(limit.evidence) if limit is not None else None,
        "moment": {"step": drop.evidence["step"], "time": drop.evidence["at"]} if drop is not None else None,
        "statements": [statement.as_json() for statement in statements],
        "notes": list(trace.notes),
    }


def _seconds(time: float) -> str:
    return f"{time:.2f} s"


_WORDS = {"success": "succeeded", "failure": "failed", "time limit": "reached its time limit"}


def ending(about: Explained) -> Numbers | None:
    """{what} {outcome}: '{ending}' ended it after {steps} steps, at {seconds}."""
    trace = about.trace
    if trace.outcome not in _WORDS:
        return None
    of = f" (agent {trace.agent})" if trace.agent else ""
    return {"what": f"{trace.what[0].upper()}{trace.what[1:]}{of}", "outcome": _WORDS[trace.outcome], "ending": trace.ended_by or "",
            "steps": trace.steps, "time": trace.time, "seconds": _seconds(trace.time)}  # fmt: skip


def error(about: Explained) -> Numbers | None:
    """{what} stopped with an error after {steps} steps, at {seconds}: {error}."""
    trace = about.trace
    return {"what": trace.what, "error": trace.error, "steps": trace.steps, "seconds": _seconds(trace.time)} if trace.error else None


def not_ended(about: Explained) -> Numbers | None:
    """{what} holds {steps} steps ({seconds}), and the episode does not end in them."""
    trace = about.trace
    if trace.outcome != "not ended":
        return None
    return {"what": trace.what, "steps": trace.steps, "seconds": _seconds(trace.time)}


def margin(about: Explained) -> Numbers | None:
    """{side} was {shown}: {by} {where} the bound of {limit}."""
    end = about.end
    if end is None or not isinstance(end.condition, Comparison) or end.margin is None or end.bound is None:
        return None
    leaf = end.condition
    value, bound = leaf.sides
    named = f" ({bound})" if not bound[:1].isdigit() else ""
    where = "over" if end.value > end.bound else "under" if end.value < end.bound else "away from"
    return {**as_json(end), "side": value, "shown": quantity(end.value, leaf.unit), "limit": quantity(end.bound, leaf.unit) + named,
            "by": quantity(abs(end.margin), leaf.unit, 3), "where": where}  # fmt: skip


def fact(about: Explained) -> Numbers | None:
    """`{condition}` became {truth} in step {step}; it is a truth value, so 0 or 1 and without a margin."""
    end = about.end
    if end is None or isinstance(end.condition, Comparison):
        return None
    return {**as_json(end), "step": about.trace.steps, "truth": "true" if end.value else "false"}


def limit(about: Explained) -> Numbers | None:
    """The episode reached {shown} of at most {limit} ({condition})."""
    trace, limits = about.trace, about.trace.program.truncation
    if trace.outcome not in ("time limit", "success") or trace.ended_by not in ("max_steps", "max_time"):
        return None
    value, bound, unit = (trace.steps, limits.max_steps, "") if trace.ended_by == "max_steps" else (trace.time, limits.max_time, "s")
    return {"condition": trace.ended_by, "value": value, "bound": bound, "margin": value - (bound or 0), "unit": unit,
            "shown": quantity(value, unit), "limit": quantity(bound or 0, unit)}  # fmt: skip


def approach(about: Explained) -> Numbers | None:
    """From {seconds} (step {step}, {side} = {from}) on, it came nearer to the bound in each of {steps} steps."""
    end, trace = about.end, about.trace
    if end is None or not isinstance(end.condition, Comparison):
        return None
    past = about.history(end.condition)
    margins = [each.margin for each in past if each.margin is not None]
    start = len(margins) - 1
    while start > 0 and margins[start - 1] < margins[start]:
        start -= 1
    if start >= len(margins) - 2:
        return None
    return {"step": start, "steps": len(margins) - 1 - start, "at": trace.at(start), "seconds": _seconds(trace.at(start)),
            "from": quantity(past[start].value, end.condition.unit), "side": end.condition.sides[0]}  # fmt: skip


def nearest(about: Explained) -> Numbers | None:
    """'{ending}' needs {side} {sign} {limit}; the nearest was {best}, at {seconds} (step {step})."""
    trace = about.trace
    wanted = [e.name for e in trace.program.endings if e.outcome == "success"] + ["goal_reached"]
    if trace.outcome in ("success", "error"):
        return None
    for name in wanted:
        condition = trace.watch.conditions.get(name)
        compared = [leaf for leaf in leaves(condition) if isinstance(leaf, Comparison)] if condition else []
        if compared:
            past = about.history(compared[0])
            best = max(range(len(past)), key=lambda step: past[step].margin or 0.0)
            found, leaf = past[best], compared[0]
            return {**as_json(found), "ending": name, "side": leaf.sides[0], "sign": SIGNS[leaf.operator], "step": best,
                    "limit": quantity(found.bound or 0.0, leaf.unit), "best": quantity(found.value, leaf.unit),
                    "seconds": _seconds(trace.at(best))}  # fmt: skip
    return None


def terms(about: Explained) -> Numbers | None:
    """The return of {total} is made of {parts}; shares are of the absolute values."""
    sums = {name: float(np.nansum(values)) for name, values in about.trace.terms.items()}
    whole = sum(map(abs, sums.values()))
    if not about.trace.steps:
        return None
    order = sorted(sums, key=lambda name: -abs(sums[name]))
    shares = {name: abs(sums[name]) / whole if whole else 0.0 for name in order}
    parts = [f"{name} {sums[name]:+.4g} ({shares[name]:.0%})" for name in order[:_SHOWN]]
    rest = len(order) - _SHOWN
    return {"return": about.trace.returns, "total": f"{about.trace.returns:.4g}", "terms": sums, "shares": shares,
            "parts": listed([*parts, *([f"{rest} more"] if rest > 0 else [])])}  # fmt: skip


def critic(about: Explained) -> Numbers | None:
    """The critic's value fell most at {seconds} (step {step}), from {before} to {after}, {left} steps before the end."""
    trace, critic = about.trace, about.trace.critic
    if critic is None or len(critic) < 2:
        return None
    changes = np.diff(critic)
    step = int(np.argmin(changes)) + 1
    if changes[step - 1] >= 0:
        return None
    return {"step": step, "at": trace.at(step), "seconds": _seconds(trace.at(step)), "before": float(critic[step - 1]),
            "after": float(critic[step]), "drop": float(-changes[step - 1]), "left": trace.steps - step}  # fmt: skip


def unforeseen(about: Explained) -> Numbers | None:
    """The critic did not foresee this failure: its value fell in none of {steps} steps, and rose from {first} to {last}."""
    trace, critic = about.trace, about.trace.critic
    if trace.outcome != "failure" or critic is None or len(critic) < 2 or np.diff(critic).min() < 0:
        return None
    return {"steps": trace.steps, "first": float(critic[0]), "last": float(critic[-1])}


def no_critic(about: Explained) -> Numbers | None:
    """The critic's value is known in {known} of {steps} steps: {reason}."""
    if about.trace.critic is not None:
        return None
    return {"steps": about.trace.steps, "reason": about.trace.critic_absent, "known": 0}


def saturation(about: Explained) -> Numbers | None:
    """Observations at an end of their range, as a share of steps: {parts}."""
    shares = about.trace.saturation()
    if not shares:
        return None
    parts = [f"{name} in {share:.0%}" for name, share in shares.items() if share >= 0.005][:_SHOWN]
    return {"shares": shares, "parts": listed(parts) if parts else "none (0%)"}


def choices(about: Explained) -> Numbers | None:
    """Actions, as a share of steps: {parts}."""
    options = about.trace.options()
    if not options or not about.trace.steps:
        return None
    parts = [f"{name} {option} in {share:.0%}" for name, found in options.items() for option, share in list(found.items())[:_SHOWN]]
    return {"options": options, "parts": listed(parts)}


def limits(about: Explained) -> Numbers | None:
    """Actions at a limit of their range, as a share of steps: {parts}."""
    ranges = about.trace.ranges()
    if not ranges:
        return None
    shares: Mapping[str, float] = {name: float((np.abs(values) >= 0.999).mean()) for name, values in ranges.items()}
    order = [name for name in sorted(shares, key=lambda name: -shares[name]) if shares[name] >= 0.005][:_SHOWN]
    return {"shares": shares, "parts": listed([f"{name} in {shares[name]:.0%}" for name in order]) if order else "none (0%)"}


def several(about: Explained) -> Numbers | None:
    """{count} further ending held in step {step} too: {names}."""
    from deepbots_cli.insight.conditions import holds

    trace = about.trace
    if about.end is None:
        return None
    also = [
        name
        for name, condition in trace.watch.conditions.items()
        if name not in (trace.ended_by, "goal_reached") and condition is not None and holds(condition, trace.values[-1])
    ]
    return {"names": listed(also), "count": len(also), "step": trace.steps} if also else None


ROWS: tuple[Finder[Explained], ...] = (
    ending,
    error,
    not_ended,
    margin,
    fact,
    limit,
    several,
    approach,
    nearest,
    terms,
    critic,
    unforeseen,
    no_critic,
    saturation,
    choices,
    limits,
)
"""What is said of an episode, in this order."""
