"""The verdict about a run: the evaluation that is quoted everywhere, and whether the run solves its task.

`run_verdict` is the one definition of "solved" of `train`, `runs`, `report`, `diagnose` and the card of an
exported policy. Nothing is compiled, and torch is not imported.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean
from typing import NamedTuple

from deepbots_cli.errors import RunError
from deepbots_cli.learning.runs.directories import numbered_files
from deepbots_cli.learning.runs.evaluations import EvaluationResult
from deepbots_cli.learning.runs.records import QuotedEvaluation, RunRecord
from deepbots_cli.learning.runs.run import ModelRef, Run, has_model
from deepbots_cli.learning.runs.statistics import UNBOUNDED, Interval, gate_rate
from deepbots_cli.program.task import Solved
from deepbots_cli.rollout import Episode
from deepbots_cli.words import beside


class SolvedVerdict(NamedTuple):
    """The verdict of episodes on whether a task is solved.

    Attributes:
        solved: True: the episodes show it. False: they do not meet the criterion, or would be refused as a
            confirmation. None: the scenario has no criterion, or more episodes are needed.
        text: The answer and its reason.
        required_episodes: The number of episodes from which on there is an answer; None without a criterion.
    """

    solved: bool | None
    text: str
    required_episodes: int | None


def solved_verdict(
    solved: Solved | None,
    outcomes: Sequence[Episode],
    returns: Interval = UNBOUNDED,
    number: int | None = None,
) -> SolvedVerdict:
    """Return whether these episodes show that the task is solved, and why.

    Args:
        solved: The criterion of the scenario.
        done: The episodes.
        returns: The lowest and the highest possible return.
        number: The number of the confirmation that the episodes are; None for a policy that is confirmed,
            whose episodes need only meet the criterion.
    """
    episodes = len(outcomes)
    mean_return = fmean(episode.total_return for episode in outcomes)
    success_rate = fmean(episode.is_success for episode in outcomes)
    if solved is None:
        return SolvedVerdict(None, "the scenario has no `solved` criterion", None)
    if episodes < solved.episodes and solved.success_rate is not None:
        certain = gate_rate(solved.success_rate, round(success_rate * episodes), episodes, solved.episodes)
        if certain.met is False:
            required = f"a success rate of {100 * solved.success_rate:g}% is required"
            return SolvedVerdict(False, f"not solved: {required}, and {certain.reason}", solved.episodes)
    if episodes < solved.episodes:
        evaluated = f"{episodes} {'was' if episodes == 1 else 'were'} evaluated"
        needed = f"the criterion needs {solved.episodes} episodes and only {evaluated}"
        text = f"solved: unknown, because {needed}; evaluate with `--episodes {solved.episodes}`"
        return SolvedVerdict(None, text, solved.episodes)
    reasons = []
    if solved.mean_return is not None:
        reasons.append("mean return {} where {} is required".format(*beside(mean_return, solved.mean_return)))
    if solved.success_rate is not None:
        measured, bar = beside(100 * success_rate, 100 * solved.success_rate)
        reasons.append(f"success rate {measured}% where {bar}% is required")
    if not solved.is_met(mean_return, success_rate):
        return SolvedVerdict(False, f"not solved: {', '.join(reasons)}", solved.episodes)
    if number is None:
        return SolvedVerdict(True, f"solved: {', '.join(reasons)}", solved.episodes)
    from deepbots_cli.learning.runs.confirmation_rule import Confirmation

    lowest = min(episode.total_return for episode in outcomes)
    highest = max(episode.total_return for episode in outcomes)
    bounds = (
        returns[0] if math.isfinite(returns[0]) else lowest,
        returns[1] if math.isfinite(returns[1]) else highest,
    )
    confirmation = Confirmation.with_episodes(solved, number, bounds, episodes)
    if confirmation.passes(outcomes):
        return SolvedVerdict(True, f"solved: {', '.join(reasons)}", solved.episodes)
    plan = Confirmation.plan(solved, number, bounds, outcomes)
    if plan is not None and plan.episodes > episodes:
        luck = f"{', '.join(reasons)} may be luck in {episodes:,} episodes"
        text = f"solved: unknown, because {luck}; evaluate with `--episodes {plan.episodes}`"
        return SolvedVerdict(None, text, plan.episodes)
    text = f"not solved: {', '.join(reasons)}, and to confirm it, {confirmation.requirement} must be reached"
    return SolvedVerdict(False, text, solved.episodes)


def logged_episodes_meet(solved: Solved | None, returns: Sequence[float], successes: Sequence[float]) -> bool:
    """Return whether episodes in the log of a training meet the criterion; False without one, or without
    episodes. They are the answer of a run that has no evaluation yet."""
    return solved is not None and len(returns) > 0 and solved.is_met(fmean(returns), fmean(successes))


@dataclass(frozen=True)
class RunVerdict:
    """The verdict on whether a run solves its task, by the evaluation that is quoted everywhere.

    `solved` is None where there is no such evaluation, where it has too few episodes, or where the scenario
    has no `solved`. A training that stopped because its task is solved has an evaluation: the confirmation.
    """

    solved: bool | None
    evaluation: EvaluationResult | None
    confirmed_after: int | None = None
    """The steps after which a confirmation showed that the task is solved."""

    def of_agent(self, agent: str) -> RunVerdict:
        """Return the verdict about one of several agents of the run; of a run of this agent alone, itself."""
        evaluation = self.evaluation
        if evaluation is None or not evaluation.agents:
            return self
        return RunVerdict(None, evaluation.of_agent(agent))

    @property
    def solved_after(self) -> int | None:
        """The steps of `confirmed_after` of a run that is solved. A later evaluation with more episodes may
        contradict the confirmation."""
        return self.confirmed_after if self.solved else None

    def is_unsolved(self, *, defines_success: bool) -> bool:
        """Return whether the task has a criterion or defines success, and the run does not solve it."""
        return self.solved is False or (self.solved is None and defines_success)

    @property
    def text(self) -> str:
        """Mean return and success rate with their intervals, the circumstances, and the verdict."""
        if self.evaluation is None:
            return "not evaluated since the end of the training"
        answer = {True: "; solved", False: "; not solved", None: ""}[self.solved]
        return f"{self.evaluation.text}{answer}"


def run_verdict(path: Path, record: RunRecord) -> RunVerdict:
    """Return the verdict about a run from its record. While the run trains, its evaluations are those of
    older models and are ignored."""
    quoted = None if record.state(path) == "training" else quoted_evaluation(path, record)
    if quoted is None:
        return RunVerdict(None, None)
    confirmed_at = record.result.confirmed_at if record.result is not None else None
    steps = confirmed_at.steps if confirmed_at is not None else None
    return RunVerdict(quoted.evaluation.solved, quoted.evaluation, steps)


def quoted_evaluation(path: Path, record: RunRecord) -> QuotedEvaluation | None:
    """Return the evaluation of the best model that is quoted everywhere: the one in the record.

    The record of a version before 0.2 has none, and the file of an evaluation may have been removed. It is
    then chosen from the files since the training ended, as `RunRecord.with_evaluation` chooses it.
    """
    quoted = record.quoted
    if record.task is not None and (quoted is None or evaluation_file(path, quoted.number).is_file()):
        return quoted
    record = record.model_copy(update={"quoted": None})
    for number, file in numbered_files(path / "evaluations"):
        with suppress(RunError):
            evaluation = EvaluationResult.read(file)
            record = record.with_evaluation(number, evaluation) if record.follows(evaluation) else record
    return record.quoted


def quoted_episodes(run: Run) -> EvaluationResult | None:
    """Return `quoted_evaluation` with its episodes.

    Raises:
        RunError: It is damaged.
    """
    quoted = quoted_evaluation(run.path, run.record)
    if quoted is None:
        return None
    evaluation = EvaluationResult.read(evaluation_file(run.path, quoted.number))
    return evaluation.model_copy(update={"solved": quoted.evaluation.solved})


def last_episodes(ref: ModelRef) -> tuple[Path, EvaluationResult] | None:
    """Return the last evaluation in the scenario and engine of the training, since the training ended,
    including evaluations with sampled actions, and its file.

    It is one of the named model, or of any model that the run still has if a run was named.

    Raises:
        RunError: It, or a later one, is damaged.
    """
    path, record = ref.run.path, ref.run.record
    for _, file in reversed(numbered_files(path / "evaluations")):
        evaluation = EvaluationResult.read(file)
        is_named = evaluation.model == ref.name if ref.is_named else has_model(path, evaluation.model)
        if record.follows(evaluation) and record.is_own(evaluation) and is_named:
            return file, evaluation
    return None


def evaluation_file(path: Path, number: int) -> Path:
    """Return the file of an evaluation of a run."""
    return path / "evaluations" / f"{number:04d}.json"
