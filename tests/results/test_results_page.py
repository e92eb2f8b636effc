"""The results page is what the records say, and the records are of what is asked for."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest

from deepbots_cli.document import shipped
from tests.results import asked, fingerprint, picture, records, render
from tests.results.__main__ import main
from tests.results.catalogue import experiments, reasons
from tests.results.experiment import FIRST_SEED, Bar, Evaluation, Experiment, Training
from tests.results.figures import Ahead, Crossed, Held, Solved, Tried
from tests.results.places import ROOT, Places
from tests.results.standing import Standing
from tests.results.verdicts import judge

PLACES = Places()
CURRENT = "run: python -m tests.results --render"
EXPERIMENTS = list(experiments().values())


def named(experiment: Experiment) -> str:
    return experiment.name


def test_the_page_is_what_the_records_say():
    assert PLACES.page.read_text(encoding="utf-8") == render.page(PLACES, experiments()), CURRENT


def test_the_readme_tells_figures_of_the_page():
    measured: dict[str, str] = {}
    task = ""
    for line in PLACES.page.read_text(encoding="utf-8").partition("## CartPole")[0].splitlines():
        if (cells := line.split("|"))[0] == "" and len(cells) == 7:
            task = cells[1].strip() or task
            measured[task] = measured.get(task, "") + cells[4]
    rows = re.findall(r"^\| \[(\w+)\]\(docs/results\.md#.*\| (.*) \|$", (ROOT / "README.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert [name for name, _ in rows] == ["CartPole", "PitEscape", "FindBall"]
    for name, told in rows:
        (page,) = (figures for task, figures in measured.items() if task.startswith(f"[{name}]"))
        figures = re.findall(r"[\d.]+(?: %| h| s|)", told.replace("200 of 200", "200"))
        assert figures
        assert [figure for figure in figures if figure not in page] == []


@pytest.mark.parametrize("experiment", EXPERIMENTS, ids=named)
def test_the_picture_of_a_scenario_shows_its_records_and_is_small(experiment: Experiment):
    path = PLACES.picture(experiment.name)
    assert picture.is_current(Standing.of(experiment, records.read(PLACES.record(experiment.name))), path), CURRENT
    assert not path.exists() or path.stat().st_size < 100_000


def test_every_shipped_scenario_is_measured_or_it_is_said_why_not():
    assert set(shipped.scenario_names()) == {*experiments(), *reasons()}


@pytest.mark.parametrize("experiment", EXPERIMENTS, ids=named)
def test_bars_look_at_what_is_measured(experiment: Experiment):
    baselines = {baseline.name for baseline in experiment.baselines}
    for figure in (bar.figure for bar in experiment.bars):
        if isinstance(figure, (Tried, Ahead)):
            assert figure.baseline in baselines
        if isinstance(figure, (Held, Ahead)):
            held = {evaluation.name: evaluation for evaluation in experiment.training(figure.training).evaluations}
            found = fingerprint.compiled(held[figure.evaluation].scenario or experiment.scenario)
            assert figure.case is None or figure.case in {case.name for case in found.cases}
        assert figure.training is None or figure.training in {training.name for training in experiment.trainings}


@pytest.mark.parametrize("experiment", EXPERIMENTS, ids=named)
def test_what_is_evaluated_and_tried_is_there_before_hours_of_training_are_over(experiment: Experiment):
    for training in experiment.trainings:
        for evaluation in training.evaluations:
            assert asked.evaluation(experiment, training, evaluation)
    for baseline in experiment.baselines:
        assert asked.baseline(experiment, baseline)
        option, name = baseline.options
        assert option != "--script" or fingerprint.compiled(experiment.scenario).script(name)


@pytest.mark.parametrize("experiment", EXPERIMENTS, ids=named)
def test_no_reported_seed_was_used_for_tuning(experiment: Experiment):
    assert all(seed >= FIRST_SEED for training in experiment.trainings for seed in training.seeds)


def test_a_name_that_is_neither_a_scenario_nor_a_part_is_told_with_those_there_are(capsys: pytest.CaptureFixture[str]):
    assert main(["cartpoel"]) == 2
    assert capsys.readouterr().err.startswith("there is no cartpoel; there are: cartpole, cartpole_continuous, ")


def test_what_is_missing_can_be_asked_for_without_measuring_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    places = Places(*(tmp_path / name for name in ("records", "page.md", "pictures", "runs")))
    assert main(["--list", "cartpole", "costs"], places) == 0
    assert capsys.readouterr().out.split() == ["cartpole", "11", "missing", "costs", "6", "missing"]
    assert list(tmp_path.iterdir()) == []


def hours(*values: float | None) -> dict[str, object]:
    seeds = {str(101 + i): {"solved_at": None if value is None else {"simulated_hours": value}} for i, value in enumerate(values)}
    return {"trainings": {"main": seeds}}


def verdict(bar: Bar, record: dict[str, object], seeds: int = 3) -> tuple[str, str]:
    found = judge(Experiment("cartpole", "", "", (Training(tuple(range(101, 101 + seeds))),), (bar,)), bar, record)
    return found.word, found.measured


def test_a_bar_over_all_seeds_is_missed_by_the_worst_of_them():
    bar = Bar(Solved("simulated_hours"), at_most=0.5)
    assert verdict(bar, hours(0.1, 0.2, 0.5)) == ("met", "0.5 h, the worst; 3 of 3 seeds")
    assert verdict(bar, hours(0.1, 0.2, 0.51)) == ("**missed**", "0.51 h, the worst; 2 of 3 seeds")


def test_a_seed_that_was_never_solved_misses_every_bar_on_hours():
    assert verdict(Bar(Solved("simulated_hours"), at_most=9), hours(0.1, None, 0.2)) == ("**missed**", "never, the worst; 2 of 3 seeds")
    assert verdict(Bar(Solved("simulated_hours"), at_most=9, over="mean"), hours(0.1, None, 0.2)) == ("**missed**", "never")


def test_mean_and_median_of_the_seeds_are_compared_as_such():
    record = hours(0.1, 0.2, 0.9)
    assert verdict(Bar(Solved("simulated_hours"), at_most=0.3, over="median"), record) == ("met", "0.2 h")
    assert verdict(Bar(Solved("simulated_hours"), at_most=0.3, over="mean"), record) == ("**missed**", "0.4 h")


def test_a_bar_is_open_until_all_seeds_are_measured():
    assert verdict(Bar(Solved("simulated_hours"), at_most=0.5), hours(0.1, 0.2)) == ("not measured", "2 of 3 seeds")


def test_one_seed_that_fails_is_a_miss_before_the_others_are_measured():
    told = ("**missed**", "0.6 h, the worst; 1 of 3 seeds, 2 measured")
    assert verdict(Bar(Solved("simulated_hours"), at_most=0.5), hours(0.1, 0.6)) == told
    assert verdict(Bar(Solved("simulated_hours"), at_most=0.5, over="mean"), hours(0.1, 0.6))[0] == "not measured"


def test_a_stretch_bar_is_reached_or_not_and_never_missed():
    bar = Bar(Solved("simulated_hours"), at_most=0.5, stretch=True)
    assert verdict(bar, hours(0.6), seeds=1)[0] == "not reached"
    assert verdict(bar, hours(0.4), seeds=1)[0] == "reached"


def entry(digest: str) -> dict[str, object]:
    """A seed that was measured."""
    curve = {"simulated_hours": [0.1, 0.2], "return": [10.0, 20.0], "success": [0.0, 0.0]}
    counts = {"steps": 2000, "episodes": 20, "simulated_hours": 0.2, "cpu_seconds": 9.0, "times_resumed": 0}
    rest = {"solved_at": None, "stage": None, "stages": [], "crossings": {}, "curve": curve, "evaluations": {}}
    return {"digest": digest, "command": "deepbots train cartpole --seed 101", **records.circumstances(), **counts, **rest}


def test_figures_of_an_earlier_version_of_a_scenario_are_marked_on_the_page(tmp_path: Path):
    places = Places(*(tmp_path / name for name in ("records", "page.md", "pictures", "runs")))
    bars = (Bar(Solved("simulated_hours"), at_most=0.5),)
    chosen = {"cartpole": Experiment("cartpole", "CartPole", "", (Training(),), bars)}
    digest = fingerprint.of_training("cartpole", chosen["cartpole"].training("main"))
    for measured, marked in ((digest, False), ("of another world", True)):
        records.put(places.record("cartpole"), entry(measured), "trainings", "main", "101")
        page = " ".join(render.page(places, chosen).split())
        assert ("**Measured on an earlier version of the scenario or of the experiment:** seed 101." in page) == marked
        assert ("1 of these verdicts is of an earlier version of a scenario." in page) == marked


def test_a_new_case_asks_for_an_evaluation_and_for_no_new_training(monkeypatch: pytest.MonkeyPatch):
    program = fingerprint.compiled("find_ball_random")
    fewer = replace(program, cases=program.cases[:-1])
    training = Training(evaluations=(Evaluation(),))
    before = fingerprint.of_training("find_ball_random", training), fingerprint.of_evaluation("find_ball_random", training, Evaluation())
    monkeypatch.setattr(fingerprint, "compiled", lambda scenario, sets=(): fewer)
    after = fingerprint.of_training("find_ball_random", training), fingerprint.of_evaluation("find_ball_random", training, Evaluation())
    assert after[0] == before[0]
    assert after[1] != before[1]


def test_crossings_are_of_a_metric_and_a_threshold():
    assert Crossed(0.9, "simulated_hours").key == "return 0.9"
    assert Crossed(0.9, "steps", metric="success").words == "steps until 90 % successes over 100 episodes"


def test_a_threshold_is_told_as_it_is_and_not_rounded_up():
    assert Crossed(0.987, "steps", metric="success").words == "steps until 98.7 % successes over 100 episodes"
