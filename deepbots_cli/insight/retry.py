"""Trainings that follow one another until one solves the task, each with the values under `train` that a
diagnosis advises.

    runs/cartpole-retry-1/
    ├── group.json               the attempts so far: what was changed, and the sentence of the cause
    ├── inputs/, resolved.yaml   the scenario, from which all attempts are trained
    └── try-1/, try-2/ ...       their runs

The next attempt begins with the values of the last one, or of the best one if the last one is clearly worse,
and with the advice of its first cause that has a value which was not tried yet. All attempts have the seed of
the first one, so that the values are their only difference, and all policies are evaluated on the same
starts. An attempt that only trains longer is a copy of the run before, and continues it. An attempt is
written to `group.json` before it is trained, so a group whose process was killed continues with the same
attempts.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Unpack

from deepbots_cli.api import Compiled
from deepbots_cli.document import Permissions
from deepbots_cli.errors import DeepbotsError, RunError, UsageError
from deepbots_cli.insight.diagnosis import CERTAIN, causes_after
from deepbots_cli.insight.ends import TOTAL_TIMESTEPS
from deepbots_cli.insight.linted import named_source
from deepbots_cli.insight.statements import Statement
from deepbots_cli.learning.campaigns.campaign import evaluate_once, train_member
from deepbots_cli.learning.campaigns.group import MAX_RETRIES, Group, RetryAttempt, new_record
from deepbots_cli.learning.executor import SERIAL, Executor
from deepbots_cli.learning.report import Reporter
from deepbots_cli.learning.runs.directories import new_directory, run_lock
from deepbots_cli.learning.runs.records import RunRecord, TrainingOptions, TrainingResult, changed_settings
from deepbots_cli.learning.runs.verdict import RunVerdict
from deepbots_cli.rollout.source import SourceKind, folder_kind

OnAttempt = Callable[[Path, RetryAttempt], object]
"""Called before an attempt is trained or continued, with the folder of its run."""
OnEpisode = Callable[[int, int], None] | None
_COPY = ".deepbots-copy"


class Attempted(NamedTuple):
    """The run of an attempt, and its result."""

    path: Path
    attempt: RetryAttempt
    verdict: RunVerdict


@dataclass(frozen=True)
class RetriedTraining:
    """The result of the attempts.

    `best` is the number of the best one, from 1. `diagnosed` is the one that was diagnosed last, and `causes`
    are those of its causes whose values were not tried; empty if the task is solved. `stopped_by` is the
    reason why no attempt follows.
    """

    group: Path
    attempts: tuple[Attempted, ...]
    best: int
    solved: bool | None
    diagnosed: int = 0
    interrupted: bool = False
    causes: tuple[Statement, ...] = ()
    stopped_by: str = ""


def train_with_retries(
    compiled: Compiled,
    retries: int,
    *,
    seed: int = 0,
    group: str | Path | None = None,
    runs: str | Path = "runs",
    progress: bool | Reporter = False,
    executor: Executor = SERIAL,
    on_attempt: OnAttempt | None = None,
    on_episode: OnEpisode = None,
    **options: Unpack[TrainingOptions],
) -> RetriedTraining:
    """Train a scenario, and up to `retries` times again with advised values, until an attempt solves it or no
    advice is left.

    Args:
        group: The folder to make; by default `runs/<scenario>-retry-<n>`.
        on_attempt: Is called before each attempt.
        on_episode: Is called after each episode of an evaluation, with its number and the number of all.
        options: The options of `train`, like the other arguments.

    Raises:
        UsageError: The folder exists, or the settings are invalid for training.
    """
    _check_number(retries)
    from deepbots_cli.learning.training import checked_settings

    checked_settings(compiled.program, [seed], **options)
    if compiled.program.agent.solved is None and not compiled.program.defines_success:
        name = compiled.program.name
        raise UsageError(
            f"{name} does not say when it is solved; add `solved`, such as `solved: mean_return >= 100 over"
            " 100 episodes`"
        )
    path = new_directory(group, runs, compiled.program.name, "retry")
    with Group.created(path, new_record(compiled, [seed], options, retries), compiled) as created:
        return _Retries(created, compiled.permissions, progress, executor, on_attempt, on_episode).run()


def resume_retries(
    group: str | Path,
    *,
    retries: int | None = None,
    progress: bool | Reporter = False,
    permissions: Permissions = Permissions(),
    executor: Executor = SERIAL,
    on_attempt: OnAttempt | None = None,
    on_episode: OnEpisode = None,
) -> RetriedTraining:
    """Continue a group of `train_with_retries`, or add `retries` to it.

    Raises:
        RunError: The folder is not such a group, or is damaged.
        UsageError: Another training uses it.
    """
    resumed = Group.open(group)
    if not resumed.attempts:
        raise RunError(f"{resumed.path} is a group of seeds, not of `train --retry`")
    with run_lock(resumed.path):
        if retries is not None and retries != resumed.record.retries:
            _check_number(retries)
            resumed = resumed.changed(retries=retries)
        return _Retries(resumed, permissions, progress, executor, on_attempt, on_episode).run()


def _check_number(retries: int) -> None:
    if not 1 <= retries <= MAX_RETRIES:
        raise UsageError(f"retries must be from 1 to {MAX_RETRIES}, not {retries}")


@dataclass
class _Retries:
    """The attempts of a group, in this process."""

    group: Group
    permissions: Permissions
    progress: bool | Reporter
    executor: Executor
    on_attempt: OnAttempt | None
    on_episode: OnEpisode

    def run(self) -> RetriedTraining:
        """Train, evaluate and diagnose until an attempt is solved, none is left, or no advice is."""
        interrupted, causes, base, reason = False, list[Statement](), 0, ""
        while True:
            number = len(self.group.record.attempts)
            try:
                result = self._train(number)
            except DeepbotsError as error:  # for example, a training that diverges with the advised values
                if number == 1:
                    raise
                reason = f"try-{number} failed: {error.full_message}"
                break
            interrupted = result is not None and result.stop_requested
            if interrupted:
                break
            if self._evaluated(number).solved:
                break
            best = self.group.best_attempt
            base = best if self._is_given_up(number, best) else number
            causes = untried(self._causes(base), self.group.record.attempts, base)
            following = next_attempt(causes, self.group.record.attempts, base)
            if following is None:
                reason = (
                    "no other value under `train` is advised"
                    if causes
                    else f"no other cause of try-{base} was found"
                )
                break
            if number > self.group.record.retries:
                break
            self.group = self.group.changed(attempts=(*self.group.record.attempts, following))
        return self._result(diagnosed=base, interrupted=interrupted, causes=causes, reason=reason)

    def _train(self, number: int) -> TrainingResult | None:
        """Train an attempt or continue it; None if it was trained before."""
        record = self.group.record
        path = self.group.planned[number - 1]
        attempt = self.group.record.attempts[number - 1]
        compiled = self.group.compiled(self.group.attempts[number - 1].assignments, self.permissions)
        changes: dict[str, Any] = {}
        if self._is_longer(attempt):
            base = self.group.planned[attempt.base - 1]
            if folder_kind(path) is not SourceKind.RUN:
                self._copy(base, path)
            # A copy that was continued before has one more entry, and its record has the new goal.
            is_copy = len(RunRecord.read(path).resumed_at) == len(RunRecord.read(base).resumed_at)
            training = compiled.program.agent.training if is_copy else None
            changes = {} if training is None else {"total_timesteps": training.total_timesteps}
        if folder_kind(path) is SourceKind.RUN and RunRecord.read(path).status == "finished" and not changes:
            return None
        if self.on_attempt is not None:
            self.on_attempt(path, attempt)
        options = record.options | {"command": self._command(number)}
        if TOTAL_TIMESTEPS in attempt.settings:
            # The value of the attempt counts, and not the one of the command line.
            options["total_timesteps"] = None
        further: dict[str, Any] = {"progress": self.progress, "executor": self.executor}
        return train_member(path, compiled, record.seeds[0], options, changes, **further)

    def _is_longer(self, attempt: RetryAttempt) -> bool:
        """Return whether an attempt only continues the one that it is based on."""
        base = self.group.record.attempts[attempt.base - 1].settings if attempt.base else attempt.settings
        return {name for name in attempt.settings if attempt.settings[name] != base.get(name)} == {
            TOTAL_TIMESTEPS
        }

    def _is_given_up(self, number: int, best: int) -> bool:
        """Return whether the values of an attempt are worse than those of the best one. A longer training is
        not given up, because it may have to be longer still."""
        worse = is_worse(self.group.attempt_verdict(number), self.group.attempt_verdict(best))
        return worse and not self._is_longer(self.group.record.attempts[number - 1])

    def _causes(self, number: int) -> list[Statement]:
        try:
            return causes_after(self.group.planned[number - 1], self.permissions)
        except DeepbotsError:  # for example, it has no finished episode
            return []

    def _command(self, number: int) -> list[str]:
        """Return the command line of the group with the values of an attempt, for its record."""
        record, attempt = self.group.record, self.group.attempts[number - 1]
        others = [
            text for text in changed_settings(record.command) if text.partition("=")[0] not in attempt.values
        ]
        words = ["deepbots", "train", named_source(record.source), "--seed", str(record.seeds[0])]
        return [*words, *(word for text in (*others, *attempt.assignments) for word in ("--set", text))]

    def _copy(self, source: Path, target: Path) -> None:
        """Copy a run, whole or not at all."""
        draft = target.with_name(f"{_COPY}-{target.name}")
        shutil.rmtree(draft, ignore_errors=True)
        try:
            # Without the lock, which belongs to the folder of the source.
            shutil.copytree(source, draft, ignore=shutil.ignore_patterns(".lock"))
            draft.rename(target)
        except OSError as error:
            shutil.rmtree(draft, ignore_errors=True)
            raise RunError(f"{target} cannot be written: {error.strerror or error}") from error

    def _evaluated(self, number: int) -> RunVerdict:
        """Return the verdict about an attempt, after it is evaluated if it was not."""
        evaluate_once(self.group.planned[number - 1], self.permissions, self.on_episode)
        return self.group.attempt_verdict(number)

    def _result(
        self, *, diagnosed: int, interrupted: bool, causes: Sequence[Statement], reason: str
    ) -> RetriedTraining:
        group, best = self.group, self.group.best_attempt
        numbered = enumerate(group.record.attempts, start=1)
        attempts = tuple(
            Attempted(group.planned[number - 1], attempt, group.attempt_verdict(number))
            for number, attempt in numbered
        )
        solved = attempts[best - 1].verdict.solved
        return RetriedTraining(
            group.path,
            attempts,
            best,
            solved,
            diagnosed,
            interrupted,
            () if solved else tuple(causes),
            reason,
        )


def is_worse(verdict: RunVerdict, best_verdict: RunVerdict) -> bool:
    """Return whether an evaluation is clearly worse: the intervals of success rate, or else of mean return,
    do not overlap."""
    evaluation, best = verdict.evaluation, best_verdict.evaluation
    if evaluation is None or best is None:
        return evaluation is None
    pairs = (
        (evaluation.success_interval, best.success_interval),
        (evaluation.return_interval, best.return_interval),
    )
    interval, higher = next(
        ((a, b) for a, b in pairs if a is not None and b is not None and a != b), (None, None)
    )
    return interval is not None and higher is not None and interval[1] < higher[0]


def untried(causes: Sequence[Statement], attempts: Sequence[RetryAttempt], base: int) -> list[Statement]:
    """Return the causes of an attempt without those whose values an attempt has had already."""
    tried = [dict(attempt.settings) for attempt in attempts]
    return [
        cause
        for cause in causes
        if not cause.settings or {**attempts[base - 1].settings, **cause.settings} not in tried
    ]


def next_attempt(
    causes: Sequence[Statement], attempts: Sequence[RetryAttempt], base: int
) -> RetryAttempt | None:
    """Return the attempt that the causes of attempt `base` advise, from the most likely cause on; None if
    they advise no new values.

    If a certain cause needs a change outside of `train`, less likely causes do not justify another training.
    """
    for cause in untried(causes, attempts, base):
        if cause.settings:
            settings = {**attempts[base - 1].settings, **cause.settings}
            return RetryAttempt(settings=settings, base=base, cause=cause.cause, text=cause.text)
        if cause.evidence["likelihood"] >= CERTAIN:
            return None
    return None
