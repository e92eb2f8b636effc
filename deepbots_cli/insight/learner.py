"""Causes in the learner: its rate, its horizon, its exploration."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import fmean
from typing import Any, NamedTuple

import numpy as np

from deepbots_cli.insight.collapse import suspects
from deepbots_cli.insight.ends import training_length
from deepbots_cli.insight.stages import criterion, hides_success, needs_exploration
from deepbots_cli.insight.statements import Numbers, Percentage, sentence, statement
from deepbots_cli.insight.training import MIN_EPISODES, TrainingEvidence, mean_return, return_trend
from deepbots_cli.learning.sb3.defaults import default_values, longest_episode
from deepbots_cli.words import number_text

_LARGE_RETURN = 1000.0
"""The absolute mean return from which a critic of the usual learning rate falls behind: CartPole with 1000
for each step is not learned."""
_HIDDEN = 6.0
"""The number of steps, in units of 1 / (1 - gamma), after which a reward has less than 0.3 % of its
weight."""


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
    first, last = mean_return(evidence, 0.0, 0.25), mean_return(evidence, 0.75, 1.0)
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
    if not rate or len(evidence.episodes) < 2 * MIN_EPISODES or return_trend(evidence).direction == "rises":
        return None
    # In an update of PPO with a usual rate, the KL divergence is about 0.01.
    if usual < 10 * rate or (kl.max() > 1e-3 if len(kl) else usual < 50 * rate):
        return None
    first, last = mean_return(evidence, 0.0, 0.25), mean_return(evidence, 0.75, 1.0)
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
        "remedy": sentence(remedy),
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
        "late": mean_return(evidence, 0.75, 1.0),
        "last_evaluation": last,
        "evaluated": ""
        if last is None
        else f", and that of the last evaluation, without exploration, {number_text(last, 3)}",
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
    remedy = sentence(" or ".join(map(str, [*more, *slower])) or "raise the noise of the algorithm")
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
