"""Gymnasium spaces of a compiled scenario, and which numbers of the last steps an observation is made of."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from deepbots_cli.program import Program
from deepbots_cli.program.task import ActionRange, Choices, viewed


def observation_space(scenario: Program) -> gym.Space[Any]:
    """One float32 per number that the policy sees: [-1, 1], [0, 1] for a truth value, without bounds if it is not clipped.

    With pictures or a goal, that stands as `observation` in a Dict beside them: pictures under their names as uint8 (rows,
    columns, channels), and `achieved_goal` and `desired_goal`.
    """
    entries = [scenario.numbers[index] for index, _ in viewed(scenario.numbers, scenario.agent.stack)]
    low = np.array([0.0 if entry.truth else -1.0 if entry.clip else -np.inf for entry in entries], np.float32)
    high = np.array([1.0 if entry.truth or entry.clip else np.inf for entry in entries], np.float32)
    box = gym.spaces.Box(low, high, dtype=np.float32)
    if scenario.goal is None and not scenario.images:
        return box
    parts: dict[str, gym.Space[Any]] = {"observation": box} if entries or not scenario.images else {}
    for pictured in scenario.images:
        rows, columns, channels = pictured.shape
        parts[pictured.key] = gym.spaces.Box(0, 255, (rows, columns, channels * len(pictured.ages(scenario.agent.stack))), np.uint8)
    if scenario.goal is not None:
        goal = gym.spaces.Box(-1.0, 1.0, (len(scenario.goal.low),), np.float32)
        parts |= {"achieved_goal": goal, "desired_goal": goal}
    return gym.spaces.Dict(parts)


def depth(scenario: Program) -> int:
    """How many steps must be kept for the longest history."""
    stack = scenario.agent.stack
    return stack + max([entry.history for entry in scenario.observation], default=1) - 1


def views(scenario: Program) -> NDArray[np.intp]:
    """Where the numbers of an observation stand in a ring of frames; row p is for a newest frame in place p."""
    seen = np.array(viewed(scenario.numbers, scenario.agent.stack), np.intp).reshape(-1, 2)
    frames = depth(scenario)
    newest = np.arange(frames)[:, None]
    return (newest - seen[:, 1]) % frames * len(scenario.numbers) + seen[:, 0]


def action_space(scenario: Program) -> gym.Space[Any]:
    """Discrete for one choice, MultiDiscrete for several, Box [-1, 1] for intervals; a Dict of `choices` and `ranges` for both."""
    options = [len(part.options) for part in scenario.action if isinstance(part, Choices)]
    size = sum(max(1, len(part.components)) for part in scenario.action if isinstance(part, ActionRange))
    ranges = gym.spaces.Box(-1.0, 1.0, (size,), np.float32)
    if not options:
        return ranges
    choices: gym.Space[Any] = gym.spaces.Discrete(options[0]) if len(options) == 1 else gym.spaces.MultiDiscrete(options)
    return gym.spaces.Dict({"choices": choices, "ranges": ranges}) if size else choices
