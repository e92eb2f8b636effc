"""A training is said to fall apart after a fall of its evaluations, and hardly ever while it is healthy."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy import stats

from deepbots_cli.errors import RunError
from deepbots_cli.learning.runs.decline import find_decline, paired
from deepbots_cli.learning.runs.episodes import read_evaluations
from tests.few import few


def _evaluations(rates, *, stage="", every=1000, low=20.0, high=200.0):
    """Evaluations of 20 episodes, of which these shares succeed and return `high`; the others return
    `low`."""
    wins = [np.arange(20) < round(20 * rate) for rate in rates]
    return [
        {
            "steps": every * (number + 1),
            "stage": stage,
            "returns": np.where(won, high, low).tolist(),
            "successes": won.astype(float).tolist(),
        }
        for number, won in enumerate(wins)
    ]


FALL = [0.0, 0.2, 0.6, 1.0, 1.0, 0.95, 1.0, 0.4, 0.3, 0.35, 0.2, 0.4]


def test_a_training_that_gets_much_worse_after_its_best_evaluation_is_named():
    fall = find_decline(_evaluations(FALL), "success_rate")
    assert fall is not None
    assert fall.best_value == 1.0
    assert (fall.best_steps, fall.since_steps, fall.last_episodes) == (7000, 8000, 60)
    assert fall.last_value == pytest.approx(19 / 60)
    assert "the success rate of its evaluations fell from 100% at 7,000 steps to 32%" in fall.text
    assert "since about 8,000 steps" in fall.text
    returns = find_decline(_evaluations(FALL), "mean_return")
    assert returns is not None
    assert returns.best_value > 190
    assert returns.last_value == pytest.approx(77)
    assert "the mean return of its evaluations fell from" in returns.text


@pytest.mark.parametrize("measure", ["success_rate", "mean_return"])
@pytest.mark.parametrize(
    "rates",
    [
        FALL[:7],
        [*FALL, 1.0],  # recovered
        [0.0] * 12,  # never learned
        [1.0] * 12,
        [0.2, 0.5, 0.9, 1.0, 0.9, 1.0, 0.9],
        [0.4],
        [],
        [1.0, 0.85],  # a single evaluation, and a small difference
    ],
)
def test_a_training_that_rises_recovers_or_never_learned_is_not_named(rates, measure):
    assert find_decline(_evaluations(rates), measure) is None


def test_the_last_evaluation_alone_is_enough_for_a_large_fall():
    fall = find_decline(_evaluations([0.0, 0.6, 1.0, 0.2]), "success_rate")
    assert fall is not None
    assert (fall.best_steps, fall.last_value) == (3000, 0.2)


def test_two_evaluations_are_few_also_where_they_are_the_last_quarter():
    assert find_decline(_evaluations([0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.85, 0.85]), "success_rate") is None
    assert find_decline(_evaluations([0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.3, 0.3]), "success_rate") is not None


def test_a_harder_stage_of_the_curriculum_is_not_a_fall():
    easy = _evaluations([0.9, 1.0, 1.0, 1.0], stage="easy")
    hard = _evaluations([0.1, 0.2, 0.2, 0.3], stage="hard", every=10_000)
    assert find_decline([*easy, *hard], "success_rate") is None
    fallen = _evaluations([0.1, 0.9, 1.0, 1.0, 0.1, 0.0], stage="hard", every=10_000)
    fall = find_decline([*easy, *fallen], "success_rate")
    assert fall is not None
    assert fall.best_steps == 40_000


def test_small_differences_between_nearly_perfect_returns_are_not_a_fall():
    evaluations = _evaluations([0.0, 1.0, 1.0, 1.0, 1.0])
    for number, each in enumerate(evaluations[1:]):
        each["returns"] = [200.0 - 0.3 * number] * 20
    assert find_decline(evaluations, "mean_return") is None


def _healthy(shape: str, count: int, random: np.random.Generator) -> np.ndarray:
    """The true success rates of a policy that learns, or stays as it is."""
    share = np.linspace(0, 1, count)
    match shape:
        case "steady":
            return np.full(count, random.uniform(0.2, 1.0))
        case "rising":
            return np.clip(random.uniform(0, 0.3) + share * random.uniform(0.3, 1.0), 0, 1)
        case _:
            return random.uniform(0.6, 1.0) * (1 - np.exp(-share * random.uniform(3, 20)))


def _drawn(rates, kind: str, random: np.random.Generator):
    evaluations = _evaluations(rates)
    for each, rate in zip(evaluations, rates, strict=True):
        won = random.random(20) < rate
        returns = {
            "two values": np.where(won, 200.0, 20.0),
            "a long tail": np.where(won, 200.0, random.exponential(60, 20).clip(0, 199)),
            "normal": 100 * rate + random.normal(0, 20, 20),
        }
        each |= {"returns": returns[kind].tolist(), "successes": won.astype(float).tolist()}
    return evaluations


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["two values", "a long tail", "normal"])
@pytest.mark.parametrize("shape", few(["steady", "rising", "leveling"], ["leveling"]))
def test_healthy_trainings_raise_a_false_alarm_in_at_most_two_percent(shape, kind):
    random = np.random.default_rng(7)
    count = 150
    alarms = {"success_rate": 0, "mean_return": 0}
    for number in range(count):
        evaluations = _drawn(_healthy(shape, (4, 10, 30)[number % 3], random), kind, random)
        for measure in alarms:
            alarms[measure] += find_decline(evaluations, measure) is not None
    assert max(alarms.values()) <= 0.02 * count, alarms


@pytest.mark.parametrize("share", [0.5, 0.7, 0.9])
def test_starts_that_always_fail_raise_no_alarm(share):
    """With a test for independent episodes, 4 to 9 % of such trainings "got worse"."""
    random = np.random.default_rng(3)
    alarms = 0
    for _ in range(150):
        rate = random.uniform(0.3, 0.95)
        is_hard = random.random(20) < share
        fixed = random.random(20) < rate
        evaluations = _evaluations([rate] * 30)
        for each in evaluations:
            each["successes"] = np.where(is_hard, fixed, random.random(20) < rate).astype(float).tolist()
        alarms += find_decline(evaluations, "success_rate") is not None
    assert alarms <= 3


@pytest.mark.parametrize("shift", [0.0, 0.5, 1.5, 3.0])
def test_the_test_is_students_of_the_differences(shift):
    random = np.random.default_rng(1)
    better, worse = random.normal(shift, 1, 20), random.normal(0, 2, 20)
    differences = better - worse
    expected = stats.ttest_1samp([*differences, -np.abs(differences).max()], 0, alternative="greater").pvalue
    assert paired(better.tolist(), worse.tolist()) == pytest.approx(expected, rel=0.02, abs=1e-9)
    assert paired([1.0] * 20, [0.0] * 20) < 1e-6
    assert paired([1.0], [0.0]) == paired([1.0] * 20, [1.0] * 20) == 1.0


def test_damaged_evaluations_are_refused_in_a_sentence(tmp_path):
    (tmp_path / "evaluations").mkdir()
    path = tmp_path / "evaluations" / "training.jsonl"
    line = json.dumps(_evaluations([0.5])[0])
    path.write_text(f"{line}\n{line[:20]}")
    assert len(read_evaluations(tmp_path)) == 1  # half a line is still being written
    for damaged in (
        "{",
        '{"steps": -1, "returns": [1], "successes": [1]}',
        '{"steps": 1, "returns": [], "successes": []}',
        "[]",
    ):
        path.write_text(f"{damaged}\n")
        with pytest.raises(RunError, match="is damaged"):
            read_evaluations(tmp_path)
