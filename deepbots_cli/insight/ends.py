"""Causes at the end of a training: it was too short, it stopped too early, or it kept another model than the
best one."""

from __future__ import annotations

from collections import Counter
from functools import partial
from shlex import quote
from typing import Any

from deepbots_cli.document.files import display_path
from deepbots_cli.insight.stages import needs_exploration, plateau
from deepbots_cli.insight.statements import Numbers, Percentage, statement
from deepbots_cli.insight.training import (
    MIN_EPISODES,
    TrainingEvidence,
    Trend,
    return_trend,
    success_trend,
    usual_settings,
)
from deepbots_cli.learning.report import longer_goal
from deepbots_cli.words import number_text, rate_text

TOTAL_TIMESTEPS = "train.total_timesteps"
"""The setting whose new value continues a training. A new value of another setting begins another
training."""
_FAR = 10
"""The number of trainings from which a longer training is not the first advice."""
_SHORTER_LIKELIHOOD = 0.895
"""The likelihood of a training that is shorter than a solved one: before all else that has changed since."""


@statement(
    "one_ending",
    "'{ending}' ends {share} of the last {episodes} episodes, after {length} steps on average.",
    advice="Run `deepbots diagnose RUN --episode failed`: it shows the value and the threshold of this"
    " ending in one of these episodes.",
)
def one_ending(evidence: TrainingEvidence) -> Numbers | None:
    late = evidence.episodes_between(0.75, 1.0)
    if len(late) < MIN_EPISODES:
        return None
    name, count = Counter(late.endings).most_common(1)[0]
    share = count / len(late)
    is_failure = name in evidence.program.failures
    if (
        not is_failure
        or share < 0.9
        or len(evidence.program.endings) < 2
        or return_trend(evidence).direction == "rises"
    ):
        return None
    return {
        "likelihood": 0.25,
        "ending": name,
        "share": Percentage(share),
        "episodes": len(late),
        "length": float(late.lengths.mean()),
    }


@statement(
    "stopped_early",
    "The training stopped after {steps} of {planned} steps, {reason}. {verdict}: {result}.",
    advice="{advice}",
)
def stopped_early(evidence: TrainingEvidence) -> Numbers | None:
    result, evaluation = evidence.run.record.result, evidence.verdict.evaluation
    if (
        result is None
        or result.solved_at is None
        or evidence.is_running
        or evidence.verdict.solved is not False
        or evaluation is None
    ):
        return None
    if evidence.steps > 0.95 * evidence.run.record.total_timesteps or needs_exploration(evidence) is not None:
        return None
    return {
        **training_length(evidence, evidence.run.record.total_timesteps),
        "likelihood": 0.9,
        "planned": evidence.run.record.total_timesteps,
        "reason": "because a confirmation, of new episodes without exploration, met `solved`",
        "verdict": f"An evaluation of {evaluation.episodes:,} episodes does not meet it",
        "result": evaluation.text,
    }


@statement(
    "too_few_steps",
    "{finding}. The training has made {steps} steps in {episodes} episodes; the scenario sets {planned}"
    " steps.",
    advice="{advice}",
)
def too_few_steps(evidence: TrainingEvidence) -> Numbers | None:
    length, success, trend = training_length(evidence), success_trend(evidence), return_trend(evidence)
    measure, form = "mean return", partial(number_text, digits=3)
    if success.direction == "rises":
        measure, form, trend = "success rate", partial(rate_text, decimals=1), success
    elif plateau(evidence) is not None:
        return None
    if trend.direction == "rises":
        numbers = {**length, "first": trend.before, "last": trend.late, "gain": trend.gain}
        if measure == "mean return" and (too_slow := _too_slow(evidence, trend)) is not None:
            return {**numbers, **too_slow}
        before, late = (form(value) for value in (trend.before, trend.late))
        whole = f"stage '{evidence.stage}'" if evidence.stage else "the training"
        return {
            **numbers,
            "likelihood": 0.8 if length["share"] < 0.5 else 0.65,
            "finding": f"The policy still learns: the {measure} rises from {before} in the second quarter of"
            f" {whole} to {late} in the last one",
        }
    if length["share"] >= 0.5 or evidence.is_running:
        return None
    result = None if evidence.earlier_solved is None else evidence.earlier_solved[0].record.result
    if evidence.earlier_solved is None or result is None:
        return {**length, "likelihood": 0.5, "finding": "The training is short"}
    if result.steps <= evidence.steps:  # then the length is not a cause
        return None
    earlier = display_path(evidence.earlier_solved[0].path)
    finding = f"The training is shorter than {earlier}, which made {result.steps:,} steps and was solved"
    return {**length, "likelihood": _SHORTER_LIKELIHOOD, "finding": finding}


def _too_slow(evidence: TrainingEvidence, trend: Trend) -> dict[str, Any] | None:
    """Return what to change if the mean return of `solved` is many trainings away; None if it is not.

    The return is extrapolated: it goes on to rise as from the second quarter of the training to its last one.
    """
    solved = evidence.program.agent.solved
    if solved is None or solved.mean_return is None or not evidence.is_last_stage:
        return None
    steps = (solved.mean_return - trend.late) * 0.5 * evidence.stage_steps / trend.gain
    if steps <= _FAR * max(evidence.planned, evidence.steps):
        return None
    settings, change = {}, "reward progress towards the task in small steps, or let a script teach the policy"
    rate, usual = evidence.number_setting("learning_rate"), usual_settings(evidence).get("learning_rate")
    if rate and isinstance(usual, int | float) and rate < usual:
        settings = {"train.learning_rate": f"{usual:g}"}
        change = f"raise `train.learning_rate` from {rate:g} to {usual:g}"
    return {
        "likelihood": 0.6,
        "finding": "The policy learns too slowly: the mean return of the last quarter of the training is"
        f" {number_text(trend.late, 3)}, {number_text(trend.gain, 3)} above that of the second. At this rate,"
        f" {solved.mean_return:g}"
        f" is about {float(f'{steps:.2g}'):,.0f} steps away",
        "left": steps,
        "advice": f"Change something before you train longer: {change}.",
        "settings": {} if evidence.is_running else settings,
    }


def training_length(evidence: TrainingEvidence, planned: int = 0) -> dict[str, Any]:
    """Return the length of a training, and the way to continue it: to the `planned` steps if they are more
    than 1.1 times as many, else further."""
    more = planned if planned > 1.1 * evidence.steps else max(evidence.planned, longer_goal(evidence.steps))
    command = f"deepbots resume {quote(display_path(evidence.run.path))} --timesteps {more:_}"
    advice = f"Continue the training with `{command}`."
    if evidence.is_running:
        advice = (
            f"Let it run: {evidence.steps:,} of {evidence.run.record.total_timesteps:,} steps have been made."
        )
    return {
        "steps": evidence.steps,
        "episodes": len(evidence.all_episodes),
        "planned": evidence.planned,
        "share": Percentage(evidence.steps / evidence.planned),
        "more": more,
        "advice": advice,
        "settings": {} if evidence.is_running else {TOTAL_TIMESTEPS: f"{more:_}"},
    }
