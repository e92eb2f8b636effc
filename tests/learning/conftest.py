"""Makes the small world importable, keeps runs in a directory of the test, and trains one run for all who
only read it."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

import stand_in

from deepbots_cli.learning import TrainingResult, train
from deepbots_cli.program.task import Solved, Training


@pytest.fixture(scope="session")
def trained(tmp_path_factory: pytest.TempPathFactory) -> TrainingResult:
    """A short PPO training; not to be changed."""
    compiled = stand_in.compiled(
        training=Training("PPO", 2_000, environments=4), solved=Solved(10, mean_return=195.0)
    )
    return train(
        compiled,
        runs=tmp_path_factory.mktemp("runs"),
        seed=3,
        build=stand_in.build,
        command=("deepbots", "train", "stand_in"),
    )


@pytest.fixture
def run_copy(trained: TrainingResult, tmp_path: Path) -> Path:
    """A copy of that run, to spoil."""
    return Path(shutil.copytree(trained.run, tmp_path / "copy"))
