"""The programs of docs/python.md run; whole, they reach what the page says."""

from __future__ import annotations

from importlib import import_module, util
from pathlib import Path
from typing import Any

import gymnasium as gym
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


def test_the_package_for_sbx_is_loaded_without_jax_and_stores_weights_as_tensors(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.syspath_prepend(str(FOLDER / "sbx"))
    package = import_module("deepbots_sbx")
    assert [(model.base(), model.import_path) for model in (package.JaxPPO, package.JaxSAC)] == [
        ("PPO", "deepbots_sbx.algorithms:JaxPPO"),
        ("SAC", "deepbots_sbx.algorithms:JaxSAC"),
    ]
    pytest.importorskip("sbx")
    algorithms, space = import_module("deepbots_sbx.algorithms"), gym.spaces.Box(-1, 1, (4,), np.float32)
    one, other = (
        algorithms.JaxPPO("MlpPolicy", _Still(space), n_steps=8, batch_size=8, seed=seed) for seed in (0, 1)
    )
    one.learn(16)
    for part in one._get_torch_save_params()[0]:
        getattr(other, part).load_state_dict(getattr(one, part).state_dict())
    seen = np.linspace(-1, 1, 40, dtype=np.float32).reshape(10, 4)
    assert all(
        np.array_equal(one.predict(seen, deterministic=d)[0], other.predict(seen, deterministic=d)[0])
        for d in (True, False)
    )


class _Still(gym.Env[Any, Any]):
    """Gives the same observation."""

    def __init__(self, space: gym.spaces.Box) -> None:
        self.observation_space, self.action_space = space, gym.spaces.Discrete(2)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        return np.zeros(4, np.float32), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        return np.zeros(4, np.float32), 1.0, False, False, {}


def test_the_page_names_every_program() -> None:
    page = (FOLDER.parent / "python.md").read_text(encoding="utf-8")
    assert all(f"(examples/{path.name})" in page for path in FOLDER.glob("*.py"))


@pytest.mark.slow
def test_whole_they_learn(tmp_path: Path) -> None:
    assert main_of("numpy_agent")() > 150.0
    assert np.mean(main_of("ppo")()[-50:]) > 150.0
    assert main_of("sb3_by_hand")(folder=str(tmp_path)) > 150.0
