"""Groups: one folder with a run for each of several seeds, which differ in nothing else, or with attempts at
one scenario.

    runs/cartpole-seeds-1/
    ├── group.json           seeds, settings of the trainings, command
    ├── inputs/, resolved.yaml   the scenario, from which seeds that have not begun are trained
    ├── workers/             the output of workers
    └── seed-0/, seed-1/ ... the runs

The runs of `train --retry` are `try-1`, `try-2`, ... instead: one seed, with other values under `train` each
(`insight/retry.py`). The seeds are trained one after the other, or on workers (`executor`): then a training
whose worker was lost is resumed by another one, to the same bytes. Importing this module does not load torch.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any, Unpack

from pydantic import BaseModel, ConfigDict, Field, NonNegativeInt, PositiveInt

from deepbots_cli import api
from deepbots_cli.api import Compiled
from deepbots_cli.document import Permissions
from deepbots_cli.errors import DeepbotsError, RunError, StorageError, UsageError
from deepbots_cli.learning.calls import Attempt
from deepbots_cli.learning.campaigns.campaign import MAX_SEEDS, Campaign, CampaignRecord, Member, train_member
from deepbots_cli.learning.executor import SERIAL, CallOptions, Executor
from deepbots_cli.learning.report import GroupProgressReporter, GroupReporter, Reporter, TrainingProgress
from deepbots_cli.learning.runs.directories import WORKERS_FOLDER, new_directory, run_lock
from deepbots_cli.learning.runs.order import Measure, Rank, measure_of, rank
from deepbots_cli.learning.runs.records import RunRecord, TrainingOptions, TrainingResult
from deepbots_cli.learning.runs.verdict import RunVerdict, run_verdict
from deepbots_cli.learning.signals import Interruption, signals_handled
from deepbots_cli.rollout.source import GROUP_RECORD_NAME, SourceKind, folder_kind

if TYPE_CHECKING:
    from deepbots_cli.learning.callbacks import OnEvaluation
    from deepbots_cli.learning.environments import WorldFactory

MAX_RETRIES = 20


class RetryAttempt(BaseModel):
    """A training of `train --retry`.

    Attributes:
        settings: The values that differ from the scenario, as text, by the path of the setting.
        base: Number of the attempt that was diagnosed, from 1; 0 for the first one.
        cause: Name of the cause that advised the last of the values, `text` is its sentence.
    """

    model_config = ConfigDict(frozen=True, strict=True)

    settings: Mapping[str, str] = {}
    base: NonNegativeInt = 0
    cause: str = ""
    text: str = ""


class GroupRecord(CampaignRecord):
    """The content of `group.json`: the seeds, and the settings that all trainings share; see `train` for
    their meaning.

    A group of `train --retry` has one seed, the attempts so far, and the highest number of `retries` after
    the first.
    """

    total_timesteps: PositiveInt | None = None
    stop_when_solved: bool = True
    stage: str | None = None
    keep_checkpoints: NonNegativeInt = 0
    initialize_from: str | None = None
    demonstrations: str | None = None
    callbacks: tuple[str, ...] = ()
    loggers: tuple[str, ...] = ()
    retries: int = Field(default=0, ge=0, le=MAX_RETRIES)
    attempts: tuple[RetryAttempt, ...] = Field(default=(), max_length=MAX_RETRIES + 1)

    @property
    def options(self) -> dict[str, Any]:
        """The options of each training."""
        return self.model_dump(include={*TrainingOptions.__annotations__})


@dataclass(frozen=True)
class Group(Campaign[GroupRecord]):
    """A group on disk, with a run for each seed, or for each attempt of `train --retry`."""

    noun = "group"
    kind = SourceKind.GROUP
    record_name = GROUP_RECORD_NAME
    record_type = GroupRecord

    def __post_init__(self) -> None:
        attempts = self.record.attempts
        is_ordered = all(attempt.base <= number for number, attempt in enumerate(attempts))
        if not is_ordered or (attempts and len(self.record.seeds) > 1):
            raise RunError(
                f"{self.path / GROUP_RECORD_NAME} is damaged: its attempts do not follow one another"
            )

    def run(self, seed: int) -> Path:
        """Return the folder of the run of a seed, which exists once its training has begun."""
        return self.path / f"seed-{seed}"

    @property
    def attempts(self) -> list[Member]:
        """The attempts of `train --retry`; empty for a group of seeds."""
        attempts = enumerate(self.record.attempts, start=1)
        return [Member(self.path / f"try-{number}", attempt.settings) for number, attempt in attempts]

    @property
    def planned(self) -> list[Path]:
        return [attempt.path for attempt in self.attempts] or [self.run(seed) for seed in self.record.seeds]

    @property
    def representatives(self) -> list[Path]:
        """The folders of the runs that represent the group, as far as they have begun: those of all seeds, or
        that of the best attempt.

        Raises:
            RunError: A record is damaged.
        """
        best = self.best
        return self.runs if best is None else [best.path]

    @property
    def best(self) -> Member | None:
        return self.attempts[self.best_attempt - 1] if self.attempts else None

    def attempt_verdict(self, number: int) -> RunVerdict:
        """Return the verdict about an attempt, from 1.

        Raises:
            RunError: The record of the attempt is damaged.
        """
        folder = self.planned[number - 1]
        return (
            run_verdict(folder, RunRecord.read(folder))
            if folder_kind(folder) is SourceKind.RUN
            else RunVerdict(None, None)
        )

    @property
    def best_attempt(self) -> int:
        """The number of the attempt with the best evaluation: solved, then by the measure of the task; of
        equals the last one.

        Raises:
            RunError: A record is damaged.
        """

        verdicts = {
            number: self.attempt_verdict(number) for number in range(1, len(self.record.attempts) + 1)
        }
        evaluations = [verdict.evaluation for verdict in verdicts.values() if verdict.evaluation is not None]
        measure = self._measure(defines_success=any(evaluation.success_defined for evaluation in evaluations))

        def order(number: int) -> tuple[bool, Rank, int]:
            verdict = verdicts[number]
            evaluation = verdict.evaluation
            score = (-math.inf, -math.inf)
            if evaluation is not None:
                score = rank(measure, evaluation.success_rate, evaluation.mean_return)
            return verdict.solved is True, score, number

        return max(verdicts, key=order)

    def _measure(self, *, defines_success: bool) -> Measure:
        """Return the measure of the task that a training has recorded; nothing is compiled."""
        for folder in self.runs:
            result = RunRecord.read(folder).result
            if result is not None and result.best is not None:
                return result.best.measure
        return measure_of(None, defines_success=defines_success)

    @property
    def runs_with_model(self) -> list[Path]:
        """The folders of the runs that have a model."""
        return [run for run in self.runs if any(run.glob("models/*/best.zip"))]


@dataclass(frozen=True)
class GroupTraining:
    """The result of training a group.

    `trained` are the results of the runs that this call has trained, `skipped` the seeds that were finished
    before, and `failed` the reasons why a training failed, by seed. `waiting` are the seeds that an
    interruption leaves untrained or unfinished.
    """

    group: Path
    trained: tuple[TrainingResult, ...]
    skipped: tuple[int, ...]
    failed: dict[int, str]
    waiting: tuple[int, ...]

    @property
    def interrupted(self) -> bool:
        """Whether a stop was requested, including one in the last rollout of the last seed, which leaves no
        seed waiting."""
        return bool(self.waiting) or any(result.stop_requested for result in self.trained)


OnSeed = Callable[[int, int, int], object]
"""Called before the training of a seed in this process, with the seed, its number from 1, and the number of
all seeds; returns False to end the group."""


def train_group(
    compiled: Compiled,
    seeds: Sequence[int],
    *,
    group: str | Path | None = None,
    runs: str | Path = "runs",
    progress: bool | Reporter = False,
    on_seed: OnSeed | None = None,
    on_evaluation: OnEvaluation | None = None,
    build: WorldFactory | None = None,
    executor: Executor = SERIAL,
    **options: Unpack[TrainingOptions],
) -> GroupTraining:
    """Train a scenario with several seeds in a new folder.

    If one training fails, the others continue. An interruption stops the group after the current rollout. A
    second one stops it at once.

    Args:
        compiled: The scenario.
        seeds: The root seeds, each once.
        group: The folder to make; by default `runs/<scenario>-seeds-<n>`.
        progress: Whether to report progress on standard error, or your own `Reporter`; on workers it is a
            table of all trainings.
        on_seed: Is called before each training in this process; where it returns False, the group ends.
        on_evaluation: As for `train`, for each training in this process.
        executor: Where the trainings run; the result does not depend on it. By default they run in this
            process, one after the other.
        runs: The folder in which a default one is made.
        build: As for `train`.
        options: Further options of `train`.

    Raises:
        UsageError: The folder exists, a seed is given twice, or the settings are invalid for training.
        TypeError: `train` has no such option.
    """
    if unknown := options.keys() - TrainingOptions.__annotations__.keys():
        raise TypeError(f"a training has no option {', '.join(sorted(unknown))}")
    if not seeds or len(set(seeds)) < len(seeds) or len(seeds) > MAX_SEEDS:
        raise UsageError(f"a group needs 1 to {MAX_SEEDS} different seeds")
    from deepbots_cli.learning.training import checked_settings

    compiled = api.with_learner(compiled)
    checked_settings(compiled.program, seeds, **options)
    path = new_directory(group, runs, compiled.program.name, "seeds")
    with Group.created(path, new_record(compiled, seeds, options), compiled) as created:
        return _train_seeds(created, compiled, {}, on_seed, progress, build, executor, on_evaluation)


def new_record(
    compiled: Compiled, seeds: Sequence[int], options: TrainingOptions, retries: int = 0
) -> GroupRecord:
    """Return the record of a group whose trainings have these options; with `retries`, of a group of
    attempts."""
    values: dict[str, Any] = {**options}
    values |= {name: tuple(values.get(name, ())) for name in ("callbacks", "loggers", "command")}
    for name in ("initialize_from", "demonstrations"):
        if values.get(name) is not None:
            # The group may be resumed from another working directory.
            values[name] = str(Path(values[name]).absolute())
    values |= GroupRecord.common(compiled, values.get("engine"))
    return GroupRecord(
        seeds=tuple(seeds), retries=retries, attempts=(RetryAttempt(),) if retries else (), **values
    )


def resume_group(
    group: str | Path,
    *,
    total_timesteps: int | None = None,
    stop_when_solved: bool | None = None,
    callbacks: Sequence[str] | None = None,
    loggers: Sequence[str] | None = None,
    progress: bool | Reporter = False,
    permissions: Permissions = Permissions(),
    on_seed: OnSeed | None = None,
    on_evaluation: OnEvaluation | None = None,
    build: WorldFactory | None = None,
    executor: Executor = SERIAL,
) -> GroupTraining:
    """Continue a group: finished seeds are skipped, interrupted ones continue from their last checkpoint, the
    others begin.

    Arguments are those of `resume` and `train_group`; with a higher `total_timesteps`, finished seeds
    continue too.

    Raises:
        RunError: The folder is not a group, or is damaged.
        UsageError: Another training uses the group, or a callback or logger does not exist.
    """
    resumed = Group.open(group)
    if resumed.attempts:
        raise UsageError(
            f"{resumed.path} is a group of `train --retry`; continue it with: deepbots resume"
            f" {quote(str(resumed.path))}"
        )
    options = {
        "callbacks": None if callbacks is None else tuple(callbacks),
        "loggers": None if loggers is None else tuple(loggers),
        "total_timesteps": total_timesteps,
        "stop_when_solved": stop_when_solved,
    }
    changes = {name: value for name, value in options.items() if value is not None}
    with run_lock(resumed.path):
        if callbacks or loggers:
            from deepbots_cli.learning.sb3 import plugins

            plugins.check(callbacks or (), loggers or ())
        if changes:  # a later call continues with them if this one is interrupted
            resumed = resumed.changed(**changes)
        compiled = resumed.compiled(permissions=permissions)
        return _train_seeds(resumed, compiled, changes, on_seed, progress, build, executor, on_evaluation)


def _train_seeds(
    group: Group,
    compiled: Compiled,
    changes: Mapping[str, Any],
    on_seed: OnSeed | None,
    progress: bool | Reporter,
    build: WorldFactory | None,
    executor: Executor,
    on_evaluation: OnEvaluation | None,
) -> GroupTraining:
    """Train or continue every seed that is not finished, with `changes` of the options that the group began
    with."""
    seeds, options = group.record.seeds, group.record.options
    skipped = tuple(seed for seed in seeds if _is_complete(group, seed, changes))
    left = [seed for seed in seeds if seed not in skipped]
    items = [
        _SeedTraining(group.run(seed), seed, compiled, options, _changes_of(group, seed, changes))
        for seed in left
    ]
    trained: list[TrainingResult] = []
    failed: dict[int, str] = {}
    with ExitStack() as stack:
        on_workers: CallOptions = {}
        if executor.is_here:
            begins = {
                seed: None if on_seed is None else partial(on_seed, seed, number, len(seeds))
                for number, seed in enumerate(seeds, 1)
            }
            arguments = {"progress": progress, "build": build, "on_evaluation": on_evaluation}
            items = [replace(item, local=arguments, begin=begins[item.seed]) for item in items]
        else:
            if build is not None or on_evaluation is not None or isinstance(progress, Reporter):
                raise UsageError(
                    "`build`, `on_evaluation` and your own reporter work in this process only; leave out the"
                    " workers"
                )
            interruption = Interruption()
            reporter = GroupProgressReporter(group.path, left) if progress else GroupReporter()
            stack.callback(reporter.close)
            stack.enter_context(signals_handled(interruption))
            on_workers = {"watcher": reporter, "stop": partial(_stops, interruption, reporter)}
            on_workers |= {"files": [group.path / GROUP_RECORD_NAME], "log": partial(_log_of, group.path)}
        outcomes = stack.enter_context(closing(executor.map(_train_seed, items, **on_workers)))
        with suppress(KeyboardInterrupt):  # a signal before a training handles it, or a second one
            # After a stop, there are fewer outcomes than seeds.
            for seed, outcome in zip(left, outcomes, strict=False):
                if isinstance(outcome, DeepbotsError):
                    # The settings cannot be trained, or the folder cannot be written to.
                    if not group.runs or isinstance(outcome, StorageError):
                        raise outcome
                    failed[seed] = outcome.full_message
                elif outcome is not None:
                    trained.append(outcome)
                    if executor.is_here and outcome.stop_requested:
                        break
                elif executor.is_here:
                    break
    finished_runs = {result.run for result in trained if not result.interrupted}
    waiting = tuple(seed for seed in left if seed not in failed and group.run(seed) not in finished_runs)
    return GroupTraining(group.path, tuple(trained), skipped, failed, waiting)


def _stops(interruption: Interruption, reporter: GroupReporter) -> bool:
    if interruption.requested:
        reporter.stop()
    return interruption.requested


@dataclass(frozen=True)
class _SeedTraining:
    """A training of a group: it begins with the `options` of the group, or continues, both with `changes` of
    these.

    `local` are further arguments of `train` and `resume` in this process; on workers they are None.
    """

    path: Path
    seed: int
    compiled: Compiled
    options: Mapping[str, Any]
    changes: Mapping[str, Any]
    local: Mapping[str, Any] | None = None
    begin: Callable[[], object] | None = None


def _log_of(group: Path, item: _SeedTraining) -> Path:
    return group / WORKERS_FOLDER / f"seed-{item.seed}.log"


def _is_complete(group: Group, seed: int, changes: Mapping[str, Any]) -> bool:
    """Return whether nothing is left to train. A damaged run counts as incomplete, so that its error is
    reported."""
    try:
        record = _record_of(group, seed)
    except DeepbotsError:
        return False
    if record is None or record.status != "finished":
        return False
    steps = record.result.steps if record.result is not None else 0
    goal: int | None = changes.get("total_timesteps")
    if goal is not None:
        return steps >= goal
    missed = _missed_changes(group, record)
    if "stop_when_solved" in missed:
        return "total_timesteps" not in missed and steps >= record.total_timesteps
    return not missed


def _changes_of(group: Group, seed: int, changes: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the changes for a run: those of this call, and those of an earlier one that did not reach it."""
    try:
        record = _record_of(group, seed)
    except DeepbotsError:
        return changes
    return changes if record is None else {**_missed_changes(group, record), **changes}


def _missed_changes(group: Group, record: RunRecord) -> dict[str, Any]:
    """Return the options of a group with which a run has not continued yet."""
    total = group.record.total_timesteps
    missed: dict[str, Any] = {}
    if total is not None and record.total_timesteps < total:
        missed["total_timesteps"] = total
    if record.stop_when_solved and not group.record.stop_when_solved:
        missed["stop_when_solved"] = False
    return missed


def _record_of(group: Group, seed: int) -> RunRecord | None:
    run = group.run(seed)
    return RunRecord.read(run) if folder_kind(run) is SourceKind.RUN else None


def _train_seed(item: _SeedTraining, attempt: Attempt) -> TrainingResult | None:
    """Train a seed, or continue its run, which may have been begun by a worker that was lost. None if the
    group ends before."""
    if item.begin is not None and item.begin() is False:
        return None
    arguments = {"progress": _AttemptReporter(attempt)} if item.local is None else item.local
    is_repeated = attempt.number > 1
    return train_member(
        item.path, item.compiled, item.seed, item.options, item.changes, is_repeated=is_repeated, **arguments
    )


class _AttemptReporter(Reporter):
    """Reports the progress of a training on a worker."""

    def __init__(self, attempt: Attempt) -> None:
        self._attempt = attempt

    def note(self, text: str) -> None:
        self._attempt.note(text)

    def start(self, progress: TrainingProgress) -> None:
        self._attempt.report(progress)

    def update(self, progress: TrainingProgress) -> None:
        self._attempt.report(progress)
