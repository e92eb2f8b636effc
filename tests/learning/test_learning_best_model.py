"""Held-out episodes during a training: which model is kept as the best, and when a solved task ends the
training."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import stand_in
import torch
from stand_in import hyper

from deepbots_cli.learning import (
    TrainingResult,
    evaluate,
    evaluate_trained,
    learner,
    model_files,
    resume,
    train,
    training_evaluations,
)
from deepbots_cli.learning.held_out import EVALUATION_EPISODES, Evaluator, confirmation_root, evaluation_seeds
from deepbots_cli.learning.report import Reporter
from deepbots_cli.learning.runs.confirmation_rule import COST_SHARE
from deepbots_cli.learning.runs.records import PATIENCE, RunRecord
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.learning.runs.verdict import run_verdict
from deepbots_cli.learning.signals import Interruption
from deepbots_cli.program import Program
from deepbots_cli.program.task import Solved, Training
from deepbots_cli.rollout import Start

SEED = 0
EVALUATION = evaluation_seeds(SEED, range(EVALUATION_EPISODES))
NEW_STARTS = evaluation_seeds(SEED, range(EVALUATION_EPISODES, 200))
CONFIRMATIONS = {
    Start.of_evaluation(confirmation_root(SEED, number), start).seed: number
    for number in range(1, 30)
    for start in range(400)
}
SUCCESS = Solved(20, success_rate=0.9)
RETURN = Solved(20, mean_return=5.0)
Score = Callable[[int], tuple[float, bool]]
"""The reward of a step, and whether the episode is a success, by the number of the evaluation, of the
confirmation, or of the candidate in the last choice, each from 0."""


def poor(number: int) -> tuple[float, bool]:
    return 0.0, False


def good(number: int) -> tuple[float, bool]:
    return 1.0, True


class Worlds:
    """Builds worlds whose held-out episodes have the given scores; training episodes pay 1 and succeed."""

    def __init__(self, evaluation: Score, confirmation: Score = poor, choice: Score = poor) -> None:
        self.evaluation, self.confirmation, self.choice = evaluation, confirmation, choice
        self.seeds: list[int] = []
        """Of all resets, in their order."""
        self.open = 0

    def __call__(self, program: Program, *, render_mode: str | None = None) -> Scored:
        self.open += 1
        return Scored(program, self, render_mode)

    def count(self, seed: int) -> int:
        return self.seeds.count(seed)

    @property
    def evaluations(self) -> int:
        return self.count(EVALUATION[0])

    def score(self, seed: int | None) -> tuple[float, bool]:
        """The score of the running episode, which began from `seed`."""
        if seed in EVALUATION:
            return self.evaluation(self.evaluations - 1)
        if seed in CONFIRMATIONS:
            return self.confirmation(CONFIRMATIONS[seed] - 1)
        if seed in NEW_STARTS:
            return self.choice(self.count(seed) - 1)
        return 1.0, True


class Scored(stand_in.CartPole):
    def __init__(self, program: Program, worlds: Worlds, render_mode: str | None = None) -> None:
        super().__init__(program, render_mode)
        self.worlds = worlds
        self.seed: int | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        self.seed = seed
        if seed is not None:
            self.worlds.seeds.append(seed)
        return super().reset(seed=seed, options=options)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        observation, _, terminated, truncated, info = super().step(action)
        reward, success = self.worlds.score(self.seed)
        return observation, reward, terminated, truncated, {**info, "is_success": success}

    def close(self) -> None:
        self.worlds.open -= not self.closed
        super().close()


class Notes(Reporter):
    """Keeps the notes of a training, and its activities beside learning."""

    def __init__(self) -> None:
        self.notes: list[str] = []
        self.activities: list[str] = []

    def note(self, text: str) -> None:
        self.notes.append(text)

    def update(self, progress: Any) -> None:
        if progress.activity:
            self.activities.append(progress.activity.text)


def learned(
    folder: Path,
    build: Any,
    total: int = 300,
    solved: Solved | None = SUCCESS,
    n_steps: int = 32,
    batch_size: int = 32,
    **options: Any,
) -> TrainingResult:
    task = stand_in.compiled(
        training=Training("PPO", total, 2, hyper(n_steps=n_steps, batch_size=batch_size, n_epochs=1)),
        solved=solved,
        success=True,
        max_steps=6,
    )
    return train(task, runs=folder, seed=SEED, build=build, **options)


def steps_of(result: TrainingResult, model: str) -> int:
    return model_files.steps_of(result.run / "models" / "agent" / f"{model}.zip")


def evaluated_steps(result: TrainingResult) -> list[int]:
    lines = (result.run / "evaluations" / "training.jsonl").read_text().splitlines()
    return [json.loads(line)["steps"] for line in lines]


@pytest.fixture(scope="module")
def unpaid(tmp_path_factory: pytest.TempPathFactory) -> tuple[Worlds, TrainingResult]:
    """A training whose held-out episodes all have a return of 0; not to be changed."""
    build = Worlds(poor)
    return build, learned(tmp_path_factory.mktemp("unpaid"), build)


# The order of policies


def test_the_policy_that_is_kept_succeeds_although_another_one_has_a_higher_return(tmp_path: Path) -> None:
    build = Worlds(
        lambda number: (9.0, False) if number == 0 else (0.1, number == 1),
        choice=lambda number: (0.1, number == 0),
    )
    result = learned(tmp_path, build, total=1_200)
    first, second, *_ = evaluated_steps(result)
    assert first < second < result.steps
    assert result.best is not None
    assert (result.best.steps, steps_of(result, "best")) == (second, second)
    assert result.best.measure == "success_rate"
    assert run_verdict(result.run, RunRecord.read(result.run)).solved is None  # it was not evaluated yet


def test_where_solved_asks_for_a_return_the_higher_return_is_kept(tmp_path: Path) -> None:
    build = Worlds(
        lambda number: (0.09, False) if number == 0 else (0.01, True), choice=lambda number: (0.01, False)
    )
    result = learned(tmp_path, build, total=1_000, solved=Solved(20, mean_return=40.0))
    assert result.best is not None
    assert (result.best.measure, result.best.steps) == ("mean_return", evaluated_steps(result)[0])


def test_of_equal_evaluations_the_later_model_is_kept(unpaid: tuple[Worlds, TrainingResult]) -> None:
    _, result = unpaid
    assert steps_of(result, "best") == steps_of(result, "last")


@pytest.mark.slow
def test_the_best_of_many_small_evaluations_is_chosen_again_on_new_starts(tmp_path: Path) -> None:
    # The first evaluation is the best by luck; on new starts only the model of the third one succeeds.
    build = Worlds(lambda number: (1.0, number < 3), choice=lambda number: (1.0, number == 0))
    notes = Notes()
    result = learned(tmp_path, build, total=2_400, solved=None, progress=notes)
    *_, third = evaluated_steps(result)[:3]
    assert result.best is not None
    assert result.best.chosen_by == "new starts"
    assert result.best.steps == third  # of equals it was the first to play
    assert result.best.episodes is not None
    assert (
        result.best.episodes % EVALUATION_EPISODES == 0
    )  # the evaluation that put it forward is not among them
    assert result.best.success_rate == 1.0
    assert any(f"that of {third:,} steps is the best on new starts" in note for note in notes.notes)
    assert any(" models on new starts: 0 of at most " in activity for activity in notes.activities)
    # The printed result comes from starts that did not choose the model.
    chosen = {seed for seed in build.seeds if seed in NEW_STARTS}
    before = len(build.seeds)
    evaluate(result.run, episodes=20, build=build)
    assert chosen
    assert not set(build.seeds[before:]) & {*chosen, *EVALUATION}


@pytest.mark.slow
def test_candidates_are_models_that_can_be_named(tmp_path: Path) -> None:
    result = learned(tmp_path, Worlds(lambda number: (float(number), False)), total=1_600, solved=None)
    files = sorted((result.run / "models" / "agent").glob("candidate-*.zip"))
    assert 2 <= len(files) <= 5
    assert steps_of(result, files[0].stem) == int(files[0].stem.removeprefix("candidate-"))


def test_a_run_of_before_is_read_and_its_best_marked_as_chosen_by_return(
    unpaid: tuple[Worlds, TrainingResult], tmp_path: Path
) -> None:
    _, result = unpaid
    record = json.loads((result.run / "run.json").read_text())
    for name in ("best", "confirmations", "confirmed_seed"):
        record["result"].pop(name)
    (tmp_path / "run.json").write_text(
        json.dumps(record | {"result": record["result"] | {"best_return": 12.5}})
    )
    best = RunRecord.read(tmp_path).result
    assert best is not None
    assert best.best_model is not None
    assert best.best_model.chosen_by == "return"
    assert best.best_model.mean_return == 12.5
    assert "chosen by return" in best.best_model.text


# When a training stops


def test_successes_of_training_episodes_do_not_solve_a_task(unpaid: tuple[Worlds, TrainingResult]) -> None:
    build, result = unpaid
    assert result.success_rate == 1.0
    assert result.solved_at is None
    assert result.status == "finished"
    assert result.steps >= 300
    assert not set(build.seeds) & set(CONFIRMATIONS)


def test_a_lucky_evaluation_does_not_stop_a_training(tmp_path: Path) -> None:
    notes = Notes()
    build = Worlds(good, confirmation=poor)
    result = learned(tmp_path, build, total=1_000, progress=notes)
    assert result.status == "finished"
    assert result.steps >= 1_000
    assert result.solved_at is None
    assert result.confirmations >= 1
    assert notes.activities[0].startswith("confirming on ")
    assert ": 0 played, needs " in notes.activities[0]
    assert any("not confirmed after" in note and "the training goes on" in note for note in notes.notes)


@pytest.mark.parametrize("solved", [SUCCESS, RETURN])
def test_training_and_final_verdict_are_one_verdict(tmp_path: Path, solved: Solved) -> None:
    build = Worlds(
        lambda number: (1.0, number >= 1) if solved is SUCCESS else (float(number >= 1), False),
        confirmation=good,
    )
    result = learned(tmp_path, build, total=100_000, solved=solved)
    assert build.evaluations == 2
    assert result.steps < 6_000
    assert result.confirmed_at is not None
    assert result.confirmed_at.steps == result.steps == steps_of(result, "best")
    run = Run.open(result.run)
    verdict = run_verdict(result.run, run.record)
    assert verdict.solved is True
    assert verdict.evaluation is not None
    assert verdict.evaluation.confirmation == 1
    assert verdict.evaluation.episodes % solved.episodes == 0
    # The evaluation after the training and `deepbots eval` are these episodes, not other ones.
    trained = evaluate_trained(run)
    again = evaluate(run, episodes=verdict.evaluation.episodes, build=build)
    assert [each.total_return for each in trained.outcomes] == [each.total_return for each in again.outcomes]
    assert trained.seed == again.seed == result.confirmed_seed == confirmation_root(SEED, 1)
    assert result.best is not None
    assert result.best.chosen_by == "confirmation"


@pytest.mark.slow
@pytest.mark.parametrize(("successes", "confirmations"), [({1, 3, 5}, 0), ({1, 2}, 1)])
def test_a_single_lucky_evaluation_of_an_off_policy_training_begins_no_confirmation(
    tmp_path: Path, successes: set[int], confirmations: int
) -> None:
    build = Worlds(lambda number: (1.0, number in successes))
    training = Training("DQN", 600, 1, hyper(learning_starts=10, train_freq=100, batch_size=8))
    result = train(
        stand_in.compiled(training=training, solved=SUCCESS, success=True, max_steps=50),
        runs=tmp_path,
        seed=SEED,
        build=build,
    )
    assert build.evaluations > 2
    assert result.confirmations == confirmations


@pytest.mark.slow
def test_each_confirmation_has_new_starts_and_failed_ones_take_a_tenth_of_the_steps(tmp_path: Path) -> None:
    build = Worlds(good, confirmation=poor)
    result = learned(tmp_path, build, total=3_000)
    begun = [CONFIRMATIONS[seed] for seed in build.seeds if seed in CONFIRMATIONS]
    assert set(begun) == set(range(1, result.confirmations + 1))
    assert result.confirmations >= 2
    confirmed_from = [seed for seed in build.seeds if seed in CONFIRMATIONS]
    assert len(confirmed_from) == len(set(confirmed_from))
    last = training_evaluations.CONFIRMATION_PART  # episodes of a confirmation that fails at once
    shortest = 6  # steps of an episode
    assert shortest * (len(begun) - last) <= COST_SHARE * result.steps


def test_a_training_that_does_not_stop_when_solved_notes_it_once(tmp_path: Path) -> None:
    build = Worlds(good, confirmation=good, choice=good)
    result = learned(tmp_path, build, total=1_000, stop_when_solved=False)
    assert result.steps >= 1_000
    assert result.solved_at is not None
    assert result.solved_at.steps < result.steps
    assert result.confirmations == 1
    assert result.confirmed_seed is None


@pytest.mark.slow
def test_a_training_resumed_after_a_solved_task_evaluates_again_and_keeps_a_better_model(
    tmp_path: Path,
) -> None:
    build = Worlds(
        lambda number: (1.0 + number, True), confirmation=good, choice=lambda number: (1.0, number == 0)
    )
    result = learned(tmp_path, build, total=2_500)
    assert result.confirmed_seed is not None
    before = evaluated_steps(result)
    again = resume(result.run, total_timesteps=2_500, build=build)
    after = evaluated_steps(again)
    assert after[: len(before)] == before
    assert len(after) > len(before)
    assert again.best is not None
    assert again.best.steps is not None
    assert again.best.steps > result.steps
    assert steps_of(again, "best") == again.best.steps
    assert again.confirmed_seed is None  # no confirmation ended it, so its verdict comes from an evaluation


@pytest.mark.slow
def test_a_checkpoint_of_before_goes_on(tmp_path: Path) -> None:
    build = Worlds(poor)
    result = learned(tmp_path, build, total=300)
    (path,) = (result.run / "checkpoints").glob("0*/state.json")
    state = json.loads(path.read_text())
    for name in ("candidates", "confirmations", "confirmation_steps", "returns"):
        state["callback"].pop(name)
    state["callback"] |= {
        "best": [True, True, 200.0],
        "confirmed": True,
        "solved_seen": True,
        "evaluation_steps": 10**6,
    }
    path.write_text(json.dumps(state))
    again = resume(result.run, total_timesteps=1_500, build=build)
    assert len(evaluated_steps(again)) > 1  # although older versions spent more steps on evaluations


@pytest.mark.slow
def test_a_training_that_does_not_get_better_ends_after_its_patience(tmp_path: Path) -> None:
    build = Worlds(lambda number: (1.0, number == 0), choice=good)
    notes = Notes()
    training = Training("PPO", 30_000, 2, hyper(n_steps=32), patience=1_000)
    task = stand_in.compiled(training=training, solved=SUCCESS, success=True, max_steps=6)
    result = train(task, runs=tmp_path, build=build, progress=notes)
    assert result.stopped_by == PATIENCE
    assert 1_000 <= result.steps < 10_000
    assert any("`patience: 1000`" in note for note in notes.notes)


def test_a_training_ends_after_the_evaluation_at_which_it_is_stopped(tmp_path: Path) -> None:
    build = Worlds(poor)
    result = learned(
        tmp_path, build, on_evaluation=lambda run: "somebody" if run.parent == tmp_path else None
    )
    assert result.status == "finished"
    assert result.stopped_by == "somebody"
    assert build.evaluations == 1
    assert result.steps < 600


def test_the_last_evaluation_keeps_who_stopped_the_training_before(tmp_path: Path) -> None:
    build = Worlds(poor)
    result = learned(
        tmp_path,
        build,
        total=1_000,
        on_iteration=lambda iteration: "somebody" if iteration.steps >= 300 else None,
        on_evaluation=lambda run: None,
    )
    assert result.stopped_by == "somebody"
    assert build.evaluations
    assert result.steps < 600


# How evaluations go


@pytest.mark.slow
def test_evaluations_take_at_most_their_share_of_the_steps(tmp_path: Path) -> None:
    result = learned(tmp_path, Worlds(poor, choice=poor), total=20_000)
    chosen = 5 * EVALUATION_EPISODES * 6 * 4
    assert (
        0
        < result.evaluation_steps
        <= result.steps * training_evaluations.URGENT_SHARE + 2 * EVALUATION_EPISODES * 6 + chosen
    )


@pytest.mark.slow
def test_the_best_models_are_not_the_same_policy_evaluated_again_within_a_long_rollout(
    tmp_path: Path,
) -> None:
    result = learned(tmp_path, Worlds(poor), total=3_000, n_steps=500, batch_size=500)
    # The last evaluation follows the last update.
    rollouts = [(steps - 1) // 1_000 for steps in evaluated_steps(result)[:-1]]
    assert len(rollouts) >= 2
    assert len(set(rollouts)) == len(rollouts)


def test_evaluations_start_where_neither_training_nor_evaluation_does(
    unpaid: tuple[Worlds, TrainingResult],
) -> None:
    build, result = unpaid
    assert set(EVALUATION) <= set(build.seeds)
    before = len(build.seeds)
    evaluate(result.run, episodes=30, build=build)
    assert not set(EVALUATION) & set(build.seeds[before:])
    assert build.open == 0


def test_what_is_learned_does_not_depend_on_the_evaluations(
    unpaid: tuple[Worlds, TrainingResult], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, few = unpaid
    monkeypatch.setattr(training_evaluations, "URGENT_SHARE", 2.0)
    many = learned(tmp_path, Worlds(poor))
    assert many.evaluation_steps > few.evaluation_steps
    assert many.weights_digest == few.weights_digest


def test_an_evaluation_stops_when_somebody_wants_the_training_to_end() -> None:
    task = stand_in.scenario(max_steps=50)
    world = stand_in.build(task)
    assert task.agent.training is not None
    policy = learner.create(learner.Setup(task.agent.training, world.observation_space, world.action_space))
    evaluator = Evaluator(stand_in.build, seed=0)
    interruption = Interruption()
    state = torch.get_rng_state()
    first, second = (evaluator.evaluate(policy, task, interruption) for _ in range(2))
    assert first == second  # the same starts each time
    assert len(first) == EVALUATION_EPISODES
    assert torch.equal(torch.get_rng_state(), state)
    interruption.requested = True
    with pytest.raises(KeyboardInterrupt):
        evaluator.evaluate(policy, task, interruption)
    evaluator.close()
