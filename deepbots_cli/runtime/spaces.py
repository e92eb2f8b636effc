"""Spaces of a compiled scenario, actions in their forms, and rewards for other goals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, cast

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from deepbots_cli.arrays import evaluate
from deepbots_cli.errors import EvaluationError, UsageError
from deepbots_cli.expressions.scalar import Name
from deepbots_cli.program.task import Agent, Goal
from deepbots_cli.runtime.formulas import clip

Column = NDArray[Any]
Goals = NDArray[np.floating[Any]]


def observation_space(agent: Agent) -> gym.Space[Any]:
    """Return the space of one float32 per number that the policy sees: [-1, 1], [0, 1] for a truth value,
    without bounds if it is not clipped.

    With pictures or a goal, this space is `observation` in a Dict beside them: pictures under their names as
    uint8 (rows, columns, channels), and `achieved_goal` and `desired_goal`.
    """
    high = np.array([1.0 if entry.truth or entry.clipped else np.inf for entry in agent.inputs], np.float32)
    low = -high
    low[[entry.truth for entry in agent.inputs]] = 0.0
    box = gym.spaces.Box(low, high, dtype=np.float32)
    if agent.goal is None and not agent.images:
        return box
    parts: dict[str, gym.Space[Any]] = {"observation": box} if agent.inputs or not agent.images else {}
    for pictured in agent.images:
        rows, columns, channels = pictured.shape
        parts[pictured.key] = gym.spaces.Box(
            0, 255, (rows, columns, channels * len(pictured.ages(agent.frame_stack))), np.uint8
        )
    if agent.goal is not None:
        goal = gym.spaces.Box(-1.0, 1.0, (len(agent.goal.low),), np.float32)
        parts |= {"achieved_goal": goal, "desired_goal": goal}
    return gym.spaces.Dict(parts)


def scaled_goal(goal: Goal, values: Sequence[float]) -> list[float]:
    """Map the components of an achieved or a desired goal to [-1, 1], and clip them.

    Raises:
        FloatingPointError: A component is not a number.
    """
    scaled = [
        (value - middle) / half for value, middle, half in zip(values, goal.middles, goal.halves, strict=True)
    ]
    return [x if -1.0 <= x <= 1.0 else clip(x) for x in scaled]


def action_space(agent: Agent) -> gym.Space[Any]:
    """Return Discrete for one choice, MultiDiscrete for several, Box [-1, 1] for intervals; a Dict of
    `choices` and `ranges` for both."""
    options = [len(part.options) for part in agent.choices]
    size = len(agent.range_names)
    ranges = gym.spaces.Box(-1.0, 1.0, (size,), np.float32)
    if not options:
        return ranges
    choices: gym.Space[Any] = (
        gym.spaces.Discrete(options[0]) if len(options) == 1 else gym.spaces.MultiDiscrete(options)
    )
    return gym.spaces.Dict({"choices": choices, "ranges": ranges}) if size else choices


def compose_action(space: gym.Space[Any], choices: Sequence[int], ranges: Sequence[float]) -> Any:
    """Return the action of `space` with these options by number, one per choice, and these values from -1 to
    1."""
    if isinstance(space, gym.spaces.Dict):
        return {
            "choices": compose_action(space["choices"], choices, ()),
            "ranges": compose_action(space["ranges"], (), ranges),
        }
    if isinstance(space, gym.spaces.Discrete):
        return choices[0]
    return np.array(choices, np.int64) if choices else np.array(ranges, np.float32)


def compose_rows(space: gym.Space[Any], choices: NDArray[Any], ranges: NDArray[Any]) -> Any:
    """Return actions of `space`, given options by number (row, choice) and values from -1 to 1 (row,
    range)."""
    if isinstance(space, gym.spaces.Dict):
        return {
            "choices": compose_rows(space["choices"], choices, ranges),
            "ranges": compose_rows(space["ranges"], choices, ranges),
        }
    if isinstance(space, gym.spaces.Box):
        return ranges.astype(np.float32)
    options = choices.astype(np.int64)
    return options[:, 0] if isinstance(space, gym.spaces.Discrete) else options


def parts_of_rows(actions: Any) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the options by number (row, choice) and the values (row, range) in actions of one space, one a
    row."""
    if isinstance(actions, dict):
        return parts_of_rows(actions["choices"])[0], actions["ranges"]
    none = np.zeros((len(actions), 0), np.float32)
    if actions.dtype.kind == "f":
        return none.astype(np.int64), actions
    return actions.reshape(len(actions), -1), none


def mask_of_space(space: gym.Space[Any], masks: Sequence[NDArray[np.int8]]) -> Any:
    """Return masks of options, one of each choice, in the form that `space.sample` takes; each may have a row
    per world."""
    if isinstance(space, gym.spaces.Dict):
        return {"choices": mask_of_space(space["choices"], masks), "ranges": None}
    return masks[0] if isinstance(space, gym.spaces.Discrete) else tuple(masks)


def canonical_action(space: gym.Space[Any], action: Any) -> Any:
    """Return the action as generated code takes it (int or array); None if it has another shape or kind, is
    not finite, or names no option. Numbers beyond the bounds of a Box pass."""
    try:
        if isinstance(space, gym.spaces.Dict):
            parts = (
                {key: canonical_action(part, action[key]) for key, part in space.spaces.items()}
                if set(action) == set(space.spaces)
                else {}
            )
            return parts if parts and all(part is not None for part in parts.values()) else None
        array = np.asarray(action)
        if isinstance(space, gym.spaces.Box):
            fits = array.shape == space.shape and array.dtype.kind in "iuf" and np.isfinite(array).all()
            return array if fits else None
        if isinstance(space, gym.spaces.Discrete):
            return array.item() if array.ndim == 0 and space.contains(array.item()) else None
        return array if space.contains(array) else None
    except (TypeError, ValueError, OverflowError):
        return None


def fitting_rows(space: gym.Space[Any], actions: Any, count: int) -> NDArray[np.bool_] | None:
    """Return which of the actions of `count` worlds, one per row, are of this space; None if the actions have
    another shape or kind."""
    try:
        if isinstance(space, gym.spaces.Dict):
            if set(actions) != set(space.spaces):
                return None
            parts = [fitting_rows(part, actions[key], count) for key, part in space.spaces.items()]
            fitting = [part for part in parts if part is not None]
            return np.all(fitting, axis=0) if len(fitting) == len(parts) else None
        array = np.asarray(actions)
    except (TypeError, ValueError):
        return None
    if array.shape != (count, *(space.shape or ())) or array.dtype.kind not in (
        "iuf" if isinstance(space, gym.spaces.Box) else "iu"
    ):
        return None
    if isinstance(space, gym.spaces.Box):
        fits = np.isfinite(array)
    else:
        options = (
            space.n if isinstance(space, gym.spaces.Discrete) else cast(gym.spaces.MultiDiscrete, space).nvec
        )
        fits = (array >= 0) & (array < options)
    rows: NDArray[np.bool_] = np.logical_and.reduce(fits.reshape(count, -1), axis=1)
    return rows


def apply_to_parts(function: Callable[..., Any], *values: Any) -> Any:
    """Apply a function to observations or actions, or to each of their parts where they are dictionaries of
    arrays."""
    if isinstance(values[0], dict):
        return {key: function(*(value[key] for value in values)) for key in values[0]}
    return function(*values)


def joined(rows: Sequence[Any]) -> Any:
    """Return observations or actions, one of each world or agent, as one with a row for each."""
    return apply_to_parts(lambda *parts: np.array(parts), *rows)


def is_canonical(usual: Any, action: Any) -> bool:
    """Return whether an action came in the form in which generated code takes it."""
    if isinstance(usual, dict):
        return all(is_canonical(part, action[key]) for key, part in usual.items())
    return type(usual) is type(action) or isinstance(action, int | np.integer)


# Goals


def recompute_rewards(agent: Agent, achieved: Goals, desired: Goals) -> NDArray[np.float64]:
    """Return the reward that each transition would have got for another goal; `achieved` and `desired` are
    (n, k), as the policy sees them.

    Raises:
        UsageError: The scenario has no goal, or the arrays have another shape.
        EvaluationError: A reward is not finite; names the term.
    """
    goal = agent.goal
    if goal is None:
        raise UsageError("this scenario has no `goal`, so its reward cannot be recomputed for another")
    size = len(goal.low)
    if achieved.ndim != 2 or achieved.shape[1] != size or achieved.shape != desired.shape:
        raise UsageError(
            f"goals of shape {achieved.shape} and {desired.shape}, where this scenario has {size} numbers in"
            " each"
        )
    values = {
        **_goal_values_in_unit(goal, goal.names("achieved"), achieved),
        **_goal_values_in_unit(goal, goal.names("desired"), desired),
    }
    values[Name("goal_reached")] = evaluate(goal.reached, values)
    total = np.zeros(len(achieved))
    for term in agent.reward:
        reward = np.broadcast_to(np.asarray(evaluate(term.scalar, values), float), total.shape)
        if not np.isfinite(reward).all():
            raise EvaluationError(f"the reward term '{term.name}' is not finite for every goal")
        # Term by term as in a step, so that the last bits agree.
        total = total + reward
    return total


def _goal_values_in_unit(goal: Goal, names: tuple[Name, ...], goals: Goals) -> dict[Name, Any]:
    """Return the columns in the unit of the goal; exactly what the names mean in a step."""
    columns = goals.astype(np.float64).T
    return {
        name: middle + half * column
        for name, middle, half, column in zip(names, goal.middles, goal.halves, columns, strict=True)
    }
