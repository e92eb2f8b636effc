"""Stages and levels.

* A training that goes through stages.
* A training in which each world has a level of its own.
"""

from __future__ import annotations

import itertools
import json
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import stand_in
from pydantic import ValidationError
from stand_in import hyper

from deepbots_cli import api
from deepbots_cli.api import Compiled
from deepbots_cli.cli import main
from deepbots_cli.cli.records import evaluation_text, training_text
from deepbots_cli.errors import EngineError, RunError, UsageError
from deepbots_cli.learning import TrainingResult, evaluate, resume, train
from deepbots_cli.learning.runs.curriculum import Curriculum, CurriculumState, LevelSpread
from deepbots_cli.learning.shards import outcomes_of
from deepbots_cli.program import Program
from deepbots_cli.program.task import SUCCESS, Criterion, Levels, Solved, Training
from deepbots_cli.rollout import Episode
from tests.commands import Deepbots
from tests.few import few
from tests.learning.interruption import At, monitor_rows, outcome

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
    curriculum = Curriculum(staged(Criterion("success_rate", 0.5, 4), None, success=True).program)
    outcomes = [True, True, False, False, True]  # two of four at the fourth
    begun = [
        curriculum.add(Episode(0.0, 10, good, None), 10 * n, n) for n, good in enumerate(outcomes[:4], 1)
    ]
    assert (begun, curriculum.name) == ([False, False, False, True], "b")
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
    assert (parts.status, [done.name for done in parts.stages]) == ("interrupted", ["a"])
    again = resume(parts.run, build=stand_in.build)
    assert (again.inexact, again.stages, again.weights_digest) == ((), whole.stages, whole.weights_digest)


def test_an_evaluation_below_the_criterion_begins_no_stage_and_is_kept_by_a_checkpoint() -> None:
    program = staged(Criterion("success_rate", 0.6, None), None, success=True).program
    curriculum, again = Curriculum(program), Curriculum(program)
    assert (
        curriculum.add(Episode(0.0, 10, True, None), 10, 1) is False
    )  # episodes of the training do not count
    assert curriculum.add_evaluation(0.0, 0.55, 20, 2) is False
    again.restore(CurriculumState.model_validate_json(curriculum.state().model_dump_json()), [0])
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


@pytest.mark.slow
def test_a_training_may_begin_in_a_later_stage_and_stays_there_when_it_is_resumed(tmp_path: Path) -> None:
    result = learned(tmp_path, staged(SHORT, LONG, None), stage="b", total_timesteps=96)
    assert ({row["stage"] for row in monitor_rows(result.run)}, result.stage) == ({"b"}, "b")
    assert result.stages == ()
    again = resume(result.run, total_timesteps=900, build=stand_in.build)
    assert ([row["stage"] for row in monitor_rows(result.run)][-1], again.stage) == ("c", "c")
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
        Curriculum(staged(SHORT, None).program).restore(CurriculumState.model_validate(state), [0])


SCENARIO = Path(__file__).parents[1] / "data" / "scenarios" / "levels.yaml"
ENGINES = [
    pytest.param("pybullet", id="single worlds", marks=pytest.mark.slow),
    pytest.param("mujoco", id="batch"),
]


def compiled(*overrides: str) -> Compiled:
    return api.compile(SCENARIO, overrides=overrides)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., TrainingResult]:
    """Trains once in an engine and in shards; the runs are not to be changed."""

    @cache
    def train_whole(engine: str = "mujoco", shards: int = 1) -> TrainingResult:
        task = compiled(f"train.shards={shards}")
        return train(task, run=tmp_path_factory.mktemp("whole") / "run", engine=engine)

    return train_whole


def levels_of(compiled: Compiled) -> Levels:
    levels = compiled.program.levels
    assert levels is not None
    return levels


def rule(count: int = 5, *, is_random_at_top: bool = False, start: tuple[int, int] = (0, 0)) -> Levels:
    values = (("level", tuple(map(float, range(count)))),)
    return Levels(count, values, start, frozenset({"won"}), frozenset({"lost"}), is_random_at_top)


def none_drawn() -> int:
    raise AssertionError("nothing is random here")


def path_of(levels: Levels, outcomes: list[str], level: int = 0, draw: Any = none_drawn) -> list[int]:
    """The levels of the episodes with these outcomes, and of the next one."""
    visited = [level]
    for each in outcomes:
        visited.append(levels.next(visited[-1], [each], draw))
    return visited


def test_after_the_highest_level_a_random_one_follows() -> None:
    numbers = iter([12, 3])
    path = path_of(rule(is_random_at_top=True), ["won", "won", "won", "won"], 4, lambda: next(numbers))
    assert path == [4, 2, 3, 4, 3]


def test_if_one_copy_of_a_robot_fails_the_world_is_one_level_lower() -> None:
    assert rule().next(2, ["won", "lost"], none_drawn) == 1


def test_the_first_levels_are_spread_evenly_over_the_worlds() -> None:
    levels = rule(start=(1, 3))
    assert [levels.first(world) for world in range(7)] == [1, 2, 3, 1, 2, 3, 1]


def test_every_path_changes_by_one_at_a_time_and_stays_within_the_levels() -> None:
    """All outcomes of five episodes, from every level."""
    levels = rule(3)
    steps = {"won": 1, "lost": -1, "max_steps": 0}
    for first, outcomes in itertools.product(range(3), itertools.product(steps, repeat=5)):
        path = path_of(levels, list(outcomes), first)
        for before, each, after in zip(path[:-1], outcomes, path[1:], strict=True):
            assert after == min(max(before + steps[each], 0), 2)


def test_the_outcome_of_an_episode_is_its_ending() -> None:
    assert outcomes_of(Episode(0.0, 3, True, "arrived"), ["arrived"]) == ["arrived"]
    assert outcomes_of(Episode(0.0, 3, True, "max_steps"), []) == [SUCCESS]  # a goal that was reached
    assert outcomes_of(Episode(0.0, 3, False, "max_steps"), []) == ["max_steps"]
    assert outcomes_of(Episode(0.0, 3, False, "another_copy"), []) == []


@pytest.mark.parametrize("up", ["success", "max_steps"])
def test_a_limit_that_is_a_success_raises_the_level(up: str) -> None:
    limit = "truncation={max_steps: {limit: 5, success: all}}"
    task = compiled(limit, f"curriculum.up={up}", "curriculum.down=fallen")
    (outcome_at_limit,) = outcomes_of(Episode(0.0, 5, True, "max_steps"), task.program.agent.success)
    assert outcome_at_limit in levels_of(task).up
    by_endings = compiled(limit, "curriculum.up=termination", "curriculum.down=max_steps")
    assert outcome_at_limit not in levels_of(by_endings).up


def test_the_levels_divide_the_range_of_each_parameter_evenly() -> None:
    both = compiled("parameters.size=uniform(1 .. 5 cm)", "curriculum.set={level: 0 .. 5, size: 4 .. 1.5 cm}")
    levels = levels_of(both)
    assert levels.settings(0, 0) == {"level": 0.0, "size": pytest.approx(0.04)}
    assert levels.settings(0, 2) == {"level": 2.0, "size": pytest.approx(0.03)}
    assert levels.settings(3, 5) == {"level": 5.0, "size": pytest.approx(0.015)}


def test_worlds_have_the_values_of_a_parameter_in_turn_and_each_of_them_all_first_levels() -> None:
    kinds = compiled(
        "parameters.kind=choice(0 | 0 | 1 | 2)", "curriculum.per_world=kind", "curriculum.start=0 .. 2"
    )
    levels = levels_of(kinds)
    assert [levels.settings(world, 0)["kind"] for world in range(9)] == [0, 0, 1, 2, 0, 0, 1, 2, 0]
    assert [levels.first(world) for world in range(13)] == [0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 0]


@pytest.mark.parametrize("engine", few(["pybullet", "mujoco"], ["mujoco"]))
def test_each_world_has_one_value_of_a_parameter(tmp_path: Path, engine: str) -> None:
    """Kind 0 goes up a level with each episode, and kind 1 stays: its mark is out of reach."""
    task = compiled(
        "train.shards=2",
        "parameters.kind=integer(0 .. 1)",
        "parameters.mark=1 cm + 5 mm * level + 10 m * kind",
        "curriculum.per_world=kind",
        "curriculum.at_top=stay",
        "curriculum.down=fallen",
        "curriculum.start=0",
        "action={drive: {choices: {forward: 1, fast: 1}}}",
    )
    result = train(task, run=tmp_path / "run", engine=engine)
    drawn = [json.loads(row["drawn"]) for row in monitor_rows(result.run)]
    levels = {kind: {entry["level"] for entry in drawn if entry["kind"] == kind} for kind in (0, 1)}
    assert max(levels[0]) > 2
    assert levels[1] == {0}
    assert result.levels is not None
    assert result.levels.by_value == {"kind=0": 2 * result.levels.mean, "kind=1": 0.0}
    assert f"{2 * result.levels.mean:.2f} with kind=0, 0.00 with kind=1" in training_text(result)


def test_groups_of_endings_are_the_endings_of_the_scenario() -> None:
    levels = levels_of(compiled("curriculum.down=[failure, truncation]"))
    assert levels.up == frozenset({"arrived"})
    assert levels.down == frozenset({"fallen", "off_track", "max_steps"})


def drawn_level(row: dict[str, str]) -> int:
    return int(json.loads(row["drawn"])["level"])


@pytest.mark.parametrize("engine", ENGINES)
def test_each_world_follows_its_own_episodes(tmp_path: Path, engine: str) -> None:
    """With one world, the order of the log is that of its episodes."""
    task = compiled("train.environments=1", "train.total_timesteps=512", "curriculum.at_top=stay")
    rows = monitor_rows(train(task, run=tmp_path / "run", engine=engine).run)
    levels = levels_of(task)
    visited = [drawn_level(row) for row in rows]
    assert visited[0] == 0
    assert len(set(visited)) > 2
    for before, row, after in zip(visited, rows, visited[1:], strict=False):
        assert after == levels.next(before, [row["ended_by"]], none_drawn)


@pytest.mark.parametrize(
    ("engine", "shards"),
    [
        pytest.param("mujoco", 1, id="batch", marks=pytest.mark.slow),
        pytest.param("mujoco", 2, id="batches", marks=pytest.mark.slow),
        pytest.param("pybullet", 1, id="single worlds", marks=pytest.mark.slow),
        pytest.param("pybullet", 2, id="shards of single worlds", marks=pytest.mark.slow),
    ],
)
def test_a_resumed_training_is_one_without_interruption_to_the_bit(
    tmp_path: Path, engine: str, shards: int, whole: Callable[..., TrainingResult]
) -> None:
    expected = whole(engine, shards).run
    task = compiled(f"train.shards={shards}")
    parts = train(task, run=tmp_path / "parts", engine=engine, progress=At(400))
    assert parts.status == "interrupted"
    again = resume(parts.run)
    assert (again.inexact, {drawn_level(row) for row in monitor_rows(expected)}) == ((), {0, 1, 2, 3, 4, 5})
    uninterrupted, resumed = outcome(expected), outcome(again.run)
    for part in uninterrupted:
        assert resumed[part] == uninterrupted[part], part


@pytest.mark.slow
def test_the_levels_do_not_depend_on_the_number_of_shards(tmp_path: Path) -> None:
    """All robots take the same actions: with random ones, the two trainings would differ for that reason
    alone."""
    task = {
        shards: compiled(
            f"train.shards={shards}",
            "action={drive: {choices: {forward: 1, fast: 1}}}",
            "train.total_timesteps=512",
        )
        for shards in (1, 2)
    }
    runs = [train(task[shards], run=tmp_path / str(shards)).run for shards in (1, 2)]
    single_shard, two_shards = (
        [(row["ended_by"], row["l"], row["drawn"]) for row in monitor_rows(run)] for run in runs
    )
    assert (single_shard, {drawn_level(row) for row in monitor_rows(runs[0])}) == (two_shards, set(range(6)))


def test_results_show_the_levels_and_an_evaluation_draws_all(
    whole: Callable[..., TrainingResult], deepbots: Deepbots
) -> None:
    result = whole()
    assert isinstance(result.levels, LevelSpread)
    assert 0 <= result.levels.lowest <= result.levels.mean <= result.levels.highest < 6
    assert str(result.levels) in training_text(result)
    scalars = outcome(result.run)["scalars"]
    assert scalars["curriculum/mean_level"][-1][1] == pytest.approx(result.levels.mean)
    evaluation = evaluate(result.run, episodes=60)
    assert {episode.drawn["level"] for episode in evaluation.outcomes} == set(range(6))
    assert json.loads(deepbots("runs", result.run, "--json").out)["mean_level"] == result.levels.mean


@pytest.mark.parametrize("engine", few(["pybullet", "mujoco"], ["mujoco"]))
def test_a_world_with_copies_of_a_robot_has_one_level(tmp_path: Path, engine: str) -> None:
    task = api.compile(
        "multi_cartpole",
        overrides=[
            "parameters.level=integer(0 .. 2)",
            "parameters.fall_angle=15 deg - 2 deg * level",
            "curriculum={set: {level: 0 .. 2}, levels: 3, up: fallen, down: max_steps}",
            "train={algorithm: PPO, total_timesteps: 600, environments: 2, n_steps: 50, batch_size: 50}",
        ],
    )
    result = train(task, run=tmp_path / "run", engine=engine)
    rows = monitor_rows(result.run)
    endings: dict[int, list[str]] = {}
    for row in rows:
        endings.setdefault(drawn_level(row), []).append(row["ended_by"])
    assert result.levels == LevelSpread(mean=2.0, lowest=2, highest=2, count=3)
    for level in (0, 1):
        assert endings[level].count("fallen") >= 2  # an episode in each world
        assert "another_copy" in endings[level]


def test_a_level_that_the_scenario_does_not_have_is_refused(tmp_path: Path) -> None:
    run = train(compiled(), run=tmp_path / "run", progress=At(300)).run
    (kept,) = (run / "checkpoints").glob("0*/state.json")
    state = json.loads(kept.read_text())
    state["stages"][0] = 9
    kept.write_text(json.dumps(state))
    with pytest.raises(RunError, match="stage 9"):
        resume(run)


def test_a_training_in_one_level_can_be_evaluated_in_another(
    whole: Callable[..., TrainingResult], tmp_path: Path
) -> None:
    result = train(compiled("level=3"), run=tmp_path / "run", total_timesteps=256, engine="mujoco")
    assert result.levels is None
    assert evaluate(result.run, episodes=2).episodes == 2
    of_all = shutil.copytree(whole().run, tmp_path / "all")
    assert main(["eval", str(of_all), "--set", "level=5", "--episodes", "2"]) == 0


def test_a_failure_repeats_in_the_level_of_its_world(tmp_path: Path) -> None:
    """The reward has no value in level 2."""
    from deepbots_cli.errors import EvaluationError
    from deepbots_cli.learning.environments import reproduce

    task = compiled("reward={alive: 1 / (level - 2)}", "curriculum.start=2", "train.environments=1")
    with pytest.raises(EvaluationError, match="divi"):
        train(task, run=tmp_path / "run", engine="pybullet")
    (kept,) = (tmp_path / "run" / "failures").glob("*.json")
    failure, error = reproduce(kept)
    assert failure.options == {"level": 2.0}
    assert error is not None
