"""Whether a bar is met: what was asked, what was measured, in words and as a verdict."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from statistics import fmean, median
from typing import Any, Literal

from tests.results.experiment import Bar, Experiment

Status = Literal["met", "missed", "not measured"]


@dataclass(frozen=True)
class Verdict:
    """A bar beside what was measured, ready to be put in a table."""

    bar: Bar
    what: str
    asked: str
    measured: str
    status: Status

    @property
    def word(self) -> str:
        """Reached or missed; a stretch bar that is not reached is no failure."""
        if self.status == "not measured":
            return self.status
        if self.bar.stretch:
            return "reached" if self.status == "met" else "not reached"
        return "met" if self.status == "met" else "**missed**"


def judge(experiment: Experiment, bar: Bar, record: Mapping[str, Any]) -> Verdict:
    seeds = len(experiment.training(bar.figure.training).seeds) if bar.figure.training else 1
    values = bar.figure.values(record)
    what = bar.words or bar.figure.words
    if len(values) < seeds and not (bar.over == "all" and any(not _holds(bar, value) for value in values)):
        told = f"{len(values)} of {seeds} seeds" if values and seeds > 1 else ""
        return Verdict(bar, what, _asked(bar, seeds), told, "not measured")
    if bar.over == "all":  # one seed that fails is a miss, however many are still to come
        good = sum(_holds(bar, value) for value in values)
        worst = max(values) if bar.at_most is not None else min(values)
        so_far = f", {len(values)} measured" if len(values) < seeds else ""
        measured = _figure(worst, bar.figure.unit) + (f", the worst; {good} of {seeds} seeds{so_far}" if seeds > 1 else "")
        return Verdict(bar, what, _asked(bar, seeds), measured, "met" if good == seeds else "missed")
    value = fmean(values) if bar.over == "mean" else median(values)
    return Verdict(bar, what, _asked(bar, seeds), _figure(value, bar.figure.unit), "met" if _holds(bar, value) else "missed")


def _holds(bar: Bar, value: float) -> bool:
    rounded = round(value, 9)  # a mean of shares may end in ...9999
    return rounded <= bar.at_most if bar.at_most is not None else rounded >= (bar.at_least or 0.0)


def _asked(bar: Bar, seeds: int) -> str:
    value = bar.at_most if bar.at_most is not None else bar.at_least
    assert value is not None  # one of the two, says Bar
    whose = {"all": f", {seeds} of {seeds} seeds", "mean": f", mean of {seeds} seeds", "median": f", median of {seeds} seeds"}[bar.over]
    stretch = "stretch: " if bar.stretch else ""
    return f"{stretch}at {'most' if bar.at_most is not None else 'least'} {_figure(value, bar.figure.unit)}{whose if seeds > 1 else ''}"


def _figure(value: float, unit: str) -> str:
    if not math.isfinite(value):
        return "never"
    if unit == "%":
        return f"{100 * value:.1f}".removesuffix(".0") + " %"
    text = f"{value:,.0f}".replace(",", " ") if abs(value) >= 1000 else f"{value:.4g}"
    return f"{text} {unit}".rstrip()
