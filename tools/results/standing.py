"""How an experiment stands: what was measured of what is asked for, and which bars are met."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import sqrt
from statistics import fmean, median
from typing import Any, Literal

from scipy.special import stdtrit

from deepbots_cli.learning.runs.statistics import ALPHA, wilson
from tools.results import measure
from tools.results.experiment import Bar, Experiment, Held, Training, with_unit

Entry = Mapping[str, Any]


@dataclass(frozen=True)
class Verdict:
    """A bar beside what was measured, ready to be put in a table."""

    bar: Bar
    what: str
    requirement: str
    measured: str
    status: Literal["met", "missed", "not measured"]

    @property
    def word(self) -> str:
        """Reached or missed; a stretch bar that is not reached is not a failure."""
        if self.status == "not measured":
            return self.status
        if self.bar.stretch:
            return "reached" if self.status == "met" else "not reached"
        return "met" if self.status == "met" else "**missed**"


def judge(experiment: Experiment, bar: Bar, record: Entry) -> Verdict:
    """Whether a bar is met: what is asked, and what was measured."""
    figure = bar.figure
    seeds = len(experiment.training(figure.training).seeds) if figure.training else 1
    values, what = figure.values(record), bar.words or figure.words
    limit = bar.at_most if bar.at_most is not None else bar.at_least or 0.0
    statistic = str(seeds - bar.misses) if bar.over == "all" else bar.over
    whose = "" if seeds == 1 else f", {statistic} of {seeds} seeds"
    requirement = (
        f"{'stretch: ' if bar.stretch else ''}at {'most' if bar.at_most is not None else 'least'}"
        f" {with_unit(limit, figure.what)}{whose}"
    )
    good = sum(map(bar.holds, values))
    is_lost = bar.over == "all" and len(values) - good > bar.misses
    if len(values) < seeds and not is_lost:
        return Verdict(
            bar,
            what,
            requirement,
            f"{len(values)} of {seeds} seeds" if values and seeds > 1 else "",
            "not measured",
        )
    if bar.over == "all":  # seeds that fail are a miss, however many are still to come
        worst = max(values) if bar.at_most is not None else min(values)
        so_far = f", {len(values)} measured" if len(values) < seeds else ""
        measured = with_unit(worst, figure.what) + (
            f", the worst; {good} of {seeds} seeds{so_far}" if seeds > 1 else ""
        )
        return Verdict(bar, what, requirement, measured, "missed" if is_lost else "met")
    value = fmean(values) if bar.over == "mean" else median(values)
    return Verdict(
        bar, what, requirement, with_unit(value, figure.what), "met" if bar.holds(value) else "missed"
    )


@dataclass(frozen=True)
class Standing:
    """How an experiment stands: what of its record is asked for, what of that is of another version, and
    which bars are met.

    `record` holds only what the experiment names: seeds and trainings that it had before may still be in the
    file.
    """

    experiment: Experiment
    record: Entry

    @classmethod
    def of(cls, experiment: Experiment, record: Entry) -> Standing:
        measured = record.get("trainings", {})
        trainings = {
            training.name: {
                str(seed): measured[training.name][str(seed)]
                for seed in training.seeds
                if str(seed) in measured[training.name]
            }
            for training in experiment.trainings
            if training.name in measured
        }
        names = [baseline.name for baseline in experiment.baselines]
        baselines = {name: entry for name, entry in record.get("baselines", {}).items() if name in names}
        return cls(experiment, {"trainings": trainings, "baselines": baselines})

    def seeds(self, training: Training) -> dict[int, Entry]:
        """What was measured of each seed."""
        measured = self.record["trainings"].get(training.name, {})
        return {seed: measured[str(seed)] for seed in training.seeds if str(seed) in measured}

    def entries(self) -> Iterator[Entry]:
        """Whatever was measured: trainings, evaluations, baselines."""
        for training in self.experiment.trainings:
            for entry in self.seeds(training).values():
                yield entry
                yield from entry["evaluations"].values()
        yield from self.record["baselines"].values()

    def verdicts(self) -> list[Verdict]:
        return [judge(self.experiment, bar, self.record) for bar in self.experiment.bars]

    @cached_property
    def outdated(self) -> tuple[str, ...]:
        """What was measured of an earlier version of the scenario, or by another command than is asked for
        now."""
        return tuple(self._outdated())

    def _outdated(self) -> Iterator[str]:
        scenario = self.experiment.scenario
        for training in self.experiment.trainings:
            for seed, entry in self.seeds(training).items():
                place = f"seed {seed}" + ("" if training.name == "main" else f" ({training.name})")
                if not measure.training_request(scenario, training, seed).is_answered_by(entry):
                    yield place
                    continue
                held = [
                    (e, entry["evaluations"][e.name])
                    for e in training.evaluations
                    if e.name in entry["evaluations"]
                ]
                yield from (
                    f"{e.name} of {place}"
                    for e, evaluated in held
                    if not measure.evaluation_request(scenario, training, e).is_answered_by(evaluated)
                )
        for baseline in self.experiment.baselines:
            tried = self.record["baselines"].get(baseline.name)
            if tried is not None and not measure.baseline_request(scenario, baseline).is_answered_by(tried):
                yield baseline.name


# The episodes of several policies


def together(entries: Sequence[Entry]) -> Entry:
    """The held-out episodes of the policies of all seeds as one evaluation, with intervals over the
    episodes."""
    if len(entries) == 1:
        return entries[0]
    episodes = sum(entry["episodes"] for entry in entries)
    mean = sum(entry["mean_return"] * entry["episodes"] for entry in entries) / episodes
    successes = sum(entry["successes"] or 0 for entry in entries)
    is_success_defined = entries[0]["success_defined"]
    squares = sum(
        (entry["episodes"] - 1) * _variance(entry) + entry["episodes"] * (entry["mean_return"] - mean) ** 2
        for entry in entries
    )
    half = float(stdtrit(episodes - 1, 1 - ALPHA / 2)) * sqrt(squares / (episodes - 1) / episodes)
    return {
        "episodes": episodes,
        "success_defined": is_success_defined,
        "successes": successes,
        "success_rate": successes / episodes,
        "success_interval": wilson(successes, episodes),
        "mean_return": mean,
        "return_interval": (mean - half, mean + half),
        "least_return": min(entry["least_return"] for entry in entries),
        "greatest_return": max(entry["greatest_return"] for entry in entries),
        "endings": sum((Counter(entry["endings"]) for entry in entries), Counter()),
    }


def _variance(entry: Entry) -> float:
    """Of the returns of an evaluation, from Student's interval of their mean; the longer side, since bounds
    may cut the other one."""
    if entry["least_return"] == entry["greatest_return"]:
        return 0.0
    episodes, mean, (low, high) = entry["episodes"], entry["mean_return"], entry["return_interval"]
    return float(episodes * (max(mean - low, high - mean) / stdtrit(episodes - 1, 1 - ALPHA / 2)) ** 2)


def quartiles(values: Sequence[float]) -> tuple[float, float, float]:
    """The lower quartile, the median and the upper quartile of the seeds; an infinity is a seed that never
    got there."""
    ordered = sorted(values)
    low, middle, high = (ordered[round(share * (len(ordered) - 1))] for share in (0.25, 0.5, 0.75))
    return low, middle if len(ordered) % 2 else median(ordered), high


@dataclass(frozen=True)
class Headline:
    """What stands for an experiment: held-out episodes of its first training, the random policy, and medians
    of the cost of a training."""

    held: Entry
    random: Entry | None
    seeds: int
    simulated_hours: float
    cpu_seconds: float

    @classmethod
    def of(cls, standing: Standing) -> Headline | None:
        """None where nothing is measured; the random policy is None where it was measured under other
        conditions."""
        experiment = standing.experiment
        training = experiment.trainings[0]
        entries = Held("success_rate", training.evaluations[0].name, experiment.case, training.name).entries(
            standing.record
        )
        trained = standing.seeds(training).values()
        if not entries:
            return None
        cost = {key: median(entry[key] for entry in trained) for key in ("simulated_hours", "cpu_seconds")}
        random = None if experiment.case else standing.record["baselines"].get("random")
        return cls(together(entries), random, len(entries), **cost)
