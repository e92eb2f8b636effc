"""Groups of runs: trained seed by seed, resumed, evaluated and compared as one, and listed from their
files."""

from __future__ import annotations

import json
import os
import shutil
import signal
from dataclasses import replace
from functools import partial
from pathlib import Path
from statistics import fmean

import pytest
import stand_in
from stand_in import hyper

from deepbots_cli.analysis.changes import scenario_changes
from deepbots_cli.cli import main
from deepbots_cli.cli.gates import Gates
from deepbots_cli.cli.sources import open_source
from deepbots_cli.document import Permissions
from deepbots_cli.errors import RunError, UsageError
from deepbots_cli.learning import (
    TrainingResult,
    compare,
    evaluate,
    evaluate_group,
    resume_group,
    train,
    train_group,
)
from deepbots_cli.learning.campaigns.group import Group, GroupTraining
from deepbots_cli.learning.campaigns.listing import list_runs, read_listed, sort_runs
from deepbots_cli.learning.comparison import GroupDifference
from deepbots_cli.learning.report import Reporter, TrainingProgress
from deepbots_cli.learning.runs.directories import run_lock
from deepbots_cli.learning.runs.records import short_settings
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.learning.runs.statistics import compare_seeds, interquartile_mean, mean_interval
from deepbots_cli.program import Program
from deepbots_cli.program.task import Solved, Training
from deepbots_cli.rollout import Episode

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
    run = open_source(str(trained_group.group / "seed-0"), (), Permissions())
    assert scenario_changes(group, run) == []
    with pytest.raises(UsageError, match="is a group, which cannot be changed after the training"):
        open_source(str(trained_group.group), ("track=1 m",), Permissions())


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
    assert listed.state == "interrupted"
    assert [run.state for run in listed.runs] == ["finished", "interrupted"]
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

    longer = resume_group(group, total_timesteps=400, on_seed=end_after_one, build=stand_in.build)
    assert longer.waiting == (1,)
    resume_group(group, build=stand_in.build)
    assert [Run.open(group / f"seed-{seed}").record.total_timesteps for seed in (0, 1)] == [400, 400]
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


def test_a_seed_that_diverges_does_not_end_the_others(tmp_path: Path) -> None:
    training = train_group(
        SCENARIO,
        (0, 1),
        group=tmp_path / "group",
        build=lambda program, render_mode=None: stand_in.Failing(program),
    )
    assert training.trained == ()
    assert sorted(training.failed) == [0, 1]
    assert "is not finite" in training.failed[0]
    assert read_listed(tmp_path / "group").state == "failed"


def test_ctrl_c_while_a_seed_is_set_up_leaves_a_group_to_go_on_with(tmp_path: Path) -> None:
    def build(program: Program, *, render_mode: str | None = None) -> stand_in.CartPole:
        first = tmp_path / "group" / "seed-0"
        if first.exists() and Run.open(first).record.status == "finished":
            raise KeyboardInterrupt
        return stand_in.build(program)

    training = train_group(SCENARIO, (0, 1), group=tmp_path / "group", build=build)
    assert training.waiting == (1,)
    assert resume_group(tmp_path / "group", build=stand_in.build).waiting == ()


def test_a_group_that_cannot_be_trained_leaves_nothing_behind(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no stage"):
        train_group(SCENARIO, (0, 1), runs=tmp_path, stage="late", build=stand_in.build)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(UsageError, match="expected 1 to 1000 different seeds"):
        train_group(SCENARIO, (1, 1), runs=tmp_path, build=stand_in.build)


def test_a_group_is_evaluated_by_one_score_per_seed(trained_group: GroupTraining) -> None:
    evaluation = evaluate_group(trained_group.group, episodes=6, build=stand_in.build)
    starts = [[episode.seed for episode in result.outcomes] for result in evaluation.evaluations]
    assert starts[0] == starts[1] == starts[2]
    assert evaluation.returns == [result.mean_return for result in evaluation.evaluations]
    assert evaluation.mean_return == fmean(evaluation.returns)
    assert evaluation.return_interval == mean_interval(evaluation.returns)
    assert evaluation.interquartile_mean == interquartile_mean(evaluation.returns)
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
    verdict = GroupDifference(
        "wide", "narrow", "mean_return", equal, None, between_seeds=True, solved_after=steps
    ).verdict
    assert verdict.startswith(
        "narrow: the same mean return as wide in every run, so neither is better; it is solved after 19,600 more"
        " steps of training (95 % interval "
    )


def test_variants_that_see_something_else_are_compared_in_their_own_scenarios(
    trained_group: GroupTraining, tmp_path: Path
) -> None:
    variant = train(
        stand_in.compiled(training=SHORT, speed_range=1.0), run=tmp_path / "other", build=stand_in.build
    ).run
    comparison = compare([trained_group.group / "seed-0", variant], episodes=4, build=stand_in.build)
    assert comparison.scenario is None
    assert any("observation.speed" in note for note in comparison.notes)
    assert not any("rewards differ" in note for note in comparison.notes)


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
    assert listed.mean_return == pytest.approx(fmean(_returns(run_copy)[-100:]))
    assert listed.cpu_seconds is not None
    with (run_copy / "monitor.csv").open("a") as log:
        log.write("12.0,12")  # a line that is being written
    assert read_listed(run_copy).episodes == listed.episodes


def _returns(run: Path) -> list[float]:
    return [float(line.split(",")[0]) for line in (run / "monitor.csv").read_text().splitlines()[2:]]


def test_the_list_shows_the_longest_evaluation_in_the_scenario_of_the_training(run_copy: Path) -> None:
    assert read_listed(run_copy).score == "training"
    plain = evaluate(run_copy, episodes=3, build=stand_in.build)
    run = Run.open(run_copy)
    run.write_evaluation(plain.model_dump(mode="json"))
    run.write_evaluation(plain.model_dump(mode="json") | {"mean_return": 1e6, "set": ["world.substeps=2"]})
    run.write_evaluation(plain.model_dump(mode="json") | {"mean_return": 1e6, "model": "last"})
    (run_copy / "evaluations" / "0009.json").write_text("{")
    listed = read_listed(run_copy)
    assert listed.score == "evaluation"
    assert listed.mean_return == plain.mean_return
    assert listed.return_interval == plain.return_interval
    run.write_evaluation(
        plain.model_dump(mode="json") | {"mean_return": 1e6, "episodes": 2}
    )  # such as one that a gate has stopped early
    listed = read_listed(run_copy)
    assert (listed.mean_return, listed.evaluated_episodes) == (plain.mean_return, 3)


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


def test_scenarios_of_the_same_name_are_listed_with_their_files(
    run_copy: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["runs", str(run_copy.parent)]) == 0
    assert "stand_in (" not in capsys.readouterr().out
    copy = shutil.copytree(run_copy, run_copy.parent / "other")
    record = json.loads((copy / "run.json").read_text())
    (copy / "run.json").write_text(json.dumps(record | {"source": "tasks/other.yaml"}))
    assert main(["runs", str(run_copy.parent)]) == 0
    output = capsys.readouterr().out
    assert "stand_in (stand_in.yaml)" in output
    assert "stand_in (other.yaml)" in output


def test_runs_in_folders_of_the_same_name_are_compared_under_their_paths(
    run_copy: Path, tmp_path: Path
) -> None:
    copy = shutil.copytree(run_copy, tmp_path / "second" / run_copy.name)
    comparison = compare([run_copy, copy], episodes=1, build=stand_in.build)
    assert [group.name for group in comparison.groups] == [str(run_copy), str(copy)]


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
