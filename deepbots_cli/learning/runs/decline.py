"""The decline of a training: its last held-out evaluations are worse than earlier ones by more than chance.

The evaluations of a training have 20 fixed starts each, and the last one is at its end. Those of the last
quarter of the present stage, and the last two alone, are compared with every earlier window of one or three
evaluations in a row. A window shows a decline if three things hold:

- It is better than the last evaluations by more than chance: with Student's paired test over the starts,
  because some of them are harder than others in every evaluation. The best of many windows looks better than
  it is, so the level of each test is `FALSE_ALARMS` divided by the number of comparisons (Bonferroni's
  inequality).
- The difference is at least `MIN_EFFECT`: points of the success rate, or a share of the range of returns
  since then. It is also at least `MIN_SHARE` of the range of all returns, so that small differences between
  perfect returns do not count. One or two evaluations must differ by `MIN_EFFECT_OF_FEW` and
  `MIN_SHARE_OF_FEW`: the policy changes from update to update.
- The very last evaluation is lower by this difference too, so that the training has not recovered.

`tests/learning/test_confirmation.py` measures how often healthy trainings raise a false alarm. Nothing is
compiled, and neither numpy nor torch is imported.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import accumulate
from pathlib import Path
from statistics import NormalDist, fmean
from typing import Any

from deepbots_cli.learning.runs.episodes import read_evaluations
from deepbots_cli.learning.runs.order import Measure
from deepbots_cli.learning.runs.records import RunRecord
from deepbots_cli.words import number_text, rate_text

FALSE_ALARMS = 0.01
"""The largest probability of a reported decline in a training whose policy stays the same."""
MIN_EFFECT = 0.1
MIN_SHARE = 0.05
MIN_EFFECT_OF_FEW = 0.25
MIN_SHARE_OF_FEW = 0.2
LAST_SHARE = 0.25
"""The share of the present stage whose evaluations are compared with earlier ones."""
_WINDOWS = (1, 3)


@dataclass(frozen=True)
class Decline:
    """A decline of a training: its size, and its start.

    Attributes:
        measure: The measure of the task, whose values are compared.
        best_value: The value of the best window, a mean over its episodes.
        best_steps: Steps of the training at the best evaluation in this window.
        last_value: The value of the last evaluations.
        last: The last evaluations, in words.
        last_steps: Steps at the first of them.
        since_steps: Steps at the first of the worse evaluations: the split into two means with the smallest
            squared error.
        best_episodes: Episodes of `best_value`; `last_episodes` are those of `last_value`.
    """

    measure: Measure
    best_value: float
    best_steps: int
    last_value: float
    since_steps: int
    best_episodes: int
    last_episodes: int
    last: str
    last_steps: int

    def as_json(self) -> dict[str, Any]:
        """Return the attributes, and the sentence."""
        return {**asdict(self), "text": self.text}

    @property
    def text(self) -> str:
        """A sentence without a full stop: the measure that fell, its values before and after, and when."""
        is_rate = self.measure == "success_rate"
        name, form = ("success rate", rate_text) if is_rate else ("mean return", number_text)
        best, last = form(self.best_value), form(self.last_value)
        return (
            f"the training got worse: the {name} of its evaluations fell from {best} at {self.best_steps:,}"
            f" steps to {last} in {self.last} ({self.last_episodes:,} episodes), since about"
            f" {self.since_steps:,} steps"
        )


def decline_of(run: Path, record: RunRecord) -> Decline | None:
    """Return the decline of a training from the files of its run, even while it trains; None if it has none.

    Raises:
        RunError: Its evaluations cannot be read.
    """
    best = record.result.best_model if record.result is not None else None
    if best is None or best.chosen_by == "newest":  # of rivals: the other one may have learned more
        return None
    return find_decline(read_evaluations(run), best.measure)


def find_decline(evaluations: Sequence[Mapping[str, Any]], measure: Measure) -> Decline | None:
    """Return the decline of a training in its present stage; None if its evaluations are not worse than
    chance explains.

    Args:
        evaluations: The evaluations of `read_evaluations`, in order. Entries without `steps` are not of the
            training.
        measure: The measure of the task.
    """
    rows = [row for row in evaluations if "steps" in row]
    earlier = [number for number, row in enumerate(rows) if row["stage"] != rows[-1]["stage"]]
    stage_start = 0.0
    if earlier:
        stage_start = rows[earlier[-1]]["steps"]
        rows = rows[earlier[-1] + 1 :]
    if len(rows) < 2:
        return None
    quarter_start = rows[-1]["steps"] - LAST_SHARE * (rows[-1]["steps"] - stage_start)
    first_late = min(len(rows) - 1, sum(row["steps"] <= quarter_start for row in rows))
    splits = {first_late: "the last quarter"}
    if first_late < len(rows) - 2:
        splits[len(rows) - 2] = "the last two evaluations"
    for split, last in splits.items():
        if (fall := _fall(rows, split, last, measure, level=FALSE_ALARMS / len(splits))) is not None:
            return fall
    return None


def _fall(
    rows: Sequence[Mapping[str, Any]], split: int, last: str, measure: Measure, *, level: float
) -> Decline | None:
    """Return the decline of the evaluations from `split` on against earlier ones, if a test at this level
    shows it."""
    is_rate = measure == "success_rate"
    scores = [list(map(float, row["successes" if is_rate else "returns"])) for row in rows]
    late = _joined(scores[split:])
    late_mean = fmean(late)
    last_mean = max(late_mean, fmean(scores[-1]))
    late_scores = _mean_scores(scores[split:])
    ranges = _ranges(scores)
    is_few = len(rows) - split <= 2
    least, share = (MIN_EFFECT_OF_FEW, MIN_SHARE_OF_FEW) if is_few else (MIN_EFFECT, MIN_SHARE)
    windows = [range(start, start + size) for size in _WINDOWS for start in range(split - size + 1)]
    better: list[tuple[float, range]] = []
    for window in windows:
        episodes = _joined([scores[number] for number in window])
        effect = least if is_rate else max(least * ranges[window.start], share * ranges[0])
        if fmean(episodes) - last_mean < effect or effect <= 0:
            continue
        # Bonferroni's correction, because the best of many windows is good by chance.
        if paired(_mean_scores(scores[window.start : window.stop]), late_scores) <= level / len(windows):
            better.append((fmean(episodes), window))
    if not better:
        return None
    value, window = max(better, key=lambda candidate: (candidate[0], len(candidate[1]), candidate[1].start))
    means = list(map(fmean, scores))
    best = max(window, key=lambda number: (means[number], number))
    return Decline(
        measure=measure,
        best_value=value,
        best_steps=int(rows[best]["steps"]),
        last_value=late_mean,
        since_steps=int(rows[best + _change(means[best:])]["steps"]),
        best_episodes=sum(len(scores[number]) for number in window),
        last_episodes=len(late),
        last=last,
        last_steps=int(rows[split]["steps"]),
    )


def _joined(scores: Sequence[Sequence[float]]) -> list[float]:
    return [score for episodes in scores for score in episodes]


def _mean_scores(scores: Sequence[Sequence[float]]) -> list[float]:
    """Return the mean score of each start over some evaluations."""
    return [sum(column) / len(column) for column in zip(*scores, strict=False)]


def _ranges(scores: Sequence[Sequence[float]]) -> list[float]:
    """Return the range of all scores from each evaluation on."""
    highest = [*accumulate(map(max, reversed(scores)), max)]
    lowest = [*accumulate(map(min, reversed(scores)), min)]
    return [high - low for high, low in zip(reversed(highest), reversed(lowest), strict=True)]


def _change(means: Sequence[float]) -> int:
    """Return the place, from 1, at which a split into two means leaves the smallest squared error."""

    sums = [*accumulate(means)]

    def explained(split: int) -> float:
        return sums[split - 1] ** 2 / split + (sums[-1] - sums[split - 1]) ** 2 / (len(means) - split)

    return max(range(1, len(means)), key=explained)


def paired(better: Sequence[float], worse: Sequence[float]) -> float:
    """Return the one-sided p-value of the hypothesis that the mean of `better` is not higher, for the same
    starts in both, by Student's test of the differences.

    One more start has the largest of the differences, in the other direction: `better` is the best of many
    windows, in which rare failures are missing, so the variance is too small. Without it, up to 4 % of
    healthy trainings raised an alarm, with it 0.7 %. Student's t is transformed to a normal variable, which
    needs no scipy (D. L. Wallace, Ann. Math. Stat. 30, 1959, p. 1124).
    """
    differences = [first - second for first, second in zip(better, worse, strict=False)]
    freedom = len(differences)
    if freedom < 2:
        return 1.0
    differences.append(-max(map(abs, differences)))
    mean = fmean(differences)
    # `statistics.variance` computes with fractions, which takes 1 us a number.
    squares = sum((difference - mean) ** 2 for difference in differences)
    squared_error_of_mean = squares / freedom / (freedom + 1)
    if squared_error_of_mean <= 0:
        return 1.0
    scale = (8 * freedom + 1) / (8 * freedom + 3)
    z = math.copysign(
        scale * math.sqrt(freedom * math.log1p(mean**2 / squared_error_of_mean / freedom)), mean
    )
    return NormalDist().cdf(-z)
