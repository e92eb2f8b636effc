"""The effect of drawn values on episodes: one test for a trend per value, corrected for the number of values.

A scenario may draw dozens of values, and some of them differ between successes and failures by chance alone.
Each value therefore has one test. With Holm's correction, the probability that any value without an effect is
named is at most `ALPHA` (S. Holm, Scand. J. Stat. 6, 1979). The tests find trends: a value that is best in
its middle has none.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from deepbots_cli.analysis.shown_units import ShownUnits
from deepbots_cli.learning.runs.episodes import SUCCESS_STATISTICS, Summary
from deepbots_cli.learning.runs.evaluations import DrawLabel
from deepbots_cli.learning.runs.statistics import ALPHA, UNBOUNDED, Interval
from deepbots_cli.program import Program
from deepbots_cli.program.draws import is_of_member, without_copy
from deepbots_cli.rollout import Episode
from deepbots_cli.words import number_text

Outcome = Literal["success", "return"]
Floats = NDArray[np.float64]

MAX_OPTIONS = 6
"""The largest number of different numbers of a drawn value that has a part for each of them. Each drawn word
has a part of its own."""
PARTS = 4
"""The number of parts of other values; they have equally many episodes."""
POWER = 0.9
"""The probability with which an effect of the size `DrawnEffects.detectable` is found."""
_QUARTERS = 0.75 * math.sqrt(12)
"""For a linear trend over a uniform value: the difference between the mean outcomes of the lowest and the
highest quarter, in standard deviations of the outcome, divided by the coefficient of correlation."""


class DrawnPart(Summary, frozen=True):
    """The episodes in which a drawn value lies from `low` to `high`, both included, in SI units.

    For a drawn word, `low` and `high` are this word.
    """

    low: float | str
    high: float | str


def draw_labels(program: Program, units: ShownUnits) -> dict[str, DrawLabel]:
    """Return the label of each draw of a scenario, by its name without the copy of a robot. `units` are the
    units of its file."""
    return {
        entry.name: DrawLabel(entry.unit or units.of(entry.si), entry.is_parameter)
        for entry in program.draws.entries
    }


@dataclass(frozen=True)
class DrawnValue:
    """A drawn value and the episodes by its parts.

    `chance` is the probability of such a trend if no value has an effect, after the correction for all
    values. `has_effect` is true if it is at most `ALPHA`.
    """

    name: str
    label: DrawLabel
    chance: float
    has_effect: bool
    parts: tuple[DrawnPart, ...]


@dataclass(frozen=True)
class DrawnEffects:
    """The effects of all drawn values that vary.

    Attributes:
        outcome: The tested outcome: success if some of the episodes succeed, else the return.
        starts: The number of different starts; episodes of several policies from one start count as one.
        detectable: The effect that is found with a probability of `POWER`: the difference of the outcome
            between the lowest and the highest quarter of a value. None if there are too few episodes to find
            any possible effect.
        is_constant: Whether all episodes have the same outcome.
        values: The values by name: those with an effect first, then those without; in both, parameters of the
            scenario first, the smallest `chance` first.
    """

    outcome: Outcome
    starts: int
    detectable: float | None
    is_constant: bool
    values: Mapping[str, DrawnValue]

    @property
    def effective(self) -> list[DrawnValue]:
        """The values with an effect, in the order of `values`."""
        return [value for value in self.values.values() if value.has_effect]

    @property
    def conclusion(self) -> str:
        """A sentence with the number of values that have an effect, and the size of the effect that would
        have been found."""
        count, total = len(self.effective), len(self.values)
        if not total:
            return "no drawn value varies"
        many = f"the {total} drawn values" if total > 1 else "the drawn value"
        if self.is_constant:
            size = "all episodes have the same one"
        elif self.detectable is None:
            size = f"{self.starts:,} episodes are too few to find one"
        else:
            points = f"{100 * self.detectable:.0f} percentage points"
            amount = (
                points if self.outcome == "success" else f"{number_text(self.detectable, 3)} in the return"
            )
            size = (
                f"with {self.starts:,} episodes, a difference of {amount} between the lowest and the highest"
                f" quarter of a value is found with a probability of {POWER:.0%}"
            )
        if count and self.detectable is None:
            size = ""
        verb = "has" if count == 1 else "have"
        subject = f"{count} of {many} {verb}" if count else f"none of {many} has"
        if total == 1:
            subject = f"{many} has" if count else f"{many} does not have"
        return (
            f"{subject} an effect on"
            f" {'success' if self.outcome == 'success' else 'the return'}{f' ({size})' * bool(size)}"
        )

    def as_json(self, *, success_defined: bool) -> dict[str, Any]:
        """Return the fields, with the statistics of each part. Statistics of success are None if no success
        is defined."""
        hidden = () if success_defined else SUCCESS_STATISTICS
        values = {
            name: {
                "parameter": value.label.is_parameter,
                "unit": value.label.unit.text,
                "chance": value.chance,
                "has_effect": value.has_effect,
                "parts": [{**vars(part), **dict.fromkeys(hidden)} for part in value.parts],
            }
            for name, value in self.values.items()
        }
        return {
            "outcome": self.outcome,
            "starts": self.starts,
            "detectable": self.detectable,
            "values": values,
        }


def drawn_effects(
    episodes: Sequence[Episode],
    labels: Mapping[str, DrawLabel] | None = None,
    bounds: Interval = UNBOUNDED,
) -> DrawnEffects:
    """Return the effect of each value that the episodes draw, by its place in the scenario.

    Values that do not vary are left out, and so are values of single members of a group, which have no
    meaning of their own.

    Args:
        episodes: The episodes.
        labels: The labels of the draws.
        bounds: The possible returns.
    """
    from scipy.special import ndtri  # commands that only read runs work without scipy

    outcome: Outcome = "success" if len({episode.is_success for episode in episodes}) == 2 else "return"
    names = {name: None for episode in episodes for name in episode.drawn if not is_of_member(name)}
    chances: dict[str, float] = {}
    parts: dict[str, tuple[DrawnPart, ...]] = {}
    for name in names:
        drawing = [episode for episode in episodes if name in episode.drawn]
        if _is_of_one_kind([episode.drawn[name] for episode in drawing]):
            own_parts = _parts(drawing, name, bounds)
            if len(own_parts) > 1:
                starts, results = _mean_outcomes(drawing, outcome)
                parts[name] = own_parts
                chances[name] = _chance([start.drawn[name] for start in starts], results)
    corrected = _holm(chances)
    values = [
        DrawnValue(
            name, (labels or {}).get(without_copy(name), DrawLabel()), chance, chance <= ALPHA, parts[name]
        )
        for name, chance in corrected.items()
    ]
    values.sort(key=lambda value: (not value.has_effect, not value.label.is_parameter, value.chance))
    _, results = _mean_outcomes(episodes, outcome)
    detectable = None
    if values and len(results) > 1:
        needed = float(ndtri(1 - ALPHA / (2 * len(values))) + ndtri(POWER)) / math.sqrt(len(results) - 1)
        detectable = _detectable(needed, results, outcome)
    is_constant = bool(len(results)) and float(np.ptp(results)) == 0
    return DrawnEffects(
        outcome, len(results), detectable, is_constant, {value.name: value for value in values}
    )


def _is_of_one_kind(values: Sequence[object]) -> bool:
    """Return whether all are words, or all are finite numbers."""
    is_number = [isinstance(value, int | float) and math.isfinite(value) for value in values]
    return all(is_number) or all(isinstance(value, str) for value in values)


def _parts(episodes: Sequence[Episode], name: str, bounds: Interval) -> tuple[DrawnPart, ...]:
    ordered = sorted(episodes, key=lambda episode: episode.drawn[name])
    options = sorted({episode.drawn[name] for episode in ordered})
    if isinstance(options[0], str) or len(options) <= MAX_OPTIONS:
        parts = [[episode for episode in ordered if episode.drawn[name] == option] for option in options]
    else:
        values = [episode.drawn[name] for episode in ordered]
        edges = [0]
        for part in range(1, PARTS):  # equal values are in one part
            value = values[len(values) * part // PARTS]
            before = bisect_left(values, value)
            edges.append(before if before > edges[-1] else bisect_right(values, value))
        edges.append(len(values))
        parts = [ordered[first:end] for first, end in pairwise(edges)]
    return tuple(
        DrawnPart.of_episodes(part, bounds, low=part[0].drawn[name], high=part[-1].drawn[name])
        for part in parts
        if part
    )


# The test


def _mean_outcomes(episodes: Sequence[Episode], outcome: Outcome) -> tuple[list[Episode], Floats]:
    """Return one episode of each start, and the mean outcome of each start.

    Several policies that begin with the same start are not independent observations of its difficulty.
    """
    groups: dict[tuple[str, int], list[Episode]] = {}
    for number, episode in enumerate(episodes):
        key = ("number", number) if episode.seed is None else ("seed", episode.seed)
        groups.setdefault(key, []).append(episode)
    values = [
        sum(episode.is_success if outcome == "success" else episode.total_return for episode in group)
        / len(group)
        for group in groups.values()
    ]
    return [group[0] for group in groups.values()], np.array(values, float)


def _chance(values: Sequence[float | str], results: Floats) -> float:
    """Return the two-sided probability of a trend at least as strong if the value has no effect.

    The outcome, or its rank where it has more than two values, is compared with the rank of the value: for
    success, this is the test of Wilcoxon, Mann and Whitney; for returns, it is Spearman's. Words have no
    order: each of them is compared with all others, with Bonferroni's correction.
    """
    ranks = results if len(set(results.tolist())) <= 2 else _ranks(results)
    words = sorted({value for value in values if isinstance(value, str)})
    if not words:
        return _association(_ranks(np.array(values, float)), ranks)
    compared = words if len(words) > 2 else words[:1]
    indicators = (np.array([value == word for value in values], float) for word in compared)
    return min(1.0, len(compared) * min(_association(indicator, ranks) for indicator in indicators))


def _ranks(values: Floats) -> Floats:
    """Return the rank of each value; equal values have their mean rank."""
    _, inverse, counts = np.unique(values, return_inverse=True, return_counts=True)
    means: Floats = np.cumsum(counts) - (counts - 1) / 2
    return means[inverse]


def _association(first: Floats, second: Floats) -> float:
    """Return the two-sided probability that the sum of products is at least as far from its mean under random
    pairing.

    The distribution over all pairings has a known variance and skewness, and is approximated by Pearson's
    type III; the normal distribution would treat a rare value that meets two rare failures as certain
    evidence. If both have only two values, Fisher's test is exact.
    """
    from scipy.special import gammainc, gammaincc, ndtr

    if max(len(set(values.tolist())) for values in (first, second)) == 2:
        return _exact_association(first == first.max(), second == second.max())
    count = len(first)
    a = first - first.mean()
    b = second - second.mean()
    variance = float((a**2).sum() * (b**2).sum()) / max(1, count - 1)
    if count < 3 or variance <= 0:
        return 1.0
    z = abs(float(a @ b)) / math.sqrt(variance)
    third = count / ((count - 1) * (count - 2)) * float((a**3).sum() * (b**3).sum())
    skewness = abs(third) / variance**1.5
    if skewness < 1e-3:
        return float(2 * ndtr(-z))
    shape = 4 / skewness**2
    upper, lower = (max(0.0, shape + side * z * math.sqrt(shape)) for side in (1, -1))
    return min(1.0, float(gammaincc(shape, upper) + gammainc(shape, lower)))


def _exact_association(first: NDArray[np.bool_], second: NDArray[np.bool_]) -> float:
    """Compute Fisher's test: the probability of all tables that are no more probable than this one, given
    their margins."""
    from scipy.special import gammaln

    count = len(first)
    first_ones = int(first.sum())
    second_ones = int(second.sum())
    overlaps = np.arange(max(0, first_ones + second_ones - count), min(first_ones, second_ones) + 1)
    cells = (
        overlaps,
        first_ones - overlaps,
        second_ones - overlaps,
        count - first_ones - second_ones + overlaps,
    )
    logs = -sum(gammaln(cell + 1) for cell in cells)
    weights = np.exp(logs - logs.max())
    weight = weights[int((first & second).sum()) - overlaps[0]]
    return float(weights[weights <= weight * (1 + 1e-7)].sum() / weights.sum())


def _holm(chances: Mapping[str, float]) -> dict[str, float]:
    """Return the probabilities after Holm's correction, by name, the smallest first."""
    corrected: dict[str, float] = {}
    largest = 0.0
    for rank, name in enumerate(sorted(chances, key=lambda name: chances[name])):
        largest = max(largest, min(1.0, chances[name] * (len(chances) - rank)))
        corrected[name] = largest
    return corrected


def _detectable(correlation: float, results: Floats, outcome: Outcome) -> float | None:
    """Return the difference between the outer quarters of a value with this coefficient of correlation, if it
    is possible."""
    difference = _QUARTERS * correlation * float(results.std())
    rate = float(results.mean())
    # The largest effect has all failures in one quarter.
    largest = min(1.0, 4 * min(rate, 1 - rate)) if outcome == "success" else math.inf
    return difference if correlation < 1 and 0 < difference <= largest else None
