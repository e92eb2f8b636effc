"""Causes in the teacher of the policy: a script that could teach, a teacher that fails itself, or one that
observes more."""

from __future__ import annotations

from deepbots_cli.analysis import unobserved_reads
from deepbots_cli.insight.statements import Numbers, SuccessRate, statement
from deepbots_cli.insight.training import MIN_EPISODES, TrainingEvidence

_GOOD_TEACHER = 0.8
"""The success rate below which a teacher is named, if `solved` has none."""
_AS_GOOD = 0.85
"""The share of the teacher's success rate from which a pupil is as good as its teacher."""


@statement(
    "script_succeeds",
    "A script is better than the policy: '{script}' succeeds in {by_script}, and the policy in {by_policy}.",
    advice="Let the script teach the policy, with `teacher: {script}` under `train`.",
)
def script_succeeds(evidence: TrainingEvidence) -> Numbers | None:
    policy = policy_rate(evidence)
    rates = {
        name: SuccessRate([trace.outcome == "success" for trace in traces])
        for name, traces in evidence.scripts.items()
        if traces
    }
    if not rates or policy.episodes < MIN_EPISODES or _has_teacher(evidence):
        return None
    name = max(rates, key=lambda script: rates[script].rate)
    # A script of less than 70 % hardly teaches what the policy cannot find itself.
    if rates[name].episodes < MIN_EPISODES or rates[name].rate < 0.7 or rates[name].low <= policy.high:
        return None
    return {
        "likelihood": 0.89,
        "script": name,
        "by_script": rates[name],
        "by_policy": policy,
        "settings": {"train.teacher": name},
    }


def policy_rate(evidence: TrainingEvidence) -> SuccessRate:
    """Return the success rate of the policy: in the quoted evaluation, else in the last quarter of the
    training."""
    episodes = [episode.is_success for episode in evidence.final_episodes] if evidence.is_last_stage else []
    return SuccessRate(episodes or evidence.episodes_between(0.75, 1.0).successes)


def _has_teacher(evidence: TrainingEvidence) -> bool:
    training = evidence.program.agent.training
    taught_by_file = evidence.run.demonstrations.exists() or evidence.run.teacher.exists()
    return taught_by_file or (training is not None and training.teacher is not None)


def teacher_rate(evidence: TrainingEvidence) -> SuccessRate | None:
    """Return the success rate of the script that teaches: from the starts of the evaluations, as the training
    logged it, else in short episodes."""
    training, logged = evidence.program.agent.training, evidence.curve("teacher/success_rate")
    if training is None or training.teacher is None:
        return None
    sizes = [len(evaluation["successes"]) for evaluation in evidence.evaluations if "steps" in evaluation]
    if len(logged) and sizes:
        won = round(float(logged[-1]) * sizes[-1])
        return SuccessRate([1.0] * won + [0.0] * (sizes[-1] - won))
    played = evidence.scripts.get(training.teacher.script, ())
    return SuccessRate([trace.outcome == "success" for trace in played]) if played else None


@statement(
    "teacher_fails",
    "The teacher fails itself: '{script}' succeeds in {by_script}, and the policy that it teaches in"
    " {by_policy}. A policy hardly learns from a teacher what the teacher cannot do.",
    advice="Improve the script first: `deepbots try {scenario} --driver {script} --episodes 20` shows its"
    " endings. Or train without it.",
)
def teacher_fails(evidence: TrainingEvidence) -> Numbers | None:
    training, script, policy = evidence.program.agent.training, teacher_rate(evidence), policy_rate(evidence)
    if training is None or training.teacher is None or script is None:
        return None
    solved = evidence.program.agent.solved
    required = _GOOD_TEACHER if solved is None or solved.success_rate is None else solved.success_rate
    if min(script.episodes, policy.episodes) < MIN_EPISODES or script.high >= max(required, _GOOD_TEACHER):
        return None
    if policy.rate < _AS_GOOD * script.rate or policy.rate >= required:
        return None
    name = training.teacher.script
    return {
        "likelihood": 0.895,
        "script": name,
        "by_script": script,
        "by_policy": policy,
        "scenario": evidence.scenario_argument,
    }


@statement(
    "teacher_sees_more",
    "The teacher sees more than the policy: '{script}' reads {names}, which the policy does not observe, so"
    " it acts differently in states that look the same to the policy. It succeeds in {by_script}, and the"
    " policy in {by_policy}.",
    advice="Add what the teacher reads to `observation`. If a robot could not measure it, show the policy"
    " more of the past: {past} for the sensors that change with it.",
)
def teacher_sees_more(evidence: TrainingEvidence) -> Numbers | None:
    training = evidence.program.agent.training
    if (
        training is None
        or training.teacher is None
        or not (played := evidence.scripts.get(training.teacher.script))
    ):
        return None
    script = SuccessRate([trace.outcome == "success" for trace in played])
    policy = (
        SuccessRate([episode.is_success for episode in evidence.final_episodes])
        if evidence.final_episodes
        else evidence.late_success
    )
    hidden = unobserved_reads(evidence.program, training.teacher.script)
    if not hidden or policy.episodes < MIN_EPISODES or policy.rate >= 0.9 * script.rate:
        return None
    longer = evidence.facts.history
    past = "`history: 4`" if longer == 1 else f"a `history` of more than the {longer} steps that it has"
    return {
        "likelihood": 0.88,
        "script": training.teacher.script,
        "names": " and ".join(f"`{text}`" for text in hidden[:3]),
        "by_script": script,
        "by_policy": policy,
        "hidden": hidden,
        "past": past,
    }
