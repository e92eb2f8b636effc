"""Trainings whose logs are written by hand, so that each test has the curve that it is about."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from deepbots_cli import api
from deepbots_cli.insight.causes import diagnose
from deepbots_cli.insight.statements import Statement
from deepbots_cli.insight.training import TrainingEvidence, read_training
from deepbots_cli.learning import train
from deepbots_cli.learning.runs.run import Run

SHUTTLE = Path(__file__).with_name("shuttle.yaml")


def with_logs(
    run: Path,
    returns,
    lengths=None,
    ending="fallen",
    success=False,
    stages="",
    drawn="",
    evaluations=(),
    **scalars,
) -> TrainingEvidence:
    """A training with these logs in the place of its own, and without short episodes."""
    returns = np.asarray(returns, float)
    lengths = returns if lengths is None else np.asarray(lengths, float)
    count = len(returns)
    per_episode = [
        np.broadcast_to(np.asarray(value, kind), count)
        for value, kind in ((success, float), (ending, object), (stages, object))
    ]
    columns = [
        np.cumsum(lengths),
        returns,
        lengths,
        *per_episode,
        np.broadcast_to(np.asarray(drawn, object), count),
    ]
    episodes = np.rec.fromarrays(columns, names="steps, returns, lengths, successes, endings, stages, drawn")
    curves = {
        name.replace("__", "/"): (np.arange(len(values), dtype=float), np.asarray(values, float))
        for name, values in scalars.items()
    }
    return replace(
        read_training(Run.open(run)), all_episodes=episodes, scalars=curves, all_evaluations=list(evaluations)
    )


def evaluations_with(*rates: float, stage: str = "", every: int = 1000, returns: float = 1.0) -> list[dict]:
    """Evaluations of 20 episodes during a training, with these success rates."""
    wins = [[True] * round(20 * rate) + [False] * (20 - round(20 * rate)) for rate in rates]
    return [
        {"steps": every * (k + 1), "stage": stage, "returns": [returns] * 20, "successes": won}
        for k, won in enumerate(wins)
    ]


def causes_of(training: TrainingEvidence) -> list[str]:
    """The names of the causes of a training, the most likely first."""
    return [cause.cause for cause in diagnose(training)]


def statement_of(training: TrainingEvidence, cause: str) -> Statement:
    """The statement about one cause of a training."""
    (statement,) = [each for each in diagnose(training) if each.cause == cause]
    return statement


def train_shuttle(folder: Path, *overrides: str) -> Path:
    compiled = api.compile(
        api.load(
            SHUTTLE,
            overrides=["world.engine=mujoco", "train.environments=2", "train.n_steps=32", *overrides],
        )
    )
    return train(compiled, total_timesteps=128, seed=2, run=folder / "shuttle").run


def outcomes(count: int, *rates: float) -> np.ndarray:
    """Successes of episodes whose rate goes from one value to the next."""
    wanted = np.interp(np.linspace(0, 1, count), np.linspace(0, 1, len(rates)), rates)
    return (np.random.default_rng(7).random(count) < wanted).astype(float)


def returns_of(successes: np.ndarray, *means: float) -> np.ndarray:
    """Returns whose mean goes from one value to the next, and that a success raises by 5."""
    means = np.interp(np.linspace(0, 1, len(successes)), np.linspace(0, 1, len(means)), means)
    return means + 5 * successes + np.random.default_rng(8).normal(0, 0.3, len(successes))
