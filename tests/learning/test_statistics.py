"""Statistics of evaluations against closed forms, published tables and simulated experiments of known
truth."""

from __future__ import annotations

import math
from statistics import NormalDist, fmean

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deepbots_cli.learning.runs import statistics as stats
from tests.few import few


def test_wilson_has_the_values_of_the_published_example():
    # R. G. Newcombe, Stat. Med. 17, 1998, table I: 81 of 263, 15 of 148, 0 of 20, 1 of 29.
    for successes, episodes, low, high in (
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ):
        assert stats.wilson(successes, episodes) == pytest.approx((low, high), abs=5e-5)


@given(trials=st.integers(1, 5_000), share=st.floats(0, 1))
def test_the_wilson_bounds_are_where_the_score_test_just_rejects(trials: int, share: float) -> None:
    successes = round(share * trials)
    observed = successes / trials
    z = 1.959963984540054
    low, high = stats.wilson(successes, trials)
    assert 0 <= low <= observed <= high <= 1
    for bound in (low, high):
        assert (observed - bound) ** 2 == pytest.approx(
            z * z * bound * (1 - bound) / trials, rel=1e-6, abs=1e-12
        )


def test_an_interval_of_a_mean_is_students():
    # t at 0.975 with 4 degrees of freedom is 2.776445.
    low, high = stats.mean_interval([1.0, 2.0, 3.0, 4.0, 5.0])
    assert (low, high) == pytest.approx(
        (3 - 2.776445 * math.sqrt(2.5 / 5), 3 + 2.776445 * math.sqrt(2.5 / 5)), abs=1e-5
    )
    assert stats.mean_interval([1.0]) is None
    assert stats.mean_interval([3.0, 3.0, 3.0]) is None
    # At most the share 1 - 0.05^(1/5) = 0.451 of all values differs from five equal ones.
    assert stats.mean_interval([200.0] * 5, (1.0, 200.0)) == pytest.approx(
        (200 - 0.4507 * 199, 200.0), abs=0.01
    )


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ([1, 2, 3, 4], 2.5),
        ([0, 10, 20, 30, 40, 50, 60, 1000], 35.0),
        ([7], 7.0),
        ([0, 3, 9], (0 * 0.25 + 3 + 9 * 0.25) / 1.5),
    ],
)
def test_the_interquartile_mean_weighs_the_edges_in_part(values, expected):
    assert stats.interquartile_mean(values) == pytest.approx(expected)


def test_an_interval_of_a_mean_is_cut_at_the_bounds_of_its_values():
    values = [200.0] * 9 + [190.0]
    low, high = stats.mean_interval(values)
    assert high > 200
    assert stats.mean_interval(values, (1.0, 200.0)) == (low, 200.0)
    assert stats.mean_interval([-v for v in values], (-200.0, -1.0)) == (-200.0, -low)


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=40), st.floats(-100, 100))
def test_the_interquartile_mean_moves_with_its_values_and_ignores_their_order(values, shift):
    center = stats.interquartile_mean(values)
    assert min(values) - 1e-6 <= center <= max(values) + 1e-6
    assert stats.interquartile_mean([value + shift for value in reversed(values)]) == pytest.approx(
        center + shift, abs=1e-6
    )


@given(st.integers(1, 300), st.data())
def test_a_confidence_sequence_holds_the_rate_and_excludes_what_its_evidence_excludes(episodes, data):
    successes = data.draw(st.integers(0, episodes))
    low, high = stats.rate_sequence(successes, episodes)
    assert 0 <= low <= successes / episodes <= high <= 1
    for rate in (0.05, 0.3, 0.5, 0.9, 0.99):
        excluded = stats.rate_evidence(rate, successes, episodes) > math.log(1 / stats.ALPHA)
        assert excluded == (not low - 1e-9 <= rate <= high + 1e-9)


def test_the_evidence_on_a_rate_is_the_ratio_of_likelihoods():
    # One success under Beta(1/2, 1/2): the mixture gives 1/2, the rate 0.1 gives 0.1.
    assert stats.rate_evidence(0.1, 1, 1) == pytest.approx(math.log(5))
    assert stats.rate_evidence(1.0, 3, 4) == math.inf


def test_the_evidence_on_a_mean_is_the_capital_of_its_bets():
    # Gains of 1 where at most 2 can be lost: no bet on the first, then the largest, which loses three
    # quarters of the capital on -2.
    above, below = stats.mean_evidence(2.0, [3.0] * 5, (0.0, 10.0))
    assert above == pytest.approx(4 * math.log(1 + 0.75 / 2))
    assert below == 0
    # After gains of 1 and -0.5, the bet is the ratio of the mean to the mean square, 0.25 / 0.625.
    above, _ = stats.mean_evidence(2.0, [3.0, 1.5, 4.0], (0.0, math.inf))
    assert above == pytest.approx(math.log(1 - 0.375 * 0.5) + math.log(1 + 0.75 / 2 * 2))
    assert stats.mean_evidence(3.0, [3.0] * 5, (0.0, 10.0)) == (0, 0)
    assert stats.mean_evidence(2.0, [3.0] * 500, (-math.inf, math.inf)) == (0, 0)


def simulate_gates(rate: float, required: float, gates: int, planned: int, seed: int) -> float:
    """The share of gates that decide early, by the confidence sequence, and wrongly."""
    generator = np.random.default_rng(seed)
    wrong = 0
    for _ in range(gates):
        successes = 0
        for episode, success in enumerate(generator.random(planned) < rate, start=1):
            successes += int(success)
            if stats.rate_evidence(required, successes, episode) >= math.log(1 / stats.ALPHA):
                wrong += (successes / episode > required) != (rate >= required)
                break
    return wrong / gates


@pytest.mark.slow
@pytest.mark.parametrize("rate", few([0.9, 0.91, 0.89], ["0.91", "0.89"]))
def test_at_most_one_gate_in_twenty_is_wrong_before_its_last_episode(rate):
    assert simulate_gates(rate, 0.9, 2000, 100, seed=1) <= stats.ALPHA


RETURNS = {
    "mostly the largest return": lambda generator: np.where(generator.random(100) < 0.95, 200.0, 20.0),
    "half the largest return": lambda generator: np.where(generator.random(100) < 0.5, 200.0, 20.0),
    "even": lambda generator: generator.uniform(0, 200, 100),
    "skewed": lambda generator: 200 * generator.beta(0.2, 2, 100),
}
MEANS = {
    "mostly the largest return": 191.0,
    "half the largest return": 110.0,
    "even": 100.0,
    "skewed": 200 * 0.2 / 2.2,
}


@pytest.mark.parametrize("returns", few(RETURNS, ["mostly the largest return", "skewed"]))
@pytest.mark.parametrize("off", [-0.5, 0.5])
def test_at_most_one_gate_in_twenty_on_a_mean_is_wrong(returns, off):
    generator = np.random.default_rng(2)
    wrong = 0
    for _ in range(200):
        done = RETURNS[returns](generator).tolist()
        verdicts = (
            stats.gate_mean(MEANS[returns] + off, done[:count], 100, (0.0, 200.0))
            for count in range(5, 100, 5)
        )
        decided = next(
            (verdict.met for verdict in verdicts if verdict.met is not None and "sequence" in verdict.reason),
            None,
        )
        wrong += decided is (off > 0)
    assert wrong / 200 <= stats.ALPHA


def test_thirty_failures_decide_a_gate_of_95_percent_without_the_other_seventy():
    verdict = stats.gate_rate(0.95, 0, 30, 100)
    assert verdict.met is False
    assert "0 of 30" in verdict.reason
    assert next(count for count in range(1, 31) if stats.gate_rate(0.95, 0, count, 100).met is False) <= 6


def test_a_gate_is_decided_when_the_remaining_episodes_cannot_change_it():
    assert stats.gate_rate(0.5, 4, 5, 8).met is True
    assert stats.gate_rate(0.5, 1, 6, 8).met is False
    assert stats.gate_rate(0.5, 3, 6, 8).met is None
    assert stats.gate_rate(0.9, 9, 10, 10).met is True
    assert stats.gate_mean(1.0, [0.5, 1.6], 2).met is True
    assert stats.gate_mean(1.0, [0.5, 1.2], 2).met is False
    assert stats.gate_mean(1.0, [0.5, 1.2], 20).met is None
    assert stats.gate_mean(0.5, [0.9, 0.8], 3, (0.0, 1.0)).met is True
    assert stats.gate_mean(0.8, [0.5, 0.6], 3, (0.0, 1.0)).met is False


def test_a_gate_on_a_mean_is_not_met_by_a_few_equal_returns():
    """Five returns of 200 say little about a policy that fails in one of five episodes."""
    assert stats.gate_mean(195.0, [200.0] * 5, 100, (1.0, 200.0)).met is None
    assert stats.gate_mean(0.8, [0.91, 0.92] * 25, 100, (0.0, 1.0)).met is True
    assert stats.gate_mean(195.0, [200.0, 90.0, 60.0] * 10, 100, (1.0, 200.0)).met is False


@pytest.mark.parametrize("seeds", [3, 5])
def test_an_interval_of_a_difference_covers_it_in_93_percent_of_comparisons(seeds):
    generator = np.random.default_rng(seeds)
    covered = 0
    for _ in range(2000):
        comparison = stats.compare_seeds(generator.normal(100, 10, seeds), generator.normal(120, 20, seeds))
        covered += comparison.interval[0] <= 20 <= comparison.interval[1]
    assert covered / 2000 >= 0.93


def test_the_probability_of_improvement_is_that_of_normal_scores():
    generator = np.random.default_rng(0)
    first, second = generator.normal(0, 1, 1500), generator.normal(1, 1, 1500)
    assert stats.probability_of_improvement(first, second) == pytest.approx(
        NormalDist().cdf(1 / math.sqrt(2)), abs=0.02
    )
    assert stats.probability_of_improvement([1, 1], [1, 1]) == 0.5


def test_pairing_by_start_finds_a_difference_that_the_spread_of_starts_hides():
    generator = np.random.default_rng(3)
    starts = generator.normal(0, 100, 60)
    first = starts + generator.normal(0, 1, 60)
    second = starts + 2 + generator.normal(0, 1, 60)
    paired = stats.compare_episodes(list(first), list(second))
    assert paired.certain
    assert paired.mean == pytest.approx(fmean(second) - fmean(first))
    assert not stats.compare_seeds(first, second).certain


def test_one_run_each_has_a_difference_without_an_interval():
    comparison = stats.compare_seeds([1.0], [3.0])
    assert comparison.mean == 2.0
    assert comparison.interval is None
    assert comparison.certain is False


@pytest.mark.parametrize("rate", [0.5, 0.9, 0.95])
def test_so_many_successes_are_needed_to_be_above_a_rate(rate: float) -> None:
    """`robustness --episodes 20` called every level "not significant" for 90 %, and did not say that 35 are
    needed."""
    count = stats.episodes_above(rate)
    assert stats.wilson(count, count)[0] >= rate > stats.wilson(count - 1, count - 1)[0]
