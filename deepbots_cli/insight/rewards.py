"""Causes in the reward: terms that reward something other than success, or nothing."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import fmean
from typing import Any, NamedTuple

import numpy as np

from deepbots_cli.analysis import possible_returns
from deepbots_cli.analysis.returns import break_even
from deepbots_cli.insight.stages import hides_success, plateau
from deepbots_cli.insight.statements import Numbers, Percentage, SuccessRate, list_text, statement
from deepbots_cli.insight.trace import Trace, comparisons_in, measure
from deepbots_cli.insight.training import (
    MIN_EPISODES,
    TrainingEvidence,
    commonest_ending,
    last_quarter,
    mean_return,
    return_trend,
    success_trend,
)
from deepbots_cli.words import number_text, rate_text

_LIMITS = ("max_steps", "max_time")
_CLEARLY_MORE = 0.05
"""The share of a mean return by which another one must exceed it to be more."""


def _per_step(traces: Sequence[Trace]) -> float:
    return sum(trace.returns for trace in traces) / max(1, sum(trace.steps for trace in traces))


@statement(
    "term_dominates",
    "The reward term '{term}' dominates: it is {share} of the reward. With random actions it gives {mean}"
    " per step, and all other terms together give {others}.",
    advice="Scale '{term}' down until the other terms outweigh it, for example by a factor of 10.",
)
def term_dominates(evidence: TrainingEvidence) -> Numbers | None:
    names = [term.name for term in evidence.program.agent.reward]
    sums = {name: sum(trace.sums[name] for trace in evidence.random) for name in names}
    whole = sum(map(abs, sums.values()))
    if len(sums) < 2 or not whole:
        return None
    name = max(sums, key=lambda term: abs(sums[term]))
    share, other_sum = abs(sums[name]) / whole, sum(value for key, value in sums.items() if key != name)
    varies = any(np.ptp(trace.terms[name]) > 1e-9 for trace in evidence.random if trace.steps)
    others = [
        fmean(trace.returns - trace.sums[name] for trace in traces)
        for traces in (evidence.random, evidence.policy or evidence.random)
    ]
    # The policy earns the other terms all the same.
    if share < 0.55 or not varies or not sums[name] < 0 < other_sum or others[1] > 1.5 * others[0]:
        return None
    steps = sum(trace.steps for trace in evidence.random)
    return {
        "likelihood": 0.94,
        "term": name,
        "share": Percentage(share),
        "mean": sums[name] / steps,
        "others": other_sum / steps,
        "steps": steps,
    }


@statement(
    "reward_exploited",
    "The reward pays for something other than the success: the mean return of {what} is {gained}, more than"
    " the {by_example} of {example}, but the policy succeeds in {policy}{and_example}.{paying}",
    advice="{remedy}",
)
def reward_exploited(evidence: TrainingEvidence) -> Numbers | None:
    pairs = ((example, _exploiting_outcome(evidence, example)) for example in _examples(evidence))
    example, outcome = next((pair for pair in pairs if pair[1] is not None), (None, None))
    if example is None or outcome is None:
        return None
    terms = {
        name: float(curve[int(0.75 * len(curve)) :].mean()) for name, curve in evidence.term_curves.items()
    }
    extra = {name: value - example.terms.get(name, 0.0) for name, value in terms.items()}
    term = max(extra, key=lambda name: extra[name], default="")
    paying, term_text = "", "the term that pays for it"
    if term and extra[term] > 0:
        term_text = f"'{term}'"
        paying = (
            f" {term_text} pays most of the difference: {number_text(terms[term], 3)} per episode, and"
            f" {number_text(example.terms.get(term, 0.0), 3)}"
        )
        paying += f" in {example.episode}."
    once = f"Let {term_text} pay once, or only for a change (`delta(...)`), or end the episode where it pays"
    if term and evidence.facts.uses_earlier_values(term):
        once = f"Scale {term_text} down"
    aimed = SuccessRate(example.successes)
    return {
        "likelihood": 0.929,  # behind the causes that name what the policy does instead
        "what": outcome.name,
        "gained": fmean(outcome.returns),
        "by_example": fmean(example.returns),
        "example": example.name,
        "policy": SuccessRate(outcome.successes),
        "and_example": f", and the script in {aimed}" if example.is_script else "",
        "term": term,
        "terms": terms,
        "example_terms": example.terms,
        "paying": paying,
        "remedy": f"{once}. A success must earn more than an episode without success can collect.",
    }


class _Example(NamedTuple):
    """Episodes that succeed, or mostly, with which the policy is compared: their name, the name of one, and
    their mean reward terms."""

    name: str
    episode: str
    returns: Sequence[float]
    successes: Sequence[float]
    terms: dict[str, float]
    is_script: bool


def _examples(evidence: TrainingEvidence) -> list[_Example]:
    """Return the script that succeeds most, and the successful episodes of the quoted evaluation if they are
    at least half of it."""
    if not evidence.program.defines_success:
        return []
    names = [term.name for term in evidence.program.agent.reward]
    examples = []
    played = {name: traces for name, traces in evidence.scripts.items() if len(traces) >= MIN_EPISODES}
    if played:
        script, traces = max(played.items(), key=lambda entry: SuccessRate.of(entry[1])["successes"])
        terms = {name: fmean(trace.sums[name] for trace in traces) for name in names}
        returns, successes = [trace.returns for trace in traces], [trace.is_success for trace in traces]
        name = f"the script '{script}'"
        examples.append(_Example(name, f"an episode of {name}", returns, successes, terms, is_script=True))
    succeeded = (
        [episode for episode in evidence.final_episodes if episode.is_success]
        if evidence.is_last_stage
        else []
    )
    if len(succeeded) >= max(MIN_EPISODES, len(evidence.final_episodes) / 2):
        terms = {name: fmean(episode.terms.get(name, 0.0) for episode in succeeded) for name in names}
        returns = [episode.total_return for episode in succeeded]
        name = "the successful episodes of the evaluation"
        examples.append(
            _Example(name, "a successful one", returns, [1.0] * len(returns), terms, is_script=False)
        )
    return examples


def _exploiting_outcome(evidence: TrainingEvidence, example: _Example) -> _Outcome | None:
    """Return the episodes of the policy that return clearly more than the example and succeed clearly less
    often."""
    aimed, expected = SuccessRate(example.successes), fmean(example.returns)
    for outcome in _policy_outcomes(evidence):
        policy, gained = SuccessRate(outcome.successes), fmean(outcome.returns)
        error = _error_of_difference(outcome.returns, example.returns)
        if policy.high < aimed.low and gained - expected > max(error, _CLEARLY_MORE * abs(expected)):
            return outcome
    return None


class _Outcome(NamedTuple):
    """Returns and successes of the policy in some episodes, and the name of these."""

    name: str
    returns: Sequence[float]
    successes: Sequence[float]


def _policy_outcomes(evidence: TrainingEvidence) -> list[_Outcome]:
    """Return the results of the policy at the end of the training: without exploration, with exploration, and
    of the kept model."""
    late, episodes = evidence.late_evaluations, evidence.episodes_between(0.75, 1.0)[-100:]
    final = evidence.final_episodes if evidence.is_last_stage else ()
    outcomes = [
        _Outcome(
            "its last evaluations",
            [float(value) for evaluation in late for value in evaluation["returns"]],
            [float(value) for evaluation in late for value in evaluation["successes"]],
        ),
        _Outcome("the last episodes of the training", episodes.returns, episodes.successes),
        _Outcome(
            "the evaluation of the kept model",
            [episode.total_return for episode in final],
            [float(episode.is_success) for episode in final],
        ),
    ]
    return [outcome for outcome in outcomes if len(outcome.returns) >= MIN_EPISODES]


def _error_of_difference(first: Sequence[float], second: Sequence[float]) -> float:
    """Return the half width of the 95 % interval of the difference of two means."""
    return 2 * float(np.hypot(*(np.std(values) / np.sqrt(len(values)) for values in (first, second))))


@statement(
    "ending_early_pays",
    "Failing early pays: a step earns {reward} on average, {failed} of the late episodes"
    " fail{correlated}.{sooner}{saving}{going_on}",
    advice="Make good steps earn a positive reward (check the signs of the terms), or {price}.",
)
def ending_early_pays(evidence: TrainingEvidence) -> Numbers | None:
    late = evidence.episodes_between(0.75, 1.0)
    if len(late) < MIN_EPISODES or np.ptp(evidence.episodes.lengths) == 0:
        return None
    failed = float(np.mean([ending in evidence.program.failures for ending in late.endings]))
    per_step = float(late.returns.sum() / max(1.0, late.lengths.sum()))
    if failed < 0.5 or late.successes.mean() > 0.2:
        return None
    sooner = _fails_sooner(evidence)
    together = (
        float(np.corrcoef(evidence.episodes.lengths, evidence.episodes.returns)[0, 1])
        if np.ptp(evidence.episodes.returns)
        else 0.0
    )
    costs = per_step < 0 and _per_step(evidence.policy) <= 0 and together < -0.5
    if not costs and sooner is None:
        return None
    prices = [(name, evidence.facts.price_of(name)) for name in evidence.program.failures]
    priced = list_text(
        [
            f"'{name}' costs {number_text(-cost, 3)} now"
            for name, cost in prices
            if cost is not None and cost < 0
        ]
        or [""]
    )
    price = f"make a failure cost more than the steps that it saves{f' ({priced})' if priced else ''}"
    correlated = f", and longer episodes have lower returns (correlation {together:.3g})" if costs else ""
    return {
        "likelihood": 0.93 if sooner is None else 0.956,
        "reward": per_step,
        "failed": Percentage(failed),
        "length": float(late.lengths.mean()),
        "first": float(evidence.episodes_between(0.0, 0.25).lengths.mean()),
        "correlation": together,
        "correlated": correlated,
        "price": price,
        "sooner": "",
        "saving": "",
        **(sooner or {}),
        **_going_on(evidence),
    }


def _fails_sooner(evidence: TrainingEvidence) -> dict[str, Any] | None:
    """Detect that a policy fails early to save costs: late episodes all end by one failure, after fewer steps
    than the first episodes."""
    first = evidence.episodes[: max(MIN_EPISODES, min(100, len(evidence.episodes) // 10))]
    late = evidence.episodes_between(0.75, 1.0)[-100:]
    if len(evidence.episodes) < 10 * MIN_EPISODES:
        return None
    name, share = commonest_ending(late)
    before, now = float(first.lengths.mean()), float(late.lengths.mean())
    error = _error_of_difference(first.lengths, late.lengths)
    gain = float(late.returns.mean() - first.returns.mean())
    if (
        name not in evidence.program.failures
        or share < 0.95
        or not now < min(before - error, 0.85 * before)
        or gain <= 0
    ):
        return None
    ends = {
        term: (float(curve[: max(1, len(curve) // 20)].mean()), float(last_quarter(curve).mean()))
        for term, curve in evidence.term_curves.items()
    }
    saved = {term: after - start for term, (start, after) in ends.items() if start < after <= 0}
    if sum(saved.values()) < 0.5 * gain:  # what it does in these steps pays, such as coming nearer
        return None
    largest = sorted(saved, key=lambda term: -saved[term])
    costs = list_text(
        [
            "'{}' went from {} to {} per episode".format(term, *(number_text(end, 3) for end in ends[term]))
            for term in largest
        ]
    )
    return {
        "sooner": f" '{name}' ends {rate_text(share)} of them after {now:.0f} steps on"
        " average; the first episodes"
        f" of the training lasted {before:.0f}.",
        "saving": f" The shorter episodes save costs: {costs}.",
        "ending": name,
        "terms": {term: {"early": start, "late": after} for term, (start, after) in ends.items()},
    }


def _going_on(evidence: TrainingEvidence) -> Numbers:
    """Return the mean returns of failing, lasting until the time limit and succeeding, and the success rate
    from which going on pays."""
    episodes = evidence.episodes
    failed = episodes.returns[np.isin(episodes.endings, list(evidence.program.failures))]
    won = episodes.returns[episodes.successes > 0]
    lasted = episodes.returns[np.isin(episodes.endings, _LIMITS) & (episodes.successes == 0)]
    if min(len(failed), len(lasted)) < 3:
        return {"going_on": ""}
    fail, last = float(failed.mean()), float(lasted.mean())
    text = (
        f" The mean return is {number_text(fail, 3)} for a failure, and {number_text(last, 3)} for an episode"
        " that reaches its limit"
    )
    returns = {"failing": fail, "lasting": last}
    if len(won) and (win := float(won.mean())) > fail > last:
        returns |= {"succeeding": win, "break_even": break_even(last, fail, win)}
        text += (
            f"; for a success it is {number_text(win, 3)}, so continuing pays only if at least"
            f" {returns['break_even']:.0%} of such episodes succeed"
        )
    return {**returns, "going_on": f"{text}."}


@statement(
    "standing_still_pays",
    "Standing still pays: zero actions earn {still} per step, {others} {policy}, and {rate} of the late"
    " episodes succeed.",
    advice="{progress}, and make each step cost something instead of earning something.",
)
def standing_still_pays(evidence: TrainingEvidence) -> Numbers | None:
    late = evidence.episodes_between(0.75, 1.0)
    if (
        not evidence.idle
        or not evidence.program.defines_success
        or (len(late.successes) and late.successes.mean() >= 0.5)
    ):
        return None
    still, policy = _per_step(evidence.idle), _per_step(evidence.policy or evidence.random)
    outcomes = [trace.outcome for trace in evidence.idle]
    # Where standing still fails soon, it pays until then only.
    if (
        still <= 0
        or "success" in outcomes
        or 2 * outcomes.count("failure") > len(outcomes)
        or still < 0.8 * policy
    ):
        return None
    terms = [
        term for term in evidence.facts.terms_towards_success if evidence.facts.uses_earlier_values(term)
    ]
    progress = "Reward progress towards success (such as the change of a distance)"
    if terms:
        names = list_text([f"'{term}'" for term in terms])
        progress = f"Raise {names}, which already rewards progress, until it earns more than standing still"
    return {
        "likelihood": 0.93,
        "still": still,
        "policy": policy,
        "others": "the policy earns" if evidence.policy else "random actions earn",
        "random": _per_step(evidence.random),
        "episodes": len(evidence.idle),
        "rate": Percentage(float(late.successes.mean()) if len(late.successes) else 0.0),
        "progress": progress,
    }


@statement(
    "loitering",
    "Staying near success pays more than success: {share} of the late episodes reach the time limit. In the"
    " second half of such episodes, '{term}' gives {per_step} per step, which is {whole} for {steps} steps."
    " {compared}",
    advice="{nearer}nd the episode where it pays, or scale it down until an episode of it earns less than"
    " success.",
)
def loitering(evidence: TrainingEvidence) -> Numbers | None:
    if not evidence.program.defines_success or not evidence.is_mature or not evidence.policy:
        return None
    late = evidence.episodes_between(0.5, 1.0)
    at_limit, won = np.isin(late.endings, _LIMITS) & (late.successes == 0), evidence.episodes.successes > 0
    staying = [
        trace
        for trace in evidence.policy
        if trace.outcome in ("time limit", "not ended") and trace.steps >= 2 * MIN_EPISODES
    ]
    if (
        len(late) < MIN_EPISODES
        or at_limit.mean() < 0.3
        or 2 * sum(map(_stays_near, staying)) <= len(staying)
    ):
        return None
    halves = {
        term.name: np.concatenate([trace.terms[term.name][trace.steps // 2 :] for trace in staying])
        for term in evidence.program.agent.reward
    }
    paid = {name: float(values.mean()) for name, values in halves.items() if (values > 0).mean() >= 0.8}
    if (
        not paid
        or sum(values.mean() for values in halves.values()) <= 0
        or (evidence.idle and _per_step(evidence.idle) >= 0.8 * _per_step(evidence.policy))
    ):
        return None
    name = max(paid, key=lambda term: paid[term])
    stayed = float(late.returns[at_limit].mean())
    compared = f"Of {len(won):,} episodes of the training, {int(won.sum()):,} succeeded."
    gained = None
    if won.sum() >= MIN_EPISODES:
        gained = float(evidence.episodes.returns[won].mean())
        compared = (
            f"The mean return of {int(won.sum()):,} episodes with success is {number_text(gained, 3)}, that"
            " of"
            f" late ones without {number_text(stayed, 3)}."
        )
        if gained > stayed + 0.1 * abs(stayed):
            return None
    return {
        "likelihood": 0.935,
        "share": Percentage(float(at_limit.mean())),
        "term": name,
        "per_step": paid[name],
        "whole": paid[name] * evidence.longest,
        "steps": evidence.longest,
        "return_of_success": gained,
        "return_of_staying": stayed,
        "compared": compared,
        "nearer": "E"
        if evidence.facts.uses_earlier_values(name)
        else f"Make '{name}' reward coming nearer instead of being near (`delta(...)` of its value), e",
    }


def _stays_near(trace: Trace) -> bool:
    """Return whether an episode came near to a success and stayed there: a comparison that was false at its
    start is nearly true."""
    for name in trace.program.agent.success:
        condition = trace.instrumented.conditions.get(name)
        for outer in comparisons_in(condition) if condition is not None else ():
            for leaf in comparisons_in(outer.lasting) if outer.lasting is not None else (outer,):
                past = [measure(leaf, values) for values in trace.values]
                half, missing = past[len(past) // 2 :], [-(comparison.margin or 0.0) for comparison in past]
                nearer = leaf.bound is not None and np.median(missing[len(past) // 2 :]) <= 0.35 * missing[0]
                if not past[0].holds and (nearer or np.mean([moment.holds for moment in half]) >= 0.25):
                    return True
    return False


@statement(
    "reward_apart_from_success",
    "A higher return does not mean more success: {how}.{rising}",
    advice="Make a success earn more than an episode without success can collect, and scale down the terms"
    " that reward something else.",
)
def reward_apart_from_success(evidence: TrainingEvidence) -> Numbers | None:
    if not evidence.program.defines_success or not evidence.is_mature:
        return None
    late = evidence.episodes_by_steps(0.5, 1.0)
    episodes = late if late.successes.sum() >= MIN_EPISODES else evidence.episodes
    won, lost = episodes.returns[episodes.successes > 0], episodes.returns[episodes.successes == 0]
    if min(len(won), len(lost)) < MIN_EPISODES or late.successes.mean() >= 0.8:
        return None
    rates = [
        SuccessRate(window.successes)
        for window in (evidence.episodes_between(0.0, 0.25), evidence.episodes_between(0.75, 1.0))
    ]
    returns, success, term = return_trend(evidence), success_trend(evidence), rising_term(evidence)
    rising = (
        ""
        if term is None
        else f" '{term[0]}' rises most, from {number_text(term[1], 3)} to {number_text(term[2], 3)} per"
        " episode."
    )
    error = _error_of_difference(won, lost)
    numbers = {
        "return_of_success": float(won.mean()),
        "return_without": float(lost.mean()),
        "early": rates[0],
        "late": rates[1],
        "term": term[0] if term else "",
        "rising": rising,
    }
    if won.mean() < lost.mean() - error:
        how = (
            f"the mean return is {number_text(won.mean(), 3)} in {len(won):,} episodes with success, and"
            f" {number_text(lost.mean(), 3)} in {len(lost):,} without"
        )
        return {**numbers, "likelihood": 0.925, "how": how}
    falls = rates[1].high < rates[0].low
    flat = (
        success.direction in ("falls", "no longer rises")
        and plateau(evidence) is not None
        and rates[1].rate <= rates[0].rate + 0.03
        and hides_success(evidence) is None
    )
    if returns.direction != "rises" or not (falls or flat):
        return None
    how = (
        f"the mean return of the last quarter is {number_text(returns.late, 3)},"
        f" {number_text(returns.gain, 3)} above that of the"
        " second, and the success rate "
    )
    how += f"went from {rates[0]} in the first quarter to {rates[1]} in the last one"
    return {**numbers, "likelihood": 0.91 if falls else 0.72, "how": how}


def rising_term(evidence: TrainingEvidence) -> tuple[str, float, float] | None:
    """Return the reward term that rises most in the present stage, with its mean per episode in the first and
    in the last quarter."""
    ends = [
        (name, float(curve[: max(1, len(curve) // 4)].mean()), float(last_quarter(curve).mean()))
        for name, curve in evidence.term_curves.items()
    ]
    rising = max(ends, key=lambda end: end[2] - end[1], default=None)
    return rising if rising is not None and rising[2] > rising[1] else None


_CEILING = 0.01
"""The share by which returns must differ to be different."""


@statement(
    "return_at_ceiling",
    "The return is at its ceiling: it is {mean} {spread} {episodes} {what} (from {low} to {high}),"
    " {grown}and no episode of the training returned more than {most}.{bounded}{asked}",
    advice="{remedy}",
)
def return_at_ceiling(evidence: TrainingEvidence) -> Numbers | None:
    solved, late = evidence.run.program.agent.solved, evidence.episodes_between(0.75, 1.0)
    required = None if solved is None else solved.mean_return
    if (
        len(evidence.episodes) < 4 * MIN_EPISODES
        or (solved is not None and required is None)
        or not evidence.is_last_stage
    ):
        return None
    sample, returns = "late episodes of the training", late.returns
    if len(evidence.final_episodes) >= MIN_EPISODES:
        sample = "episodes of the evaluation"
        returns = np.array([episode.total_return for episode in evidence.final_episodes])
    mean, low, high = float(returns.mean()), float(returns.min()), float(returns.max())
    if (
        mean <= 0
        or (required is not None and mean >= required)
        or (trend := return_trend(evidence).direction) == "rises"
        or (evidence.program.defines_success and late.successes.mean() < 0.8)
    ):
        return None
    most = max(high, float(evidence.episodes.returns.max()))
    _, bound = possible_returns(evidence.program)
    is_near = bound < np.inf and mean >= 0.95 * bound and (required is None or required > bound)
    # The same return in each episode may also be that of standing still, or that of a local optimum, which
    # others exceed.
    stands = bool(evidence.idle) and _per_step(evidence.idle) >= 0.9 * _per_step(
        evidence.policy or evidence.idle
    )
    is_same = high - low <= 2 * _CEILING * mean and most <= (1 + 2 * _CEILING) * mean
    has_grown = mean_return(evidence, 0.0, 0.1) < 0.9 * mean
    if not is_near and (stands or not is_same or not has_grown):
        return None
    remedy = (
        "Pay more for what the policy should still improve, or accept the policy: more steps cannot"
        " raise this return."
    )
    if solved is not None and required is not None:
        remedy = (
            f"Ask for a return that is possible, such as `mean_return >= {np.floor(98 * mean) / 100:g} over"
            f" {solved.episodes} episodes`, or raise what limits it: the time of an episode, or the speed of"
            " the robot. More exploration or a longer training cannot."
        )
    return {
        "likelihood": 0.952,
        "mean": mean,
        "low": low,
        "high": high,
        "most": most,
        "spread": "in all of" if is_same else "on average in",
        "episodes": len(returns),
        "what": sample,
        "bound": bound if bound < np.inf else None,
        "required": required,
        "grown": "it no longer grows, " if trend else "",
        "bounded": f" The reward allows at most {number_text(bound)} in {evidence.longest:,} steps."
        if is_near
        else "",
        "asked": "" if required is None else f" `solved` asks for {required:g}.",
        "remedy": remedy,
    }
