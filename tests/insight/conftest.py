"""Short trainings, for all tests that read them."""

from __future__ import annotations

from pathlib import Path

import pytest

from deepbots_cli import api
from deepbots_cli.learning import evaluate, train
from deepbots_cli.learning.runs.run import Run
from tests.insight.logs import train_shuttle


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of CartPole with short episodes that draw two values; not to be changed."""
    folder = tmp_path_factory.mktemp("insight")
    overrides = [
        "truncation.max_steps=12",
        "world.arena.friction=uniform(0.8 .. 1.2)",
        "train.environments=2",
        "train.n_steps=64",
    ]
    compiled = api.compile("cartpole", overrides=overrides)
    trained = train(
        compiled,
        run=folder / "cartpole",
        seed=3,
        total_timesteps=256,
        command=("deepbots", "train", "<b>cartpole</b>"),
    )
    Run.open(trained.run).write_evaluation(evaluate(trained.run, episodes=12).model_dump(mode="json"))
    return trained.run


@pytest.fixture(scope="session")
def short(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A training of two rollouts; not to be changed."""
    return train("cartpole", total_timesteps=1024, seed=2, run=tmp_path_factory.mktemp("runs") / "short").run


@pytest.fixture(scope="session")
def carriage(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short training in one stage, of a scenario that plans 24,000 steps; not to be changed."""
    return train_shuttle(tmp_path_factory.mktemp("runs"))
