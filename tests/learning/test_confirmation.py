"""When a training ends, and which model and evaluation it is judged by.

* The chances of a training that stops because a confirmation shows that its task is solved: simulated, and
  against closed forms.
* A training is said to fall apart after a fall of its evaluations, and hardly ever while it is healthy.
* Held-out episodes during a training: which model is kept as the best, and when a solved task ends the
  training.
* Which evaluation of a run is quoted, and whether the run is solved.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest
import stand_in
import torch
from scipy import stats
from scipy.stats import binom
from stand_in import hyper

from deepbots_cli.cli.records import evaluation_text, interval_text, scores
from deepbots_cli.engine_kinds import PHYSICS
from deepbots_cli.errors import RunError
from deepbots_cli.learning import (
    TrainingResult,
    callbacks,
    evaluate,
    evaluate_trained,
    learner,
    resume,
    train,
)
from deepbots_cli.learning.campaigns.listing import read_listed
from deepbots_cli.learning.environments import (
    EVALUATION_EPISODES,
    Evaluator,
    evaluation_seeds,
    six_digits,
)
from deepbots_cli.learning.executor import Interruption
from deepbots_cli.learning.report import Reporter
from deepbots_cli.learning.runs.episodes import read_evaluations
from deepbots_cli.learning.runs.order import Candidate, Shortlist
from deepbots_cli.learning.runs.run import PATIENCE, ModelRef, Run, RunRecord, steps_of
from deepbots_cli.learning.runs.statistics import (
    COST_SHARE,
    FALSE_STOPS,
    MARGIN,
    PART,
    Confirmation,
    error_level,
    may_begin,
    required_successes,
)
from deepbots_cli.learning.runs.verdict import (
    find_decline,
    last_episodes,
    paired,
    quoted_episodes,
    quoted_evaluation,
    run_verdict,
)
from deepbots_cli.program import Program
from deepbots_cli.program.task import Solved, Training
from deepbots_cli.rollout import Episode, Start
from tests.commands import Deepbots
from tests.few import few

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


def trained_once(
    generator: np.random.Generator, solved: Solved, values: Sequence[float], draw: Draw
) -> Outcome:
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
        while len(done) < plan.episodes and not (plan.is_lost(done) or plan.passes(done)):
            done += draw(generator, value, len(plan.next_part(len(done))))
        if plan.passes(done):
            return Outcome(value, failed, failed / steps)
        number, failed = number + 1, failed + len(done)
    return Outcome(None, failed, failed / steps)


def simulate(
    solved: Solved, values: Sequence[float], draw: Draw, repetitions: int, seed: int
) -> list[Outcome]:
    generator = np.random.default_rng(seed)
    return [trained_once(generator, solved, values, draw) for _ in range(repetitions)]


def stops(outcomes: Sequence[Outcome], below: float = math.inf) -> float:
    """The share of trainings that stopped with a policy of at most this value."""
    return float(np.mean([each.stopped_with is not None and each.stopped_with <= below for each in outcomes]))


def test_the_first_confirmations_of_90_percent_need_95_of_100_then_142_and_143_of_150() -> None:
    plans = [Confirmation.plan(RATE, number, BOUNDS) for number in (1, 2, 3)]
    assert [(plan.successes, plan.episodes) for plan in plans if plan is not None] == [
        (95, 100),
        (142, 150),
        (143, 150),
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


def test_equal_returns_pass_after_the_episodes_that_bets_of_a_fixed_share_need() -> None:
    # Each bet of 0.75 / 191 of the capital gains 9 on a return of 200 where 191 is too weak; 40 is enough.
    plan = Confirmation.plan(RETURN, 1, BOUNDS)
    assert plan is not None
    enough = 1 + math.ceil(math.log(40) / math.log1p(9 * 0.75 / 191))
    best = [Episode(200.0, 1, False, None)] * plan.episodes
    assert [plan.passes(best[:count]) for count in (enough - 1, enough)] == [False, True]
    assert (enough, plan.episodes) == (108, 216)


@pytest.mark.parametrize(
    ("criterion", "episodes"), [(Solved(2, success_rate=1.0), 183), (Solved(20, success_rate=0.9), 90)]
)
def test_a_criterion_of_few_episodes_is_confirmed_with_more(criterion: Solved, episodes: int) -> None:
    plan = Confirmation.plan(criterion, 1, BOUNDS)
    assert plan is not None
    assert plan.episodes == episodes


@pytest.mark.parametrize("number", [1, 3, 8])
@pytest.mark.parametrize("required", [0.5, 0.9, 0.99])
def test_rare_failures_that_a_sample_lacks_do_not_confirm_a_mean_return(required: float, number: int) -> None:
    generator = np.random.default_rng(number)
    plan = Confirmation.plan(Solved(100, mean_return=required), number, (0.0, 1.0))
    assert plan is not None
    for high in (
        required,
        (1 + required) / 2,
        1.0,
    ):  # an episode returns this value or 0, too little in the mean
        passed = 0
        for won in generator.random((150, plan.episodes)) < (required - MARGIN) / high:
            episodes = [Episode(high * float(good), 1, False, None) for good in won]
            passed += any(plan.passes(episodes[:count]) for count in range(100, plan.episodes + 1, 8))
        assert binom.sf(passed - 1, 150, error_level(number)) > 1e-4


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


SEED = 0
EVALUATION = evaluation_seeds(SEED, range(EVALUATION_EPISODES))
NEW_STARTS = evaluation_seeds(SEED, range(EVALUATION_EPISODES, 200))
CONFIRMATIONS = {
    Start.of_evaluation(six_digits(SEED, "confirmation", number), start).seed: number
    for number in range(1, 30)
    for start in range(400)
}
SUCCESS = Solved(20, success_rate=0.9)
LOW_RETURN = Solved(20, mean_return=5.0)
Score = Callable[[int], tuple[float, bool]]
"""The reward of a step, and whether the episode is a success, by the number of the evaluation, of the
confirmation, or of the candidate in the last choice, each from 0."""


def poor(number: int) -> tuple[float, bool]:
    return 0.0, False


def good(number: int) -> tuple[float, bool]:
    return 1.0, True


class Worlds:
    """Builds worlds whose held-out episodes have the given scores; training episodes pay 1 and succeed."""

    def __init__(self, evaluation: Score, confirmation: Score = poor, choice: Score = poor) -> None:
        self.evaluation, self.confirmation, self.choice = evaluation, confirmation, choice
        self.seeds: list[int] = []
        """Of all resets, in their order."""
        self.open = 0

    def __call__(self, program: Program, *, render_mode: str | None = None) -> Scored:
        self.open += 1
        return Scored(program, self, render_mode)

    def count(self, seed: int) -> int:
        return self.seeds.count(seed)

    @property
    def evaluations(self) -> int:
        return self.count(EVALUATION[0])

    def score(self, seed: int | None) -> tuple[float, bool]:
        """The score of the running episode, which began from `seed`."""
        if seed in EVALUATION:
            return self.evaluation(self.evaluations - 1)
        if seed in CONFIRMATIONS:
            return self.confirmation(CONFIRMATIONS[seed] - 1)
        if seed in NEW_STARTS:
            return self.choice(self.count(seed) - 1)
        return 1.0, True


class Scored(stand_in.CartPole):
    def __init__(self, program: Program, worlds: Worlds, render_mode: str | None = None) -> None:
        super().__init__(program, render_mode)
        self.worlds = worlds
        self.seed: int | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        self.seed = seed
        if seed is not None:
            self.worlds.seeds.append(seed)
        return super().reset(seed=seed, options=options)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        observation, _, terminated, truncated, info = super().step(action)
        reward, success = self.worlds.score(self.seed)
        return observation, reward, terminated, truncated, {**info, "is_success": success}

    def close(self) -> None:
        self.worlds.open -= not self.closed
        super().close()


class Notes(Reporter):
    """Keeps the notes of a training, and its activities beside learning."""

    def __init__(self) -> None:
        self.notes: list[str] = []
        self.activities: list[str] = []

    def note(self, text: str) -> None:
        self.notes.append(text)

    def update(self, progress: Any) -> None:
        if progress.activity:
            self.activities.append(progress.activity.text)


def learned(
    folder: Path,
    build: Any,
    total: int = 300,
    solved: Solved | None = SUCCESS,
    n_steps: int = 32,
    batch_size: int = 32,
    **options: Any,
) -> TrainingResult:
    task = stand_in.compiled(
        training=Training("PPO", total, 2, hyper(n_steps=n_steps, batch_size=batch_size, n_epochs=1)),
        solved=solved,
        success=True,
        max_steps=6,
    )
    return train(task, runs=folder, seed=SEED, build=build, **options)


def model_steps(result: TrainingResult, model: str) -> int:
    return steps_of(result.run / "models" / "agent" / f"{model}.zip")


def evaluated_steps(result: TrainingResult) -> list[int]:
    lines = (result.run / "evaluations" / "training.jsonl").read_text().splitlines()
    return [json.loads(line)["steps"] for line in lines]


@pytest.fixture(scope="module")
def unpaid(tmp_path_factory: pytest.TempPathFactory) -> tuple[Worlds, TrainingResult]:
    """A training whose held-out episodes all have a return of 0; not to be changed."""
    build = Worlds(poor)
    return build, learned(tmp_path_factory.mktemp("unpaid"), build)


# The order of policies
def test_the_policy_that_is_kept_succeeds_although_another_one_has_a_higher_return(tmp_path: Path) -> None:
    build = Worlds(
        lambda number: (9.0, False) if number == 0 else (0.1, number == 1),
        choice=lambda number: (0.1, number == 0),
    )
    result = learned(tmp_path, build, total=1_200)
    first, second, *_ = evaluated_steps(result)
    assert first < second < result.steps
    assert result.best is not None
    assert (result.best.steps, model_steps(result, "best")) == (second, second)
    assert result.best.measure == "success_rate"
    assert run_verdict(result.run, RunRecord.read(result.run)).solved is None  # it was not evaluated yet


def test_where_solved_asks_for_a_return_the_higher_return_is_kept(tmp_path: Path) -> None:
    build = Worlds(
        lambda number: (0.09, False) if number == 0 else (0.01, True), choice=lambda number: (0.01, False)
    )
    result = learned(tmp_path, build, total=1_000, solved=Solved(20, mean_return=40.0))
    assert result.best is not None
    assert (result.best.measure, result.best.steps) == ("mean_return", evaluated_steps(result)[0])


def test_of_equal_evaluations_the_later_model_is_kept(unpaid: tuple[Worlds, TrainingResult]) -> None:
    _, result = unpaid
    assert model_steps(result, "best") == model_steps(result, "last")


@pytest.mark.slow
def test_the_best_of_many_small_evaluations_is_chosen_again_on_new_starts(tmp_path: Path) -> None:
    # The first evaluation is the best by luck; on new starts only the model of the third one succeeds.
    build = Worlds(lambda number: (1.0, number < 3), choice=lambda number: (1.0, number == 0))
    notes = Notes()
    result = learned(tmp_path, build, total=2_400, solved=None, progress=notes)
    *_, third = evaluated_steps(result)[:3]
    assert result.best is not None
    assert result.best.chosen_by == "new starts"
    assert result.best.steps == third  # of equals it was the first to play
    assert result.best.episodes is not None
    assert (
        result.best.episodes % EVALUATION_EPISODES == 0
    )  # the evaluation that put it forward is not among them
    assert result.best.success_rate == 1.0
    assert any(f"that of {third:,} steps is the best on new starts" in note for note in notes.notes)
    assert any(" models on new starts: 0 of at most " in activity for activity in notes.activities)
    # The printed result comes from starts that did not choose the model.
    chosen = {seed for seed in build.seeds if seed in NEW_STARTS}
    before = len(build.seeds)
    evaluate(result.run, episodes=20, build=build)
    assert chosen
    assert not set(build.seeds[before:]) & {*chosen, *EVALUATION}


@pytest.mark.slow
def test_candidates_are_models_that_can_be_named(tmp_path: Path) -> None:
    result = learned(tmp_path, Worlds(lambda number: (float(number), False)), total=1_600, solved=None)
    files = sorted((result.run / "models" / "agent").glob("candidate-*.zip"))
    assert 2 <= len(files) <= 5
    assert model_steps(result, files[0].stem) == int(files[0].stem.removeprefix("candidate-"))


# When a training stops
def test_successes_of_training_episodes_do_not_solve_a_task(unpaid: tuple[Worlds, TrainingResult]) -> None:
    build, result = unpaid
    assert result.success_rate == 1.0
    assert result.solved_at is None
    assert result.status == "finished"
    assert result.steps >= 300
    assert not set(build.seeds) & set(CONFIRMATIONS)


def test_a_lucky_evaluation_does_not_stop_a_training(tmp_path: Path) -> None:
    notes = Notes()
    result = learned(tmp_path, Worlds(good, confirmation=poor), total=1_000, progress=notes)
    assert result.status == "finished"
    assert result.steps >= 1_000
    assert result.solved_at is None
    assert result.confirmations >= 1
    assert notes.activities[0].startswith("confirming on ")
    assert ": 0 played, needs " in notes.activities[0]
    assert any("not confirmed after" in note and "the training goes on" in note for note in notes.notes)


@pytest.mark.parametrize("solved", [SUCCESS, pytest.param(LOW_RETURN, marks=pytest.mark.slow)])
def test_training_and_final_verdict_are_one_verdict(tmp_path: Path, solved: Solved) -> None:
    build = Worlds(
        lambda number: (1.0, number >= 1) if solved is SUCCESS else (float(number >= 1), False),
        confirmation=good,
    )
    result = learned(tmp_path, build, total=100_000, solved=solved)
    assert build.evaluations == 2
    assert result.steps < 6_000
    assert result.solved_at is not None
    assert result.solved_at.steps == result.steps == model_steps(result, "best")
    run = Run.open(result.run)
    verdict = run_verdict(result.run, run.record)
    assert verdict.solved is True
    assert verdict.evaluation is not None
    assert verdict.evaluation.confirmation == 1
    assert verdict.evaluation.episodes >= solved.episodes
    # The evaluation after the training and `deepbots eval` are these episodes, not other ones.
    trained = evaluate_trained(run)
    again = evaluate(run, episodes=verdict.evaluation.episodes, build=build)
    assert [each.total_return for each in trained.outcomes] == [each.total_return for each in again.outcomes]
    assert trained.seed == again.seed == result.confirmed_seed == six_digits(SEED, "confirmation", 1)
    assert result.best is not None
    assert result.best.chosen_by == "confirmation"


@pytest.mark.slow
@pytest.mark.parametrize(("successes", "confirmations"), [({1, 3, 5}, 0), ({1, 2}, 1)])
def test_a_single_lucky_evaluation_of_an_off_policy_training_begins_no_confirmation(
    tmp_path: Path, successes: set[int], confirmations: int
) -> None:
    build = Worlds(lambda number: (1.0, number in successes))
    training = Training("DQN", 600, 1, hyper(learning_starts=10, train_freq=100, batch_size=8))
    result = train(
        stand_in.compiled(training=training, solved=SUCCESS, success=True, max_steps=50),
        runs=tmp_path,
        seed=SEED,
        build=build,
    )
    assert build.evaluations > 2
    assert result.confirmations == confirmations


@pytest.mark.slow
def test_each_confirmation_has_new_starts_and_failed_ones_take_a_tenth_of_the_steps(tmp_path: Path) -> None:
    build = Worlds(good, confirmation=poor)
    result = learned(tmp_path, build, total=3_000)
    begun = [CONFIRMATIONS[seed] for seed in build.seeds if seed in CONFIRMATIONS]
    assert set(begun) == set(range(1, result.confirmations + 1))
    assert result.confirmations >= 2
    confirmed_from = [seed for seed in build.seeds if seed in CONFIRMATIONS]
    assert len(confirmed_from) == len(set(confirmed_from))
    last = PART  # episodes of a confirmation that fails at once
    shortest = 6  # steps of an episode
    assert shortest * (len(begun) - last) <= COST_SHARE * result.steps


def test_a_training_that_does_not_stop_when_solved_notes_it_once(tmp_path: Path) -> None:
    result = learned(
        tmp_path, Worlds(good, confirmation=good, choice=good), total=1_000, stop_when_solved=False
    )
    assert result.steps >= 1_000
    assert result.solved_at is not None
    assert result.solved_at.steps < result.steps
    assert result.confirmations == 1
    assert result.confirmed_seed is None


@pytest.mark.slow
def test_a_training_resumed_after_a_solved_task_evaluates_again_and_keeps_a_better_model(
    tmp_path: Path,
) -> None:
    build = Worlds(
        lambda number: (1.0 + number, True), confirmation=good, choice=lambda number: (1.0, number == 0)
    )
    result = learned(tmp_path, build, total=2_500)
    assert result.confirmed_seed is not None
    before = evaluated_steps(result)
    again = resume(result.run, total_timesteps=2_500, build=build)
    after = evaluated_steps(again)
    assert after[: len(before)] == before
    assert len(after) > len(before)
    assert again.best is not None
    assert again.best.steps is not None
    assert again.best.steps > result.steps
    assert model_steps(again, "best") == again.best.steps
    assert again.confirmed_seed is None  # no confirmation ended it, so its verdict comes from an evaluation


@pytest.mark.parametrize("score", [poor, lambda number: (1.0, number == 0)])
def test_a_training_whose_evaluations_get_no_better_ends_after_its_patience(
    tmp_path: Path, score: Score
) -> None:
    notes = Notes()
    training = Training("PPO", 6_000, 2, hyper(n_steps=32), patience=1_000)
    task = stand_in.compiled(training=training, solved=SUCCESS, success=True, max_steps=6)
    result = train(task, runs=tmp_path, build=Worlds(score, choice=poor), progress=notes)
    assert result.stopped_by == PATIENCE
    assert 1_000 <= result.steps < 5_000
    assert any("`patience: 1000`" in note for note in notes.notes)


def test_a_training_whose_task_is_solved_has_not_lost_its_patience(tmp_path: Path) -> None:
    # Equal evaluations are no better.
    training = Training("DQN", 6_000, 1, hyper(learning_starts=10, train_freq=100, batch_size=8), patience=1)
    task = stand_in.compiled(training=training, solved=SUCCESS, success=True, max_steps=50)
    result = train(task, runs=tmp_path, build=Worlds(good, confirmation=good, choice=good))
    assert (result.confirmed_seed is not None, result.stopped_by) == (True, None)


def test_a_training_ends_after_the_evaluation_at_which_it_is_stopped(tmp_path: Path) -> None:
    build = Worlds(poor)
    result = learned(
        tmp_path, build, on_evaluation=lambda run: "somebody" if run.parent == tmp_path else None
    )
    assert (result.status, result.stopped_by, build.evaluations) == ("finished", "somebody", 1)
    assert result.steps < 600


def test_evaluations_start_where_neither_training_nor_evaluation_does(
    unpaid: tuple[Worlds, TrainingResult],
) -> None:
    build, result = unpaid
    assert set(EVALUATION) <= set(build.seeds)
    before = len(build.seeds)
    evaluate(result.run, episodes=30, build=build)
    assert not set(EVALUATION) & set(build.seeds[before:])
    assert build.open == 0


def test_what_is_learned_does_not_depend_on_the_evaluations(
    unpaid: tuple[Worlds, TrainingResult], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, few = unpaid
    monkeypatch.setattr(callbacks, "URGENT_SHARE", 2.0)
    many = learned(tmp_path, Worlds(poor))
    assert many.evaluation_steps > few.evaluation_steps
    assert many.weights_digest == few.weights_digest


def test_an_evaluation_stops_when_somebody_wants_the_training_to_end() -> None:
    task = stand_in.scenario(max_steps=50)
    world = stand_in.build(task)
    assert task.agent.training is not None
    policy = learner.create(learner.Setup(task.agent.training, world.observation_space, world.action_space))
    evaluator = Evaluator(stand_in.build, seed=0)
    interruption = Interruption()
    state = torch.get_rng_state()
    first, second = (evaluator.evaluate(policy, task, interruption) for _ in range(2))
    assert first == second  # the same starts each time
    assert len(first) == EVALUATION_EPISODES
    assert torch.equal(torch.get_rng_state(), state)
    interruption.requested = True
    with pytest.raises(KeyboardInterrupt):
        evaluator.evaluate(policy, task, interruption)
    evaluator.close()


SOLVED_AT = {
    "episode": 3,
    "steps": 90,
    "simulated_hours": 0.1,
    "cpu_seconds": 1.0,
    "mean_return": 200.0,
    "success_rate": 0.0,
}


def test_a_quick_evaluation_does_not_replace_the_one_with_the_most_episodes(run_copy: Path) -> None:
    run = Run.open(run_copy)
    long, quick = (evaluate(run, episodes=count, build=stand_in.build) for count in (12, 3))
    run.write_evaluation(long.model_dump(mode="json"))
    quick_path = run.write_evaluation(quick.model_dump(mode="json"))
    quoted = quoted_episodes(run)
    last = last_episodes(ModelRef(run))
    assert quoted is not None
    assert last is not None
    assert (len(quoted.outcomes), last[0]) == (12, quick_path)
    assert run_verdict(run_copy, run.record).text.startswith(quoted.text)
    latest = run.write_evaluation(long.model_dump(mode="json"))
    assert quoted_evaluation(run_copy, run.record).number == int(latest.stem)  # type: ignore[union-attr]


def test_a_run_quotes_another_evaluation_where_the_file_of_the_quoted_one_was_removed(run_copy: Path) -> None:
    run = Run.open(run_copy)
    long, quick = (evaluate(run, episodes=count, build=stand_in.build) for count in (12, 3))
    path = run.write_evaluation(long.model_dump(mode="json"))
    run.write_evaluation(quick.model_dump(mode="json"))
    path.unlink()
    assert read_listed(run_copy).evaluated_episodes == 3


def test_a_run_of_other_physics_says_so_where_it_is_evaluated(run_copy: Path) -> None:
    record = json.loads((run_copy / "run.json").read_text()) | {"physics": PHYSICS + 1}
    (run_copy / "run.json").write_text(json.dumps(record))
    (note,) = evaluate(run_copy, episodes=3, build=stand_in.build).notes
    assert f"was trained with physics {PHYSICS + 1} of deepbots, and this version simulates" in note
    assert Run.open(run_copy).notes_on_physics() == [note]


def test_an_edited_criterion_does_not_make_a_run_solved(run_copy: Path) -> None:
    resolved = run_copy / "resolved.yaml"
    resolved.write_text(resolved.read_text().replace("mean_return >= 195", "mean_return >= 1"))
    run = Run.open(run_copy)
    assert run.digest != run.record.digest
    evaluation = evaluate(run, episodes=12, build=stand_in.build)
    assert evaluation.solved is True
    assert evaluation.verdict.endswith("(scenario changed since the training)")
    run.write_evaluation(evaluation.model_dump(mode="json"))
    listed = read_listed(run_copy)
    assert listed.solved is None
    assert listed.remarks == ("scenario changed since the training",)
    # One of the scenario of the training is quoted in its place, however few its episodes.
    few = evaluate(run, episodes=3, build=stand_in.build)
    run.write_evaluation(few.model_copy(update={"digest": run.record.digest}).model_dump(mode="json"))
    assert read_listed(run_copy).evaluated_episodes == 3


@pytest.mark.parametrize(
    "where",
    [
        {"stage": "easy"},
        {"case": "easy"},
        {"set": ["solved=mean_return >= 1 over 9 episodes"]},
        {"elsewhere": "easy.yaml"},
    ],
)
def test_an_evaluation_of_an_easy_stage_or_another_scenario_does_not_make_a_run_solved(
    run_copy: Path, where: dict[str, object]
) -> None:
    run = Run.open(run_copy)
    evaluation = evaluate(run, episodes=12, build=stand_in.build).model_dump(mode="json")
    run.write_evaluation(evaluation | where | {"solved": True, "episodes": 999})
    assert run_verdict(run_copy, run.record).solved is None
    assert quoted_evaluation(run_copy, run.record) is None


def test_an_evaluation_that_a_requirement_stopped_says_so(run_copy: Path) -> None:
    run = Run.open(run_copy)
    evaluation = evaluate(run, episodes=12, build=stand_in.build, until=lambda episodes: len(episodes) == 8)
    run.write_evaluation(evaluation.model_dump(mode="json"))
    assert (evaluation.episodes, evaluation.planned) == (8, 12)
    assert "(stopped by a requirement after 8 of 12 episodes)" in evaluation.verdict
    assert "(stopped by a requirement after 8 of 12 episodes)" in run_verdict(run_copy, run.record).text


def test_training_episodes_make_no_run_solved(run_copy: Path) -> None:
    run = Run.open(run_copy)
    run.write_evaluation(evaluate(run, episodes=3, build=stand_in.build).model_dump(mode="json"))
    record = json.loads((run_copy / "run.json").read_text())
    record["result"]["solved_at"] = SOLVED_AT
    (run_copy / "run.json").write_text(json.dumps(record))
    verdict = run_verdict(run_copy, Run.open(run_copy).record)
    assert verdict.solved is None
    assert verdict.text.endswith("(fewer than 10 episodes)")


def test_a_run_that_is_not_solved_is_not_listed_with_the_steps_until_it_was(run_copy: Path) -> None:
    run = Run.open(run_copy)
    evaluated = evaluate(run, episodes=12, build=stand_in.build)
    run.write_evaluation(evaluated.model_copy(update={"solved": True}).model_dump(mode="json"))
    record = json.loads((run_copy / "run.json").read_text())
    record["result"] |= {"solved_at": SOLVED_AT, "confirmations": 1}
    (run_copy / "run.json").write_text(json.dumps(record))
    listed = read_listed(run_copy)
    assert listed.solved is True
    assert listed.solved_after == 90
    # An evaluation of more episodes says otherwise.
    run.write_evaluation(
        evaluated.model_copy(update={"episodes": 300, "solved": False}).model_dump(mode="json")
    )
    listed = read_listed(run_copy)
    assert listed.solved is False
    assert listed.solved_after is None


def test_equal_returns_are_not_shown_as_an_interval_around_them(run_copy: Path, deepbots: Deepbots) -> None:
    run = Run.open(run_copy)
    evaluation = evaluate(run, episodes=3, build=stand_in.build)
    same = {"mean_return": 0.0, "std_return": 0.0, "least_return": 0.0, "greatest_return": 0.0}
    equal = evaluation.model_copy(update=same | {"return_interval": (-155.8, 155.8)})
    text = evaluation_text(equal)
    assert "mean return         0.00 (95 %: -155.80 .. 155.80; all returns are equal)" in text
    assert scores(equal)["return_95 %"] == "all equal"
    run.write_evaluation(equal.model_dump(mode="json"))
    assert "155.8" not in deepbots("runs", run_copy).out
    assert run_verdict(run_copy, run.record).text.startswith("mean return 0 (95 % interval -155.8")
    assert interval_text((200.0, 200.0)) == "200"


def test_a_confirmed_model_stays_the_best_one_when_its_training_goes_on(tmp_path: Path) -> None:
    shortlist = Shortlist(SimpleNamespace(model=lambda name: tmp_path / f"{name}.zip"), "success_rate")
    for steps, rate, save in ((100, 1.0, shortlist.add), (200, 0.97, shortlist.put_first)):
        candidate = Candidate(steps=steps, episodes=20, success_rate=rate, mean_return=0.0)
        save(candidate, lambda path, name=str(steps): path.write_text(name))
    shortlist.restore(shortlist.candidates)
    assert (tmp_path / "best.zip").read_text() == "200"
    better = Candidate(steps=300, episodes=20, success_rate=0.98, mean_return=0.0)
    assert not shortlist.add(better, lambda path: path.write_text("300"))
    assert [candidate.steps for candidate in shortlist.candidates] == [200, 100, 300]
    assert (tmp_path / "best.zip").read_text() == "200"
