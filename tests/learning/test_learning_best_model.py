"""Evaluations during a training: they decide what is kept as the best and when a solved task ends the training."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import stand_in
import torch

from deepbots_cli.learning import TrainingResult, callbacks, evaluate, learner, resume, train
from deepbots_cli.learning.callbacks import Evaluator, Interruption
from deepbots_cli.program import Program
from deepbots_cli.program.task import Hyperparameter, Solved, Training
from deepbots_cli.runtime.streams import derive_seed

EVALUATION_SEEDS = [derive_seed(0, "trial", k) for k in range(callbacks.EVALUATION_EPISODES)]
CONFIRMATION_SEED = derive_seed(0, "trial", callbacks.CONFIRMATION_EPISODES - 1)
EASY = Solved(2, mean_return=5.0)


class Paying(stand_in.CartPole):
    """Pays 1 per step and calls every episode a success; in evaluations, `wage` and `success` say so by the number of the evaluation."""

    def __init__(
        self, program: Program, wage: Callable[[int], float], success: Callable[[int], bool], render_mode: str | None = None
    ) -> None:
        super().__init__(program, render_mode)
        self.wage = wage
        self.success = success
        self.seeds: list[int] = []

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        if seed is not None:
            self.seeds.append(seed)
        return super().reset(seed=seed, options=options)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        observation, reward, terminated, truncated, info = super().step(action)
        success = True
        if self.seeds and self.seeds[-1] in EVALUATION_SEEDS:
            number = (len(self.seeds) - 1) // callbacks.EVALUATION_EPISODES
            reward, success = self.wage(number), self.success(number)
        return observation, reward, terminated, truncated, {**info, "is_success": success}


class Builder:
    """Builds worlds and remembers them."""

    def __init__(self, wage: Callable[[int], float], success: Callable[[int], bool] = lambda number: True) -> None:
        self.wage = wage
        self.success = success
        self.worlds: list[Paying] = []

    def __call__(self, program: Program, *, render_mode: str | None = None) -> Paying:
        self.worlds.append(Paying(program, self.wage, self.success, render_mode))
        return self.worlds[-1]

    @property
    def tried(self) -> int:
        """Trials that were held."""
        return sum(seed == EVALUATION_SEEDS[0] for world in self.worlds for seed in world.seeds)


def learned(folder: Path, build: Any = stand_in.build, total: int = 800, solved: Solved = EASY, **options: Any) -> TrainingResult:
    figures = {"n_steps": 32, "batch_size": 32, "n_epochs": 1}
    hyperparameters = tuple(Hyperparameter(name, figure) for name, figure in figures.items())
    task = stand_in.compiled(
        training=Training("PPO", total, environments=2, hyperparameters=hyperparameters), solved=solved, success=True, max_steps=50
    )
    return train(task, runs=folder, build=build, **options)


@pytest.fixture(scope="module")
def unpaid(tmp_path_factory: pytest.TempPathFactory) -> tuple[Builder, TrainingResult]:
    """A training whose evaluations all give a return of 0; not to be changed."""
    build = Builder(lambda number: 0.0)
    return build, learned(tmp_path_factory.mktemp("unpaid"), build)


def test_a_training_does_not_end_while_the_policy_by_itself_does_not_solve_the_task(unpaid: tuple[Builder, TrainingResult]) -> None:
    _, result = unpaid
    assert result.solved_at is not None
    assert result.solved_at.steps < 200  # by the episodes of the training
    assert (result.status, result.steps >= 800) == ("finished", True)


def test_a_training_ends_at_the_first_evaluation_that_solves_the_task(tmp_path: Path) -> None:
    build = Builder(lambda number: float(number >= 2))
    result = learned(tmp_path, build, total=100_000)
    assert result.steps < 20_000
    assert build.tried == 3
    assert result.best_return is not None
    assert result.best_return >= 5.0


def test_a_training_ends_after_the_evaluation_at_which_it_is_stopped(tmp_path: Path) -> None:
    build = Builder(lambda number: 0.0)
    result = learned(tmp_path, build, on_evaluation=lambda run: "somebody" if run.parent == tmp_path else None)
    assert (result.status, result.stopped_by, build.tried) == ("finished", "somebody", 1)
    assert result.steps < 1_500


@pytest.mark.slow
def test_the_best_model_is_that_of_the_best_evaluation_and_evaluations_take_at_most_their_share_of_the_steps(tmp_path: Path) -> None:
    build = Builder(lambda number: 0.1 if number == 1 else 0.0)
    result = learned(tmp_path, build, total=3_000)
    assert build.tried > 2
    best, last = (learner.steps_of(result.run / "models" / "agent" / f"{name}.zip") for name in ("best", "last"))
    assert 0 < best < last
    assert evaluate(result.run, episodes=1, build=stand_in.build).mean_return > 0
    # The last evaluation comes in addition.
    assert 0 < result.evaluation_steps <= result.steps * callbacks.FINAL_EVALUATION_SHARE + 2 * callbacks.EVALUATION_EPISODES * 50
    again = resume(result.run, total_timesteps=5_000, build=build)
    assert again.evaluation_steps > result.evaluation_steps


def test_a_network_that_solves_the_task_goes_before_one_with_a_higher_return(tmp_path: Path) -> None:
    build = Builder(lambda number: 9.0 if number == 0 else 0.1, lambda number: number == 1)
    result = learned(tmp_path, build, 50_000, Solved(2, success_rate=1.0))
    assert (build.tried, result.steps < 50_000) == (2, True)
    best, last = (learner.steps_of(result.run / "models" / "agent" / f"{name}.zip") for name in ("best", "last"))
    assert best == last
    assert result.best_return is not None
    assert result.best_return < 0.1 * 50 + 1e-6


def test_an_off_policy_algorithm_ends_after_a_longer_evaluation(tmp_path: Path) -> None:
    build = Builder(lambda number: 1.0)
    task = stand_in.compiled(training=Training("TD3", 1_500, environments=2), solved=EASY, continuous=True)
    result = train(task, runs=tmp_path, build=build)
    assert result.steps < 1_500
    assert sum(seed == CONFIRMATION_SEED for world in build.worlds for seed in world.seeds) == 1


@pytest.mark.slow
def test_a_network_that_confirmed_the_solved_task_goes_before_one_that_shone_earlier(tmp_path: Path) -> None:
    class Late(Paying):
        """Its episodes in training are successes from the 100th on."""

        begun = 0

        def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
            self.begun += 1
            return super().reset(seed=seed, options=options)

        def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
            *outcome, info = super().step(action)
            in_evaluation = bool(self.seeds) and self.seeds[-1] in EVALUATION_SEEDS
            return *outcome, info | {"is_success": in_evaluation or self.begun >= 100}  # type: ignore[return-value]

    worlds = []

    def build(program: Program, *, render_mode: str | None = None) -> Late:
        worlds.append(Late(program, lambda number: 9.0 if number == 0 else 1.0, lambda number: True, render_mode))
        return worlds[-1]

    result = learned(tmp_path, build, 50_000, Solved(30, success_rate=1.0))
    assert sum(seed == EVALUATION_SEEDS[0] for world in worlds for seed in world.seeds) == 2
    assert result.solved_at is not None
    best = learner.steps_of(result.run / "models" / "agent" / "best.zip")
    assert best >= result.solved_at.steps


def test_of_equal_evaluations_the_later_network_is_kept(unpaid: tuple[Builder, TrainingResult]) -> None:
    _, result = unpaid
    best, last = (learner.steps_of(result.run / "models" / "agent" / f"{name}.zip") for name in ("best", "last"))
    assert best == last


def test_evaluations_start_where_neither_training_nor_evaluation_does(unpaid: tuple[Builder, TrainingResult]) -> None:
    build, result = unpaid
    seen = [seed for world in build.worlds for seed in world.seeds]
    before = len(build.worlds)
    evaluate(result.run, episodes=30, build=build)
    assert set(EVALUATION_SEEDS) <= set(seen)
    assert not set(EVALUATION_SEEDS) & {seed for world in build.worlds[before:] for seed in world.seeds}
    in_evaluations = {id(world) for world in build.worlds if set(EVALUATION_SEEDS) & set(world.seeds)}
    assert len(in_evaluations) == 1  # a world of their own
    assert all(set(world.seeds) <= set(EVALUATION_SEEDS) for world in build.worlds if id(world) in in_evaluations)
    assert all(world.closed for world in build.worlds)


def test_what_is_learned_does_not_depend_on_the_evaluations(
    unpaid: tuple[Builder, TrainingResult], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, few = unpaid
    monkeypatch.setattr(callbacks, "FINAL_EVALUATION_SHARE", 1.0)
    many = learned(tmp_path, Builder(lambda number: 0.0))
    assert many.evaluation_steps > few.evaluation_steps
    assert many.weights_digest == few.weights_digest


def test_an_evaluation_stops_when_somebody_wants_the_training_to_end() -> None:
    task = stand_in.scenario(max_steps=50)
    world = stand_in.build(task)
    assert task.agent.training is not None
    policy = learner.create(learner.Setup(task.agent.training, world.observation_space, world.action_space))
    evaluator, interruption = Evaluator(stand_in.build, seed=0), Interruption()
    state = torch.get_rng_state()
    first, second = (evaluator.run_episodes(policy, task, interruption) for _ in range(2))
    assert first == second  # the same starts each time
    assert len(first) == callbacks.EVALUATION_EPISODES
    assert torch.equal(torch.get_rng_state(), state)
    interruption.requested = True
    with pytest.raises(KeyboardInterrupt):
        evaluator.run_episodes(policy, task, interruption)
    evaluator.close()
