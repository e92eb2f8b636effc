"""Stable-Baselines3 has the private members that deepbots uses, and one module names them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3.common.vec_env import VecNormalize

from deepbots_cli.learning.sb3 import algorithms, internals
from deepbots_cli.learning.sb3.rollouts import spaces_only
from deepbots_cli.program.task import Hindsight, Training
from tests.private_members import private_members

MODULE = Path(internals.__file__)
RANGES = gym.spaces.Box(-1.0, 1.0, (2,), np.float32)
GOALS = gym.spaces.Dict(dict.fromkeys(("observation", "achieved_goal", "desired_goal"), RANGES))


def learner_of(
    algorithm: str, observations: gym.Space[Any] = RANGES, actions: gym.Space[Any] = RANGES, **settings: Any
) -> Any:
    env: Any = VecNormalize(spaces_only(observations, actions), norm_obs=False)
    return algorithms.create(Training(algorithm, 1_000, **settings), env, seed=0, total_timesteps=1_000)


def test_the_library_has_each_private_member() -> None:
    models = [
        learner_of("PPO"),
        learner_of("RecurrentPPO"),
        learner_of("SAC"),
        learner_of("DDPG", GOALS, replay=Hindsight()),
    ]
    models.append(learner_of("DQN", actions=gym.spaces.Discrete(2)))
    parts: list[Any] = [*models, models[0].env, *(model.policy for model in models)]
    parts += [
        getattr(model, name)
        for model in models
        for name in ("rollout_buffer", "replay_buffer")
        if hasattr(model, name)
    ]
    used = {name for _, name in private_members(MODULE)}
    assert len(used) > 15
    assert {name for name in used if not any(hasattr(part, name) for part in parts)} == set()


INTERNALS = {"learning/sb3": "internals.py", "cluster": "ray_internals.py"}


@pytest.mark.parametrize("package", INTERNALS)
def test_one_module_of_a_package_names_private_members(package: str) -> None:
    folder = MODULE.parents[2] / package
    named = [path.name for path in folder.glob("*.py") if any(private_members(path))]
    assert named == [INTERNALS[package]]
