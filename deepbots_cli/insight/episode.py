"""The table that explains an episode: why it ended, when and by how much, what it earned, and when it went wrong."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from deepbots_cli.insight.conditions import SIGNS, Comparison, Measured, as_json, deciding, leaves, measure
from deepbots_cli.insight.statements import Numbers, Row, Statement, listed, quantity, state_all
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
        condition = trace.watch.conditions.get(trace.ended_by or "")
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


def _ending(about: Explained) -> Numbers | None:
    trace = about.trace
    if trace.outcome not in _WORDS:
        return None
    of = f" (agent {trace.agent})" if trace.agent else ""
    return {"what": f"{trace.what[0].upper()}{trace.what[1:]}{of}", "outcome": _WORDS[trace.outcome], "ending": trace.ended_by or "",
            "steps": trace.steps, "time": trace.time, "seconds": _seconds(trace.time)}  # fmt: skip


def _error(about: Explained) -> Numbers | None:
    trace = about.trace
    return {"what": trace.what, "error": trace.error, "steps": trace.steps, "seconds": _seconds(trace.time)} if trace.error else None


def _unended(about: Explained) -> Numbers | None:
    trace = about.trace
    if trace.outcome != "not ended":
        return None
    return {"what": trace.what, "steps": trace.steps, "seconds": _seconds(trace.time)}


def _margin(about: Explained) -> Numbers | None:
    end = about.end
    if end is None or not isinstance(end.condition, Comparison) or end.margin is None or end.bound is None:
        return None
    leaf = end.condition
    value, bound = leaf.sides
    named = f" ({bound})" if not bound[:1].isdigit() else ""
    return {**as_json(end), "side": value, "shown": quantity(end.value, leaf.unit), "limit": quantity(end.bound, leaf.unit) + named,
            "by": quantity(abs(end.margin), leaf.unit), "sign": SIGNS[leaf.operator]}  # fmt: skip


def _fact(about: Explained) -> Numbers | None:
    end = about.end
    if end is None or isinstance(end.condition, Comparison):
        return None
    return {**as_json(end), "step": about.trace.steps, "truth": "true" if end.value else "false"}


def _limit(about: Explained) -> Numbers | None:
    """The limit that cut the episode short, in its own unit."""
    trace, limits = about.trace, about.trace.program.truncation
    if trace.outcome not in ("time limit", "success") or trace.ended_by not in ("max_steps", "max_time"):
        return None
    value, bound, unit = (trace.steps, limits.max_steps, "") if trace.ended_by == "max_steps" else (trace.time, limits.max_time, "s")
    return {"condition": trace.ended_by, "value": value, "bound": bound, "margin": value - (bound or 0), "unit": unit,
            "shown": quantity(value, unit), "limit": quantity(bound or 0, unit)}  # fmt: skip


def _approach(about: Explained) -> Numbers | None:
    """The last stretch in which the value came nearer to its bound in every step."""
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


def _nearest(about: Explained) -> Numbers | None:
    """How near an episode without a success came to one."""
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


def _terms(about: Explained) -> Numbers | None:
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


def _critic(about: Explained) -> Numbers | None:
    trace, critic = about.trace, about.trace.critic
    if critic is None or len(critic) < 2:
        return None
    changes = np.diff(critic)
    step = int(np.argmin(changes)) + 1
    if changes[step - 1] >= 0:
        return None
    return {"step": step, "at": trace.at(step), "seconds": _seconds(trace.at(step)), "before": float(critic[step - 1]),
            "after": float(critic[step]), "drop": float(-changes[step - 1]), "left": trace.steps - step}  # fmt: skip


def _no_critic(about: Explained) -> Numbers | None:
    if about.trace.critic is not None:
        return None
    return {"steps": about.trace.steps, "reason": about.trace.critic_absent, "known": 0}


def _saturated(about: Explained) -> Numbers | None:
    shares = about.trace.saturation()
    if not shares:
        return None
    parts = [f"{name} in {share:.0%}" for name, share in shares.items() if share > 0][:_SHOWN]
    return {"shares": shares, "parts": listed(parts) if parts else "no number of the observation in any (0%)"}


def _choices(about: Explained) -> Numbers | None:
    options = about.trace.options()
    if not options or not about.trace.steps:
        return None
    parts = [f"{name} {option} in {share:.0%}" for name, found in options.items() for option, share in list(found.items())[:_SHOWN]]
    return {"options": options, "parts": listed(parts)}


def _at_limits(about: Explained) -> Numbers | None:
    ranges = about.trace.ranges()
    if not ranges:
        return None
    shares: Mapping[str, float] = {name: float((np.abs(values) >= 0.999).mean()) for name, values in ranges.items()}
    order = sorted(shares, key=lambda name: -shares[name])[:_SHOWN]
    return {"shares": shares, "parts": listed([f"{name} in {shares[name]:.0%}" for name in order])}


def _several(about: Explained) -> Numbers | None:
    """Other endings that held in the same moment."""
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


ROWS: tuple[Row[Explained], ...] = (
    Row("ending", "{what} {outcome}: '{ending}' ended it after {steps} steps, at {seconds}.", _ending),
    Row("error", "{what} stopped with an error after {steps} steps, at {seconds}: {error}.", _error),
    Row("not_ended", "{what} holds {steps} steps ({seconds}), and the episode does not end in them.", _unended),
    Row("margin", "{side} was {shown}; the ending holds for {sign} {limit}, so it was {by} beyond.", _margin),
    Row("fact", "`{condition}` became {truth} in step {step}; it is a truth value, so 0 or 1 and without a margin.", _fact),
    Row("limit", "The episode reached {shown} of at most {limit} ({condition}).", _limit),
    Row("several", "{count} further ending held in step {step} too: {names}.", _several),
    Row("approach", "From {seconds} (step {step}, {side} = {from}) on, it came nearer to the bound in each of {steps} steps.", _approach),
    Row("nearest", "'{ending}' needs {side} {sign} {limit}; the nearest was {best}, at {seconds} (step {step}).", _nearest),
    Row("terms", "The return of {total} is made of {parts}; shares are of the absolute values.", _terms),
    Row(
        "critic", "The critic's value fell most at {seconds} (step {step}), from {before} to {after}, {left} steps before the end.", _critic
    ),
    Row("no_critic", "The critic's value is known in {known} of {steps} steps: {reason}.", _no_critic),
    Row("saturation", "Observations at an end of their range, as a share of steps: {parts}.", _saturated),
    Row("choices", "Actions, as a share of steps: {parts}.", _choices),
    Row("limits", "Actions at a limit of their range, as a share of steps: {parts}.", _at_limits),
)
"""What is said of an episode, in this order."""
