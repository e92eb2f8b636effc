"""The best model of a run, chosen again on new starts or by hand (`eval --keep`)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import stand_in
from stand_in import hyper

from deepbots_cli.errors import RunError, UsageError
from deepbots_cli.learning import evaluate, train
from deepbots_cli.learning.keeping import keep, kept_models
from deepbots_cli.learning.model_files import steps_of
from deepbots_cli.learning.runs.directories import run_lock
from deepbots_cli.learning.runs.records import RunRecord
from deepbots_cli.learning.runs.run import ModelRef, Run
from deepbots_cli.learning.runs.verdict import run_verdict
from deepbots_cli.program import Program
from deepbots_cli.program.task import Training
from deepbots_cli.runtime.forward_pass import FORWARD_BATCH_SIZE

SHORT = Training(
    "PPO",
    400,
    2,
    hyper(n_steps=32, batch_size=32, n_epochs=1),
)


class PaidByTurn:
    """Builds worlds that pay 1 a step to the models that play in certain turns, each in `FORWARD_BATCH_SIZE`
    worlds."""

    def __init__(self, *turns: int) -> None:
        self.turns = turns
        self.count = 0
        self.seeds: set[int] = set()

    def __call__(self, program: Program, *, render_mode: str | None = None) -> Paid:
        self.count += 1
        return Paid(program, self, float((self.count - 1) // FORWARD_BATCH_SIZE in self.turns))


class Paid(stand_in.CartPole):
    def __init__(self, program: Program, worlds: PaidByTurn, reward: float) -> None:
        super().__init__(program)
        self.worlds, self.reward = worlds, reward

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        if seed is not None:
            self.worlds.seeds.add(seed)
        return super().reset(seed=seed, options=options)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        observation, _, terminated, truncated, info = super().step(action)
        return observation, self.reward, terminated, truncated, info


@pytest.fixture
def run(tmp_path: Path) -> Run:
    """A run with three models: of 192, 320 and 448 steps; the last one is the best."""
    task = stand_in.compiled(training=SHORT)
    return Run.open(train(task, run=tmp_path / "run", build=stand_in.build, keep_checkpoints=3).run)


def bytes_of(run: Run, name: str) -> bytes:
    return run.model(name).read_bytes()


def test_the_best_model_is_chosen_again_on_new_starts_and_evaluated_on_others(run: Run) -> None:
    before = bytes_of(run, "best")
    names = kept_models(run)
    assert len(names) >= 3
    assert len(set(names.values())) == len(names)
    run.write_evaluation(evaluate(run, episodes=4, build=stand_in.build).model_dump(mode="json"))
    # The second model wins the first round, and is the first to play in each later one.
    turns = [1]
    left = len(names)
    played = left
    while (left := (left + 1) // 2) > 1:
        turns.append(played)
        played += left
    build = PaidByTurn(*turns)
    progress = list[tuple[int, int]]()
    kept = keep(ModelRef(run), build=build, on_model=lambda done, planned: progress.append((done, planned)))
    steps, name = list(names.items())[1]
    assert kept.name == name
    assert kept.best.steps == steps
    assert kept.best.chosen_by == "new starts"
    assert kept.best.mean_return == kept.played[0].result.mean_return
    assert progress[-1] == (played, played)
    assert bytes_of(run, "best") == bytes_of(run, name)
    assert kept.earlier == run.model("earlier-1")
    assert bytes_of(run, "earlier-1") == before
    record = RunRecord.read(run.path)
    assert record.result is not None
    assert record.result.best == kept.best
    # The evaluations of the earlier model do not apply to this one.
    assert run_verdict(run.path, record).evaluation is None
    seeds_of_the_choice = set(build.seeds)
    evaluated = evaluate(kept.run, episodes=4, build=build)
    assert evaluated.seed == kept.best.evaluation_seed != run.record.seed
    assert not {episode.seed for episode in evaluated.outcomes} & seeds_of_the_choice
    kept.run.write_evaluation(evaluated.model_dump(mode="json"))
    assert run_verdict(run.path, RunRecord.read(run.path)).evaluation is not None


def test_a_run_of_before_whose_best_model_was_chosen_by_return_is_judged_again(run: Run) -> None:
    record = json.loads((run.path / "run.json").read_text())
    record["result"].pop("best")
    (run.path / "run.json").write_text(
        json.dumps(record | {"result": record["result"] | {"best_return": 12.5}})
    )
    keep(ModelRef.open(run.path), build=stand_in.build)
    result = RunRecord.read(run.path).result
    assert result is not None
    assert result.best_model is not None
    assert result.best_model.chosen_by == "new starts"


def test_a_checkpoint_is_kept_by_hand(run: Run) -> None:
    name = next(name for name in kept_models(run).values() if name.startswith("step-"))
    before = bytes_of(run, "best")
    kept = keep(ModelRef.open(run.model(name)), build=stand_in.build)
    assert (kept.best.chosen_by, kept.best.steps, kept.played) == ("hand", steps_of(run.model(name)), ())
    assert "chosen by hand" in kept.best.text
    assert (bytes_of(run, "best"), bytes_of(run, "earlier-1")) == (bytes_of(run, name), before)
    again = keep(ModelRef.open(run.model("earlier-1")), build=stand_in.build)
    assert (bytes_of(run, "best"), again.earlier) == (before, run.model("earlier-2"))
    assert again.best.evaluation_seed != kept.best.evaluation_seed


def test_the_best_model_stays_with_its_evaluations_where_it_is_chosen_again(run: Run) -> None:
    run.write_evaluation(evaluate(run, episodes=4, build=stand_in.build).model_dump(mode="json"))
    kept = keep(ModelRef.open(run.model("best")), build=stand_in.build)
    assert kept.earlier is None
    assert not list(run.model("best").parent.glob("earlier-*"))
    assert run_verdict(run.path, RunRecord.read(run.path)).evaluation is not None


def test_no_model_is_kept_while_a_training_is_at_work(run: Run) -> None:
    digest = stand_in.tree_digest(run.path / "models")
    with run_lock(run.path), pytest.raises(UsageError, match="another process writes to"):
        keep(ModelRef(run), build=stand_in.build)
    record = json.loads((run.path / "run.json").read_text())
    (run.path / "run.json").write_text(json.dumps(record | {"status": "running", "result": None}))
    with pytest.raises(UsageError, match="has not ended; continue it with: deepbots resume"):
        keep(ModelRef.open(run.path), build=stand_in.build)
    assert stand_in.tree_digest(run.path / "models") == digest


def test_a_file_that_is_not_a_model_is_not_kept(run: Run) -> None:
    run.model("step-000000001").write_bytes(b"nothing")
    before = bytes_of(run, "best")
    with pytest.raises(RunError, match="is damaged, or was not written by deepbots"):
        keep(ModelRef.open(run.model("step-000000001")), build=stand_in.build)
    assert bytes_of(run, "best") == before
