"""The chances of a training that stops because a confirmation shows that its task is solved: simulated, and
against closed forms."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import pytest
from scipy.stats import binom, t

from deepbots_cli.learning.held_out import EVALUATION_EPISODES
from deepbots_cli.learning.runs.confirmation_rule import (
    COST_SHARE,
    FALSE_STOPS,
    MARGIN,
    Confirmation,
    error_level,
    lower_bound,
    may_begin,
    required_successes,
)
from deepbots_cli.learning.training_evaluations import CONFIRMATION_PART
from deepbots_cli.program.task import Solved
from deepbots_cli.rollout import Episode

LOOKS = 60
RATE = Solved(100, success_rate=0.9)
RETURN = Solved(100, mean_return=195.0)
BOUNDS = (0.0, 200.0)
Draw = Callable[[np.random.Generator, float, int], Sequence[Episode]]


class Outcome(NamedTuple):
    """The outcome of one simulated training.

    Attributes:
        stopped_with: The value of the policy with which it stopped; None if it did not stop early.
        failed: The number of episodes in failed confirmations.
        share: `failed` divided by the episodes of the training.
    """

    stopped_with: float | None
    failed: int
    share: float


def successes(generator: np.random.Generator, rate: float, count: int) -> list[Episode]:
    return [Episode(0.0, 1, bool(good), None) for good in generator.random(count) < rate]


def falls(generator: np.random.Generator, mean: float, count: int) -> list[Episode]:
    """Returns of a CartPole: 200, or a fall after 20 to 200 steps."""
    fallen = generator.random(count) < (200.0 - mean) / 90.0
    returns = np.where(fallen, generator.uniform(20.0, 200.0, count), 200.0)
    return [Episode(float(value), 1, False, None) for value in returns]


def uniform(generator: np.random.Generator, mean: float, count: int) -> list[Episode]:
    return [
        Episode(float(value), 1, False, None) for value in generator.uniform(2 * mean - 200.0, 200.0, count)
    ]


def wins(generator: np.random.Generator, mean: float, count: int) -> list[Episode]:
    """Returns of 200 or 0."""
    return [Episode(200.0 * float(won), 1, False, None) for won in generator.random(count) < mean / 200.0]


def train(generator: np.random.Generator, solved: Solved, values: Sequence[float], draw: Draw) -> Outcome:
    """A training as `TrainingCallback` runs it, whose policy has these true values at its evaluations.
    Evaluations take 10 % of the steps, and all episodes have the same length."""
    number, failed, steps = 1, 0, 0
    for value in values:
        steps += 10 * EVALUATION_EPISODES
        evaluated = draw(generator, value, EVALUATION_EPISODES)
        mean = float(np.mean([episode.total_return for episode in evaluated]))
        rate = float(np.mean([episode.is_success for episode in evaluated]))
        if mean < (solved.mean_return or -math.inf) or rate < (solved.success_rate or 0.0):
            continue
        if not may_begin(number, failed, steps, COST_SHARE):
            continue
        plan = Confirmation.plan(solved, number, BOUNDS, evaluated)
        assert plan is not None
        done: list[Episode] = []
        while len(done) < plan.episodes and not plan.is_lost(done):
            done += draw(generator, value, min(CONFIRMATION_PART, plan.episodes - len(done)))
        if plan.passes(done):
            return Outcome(value, failed, failed / steps)
        number, failed = number + 1, failed + len(done)
    return Outcome(None, failed, failed / steps)


def simulate(
    solved: Solved, values: Sequence[float], draw: Draw, repetitions: int, seed: int
) -> list[Outcome]:
    generator = np.random.default_rng(seed)
    return [train(generator, solved, values, draw) for _ in range(repetitions)]


def stops(outcomes: Sequence[Outcome], below: float = math.inf) -> float:
    """The share of trainings that stopped with a policy of at most this value."""
    return float(np.mean([each.stopped_with is not None and each.stopped_with <= below for each in outcomes]))


def test_the_first_confirmations_of_90_percent_need_95_of_100_then_187_and_188_of_200() -> None:
    plans = [Confirmation.plan(RATE, number, BOUNDS) for number in (1, 2, 3)]
    assert [(plan.successes, plan.episodes) for plan in plans if plan is not None] == [
        (95, 100),
        (187, 200),
        (188, 200),
    ]


@pytest.mark.parametrize("number", [1, 2, 5, 10])
@pytest.mark.parametrize("rate", [0.5, 0.9, 0.95, 0.99])
def test_half_of_the_policies_halfway_to_100_percent_pass_a_confirmation(rate: float, number: int) -> None:
    plan = Confirmation.plan(Solved(100, success_rate=rate), number, BOUNDS)
    assert plan is not None
    assert binom.sf(plan.successes - 1, plan.episodes, (1 + rate) / 2) >= 0.5


@pytest.mark.parametrize("episodes", [1, 7, 100, 1_000])
@pytest.mark.parametrize("rate", [0.0, 0.1, 0.88, 0.99, 1.0])
@pytest.mark.parametrize("level", [0.025, 1e-4])
def test_the_required_successes_are_those_of_the_binomial_distribution(
    episodes: int, rate: float, level: float
) -> None:
    least = required_successes(episodes, rate, level)
    assert binom.sf(least - 1, episodes, rate) <= level
    assert least == 0 or binom.sf(least - 2, episodes, rate) > level


def test_the_levels_of_all_confirmations_add_up_to_the_chance_of_a_false_stop() -> None:
    assert sum(error_level(number) for number in range(1, 10_000)) == pytest.approx(FALSE_STOPS, rel=1e-3)


def test_a_confirmation_has_up_to_100000_episodes() -> None:
    plans = [Confirmation.plan(Solved(count, success_rate=0.9), 1, BOUNDS) for count in (100_000, 100_001)]
    assert [plan and plan.episodes for plan in plans] == [100_000, None]


def test_the_lower_bound_is_that_of_student_with_the_worst_returns_added() -> None:
    values = [3.0, 4.0, 5.0, 9.0, 0.0, 0.0]
    half = t.ppf(0.975, 5) * np.std(values, ddof=1) / math.sqrt(6)
    assert lower_bound(values[:4], 0.0, 0.025) == pytest.approx(np.mean(values) - half)


@pytest.mark.parametrize(
    ("criterion", "episodes"), [(Solved(2, success_rate=1.0), 184), (Solved(20, success_rate=0.9), 100)]
)
def test_a_criterion_of_few_episodes_is_confirmed_with_more(criterion: Solved, episodes: int) -> None:
    plan = Confirmation.plan(criterion, 1, BOUNDS)
    assert plan is not None
    assert plan.episodes == episodes


@pytest.mark.parametrize("number", [1, 3, 8])
@pytest.mark.parametrize("required", [0.5, 0.9, 0.99])
def test_rare_failures_that_a_sample_lacks_do_not_confirm_a_mean_return(required: float, number: int) -> None:
    plan = Confirmation.plan(Solved(100, mean_return=required), number, (0.0, 1.0))
    assert plan is not None
    chances = []
    for high in np.linspace(
        required, 1.0, 6
    ):  # an episode returns this value or 0, and too little in the mean
        episodes = (
            [Episode(float(high), 1, False, None)] * plan.episodes,
            [Episode(0.0, 1, False, None)] * plan.episodes,
        )
        mixed = range(round(required * plan.episodes), plan.episodes + 1)
        passing = [count for count in mixed if plan.passes([*episodes[0][:count], *episodes[1][count:]])]
        chances.append(float(np.sum(binom.pmf(passing, plan.episodes, (required - MARGIN) / high))))
    assert max(chances) <= error_level(number)


def test_a_confirmation_ends_as_soon_as_it_cannot_pass() -> None:
    plan = Confirmation.plan(RATE, 1, BOUNDS)
    assert plan is not None
    bad, fine = Episode(0.0, 1, False, None), Episode(0.0, 1, True, None)
    assert not plan.is_lost([fine] * 60 + [bad] * 5)
    assert plan.is_lost([fine] * 60 + [bad] * 6)  # more failures than 95 of 100 successes allow
    assert not plan.is_lost([fine] * 16 + [bad] * 4)
    assert plan.is_lost([fine] * 15 + [bad] * 5)  # possible, but very unlikely for a policy of 95 %
    planned = Confirmation.plan(RETURN, 1, BOUNDS)
    assert planned is not None
    assert planned.is_lost([Episode(value, 1, False, None) for value in (180.0, 182.0, 185.0, 183.0) * 5])
    assert not plan.passes([fine] * 94)
    assert plan.passes([fine] * 95 + [bad] * 5)
    assert not plan.passes([fine] * 94 + [bad] * 6)


def test_policies_below_the_bar_rarely_stop_a_training_and_policies_above_it_do() -> None:
    assert stops(simulate(RATE, [0.85] * LOOKS, successes, 100, seed=1)) <= 0.05
    assert stops(simulate(RATE, [0.97] * LOOKS, successes, 50, seed=2)) >= 0.95


@pytest.mark.slow
@pytest.mark.parametrize("rate", [0.80, 0.82, 0.84, 0.85, 0.86, 0.87, 0.88])
def test_false_stops_over_all_looks_of_a_training(rate: float) -> None:
    outcomes = simulate(RATE, [rate] * LOOKS, successes, 2_000, seed=10 + round(100 * rate))
    print(
        f"{rate:.0%}: false stops {stops(outcomes):.2%}, failed confirmations"
        f" {np.median([each.failed for each in outcomes]):.0f} episodes"
    )
    assert stops(outcomes) <= FALSE_STOPS
    assert max(each.share for each in outcomes) <= 0.15


@pytest.mark.slow
def test_a_policy_of_95_percent_stops_its_training() -> None:
    outcomes = simulate(RATE, [0.95] * LOOKS, successes, 2_000, seed=3)
    print(
        f"never stopped {1 - stops(outcomes):.2%}, median cost"
        f" {np.median([each.failed for each in outcomes]):.0f} episodes"
    )
    assert stops(outcomes) >= 0.95


@pytest.mark.slow
@pytest.mark.parametrize(("first", "last"), [(0.6, 0.88), (0.8, 0.88), (0.5, 0.95)])
def test_rising_rates_do_not_stop_a_training_early(first: float, last: float) -> None:
    outcomes = simulate(RATE, list(np.linspace(first, last, LOOKS)), successes, 2_000, seed=4)
    print(f"{first:.0%} to {last:.0%}: stops at most 2 points below the bar {stops(outcomes, 0.88):.2%}")
    assert stops(outcomes, 0.88) <= FALSE_STOPS


@pytest.mark.slow
@pytest.mark.parametrize("draw", [falls, uniform, wins])
@pytest.mark.parametrize("mean", [185.0, 188.0, 190.0, 191.0])
def test_false_stops_of_a_mean_return(draw: Draw, mean: float) -> None:
    outcomes = simulate(RETURN, [mean] * LOOKS, draw, 2_000, seed=5)
    print(f"{draw.__name__} {mean:g}: false stops {stops(outcomes):.2%}")
    assert stops(outcomes) <= FALSE_STOPS


@pytest.mark.slow
def test_a_mean_return_of_199_stops_its_training() -> None:
    assert stops(simulate(RETURN, [199.0] * LOOKS, falls, 500, seed=6)) >= 0.95
