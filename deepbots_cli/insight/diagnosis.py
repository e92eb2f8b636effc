"""The table of reasons why a policy does not learn, each with its evidence and advice.

A row finds its evidence in the logs or in the short episodes, or does not apply. `likelihood` orders the
rows: observed causes that make learning impossible come before those that often do, and both come before
possible symptoms. A training that solves its task has none, unless it fell apart afterwards.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path, PurePath
from shlex import join, quote
from statistics import fmean
from typing import Literal

import numpy as np

from deepbots_cli.compiler.inputs import ELSEWHERE
from deepbots_cli.diagnostics import Finding
from deepbots_cli.diagnostics.registry import RULES
from deepbots_cli.document import Permissions
from deepbots_cli.document.files import display_path
from deepbots_cli.errors import RunError
from deepbots_cli.insight.causes import (
    TOTAL_TIMESTEPS,
    changed_since_solved,
    constant_observation,
    one_ending,
    rival_improved,
    rival_too_strong,
    saturated_observation,
    script_succeeds,
    sensor_without_reading,
    stopped_early,
    strategies_cycle,
    teacher_fails,
    teacher_sees_more,
    too_few_steps,
)
from deepbots_cli.insight.learner import (
    exploration_collapsed,
    exploration_hides_success,
    exploration_too_large,
    fell_apart,
    horizon_too_short,
    learning_rate_too_high,
    learning_rate_too_low,
    rewards_too_large,
    success_needs_exploration,
)
from deepbots_cli.insight.rewards import (
    ending_early_pays,
    loitering,
    return_at_ceiling,
    reward_apart_from_success,
    reward_exploited,
    standing_still_pays,
    term_dominates,
)
from deepbots_cli.insight.scenario_facts import training_command
from deepbots_cli.insight.stages import (
    easy_stage_counted,
    levels_stay_lowest,
    missed_condition,
    some_starts_fail,
    stage_too_hard,
    stuck_in_stage,
    success_never_seen,
    success_plateau,
)
from deepbots_cli.insight.statements import (
    Numbers,
    Percentage,
    Statement,
    StatementRule,
    SuccessRate,
    list_text,
    sentence,
    statement,
    statements_about,
)
from deepbots_cli.insight.trace import Trace
from deepbots_cli.insight.training import (
    MIN_EPISODES,
    TrainingEvidence,
    commonest_ending,
    latest_failure,
    read_trainings,
    run_probes,
)
from deepbots_cli.learning.environments import Failure
from deepbots_cli.learning.multi_agent import SHARED
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.learning.runs.verdict import logged_episodes_meet
from deepbots_cli.program.task import SAME_OBSERVATION

_UNLEARNABLE = {
    "DB705": "Failing early pays",
    "DB708": "Avoiding the success pays more than the success",
    "DB711": "Every policy earns the same",
    "DB807": "The success is out of reach",
    "DB810": "`solved` asks for what no policy can miss or reach",
}
"""The meaning of findings of lint for a training that cannot learn its task."""
_EXPLOITS = {"DB708", "DB717"}
"""Findings of payments that a policy can collect without success."""


def _success_earns_more(evidence: TrainingEvidence) -> bool:
    """Return whether the successes at the end of the training have the higher mean return."""
    late = evidence.episodes_between(0.75, 1.0)
    is_success = late.successes > 0
    successes, others = late.returns[is_success], late.returns[~is_success]
    return min(len(successes), len(others)) >= MIN_EPISODES and float(successes.mean()) > float(others.mean())


_REFUTED: Mapping[str, Callable[[TrainingEvidence], bool]] = {
    "DB708": _success_earns_more,
    "DB711": lambda evidence: len(evidence.episodes) > 1 and float(np.ptp(evidence.episodes.returns)) > 0.0,
    "DB807": lambda evidence: bool(evidence.episodes.successes.any()),
}
"""The tests of whether the episodes of a training refute a finding of lint."""
CERTAIN, _SYMPTOMS = 0.9, {"too_few_steps", "one_ending", "success_plateau", "missed_condition"}
"""The likelihood of a certain cause, and the causes that are only symptoms beside one: the length of the
training, its most frequent ending, a plateau of success and a missed condition."""
_EXPLAINED = {
    "return_at_ceiling": {"exploration_collapsed", "learning_rate_too_low", "too_few_steps"},
    "reward_exploited": {"reward_apart_from_success", "exploration_collapsed", "success_needs_exploration"},
    "ending_early_pays": {"exploration_collapsed", "success_never_seen"},
    "missed_condition": {"success_plateau"},
    "rival_too_strong": {"success_never_seen", "one_ending", "rival_improved"},
    "rival_improved": {"one_ending"},
}
"""For each cause, the causes that it implies, which are then not listed: a policy that repeats the action
that pays most is not reported as exploring too little."""
_PROVISIONAL_CAUSES = {
    "success_never_seen",
    "one_ending",
    "exploration_too_large",
}
"""Findings that a young training may still outgrow. They become causes when the training or the stage is
mature, or when they are certain."""


def diagnose(training: TrainingEvidence) -> list[Statement]:
    """Return the causes that apply in the present stage, the most likely first; none for a training that has
    learned its task.

    Raises:
        RunError: The training has finished no episode, and has not failed either.
    """
    path = training.run.path
    if not len(training.all_episodes) and not training.has_failed:
        wait = (
            "wait for it"
            if training.is_running
            else f"train it longer, with: deepbots resume {quote(str(path))}"
        )
        raise RunError(f"{path} contains no finished episode yet; {wait}")
    learned = has_learned(training)
    if not (len(training.episodes) or training.has_failed):
        return []
    causes = CAUSES
    if learned:
        # Without `solved`, failing starts are reported.
        starts = (some_starts_fail,) if training.run.program.agent.solved is None else ()
        explored = (exploration_too_large,) if learned == "evaluated" else ()
        causes = (
            fell_apart,
            stopped_early,
            reward_exploited,
            strategies_cycle,
            lint_warns,
            teacher_sees_more,
            *starts,
            *explored,
        )
    statements = sorted(statements_about(causes, training), key=lambda entry: -entry.evidence["likelihood"])
    unlikely = [statement for statement in statements if statement.evidence["likelihood"] < CERTAIN]
    left_out = set[str]() if training.is_mature else set(_PROVISIONAL_CAUSES)
    left_out |= _SYMPTOMS if len(unlikely) < len(statements) else set()
    remaining = [
        statement for statement in statements if not (statement in unlikely and statement.cause in left_out)
    ]
    explained = set[str]().union(*(_EXPLAINED.get(statement.cause, ()) for statement in remaining))
    remaining = [statement for statement in remaining if statement.cause not in explained]
    with_settings = [replace(entry, settings=_settings_of_agent(training, entry)) for entry in remaining]
    return [replace(statement, command=_next_command(training, statement)) for statement in with_settings]


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
    if has_learned(training):
        causes = (
            [] if training.verdict.solved is not False and training.decline is None else diagnose(training)
        )
        return (
            causes
            if training.verdict.solved is False
            else [cause for cause in causes if cause.cause == fell_apart.name]
        )
    run_probes(training, permissions=permissions, seconds=QUICK_SECONDS)
    return diagnose(training)


_COMMANDS: Mapping[str, str] = {
    "action_without_effect": "inspect {run}",
    "changed_since_solved": "diff {earlier} {run}",
    "constant_observation": "inspect {run}",
    "easy_stage_counted": "eval {run} --details",
    "ending_at_reset": "lint --deep {run}/resolved.yaml",
    "lint_warns": "lint {path}",
    "saturated_observation": "inspect {run}",
    "sensor_without_reading": "view {run}",
    "some_starts_fail": "eval {run} --details",
    "stage_too_hard": "eval {run} --details",
    "standing_still_pays": "try {scenario} --driver zero",
    "stuck_in_stage": "eval {run} --details",
    "teacher_fails": "try {scenario} --driver {script} --episodes 20",
    "term_dominates": "try {scenario}",
}
"""The commands that show more of a cause for which no value under `train` is advised. For all others, this is
a failed episode."""
_OF_AGENT = {"diagnose", "eval", "try"}
"""The commands above that show one of several agents."""


def _next_command(evidence: TrainingEvidence, statement: Statement) -> str:
    """Return the next command after a cause: the training with the advised values, or a command that shows
    the fault."""
    run, path = evidence.run, quote(display_path(evidence.run.path))
    if statement.settings.keys() == {TOTAL_TIMESTEPS}:
        return f"deepbots resume {path} --timesteps {statement.settings[TOTAL_TIMESTEPS]}"
    if statement.settings:
        return join(
            training_command(run, [f"{setting}={value}" for setting, value in statement.settings.items()])
        )
    if evidence.is_running:
        return ""
    if statement.cause == "not_finite" and (failure := latest_failure(run.path)) is not None:
        return f"deepbots diagnose {quote(str(failure))}"
    has_failed_episode = not all(episode.is_success for episode in evidence.final_episodes) and (
        evidence.run.program.defines_success
        or any(episode.ended_by in evidence.run.program.failures for episode in evidence.final_episodes)
    )
    form = _COMMANDS.get(
        statement.cause, "diagnose {run} --episode failed" if has_failed_episode else "view {run}"
    )
    if evidence.agent and form.partition(" ")[0] in _OF_AGENT:
        form += f" --agent {evidence.agent}"
    return "deepbots " + form.format(
        run=path,
        path=statement.evidence.get("path"),
        scenario=evidence.scenario_argument,
        earlier=quote(str(statement.evidence.get("earlier"))),
        script=statement.evidence.get("script"),
    )


def has_learned(evidence: TrainingEvidence) -> Literal["exploring", "evaluated"] | None:
    """Return where the policy has learned the task: in the episodes of the training, or only in evaluations,
    which do not explore.

    The task is the scenario itself, or the last stage of its curriculum. The task is not learned if an
    evaluation after the training excludes it. In a scenario without `solved`, the task is learned at a
    success rate of 80 %.
    """
    solved, succeeds = evidence.run.program.agent.solved, evidence.run.program.defines_success
    required = 0.8 if solved is None else solved.success_rate or 0.0

    def suffices(successes: Sequence[float]) -> bool:
        """Return whether successes suffice in a scenario without `solved`."""
        return solved is None and succeeds and len(successes) >= MIN_EPISODES and fmean(successes) >= required

    final = SuccessRate.of(evidence.final_episodes)
    excluded = succeeds and final.episodes >= MIN_EPISODES and final.high < required
    if not excluded and (
        _met_while_exploring(evidence)
        or (evidence.is_last_stage and suffices(evidence.episodes.successes[-100:]))
    ):
        return "exploring"
    evaluated = (
        evidence.evaluations[-1]["successes"]
        if evidence.evaluations and evidence.program.defines_success
        else ()
    )
    last = (
        evaluated if evidence.is_last_stage else [episode.is_success for episode in evidence.final_episodes]
    )
    return "evaluated" if evidence.solved or suffices(last) else None


def _met_while_exploring(evidence: TrainingEvidence) -> bool:
    """Return whether episodes of the training, which explore, met `solved`."""
    solved, result = evidence.run.program.agent.solved, evidence.run.record.result
    if result is None or result.solved_at is None:
        return False
    if solved is None:
        return True
    recent = evidence.episodes[-solved.episodes :] if evidence.is_last_stage else evidence.episodes[:0]
    return logged_episodes_meet(solved, recent.returns, recent.successes)


# Faults


@statement(
    "ending_at_reset",
    "An episode cannot start after {steps} steps of training: {error}.",
    advice="Change the start under `reset` or the threshold of the ending. `deepbots lint --deep SCENARIO`"
    " counts the starts that end at once.",
)
def ending_at_reset(evidence: TrainingEvidence) -> Numbers | None:
    if evidence.failure is None or not evidence.failure.ends_at_reset:
        return None
    return {"likelihood": 1.0, "steps": evidence.steps, "error": _error(evidence.failure)}


def _error(failure: Failure) -> str:
    """Return the error of an episode, within a sentence."""
    return f"episode {failure.episode:,}, {failure.error}".rstrip(".")


@statement(
    "not_finite",
    "The training stopped with an error after {steps} steps: {error}.",
    advice="Use max(...) to keep divisors and arguments of sqrt and log above 0, or lower"
    " `train.learning_rate`. `deepbots diagnose RUN/failures/NNNN.json` explains the episode.",
)
def not_finite(evidence: TrainingEvidence) -> Numbers | None:
    if not evidence.has_failed or (evidence.failure is not None and evidence.failure.ends_at_reset):
        return None
    reason = (
        "the last value in its log is not a number (NaN)"
        if evidence.failure is None
        else _error(evidence.failure)
    )
    return {"likelihood": 1.0, "steps": evidence.steps, "error": reason, "episodes": len(evidence.episodes)}


@statement(
    "action_without_effect",
    "{count} of {of} action parts have no effect ({parts}): from the same start, all tested values give the"
    " same observations for {steps} steps.",
    advice="Check `apply` of the robot, the limits of its motors (`deepbots inspect RUN`), and the wheels or"
    " joints that it drives.",
)
def action_without_effect(evidence: TrainingEvidence) -> Numbers | None:
    indices = [
        index
        for index, number in enumerate(evidence.program.agent.numbers)
        if number.name != "previous_action"
    ]
    dead, steps = [], 0
    for part, traces in evidence.constant_actions.items():
        pairs = list(combinations(traces.values(), 2))
        if pairs and max(_difference(first, second, indices) for first, second in pairs) < SAME_OBSERVATION:
            dead.append(part)
            steps = min(trace.steps for trace in traces.values())
    if not dead or not steps:
        return None
    return {
        "likelihood": 0.98 if len(dead) == len(evidence.constant_actions) else 0.8,
        "parts": list_text(dead),
        "count": len(dead),
        "of": len(evidence.constant_actions),
        "steps": steps,
        "difference": 0.0,
    }


def _difference(first: Trace, second: Trace, numbers: Sequence[int]) -> float:
    """Return the largest difference of the observations, and of the values that the endings compare."""
    if first.steps != second.steps:
        return 1.0
    largest = np.abs(first.observations[:, numbers] - second.observations[:, numbers]).max(initial=0.0)
    differences = [
        abs(a - b)
        for x, y in zip(first.values, second.values, strict=True)
        for key in x
        for a, b in zip(x[key], y[key], strict=True)
    ]
    return float(max(largest, *differences, 0.0)) if differences else float(largest)


@statement(
    "ending_at_once",
    "Episodes end before the policy can act: '{ending}' ends {share} of them. Half of all episodes end"
    " within {length} steps and 90% within {long}, of {longest} possible steps.",
    advice="Loosen the threshold of '{ending}', or start farther away from it: `deepbots diagnose RUN"
    " --episode failed` shows the value and the threshold.",
)
def ending_at_once(evidence: TrainingEvidence) -> Numbers | None:
    lengths = evidence.episodes.lengths
    if len(lengths) < MIN_EPISODES:
        return None
    long = float(np.quantile(lengths, 0.9))
    name, share = commonest_ending(evidence.episodes)
    if long > min(12, 0.2 * evidence.longest) or name not in evidence.program.failures:
        return None
    return {
        "likelihood": 0.96,
        "ending": name,
        "share": Percentage(share),
        "length": float(np.median(lengths)),
        "long": long,
        "longest": evidence.longest,
    }


@statement(
    "lint_warns",
    "{meaning}: {finding} ({code}).{others}",
    advice="{help}: `deepbots lint {path}` shows the lines.{copy}",
)
def lint_warns(evidence: TrainingEvidence) -> Numbers | None:
    linted = evidence.linted
    meanings = {
        code: text
        for code, text in _UNLEARNABLE.items()
        if not (code in _REFUTED and _REFUTED[code](evidence))
    }
    # If the training continues, a policy that has learned the task may still discover a reward without
    # success.
    learned = has_learned(evidence)
    concerned = [
        finding
        for finding in linted.findings
        if finding.code in _EXPLOITS or not (learned or _is_of_foreign_robot(finding))
    ]
    findings = sorted(concerned, key=lambda finding: finding.code not in meanings)
    if not findings:
        return None
    first, *other_findings = findings
    others = ""
    if other_findings:
        reported = list_text([f"{finding.headline} ({finding.code})" for finding in other_findings], 2)
        others = f" Lint also reports: {reported}."
    meaning = meanings.get(first.code) or f"Lint warns about {RULES[first.code].summary}"
    changed = linted.changed_source
    copy = f" It is the copy that the training read: {changed} was changed since then." if changed else ""
    return {
        "likelihood": 0.91 if first.code in meanings else 0.3,
        "meaning": meaning,
        "finding": first.headline,
        "code": first.code,
        "count": len(findings),
        "others": others,
        "help": sentence(first.help or "Change what the finding names"),
        "codes": [finding.code for finding in findings],
        "path": linted.arguments,
        "copy": copy,
    }


def _is_of_foreign_robot(finding: Finding) -> bool:
    """Return whether a finding is in the copy of a robot file outside the project, such as one of a package.
    Lint leaves out warnings about files of packages, which a copy no longer names."""
    path = PurePath(finding.span.source.name)
    return path.suffix == ".urdf" and any(name.startswith(ELSEWHERE) for name in path.parts)


CAUSES: tuple[StatementRule[TrainingEvidence], ...] = (
    # A fact, after certain causes and before all others
    changed_since_solved,
    # Nothing to learn
    ending_at_reset,
    not_finite,
    fell_apart,
    action_without_effect,
    ending_at_once,
    # What pays is not the task
    reward_exploited,
    ending_early_pays,
    return_at_ceiling,
    lint_warns,
    # The observation
    sensor_without_reading,
    constant_observation,
    saturated_observation,
    # The reward
    term_dominates,
    standing_still_pays,
    loitering,
    stage_too_hard,
    easy_stage_counted,
    some_starts_fail,
    reward_apart_from_success,
    # Starts, stages and teachers
    stuck_in_stage,
    levels_stay_lowest,
    script_succeeds,
    teacher_fails,
    teacher_sees_more,
    success_never_seen,
    # Other agents
    rival_too_strong,
    rival_improved,
    strategies_cycle,
    # The learner
    learning_rate_too_high,
    learning_rate_too_low,
    rewards_too_large,
    horizon_too_short,
    exploration_hides_success,
    success_needs_exploration,
    exploration_too_large,
    exploration_collapsed,
    # The end
    missed_condition,
    success_plateau,
    one_ending,
    stopped_early,
    too_few_steps,
)
"""The causes of a training that does not learn. Among causes that are as likely, the first one of this list
comes first."""
