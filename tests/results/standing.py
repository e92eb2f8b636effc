"""How an experiment stands: what of its record is asked for, what of that is of another version, and which bars are met."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from tests.results import asked
from tests.results.experiment import Experiment, Training
from tests.results.verdicts import Verdict, judge

Entry = Mapping[str, Any]


@dataclass(frozen=True)
class Standing:
    experiment: Experiment
    record: Entry
    """Only what the experiment names: seeds and trainings that it had before may still be in the file."""

    @classmethod
    def of(cls, experiment: Experiment, record: Entry) -> Standing:
        known = record.get("trainings", {})
        trainings = {
            training.name: {str(seed): known[training.name][str(seed)] for seed in training.seeds if str(seed) in known[training.name]}
            for training in experiment.trainings
            if training.name in known
        }
        names = [baseline.name for baseline in experiment.baselines]
        baselines = {name: entry for name, entry in record.get("baselines", {}).items() if name in names}
        return cls(experiment, {"trainings": trainings, "baselines": baselines})

    def seeds(self, training: Training) -> dict[int, Entry]:
        """What was measured of each seed."""
        known = self.record["trainings"].get(training.name, {})
        return {seed: known[str(seed)] for seed in training.seeds if str(seed) in known}

    def entries(self) -> Iterator[Entry]:
        """Whatever was measured: trainings, evaluations, baselines."""
        for training in self.experiment.trainings:
            for entry in self.seeds(training).values():
                yield entry
                yield from entry["evaluations"].values()
        yield from self.record["baselines"].values()

    @property
    def has_curves(self) -> bool:
        return any(self.record["trainings"].values())

    def verdicts(self) -> list[Verdict]:
        return [judge(self.experiment, bar, self.record) for bar in self.experiment.bars]

    def outdated(self) -> Iterator[str]:
        """What was measured of an earlier version of the scenario, or by another command than is asked for now."""
        for training in self.experiment.trainings:
            for seed, entry in self.seeds(training).items():
                place = f"seed {seed}" + ("" if training.name == "main" else f" ({training.name})")
                if not asked.training(self.experiment, training, seed).is_of(entry):
                    yield place
                    continue
                for evaluation in training.evaluations:
                    held = entry["evaluations"].get(evaluation.name)
                    if held is not None and not asked.evaluation(self.experiment, training, evaluation).is_of(held):
                        yield f"{evaluation.name} of {place}"
        for baseline in self.experiment.baselines:
            tried = self.record["baselines"].get(baseline.name)
            if tried is not None and not asked.baseline(self.experiment, baseline).is_of(tried):
                yield baseline.name
