"""The confirmation of a model on new starts, which shows that the task is solved and the training may stop.

An evaluation during a training is small and there are many of them, so one of them may meet `solved` by luck.
A model whose evaluation meets `solved` is therefore confirmed on new starts, as many as `solved` requires.
The training stops only if the confirmation shows more than the required value. A confirmation is judged once,
by all of its episodes, so the chance of a false stop is easy to compute:

- The k-th confirmation of a training may err with a probability of 5 % / (k (k + 1)). Over all confirmations,
  the sum is at most 5 % (Bonferroni's inequality; 1/2 + 1/6 + 1/12 + ... = 1), for any policies and any
  number of evaluations.
- A success rate passes if a policy whose rate is 2 points below the required one would have so many successes
  with at most this probability, by the binomial distribution. For `>= 90 % over 100 episodes`, the first
  confirmation needs 95 of 100 successes, the second 187 of 200.
- A mean return passes if it reaches the required one, and Student's lower bound at this level is not more
  than 2 % of the range of returns below it. The bound includes `worst_returns` more episodes with the worst
  return, because returns are often equal but for rare failures, which a sample may miss.

A confirmation ends early when it cannot pass any more, or would hardly pass, which makes false stops rarer.
`tests/learning/test_confirmation.py` measures the chances.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist, fmean, stdev

from deepbots_cli.learning.runs.statistics import Interval, student_quantile
from deepbots_cli.program.task import Solved
from deepbots_cli.rollout import Episode
from deepbots_cli.scenario.quantities import MAX_SOLVED_EPISODES
from deepbots_cli.words import number_text

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
0.89 is required failed by the worst returns that are added."""
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

    Attributes:
        solved: The criterion of the scenario.
        number: The number of the confirmation, from 1.
        returns: The lowest and the highest return of an episode: the possible ones, or else those seen so
            far.
        episodes: The number of new starts: that of `solved`, or its smallest multiple with which a good
            policy passes. A policy halfway between the required rate and 100 % must pass with a probability
            of `POWER`; a policy with the expected mean return must pass.
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
        for episodes in range(solved.episodes, _MAX_EPISODES + 1, solved.episodes):
            planned = Confirmation.with_episodes(solved, number, returns, episodes)
            if solved.success_rate is not None:
                halfway = (1 + solved.success_rate) / 2
                if probability_of_at_least(planned.successes, episodes, halfway) < POWER:
                    continue
            if planned._return_passes([mean] * episodes):
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
        least 195, with a lower bound of 191`."""
        parts = []
        if self.solved.success_rate is not None:
            parts.append(f"at least {self.successes:,} of {self.episodes:,} successes")
        if self.solved.mean_return is not None:
            bound = f"a lower bound of {number_text(self._lowest_bound)}"
            parts.append(f"a mean return of at least {self.solved.mean_return:g}, with {bound}")
        return " and ".join(parts)

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
        """Return whether all episodes of the confirmation show that the task is solved."""
        returns = [episode.total_return for episode in episodes]
        successes = sum(episode.is_success for episode in episodes)
        if len(episodes) < self.episodes or successes < self.successes:
            return False
        return self.solved.is_met(fmean(returns), successes / len(episodes)) and self._return_passes(returns)

    def _return_passes(self, returns: Sequence[float]) -> bool:
        """Return whether the lower bound of the mean return is at most `MARGIN` of the range below the
        required one."""
        return (
            self.solved.mean_return is None
            or lower_bound(returns, self.returns[0], self.level) >= self._lowest_bound
        )

    @property
    def _lowest_bound(self) -> float:
        """The smallest lower bound of the mean return that passes."""
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


def worst_returns(level: float) -> int:
    """Return the number of worst returns that the lower bound at a confidence of `1 - level` includes: 2, 3,
    4 for the first confirmations.

    A sample often lacks a rare failure, and its standard deviation is then too small. A. Agresti and B. Coull
    (Am. Stat. 52, 1998) add z^2 / 2 failures to a proportion, where z is the normal quantile. With a single
    one, 8 to 13 % of the trainings whose episodes return 0 or 1 stopped with a policy that is too weak.
    """
    return math.ceil(NormalDist().inv_cdf(1 - level) ** 2 / 2)


def lower_bound(returns: Sequence[float], worst: float, level: float) -> float:
    """Student's one-sided lower bound of a mean return at a confidence of `1 - level`, with `worst_returns`
    added."""
    values = [*returns, *[worst] * worst_returns(level)]
    half = student_quantile(len(values) - 1, 1 - level) * stdev(values) / math.sqrt(len(values))
    return fmean(values) - half


def upper_bound(returns: Sequence[float], level: float) -> float:
    """Student's one-sided upper bound of a mean return at a confidence of `1 - level`; infinite for fewer
    than two returns."""
    if len(returns) < 2:
        return math.inf
    half = student_quantile(len(returns) - 1, 1 - level) * stdev(returns) / math.sqrt(len(returns))
    return fmean(returns) + half
