"""The benchmark page is what the records say, every cell is measured or has a reason, and no figure is
without its interval."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from deepbots_cli.learning.runs.statistics import wilson
from tools.results import benchmark, measure
from tools.results.__main__ import main, measured
from tools.results.benchmark import SEEDS, TASKS, Cell, Task
from tools.results.benchmark_page import first, own_algorithm, page, return_interval, rows, success_interval
from tools.results.experiment import FIRST_SEED, Evaluation, Training, experiments
from tools.results.measure import Places

PLACES = Places()
EACH_TASK = pytest.mark.parametrize("task", TASKS, ids=lambda task: task.scenario)


def record_of(task: Task) -> dict[str, Any]:
    return measure.read(PLACES.record(task.experiment.name))


def test_no_figure_on_the_page_is_without_an_interval():
    assert "no interval" not in page(PLACES, TASKS)


def test_no_value_was_chosen_by_the_seeds():
    reported = {
        seed
        for experiment in experiments().values()
        for training in experiment.trainings
        for seed in training.seeds
    }
    assert min(SEEDS) >= FIRST_SEED
    assert reported.isdisjoint(SEEDS)


@EACH_TASK
def test_each_algorithm_is_trained_or_has_a_reason_why_not(task: Task):
    cells = {cell.algorithm: cell for cell in task.cells}
    assert {"PPO", "SAC", "TD3", "TQC", own_algorithm(task)} <= set(cells)
    for cell in task.cells:
        assert (cell.training is None) == bool(cell.reason)
        if cell.training:
            program = measure.compiled(task.scenario, cell.training.sets)
            assert program.agent.training is not None
            assert (program.agent.training.algorithm, program.engine) == (cell.algorithm, task.engine)


@EACH_TASK
def test_the_learner_of_the_scenario_has_its_own_values(task: Task):
    (cell,) = (cell for cell in task.cells if cell.algorithm == own_algorithm(task))
    assert cell.training is not None
    assert (
        measure.compiled(task.scenario, cell.training.sets).agent.training
        == measure.compiled(task.scenario).agent.training
    )


@EACH_TASK
def test_a_task_runs_on_the_engine_that_steps_it_fastest(task: Task):
    measured = record_of(task).get("engines")
    if measured is None:
        pytest.skip("its engines are not measured")
    times = measured["step_us"]
    assert times[task.engine] <= 1.1 * min(times.values())  # a tenth is noise


@EACH_TASK
def test_a_scenario_recommends_the_first_or_has_a_reason_why_not(task: Task):
    ranking = rows(task, record_of(task))
    best = first(ranking)
    whole = all(len(row.entries) == len(SEEDS) for row in ranking if row.cell.training)
    if best is None or not whole:
        pytest.skip("not all of its cells are trained with all seeds")
    assert best.is_own or task.advice


def evaluations_with(*rates: float) -> list[dict[str, Any]]:
    outcomes = ((round(100 * rate), rate) for rate in rates)
    return [
        {
            "successes": successes,
            "episodes": 100,
            "success_rate": rate,
            "mean_return": rate,
            "return_interval": [rate - 0.03, rate + 0.04],
        }
        for successes, rate in outcomes
    ]


def test_an_interval_is_over_seeds_and_over_episodes():
    assert success_interval(evaluations_with(1, 1, 1)) == wilson(300, 300)
    low, high = success_interval(evaluations_with(0.7, 0.8, 0.9))
    assert (low, high) == pytest.approx(
        (0.8 - 4.302653 * 0.1 / 3**0.5, 1.0)
    )  # Student's t for two degrees of freedom, cut at 1
    assert return_interval(evaluations_with(0.5, 0.5)) == pytest.approx(
        (0.5 - 0.03 / 2**0.5, 0.5 + 0.04 / 2**0.5)
    )
    assert return_interval(evaluations_with(0.4, 0.6)) == pytest.approx(
        (0.5 - 12.706205 * 0.1, 0.5 + 12.706205 * 0.1)
    )
    assert (
        return_interval(evaluations_with(0.5, 0.5), (0.49, 0.51))
        == return_interval(evaluations_with(0.4, 0.6), (0.49, 0.51))
        == (0.49, 0.51)
    )


def test_the_command_on_the_page_measures_what_is_missing(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["--list", "benchmark"], Places(records=tmp_path, runs=tmp_path)) == 0
    counted = re.findall(r"^(benchmark/\w+) +(\d+) missing$", capsys.readouterr().out, re.MULTILINE)
    cells = {task.experiment.name: sum(cell.training is not None for cell in task.cells) for task in TASKS}
    assert {name: int(number) for name, number in counted} == {
        name: 1 + 2 * len(SEEDS) * number for name, number in cells.items()
    }
    assert f"python -m tools.results {benchmark.GROUP}/cartpole" in page(PLACES, TASKS)


def tiny(algorithm: str) -> Cell:
    section = f"train={{algorithm: {algorithm}, total_timesteps: 2000}}"
    evaluation = Evaluation(episodes=3)
    return Cell(
        algorithm,
        Training(SEEDS[:1], algorithm, (section, "evaluation={episodes: 3}"), evaluations=(evaluation,)),
    )


@pytest.mark.slow
def test_cells_are_measured_once_and_end_on_the_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    cells = (tiny("PPO"), tiny("DQN"), Cell("SAC", None, reason="discrete actions"))
    task = Task("tests/data/scenarios/rail.yaml", "Rail", "pybullet", cells)
    places = Places(records=tmp_path, runs=tmp_path)
    assert measured(task.experiment, places) == 0
    assert capsys.readouterr().err.count(": done in") == 1 + 2 * 2
    text = page(places, [task])
    assert "0 are measured with all 3 seeds, 2 with fewer, and 0 are not measured yet." in text
    interval = r"-?[\d.]+ \(-?[\d.]+ \.\. -?[\d.]+\)"
    assert re.search(rf"^\| PPO \*? ?\| .* \| {interval} \| \d of 1 ", text, re.MULTILINE)
    assert "| SAC | discrete actions |" in text
    assert measured(task.experiment, places) == 0
    assert capsys.readouterr().err == ""
