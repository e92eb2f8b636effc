"""The levels of a curriculum in which each world of a training has its own."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

LIMITS = ("max_steps", "max_time")
"""The names of the limits of an episode."""
SUCCESS = "success"
"""The outcome of an episode that has reached its goal when a limit ends it; an ending has its own name."""


@dataclass(frozen=True)
class Levels:
    """Levels from 0, the easiest, up, and how a world changes its own.

    Attributes:
        count: The number of levels.
        values: The value of each parameter in each level, in SI units, by the name of its draw.
        start: The lowest and the highest level in which worlds begin.
        up: The outcomes after which the next episode is one level higher: names of endings and limits, and
            `SUCCESS`.
        down: The outcomes after which it is one level lower.
        is_random_at_top: Whether `up` in the highest level leads to a random level.
    """

    count: int
    values: tuple[tuple[str, tuple[float, ...]], ...]
    start: tuple[int, int]
    up: frozenset[str]
    down: frozenset[str]
    is_random_at_top: bool

    def digest_fields(self) -> dict[str, object]:
        # The order of a set of texts differs between processes.
        return {**vars(self), "up": tuple(sorted(self.up)), "down": tuple(sorted(self.down))}

    def first(self, world: int) -> int:
        """Return the level in which a world begins: the levels from the lowest to the highest, in turn."""
        low, high = self.start
        return low + world % (high - low + 1)

    def settings(self, level: int) -> Mapping[str, float]:
        """Return the values of the draws in a level, as `options` of `reset`."""
        return {name: values[level] for name, values in self.values}

    def next(self, level: int, outcomes: Sequence[str], draw: Callable[[], int]) -> int:
        """Return the level after an episode.

        Args:
            level: The level of the episode.
            outcomes: The outcome of the episode, for each copy of a robot that ended it. `down` has
                precedence.
            draw: Returns a random whole number from 0 up, for a random level.
        """
        if not self.down.isdisjoint(outcomes):
            return max(0, level - 1)
        if self.up.isdisjoint(outcomes):
            return level
        if level < self.count - 1:
            return level + 1
        return draw() % self.count if self.is_random_at_top else level
