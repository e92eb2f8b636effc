"""Trials of a study: how a process takes, trains, scores and prunes them."""

from __future__ import annotations

import shutil
from collections.abc import Collection, Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager
from dataclasses import asdict
from functools import partial
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Any

from deepbots_cli.compiler.inputs import RESOLVED_NAME
from deepbots_cli.document import Permissions
from deepbots_cli.errors import DeepbotsError, StorageError, UsageError
from deepbots_cli.learning.campaigns.group import Group, resume_group, train_group
from deepbots_cli.learning.campaigns.study import (
    Journal,
    Objective,
    SeedScore,
    Study,
    StudyRecord,
    StudyReporter,
    TrialProgress,
    TrialResult,
    journal_errors,
)
from deepbots_cli.learning.executor import (
    SERIAL,
    Attempt,
    CallOptions,
    Executor,
    Interruption,
    Watcher,
    signals_handled,
)
from deepbots_cli.learning.report import Reporter, TrainingProgress
from deepbots_cli.learning.runs.directories import WORKERS_FOLDER, has_ended, is_training, run_lock
from deepbots_cli.learning.runs.episodes import read_evaluations
from deepbots_cli.learning.runs.run import Run, RunRecord
from deepbots_cli.learning.runs.verdict import quoted_evaluation
from deepbots_cli.program import Program
from deepbots_cli.program.task import Solved
from deepbots_cli.records import dataclass
from deepbots_cli.rollout.source import SourceKind, folder_kind
from deepbots_cli.runtime.streams import derive_seed
from deepbots_cli.scenario.search import SearchSpace

if TYPE_CHECKING:
    import optuna


PRUNED_BY = "tune"
"""The value of `stopped_by` of a run whose trial was pruned."""
GRID = 10
"""The number of points of a training at which trials are compared."""
WARM_UP = 2
"""The number of points of the first training at which no trial is pruned, because its first evaluations are
uncertain."""
MIN_COMPARED = 5
"""The number of complete trials before one is pruned."""
UNSOLVED = 2.0
"""The score of a training without a model, the upper bound of all others."""
_MAX_FAILED_FIRST = 3
"""The number of trials that may fail at the beginning. More failures are due to the settings, not the
values."""


def run_study(
    study: Study,
    *,
    reporter: StudyReporter | None = None,
    permissions: Permissions = Permissions(),
    executor: Executor = SERIAL,
) -> bool:
    """Take trials until the study has as many as its record defines, those that were begun and left first.

    Returns False after Ctrl-C or SIGTERM. This process takes each trial when a worker is free, so that the
    sampler has all results until then. A trial whose worker is lost continues on another one.

    Args:
        study: The study.
        reporter: Follows the trials.
        permissions: With `code`, the scenario may run functions of installed Python packages.
        executor: Where trials run, by default in this process, one after the other. With several at a time,
            the values of a trial depend on those that have ended when it begins. The result of a trial with
            these values does not, except for pruning.

    Raises:
        RunError: The study is damaged.
        UsageError: Another process trains the study, or the first trials fail; the message is that of the
            last one. Also the errors of `Executor.map`.
    """
    with ExitStack() as stack:
        current = stack.enter_context(_at_work(study))
        search = _Search(current, reporter or StudyReporter(), permissions)
        options: CallOptions = {"watcher": search}
        if not executor.is_here:
            interruption = Interruption()
            stack.enter_context(signals_handled(interruption))
            options |= {
                "stop": partial(search.stops, interruption),
                "files": [study.path / RESOLVED_NAME],
                "log": _log_of,
            }
        outcomes = stack.enter_context(closing(executor.map(run_trial, search.trials(), **options)))
        try:
            for outcome in outcomes:
                if executor.is_here and (not isinstance(outcome, TrialResult) or outcome.stop_requested):
                    return False
        except KeyboardInterrupt:  # a second Ctrl-C
            if executor.is_here:
                raise
            return False
        return not search.is_stopping and not search.left


@contextmanager
def _at_work(study: Study) -> Iterator[Study]:
    """Context in which this process trains the study, as it is now. It ends without an error where the record
    is to say whether the study is finished."""
    with run_lock(study.path):
        current = Study.open(study.path).changed(status="running")
        yield current
        ended = [trial for trial in current.connect().trials if trial.state.is_finished()]
        current.changed(status="finished" if len(ended) >= current.record.trials else "interrupted")


@dataclass(frozen=True)
class TakenTrial:
    """A trial that a process has taken, to be run in any process with access to the study."""

    study: Path
    number: int
    permissions: Permissions


def _log_of(trial: TakenTrial) -> Path:
    return trial.study / WORKERS_FOLDER / f"trial-{trial.number}.log"


class _Search(Watcher):
    """Takes trials, and reports their results to Optuna.

    Attributes:
        is_stopping: Whether a stop was requested.
        left: Numbers of the trials that have begun and not ended.
    """

    def __init__(self, study: Study, reporter: StudyReporter, permissions: Permissions) -> None:
        self._study = study
        self._reporter = reporter
        self._permissions = permissions
        self._journal = study.connect(to_write=True)
        self._numbers: list[int] = []
        self._running: set[int] = set()
        self.left: set[int] = set()
        self.is_stopping = False

    def trials(self) -> Iterator[TakenTrial]:
        while True:
            number = next_trial(self._study, self._journal, self._running)
            if number is None:
                return
            self._reporter.begin_trial(self._study.trial(self._journal, number))
            self._numbers.append(number)
            self._running.add(number)
            self.left.add(number)
            yield TakenTrial(self._study.path, number, self._permissions)

    def stops(self, interruption: Interruption) -> bool:
        if interruption.requested and not self.is_stopping:
            self.is_stopping = True
            self._reporter.note("stopping after these rollouts")
        return interruption.requested

    def on_report(self, item: int, value: object) -> None:
        number = self._numbers[item]
        if (
            isinstance(value, TrialProgress) and number in self._running
        ):  # a last report may come after the end
            self._reporter.update(number, value)

    def on_note(self, item: int, text: str) -> None:
        self._reporter.note(text)

    def on_loss(self, item: int) -> None:
        self._reporter.note(
            f"the worker of trial {self._numbers[item]} was lost; another one continues the trial"
        )

    def on_done(self, item: int, outcome: object) -> None:
        number = self._numbers[item]
        self._running.discard(number)
        # This is an error of the study or the worker; errors of a training are in a `TrialResult`.
        if isinstance(outcome, UsageError):
            raise outcome
        result = (
            TrialResult("failed", reason=outcome.full_message)
            if isinstance(outcome, DeepbotsError)
            else outcome
        )
        if not isinstance(result, TrialResult) or result.state == "running":
            return
        end_trial(self._journal, number, result)
        self.left.discard(number)
        self._reporter.end_trial(self._study.trial(self._journal, number))
        ended = self._study.trials(self._journal)
        if len(ended) >= _MAX_FAILED_FIRST and all(trial.state == "failed" for trial in ended):
            raise UsageError(f"all trials fail: {result.reason}")


def next_trial(study: Study, journal: Journal, running: Collection[int] = ()) -> int | None:
    """Return the next trial, with its values; None if there is none left.

    A trial that is unfinished and not `running` comes first; then a new one with values of the sampler.
    """
    from optuna.samplers import TPESampler

    trials = journal.trials
    begun = [trial.number for trial in trials if trial.state.name == "RUNNING"]
    # A worker whose driver has died may still train a trial.
    left = (n for n in begun if n not in running and not is_training(study.trial_folder(n)))
    number = next(left, None)
    # A sampler for each trial: that of a process would begin again with the same numbers after an
    # interruption.
    seed = derive_seed(study.record.seed, "trial", len(trials) if number is None else number)
    journal.study.sampler = TPESampler(seed=seed)
    is_waiting = any(trial.state.name == "WAITING" for trial in trials)
    with journal_errors(journal.path):
        if number is None and (is_waiting or len(trials) < study.record.trials):
            if not trials and study.record.present:
                journal.study.enqueue_trial(dict(study.record.present))
            number = journal.study.ask().number
        if number is not None:
            _suggest(journal.trial(number), study.record.search)
    return number


def _suggest(trial: optuna.trial.Trial, search: Mapping[str, SearchSpace]) -> None:
    """Give a trial the values that it does not have yet."""
    for name, space in search.items():
        if space.choices:
            trial.suggest_categorical(name, space.choices)
        elif space.whole:
            trial.suggest_int(name, int(space.low), int(space.high), log=space.log)
        else:
            trial.suggest_float(name, space.low, space.high, log=space.log)


def end_trial(journal: Journal, number: int, result: TrialResult) -> None:
    """Report the result of a trial to Optuna. A failed trial is reported as pruned, so that the sampler
    avoids its values."""
    from optuna.trial import TrialState

    trial = journal.trial(number)
    with journal_errors(journal.path):
        trial.set_user_attr("seeds", [asdict(seed) for seed in result.seeds])
        if result.reason is not None:
            trial.set_user_attr("reason", result.reason)
        if result.state == "complete":
            journal.study.tell(trial, fmean(seed.score for seed in result.seeds), skip_if_finished=True)
        else:
            journal.study.tell(trial, state=TrialState.PRUNED, skip_if_finished=True)


def run_trial(taken: TakenTrial, attempt: Attempt) -> TrialResult:
    """Train or continue the runs of a trial, and evaluate their best models. The caller has its lock.

    Evaluations of the trainings go to the journal. Reports are `TrialProgress`.

    Raises:
        RunError: The study is damaged, or a file cannot be written.
    """
    study = Study.open(taken.study)
    number = taken.number
    permissions = taken.permissions
    record = study.record
    folder = study.trial_folder(number)
    journal = study.connect(to_write=True)
    # A node that was lost may still be at work.
    if attempt.number > 1 and not has_ended(folder):
        return TrialResult("running")
    follower = _Follower(study, journal, number, study.compiled().program, attempt)
    options: dict[str, Any] = {
        "progress": follower,
        "on_seed": follower.begin_seed,
        "on_evaluation": follower.add_evaluation,
    }
    try:
        if folder_kind(folder) is SourceKind.GROUP:
            trained = resume_group(folder, permissions=permissions, **options)
        else:
            # The folder is left by a process that was killed before it wrote the record.
            shutil.rmtree(folder, ignore_errors=True)
            overrides = study.trial(journal, number).assignments
            compiled = study.compiled(overrides, permissions)
            options |= {
                "total_timesteps": record.total_timesteps,
                "engine": compiled.program.engine or record.engine,
            }
            trained = train_group(
                compiled, record.seeds, group=folder, command=record.training_command(overrides), **options
            )
    except StorageError:  # the trial stays as it is, and can be continued
        raise
    except DeepbotsError as error:  # the values do not fit together
        return TrialResult("failed", reason=error.full_message)
    stop_requested = any(result.stop_requested for result in trained.trained)
    group = Group.open(folder)
    if follower.is_pruned():
        group.changed(status="finished")
        return TrialResult("pruned", stop_requested=stop_requested)
    if trained.interrupted and trained.waiting:
        return TrialResult("running", stop_requested=True)
    reason = "; ".join(f"seed {seed}: {why}" for seed, why in trained.failed.items()) or None
    if reason is not None and record.objective != "solved":
        return TrialResult("failed", reason=reason, stop_requested=stop_requested)
    try:
        for path in group.runs_with_model:
            _evaluate_once(path, permissions)
    except KeyboardInterrupt:
        return TrialResult("running", stop_requested=True)
    except StorageError:
        raise
    except DeepbotsError as error:
        return TrialResult("failed", reason=error.full_message, stop_requested=stop_requested)
    follower.finish()
    return TrialResult(
        "complete",
        tuple(_seed_score(study, group, follower.solved, seed) for seed in record.seeds),
        None,
        stop_requested,
    )


def _evaluate_once(path: Path, permissions: Permissions) -> None:
    """Evaluate the best model of a run and keep the evaluation, unless the run has one.

    Raises:
        RunError: The run has no model.
    """
    from deepbots_cli.learning.evaluation import evaluate

    run = Run.open(path)
    if quoted_evaluation(path, run.record) is None:
        run.write_evaluation(evaluate(run, permissions=permissions).model_dump(mode="json"))


def _seed_score(study: Study, group: Group, solved: Solved | None, seed: int) -> SeedScore:
    """Return the score of a training from the evaluation of its best model."""
    path = group.run(seed)
    record = study.record
    run = RunRecord.read(path) if folder_kind(path) is SourceKind.RUN else None
    quoted = quoted_evaluation(path, run) if run is not None else None
    if run is None or run.result is None or quoted is None:
        return SeedScore(seed, UNSOLVED)
    evaluation = quoted.evaluation
    rate = evaluation.success_rate
    steps = None
    if evaluation.solved:
        steps = run.result.solved_at.steps if run.result.solved_at else run.result.steps
    value = score(
        record.objective,
        solved,
        evaluation.mean_return,
        rate,
        None if steps is None else steps / record.total_timesteps,
    )
    return SeedScore(seed, value, steps, evaluation.mean_return, evaluation.own_scores.success_rate)


def score(
    objective: Objective,
    solved: Solved | None,
    mean_return: float,
    success_rate: float,
    solved_after: float | None,
) -> float:
    """Return the score of a training.

    The score of the objective `solved` is at most 1 for a solved task: the fraction of the timesteps after
    which it was solved (`solved_after`, None if it was not). For others, it is 1 to 2, and grows with the
    distance d from the required value, relative to this value: of a success rate, d / 2 is added, so that the
    mean over seeds follows their mean success rate; of a return, which has no lower bound, d / (1 + d). Small
    values are good.
    """
    if objective != "solved" or solved is None:
        return mean_return if objective == "mean_return" else success_rate
    if solved_after is not None:
        return min(1.0, solved_after)
    added = 0.0
    if solved.success_rate is not None:
        added = max(0.0, solved.success_rate - success_rate) / (solved.success_rate or 1.0) / 2
    if solved.mean_return is not None:
        gap = max(0.0, solved.mean_return - mean_return) / (abs(solved.mean_return) or 1.0)
        added = max(added, gap / (1.0 + gap))
    return 1.0 + added


def _pruner(record: StudyRecord) -> optuna.pruners.BasePruner:
    from optuna.pruners import MedianPruner, NopPruner

    if not record.prune:
        return NopPruner()
    return MedianPruner(MIN_COMPARED, n_warmup_steps=WARM_UP + 1, n_min_trials=MIN_COMPARED)


class _Follower(Reporter):
    """Reports the evaluations of the trainings of a trial to the journal, where Optuna prunes the trial.

    After each evaluation, the best one so far has a score. At `GRID` points of each training, the mean of
    this score and those of the seeds before it goes to the journal. Everything is read from the files of the
    runs, so a trial that is continued reports the same.
    """

    def __init__(
        self, study: Study, journal: Journal, number: int, program: Program, attempt: Attempt
    ) -> None:
        self._study = study
        self._journal = journal
        journal.study.pruner = _pruner(study.record)
        self._attempt = attempt
        self._seed = (0, 0, 0)
        self._trial = journal.trial(number)
        self._runs = [study.trial_folder(number) / f"seed-{seed}" for seed in study.record.seeds]
        self._last_stage = program.curriculum[-1].name if program.curriculum else None
        self.solved = program.agent.solved

    def begin_seed(self, seed: int, number: int, count: int) -> bool:
        """Return whether to train a seed, which is false after the trial was pruned."""
        if not self.is_pruned():
            self._seed = (seed, number, count)
            return True
        return False

    def note(self, text: str) -> None:
        # The hint on how to continue this training is left out.
        self._attempt.note(text.partition(";")[0])

    def update(self, progress: TrainingProgress) -> None:
        self._attempt.report(TrialProgress(*self._seed, progress))

    def add_evaluation(self, run: Path) -> str | None:
        """Called after each evaluation of a training."""
        index = self._runs.index(run)
        evaluations = self._evaluations(run)
        point = int(GRID * evaluations[-1][0]) if evaluations else 0
        return PRUNED_BY if 0 < point < GRID and self._is_worse(index, point) else None

    def is_pruned(self) -> bool:
        """Return whether a training of the trial was stopped, or the next one is not worth its time."""
        begun = [RunRecord.read(run) for run in self._runs if folder_kind(run) is SourceKind.RUN]
        if any(record.result is not None and record.result.stopped_by == PRUNED_BY for record in begun):
            return True
        is_between = 0 < len(begun) < len(self._runs) and all(
            record.status in ("finished", "failed") for record in begun
        )
        return is_between and self._is_worse(len(begun) - 1, GRID)

    def finish(self) -> None:
        """Called after the last training."""
        self._report(len(self._runs) - 1, GRID)

    def _is_worse(self, index: int, point: int) -> bool:
        """Report the scores up to a point of the training at `index`, and return whether Optuna prunes the
        trial."""
        self._report(index, point)
        with journal_errors(self._journal.path):
            return self._trial.should_prune()

    def _report(self, index: int, point: int) -> None:
        """Report the scores up to a point of the training at `index`, each once."""
        reported = self._journal.trials[self._trial.number].intermediate_values
        for number in range(1, point + 1):
            step = GRID * index + number
            value = None if step in reported else self._score(index, number)
            if value is not None:
                with journal_errors(self._journal.path):
                    self._trial.report(value, step)

    def _score(self, index: int, point: int) -> float | None:
        """Return the mean score of the trainings up to `index` at a point of the last one; None before its
        first evaluation."""
        scores = [self._score_of(run, GRID) for run in self._runs[:index]]
        scores.append(self._score_of(self._runs[index], point))
        return None if None in scores else fmean(mean for mean in scores if mean is not None)

    def _score_of(self, run: Path, point: int) -> float | None:
        """Return the score of the best evaluation of a training up to a point."""
        record = RunRecord.read(run)
        study = self._study.record
        at = record.result.solved_at if record.is_finished and record.result is not None else None
        share = (
            at.steps / study.total_timesteps
            if at is not None and GRID * at.steps <= point * study.total_timesteps
            else None
        )
        evaluations = [evaluation for evaluation in self._evaluations(run) if GRID * evaluation[0] <= point]
        scores = [
            score(study.objective, self.solved, mean_return, rate, share)
            for _, mean_return, rate in evaluations
        ]
        if not scores and point == GRID and record.status != "running" and study.lower_is_better:
            return UNSOLVED
        return (min if study.lower_is_better else max)(scores, default=None)

    def _evaluations(self, run: Path) -> list[tuple[float, float, float]]:
        """Return the evaluations of a training in the last stage of the curriculum: fraction of its steps,
        mean return, success rate."""
        total = self._study.record.total_timesteps
        return [
            (line["steps"] / total, fmean(line["returns"]), fmean(line["successes"]))
            for line in read_evaluations(run)
            if line["stage"] == (self._last_stage or "")
        ]
