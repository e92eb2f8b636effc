"""The table of causes why a training does not learn, each with its evidence and what to try.

A row finds its evidence in the logs or in the short episodes, or does not apply. `likelihood` orders the rows: what was seen to make
learning impossible comes before what often does, and both before what may only be a symptom. A training that solves its task has none.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import combinations
from typing import Any

import numpy as np

from deepbots_cli.compiler.inputs import RESOLVED_NAME
from deepbots_cli.errors import RunError
from deepbots_cli.insight.statements import Finder, Numbers, Share, Statement, listed, state_all
from deepbots_cli.insight.trace import Array, Trace
from deepbots_cli.insight.training import Training
from deepbots_cli.learning.defaults import longest_episode, ours
from deepbots_cli.program.task import Choices

_SHOWN = 4
_SAME = 1e-6  # numbers of the observation, from -1 to 1, that differ by less are equal
_ENOUGH = 8  # episodes, below which the returns of a training tell nothing
_UNLEARNABLE = {"DB705", "DB711", "DB807", "DB810"}
"""Lint shows by these that failing at once earns most, that all policies earn the same, or that what is required is out of reach."""
_CERTAIN, _SYMPTOMS = 0.9, {"too_few_steps", "short_training", "one_ending"}
"""Beside a cause that is as likely as this, the length of the training and its most frequent ending are no causes of their own."""


def diagnose(training: Training) -> list[Statement]:
    """The causes that apply, the most likely first; none for a training that solves its task.

    A policy that solves it in evaluations, which act without exploration, and not in the training may still be random there.

    Raises:
        RunError: The training has finished no episode, and has not failed either.
    """
    if not len(training.episodes.returns) and not _has_failed(training):
        raise RunError(
            f"{training.run.path} holds no finished episode yet; train it longer, with: deepbots train --resume {training.run.path}"
        )
    if training.solved_while_exploring or _succeeds(training):
        return []
    causes = (exploration_too_large,) if training.solved else CAUSES
    found = sorted(state_all(causes, training), key=lambda statement: -statement.evidence["likelihood"])
    certain = bool(found) and found[0].evidence["likelihood"] >= _CERTAIN
    return [statement for statement in found if not (certain and statement.cause in _SYMPTOMS)]


def _has_failed(training: Training) -> bool:
    return bool(training.failure) or training.run.record.status == "failed"


def _succeeds(training: Training) -> bool:
    """Whether a scenario that does not say what counts as solved succeeds in most episodes of late."""
    late = training.episodes.successes[-100:]
    return training.program.solved is None and training.program.defines_success and len(late) >= _ENOUGH and float(late.mean()) >= 0.8


def _late(values: Array) -> float:
    """The mean of the last quarter."""
    return float(values[-max(1, len(values) // 4) :].mean()) if len(values) else 0.0


def _observations(traces: Sequence[Trace]) -> Array:
    """The moments of all episodes in a row: (moments, numbers)."""
    return np.concatenate([trace.observations for trace in traces]) if traces else np.zeros((0, 0))


def _term_sums(traces: Sequence[Trace]) -> dict[str, float]:
    names = traces[0].terms if traces else ()
    return {name: float(sum(np.nansum(trace.terms[name]) for trace in traces)) for name in names}


def _per_step(traces: Sequence[Trace]) -> float:
    """The mean reward of a step."""
    steps = sum(trace.steps for trace in traces)
    return sum(trace.returns for trace in traces) / steps if steps else 0.0


# Faults


_AT_RESET = "already holds at reset"


def ending_at_reset(t: Training) -> Numbers | None:
    """An episode cannot start after {steps} steps of training: {error}.

    Try: Change the start under `reset` or the bound of the ending. `deepbots lint --deep SCENARIO` counts the starts that end at once.
    """
    return {"likelihood": 1.0, "steps": t.steps, "error": t.failure.rstrip(".")} if _AT_RESET in t.failure else None


def not_finite(t: Training) -> Numbers | None:
    """The training stopped with an error after {steps} steps: {error}.

    Try: Keep arguments of sqrt, log and divisions away from 0 with max(...), or lower `train.learning_rate`; explain the episode with
    `deepbots explain-episode RUN/failures/NNNN.json`.
    """
    if not _has_failed(t) or _AT_RESET in t.failure:
        return None
    reason = t.failure.rstrip(".") or "the last entry of its log is no number"
    return {"likelihood": 1.0, "steps": t.steps, "error": reason, "episodes": len(t.episodes.returns)}


def action_without_effect(t: Training) -> Numbers | None:
    """{count} of {of} parts of the action do nothing ({parts}): from the same start, all their values lead to the same observations for
    {steps} steps.

    Try: Look at `apply` of the robot, at the limits of its motors (`deepbots inspect RUN`), and at the wheels or joints that it
    drives.
    """
    own = [place for place, number in enumerate(t.program.policy.numbers) if number.name != "previous_action"]
    dead, steps = [], 0
    for part, traces in t.constant.items():
        pairs = list(combinations(traces.values(), 2))
        if pairs and max(_difference(one, other, own) for one, other in pairs) < _SAME:
            dead.append(part)
            steps = min(trace.steps for trace in traces.values())
    if not dead or not steps:
        return None
    return {"likelihood": 0.98 if len(dead) == len(t.constant) else 0.8, "parts": listed(dead), "count": len(dead), "of": len(t.constant),
            "steps": steps, "difference": 0.0}  # fmt: skip


def _difference(one: Trace, other: Trace, numbers: Sequence[int]) -> float:
    """The largest difference of what the policy sees, and of what the endings compare."""
    if one.steps != other.steps:
        return 1.0
    seen = np.abs(one.observations[:, numbers] - other.observations[:, numbers]).max(initial=0.0)
    kept = [abs(a - b) for x, y in zip(one.values, other.values, strict=True) for key in x for a, b in zip(x[key], y[key], strict=True)]
    return float(max(seen, *kept, 0.0)) if kept else float(seen)


def ending_at_once(t: Training) -> Numbers | None:
    """Episodes end before the policy can do anything: '{ending}' ends {share} of them, half within {length} and 90% within {long} of
    {longest} steps.

    Try: Loosen the bound of '{ending}', or start farther away from it: `deepbots explain-episode RUN` shows the value and the bound.
    """
    lengths, longest = t.episodes.lengths, t.program.truncation.max_episode_steps(t.program.period)
    if len(lengths) < _ENOUGH:
        return None
    long, (name, count) = float(np.quantile(lengths, 0.9)), Counter(t.episodes.endings).most_common(1)[0]
    if long > min(12, 0.2 * longest) or name not in t.program.failures:
        return None
    return {"likelihood": 0.96, "ending": name, "share": Share(count / len(lengths)), "length": float(np.median(lengths)), "long": long,
            "longest": longest}  # fmt: skip


def lint_warns(t: Training) -> Numbers | None:
    """Lint has {count} about the scenario: {findings}.

    Try: `deepbots lint {path}` shows the lines and what to write instead.
    """
    found = sorted(t.findings, key=lambda finding: finding.code not in _UNLEARNABLE)
    if not found:
        return None
    shown = "; ".join([f"{finding.headline} ({finding.code})" for finding in found[:2]] + [f"{len(found) - 2} more"] * (len(found) > 2))
    return {"likelihood": 0.91 if found[0].code in _UNLEARNABLE else 0.3, "count": f"{len(found)} warning{'s' * (len(found) > 1)}",
            "findings": shown, "codes": [finding.code for finding in found], "path": str(t.run.path / RESOLVED_NAME)}  # fmt: skip


# Observations


def constant_observation(t: Training) -> Numbers | None:
    """{count} of {of} numbers of the observation hardly change ({names}): in {moments} moments they move by at most {span} of a range of
    2.

    Try: Narrow their ranges under `observation` to the values that occur: `deepbots inspect RUN` lists the ranges.
    """
    seen = _observations([*t.random, *t.policy])
    if len(seen) < 2 * _ENOUGH:
        return None
    spans = np.ptp(seen, axis=0)
    numbers = [(n.full_name, float(span)) for n, span in zip(t.program.policy.numbers, spans, strict=True) if n.name != "previous_action"]
    names = [name for name, span in numbers if span < 0.01]
    if not names:
        return None
    share = len(names) / len(numbers)
    return {"likelihood": 0.95 if share >= 0.75 else 0.35 * share, "count": len(names), "of": len(numbers), "moments": len(seen),
            "names": _some(names), "span": max(span for name, span in numbers if name in names)}  # fmt: skip


def saturated_observation(t: Training) -> Numbers | None:
    """{count} of {of} numbers of the observation are at an end of their range in {share} of the moments ({names}).

    Try: Widen their ranges under `observation`: beyond the ends the policy cannot tell values apart.
    """
    traces = [*t.random, *t.policy]
    seen, numbers = _observations(traces), t.program.policy.numbers
    if len(seen) < 2 * _ENOUGH:
        return None
    shares = {n.full_name: float((np.abs(seen[:, i]) >= 1.0).mean()) for i, n in enumerate(numbers) if n.clip and not n.is_truth
              and n.name != "previous_action" and np.ptp(seen[:, i]) >= 0.01}  # fmt: skip
    worst = sorted((name for name, share in shares.items() if share >= 0.4), key=lambda name: -shares[name])
    if not worst:
        return None
    part, mean = len(worst) / len(shares), float(np.mean([shares[name] for name in worst]))
    # Numbers that are almost always at an end come before the length of the training.
    return {"likelihood": 0.95 if part >= 0.75 else 0.85 if mean >= 0.8 else 0.55 * part, "count": len(worst), "of": len(shares),
            "names": _some(worst), "share": Share(mean), "shares": shares}  # fmt: skip


def _some(names: Sequence[str]) -> str:
    rest = len(names) - _SHOWN
    return listed([*names[:_SHOWN], *([f"{rest} more"] if rest > 0 else [])])


# Reward


def term_dominates(t: Training) -> Numbers | None:
    """The reward term '{term}' is {share} of the reward: with random actions it gives {mean} a step, and all other terms together {others}.

    Try: Weaken '{term}' until the other terms outweigh it, such as by a factor of 10.
    """
    sums = _term_sums(t.random)
    whole = sum(map(abs, sums.values()))
    if len(sums) < 2 or not whole:
        return None
    name = max(sums, key=lambda each: abs(sums[each]))
    share, rest = abs(sums[name]) / whole, sum(value for key, value in sums.items() if key != name)
    varies = any(np.ptp(trace.terms[name]) > 1e-9 for trace in t.random if trace.steps)
    if share < 0.55 or not varies or not sums[name] < 0 < rest:
        return None
    steps = sum(trace.steps for trace in t.random)
    return {"likelihood": 0.94, "term": name, "share": Share(share), "mean": sums[name] / steps, "others": rest / steps, "steps": steps}


def ending_early_pays(t: Training) -> Numbers | None:
    """It pays to fail early: a step earns {reward} on average, {failed} of the late episodes fail, and the return falls with the length of
    an episode (correlation {correlation}).

    Try: Let a step that goes well earn a positive reward (check the signs of the terms), or let a failure cost more than the steps
    that it saves.
    """
    late = t.episodes.part(0.75, 1.0)
    if len(late.returns) < _ENOUGH:
        return None
    failed = float(np.mean([ending in t.program.failures for ending in late.endings]))
    per_step = float(late.returns.sum() / max(1.0, late.lengths.sum()))
    if failed < 0.5 or per_step >= 0 or late.successes.mean() > 0.2 or np.ptp(t.episodes.lengths) == 0:
        return None
    together = float(np.corrcoef(t.episodes.lengths, t.episodes.returns)[0, 1]) if np.ptp(t.episodes.returns) else 0.0
    if not together < -0.5:
        return None
    return {"likelihood": 0.92, "reward": per_step, "failed": Share(failed), "length": float(late.lengths.mean()),
            "first": float(t.episodes.part(0.0, 0.25).lengths.mean()), "correlation": together}  # fmt: skip


def standing_still_pays(t: Training) -> Numbers | None:
    """Standing still pays: commanding zeros earns {still} a step, the policy {policy}, and {rate} of the late episodes succeed.

    Try: Reward the way toward the success (such as the change of a distance), and make time cost something instead of earning it.
    """
    late = t.episodes.part(0.75, 1.0)
    if not t.still or not t.program.defines_success or (len(late.successes) and late.successes.mean() >= 0.5):
        return None
    still, policy = _per_step(t.still), _per_step(t.policy or t.random)
    succeeded = sum(trace.outcome == "success" for trace in t.still)
    if still <= 0 or succeeded or still < 0.8 * policy:
        return None
    return {"likelihood": 0.93, "still": still, "policy": policy, "random": _per_step(t.random), "episodes": len(t.still),
            "rate": Share(float(late.successes.mean()) if len(late.successes) else 0.0)}  # fmt: skip


def success_never_seen(t: Training) -> Numbers | None:
    """None of {episodes} episodes is a success ('{ending}'); their returns differ by {spread} (standard deviation).

    Try: Add a term that pays for coming nearer, start nearer to the success, or loosen its condition; a curriculum can do the latter
    two.
    """
    if not t.program.defines_success or len(t.episodes.returns) < _ENOUGH or t.episodes.successes.any():
        return None
    flat = float(np.ptp(t.episodes.returns)) < 1e-9
    names = [ending.name for ending in t.program.endings if ending.outcome == "success"] or ["goal_reached"]
    return {"likelihood": 0.93 if flat else 0.45, "episodes": len(t.episodes.returns), "ending": " or ".join(names),
            "spread": float(t.episodes.returns.std()), "mean": float(t.episodes.returns.mean())}  # fmt: skip


def silent_terms(t: Training) -> Numbers | None:
    """{count} of {of} reward terms are 0 in all {steps} steps of short episodes and in the logs: {names}.

    Try: Check the condition of each such term: `deepbots run SCENARIO` shows the terms of an episode.
    """
    logged = t.curves("reward/")
    sums = (
        {name: sum(float(np.abs(trace.terms[name]).sum()) for trace in [*t.random, *t.policy]) for name in t.random[0].terms}
        if t.random
        else {}
    )
    silent = [name for name, value in sums.items() if value == 0 and not np.abs(logged.get(name, np.zeros(1))).max(initial=0.0)]
    if not silent or not any(trace.steps for trace in [*t.random, *t.policy]):
        return None
    everything = len(silent) == len(sums)
    return {"likelihood": 0.9 if everything else 0.3, "names": _some(silent), "count": len(silent), "of": len(sums),
            "steps": sum(trace.steps for trace in [*t.random, *t.policy])}  # fmt: skip


# Learning


def _default_rate(t: Training) -> float | None:
    training = t.program.policy.training
    if training is None:
        return None
    known: Any = ours(training, t.run.record.total_timesteps, longest_episode(t.program)).get("learning_rate")
    return float(known) if isinstance(known, int | float) else 3e-4  # of the library


def learning_rate_too_high(t: Training) -> Numbers | None:
    """The learning rate is {rate}, {times} times the usual {usual}: up to {clipped} of an update is clipped, the largest KL divergence is
    {kl}, and the mean return goes from {first} to {last}.

    Try: Set `train.learning_rate` to {usual}.
    """
    rate, usual = t.setting("learning_rate"), _default_rate(t)
    if rate is None or usual is None:
        return None
    clipped, kl = t.curve("train/clip_fraction"), t.curve("train/approx_kl")
    largest = float(clipped.max(initial=0.0))
    jumps = largest >= 0.5 or float(kl.max(initial=0.0)) >= 0.3
    times = rate / usual
    if not ((jumps and times > 2) or times >= 20):
        return None
    likelihood = 0.93 if times >= 20 else 0.75 if times > 5 else 0.5
    first, last = t.episodes.part(0.0, 0.25).returns.mean(), t.episodes.part(0.75, 1.0).returns.mean()
    return {"likelihood": likelihood, "rate": rate, "usual": usual, "times": times, "clipped": Share(largest),
            "kl": float(kl.max(initial=0.0)), "first": float(first), "last": float(last)}  # fmt: skip


def exploration_too_large(t: Training) -> Numbers | None:
    """The policy is still random: after {updates} updates its entropy is {entropy}, {share} of that at the start, with `ent_coef`
    {weight}. Its late training episodes have a mean return of {late}{evaluated}.

    Try: Lower `train.ent_coef`, such as to 0.01 or 0.
    """
    weight = t.setting("ent_coef")
    entropy = -t.curve("train/entropy_loss")
    random, spread = _random_entropy(t), t.curve("train/std")
    if not weight or not len(entropy):
        return None
    if random is not None:
        share = _late(entropy) / random
        if share < 0.97:
            return None
    elif not len(spread) or spread[-1] < 1.2 * spread[0]:
        return None
    else:
        share = float(spread[-1] / spread[0])
    last = float(np.mean(t.evaluations[-1]["returns"])) if t.evaluations else None
    return {"likelihood": 0.93 if weight >= 0.1 else 0.5, "weight": weight, "entropy": _late(entropy), "share": Share(share),
            "updates": len(entropy), "late": _late(t.episodes.returns), "last_evaluation": last,
            "evaluated": "" if last is None else f", and the last evaluation, without exploration, one of {last:.3g}"}  # fmt: skip


def _random_entropy(t: Training) -> float | None:
    """The entropy of a random policy; None where not all parts of the action are choices."""
    parts = t.program.policy.action
    options = [len(part.options) for part in parts if isinstance(part, Choices)]
    return float(np.log(options).sum()) if len(options) == len(parts) else None


def exploration_collapsed(t: Training) -> Numbers | None:
    """The policy hardly explores: {measure} is {value} after {steps} steps, and below {least} it finds little new.

    Try: Raise the noise: `train.ent_coef` of PPO and A2C, `train.action_noise` of DDPG and TD3; or lower `train.learning_rate`.
    """
    noise = t.settings.get("action_noise")
    sigma = getattr(getattr(noise, "sigma", None), "start", None)
    if sigma == 0:
        return {"likelihood": 0.85, "measure": "the standard deviation of the action noise", "value": 0.0, "least": 0.1, "steps": t.steps}
    entropy, spread, random = -t.curve("train/entropy_loss"), t.curve("train/std"), _random_entropy(t)
    if len(entropy) < _ENOUGH:
        return None
    known = {"likelihood": 0.6, "steps": t.steps // 2}
    if random is not None and (value := float(entropy[len(entropy) // 2])) < 0.05 * random:
        return {**known, "measure": "the entropy of the policy", "value": value, "least": 0.05 * random}
    if len(spread) and (value := float(spread[len(spread) // 2])) < 0.05:
        return {**known, "measure": "the standard deviation of the actions", "value": value, "least": 0.05}
    return None


def one_ending(t: Training) -> Numbers | None:
    """'{ending}' ends {share} of the last {episodes} episodes, after {length} steps on average.

    Try: `deepbots explain-episode RUN` shows the value and the bound of this ending in one of them.
    """
    late = t.episodes.part(0.75, 1.0)
    if len(late.returns) < _ENOUGH:
        return None
    name, count = Counter(late.endings).most_common(1)[0]
    share = count / len(late.returns)
    if name not in t.program.failures or share < 0.9 or len(t.program.endings) < 2 or too_few_steps(t) is not None:
        return None
    return {"likelihood": 0.25, "ending": name, "share": Share(share), "episodes": len(late.returns), "length": float(late.lengths.mean())}


def too_few_steps(t: Training) -> Numbers | None:
    """The policy still learns: the mean return of the last quarter of the training is {last}, {gain} above that of the first half, and the
    {steps} steps are {share} of the {planned} of the scenario.

    Try: Train on: deepbots train --resume {run} --timesteps {more}
    """
    returns = t.episodes.returns
    early, late = t.episodes.part(0.0, 0.5).returns, t.episodes.part(0.75, 1.0).returns
    if len(returns) < 2 * _ENOUGH:
        return None
    gain = float(late.mean() - early.mean())
    chance = 2 * float(np.hypot(early.std() / np.sqrt(len(early)), late.std() / np.sqrt(len(late))))
    if not gain > chance > 0:
        return None
    numbers = _length(t)
    likelihood = 0.8 if numbers["share"].value < 0.5 else 0.65
    return {**numbers, "likelihood": likelihood, "first": float(early.mean()), "last": float(late.mean()), "gain": gain, "chance": chance}


def short_training(t: Training) -> Numbers | None:
    """The training is short: {steps} steps and {episodes} episodes, {share} of the {planned} steps of the scenario.

    Try: Train on: deepbots train --resume {run} --timesteps {more}
    """
    numbers = _length(t)
    if numbers["share"].value >= 0.5 or too_few_steps(t) is not None:
        return None
    return {**numbers, "likelihood": 0.5, "episodes": len(t.episodes.returns)}


def _length(t: Training) -> dict[str, Any]:
    settings = t.program.policy.training
    planned = settings.total_timesteps if settings else t.run.record.total_timesteps
    share, more = Share(t.steps / planned), max(planned, 2 * t.steps)
    return {"steps": t.steps, "planned": planned, "share": share, "more": str(more), "run": str(t.run.path)}


CAUSES: tuple[Finder[Training], ...] = (
    ending_at_reset,
    not_finite,
    action_without_effect,
    ending_at_once,
    lint_warns,
    constant_observation,
    saturated_observation,
    term_dominates,
    ending_early_pays,
    standing_still_pays,
    success_never_seen,
    silent_terms,
    learning_rate_too_high,
    exploration_too_large,
    exploration_collapsed,
    one_ending,
    too_few_steps,
    short_training,
)
"""Why a training does not learn."""
