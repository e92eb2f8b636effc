"""Spaces of a compiled scenario, actions in their forms, stacks of the frames of an observation, and rewards
for other goals."""

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

Goals = NDArray[np.floating[Any]]


def observation_space(agent: Agent) -> gym.Space[Any]:
    """One float32 per number that the policy sees: [-1, 1], [0, 1] for a truth value, without bounds if it is
    not clipped.

    With pictures or a goal, that stands as `observation` in a Dict beside them: pictures under their names as
    uint8 (rows, columns, channels), and `achieved_goal` and `desired_goal`.
    """
    low = np.array(
        [0.0 if entry.truth else -1.0 if entry.clipped else -np.inf for entry in agent.inputs], np.float32
    )
    high = np.array([1.0 if entry.truth or entry.clipped else np.inf for entry in agent.inputs], np.float32)
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


def frame_indices(agent: Agent) -> NDArray[np.intp]:
    """The indices of the numbers of an observation in a ring of frames; row p is for a newest frame in place
    p."""
    seen = np.array(agent.seen, np.intp).reshape(-1, 2)
    frames = agent.frame_stack + max([entry.history for entry in agent.observation], default=1) - 1
    newest = np.arange(frames)[:, None]
    return (newest - seen[:, 1]) % frames * len(agent.numbers) + seen[:, 0]


def action_space(agent: Agent) -> gym.Space[Any]:
    """Discrete for one choice, MultiDiscrete for several, Box [-1, 1] for intervals; a Dict of `choices` and
    `ranges` for both."""
    options, size = [len(part.options) for part in agent.choices], len(agent.range_names)
    ranges = gym.spaces.Box(-1.0, 1.0, (size,), np.float32)
    if not options:
        return ranges
    choices: gym.Space[Any] = (
        gym.spaces.Discrete(options[0]) if len(options) == 1 else gym.spaces.MultiDiscrete(options)
    )
    return gym.spaces.Dict({"choices": choices, "ranges": ranges}) if size else choices


def compose_action(space: gym.Space[Any], choices: Sequence[int], ranges: Sequence[float]) -> Any:
    """The action of `space` with these options by number, one per choice, and these values from -1 to 1."""
    if isinstance(space, gym.spaces.Dict):
        return {
            "choices": compose_action(space["choices"], choices, ()),
            "ranges": compose_action(space["ranges"], (), ranges),
        }
    if isinstance(space, gym.spaces.Discrete):
        return choices[0]
    return np.array(choices, np.int64) if choices else np.array(ranges, np.float32)


def mask_of_space(space: gym.Space[Any], masks: Sequence[NDArray[np.int8]]) -> Any:
    """Masks of options, one of each choice, in the form that `space.sample` takes; each may have a row per
    world."""
    if isinstance(space, gym.spaces.Dict):
        return {"choices": mask_of_space(space["choices"], masks), "ranges": None}
    return masks[0] if isinstance(space, gym.spaces.Discrete) else tuple(masks)


def canonical_action(space: gym.Space[Any], action: Any) -> Any:
    """The action as generated code takes it (int or array), or None if it is none of this space."""
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
            fits = (
                array.shape == space.shape and np.isrealobj(array) and np.isfinite(array.astype(float)).all()
            )
            return array if fits else None
        if isinstance(space, gym.spaces.Discrete):
            return array.item() if array.ndim == 0 and space.contains(array.item()) else None
        return array if space.contains(array) else None
    except (TypeError, ValueError, OverflowError):
        return None


def fitting_rows(space: gym.Space[Any], actions: Any, count: int) -> NDArray[np.bool_] | None:
    """Which of the actions of `count` worlds, one per row, are of this space; None if the actions have
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


def by_part(function: Callable[..., Any], *values: Any) -> Any:
    """The function of observations or actions, or of each of their parts where they are dictionaries of
    arrays."""
    if isinstance(values[0], dict):
        return {key: function(*(value[key] for value in values)) for key in values[0]}
    return function(*values)


def joined(rows: Sequence[Any]) -> Any:
    """Observations or actions, one of each world or agent, as one with a row for each."""
    return by_part(lambda *parts: np.array(parts), *rows)


def is_canonical(usual: Any, action: Any) -> bool:
    """Whether an action came in the form in which generated code takes it."""
    if isinstance(usual, dict):
        return all(is_canonical(part, action[key]) for key, part in usual.items())
    return type(usual) is type(action) or isinstance(action, int | np.integer)


class FrameStack:
    """A ring of pictures, uint8; which of them are seen together follows from their ages in steps."""

    def __init__(self, shape: Sequence[int], ages: Sequence[int], depth: int) -> None:
        self.frames = np.zeros((depth, *shape), np.uint8)
        self._places = (np.arange(depth)[:, None] - np.array(ages)) % depth
        self._shape = (*shape[:2], shape[2] * len(ages))

    def seen(self, newest: int) -> NDArray[np.uint8]:
        """The pictures, oldest first, with their channels side by side; a copy. `newest` is the place of the
        last one."""
        return np.reshape(self.frames[self._places[newest]].transpose(1, 2, 0, 3), self._shape)


# Goals


def recompute_rewards(agent: Agent, achieved: Goals, desired: Goals) -> NDArray[np.float64]:
    """The reward that each transition would have got for another goal; `achieved` and `desired` are (n, k),
    as the policy sees them.

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
        total = total + reward
    return total


def _goal_values_in_unit(goal: Goal, names: tuple[Name, ...], seen: Goals) -> dict[Name, Any]:
    """The columns in the unit of the goal; exactly what the names mean in a step."""
    columns = seen.astype(np.float64).T
    return {
        name: (high + low) / 2 + (high - low) / 2 * column
        for name, low, high, column in zip(names, goal.low, goal.high, columns, strict=True)
    }
