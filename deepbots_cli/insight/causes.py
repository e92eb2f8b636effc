"""Causes beside the reward, the learner and the stages: the observation, scripts that teach, the other
agents, the end of the training, and what changed since a run that was solved."""

from __future__ import annotations

from functools import partial
from itertools import combinations
from pathlib import Path
from shlex import quote
from typing import Any, NamedTuple

import numpy as np

from deepbots_cli.analysis import unobserved_reads
from deepbots_cli.document.files import display_path
from deepbots_cli.document.nodes import follow_dotted
from deepbots_cli.insight.stages import needs_exploration, plateau
from deepbots_cli.insight.statements import Numbers, Percentage, SuccessRate, list_text, statement
from deepbots_cli.insight.trace import Array
from deepbots_cli.insight.training import (
    MIN_EPISODES,
    TrainingEvidence,
    Trend,
    commonest_ending,
    return_trend,
    success_trend,
    usual_settings,
)
from deepbots_cli.learning.report import longer_goal
from deepbots_cli.learning.runs.records import PoolGames
from deepbots_cli.learning.runs.statistics import wilson
from deepbots_cli.learning.runs.verdict import SEED, ChangedValue
from deepbots_cli.program.task import SAME_OBSERVATION, Observation
from deepbots_cli.words import number_text, rate_text

_MOST, _MOST_LIKELIHOOD = 0.75, 0.95
"""The share of the numbers that counts as most of them, and the likelihood of a cause that concerns most."""
_PER_CONSTANT_SHARE, _PER_CLIPPED_SHARE = 0.35, 0.55
"""The likelihood of a cause that concerns fewer, per share of the numbers: of constant and of clipped
ones."""
_MAX_CONSTANT_SPAN = 0.01
"""A number of the observation, from -1 to 1, that varies by less hardly changes."""
_MIN_CLIPPED_SHARE, _MIN_LOST_SPREAD = 0.4, 0.1
"""A number is saturated if it is clipped in this share of the moments, and the clipped values differ by this
share of its range."""
_ALMOST_ALWAYS, _ALMOST_ALWAYS_LIKELIHOOD = 0.8, 0.85
"""The share of the moments that counts as almost always, and the likelihood if the saturated numbers are
clipped almost always."""


def _likelihood(share: float, per_share: float) -> float:
    return _MOST_LIKELIHOOD if share >= _MOST else per_share * share


@statement(
    "sensor_without_reading",
    "{count} of {of} measured numbers of the observation never changed in {moments} moments ({values}):"
    " {guess}.",
    advice="Check the position and direction of these sensors, and that something is in their range:"
    " `deepbots view RUN` draws the rays of sensors. Or remove the values from `observation`.",
)
def sensor_without_reading(evidence: TrainingEvidence) -> Numbers | None:
    spans = _spans(evidence)
    still = [name for name, (span, _) in spans.items() if span < SAME_OBSERVATION]
    if not still:
        return None
    at_end = [name for name in still if abs(spans[name][1]) > 1 - SAME_OBSERVATION]
    guess = "these sensors detect nothing, or nothing changes these values"
    if len(at_end) == len(still):
        guess = "they are always at an end of their range, like a sensor that detects nothing"
    share = len(still) / len(spans)
    values = list_text([f"{name} always {_unscaled(evidence, name, spans[name][1])}" for name in still])
    return {
        "likelihood": _likelihood(share, _PER_CONSTANT_SHARE),
        "count": len(still),
        "of": len(spans),
        "moments": evidence.probe_moments,
        "names": still,
        "values": values,
        "guess": guess,
    }


def _spans(evidence: TrainingEvidence) -> dict[str, tuple[float, float]]:
    """Return, for each number of the observation, the range that it spans in the short episodes, and its
    first value.

    The previous action is left out, and so are parameters and values that depend on parameters alone: no
    sensor measures them.
    """
    if evidence.probe_moments < 2 * MIN_EPISODES:
        return {}
    rows = np.concatenate([trace.observations for trace in evidence.probes])
    spans = zip(np.ptp(rows, axis=0), rows[0], strict=True)
    return {
        number.full_name: (float(span), float(first))
        for number, (span, first) in zip(evidence.program.agent.numbers, spans, strict=True)
        if number.name != "previous_action" and evidence.facts.is_measured(number)
    }


def _unscaled(evidence: TrainingEvidence, name: str, value: float) -> str:
    """Return a number of the observation, from -1 to 1, as the value that it represents."""
    number = next(entry for entry in evidence.program.agent.numbers if entry.full_name == name)
    if number.is_truth:
        return "true" if value else "false"
    return evidence.facts.range_text(number, number.low + (value + 1) / 2 * (number.high - number.low))


@statement(
    "constant_observation",
    "{count} of {of} measured numbers of the observation hardly change ({names}): in {moments} moments, after"
    " mapping to [-1, 1], they vary by at most {span}.",
    advice="Narrow their ranges under `observation` to the values that occur: `deepbots inspect RUN` lists"
    " the ranges.",
)
def constant_observation(evidence: TrainingEvidence) -> Numbers | None:
    spans = _spans(evidence)
    names = [name for name, (span, _) in spans.items() if SAME_OBSERVATION <= span < _MAX_CONSTANT_SPAN]
    if not names:
        return None
    share = len(names) / len(spans)
    return {
        "likelihood": _likelihood(share, _PER_CONSTANT_SHARE),
        "count": len(names),
        "of": len(spans),
        "moments": evidence.probe_moments,
        "names": list_text(names),
        "span": max(spans[name][0] for name in names),
    }


@statement(
    "saturated_observation",
    "{count} of {of} clipped numbers of the observation are outside their range in {share} of the moments"
    " ({names}). The clipped values differ by up to {lost} times the range.",
    advice="Widen their ranges under `observation`: the policy cannot distinguish values outside a range.",
)
def saturated_observation(evidence: TrainingEvidence) -> Numbers | None:
    if evidence.probe_moments < 2 * MIN_EPISODES:
        return None
    beyond = {
        entry.name: _beyond(evidence, entry)
        for entry in evidence.program.agent.observation
        if entry.clip and entry.name != "previous_action"
    }
    cut = {
        n.full_name: excess
        for e in evidence.program.agent.observation
        for n, excess in zip(e.numbers, beyond.get(e.name, ()), strict=False)
    }
    shares = {name: float((excess != 0).mean()) for name, excess in cut.items()}
    # Clipping holds a value such as the reading of a sensor that sees nothing at an end, and loses nothing if
    # it is always the same one.
    spreads = {
        name: max(_spread(excess[excess > 0]), _spread(excess[excess < 0])) for name, excess in cut.items()
    }
    worst = sorted(
        (
            name
            for name, share in shares.items()
            if share >= _MIN_CLIPPED_SHARE and spreads[name] >= _MIN_LOST_SPREAD
        ),
        key=lambda name: -shares[name],
    )
    if not worst:
        return None
    clipped_share, mean = len(worst) / len(shares), float(np.mean([shares[name] for name in worst]))
    likelihood = _likelihood(clipped_share, _PER_CLIPPED_SHARE)
    # Numbers that are almost always beyond an end come before the length of the training.
    if mean >= _ALMOST_ALWAYS:
        likelihood = max(likelihood, _ALMOST_ALWAYS_LIKELIHOOD)
    return {
        "likelihood": likelihood,
        "count": len(worst),
        "of": len(shares),
        "names": list_text(worst),
        "share": Percentage(mean),
        "lost": max(spreads[name] for name in worst),
        "shares": shares,
    }


def _beyond(evidence: TrainingEvidence, entry: Observation) -> list[Array]:
    """Return how much each number of an entry lies above its range, or below it (negative), in all moments,
    as a share of the range."""
    key = evidence.probes[0].instrumented.observed_signals.get(entry.name)
    if key is None or entry.value.typed.type.boolean:
        return []
    rows = np.array([values[key] for trace in evidence.probes for values in trace.values], float)
    return [
        (row - row.clip(low, high)) / (high - low)
        for row, low, high in zip(rows.T, entry.low, entry.high, strict=True)
    ]


def _spread(values: Array) -> float:
    """Return the distance that contains 80 % of the values, from the lowest tenth to the highest."""
    return float(np.subtract(*np.quantile(values, (0.9, 0.1)))) if len(values) else 0.0


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
    rates = {name: SuccessRate.of(traces) for name, traces in evidence.scripts.items() if traces}
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
    final = [episode.is_success for episode in evidence.final_episodes] if evidence.is_last_stage else []
    return SuccessRate(final or evidence.episodes_between(0.75, 1.0).successes)


def _teacher(evidence: TrainingEvidence) -> str | None:
    """Return the script that teaches the policy."""
    training = evidence.program.agent.training
    return training.teacher.script if training is not None and training.teacher is not None else None


def _has_teacher(evidence: TrainingEvidence) -> bool:
    taught_by_file = evidence.run.demonstrations.exists() or evidence.run.teacher.exists()
    return taught_by_file or _teacher(evidence) is not None


def teacher_rate(evidence: TrainingEvidence) -> SuccessRate | None:
    """Return the success rate of the script that teaches: from the starts of the evaluations, as the training
    logged it, else in short episodes."""
    teacher, logged = _teacher(evidence), evidence.curve("teacher/success_rate")
    if teacher is None:
        return None
    sizes = [len(evaluation["successes"]) for evaluation in evidence.evaluations if "steps" in evaluation]
    if len(logged) and sizes:
        return SuccessRate.counted(round(float(logged[-1]) * sizes[-1]), sizes[-1])
    played = evidence.scripts.get(teacher, ())
    return SuccessRate.of(played) if played else None


@statement(
    "teacher_fails",
    "The teacher fails itself: '{script}' succeeds in {by_script}, and the policy that it teaches in"
    " {by_policy}. A policy hardly learns from a teacher what the teacher cannot do.",
    advice="Improve the script first: `deepbots try {scenario} --driver {script} --episodes 20` shows its"
    " endings. Or train without it.",
)
def teacher_fails(evidence: TrainingEvidence) -> Numbers | None:
    script, policy = teacher_rate(evidence), policy_rate(evidence)
    if script is None:
        return None
    solved = evidence.program.agent.solved
    required = _GOOD_TEACHER if solved is None or solved.success_rate is None else solved.success_rate
    if min(script.episodes, policy.episodes) < MIN_EPISODES or script.high >= max(required, _GOOD_TEACHER):
        return None
    if policy.rate < _AS_GOOD * script.rate or policy.rate >= required:
        return None
    return {
        "likelihood": 0.895,
        "script": _teacher(evidence),
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
    teacher = _teacher(evidence)
    if teacher is None or not (played := evidence.scripts.get(teacher)):
        return None
    script = SuccessRate.of(played)
    policy = SuccessRate.of(evidence.final_episodes) if evidence.final_episodes else evidence.late_success
    hidden = unobserved_reads(evidence.program, teacher)
    if not hidden or policy.episodes < MIN_EPISODES or policy.rate >= 0.9 * script.rate:
        return None
    longer = evidence.facts.history
    past = "`history: 4`" if longer == 1 else f"a `history` of more than the {longer} steps that it has"
    return {
        "likelihood": 0.88,
        "script": teacher,
        "names": " and ".join(f"`{text}`" for text in hidden[:3]),
        "by_script": script,
        "by_policy": policy,
        "hidden": hidden,
        "past": past,
    }


_HARDLY, _NEARLY_ALWAYS = 0.05, 0.9
"""The success rates at and below which an agent hardly succeeds, and from which a rival nearly always
does."""
_EARLY = 0.4
"""The share of the steps after which a rival must have been too strong in the rest of the training. A rival
that wins only in the end may lose again."""
_CHANGE = 0.2
"""The change of a success rate from which a rival got better."""
_PARTS = 3
"""The number of parts of this rest; the rival must be too strong in each."""


@statement(
    "rival_too_strong",
    "The rival is too strong: since {since} steps, `{agent}` succeeds in {own} of the episodes, and `{rival}`"
    " in {other}. Where nothing that it does succeeds, `{agent}` does not learn what is better.",
    advice="Let one learn while the other keeps its policy, with `turns` under `train`; train `{agent}`"
    " against a weaker `{rival}` first, with --agent {agent} --against {rival}=random, and begin with this"
    " policy (--initialize-from); or pay for what leads to a success.",
)
def rival_too_strong(evidence: TrainingEvidence) -> Numbers | None:
    episodes = evidence.all_episodes
    late = episodes.steps > _EARLY * evidence.steps
    late_indices = np.array_split(np.flatnonzero(late), _PARTS)
    if min(map(len, late_indices)) < MIN_EPISODES:
        return None
    for name, successes in evidence.rivals.items():
        if all(
            episodes.successes[indices].mean() <= _HARDLY and successes[indices].mean() >= _NEARLY_ALWAYS
            for indices in late_indices
        ):
            return {
                "likelihood": 0.94,
                "agent": evidence.agent,
                "rival": name,
                "since": int(episodes.steps[late_indices[0][0]]),
                "own": Percentage(episodes.successes[late].mean()),
                "other": Percentage(successes[late].mean()),
            }
    return None


@statement(
    "rival_improved",
    "The rival got better: `{agent}` succeeded in {own_before} of the episodes from {begin} to {since} steps,"
    " and in {own} of the last quarter; `{rival}` went from {other_before} to {other}. Against a rival that"
    " also learns, less success does not show that `{agent}` acts worse than before.",
    advice="Compare its policy with scripts and random actions: `deepbots compare {run}`. If it is no better"
    " than these, let one learn while the other keeps its policy, with `turns` under `train`.",
)
def rival_improved(evidence: TrainingEvidence) -> Numbers | None:
    quarters = np.array_split(np.arange(len(evidence.all_episodes.steps)), 4)
    if min(map(len, quarters)) < MIN_EPISODES:
        return None
    rates = [float(evidence.all_episodes.successes[quarter].mean()) for quarter in quarters]
    best = int(np.argmax(rates[:-1]))
    for name, successes in evidence.rivals.items():
        rival_rates = [float(successes[quarter].mean()) for quarter in quarters]
        if rates[best] - rates[-1] >= _CHANGE and rival_rates[-1] - rival_rates[best] >= _CHANGE:
            return {
                "likelihood": 0.7,
                "agent": evidence.agent,
                "rival": name,
                "begin": int(evidence.all_episodes.steps[quarters[best][0]]),
                "since": int(evidence.all_episodes.steps[quarters[best][-1]]),
                "own_before": Percentage(rates[best]),
                "own": Percentage(rates[-1]),
                "other_before": Percentage(rival_rates[best]),
                "other": Percentage(rival_rates[-1]),
                "run": quote(str(evidence.run.path)),
            }
    return None


class _Record(NamedTuple):
    """The games of the newest policy against a past version: the share of the wins, and its interval."""

    steps: int
    share: Percentage
    low: float
    high: float
    games: int

    @classmethod
    def of(cls, games: PoolGames) -> _Record | None:
        """Return the record of enough games, else None."""
        count = games.wins + games.losses
        if count < 2 * MIN_EPISODES:
            return None
        wins, decided = round(games.wins), round(count)
        low, high = wilson(min(wins, decided), decided)
        return cls(games.steps, Percentage(games.wins / count), low, high, decided)


@statement(
    "strategies_cycle",
    "The strategies go round in a circle: the newest policy wins {lost} of its decided games against the"
    " version of {old} steps, but {won} against the later version of {late} steps.",
    advice="Keep more past versions with a larger `pool` of `self_play`, and let fewer environments play the"
    " newest version against itself (`newest`), so that the policy meets the old strategies again.",
)
def strategies_cycle(evidence: TrainingEvidence) -> Numbers | None:
    result = evidence.run.record.result
    records = [] if result is None else [_Record.of(games) for games in result.pool_games]
    pairs = combinations([record for record in records if record is not None], 2)
    lost = [(old, late) for old, late in pairs if old.high < 0.5 < late.low]
    if not lost:
        return None
    old, late = min(lost, key=lambda pair: pair[0].share)
    return {
        "likelihood": 0.9,
        "old": old.steps,
        "late": late.steps,
        "lost": old.share,
        "won": late.share,
        "games": [old.games, late.games],
    }


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
    name, share = commonest_ending(late)
    if (
        name not in evidence.program.failures
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


_MAX_SHOWN = 4
_LIKELIHOOD = 0.89
"""The likelihood that orders this fact: after certain causes (0.9), and before all others."""


@statement(
    "changed_since_solved",
    "Changed since {earlier}, which was solved: {changed}.",
    advice="Set {them} back and train again: the task is solved once more if this value is the reason. To"
    " keep a value, adapt what depends on it, such as endings, ranges of the observation, or the length of"
    " the training.",
)
def changed_since_solved(evidence: TrainingEvidence) -> Numbers | None:
    if evidence.verdict.solved or evidence.earlier_solved is None:
        return None
    earlier, values = evidence.earlier_solved
    if all(value.path == SEED for value in values):
        return None
    changes = [_change(value, evidence) for value in values]
    return {
        "likelihood": _LIKELIHOOD,
        "earlier": display_path(earlier.path),
        "changed": list_text(
            [_text(change, value) for change, value in zip(changes, values, strict=True)], _MAX_SHOWN
        ),
        "changes": changes,
        "them": "one of them" if len(changes) > 1 else "it",
    }


def _change(value: ChangedValue, evidence: TrainingEvidence) -> dict[str, Any]:
    """Return a changed value as JSON; `place` is its file and line."""
    root = evidence.linted.root
    _, node, unresolved = follow_dotted(root, value.path) if root is not None else ((), None, value.path)
    location = ""
    if node is not None and not unresolved:
        location = f"{display_path(Path(node.span.source.name))}:{node.span.start_position.line}"
    return {
        "path": value.path,
        "before": value.before,
        "after": value.after,
        **({"place": location} if location else {}),
        "is_written": value.is_written,
    }


def _text(change: dict[str, Any], value: ChangedValue) -> str:
    return f"{value} ({change['place']})" if "place" in change else str(value)
