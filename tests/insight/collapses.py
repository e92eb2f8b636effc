"""Trainings that learn and then fall apart by a planted setting: is the fall named, and the setting that was
planted?

The cases are what someone planted who had not read the detector. Of 26 settings, 18 did not make a training
fall, such as 100 epochs, an entropy of 0.5 or 1, a clip range of 0.9 in LineFollower, and rewards times 1000.

A training has learned if an evaluation reaches 60 % of what `solved` asks for. It has fallen if its last two
evaluations have at most 80 % of the best one. Healthy trainings (`planted` is empty) must not be named.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from statistics import fmean
from typing import NamedTuple

from deepbots_cli import api
from deepbots_cli.errors import DeepbotsError
from deepbots_cli.insight.causes import diagnose
from deepbots_cli.insight.training import read_training
from deepbots_cli.learning import train
from deepbots_cli.learning.runs.episodes import read_evaluations
from deepbots_cli.learning.runs.run import Run

SHORT = ("truncation.max_steps=100", "solved=mean_return >= 97 over 100 episodes")
"""A CartPole of half the length, which is evaluated twice as often."""
DQN = (
    "train={algorithm: DQN, total_timesteps: 60_000, environments: 4, learning_rate: 1e-3, learning_starts:"
    " 1000, batch_size: 64, "
    "gradient_steps: 4, train_freq: 1, target_update_interval: 250, exploration_fraction: 0.2,"
    " exploration_final_eps: 0.05, "
    "gamma: 0.98, buffer_size: 50000, network: {hidden: [64, 64]}}"
)


class Case(NamedTuple):
    """A training on MuJoCo, and the paths of which one explains its fall; none for a healthy one."""

    name: str
    scenario: str
    timesteps: int
    seed: int
    set: Sequence[str]
    planted: Sequence[str] = ()


CASES = (
    Case("clip", "cartpole_continuous", 120_000, 1, [*SHORT, "train.clip_range=0.9"], ["train.clip_range"]),
    Case("clip_balancer", "balancer", 600_000, 5, ["train.clip_range=0.9"], ["train.clip_range"]),
    Case("n_steps", "cartpole_continuous", 93_552, 9, [*SHORT, "train.n_steps=2"], ["train.n_steps"]),
    Case("rate_pit", "pit_escape", 84_000, 8, ["train.learning_rate=3e-2"], ["train.learning_rate"]),
    Case(
        "rate_dqn", "cartpole", 60_000, 1, [*SHORT, DQN, "train.learning_rate=3e-2"], ["train.learning_rate"]
    ),
    Case("healthy", "cartpole_continuous", 150_000, 1, SHORT),
    Case("healthy_dqn", "cartpole", 60_000, 1, [*SHORT, DQN]),
    Case("healthy_balancer", "balancer", 300_000, 5, []),
)


def trained(case: Case, run: Path) -> Run:
    """The training of a case, to its last step, made where it is not there."""
    if not run.exists():
        compiled = api.compile(api.load(case.scenario, overrides=case.set))
        try:
            train(
                compiled,
                total_timesteps=case.timesteps,
                seed=case.seed,
                run=run,
                stop_when_solved=False,
                engine="mujoco",
            )
        except DeepbotsError as error:  # a diverged training has another cause
            print(f"{run.name}: {error}", flush=True)
    return Run.open(run)


def has_fallen(run: Run) -> bool:
    """Whether the training learned its task, and lost it again."""
    solved = run.program.agent.solved
    evaluations = read_evaluations(run.path)
    if solved is None or len(evaluations) < 3:
        return False
    name, wanted = (
        ("returns", solved.mean_return) if solved.success_rate is None else ("successes", solved.success_rate)
    )
    means = [fmean(each[name]) for each in evaluations]
    return max(means) >= 0.6 * (wanted or 0.0) and fmean(means[-2:]) <= 0.8 * max(means)


def named(run: Run) -> tuple[bool, list[str]]:
    """Whether `diagnose` names the fall, and the settings that it names, in their order."""
    causes = [cause for cause in diagnose(read_training(run)) if cause.cause == "fell_apart"]
    return bool(causes), [suspect["path"] for cause in causes for suspect in cause.evidence["suspects"]]
