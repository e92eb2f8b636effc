"""`CAUSES`, the table of reasons why a policy does not learn, each with its condition, evidence and advice;
and `diagnose`, which lists those of a training, the most likely first.

A row applies to the evidence of a training, its logs and short episodes, or does not. Numbers that need more
than an expression are computed by functions: here, in `rewards.py`, `stages.py` or `learner.py`. `likelihood`
orders the rows: observed causes that make learning impossible come before those that often do, and both come
before possible symptoms.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations
from pathlib import Path, PurePath
from shlex import join
from typing import Any, NamedTuple

import numpy as np

from deepbots_cli.analysis import unobserved_reads
from deepbots_cli.compiler.inputs import ELSEWHERE
from deepbots_cli.diagnostics import Finding
from deepbots_cli.diagnostics.registry import RULES
from deepbots_cli.document import Permissions
from deepbots_cli.document.files import display_path
from deepbots_cli.document.nodes import Node, ScalarNode, follow_dotted, walk
from deepbots_cli.errors import RunError
from deepbots_cli.insight import learner, rewards, stages
from deepbots_cli.insight.rewards import per_step
from deepbots_cli.insight.scenario_facts import training_command
from deepbots_cli.insight.stages import is_rare, needs_exploration, plateau
from deepbots_cli.insight.statements import (
    Numbers,
    Percentage,
    Statement,
    StatementRule,
    SuccessRate,
    list_text,
    sentence,
    statements_about,
)
from deepbots_cli.insight.trace import Array, Trace
from deepbots_cli.insight.training import (
    MIN_EPISODES,
    TOTAL_TIMESTEPS,
    TrainingEvidence,
    Trend,
    commonest_ending,
    latest_failure,
    read_trainings,
    run_probes,
)
from deepbots_cli.learning.environments import Failure
from deepbots_cli.learning.multi_agent import SHARED
from deepbots_cli.learning.runs.run import PoolGames, Run
from deepbots_cli.learning.runs.statistics import wilson
from deepbots_cli.learning.runs.verdict import SEED, ChangedValue
from deepbots_cli.program.task import SAME_OBSERVATION, Observation
from deepbots_cli.words import number_text, rate_text, shell_word

# Faults


def _error(failure: Failure | None) -> str:
    """Return the error of an episode, within a sentence."""
    if failure is None:
        return "the last value in its log is not a number (NaN)"
    return f"episode {failure.episode:,}, {failure.error}".rstrip(".")


def action_without_effect(evidence: TrainingEvidence) -> Numbers | None:
    indices = [
        index
        for index, number in enumerate(evidence.program.agent.numbers)
        if number.name != "previous_action"
    ]
    tested = {part: [*traces.values()] for part, traces in evidence.constant_actions.items()}
    dead = {
        part: min(trace.steps for trace in traces)
        for part, traces in tested.items()
        if len(traces) > 1 and all(_is_same(*pair, indices) for pair in combinations(traces, 2))
    }
    if not any(dead.values()):
        return None
    return {
        "likelihood": 0.98 if len(dead) == len(tested) else 0.8,
        "parts": list_text([*dead]),
        "count": len(dead),
        "of": len(tested),
        "steps": min(dead.values()),
        "difference": 0.0,
    }


def _is_same(first: Trace, second: Trace, numbers: Sequence[int]) -> bool:
    """Return whether these numbers of the observation and the values that the endings compare are the
    same."""
    if first.steps != second.steps:
        return False
    pairs = zip(first.values, second.values, strict=True)
    differences = [abs(a - b) for x, y in pairs for key in x for a, b in zip(x[key], y[key], strict=True)]
    largest = np.abs(first.observations[:, numbers] - second.observations[:, numbers]).max(initial=0.0)
    return bool(max(largest, *differences, 0.0) < SAME_OBSERVATION)


# Lint

_UNLEARNABLE = {
    "DB705": "failing early pays",
    "DB708": "avoiding the success pays more than the success",
    "DB711": "every policy earns the same",
    "DB807": "the success is out of reach",
    "DB810": "`solved` asks for what no policy can miss or reach",
}
"""The meaning of findings of lint for a training that cannot learn its task."""
_EXPLOITS = {"DB708", "DB717"}
"""Findings of payments that a policy can collect without success."""


def lint_warns(evidence: TrainingEvidence) -> Numbers | None:
    linted, refuted = evidence.linted, _refuted(evidence)
    meanings = {code: text for code, text in _UNLEARNABLE.items() if not refuted.get(code)}
    early = _BY_NAME["ending_early_pays"]
    # This cause says the same from the episodes.
    repeated = {"DB705"} if early.when(evidence) and early.numbers(evidence) else set()
    # If the training continues, a policy that has learned the task may still discover a reward without
    # success.
    concerned = [
        finding
        for finding in linted.findings
        if finding.code not in repeated
        and (finding.code in _EXPLOITS or not (evidence.learned or _is_of_foreign_robot(finding)))
    ]
    if not concerned:
        return None
    first, *others = sorted(concerned, key=lambda finding: finding.code not in meanings)
    reported = list_text([f"{finding.headline} ({finding.code})" for finding in others], 2)
    title = meanings.get(first.code) or f"lint warns about {RULES[first.code].summary}"
    changed = linted.changed_source
    copy = f" It is the copy that the training read: {changed} was changed since then." if changed else ""
    return {
        "likelihood": 0.91 if first.code in meanings else 0.3,
        "title": title,
        "meaning": sentence(title),
        "finding": first.headline,
        "code": first.code,
        "count": len(concerned),
        "others": f" Lint also reports: {reported}." if others else "",
        "help": sentence(first.help or "Change what the finding names"),
        "codes": [finding.code for finding in (first, *others)],
        "path": linted.arguments,
        "copy": copy,
        "settings": {} if evidence.agent else _fixed_value(linted.root, first),
    }


def _fixed_value(root: Node | None, finding: Finding) -> dict[str, str]:
    """Return the value that the fix of a finding writes in place of another one, by its path; empty for any
    other fix."""
    edits = finding.fix.edits if finding.fix is not None else ()
    if root is None or len(edits) != 1:
        return {}
    span = edits[0].span
    return {
        ".".join(map(str, path)): edits[0].text
        for path, node in walk(root)
        if isinstance(node, ScalarNode)
        and node.text == span.text
        and node.span.source == span.source
        and node.span.start <= span.start <= span.end <= node.span.end
    }


def _refuted(evidence: TrainingEvidence) -> Mapping[str, bool]:
    """Return whether the episodes of a training refute findings of lint, by their codes."""
    late, episodes = evidence.late, evidence.episodes
    won, lost = late.returns[late.successes > 0], late.returns[late.successes == 0]
    return {
        # Successes at the end of the training have the higher mean return.
        "DB708": min(len(won), len(lost)) >= MIN_EPISODES and bool(won.mean() > lost.mean()),
        "DB711": len(episodes) > 1 and float(np.ptp(episodes.returns)) > 0.0,
        "DB807": bool(episodes.successes.any()),
    }


def _is_of_foreign_robot(finding: Finding) -> bool:
    """Return whether a finding is in the copy of a robot file outside the project, such as one of a package.
    Lint leaves out warnings about files of packages, which a copy no longer names."""
    path = PurePath(finding.span.source.name)
    return path.suffix == ".urdf" and any(name.startswith(ELSEWHERE) for name in path.parts)


# The observation

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


def hardly_changing(evidence: TrainingEvidence, low: float, high: float) -> Numbers | None:
    """Return the numbers of the observation that span from `low` to less than `high` in the short episodes.

    The previous action is left out, and so are parameters and values that depend on parameters alone: no
    sensor measures them.
    """
    if evidence.probe_moments < 2 * MIN_EPISODES:
        return None
    rows = np.concatenate([trace.observations for trace in evidence.probes])
    columns = [
        (number, float(span), float(first))
        for number, span, first in zip(
            evidence.program.agent.numbers, np.ptp(rows, axis=0), rows[0], strict=True
        )
        if number.name != "previous_action" and evidence.facts.is_measured(number)
    ]
    still = [column for column in columns if low <= column[1] < high]
    if not still:
        return None
    return {
        "likelihood": _likelihood(len(still) / len(columns), _PER_CONSTANT_SHARE),
        "count": len(still),
        "of": len(columns),
        "moments": evidence.probe_moments,
        "names": list_text([number.full_name for number, _, _ in still]),
        "span": max(span for _, span, _ in still),
        "values": list_text(
            [
                f"{number.full_name} always {evidence.facts.seen_text(number, first)}"
                for number, _, first in still
            ]
        ),
        "guess": "they are always at an end of their range, like a sensor that detects nothing"
        if all(abs(first) > 1 - SAME_OBSERVATION for _, _, first in still)
        else "these sensors detect nothing, or nothing changes these values",
    }


def saturated_observation(evidence: TrainingEvidence) -> Numbers | None:
    cut = {
        number.full_name: excess
        for entry in evidence.program.agent.observation
        if entry.clip and entry.name != "previous_action"
        for number, excess in zip(entry.numbers, _beyond(evidence, entry), strict=False)
    }
    shares = {name: float((excess != 0).mean()) for name, excess in cut.items()}
    # Clipping holds a value such as the reading of a sensor that sees nothing at an end, and loses nothing if
    # it is always the same one.
    spreads = {
        name: max(_spread(excess[excess > 0]), _spread(excess[excess < 0])) for name, excess in cut.items()
    }
    clipped = [
        name for name in cut if shares[name] >= _MIN_CLIPPED_SHARE and spreads[name] >= _MIN_LOST_SPREAD
    ]
    if not clipped:
        return None
    mean = float(np.mean([shares[name] for name in clipped]))
    likelihood = _likelihood(len(clipped) / len(shares), _PER_CLIPPED_SHARE)
    # Numbers that are almost always beyond an end come before the length of the training.
    at_least = _ALMOST_ALWAYS_LIKELIHOOD if mean >= _ALMOST_ALWAYS else 0.0
    return {
        "likelihood": max(likelihood, at_least),
        "count": len(clipped),
        "of": len(shares),
        "names": list_text(sorted(clipped, key=lambda name: -shares[name])),
        "share": Percentage(mean),
        "lost": max(spreads[name] for name in clipped),
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


# Teachers

_GOOD_TEACHER = 0.8
"""The success rate below which a teacher is named, if `solved` has none."""
_AS_GOOD = 0.85
"""The share of the teacher's success rate from which a pupil is as good as its teacher."""


def script_succeeds(evidence: TrainingEvidence) -> Numbers | None:
    rates, policy = evidence.script_rates, evidence.policy_rate
    name = max(rates, key=lambda script: rates[script].rate)
    # A script of less than 70 % hardly teaches what the policy cannot find itself.
    if policy.episodes < MIN_EPISODES or rates[name].rate < 0.7 or rates[name].low <= policy.high:
        return None
    settings = {"train.teacher": name}
    return {"script": name, "by_script": rates[name], "by_policy": policy, "settings": settings}


def teacher_fails(evidence: TrainingEvidence) -> Numbers | None:
    script, policy, solved = _teacher_rate(evidence), evidence.policy_rate, evidence.program.agent.solved
    required = _GOOD_TEACHER if solved is None or solved.success_rate is None else solved.success_rate
    if min(script.episodes, policy.episodes) < MIN_EPISODES or script.high >= required:
        return None
    if policy.rate < _AS_GOOD * script.rate or policy.rate >= required:
        return None
    numbers = {"script": evidence.teacher, "by_script": script, "by_policy": policy}
    return {**numbers, "scenario": evidence.scenario_argument}


def _teacher_rate(evidence: TrainingEvidence) -> SuccessRate:
    """Return the success rate of the script that teaches: from the starts of the evaluations, as the training
    logged it, else in short episodes."""
    logged = evidence.curve("teacher/success_rate")
    sizes = [len(evaluation["successes"]) for evaluation in evidence.evaluations if "steps" in evaluation]
    if len(logged) and sizes:
        return SuccessRate.counted(round(float(logged[-1]) * sizes[-1]), sizes[-1])
    return SuccessRate.of(evidence.scripts.get(evidence.teacher or "", ()))


def teacher_sees_more(evidence: TrainingEvidence) -> Numbers | None:
    teacher, final = evidence.teacher or "", SuccessRate.of(evidence.final_episodes)
    script, policy = (
        SuccessRate.of(evidence.scripts[teacher]),
        final if final.episodes else evidence.late_success,
    )
    hidden, longer = unobserved_reads(evidence.program, teacher), evidence.facts.history
    if not hidden or policy.episodes < MIN_EPISODES or policy.rate >= 0.9 * script.rate:
        return None
    past = f"a `history` of more than the {longer} steps that it has"
    return {
        "script": teacher,
        "names": " and ".join(f"`{text}`" for text in hidden[:3]),
        "by_script": script,
        "by_policy": policy,
        "hidden": hidden,
        "past": "`history: 4`" if longer == 1 else past,
    }


# Other agents

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


def rival_too_strong(evidence: TrainingEvidence) -> Numbers | None:
    episodes = evidence.all_episodes
    late = np.flatnonzero(episodes.steps > _EARLY * evidence.steps)
    parts = np.array_split(late, _PARTS)
    for name, successes in evidence.rivals.items() if len(parts[-1]) >= MIN_EPISODES else ():
        ends = [(episodes.successes[part].mean(), successes[part].mean()) for part in parts]
        if all(own <= _HARDLY and other >= _NEARLY_ALWAYS for own, other in ends):
            return {
                "agent": evidence.agent,
                "rival": name,
                "since": int(episodes.steps[late[0]]),
                "own": Percentage(episodes.successes[late].mean()),
                "other": Percentage(successes[late].mean()),
            }
    return None


def rival_improved(evidence: TrainingEvidence) -> Numbers | None:
    quarters = np.array_split(np.arange(len(evidence.all_episodes.steps)), 4)
    for name, successes in evidence.rivals.items() if len(quarters[-1]) >= MIN_EPISODES else ():
        own, other = (
            [Percentage(values[quarter].mean()) for quarter in quarters]
            for values in (evidence.all_episodes.successes, successes)
        )
        best = int(np.argmax(own[:-1]))
        if own[best] - own[-1] >= _CHANGE and other[-1] - other[best] >= _CHANGE:
            begin, since = (int(evidence.all_episodes.steps[quarters[best][end]]) for end in (0, -1))
            return {
                "agent": evidence.agent,
                "rival": name,
                "begin": begin,
                "since": since,
                "own_before": own[best],
                "own": own[-1],
                "other_before": other[best],
                "other": other[-1],
                "run": shell_word(evidence.run.path),
            }
    return None


class _Games(NamedTuple):
    """The games of the newest policy against a past version: the share of the wins, and its interval."""

    steps: int
    share: Percentage
    low: float
    high: float
    decided: int


def _games(games: PoolGames) -> _Games:
    decided = round(games.wins + games.losses)
    interval = wilson(min(round(games.wins), decided), decided)
    return _Games(games.steps, Percentage(games.wins / (games.wins + games.losses)), *interval, decided)


def strategies_cycle(evidence: TrainingEvidence) -> Numbers | None:
    result = evidence.run.record.result
    games = [] if result is None else result.pool_games
    records = [_games(row) for row in games if row.wins + row.losses >= 2 * MIN_EPISODES]
    lost = [(old, late) for old, late in combinations(records, 2) if old.high < 0.5 < late.low]
    if not lost:
        return None
    old, late = min(lost, key=lambda pair: pair[0].share)
    return {
        "old": old.steps,
        "late": late.steps,
        "lost": old.share,
        "won": late.share,
        "games": [old.decided, late.decided],
    }


# The end of the training

_FAR = 10
"""The number of trainings from which a longer training is not the first advice."""


def stopped_early(evidence: TrainingEvidence) -> Numbers | None:
    record, evaluation = evidence.run.record, evidence.verdict.evaluation
    was_solved = record.result is not None and record.result.solved_at is not None
    is_early = evidence.steps <= 0.95 * record.total_timesteps and needs_exploration(evidence) is None
    if evaluation is None or not was_solved or not is_early:
        return None
    return {
        **evidence.length(record.total_timesteps),
        "planned": record.total_timesteps,
        "reason": "because a confirmation, of new episodes without exploration, met `solved`",
        "verdict": f"An evaluation of {evaluation.episodes:,} episodes does not meet it",
        "result": evaluation.text,
    }


def too_few_steps(evidence: TrainingEvidence) -> Numbers | None:
    length, trend = evidence.length(), evidence.return_trend
    measure, form = "mean return", partial(number_text, digits=3)
    if evidence.success_trend.direction == "rises":
        measure, form, trend = "success rate", partial(rate_text, decimals=1), evidence.success_trend
    elif plateau(evidence) is not None:
        return None
    if trend.direction == "rises":
        whole = f"stage '{evidence.stage}'" if evidence.stage else "the training"
        return {
            **length,
            "first": trend.before,
            "last": trend.late,
            "gain": trend.gain,
            "likelihood": 0.8 if length["share"] < 0.5 else 0.65,
            "finding": f"The policy still learns: the {measure} rises from {form(trend.before)} in the second"
            f" quarter of {whole} to {form(trend.late)} in the last one",
            **(_too_slow(evidence, trend) if measure == "mean return" else {}),
        }
    if length["share"] >= 0.5 or evidence.is_running:
        return None
    if evidence.earlier_solved is None:
        return {**length, "finding": "The training is short"}
    earlier, _ = evidence.earlier_solved
    steps = earlier.record.result.steps if earlier.record.result is not None else 0
    if steps <= evidence.steps:  # then the length is not a cause
        return None
    place = display_path(earlier.path)
    finding = f"The training is shorter than {place}, which made {steps:,} steps and was solved"
    # Before all else that has changed since the solved training.
    return {**length, "likelihood": 0.895, "finding": finding}


def _too_slow(evidence: TrainingEvidence, trend: Trend) -> dict[str, Any]:
    """Return what to change if the mean return of `solved` is many trainings away; nothing if it is not.

    The return is extrapolated: it goes on to rise as from the second quarter of the training to its last one.
    """
    solved = evidence.program.agent.solved
    if solved is None or solved.mean_return is None or not evidence.is_last_stage:
        return {}
    steps = (solved.mean_return - trend.late) * 0.5 * evidence.stage_steps / trend.gain
    if steps <= _FAR * max(evidence.planned, evidence.steps):
        return {}
    settings, change = {}, "reward progress towards the task in small steps, or let a script teach the policy"
    rate, usual = evidence.number_setting("learning_rate"), evidence.usual_settings.get("learning_rate")
    if rate and isinstance(usual, int | float) and rate < usual:
        settings = {"train.learning_rate": f"{usual:g}"}
        change = f"raise `train.learning_rate` from {rate:g} to {usual:g}"
    return {
        "likelihood": 0.6,
        "finding": "The policy learns too slowly: the mean return of the last quarter of the training is"
        f" {number_text(trend.late, 3)}, {number_text(trend.gain, 3)} above that of the second. At this rate,"
        f" {solved.mean_return:g} is about {float(f'{steps:.2g}'):,.0f} steps away",
        "left": steps,
        "advice": f"Change something before you train longer: {change}.",
        "settings": {} if evidence.is_running else settings,
    }


def changed_since_solved(evidence: TrainingEvidence) -> Numbers | None:
    earlier, values = evidence.earlier_solved or (evidence.run, [])
    if all(value.path == SEED for value in values):
        return None
    changes = [_change(value, evidence) for value in values]
    places = [f" ({change['place']})" if "place" in change else "" for change in changes]
    texts = [f"{value}{place}" for value, place in zip(values, places, strict=True)]
    return {
        "earlier": display_path(earlier.path),
        "changed": list_text(texts),
        "changes": changes,
        "them": "one of them" if len(changes) > 1 else "it",
    }


def _change(value: ChangedValue, evidence: TrainingEvidence) -> dict[str, Any]:
    """Return a changed value as JSON; `place` is its file and line, or its option."""
    root = evidence.linted.root
    _, node, unresolved = follow_dotted(root, value.path) if root is not None else ((), None, value.path)
    row = {"path": value.path, "before": value.before, "after": value.after, "is_written": value.is_written}
    if node is not None and not unresolved:
        line = "" if node.span.source.assigned else f":{node.span.start_position.line}"
        row["place"] = f"{display_path(Path(node.span.source.name))}{line}"
    return row


Cause = StatementRule[TrainingEvidence]

CAUSES: tuple[Cause, ...] = (
    # A fact, after certain causes and before all others
    Cause(
        name="changed_since_solved",
        title="values changed since {earlier}, which was solved",
        likelihood=0.89,
        when=lambda e: not e.verdict.solved and e.earlier_solved is not None,
        numbers=changed_since_solved,
        text="Changed since {earlier}, which was solved: {changed}.",
        advice="Set {them} back and train again: the task is solved once more if this value is the reason. To"
        " keep a value, adapt what depends on it, such as endings, ranges of the observation, or the length"
        " of the training.",
        command="diff {earlier} {run}",
    ),
    # Nothing to learn
    Cause(
        name="ending_at_reset",
        title="an episode cannot start",
        likelihood=1.0,
        when=lambda e: e.failure is not None and e.failure.ends_at_reset,
        numbers=lambda e: {"steps": e.steps, "error": _error(e.failure)},
        text="An episode cannot start after {steps} steps of training: {error}.",
        advice="Change the start under `reset` or the threshold of the ending. `lint --deep` counts the"
        " starts that end at once.",
        command="lint --deep {run}/resolved.yaml",
    ),
    Cause(
        name="not_finite",
        title="the training stopped with an error",
        likelihood=1.0,
        when=lambda e: e.has_failed and not (e.failure is not None and e.failure.ends_at_reset),
        numbers=lambda e: {"steps": e.steps, "error": _error(e.failure), "episodes": len(e.episodes)},
        text="The training stopped with an error after {steps} steps: {error}.",
        advice="Use max(...) to keep divisors and arguments of sqrt and log above 0, or lower"
        " `train.learning_rate`.",
    ),
    Cause(
        name="fell_apart",
        title="the training got worse after its best model",
        likelihood=0.9,
        numbers=learner.fell_apart,
        text="{fall}. {reasons}",
        advice="{advice} The best model is from before the fall: `deepbots view`, `eval` and `export` use"
        " it.",
    ),
    Cause(
        name="action_without_effect",
        title="{count} of {of} action parts have no effect",
        likelihood=0.98,
        numbers=action_without_effect,
        text="{count} of {of} action parts have no effect ({parts}): from the same start, all tested values"
        " give the same observations for {steps} steps.",
        advice="Check `apply` of the robot, the limits of its motors (`deepbots inspect RUN`), and the wheels"
        " or joints that it drives.",
        command="inspect {run}",
    ),
    Cause(
        name="ending_at_once",
        title="'{ending}' ends episodes before the policy can act",
        likelihood=0.96,
        when=lambda e: (
            len(e.episodes) >= MIN_EPISODES
            and np.quantile(e.episodes.lengths, 0.9) <= min(12, 0.2 * e.longest)
            and commonest_ending(e.episodes)[0] in e.program.failures
        ),
        numbers=lambda e: {
            "ending": commonest_ending(e.episodes)[0],
            "share": Percentage(commonest_ending(e.episodes)[1]),
            "length": float(np.median(e.episodes.lengths)),
            "long": float(np.quantile(e.episodes.lengths, 0.9)),
            "longest": e.longest,
        },
        text="Episodes end before the policy can act: '{ending}' ends {share} of them. Half of all episodes"
        " end within {length} steps and 90% within {long}, of {longest} possible steps.",
        advice="Loosen the threshold of '{ending}', or start farther away from it: `deepbots diagnose RUN"
        " --episode failed` shows the value and the threshold.",
    ),
    # What pays is not the task
    Cause(
        name="reward_exploited",
        title="the reward pays for something other than the success",
        likelihood=0.929,
        numbers=rewards.reward_exploited,
        text="The reward pays for something other than the success: the mean return of {what} is {gained},"
        " more than the {by_example} of {example}, but the policy succeeds in {policy}{and_example}.{paying}",
        advice="{remedy}",
        explains=("reward_apart_from_success", "exploration_collapsed", "success_needs_exploration"),
    ),
    Cause(
        name="ending_early_pays",
        title="failing early pays",
        likelihood=0.93,
        when=lambda e: len(e.late) >= MIN_EPISODES and np.ptp(e.episodes.lengths) > 0,
        numbers=rewards.ending_early_pays,
        text="Failing early pays: a step earns {reward} on average, {failed} of the late episodes"
        " fail{correlated}.{sooner}{saving}{going_on}",
        advice="Make good steps earn a positive reward (check the signs of the terms), or {price}.",
        explains=("exploration_collapsed", "success_never_seen"),
    ),
    Cause(
        name="return_at_ceiling",
        title="the return is at its ceiling",
        likelihood=0.952,
        when=lambda e: (
            len(e.episodes) >= 4 * MIN_EPISODES
            and e.is_last_stage
            and (e.run.program.agent.solved is None or e.run.program.agent.solved.mean_return is not None)
        ),
        numbers=rewards.return_at_ceiling,
        text="The return is at its ceiling: it is {mean} {spread} {episodes} {what} (from {low} to {high}),"
        " {grown}and no episode of the training returned more than {most}.{bounded}{asked}",
        advice="{remedy}",
        explains=("exploration_collapsed", "learning_rate_too_low", "too_few_steps"),
    ),
    Cause(
        name="lint_warns",
        title="{title}",
        likelihood=0.3,
        numbers=lint_warns,
        text="{meaning}: {finding} ({code}).{others}",
        advice="{help}: `deepbots lint {path}` shows the lines.{copy}",
        command="lint {path}",
    ),
    # The observation
    Cause(
        name="sensor_without_reading",
        title="{count} of {of} measured numbers of the observation never change",
        likelihood=0.95,
        numbers=lambda e: hardly_changing(e, 0.0, SAME_OBSERVATION),
        text="{count} of {of} measured numbers of the observation never changed in {moments} moments"
        " ({values}): {guess}.",
        advice="Check the position and direction of these sensors, and that something is in their range:"
        " `deepbots view RUN` draws the rays of sensors. Or remove the values from `observation`.",
        command="view {run}",
    ),
    Cause(
        name="constant_observation",
        title="{count} of {of} measured numbers of the observation hardly change",
        likelihood=0.95,
        numbers=lambda e: hardly_changing(e, SAME_OBSERVATION, _MAX_CONSTANT_SPAN),
        text="{count} of {of} measured numbers of the observation hardly change ({names}): in {moments}"
        " moments, after mapping to [-1, 1], they vary by at most {span}.",
        advice="Narrow their ranges under `observation` to the values that occur: `deepbots inspect RUN`"
        " lists the ranges.",
        command="inspect {run}",
    ),
    Cause(
        name="saturated_observation",
        title="{count} of {of} clipped numbers of the observation are outside their range",
        likelihood=0.95,
        when=lambda e: e.probe_moments >= 2 * MIN_EPISODES,
        numbers=saturated_observation,
        text="{count} of {of} clipped numbers of the observation are outside their range in {share} of the"
        " moments ({names}). The clipped values differ by up to {lost} times the range.",
        advice="Widen their ranges under `observation`: the policy cannot distinguish values outside a"
        " range.",
        command="inspect {run}",
    ),
    # The reward
    Cause(
        name="term_dominates",
        title="the reward term '{term}' dominates",
        likelihood=0.94,
        numbers=rewards.term_dominates,
        text="The reward term '{term}' dominates: it is {share} of the reward. With random actions it gives"
        " {mean} per step, and all other terms together give {others}.",
        advice="Scale '{term}' down until the other terms outweigh it, for example by a factor of 10.",
        command="try {scenario}",
    ),
    Cause(
        name="standing_still_pays",
        title="the reward pays for standing still",
        likelihood=0.93,
        when=lambda e: (
            e.idle
            and e.program.defines_success
            and e.late_training_success < 0.5
            and 0 < per_step(e.idle) >= 0.8 * per_step(e.policy or e.random)
            # Where standing still fails soon, it pays until then only.
            and not any(trace.outcome == "success" for trace in e.idle)
            and 2 * sum(trace.outcome == "failure" for trace in e.idle) <= len(e.idle)
        ),
        numbers=lambda e: {
            "still": per_step(e.idle),
            "policy": per_step(e.policy or e.random),
            "others": "the policy earns" if e.policy else "random actions earn",
            "random": per_step(e.random),
            "episodes": len(e.idle),
            "rate": Percentage(e.late_training_success),
            "progress": rewards.progress_advice(e),
        },
        text="Standing still pays: zero actions earn {still} per step, {others} {policy}, and {rate} of the"
        " late episodes succeed.",
        advice="{progress}, and make each step cost something instead of earning something.",
        command="try {scenario} --driver zero",
    ),
    Cause(
        name="loitering",
        title="staying near success pays more than success",
        likelihood=0.935,
        when=lambda e: e.program.defines_success and e.is_mature and e.policy,
        numbers=rewards.loitering,
        text="Staying near success pays more than success: {share} of the late episodes reach the time limit."
        " In the second half of such episodes, '{term}' gives {per_step} per step, which is {whole} for"
        " {steps} steps. {compared}",
        advice="{nearer}nd the episode where it pays, or scale it down until an episode of it earns less than"
        " success.",
    ),
    Cause(
        name="stage_too_hard",
        title="stage '{stage}' is too hard after stage '{before}'",
        likelihood=0.935,
        when=lambda e: e.stage_index and e.program.defines_success and e.is_mature,
        numbers=stages.stage_too_hard,
        text="Stage '{stage}' is too hard after stage '{before}'. At the end of '{before}', the policy"
        " succeeded in {success_before}; in the second half of the {steps} steps of '{stage}', it succeeds in"
        " {success}.",
        advice="Add a stage between the two, with values between theirs{changes}, or let episodes of"
        " '{stage}' start nearer to success.",
        command="eval {run} --details",
    ),
    Cause(
        name="easy_stage_counted",
        title="the policy has learned only an easy stage",
        likelihood=0.93,
        when=lambda e: not e.is_running and (e.steps >= 0.5 * e.planned or e.final_episodes),
        numbers=stages.easy_stage_counted,
        text="The policy has learned only an easy stage: the training ended in stage '{stage}' ({number} of"
        " {count}). In this stage it succeeds in {success}{task}. The stage ends at {criterion}; {reached}.",
        advice="{remedy}",
        command="eval {run} --details",
    ),
    Cause(
        name="some_starts_fail",
        title="the policy fails from some starts",
        likelihood=0.55,
        numbers=stages.some_starts_fail,
        text="{flat} depends on the start: with `{drawn}` {worst}, the policy succeeds in {failing}; with"
        " `{drawn}` {best}, it succeeds in {succeeding} ({source}; by value: {parts}).",
        advice="Check that these starts can succeed, with a script or by hand (`deepbots play`){observed}."
        " Then train more on these starts, for example with a curriculum that draws them more often at"
        " first.",
        command="eval {run} --details",
    ),
    Cause(
        name="reward_apart_from_success",
        title="a higher return does not mean more success",
        likelihood=0.72,
        when=lambda e: e.program.defines_success and e.is_mature,
        numbers=rewards.reward_apart_from_success,
        text="A higher return does not mean more success: {how}.{rising}",
        advice="Make a success earn more than an episode without success can collect, and scale down the"
        " terms that reward something else.",
    ),
    # Starts, stages and teachers
    Cause(
        name="stuck_in_stage",
        title="the training is stuck in stage '{stage}'",
        likelihood=0.75,
        numbers=stages.stuck_in_stage,
        text="The training is stuck in stage '{stage}' ({number} of {count}), which began at step {since}:"
        " the {metric} was {before} in the third quarter of the stage and {late} in the last quarter, but the"
        " stage ends at {threshold}.",
        advice="{remedy}. Also check the causes below: they apply to this stage.",
        command="eval {run} --details",
    ),
    Cause(
        name="levels_stay_lowest",
        title="all worlds stay in the lowest level",
        likelihood=0.7,
        when=lambda e: len(e.late) >= MIN_EPISODES,
        numbers=stages.levels_stay_lowest,
        text="All worlds are in level 0 of 0 to {highest}. Of the episodes in the last quarter of the"
        " training, {share} ended by {up}, which raises the level.",
        advice="Make level 0 easier, or name under `curriculum.up` an ending that a policy reaches earlier.",
    ),
    Cause(
        name="script_succeeds",
        title="the script '{script}' is better than the policy",
        likelihood=0.89,
        when=lambda e: e.script_rates and not e.is_taught,
        numbers=script_succeeds,
        text="A script is better than the policy: '{script}' succeeds in {by_script}, and the policy in"
        " {by_policy}.",
        advice="Let the script teach the policy, with `teacher: {script}` under `train`.",
    ),
    Cause(
        name="teacher_fails",
        title="the teacher itself fails",
        likelihood=0.895,
        when=lambda e: e.teacher is not None,
        numbers=teacher_fails,
        text="The teacher fails itself: '{script}' succeeds in {by_script}, and the policy that it teaches in"
        " {by_policy}. A policy hardly learns from a teacher what the teacher cannot do.",
        advice="Improve the script first: `deepbots try {scenario} --driver {script} --episodes 20` shows its"
        " endings. Or train without it.",
        command="try {scenario} --driver {script} --episodes 20",
    ),
    Cause(
        name="teacher_sees_more",
        title="the teacher sees more than the policy",
        likelihood=0.88,
        when=lambda e: e.teacher is not None and e.scripts.get(e.teacher),
        numbers=teacher_sees_more,
        text="The teacher sees more than the policy: '{script}' reads {names}, which the policy does not"
        " observe, so it acts differently in states that look the same to the policy. It succeeds in"
        " {by_script}, and the policy in {by_policy}.",
        advice="Add what the teacher reads to `observation`. If a robot could not measure it, show the policy"
        " more of the past: {past} for the sensors that change with it.",
    ),
    Cause(
        name="success_never_seen",
        title="{title}",
        likelihood=0.7,
        when=lambda e: e.program.defines_success and len(e.episodes) >= MIN_EPISODES and is_rare(e),
        numbers=stages.success_never_seen,
        text="{seen} of {episodes} episodes{where} {verb} a success ('{ending}'){though}; their returns"
        " differ by {spread} (standard deviation).",
        advice="{remedy}, start nearer to success, or loosen its condition; a curriculum can do the latter"
        " two.",
        is_provisional=True,
    ),
    # Other agents
    Cause(
        name="rival_too_strong",
        title="the rival is too strong",
        likelihood=0.94,
        numbers=rival_too_strong,
        text="The rival is too strong: since {since} steps, `{agent}` succeeds in {own} of the episodes, and"
        " `{rival}` in {other}. Where nothing that it does succeeds, `{agent}` does not learn what is"
        " better.",
        advice="Let one learn while the other keeps its policy, with `turns` under `train`; train `{agent}`"
        " against a weaker `{rival}` first, with --agent {agent} --against {rival}=random, and begin with"
        " this policy (--initialize-from); or pay for what leads to a success.",
        explains=("success_never_seen", "one_ending", "rival_improved"),
    ),
    Cause(
        name="rival_improved",
        title="the rival got better",
        likelihood=0.7,
        numbers=rival_improved,
        text="The rival got better: `{agent}` succeeded in {own_before} of the episodes from {begin} to"
        " {since} steps, and in {own} of the last quarter; `{rival}` went from {other_before} to {other}."
        " Against a rival that also learns, less success does not show that `{agent}` acts worse than"
        " before.",
        advice="Compare its policy with scripts and random actions: `deepbots compare {run}`. If it is no"
        " better than these, let one learn while the other keeps its policy, with `turns` under `train`.",
        explains=("one_ending",),
    ),
    Cause(
        name="strategies_cycle",
        title="the strategies go round in a circle",
        likelihood=0.9,
        numbers=strategies_cycle,
        text="The strategies go round in a circle: the newest policy wins {lost} of its decided games against"
        " the version of {old} steps, but {won} against the later version of {late} steps.",
        advice="Keep more past versions with a larger `pool` of `self_play`, and let fewer environments play"
        " the newest version against itself (`newest`), so that the policy meets the old strategies again.",
    ),
    # The learner
    Cause(
        name="learning_rate_too_high",
        title="the learning rate is too high",
        likelihood=0.93,
        numbers=learner.learning_rate_too_high,
        text="The learning rate is {rate}, {times} times the usual {usual}: up to {clipped} of the samples of"
        " an update are clipped, the largest KL divergence is {kl}, and the mean return went from {first} to"
        " {last}.",
        advice="Set `train.learning_rate` to {usual}.",
    ),
    Cause(
        name="learning_rate_too_low",
        title="the learning rate is too low",
        likelihood=0.93,
        when=lambda e: len(e.episodes) >= 2 * MIN_EPISODES,
        numbers=learner.learning_rate_too_low,
        text="The learning rate is {rate}, {times} times lower than the usual {usual}: after {steps} steps,"
        " the mean return went only from {first} to {last}{divergence}.",
        advice="Set `train.learning_rate` to {usual}.",
    ),
    Cause(
        name="rewards_too_large",
        title="the rewards are too large for the critic",
        likelihood=0.91,
        when=lambda e: len(e.episodes) >= 2 * MIN_EPISODES,
        numbers=learner.rewards_too_large,
        text="The rewards are too large for the critic: the mean return of late episodes is {late}, and the"
        " critic explains {explained} of the variance of the returns. The norm of a gradient is limited, and"
        " the part of the critic leaves hardly any for the policy.",
        advice="Set `train.normalize` to `reward`, which divides rewards by their standard deviation for"
        " learning only, or scale all terms down.",
    ),
    Cause(
        name="horizon_too_short",
        title="the discount factor hides late rewards",
        likelihood=0.45,
        numbers=learner.horizon_too_short,
        text="The discount factor {gamma} hides what comes late: after {length} steps, {of}, a reward has"
        " {weight} of its weight.",
        advice="Set `train.gamma` to {wanted}.",
    ),
    Cause(
        name="exploration_hides_success",
        title="exploration prevents success",
        likelihood=0.923,
        numbers=learner.exploration_hides_success,
        text="Without exploration, the policy succeeds in {without}{where} at the end of the training. The"
        " last episodes of the training, with exploration, succeed in {with}: exploration prevents success.",
        advice="{remedy}, or loosen the condition for success. You can already use the policy: `deepbots"
        " view`, `eval` and `export` run it without exploration.",
    ),
    Cause(
        name="success_needs_exploration",
        title="the policy succeeds only with exploration",
        likelihood=0.923,
        numbers=learner.success_needs_exploration,
        text="The last episodes of the training, with exploration, succeed in {with}. Without it, the policy"
        " succeeds in {without}{where}: it seems to stand still or to repeat itself in some states, and only"
        " the noise on its actions leads out of them.",
        advice="{advice} The noise becomes smaller, and the policy learns to do without it. {otherwise}",
    ),
    Cause(
        name="exploration_too_large",
        title="the policy is still random",
        likelihood=0.93,
        numbers=learner.exploration_too_large,
        text="The policy is still random: after {updates} updates it has {randomness} its initial randomness"
        " (entropy {entropy}), with `ent_coef` {weight}. The mean return of late training episodes is"
        " {late}{evaluated}.",
        advice="Lower `train.ent_coef` from {weight} to {wanted}.",
        is_provisional=True,
    ),
    Cause(
        name="exploration_collapsed",
        title="the policy hardly explores",
        likelihood=0.6,
        numbers=learner.exploration_collapsed,
        text="The policy hardly explores: {measure} is {value} after {steps} steps. Below {least}, a policy"
        " finds hardly anything new.",
        advice="{remedy}.",
    ),
    # The end
    Cause(
        name="missed_condition",
        title="episodes miss a condition of '{ending}'",
        likelihood=0.69,
        when=lambda e: e.is_mature,
        numbers=stages.missed_condition,
        text="Episodes without success miss the same condition of '{ending}': in {episodes} of {of},"
        " `{condition}` is true least often, in {true} of {moments} moments{nearest}. {others}.",
        advice="{remedy}, or loosen the threshold. `deepbots diagnose RUN --episode failed` shows one of"
        " these episodes.",
        explains=("success_plateau",),
        is_symptom=True,
    ),
    Cause(
        name="success_plateau",
        title="the success rate does not rise",
        likelihood=0.6,
        numbers=stages.success_plateau,
        text="{verdict}: it was {before} in the second quarter of {whole} and {late} in the last one, which"
        " is {change}. In the second half of {whole}, the policy succeeds in {success}.",
        advice="Look at episodes without success: `deepbots eval RUN --details` shows their starts, `deepbots"
        " diagnose RUN --episode failed` shows which condition they miss.{more}",
        is_symptom=True,
    ),
    Cause(
        name="one_ending",
        title="'{ending}' ends {share} of the last episodes",
        likelihood=0.25,
        when=lambda e: (
            len(e.late) >= MIN_EPISODES
            and commonest_ending(e.late)[0] in e.program.failures
            and commonest_ending(e.late)[1] >= 0.9
            and len(e.program.endings) > 1
            and e.return_trend.direction != "rises"
        ),
        numbers=lambda e: {
            "ending": commonest_ending(e.late)[0],
            "share": Percentage(commonest_ending(e.late)[1]),
            "episodes": len(e.late),
            "length": float(e.late.lengths.mean()),
        },
        text="'{ending}' ends {share} of the last {episodes} episodes, after {length} steps on average.",
        advice="Run `deepbots diagnose RUN --episode failed`: it shows the value and the threshold of this"
        " ending in one of these episodes.",
        is_symptom=True,
        is_provisional=True,
    ),
    Cause(
        name="stopped_early",
        title="the training stopped early",
        likelihood=0.9,
        when=lambda e: e.verdict.solved is False and not e.is_running,
        numbers=stopped_early,
        text="The training stopped after {steps} of {planned} steps, {reason}. {verdict}: {result}.",
        advice="{advice}",
    ),
    Cause(
        name="too_few_steps",
        title="the training is too short",
        likelihood=0.5,
        numbers=too_few_steps,
        text="{finding}. The training has made {steps} steps in {episodes} episodes; the scenario sets"
        " {planned} steps.",
        advice="{advice}",
        is_symptom=True,
    ),
)
"""The causes of a training that does not learn. Among causes that are as likely, the first one of this list
comes first."""


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
        explored = {"exploration_too_large", "changed_since_solved"} if learned == "evaluated" else set()
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
    """Return whether a training solves its task, and the first of its causes, in a sentence."""
    states = {True: "solved", False: "not solved", None: ""}
    state = "not solved yet" if training.is_running else states[training.verdict.solved]
    return (
        ": ".join(filter(None, (state, *(cause.title for cause in causes[:1]))))
        or "no cause of a failure was found"
    )


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
