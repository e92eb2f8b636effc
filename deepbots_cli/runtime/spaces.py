"""Gymnasium spaces of a compiled scenario."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from deepbots_cli.errors import UsageError
from deepbots_cli.ir import Choices, CompiledScenario, Interval


def observation_space(scenario: CompiledScenario) -> gym.Space[NDArray[np.float32]]:
    """One float32 per observed number: [-1, 1], or [0, 1] for a truth value."""
    low = np.array([0.0 if entry.truth else -1.0 for entry in scenario.observation], np.float32)
    box: gym.Space[Any] = gym.spaces.Box(low, np.ones_like(low), dtype=np.float32)
    return box


def action_space(scenario: CompiledScenario) -> gym.Space[Any]:
    """Discrete for one choice, MultiDiscrete for several, Box [-1, 1] for intervals."""
    choices = [part for part in scenario.action if isinstance(part, Choices)]
    intervals = [part for part in scenario.action if isinstance(part, Interval)]
    if choices and intervals:
        raise UsageError("choices and intervals in one action are not supported by this version")
    if intervals:
        size = sum(max(1, len(part.components)) for part in intervals)
        return gym.spaces.Box(-1.0, 1.0, (size,), np.float32)
    if len(choices) == 1:
        return gym.spaces.Discrete(len(choices[0].options))
    return gym.spaces.MultiDiscrete([len(part.options) for part in choices])
