"""What a measurement is known by: the command line, and the digest of the scenario. It counts as long as both are what is asked for."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from tests.results import fingerprint
from tests.results.experiment import Baseline, Evaluation, Experiment, Training


@dataclass(frozen=True)
class Asked:
    """`command` is as the page has it: without a run directory, with RUN for what a training made."""

    digest: str
    command: str

    def is_of(self, entry: Mapping[str, Any] | None) -> bool:
        """Whether an entry of a record is what is asked for."""
        return entry is not None and (entry["digest"], entry["command"]) == (self.digest, self.command)


def training(experiment: Experiment, wanted: Training, seed: int | str) -> Asked:
    words = ["deepbots", "train", experiment.scenario, "--seed", str(seed), *wanted.options]
    return Asked(fingerprint.of_training(experiment.scenario, wanted), shlex.join(words))


def evaluation(experiment: Experiment, trained: Training, wanted: Evaluation) -> Asked:
    digest = fingerprint.of_evaluation(experiment.scenario, trained, wanted)
    return Asked(digest, shlex.join(["deepbots", "eval", "RUN", *wanted.options]))


def baseline(experiment: Experiment, wanted: Baseline) -> Asked:
    digest = fingerprint.of_baseline(experiment.scenario, wanted)
    return Asked(digest, shlex.join(["deepbots", "run", experiment.scenario, *wanted.all_options]))
