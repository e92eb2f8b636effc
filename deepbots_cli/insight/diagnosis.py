"""The table of causes why a training does not learn, each with its evidence and what to try.

A row finds its evidence in the logs or in the short episodes, or does not apply. `likelihood` orders the rows: what was seen to make
learning impossible comes before what often does, and both before what may only be a symptom. A training that solves its task has none.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import combinations
from statistics import fmean
from typing import Any

import numpy as np

from deepbots_cli.errors import RunError
from deepbots_cli.insight.statements import Numbers, Percentage, Statement, StatementRule, list_text, statements_about
from deepbots_cli.insight.trace import Array, Trace
from deepbots_cli.insight.training import TrainingEvidence, lint_findings
from deepbots_cli.learning.defaults import default_values, longest_episode
from deepbots_cli.program.task import Choices, Observation

_SAME_TOLERANCE = 1e-6  # numbers of the observation, from -1 to 1, that differ by less are equal
_MIN_EPISODES = 8  # episodes, below which the returns of a training tell nothing
_AT_RESET = "already holds at reset"  # the error of an episode that cannot start
_UNLEARNABLE = {"DB705", "DB711", "DB807", "DB810"}
"""Lint shows by these that failing at once earns most, that all policies earn the same, or that what is required is out of reach."""
_CERTAIN_SHARE, _SYMPTOMS = 0.9, {"too_few_steps", "short_training", "one_ending"}
"""Beside a cause that is as likely as this, the length of the training and its most frequent ending are no causes of their own."""
_PROVISIONAL_CAUSES = {"success_never_seen", "silent_terms", "one_ending", "exploration_too_large"}
"""What may still change in a training that was cut short: a cause only after half of the planned timesteps, or if it is certain."""


def diagnose(training: TrainingEvidence) -> list[Statement]:
    """The causes that apply, the most likely first; none for a training that solves its task, or of late succeeds in most episodes.

    A policy that solves its task in evaluations, which act without exploration, has learned, unless it is still random in the training.

    Raises:
        RunError: The training has finished no episode, and has not failed either.
    """
    if not len(training.episodes) and not training.has_failed:
        raise RunError(
            f"{training.run.path} holds no finished episode yet; train it longer, with: deepbots train --resume {training.run.path}"
        )
    late, can_succeed = training.episodes.successes[-100:], training.program.solved is None and training.program.defines_success
    succeeds, evaluated = (can_succeed and len(of) >= _MIN_EPISODES and fmean(of) >= 0.8 for of in (late, training.last_successes))
    if training.solved_while_exploring or succeeds:
        return []
    causes = (exploration_too_large,) if training.solved or evaluated else CAUSES
    found = sorted(statements_about(causes, training), key=lambda statement: -statement.evidence["likelihood"])
    unlikely = [statement for statement in found if statement.evidence["likelihood"] < _CERTAIN_SHARE]
    left_out = (_SYMPTOMS if len(unlikely) < len(found) else set()) | (_PROVISIONAL_CAUSES if _length(training)["share"] < 0.5 else set())
    return [statement for statement in found if not (statement in unlikely and statement.cause in left_out)]


def _per_step(traces: Sequence[Trace]) -> float:
    """The mean reward of a step."""
    return sum(trace.returns for trace in traces) / max(1, sum(trace.steps for trace in traces))


# Faults


def ending_at_reset(t: TrainingEvidence) -> Numbers | None:
    """An episode cannot start after {steps} steps of training: {error}.

    Try: Change the start under `reset` or the bound of the ending. `deepbots lint --deep SCENARIO` counts the starts that end at once.
    """
    return {"likelihood": 1.0, "steps": t.steps, "error": t.failure.rstrip(".")} if _AT_RESET in t.failure else None


def not_finite(t: TrainingEvidence) -> Numbers | None:
    """The training stopped with an error after {steps} steps: {error}.

    Try: Keep arguments of sqrt, log and divisions away from 0 with max(...), or lower `train.learning_rate`; explain the episode with
    `deepbots explain-episode RUN/failures/NNNN.json`.
    """
    if not t.has_failed or _AT_RESET in t.failure:
        return None
    reason = t.failure.rstrip(".") or "the last entry of its log is no number"
    return {"likelihood": 1.0, "steps": t.steps, "error": reason, "episodes": len(t.episodes)}


def action_without_effect(t: TrainingEvidence) -> Numbers | None:
    """{count} of {of} parts of the action do nothing ({parts}): from the same start, all their values lead to the same observations for
    {steps} steps.

    Try: Look at `apply` of the robot, at the limits of its motors (`deepbots inspect RUN`), and at the wheels or joints that it
    drives.
    """
    own = [place for place, number in enumerate(t.program.policy.numbers) if number.name != "previous_action"]
    dead, steps = [], 0
    for part, traces in t.constant_actions.items():
        pairs = list(combinations(traces.values(), 2))
        if pairs and max(_difference(one, other, own) for one, other in pairs) < _SAME_TOLERANCE:
            dead.append(part)
            steps = min(trace.steps for trace in traces.values())
    if not dead or not steps:
        return None
    return {"likelihood": 0.98 if len(dead) == len(t.constant_actions) else 0.8, "parts": list_text(dead), "count": len(dead),
            "of": len(t.constant_actions), "steps": steps, "difference": 0.0}  # fmt: skip


def _difference(one: Trace, other: Trace, numbers: Sequence[int]) -> float:
    """The largest difference of what the policy sees, and of what the endings compare."""
    if one.steps != other.steps:
        return 1.0
    seen = np.abs(one.observations[:, numbers] - other.observations[:, numbers]).max(initial=0.0)
    kept = [abs(a - b) for x, y in zip(one.values, other.values, strict=True) for key in x for a, b in zip(x[key], y[key], strict=True)]
    return float(max(seen, *kept, 0.0)) if kept else float(seen)


def ending_at_once(t: TrainingEvidence) -> Numbers | None:
    """Episodes end before the policy can do anything: '{ending}' ends {share} of them, half within {length} and 90% within {long} of
    {longest} steps.

    Try: Loosen the bound of '{ending}', or start farther away from it: `deepbots explain-episode RUN` shows the value and the bound.
    """
    lengths, longest = t.episodes.lengths, t.program.truncation.max_episode_steps(t.program.period)
    if len(lengths) < _MIN_EPISODES:
        return None
    long, (name, count) = float(np.quantile(lengths, 0.9)), Counter(t.episodes.endings).most_common(1)[0]
    if long > min(12, 0.2 * longest) or name not in t.program.failures:
        return None
    return {"likelihood": 0.96, "ending": name, "share": Percentage(count / len(lengths)), "length": float(np.median(lengths)),
            "long": long, "longest": longest}  # fmt: skip


def lint_warns(t: TrainingEvidence) -> Numbers | None:
    """Lint has {count} about the scenario: {findings}.

    Try: Run `deepbots lint {path}`: it shows the lines and what to write instead.
    """
    path, found = lint_findings(t.run)
    found.sort(key=lambda finding: finding.code not in _UNLEARNABLE)
    if not found:
        return None
    shown = "; ".join([f"{finding.headline} ({finding.code})" for finding in found[:2]] + [f"{len(found) - 2} more"] * (len(found) > 2))
    return {"likelihood": 0.91 if found[0].code in _UNLEARNABLE else 0.3, "count": f"{len(found)} warning{'s' * (len(found) > 1)}",
            "findings": shown, "codes": [finding.code for finding in found], "path": path}  # fmt: skip


# Observations


def constant_observation(t: TrainingEvidence) -> Numbers | None:
    """{count} of {of} numbers of the observation hardly change ({names}): in {moments} moments they move by at most {span} of a range of
    2.

    Try: Narrow their ranges under `observation` to the values that occur: `deepbots inspect RUN` lists the ranges.
    """
    if t.probe_moments < 2 * _MIN_EPISODES:
        return None
    spans = np.ptp(np.concatenate([trace.observations for trace in t.probes]), axis=0)
    numbers = [(n.full_name, float(span)) for n, span in zip(t.program.policy.numbers, spans, strict=True) if n.name != "previous_action"]
    names = [name for name, span in numbers if span < 0.01]
    if not names:
        return None
    share = len(names) / len(numbers)
    return {"likelihood": 0.95 if share >= 0.75 else 0.35 * share, "count": len(names), "of": len(numbers), "moments": t.probe_moments,
            "names": list_text(names), "span": max(span for name, span in numbers if name in names)}  # fmt: skip


def saturated_observation(t: TrainingEvidence) -> Numbers | None:
    """{count} of {of} numbers of the observation lie beyond an end of their range in {share} of the moments ({names}); the values that
    are cut off differ by up to {lost} times the range.

    Try: Widen their ranges under `observation`: beyond the ends the policy cannot tell values apart.
    """
    if t.probe_moments < 2 * _MIN_EPISODES:
        return None
    found = {entry.name: _beyond(t, entry) for entry in t.program.policy.observation if entry.clip and entry.name != "previous_action"}
    cut = {n.full_name: part for e in t.program.policy.observation for n, part in zip(e.numbers, found.get(e.name, ()), strict=False)}
    shares = {name: float((part != 0).mean()) for name, part in cut.items()}
    # Clipping holds a value such as the reading of a sensor that sees nothing at an end, and loses nothing if it is always the same one.
    spreads = {name: max(_spread(part[part > 0]), _spread(part[part < 0])) for name, part in cut.items()}
    worst = sorted((name for name, share in shares.items() if share >= 0.4 and spreads[name] >= 0.1), key=lambda name: -shares[name])
    if not worst:
        return None
    part, mean = len(worst) / len(shares), float(np.mean([shares[name] for name in worst]))
    # Numbers that are almost always beyond an end come before the length of the training.
    return {"likelihood": 0.95 if part >= 0.75 else 0.85 if mean >= 0.8 else 0.55 * part, "count": len(worst), "of": len(shares),
            "names": list_text(worst), "share": Percentage(mean), "lost": max(spreads[name] for name in worst),
            "shares": shares}  # fmt: skip


def _beyond(t: TrainingEvidence, entry: Observation) -> list[Array]:
    """By how much each number of an entry lies above its range, or below it (negative), in all moments, as a share of the range."""
    key = t.probes[0].instrumented.observed_signals.get(entry.name)
    if key is None or entry.value.typed.type.boolean:
        return []
    rows = np.array([values[key] for trace in t.probes for values in trace.values], float)
    return [(row - row.clip(low, high)) / (high - low) for row, low, high in zip(rows.T, entry.low, entry.high, strict=True)]


def _spread(values: Array) -> float:
    """The distance that holds 80 % of the values, from the lowest tenth to the highest."""
    return float(np.subtract(*np.quantile(values, (0.9, 0.1)))) if len(values) else 0.0


# Reward


def term_dominates(t: TrainingEvidence) -> Numbers | None:
    """The reward term '{term}' is {share} of the reward: with random actions it gives {mean} a step, and all other terms together {others}.

    Try: Weaken '{term}' until the other terms outweigh it, such as by a factor of 10.
    """
    names = [term.name for term in t.program.policy.reward]
    sums = {name: float(sum(np.nansum(trace.terms[name]) for trace in t.random)) for name in names}
    whole = sum(map(abs, sums.values()))
    if len(sums) < 2 or not whole:
        return None
    name = max(sums, key=lambda each: abs(sums[each]))
    share, rest = abs(sums[name]) / whole, sum(value for key, value in sums.items() if key != name)
    varies = any(np.ptp(trace.terms[name]) > 1e-9 for trace in t.random if trace.steps)
    others = [fmean(trace.returns - float(np.nansum(trace.terms[name])) for trace in traces) for traces in (t.random, t.policy or t.random)]
    if share < 0.55 or not varies or not sums[name] < 0 < rest or others[1] > 1.5 * others[0]:  # the policy earns the others all the same
        return None
    steps = sum(trace.steps for trace in t.random)
    return {
        "likelihood": 0.94,
        "term": name,
        "share": Percentage(share),
        "mean": sums[name] / steps,
        "others": rest / steps,
        "steps": steps,
    }


def ending_early_pays(t: TrainingEvidence) -> Numbers | None:
    """It pays to fail early: a step earns {reward} on average, {failed} of the late episodes fail, and the return falls with the length of
    an episode (correlation {correlation}).

    Try: Let a step that goes well earn a positive reward (check the signs of the terms), or let a failure cost more than the steps
    that it saves.
    """
    late = t.episodes_between(0.75, 1.0)
    if len(late) < _MIN_EPISODES:
        return None
    failed = float(np.mean([ending in t.program.failures for ending in late.endings]))
    per_step = float(late.returns.sum() / max(1.0, late.lengths.sum()))
    if failed < 0.5 or per_step >= 0 or late.successes.mean() > 0.2 or np.ptp(t.episodes.lengths) == 0 or _per_step(t.policy) > 0:
        return None
    together = float(np.corrcoef(t.episodes.lengths, t.episodes.returns)[0, 1]) if np.ptp(t.episodes.returns) else 0.0
    if not together < -0.5:
        return None
    return {"likelihood": 0.92, "reward": per_step, "failed": Percentage(failed), "length": float(late.lengths.mean()),
            "first": float(t.episodes_between(0.0, 0.25).lengths.mean()), "correlation": together}  # fmt: skip


def standing_still_pays(t: TrainingEvidence) -> Numbers | None:
    """Standing still pays: commanding zeros earns {still} a step, the policy {policy}, and {rate} of the late episodes succeed.

    Try: Reward the way toward the success (such as the change of a distance), and make time cost something instead of earning it.
    """
    late = t.episodes_between(0.75, 1.0)
    if not t.idle or not t.program.defines_success or (len(late.successes) and late.successes.mean() >= 0.5):
        return None
    still, policy = _per_step(t.idle), _per_step(t.policy or t.random)
    outcomes = [trace.outcome for trace in t.idle]  # where standing still fails soon, it pays until then only
    if still <= 0 or "success" in outcomes or 2 * outcomes.count("failure") > len(outcomes) or still < 0.8 * policy:
        return None
    return {"likelihood": 0.93, "still": still, "policy": policy, "random": _per_step(t.random), "episodes": len(t.idle),
            "rate": Percentage(float(late.successes.mean()) if len(late.successes) else 0.0)}  # fmt: skip


def success_never_seen(t: TrainingEvidence) -> Numbers | None:
    """None of {episodes} episodes is a success ('{ending}'){though}; their returns differ by {spread} (standard deviation).

    Try: {remedy} start nearer to the success, or loosen its condition; a curriculum can do the latter two.
    """
    if not t.program.defines_success or len(t.episodes) < _MIN_EPISODES or t.episodes.successes.any():
        return None
    flat = float(np.ptp(t.episodes.returns)) < 1e-9
    names = [ending.name for ending in t.program.endings if ending.outcome == "success"] or ["goal_reached"]
    late = {term.name: t.curve(f"reward/{term.name}") for term in t.program.policy.reward}
    paid = {name: max(0.0, float(curve[-max(1, len(curve) // 4) :].mean())) for name, curve in late.items() if len(curve)}
    name, whole = max(paid, key=lambda each: paid[each], default=""), sum(paid.values())
    share = paid[name] / whole if whole else 0.0
    though, remedy = "", "Add a term that pays for coming nearer,"
    if share >= 0.8 and too_few_steps(t) is None:
        though = f", and '{name}' pays {share:.0%} of what late episodes gain: the policy stays at a local optimum of this term"
        remedy = f"Let '{name}' lead around obstacles, such as with path_distance in place of a straight distance;"
    return {"likelihood": 0.93 if flat else 0.7 if _length(t)["share"] >= 0.5 else 0.45, "episodes": len(t.episodes),
            "ending": " or ".join(names), "spread": float(t.episodes.returns.std()), "mean": float(t.episodes.returns.mean()),
            "term": name if whole else None, "term_share": share, "though": though, "remedy": remedy}  # fmt: skip


def silent_terms(t: TrainingEvidence) -> Numbers | None:
    """{count} of {of} reward terms are 0 in all {steps} steps of short episodes and in the logs: {names}.

    Try: Check the condition of each such term: `deepbots run SCENARIO` shows the terms of an episode.
    """
    names = [term.name for term in t.program.policy.reward]
    sums = {name: sum(float(np.abs(trace.terms[name]).sum()) for trace in t.probes) for name in names}
    silent = [name for name, value in sums.items() if value == 0 and not np.abs(t.curve(f"reward/{name}")).max(initial=0.0)]
    steps = sum(trace.steps for trace in t.probes)
    if not silent or not steps:
        return None
    likelihood = 0.9 if len(silent) == len(sums) else 0.3
    return {"likelihood": likelihood, "names": list_text(silent), "count": len(silent), "of": len(sums), "steps": steps}


# Learning


def learning_rate_too_high(t: TrainingEvidence) -> Numbers | None:
    """The learning rate is {rate}, {times} times the usual {usual}: up to {clipped} of an update is clipped, the largest KL divergence is
    {kl}, and the mean return goes from {first} to {last}.

    Try: Set `train.learning_rate` to {usual}.
    """
    rate, training = t.number_setting("learning_rate"), t.program.policy.training
    if rate is None or training is None:
        return None
    known: Any = default_values(training, t.run.record.total_timesteps, longest_episode(t.program)).get("learning_rate")
    usual = float(known) if isinstance(known, int | float) else 3e-4  # of the library
    clipped, kl = (float(t.curve(f"train/{name}").max(initial=0.0)) for name in ("clip_fraction", "approx_kl"))
    times = rate / usual
    if not (((clipped >= 0.5 or kl >= 0.3) and times > 2) or times >= 20):
        return None
    first, last = (float(t.episodes_between(*ends).returns.mean()) for ends in ((0.0, 0.25), (0.75, 1.0)))
    return {"likelihood": 0.93 if times >= 20 else 0.75 if times > 5 else 0.5, "rate": rate, "usual": usual, "times": times,
            "clipped": Percentage(clipped), "kl": kl, "first": first, "last": last}  # fmt: skip


def exploration_too_large(t: TrainingEvidence) -> Numbers | None:
    """The policy is still random: after {updates} updates its entropy is {entropy}, {share} of that at the start, with `ent_coef`
    {weight}. Its late training episodes have a mean return of {late}{evaluated}.

    Try: Lower `train.ent_coef`, such as to 0.01 or 0.
    """
    weight, random = t.number_setting("ent_coef"), _random_entropy(t)
    entropy, spread = -t.curve("train/entropy_loss"), t.curve("train/std")
    if not weight or not len(entropy) or (random is None and not len(spread)):
        return None
    late = float(entropy[-max(1, len(entropy) // 4) :].mean())
    share = float(spread[-1] / spread[0]) if random is None else late / random
    if share < (1.2 if random is None else 0.97):
        return None
    last = fmean(t.evaluations[-1]["returns"]) if t.evaluations else None
    return {"likelihood": 0.93 if weight >= 0.1 else 0.5, "weight": weight, "entropy": late, "share": Percentage(share),
            "updates": len(entropy), "late": float(t.episodes_between(0.75, 1.0).returns.mean()), "last_evaluation": last,
            "evaluated": "" if last is None else f", and the last evaluation, without exploration, one of {last:.3g}"}  # fmt: skip


def exploration_hides_success(t: TrainingEvidence) -> Numbers | None:
    """Without exploration the policy succeeds in {without} of {episodes} episodes of its last evaluation, and while it explored in {with}
    of the last {late} episodes of the training: the noise of the exploration prevents the success.

    Try: Use the policy as it is, since `deepbots view`, `eval` and `export` do not explore. To let the training succeed too, lower its
    exploration (`train.ent_coef` or `train.action_noise`), or loosen what the success requires.
    """
    late, last = t.episodes_between(0.75, 1.0).successes[-100:], t.last_successes
    if min(len(late), len(last)) < _MIN_EPISODES or fmean(last) < max(0.5, late.mean() + 0.3):
        return None
    return {"likelihood": 0.94, "without": Percentage(fmean(last)), "episodes": len(last), "with": Percentage(late.mean()),
            "late": len(late)}  # fmt: skip


def _random_entropy(t: TrainingEvidence) -> float | None:
    """The entropy of a random policy; None where not all parts of the action are choices."""
    parts = t.program.policy.action
    options = [len(part.options) for part in parts if isinstance(part, Choices)]
    return float(np.log(options).sum()) if len(options) == len(parts) else None


def exploration_collapsed(t: TrainingEvidence) -> Numbers | None:
    """The policy hardly explores: {measure} is {value} after {steps} steps, and below {least} it finds little new.

    Try: Raise the noise: `train.ent_coef` of PPO and A2C, `train.action_noise` of DDPG and TD3; or lower `train.learning_rate`.
    """
    sigma = getattr(getattr(t.settings.get("action_noise"), "sigma", None), "start", None)
    if sigma == 0:
        return {"likelihood": 0.85, "measure": "the standard deviation of the action noise", "value": 0.0, "least": 0.1, "steps": t.steps}
    random, measures = _random_entropy(t), []
    if random is not None:
        measures.append(("the entropy of the policy", -t.curve("train/entropy_loss"), 0.05 * random))
    for measure, curve, least in [*measures, ("the standard deviation of the actions", t.curve("train/std"), 0.05)]:
        if len(curve) >= _MIN_EPISODES and (value := float(curve[len(curve) // 2])) < least:
            return {"likelihood": 0.6, "steps": t.steps // 2, "measure": measure, "value": value, "least": least}
    return None


def one_ending(t: TrainingEvidence) -> Numbers | None:
    """'{ending}' ends {share} of the last {episodes} episodes, after {length} steps on average.

    Try: Run `deepbots explain-episode RUN`: it shows the value and the bound of this ending in one of them.
    """
    late = t.episodes_between(0.75, 1.0)
    if len(late) < _MIN_EPISODES:
        return None
    name, count = Counter(late.endings).most_common(1)[0]
    share = count / len(late)
    if name not in t.program.failures or share < 0.9 or len(t.program.endings) < 2 or too_few_steps(t) is not None:
        return None
    return {"likelihood": 0.25, "ending": name, "share": Percentage(share), "episodes": len(late), "length": float(late.lengths.mean())}


def too_few_steps(t: TrainingEvidence) -> Numbers | None:
    """The policy still learns: the mean return of the last quarter of the training is {last}, {gain} above that of the first half, after
    {steps} steps; the scenario plans {planned}.

    Try: Train on: deepbots train --resume {run} --timesteps {more}
    """
    early, late = t.episodes_between(0.0, 0.5).returns, t.episodes_between(0.75, 1.0).returns
    if len(t.episodes) < 2 * _MIN_EPISODES:
        return None
    gain = float(late.mean() - early.mean())
    chance = 2 * float(np.hypot(early.std() / np.sqrt(len(early)), late.std() / np.sqrt(len(late))))
    # A return that rises evenly gains a third of its total rise in the last quarter; below half of that it levels off.
    start, before = (float(t.episodes_between(share, share + 0.25).returns.mean()) for share in (0.0, 0.5))
    if not gain > chance > 0 or late.mean() - before < (late.mean() - start) / 6:
        return None
    length = _length(t)
    return {**length, "likelihood": 0.8 if length["share"] < 0.5 else 0.65, "first": float(early.mean()), "last": float(late.mean()),
            "gain": gain, "chance": chance}  # fmt: skip


def short_training(t: TrainingEvidence) -> Numbers | None:
    """The training is short: {steps} steps and {episodes} episodes, {share} of the {planned} steps of the scenario.

    Try: Train on: deepbots train --resume {run} --timesteps {more}
    """
    length = _length(t)
    if length["share"] >= 0.5 or too_few_steps(t) is not None:
        return None
    return {**length, "likelihood": 0.5, "episodes": len(t.episodes)}


def _length(t: TrainingEvidence) -> dict[str, Any]:
    settings = t.program.policy.training
    planned = settings.total_timesteps if settings else t.run.record.total_timesteps
    more = str(max(planned, 2 * t.steps))
    return {"steps": t.steps, "planned": planned, "share": Percentage(t.steps / planned), "more": more, "run": str(t.run.path)}


CAUSES: tuple[StatementRule[TrainingEvidence], ...] = (
    ending_at_reset, not_finite, action_without_effect, ending_at_once, lint_warns, constant_observation, saturated_observation,
    term_dominates, ending_early_pays, standing_still_pays, success_never_seen, silent_terms, learning_rate_too_high,
    exploration_hides_success, exploration_too_large, exploration_collapsed, one_ending, too_few_steps, short_training,
)  # fmt: skip
"""Why a training does not learn."""
