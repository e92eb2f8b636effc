"""What is measured of a shipped scenario, and what is asked of it: plain data, one `Experiment` each.

To put a scenario on the results page, write `tests/results/experiments/<scenario>.py` with

    EXPERIMENTS = (Experiment(scenario="...", ...),)

in it (the files are found by themselves; `experiments/cartpole.py` is a short one), or enter the scenario with a reason in
`experiments/not_measured.py`. Then `make results SCENARIO=<scenario>` measures and renders. What a bar looks at is one of the
figures of `figures.py`:

    Bar(Solved("simulated_hours"), at_most=1.3)                                  every seed solved within 1.3 h
    Bar(Crossed(0.9, "simulated_hours"), at_most=3, stretch=True)                 mean of 100 episodes at least 0.9 within 3 h
    Bar(Held("success_rate", case="few"), at_least=0.92, over="mean")             mean of the seeds, over an evaluation
    Bar(Tried("forward", "successes"), at_most=0)                                 of a baseline, which has no seeds
    Bar(Trained("cpu_seconds"), at_most=60)                                       of the training itself
    Bar(Ahead("random"), at_least=0)                                              better than random for sure, where no figure is set

Reported seeds count from 101; 0 to 9 are for tuning and never appear here. A second training, such as a longer one for a stretch
or one with another algorithm, has a name of its own, which figures take as `training=`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import PurePath
from typing import Literal

from tests.results.figures import Figure

Over = Literal["all", "mean", "median"]
FIRST_SEED = 101


def seeds(count: int, first: int = FIRST_SEED) -> tuple[int, ...]:
    """Consecutive seeds for reported results."""
    return tuple(range(first, first + count))


@dataclass(frozen=True)
class Evaluation:
    """Held-out episodes of each trained policy of a training.

    Without `case`, the scenario itself and all of its cases are gone through, `episodes` each (None: what the scenario says). `scenario`
    is another one to evaluate in, by name or as a path from the root of the repository; its interface must be the same. The model is the
    best of the training, or the `last`.
    """

    name: str = "held_out"
    episodes: int | None = 100
    case: str | None = None
    scenario: str | None = None
    last: bool = False
    words: str = ""
    """Shown beside its figures, where the name does not say enough."""

    @property
    def options(self) -> tuple[str, ...]:
        """Of `deepbots eval`."""
        given = (("--scenario", self.scenario), ("--case", self.case), ("--episodes", self.episodes))
        found = tuple(word for option, value in given if value is not None for word in (option, str(value)))
        return (*found, *(("--last",) if self.last else ()))


@dataclass(frozen=True)
class Training:
    """One training for each seed; `full` goes on when the task is solved, `timesteps` replaces the scenario's figure."""

    seeds: tuple[int, ...] = seeds(1)
    name: str = "main"
    sets: tuple[str, ...] = ()
    timesteps: int | None = None
    full: bool = False
    evaluations: tuple[Evaluation, ...] = (Evaluation(),)
    words: str = ""
    """What sets it apart from the other trainings of the experiment."""

    @property
    def options(self) -> tuple[str, ...]:
        """Of `deepbots train`, the seed apart."""
        found = [word for text in self.sets for word in ("--set", text)]
        if self.timesteps is not None:
            found += ["--timesteps", str(self.timesteps)]
        return (*found, *(("--full",) if self.full else ()))


@dataclass(frozen=True)
class Baseline:
    """Episodes of a policy that learned nothing: `--policy random`, `--actions forward` or `--script rocking`."""

    name: str
    options: tuple[str, ...]
    episodes: int = 100
    case: str | None = None
    words: str = ""

    @property
    def all_options(self) -> tuple[str, ...]:
        """Of `deepbots run`."""
        case = () if self.case is None else ("--case", self.case)
        return (*self.options, *case, "--episodes", str(self.episodes))


RANDOM = Baseline("random", ("--policy", "random"))


@dataclass(frozen=True)
class Bar:
    """A figure and what is asked of it, in every seed or of the mean or median of the seeds.

    A stretch bar is a wish beyond what is asked: to reach it is told, to miss it is no failure. `words` replaces the figure's own.
    """

    figure: Figure
    at_least: float | None = None
    at_most: float | None = None
    over: Over = "all"
    stretch: bool = False
    words: str = ""

    def __post_init__(self) -> None:
        if (self.at_least is None) == (self.at_most is None):
            raise ValueError(f"a bar is either at least or at most something: {self}")


@dataclass(frozen=True)
class Mark:
    """A labelled line in the picture of the learning curves: level at a `value`, or upright at a number of simulated `hours`."""

    words: str
    value: float | None = None
    hours: float | None = None


@dataclass(frozen=True)
class Experiment:
    """All that is measured of one scenario: a shipped one by name, or a file by its path from the root of the repository.

    `prose` and `paper` are for the page: what the task is, and what is known of it elsewhere.
    """

    scenario: str
    title: str
    prose: str
    trainings: tuple[Training, ...]
    bars: tuple[Bar, ...]
    baselines: tuple[Baseline, ...] = ()
    paper: str = ""
    marks: tuple[Mark, ...] = ()
    curve: Literal["return", "success"] = "return"
    """What the picture shows: the mean return of 100 episodes, or their share of successes."""

    @property
    def name(self) -> str:
        """Of its record, its picture and its runs."""
        return PurePath(self.scenario).stem

    def training(self, name: str) -> Training:
        return next(training for training in self.trainings if training.name == name)
