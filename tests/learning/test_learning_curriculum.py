"""A training that goes through stages."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
import stand_in
from pydantic import ValidationError
from stand_in import hyper

from deepbots_cli.api import Compiled
from deepbots_cli.cli.records import evaluation_text, training_text
from deepbots_cli.errors import EngineError, RunError, UsageError
from deepbots_cli.learning import TrainingResult, evaluate, resume, train
from deepbots_cli.learning.runs.curriculum import Curriculum, CurriculumState
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.program import Program
from deepbots_cli.program.task import Criterion, Solved, Training
from deepbots_cli.rollout import Episode
from tests.learning.interruption import At, monitor_rows

PPO = Training(
    "PPO",
    1_000,
    3,
    hyper(n_steps=32, batch_size=32, n_epochs=1),
)
SHORT, LONG = Criterion("mean_return", 4.5, 6), Criterion("steps", 300.0)


def staged(*untils: Criterion | None, lengths: tuple[int, ...] = (5, 8, 11, 14), **settings: Any) -> Compiled:
    """A scenario with a stage for each criterion; `lengths` has the steps of an episode in the stages `a`,
    `b`, ..."""
    stages = [
        f"  - {{name: {name}, set: {{truncation.max_steps: {length}}}{until_text(until)}}}\n"
        for name, until, length in zip("abcd", untils, lengths, strict=False)
    ]
    return stand_in.compiled(
        training=PPO, more="".join(["curriculum:\n", *stages]) if stages else "", **settings
    )


def until_text(until: Criterion | None) -> str:
    if until is None:
        return ""
    if until.metric == "steps":
        return f", until: {until.threshold:g} steps"
    counted = "in evaluation" if until.episodes is None else f"over {until.episodes} episodes"
    return f", until: {until.metric} >= {until.threshold:g} {counted}"


def learned(
    tmp_path: Path, compiled: Compiled, build: Any = stand_in.build, **settings: Any
) -> TrainingResult:
    return train(compiled, run=tmp_path / "run", build=build, **settings)


@pytest.fixture(scope="module")
def through(tmp_path_factory: pytest.TempPathFactory) -> TrainingResult:
    """A training through three stages; not to be changed."""
    return learned(tmp_path_factory.mktemp("through"), staged(SHORT, LONG, None))


def test_each_copy_goes_on_to_the_next_stage_when_its_episode_has_ended(through: TrainingResult) -> None:
    result = through
    log = monitor_rows(through.run)
    assert {stage: {int(row["l"]) for row in log if row["stage"] == stage} for stage in "abc"} == {
        "a": {5},
        "b": {8},
        "c": {11},
    }
    # The sixth episode is the second of the last copy; the other two had begun their third by then.
    assert [row["stage"] for row in log[:9]] == ["a"] * 8 + ["b"]
    assert [(end.name, end.steps, end.episodes, end.value) for end in result.stages[:1]] == [
        ("a", 30, 6, 5.0)
    ]
    assert result.stages[1].steps >= 330
    assert result.stage == "c"
    assert "stage a" in training_text(result)


def test_the_criterion_asks_for_its_number_of_episodes_in_a_row() -> None:
    program = staged(Criterion("success_rate", 0.5, 4), None, success=True).program
    curriculum = Curriculum(program)
    outcomes = [True, True, False, False, True]  # two of four at the fourth
    begun = [
        curriculum.add(Episode(0.0, 10, good, None), 10 * n, n) for n, good in enumerate(outcomes[:4], 1)
    ]
    assert begun == [False, False, False, True]
    assert curriculum.name == "b"
    assert curriculum.is_last is True
    assert curriculum.value(40) is None
    assert curriculum.add(Episode(0.0, 10, True, None), 50, 5) is False


@pytest.mark.slow
def test_a_stage_that_counts_evaluations_ends_with_one_and_resumes_to_the_bit(tmp_path: Path) -> None:
    evaluated = [Criterion("mean_return", length - 0.5, None) for length in (2, 3)]
    compiled = staged(*evaluated, None, lengths=(2, 3, 4), solved=Solved(5, mean_return=4.5))
    whole = learned(tmp_path, compiled, total_timesteps=1400)
    log = [
        json.loads(line) for line in (whole.run / "evaluations" / "training.jsonl").read_text().splitlines()
    ]
    assert [line["stage"] for line in log] == ["a", "b", "c"]
    assert [(done.name, done.value, done.steps) for done in whole.stages] == [
        ("a", 2.0, log[0]["steps"]),
        ("b", 3.0, log[1]["steps"]),
    ]
    parts = train(
        compiled, run=tmp_path / "parts", build=stand_in.build, total_timesteps=1400, progress=At(501)
    )
    assert parts.status == "interrupted"
    assert [done.name for done in parts.stages] == ["a"]
    again = resume(parts.run, build=stand_in.build)
    assert (again.inexact, again.stages, again.weights_digest) == ((), whole.stages, whole.weights_digest)


def test_an_evaluation_below_the_criterion_begins_no_stage_and_is_kept_by_a_checkpoint() -> None:
    program = staged(Criterion("success_rate", 0.6, None), None, success=True).program
    curriculum, again = Curriculum(program), Curriculum(program)
    assert (
        curriculum.add(Episode(0.0, 10, True, None), 10, 1) is False
    )  # episodes of the training do not count
    assert curriculum.add_evaluation(0.0, 0.55, 20, 2) is False
    again.restore(CurriculumState.model_validate_json(curriculum.state().model_dump_json()))
    assert again.describe(20) == "a (1 of 2): success rate in evaluation 0.55 of 0.6"
    assert again.add_evaluation(0.0, 0.6, 30, 3) is True
    assert again.name == "b"


def test_returns_of_one_stage_do_not_count_in_the_next(tmp_path: Path) -> None:
    result = learned(tmp_path, staged(SHORT, None, solved=Solved(5, mean_return=4.0), max_steps=8))
    assert result.solved_at is not None
    log = monitor_rows(result.run)
    first = next(index for index, row in enumerate(log) if row["stage"] == "b")
    assert (
        result.solved_at.episode >= first + 5
    )  # five episodes of the last stage, though any five had the return
    assert result.best is not None
    assert result.best.mean_return == 8.0


def test_a_resumed_training_goes_on_in_its_stage(tmp_path: Path) -> None:
    result = learned(tmp_path, staged(SHORT, None), total_timesteps=96)
    assert result.stage == "b"
    before = len(monitor_rows(result.run))
    again = resume(result.run, total_timesteps=300, build=stand_in.build)
    assert {row["stage"] for row in monitor_rows(result.run)[before:]} == {"b"}
    assert again.stages == result.stages


@pytest.mark.slow
def test_a_training_may_begin_in_a_later_stage_and_stays_there_when_it_is_resumed(tmp_path: Path) -> None:
    result = learned(tmp_path, staged(SHORT, LONG, None), stage="b", total_timesteps=96)
    assert {row["stage"] for row in monitor_rows(result.run)} == {"b"}
    assert result.stage == "b"
    assert result.stages == ()
    again = resume(result.run, total_timesteps=900, build=stand_in.build)
    assert [row["stage"] for row in monitor_rows(result.run)][-1] == "c"
    assert again.stage == "c"
    assert [end.name for end in again.stages] == ["b"]


def test_a_killed_training_that_had_learned_nothing_begins_anew_in_its_first_stage(tmp_path: Path) -> None:
    run = learned(tmp_path, staged(SHORT, None), stage="b", total_timesteps=96).run
    for folder in (run / "checkpoints", run / "models" / "agent"):
        shutil.rmtree(folder)
        folder.mkdir()
    (run / "monitor.csv").unlink()
    (run / "run.json").write_text(
        json.dumps(json.loads((run / "run.json").read_text()) | {"status": "running"})
    )
    resume(run, build=stand_in.build)
    assert {row["stage"] for row in monitor_rows(run)} == {"b"}


@pytest.mark.parametrize(
    ("untils", "message"),
    [((SHORT, None), "has no stage 'z'.*there are: a, b"), ((), "has no stages, so there is no 'z'")],
)
def test_a_stage_that_does_not_exist_is_refused_before_there_is_a_run(
    tmp_path: Path, untils: tuple[Criterion, ...], message: str
) -> None:
    with pytest.raises(UsageError, match=message):
        learned(tmp_path, staged(*untils), stage="z")
    assert not (tmp_path / "run").exists()


def test_a_last_stage_with_settings_of_its_own_is_confirmed_in_the_scenario(tmp_path: Path) -> None:
    result = learned(tmp_path, staged(LONG, None, lengths=(5, 14), solved=Solved(20, mean_return=13.0)))
    assert result.solved_at is not None
    assert result.solved_at.mean_return > 14.0  # the most that an episode of the last stage returns
    assert result.best is not None
    assert result.best.mean_return == result.solved_at.mean_return


def test_the_same_seed_goes_the_same_way(through: TrainingResult, tmp_path: Path) -> None:
    again = learned(tmp_path, staged(SHORT, LONG, None))
    assert again.weights_digest == through.weights_digest
    assert again.stages == through.stages


def test_an_evaluation_says_when_the_training_did_not_come_to_the_last_stage(tmp_path: Path) -> None:
    result = learned(tmp_path, staged(SHORT, Criterion("mean_return", 100.0, 5), None))
    evaluation = evaluate(result.run, episodes=2, build=stand_in.build)
    assert evaluation.greatest_return > 11  # the scenario itself, not the stage
    assert "the training ended in stage b, number 2 of 3" in evaluation_text(evaluation)
    assert json.loads(json.dumps(result.model_dump(mode="json")))["stage"] == "b"


def test_a_stage_that_cannot_be_built_is_found_before_there_is_a_run(tmp_path: Path) -> None:
    def build(program: Program, *, render_mode: str | None = None) -> Any:
        if program.truncation.max_steps == 11:
            raise EngineError("no such world")
        return stand_in.build(program)

    with pytest.raises(EngineError):
        learned(tmp_path, staged(SHORT, LONG, None), build)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    "state",
    [
        {},
        {"ends": [{}], "first_step": 0, "recent": []},
        {"ends": [{"name": "a", "steps": 1, "episodes": 1, "value": 1.0}] * 2, "first_step": 0, "recent": []},
        {"ends": [], "first_step": -1, "recent": []},
        {"ends": [], "first_step": 0, "recent": ["much"]},
        {"ends": 3, "first_step": 0, "recent": []},
    ],
)
def test_a_checkpoint_that_does_not_fit_is_refused(state: dict[str, Any]) -> None:
    with pytest.raises((RunError, ValidationError)):
        Curriculum(staged(SHORT, None).program).restore(CurriculumState.model_validate(state))


def test_a_forged_run_whose_stages_never_end_is_refused(tmp_path: Path) -> None:
    run = learned(tmp_path, staged(SHORT, None), total_timesteps=96).run
    resolved = run / "resolved.yaml"
    resolved.write_text(resolved.read_text().replace("until:", "nothing:", 1))
    with pytest.raises(RunError, match="does not compile"):
        Run.open(run)
