"""Actions: made of options and values, and in the forms in which others give them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np


def composed(space: gym.Space[Any], choices: Sequence[int], ranges: Sequence[float]) -> Any:
    """The action of `space` with these options by number, one per choice, and these values from -1 to 1."""
    if isinstance(space, gym.spaces.Dict):
        return {"choices": composed(space["choices"], choices, ()), "ranges": composed(space["ranges"], (), ranges)}
    if isinstance(space, gym.spaces.Discrete):
        return choices[0]
    return np.array(choices, np.int64) if choices else np.array(ranges, np.float32)


def usual(space: gym.Space[Any], action: Any) -> Any:
    """The action as generated code takes it (int or array), or None if it is none of this space."""
    try:
        if isinstance(space, gym.spaces.Dict):
            parts = {key: usual(part, action[key]) for key, part in space.spaces.items()} if set(action) == set(space.spaces) else {}
            return parts if parts and all(part is not None for part in parts.values()) else None
        array = np.asarray(action)
        if isinstance(space, gym.spaces.Box):
            fits = array.shape == space.shape and np.isrealobj(array) and np.isfinite(array.astype(float)).all()
            return array if fits else None
        if isinstance(space, gym.spaces.Discrete):
            return array.item() if array.ndim == 0 and space.contains(array.item()) else None
        return array if space.contains(array) else None
    except (TypeError, ValueError, OverflowError):
        return None


def alike(usual: Any, action: Any) -> bool:
    """Whether an action came in the form in which generated code takes it."""
    if isinstance(usual, dict):
        return all(alike(part, action[key]) for key, part in usual.items())
    return type(usual) is type(action) or isinstance(action, int | np.integer)
