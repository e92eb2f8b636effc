"""What a bar looks at: a figure of a training, of an evaluation or of a baseline, read from the record of a scenario.

Each has `words`, a `unit`, and `values(record)`: one number for each seed that was measured, in the order of the seeds. What never
happened, such as a task that was not solved, is an infinity: more hours than any bar allows.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal, Protocol

Record = Mapping[str, Any]
When = Literal["simulated_hours", "steps", "episode"]
Metric = Literal["return", "success"]

_UNITS = {"simulated_hours": "h", "cpu_seconds": "s", "success_rate": "%"}
_NAMES = {
    "simulated_hours": "simulated hours",
    "episode": "episodes",
    "cpu_seconds": "CPU time",
    "success_rate": "episodes that succeed",
    "successes": "episodes that succeed",
    "mean_return": "mean return",
    "least_return": "worst return",
    "mean_length": "mean length in steps",
}


class Figure(Protocol):
    """A figure with one value for each seed, or with a single one."""

    @property
    def words(self) -> str: ...
    @property
    def unit(self) -> str: ...
    @property
    def training(self) -> str | None:
        """The training whose seeds the values are of; None for a single value."""

    def values(self, record: Record) -> list[float]: ...


def seeds_of(record: Record, training: str) -> Iterator[Record]:
    """The entries of the seeds that were measured, in the order of the seeds."""
    measured = record.get("trainings", {}).get(training, {})
    return (measured[seed] for seed in sorted(measured, key=int))


def _or_never(entry: Record | None, key: str) -> float:
    return math.inf if entry is None else float(entry[key])


def _named(key: str) -> str:
    return _NAMES.get(key, key.replace("_", " "))


@dataclass(frozen=True)
class Solved:
    """When the scenario's own `solved` was first met."""

    when: When
    training: str = "main"

    @property
    def words(self) -> str:
        return f"{_named(self.when)} until solved"

    @property
    def unit(self) -> str:
        return _UNITS.get(self.when, "")

    def values(self, record: Record) -> list[float]:
        return [_or_never(seed["solved_at"], self.when) for seed in seeds_of(record, self.training)]


@dataclass(frozen=True)
class Crossed:
    """When the mean of 100 consecutive training episodes first was at least `threshold`, in the last stage of a curriculum."""

    threshold: float
    when: When
    metric: Metric = "return"
    training: str = "main"

    @property
    def key(self) -> str:
        """Its name in a record."""
        return f"{self.metric} {self.threshold:g}"

    @property
    def words(self) -> str:
        what = f"a mean return of {self.threshold:g}" if self.metric == "return" else f"{100 * self.threshold:.4g} % successes"
        return f"{_named(self.when)} until {what} over 100 episodes"

    @property
    def unit(self) -> str:
        return _UNITS.get(self.when, "")

    def values(self, record: Record) -> list[float]:
        return [
            _or_never(seed["crossings"][self.key], self.when) for seed in seeds_of(record, self.training) if self.key in seed["crossings"]
        ]


@dataclass(frozen=True)
class Trained:
    """What a training took as a whole."""

    what: Literal["simulated_hours", "steps", "episodes", "cpu_seconds"]
    training: str = "main"

    @property
    def words(self) -> str:
        return f"{_named(self.what)} of the training"

    @property
    def unit(self) -> str:
        return _UNITS.get(self.what, "")

    def values(self, record: Record) -> list[float]:
        return [float(seed[self.what]) for seed in seeds_of(record, self.training)]


@dataclass(frozen=True)
class Held:
    """A figure of the held-out episodes; `case` is one that was gone through with the scenario itself."""

    what: Literal["success_rate", "successes", "mean_return", "least_return", "mean_length"]
    evaluation: str = "held_out"
    case: str | None = None
    training: str = "main"

    @property
    def words(self) -> str:
        place = f"case {self.case}" if self.case else "" if self.evaluation == "held_out" else self.evaluation.replace("_", " ")
        return f"{_named(self.what)}, held out{place and f', {place}'}"

    @property
    def unit(self) -> str:
        return _UNITS.get(self.what, "")

    def entries(self, record: Record) -> list[Record]:
        """What was evaluated, for each seed that was."""
        found = [seed["evaluations"].get(self.evaluation) for seed in seeds_of(record, self.training)]
        cases = [entry and (entry if self.case is None else entry["cases"].get(self.case)) for entry in found]
        return [entry for entry in cases if entry is not None]

    def values(self, record: Record) -> list[float]:
        return [float(entry[self.what]) for entry in self.entries(record)]


@dataclass(frozen=True)
class Tried:
    """A figure of a baseline."""

    baseline: str
    what: Literal["success_rate", "successes", "mean_return", "least_return", "mean_length"]
    training: None = None

    @property
    def words(self) -> str:
        return f"{_named(self.what)}, {self.baseline.replace('_', ' ')}"

    @property
    def unit(self) -> str:
        return _UNITS.get(self.what, "")

    def values(self, record: Record) -> list[float]:
        entry = record.get("baselines", {}).get(self.baseline)
        return [] if entry is None else [float(entry[self.what])]


@dataclass(frozen=True)
class Ahead:
    """How far the mean return of a trained policy is above that of a baseline, with their intervals of 95 % between them."""

    baseline: str = "random"
    evaluation: str = "held_out"
    case: str | None = None
    training: str = "main"
    unit: str = ""

    @property
    def words(self) -> str:
        return f"{Held('mean_return', self.evaluation, self.case).words}, beyond the intervals above {self.baseline.replace('_', ' ')}"

    def values(self, record: Record) -> list[float]:
        base = record.get("baselines", {}).get(self.baseline)
        held = Held("mean_return", self.evaluation, self.case, self.training).entries(record)
        return [] if base is None else [_ends(entry)[0] - _ends(base)[1] for entry in held]


def _ends(entry: Record) -> tuple[float, float]:
    low, high = entry["return_interval"]
    return float(low), float(high)
