"""Trains one run of two agents for all who only read it."""

from __future__ import annotations

from pathlib import Path

import pytest

import deepbots_cli
from tests.agents.carts import write_scenario
from tests.agents.test_multi_agent_training import SHARED


@pytest.fixture(scope="session")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run in which both agents have learned, beside its scenario; not to be changed."""
    folder = tmp_path_factory.mktemp("agents")
    deepbots_cli.train(write_scenario(folder, SHARED), run=folder / "run", seed=1)
    return folder / "run"
