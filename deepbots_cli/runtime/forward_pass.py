"""The actions of a policy for several rows, with results that do not depend on the number of worlds.

The rounding of a matrix product depends on the number of rows and on the index of a row, and a rounding error
can change an action. Therefore every forward pass has `FORWARD_BATCH_SIZE` rows, and episode k always uses
row k mod `FORWARD_BATCH_SIZE`. The content of other rows does not affect it.
"""

from __future__ import annotations

from typing import Any, Protocol

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

FORWARD_BATCH_SIZE = 8
"""The number of rows of a forward pass. A pass of a small policy takes about 0.1 ms for any number of rows up
to 16; more worlds than 8 gain little."""


class Predictor(Protocol):
    """A policy: actions for rows of observations, and the memory of a recurrent policy after them."""

    takes_masks: bool

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
        action_masks: Any = None,
    ) -> tuple[Any, Any]: ...


class ForwardPass:
    """The observations of one forward pass. Rows of worlds that do not run keep their last values.

    If the policy takes action masks, `masks` has which of the `choices` of each row are allowed. A recurrent
    policy has a `memory` for each row, which is reset where `starts` is true because an episode begins.
    """

    def __init__(self, space: gym.Space[Any], choices: int | None, size: int = FORWARD_BATCH_SIZE) -> None:
        self.memory: Any = None
        self.starts = np.ones(size, dtype=bool)
        self.masks: Array | None = None if choices is None else np.ones((size, choices), dtype=bool)
        self.observations: Any = (
            {key: _zeros(part, size) for key, part in space.spaces.items()}
            if isinstance(space, gym.spaces.Dict)
            else _zeros(space, size)
        )

    def predict(self, policy: Predictor, *, deterministic: bool) -> Any:
        """Return an action for each row."""
        actions, self.memory = policy.predict(
            self.observations, self.memory, self.starts, deterministic, self.masks
        )
        self.starts[:] = False
        return actions

    def put_all(self, observations: Any, worlds: slice, masks: Array | None) -> None:
        """Put the rows of these worlds of a batch, from the first row on."""
        count = worlds.stop - worlds.start
        if self.masks is not None and masks is not None:
            self.masks[:count] = masks[worlds]
        if isinstance(self.observations, dict):
            for key, rows in self.observations.items():
                rows[:count] = observations[key][worlds]
        else:
            self.observations[:count] = observations[worlds]

    def put(self, row: int, observation: Any, masks: Array | None) -> None:
        """Put one row."""
        if self.masks is not None and masks is not None:
            self.masks[row] = masks
        if isinstance(self.observations, dict):
            for key, rows in self.observations.items():
                rows[row] = observation[key]
        else:
            self.observations[row] = observation


def _zeros(space: gym.Space[Any], rows: int) -> Array:
    return np.zeros((rows, *(space.shape or ())), dtype=space.dtype)
