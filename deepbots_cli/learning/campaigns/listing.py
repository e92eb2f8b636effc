"""Lists runs, groups and studies from their files alone, even while they train.

Nothing is compiled, and torch is not imported.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from statistics import fmean
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict

from deepbots_cli.errors import DeepbotsError, RunError
from deepbots_cli.learning.campaigns.group import Campaign, Group
from deepbots_cli.learning.campaigns.study import Study
from deepbots_cli.learning.runs.directories import SKIPPED, numbered_files, read_json
from deepbots_cli.learning.runs.episodes import read_log_tail
from deepbots_cli.learning.runs.evaluations import EvaluationResult
from deepbots_cli.learning.runs.run import (
    MAX_STATE_BYTES,
    ChosenBy,
    RunRecord,
    RunResult,
    State,
    changed_settings,
)
from deepbots_cli.learning.runs.verdict import Decline, decline_of, run_verdict
from deepbots_cli.records import dataclass
from deepbots_cli.rollout.source import SourceKind, folder_kind

_TAIL_BYTES = 64_000
"""The number of bytes at the end of a log that contain its last episode."""
Origin = Literal["evaluation", "training"]
_ORIGINS: tuple[Origin, ...] = ("evaluation", "training")


class _Statistics(BaseModel):
    """The part of the statistics in a checkpoint that is listed."""

    model_config = ConfigDict(json_schema_extra={SKIPPED: None})

    cpu_seconds: float
    mean_return: float | None = None
    success_rate: float | None = None


class _Checkpoint(BaseModel):
    model_config = ConfigDict(json_schema_extra={SKIPPED: None})

    statistics: _Statistics


@dataclass(frozen=True)
class ListedRun:
    """A run, a group or a study, from its files.

    For a study, `runs` are the groups of its trials, and `planned` is the number of trials in all; it has no
    score. For a group, `mean_return` and `success_rate` are means over the runs that have one of the same
    `score`, over those with an evaluation if there is one; `steps` and `cpu_seconds` are sums, and `runs`
    are its members. `score` is the origin of the return and the success rate. `evaluation`: the quoted
    evaluation (`quoted_evaluation`) of `evaluated_episodes` episodes; `remarks` are its differences from a
    usual one. `training`: the recent episodes of the training, in which the policy explores. `solved_after`
    are the steps after which a confirmation showed that the task is solved, if the run is solved;
    `best_steps` are those of the best model, and `chosen_by` is how it was chosen. `mean_level` is the mean
    level of its worlds at its end, None without levels. `decline` is the decline of its evaluations since
    then; None if there is none. `settings` are the assignments of `--set`, `teacher` is that of the
    `TaskRecord`. `success_rate` is None if the scenario defines no success, and `mean_return` if its agents
    compete. `solved` is that of `run_verdict`; for a group, True if it is True for every seed, and False if
    it is False for one; `stopped_as_solved` is that of the `RunRecord`, of a group for all its runs. While
    a run trains, `mean_return`, `success_rate` and `cpu_seconds` are as old as its last checkpoint.
    `updated` is a time in UTC, and `problem` is the reason why the files cannot be read.
    """

    path: Path
    state: State | Literal["unreadable"]
    scenario: str = "?"
    source: str = ""
    digest: str = ""
    settings: tuple[str, ...] = ()
    teacher: str | None = None
    engine: str = ""
    seeds: tuple[int, ...] = ()
    steps: int | None = None
    total_timesteps: int | None = None
    episodes: int | None = None
    mean_return: float | None = None
    return_interval: tuple[float, float] | None = None
    success_rate: float | None = None
    score: Origin | None = None
    evaluated_episodes: int | None = None
    solved: bool | None = None
    solved_after: int | None = None
    stopped_as_solved: bool = False
    best_steps: int | None = None
    mean_level: float | None = None
    chosen_by: ChosenBy | None = None
    remarks: tuple[str, ...] = ()
    cpu_seconds: float | None = None
    updated: str = ""
    problem: str | None = None
    decline: Decline | None = None
    runs: tuple[ListedRun, ...] = ()
    planned: int | None = None


def list_runs(folder: Path) -> list[ListedRun]:
    """List the runs, groups and studies in a folder, the one that changed last at the end. The runs of a
    group come in the order of their seeds, and those of a study in the order of its trials."""
    if not folder.is_dir():
        return []
    if folder_kind(folder) in (SourceKind.GROUP, SourceKind.STUDY):
        return list(read_listed(folder).runs)
    folders = [path for path in folder.iterdir() if folder_kind(path) is not None]
    return sorted((read_listed(path) for path in folders), key=lambda run: (run.updated, run.path.name))


def read_listed(path: Path) -> ListedRun:
    """Read a run, a group or a study. If its files cannot be read, `problem` has the reason."""
    reader = {SourceKind.GROUP: _listed_group, SourceKind.STUDY: _listed_study}.get(
        folder_kind(path) or SourceKind.RUN, _listed_run
    )
    try:
        return reader(path)
    except DeepbotsError as error:
        return ListedRun(path, "unreadable", problem=str(error))


def _listed_run(path: Path) -> ListedRun:
    record = RunRecord.read(path)
    result = record.result
    state: State = record.state(path)
    steps, episodes = (result.steps, result.episodes) if result else (0, 0)
    training: RunResult | _Statistics | None = result
    if result is None or state == "training":
        training = _last_statistics(path)
        steps, episodes = _last_episode(path / "monitor.csv") or (steps, episodes)
    verdict = run_verdict(path, record)
    evaluation = verdict.evaluation
    scores = evaluation or training
    mean, success = (scores.mean_return, scores.success_rate) if scores else (None, None)
    if record.task.has_rivals or (
        evaluation is not None and evaluation.agents and not evaluation.success_defined
    ):
        mean = None  # the returns of agents that compete have no common meaning
    if not record.task.defines_success or (evaluation is not None and not evaluation.success_defined):
        success = None
    best = result.best if result else None
    steps_of_best = evaluation.model_steps if evaluation is not None else None
    if steps_of_best is None and best is not None:
        steps_of_best = best.steps
    of_training: Origin | None = None if mean is None else "training"
    return ListedRun(
        path,
        state,
        scenario=record.scenario,
        source=record.source,
        digest=record.digest,
        settings=changed_settings(record.command),
        teacher=record.task.teacher,
        engine=record.engine,
        seeds=(record.seed,),
        steps=steps,
        total_timesteps=record.total_timesteps,
        episodes=episodes,
        mean_return=mean,
        return_interval=evaluation.return_interval if evaluation else None,
        success_rate=success,
        score="evaluation" if evaluation else of_training,
        evaluated_episodes=evaluation.episodes if evaluation else None,
        remarks=evaluation.remarks if evaluation else (),
        solved=verdict.solved,
        solved_after=verdict.solved_after,
        stopped_as_solved=record.stopped_as_solved,
        best_steps=steps_of_best,
        mean_level=result.levels.mean if result and result.levels else None,
        chosen_by=best.chosen_by if best else None,
        decline=_decline(path, record),
        cpu_seconds=training.cpu_seconds if training else None,
        updated=record.updated,
    )


def _decline(path: Path, record: RunRecord) -> Decline | None:
    try:
        return decline_of(path, record)
    except RunError:  # only its evaluations during the training are damaged
        return None


def _listed_group(path: Path) -> ListedRun:
    group = Group.open(path)
    listed = _listed_campaign(group)
    runs = [run for run in listed.runs if run.problem is None]
    score = next((origin for origin in _ORIGINS if any(run.score == origin for run in runs)), None)
    returns = [run.mean_return for run in runs if run.mean_return is not None and run.score == score]
    rates = [run.success_rate for run in runs if run.success_rate is not None and run.score == score]
    seeds = group.record.seeds
    verdicts = {run.solved for run in runs} | ({None} if len(runs) < len(seeds) else set())
    solved = None if None in verdicts else True
    return replace(
        listed,
        digest=runs[0].digest if runs else "",
        settings=changed_settings(group.record.command),
        teacher=runs[0].teacher if runs else None,
        total_timesteps=runs[0].total_timesteps * len(seeds) if runs and runs[0].total_timesteps else None,
        mean_return=fmean(returns) if returns else None,
        success_rate=fmean(rates) if rates else None,
        score=score,
        evaluated_episodes=min(
            (run.evaluated_episodes for run in runs if run.evaluated_episodes), default=None
        ),
        solved=False if False in verdicts else solved,
        stopped_as_solved=bool(runs) and all(run.stopped_as_solved for run in runs),
    )


def _listed_study(path: Path) -> ListedRun:
    study = Study.open(path)
    listed = _listed_campaign(study)
    return replace(listed, settings=study.record.set, planned=study.record.trials)


def _listed_campaign(campaign: Campaign[Any]) -> ListedRun:
    """Return the entry of a campaign, with its members, and the sums over them."""
    members = tuple(map(read_listed, campaign.runs))
    summed = [member for member in members if member.problem is None]
    costs = [member.cpu_seconds for member in summed if member.cpu_seconds is not None]
    return ListedRun(
        campaign.path,
        campaign.state,
        scenario=campaign.record.scenario,
        source=campaign.record.source,
        engine=campaign.record.engine,
        seeds=campaign.record.seeds,
        steps=sum(member.steps or 0 for member in summed),
        episodes=sum(member.episodes or 0 for member in summed),
        cpu_seconds=sum(costs) if costs else None,
        updated=max((member.updated for member in summed), default=campaign.record.started),
        runs=members,
    )


def evaluations(run: Path) -> list[tuple[int, EvaluationResult | str]]:
    """Return the evaluations of a run by number, or the reason why one cannot be read."""
    numbered: list[tuple[int, EvaluationResult | str]] = []
    for number, path in numbered_files(run / "evaluations"):
        try:
            numbered.append((number, EvaluationResult.read(path)))
        except RunError as error:
            numbered.append((number, str(error)))
    return numbered


def _last_episode(log: Path) -> tuple[int, int] | None:
    """Return steps and number of the last episode in a log; None if it cannot be read."""
    try:
        row = read_log_tail(log, _TAIL_BYTES)[-1]
        return int(row["steps"]), int(row["episode"])
    except (RunError, IndexError, KeyError, ValueError):
        return None


def _last_statistics(run: Path) -> _Statistics | None:
    states = sorted((run / "checkpoints").glob("[0-9]*/state.json"))
    try:
        return read_json(states[-1], _Checkpoint, MAX_STATE_BYTES).statistics
    except (IndexError, RunError):
        # There is no checkpoint yet, or it has just been replaced.
        return None


def sort_runs(
    runs: Sequence[ListedRun], key: Literal["date", "name", "steps", "cpu", "return", "success"]
) -> list[ListedRun]:
    """Sort runs by date or name upwards, or by another value downwards. Runs without a value come last."""
    if key == "date":
        return list(runs)
    if key == "name":
        return sorted(runs, key=lambda run: run.path.name)
    value = {"steps": "steps", "cpu": "cpu_seconds", "return": "mean_return", "success": "success_rate"}[key]
    return sorted(runs, key=lambda run: (getattr(run, value) is None, -(getattr(run, value) or 0.0)))
