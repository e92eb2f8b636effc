"""Trials of the networks of a moment: they decide what is kept as the best and when a solved task ends the training."""

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import stand_in
import torch

from deepbots_cli.learning import TrainingResult, algorithms, callbacks, evaluate, resume, train, trials, weights
from deepbots_cli.learning.environments import copies_over
from deepbots_cli.learning.interruption import Interruption
from deepbots_cli.learning.trials import Trials
from deepbots_cli.program import Program
from deepbots_cli.program.task import Hyperparameter, Solved, Training
from deepbots_cli.runtime.streams import derive

TRIAL_SEEDS = [derive(0, "trial", k) for k in range(trials.EPISODES)]
PROOF_SEED = derive(0, "trial", trials.PROOF - 1)
EASY = Solved(2, mean_return=5.0)


class Paying(stand_in.CartPole):
    """Pays 1 per step and calls every episode a success; in trials, `wage` and `success` say so for the trial's number."""

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
        if self.seeds and self.seeds[-1] in TRIAL_SEEDS:
            trial = (len(self.seeds) - 1) // trials.EPISODES
            reward, success = self.wage(trial), self.success(trial)
        return observation, reward, terminated, truncated, {**info, "is_success": success}


class Builder:
    """Builds worlds and remembers them."""

    def __init__(self, wage: Callable[[int], float], success: Callable[[int], bool] = lambda trial: True) -> None:
        self.wage = wage
        self.success = success
        self.worlds: list[Paying] = []

    def __call__(self, program: Program, *, render_mode: str | None = None) -> Paying:
        self.worlds.append(Paying(program, self.wage, self.success, render_mode))
        return self.worlds[-1]

    @property
    def tried(self) -> int:
        """Trials that were held."""
        return sum(seed == TRIAL_SEEDS[0] for world in self.worlds for seed in world.seeds)


def learned(folder: Path, build: Any = stand_in.build, total: int = 1_500, solved: Solved = EASY) -> TrainingResult:
    figures = {"n_steps": 32, "batch_size": 32, "n_epochs": 1}
    hyperparameters = tuple(Hyperparameter(name, figure) for name, figure in figures.items())
    task = stand_in.compiled(training=Training("PPO", total, environments=2, hyperparameters=hyperparameters), solved=solved, success=True)
    return train(task, runs=folder, build=build)


@dataclass(frozen=True)
class Learned:
    """A training that several tests read, and its worlds."""

    result: TrainingResult
    build: Builder


@pytest.fixture(scope="module")
def unpaid(tmp_path_factory: pytest.TempPathFactory) -> Learned:
    """1 500 steps, with trials that pay nothing."""
    build = Builder(lambda trial: 0.0)
    return Learned(learned(tmp_path_factory.mktemp("unpaid"), build), build)


@pytest.fixture(scope="module")
def paid_once(tmp_path_factory: pytest.TempPathFactory) -> Learned:
    """12 000 steps, with trials of which only the second pays."""
    build = Builder(lambda trial: 0.1 if trial == 1 else 0.0)
    return Learned(learned(tmp_path_factory.mktemp("paid_once"), build, total=12_000), build)


def test_a_training_does_not_end_while_the_policy_by_itself_does_not_solve_the_task(unpaid: Learned) -> None:
    result = unpaid.result
    assert result.solved_at is not None
    assert result.solved_at.steps < 200  # by the episodes of the training
    assert (result.status, result.steps >= 1_500) == ("finished", True)


def test_a_training_ends_at_the_first_trial_that_solves_the_task(tmp_path: Path) -> None:
    build = Builder(lambda trial: float(trial >= 2))
    result = learned(tmp_path, build, total=100_000)
    assert result.steps < 20_000
    assert build.tried == 3
    assert result.best_return is not None
    assert result.best_return >= 5.0


def test_the_best_model_is_that_of_the_best_trial_and_not_of_the_luckiest_episodes(paid_once: Learned) -> None:
    result = paid_once.result
    assert paid_once.build.tried > 3
    best, last = (weights.read_state(result.run / "models" / f"{name}.npz").count("steps") for name in ("best", "last"))
    assert 0 < best < last
    assert evaluate(result.run, episodes=1, build=stand_in.build).mean_return > 0


def test_a_network_that_solves_the_task_goes_before_one_with_a_higher_return(tmp_path: Path) -> None:
    build = Builder(lambda trial: 9.0 if trial == 0 else 0.1, lambda trial: trial == 1)
    result = learned(tmp_path, build, 50_000, Solved(2, success_rate=1.0))
    assert (build.tried, result.steps < 50_000) == (2, True)
    best, last = (weights.read_state(result.run / "models" / f"{name}.npz").count("steps") for name in ("best", "last"))
    assert best == last
    assert result.best_return is not None
    assert result.best_return < 0.1 * 200 + 1e-6


def test_an_off_policy_algorithm_ends_after_a_longer_trial(tmp_path: Path) -> None:
    build = Builder(lambda trial: 1.0)
    task = stand_in.compiled(training=Training("TD3", 1_500, environments=2), solved=EASY, continuous=True)
    result = train(task, runs=tmp_path, build=build)
    assert result.steps < 1_500
    assert sum(seed == PROOF_SEED for world in build.worlds for seed in world.seeds) == 1


def test_a_network_that_confirmed_the_solved_task_goes_before_one_that_shone_earlier(tmp_path: Path) -> None:
    class Late(Paying):
        """Its episodes in training are successes from the 130th on."""

        begun = 0

        def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
            self.begun += 1
            return super().reset(seed=seed, options=options)

        def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
            *outcome, info = super().step(action)
            in_trial = bool(self.seeds) and self.seeds[-1] in TRIAL_SEEDS
            return *outcome, info | {"is_success": in_trial or self.begun >= 130}  # type: ignore[return-value]

    worlds = []

    def build(program: Program, *, render_mode: str | None = None) -> Late:
        worlds.append(Late(program, lambda trial: 9.0 if trial == 0 else 1.0, lambda trial: True, render_mode))
        return worlds[-1]

    result = learned(tmp_path, build, 50_000, Solved(30, success_rate=1.0))
    assert sum(seed == TRIAL_SEEDS[0] for world in worlds for seed in world.seeds) == 2
    assert result.solved_at is not None
    best = weights.read_state(result.run / "models" / "best.npz").count("steps")
    assert best >= result.solved_at.steps


def test_of_equal_trials_the_later_network_is_kept(unpaid: Learned) -> None:
    best, last = (weights.read_state(unpaid.result.run / "models" / f"{name}.npz").count("steps") for name in ("best", "last"))
    assert best == last


def test_trials_take_at_most_their_share_of_the_steps_and_the_last_one_more(paid_once: Learned, tmp_path: Path) -> None:
    result = paid_once.result
    assert paid_once.build.tried > 3
    assert 0 < result.trial_steps <= result.steps * trials.OVERTIME_SHARE + 2 * trials.EPISODES * 200
    copy = Path(shutil.copytree(result.run, tmp_path / "copy"))
    again = resume(copy, total_timesteps=14_000, build=Builder(lambda trial: 0.0))
    assert again.trial_steps > result.trial_steps


def test_trials_start_where_neither_training_nor_evaluation_does(unpaid: Learned) -> None:
    result, build = unpaid.result, unpaid.build
    seen = [seed for world in build.worlds for seed in world.seeds]
    before = len(build.worlds)
    evaluate(result.run, episodes=30, build=build)
    assert set(TRIAL_SEEDS) <= set(seen)
    assert not set(TRIAL_SEEDS) & {seed for world in build.worlds[before:] for seed in world.seeds}
    in_trials = {id(world) for world in build.worlds if set(TRIAL_SEEDS) & set(world.seeds)}
    assert len(in_trials) == 1  # a world of their own
    assert all(set(world.seeds) <= set(TRIAL_SEEDS) for world in build.worlds if id(world) in in_trials)
    assert all(world.closed for world in build.worlds)


def test_what_is_learned_does_not_depend_on_the_trials(unpaid: Learned, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    few = unpaid.result
    monkeypatch.setattr(callbacks, "OVERTIME_SHARE", 1.0)
    many = learned(tmp_path, Builder(lambda trial: 0.0))
    assert many.trial_steps > few.trial_steps
    assert many.weights_digest == few.weights_digest


def test_a_trial_stops_when_somebody_wants_the_work_to_end() -> None:
    task = stand_in.scenario()
    world = stand_in.build(task)
    assert task.policy.training is not None
    model = algorithms.create(task.policy.training, copies_over([world] * 2, [0, 0]), seed=0, total_timesteps=100, longest_episode=200)
    held, interruption = Trials(stand_in.build, seed=0), Interruption()
    state = torch.get_rng_state()
    first, second = (held.hold(model, task, interruption) for _ in range(2))
    assert first is not None
    assert first == second  # the same starts each time
    assert first.episodes == trials.EPISODES
    assert torch.equal(torch.get_rng_state(), state)
    interruption.requested = True
    assert held.hold(model, task, interruption) is None
    held.close()
