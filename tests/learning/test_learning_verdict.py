"""Which evaluation of a run is quoted, and whether the run is solved."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import stand_in

from deepbots_cli.cli import main
from deepbots_cli.cli.records import evaluation_text, interval_text, scores
from deepbots_cli.engine_kinds import PHYSICS
from deepbots_cli.learning import evaluate
from deepbots_cli.learning.campaigns.listing import read_listed
from deepbots_cli.learning.runs.run import ModelRef, Run
from deepbots_cli.learning.runs.verdict import last_episodes, quoted_episodes, quoted_evaluation, run_verdict

SOLVED_AT = {
    "episode": 3,
    "steps": 90,
    "simulated_hours": 0.1,
    "cpu_seconds": 1.0,
    "mean_return": 200.0,
    "success_rate": 0.0,
}


def test_a_quick_evaluation_does_not_replace_the_one_with_the_most_episodes(run_copy: Path) -> None:
    run = Run.open(run_copy)
    long, quick = (evaluate(run, episodes=count, build=stand_in.build) for count in (12, 3))
    run.write_evaluation(long.model_dump(mode="json"))
    quick_path = run.write_evaluation(quick.model_dump(mode="json"))
    quoted = quoted_episodes(run)
    last = last_episodes(ModelRef(run))
    assert quoted is not None
    assert last is not None
    assert (len(quoted.outcomes), last[0]) == (12, quick_path)
    assert run_verdict(run_copy, run.record).text.startswith(quoted.text)
    latest = run.write_evaluation(long.model_dump(mode="json"))
    assert quoted_evaluation(run_copy, run.record).number == int(latest.stem)  # type: ignore[union-attr]


def test_a_run_quotes_another_evaluation_where_the_file_of_the_quoted_one_was_removed(run_copy: Path) -> None:
    run = Run.open(run_copy)
    long, quick = (evaluate(run, episodes=count, build=stand_in.build) for count in (12, 3))
    path = run.write_evaluation(long.model_dump(mode="json"))
    run.write_evaluation(quick.model_dump(mode="json"))
    path.unlink()
    assert read_listed(run_copy).evaluated_episodes == 3


def test_a_run_of_other_physics_says_so_where_it_is_evaluated(run_copy: Path) -> None:
    record = json.loads((run_copy / "run.json").read_text()) | {"physics": PHYSICS + 1}
    (run_copy / "run.json").write_text(json.dumps(record))
    (note,) = evaluate(run_copy, episodes=3, build=stand_in.build).notes
    assert f"was trained with physics {PHYSICS + 1} of deepbots, and this version simulates" in note


def test_a_run_of_before_is_quoted_from_the_files_of_its_evaluations(run_copy: Path) -> None:
    run = Run.open(run_copy)
    run.write_evaluation(evaluate(run, episodes=12, build=stand_in.build).model_dump(mode="json"))
    listed = read_listed(run_copy)
    record = json.loads((run_copy / "run.json").read_text())
    for name in ("task", "physics", "plugins", "quoted"):
        del record[name]
    (run_copy / "run.json").write_text(json.dumps(record))
    assert read_listed(run_copy) == listed


def test_an_edited_criterion_does_not_make_a_run_solved(run_copy: Path) -> None:
    resolved = run_copy / "resolved.yaml"
    resolved.write_text(resolved.read_text().replace("mean_return >= 195", "mean_return >= 1"))
    run = Run.open(run_copy)
    assert run.digest != run.record.digest
    evaluation = evaluate(run, episodes=12, build=stand_in.build)
    assert evaluation.solved is True
    assert evaluation.verdict.endswith("(scenario changed since the training)")
    run.write_evaluation(evaluation.model_dump(mode="json"))
    listed = read_listed(run_copy)
    assert listed.solved is None
    assert listed.remarks == ("scenario changed since the training",)
    # One of the scenario of the training is quoted in its place, however few its episodes.
    few = evaluate(run, episodes=3, build=stand_in.build)
    run.write_evaluation(few.model_copy(update={"digest": run.record.digest}).model_dump(mode="json"))
    assert read_listed(run_copy).evaluated_episodes == 3


@pytest.mark.parametrize(
    "where",
    [
        {"stage": "easy"},
        {"case": "easy"},
        {"set": ["solved=mean_return >= 1 over 9 episodes"]},
        {"elsewhere": "easy.yaml"},
    ],
)
def test_an_evaluation_of_an_easy_stage_or_another_scenario_does_not_make_a_run_solved(
    run_copy: Path, where: dict[str, object]
) -> None:
    run = Run.open(run_copy)
    evaluation = evaluate(run, episodes=12, build=stand_in.build).model_dump(mode="json")
    run.write_evaluation(evaluation | where | {"solved": True, "episodes": 999})
    assert run_verdict(run_copy, run.record).solved is None
    assert quoted_evaluation(run_copy, run.record) is None


def test_an_evaluation_that_a_requirement_stopped_says_so(run_copy: Path) -> None:
    run = Run.open(run_copy)
    evaluation = evaluate(run, episodes=12, build=stand_in.build, until=lambda episodes: len(episodes) == 8)
    run.write_evaluation(evaluation.model_dump(mode="json"))
    assert (evaluation.episodes, evaluation.planned) == (8, 12)
    assert "(stopped by a requirement after 8 of 12 episodes)" in evaluation.verdict
    assert "(stopped by a requirement after 8 of 12 episodes)" in run_verdict(run_copy, run.record).text


def test_training_episodes_make_no_run_solved(run_copy: Path) -> None:
    run = Run.open(run_copy)
    run.write_evaluation(evaluate(run, episodes=3, build=stand_in.build).model_dump(mode="json"))
    record = json.loads((run_copy / "run.json").read_text())
    record["result"]["solved_at"] = SOLVED_AT
    (run_copy / "run.json").write_text(json.dumps(record))
    verdict = run_verdict(run_copy, Run.open(run_copy).record)
    assert verdict.solved is None
    assert verdict.text.endswith("(fewer than 10 episodes)")


def test_a_run_that_is_not_solved_is_not_listed_with_the_steps_until_it_was(run_copy: Path) -> None:
    run = Run.open(run_copy)
    evaluated = evaluate(run, episodes=12, build=stand_in.build)
    run.write_evaluation(evaluated.model_copy(update={"solved": True}).model_dump(mode="json"))
    record = json.loads((run_copy / "run.json").read_text())
    record["result"] |= {"solved_at": SOLVED_AT, "confirmations": 1}
    (run_copy / "run.json").write_text(json.dumps(record))
    listed = read_listed(run_copy)
    assert listed.solved is True
    assert listed.solved_after == 90
    # An evaluation of more episodes says otherwise.
    run.write_evaluation(
        evaluated.model_copy(update={"episodes": 300, "solved": False}).model_dump(mode="json")
    )
    listed = read_listed(run_copy)
    assert listed.solved is False
    assert listed.solved_after is None


def test_equal_returns_are_not_shown_as_an_interval_around_them(
    run_copy: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = Run.open(run_copy)
    evaluation = evaluate(run, episodes=3, build=stand_in.build)
    same = {"mean_return": 0.0, "std_return": 0.0, "least_return": 0.0, "greatest_return": 0.0}
    equal = evaluation.model_copy(update=same | {"return_interval": (-155.8, 155.8)})
    text = evaluation_text(equal)
    assert "mean return         0.00 (95 %: -155.80 .. 155.80; all returns are equal)" in text
    assert scores(equal)["return_95 %"] == "all equal"
    run.write_evaluation(equal.model_dump(mode="json"))
    assert main(["runs", str(run_copy)]) == 0
    assert "155.8" not in capsys.readouterr().out
    assert run_verdict(run_copy, run.record).text.startswith("mean return 0 (95 % interval -155.8")
    assert interval_text((200.0, 200.0)) == "200"
