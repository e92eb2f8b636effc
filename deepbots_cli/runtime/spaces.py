"""Gymnasium spaces of a compiled scenario, and which numbers of the last steps an observation is made of."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from deepbots_cli.errors import UsageError
from deepbots_cli.ir import Choices, CompiledScenario, Interval, viewed


def observation_space(scenario: CompiledScenario) -> gym.Space[Any]:
    """One float32 per number that the policy sees: [-1, 1], [0, 1] for a truth value, without bounds if it is not clipped.

    With a goal, that stands as `observation` in a Dict beside `achieved_goal` and `desired_goal`.
    """
    entries = [scenario.observation[index] for index, _ in viewed(scenario.observation, scenario.agent.stack)]
    low = np.array([0.0 if entry.truth else -1.0 if entry.clip else -np.inf for entry in entries], np.float32)
    high = np.array([1.0 if entry.truth or entry.clip else np.inf for entry in entries], np.float32)
    box = gym.spaces.Box(low, high, dtype=np.float32)
    if scenario.goal is None:
        return box
    goal = gym.spaces.Box(-1.0, 1.0, (len(scenario.goal.low),), np.float32)
    return gym.spaces.Dict({"observation": box, "achieved_goal": goal, "desired_goal": goal})


def views(scenario: CompiledScenario) -> NDArray[np.intp]:
    """Where the numbers of an observation stand in a ring of frames; row p is for a newest frame in place p.

    There are as many rows as frames are needed for the longest history.
    """
    seen = np.array(viewed(scenario.observation, scenario.agent.stack), np.intp).reshape(-1, 2)
    depth = 1 + int(seen[:, 1].max(initial=0))
    newest = np.arange(depth)[:, None]
    return (newest - seen[:, 1]) % depth * len(scenario.observation) + seen[:, 0]


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
