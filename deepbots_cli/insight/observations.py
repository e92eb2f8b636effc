"""Causes in the observation: numbers that never change, hardly change, or are beyond their range."""

from __future__ import annotations

import numpy as np

from deepbots_cli.insight.statements import Numbers, Percentage, list_text, statement
from deepbots_cli.insight.trace import Array
from deepbots_cli.insight.training import MIN_EPISODES, TrainingEvidence
from deepbots_cli.program.task import SAME_OBSERVATION, Observation

_MOST, _MOST_LIKELIHOOD = 0.75, 0.95
"""The share of the numbers that counts as most of them, and the likelihood of a cause that concerns most."""
_PER_CONSTANT_SHARE, _PER_CLIPPED_SHARE = 0.35, 0.55
"""The likelihood of a cause that concerns fewer, per share of the numbers: of constant and of clipped
ones."""
_MAX_CONSTANT_SPAN = 0.01
"""A number of the observation, from -1 to 1, that varies by less hardly changes."""
_MIN_CLIPPED_SHARE, _MIN_LOST_SPREAD = 0.4, 0.1
"""A number is saturated if it is clipped in this share of the moments, and the clipped values differ by this
share of its range."""
_ALMOST_ALWAYS, _ALMOST_ALWAYS_LIKELIHOOD = 0.8, 0.85
"""The share of the moments that counts as almost always, and the likelihood if the saturated numbers are
clipped almost always."""


def _likelihood(share: float, per_share: float) -> float:
    return _MOST_LIKELIHOOD if share >= _MOST else per_share * share


@statement(
    "sensor_without_reading",
    "{count} of {of} measured numbers of the observation never changed in {moments} moments ({values}):"
    " {guess}.",
    advice="Check the position and direction of these sensors, and that something is in their range:"
    " `deepbots view RUN` draws the rays of sensors. Or remove the values from `observation`.",
)
def sensor_without_reading(evidence: TrainingEvidence) -> Numbers | None:
    spans = _spans(evidence)
    still = [name for name, (span, _) in spans.items() if span < SAME_OBSERVATION]
    if not still:
        return None
    at_end = [name for name in still if abs(spans[name][1]) > 1 - SAME_OBSERVATION]
    guess = "these sensors detect nothing, or nothing changes these values"
    if len(at_end) == len(still):
        guess = "they are always at an end of their range, like a sensor that detects nothing"
    share = len(still) / len(spans)
    values = list_text([f"{name} always {_unscaled(evidence, name, spans[name][1])}" for name in still])
    return {
        "likelihood": _likelihood(share, _PER_CONSTANT_SHARE),
        "count": len(still),
        "of": len(spans),
        "moments": evidence.probe_moments,
        "names": still,
        "values": values,
        "guess": guess,
    }


def _spans(evidence: TrainingEvidence) -> dict[str, tuple[float, float]]:
    """Return, for each number of the observation, the range that it spans in the short episodes, and its
    first value.

    The previous action is left out, and so are parameters and values that depend on parameters alone: no
    sensor measures them.
    """
    if evidence.probe_moments < 2 * MIN_EPISODES:
        return {}
    rows = np.concatenate([trace.observations for trace in evidence.probes])
    spans = zip(np.ptp(rows, axis=0), rows[0], strict=True)
    return {
        number.full_name: (float(span), float(first))
        for number, (span, first) in zip(evidence.program.agent.numbers, spans, strict=True)
        if number.name != "previous_action" and evidence.facts.is_measured(number)
    }


def _unscaled(evidence: TrainingEvidence, name: str, value: float) -> str:
    """Return a number of the observation, from -1 to 1, as the value that it represents."""
    number = next(entry for entry in evidence.program.agent.numbers if entry.full_name == name)
    if number.is_truth:
        return "true" if value else "false"
    return evidence.facts.range_text(number, number.low + (value + 1) / 2 * (number.high - number.low))


@statement(
    "constant_observation",
    "{count} of {of} measured numbers of the observation hardly change ({names}): in {moments} moments, after"
    " mapping to [-1, 1], they vary by at most {span}.",
    advice="Narrow their ranges under `observation` to the values that occur: `deepbots inspect RUN` lists"
    " the ranges.",
)
def constant_observation(evidence: TrainingEvidence) -> Numbers | None:
    spans = _spans(evidence)
    names = [name for name, (span, _) in spans.items() if SAME_OBSERVATION <= span < _MAX_CONSTANT_SPAN]
    if not names:
        return None
    share = len(names) / len(spans)
    return {
        "likelihood": _likelihood(share, _PER_CONSTANT_SHARE),
        "count": len(names),
        "of": len(spans),
        "moments": evidence.probe_moments,
        "names": list_text(names),
        "span": max(spans[name][0] for name in names),
    }


@statement(
    "saturated_observation",
    "{count} of {of} clipped numbers of the observation are outside their range in {share} of the moments"
    " ({names}). The clipped values differ by up to {lost} times the range.",
    advice="Widen their ranges under `observation`: the policy cannot distinguish values outside a range.",
)
def saturated_observation(evidence: TrainingEvidence) -> Numbers | None:
    if evidence.probe_moments < 2 * MIN_EPISODES:
        return None
    beyond = {
        entry.name: _beyond(evidence, entry)
        for entry in evidence.program.agent.observation
        if entry.clip and entry.name != "previous_action"
    }
    cut = {
        n.full_name: excess
        for e in evidence.program.agent.observation
        for n, excess in zip(e.numbers, beyond.get(e.name, ()), strict=False)
    }
    shares = {name: float((excess != 0).mean()) for name, excess in cut.items()}
    # Clipping holds a value such as the reading of a sensor that sees nothing at an end, and loses nothing if
    # it is always the same one.
    spreads = {
        name: max(_spread(excess[excess > 0]), _spread(excess[excess < 0])) for name, excess in cut.items()
    }
    worst = sorted(
        (
            name
            for name, share in shares.items()
            if share >= _MIN_CLIPPED_SHARE and spreads[name] >= _MIN_LOST_SPREAD
        ),
        key=lambda name: -shares[name],
    )
    if not worst:
        return None
    clipped_share, mean = len(worst) / len(shares), float(np.mean([shares[name] for name in worst]))
    likelihood = _likelihood(clipped_share, _PER_CLIPPED_SHARE)
    # Numbers that are almost always beyond an end come before the length of the training.
    if mean >= _ALMOST_ALWAYS:
        likelihood = max(likelihood, _ALMOST_ALWAYS_LIKELIHOOD)
    return {
        "likelihood": likelihood,
        "count": len(worst),
        "of": len(shares),
        "names": list_text(worst),
        "share": Percentage(mean),
        "lost": max(spreads[name] for name in worst),
        "shares": shares,
    }


def _beyond(evidence: TrainingEvidence, entry: Observation) -> list[Array]:
    """Return how much each number of an entry lies above its range, or below it (negative), in all moments,
    as a share of the range."""
    key = evidence.probes[0].instrumented.observed_signals.get(entry.name)
    if key is None or entry.value.typed.type.boolean:
        return []
    rows = np.array([values[key] for trace in evidence.probes for values in trace.values], float)
    return [
        (row - row.clip(low, high)) / (high - low)
        for row, low, high in zip(rows.T, entry.low, entry.high, strict=True)
    ]


def _spread(values: Array) -> float:
    """Return the distance that contains 80 % of the values, from the lowest tenth to the highest."""
    return float(np.subtract(*np.quantile(values, (0.9, 0.1)))) if len(values) else 0.0
