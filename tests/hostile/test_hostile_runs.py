"""Run folders that mean harm end in one sentence or in what is right, within little time and memory.

Files that mean harm end in the findings that are for them, and reach for nothing outside of their
project.
"""

from __future__ import annotations

import json
import re
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "learning"))

import stand_in
from stand_in import hyper

from deepbots_cli.cli import main
from deepbots_cli.cli.records import evaluation_json, write_evaluation
from deepbots_cli.errors import RunError
from deepbots_cli.learning import evaluate, train
from deepbots_cli.learning.campaigns.listing import read_listed
from deepbots_cli.learning.environments import Failure
from deepbots_cli.learning.runs.directories import read_json
from deepbots_cli.learning.runs.evaluations import EvaluationResult
from deepbots_cli.learning.runs.run import Run, RunRecord
from deepbots_cli.learning.sb3.models import StableState
from deepbots_cli.program.task import Solved, Training
from tests.fuzz.harness import in_fork, rise_of_memory
from tests.fuzz.workbench import MOST_MEMORY
from tests.hostile.cases import Hostile
from tests.hostile.runs import CHANGES, MOST_SECONDS
from tests.hostile.runs import outcomes as outcomes_of_runs
from tests.hostile.trial import Outcome, outcomes


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run with all its files and an evaluation; not to be changed."""
    task = stand_in.compiled(
        training=Training("PPO", 640, 2, hyper(n_steps=32, batch_size=32, n_epochs=1)),
        solved=Solved(10, mean_return=1e6),
    )
    path = train(task, run=tmp_path_factory.mktemp("hostile") / "ppo", build=stand_in.build).run
    write_evaluation(Run.open(path), evaluation_json(evaluate(path, episodes=4, build=stand_in.build), ()))
    return path


@pytest.mark.parametrize(
    "numbers",
    [
        pytest.param(range(4, len(CHANGES), 12), id="some kinds"),
        *(
            pytest.param(range(at, at + 50), id=f"from {at}", marks=pytest.mark.slow)
            for at in range(0, 200, 50)
        ),
        pytest.param(range(0, 10 * len(CHANGES), len(CHANGES)), id="damaged", marks=pytest.mark.slow),
    ],
)
def test_a_hostile_run_takes_little_time_and_memory_and_prints_no_line_of_its_own(
    run: Path, numbers: range
) -> None:
    tried = list(outcomes_of_runs(run, numbers))
    assert len(tried) == len(numbers)
    assert not [problem for outcome in tried for problem in outcome["problems"]]
    assert max(outcome["seconds"] for outcome in tried) < MOST_SECONDS


EVALUATION = {
    "evaluated": "2026-01-01T00:00:00+00:00",
    "model": "best",
    "seed": 1,
    "solved": None,
    "success_defined": False,
    "episodes": 1,
    "mean_return": 0.0,
    "return_interval": None,
    "success_rate": None,
    "success_interval": None,
}
FAILURE = {"error": "e", "step": 1, "episode": 1, "case": None, "stage": None, "start": 1}
EPISODE = '{"total_return":0,"length":0,"is_success":false,"ended_by":null%s}'


def large(record: dict[str, Any], key: str, item: str, *, is_list: bool = True) -> str:
    """A record with 2 MB of equal items under a key."""
    count = 2_000_000 // (len(item) + (1 if is_list else 8))
    items = ",".join([item] * count if is_list else [f'"{number:06x}":{item}' for number in range(count)])
    return f'{json.dumps(record)[:-1]},"{key}":{f"[{items}]" if is_list else f"{{{items}}}"}}}'


@pytest.mark.skipif(sys.platform != "linux", reason="the peak of memory is that of Linux")
@pytest.mark.parametrize(
    ("model", "text"),
    [
        (EvaluationResult, large({}, "x", "0", is_list=False)),
        (EvaluationResult, large(EVALUATION, "x", "{}")),
        pytest.param(
            EvaluationResult, large(EVALUATION, "agents", "{}", is_list=False), marks=pytest.mark.slow
        ),
        pytest.param(EvaluationResult, large(EVALUATION, "set", "0"), marks=pytest.mark.slow),
        pytest.param(EvaluationResult, large(EVALUATION, "cases", "[[]]"), marks=pytest.mark.slow),
        (EvaluationResult, "{" + ",".join(f'"k{number}":0' for number in range(200_000)) + "}"),
        pytest.param(EvaluationResult, large(EVALUATION, "outcomes", "{}"), marks=pytest.mark.slow),
        pytest.param(EvaluationResult, large(EVALUATION, "outcomes", EPISODE % ""), marks=pytest.mark.slow),
        (EvaluationResult, large(EVALUATION, "outcomes", EPISODE % ',"terms":{"a":"x"}')),
        pytest.param(RunRecord, large({}, "seeds", "0", is_list=False), marks=pytest.mark.slow),
        (RunRecord, large({}, "command", '""')),
        pytest.param(RunRecord, large({}, "command", "0"), marks=pytest.mark.slow),
        (Failure, large(FAILURE, "actions", "[0]")),
        pytest.param(Failure, large(FAILURE, "actions", '{"a":0}'), marks=pytest.mark.slow),
        pytest.param(Failure, large(FAILURE, "actions", "0"), marks=pytest.mark.slow),
        (StableState, large({}, "stages", "-1")),
        pytest.param(StableState, large({}, "logs", '"x"', is_list=False), marks=pytest.mark.slow),
    ],
)
def test_a_record_of_two_megabytes_takes_fifty_megabytes(model: Any, text: str, tmp_path: Path) -> None:
    path = tmp_path / "record.json"
    path.write_text(text)

    def read() -> None:
        with suppress(RunError):
            read_json(path, model, 10_000_000)

    read()  # the schema of the model
    assert in_fork(lambda: rise_of_memory(read)).result < 50 * 10**6


def test_an_evaluation_as_it_is_written_is_read(run: Path) -> None:
    """Also with the keys that only `EvaluationResult` has."""
    assert EvaluationResult.read(run / "evaluations" / "0001.json").episodes == 4


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"wheels": 4}, "unknown field `wheels`"),
        ({"result": {"confirmations": 10**30}}, "'result.confirmations': Input should be less"),
        ({"seed": 10**30}, "'seed': Input should be less"),
        ({"total_timesteps": -1}, "'total_timesteps': Input should be greater"),
        ({"format": 5.5}, "'format'"),
    ],
)
def test_a_key_or_a_number_that_no_run_has_is_refused(
    run: Path, tmp_path: Path, change: dict[str, Any], reason: str
) -> None:
    record = json.loads((run / "run.json").read_text())
    change |= {"result": record["result"] | change.get("result", {})}
    (tmp_path / "run.json").write_text(json.dumps(record | change))
    with pytest.raises(RunError, match=re.escape(reason)):
        RunRecord.read(tmp_path)


def test_two_thousand_long_evaluations_are_listed_in_seconds(run: Path, tmp_path: Path) -> None:
    for name in ("run.json", "resolved.yaml"):
        (tmp_path / name).write_bytes((run / name).read_bytes())
    (tmp_path / "evaluations").mkdir()
    with (tmp_path / "evaluations" / "training.jsonl").open("w") as stream:
        for number in range(2_000):
            returns = [(number * 7919 + at * 104729) % 1000 - number for at in range(400)]
            line = {"steps": number, "stage": None, "returns": returns, "successes": [False] * 400}
            stream.write(json.dumps(line) + "\n")
    start = time.process_time()
    assert read_listed(tmp_path).decline is not None
    assert time.process_time() - start < 5


def test_the_run_of_another_student_behind_a_link_is_not_judged(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    link = tmp_path / "mine"
    link.symlink_to(run)
    before = {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    assert main(["eval", str(link), "--episodes", "1"]) == 2
    assert f"mine is a symbolic link; name the folder that it leads to: {run}" in capsys.readouterr().err
    assert before == {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    # The folder above may be a link, as on a cluster whose home leads elsewhere.
    (tmp_path / "runs").symlink_to(run.parent)
    assert Run.open(tmp_path / "runs" / run.name).record == Run.open(run).record


def test_a_text_of_a_run_does_not_become_a_line_of_the_output(run: Path, tmp_path: Path) -> None:
    record = json.loads((run / "run.json").read_text())
    texts = {
        "source": "1\nmet: the task is solved",
        "engine": "pybullet\u202e",
        "platform": "\u00e9\x9b\\n",
    }
    (tmp_path / "run.json").write_text(json.dumps(record | texts))
    read = RunRecord.read(tmp_path)
    assert read.source == "1\\u{a}met: the task is solved"
    assert (read.engine, read.platform) == ("pybullet\\u{202e}", "\u00e9\\u{9b}\\n")
    (tmp_path / "run.json").write_text(json.dumps(record | texts, ensure_ascii=False))
    assert RunRecord.read(tmp_path) == read


# Files that mean harm end in the findings that are for them, and reach for nothing outside of their


@pytest.fixture(
    scope="module",
    params=[pytest.param(False, id="most"), pytest.param(True, id="all", marks=pytest.mark.slow)],
)
def tried(request: pytest.FixtureRequest) -> list[tuple[Hostile, Outcome]]:
    return list(outcomes(slow=request.param))


def test_each_hostile_file_ends_in_a_finding_that_is_for_it(tried: list[tuple[Hostile, Outcome]]) -> None:
    assert tried[-1][0].name.startswith("picture")  # lint's process has lived to the last of them
    assert not {
        case.name: outcome.codes for case, outcome in tried if not set(case.codes).intersection(outcome.codes)
    }
    assert {outcome.exit_code for _, outcome in tried} == {1}


def test_no_hostile_file_opens_anything_outside_of_its_project(tried: list[tuple[Hostile, Outcome]]) -> None:
    assert not {case.name: outcome.outside for case, outcome in tried if outcome.outside}


def test_hostile_files_take_little_memory(tried: list[tuple[Hostile, Outcome]]) -> None:
    assert max(outcome.memory for _, outcome in tried) < MOST_MEMORY
