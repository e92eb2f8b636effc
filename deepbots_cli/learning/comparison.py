"""Comparisons of policies: groups of runs, evaluated on the same starts in the same scenario."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean

from deepbots_cli import api
from deepbots_cli.api import Compiled
from deepbots_cli.compiler.inputs import RESOLVED
from deepbots_cli.errors import UsageError
from deepbots_cli.learning.environments import compiled_of
from deepbots_cli.learning.evaluation import EvaluationResult, evaluate
from deepbots_cli.learning.run import ModelName, Run, run_folders
from deepbots_cli.learning.statistics import Difference, compare_episodes, compare_seeds, interquartile_mean
from deepbots_cli.scenario import Scenario

MIN_SEEDS = 3
"""With fewer runs in a group, the interval of a difference is so wide that it rarely excludes 0."""


@dataclass(frozen=True)
class Group:
    """Runs of the same scenario with other seeds, and their evaluations on the same starts."""

    name: str
    evaluations: tuple[EvaluationResult, ...]

    @property
    def returns(self) -> list[float]:
        """The mean return of each run."""
        return [result.mean_return for result in self.evaluations]

    @property
    def success_rates(self) -> list[float]:
        """The success rate of each run."""
        return [result.success_rate for result in self.evaluations]

    @property
    def mean_return(self) -> float:
        return fmean(self.returns)

    @property
    def success_rate(self) -> float:
        return fmean(self.success_rates)

    @property
    def interquartile_mean(self) -> float:
        """Of the returns of all episodes of all runs."""
        return interquartile_mean([episode.total_return for result in self.evaluations for episode in result.outcomes])


@dataclass(frozen=True)
class Compared:
    """A group against the first group: differences of the mean return, and of the success rate if the scenario defines success.

    `between_seeds` tells whether the interval is one over the seeds of both groups. If not, each group is a single run, and the interval
    is one over the episodes of these two policies.
    """

    group: str
    mean_return: Difference
    success_rate: Difference | None
    between_seeds: bool

    @property
    def verdict(self) -> str:
        """The result in a sentence."""
        difference = self.mean_return
        if difference.interval is None:
            return f"{self.group}: a group with one run has no interval; train more seeds"
        low, high = difference.interval
        if low == high == 0:
            return f"{self.group}: the same mean return in every {'run' if self.between_seeds else 'episode'}"
        size = f"by {abs(difference.mean):.4g} in the mean return (95 % interval of the difference: {low:.4g} .. {high:.4g})"
        if not difference.certain:
            return f"{self.group}: no certain difference from the first group; it differs {size}"
        return f"{self.group} is {'better' if difference.mean > 0 else 'worse'} than the first group {size}"


@dataclass(frozen=True)
class Comparison:
    """Groups in the order in which they were given, the others against the first, and remarks on what the numbers cannot tell."""

    scenario: str
    episodes: int
    seed: int
    groups: tuple[Group, ...]
    differences: tuple[Compared, ...]
    notes: tuple[str, ...]


def compare(
    runs: Sequence[str | Path],
    *,
    episodes: int | None = None,
    seed: int = 0,
    model: ModelName = "best",
    scenario: Compiled | Scenario | str | Path | None = None,
    case: str | None = None,
    allow_code: bool = False,
    on_run: Callable[[int, int], object] | None = None,
) -> Comparison:
    """Evaluate runs on the same starts, and compare them by groups.

    Runs of the same scenario, trained in the same engine, are a group: they differ by their seeds only. If all runs are alike, each run is
    a group.
    A folder stands for all runs in it.

    Args:
        runs: At least two run directories, or folders of run directories.
        episodes: Episodes of each run; by default the number of the scenario.
        seed: Root seed of the starts, the same for all runs.
        model: `best` or `last`.
        scenario: The scenario to evaluate in; by default that of the first run. Its interface must be that of every run.
        case: An evaluation case of this scenario.
        allow_code: Whether terms in Python run.
        on_run: Is called after each run with the number of evaluated runs and of all runs.

    Raises:
        RunError: A folder is not a run, or a run does not fit the scenario.
        UsageError: There are fewer than two runs.
    """
    opened = [Run.open(path) for path in run_folders(runs)]
    if len(opened) < 2:
        raise UsageError("a comparison needs at least two runs")
    base = opened[0].path
    judged = api.compile(api.load(base / RESOLVED, allow_code=True, project=base)) if scenario is None else compiled_of(scenario)
    results = []
    for number, run in enumerate(opened, start=1):
        results.append(evaluate(run, episodes=episodes, seed=seed, model=model, scenario=judged, case=case, allow_code=allow_code))
        if on_run is not None:
            on_run(number, len(opened))
    groups = _grouped(opened, results)
    differences = tuple(_compared(groups[0], group) for group in groups[1:])
    first = results[0]
    return Comparison(first.scenario, first.episodes, seed, groups, differences, tuple(_notes(opened, groups, differences)))


@dataclass(frozen=True)
class AcrossEngines:
    """One policy in a further engine against the first, on the same starts; `case` is None for the scenario itself."""

    case: str | None
    first: str | None
    engine: str | None
    mean_return: Difference
    success_rate: Difference | None

    def row(self, *, with_case: bool) -> dict[str, object]:
        """A row of a table: the differences, each with its interval."""
        row: dict[str, object] = {"difference": f"{self.engine} - {self.first}"}
        row |= {"case": self.case or "(the scenario itself)"} if with_case else {}
        for what, found in (("return", self.mean_return), ("success", self.success_rate)):
            if found is not None:
                row |= {what: found.mean, f"{what}_95 %": "" if found.interval is None else "{:.4g} .. {:.4g}".format(*found.interval)}
        return row


def across_engines(one: EvaluationResult, other: EvaluationResult) -> AcrossEngines:
    """Compare the evaluations of one policy in two engines, episode by episode."""
    returns, successes = _paired(one, other)
    return AcrossEngines(other.case, one.engine, other.engine, returns, successes)


def _paired(one: EvaluationResult, other: EvaluationResult) -> tuple[Difference, Difference | None]:
    """Differences of return and success, episode by episode; no success where one of the two defines none."""
    before, after = one.outcomes, other.outcomes
    returns = compare_episodes([episode.total_return for episode in before], [episode.total_return for episode in after])
    if not (one.success_defined and other.success_defined):
        return returns, None
    return returns, compare_episodes([float(e.is_success) for e in before], [float(e.is_success) for e in after])


def _grouped(runs: Sequence[Run], results: Sequence[EvaluationResult]) -> tuple[Group, ...]:
    alike: dict[tuple[str, str], list[EvaluationResult]] = {}
    for run, result in zip(runs, results, strict=True):
        alike.setdefault((run.record.digest, run.record.engine), []).append(result)
    if len(alike) == 1:
        return tuple(Group(result.run.name, (result,)) for result in results)
    return tuple(Group(_name(members), tuple(members)) for members in alike.values())


def _name(members: Sequence[EvaluationResult]) -> str:
    """The name of the first run, with the number of the others."""
    others = len(members) - 1
    return members[0].run.name + (f" and {others} more" if others else "")


def _compared(first: Group, group: Group) -> Compared:
    between_seeds = max(len(first.evaluations), len(group.evaluations)) > 1
    has_success = all(result.success_defined for result in (*first.evaluations, *group.evaluations))
    if between_seeds:
        success = compare_seeds(first.success_rates, group.success_rates) if has_success else None
        return Compared(group.name, compare_seeds(first.returns, group.returns), success, between_seeds)
    return Compared(group.name, *_paired(first.evaluations[0], group.evaluations[0]), between_seeds)


def _notes(runs: Sequence[Run], groups: Sequence[Group], differences: Sequence[Compared]) -> list[str]:
    notes = []
    fewest = min(len(group.evaluations) for group in groups)
    if all(not difference.between_seeds for difference in differences):
        notes.append("each group is one run: the intervals compare these policies, and not the settings that they were trained with")
    elif fewest < MIN_SEEDS:
        notes.append(f"a group has {fewest} run{'' if fewest == 1 else 's'}: train at least {MIN_SEEDS} seeds of each, better 5")
    if len({run.record.engine for run in runs}) > 1:
        notes.append("the runs were trained in different engines, and each is evaluated in its own")
    return notes
