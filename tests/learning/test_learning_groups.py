"""Groups of runs, and comparisons.

* Groups of runs: trained seed by seed, resumed, evaluated and compared as one, and listed from their files.
* Comparisons of policies: which models, in which world, by which measure; and the intervals of a group.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
from dataclasses import replace
from functools import partial
from pathlib import Path
from statistics import fmean
from types import SimpleNamespace
from typing import Any

import pytest
import stand_in
from stand_in import hyper

import deepbots_cli
from deepbots_cli import api
from deepbots_cli.analysis.changes import scenario_changes
from deepbots_cli.cli import records
from deepbots_cli.cli.arguments import open_source
from deepbots_cli.cli.commands.compare import _data, _difference_rows, _group_rows, _lines
from deepbots_cli.cli.commands.eval import Gates
from deepbots_cli.document import Permissions
from deepbots_cli.errors import RunError, UsageError
from deepbots_cli.learning import (
    TrainingResult,
    compare,
    evaluate,
    evaluate_group,
    load_policy,
    resume_group,
    train,
    train_group,
)
from deepbots_cli.learning.campaigns.group import Group, GroupTraining
from deepbots_cli.learning.campaigns.listing import list_runs, read_listed, sort_runs
from deepbots_cli.learning.comparison import GroupDifference, GroupResult
from deepbots_cli.learning.executor import SERIAL, Attempt
from deepbots_cli.learning.report import Reporter, TrainingProgress
from deepbots_cli.learning.runs.directories import run_lock
from deepbots_cli.learning.runs.episodes import SolvedAt
from deepbots_cli.learning.runs.run import ModelRef, Run, short_settings
from deepbots_cli.learning.runs.statistics import (
    compare_episodes,
    compare_seeds,
    interquartile_mean,
    mean_interval,
)
from deepbots_cli.learning.runs.verdict import last_episodes
from deepbots_cli.program import Program
from deepbots_cli.program.task import Solved, Training
from deepbots_cli.rollout import Episode
from tests.commands import Deepbots

SHORT = Training(
    "PPO",
    200,
    2,
    hyper(n_steps=32, batch_size=32, n_epochs=1),
)
SCENARIO = stand_in.compiled(training=SHORT, solved=Solved(10, mean_return=195.0))


@pytest.fixture(scope="module")
def trained_group(tmp_path_factory: pytest.TempPathFactory) -> GroupTraining:
    """Three short trainings; not to be changed."""
    return train_group(SCENARIO, (0, 1, 4), runs=tmp_path_factory.mktemp("runs"), build=stand_in.build)


def test_the_scenario_of_a_group_is_opened_like_that_of_its_runs(trained_group: GroupTraining) -> None:
    group = open_source(str(trained_group.group), (), Permissions())
    assert scenario_changes(group, open_source(str(trained_group.group / "seed-0"), (), Permissions())) == []
    with pytest.raises(UsageError, match="is a group, which cannot be changed after the training"):
        open_source(str(trained_group.group), ("track=1 m",), Permissions())


def test_a_change_of_the_scenario_of_a_group_is_no_other_scenario(trained_group: GroupTraining) -> None:
    changed = api.compile(trained_group.group / "resolved.yaml", overrides=("truncation.max_steps=5",))
    evaluation = evaluate_group(trained_group.group, scenario=changed, episodes=2, build=stand_in.build)
    assert [result.circumstances for result in evaluation.evaluations] == [
        ("--set truncation.max_steps=5",)
    ] * 3


class InterruptsSeed(Reporter):
    """Sends Ctrl-C in the training of a certain number."""

    def __init__(self, number: int) -> None:
        self._left = number

    def start(self, progress: TrainingProgress) -> None:
        self._left -= 1

    def update(self, progress: TrainingProgress) -> None:
        if self._left == 0 and progress.steps > 100:
            self._left -= 1
            os.kill(os.getpid(), signal.SIGINT)


def test_each_seed_of_a_group_is_the_run_that_this_seed_alone_would_be(
    trained_group: GroupTraining, tmp_path: Path
) -> None:
    assert trained_group.group.name == "stand_in-seeds-1"
    assert [result.run.name for result in trained_group.trained] == ["seed-0", "seed-1", "seed-4"]
    alone = train(SCENARIO, run=tmp_path / "alone", seed=4, build=stand_in.build)
    assert (
        trained_group.trained[2].weights_digest
        == alone.weights_digest
        != trained_group.trained[1].weights_digest
    )


def test_the_cpu_time_of_a_seed_is_its_own(trained_group: GroupTraining) -> None:
    first, *_, last = (result.cpu_seconds for result in trained_group.trained)
    assert 0 < last < 2.5 * first


def test_an_interrupted_group_goes_on_and_skips_what_is_finished(
    trained_group: GroupTraining, tmp_path: Path
) -> None:
    begun = train_group(
        SCENARIO, (0, 1, 4), group=tmp_path / "group", progress=InterruptsSeed(2), build=stand_in.build
    )
    assert [result.status for result in begun.trained] == ["finished", "interrupted"]
    assert begun.waiting == (1, 4)
    listed = read_listed(tmp_path / "group")
    assert (listed.state, [run.state for run in listed.runs]) == ("interrupted", ["finished", "interrupted"])
    rest = resume_group(tmp_path / "group", build=stand_in.build)
    assert (rest.skipped, rest.waiting) == ((0,), ())
    assert [result.weights_digest for result in rest.trained] == [
        result.weights_digest for result in trained_group.trained[1:]
    ]
    assert read_listed(tmp_path / "group").state == "finished"
    again = resume_group(tmp_path / "group", build=stand_in.build)
    assert (again.trained, again.skipped) == ((), (0, 1, 4))
    longer = resume_group(tmp_path / "group", total_timesteps=300, build=stand_in.build)
    assert all(result.steps >= 300 for result in longer.trained)


def test_a_group_goes_on_with_the_options_of_a_resume_that_was_interrupted(tmp_path: Path) -> None:
    group = train_group(SCENARIO, (0, 1), runs=tmp_path, build=stand_in.build).group

    def end_after_one(seed: int, number: int, count: int) -> bool:
        return number < 2

    longer = resume_group(
        group, total_timesteps=400, loggers=["csv"], on_seed=end_after_one, build=stand_in.build
    )
    assert longer.waiting == (1,)
    resume_group(group, build=stand_in.build)
    records = [Run.open(group / f"seed-{seed}").record for seed in (0, 1)]
    assert [(record.total_timesteps, record.loggers) for record in records] == [(400, ("csv",))] * 2
    assert resume_group(group, build=stand_in.build).skipped == (0, 1)


def test_a_group_that_was_resumed_for_an_impossible_number_of_timesteps_can_still_be_opened(
    trained_group: GroupTraining, tmp_path: Path
) -> None:
    """Its record was called damaged from then on."""
    group = Path(shutil.copytree(trained_group.group, tmp_path / "group"))
    with pytest.raises(UsageError, match="'total_timesteps': Input should be greater than 0"):
        resume_group(group, total_timesteps=-5, build=stand_in.build)
    assert read_listed(group).state == "finished"


def test_a_group_that_trains_to_the_end_continues_seeds_that_stopped_as_solved(tmp_path: Path) -> None:
    training = replace(SHORT, total_timesteps=2_000)
    easy = stand_in.compiled(training=training, solved=Solved(2, mean_return=-1e6))
    begun = train_group(easy, (0,), runs=tmp_path, build=stand_in.build)
    assert begun.trained[0].steps < training.total_timesteps
    group = begun.group
    (result,) = resume_group(group, stop_when_solved=False, build=stand_in.build).trained
    assert result.steps >= training.total_timesteps
    assert resume_group(group, build=stand_in.build).skipped == (0,)


class LosesWorker(type(SERIAL)):
    """Calls a function again, as after the loss of a worker that had made these attempts."""

    def __init__(self, *attempts: int) -> None:
        self.attempts = attempts

    def map(self, function, items, **_):
        for item in items:
            *_, outcome = [function(item, Attempt(number)) for number in (*self.attempts, 2)]
            yield outcome


@pytest.mark.parametrize("attempts", [(), (1,)])
def test_a_repeated_call_trains_what_the_lost_worker_did_not(
    tmp_path: Path, attempts: tuple[int, ...]
) -> None:
    easy = stand_in.compiled(
        training=replace(SHORT, total_timesteps=2_000), solved=Solved(2, mean_return=-1e6)
    )
    group = train_group(easy, (0,), runs=tmp_path, build=stand_in.build).group
    longer = resume_group(group, total_timesteps=1_600, executor=LosesWorker(*attempts), build=stand_in.build)
    assert [result.steps >= 1_600 for result in longer.trained] == [True]
    assert len(Run.open(group / "seed-0").record.resumed_at) == 1


@pytest.mark.parametrize(
    ("total", "may_stop_early", "complete"),
    [(2_000, True, True), (2_000, False, False), (500, False, True), (2_001, True, False)],
)
def test_a_training_of_2000_steps_that_solved_its_task_after_500_is_complete_unless_more_is_asked(
    trained_group: GroupTraining, total: int, may_stop_early: bool, complete: bool
) -> None:
    record = Run.open(trained_group.trained[0].run).record
    assert record.result is not None
    changes = {"total_timesteps": 2_000, "result": record.result.model_copy(update={"steps": 500})}
    record = record.model_copy(update=changes)
    assert record.is_complete(total, may_stop_early=may_stop_early) is complete
    killed = record.model_copy(update={"status": "interrupted"})
    assert not killed.is_complete(total, may_stop_early=may_stop_early)


def test_a_seed_that_diverges_does_not_end_the_others(tmp_path: Path) -> None:
    training = train_group(
        SCENARIO,
        (0, 1),
        group=tmp_path / "group",
        build=lambda program, render_mode=None: stand_in.Failing(program),
    )
    assert (training.trained, sorted(training.failed)) == ((), [0, 1])
    assert "is not finite" in training.failed[0]
    assert read_listed(tmp_path / "group").state == "failed"


def test_ctrl_c_while_a_seed_is_set_up_leaves_a_group_to_go_on_with(tmp_path: Path) -> None:
    def build(program: Program, *, render_mode: str | None = None) -> stand_in.CartPole:
        first = tmp_path / "group" / "seed-0"
        if first.exists() and Run.open(first).record.status == "finished":
            raise KeyboardInterrupt
        return stand_in.build(program)

    assert train_group(SCENARIO, (0, 1), group=tmp_path / "group", build=build).waiting == (1,)
    assert resume_group(tmp_path / "group", build=stand_in.build).waiting == ()


def test_a_group_that_cannot_be_trained_leaves_nothing_behind(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no stage"):
        train_group(SCENARIO, (0, 1), runs=tmp_path, stage="late", build=stand_in.build)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(UsageError, match="expected 1 to 1000 different seeds"):
        deepbots_cli.train_group("cartpole", (1, 1), runs=tmp_path)


def test_a_group_is_evaluated_by_one_score_per_seed(trained_group: GroupTraining) -> None:
    evaluation = evaluate_group(trained_group.group, episodes=6, build=stand_in.build)
    starts = [[episode.seed for episode in result.outcomes] for result in evaluation.evaluations]
    assert starts[0] == starts[1] == starts[2]
    assert evaluation.returns == [result.mean_return for result in evaluation.evaluations]
    assert (evaluation.mean_return, evaluation.return_interval, evaluation.interquartile_mean) == (
        fmean(evaluation.returns),
        mean_interval(evaluation.returns),
        interquartile_mean(evaluation.returns),
    )
    alone = evaluate(trained_group.group / "seed-1", episodes=6, seed=0, build=stand_in.build)
    assert alone.model_dump(mode="json") == evaluation.evaluations[1].model_dump(mode="json")


def test_the_gate_of_a_group_stops_when_the_other_seeds_cannot_change_the_answer(
    trained_group: GroupTraining,
) -> None:
    gates = Gates(min_success=0.5, min_return=None, solved=False)
    enough = partial(gates.decided_of_group, planned=30)
    evaluation = evaluate_group(trained_group.group, episodes=10, until=enough, build=stand_in.build)
    done = sum(result.episodes for result in evaluation.evaluations)
    successes = sum(result.successes for result in evaluation.evaluations)
    assert done < 30
    assert successes >= 15 or successes + 30 - done < 15
    [(_, met, reason)] = gates.requirements_of_group(evaluation, 30)
    assert met == (successes >= 15)
    assert f"the remaining {30 - done} episodes cannot change the result" in reason


def test_a_group_goes_on_while_its_last_episode_can_reach_the_required_rate() -> None:
    gates = Gates(min_success=0.55, min_return=None, solved=False)  # 0.55 * 200 is more than 110 in binary
    episodes = [Episode(0.0, 1, number < 109, None) for number in range(199)]
    assert not gates.decided_of_group(episodes, planned=200)
    assert gates.decided_of_group([*episodes, Episode(0.0, 1, True, None)], planned=200)


def test_two_groups_are_compared_by_their_seeds_though_their_scenario_is_the_same(
    trained_group: GroupTraining, tmp_path: Path
) -> None:
    longer = shutil.copytree(trained_group.group, tmp_path / "longer")
    resume_group(longer, total_timesteps=400, build=stand_in.build)
    comparison = compare([trained_group.group, longer], episodes=5, build=stand_in.build)
    assert [(group.name, len(group.evaluations)) for group in comparison.groups] == [
        ("stand_in-seeds-1", 3),
        ("longer", 3),
    ]
    assert comparison.groups[0].solved_after == (None, None, None)
    (difference,) = comparison.differences
    assert difference.between_seeds
    assert difference.mean_return is not None
    assert difference.mean_return.mean == pytest.approx(
        comparison.groups[1].mean_return - comparison.groups[0].mean_return
    )
    with pytest.raises(UsageError, match="at least two runs"):
        compare([trained_group.group / "seed-0"], build=stand_in.build)


def test_the_runs_of_one_group_are_compared_with_each_other(trained_group: GroupTraining) -> None:
    comparison = compare([trained_group.group], episodes=2, build=stand_in.build)
    assert [group.name for group in comparison.groups] == ["seed-0", "seed-1", "seed-4"]
    assert len(comparison.differences) == 2


def test_groups_of_equal_returns_differ_by_the_steps_until_they_are_solved() -> None:
    equal = compare_seeds([200.0] * 3, [200.0] * 3)
    steps = compare_seeds([26_900, 26_300, 27_400], [46_400, 44_200, 48_800])
    means = {"mean_return": (200.0, 200.0)}
    assert (
        GroupDifference(
            "wide", "narrow", "mean_return", equal, None, True, solved_after=steps, means=means
        ).verdict
        == "neither is better: narrow and wide have the same mean return of 200 on the same starts; narrow is"
        " solved after 19,600 more steps"
    )


def test_a_damaged_group_is_refused_in_one_sentence(trained_group: GroupTraining, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(trained_group.group, tmp_path / "copy"))
    record = json.loads((copy / "group.json").read_text())
    (copy / "group.json").write_text(json.dumps(record | {"format": 9}))
    with pytest.raises(RunError, match=r"of format 9, .* reads format 2; use .*deepbots \S+ that wrote it"):
        Group.open(copy)
    for seeds in ([], [-1], [2**63], ["../../x"]):
        (copy / "group.json").write_text(json.dumps(record | {"seeds": seeds}))
        with pytest.raises(RunError, match=r"group\.json is damaged: 'seeds"):
            Group.open(copy)
    (copy / "group.json").write_text(json.dumps(record | {"seeds": [0, 0]}))
    with pytest.raises(RunError, match="expected 1 to 1000 different seeds"):
        Group.open(copy)
    (copy / "group.json").write_text('{"format": 9}')
    with pytest.raises(RunError, match="reads format 2; use the version of deepbots that wrote it"):
        Group.open(copy)
    shutil.move(copy / "seed-0", tmp_path / "elsewhere")
    (copy / "seed-0").symlink_to(tmp_path / "elsewhere")
    (copy / "group.json").write_text(json.dumps(record))
    with pytest.raises(RunError, match="symbolic link"):
        Group.open(copy)
    with pytest.raises(
        RunError, match=r"is a group of runs, and not a run; name one of its runs, such as .*/seed-0"
    ):
        Run.open(trained_group.group)


# The list
def test_the_list_follows_a_training_by_its_own_files(run_copy: Path, trained: TrainingResult) -> None:
    Run.open(run_copy).update(status="running", result=None)
    assert read_listed(run_copy).state == "interrupted"  # the process is gone
    with run_lock(run_copy):
        listed = read_listed(run_copy)
    assert (listed.state, listed.episodes, listed.score) == ("training", trained.episodes, "training")
    # Over whole generations of the four worlds, as the training itself.
    assert listed.mean_return == trained.mean_return != pytest.approx(fmean(_returns(run_copy)[-100:]))
    assert listed.cpu_seconds is not None
    with (run_copy / "monitor.csv").open("a") as log:
        log.write("12.0,12")  # a line that is being written
    assert read_listed(run_copy).episodes == listed.episodes


def _returns(run: Path) -> list[float]:
    return [float(line.split(",")[0]) for line in (run / "monitor.csv").read_text().splitlines()[2:]]


def test_a_group_is_listed_as_solved_by_the_verdicts_of_its_seeds(
    trained_group: GroupTraining, tmp_path: Path
) -> None:
    group = Path(shutil.copytree(trained_group.group, tmp_path / "group"))
    assert read_listed(group).solved is None
    evaluation = evaluate(group / "seed-0", episodes=3, build=stand_in.build).model_dump(mode="json")
    for verdicts, expected in (
        ((True, True, True), True),
        ((True, None, True), None),
        ((True, None, False), False),
    ):
        for seed, solved in zip((0, 1, 4), verdicts, strict=True):
            Run.open(group / f"seed-{seed}").write_evaluation(evaluation | {"solved": solved})
        assert read_listed(group).solved is expected


def test_a_group_averages_no_evaluation_with_a_training(trained_group: GroupTraining, tmp_path: Path) -> None:
    group = Path(shutil.copytree(trained_group.group, tmp_path / "group"))
    evaluation = evaluate(group / "seed-1", episodes=3, build=stand_in.build)
    Run.open(group / "seed-1").write_evaluation(evaluation.model_dump(mode="json"))
    listed = read_listed(group)
    assert [run.score for run in listed.runs] == ["training", "evaluation", "training"]
    assert (listed.score, listed.mean_return, listed.evaluated_episodes) == (
        "evaluation",
        evaluation.mean_return,
        3,
    )


def test_the_list_shows_the_longest_evaluation_in_the_scenario_of_the_training(run_copy: Path) -> None:
    assert read_listed(run_copy).score == "training"
    plain = evaluate(run_copy, episodes=3, build=stand_in.build)
    run = Run.open(run_copy)
    run.write_evaluation(plain.model_dump(mode="json"))
    run.write_evaluation(plain.model_dump(mode="json") | {"mean_return": 1e6, "set": ["world.substeps=2"]})
    run.write_evaluation(plain.model_dump(mode="json") | {"mean_return": 1e6, "model": "last"})
    (run_copy / "evaluations" / "0009.json").write_text("{")
    listed = read_listed(run_copy)
    assert (listed.score, listed.mean_return) == ("evaluation", plain.mean_return)
    assert listed.return_interval == plain.return_interval
    run.write_evaluation(
        plain.model_dump(mode="json") | {"mean_return": 1e6, "episodes": 2}
    )  # such as one that a gate has stopped early
    listed = read_listed(run_copy)
    assert (listed.mean_return, listed.evaluated_episodes) == (plain.mean_return, 3)


def test_the_list_has_the_success_rate_of_a_limit(tmp_path: Path) -> None:
    (tmp_path / "still.yaml").write_text(
        "deepbots: 1\nextends: cartpole\nname: Still\ntruncation: {max_steps: {limit: 2, success: all}}\n"
        "train: {n_steps: 8, environments: 1, batch_size: 8}\n"
    )
    run = train(tmp_path / "still.yaml", run=tmp_path / "run", total_timesteps=16).run
    assert read_listed(run).success_rate == 1.0


def test_values_that_the_command_line_has_changed_are_listed(run_copy: Path) -> None:
    record = json.loads((run_copy / "run.json").read_text())
    record["command"] = [
        "deepbots",
        "train",
        "cartpole",
        "--set",
        "train.learning_rate=0.003",
        "--set=fall_angle=10deg",
        "--seed",
        "1",
    ]
    (run_copy / "run.json").write_text(json.dumps(record))
    settings = read_listed(run_copy).settings
    assert settings == ("train.learning_rate=0.003", "fall_angle=10deg")
    assert short_settings(settings) == "learning_rate=0.003, fall_angle=10deg"


def test_scenarios_of_the_same_name_are_listed_with_their_files(run_copy: Path, deepbots: Deepbots) -> None:
    assert "stand_in (" not in deepbots("runs", run_copy.parent).out
    copy = shutil.copytree(run_copy, run_copy.parent / "other")
    record = json.loads((copy / "run.json").read_text())
    (copy / "run.json").write_text(json.dumps(record | {"source": "tasks/other.yaml"}))
    output = deepbots("runs", run_copy.parent).out
    assert "stand_in (stand_in.yaml)" in output
    assert "stand_in (other.yaml)" in output


def test_runs_in_folders_of_the_same_name_are_compared_under_their_paths(
    run_copy: Path, tmp_path: Path
) -> None:
    copy = shutil.copytree(run_copy, tmp_path / "second" / run_copy.name)
    comparison = compare([run_copy, copy], episodes=1, build=stand_in.build)
    assert [group.name for group in comparison.groups] == [str(run_copy), str(copy)]


def test_groups_of_the_same_name_are_compared_under_their_own_paths(
    trained_group: GroupTraining, tmp_path: Path
) -> None:
    copy = shutil.copytree(trained_group.group, tmp_path / "second" / trained_group.group.name)
    comparison = compare([trained_group.group, copy], episodes=1, build=stand_in.build)
    assert [group.name for group in comparison.groups] == [str(trained_group.group), str(copy)]


def test_runs_are_sorted_with_those_without_a_value_at_the_end(run_copy: Path) -> None:
    damaged = run_copy.parent / "damaged"
    damaged.mkdir()
    (damaged / "run.json").write_text("[]")
    assert [run.path.name for run in sort_runs(list_runs(run_copy.parent), "return")] == ["copy", "damaged"]
    assert [run.path.name for run in sort_runs(list_runs(run_copy.parent), "name")] == ["copy", "damaged"]
    assert list_runs(run_copy.parent / "nowhere") == []


def test_a_log_that_is_not_text_is_listed_without_it(run_copy: Path) -> None:
    (run_copy / "monitor.csv").write_bytes(b"#\xff\n\xff\xfe\n" + bytes(range(256)) * 10)
    record = json.loads((run_copy / "run.json").read_text())
    (run_copy / "run.json").write_text(json.dumps(record | {"result": None}))
    assert [run.state for run in list_runs(run_copy.parent)] != ["damaged"]


LONGER = Training(
    "PPO",
    400,
    2,
    hyper(n_steps=32, batch_size=32, n_epochs=1),
)
STEP = "models/agent/step-000000256.zip"


def trained(folder: Path, **changes: Any) -> Path:
    """A run of 448 steps with a model after 256 steps."""
    task = stand_in.compiled(training=LONGER, **changes)
    return train(task, run=folder, build=stand_in.build, keep_checkpoints=2).run


@pytest.fixture(scope="module")
def climb(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Not to be changed."""
    return trained(tmp_path_factory.mktemp("runs") / "climb")


@pytest.fixture(scope="module")
def group(tmp_path_factory: pytest.TempPathFactory) -> GroupTraining:
    """Three short trainings; not to be changed."""
    task = stand_in.compiled(training=LONGER, solved=Solved(10, mean_return=195.0))
    return train_group(task, (0, 1, 2), runs=tmp_path_factory.mktemp("groups"), build=stand_in.build)


# Which model
def test_a_run_is_compared_with_its_own_checkpoint_and_both_rows_name_their_steps(climb: Path) -> None:
    comparison = compare([climb, climb / STEP], episodes=3, build=stand_in.build)
    assert [entry.name for entry in comparison.groups] == ["climb", "climb (step-000000256)"]
    (first,), (second,) = (entry.evaluations for entry in comparison.groups)
    assert (first.model, second.model, second.model_steps) == ("best", "step-000000256", 256)
    assert first.model_steps is not None
    assert first.model_steps > 256
    assert [entry.seed for entry in first.outcomes] == [entry.seed for entry in second.outcomes]


def test_a_model_is_named_in_the_same_way_everywhere(climb: Path) -> None:
    checkpoint = climb / STEP
    assert evaluate(checkpoint, episodes=1, build=stand_in.build).model_steps == 256
    assert load_policy(checkpoint).scenario == "stand_in"
    ref = ModelRef.open(checkpoint)
    assert (ref.path, ref.label) == (checkpoint, "climb (step-000000256)")
    assert ref.is_named is True
    with pytest.raises(
        UsageError, match=r"--last chooses a model of a run, but .*step-000000256\.zip is already a model"
    ):
        compare([climb, checkpoint], model="last", build=stand_in.build)


def test_a_training_begins_with_the_weights_of_a_checkpoint(climb: Path, tmp_path: Path) -> None:
    task = stand_in.compiled(training=LONGER)
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
        [climb, faster],
        episodes=3,
        scenario=stand_in.compiled(training=LONGER),
        build=stand_in.build,
    )
    assert named.scenario == "stand_in"
    assert any("something else than here: robots.cart.apply.wheels" in note for note in named.notes)


def test_runs_of_two_engines_are_each_evaluated_in_their_own_in_any_order(tmp_path: Path) -> None:
    runs = [
        train(
            api.compile("cartpole", overrides=[f"world.engine={engine}"]),
            total_timesteps=256,
            run=tmp_path / engine,
        ).run
        for engine in ("mujoco", "pybullet")
    ]
    for order in (runs, runs[::-1]):
        comparison = compare(order, episodes=1)
        engines = [(group.name, group.evaluations[0].engine) for group in comparison.groups]
        assert engines == [(run.name, run.name) for run in order]
    comparison = compare(
        runs, episodes=1, scenario=api.compile("cartpole", overrides=["world.engine=mujoco"])
    )
    assert any(note.endswith("each run is evaluated in the engine mujoco") for note in comparison.notes)


def test_returns_of_different_rewards_are_left_out_where_each_policy_is_in_its_own_scenario(
    climb: Path, tmp_path: Path
) -> None:
    rewarded_twice = trained(tmp_path / "other", apply="drive * 8 rad/s", reward="{alive: 2, center: 0}")
    comparison = compare([climb, rewarded_twice], episodes=3, build=stand_in.build)
    (difference,) = comparison.differences
    assert (difference.mean_return, difference.compared) == (None, None)
    assert (
        difference.verdict
        == "other and climb cannot be compared, because returns do not mean the same (reward.alive differ)"
    )
    assert any(
        "returns are not compared, because they do not mean the same: reward.alive: 1 -> 2" in note
        for note in comparison.notes
    )
    lines = _lines(comparison, _group_rows(comparison), _difference_rows(comparison))
    assert "difference from" not in "\n".join(lines)


def test_successes_are_compared_where_returns_do_not_mean_the_same(tmp_path: Path) -> None:
    first = trained(tmp_path / "one", success=True)
    second = trained(
        tmp_path / "other", success=True, apply="drive * 8 rad/s", reward="{alive: 2, center: 0}"
    )
    (difference,) = compare([first, second], episodes=3, build=stand_in.build).differences
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
    assert "other and climb cannot be compared, because returns do not mean the same" in rewarded.verdict
    assert same.mean_return is not None
    (note,) = [note for note in comparison.notes if "the rewards of the runs differ" in note]
    assert note.endswith("compare success rates, or choose one reward with --scenario: reward.alive: 1 -> 2")
    groups = _data(comparison)["groups"]
    for group in (*groups, *(run for entry in groups for run in entry["runs"])):
        assert {group[name] for name in ("mean_return", "return_interval", "interquartile_mean")} == {None}
    assert (
        " return"
        not in "\n".join(_lines(comparison, _group_rows(comparison), _difference_rows(comparison))).partition(
            "difference from"
        )[0]
    )


def test_returns_in_a_named_scenario_are_of_its_reward_and_are_compared(climb: Path, tmp_path: Path) -> None:
    other = trained(tmp_path / "other", reward="{alive: 2, center: 0}")
    comparison = compare([climb, other], episodes=2, scenario=Run.open(climb).compiled, build=stand_in.build)
    (difference,) = comparison.differences
    assert difference.mean_return is not None
    assert difference.solved_after is None
    assert not [note for note in comparison.notes if "the rewards of the runs differ" in note]


# By which measure
def test_the_verdict_is_about_successes_where_the_task_asks_for_them() -> None:
    returns = compare_episodes([200.0] * 99 + [199.0], [100.0] * 99 + [99.0])
    successes = compare_episodes([0.0] * 100, [0.0] * 50 + [1.0] * 50)
    means = {"mean_return": (199.99, 99.99), "success_rate": (0.0, 0.5)}
    difference = GroupDifference("one", "other", "success_rate", returns, successes, False, means=means)
    better = "other is better than one: success rate 50% against 0% on the same starts"
    assert difference.verdict == better
    worse = "one is better than other: mean return 200 against 99.99 on the same starts"
    assert replace(difference, measure="mean_return").verdict == worse
    few = replace(difference, success_rate=compare_episodes([0.0, 1.0], [1.0, 1.0]))
    assert few.verdict.startswith("neither is clearly better: success rate of one 0%, of other 50%, on")


def test_a_comparison_of_one_episode_asks_for_more_episodes_and_not_for_more_seeds() -> None:
    single = compare_episodes([33.0], [20.0])
    between_runs = GroupDifference("one", "other", "mean_return", single, None, between_seeds=False)
    assert (
        between_runs.verdict
        == "other and one cannot be compared, because a single episode has no interval; evaluate more of them with"
        " --episodes N"
    )
    assert replace(between_runs, between_seeds=True).verdict.endswith(
        "one run, or a few of equal scores, have no interval; train more seeds"
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


def test_an_evaluated_group_has_the_steps_until_each_run_was_solved(group: GroupTraining) -> None:
    first = Run.open(group.group / "seed-0")
    assert first.record.result is not None
    solved_at = SolvedAt(9, 90, 0.1, 1.0, 200.0, 0.0)
    first.update(result=first.record.result.model_copy(update={"solved_at": solved_at}))
    evaluation = evaluate(first, episodes=2, build=stand_in.build).model_copy(
        update={"episodes": 100, "solved": True}
    )
    first.write_evaluation(evaluation.model_dump(mode="json"))
    of_group = evaluate_group(group.group, episodes=2, build=stand_in.build)
    assert records.group_json(of_group)["solved_after"] == (90, None, None)
