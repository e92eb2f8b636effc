"""The programs of docs/python.md run; whole, they reach what the page says."""

from __future__ import annotations

from importlib import util
from pathlib import Path
from typing import Any

import numpy as np
import pytest

FOLDER = Path(__file__).parents[2] / "docs" / "examples"


def main_of(name: str) -> Any:
    spec = util.spec_from_file_location(f"docs_example_{name}", FOLDER / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.main


def test_the_agent_in_numpy_runs() -> None:
    assert main_of("numpy_agent")(generations=1, candidates=3, elite=2) > 0.0


def test_ppo_in_one_file_runs() -> None:
    assert len(main_of("ppo")(total_timesteps=256, copies=2, steps=64)) > 2


def test_stable_baselines3_by_hand_runs(tmp_path: Path) -> None:
    assert main_of("sb3_by_hand")(total_timesteps=256, folder=str(tmp_path)) > 0.0


def test_the_loop_in_the_vector_api_runs() -> None:
    assert main_of("vector_loop")(steps=40, copies=2) != {}


def test_the_page_names_every_program() -> None:
    page = (FOLDER.parent / "python.md").read_text(encoding="utf-8")
    assert all(f"(examples/{path.name})" in page for path in FOLDER.glob("*.py"))


@pytest.mark.slow
def test_whole_they_learn(tmp_path: Path) -> None:
    assert main_of("numpy_agent")() > 150.0
    assert np.mean(main_of("ppo")()[-50:]) > 150.0
    assert main_of("sb3_by_hand")(folder=str(tmp_path)) > 150.0
