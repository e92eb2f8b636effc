"""Comparisons of policies: which models, in which world, by which measure; and the intervals of a group."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import stand_in
from stand_in import hyper

from deepbots_cli.cli import records
from deepbots_cli.cli.commands.compare import _data, _lines
from deepbots_cli.errors import UsageError
from deepbots_cli.learning import compare, evaluate, evaluate_group, load_policy, train, train_group
from deepbots_cli.learning.campaigns.group import GroupTraining
from deepbots_cli.learning.comparison import GroupDifference, GroupResult
from deepbots_cli.learning.runs.run import ModelRef, Run
from deepbots_cli.learning.runs.statistics import compare_episodes, mean_interval
from deepbots_cli.learning.runs.verdict import last_episodes
from deepbots_cli.program.task import Solved, Training

SHORT = Training(
    "PPO",
    400,
    2,
    hyper(n_steps=32, batch_size=32, n_epochs=1),
)
STEP = "models/agent/step-000000256.zip"


def trained(folder: Path, **changes: Any) -> Path:
    """A run of 448 steps with a model after 256 steps."""
    task = stand_in.compiled(training=SHORT, **changes)
    return train(task, run=folder, build=stand_in.build, keep_checkpoints=2).run


@pytest.fixture(scope="module")
def climb(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Not to be changed."""
    return trained(tmp_path_factory.mktemp("runs") / "climb")


@pytest.fixture(scope="module")
def group(tmp_path_factory: pytest.TempPathFactory) -> GroupTraining:
    """Three short trainings; not to be changed."""
    task = stand_in.compiled(training=SHORT, solved=Solved(10, mean_return=195.0))
    return train_group(task, (0, 1, 2), runs=tmp_path_factory.mktemp("groups"), build=stand_in.build)


# Which model


def test_a_run_is_compared_with_its_own_checkpoint_and_both_rows_name_their_steps(climb: Path) -> None:
    comparison = compare([climb, climb / STEP], episodes=3, build=stand_in.build)
    assert [entry.name for entry in comparison.groups] == ["climb", "climb (step-000000256)"]
    (first,), (second,) = (entry.evaluations for entry in comparison.groups)
    assert first.model == "best"
    assert second.model == "step-000000256"
    assert second.model_steps == 256
    assert first.model_steps is not None
    assert first.model_steps > 256
    assert [entry.seed for entry in first.outcomes] == [entry.seed for entry in second.outcomes]


def test_a_model_is_named_in_the_same_way_everywhere(climb: Path) -> None:
    checkpoint = climb / STEP
    assert evaluate(checkpoint, episodes=1, build=stand_in.build).model_steps == 256
    assert load_policy(checkpoint).scenario == "stand_in"
    ref = ModelRef.open(checkpoint)
    assert ref.path == checkpoint
    assert ref.label == "climb (step-000000256)"
    assert ref.is_named is True
    with pytest.raises(
        UsageError, match=r"--last chooses a model of a run, but .*step-000000256\.zip is already a model"
    ):
        compare([climb, checkpoint], model="last", build=stand_in.build)


def test_a_training_begins_with_the_weights_of_a_checkpoint(climb: Path, tmp_path: Path) -> None:
    task = stand_in.compiled(training=SHORT)
    begun = train(
        task, run=tmp_path / "second", initialize_from=climb / STEP, total_timesteps=64, build=stand_in.build
    )
    assert begun.initialized_from is not None
    assert begun.initialized_from.startswith(f"{climb / STEP}: ")
    assert (begun.run / "models" / "agent" / "initial.zip").read_bytes() == (climb / STEP).read_bytes()


@pytest.mark.slow
def test_evaluations_of_checkpoints_are_the_last_ones_too(run_copy: Path) -> None:
    run = Run.open(run_copy)
    run.model("step-000000128").write_bytes(run.model("last").read_bytes())
    of_checkpoint = ModelRef.open(run.model("step-000000128"))
    best = run.write_evaluation(evaluate(run, episodes=2, build=stand_in.build).model_dump(mode="json"))
    path = run.write_evaluation(
        evaluate(of_checkpoint, episodes=2, build=stand_in.build).model_dump(mode="json")
    )
    for ref, expected in (
        (ModelRef(run), path),
        (of_checkpoint, path),
        (ModelRef.open(run.model("best")), best),
    ):
        last = last_episodes(ref)
        assert last is not None
        assert last[0] == expected
    forged = evaluate(run, episodes=2, build=stand_in.build).model_dump(mode="json") | {
        "model": "../../../elsewhere"
    }
    run.write_evaluation(forged)
    assert last_episodes(ModelRef(run))[0] == path  # type: ignore[index]


# In which world


def test_policies_whose_apply_differs_are_each_played_in_their_own_scenario(
    climb: Path, tmp_path: Path
) -> None:
    faster = trained(tmp_path / "faster", apply="drive * 8 rad/s")
    comparison = compare([climb, faster], episodes=3, build=stand_in.build)
    assert comparison.scenario is None
    (difference,) = comparison.differences
    assert difference.own_scenarios
    assert difference.mean_return is not None  # the rewards are the same
    (note,) = [note for note in comparison.notes if "own scenario" in note]
    assert note.startswith(
        "climb and faster are each evaluated in their own scenario, from starts with the same seeds"
    )
    assert "robots.cart.apply.wheels: drive * 5 rad/s -> drive * 8 rad/s" in note
    for entry in comparison.groups:
        assert entry.evaluations[0].elsewhere is None
    named = compare(
        [climb, faster], episodes=3, scenario=stand_in.compiled(training=SHORT), build=stand_in.build
    )
    assert named.scenario == "stand_in"
    assert any("something else than here: robots.cart.apply.wheels" in note for note in named.notes)


def test_returns_of_different_rewards_are_left_out_where_each_policy_is_in_its_own_scenario(
    climb: Path, tmp_path: Path
) -> None:
    rewarded_twice = trained(tmp_path / "other", apply="drive * 8 rad/s", reward="{alive: 2, center: 0}")
    comparison = compare([climb, rewarded_twice], episodes=3, build=stand_in.build)
    (difference,) = comparison.differences
    assert (difference.mean_return, difference.compared) == (None, None)
    assert (
        difference.verdict
        == "other: cannot be compared with climb, because returns do not mean the same (reward.alive differ)"
    )
    assert any(
        "returns are not compared, because they do not mean the same: reward.alive: 1 -> 2" in note
        for note in comparison.notes
    )


def test_successes_are_compared_where_returns_do_not_mean_the_same(tmp_path: Path) -> None:
    first = trained(tmp_path / "one", success=True)
    second = trained(
        tmp_path / "other", success=True, apply="drive * 8 rad/s", reward="{alive: 2, center: 0}"
    )
    comparison = compare([first, second], episodes=3, build=stand_in.build)
    (difference,) = comparison.differences
    assert difference.measure == "success_rate"
    assert difference.mean_return is None
    assert "success rate" in difference.verdict


def test_what_two_rewards_measure_differently_is_left_out_in_one_world(climb: Path, tmp_path: Path) -> None:
    other = trained(tmp_path / "other", reward="{alive: 2, center: 0}")
    comparison = compare([climb, other, climb / STEP], episodes=2, build=stand_in.build)
    assert comparison.scenario == "stand_in"
    rewarded, same = comparison.differences
    assert not rewarded.own_scenarios
    assert (rewarded.mean_return, rewarded.solved_after) == (None, None)
    assert "cannot be compared with climb, because returns do not mean the same" in rewarded.verdict
    assert same.mean_return is not None
    (note,) = [note for note in comparison.notes if "the rewards of the runs differ" in note]
    assert note.endswith("compare success rates: reward.alive: 1 -> 2")
    groups = _data(comparison)["groups"]
    for group in (*groups, *(run for entry in groups for run in entry["runs"])):
        assert {group[name] for name in ("mean_return", "return_interval", "interquartile_mean")} == {None}
    assert " return" not in "\n".join(_lines(comparison)).partition("difference from")[0]


# By which measure


def test_the_verdict_is_about_successes_where_the_task_asks_for_them() -> None:
    returns = compare_episodes([200.0] * 99 + [199.0], [100.0] * 99 + [99.0])
    successes = compare_episodes([0.0] * 100, [0.0] * 50 + [1.0] * 50)
    difference = GroupDifference("one", "other", "success_rate", returns, successes, between_seeds=False)
    assert difference.verdict.startswith("other is better than one: the success rate is 50.0 points higher")
    assert replace(difference, measure="mean_return").verdict.startswith(
        "other is worse than one: the mean return is 100 lower"
    )


def test_a_comparison_of_one_episode_asks_for_more_episodes_and_not_for_more_seeds() -> None:
    single = compare_episodes([33.0], [20.0])
    between_runs = GroupDifference("one", "other", "mean_return", single, None, between_seeds=False)
    assert (
        between_runs.verdict
        == "other: cannot be compared, because a single episode has no interval; evaluate more of them with"
        " --episodes N"
    )
    assert replace(between_runs, between_seeds=True).verdict.endswith(
        "a group with one run has no interval; train more seeds"
    )


# Groups


def test_the_text_of_a_group_has_the_intervals_over_seeds_and_over_starts(
    group: GroupTraining,
) -> None:
    evaluation = evaluate_group(group.group, episodes=6, build=stand_in.build)
    means = [
        sum(result.outcomes[start].total_return for result in evaluation.evaluations) / 3
        for start in range(6)
    ]
    assert evaluation.return_interval_over_starts == mean_interval(
        means, evaluation.evaluations[0].possible_returns
    )
    text = records.group_text(evaluation)
    assert "over 3 seeds: what another training may give; more seeds narrow the intervals" in text
    assert (
        "over 6 starts: what these policies give from other starts; more episodes narrow the intervals"
        in text
    )
    assert text.count("  mean return ") == 2


def test_equal_returns_of_three_seeds_have_no_interval() -> None:
    run: Any = SimpleNamespace(mean_return=200.0, success_rate=1.0, possible_returns=(0.0, 200.0))
    seeds = GroupResult("seeds", (run, run, run))
    assert (seeds.return_interval, seeds.success_interval) == (None, None)
    assert records.scores(seeds, success_defined=False)["return_95 %"] == "all equal"


def test_a_group_counts_solved_runs_by_their_verdicts(group: GroupTraining) -> None:
    evaluation = evaluate_group(group.group, episodes=10, build=stand_in.build)
    first, *others = evaluation.evaluations
    run = Run.open(first.run)
    run.write_evaluation(first.model_copy(update={"episodes": 100, "solved": True}).model_dump(mode="json"))
    for result in others:
        Run.open(result.run).write_evaluation(result.model_dump(mode="json"))
    assert "solved              1 of 3 seeds" in records.group_text(evaluation)
    assert records.group_json(evaluation)["solved"] == [True, False, False]
