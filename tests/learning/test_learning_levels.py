"""A training in which each world has a level of its own."""

from __future__ import annotations

import itertools
import json
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deepbots_cli import api
from deepbots_cli.api import Compiled
from deepbots_cli.cli import main
from deepbots_cli.cli.records import training_text
from deepbots_cli.errors import RunError
from deepbots_cli.learning import TrainingResult, evaluate, resume, train
from deepbots_cli.learning.runs.curriculum import LevelSpread
from deepbots_cli.learning.shards import make_worlds, outcomes_of
from deepbots_cli.program.levels import SUCCESS, Levels
from deepbots_cli.rollout import Episode
from tests.few import few
from tests.learning.interruption import At, monitor_rows, outcome

SCENARIO = Path(__file__).parents[1] / "data" / "scenarios" / "levels.yaml"
ENGINES = [pytest.param("pybullet", id="single worlds"), pytest.param("mujoco", id="batch")]


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


def test_a_world_that_always_succeeds_is_one_level_higher_after_each_episode() -> None:
    assert path_of(rule(), ["won"] * 6) == [0, 1, 2, 3, 4, 4, 4]


def test_a_world_that_always_fails_stays_in_the_lowest_level() -> None:
    assert path_of(rule(), ["lost"] * 3) == [0, 0, 0, 0]


def test_another_ending_leaves_the_level() -> None:
    assert path_of(rule(), ["won", "max_steps", "won", "lost", "not_finite"]) == [0, 1, 1, 2, 1, 1]


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
    assert outcomes_of(Episode(0.0, 3, True, "arrived")) == ["arrived"]
    assert outcomes_of(Episode(0.0, 3, True, "max_steps")) == [SUCCESS]  # a goal that was reached
    assert outcomes_of(Episode(0.0, 3, False, "max_steps")) == ["max_steps"]
    assert outcomes_of(Episode(0.0, 3, False, "another_copy")) == []


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
    rows = monitor_rows(result.run)
    drawn = [json.loads(row["drawn"]) for row in rows]
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
    result = train(task, run=tmp_path / "run", engine=engine)
    rows = monitor_rows(result.run)
    levels = levels_of(task)
    visited = [drawn_level(row) for row in rows]
    assert visited[0] == 0
    assert len(set(visited)) > 2
    for before, row, after in zip(visited, rows, visited[1:], strict=False):
        assert after == levels.next(before, [row["ended_by"]], none_drawn)


@pytest.mark.slow
def test_a_batch_gives_the_levels_of_single_worlds(whole: Callable[..., TrainingResult]) -> None:
    from contextlib import ExitStack

    from deepbots_cli.learning.environments import supervisor_factory
    from deepbots_cli.learning.runs.run import Run
    from deepbots_cli.learning.shards import WorldPlan

    run = Run.open(whole().run)
    steps: list[list[Any]] = []

    def alone(program: Any, **settings: Any) -> Any:
        """Builds worlds that cannot be a batch, since another function builds them."""
        return api.build(program, engine="mujoco", **settings)

    for build in (supervisor_factory("mujoco"), alone):
        with ExitStack() as stack:
            stages = [0, 1, 0, 1]
            plan = WorldPlan(run, build, range(4), stages, lambda: 0)
            worlds = make_worlds(
                stack,
                plan,
                on_step=lambda: None,
                on_episode=lambda world, episode, stage, drawn: None,
                next_episode=lambda: 1,
                note=lambda text: None,
            )
            trajectory = [worlds.reset().tolist()]
            generator = np.random.default_rng(0)
            for _ in range(300):
                actions = np.full(4, generator.integers(0, 2))
                trajectory.append((worlds.step_all(actions).observations.tolist(), tuple(stages)))
            assert max(max(levels) for _, levels in trajectory[1:]) == 5
            histories = worlds.histories()
        steps.append(trajectory)
        with ExitStack() as stack:
            again = make_worlds(
                stack,
                WorldPlan(run, build, range(4), list(stages), lambda: 0),
                on_step=lambda: None,
                on_episode=lambda world, episode, stage, drawn: None,
                next_episode=lambda: 1,
                note=lambda text: None,
            )
            assert again.repeat(histories).tolist() == trajectory[-1][0]
    assert type(worlds).__name__ == "SingleWorlds"
    assert steps[0] == steps[1]


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
    assert again.inexact == ()
    assert {drawn_level(row) for row in monitor_rows(expected)} == {0, 1, 2, 3, 4, 5}
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
    assert single_shard == two_shards
    assert {drawn_level(row) for row in monitor_rows(runs[0])} == set(range(6))


def test_results_show_the_levels_and_an_evaluation_draws_all(
    whole: Callable[..., TrainingResult], capsys: pytest.CaptureFixture[str]
) -> None:
    result = whole()
    assert isinstance(result.levels, LevelSpread)
    assert 0 <= result.levels.lowest <= result.levels.mean <= result.levels.highest < 6
    assert f"level           {result.levels}" in training_text(result)
    scalars = outcome(result.run)["scalars"]
    assert scalars["curriculum/mean_level"][-1][1] == pytest.approx(result.levels.mean)
    evaluation = evaluate(result.run, episodes=60)
    assert {episode.drawn["level"] for episode in evaluation.outcomes} == set(range(6))
    assert main(["runs", str(result.run), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["mean_level"] == result.levels.mean


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
    from deepbots_cli.learning.failures import reproduce

    task = compiled("reward={alive: 1 / (level - 2)}", "curriculum.start=2", "train.environments=1")
    with pytest.raises(EvaluationError, match="divi"):
        train(task, run=tmp_path / "run", engine="pybullet")
    (kept,) = (tmp_path / "run" / "failures").glob("*.json")
    failure, error = reproduce(kept)
    assert failure.options == {"level": 2.0}
    assert error is not None
