"""Comparisons of policies: groups of runs, evaluated on the same starts in the same scenario."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from statistics import fmean
from typing import Any, NamedTuple

from deepbots_cli import api
from deepbots_cli.api import Compiled
from deepbots_cli.document import Permissions
from deepbots_cli.errors import RunError, UsageError
from deepbots_cli.learning.environments import WorldFactory
from deepbots_cli.learning.episodes import Interval
from deepbots_cli.learning.evaluation import EvaluationResult, evaluate, until_enough
from deepbots_cli.learning.group import Group
from deepbots_cli.learning.run import ModelName, Run, run_folders
from deepbots_cli.learning.spread import ONE_BY_ONE, Attempt, Counter, Spread, results
from deepbots_cli.learning.statistics import Difference, compare_episodes, compare_seeds, interquartile_mean, mean_interval
from deepbots_cli.rollout import Episode
from deepbots_cli.rollout.policies import StopCondition
from deepbots_cli.rollout.source import RECORD_NAME, SourceKind, folder_kind
from deepbots_cli.scenario import Scenario

MIN_SEEDS = 3
"""With fewer runs in a group, the interval of a difference is so wide that it rarely excludes 0."""


@dataclass(frozen=True)
class GroupResult:
    """The evaluations of runs that differ by their seeds only, on the same starts.

    Statistics are over the seeds, with one score per run: its mean return, or its success rate. Intervals are Student's at 95 %, cut at
    the bounds of the score, None for a single run. `waiting` are the seeds of the group that have no model yet. `solved_after` are the
    steps after which a confirmation showed that each run solves its task, None where none did.
    """

    name: str
    evaluations: tuple[EvaluationResult, ...]
    waiting: tuple[int, ...] = ()
    solved_after: tuple[int | None, ...] = ()

    @property
    def success_defined(self) -> bool:
        return all(result.success_defined for result in self.evaluations)

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
    def return_interval(self) -> Interval | None:
        return mean_interval(self.returns, self.evaluations[0].possible_returns)

    @property
    def interquartile_mean(self) -> float:
        """The mean of the middle half of the returns of the runs (R. Agarwal et al., NeurIPS 2021)."""
        return interquartile_mean(self.returns)

    @property
    def success_rate(self) -> float:
        return fmean(self.success_rates)

    @property
    def success_interval(self) -> Interval | None:
        return mean_interval(self.success_rates, (0.0, 1.0))


@dataclass(frozen=True)
class GroupDifference:
    """A group against the first group: differences of the mean return, and of the success rate if the scenario defines success.

    `solved_after` is the difference of the steps until a training was solved, None unless every run of both groups was. `between_seeds`
    tells whether the interval is one over the seeds of both groups. If not, each group is a single run, and the interval is one over the
    episodes of these two policies.
    """

    first: str
    group: str
    mean_return: Difference
    success_rate: Difference | None
    between_seeds: bool
    solved_after: Difference | None = None

    @property
    def verdict(self) -> str:
        """The result in a sentence: the returns, and the steps until the task was solved."""
        steps = self.solved_after
        if steps is None or steps.interval is None:
            return self._verdict_on_returns
        difference = f"{abs(steps.mean):,.0f} {'fewer' if steps.mean < 0 else 'more'} steps of training"
        interval = "(95 % interval of the difference: {:,.0f} .. {:,.0f})".format(*steps.interval)
        sooner = f"it is solved after {difference}" if steps.certain else f"it is solved after {difference}, but the interval contains 0"
        return f"{self._verdict_on_returns}; {sooner} {interval}"

    @property
    def _verdict_on_returns(self) -> str:
        difference = self.mean_return
        if difference.interval is None:
            return f"{self.group}: cannot be compared, because a group with one run has no interval; train more seeds"
        low, high = difference.interval
        if low == high == 0:
            return f"{self.group}: the same mean return in every {'run' if self.between_seeds else 'episode'}"
        interval = f"(95 % interval of the difference: {low:.4g} .. {high:.4g})"
        size, sign = f"{abs(difference.mean):.4g}", "higher" if difference.mean >= 0 else "lower"
        if not difference.certain:
            return (
                f"{self.group}: no significant difference from {self.first}; the mean return is {size} {sign}, "
                f"but the interval contains 0 {interval}"
            )
        return (
            f"{self.group} is {'better' if difference.mean > 0 else 'worse'} than {self.first}: the mean return is {size} {sign} {interval}"
        )


@dataclass(frozen=True)
class Comparison:
    """Groups in the given order, the others compared with the first, and notes on the limits of the comparison.

    `scenario` is the name of the scenario of all episodes, or None if each run is evaluated in its own.
    """

    scenario: str | None
    episodes: int
    seed: int
    groups: tuple[GroupResult, ...]
    differences: tuple[GroupDifference, ...]
    notes: tuple[str, ...]


OnRun = Callable[[int, int], object]
"""Is called after each run with the number of evaluated runs and of all runs."""


def compare(
    runs: Sequence[str | Path],
    *,
    episodes: int | None = None,
    seed: int = 0,
    model: ModelName = "best",
    scenario: Compiled | Scenario | str | Path | None = None,
    case: str | None = None,
    own: bool = False,
    permissions: Permissions = Permissions(),
    build: WorldFactory | None = None,
    on_run: OnRun | None = None,
    spread: Spread = ONE_BY_ONE,
) -> Comparison:
    """Evaluate runs on the same starts, and compare them by groups.

    The folder of a group (`deepbots train --seeds`) is a group. Other runs of the same scenario, trained in the same engine, are a group:
    they differ by their seeds only. Any other folder stands for all runs in it. If this makes a single group, each of its runs is a group.

    Args:
        runs: Groups, run directories, or folders of run directories; at least two runs.
        episodes: Episodes of each run; by default the number of the scenario.
        seed: Root seed of the starts, the same for all runs.
        scenario: The scenario to evaluate in; by default that of the first run. Its interface must be that of every run.
        own: Whether each run is evaluated in its own scenario instead, such as variants with different observations.
        on_run: Is called after each run.
        spread: Where the evaluations run; the result does not depend on it.

    The other arguments are those of `evaluate`.

    Raises:
        RunError: A folder is not a run, or a run does not fit the scenario.
        UsageError: There are fewer than two runs, or `own` comes with a scenario.
    """
    if own and scenario is not None:
        raise UsageError("choose one: evaluate each run in its own scenario (--own), or all runs in one scenario (--scenario)")
    members = _members([Path(path) for path in runs])
    opened = [run for group in members for run in group.runs]
    if len(opened) < 2:
        raise UsageError("a comparison needs at least two runs")
    judged = None if own else opened[0].compiled if scenario is None else api.compile(scenario)
    given: dict[str, Any] = {"episodes": episodes, "seed": seed, "model": model, "case": case, "permissions": permissions, "build": build}
    calls = [_Evaluation(run, {**given, "scenario": judged}) for run in opened]
    found = results(spread.map(_evaluate, calls, watcher=Counter(on_run, len(calls)), files=_records(opened)))
    groups = [
        GroupResult(group.name, tuple(islice(found, len(group.runs))), group.waiting, tuple(map(_solved_after, group.runs)))
        for group in members
    ]
    differences = tuple(_difference(groups[0], group) for group in groups[1:])
    first = groups[0].evaluations[0]
    notes = _notes(opened, groups, differences, own=own)
    return Comparison(None if own else first.scenario, first.episodes, seed, tuple(groups), differences, tuple(notes))


@dataclass(frozen=True)
class EngineDifference:
    """One policy in a further engine against the first, on the same starts; `case` is None for the scenario itself."""

    case: str | None
    first: str | None
    engine: str | None
    mean_return: Difference
    success_rate: Difference | None


def compare_engines(one: EvaluationResult | GroupResult, other: EvaluationResult | GroupResult) -> EngineDifference:
    """Compare the evaluations of a policy in two engines episode by episode, or those of a group run by run.

    Intervals for a group are over its seeds, None for a single run.
    """
    first, second = (found.evaluations[0] if isinstance(found, GroupResult) else found for found in (one, other))
    return EngineDifference(second.case, first.engine, second.engine, *_paired(one, other))


def _paired(one: EvaluationResult | GroupResult, other: EvaluationResult | GroupResult) -> tuple[Difference, Difference | None]:
    """Differences of return and success, by episodes or runs in the same order; no success where one of the two defines none."""
    (before, succeeded), (after, succeeds) = _scores(one), _scores(other)
    has_success = one.success_defined and other.success_defined
    bounds = (one.evaluations[0] if isinstance(one, GroupResult) else one).possible_returns
    success = compare_episodes(succeeded, succeeds, (0.0, 1.0)) if has_success else None
    return compare_episodes(before, after, bounds), success


def _scores(found: EvaluationResult | GroupResult) -> tuple[list[float], list[float]]:
    """The returns and successes of episodes, or of the runs of a group."""
    if isinstance(found, GroupResult):
        return found.returns, found.success_rates
    return [episode.total_return for episode in found.outcomes], [float(episode.is_success) for episode in found.outcomes]


def evaluate_group(
    group: str | Path,
    *,
    seed: int = 0,
    scenario: Compiled | Scenario | str | Path | None = None,
    until: StopCondition | None = None,
    on_run: OnRun | None = None,
    spread: Spread = ONE_BY_ONE,
    **options: Any,
) -> GroupResult:
    """Evaluate every run of a group on the same starts.

    Args:
        group: The folder of the group. Seeds without a model are left out, and named in `waiting`.
        until: Takes the episodes so far, of all runs in turn, and returns whether they are enough. The result then holds these only.
        on_run: Is called after each run.
        spread: Where the evaluations run; the result does not depend on it.
        options: Further arguments of `evaluate`. `seed` and `scenario` are as there; the default is the scenario of the group.

    Raises:
        RunError: The folder is no group, or none of its runs has a model; else as for `evaluate`.
    """
    members = _open_runs(Group.open(group))
    judged = None if scenario is None else api.compile(scenario)
    done: list[EvaluationResult] = []
    before: list[Episode] = []

    def enough(episodes: Sequence[Episode]) -> bool:
        return until is not None and until([*before, *episodes])

    given = {**options, "seed": seed, "scenario": judged}
    stops = {"until": enough} if spread.is_here else {}
    calls = [_Evaluation(run, {**given, **stops}) for run in members.runs]
    found = results(spread.map(_evaluate, calls, watcher=Counter(on_run, len(calls)), files=_records(members.runs)))
    for run, result in zip(members.runs, found, strict=False):
        done.append(result if spread.is_here else until_enough(result, enough, run, **given))
        before += done[-1].outcomes
        if enough(()):
            break
    found.close()
    return GroupResult(members.name, tuple(done), members.waiting)


class _Evaluation(NamedTuple):
    """A run, and the further arguments of `evaluate`."""

    run: Run
    options: dict[str, Any]


def _evaluate(evaluation: _Evaluation, attempt: Attempt) -> EvaluationResult:
    return evaluate(evaluation.run, **evaluation.options)


def _records(runs: Sequence[Run]) -> list[Path]:
    return [run.path / RECORD_NAME for run in runs]


class _GroupMembers(NamedTuple):
    name: str
    runs: Sequence[Run]
    waiting: tuple[int, ...] = ()


def _members(paths: Sequence[Path]) -> list[_GroupMembers]:
    """The groups in the order of their first runs; each run once."""
    found: dict[object, _GroupMembers] = {}
    single: dict[object, list[Run]] = {}
    for path in paths:
        if folder_kind(path) is SourceKind.GROUP:
            found[path] = _open_runs(Group.open(path))
            continue
        for run in map(Run.open, run_folders([path])):
            alike = single.setdefault((run.record.digest, run.record.engine), [])
            if run.path not in [other.path for other in alike]:
                alike.append(run)
            name = alike[0].path.name + (f" and {len(alike) - 1} more" if len(alike) > 1 else "")
            found[run.record.digest, run.record.engine] = _GroupMembers(name, alike)
    groups = list(found.values())
    if len(groups) == 1:
        groups = [_GroupMembers(run.path.name, (run,)) for run in groups[0].runs]
    names = [group.name for group in groups]
    return [group._replace(name=str(group.runs[0].path)) if names.count(group.name) > 1 else group for group in groups]


def _open_runs(group: Group) -> _GroupMembers:
    """The runs of a group that have a model.

    Raises:
        RunError: There is none, or the runs have different values.
    """
    if group.record.attempts:
        best = group.attempt(group.best_attempt)
        raise RunError(
            f"the runs of {group.path} have different values, so they have no common statistics; name one of them, such as {best}"
        )
    ready = group.runs_with_model
    if not ready:
        raise RunError(f"{group.path} contains no trained run yet; train it with: deepbots train --resume {group.path}")
    waiting = tuple(seed for seed in group.record.seeds if group.run(seed) not in ready)
    return _GroupMembers(group.path.name, [Run.open(run) for run in ready], waiting)


def _solved_after(run: Run) -> int | None:
    result = run.record.result
    return result.confirmed_at.steps if result is not None and result.confirmed_at is not None else None


def _difference(first: GroupResult, group: GroupResult) -> GroupDifference:
    between_seeds = max(len(first.evaluations), len(group.evaluations)) > 1
    has_success = first.success_defined and group.success_defined
    if between_seeds:
        success = compare_seeds(first.success_rates, group.success_rates, (0.0, 1.0)) if has_success else None
        returns = compare_seeds(first.returns, group.returns, first.evaluations[0].possible_returns)
        before, after = ([steps for steps in found.solved_after if steps is not None] for found in (first, group))
        all_solved = len(before) + len(after) == len(first.evaluations) + len(group.evaluations)
        steps = compare_seeds(before, after, (0.0, math.inf)) if all_solved else None
        return GroupDifference(first.name, group.name, returns, success, between_seeds, steps)
    return GroupDifference(first.name, group.name, *_paired(first.evaluations[0], group.evaluations[0]), between_seeds)


def _notes(runs: Sequence[Run], groups: Sequence[GroupResult], differences: Sequence[GroupDifference], *, own: bool) -> list[str]:
    notes = [f"{group.name}: no model yet of seed {', '.join(map(str, group.waiting))}" for group in groups if group.waiting]
    fewest = min(len(group.evaluations) for group in groups)
    if all(not difference.between_seeds for difference in differences):
        notes.append(
            "each group has one run, so the intervals compare these policies, not their settings; to compare settings, train several seeds"
        )
    elif fewest < MIN_SEEDS:
        notes.append(f"a group has {fewest} run{'' if fewest == 1 else 's'}: train at least {MIN_SEEDS} seeds of each, better 5")
    if len({run.record.engine for run in runs}) > 1:
        notes.append("the runs were trained in different engines; each run is evaluated in its own engine")
    if len({str([(term.name, term.text) for term in run.program.agent.reward]) for run in runs}) > 1:
        where = "each run is evaluated in its own scenario" if own else "all runs are evaluated with the reward of the scenario above"
        notes.append(f"the rewards of the runs differ, and {where}: compare success rates, not returns")
    for group in groups:
        notes += dict.fromkeys(f"{group.name}: {note}" for result in group.evaluations for note in result.notes if "trained with" in note)
    return notes
