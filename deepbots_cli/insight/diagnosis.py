"""The causes why a policy does not learn, the most likely first, each with the next command.

A training that solves its task has none, unless it fell apart afterwards, or may do so.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from shlex import join

from deepbots_cli.document import Permissions
from deepbots_cli.document.files import display_path
from deepbots_cli.errors import RunError
from deepbots_cli.insight.causes import CAUSES
from deepbots_cli.insight.scenario_facts import training_command
from deepbots_cli.insight.statements import Statement, statements_about
from deepbots_cli.insight.training import (
    TOTAL_TIMESTEPS,
    TrainingEvidence,
    latest_failure,
    read_trainings,
    run_probes,
)
from deepbots_cli.learning.multi_agent import SHARED
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.words import shell_word

CHANGED = "changed_since_solved"
"""The fact of what was changed since a solved run, which is no cause."""
CERTAIN = 0.9
"""The likelihood of a certain cause."""
_BY_NAME = {row.name: row for row in CAUSES}
_OF_LEARNED = {
    *("fell_apart", "stopped_early", "reward_exploited", "strategies_cycle", "lint_warns"),
    "teacher_sees_more",
}
"""The causes that a training may have that has learned its task."""


def diagnose(training: TrainingEvidence) -> list[Statement]:
    """Return the causes that apply in the present stage, the most likely first; none for a training that has
    learned its task.

    Raises:
        RunError: The training has finished no episode, and has not failed either.
    """
    path, learned, rows = training.run.path, training.learned, CAUSES
    if not len(training.all_episodes) and not training.has_failed:
        longer = f"train it longer, with: deepbots resume {shell_word(path)}"
        wait = "wait for it" if training.is_running else longer
        raise RunError(f"{path} contains no finished episode yet; {wait}")
    if not (len(training.episodes) or training.has_failed):
        return []
    if learned:
        # Without `solved`, failing starts are reported.
        starts = {"some_starts_fail"} if training.run.program.agent.solved is None else set()
        explored = {"exploration_too_large"} if learned == "evaluated" else set()
        rows = tuple(row for row in CAUSES if row.name in _OF_LEARNED | starts | explored)
    statements = sorted(statements_about(rows, training), key=lambda entry: -entry.evidence["likelihood"])
    has_certain = any(statement.evidence["likelihood"] >= CERTAIN for statement in statements)

    def is_left_out(statement: Statement) -> bool:
        """Return whether a cause is a symptom of a certain one, or may be outgrown."""
        row = _BY_NAME[statement.cause]
        is_outgrown = row.is_provisional and not training.is_mature
        return statement.evidence["likelihood"] < CERTAIN and (
            is_outgrown or (row.is_symptom and has_certain)
        )

    remaining = [statement for statement in statements if not is_left_out(statement)]
    explained = {name for statement in remaining for name in _BY_NAME[statement.cause].explains}
    causes = (
        replace(statement, settings=_settings_of_agent(training, statement))
        for statement in remaining
        if statement.cause not in explained
    )
    return [replace(cause, command=_next_command(training, cause)) for cause in causes]


def verdict(training: TrainingEvidence, causes: Sequence[Statement]) -> str:
    """Return whether a training solves its task, and its most likely cause, in a sentence."""
    states = {True: "solved", False: "not solved", None: ""}
    state = "not solved yet" if training.is_running else states[training.verdict.solved]
    titles = [cause.title for cause in sorted(causes, key=lambda cause: cause.cause == CHANGED)]
    return ": ".join(filter(None, (state, *titles[:1]))) or "no cause of a failure was found"


def _settings_of_agent(evidence: TrainingEvidence, statement: Statement) -> Mapping[str, str]:
    """Return the advised settings: with several agents, in the section of the one that they are for, unless
    all agents share them."""
    section, shared = f"agents.{evidence.agent}.", {TOTAL_TIMESTEPS, *(f"train.{key}" for key in SHARED)}
    result = evidence.run.record.result
    if not evidence.agent or (result is not None and result.ratings):  # agents of self-play share a policy
        return statement.settings
    return {
        path if path in shared else f"{section}{path}": value for path, value in statement.settings.items()
    }


QUICK_SECONDS = 10.0
"""The longest time of the short episodes after a training, in s."""


def causes_after(run: Path, permissions: Permissions = Permissions()) -> list[Statement]:
    """Return the causes of a training that has ended unsolved or fallen apart, from its files and a few
    seconds of short episodes.

    Nothing is written. A training that fell apart after it had solved its task has the causes of its fall
    only.
    """
    causes: list[Statement] = []
    for training in read_trainings(Run.open(run)):
        name = f"{training.agent}: " if training.agent else ""
        causes += [replace(cause, text=f"{name}{cause.text}") for cause in causes_of(training, permissions)]
    return causes


def causes_of(training: TrainingEvidence, permissions: Permissions = Permissions()) -> list[Statement]:
    """Return the causes of a training that has ended, as `causes_after` does."""
    if training.learned:
        causes = (
            [] if training.verdict.solved is not False and training.decline is None else diagnose(training)
        )
        return (
            causes
            if training.verdict.solved is False
            else [cause for cause in causes if cause.cause == "fell_apart"]
        )
    run_probes(training, permissions=permissions, seconds=QUICK_SECONDS)
    return diagnose(training)


_OF_AGENT = {"diagnose", "eval", "try"}
"""The commands that show one of several agents."""


def _next_command(evidence: TrainingEvidence, statement: Statement) -> str:
    """Return the next command after a cause: the training with the advised values, or a command that shows
    the fault."""
    run, path = evidence.run, shell_word(display_path(evidence.run.path))
    if statement.settings.keys() == {TOTAL_TIMESTEPS}:
        return statement.command
    if statement.settings:
        return join(
            training_command(run, [f"{setting}={value}" for setting, value in statement.settings.items()])
        )
    if evidence.is_running:
        return ""
    if statement.cause == "not_finite" and (failure := latest_failure(run.path)) is not None:
        return f"deepbots diagnose {shell_word(failure)}"
    has_failed_episode = not all(episode.is_success for episode in evidence.final_episodes) and (
        evidence.run.program.defines_success
        or any(episode.ended_by in evidence.run.program.failures for episode in evidence.final_episodes)
    )
    usual = "diagnose {run} --episode failed" if has_failed_episode else "view {run}"
    form = _BY_NAME[statement.cause].command or usual
    if evidence.agent and form.partition(" ")[0] in _OF_AGENT:
        form += f" --agent {evidence.agent}"
    return "deepbots " + form.format(
        run=path,
        path=statement.evidence.get("path"),
        scenario=evidence.scenario_argument,
        earlier=shell_word(statement.evidence.get("earlier", "")),
        script=statement.evidence.get("script"),
    )
