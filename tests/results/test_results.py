"""The pages of results are what the records say, the records are of what is asked for, and a measurement that
is stopped goes on."""

from __future__ import annotations

import json
import math
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from itertools import chain
from pathlib import Path
from statistics import fmean, median
from typing import Any

import numpy as np
import pytest

from deepbots_cli.cli import main as deepbots
from deepbots_cli.document import shipped
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.learning.runs.statistics import mean_interval
from tests.few import few
from tools import gallery_pictures
from tools.benchmarks import robot_files
from tools.results import measure, page, picture
from tools.results.__main__ import main
from tools.results.card import card
from tools.results.experiment import (
    FIRST_SEED,
    RANDOM,
    Ahead,
    Bar,
    Baseline,
    Crossed,
    Evaluation,
    Experiment,
    Held,
    Solved,
    Trained,
    Training,
    Tried,
    experiments,
)
from tools.results.experiments.not_measured import REASONS
from tools.results.measure import ROOT, Places
from tools.results.parts import PARTS, Holding
from tools.results.standing import Standing, judge, quartiles, together

PLACES = Places()
CURRENT = "run: python -m tools.results --render"
EXPERIMENTS = list(experiments().values())


def test_the_page_is_what_the_records_say():
    assert PLACES.page.read_text(encoding="utf-8") == page.results(PLACES, experiments()), CURRENT


def test_the_summary_of_robots_that_were_tried_is_that_of_the_record():
    text = robot_files.PAGE.read_text(encoding="utf-8")
    assert text == robot_files.filled(text, whole=False), "run: python -m tools.benchmarks.robot_files --page"


def test_the_studio_shows_the_measured_times_of_trainings():
    times = json.loads(gallery_pictures.TIMES.read_text(encoding="utf-8"))
    assert times == gallery_pictures.training_times(), "run: python -m tools.gallery_pictures"
    assert {"cartpole", "quadruped", "find_ball"} <= times.keys() <= {*shipped.scenario_names()}


@pytest.mark.parametrize(
    "holding",
    [table for part in PARTS for table in part.tables if isinstance(table, Holding)],
    ids=lambda holding: holding.name,
)
def test_what_holds_is_shown_by_tests_that_exist(holding: Holding):
    files = chain(ROOT.glob(holding.folder), (ROOT / holding.folder).rglob("*.py"))
    tests = "\n".join(
        [f"def {page.stem}" for page in (ROOT / "tests" / "golden").rglob("*.md")]
        + [path.read_text() for path in files if path.is_file()]
    )
    assert all(re.search(rf"def \w*{name}", tests) for name in holding.expression.split(" or "))


def test_readme_figures_equal_the_cards():
    rows = re.findall(
        r"^\| \[(\w+)\]\(docs/scenarios/(\w+)\.md\).*\| (.*) \|$",
        (ROOT / "README.md").read_text(encoding="utf-8"),
        re.MULTILINE,
    )
    assert [name for name, _, _ in rows] == ["CartPole", "PitEscape", "FindBall"]
    for _, name, row in rows:
        standing = Standing.of(experiments()[name], measure.read(PLACES.record(name)))
        numbers = " ".join(verdict.measured for verdict in standing.verdicts())
        figures = re.findall(r"[\d.]+(?: %| h\b| s\b|)", row.replace("200 of 200", "200"))
        assert figures
        assert [figure for figure in figures if figure not in numbers] == []


def test_the_table_beside_the_paper_has_its_tasks_and_the_median_quartiles_and_worst_of_all_seeds():
    text = PLACES.page.read_text(encoding="utf-8").partition("## Beside the paper")[2].partition("\n## ")[0]
    rows = [
        [cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines() if line.startswith("|")
    ][2:]
    assert [row[0].partition("]")[0] for row in rows if row[0]] == ["[CartPole", "[PitEscape", "[FindBall"]
    assert [
        row for row in rows if not re.fullmatch(r"\S+( %)? \.\. \S+( %)?", row[4]) or not row[6].isdigit()
    ] == []


@pytest.mark.parametrize("values", [[5.0], [1.0, 2.0, 3.0, 4.0, 5.0], [float(n) for n in range(1, 22)]])
def test_quartiles_are_those_of_the_seeds(values: list[float]):
    assert quartiles(values) == pytest.approx(np.percentile(values, [25, 50, 75]), abs=0.51)
    assert quartiles(values)[1] == median(values)


def test_a_seed_that_is_never_solved_is_the_upper_quartile_of_two():
    assert quartiles([0.2, math.inf]) == (0.2, math.inf, math.inf)


def test_episodes_of_several_policies_count_as_one_evaluation():
    returns = [[1.0, 2.0, 4.0], [5.0, 5.0, 8.0, 9.0], [3.0, 3.0]]
    assert together([_evaluated(values) for values in returns])["return_interval"] == pytest.approx(
        mean_interval([*chain(*returns)])
    )
    assert together([_evaluated(returns[0])]) == _evaluated(returns[0])


def _evaluated(values: list[float]) -> dict[str, Any]:
    return {
        "episodes": len(values),
        "success_defined": False,
        "successes": None,
        "mean_return": fmean(values),
        "return_interval": mean_interval(values),
        "least_return": min(values),
        "greatest_return": max(values),
        "endings": {"fallen": len(values)},
    }


def test_the_pictures_show_the_records_and_are_small():
    for experiment in EXPERIMENTS:
        path = PLACES.picture(experiment.name)
        record = Standing.of(experiment, measure.read(PLACES.record(experiment.name))).record
        assert picture.is_current(experiment, record, path), CURRENT
        assert not path.exists() or path.stat().st_size < 100_000


def test_every_shipped_scenario_is_measured_or_has_a_reason_why_not():
    assert set(shipped.scenario_names()) == {*experiments(), *REASONS}


def test_bars_and_baselines_refer_to_parts_of_their_experiment():
    for experiment in EXPERIMENTS:
        baselines = {baseline.name for baseline in experiment.baselines}
        for figure in (bar.figure for bar in experiment.bars):
            if isinstance(figure, Tried | Ahead):
                assert figure.baseline in baselines
            if isinstance(figure, Held | Ahead):
                held = {
                    evaluation.name: evaluation
                    for evaluation in experiment.training(figure.training).evaluations
                }
                compiled = measure.compiled(held[figure.evaluation].scenario or experiment.scenario)
                assert figure.case is None or figure.case in {case.name for case in compiled.cases}
            assert figure.training is None or figure.training in {
                training.name for training in experiment.trainings
            }
        for *agent, option, name in (baseline.options for baseline in experiment.baselines):
            assert option == "--driver"
            if agent:  # one of several agents, with a script of this name
                program = measure.compiled(experiment.scenario)
                assert program.members[agent[1]].program.script(name)
                continue
            assert name in ("random", "zero") or measure.compiled(experiment.scenario).script(name)


def test_no_reported_seed_was_used_for_tuning():
    for experiment in EXPERIMENTS:
        assert all(seed >= FIRST_SEED for training in experiment.trainings for seed in training.seeds)


def test_an_unknown_name_is_refused_with_the_names_that_exist(
    capsys: pytest.CaptureFixture[str],
):
    assert main(["cartpoel"]) == 2
    assert capsys.readouterr().err.startswith(
        "there is no cartpoel; there are: cartpole, cartpole_continuous, "
    )


def places_in(folder: Path) -> Places:
    return Places(*(folder / name for name in ("records", "page.md", "pictures", "runs")))


def test_what_is_missing_can_be_asked_for_without_measuring_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    assert main(["--list", "cartpole", "costs"], places_in(tmp_path)) == 0
    assert capsys.readouterr().out.split() == ["cartpole", "41", "missing", "costs", "6", "missing"]
    assert list(tmp_path.iterdir()) == []


def verdict(bar: Bar, *hours: float | None, seeds: int = 3) -> tuple[str, str]:
    entries = {
        str(101 + i): {"solved_at": None if value is None else {"simulated_hours": value}}
        for i, value in enumerate(hours)
    }
    chosen = Experiment("cartpole", "", "", (Training(tuple(range(101, 101 + seeds))),), (bar,))
    judged = judge(chosen, bar, {"trainings": {"main": entries}})
    return judged.word, judged.measured


HOURS = Bar(Solved("simulated_hours"), at_most=0.5)
MEAN_HOURS = Bar(Solved("simulated_hours"), at_most=0.3, over="mean")


@pytest.mark.parametrize(
    ("bar", "hours", "expected"),
    [
        (HOURS, (0.1, 0.2, 0.5), ("met", "0.5 h, the worst; 3 of 3 seeds")),
        (HOURS, (0.1, 0.2, 0.51), ("**missed**", "0.51 h, the worst; 2 of 3 seeds")),
        (HOURS, (0.1, None, 0.2), ("**missed**", "never, the worst; 2 of 3 seeds")),
        (HOURS, (0.1, 0.2), ("not measured", "2 of 3 seeds")),
        (HOURS, (0.1, 0.6), ("**missed**", "0.6 h, the worst; 1 of 3 seeds, 2 measured")),
        (MEAN_HOURS, (0.1, 0.2, 0.9), ("**missed**", "0.4 h")),
        (MEAN_HOURS, (0.1, None, 0.2), ("**missed**", "never")),
        (replace(MEAN_HOURS, over="median"), (0.1, 0.2, 0.9), ("met", "0.2 h")),
    ],
    ids=["met", "worst", "unsolved", "open", "missed early", "mean", "mean unsolved", "median"],
)
def test_a_bar_is_judged_over_its_seeds(bar: Bar, hours: tuple[float | None, ...], expected: tuple[str, str]):
    assert verdict(bar, *hours) == expected


def test_a_mean_is_open_until_all_seeds_are_measured():
    assert verdict(MEAN_HOURS, 0.1, 0.6)[0] == "not measured"


def test_a_bar_with_a_miss_allows_one_unsolved_seed():
    bar = replace(HOURS, misses=1)
    assert verdict(bar, 0.1, None, 0.2)[0] == "met"
    assert verdict(bar, 0.1, None, 0.6)[0] == "**missed**"
    assert verdict(bar, 0.6)[0] == "not measured"


def test_a_stretch_bar_is_reached_or_not():
    bar = replace(HOURS, stretch=True)
    assert verdict(bar, 0.6, seeds=1)[0] == "not reached"
    assert verdict(bar, 0.4, seeds=1)[0] == "reached"


def test_figures_of_an_earlier_version_of_a_scenario_are_marked(tmp_path: Path):
    places = places_in(tmp_path)
    chosen = {
        "cartpole": Experiment(
            "cartpole", "CartPole", "", (Training(),), (Bar(Solved("simulated_hours"), at_most=0.5),)
        )
    }
    curve = {"simulated_hours": [0.1, 0.2], "return": [10.0, 20.0], "success": [0.0, 0.0]}
    counts = {"steps": 2000, "episodes": 20, "simulated_hours": 0.2, "cpu_seconds": 9.0, "times_resumed": 0}
    rest = {
        "solved_at": None,
        "stage": None,
        "stages": [],
        "crossings": {},
        "curve": curve,
        "evaluations": {},
    }
    request = measure.training_request("cartpole", Training(), 101)
    for digest, marked in ((request.digest, False), ("of another world", True)):
        entry = {"digest": digest, "command": request.command, **measure.circumstances(), **counts, **rest}
        measure.put(places.record("cartpole"), entry, "trainings", "main", "101")
        standing = Standing.of(chosen["cartpole"], measure.read(places.record("cartpole")))
        warning = "**Measured on an earlier version of the scenario or of the experiment:** seed 101."
        assert (warning in " ".join(card(standing).split())) == marked
        old = "1 of these verdicts is of an earlier version of a scenario."
        assert (old in page.write(places, chosen)) == marked


def test_a_new_case_asks_for_an_evaluation_and_for_no_new_training(monkeypatch: pytest.MonkeyPatch):
    def requests() -> tuple[object, object]:
        training = Training()
        name = "find_ball_random"
        return measure.training_request(name, training, 101), measure.evaluation_request(
            name, training, Evaluation()
        )

    program = measure.compiled("find_ball_random")
    before = requests()
    monkeypatch.setattr(
        measure, "compiled", lambda scenario, sets=(): replace(program, cases=program.cases[:-1])
    )
    assert requests()[0] == before[0]
    assert requests()[1] != before[1]


def logged(folder: Path, returns: list[float], stages: list[str] | None = None) -> list[measure.Point]:
    rows = [
        f"{value},5,0,{i + 1},{10 * (i + 1)},{(i + 1) / 100},{int(value > 0)},x,{stages[i] if stages else ''}"
        for i, value in enumerate(returns)
    ]
    (folder / "monitor.csv").write_text(
        "\n".join(["#{}", "r,l,t,episode,steps,simulated_hours,is_success,ended_by,stage", *rows]) + "\n"
    )
    return measure.points(folder / "monitor.csv")


def test_a_threshold_is_crossed_by_the_mean_of_a_hundred_episodes_of_the_last_stage_only(tmp_path: Path):
    curve = logged(tmp_path, [1.0] * 50 + [0.0] * 60 + [1.0] * 100)
    assert measure.crossing(curve, Crossed(0.8, "episode")) == {
        "episode": 190,
        "steps": 1900,
        "simulated_hours": 1.9,
    }
    assert measure.crossing(curve, Crossed(1.1, "episode")) is None
    curve = logged(tmp_path, [1.0] * 100 + [0.0] * 100 + [1.0] * 100, ["easy"] * 100 + ["hard"] * 200)
    assert measure.crossing(curve, Crossed(0.9, "episode"), "hard") == {
        "episode": 290,
        "steps": 2900,
        "simulated_hours": 2.9,
    }
    curve = logged(tmp_path, [1.0] * 100 + [0.0, 1.0, 0.0], ["easy"] * 100 + ["hard", "easy", "hard"])
    assert [point.mean_return for point in curve[-2:]] == [
        0.0,
        0.0,
    ]  # an episode that began in the stage before is left out
    assert not curve[-1].full


def test_a_curve_in_a_record_is_thin_and_ends_where_the_training_does(tmp_path: Path):
    thinned = measure.thinned(logged(tmp_path, [1.0] * 1234))
    assert len(thinned["return"]) <= 200
    assert thinned["simulated_hours"][-1] == 12.34


def test_crossings_are_described_with_their_exact_threshold():
    assert Crossed(0.9, "simulated_hours").key == "return 0.9"
    assert Crossed(0.987, "steps", metric="success").words == "steps until 98.7 % successes over 100 episodes"


TINY = Experiment(
    scenario="tests/data/scenarios/rail.yaml",
    title="A rod on a rail",
    prose="Too short to be learned.",
    trainings=(Training(seeds=(0,), timesteps=6_000, evaluations=(Evaluation(episodes=3),)),),
    baselines=(Baseline(RANDOM.name, RANDOM.options, episodes=3),),
    bars=(
        Bar(Trained("steps"), at_least=6_000),
        Bar(Crossed(10, "simulated_hours"), at_most=1),
        Bar(Held("mean_return"), at_least=301),
    ),
)


@pytest.mark.slow
def test_a_measurement_that_is_stopped_goes_on_and_ends_on_the_page(tmp_path: Path):
    places = places_in(tmp_path)
    training, *others = measure.pieces(TINY, places)
    folder = training.measure.args[3]()  # type: ignore[attr-defined]  # of a partial
    folder.parent.mkdir(parents=True)
    command = [
        sys.executable,
        "-m",
        "deepbots_cli",
        "train",
        TINY.scenario,
        "--seed",
        "0",
        "--timesteps",
        "6000",
        "--run",
        str(folder),
    ]
    process = subprocess.Popen(command, cwd=ROOT)
    while not list(folder.glob("checkpoints/0*")):
        time.sleep(0.05)
    process.send_signal(signal.SIGTERM)
    process.wait()
    assert Run.open(folder).record.status == "interrupted"

    for piece in (training, *others):
        assert piece.missing()
        piece.complete()
        assert not piece.missing()
    record = measure.read(places.record("rail"))
    [entry] = record["trainings"]["main"].values()
    assert entry["times_resumed"] == 1
    assert entry["steps"] >= 6_000
    assert entry["evaluations"]["held_out"]["episodes"] == record["baselines"]["random"]["episodes"] == 3

    page.write(places, {"rail": TINY})
    text = card(Standing.of(TINY, record))
    assert "| mean return, held out |" in text
    assert " s, resumed once |" in text
    assert f"state {picture.state(TINY, Standing.of(TINY, record).record)}" in places.picture(
        "rail"
    ).read_text(encoding="utf-8")
    measure.put(places.record("rail"), entry | {"evaluations": {}}, "trainings", "main", "0")
    assert [piece.missing() for piece in measure.pieces(TINY, places)] == [False, True, False]


# Tasks that a script teaches: they lint clean, and the scripts do them


TASKS = sorted((ROOT / "tools" / "results" / "teacher").glob("*.yaml"))


@pytest.mark.parametrize("task", few(TASKS, ["park"], lambda path: path.stem))
def test_a_script_does_the_task(task: Path) -> None:
    assert deepbots(["lint", str(task)]) == 0
    assert deepbots(["test", str(task)]) == 0
