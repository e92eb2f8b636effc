"""Comparisons of policies: groups of runs, evaluated on the same starts in the same scenario."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field
from fractions import Fraction
from itertools import islice
from pathlib import Path
from statistics import fmean, stdev
from typing import Any, NamedTuple

from deepbots_cli import api
from deepbots_cli.analysis.changes import Change, Meanings, compared_meanings
from deepbots_cli.api import Compiled
from deepbots_cli.document import Permissions
from deepbots_cli.errors import RunError, UsageError
from deepbots_cli.learning.campaigns.group import Group
from deepbots_cli.learning.environments import WorldFactory
from deepbots_cli.learning.evaluation import FinishedEpisodes, evaluate, until_enough
from deepbots_cli.learning.executor import SERIAL, Attempt, Counter, Executor, results
from deepbots_cli.learning.runs.directories import run_folders
from deepbots_cli.learning.runs.episodes import check_common_measure
from deepbots_cli.learning.runs.evaluations import EvaluationResult
from deepbots_cli.learning.runs.order import Measure, measure_of
from deepbots_cli.learning.runs.run import ModelName, ModelRef, Run
from deepbots_cli.learning.runs.statistics import (
    Difference,
    Interval,
    compare_episodes,
    compare_seeds,
    interquartile_mean,
    mean_interval,
)
from deepbots_cli.learning.runs.verdict import run_verdict, written_scenario
from deepbots_cli.program.identity import timing_differences
from deepbots_cli.records import dataclass
from deepbots_cli.rollout import Episode
from deepbots_cli.rollout.episode import OnEpisode
from deepbots_cli.rollout.policies import StopCondition
from deepbots_cli.rollout.source import RECORD_NAME, SourceKind, folder_kind
from deepbots_cli.scenario import Scenario
from deepbots_cli.words import beside, counted, rate_beside, shell_word

MIN_SEEDS = 3
"""The number of runs in a group below which the interval of a difference is so wide that it rarely excludes
0."""

_MAX_LISTED = 5
"""The number of differences of two scenarios that a note lists."""


@dataclass(frozen=True)
class GroupResult:
    """The evaluations of runs that differ by their seeds only, on the same starts.

    Statistics are over the seeds, with one score per run: its mean return, or its success rate. Intervals are
    Student's at 95 %, cut at the bounds of the score, None for a single run. `waiting` are the seeds of the
    group that have no model yet. `solved_after` are the steps after which a confirmation showed that each run
    solves its task, None for a run without such a confirmation.
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
    def std_return(self) -> float | None:
        """The standard deviation of the mean returns of the runs; None for a single run."""
        return stdev(self.returns) if len(self.returns) > 1 else None

    @property
    def return_interval(self) -> Interval | None:
        """The interval over the seeds; None if all runs have the same return, which estimates no spread."""
        return mean_interval(self.returns, self.evaluations[0].possible_returns) if self.std_return else None

    @property
    def interquartile_mean(self) -> float:
        """The mean of the middle half of the returns of the runs (R. Agarwal et al., NeurIPS 2021)."""
        return interquartile_mean(self.returns)

    @property
    def success_rate(self) -> float:
        # Exact: the mean of three times 0.95 in floats is less than 0.95.
        rates = [
            Fraction(round(result.success_rate * result.episodes), result.episodes)
            for result in self.evaluations
        ]
        return float(sum(rates) / len(rates))

    @property
    def success_interval(self) -> Interval | None:
        is_spread = len(set(self.success_rates)) > 1
        return mean_interval(self.success_rates, (0.0, 1.0)) if is_spread else None

    @property
    def starts(self) -> int:
        """The number of starts that every run has played."""
        return min(result.episodes for result in self.evaluations)

    @property
    def return_interval_over_starts(self) -> Interval | None:
        """The interval of the mean return of these policies over other starts. All runs have the same starts,
        with one score each."""
        means = self._means_by_start(
            [[episode.total_return for episode in result.outcomes] for result in self.evaluations]
        )
        return mean_interval(means, self.evaluations[0].possible_returns)

    @property
    def success_interval_over_starts(self) -> Interval | None:
        """The interval of the success rate over other starts, as for the mean return."""
        means = self._means_by_start(
            [[float(episode.is_success) for episode in result.outcomes] for result in self.evaluations]
        )
        return mean_interval(means, (0.0, 1.0))

    def _means_by_start(self, scores: Sequence[Sequence[float]]) -> list[float]:
        """Return the mean over the runs for each start."""
        return [
            fmean(row)
            for row in zip(*(scores_of_run[: self.starts] for scores_of_run in scores), strict=True)
        ]


@dataclass(frozen=True)
class GroupDifference:
    """A group against the first group.

    Attributes:
        first: Name of the first group.
        group: Name of the group.
        measure: The measure of the task; `verdict` is about it.
        mean_return: The difference of the mean returns; None where the rewards of their trainings differ and
            no scenario was named, or where they are evaluated in different scenarios whose returns do not
            mean the same.
        success_rate: The difference of the success rates; None where a scenario defines no success, or where
            successes do not mean the same.
        between_seeds: Whether the intervals are over the seeds of both groups. If not, each group is a single
            run, and the intervals are over the episodes of these two policies.
        solved_after: The difference of the steps until a training was solved; None unless every run of both
            groups was, by the same criterion.
        own_scenarios: Whether each group is evaluated in its own scenario.
        meanings: The differences of the two scenarios, which determine the scores that can be compared.
        same_criterion: Whether `solved` asks for the same in both scenarios.
        means: The means of both groups, also of a measure that cannot be compared.
    """

    first: str
    group: str
    measure: Measure
    mean_return: Difference | None
    success_rate: Difference | None
    between_seeds: bool
    solved_after: Difference | None = None
    own_scenarios: bool = False
    meanings: Meanings = Meanings()
    same_criterion: bool = True
    means: Mapping[Measure, tuple[float, float]] = field(default_factory=dict)

    @property
    def verdict(self) -> str:
        """The group that is better, in a sentence: by the measure of the task, and by the steps until it was
        solved if they differ by more than chance."""
        steps = self.solved_after
        if steps is None or not steps.certain:
            return self._verdict_on_measure
        difference = f"{abs(steps.mean):,.0f} {'fewer' if steps.mean < 0 else 'more'} steps"
        return f"{self._verdict_on_measure}; {self.group} is solved after {difference}"

    @property
    def compared(self) -> Measure | None:
        """The measure of the verdict: `measure`, or the other one if `measure` cannot be compared; None if
        neither can."""
        alternative: Measure = "mean_return" if self.measure == "success_rate" else "success_rate"
        return next((name for name in (self.measure, alternative) if getattr(self, name) is not None), None)

    @property
    def _verdict_on_measure(self) -> str:
        compared, sides = self.compared, f"{self.group} and {self.first}"
        if compared is None:
            changes = (*self.meanings.returns, *self.meanings.success)[:_MAX_LISTED]
            paths = ", ".join(change.path for change in changes)
            return f"{sides} cannot be compared, because returns do not mean the same ({paths} differ)"
        difference: Difference = getattr(self, compared)
        if difference.interval is None:
            reason = "one run, or a few of equal scores, have no interval; train more seeds"
            if not self.between_seeds:
                reason = "a single episode has no interval; evaluate more of them with --episodes N"
            return f"{sides} cannot be compared, because {reason}"
        (before, after), words = self.means[compared], compared.replace("_", " ")
        form = rate_beside if compared == "success_rate" else lambda value, bar: beside(value, bar)[0]
        low, high = form(before, after), form(after, before)
        same = "starts with the same seeds" if self.own_scenarios else "the same starts"
        if difference.interval == (0.0, 0.0):
            return f"neither is better: {sides} have the same {words} of {low} on {same}"
        if not difference.certain:
            return (
                f"neither is clearly better: {words} of {self.first} {low}, of {self.group} {high}, on {same}"
            )
        if difference.mean < 0:
            return f"{self.first} is better than {self.group}: {words} {low} against {high} on {same}"
        return f"{self.group} is better than {self.first}: {words} {high} against {low} on {same}"


@dataclass(frozen=True)
class Comparison:
    """Groups in the given order, the others compared with the first, and notes on the limits of the
    comparison.

    `scenario` is the name of the scenario of all episodes, or None if a group is evaluated in its own.
    `measure` is the measure of the task.
    """

    scenario: str | None
    episodes: int
    seed: int
    measure: Measure
    groups: tuple[GroupResult, ...]
    differences: tuple[GroupDifference, ...]
    notes: tuple[str, ...]

    @property
    def returns_comparable(self) -> bool:
        """Whether the returns of all groups measure the same."""
        return all(difference.mean_return is not None for difference in self.differences)

    @property
    def criteria_comparable(self) -> bool:
        """Whether `solved` asks for the same in all groups."""
        return all(difference.same_criterion for difference in self.differences)


OnRun = Callable[[int, int], object]
"""Called after each run with the number of evaluated runs and of all runs."""


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
    on_episode: OnEpisode | None = None,
    executor: Executor = SERIAL,
) -> Comparison:
    """Evaluate runs and models of runs on the same starts, and compare them by groups.

    The folder of a group (`deepbots train --seeds`) is a group. Other runs of the same scenario, trained in
    the same engine, are a group: they differ by their seeds only. So are models of the same name of such
    runs. Any other folder stands for all runs in it. If this makes a single group, each of its runs is a
    group.

    A group is evaluated in the scenario of the first run if observation, action, robots, actuators and
    `apply` of its own scenario mean the same. Otherwise it is evaluated in its own scenario, from starts with
    the same seeds, and what does not mean the same in both scenarios is not compared. The engine is that of
    the training of each run, unless `scenario` names another.

    Args:
        runs: Groups, run directories, models in them, or folders of run directories; at least two runs or
            models.
        episodes: Episodes of each run; by default the number of the scenario of the first run.
        seed: Root seed of the starts, the same for all runs.
        model: The name of the model of each run; a model that `runs` names stays.
        scenario: The scenario to evaluate all runs in. Its interface must be that of every run.
        own: Whether each run is evaluated in its own scenario, also where they mean the same.
        on_episode: Is called with the number of finished episodes of all runs, and the number of all.
        executor: Where the evaluations run; the result does not depend on it.

    The other arguments are those of `evaluate`.

    Raises:
        RunError: A folder is not a run, or a run does not fit the scenario.
        UsageError: There are fewer than two runs, or `own` comes with a scenario.
    """
    if own and scenario is not None:
        raise UsageError(
            "choose one: evaluate each run in its own scenario (--own), or all runs in one scenario"
            " (--scenario)"
        )
    members = _members([Path(path) for path in runs], model)
    opened = [ref for group in members for ref in group.models]
    if len(opened) < 2:
        raise UsageError("a comparison needs at least two runs")
    first = members[0].models[0].run
    judged = first.compiled if scenario is None else api.compile(scenario)
    check_common_measure(judged.program, "let runs of all agents play: deepbots compare RUN")
    worlds = [
        _world(judged, first, group.models[0].run, own=own, named=scenario is not None) for group in members
    ]
    count = judged.program.evaluation_episodes(case) if episodes is None else episodes
    options: dict[str, Any] = {
        "episodes": count,
        "seed": seed,
        "case": case,
        "permissions": permissions,
        "build": build,
    }
    calls = [
        _Evaluation(ref, options | {"scenario": None if world.own else judged, "engine": world.engine})
        for group, world in zip(members, worlds, strict=True)
        for ref in group.models
    ]
    evaluations = results(
        executor.map(
            _evaluate, calls, watcher=FinishedEpisodes(on_episode, count * len(calls)), files=_records(opened)
        )
    )
    groups = [
        GroupResult(
            group.name,
            tuple(islice(evaluations, len(group.models))),
            group.waiting,
            tuple(map(_solved_after, group.models)),
        )
        for group in members
    ]
    solved = judged.program.agent.solved
    measure = measure_of(solved, defines_success=judged.program.defines_success)
    differences = tuple(
        _difference(groups[0], group, measure, world)
        for group, world in zip(groups[1:], worlds[1:], strict=True)
    )
    notes = _notes(members, groups, differences, worlds, named=scenario is not None)
    notes += _timing_notes(members, worlds, judged, case)
    name = None if any(world.own for world in worlds) else groups[0].evaluations[0].scenario
    return Comparison(
        name, groups[0].evaluations[0].episodes, seed, measure, tuple(groups), differences, tuple(notes)
    )


class _World(NamedTuple):
    """Whether a group is evaluated in its own scenario, in which engine, and how its scenario differs from
    that of the evaluation and from that of the first group. The engine is None if the scenario chooses it."""

    own: bool
    engine: str | None
    meanings: Meanings
    trainings: Meanings
    same_criterion: bool


def _world(judged: Compiled, first: Run, run: Run, *, own: bool, named: bool) -> _World:
    """Choose the scenario in which to evaluate a group that was trained in the scenario of `run`. If the
    caller named one (`named`), it is `judged`."""
    meanings, trainings = (
        Meanings()
        if compiled.digest == run.digest
        else compared_meanings(written_scenario(compiled), written_scenario(run.compiled))
        for compiled in (judged, first.compiled)
    )
    asked, other = (each.program.agent.solved for each in (first, run))
    differing = trainings.returns if asked is not None and asked.mean_return is not None else ()
    same = asked == other and not (trainings.success or differing)
    # All returns in a named scenario are of its reward.
    return _World(
        own or (bool(meanings.acting) and not named),
        None if named else run.record.engine,
        meanings,
        Meanings() if named else trainings,
        same,
    )


@dataclass(frozen=True)
class EngineDifference:
    """The difference of one policy between another engine and the first one, on the same starts. `case` is
    None for the scenario itself."""

    case: str | None
    first: str | None
    engine: str | None
    mean_return: Difference
    success_rate: Difference | None


def compare_engines(
    one: EvaluationResult | GroupResult, other: EvaluationResult | GroupResult
) -> EngineDifference:
    """Compare the evaluations of a policy in two engines episode by episode, or those of a group run by run.

    Intervals for a group are over its seeds, None for a single run.
    """
    first, second = (
        result.evaluations[0] if isinstance(result, GroupResult) else result for result in (one, other)
    )
    return EngineDifference(second.case, first.engine, second.engine, *_paired(one, other))


def _paired(
    first: EvaluationResult | GroupResult, second: EvaluationResult | GroupResult
) -> tuple[Difference, Difference | None]:
    """Compute the differences of return and success, by episodes or runs in the same order. The difference of
    success is None if one side defines no success."""
    (before, succeeded), (after, succeeds) = _scores(first), _scores(second)
    has_success = first.success_defined and second.success_defined
    bounds = (first.evaluations[0] if isinstance(first, GroupResult) else first).possible_returns
    success = compare_episodes(succeeded, succeeds, (0.0, 1.0)) if has_success else None
    return compare_episodes(before, after, bounds), success


def _scores(result: EvaluationResult | GroupResult) -> tuple[list[float], list[float]]:
    """Return the returns and successes of episodes, or of the runs of a group."""
    if isinstance(result, GroupResult):
        return result.returns, result.success_rates
    return [episode.total_return for episode in result.outcomes], [
        float(episode.is_success) for episode in result.outcomes
    ]


def evaluate_group(
    group: str | Path,
    *,
    seed: int = 0,
    scenario: Compiled | Scenario | str | Path | None = None,
    until: StopCondition | None = None,
    on_run: OnRun | None = None,
    executor: Executor = SERIAL,
    **options: Any,
) -> GroupResult:
    """Evaluate every run of a group on the same starts.

    Args:
        group: The folder of the group. Seeds without a model are left out, and named in `waiting`.
        until: Takes the episodes so far, of all runs in turn, and returns whether they are enough. The result
            then holds these only.
        on_run: Is called after each run.
        executor: Where the evaluations run; the result does not depend on it.
        options: Further arguments of `evaluate`. `seed` and `scenario` are as there; the default is the
            scenario of the group.

    Raises:
        RunError: The folder is not a group, or none of its runs has a model; else as for `evaluate`.
    """
    members = _open_runs(Group.open(group), options.pop("model", "best"))
    judged = None if scenario is None else api.compile(scenario)
    group_results: list[EvaluationResult] = []
    before: list[Episode] = []

    def enough(episodes: Sequence[Episode]) -> bool:
        return until is not None and until([*before, *episodes])

    evaluation_options = {**options, "seed": seed, "scenario": judged}
    stops = {"until": enough} if executor.is_here else {}
    calls = [_Evaluation(ref, {**evaluation_options, **stops}) for ref in members.models]
    evaluations = results(
        executor.map(_evaluate, calls, watcher=Counter(on_run, len(calls)), files=_records(members.models))
    )
    for ref, result in zip(members.models, evaluations, strict=False):
        group_results.append(
            result if executor.is_here else until_enough(result, enough, ref.run, **evaluation_options)
        )
        before += group_results[-1].outcomes
        if enough(()):
            break
    evaluations.close()
    solved_after = map(_solved_after, members.models[: len(group_results)])
    return GroupResult(members.name, tuple(group_results), members.waiting, tuple(solved_after))


class _Evaluation(NamedTuple):
    """A model, and the further arguments of `evaluate`."""

    model: ModelRef
    options: dict[str, Any]


def _evaluate(evaluation: _Evaluation, attempt: Attempt) -> EvaluationResult:
    return evaluate(evaluation.model, on_episode=lambda done, _: attempt.report(done), **evaluation.options)


def _records(models: Sequence[ModelRef]) -> list[Path]:
    return [ref.run.path / RECORD_NAME for ref in models]


class _GroupMembers(NamedTuple):
    """The models of a group; `path` tells it apart from groups of the same name."""

    name: str
    path: Path
    models: Sequence[ModelRef]
    waiting: tuple[int, ...] = ()


def _members(paths: Sequence[Path], model: ModelName) -> list[_GroupMembers]:
    """Return the groups in the order of their first runs; each model once."""
    groups_by_key: dict[object, _GroupMembers] = {}
    single: dict[object, list[ModelRef]] = {}
    for path in paths:
        if folder_kind(path) is SourceKind.GROUP:
            groups_by_key[path] = _open_runs(Group.open(path), model)
            continue
        for ref in (ModelRef.open(folder, model=model) for folder in run_folders([path])):
            key = ref.run.record.digest, ref.run.record.engine, ref.name
            alike = single.setdefault(key, [])
            if ref.path not in [member.path for member in alike]:
                alike.append(ref)
            name = alike[0].label + (f" and {len(alike) - 1} more" if len(alike) > 1 else "")
            groups_by_key[key] = _GroupMembers(name, alike[0].shown_path, alike)
    groups = list(groups_by_key.values())
    if len(groups) == 1:
        groups = [_GroupMembers(ref.label, ref.shown_path, (ref,)) for ref in groups[0].models]
    names = [group.name for group in groups]
    return [
        group._replace(name=str(group.path)) if names.count(group.name) > 1 else group for group in groups
    ]


def _open_runs(group: Group, model: ModelName = "best") -> _GroupMembers:
    """Return the models of this name of the runs of a group that have a model.

    Raises:
        RunError: There is none.
    """
    ready = group.runs_with_model
    if not ready:
        raise RunError(
            f"{group.path} contains no trained run yet; train it with: deepbots resume"
            f" {shell_word(group.path)}"
        )
    waiting = tuple(seed for seed in group.record.seeds if group.run(seed) not in ready)
    models = [ModelRef.open(run, model=model) for run in ready]
    return _GroupMembers(group.path.name, group.path, models, waiting)


def _solved_after(ref: ModelRef) -> int | None:
    """Return the steps after which a confirmation showed that the run solves its task; None for another model
    than the best."""
    return run_verdict(ref.run.path, ref.run.record).solved_after if ref.name == "best" else None


def _difference(first: GroupResult, group: GroupResult, measure: Measure, world: _World) -> GroupDifference:
    between_seeds = max(len(first.evaluations), len(group.evaluations)) > 1
    returns: Difference | None
    success: Difference | None
    steps = None
    if between_seeds:
        has_success = first.success_defined and group.success_defined
        success = compare_seeds(first.success_rates, group.success_rates, (0.0, 1.0)) if has_success else None
        returns = compare_seeds(first.returns, group.returns, first.evaluations[0].possible_returns)
        before, after = (
            [steps for steps in side.solved_after if steps is not None] for side in (first, group)
        )
        all_solved = len(before) + len(after) == len(first.evaluations) + len(group.evaluations)
        steps = compare_seeds(before, after, (0.0, math.inf)) if all_solved else None
    else:
        returns, success = _paired(first.evaluations[0], group.evaluations[0])
    if world.trainings.reward or (world.own and world.meanings.returns):
        returns = None
    if world.own and world.meanings.success:
        success = None
    return GroupDifference(
        first.name,
        group.name,
        measure,
        returns,
        success,
        between_seeds,
        steps if world.same_criterion else None,
        world.own,
        world.meanings,
        world.same_criterion,
        {
            "mean_return": (first.mean_return, group.mean_return),
            "success_rate": (first.success_rate, group.success_rate),
        },
    )


def _notes(
    members: Sequence[_GroupMembers],
    groups: Sequence[GroupResult],
    differences: Sequence[GroupDifference],
    worlds: Sequence[_World],
    *,
    named: bool,
) -> list[str]:
    notes = [
        f"{group.name}: no model yet of seed {', '.join(map(str, group.waiting))}"
        for group in groups
        if group.waiting
    ]
    for difference in differences:
        notes += _notes_on_scenarios(difference, named=named)
    fewest = min(len(group.evaluations) for group in groups)
    if all(not difference.between_seeds for difference in differences):
        notes.append(
            "each group has one run, so the intervals compare these policies, not their settings; to compare"
            " settings, train several seeds"
        )
    elif fewest < MIN_SEEDS:
        notes.append(
            f"a group has {counted(fewest, 'run')}: train at least {MIN_SEEDS} seeds of each, better 5"
        )
    for group in members:
        seeds = [ref.run.record.seed for ref in group.models]
        if len({*seeds}) < len(seeds):
            notes.append(f"{group.name} has runs of the same seed, so its interval over seeds is too narrow")
    runs = [ref.run for group in members for ref in group.models]
    notes += [note for run in runs for note in run.notes_on_physics()]
    if len({run.record.engine for run in runs}) > 1:
        engines = {str(result.engine) for group in groups for result in group.evaluations}
        where = "its own engine" if len(engines) > 1 else f"the engine {engines.pop()}"
        notes.append(f"the runs were trained in different engines; each run is evaluated in {where}")
    rewards = {change.text: change for world in worlds if not world.own for change in world.trainings.reward}
    if rewards:
        notes.append(
            "the rewards of the runs differ, so returns are left out; compare success rates, or choose"
            " one reward with --scenario:"
            f" {_listed([*rewards.values()])}"
        )
    if not all(world.same_criterion for world in worlds) and any(map(any, (g.solved_after for g in groups))):
        notes.append(
            "the steps until solved are left out, because `solved`, or an ending that it counts,"
            " differs between the runs"
        )
    return notes


def _timing_notes(
    members: Sequence[_GroupMembers], worlds: Sequence[_World], judged: Compiled, case: str | None
) -> list[str]:
    """Return the differences of timing between the evaluation and the training, once for each group."""
    notes: dict[str, None] = {}
    for group, world in zip(members, worlds, strict=True):
        for run in (ref.run for ref in group.models):
            program = (run.compiled if world.own else judged).program.variant(case, None)
            notes |= dict.fromkeys(
                f"{group.name}: {difference}" for difference in timing_differences(run.program, program)
            )
    return [*notes]


def _notes_on_scenarios(difference: GroupDifference, *, named: bool) -> list[str]:
    """Return notes on where the two groups are evaluated, why, and what is therefore not compared."""
    meanings = difference.meanings
    names = f"{difference.first} and {difference.group}"
    notes = []
    if meanings.acting and named:
        notes.append(
            f"{difference.group} was trained where observations or actions mean something else than here:"
            f" {_listed(meanings.acting)}"
        )
    if not difference.own_scenarios:
        return notes
    reason = (
        f", because the robot, the observation or the action differs: {_listed(meanings.acting)}"
        if meanings.acting
        else ""
    )
    notes.append(f"{names} are each evaluated in their own scenario, from starts with the same seeds{reason}")
    if difference.mean_return is None:
        notes.append(
            f"{names}: returns are not compared, because they do not mean the same:"
            f" {_listed(meanings.returns)}"
        )
    if meanings.success:
        notes.append(
            f"{names}: successes are not compared, because they do not mean the same:"
            f" {_listed(meanings.success)}"
        )
    return notes


def _listed(changes: Sequence[Change]) -> str:
    """Return changes in the words of `deepbots diff`."""
    more = (
        f"; and {len(changes) - _MAX_LISTED} more, which `deepbots diff` lists"
        if len(changes) > _MAX_LISTED
        else ""
    )
    return "; ".join(change.text for change in changes[:_MAX_LISTED]) + more
