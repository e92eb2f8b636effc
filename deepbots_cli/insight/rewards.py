"""Causes in the reward: terms that reward something other than success, or nothing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import fmean
from typing import Any, NamedTuple

import numpy as np

from deepbots_cli.analysis import possible_returns
from deepbots_cli.analysis.ranges import break_even
from deepbots_cli.insight.stages import hides_success, plateau
from deepbots_cli.insight.statements import Numbers, Percentage, SuccessRate, list_text
from deepbots_cli.insight.trace import Trace, comparisons_in, measure
from deepbots_cli.insight.training import (
    MIN_EPISODES,
    TrainingEvidence,
    commonest_ending,
    last_quarter,
    mean_return,
)
from deepbots_cli.words import number_text, rate_text

_LIMITS = ("max_steps", "max_time")
_CLEARLY_MORE = 0.05
"""The share of a mean return by which another one must exceed it to be more."""


def per_step(traces: Sequence[Trace]) -> float:
    """Return the mean reward of a step of episodes."""
    return sum(trace.returns for trace in traces) / max(1, sum(trace.steps for trace in traces))


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
        "term": name,
        "share": Percentage(share),
        "mean": sums[name] / steps,
        "others": other_sum / steps,
        "steps": steps,
    }


def reward_exploited(evidence: TrainingEvidence) -> Numbers | None:
    pairs = ((example, outcome) for example in _examples(evidence) for outcome in _policy_outcomes(evidence))
    example, outcome = next((pair for pair in pairs if _exploits(*pair)), (None, None))
    if example is None or outcome is None:
        return None
    terms = {
        name: float(curve[int(0.75 * len(curve)) :].mean()) for name, curve in evidence.term_curves.items()
    }
    extra = {name: value - example.terms.get(name, 0.0) for name, value in terms.items()}
    term = max(extra, key=lambda name: extra[name], default="")
    paying, term_text = "", "the term that pays for it"
    if term and extra[term] > 0:
        of_policy, of_example = (number_text(paid.get(term, 0.0), 3) for paid in (terms, example.terms))
        term_text = f"'{term}'"
        paying = f" {term_text} pays most of the difference: {of_policy} per episode, and {of_example} in"
        paying += f" {example.episode}."
    once = f"Let {term_text} pay once, or only for a change (`delta(...)`), or end the episode where it pays"
    if term and evidence.facts.uses_earlier_values(term):
        once = f"Scale {term_text} down"
    return {
        "what": outcome.name,
        "gained": fmean(outcome.returns),
        "by_example": fmean(example.returns),
        "example": example.name,
        "policy": SuccessRate(outcome.successes),
        "and_example": f", and the script in {SuccessRate(example.successes)}" if example.is_script else "",
        "term": term,
        "terms": terms,
        "example_terms": example.terms,
        "paying": paying,
        "remedy": f"{once}. A success must earn more than an episode without success can collect.",
    }


class _Outcome(NamedTuple):
    """Returns and successes in some episodes, and their name. Of an example, with which the policy is
    compared, also the name of one of the episodes, and their mean reward terms."""

    name: str
    returns: Sequence[float]
    successes: Sequence[float]
    episode: str = ""
    terms: Mapping[str, float] = {}
    is_script: bool = False


def _examples(evidence: TrainingEvidence) -> list[_Outcome]:
    """Return the script that succeeds most, and the successful episodes of the quoted evaluation if they are
    at least half of it."""
    if not evidence.program.defines_success:
        return []
    names, rates = [term.name for term in evidence.program.agent.reward], evidence.script_rates
    examples = []
    if rates:
        script = max(rates, key=lambda name: rates[name]["successes"])
        traces = evidence.scripts[script]
        terms = {name: fmean(trace.sums[name] for trace in traces) for name in names}
        returns, successes = [trace.returns for trace in traces], [trace.is_success for trace in traces]
        name = f"the script '{script}'"
        examples.append(_Outcome(name, returns, successes, f"an episode of {name}", terms, is_script=True))
    final = evidence.final_episodes if evidence.is_last_stage else ()
    succeeded = [episode for episode in final if episode.is_success]
    if len(succeeded) >= max(MIN_EPISODES, len(final) / 2):
        terms = {name: fmean(episode.terms.get(name, 0.0) for episode in succeeded) for name in names}
        returns = [episode.total_return for episode in succeeded]
        name = "the successful episodes of the evaluation"
        examples.append(_Outcome(name, returns, [1.0] * len(returns), "a successful one", terms))
    return examples


def _exploits(example: _Outcome, outcome: _Outcome) -> bool:
    """Return whether episodes of the policy return clearly more than the example and succeed clearly less
    often."""
    aimed, policy = SuccessRate(example.successes), SuccessRate(outcome.successes)
    expected, error = fmean(example.returns), _error_of_difference(outcome.returns, example.returns)
    margin = max(error, _CLEARLY_MORE * abs(expected))
    return policy.high < aimed.low and fmean(outcome.returns) - expected > margin


def _policy_outcomes(evidence: TrainingEvidence) -> list[_Outcome]:
    """Return the results of the policy at the end of the training: without exploration, with exploration, and
    of the kept model."""
    late, episodes = evidence.late_evaluations, evidence.late[-100:]
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


def ending_early_pays(evidence: TrainingEvidence) -> Numbers | None:
    late, episodes = evidence.late, evidence.episodes
    failed = float(np.mean(np.isin(late.endings, list(evidence.program.failures))))
    if failed < 0.5 or late.successes.mean() > 0.2:
        return None
    sooner, per_late_step = _fails_sooner(evidence), float(late.returns.sum() / max(1.0, late.lengths.sum()))
    varies = np.ptp(episodes.returns) > 0
    together = float(np.corrcoef(episodes.lengths, episodes.returns)[0, 1]) if varies else 0.0
    costs = per_late_step < 0 and per_step(evidence.policy) <= 0 and together < -0.5
    if not costs and sooner is None:
        return None
    prices = {name: evidence.facts.price_of(name) or 0.0 for name in evidence.program.failures}
    priced = [f"'{name}' costs {number_text(-paid, 3)} now" for name, paid in prices.items() if paid < 0]
    price = "make a failure cost more than the steps that it saves"
    return {
        "likelihood": 0.93 if sooner is None else 0.956,
        "reward": per_late_step,
        "failed": Percentage(failed),
        "length": float(late.lengths.mean()),
        "first": float(evidence.episodes_between(0.0, 0.25).lengths.mean()),
        "correlation": together,
        "correlated": f", and longer episodes have lower returns (correlation {together:.3g})"
        if costs
        else "",
        "price": f"{price} ({list_text(priced)})" if priced else price,
        "sooner": "",
        "saving": "",
        **(sooner or {}),
        **_going_on(evidence),
    }


def _fails_sooner(evidence: TrainingEvidence) -> dict[str, Any] | None:
    """Detect that a policy fails early to save costs: late episodes all end by one failure, after fewer steps
    than the first episodes."""
    first = evidence.episodes[: max(MIN_EPISODES, min(100, len(evidence.episodes) // 10))]
    late = evidence.late[-100:]
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
    numbers = {
        term: [number_text(end, 3) for end in ends[term]]
        for term in sorted(saved, key=lambda term: -saved[term])
    }
    costs = [f"'{term}' went from {start} to {after} per episode" for term, (start, after) in numbers.items()]
    return {
        "sooner": f" '{name}' ends {rate_text(share)} of them after {now:.0f} steps on average; the first"
        f" episodes of the training lasted {before:.0f}.",
        "saving": f" The shorter episodes save costs: {list_text(costs)}.",
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


def progress_advice(evidence: TrainingEvidence) -> str:
    """Return what to pay for instead of standing still."""
    facts = evidence.facts
    terms = [f"'{term}'" for term in facts.terms_towards_success if facts.uses_earlier_values(term)]
    if not terms:
        return "Reward progress towards success (such as the change of a distance)"
    return (
        f"Raise {list_text(terms)}, which already rewards progress, until it earns more than standing still"
    )


def loitering(evidence: TrainingEvidence) -> Numbers | None:
    late, won = evidence.episodes_between(0.5, 1.0), evidence.episodes.successes > 0
    at_limit = np.isin(late.endings, _LIMITS) & (late.successes == 0)
    staying = [
        trace
        for trace in evidence.policy
        if trace.outcome in ("time limit", "not ended") and trace.steps >= 2 * MIN_EPISODES
    ]
    stays = len(late) >= MIN_EPISODES and at_limit.mean() >= 0.3
    if not stays or 2 * sum(map(_stays_near, staying)) <= len(staying):
        return None
    halves = {
        term.name: np.concatenate([trace.terms[term.name][trace.steps // 2 :] for trace in staying])
        for term in evidence.program.agent.reward
    }
    paid = {name: float(values.mean()) for name, values in halves.items() if (values > 0).mean() >= 0.8}
    idles = evidence.idle and per_step(evidence.idle) >= 0.8 * per_step(evidence.policy)
    if not paid or sum(values.mean() for values in halves.values()) <= 0 or idles:
        return None
    name, wins, stayed = (
        max(paid, key=lambda term: paid[term]),
        int(won.sum()),
        float(late.returns[at_limit].mean()),
    )
    compared, gained = f"Of {len(won):,} episodes of the training, {wins:,} succeeded.", None
    if wins >= MIN_EPISODES:
        gained = float(evidence.episodes.returns[won].mean())
        compared = (
            f"The mean return of {wins:,} episodes with success is {number_text(gained, 3)}, that of late"
            f" ones without {number_text(stayed, 3)}."
        )
        if gained > stayed + 0.1 * abs(stayed):
            return None
    nearer = f"Make '{name}' reward coming nearer instead of being near (`delta(...)` of its value), e"
    return {
        "share": Percentage(float(at_limit.mean())),
        "term": name,
        "per_step": paid[name],
        "whole": paid[name] * evidence.longest,
        "steps": evidence.longest,
        "return_of_success": gained,
        "return_of_staying": stayed,
        "compared": compared,
        "nearer": "E" if evidence.facts.uses_earlier_values(name) else nearer,
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


def reward_apart_from_success(evidence: TrainingEvidence) -> Numbers | None:
    late = evidence.episodes_by_steps(0.5, 1.0)
    episodes = late if late.successes.sum() >= MIN_EPISODES else evidence.episodes
    won, lost = episodes.returns[episodes.successes > 0], episodes.returns[episodes.successes == 0]
    if min(len(won), len(lost)) < MIN_EPISODES or late.successes.mean() >= 0.8:
        return None
    first, last = (
        SuccessRate(part.successes) for part in (evidence.episodes_between(0.0, 0.25), evidence.late)
    )
    returns, term, rising = evidence.return_trend, rising_term(evidence), ""
    if term is not None:
        start, end = (number_text(value, 3) for value in term[1:])
        rising = f" '{term[0]}' rises most, from {start} to {end} per episode."
    numbers = {
        "return_of_success": float(won.mean()),
        "return_without": float(lost.mean()),
        "early": first,
        "late": last,
        "term": term[0] if term else "",
        "rising": rising,
    }
    if won.mean() < lost.mean() - _error_of_difference(won, lost):
        how = (
            f"the mean return is {number_text(won.mean(), 3)} in {len(won):,} episodes with success, and"
            f" {number_text(lost.mean(), 3)} in {len(lost):,} without"
        )
        return {**numbers, "likelihood": 0.925, "how": how}
    falls = last.high < first.low
    flat = (
        evidence.success_trend.direction in ("falls", "no longer rises")
        and plateau(evidence) is not None
        and last.rate <= first.rate + 0.03
        and hides_success(evidence) is None
    )
    if returns.direction != "rises" or not (falls or flat):
        return None
    how = (
        f"the mean return of the last quarter is {number_text(returns.late, 3)},"
        f" {number_text(returns.gain, 3)} above that of the second, and the success rate went from {first} in"
        f" the first quarter to {last} in the last one"
    )
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


def return_at_ceiling(evidence: TrainingEvidence) -> Numbers | None:
    solved, late, final = evidence.run.program.agent.solved, evidence.late, evidence.final_episodes
    required = None if solved is None else solved.mean_return
    sample, returns = "late episodes of the training", late.returns
    if len(final) >= MIN_EPISODES:
        sample, returns = "episodes of the evaluation", np.array([episode.total_return for episode in final])
    mean, low, high = float(returns.mean()), float(returns.min()), float(returns.max())
    is_missed = evidence.program.defines_success and late.successes.mean() < 0.8
    trend = evidence.return_trend.direction
    if mean <= 0 or mean >= (np.inf if required is None else required) or trend == "rises" or is_missed:
        return None
    most = max(high, float(evidence.episodes.returns.max()))
    _, bound = possible_returns(evidence.program)
    is_near = bound < np.inf and mean >= 0.95 * bound and (required is None or required > bound)
    # The same return in each episode may also be that of standing still, or that of a local optimum, which
    # others exceed.
    stands = evidence.idle and per_step(evidence.idle) >= 0.9 * per_step(evidence.policy or evidence.idle)
    is_same = high - low <= 2 * _CEILING * mean and most <= (1 + 2 * _CEILING) * mean
    has_grown = mean_return(evidence, 0.0, 0.1) < 0.9 * mean
    if not is_near and (stands or not is_same or not has_grown):
        return None
    bounded = (
        f" The reward allows at most {number_text(bound)} in {evidence.longest:,} steps." if is_near else ""
    )
    remedy = (
        "Pay more for what the policy should still improve, or accept the policy: more steps cannot raise"
        " this return."
    )
    if solved is not None and required is not None:
        remedy = (
            f"Ask for a return that is possible, such as `mean_return >= {np.floor(98 * mean) / 100:g} over"
            f" {solved.episodes} episodes`, or raise what limits it: the time of an episode, or the speed of"
            " the robot. More exploration or a longer training cannot."
        )
    return {
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
        "bounded": bounded,
        "asked": "" if required is None else f" `solved` asks for {required:g}.",
        "remedy": remedy,
    }
