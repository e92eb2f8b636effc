"""A measurement is stopped anywhere, and goes on where it was."""

from __future__ import annotations

import json
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from deepbots_cli.learning.run import Run
from tests.results import curves, measure, picture, records, render
from tests.results.commands import Commands, StoppedError
from tests.results.experiment import RANDOM, Bar, Baseline, Evaluation, Experiment, Training
from tests.results.figures import Crossed, Held, Trained, Tried
from tests.results.places import Places
from tests.results.progress import Progress
from tests.results.standing import Standing

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
        Bar(Tried("random", "mean_return"), at_least=1),
    ),
)


@pytest.fixture
def places(tmp_path: Path) -> Places:
    return Places(*(tmp_path / name for name in ("records", "page.md", "pictures", "runs")))


def measured(places: Places, commands: Commands) -> None:
    progress = Progress(0)
    for chain in measure.chains(TINY, places):
        chain.measure(commands, progress)


def stop_when_there_is_a_checkpoint(commands: Commands, places: Places) -> None:
    while not list(places.runs.glob("rail/*/checkpoints/0*")):
        time.sleep(0.05)
    commands.stop()


@pytest.mark.slow
def test_a_measurement_that_is_stopped_goes_on_and_ends_on_the_page(places: Places):
    commands = Commands()
    stopping = threading.Thread(target=stop_when_there_is_a_checkpoint, args=(commands, places))
    stopping.start()
    with pytest.raises(StoppedError):
        measured(places, commands)
    stopping.join()
    [run] = [path.parent for path in places.runs.glob("rail/*/run.json")]
    assert Run.open(run).record.status == "interrupted"
    assert records.read(places.record("rail")) == {}

    measured(places, Commands())
    record = records.read(places.record("rail"))
    [entry] = record["trainings"]["main"].values()
    assert entry["times_resumed"] == 1
    assert entry["steps"] >= 6_000
    ledger = [float(line) for line in run.with_suffix(".cpu").read_text().split()]
    assert len(ledger) == 2  # the training in two processes
    assert entry["cpu_seconds"] == pytest.approx(sum(ledger), abs=0.1)
    assert entry["evaluations"]["held_out"]["episodes"] == record["baselines"]["random"]["episodes"] == 3
    assert len(entry["curve"]["return"]) <= curves.POINTS

    assert [chain.missing() for chain in measure.chains(TINY, places)] == [0, 0]
    before = places.record("rail").stat().st_mtime_ns
    measured(places, Commands())
    assert places.record("rail").stat().st_mtime_ns == before

    render.write(places, {"rail": TINY})
    page = places.page.read_text(encoding="utf-8")
    assert "| mean return, held out | at least 301 |" in page
    assert "| **missed** |" in page
    assert " s, resumed once |" in page
    assert f"state {picture.state(Standing.of(TINY, record))}" in places.picture("rail").read_text(encoding="utf-8")

    forget_evaluation(places)
    assert [chain.missing() for chain in measure.chains(TINY, places)] == [1, 0]


def forget_evaluation(places: Places) -> None:
    record: dict[str, Any] = json.loads(places.record("rail").read_text(encoding="utf-8"))
    [entry] = record["trainings"]["main"].values()
    records.put(places.record("rail"), entry | {"evaluations": {}}, "trainings", "main", "0")


MONITOR = """\
#{"t_start": 0}
r,l,t,episode,steps,simulated_hours,is_success,ended_by,stage
1,5,0,1,5,0.1,0,fallen,
2,5,0,2,10,0.2,0,fallen,
9,5,0,3,15,0.3,1,fallen,
3,5,0,2,11,0.2,0,fallen,
4,5,0,3,16,0.3,1,found,
"""


def test_episodes_that_a_killed_training_logged_after_its_checkpoint_do_not_count(tmp_path: Path):
    (tmp_path / "monitor.csv").write_text(MONITOR)
    found = curves.episodes(tmp_path / "monitor.csv")
    assert [(episode.episode, episode.total_return) for episode in found] == [(1, 1), (2, 3), (3, 4)]


def logged(returns: list[float], stages: list[str] | None = None) -> list[curves.Episode]:
    return [
        curves.Episode(i + 1, 10 * (i + 1), (i + 1) / 100, value, value > 0, stages[i] if stages else "") for i, value in enumerate(returns)
    ]


def test_a_threshold_is_crossed_by_the_mean_of_a_hundred_episodes_only():
    curve = curves.points(logged([1.0] * 50 + [0.0] * 60 + [1.0] * 100))
    assert curves.crossing(curve, Crossed(0.8, "episode")) == {"episode": 190, "steps": 1900, "simulated_hours": 1.9}
    assert curves.crossing(curve, Crossed(1.1, "episode")) is None


def test_a_threshold_that_is_crossed_in_an_easy_stage_is_not_crossed():
    curve = curves.points(logged([1.0] * 100 + [0.0] * 100 + [1.0] * 100, ["easy"] * 100 + ["hard"] * 200))
    assert curves.crossing(curve, Crossed(0.9, "episode"), "hard") == {"episode": 290, "steps": 2900, "simulated_hours": 2.9}


def test_what_episodes_of_one_stage_came_to_does_not_count_in_the_next():
    curve = curves.points(logged([1.0] * 100 + [0.0, 1.0, 0.0], ["easy"] * 100 + ["hard", "easy", "hard"]))
    assert [point.mean_return for point in curve[-3:]] == [1.0, 0.0, 0.0]
    assert not curve[-1].full


def test_a_curve_in_a_record_is_thin_and_ends_where_the_training_does():
    curve = curves.points(logged([1.0] * 1234))
    thinned = curves.thinned(curve)
    assert len(thinned["return"]) <= 200
    assert thinned["simulated_hours"][-1] == 12.34
