"""Studies: searches for better values of a scenario with Optuna. A trial is a group of runs under one set of
values.

    runs/cartpole-tune-1/
    ├── study.json           search space, seeds, objective, settings of the trainings, status, command
    ├── inputs/, resolved.yaml   the scenario, from which all trials are trained
    ├── journal.log          the values, states and scores of the trials (`optuna.storages.JournalStorage`)
    ├── workers/             the output of workers
    └── trial-0/, trial-1/ ...   a group for each trial

One process trains a study, with workers for several trials at a time. A trial that was begun before this
process was killed is taken up again, and its runs continue from their checkpoints. The values
of a trial depend on the seed of the study, the number of the trial and the trials before it, so one process
with the same seed gives the same study, with or without an interruption. Importing this module loads neither
Optuna nor torch.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field, PositiveInt, TypeAdapter

from deepbots_cli import api
from deepbots_cli.compiler import CheckedScenario
from deepbots_cli.document import inline_text
from deepbots_cli.document.load import TUNE, setting_path
from deepbots_cli.document.nodes import node_at
from deepbots_cli.errors import MissingExtraError, RunError, StorageError, UsageError
from deepbots_cli.files import unwritable_message
from deepbots_cli.learning.campaigns.group import Campaign, CampaignRecord
from deepbots_cli.learning.report import TrainingProgress
from deepbots_cli.learning.runs.directories import new_directory
from deepbots_cli.learning.runs.episodes import MAX_STEPS
from deepbots_cli.learning.runs.order import Measure, Rank, rank
from deepbots_cli.learning.runs.run import versions
from deepbots_cli.learning.runs.statistics import (
    ALPHA,
    UNBOUNDED,
    Difference,
    Interval,
    compare_seeds,
    mean_interval,
)
from deepbots_cli.records import dataclass
from deepbots_cli.rollout.source import STUDY_RECORD_NAME, SourceKind
from deepbots_cli.scenario.search import SearchSpace

if TYPE_CHECKING:
    import optuna


JOURNAL_NAME = "journal.log"
Objective = Literal["solved", "success_rate", "mean_return"]
TrialState = Literal["running", "complete", "pruned", "failed"]

_MAX_JOURNAL_BYTES = 200_000_000
_MAX_REASON = 10_000  # the largest number of characters of the reason of a failure


class StudyRecord(CampaignRecord):
    """The content of `study.json`.

    `set` are the assignments of `--set`. `present` are the values of the scenario itself, which the first
    trial tries; empty where one of them is not in the file, or not in its range. `total_timesteps` are those
    of each training, `seed` is that of the search.
    """

    set: tuple[str, ...] = ()
    search: Mapping[str, SearchSpace] = Field(min_length=1)
    present: Mapping[str, float | str] = {}
    trials: PositiveInt
    total_timesteps: PositiveInt
    objective: Objective
    prune: bool
    seed: int = Field(ge=0, lt=2**63)
    versions: Mapping[str, str]

    @property
    def lower_is_better(self) -> bool:
        return self.objective == "solved"

    @property
    def direction(self) -> Literal["minimize", "maximize"]:
        return "minimize" if self.lower_is_better else "maximize"

    def score_interval(self, trial: StudyTrial) -> Interval | None:
        """Return the interval of the score of a trial over its seeds."""
        return mean_interval([seed.score for seed in trial.seeds], self.score_bounds)

    @property
    def score_bounds(self) -> Interval:
        """The smallest and the largest possible score."""
        return {"solved": (0.0, 2.0), "success_rate": (0.0, 1.0), "mean_return": UNBOUNDED}[self.objective]

    def training_command(self, assignments: Sequence[str], seeds: str = "") -> list[str]:
        """Return the command that trains a trial with these values, without a study; by default with the
        seeds of the study."""
        settings = [word for text in (*self.set, *assignments) for word in ("--set", text)]
        seeds = seeds or ",".join(map(str, self.seeds))
        return [
            "deepbots",
            "train",
            self.source,
            "--seeds",
            seeds,
            "--timesteps",
            str(self.total_timesteps),
            *settings,
        ]

    def texts(self, values: Mapping[str, Any]) -> dict[str, str]:
        """Return the values of a trial as they are written in a scenario, by key; those of the scenario
        itself are exact."""
        return {
            name: space.text(values[name], is_exact=values[name] == self.present.get(name))
            for name, space in self.search.items()
        }


_Number = Annotated[float, Field(ge=-1e300, le=1e300)]
"""A number of a journal; sums stay finite."""


@dataclass(frozen=True)
class SeedScore:
    """The result of one training of a trial. Statistics are None without a model, and `steps` is None if the
    task is not solved."""

    seed: int
    score: _Number
    steps: Annotated[int, Field(ge=0, le=MAX_STEPS)] | None = None
    mean_return: _Number | None = None
    success_rate: _Number | None = None


_SEED_SCORES = TypeAdapter(tuple[SeedScore, ...])


@dataclass(frozen=True)
class StudyTrial:
    """A trial, as far as it has run. `path` is the folder of its group, which exists once its training has
    begun, and `values` are those that differ from the scenario, as text, by the path of the setting. `score`
    is None unless the trial is complete, and `reason` is the reason of a failure."""

    path: Path
    values: Mapping[str, str]
    number: int
    state: TrialState
    score: float | None = None
    seeds: tuple[SeedScore, ...] = ()
    reason: str | None = None

    @property
    def assignments(self) -> list[str]:
        """The values as for `--set`."""
        return [f"{path}={value}" for path, value in self.values.items()]

    @property
    def success_rate(self) -> float | None:
        """The mean over the seeds; None where no seed has one."""
        return _mean([seed.success_rate for seed in self.seeds])

    @property
    def mean_return(self) -> float | None:
        """The mean over the seeds that have a model."""
        return _mean([seed.mean_return for seed in self.seeds])


def _mean(values: Sequence[float | None]) -> float | None:
    present = [value for value in values if value is not None]
    return fmean(present) if present else None


@dataclass(frozen=True)
class OverFirst:
    """The best trial against the first one, which has the values of the scenario itself.

    `difference` is that of the scores over the seeds. Its interval covers all complete trials together: the
    best of many trials looks better than it is. `is_clear` holds where the interval shows that the best trial
    is better.
    """

    difference: Difference
    is_clear: bool


@dataclass(frozen=True)
class TrialResult:
    """The result of `run_trial`. `state` is `running` after an interruption: the trial can be continued."""

    state: TrialState
    seeds: tuple[SeedScore, ...] = ()
    reason: str | None = None
    stop_requested: bool = False


@dataclass(frozen=True)
class TrialProgress:
    """The progress of a trial: the training of `seed`, number `place` from 1 of its `count` trainings."""

    seed: int
    place: int
    count: int
    training: TrainingProgress

    @property
    def fraction(self) -> float:
        """The completed share of all steps, if each training takes them all."""
        return (self.place - 1 + self.training.steps / self.training.total_steps) / self.count


class StudyReporter:
    """Follows a study and the trials at work. This one reports nothing."""

    def note(self, text: str) -> None:
        """Called with a note for the user."""

    def begin_trial(self, trial: StudyTrial) -> None:
        """Called before a trial is trained, or continued."""

    def update(self, number: int, progress: TrialProgress) -> None:
        """Called during the trainings of a trial."""

    def end_trial(self, trial: StudyTrial) -> None:
        """Called after a trial has ended."""


@contextmanager
def journal_errors(path: Path) -> Iterator[None]:
    """Context in which the errors of Optuna are those of the journal, whose entries Optuna does not check.

    Raises:
        RunError: The journal is damaged.
        StorageError: It cannot be read or written.
    """
    from optuna.exceptions import OptunaError

    try:
        yield
    except OSError as error:
        raise StorageError(unwritable_message(path, error)) from error
    except (
        ArithmeticError,
        AssertionError,
        AttributeError,
        LookupError,
        OptunaError,
        RuntimeError,
        TypeError,
        ValueError,
    ) as error:
        raise RunError(f"{path} is damaged, or was not written by deepbots") from error


@dataclass(frozen=True)
class Journal:
    """Optuna's study, read from its journal and written to it."""

    path: Path
    study: optuna.Study
    storage: optuna.storages.JournalStorage

    @property
    def trials(self) -> list[optuna.trial.FrozenTrial]:
        """All trials, by number.

        Raises:
            RunError: The journal is damaged.
        """
        with journal_errors(self.path):
            return self.study.get_trials(deepcopy=False)

    def trial(self, number: int) -> optuna.trial.Trial:
        """Return a trial of any process, to report to.

        Raises:
            RunError: The journal is damaged.
        """
        import optuna

        with journal_errors(self.path):
            study_id = self.storage.get_study_id_from_name(self.study.study_name)
            trial_id = self.storage.get_trial_id_from_study_id_trial_number(study_id, number)
            return optuna.trial.Trial(self.study, trial_id)


@dataclass(frozen=True)
class Study(Campaign[StudyRecord]):
    """A study on disk."""

    noun = "study"
    kind = SourceKind.STUDY
    record_name = STUDY_RECORD_NAME
    record_type = StudyRecord
    files = (*Campaign.files, JOURNAL_NAME)

    def trial_folder(self, number: int) -> Path:
        return self.path / f"trial-{number}"

    @property
    def planned(self) -> list[Path]:
        return sorted(self.path.glob("trial-*"), key=lambda path: (len(path.name), path.name))

    def connect(self, *, to_write: bool = False) -> Journal:
        """Open the journal; `to_write` removes a last line that a crash has left incomplete.

        Raises:
            MissingExtraError: Optuna is not installed.
            RunError: The journal is damaged.
        """
        try:
            from optuna import load_study
        except ModuleNotFoundError as error:
            raise MissingExtraError("tune", "a search over values") from error
        path = self.path / JOURNAL_NAME
        if not path.is_file():  # a pipe would be read for ever
            raise RunError(f"{path} is missing, or is not a regular file")
        if path.stat().st_size > _MAX_JOURNAL_BYTES:
            raise RunError(f"{path} is larger than {_MAX_JOURNAL_BYTES} bytes, so deepbots did not write it")
        with journal_errors(path):
            if to_write:
                _remove_incomplete_line(path)
            storage = _journal_storage(path)
            study = load_study(study_name=self.record.scenario, storage=storage)
            if study.direction.name.lower() != self.record.direction:
                raise ValueError("the journal of another objective")
            return Journal(path, study, storage)

    def trials(self, journal: Journal | None = None) -> list[StudyTrial]:
        """Return all trials that have values, by number.

        Raises:
            RunError: The journal is damaged, or has values that are not in the search space.
        """
        frozen = (self.connect() if journal is None else journal).trials
        return [self._trial(trial) for trial in frozen if self.record.search.keys() <= trial.params.keys()]

    def trial(self, journal: Journal, number: int) -> StudyTrial:
        return self._trial(journal.trials[number])

    def _trial(self, frozen: optuna.trial.FrozenTrial) -> StudyTrial:
        states: dict[str, TrialState] = {"COMPLETE": "complete", "PRUNED": "pruned", "FAIL": "failed"}
        state = states.get(frozen.state.name, "running")
        reason = frozen.user_attrs.get("reason")
        try:
            seeds = _SEED_SCORES.validate_python(frozen.user_attrs.get("seeds", ()))
            values = self.record.texts(frozen.params)
            score = fmean(seed.score for seed in seeds) if state == "complete" else None
            if state == "complete" and [seed.seed for seed in seeds] != [*self.record.seeds]:
                raise ValueError("a complete trial has the scores of all seeds")
        except (ArithmeticError, LookupError, RuntimeError, TypeError, ValueError) as error:
            raise RunError(
                f"{self.path / JOURNAL_NAME} is damaged: trial {frozen.number} does not fit the study"
            ) from error
        state, reason = ("failed", str(reason)[:_MAX_REASON]) if reason else (state, None)
        folder = self.trial_folder(frozen.number)
        return StudyTrial(folder, values, frozen.number, state, score, seeds, reason)

    def ranked(self, trials: Sequence[StudyTrial]) -> list[StudyTrial]:
        """Return the complete trials, the best first.

        Trials with equal scores, such as those without any success, are ordered by the success rate, then by
        the return; with the objective `mean_return`, in the other order. Among equals, the earlier trial
        comes first.
        """
        sign = -1 if self.record.lower_is_better else 1
        measure: Measure = "mean_return" if self.record.objective == "mean_return" else "success_rate"

        def quality(trial: StudyTrial) -> tuple[float, Rank, int]:
            mean_return = -math.inf if trial.mean_return is None else trial.mean_return
            return sign * (trial.score or 0.0), rank(measure, trial.success_rate, mean_return), -trial.number

        return sorted((trial for trial in trials if trial.score is not None), key=quality, reverse=True)

    def over_first(self, trials: Sequence[StudyTrial]) -> OverFirst | None:
        """Return the best trial against the first one; None if it is the first one, or the first one has no
        score."""
        ranked = self.ranked(trials)
        first = next((trial for trial in ranked if trial.number == 0 and self.record.present), None)
        if first is None or ranked[0] is first:
            return None
        first_scores, best_scores = ([seed.score for seed in trial.seeds] for trial in (first, ranked[0]))
        difference = compare_seeds(
            first_scores, best_scores, self.record.score_bounds, ALPHA / (len(ranked) - 1)
        )
        is_better = (difference.mean < 0) == self.record.lower_is_better
        return OverFirst(difference, is_better and difference.certain)


def create_study(
    checked: CheckedScenario,
    *,
    folder: str | Path | None = None,
    runs: str | Path = "runs",
    trials: int | None = None,
    seeds: Sequence[int] | None = None,
    timesteps: int | None = None,
    objective: Objective | None = None,
    prune: bool | None = None,
    seed: int = 0,
    command: Sequence[str] = (),
) -> Study:
    """Create the folder of a study; nothing is trained yet. Arguments that are None are taken from `tune` of
    the scenario.

    Raises:
        ScenarioError: The scenario has findings at error level.
        UsageError: The scenario has no search, does not fit the objective, an argument is outside its limits,
            a seed is given twice, or the folder exists.
    """
    if find_spec("optuna") is None:
        raise MissingExtraError("tune", "a search over values")
    compiled = api.compile(checked)
    program = compiled.program
    tune = checked.spec.tune if checked.spec else None
    root = checked.document.root
    if tune is None or root is None:
        raise UsageError(
            f"{program.name} has no `tune` section; name what to search: --param"
            " train.learning_rate=1e-4..1e-2:log"
        )
    training, solved = program.agent.training, program.agent.solved
    if training is None:
        raise UsageError(f"{program.name} has no `train` section; add `train: {{algorithm: auto}}`")
    usual: Objective = "success_rate" if program.defines_success else "mean_return"
    final_objective = objective or tune.objective or ("solved" if solved else usual)
    if final_objective == "solved" and solved is None:
        raise UsageError(
            f"the objective `solved` needs the key `solved`, which {program.name} does not have; use"
            " --objective mean_return"
        )
    if final_objective == "success_rate" and not program.defines_success:
        raise UsageError(
            f"the objective `success_rate` needs a success, which {program.name} does not define; use"
            " --objective mean_return"
        )
    nodes = {name: node_at(root, *setting_path(root, name)) for name in checked.search}
    values = {
        name: space.value_of(inline_text(node))
        for name, space in checked.search.items()
        if (node := nodes[name]) is not None
    }
    present = {name: value for name, value in values.items() if value is not None}
    usual_timesteps = tune.timesteps or training.total_timesteps
    record = StudyRecord.new(
        compiled,
        set=tuple(
            text for text in compiled.overrides if re.split(r"[.=]", text, maxsplit=1)[0].strip() != TUNE
        ),
        search=checked.search,
        present=present if len(present) == len(checked.search) else {},
        seeds=tuple(range(tune.seeds) if seeds is None else seeds),
        trials=tune.trials if trials is None else trials,
        total_timesteps=usual_timesteps if timesteps is None else timesteps,
        objective=final_objective,
        prune=tune.prune if prune is None else prune,
        seed=seed,
        versions=versions("optuna"),
        command=tuple(command),
    )
    with Study.created(new_directory(folder, runs, program.name, "tune"), record, compiled) as study:
        _create_journal(study)
        return study


def _journal_storage(path: Path) -> optuna.storages.JournalStorage:
    from optuna.storages import JournalStorage
    from optuna.storages.journal import JournalFileBackend, JournalFileOpenLock

    return JournalStorage(JournalFileBackend(str(path), JournalFileOpenLock(str(path))))


def _create_journal(study: Study) -> None:
    import optuna

    path, record = study.path / JOURNAL_NAME, study.record
    level = optuna.logging.get_verbosity()
    # Otherwise Optuna reports each study that it creates.
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    try:
        with journal_errors(path):
            optuna.create_study(
                storage=_journal_storage(path), study_name=record.scenario, direction=record.direction
            )
    finally:
        optuna.logging.set_verbosity(level)


def _remove_incomplete_line(path: Path) -> None:
    """Remove a last line without an end from a journal. Optuna would append to it, which makes the journal
    unreadable."""
    from optuna.storages.journal import JournalFileOpenLock

    lock = JournalFileOpenLock(str(path))
    lock.acquire()  # no other process is writing a line
    try:
        with path.open("r+b") as file:
            file.truncate(file.read().rfind(b"\n") + 1)
    finally:
        lock.release()
