"""Statistics of evaluations: intervals, tests that may be read at any time, comparisons of groups of runs,
and the confirmation that a task is solved.

Scores are returns or successes of episodes. All intervals have a confidence of 95 % unless stated otherwise.
numpy and scipy are imported where they are used: commands that only read runs work without them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from enum import StrEnum
from statistics import NormalDist, fmean, stdev, variance
from typing import TYPE_CHECKING

from deepbots_cli.program.task import Solved
from deepbots_cli.records import dataclass
from deepbots_cli.rollout import Episode
from deepbots_cli.scenario.quantities import MAX_SOLVED_EPISODES
from deepbots_cli.words import beside, number_text

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

Interval = tuple[float, float]
UNBOUNDED: Interval = (-math.inf, math.inf)

ALPHA = 0.05
"""The probability that an interval misses the true value, or that a test that stops early gives a wrong
answer."""


def wilson(successes: int, episodes: int, error: float = ALPHA) -> Interval:
    """Return the score interval of a proportion (E. B. Wilson, J. Am. Stat. Assoc. 22, 1927, p. 209).

    It solves (p - phat)^2 = z^2 p (1 - p) / n for p. It stays inside [0, 1] and has a width also at 0 and at
    n successes.
    """
    z = NormalDist().inv_cdf(1 - error / 2)
    rate, spread = successes / episodes, z * z / episodes
    center = (rate + spread / 2) / (1 + spread)
    half = math.sqrt(rate * (1 - rate) * spread + spread * spread / 4) / (1 + spread)
    # Rounding may leave the rate itself outside: 20 of 20 reach up to exactly 1.
    return max(0.0, min(rate, center - half)), min(1.0, max(rate, center + half))


def episodes_above(rate: float, error: float = ALPHA) -> int:
    """Return the smallest number of episodes whose interval is above a rate if all of them succeed; its lower
    end is n / (n + z^2)."""
    return math.ceil(NormalDist().inv_cdf(1 - error / 2) ** 2 * rate / (1.0 - rate))


def mean_interval(
    values: Sequence[float], bounds: Interval = UNBOUNDED, error: float = ALPHA
) -> Interval | None:
    """Student's interval of a mean, cut at the bounds of the values; None for fewer than two values.

    Equal values give no estimate of the spread. With a probability of 95 %, at most the share 1 - 0.05^(1/n)
    of all values differs from n equal ones; the interval then has this share of the way to the bounds, and is
    None without bounds.
    """
    if len(values) < 2:
        return None
    if min(values) == max(values):
        share = 1 - error ** (1 / len(values))
        value = values[0]
        reach = value - share * (value - bounds[0]), value + share * (bounds[1] - value)
        return reach if math.isfinite(reach[0]) and math.isfinite(reach[1]) else None
    half = student_quantile(len(values) - 1, 1 - error / 2) * stdev(values) / math.sqrt(len(values))
    center = fmean(values)
    # The interval contains the mean, even if the mean lies beyond a bound by rounding.
    return max(center - half, min(bounds[0], center)), min(center + half, max(bounds[1], center))


def student_quantile(freedom: float, probability: float) -> float:
    """Return the quantile of Student's distribution with so many degrees of freedom."""
    from scipy.special import stdtrit

    return float(stdtrit(freedom, probability))


class Statistic(StrEnum):
    """A statistic over seeds."""

    mean = "mean"
    iqm = "iqm"


def interquartile_mean(values: Sequence[float]) -> float:
    """Return the mean of the middle half of the values (R. Agarwal et al., NeurIPS 2021); the values at its
    two edges count in part."""
    import numpy as np

    return float(interquartile_means(np.asarray(values, dtype=float)))


def interquartile_means(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the interquartile mean of each column."""
    import numpy as np

    ordered = np.sort(rows, axis=0)
    quarter = len(ordered) / 4
    # The share of each value that lies between the first and the third quartile, for values of equal width.
    edges = np.arange(len(ordered) + 1)
    share = np.clip(np.minimum(edges[1:], 3 * quarter) - np.maximum(edges[:-1], quarter), 0, 1)
    means: NDArray[np.float64] = np.average(ordered, axis=0, weights=share)
    return means


def bootstrap_interval(
    rows: NDArray[np.float64], statistic: Callable[[NDArray[np.float64]], NDArray[np.float64]]
) -> NDArray[np.float64]:
    """Return the limits of the 95 % interval of a statistic of each column, whose rows are seeds: percentiles
    of 2,000 samples of the rows with replacement (R. Agarwal et al., NeurIPS 2021). The samples are always
    the same."""
    import numpy as np

    chosen = np.random.default_rng(0).integers(len(rows), size=(2000, len(rows)))
    limits: NDArray[np.float64] = np.percentile(
        [statistic(rows[sample]) for sample in chosen], [100 * ALPHA / 2, 100 - 100 * ALPHA / 2], axis=0
    )
    return limits


# -- tests that may be read after every episode
# ---------------------------------------------------------------------------

_LARGEST_BET = 0.75  # the largest share of the capital that may be lost at once


def rate_evidence(rate: float, successes: int, episodes: int) -> float:
    """Return the natural logarithm of the evidence against a success rate of exactly `rate`, from 0 to 1.

    This is the beta-binomial mixture martingale with Jeffreys' prior Beta(1/2, 1/2) (H. Robbins, Ann. Math.
    Stat. 41, 1970, p. 1397): if `rate` is true, the evidence exceeds log(1 / ALPHA) after any number of
    episodes with a probability of at most ALPHA.
    """
    from scipy.special import betaln

    failures = episodes - successes
    # Such an outcome is impossible under the rate.
    if (rate == 0 and successes) or (rate == 1 and failures):
        return math.inf
    # 0 * log(0) counts as 0 here, but math.log(0) raises a ValueError.
    likelihood = (successes * math.log(rate) if successes else 0.0) + (
        failures * math.log1p(-rate) if failures else 0.0
    )
    return float(betaln(successes + 0.5, failures + 0.5) - betaln(0.5, 0.5)) - likelihood


def rate_sequence(successes: int, episodes: int) -> Interval:
    """Return the confidence sequence of a success rate: with a probability of 95 % it contains the true rate
    after every episode at once."""
    # The import takes 0.2 s of CPU, and trainings do not need it.
    from scipy.optimize import brentq

    def excess(rate: float) -> float:
        return rate_evidence(rate, successes, episodes) - math.log(1 / ALPHA)

    rate = successes / episodes
    # At a rate of 0 or 1 the evidence may be infinite, from which brentq cannot interpolate.
    tiny = 1e-12
    low = 0.0 if excess(tiny) <= 0 else brentq(excess, tiny, max(rate, 2 * tiny))
    high = 1.0 if excess(1 - tiny) <= 0 else brentq(excess, min(rate, 1 - 2 * tiny), 1 - tiny)
    return low, high


def mean_evidence(mean: float, values: Sequence[float], bounds: Interval) -> tuple[float, float]:
    """Return the natural logarithms of the evidence that the mean of bounded values is above `mean`, and that
    it is below.

    Each is the capital of a gambler who bets on the next value, from 1 (I. Waudby-Smith and A. Ramdas,
    "Estimating means of bounded random variables by betting", J. R. Stat. Soc. B 86, 2024). If the true mean
    is not above `mean`, the first exceeds log(1 / a) after any number of values with a probability of at most
    a. This holds for any distribution within the bounds, also if most values are equal. Values without a
    lower bound are not evidence of a mean above, and values without an upper bound none of a mean below.
    """
    low, high = bounds
    return _capital([value - mean for value in values], mean - low), _capital(
        [mean - value for value in values], high - mean
    )


def _capital(gains: Sequence[float], largest_loss: float) -> float:
    """Return the logarithm of the capital after bets on values of which none is below -`largest_loss`.

    A bet is the ratio of the mean to the mean square of the values before, which nearly maximizes the growth
    of the capital.
    """
    if not 0 < largest_loss < math.inf:
        return 0.0
    total = squares = capital = 0.0
    for gain in gains:
        # A bet below 0 would gain from a mean on the other side, and the test is one-sided.
        if total > 0:
            capital += math.log1p(min(total / squares, _LARGEST_BET / largest_loss) * gain)
        # After the bet: with a bet that depends on its own gain, the capital is not a martingale.
        total, squares = total + gain, squares + gain * gain
    return capital


@dataclass(frozen=True)
class Verdict:
    """The answer of a gate so far: whether the requirement is met (None: not certain yet), and the reason."""

    met: bool | None
    reason: str


def gate_rate(required: float, successes: int, episodes: int, planned: int) -> Verdict:
    """Return whether a success rate reaches `required` after `episodes` of `planned` episodes.

    The answer is certain when the confidence sequence of the rate excludes `required`, or when the episodes
    that are left cannot change it. After the last planned episode, the answer is that of the measured rate.
    """
    rate = successes / episodes
    if rate_evidence(required, successes, episodes) >= math.log(1 / ALPHA):
        low, high = rate_sequence(successes, episodes)
        return Verdict(
            rate > required,
            f"{successes} of {episodes} episodes succeed; 95 % confidence sequence {low:.3g} .. {high:.3g}",
        )
    left = planned - episodes
    so_far = f"{successes} of {episodes} episodes succeed" + (
        f"; the remaining {left} cannot change the result" if left else ""
    )
    # A quotient is the number nearest to the rate, as `required` is; 0.55 * 100 is more than 55.
    if successes / planned >= required:
        return Verdict(True, so_far)
    if (successes + left) / planned < required:
        return Verdict(False, so_far)
    return Verdict(None, so_far)


def gate_mean(
    required: float, returns: Sequence[float], planned: int, bounds: Interval = UNBOUNDED
) -> Verdict:
    """Return whether a mean return reaches `required` after some of `planned` episodes; `bounds` are those of
    a return.

    The answer is certain when the evidence against the other answer exceeds 2 / ALPHA, or when the episodes
    that are left cannot change it. After the last planned episode, the answer is that of the measured mean.
    Without bounds, no answer is certain before.
    """
    left = planned - len(returns)
    so_far = f"mean return {beside(fmean(returns), required)[0]} in {len(returns)} episodes"
    above, below = mean_evidence(required, returns, bounds)
    # Each of the two one-sided tests has half of ALPHA.
    if left and max(above, below) >= math.log(2 / ALPHA):
        return Verdict(above > below, f"{so_far}; confidence sequence at 95 %")
    # A plain sum of ten returns of 0.1 is below 1, and would miss a required mean of 0.1.
    total = math.fsum(returns)
    needed = required * planned
    if left == 0:
        return Verdict(total >= needed, so_far)
    if total + left * bounds[0] >= needed:
        met = True
    elif total + left * bounds[1] < needed:
        met = False
    else:
        met = None
    return Verdict(met, so_far if met is None else f"{so_far}, which the remaining {left} cannot change")


# -- comparisons
# ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Difference:
    """The second of two groups against the first: `mean` is the difference of their means, with its interval.

    `interval` is None where a group has one run only and episodes cannot be paired, and where scores without
    any spread are too few. `improvement` is the
    probability that a run of the second group scores higher than one of the first; equal scores count half.
    """

    mean: float
    interval: Interval | None
    improvement: float

    @property
    def certain(self) -> bool:
        """Whether the interval excludes 0."""
        return self.interval is not None and (self.interval[0] > 0 or self.interval[1] < 0)


def compare_seeds(
    first: Sequence[float], second: Sequence[float], bounds: Interval = UNBOUNDED, error: float = ALPHA
) -> Difference:
    """Compare two groups of runs by one score per seed: Welch's interval of the difference of their means (B.
    L. Welch, Biometrika 34, 1947).

    The interval is cut at the largest difference that the `bounds` of a score allow. Equal scores of all
    seeds of each group have none unless a permutation test separates the groups. The seeds of both groups
    are independent, also where they have the same numbers: two trainings diverge after the first update.
    `error` is the probability that the interval misses the true difference.
    """
    mean = fmean(second) - fmean(first)
    improvement = probability_of_improvement(first, second)
    if min(len(first), len(second)) < 2:
        return Difference(mean, None, improvement)
    parts = [variance(group) / len(group) for group in (first, second)]
    standard_error = math.sqrt(sum(parts))
    # Without any spread the degrees of freedom below are 0 / 0. A permutation test decides: of all ways to
    # divide the scores into two such groups, two separate them.
    if standard_error == 0:
        is_clear = mean == 0 or 2 / math.comb(len(first) + len(second), len(first)) <= error
        return Difference(mean, (mean, mean) if is_clear else None, improvement)
    # The Welch-Satterthwaite equation (F. E. Satterthwaite, Biometrics Bulletin 2, 1946, p. 110).
    freedom = sum(parts) ** 2 / sum(
        part * part / (len(group) - 1) for part, group in zip(parts, (first, second), strict=True)
    )
    half = student_quantile(freedom, 1 - error / 2) * standard_error
    largest = bounds[1] - bounds[0]
    return Difference(mean, (max(mean - half, -largest), min(mean + half, largest)), improvement)


def compare_episodes(
    first: Sequence[float], second: Sequence[float], bounds: Interval = UNBOUNDED
) -> Difference:
    """Compare two policies on the same starts by one score per episode in the same order: Student's interval
    of the mean of the differences.

    The interval is cut at the largest difference that the `bounds` of a score allow.
    """
    differences = [after - before for before, after in zip(first, second, strict=True)]
    mean = fmean(differences)
    largest = bounds[1] - bounds[0]
    better = fmean(float(difference > 0) + 0.5 * float(difference == 0) for difference in differences)
    if len(differences) > 1 and min(differences) == max(differences):
        return Difference(mean, (mean, mean), better)
    return Difference(mean, mean_interval(differences, (-largest, largest)), better)


def probability_of_improvement(first: Sequence[float], second: Sequence[float]) -> float:
    """Return the probability that a score of `second` exceeds one of `first`; equal scores count half.

    This is the Mann-Whitney U statistic over the number of pairs.
    """
    import numpy as np

    before, after = np.asarray(first, dtype=float)[:, None], np.asarray(second, dtype=float)[None, :]
    return float(np.mean((after > before) + 0.5 * (after == before)))


FALSE_STOPS = 0.05
"""The largest probability that a training stops with a policy that is `MARGIN` or more below the required
value."""
MARGIN = 0.02
"""The margin, as a share of the success rate or of the range of returns."""
COST_SHARE = 0.1
"""The largest share of the steps of the training for failed confirmations. Once this share is used up, no
further confirmation begins."""
POWER = 0.5
"""The smallest probability that a confirmation passes at a success rate halfway from the required one to 100
%. With 100 starts, the first two confirmations of `>= 95 %` need 99 successes and the third 100, so a policy
of 97.5 % would pass with 28 and 8 %. With 200 starts, it needs 194 and 195, and passes with 76 and 62 %."""
EXPECTED = 0.25
"""The smallest mean return for which the number of starts is chosen, as a share of the way from the required
one to the highest return. With 100 starts for the highest return only, a policy of PitEscape with 0.91 where
0.89 is required failed."""
ROOM = 2
"""A confirmation of a mean return has up to so many times the episodes after which the expected one passes."""
PART = 40
"""The number of episodes of a confirmation after which it is checked whether it can still pass; a multiple of
the rows of a forward pass. Where the next ones may be enough to pass, it is a fifth of this."""
HOPELESS = 0.01
"""A confirmation ends if a policy halfway to 100 % would have so few successes with at most this probability,
or if Student's upper bound of the mean return at this level is below the required one. So a confirmation that
fails is short, and a later one fits into `COST_SHARE` earlier."""
_MAX_EPISODES = 10 * MAX_SOLVED_EPISODES


def may_begin(number: int, failed_steps: float, steps: float, share: float) -> bool:
    """Return whether confirmation `number`, counted from 1, may begin: the first one always, and a further
    one while failed ones took at most `share` of the steps of the training."""
    return number == 1 or failed_steps <= share * steps


def error_level(number: int) -> float:
    """Return the largest probability that confirmation `number`, counted from 1, passes a policy that is too
    weak."""
    return FALSE_STOPS / (number * (number + 1))


def probability_of_at_least(successes: int, episodes: int, rate: float) -> float:
    """Return the probability of at least so many successes at a success rate of `rate`, by the binomial
    distribution."""
    from scipy.special import bdtrc  # commands that only read runs work without scipy

    if successes <= 0:
        return 1.0
    # `bdtrc(k, ...)` is the probability of more than k successes.
    return float(bdtrc(successes - 1, episodes, rate)) if successes <= episodes else 0.0


def required_successes(episodes: int, rate: float, level: float) -> int:
    """Return the smallest number of successes that `episodes` episodes reach with at most the probability
    `level` at a success rate of `rate`. It is larger than `episodes` if even all of them are too few."""
    low, high = 0, episodes + 1
    while low < high:  # the probability falls with the number of successes
        middle = (low + high) // 2
        is_enough = probability_of_at_least(middle, episodes, rate) <= level
        low, high = (low, middle) if is_enough else (middle + 1, high)
    return low


@dataclass(frozen=True)
class Confirmation:
    """One confirmation of a training.

    An evaluation during a training is small and there are many of them, so one of them may meet `solved` by
    luck. A model whose evaluation meets `solved` is therefore confirmed on new starts, as many as `solved`
    requires. The training stops only if the confirmation shows more than the required value:

    - The k-th confirmation of a training may err with a probability of 5 % / (k (k + 1)). Over all
      confirmations, the sum is at most 5 % (Bonferroni's inequality; 1/2 + 1/6 + 1/12 + ... = 1), for any
      policies and any number of evaluations.
    - A success rate passes if a policy whose rate is 2 points below the required one would have so many
      successes with at most this probability, by the binomial distribution. For `>= 90 % over 100 episodes`,
      the first confirmation needs 95 of 100 successes, the second 142 of 150.
    - A mean return passes if it reaches the required one, and the evidence against a mean that is 2 % of the
      range of returns below it (`mean_evidence`) exceeds 1 / level. This holds for any returns in the range
      and after any number of episodes, so it passes as soon as this is true, from the number of `solved` on.

    A confirmation ends early when it cannot pass any more, or would hardly pass, which makes false stops
    rarer. `tests/learning/test_confirmation.py` measures the chances.

    Attributes:
        solved: The criterion of the scenario.
        number: The number of the confirmation, from 1.
        returns: The lowest and the highest return of an episode: the possible ones, or else those seen so
            far.
        episodes: The largest number of new starts: that of `solved`, or more so that a good policy passes. A
            policy halfway between the required rate and 100 % must pass with a probability of `POWER`. For a
            mean return, it is `ROOM` times the number after which equal returns of the expected mean pass.
        successes: The number of required successes; 0 if `solved` has no success rate.
    """

    solved: Solved
    number: int
    returns: Interval
    episodes: int
    successes: int

    @staticmethod
    def plan(
        solved: Solved, number: int, returns: Interval, evaluated: Sequence[Episode] = ()
    ) -> Confirmation | None:
        """Plan the next confirmation; None if no number of episodes up to 100 000 is enough.

        Args:
            solved: The criterion of the scenario.
            number: The number of the confirmation, from 1.
            returns: The lowest and the highest return of an episode.
            evaluated: The episodes that met `solved`. The plan is for a policy with their mean return less
                its standard error, or with that of `EXPECTED` if it is higher. Without them, it is for the
                highest return.
        """
        if solved.mean_return is None:
            mean = returns[1]
        else:
            least = solved.mean_return + EXPECTED * (returns[1] - solved.mean_return)
            mean = min(returns[1], max(least, _cautious_mean(evaluated) if evaluated else returns[1]))
        smallest = Confirmation.with_episodes(solved, number, returns, solved.episodes)
        first = max(solved.episodes, ROOM * smallest._enough_equal(mean))
        for episodes in range(first, _MAX_EPISODES + 1, math.ceil(solved.episodes / 2)):
            planned = Confirmation.with_episodes(solved, number, returns, episodes)
            halfway = (1 + (solved.success_rate or 0.0)) / 2
            if probability_of_at_least(planned.successes, episodes, halfway) >= POWER:
                return planned
        return None

    @staticmethod
    def with_episodes(solved: Solved, number: int, returns: Interval, episodes: int) -> Confirmation:
        """Return a confirmation with this number of episodes, which may be too few to pass."""
        successes = 0
        if solved.success_rate is not None:
            required = required_successes(
                episodes, max(0.0, solved.success_rate - MARGIN), error_level(number)
            )
            # 0.55 * 100 is 55.00000000000001, which without the difference would need 56 successes.
            successes = max(required, math.ceil(solved.success_rate * episodes - 1e-9))
        return Confirmation(solved, number, returns, episodes, successes)

    @property
    def level(self) -> float:
        return error_level(self.number)

    @property
    def requirement(self) -> str:
        """The condition to pass in words, such as `at least 95 of 100 successes`, or `a mean return of at
        least 195, certainly above 191`."""
        parts = []
        if self.solved.success_rate is not None:
            parts.append(f"at least {self.successes:,} of {self.episodes:,} successes")
        if self.solved.mean_return is not None:
            mean, weak = f"{self.solved.mean_return:g}", number_text(self._too_weak)
            parts.append(f"a mean return of at least {mean}, certainly above {weak}")
        return " and ".join(parts)

    @property
    def least_episodes(self) -> int:
        """The smallest number of episodes that may pass."""
        return self.episodes if self.solved.success_rate is not None else self.solved.episodes

    def next_part(self, played: int) -> range:
        """Return the numbers of the next episodes, after which it is checked whether it passes or is lost."""
        may_pass = self.least_episodes < self.episodes and played + PART > self.least_episodes
        return range(played, min(self.episodes, played + (PART // 5 if may_pass else PART)))

    def is_lost(self, episodes: Sequence[Episode]) -> bool:
        """Return whether the first episodes rule out a confirmation that passes, or make it very unlikely."""
        left = self.episodes - len(episodes)
        successes = sum(episode.is_success for episode in episodes)
        if successes + left < self.successes:
            return True
        if self.solved.success_rate is not None:
            halfway = (1 + self.solved.success_rate) / 2
            if 1.0 - probability_of_at_least(successes + 1, len(episodes), halfway) <= HOPELESS:
                return True
        if self.solved.mean_return is None:
            return False
        returns = [episode.total_return for episode in episodes]
        best = math.fsum(returns) + left * self.returns[1]
        return (
            best < self.solved.mean_return * self.episodes
            or upper_bound(returns, HOPELESS) < self.solved.mean_return
        )

    def passes(self, episodes: Sequence[Episode]) -> bool:
        """Return whether these episodes, all of them or for a mean return the first ones, show that the task
        is solved."""
        count, successes = len(episodes), sum(episode.is_success for episode in episodes)
        if count < self.least_episodes or successes < self.successes:
            return False
        returns = [episode.total_return for episode in episodes]
        return self.solved.is_met(fmean(returns), successes / count) and self._return_passes(returns)

    def _return_passes(self, returns: Sequence[float]) -> bool:
        """Return whether the evidence against a mean return of `_too_weak` is enough."""
        lowest, highest = min(self.returns[0], *returns), max(self.returns[1], *returns)
        if self.solved.mean_return is None or self._too_weak <= lowest:
            return True
        evidence, _ = mean_evidence(self._too_weak, returns, (lowest, highest))
        return evidence >= math.log(1 / self.level)

    def _enough_equal(self, value: float) -> int:
        """Return the number of episodes with this return that pass, by `mean_evidence`."""
        gain, largest_loss = value - self._too_weak, self._too_weak - self.returns[0]
        if self.solved.mean_return is None or largest_loss <= 0:
            return 0
        growth = math.log1p(min(1.0, _LARGEST_BET * gain / largest_loss))
        return 1 + math.ceil(-math.log(self.level) / growth) if growth > 0 else _MAX_EPISODES + 1

    @property
    def _too_weak(self) -> float:
        """The largest mean return that a confirmation is to refuse."""
        low, high = self.returns
        return (self.solved.mean_return or 0.0) - MARGIN * (high - low)


def _cautious_mean(episodes: Sequence[Episode]) -> float:
    """Return the mean return less its standard error.

    In a plan for the mean itself, a policy of PitEscape had 0.912 in its evaluation and 0.908 in its
    confirmation, which failed because 100 starts were too few.
    """
    returns = [episode.total_return for episode in episodes]
    error = stdev(returns) / math.sqrt(len(returns)) if len(returns) > 1 else 0.0
    return fmean(returns) - error


def upper_bound(returns: Sequence[float], level: float) -> float:
    """Student's one-sided upper bound of a mean return at a confidence of `1 - level`; infinite for fewer
    than two returns."""
    if len(returns) < 2:
        return math.inf
    half = student_quantile(len(returns) - 1, 1 - level) * stdev(returns) / math.sqrt(len(returns))
    return fmean(returns) + half
