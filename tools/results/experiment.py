"""What is measured of a shipped scenario, and what is asked of it: plain data, one `Experiment` each.

To put a scenario on the results page, write `tools/results/experiments/<scenario>.py` with

    EXPERIMENTS = (Experiment(scenario="...", ...),)

in it (`experiments/cartpole.py` is a short one), or enter the scenario with a reason in
`experiments/not_measured.py`. Then `make results SCENARIO=<scenario>` measures and renders. A bar looks at a
figure:

    Bar(Solved("simulated_hours"), at_most=1.3)                                  every seed solved within 1.3
                                                                                 h
    Bar(Crossed(0.9, "simulated_hours"), at_most=3, stretch=True)                mean of 100 episodes at least
                                                                                 0.9 within 3 h
    Bar(Held("success_rate", case="few"), at_least=0.92, over="mean")            mean of the seeds, over an
                                                                                 evaluation
    Bar(Tried("forward", "successes"), at_most=0)                                of a baseline, which has no
                                                                                 seeds
    Bar(Trained("cpu_seconds"), at_most=60)                                      of the training itself
    Bar(Ahead("random"), at_least=0)                                             better than random for sure,
                                                                                 where no figure is set

Reported seeds count from 101; 0 to 9 are for tuning and never appear here. A second training, such as a
longer one for a stretch or one with another algorithm, has a name of its own, which figures take as
`training=`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path, PurePosixPath
from typing import Any, Literal, Protocol

Record = Mapping[str, Any]
When = Literal["simulated_hours", "steps", "episode"]
FIRST_SEED = 101


def seeds(count: int, first: int = FIRST_SEED) -> tuple[int, ...]:
    """Consecutive seeds for reported results."""
    return tuple(range(first, first + count))


@dataclass(frozen=True)
class Evaluation:
    """Held-out episodes of each trained policy of a training.

    Without `case`, the scenario itself and all of its cases are gone through, `episodes` each (None: what the
    scenario says). `scenario` is another one to evaluate in, by name or as a path from the root of the
    repository; its interface must be the same. The model is the best of the training, or the `last`. `words`
    are shown in the place of the name. Without a `seed`, a training that a confirmation ended is evaluated
    from the starts of the confirmation, which it passed.
    """

    name: str = "held_out"
    episodes: int | None = 100
    seed: int | None = None
    case: str | None = None
    scenario: str | None = None
    last: bool = False
    words: str = ""

    @property
    def options(self) -> tuple[str, ...]:
        """Of `deepbots eval`."""
        values = (
            ("--scenario", self.scenario),
            ("--case", self.case),
            ("--episodes", self.episodes),
            ("--seed", self.seed),
        )
        words = tuple(word for option, value in values if value is not None for word in (option, str(value)))
        return (*words, *(("--last",) if self.last else ()))


@dataclass(frozen=True)
class Training:
    """One training for each seed; `full` goes on when the task is solved, `timesteps` replaces the scenario's
    number.

    `words` say what sets it apart from the other trainings of the experiment.
    """

    seeds: tuple[int, ...] = seeds(1)
    name: str = "main"
    sets: tuple[str, ...] = ()
    timesteps: int | None = None
    full: bool = False
    evaluations: tuple[Evaluation, ...] = (Evaluation(),)
    words: str = ""

    @property
    def options(self) -> tuple[str, ...]:
        """Of `deepbots train`, the seed apart."""
        words = [word for text in self.sets for word in ("--set", text)]
        words += [] if self.timesteps is None else ["--timesteps", str(self.timesteps)]
        return (*words, *(("--full",) if self.full else ()))


@dataclass(frozen=True)
class Baseline:
    """Episodes of a policy that learned nothing: `--driver random`, `--driver forward` or `--driver
    rocking`."""

    name: str
    options: tuple[str, ...]
    episodes: int = 100
    case: str | None = None
    words: str = ""

    @property
    def all_options(self) -> tuple[str, ...]:
        """Of `deepbots try`."""
        case = () if self.case is None else ("--case", self.case)
        return (*self.options, *case, "--episodes", str(self.episodes))


RANDOM = Baseline("random", ("--driver", "random"))
NEW_STARTS = Evaluation(seed=9)
"""Starts that no confirmation had."""

# Figures: what a bar looks at, read from a record

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
    """A figure of a record in `words`, with one value for each seed of a `training`, or a single one (None).

    A number `what` is shown in its unit. What never happened, such as a task that was not solved, is an
    infinity: more hours than any bar allows.
    """

    @property
    def what(self) -> str: ...
    @property
    def words(self) -> str: ...
    @property
    def training(self) -> str | None: ...
    def values(self, record: Record) -> list[float]: ...


def seeds_of(record: Record, training: str) -> Iterator[Record]:
    """The entries of the seeds that were measured, in the order of the seeds."""
    measured = record.get("trainings", {}).get(training, {})
    return (measured[seed] for seed in sorted(measured, key=int))


def _named(key: str) -> str:
    return _NAMES.get(key, key.replace("_", " "))


def _when(record: Record | None, what: str) -> float:
    return math.inf if record is None else float(record[what])


@dataclass(frozen=True)
class Solved:
    """When the scenario's own `solved` was first met."""

    what: When
    training: str = "main"

    @property
    def words(self) -> str:
        return f"{_named(self.what)} until solved"

    def values(self, record: Record) -> list[float]:
        return [_when(seed["solved_at"], self.what) for seed in seeds_of(record, self.training)]


@dataclass(frozen=True)
class Crossed:
    """When the mean of 100 consecutive training episodes first was at least `threshold`, in the last stage of
    a curriculum.

    `key` is its name in a record.
    """

    threshold: float
    what: When
    metric: Literal["return", "success"] = "return"
    training: str = "main"

    @property
    def key(self) -> str:
        return f"{self.metric} {self.threshold:g}"

    @property
    def words(self) -> str:
        goal = (
            f"a mean return of {self.threshold:g}"
            if self.metric == "return"
            else f"{100 * self.threshold:.4g} % successes"
        )
        return f"{_named(self.what)} until {goal} over 100 episodes"

    def values(self, record: Record) -> list[float]:
        by_seed = [seed["crossings"] for seed in seeds_of(record, self.training)]
        return [_when(crossings[self.key], self.what) for crossings in by_seed if self.key in crossings]


@dataclass(frozen=True)
class Trained:
    """What a training took as a whole."""

    what: Literal["simulated_hours", "steps", "episodes", "cpu_seconds"]
    training: str = "main"

    @property
    def words(self) -> str:
        return f"{_named(self.what)} of the training"

    def values(self, record: Record) -> list[float]:
        return [float(seed[self.what]) for seed in seeds_of(record, self.training)]


Outcome = Literal["success_rate", "successes", "mean_return", "least_return", "mean_length"]


@dataclass(frozen=True)
class Held:
    """A number of the held-out episodes; `case` is one that was gone through with the scenario itself."""

    what: Outcome
    evaluation: str = "held_out"
    case: str | None = None
    training: str = "main"

    @property
    def words(self) -> str:
        place = "" if self.evaluation == "held_out" else self.evaluation.replace("_", " ")
        if self.case:
            place = f"case {self.case}"
        return f"{_named(self.what)}, held out{place and f', {place}'}"

    def entries(self, record: Record) -> list[Record]:
        """What was evaluated, for each seed that was."""
        evaluations = [seed["evaluations"].get(self.evaluation) for seed in seeds_of(record, self.training)]
        return [
            e if self.case is None else e["cases"][self.case]
            for e in evaluations
            if e and (self.case is None or self.case in e["cases"])
        ]

    def values(self, record: Record) -> list[float]:
        return [float(entry[self.what]) for entry in self.entries(record)]


@dataclass(frozen=True)
class Tried:
    """A number of a baseline."""

    baseline: str
    what: Outcome
    training: None = None

    @property
    def words(self) -> str:
        return f"{_named(self.what)}, {self.baseline.replace('_', ' ')}"

    def values(self, record: Record) -> list[float]:
        entry = record.get("baselines", {}).get(self.baseline)
        return [] if entry is None else [float(entry[self.what])]


@dataclass(frozen=True)
class Ahead:
    """How far the mean return of a trained policy is above that of a baseline, with their intervals of 95 %
    between them."""

    baseline: str = "random"
    evaluation: str = "held_out"
    case: str | None = None
    training: str = "main"
    what: str = "mean_return"

    @property
    def words(self) -> str:
        return (
            f"{Held('mean_return', self.evaluation, self.case).words}, beyond the intervals above"
            f" {self.baseline.replace('_', ' ')}"
        )

    def values(self, record: Record) -> list[float]:
        base = record.get("baselines", {}).get(self.baseline)
        held = Held("mean_return", self.evaluation, self.case, self.training).entries(record)
        return (
            []
            if base is None
            else [entry["return_interval"][0] - base["return_interval"][1] for entry in held]
        )


def with_unit(value: float, what: str) -> str:
    """Return a value with its unit."""
    if not math.isfinite(value):
        return "never"
    unit = _UNITS.get(what, "")
    if unit == "%":
        return f"{100 * value:.1f}".removesuffix(".0") + " %"
    text = f"{value:,.0f}".replace(",", " ") if abs(value) >= 1000 else f"{value:.4g}"
    return f"{text} {unit}".rstrip()


@dataclass(frozen=True)
class Bar:
    """A figure and what is asked of it, in every seed or of the mean or median of the seeds.

    Of a bar for all seeds, `misses` seeds may miss it. A stretch bar goes beyond what is asked, and to miss
    it is not a failure. `words` replaces the words of the figure.
    """

    figure: Figure
    at_least: float | None = None
    at_most: float | None = None
    over: Literal["all", "mean", "median"] = "all"
    misses: int = 0
    stretch: bool = False
    words: str = ""

    def __post_init__(self) -> None:
        if (self.at_least is None) == (self.at_most is None):
            raise ValueError(f"a bar is either at least or at most something: {self}")

    def holds(self, value: float) -> bool:
        rounded = round(value, 9)  # a mean of shares may end in ...9999
        return rounded <= self.at_most if self.at_most is not None else rounded >= (self.at_least or 0.0)


@dataclass(frozen=True)
class Mark:
    """A labeled line in the picture of the learning curves: level at a `value`, or upright at a number of
    simulated `hours`."""

    words: str
    value: float | None = None
    hours: float | None = None


@dataclass(frozen=True)
class Beside:
    """A figure of the trained policies beside that of the paper, as text."""

    words: str
    paper: str
    figure: Figure


@dataclass(frozen=True)
class Experiment:
    """All that is measured of one scenario: a shipped one by name, or a file by its path from the root of the
    repository.

    `prose` and `paper` are paragraphs of its card: how to read the figures, and the results of others.
    `beside` are rows of the table beside the paper. `case` is the one shown on the page of results; the
    scenario itself by default. `curve` is what the picture shows: the mean return of 100 episodes, or their
    share of successes. `engines` are compared by their speed. Records of a `group` have a folder of its name.
    """

    scenario: str
    title: str
    prose: str
    trainings: tuple[Training, ...]
    bars: tuple[Bar, ...]
    baselines: tuple[Baseline, ...] = ()
    paper: str = ""
    beside: tuple[Beside, ...] = ()
    case: str | None = None
    marks: tuple[Mark, ...] = ()
    curve: Literal["return", "success"] = "return"
    engines: tuple[str, ...] = ()
    group: str = ""

    @property
    def name(self) -> str:
        """Of its record, its picture and its runs."""
        return str(PurePosixPath(self.group, PurePosixPath(self.scenario).stem))

    def training(self, name: str) -> Training:
        return next(training for training in self.trainings if training.name == name)


_FIRST = (
    "cartpole",
    "cartpole_continuous",
    "cartpole_long",
    "cartpole_wireless",
    "multi_cartpole",
    "pit_escape",
    "find_ball",
    "find_ball_as_printed",
    "find_ball_random",
    "find_and_avoid",
    "find_and_avoid_unmasked",
    "panda_reach",
    "panda_push",
)
"""The order on the page; the others follow by name."""


@cache
def experiments() -> dict[str, Experiment]:
    """Those of the modules in experiments/, by name, in the order of the page."""
    names = sorted(
        path.stem
        for path in (Path(__file__).parent / "experiments").glob("*.py")
        if path.stem != "not_measured"
    )
    by_name = {
        one.name: one
        for name in names
        for one in import_module(f"tools.results.experiments.{name}").EXPERIMENTS
    }
    return {name: by_name[name] for name in (*_FIRST, *sorted(set(by_name) - set(_FIRST)))}
