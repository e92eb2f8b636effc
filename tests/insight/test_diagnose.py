"""Diagnoses of trainings: planted causes come first, healthy trainings have none, and broken files are
refused in a sentence."""

from __future__ import annotations

import json
import re
import shutil
from contextlib import closing
from dataclasses import replace
from itertools import islice, pairwise
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from deepbots_cli import api
from deepbots_cli.cli import main
from deepbots_cli.errors import EvaluationError, RunError
from deepbots_cli.insight.diagnosis import CAUSES, diagnose
from deepbots_cli.insight.episode import ROWS, explain, explanation_json
from deepbots_cli.insight.stages import present_stage
from deepbots_cli.insight.statements import statements_about
from deepbots_cli.insight.trace import TraceRecorder, instrument_program, trace_episodes
from deepbots_cli.insight.training import read_training, run_probes
from deepbots_cli.learning import train
from deepbots_cli.learning.campaigns.group import GroupRecord
from deepbots_cli.learning.runs.directories import run_lock
from deepbots_cli.learning.runs.episodes import SolvedAt
from deepbots_cli.learning.runs.evaluations import EvaluationResult
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.learning.runs.verdict import RunVerdict, quoted_episodes
from deepbots_cli.rollout import Episode
from tests.insight.broken import BROKEN, all_causes
from tests.insight.logs import causes_of, evaluations_with, outcomes, returns_of, train_shuttle, with_logs

DOCS = Path(__file__).parents[2] / "docs" / "diagnose.md"
SEED = 1


def test_logs_alone_name_some_causes(short):
    noise = np.random.default_rng(0).normal(0, 3, 200)
    assert causes_of(with_logs(short, -30 + noise, 30 - noise))[0] == "ending_early_pays"
    assert causes_of(with_logs(short, np.full(50, 3.0)))[0] == "ending_at_once"
    assert causes_of(with_logs(short, 30 + np.arange(200) / 4 + noise))[0] == "too_few_steps"
    leveled = diagnose(with_logs(short, 100 - 70 * np.exp(-np.arange(200) / 40) + noise))
    assert not any("still learns" in cause.text for cause in leveled)
    # 1 % of the planned timesteps: later episodes may end in other ways, or succeed
    assert [cause.text.partition(".")[0] for cause in diagnose(with_logs(short, 30 + noise))] == [
        "The training is short"
    ]
    assert "exploration_collapsed" in causes_of(
        with_logs(short, 30 + noise, train__entropy_loss=[-0.6] * 4 + [-0.001] * 10)
    )


def test_a_rise_that_is_far_from_its_goal_is_not_advised_to_go_on(short):
    noise = np.random.default_rng(0).normal(0, 0.1, 200)
    (cause,) = diagnose(with_logs(short, 30 + np.arange(200) / 400 + noise))
    assert cause.cause == "too_few_steps"
    assert cause.text.startswith("The policy learns too slowly: ")
    assert "At this rate, 195 is about 2,200,000 steps away" in cause.text
    assert cause.advice.startswith("Change something before you train longer: ")
    assert "resume" not in cause.command
    assert "train.total_timesteps" not in cause.settings


@pytest.fixture(scope="session")
def aiming(tmp_path_factory) -> Path:
    """A training of all its timesteps in a task with a success; not to be changed."""
    sets = [
        "termination.success={there: x > 0.3 m}",
        "reward.there=300 when there",
        "train.total_timesteps=512",
    ]
    compiled = api.compile(api.load("cartpole", overrides=sets))
    return train(compiled, total_timesteps=512, seed=2, run=tmp_path_factory.mktemp("runs") / "aiming").run


def test_the_term_that_pays_a_local_optimum_is_named(aiming):
    returns = 100 - 70 * np.exp(-np.arange(200) / 20) + np.random.default_rng(0).normal(0, 3, 200)
    first = diagnose(with_logs(aiming, returns, np.full(200, 100), reward__alive=returns))[0]
    assert (first.cause, first.evidence["term"], first.evidence["term_share"]) == (
        "success_never_seen",
        "alive",
        1.0,
    )
    assert "'alive' gives 100% of the positive reward of late episodes" in first.text
    assert "a reward term for progress" not in first.advice
    assert "path_distance" in first.advice


def test_a_training_without_a_success_is_not_first_advised_to_continue(aiming):
    rising = 30 + np.arange(200) / 4 + np.random.default_rng(0).normal(0, 3, 200)
    causes = causes_of(with_logs(aiming, rising, np.full(200, 100), reward__alive=rising))
    assert causes.index("success_never_seen") < causes.index("too_few_steps")


def test_a_policy_that_succeeds_in_a_later_evaluation_is_not_advised_to_continue(aiming):
    training = with_logs(aiming, 30 + np.arange(200) / 4, np.full(200, 100))

    def evaluated(mean_return: float) -> list:
        last = {"returns": [mean_return] * 30, "successes": [True] * 29 + [False]}
        return diagnose(replace(training, all_evaluations=[last]))

    first = evaluated(100.0)[0]
    assert first.cause == "exploration_hides_success"
    assert "in 97% (83% to 99%) of 30 episodes" in first.text
    assert evaluated(300.0) == []  # which solves the task


def test_an_evaluation_of_a_run_is_read(aiming, tmp_path):
    run = shutil.copytree(aiming, tmp_path / "run")
    assert (
        main(["eval", str(run), "--episodes", "9"]),
        len(read_training(Run.open(run)).final_episodes),
    ) == (0, 9)


def test_steps_beyond_the_plan_read_sensibly(short):
    training = with_logs(short, 30 + np.arange(200) / 4 + np.random.default_rng(0).normal(0, 3, 200))
    (statement,) = [cause for cause in diagnose(training) if cause.cause == "too_few_steps"]
    assert "10,984 steps in 200 episodes; the scenario sets 100,000" in statement.text


STAGES = (
    "[{name: wide, set: {near: 6 cm}, until: success_rate >= 80 % over 40 episodes}, {name: exact, set:"
    " {near: 1 mm}}]"
)


@pytest.fixture(scope="session")
def staged(tmp_path_factory) -> Path:
    """The same with a curriculum of two stages; not to be changed."""
    return train_shuttle(tmp_path_factory.mktemp("runs"), f"curriculum={STAGES}")


def test_evaluations_of_an_easy_stage_do_not_count_as_solved(staged):
    """Evaluations of stage `wide` must not count as solved."""
    good = outcomes(400, 0.7, 0.95)
    evaluations = evaluations_with(*[0.95] * 20, stage="wide")
    training = with_logs(
        staged, returns_of(good, 1), np.full(400, 60), success=good, stages="wide", evaluations=evaluations
    )
    assert not training.solved
    first = diagnose(training)[0]
    assert first.cause == "easy_stage_counted"
    assert "stage 'wide' (1 of 2)" in first.text
    assert "`until: success_rate >= 80 % in evaluation`" in first.advice
    text = statements_about((present_stage,), training)[0].text
    assert "is in stage 'wide' (1 of 2), which began at step 0 of 24,000" in text
    assert (
        "succeeds in 95% of the episodes in 2 evaluations" in text
    )  # of the same starts, so without an interval
    done = [Episode(1.0, 60, k < 6, "max_steps") for k in range(100)]
    (final,) = [
        each
        for each in diagnose(replace(training, final_episodes=done))
        if each.cause == "easy_stage_counted"
    ]
    assert "in the scenario itself in 6% (3% to 12%) of 100 episodes" in final.text


def test_returns_of_different_stages_are_not_compared(staged):
    """The second stage earns more, and nothing rises in it."""
    good = np.concatenate([outcomes(200, 0.5, 0.9), outcomes(400, 0.5, 0.5)])
    returns = returns_of(good, 0) + np.repeat([0.0, 10.0], [200, 400])
    stages = np.repeat(["wide", "exact"], [200, 400]).astype(object)
    training = with_logs(staged, returns, np.full(600, 60), success=good, stages=stages)
    assert (training.first_step, training.stage_steps) == (12_000, 24_000)
    assert set(causes_of(training)) & {"too_few_steps", "reward_apart_from_success"} == set()
    assert causes_of(training)[0] == "success_plateau"


def test_a_step_to_a_stage_that_is_too_hard_is_named_with_the_settings_that_change(staged):
    good = np.concatenate([outcomes(200, 0.5, 0.9), np.zeros(400)])
    stages = np.repeat(["wide", "exact"], [200, 400]).astype(object)
    first = diagnose(
        with_logs(staged, returns_of(good, 0, 1), np.full(600, 60), success=good, stages=stages)
    )[0]
    assert first.cause == "stage_too_hard"
    assert "near: 6 cm -> 1 mm" in first.advice


def test_a_stage_that_never_ends_is_named_with_the_value_that_it_reaches(staged):
    good = outcomes(400, 0.2, 0.5, 0.5, 0.5)
    first = diagnose(with_logs(staged, returns_of(good, 0), np.full(400, 60), success=good, stages="wide"))[0]
    assert first.cause == "stuck_in_stage"
    assert "the stage ends at 80%" in first.text
    assert "`until: success_rate >= 4" in first.advice
    rising = outcomes(400, 0, 0.1, 0.2, 0.75)
    assert "stuck_in_stage" not in causes_of(
        with_logs(staged, returns_of(rising, 0), np.full(400, 60), success=rising, stages="wide")
    )


def test_a_success_rate_that_is_flat_is_a_plateau_whatever_the_return_does(carriage):
    """More steps do not help."""
    good = outcomes(400, 0, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5)
    causes = causes_of(with_logs(carriage, returns_of(good, 0, 4), np.full(400, 60), success=good))
    assert causes[0] == "success_plateau"
    assert "too_few_steps" not in causes
    rising = outcomes(400, 0, 0.2, 0.4, 0.7)
    assert causes_of(with_logs(carriage, returns_of(rising, 0, 4), np.full(400, 60), success=rising)) == [
        "too_few_steps"
    ]


@pytest.mark.parametrize(
    ("rates", "expected"),
    [
        ((0.01, 0.06), "The policy still learns: the success rate rises from 3.1% "),
        ((0.05, 0.12), "The policy still learns: the success rate rises from "),
        ((0.5, 0.58), "The success rate may still rise: it was 53% "),
        ((0.3, 0.3), "The success rate no longer rises: it was 30% "),
        ((0.0, 0.6, 0.6, 0.6, 0.6), "The success rate no longer rises: it was 60% "),
        ((0.0, 0.6, 0.5, 0.4), "The success rate falls: it was 56% "),
    ],
)
def test_a_success_rate_that_rises_slowly_is_not_said_to_rise_no_longer(carriage, rates, expected):
    """In 1,700 episodes, whose successes are spread as evenly as their rate allows."""
    rate = np.interp(np.linspace(0, 1, 1700), np.linspace(0, 1, len(rates)), rates)
    good = np.diff(np.floor(np.cumsum(rate)), prepend=0.0)
    texts = [cause.text for cause in diagnose(with_logs(carriage, 5 * good, np.full(1700, 60), success=good))]
    assert any(text.startswith(expected) for text in texts), texts
    assert ("no longer rises" in expected) == any("no longer rises" in text for text in texts)


def test_the_starts_that_fail_are_named_with_the_value_that_they_draw(carriage):
    generator = np.random.default_rng(1)
    places, unrelated = generator.uniform(-1, 1, (2, 400))
    good = ((places > -0.5) & (generator.random(400) < 0.8)).astype(float)
    drawn = [json.dumps({"other": b, "reset.place.bar.y": a}) for a, b in zip(places, unrelated, strict=True)]
    first = diagnose(with_logs(carriage, returns_of(good, 0), np.full(400, 60), success=good, drawn=drawn))[0]
    assert (first.cause, first.evidence["drawn"]) == ("some_starts_fail", "reset.place.bar.y")
    worst = first.evidence["bins"][0]
    assert (worst["rate"], worst["interval"][0]) == (0.0, 0.0)
    assert worst["low"] < -0.9
    assert "(0% to " in first.text


def test_starts_that_fail_are_named_though_the_evaluations_succeed_in_four_of_five(carriage):
    """The scenario does not say what counts as solved."""
    places = np.random.default_rng(5).uniform(-1, 1, 400)
    good = (places > -0.5).astype(float)
    drawn = [json.dumps({"place": place}) for place in places]
    training = with_logs(
        carriage,
        returns_of(good, 0),
        np.full(400, 60),
        success=good,
        drawn=drawn,
        evaluations=evaluations_with(*[0.8] * 20),
    )
    assert causes_of(training) == ["some_starts_fail"]


def test_one_success_among_thousands_is_as_good_as_none(carriage):
    good = np.zeros(2706)
    good[1200] = 1
    first = diagnose(with_logs(carriage, returns_of(good, 0), np.full(2706, 60), success=good))[0]
    assert first.cause == "success_never_seen"
    assert "Only 1 of 2,706 episodes is a success" in first.text
    late = np.concatenate([np.zeros(380), np.tile([0.0, 1.0], 10)])  # success has just begun
    assert "success_never_seen" not in causes_of(
        with_logs(carriage, returns_of(late, 0, 2), np.full(400, 60), success=late)
    )


def test_advice_on_exploration_names_options_that_the_algorithm_has(staged, tmp_path):
    """PPO has no action noise, and its `ent_coef` is 0."""
    good = outcomes(400, 0.0, 0.05)
    logs = {
        "lengths": np.full(400, 60),
        "success": good,
        "stages": "wide",
        "evaluations": evaluations_with(*[1.0] * 20, stage="wide"),
    }
    first = diagnose(with_logs(staged, returns_of(good, 0), **logs))[0]
    assert first.cause == "exploration_hides_success"
    assert "with `in evaluation` in its `until`" in first.advice
    assert "ent_coef" not in first.advice
    assert "action_noise" not in first.advice
    weighted = train_shuttle(tmp_path, f"curriculum={STAGES}", "train.ent_coef=0.05")
    advised = diagnose(with_logs(weighted, returns_of(good, 0), **logs))[0]
    assert "lower `train.ent_coef` from 0.05 to 0.005" in advised.advice
    assert advised.settings == {"train.ent_coef": "0.005"}


@pytest.mark.slow
def test_action_noise_of_zero_is_raised_to_a_number_above_zero(tmp_path):
    silent = train_shuttle(
        tmp_path, "train={algorithm: TD3, total_timesteps: 24000, action_noise: {type: normal, sigma: 0}}"
    )
    collapsed = diagnose(with_logs(silent, returns_of(np.zeros(400), 0)))
    (statement,) = [each for each in collapsed if each.cause == "exploration_collapsed"]
    assert "aise `train.action_noise.sigma` from 0 to 0.3" in statement.advice
    assert statement.settings == {"train.action_noise.sigma": "0.3"}


def test_a_learning_rate_that_is_far_too_low_is_not_advised_to_continue(tmp_path):
    run = train_shuttle(tmp_path, "train.learning_rate=1e-5")
    flat = returns_of(np.zeros(400), 0)
    first = diagnose(with_logs(run, flat, np.full(400, 60), train__approx_kl=[1e-7] * 20))[0]
    assert (first.cause, first.settings) == ("learning_rate_too_low", {"train.learning_rate": "0.003"})
    assert "300 times lower than the usual 0.003" in first.text
    assert "learning_rate_too_low" not in causes_of(
        with_logs(run, flat, np.full(400, 60), train__approx_kl=[0.01] * 20)
    )
    rising = with_logs(run, returns_of(np.zeros(400), 0, 9), np.full(400, 60), train__approx_kl=[1e-7] * 20)
    assert "learning_rate_too_low" not in causes_of(rising)


def test_a_training_that_stopped_by_luck_is_continued_to_its_planned_steps(carriage):
    """Its episodes and an evaluation met `solved`, but 100 further episodes did not. Such a training needs a
    cause."""
    training = with_logs(carriage, returns_of(np.ones(400), 0), np.full(400, 60), success=1.0)
    record = training.run.record
    met = SolvedAt(
        episode=200, steps=12_000, simulated_hours=1.0, cpu_seconds=1.0, mean_return=4.0, success_rate=1.0
    )
    training.run.record = record.model_copy(
        update={
            "total_timesteps": 48_000,
            "result": record.result.model_copy(update={"solved_at": met, "steps": 24_000}),
        }
    )
    episodes = [Episode(4.0, 100, number < 87, None) for number in range(100)]
    evaluation = EvaluationResult.of_episodes(
        episodes, model="best", seed=0, success_defined=True, solved=False
    )
    (statement,) = diagnose(replace(training, verdict=RunVerdict(False, evaluation)))
    assert (statement.cause, statement.settings) == ("stopped_early", {"train.total_timesteps": "48_000"})
    assert statement.command == f"deepbots resume {carriage} --timesteps 48_000"
    assert "success rate 87.0% (95 % interval 79.0% .. 92.2%)" in statement.text
    assert diagnose(replace(training, verdict=RunVerdict(True, evaluation))) == []


def test_rewards_that_the_critic_cannot_follow_are_normalized(short):
    noise = np.random.default_rng(0).normal(0, 3, 200)
    training = with_logs(short, 30_000 + 1000 * noise, 30 + noise, train__explained_variance=[0.02] * 20)
    (statement,) = [each for each in diagnose(training) if each.cause == "rewards_too_large"]
    assert statement.settings == {"train.normalize": "reward"}
    assert "rewards_too_large" not in causes_of(
        with_logs(short, 30_000 + 1000 * noise, 30 + noise, train__explained_variance=[0.9] * 20)
    )
    assert "rewards_too_large" not in causes_of(
        with_logs(short, 30 + noise, 30 + noise, train__explained_variance=[0.02] * 20)
    )


def test_a_discount_factor_that_hides_the_success_is_raised_by_the_length_of_an_episode(tmp_path):
    flat = {"returns": returns_of(np.zeros(400), 0), "lengths": np.full(400, 60)}
    first = diagnose(with_logs(train_shuttle(tmp_path / "far", "train.gamma=0.4"), **flat))[0]
    assert first.cause == "horizon_too_short"
    assert first.settings == {"train.gamma": "0.95"}  # at most 60 steps: 0.95^60 is 5 %
    assert "horizon_too_short" not in causes_of(
        with_logs(train_shuttle(tmp_path / "near", "train.gamma=0.95"), **flat)
    )


def test_a_discount_factor_is_not_a_cause_where_no_reward_comes_late(tmp_path):
    half = outcomes(400, 0.5, 0.5)
    flat = {"returns": returns_of(half, 0), "lengths": np.full(400, 60), "success": half}
    late = train_shuttle(tmp_path / "late", "train.gamma=0.85")
    assert "horizon_too_short" in causes_of(with_logs(late, **flat))
    dense = train_shuttle(tmp_path / "dense", "train.gamma=0.85", "reward={near: exp(-abs(gap) / m)}")
    assert "horizon_too_short" not in causes_of(with_logs(dense, **flat))


def test_worlds_that_stay_at_the_lowest_level_are_named(tmp_path):
    levels = "curriculum={set: {mark: 0.1 .. 0.4 m}, levels: 4, up: parked, down: truncation}"
    run = train_shuttle(tmp_path, levels)
    logs = {"returns": returns_of(np.zeros(400), 0), "lengths": np.full(400, 60), "ending": "max_steps"}
    low = diagnose(with_logs(run, **logs, curriculum__mean_level=[1.0, 0.5, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0]))
    (statement,) = [each for each in low if each.cause == "levels_stay_lowest"]
    assert "in level 0 of 0 to 3" in statement.text
    assert "0% ended by `parked`" in statement.text
    assert "levels_stay_lowest" not in causes_of(with_logs(run, **logs, curriculum__mean_level=[0.2] * 8))


def test_a_success_that_needs_exploration_is_named(carriage):
    """Without noise on its actions, the policy stood still."""
    good = outcomes(400, 0.2, 0.9, 1.0, 1.0)
    poor = [Episode(0.0, 60, k < 29, "max_steps") for k in range(100)]
    training = with_logs(
        carriage,
        returns_of(good, 0),
        np.full(400, 60),
        success=good,
        evaluations=evaluations_with(*[0.3] * 20),
    )
    first = diagnose(replace(training, final_episodes=poor))[0]
    assert (first.cause, first.evidence["with"].rate) == (
        "success_needs_exploration",
        pytest.approx(1.0, abs=0.03),
    )
    assert (first.evidence["without"].rate, first.settings) == (0.3, {"train.total_timesteps": "50_000"})
    high = evaluations_with(*[0.9] * 20)
    assert "success_needs_exploration" not in causes_of(
        replace(training, all_evaluations=high, final_episodes=poor)
    )


def test_a_script_that_succeeds_where_the_policy_does_not_is_the_teacher(tmp_path):
    by_hand = "scripts={by_hand: {drive: 4 * gap / m}, idle: {drive: 0}}"
    training = read_training(Run.open(train_shuttle(tmp_path, by_hand)))
    run_probes(training)
    assert {name: len(traces) for name, traces in training.scripts.items()} == {"by_hand": 8, "idle": 8}
    poor = [Episode(0.0, 60, k < 6, "max_steps") for k in range(100)]
    (statement,) = [
        each for each in diagnose(replace(training, final_episodes=poor)) if each.cause == "script_succeeds"
    ]
    assert statement.settings == {"train.teacher": "by_hand"}
    assert "'by_hand' succeeds in 100% (68% to 100%) of 8 episodes, and the policy in 6%" in statement.text
    good = [Episode(0.0, 60, k < 70, "parked") for k in range(100)]
    assert "script_succeeds" not in causes_of(replace(training, final_episodes=good))


def test_a_success_that_earns_less_than_its_absence_is_named(carriage):
    good = outcomes(400, 0.3, 0.3)
    first = diagnose(with_logs(carriage, returns_of(good, 5) - 12 * good, np.full(400, 60), success=good))[0]
    assert first.cause == "reward_apart_from_success"
    assert "the mean return is -1.97 in " in first.text
    falling = outcomes(400, 0.6, 0.1, 0.1)
    first = diagnose(
        with_logs(
            carriage,
            returns_of(falling, 0, 9),
            np.full(400, 60),
            success=falling,
            reward__closer=np.arange(20.0),
        )
    )[0]
    assert (first.cause, first.evidence["term"]) == ("reward_apart_from_success", "closer")


def test_dying_early_is_named_with_the_success_rate_from_which_going_on_pays(tmp_path):
    """A step costs 2, a hit 5, and a success earns 10."""
    run = Run.open(
        train_shuttle(tmp_path, "termination.failure={hit: abs(shuttle.place) > 0.49 m}", "reward.time=-2")
    )
    generator = np.random.default_rng(5)
    lengths = np.concatenate([np.full(20, 60), np.full(20, 30), generator.integers(8, 20, 360)]).astype(float)
    good = np.zeros(400)
    ending = np.array(["max_steps"] * 20 + ["parked"] * 20 + ["hit"] * 360, object)
    good[20:40] = 1
    training = with_logs(
        run.path, -2 * lengths + 40 * good - 5 * (ending == "hit"), lengths, success=good, ending=ending
    )
    first = diagnose(training)[0]
    assert first.cause == "ending_early_pays"
    assert first.evidence["break_even"] == pytest.approx(
        (-5 - 2 * lengths[40:].mean() + 120) / (-20 + 120), abs=1e-6
    )
    assert "continuing pays only if at least 8" in first.text


def test_a_running_training_is_not_advised_to_resume(carriage, tmp_path, capsys):
    run = Path(shutil.copytree(carriage, tmp_path / "run"))
    Run.open(run).update(status="running")
    with run_lock(run):
        assert main(["diagnose", str(run), "--only-logs"]) == 0
    text = capsys.readouterr().out
    assert "it still runs" in text
    assert "deepbots resume" not in text
    rising = returns_of(np.zeros(100), 0, 5)
    training = replace(with_logs(carriage, rising, np.full(100, 60)), is_running=True)
    training.run.record = training.run.record.model_copy(update={"total_timesteps": 48_000})
    (statement,) = diagnose(training)
    assert statement.advice == "Let it run: 6,000 of 48,000 steps have been made."
    assert main(["diagnose", str(run), "--only-logs"]) == 0
    assert "deepbots resume" in capsys.readouterr().out


def test_a_run_whose_last_evaluation_misses_the_criterion_is_not_called_solved(tmp_path):
    run = Run.open(train_shuttle(tmp_path, "solved=success_rate >= 95 % over 100 episodes"))
    good = np.ones(400)
    done = [Episode(5.0, 60, k >= 7, "parked") for k in range(100)]
    training = with_logs(
        run.path,
        returns_of(good, 0),
        np.full(400, 60),
        success=good,
        evaluations=evaluations_with(*[1.0] * 20),
    )
    assert training.solved
    assert not replace(training, final_episodes=done, verdict=RunVerdict(False, None)).solved


def test_a_sensor_that_saw_nothing_is_not_advised_a_smaller_range(tmp_path):
    still = "robots.shuttle.sensors.ray={type: laser, link: carriage, rays: 1, range: 0 .. 30 cm}"
    overrides = [
        still,
        "robots.shuttle.emit=[place, ray]",
        "observation={shuttle.place: -0.5 .. 0.5 m, gap: -0.9 .. 0.9 m, shuttle.ray: auto}",
    ]
    training = read_training(Run.open(train_shuttle(tmp_path, *overrides)))
    run_probes(training)
    (statement,) = [each for each in diagnose(training) if each.cause == "sensor_without_reading"]
    assert "shuttle.ray.r0 always 0.3 m" in statement.text
    assert "Narrow their ranges" not in statement.advice
    assert "constant_observation" not in causes_of(training)


def test_staying_near_the_success_is_named_where_it_pays_more(tmp_path):
    run = Run.open(train_shuttle(tmp_path, "reward.warm=max(0, 1 - abs(gap) / (15 cm))"))
    watch = instrument_program(run.program, include_observation=True)
    world = TraceRecorder(api.build(watch.program, engine="mujoco"), watch)
    with closing(world):
        observation, _ = world.reset(seed=4, options={"mark": 0.3})
        ended = False
        while not ended:
            gap = 0.9 * observation[1]
            observation, _, failed, ended, _ = world.step(
                np.array([np.sign(gap) if abs(gap) > 0.06 else 0.0], np.float32)
            )
            assert not failed
        staying = world.trace("an episode")
    good = outcomes(400, 0.3, 0.05)
    training = with_logs(
        run.path, returns_of(good, 10, 30), np.full(400, 60), success=good, ending="max_steps"
    )
    first = diagnose(replace(training, policy=[staying]))[0]
    assert (first.cause, first.evidence["term"]) == ("loitering", "warm")
    assert 0.5 < first.evidence["per_step"] < 0.7
    # Two lucky successes do not contradict the headline, and are not compared.
    good = np.arange(400) < 2
    rare = with_logs(run.path, returns_of(good, 40, 30), np.full(400, 60), success=good, ending="max_steps")
    (text,) = (
        cause.text for cause in diagnose(replace(rare, policy=[staying])) if cause.cause == "loitering"
    )
    assert text.endswith("Of 400 episodes of the training, 2 succeeded.")


def test_a_training_that_stops_at_a_reset_has_this_cause_alone(tmp_path, capsys):
    with pytest.raises(EvaluationError):
        train(
            api.compile(api.load("cartpole", overrides=["fall_angle=0.15 deg"])),
            total_timesteps=64,
            run=tmp_path / "run",
        )
    training = read_training(Run.open(tmp_path / "run"))
    run_probes(training)
    assert causes_of(training) == ["ending_at_reset"]
    assert main(["diagnose", str(tmp_path / "run"), "--episode", "0"]) == 2
    assert "deepbots diagnose" in capsys.readouterr().err


def test_a_training_that_solves_its_task_has_no_cause(short):
    """The same logs as a collapsed exploration, and an evaluation that meets `solved`."""
    training = with_logs(short, np.full(200, 200.0), ending="max_steps", train__entropy_loss=[-0.001] * 20)
    evaluation = {"returns": [200.0] * 20, "successes": [False] * 20}
    assert causes_of(replace(training, all_evaluations=[evaluation])) == []


@pytest.mark.slow
def test_an_action_without_effect_and_useless_ranges_are_found_in_short_episodes(tmp_path):
    overrides = [
        "robots.cart.apply.wheels=0 * drive * wheel_speed",
        "observation.x=-1e-6 .. 1e-6 m",
        "reward.alive=-1",
        "train.ent_coef=5",
    ]
    overrides += ["augment.tilt=max(abs(cart.pole_angle) / rad, 0.19)", "observation.tilt=0.2 .. 0.4"]
    compiled = api.compile(api.load("cartpole", overrides=overrides))
    training = read_training(
        Run.open(train(compiled, total_timesteps=512, seed=2, run=tmp_path / "dead").run)
    )
    assert "action_without_effect" not in causes_of(training)
    run_probes(training)
    assert (causes_of(training)[0], {trace.ended_by for trace in training.policy}) == (
        "action_without_effect",
        {"fallen"},
    )
    (warned,) = [cause for cause in diagnose(training) if cause.cause == "lint_warns"]
    assert warned.evidence["likelihood"] > 0.9  # the required return is out of reach
    assert "the highest possible return is -1 (DB810)" in warned.text
    # Most values of both are beyond their range. Those of `tilt` hardly differ there, so clipping loses
    # nothing.
    (clipped,) = [cause for cause in diagnose(training) if cause.cause == "saturated_observation"]
    assert min(clipped.evidence["shares"]["x"], clipped.evidence["shares"]["tilt"]) > 0.4
    assert clipped.evidence["names"] == "x"
    # Its evaluations, which do not explore, may solve the task all the same.
    assert causes_of(replace(training, all_evaluations=[{"returns": [200.0], "successes": [False]}])) == [
        "exploration_too_large"
    ]


def test_a_diagnosis_is_printed_with_numbers_and_what_to_try(short, capsys):
    assert main(["diagnose", str(short)]) == 0
    text = capsys.readouterr().out
    assert "the most likely first" in text
    assert "Try: " in text
    assert main(["diagnose", str(short), "--json", "--only-logs"]) == 0
    (diagnosis,) = json.loads(capsys.readouterr().out)["runs"]
    assert diagnosis["causes"]
    assert all(any(sign.isdigit() for sign in cause["text"]) for cause in diagnosis["causes"])
    likelihoods = [cause["evidence"]["likelihood"] for cause in diagnosis["causes"]]
    assert likelihoods == sorted(likelihoods, reverse=True)


def test_an_episode_of_a_run_is_explained_with_its_critic(short, capsys):
    assert main(["diagnose", str(short), "--json", "--episode", "3"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert 0 < data["moment"]["time"] < data["time"]
    assert data["end"]["margin"] > 0


def test_episodes_of_an_evaluation_are_repeated_to_the_bit(short, tmp_path, capsys):
    """Also those that stand in another row of its forward passes."""
    run = shutil.copytree(short, tmp_path / "run")
    assert main(["eval", str(run), "--episodes", "failed"]) == 2
    assert "keeps no evaluation" in capsys.readouterr().err
    assert main(["eval", str(run), "--episodes", "10", "--json"]) == 0
    outcomes = json.loads(capsys.readouterr().out)["outcomes"]
    opened = Run.open(run)
    kept = quoted_episodes(opened)
    assert kept.failed(opened.program) == list(range(10))
    for trace, number in zip(trace_episodes(opened, (9, 3), **kept.replay_options), (9, 3), strict=True):
        outcome = outcomes[number]
        assert (trace.steps, trace.returns, trace.ended_by) == (
            outcome["length"],
            outcome["total_return"],
            outcome["ended_by"],
        )


def test_failed_episodes_that_a_time_limit_ended_print_no_blank_lines(short, tmp_path, capsys):
    run = shutil.copytree(short, tmp_path / "run")
    resolved = run / "resolved.yaml"
    record = json.loads((run / "run.json").read_text())
    resolved.write_text(
        resolved.read_text().replace("failure:", "success:\n    kept: time > 60 s\n  failure:")
    )
    text = resolved.read_text()
    resolved.write_text(re.sub(r"max_steps: \d+", "max_steps: 5", text))
    (run / "run.json").write_text(json.dumps(record | {"digest": Run.open(run).digest}))
    assert main(["eval", str(run), "--episodes", "2"]) == 0
    capsys.readouterr()
    assert main(["eval", str(run), "--episodes", "failed"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "episode 0: 'max_steps' at 0.16 s"
    assert lines[1].strip().startswith("The episode reached 5 of at most 5 (max_steps).")
    assert "'kept' requires" in lines[1]
    assert all(line.strip() for line in lines)


def test_a_critic_that_never_fell_names_no_moment(short):
    run = Run.open(short)
    trace = next(trace_episodes(run, [0], seed=5))
    trace.critic = np.linspace(1.0, 2.0, trace.steps)
    statements = explain(trace)
    assert explanation_json(trace, statements)["moment"] is None
    assert "rose from 1 to 2" in next(each.text for each in statements if each.cause == "unforeseen")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scenario", "timesteps"),
    [("cartpole", 2048), ("balancer", 6000), ("quadrotor", 6000), ("line_follower", 6000)],
)
def test_the_named_moment_precedes_the_end_of_fifty_failed_episodes(scenario, timesteps, tmp_path):
    """It is the largest drop of the critic's value, of a policy at the beginning of its training; 20 s of CPU
    time each."""
    run = Run.open(train(scenario, total_timesteps=timesteps, seed=711, run=tmp_path / scenario).run)
    episodes = trace_episodes(run, range(500), seed=712, model="last")
    failed = list(islice((trace for trace in episodes if trace.outcome == "failure"), 50))
    assert len(failed) == 50
    moments = [explanation_json(trace, explain(trace))["moment"] for trace in failed]
    for trace, moment in zip(failed, moments, strict=True):
        drops = [before - after for before, after in pairwise(trace.critic)]
        if moment is None:
            assert max(drops) <= 0
        else:
            assert drops[moment["step"] - 1] == max(drops) > 0
            assert 0 < moment["time"] < trace.time
    assert sum(moment is None for moment in moments) <= 2


@pytest.mark.slow
def test_failed_episodes_are_filmed(short, tmp_path, capsys, monkeypatch):
    """A film takes 3 s of CPU time."""
    run = shutil.copytree(short, tmp_path / "run")
    monkeypatch.chdir(tmp_path)
    assert main(["eval", str(run), "--episodes", "2"]) == 0
    capsys.readouterr()
    assert main(["eval", str(run), "--episodes", "failed", "--json"]) == 0
    failed = json.loads(capsys.readouterr().out)["failed"]
    assert main(["render", str(run), "--episodes", "failed", "-o", "failed.mp4", "--json"]) == 0
    films = json.loads(capsys.readouterr().out)["files"]
    assert [each["file"] for each in films] == ["failed-0.mp4", "failed-1.mp4"]
    assert all(each["bytes"] > 1000 for each in films)
    filmed = [(episode["ended_by"], episode["steps"]) for each in films for episode in each["episodes"]]
    assert filmed == [(each["ended_by"], each["steps"]) for each in failed]


def test_a_folder_that_cannot_be_diagnosed_is_refused_in_a_sentence(short, tmp_path, capsys):
    run = shutil.copytree(short, tmp_path / "run")
    log = run / "monitor.csv"
    log.write_text("".join(log.read_text().splitlines(keepends=True)[:2]))
    assert main(["diagnose", str(run)]) == 2
    assert "contains no finished episode yet" in capsys.readouterr().err
    log.write_text(log.read_text() + "a,b,c,d,e,f,g,h,i,j\n")
    assert main(["diagnose", str(run)]) == 2
    assert "is damaged" in capsys.readouterr().err
    shutil.copy(short / "monitor.csv", log)
    evaluation = run / "evaluations" / "0001.json"
    kept = EvaluationResult.of_episodes(
        [Episode(9.0, 60, False, None)],
        evaluated="9999",
        model="best",
        seed=2,
        solved=None,
        success_defined=False,
    )
    evaluation.write_text(kept.model_copy(update={"outcomes": ()}).model_dump_json())
    assert main(["diagnose", str(run), "--episode", "failed"]) == 2
    assert "0001.json is damaged: 'outcomes'" in capsys.readouterr().err
    evaluation.unlink()
    shutil.rmtree(run / "models")
    run = run.rename(tmp_path / "a run")
    assert main(["diagnose", str(run), "--episode", "0"]) == 2
    err = capsys.readouterr().err
    assert "contains no model" in err
    assert f"deepbots resume '{run}'" in " ".join(err.split())
    assert main(["diagnose", str(tmp_path)]) == 2
    assert "is not a run" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("line", "damaged"),
    [
        ('{"steps": 512, "returns": [9.0], "succ', False),  # a killed training leaves half a line
        ('{"steps": 512, "returns": [9.0], "succ\n', True),
        ('{"steps": 512, "returns": [], "successes": []}\n', True),
        ('{"steps": 512, "returns": [NaN], "successes": [true]}\n', True),
        ('{"steps": 512, "returns": [9.0], "successes": ["yes"]}\n', True),
    ],
)
def test_half_a_line_of_a_log_is_left_out_and_any_other_damage_is_an_error(short, tmp_path, line, damaged):
    run = Path(shutil.copytree(short, tmp_path / "run"))
    with (run / "evaluations" / "training.jsonl").open("a") as file:
        file.write(line)
    if damaged:
        with pytest.raises(RunError, match="one of its logs cannot be read"):
            read_training(Run.open(run))
    else:
        assert len(read_training(Run.open(run)).evaluations) == len(
            read_training(Run.open(short)).evaluations
        )


def test_a_damaged_seed_of_a_group_hides_no_other_seed(short, tmp_path, capsys):
    group = tmp_path / "group"
    for seed in (0, 1):
        shutil.copytree(short, group / f"seed-{seed}")
    (group / "seed-0" / "run.json").write_text("{")
    record = {name: None for name, field in GroupRecord.model_fields.items() if field.is_required()} | {
        "format": 2, "deepbots": "", "scenario": "", "source": "", "engine": "pybullet", "seeds": [0, 1],
        "stop_when_solved": False, "keep_checkpoints": 0, "command": [], "started": "",
    }  # fmt: skip
    (group / "group.json").write_text(json.dumps(record))
    assert main(["diagnose", str(group), "--only-logs"]) == 0
    output = capsys.readouterr()
    assert "seed-0/run.json is damaged" in output.err
    assert "seed-1: " in output.out
    (group / "seed-1" / "run.json").write_text("{")
    assert main(["diagnose", str(group), "--only-logs", "--json"]) == 2
    assert "contains no run that can be diagnosed" in capsys.readouterr().err


def test_the_page_names_every_cause_and_every_planted_one_is_known():
    text = DOCS.read_text("utf-8")
    names = [cause.name for cause in CAUSES]
    assert [name for name in names if f"`{name}`" not in text] == []
    assert {entry["cause"] for entry in BROKEN} <= set(names)
    assert all("{" in row.text for row in (*CAUSES, *ROWS))


@pytest.mark.slow
def test_the_planted_cause_comes_first_in_nineteen_of_twenty(tmp_path):
    """Five minutes of CPU time."""
    first = {entry["name"]: (entry["cause"], causes[0]) for entry, causes in all_causes(SEED, tmp_path)}
    wrong = {name: pair for name, pair in first.items() if pair[0] != pair[1]}
    assert len(first) == 20
    assert len(wrong) <= 1, wrong
