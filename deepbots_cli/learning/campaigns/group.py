"""Campaigns: several trainings of one scenario in one folder, which differ by the plan; and groups, in which
they differ by the seed alone.

    a group  seed-0/, seed-1/ ...    other random numbers    this module
    a study  trial-0/, trial-1/ ...  the values of a search  `study.py`

Each has a record, the copies of its scenario, and its members. A member of a group is a run; that of a study
is a group. The process that trains a campaign writes its status into the record; commands read
`Campaign.state`.

    runs/cartpole-seeds-1/
    ├── group.json           seeds, settings of the trainings, status, command
    ├── inputs/, resolved.yaml   the scenario, from which seeds that have not begun are trained
    ├── workers/             the output of workers
    └── seed-0/, seed-1/ ... the runs

The seeds are trained one after the other, or on workers (`executor`): then a training whose worker was lost
is resumed by another one, to the same bytes. Importing this module does not load torch.
"""

from __future__ import annotations

import shutil
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Generic, Self, TypeVar, Unpack

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    NonNegativeInt,
    PositiveInt,
    ValidationError,
    field_validator,
)
from pydantic_core import PydanticCustomError

import deepbots_cli
from deepbots_cli import api, engine_kinds
from deepbots_cli.api import Compiled
from deepbots_cli.compiler.inputs import INPUTS_FOLDER, RESOLVED_NAME, write_copies
from deepbots_cli.document import Permissions
from deepbots_cli.errors import DeepbotsError, RunError, StorageError, UsageError
from deepbots_cli.learning.executor import (
    SERIAL,
    Attempt,
    CallOptions,
    Executor,
    Interruption,
    signals_handled,
)
from deepbots_cli.learning.report import GroupProgressReporter, GroupReporter, Reporter, TrainingProgress
from deepbots_cli.learning.runs.directories import (
    WORKERS_FOLDER,
    has_ended,
    is_training,
    new_directory,
    read_record,
    refuse_link,
    run_lock,
    validation_text,
    write_text,
)
from deepbots_cli.learning.runs.run import (
    RunRecord,
    State,
    Status,
    TrainingOptions,
    TrainingResult,
    remove_incomplete,
    state_of,
    timestamp,
)
from deepbots_cli.records import dataclass
from deepbots_cli.rollout.source import GROUP_RECORD_NAME, Source, SourceKind, folder_kind

if TYPE_CHECKING:
    from deepbots_cli.learning.callbacks import OnEvaluation
    from deepbots_cli.learning.environments import WorldFactory
    from deepbots_cli.scenario import Scenario

FORMAT = 2
MAX_SEEDS = 1000
_MAX_RECORD_BYTES = 1_000_000


class CampaignRecord(BaseModel):
    """The fields of the records of all campaigns: the seeds of the trainings, and the engine unless a
    scenario names one. `status` is that of the last process that trained; it stays `running` if this process
    was killed."""

    model_config = ConfigDict(frozen=True, strict=True, allow_inf_nan=False)

    format: int
    deepbots: str
    status: Status = "running"
    scenario: str
    source: str
    engine: str
    seeds: tuple[Annotated[int, Field(ge=0, lt=2**63)], ...]
    command: tuple[str, ...]
    started: str

    @field_validator("seeds")
    @classmethod
    def _are_different(cls, seeds: tuple[int, ...]) -> tuple[int, ...]:
        if not 1 <= len(set(seeds)) == len(seeds) <= MAX_SEEDS:
            raise PydanticCustomError("seeds", "expected 1 to {limit} different seeds", {"limit": MAX_SEEDS})
        return seeds

    @classmethod
    def new(cls, compiled: Compiled, engine: str | None = None, **values: Any) -> Self:
        """Return the record of a campaign that begins; arguments and errors are those of `checked`."""
        return cls.checked(
            format=FORMAT,
            deepbots=deepbots_cli.__version__,
            scenario=compiled.program.name,
            source=str(compiled.source),
            engine=engine_kinds.chosen(engine or compiled.program.engine),
            started=timestamp(),
            **values,
        )

    @classmethod
    def checked(cls, **values: Any) -> Self:
        """Return a record with these values.

        Raises:
            UsageError: A value is outside its limits, or a seed is given twice.
        """
        try:
            return cls(**values)
        except ValidationError as error:
            raise UsageError(f"the settings of the trainings do not fit: {validation_text(error)}") from None


R = TypeVar("R", bound=CampaignRecord)


@dataclass(frozen=True)
class Campaign(ABC, Generic[R]):
    """Several trainings on disk."""

    path: Path
    record: R

    noun: ClassVar[str]
    kind: ClassVar[SourceKind]
    record_name: ClassVar[str]
    record_type: ClassVar[type[CampaignRecord]]
    files: ClassVar[tuple[str, ...]] = (RESOLVED_NAME, INPUTS_FOLDER, WORKERS_FOLDER)

    @classmethod
    def open(cls, path: str | Path | Source) -> Self:
        """Open a campaign that exists.

        Raises:
            RunError: The folder is not such a campaign, its record is damaged, or another version of deepbots
                wrote it.
        """
        folder = Source.open(path, Permissions(), cls.kind).path
        refuse_link(folder)
        record = folder / cls.record_name
        contents = read_record(record, cls.record_type, cls.noun, FORMAT, _MAX_RECORD_BYTES)
        campaign = cls(folder, contents)  # type: ignore[arg-type]  # R is its record_type
        for member in (record, *(folder / name for name in cls.files), *campaign.planned):
            if member.is_symlink():
                raise RunError(
                    f"{member} is a symbolic link; deepbots does not write symbolic links into a {cls.noun}"
                )
        return campaign

    @classmethod
    @contextmanager
    def created(cls, path: Path, record: R, compiled: Compiled) -> Iterator[Self]:
        """Context with a campaign in a new folder, which is removed if the block fails before a training has
        begun."""
        campaign = cls(path, record)
        try:
            with run_lock(path):
                write_copies(path, compiled.resolved, compiled.inputs)
                campaign.write()
                yield campaign
        except (DeepbotsError, KeyboardInterrupt):
            if not campaign.runs:  # the settings cannot be trained, or the folder cannot be written to
                shutil.rmtree(path, ignore_errors=True)
            raise

    @property
    @abstractmethod
    def planned(self) -> Sequence[Path]:
        """The folders of all planned members, including those that have not begun."""

    @property
    def is_training(self) -> bool:
        """Whether a process trains the campaign."""
        return is_training(self.path)

    @property
    def state(self) -> State:
        """The status of the record; a campaign whose processes were killed is interrupted."""
        return state_of(self.record.status, lambda: self.is_training)

    @property
    def runs(self) -> list[Path]:
        """The folders of the members that have begun, in their order."""
        return [
            folder for folder in self.planned if folder_kind(folder) in (SourceKind.RUN, SourceKind.GROUP)
        ]

    def write(self) -> None:
        """Write the record."""
        write_text(self.path / self.record_name, self.record.model_dump_json(indent=2) + "\n")

    def changed(self, **values: Any) -> Self:
        """Return the campaign with other values in its record, and write this record.

        Raises:
            UsageError: A value is outside its limits.
        """
        campaign = replace(self, record=self.record.checked(**{**dict(self.record), **values}))
        campaign.write()
        return campaign

    def compiled(self, overrides: Sequence[str] = (), permissions: Permissions = Permissions()) -> Compiled:
        """Compile the scenario from its copy, with assignments of `--set`."""
        compiled = api.compile(Source.kept(self.path, kind=self.kind), overrides=overrides)
        return replace(compiled, source=Path(self.record.source), permissions=permissions)


class GroupRecord(CampaignRecord):
    """The content of `group.json`: the seeds, and the settings that all trainings share; see `train` for
    their meaning."""

    total_timesteps: PositiveInt | None = None
    stop_when_solved: bool = True
    stage: str | None = None
    keep_checkpoints: NonNegativeInt = 0
    initialize_from: str | None = None
    demonstrations: str | None = None
    callbacks: tuple[str, ...] = ()
    loggers: tuple[str, ...] = ()

    @property
    def options(self) -> dict[str, Any]:
        """The options of each training."""
        return self.model_dump(include={*TrainingOptions.__annotations__})


@dataclass(frozen=True)
class Group(Campaign[GroupRecord]):
    """A group on disk."""

    noun = "group"
    kind = SourceKind.GROUP
    record_name = GROUP_RECORD_NAME
    record_type = GroupRecord

    def run(self, seed: int) -> Path:
        """Return the folder of the run of a seed, which exists once its training has begun."""
        return self.path / f"seed-{seed}"

    @property
    def planned(self) -> list[Path]:
        return [self.run(seed) for seed in self.record.seeds]

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
    scenario: Compiled | Scenario | str | Path,
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
        scenario: As for `train`.
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
    from deepbots_cli.learning.training import checked_settings

    compiled = api.with_learner(api.compile(scenario))
    record = _new_record(compiled, seeds, options)
    checked_settings(compiled.program, seeds, **options)
    path = new_directory(group, runs, compiled.program.name, "seeds")
    with Group.created(path, record, compiled) as created:
        return _train_seeds(created, compiled, {}, on_seed, progress, build, executor, on_evaluation)


def _new_record(compiled: Compiled, seeds: Sequence[int], options: TrainingOptions) -> GroupRecord:
    """Return the record of a group whose trainings have these options."""
    values: dict[str, Any] = {**options}
    values |= {name: tuple(values.get(name, ())) for name in ("callbacks", "loggers", "command")}
    for name in ("initialize_from", "demonstrations"):
        if values.get(name) is not None:
            # The group may be resumed from another working directory.
            values[name] = str(Path(values[name]).absolute())
    engine = values.pop("engine", None)
    return GroupRecord.new(compiled, engine, seeds=tuple(seeds), **values)


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
    options = {
        "callbacks": None if callbacks is None else tuple(callbacks),
        "loggers": None if loggers is None else tuple(loggers),
        "total_timesteps": total_timesteps,
        "stop_when_solved": stop_when_solved,
    }
    changes = {name: value for name, value in options.items() if value is not None}
    with run_lock(resumed.path):
        if callbacks or loggers:
            from deepbots_cli.learning.sb3 import logs

            logs.check_plugins(callbacks or (), loggers or ())
        if changes:  # a later call continues with them if this one is interrupted
            resumed = resumed.changed(status="running", **changes)
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
    records = {seed: _record_of(group.run(seed)) for seed in seeds}
    all_changes = {seed: _changes_of(group.record, record, changes) for seed, record in records.items()}
    left = [seed for seed, own in all_changes.items() if own is not None]
    skipped = tuple(seed for seed in seeds if seed not in left)
    if left:
        group = group.changed(status="running")
    items = [
        _SeedTraining(
            group.run(seed), seed, compiled, options, own, None if record is None else record.resumed_at
        )
        for (seed, own), record in zip(all_changes.items(), records.values(), strict=True)
        if own is not None
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
    group.changed(status=_status(failed, waiting))
    return GroupTraining(group.path, tuple(trained), skipped, failed, waiting)


def _status(failed: Mapping[int, str], waiting: Sequence[int]) -> Status:
    """Return the status of a group after a call that leaves these seeds."""
    if failed:
        return "failed"
    return "interrupted" if waiting else "finished"


def _stops(interruption: Interruption, reporter: GroupReporter) -> bool:
    if interruption.requested:
        reporter.stop()
    return interruption.requested


@dataclass(frozen=True)
class _SeedTraining:
    """A training of a group: it begins with the `options` of the group, or continues, both with `changes` of
    these.

    `resumed_at` is that of the run before; None if there was no run. `local` are further arguments of `train`
    and `resume` in this process; on workers they are None.
    """

    path: Path
    seed: int
    compiled: Compiled
    options: Mapping[str, Any]
    changes: Mapping[str, Any]
    resumed_at: tuple[int, ...] | None
    local: Mapping[str, Any] | None = None
    begin: Callable[[], object] | None = None


def _log_of(group: Path, item: _SeedTraining) -> Path:
    return group / WORKERS_FOLDER / f"seed-{item.seed}.log"


def _record_of(run: Path) -> RunRecord | None:
    """Return the record of a run; None if there is no run, or if it is damaged."""
    try:
        return RunRecord.read(run) if folder_kind(run) is SourceKind.RUN else None
    except DeepbotsError:
        return None


def _changes_of(
    group: GroupRecord, run: RunRecord | None, changes: Mapping[str, Any]
) -> Mapping[str, Any] | None:
    """Return the changes for a run of the group: those of this call, and those of an earlier one that did not
    reach it. None if nothing is left to train; a damaged run is left, so that its error is reported."""
    if run is None:
        return changes
    missed: dict[str, Any] = {
        name: getattr(group, name)
        for name in ("callbacks", "loggers")
        if getattr(group, name) != getattr(run, name)
    }
    total = group.total_timesteps
    if total is not None and run.total_timesteps < total:
        missed["total_timesteps"] = total
    if run.stop_when_solved and not group.stop_when_solved:
        missed["stop_when_solved"] = False
    continued = {**missed, **changes}
    may_stop_early = "total_timesteps" not in changes and "stop_when_solved" not in missed
    goal = continued.get("total_timesteps", run.total_timesteps)
    return None if run.is_complete(goal, may_stop_early=may_stop_early) else continued


def _train_seed(item: _SeedTraining, attempt: Attempt) -> TrainingResult | None:
    """Train a seed, or continue its run, which may have been begun by a worker that was lost. None if the
    group ends before."""
    if item.begin is not None and item.begin() is False:
        return None
    from deepbots_cli.learning.training import resume, train

    further = {"progress": _AttemptReporter(attempt)} if item.local is None else item.local
    is_repeated = attempt.number > 1
    if is_repeated:
        # A training that goes on has the lock of the run, and `resume` would fail.
        has_ended(item.path)
    if folder_kind(item.path) is not SourceKind.RUN:
        remove_incomplete(item.path)
        options = {**item.options, **item.changes}
        return train(item.compiled, run=item.path, seed=item.seed, **options, **further)
    record = RunRecord.read(item.path)
    # The run was not complete before this call: only the lost worker can have finished it since.
    is_complete = record.is_finished and record.resumed_at != item.resumed_at
    if is_repeated and is_complete and record.result is not None:
        return TrainingResult(run=item.path, initialized_from=record.initialized_from, **vars(record.result))
    return resume(item.path, permissions=item.compiled.permissions, **item.changes, **further)


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
