"""The table of reasons why a policy does not learn, each with its evidence and advice.

A row finds its evidence in the logs or in the short episodes, or does not apply. `likelihood` orders the
rows: observed causes that make learning impossible come before those that often do, and both come before
possible symptoms. A training that solves its task has none, unless it fell apart afterwards.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path, PurePath
from shlex import join, quote
from statistics import fmean
from typing import Any, Literal, NamedTuple

import numpy as np

from deepbots_cli.compiler.inputs import ELSEWHERE
from deepbots_cli.diagnostics import Finding
from deepbots_cli.diagnostics.registry import RULES
from deepbots_cli.document import Permissions
from deepbots_cli.document.files import display_path
from deepbots_cli.errors import RunError
from deepbots_cli.insight.changed import changed_since_solved
from deepbots_cli.insight.collapse import fell_apart, suspects
from deepbots_cli.insight.ends import (
    TOTAL_TIMESTEPS,
    kept_by_return,
    one_ending,
    stopped_early,
    too_few_steps,
    training_length,
)
from deepbots_cli.insight.missed import missed_condition
from deepbots_cli.insight.observations import (
    constant_observation,
    saturated_observation,
    sensor_without_reading,
)
from deepbots_cli.insight.rewards import (
    ending_early_pays,
    loitering,
    return_at_ceiling,
    reward_apart_from_success,
    reward_exploited,
    silent_terms,
    standing_still_pays,
    term_dominates,
)
from deepbots_cli.insight.rivals import rival_improved, rival_too_strong, strategies_cycle
from deepbots_cli.insight.stages import (
    criterion,
    criterion_text,
    easy_stage_counted,
    hides_success,
    levels_stay_lowest,
    needs_exploration,
    some_starts_fail,
    stage_too_hard,
    stuck_in_stage,
    success_never_seen,
    success_plateau,
)
from deepbots_cli.insight.statements import (
    EvaluationRate,
    Numbers,
    Percentage,
    Statement,
    StatementRule,
    SuccessRate,
    list_text,
    statement,
    statements_about,
)
from deepbots_cli.insight.teachers import script_succeeds, teacher_fails, teacher_sees_more
from deepbots_cli.insight.trace import Trace
from deepbots_cli.insight.training import (
    MIN_EPISODES,
    TrainingEvidence,
    latest_failure,
    read_trainings,
    returns_rise,
    run_probes,
    training_command,
)
from deepbots_cli.learning.agents.multi_agent import SHARED
from deepbots_cli.learning.failures import Failure
from deepbots_cli.learning.runs.episodes import meets_solved
from deepbots_cli.learning.runs.run import Run
from deepbots_cli.learning.sb3.defaults import default_values, longest_episode
from deepbots_cli.program.task import SAME_OBSERVATION

_UNLEARNABLE = {
    "DB705": "Failing early pays",
    "DB708": "Avoiding the success pays more than the success",
    "DB711": "Every policy earns the same",
    "DB807": "The success is out of reach",
    "DB810": "`solved` asks for what no policy can miss or reach",
}
"""The meaning of findings of lint for a training that cannot learn its task."""

_EXPLOITS = {"DB708", "DB716", "DB717"}
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
_LARGE_RETURN = 1000.0
"""The absolute mean return from which a critic of the usual learning rate falls behind: CartPole with 1000
for each step is not learned."""
_HIDDEN = 6.0
"""The number of steps, in units of 1 / (1 - gamma), after which a reward has less than 0.3 % of its
weight."""
_PROVISIONAL_CAUSES = {
    "kept_by_return",
    "success_never_seen",
    "silent_terms",
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
            kept_by_return,
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
    "kept_by_return": "eval {run} --details",
    "constant_observation": "inspect {run}",
    "easy_stage_counted": "eval {run} --details",
    "ending_at_reset": "lint --deep {run}/resolved.yaml",
    "exploration_delays_stage": "eval {run} --details",
    "lint_warns": "lint {path}",
    "saturated_observation": "inspect {run}",
    "sensor_without_reading": "view {run}",
    "silent_terms": "try {scenario}",
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

    final = SuccessRate([episode.is_success for episode in evidence.final_episodes])
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
    if result.confirmed_at is None or solved is None:  # versions before 0.2 did not confirm
        return True
    recent = evidence.episodes[-solved.episodes :] if evidence.is_last_stage else evidence.episodes[:0]
    return len(recent) > 0 and meets_solved(
        solved, float(recent.returns.mean()), float(recent.successes.mean())
    )


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
    longest = evidence.program.truncation.max_episode_steps(evidence.program.period)
    if len(lengths) < MIN_EPISODES:
        return None
    long = float(np.quantile(lengths, 0.9))
    name, count = Counter(evidence.episodes.endings).most_common(1)[0]
    if long > min(12, 0.2 * longest) or name not in evidence.program.failures:
        return None
    return {
        "likelihood": 0.96,
        "ending": name,
        "share": Percentage(count / len(lengths)),
        "length": float(np.median(lengths)),
        "long": long,
        "longest": longest,
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
        "help": _sentence(first.help or "Change what the finding names"),
        "codes": [finding.code for finding in findings],
        "path": linted.arguments,
        "copy": copy,
    }


def _is_of_foreign_robot(finding: Finding) -> bool:
    """Return whether a finding is in the copy of a robot file outside the project, such as one of a package.
    Lint leaves out warnings about files of packages, which a copy no longer names."""
    path = PurePath(finding.span.source.name)
    return path.suffix == ".urdf" and any(name.startswith(ELSEWHERE) for name in path.parts)


# Learning


@statement(
    "learning_rate_too_high",
    "The learning rate is {rate}, {times} times the usual {usual}: up to {clipped} of the samples of an"
    " update are clipped, the largest KL divergence is {kl}, and the mean return went from {first} to"
    " {last}.",
    advice="Set `train.learning_rate` to {usual}.",
)
def learning_rate_too_high(evidence: TrainingEvidence) -> Numbers | None:
    rate, usual = evidence.number_setting("learning_rate"), _usual_rate(evidence)
    if rate is None or _names_rate(evidence):
        return None
    clipped, kl = (
        float(evidence.curve(f"train/{name}").max(initial=0.0)) for name in ("clip_fraction", "approx_kl")
    )
    times = rate / usual
    if not (((clipped >= 0.5 or kl >= 0.3) and times > 2) or times >= 20):
        return None
    first, last = (
        float(evidence.episodes_between(*ends).returns.mean()) for ends in ((0.0, 0.25), (0.75, 1.0))
    )
    unlikely = 0.75 if times > 5 else 0.5
    return {
        "likelihood": 0.93 if times >= 20 else unlikely,
        "rate": rate,
        "usual": usual,
        "times": times,
        "clipped": Percentage(clipped),
        "kl": kl,
        "first": first,
        "last": last,
        "settings": {"train.learning_rate": f"{usual:g}"},
    }


def _names_rate(evidence: TrainingEvidence) -> bool:
    """Return whether the cause of a fall names the learning rate."""
    return evidence.decline is not None and any(
        suspect.path == "train.learning_rate" for suspect in suspects(evidence, evidence.decline)
    )


def _usual_rate(evidence: TrainingEvidence) -> float:
    """Return the default learning rate, of deepbots or the library."""
    training = evidence.program.agent.training
    defaults: Any = (
        None
        if training is None
        else default_values(training, evidence.run.record.total_timesteps, longest_episode(evidence.program))
    )
    rate = (defaults or {}).get("learning_rate")
    return float(rate) if isinstance(rate, int | float) else 3e-4  # of the library


@statement(
    "learning_rate_too_low",
    "The learning rate is {rate}, {times} times lower than the usual {usual}: after {steps} steps, the mean"
    " return went only from {first} to {last}{divergence}.",
    advice="Set `train.learning_rate` to {usual}.",
)
def learning_rate_too_low(evidence: TrainingEvidence) -> Numbers | None:
    rate, usual = evidence.number_setting("learning_rate"), _usual_rate(evidence)
    kl = evidence.curve("train/approx_kl")
    if not rate or len(evidence.episodes) < 2 * MIN_EPISODES or returns_rise(evidence) is not None:
        return None
    # In an update of PPO with a usual rate, the KL divergence is about 0.01.
    if usual < 10 * rate or (kl.max() > 1e-3 if len(kl) else usual < 50 * rate):
        return None
    first, last = (
        float(evidence.episodes_between(*ends).returns.mean()) for ends in ((0.0, 0.25), (0.75, 1.0))
    )
    divergence = (
        f", and the largest KL divergence, by which an update changes the policy, is {kl.max():.2g}"
        if len(kl)
        else ""
    )
    return {
        "likelihood": 0.93,
        "rate": rate,
        "usual": usual,
        "times": usual / rate,
        "steps": evidence.steps,
        "first": first,
        "last": last,
        "divergence": divergence,
        "settings": {"train.learning_rate": f"{usual:g}"},
    }


@statement(
    "rewards_too_large",
    "The rewards are too large for the critic: the mean return of late episodes is {late}, and the critic"
    " explains {explained} of the variance of the returns. The norm of a gradient is limited, and the part of"
    " the critic leaves hardly any for the policy.",
    advice="Set `train.normalize` to `reward`, which divides rewards by their standard deviation for"
    " learning only, or scale all terms down.",
)
def rewards_too_large(evidence: TrainingEvidence) -> Numbers | None:
    training, explained = evidence.program.agent.training, evidence.curve("train/explained_variance")
    if (
        training is None
        or training.normalize == "reward"
        or len(explained) < MIN_EPISODES
        or len(evidence.episodes) < 2 * MIN_EPISODES
    ):
        return None
    late = evidence.episodes_between(0.75, 1.0).returns
    median = float(np.median(explained[-max(1, len(explained) // 4) :]))
    if median > 0.3 or np.abs(late).mean() < _LARGE_RETURN:
        return None
    return {"likelihood": 0.91, "late": float(late.mean()), "explained": Percentage(max(0.0, median)),
            "settings": {"train.normalize": "reward"}}  # fmt: skip


@statement(
    "horizon_too_short",
    "The discount factor {gamma} hides what comes late: after {length} steps, {of}, a reward has {weight} of"
    " its weight.",
    advice="Set `train.gamma` to {wanted}.",
)
def horizon_too_short(evidence: TrainingEvidence) -> Numbers | None:
    gamma, won = evidence.number_setting("gamma"), evidence.episodes.lengths[evidence.episodes.successes > 0]
    if gamma is None or gamma >= 1.0:
        return None
    has_successes = len(won) >= MIN_EPISODES
    length = (
        float(np.median(won))
        if has_successes
        else float(evidence.program.truncation.max_episode_steps(evidence.program.period))
    )
    if length * (1.0 - gamma) < _HIDDEN:
        return None
    is_far = length * (1.0 - gamma) > 5 * _HIDDEN
    if not is_far and evidence.facts.pays_in_ordinary_steps_only:
        return None
    if not (has_successes or is_far) and (
        evidence.facts.terms_towards_success or not evidence.program.defines_success
    ):
        return None  # rewards on the way do
    advised = min(0.999, round(1.0 - 3.0 / length, 3))  # a weight of 5 %
    if advised <= gamma:
        return None
    # A factor that is far too small; else rewards on the way may do.
    return {
        "likelihood": 0.915 if is_far else 0.45,
        "gamma": gamma,
        "length": round(length),
        "of": "the median of the successes" if has_successes else "the limit of an episode",
        "weight": Percentage(gamma**length),
        "wanted": advised,
        "settings": {"train.gamma": f"{advised:g}"},
    }


@statement(
    "exploration_hides_success",
    "Without exploration, the policy succeeds in {without}{where} at the end of the training. With"
    " exploration, it succeeds in {with}. Exploration prevents success.",
    advice="{remedy}, or loosen the condition for success. You can already use the policy: `deepbots view`,"
    " `eval` and `export` run it without exploration.",
)
def exploration_hides_success(evidence: TrainingEvidence) -> Numbers | None:
    hidden, until = hides_success(evidence), criterion(evidence)
    if hidden is None:
        return None
    counts = until is not None and until.episodes is not None and until.metric != "steps"
    by_evaluation = ["let evaluations end the stage, with `in evaluation` in its `until`"] if counts else []
    shorten = "shorten the time for which the success condition must be true"
    less = _exploration_changes(evidence, 0.1)
    remedy = " and ".join([*by_evaluation, *map(str, less)]) or shorten
    return {
        "likelihood": 0.923,
        "without": hidden[0],
        "with": hidden[1],
        "where": f" in stage '{evidence.stage}'" if evidence.stage else "",
        "remedy": _sentence(remedy),
        "settings": _settings(less),
    }


@statement(
    "success_needs_exploration",
    "With exploration, the policy succeeds in {with} at the end of the training. Without it, it succeeds in"
    " {without}{where}: it seems to stand still or to repeat itself in some states, and only the noise on its"
    " actions leads out of them.",
    advice="{advice} The noise becomes smaller, and the policy learns to do without it. {otherwise}",
)
def success_needs_exploration(evidence: TrainingEvidence) -> Numbers | None:
    needed = needs_exploration(evidence)
    if needed is None:
        return None
    otherwise = "If it still needs the noise then, let no action be standing still"
    if not evidence.facts.shows_previous_action:
        otherwise += ", or show the policy its previous action (`previous_action: auto` under `observation`)"
    return {
        **training_length(evidence),
        "otherwise": f"{otherwise}.",
        "likelihood": 0.923,
        "with": needed[0],
        "without": needed[1],
        "where": f" in stage '{evidence.stage}'" if evidence.stage else "",
    }


@statement(
    "exploration_delays_stage",
    "Stage '{stage}' continued for {delay} steps after its evaluations reached {criterion}, because training"
    " episodes with exploration stayed below it. In these evaluations, without exploration, the policy"
    " succeeds in {success}.",
    advice="Let evaluations end the stage, with `in evaluation` in its `until`.",
)
def exploration_delays_stage(evidence: TrainingEvidence) -> Numbers | None:
    worst: dict[str, Any] = {}
    for index, stage in enumerate(evidence.stages[: evidence.stage_index]):
        until, after = stage.until, evidence.episodes_of(evidence.stages[index + 1].name)
        if until is None or until.metric == "steps" or until.episodes is None or not len(after):
            continue
        values = "successes" if until.metric == "success_rate" else "returns"
        evaluations = [
            evaluation for evaluation in evidence.all_evaluations if evaluation.get("stage") == stage.name
        ]
        reached = [
            k
            for k in range(len(evaluations))
            if all(fmean(evaluation[values]) >= until.threshold for evaluation in evaluations[k:])
        ]
        delay = int(after.steps[0] - evaluations[reached[0]]["steps"]) if reached else 0
        if delay > max(worst.get("delay", 0), 0.1 * evidence.planned):
            rate = EvaluationRate([evaluation["successes"] for evaluation in evaluations[reached[0] :]])
            worst = {
                "likelihood": 0.5,
                "stage": stage.name,
                "delay": delay,
                "criterion": criterion_text(until),
                "success": rate,
            }
    return worst or None


def _sentence(words: str) -> str:
    return words[0].upper() + words[1:]


class Change(NamedTuple):
    """Another value of a setting under `train`: the path of the setting, its present value and the advised
    one, both as text."""

    path: str
    before: str
    after: str
    verb: str = "set"

    def __str__(self) -> str:
        now = f" from {self.before}" if self.before else ""
        return f"{self.verb} `{self.path}`{now} to {self.after}"


def _settings(changes: Sequence[Change]) -> dict[str, str]:
    return {change.path: change.after for change in changes}


def _exploration_changes(evidence: TrainingEvidence, factor: float) -> list[Change]:
    """Return changes of the options for exploration that the algorithm has."""
    changes, settings, verb = list[Change](), evidence.settings, "raise" if factor > 1 else "lower"
    weight, chance = evidence.number_setting("ent_coef"), evidence.number_setting("exploration_final_eps")
    noise = getattr(settings.get("action_noise"), "sigma", None)
    if weight is not None and (weight or factor > 1):
        changes.append(Change("train.ent_coef", f"{weight:g}", f"{weight * factor or 0.01:.2g}", verb))
    elif isinstance(settings.get("ent_coef"), str):
        size = len(evidence.program.agent.range_names)
        changes.append(
            Change(
                "train.target_entropy",
                f"{settings.get('target_entropy')}",
                f"{-size * (0.5 if factor > 1 else 2):g}",
            )
        )
    if noise is not None and (noise.end or factor > 1):
        advised = (
            f"{max(0.3, 2 * noise.start):.2g}" if factor > 1 else f"{noise.start:g} -> {0.1 * noise.end:.2g}"
        )
        path, value = evidence.noise_setting(advised)
        changes.append(Change(path, noise.text, value, verb))
    if chance is not None and (chance or factor > 1):
        wanted_chance = max(chance, min(0.3, 3 * chance or 0.1)) if factor > 1 else 0.1 * chance
        changes.append(Change("train.exploration_final_eps", f"{chance:g}", f"{wanted_chance:.2g}", verb))
    return [change for change in changes if change.after != change.before]


@statement(
    "exploration_too_large",
    "The policy is still random: after {updates} updates it has {randomness} its initial randomness (entropy"
    " {entropy}), with `ent_coef` {weight}. The mean return of late training episodes is {late}{evaluated}.",
    advice="Lower `train.ent_coef` from {weight} to {wanted}.",
)
def exploration_too_large(evidence: TrainingEvidence) -> Numbers | None:
    weight, random = evidence.number_setting("ent_coef"), _random_entropy(evidence)
    entropy, spread = -evidence.curve("train/entropy_loss"), evidence.curve("train/std")
    if not weight or not len(entropy) or (random is None and not len(spread)):
        return None
    late = float(entropy[-max(1, len(entropy) // 4) :].mean())
    share = float(spread[-1] / spread[0]) if random is None else late / random
    if share < (1.2 if random is None else 0.97):
        return None
    last = fmean(evidence.evaluations[-1]["returns"]) if evidence.evaluations else None
    return {
        "likelihood": 0.93 if weight >= 0.1 else 0.5,
        "weight": weight,
        "entropy": late,
        "share": Percentage(share),
        "randomness": f"{Percentage(share)} of" if share < 10 else "more than 10 times",
        "updates": len(entropy),
        "late": float(evidence.episodes_between(0.75, 1.0).returns.mean()),
        "last_evaluation": last,
        "evaluated": ""
        if last is None
        else f", and that of the last evaluation, without exploration, {last:.3g}",
        "wanted": min(0.01, 0.1 * weight),
        "settings": {"train.ent_coef": f"{min(0.01, 0.1 * weight):.3g}"},
    }


def _random_entropy(evidence: TrainingEvidence) -> float | None:
    """Return the entropy of a random policy; None where not all parts of the action are choices."""
    agent = evidence.program.agent
    return None if agent.ranges else float(np.log([len(choice.options) for choice in agent.choices]).sum())


@statement(
    "exploration_collapsed",
    "The policy hardly explores: {measure} is {value} after {steps} steps. Below {least}, a policy finds"
    " hardly anything new.",
    advice="{remedy}.",
)
def exploration_collapsed(evidence: TrainingEvidence) -> Numbers | None:
    rate, more = evidence.number_setting("learning_rate"), _exploration_changes(evidence, 10.0)
    slower = (
        []
        if rate is None
        else [
            Change("train.learning_rate", f"{rate:g}", f"{min(rate / 3, _usual_rate(evidence)):.1g}", "lower")
        ]
    )
    remedy = _sentence(" or ".join(map(str, [*more, *slower])) or "raise the noise of the algorithm")
    settings = _settings(more or slower)
    sigma = getattr(getattr(evidence.settings.get("action_noise"), "sigma", None), "start", None)
    if sigma == 0:
        return {
            "likelihood": 0.85,
            "measure": "the standard deviation of the action noise",
            "value": 0.0,
            "least": 0.1,
            "steps": evidence.steps,
            "remedy": remedy,
            "settings": settings,
        }
    random, measures = _random_entropy(evidence), []
    if random is not None:
        measures.append(("the entropy of the policy", -evidence.curve("train/entropy_loss"), 0.05 * random))
    for measure, curve, least in [
        *measures,
        ("the standard deviation of the actions", evidence.curve("train/std"), 0.05),
    ]:
        if len(curve) >= MIN_EPISODES and (value := float(curve[len(curve) // 2])) < least:
            return {
                "likelihood": 0.6,
                "steps": evidence.steps // 2,
                "measure": measure,
                "value": value,
                "least": least,
                "remedy": remedy,
                "settings": settings,
            }
    return None


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
    silent_terms,
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
    exploration_delays_stage,
    exploration_too_large,
    exploration_collapsed,
    # The end
    kept_by_return,
    missed_condition,
    success_plateau,
    one_ending,
    stopped_early,
    too_few_steps,
)
"""The causes of a training that does not learn. Among causes that are as likely, the first one of this list
comes first."""
