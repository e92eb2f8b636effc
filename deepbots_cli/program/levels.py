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
        per_world: The name of a draw, and its values (SI units), of which each world has one for the whole
            training; none without it.
    """

    count: int
    values: tuple[tuple[str, tuple[float, ...]], ...]
    start: tuple[int, int]
    up: frozenset[str]
    down: frozenset[str]
    is_random_at_top: bool
    per_world: tuple[str, tuple[float, ...]] | None = None

    def digest_fields(self) -> dict[str, object]:
        # The order of a set of texts differs between processes.
        fields = {**vars(self), "up": tuple(sorted(self.up)), "down": tuple(sorted(self.down))}
        if self.per_world is None:  # The digests of files without it stay.
            del fields["per_world"]
        return fields

    def first(self, world: int) -> int:
        """Return the level in which a world begins: the levels from the lowest to the highest, in turn, and
        all values of `per_world` in each of them."""
        low, high = self.start
        turns = 1 if self.per_world is None else len(self.per_world[1])
        return low + world // turns % (high - low + 1)

    def settings(self, world: int, level: int) -> Mapping[str, float]:
        """Return the values of the draws of a world in a level, as `options` of `reset`."""
        return {name: values[level] for name, values in self.values} | self.settings_of(world)

    def settings_of(self, world: int) -> dict[str, float]:
        """Return the value of `per_world` that a world has in all levels."""
        if self.per_world is None:
            return {}
        name, values = self.per_world
        return {name: values[world % len(values)]}

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
