"""Windows over the episodes of worlds that run side by side: the newest episodes of each world, equally many
of each.

The newest episodes of all worlds together are a biased sample: in 256 worlds that begin at once, the episodes
that fail early end first, and those that succeed end last and all at the same time. A window of 100 episodes
then holds failures only, and soon after successes only. A window therefore moves by generations: the nth
newest episodes of all worlds are one generation, and a window has whole generations. For a policy that does
not change, the newest finished episodes of a world have the distribution of all its episodes, at any time
after each world has finished so many (renewal theory: the interval that covers a point in time is longer than
others, and the intervals before it are not).

With one world, these are the newest episodes.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from itertools import chain
from typing import Generic, TypeVar

Item = TypeVar("Item")


class Generations(Generic[Item]):
    """The newest items of each world, one for each episode.

    Args:
        episodes: The least number of episodes of a full window, from 1.
        worlds: The number of worlds.
        copies: The number of episodes that end at once in a world, one for each copy of a robot.
    """

    def __init__(self, episodes: int, worlds: int = 1, copies: int = 1) -> None:
        self._copies = copies
        self._rows = worlds * copies
        self._window: list[deque[Item]] = [deque(maxlen=self._of_each(episodes)) for _ in range(worlds)]

    def _of_each(self, episodes: int) -> int:
        """Return the episodes of each world in whole generations of at least so many episodes."""
        return math.ceil(episodes / self._rows) * self._copies

    def add(self, item: Item, world: int = 0) -> None:
        """Add the episode of a world that has just ended."""
        self._window[world].append(item)

    def clear(self) -> None:
        """Forget all episodes."""
        for items in self._window:
            items.clear()

    @property
    def is_full(self) -> bool:
        """Whether each world has all of its episodes of the window."""
        return all(len(items) == items.maxlen for items in self._window)

    @property
    def finished(self) -> list[Item]:
        """The episodes of all worlds. Before the window is full, some worlds may have more than others."""
        return list(chain.from_iterable(self._window))

    @property
    def whole(self) -> list[Item]:
        """The newest whole generations; empty before each world has finished an episode."""
        least = min(map(len, self._window))
        return self._newest(least - least % self._copies)

    def newest(self, episodes: int) -> list[Item] | None:
        """Return the newest whole generations with at least so many episodes, or the whole window if it has
        fewer.

        The result is None while some world has not finished its part.
        """
        count = min(self._of_each(episodes), self._window[0].maxlen or 1)
        return self._newest(count) if all(len(items) >= count for items in self._window) else None

    def _newest(self, count: int) -> list[Item]:
        """Return the newest `count` episodes of each world."""
        return [item for items in self._window for item in list(items)[len(items) - count :]]

    def state(self) -> tuple[list[Item], list[int]]:
        """Return the items, and the world of each."""
        return self.finished, [world for world, items in enumerate(self._window) for _ in items]

    def restore(self, items: Sequence[Item], worlds: Sequence[int] | None) -> None:
        """Restore items that `state` returned.

        Versions before 0.2 kept no worlds. The items of several worlds are then dropped, since their
        generations are unknown.

        Raises:
            ValueError: The worlds do not fit.
        """
        self.clear()
        if worlds is None:
            worlds = [0] * len(items) if len(self._window) == 1 else []
            items = items[: len(worlds)]
        if len(worlds) != len(items) or not all(0 <= world < len(self._window) for world in worlds):
            raise ValueError(
                f"the worlds of {len(items)} episodes do not fit a training with {len(self._window)} worlds"
            )
        for item, world in zip(items, worlds, strict=True):
            self.add(item, world)
