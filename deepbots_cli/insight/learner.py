"""Causes in the learner: its rate, horizon and exploration, and the settings of a training that fell apart.

deepbots weighs each setting of a training that fell apart by its distance from the usual value, on a scale
of its own where 1 means "often breaks a training that has learned", and by the scalars of the run: an
update that changes the policy a lot has a large KL divergence, a weight of the entropy that is too large
lets the entropy rise again. `tests/insight/collapses.py` measures how often the planted setting is
named.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from statistics import fmean
from typing import Any, NamedTuple

import numpy as np

from deepbots_cli.insight.rewards import rising_term
from deepbots_cli.insight.stages import criterion, hides_success, needs_exploration
from deepbots_cli.insight.statements import Numbers, Percentage, sentence
from deepbots_cli.insight.training import (
    MIN_EPISODES,
    TrainingEvidence,
    last_quarter,
    mean_return,
)
from deepbots_cli.learning.runs.verdict import Decline
from deepbots_cli.program.task import Schedule, Training
from deepbots_cli.scenario.training import ALGORITHMS
from deepbots_cli.words import number_text, rate_text

SUSPECTED = 0.5
"""The weight from which a setting is named; settings of shipped scenarios stay below."""
MAX_SUSPECTS = 2
"""The largest number of settings that are named."""
_LARGE_UPDATE = 0.03
"""The KL divergence of an update that changes the policy a lot. In a usual update it is 0.003 to 0.02; see
`_of_scale`."""
_USUAL_RETURN, _BREAKING_RETURNS = 300.0, 10.0
"""The returns for which a critic is suited, and the factor of returns that break it."""


class Suspect(NamedTuple):
    """A setting that explains a fall: its path, its value and the one to write, both as text, a reason, and
    how likely it is."""

    path: str
    now: str
    advised: str
    reason: str
    weight: float

    @property
    def advice(self) -> str:
        return f"`{self.path}: {self.advised}`" + (f" instead of {self.now}" if self.now else "")


class _Scale(NamedTuple):
    """The scale of a setting: its usual value, and the distance from it that often breaks a training.

    Attributes:
        usual: Its usual value; None for its default.
        times: The factor on the usual value that often breaks a training; below 1 for values that are too
            small.
        acts_by_updates: Whether it breaks it by updates that change the policy a lot.
    """

    usual: float | None
    times: float
    acts_by_updates: bool = False


_ON_POLICY: Mapping[str, _Scale] = {
    "learning_rate": _Scale(None, 5, acts_by_updates=True),
    "n_epochs": _Scale(10, 5, acts_by_updates=True),
    "clip_range": _Scale(0.2, 2.5, acts_by_updates=True),
    "batch_size": _Scale(64, 1 / 4, acts_by_updates=True),
    "max_grad_norm": _Scale(0.5, 20, acts_by_updates=True),
    "ent_coef": _Scale(0.01, 8),
    "vf_coef": _Scale(0.5, 20),
}
_OFF_POLICY: Mapping[str, _Scale] = {
    "learning_rate": _Scale(1e-3, 5),
    "batch_size": _Scale(None, 1 / 20),
    "tau": _Scale(None, 40),
    "buffer_size": _Scale(None, 1 / 20),
    "target_update_interval": _Scale(None, 1 / 50),
    "exploration_final_eps": _Scale(0.05, 6),
    "ent_coef": _Scale(0.02, 10),
}


def fell_apart(evidence: TrainingEvidence) -> Numbers | None:
    fall = evidence.decline
    if fall is None or evidence.rivals:  # less success against a rival is its gain: `rival_improved`
        return None
    numbers = {name: value for name, value in fall.as_json().items() if name != "text"}
    numbers["fall"] = sentence(fall.text)
    before, after = _returns_meanwhile(evidence, fall)
    if after >= before:
        return {
            **numbers,
            "likelihood": 0.5,
            "reasons": f"Meanwhile the mean return rose from {number_text(before)} to {number_text(after)}:"
            f" the reward pays for something other than success{_paying_term(evidence)}.",
            "advice": "Make a success earn more than everything else that an episode can collect; `deepbots"
            " lint` and `lint --exploits` look for such payments.",
            "suspects": [],
        }
    causes = suspects(evidence, fall)[:MAX_SUSPECTS]
    settings = {suspect.path: suspect.advised for suspect in causes[:1]} or _fallback(evidence)
    reasons = ". Or ".join(suspect.reason for suspect in causes) or (
        "no setting is unusual: later updates may still be too large for a policy that has learned"
    )
    advice = f"Write {', or '.join(suspect.advice for suspect in causes)}."
    if not causes:
        change = " and ".join(f"`{path}: {value}`" for path, value in settings.items())
        smaller = f"Write {change}, so that updates become smaller."
        advice = smaller if change else "Train with further seeds: `--seeds 0..4`."
    return {
        **numbers,
        # Before the rows of single settings; after faults of the reward if no setting is far from usual.
        "likelihood": 0.945 if causes and causes[0].weight >= 1.0 else 0.9,
        "reasons": sentence(f"{reasons}."),
        "advice": advice,
        "suspects": [suspect._asdict() for suspect in causes],
        "settings": settings,
    }


def _returns_meanwhile(evidence: TrainingEvidence, fall: Decline) -> tuple[float, float]:
    """Return the mean return of the evaluations at the best model and of the last ones; NaN for a fall of the
    return."""
    points = [
        (evaluation["steps"], fmean(evaluation["returns"]))
        for evaluation in evidence.evaluations
        if "steps" in evaluation and fall.measure == "success_rate"
    ]
    best = [value for steps, value in points if steps == fall.best_steps]
    late = [value for steps, value in points if steps >= fall.last_steps]
    return (best[0], fmean(late)) if best and late else (math.nan, math.nan)


def _paying_term(evidence: TrainingEvidence) -> str:
    """Return the reward term that rose most, in words; empty where none rose."""
    rise = rising_term(evidence)
    if rise is None:
        return ""
    before, after = (number_text(value) for value in rise[1:])
    return f". The term '{rise[0]}' rose most, from {before} to {after} per episode"


def suspects(evidence: TrainingEvidence, fall: Decline) -> list[Suspect]:
    """Return the settings that explain a fall, the most likely first, and only those whose value is not the
    advised one."""
    training = evidence.program.agent.training
    if training is None:
        return []
    is_off_policy = "buffer_size" in evidence.settings
    scales = _OFF_POLICY if is_off_policy else _ON_POLICY
    causes = [_of_scale(evidence, fall, name, scale) for name, scale in scales.items()]
    further = _off_policy_suspects if is_off_policy else _on_policy_suspects
    causes += [*_shared_suspects(evidence, fall, training), *further(evidence, fall, training)]
    by_path: dict[str, Suspect] = {}  # the strongest of several reasons for a change of one setting
    for suspect in sorted(filter(None, causes), key=lambda suspect: -suspect.weight):
        if suspect.weight >= SUSPECTED and suspect.now != suspect.advised:
            by_path.setdefault(suspect.path, suspect)
    return list(by_path.values())


def _of_scale(evidence: TrainingEvidence, fall: Decline, name: str, scale: _Scale) -> Suspect | None:
    """Detect a number that is too large or too small."""
    value, default = _value_at(evidence, name, fall.since_steps), evidence.usual_settings.get(name)
    usual = scale.usual
    if usual is None:
        usual = default if isinstance(default, int | float) else 3e-4
    if value is None or value <= 0 or usual <= 0:
        return None
    weight = math.log(value / usual) / math.log(scale.times)
    times = value / usual if scale.times > 1 else usual / value
    size = f"{times:.2g} times" if scale.times > 1 else f"{times:.2g} times smaller than"
    reason = f"`{name}` is {value:g}, {size} the usual {usual:g}"
    if scale.acts_by_updates:
        divergence = _part(evidence, "train/approx_kl", fall.best_steps)
        if len(divergence):
            high = float(np.quantile(divergence, 0.9))
            weight *= 1.0 if high >= _LARGE_UPDATE else 0.6
            size = f"up to {divergence.max():.2g} (usual: 0.003 to 0.02)"
            reason += (
                f"; the KL divergence, by which an update changes the policy, is {size} since"
                f" {fall.best_steps:,} steps"
            )
    if name == "ent_coef":
        ends = (0.5 * fall.best_steps, fall.best_steps), (fall.since_steps, math.inf)
        before, after = (-_part(evidence, "train/entropy_loss", *part) for part in ends)
        if len(before) and len(after):
            rise = float(after.mean() - before.mean())
            weight *= 1.2 if rise > 0 else 0.8
            reason += f"; the entropy went from {before.mean():.2g} to {after.mean():.2g}"
    now = evidence.settings.get(name)
    text = now.text if isinstance(now, Schedule) else f"{value:g}"
    return Suspect(f"train.{name}", text, _advised(evidence, name, usual, default), reason, weight)


def _advised(evidence: TrainingEvidence, name: str, usual: float, default: Any) -> str:
    """Return the value to write."""
    if name == "batch_size" and (rows := _rows(evidence)):
        return f"{next((size for size in (256, 128, 64, 32) if rows % size == 0 and size < rows), rows)}"
    if name == "ent_coef" and isinstance(default, str):
        return default
    if name == "learning_rate":
        rate = min(usual, default) if isinstance(default, int | float) else usual
        return f"{rate:g} -> {rate / 10:g}"
    return f"{usual:g}" if usual != int(usual) or usual < 10_000 else f"{int(usual):_}"


def _shared_suspects(evidence: TrainingEvidence, fall: Decline, training: Training) -> Iterator[Suspect]:
    """Yield settings of any algorithm that need more than a scale."""
    high = max((abs(value) for row in evidence.evaluations for value in row["returns"]), default=0.0)
    if training.normalize != "reward" and high > 0:  # returns that are too large for a critic
        weight = math.log(high / _USUAL_RETURN) / math.log(_BREAKING_RETURNS)
        reason = f"the rewards are large: the returns of evaluations are up to {number_text(high)}"
        explained = _part(evidence, "train/explained_variance", fall.best_steps)
        if len(explained):
            median = float(np.median(explained))
            weight += 0.3 if median < 0.3 else 0.0
            reason += f", and the critic explains {rate_text(max(0.0, median))} of their variance"
        yield Suspect("train.normalize", "", "reward", reason, weight)
    gamma, length = evidence.number_setting("gamma"), evidence.longest
    if gamma is not None:
        # A horizon 1 / (1 - gamma) of a quarter of the longest episode. A third of it is common; a tenth
        # hides the end of an episode.
        advised = min(0.99, max(0.9, round(1 - 4 / length, 3)))
        horizon, usual = 1 / max(1e-6, 1 - gamma), 1 / (1 - advised)
        ratio, verb = (usual / horizon, "count") if horizon < usual else (horizon / usual, "add up")
        weight = math.log(ratio) / math.log(8 if horizon < usual else 30)
        reason = f"`gamma` is {gamma:g}: rewards {verb} over about {horizon:.0f} of {length:,} steps"
        if gamma >= 1:
            weight, reason = 0.9, "`gamma` is 1, so errors of the critic about later rewards do not fade"
        yield Suspect("train.gamma", f"{gamma:g}", f"{advised:g}", reason, weight)
    if (sigma := _noise_of(evidence)) is not None:  # that hides the actions of the policy, or is absent
        value = sigma.at(evidence.progress(fall.since_steps))
        weight = math.log(value / 0.2) / math.log(4) if value > 0 else 0.7
        path, written = evidence.noise_setting("0.3 -> 0.1")
        reason = f"the noise on actions has a standard deviation of {value:.2g}, and 0.1 to 0.4 is usual"
        yield Suspect(path, sigma.text, written, reason, weight)
    # A policy that was better while it imitated than after it learned by itself.
    steps, values = evidence.scalars.get("teacher/weight", (np.zeros(0), np.zeros(0)))
    alone, rate = steps[values < 1.0], _value_at(evidence, "learning_rate", fall.since_steps)
    if len(alone) and fall.since_steps >= alone[0] and rate is not None:
        reason = (
            f"it fell after the teacher had ended, at {int(alone[0]):,} steps: the updates of the algorithm"
            " undo what was imitated"
        )
        yield Suspect("train.learning_rate", f"{rate:g}", f"{rate / 5:.1g}", reason, 0.75)


def _on_policy_suspects(evidence: TrainingEvidence, fall: Decline, training: Training) -> Iterator[Suspect]:
    trace, algorithm = evidence.number_setting("gae_lambda"), ALGORITHMS.get(training.algorithm)
    is_a2c = algorithm is not None and algorithm.base() == "A2C"
    # A `gae_lambda` of 1 gives noisy advantages, those of a small one depend on an inaccurate critic.
    if trace is not None and not is_a2c and not 0.6 <= trace < 0.995:
        reason = f"`gae_lambda` is {trace:g}, and 0.8 to 0.95 is usual"
        yield Suspect("train.gae_lambda", f"{trace:g}", "0.9", reason, 0.8)
    rows, steps = _rows(evidence), evidence.number_setting("n_steps")
    if rows and steps and "n_epochs" in evidence.settings:
        usual, weight = max(32.0, 256 / rows * steps), math.log(256 / rows) / math.log(8)
        reason = f"an update uses {rows:,.0f} steps only (`n_steps` in each world), and 256 or more are usual"
        yield Suspect("train.n_steps", f"{steps:g}", f"{usual:.0f}", reason, weight)
    if "n_epochs" in evidence.settings and evidence.settings.get("normalize_advantage") is False:
        reason = "`normalize_advantage` is false, so that updates are as large as the rewards"
        yield Suspect("train.normalize_advantage", "false", "true", reason, 0.9)


def _off_policy_suspects(evidence: TrainingEvidence, fall: Decline, training: Training) -> Iterator[Suspect]:
    updates, often = (evidence.number_setting(name) for name in ("gradient_steps", "train_freq"))
    ratio = updates / (often * training.environments) if updates and often else 0.0
    if ratio > 1:
        reason = f"`gradient_steps` makes {ratio:.2g} updates for each step of a world, and 1 is usual"
        yield Suspect("train.gradient_steps", f"{updates:g}", "-1", reason, math.log(ratio) / math.log(6))


def _noise_of(evidence: TrainingEvidence) -> Schedule | None:
    """Return the standard deviation of the action noise."""
    return getattr(evidence.settings.get("action_noise"), "sigma", None)


def _fallback(evidence: TrainingEvidence) -> dict[str, str]:
    """Return what to change if no setting is unusual."""
    rate = evidence.settings.get("learning_rate")
    if isinstance(rate, int | float) and rate > 0:
        return {"train.learning_rate": f"{rate:g} -> {rate / 10:g}"}
    if isinstance(rate, Schedule) and rate.start > 0:
        return {"train.learning_rate": f"{rate.start / 3:.1g} -> {rate.end / 3:.1g}"}
    return {}


# Numbers


def _rows(evidence: TrainingEvidence) -> int:
    """Return the steps of all rows between two updates of an on-policy algorithm; 0 for another one."""
    training, copies = evidence.program.agent.training, evidence.program.agent.copies
    steps = evidence.number_setting("n_steps")
    if training is None or steps is None or "buffer_size" in evidence.settings:
        return 0
    return int(steps) * training.environments * (copies.count if copies else 1)


def _value_at(evidence: TrainingEvidence, name: str, steps: float) -> float | None:
    """Return a hyperparameter after so many steps; None where it is not a number."""
    value = evidence.settings.get(name)
    if isinstance(value, Schedule):
        return value.at(evidence.progress(steps))
    return evidence.number_setting(name)


def _part(evidence: TrainingEvidence, tag: str, first: float, last: float = math.inf) -> Any:
    """Return the finite values of a scalar between two numbers of steps."""
    steps, values = evidence.scalars.get(tag, (np.zeros(0), np.zeros(0)))
    return values[(steps >= first) & (steps <= last) & np.isfinite(values)]


_LARGE_RETURN = 1000.0
"""The absolute mean return from which a critic of the usual learning rate falls behind: CartPole with 1000
for each step is not learned."""
_HIDDEN = 6.0
"""The number of steps, in units of 1 / (1 - gamma), after which a reward has less than 0.3 % of its
weight."""


def usual_rate(evidence: TrainingEvidence) -> float:
    """Return the default learning rate, of deepbots or the library."""
    rate = evidence.usual_settings.get("learning_rate")
    return float(rate) if isinstance(rate, int | float) else 3e-4  # of the library


def learning_rate_too_high(evidence: TrainingEvidence) -> Numbers | None:
    rate, usual = evidence.number_setting("learning_rate"), usual_rate(evidence)
    causes = suspects(evidence, evidence.decline) if evidence.decline is not None else ()
    if rate is None or "train.learning_rate" in {suspect.path for suspect in causes}:
        return None
    clipped, kl = (
        float(evidence.curve(f"train/{name}").max(initial=0.0)) for name in ("clip_fraction", "approx_kl")
    )
    times = rate / usual
    if times < 20 and (times <= 2 or (clipped < 0.5 and kl < 0.3)):
        return None
    unlikely = 0.75 if times > 5 else 0.5
    return {
        "likelihood": 0.93 if times >= 20 else unlikely,
        **_rate_numbers(evidence, rate, rate / usual),
        "clipped": Percentage(clipped),
        "kl": kl,
    }


def learning_rate_too_low(evidence: TrainingEvidence) -> Numbers | None:
    rate, usual = evidence.number_setting("learning_rate"), usual_rate(evidence)
    kl, numbers = evidence.curve("train/approx_kl"), ""
    if not rate or evidence.return_trend.direction == "rises":
        return None
    # In an update of PPO with a usual rate, the KL divergence is about 0.01.
    if usual < 10 * rate or (kl.max() > 1e-3 if len(kl) else usual < 50 * rate):
        return None
    if len(kl):
        numbers = f", and the largest KL divergence, by which an update changes the policy, is {kl.max():.2g}"
    return {**_rate_numbers(evidence, rate, usual / rate), "steps": evidence.steps, "divergence": numbers}


def _rate_numbers(evidence: TrainingEvidence, rate: float, times: float) -> dict[str, Any]:
    usual = usual_rate(evidence)
    return {
        "rate": rate,
        "usual": usual,
        "times": times,
        "first": mean_return(evidence, 0.0, 0.25),
        "last": mean_return(evidence, 0.75, 1.0),
        "settings": {"train.learning_rate": f"{usual:g}"},
    }


def rewards_too_large(evidence: TrainingEvidence) -> Numbers | None:
    training, explained = evidence.program.agent.training, evidence.curve("train/explained_variance")
    if training is None or training.normalize == "reward" or len(explained) < MIN_EPISODES:
        return None
    returns, median = evidence.late.returns, float(np.median(last_quarter(explained)))
    if median > 0.3 or np.abs(returns).mean() < _LARGE_RETURN:
        return None
    numbers = {"late": float(returns.mean()), "explained": Percentage(max(0.0, median))}
    return {**numbers, "settings": {"train.normalize": "reward"}}


def horizon_too_short(evidence: TrainingEvidence) -> Numbers | None:
    gamma, won = evidence.number_setting("gamma"), evidence.episodes.lengths[evidence.episodes.successes > 0]
    has_successes = len(won) >= MIN_EPISODES
    length = float(np.median(won)) if has_successes else float(evidence.longest)
    if gamma is None or gamma >= 1.0 or length * (1.0 - gamma) < _HIDDEN:
        return None
    is_far, facts = length * (1.0 - gamma) > 5 * _HIDDEN, evidence.facts
    pays_on_the_way = not has_successes and (
        facts.terms_towards_success or not evidence.program.defines_success
    )
    if not is_far and (facts.pays_in_ordinary_steps_only or pays_on_the_way):
        return None
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


def exploration_hides_success(evidence: TrainingEvidence) -> Numbers | None:
    hidden, until = hides_success(evidence), criterion(evidence)
    if hidden is None:
        return None
    counts = until is not None and until.episodes is not None and until.metric != "steps"
    by_evaluation = ["let evaluations end the stage, with `in evaluation` in its `until`"] if counts else []
    less = _exploration_changes(evidence, 0.1)
    shorten = "shorten the time for which the success condition must be true"
    return {
        "without": hidden[0],
        "with": hidden[1],
        "where": f" in stage '{evidence.stage}'" if evidence.stage else "",
        "remedy": sentence(" and ".join([*by_evaluation, *map(str, less)]) or shorten),
        "settings": _settings(less),
    }


def success_needs_exploration(evidence: TrainingEvidence) -> Numbers | None:
    needed, otherwise = (
        needs_exploration(evidence),
        "If it still needs the noise then, let no action be standing still",
    )
    if needed is None:
        return None
    if all(entry.name != "previous_action" for entry in evidence.program.agent.observation):
        otherwise += ", or show the policy its previous action (`previous_action: auto` under `observation`)"
    return {
        **evidence.length(),
        "otherwise": f"{otherwise}.",
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
    noise = _noise_of(evidence)
    if weight is not None and (weight or factor > 1):
        changes.append(Change("train.ent_coef", f"{weight:g}", f"{weight * factor or 0.01:.2g}", verb))
    elif isinstance(settings.get("ent_coef"), str):
        target = -len(evidence.program.agent.range_names) * (0.5 if factor > 1 else 2)
        changes.append(Change("train.target_entropy", f"{settings.get('target_entropy')}", f"{target:g}"))
    if noise is not None and (noise.end or factor > 1):
        less, more = f"{noise.start:g} -> {0.1 * noise.end:.2g}", f"{max(0.3, 2 * noise.start):.2g}"
        path, value = evidence.noise_setting(more if factor > 1 else less)
        changes.append(Change(path, noise.text, value, verb))
    if chance is not None and (chance or factor > 1):
        wanted = max(chance, min(0.3, 3 * chance or 0.1)) if factor > 1 else 0.1 * chance
        changes.append(Change("train.exploration_final_eps", f"{chance:g}", f"{wanted:.2g}", verb))
    return [change for change in changes if change.after != change.before]


def exploration_too_large(evidence: TrainingEvidence) -> Numbers | None:
    weight, random = evidence.number_setting("ent_coef"), _random_entropy(evidence)
    entropy, spread = -evidence.curve("train/entropy_loss"), evidence.curve("train/std")
    if not weight or not len(entropy) or (random is None and not len(spread)):
        return None
    late = float(last_quarter(entropy).mean())
    share = float(spread[-1] / spread[0]) if random is None else late / random
    if share < (1.2 if random is None else 0.97):
        return None
    last, evaluated = fmean(evidence.evaluations[-1]["returns"]) if evidence.evaluations else None, ""
    if last is not None:
        evaluated = f", and that of the last evaluation, without exploration, {number_text(last, 3)}"
    return {
        "likelihood": 0.93 if weight >= 0.1 else 0.5,
        "weight": weight,
        "entropy": late,
        "share": Percentage(share),
        "randomness": f"{Percentage(share)} of" if share < 10 else "more than 10 times",
        "updates": len(entropy),
        "late": mean_return(evidence, 0.75, 1.0),
        "last_evaluation": last,
        "evaluated": evaluated,
        "wanted": min(0.01, 0.1 * weight),
        "settings": {"train.ent_coef": f"{min(0.01, 0.1 * weight):.3g}"},
    }


def _random_entropy(evidence: TrainingEvidence) -> float | None:
    """Return the entropy of a random policy; None where not all parts of the action are choices."""
    agent = evidence.program.agent
    return None if agent.ranges else float(np.log([len(choice.options) for choice in agent.choices]).sum())


def exploration_collapsed(evidence: TrainingEvidence) -> Numbers | None:
    rate, random, sigma = (
        evidence.number_setting("learning_rate"),
        _random_entropy(evidence),
        _noise_of(evidence),
    )
    measures: list[tuple[float, str, Any, float]] = [
        (
            0.6,
            "the entropy of the policy",
            -evidence.curve("train/entropy_loss"),
            0.05 * (random or -math.inf),
        ),
        (0.6, "the standard deviation of the actions", evidence.curve("train/std"), 0.05),
    ]
    if sigma is not None and sigma.start == 0:
        measures.insert(0, (0.85, "the standard deviation of the action noise", np.zeros(MIN_EPISODES), 0.1))
    collapsed = (row for row in measures if len(row[2]) >= MIN_EPISODES and row[2][len(row[2]) // 2] < row[3])
    row = next(collapsed, None)
    if row is None:
        return None
    likelihood, measure, curve, least = row
    more, slower = _exploration_changes(evidence, 10.0), list[Change]()
    if rate is not None:
        slow = f"{min(rate / 3, usual_rate(evidence)):.1g}"
        slower = [Change("train.learning_rate", f"{rate:g}", slow, "lower")]
    return {
        "likelihood": likelihood,
        "measure": measure,
        "value": float(curve[len(curve) // 2]),
        "least": least,
        "steps": evidence.steps // (1 if likelihood > 0.6 else 2),
        "remedy": sentence(" or ".join(map(str, [*more, *slower])) or "raise the noise of the algorithm"),
        "settings": _settings(more or slower),
    }
