"""The last pictures of one kind."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray


class Album:
    """A ring of pictures, uint8; which of them are seen together follows from their ages in steps."""

    def __init__(self, shape: Sequence[int], ages: Sequence[int], depth: int) -> None:
        self.frames = np.zeros((depth, *shape), np.uint8)
        self._places = (np.arange(depth)[:, None] - np.array(ages)) % depth
        self._shape = (*shape[:2], shape[2] * len(ages))

    def seen(self, newest: int) -> NDArray[np.uint8]:
        """The pictures, oldest first, with their channels side by side; a copy. `newest` is the place of the last one."""
        return np.reshape(self.frames[self._places[newest]].transpose(1, 2, 0, 3), self._shape)
