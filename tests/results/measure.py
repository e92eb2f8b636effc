"""Measures what is missing of an experiment: trains or goes on, evaluates, tries baselines, and enters each result as it comes.

The pieces of an experiment are chains, which know of nothing but each other's records: a training with its evaluations for each seed,
and the baselines. A chain that is stopped anywhere goes on from there: a finished piece is in the record, and an unfinished training
in its run directory.
"""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

from deepbots_cli.errors import RunError, UsageError
from deepbots_cli.learning.checkpoints import latest, read_state
from deepbots_cli.learning.run import Run, run_lock
from tests.results import asked, curves, records
from tests.results.asked import Asked
from tests.results.commands import Commands
from tests.results.experiment import Baseline, Evaluation, Experiment, Training
from tests.results.figures import Crossed
from tests.results.places import Places
from tests.results.progress import Progress

POLL_SECONDS = 5.0
KEPT = (
    "episodes",
    "mean_return",
    "return_interval",
    "least_return",
    "greatest_return",
    "success_defined",
    "successes",
    "success_rate",
    "success_interval",
    "mean_length",
    "endings",
)
"""What a record keeps of an evaluation."""


class Chain(Protocol):
    """Pieces that are measured one after the other."""

    def missing(self) -> int:
        """How many are to be measured."""

    def measure(self, commands: Commands, progress: Progress) -> None:
        """Measure them.

        Raises:
            StoppedError, CommandFailedError: From the commands; what was measured before is kept.
        """


def chains(experiment: Experiment, places: Places) -> Iterator[Chain]:
    for training in experiment.trainings:
        for seed in training.seeds:
            yield SeedChain(experiment, training, seed, places)
    for baseline in experiment.baselines:
        yield BaselineChain(experiment, baseline, places)


@dataclass(frozen=True)
class SeedChain:
    """The training of one seed, and what is evaluated of it."""

    experiment: Experiment
    training: Training
    seed: int
    places: Places

    @property
    def _scenario(self) -> str:
        return self.experiment.scenario

    @property
    def _record(self) -> Path:
        return self.places.record(self.experiment.name)

    @property
    def asked(self) -> Asked:
        return asked.training(self.experiment, self.training, self.seed)

    @property
    def folder(self) -> Path:
        """The run directory: one of its own for whatever is asked for."""
        key = hashlib.sha256(f"{self.asked.digest} {self.asked.command}".encode()).hexdigest()[:10]
        return self.places.runs / self.experiment.name / f"{self.training.name}-{self.seed}-{key}"

    @property
    def _keys(self) -> tuple[str, ...]:
        return "trainings", self.training.name, str(self.seed)

    def entry(self) -> dict[str, Any] | None:
        """What the record has of this seed, if it is of what is asked for now."""
        found: Any = records.read(self._record)
        for key in self._keys:
            found = found.get(key, {})
        wanted = {crossed.key for crossed in self._crossings()}
        return found if found and self.asked.is_of(found) and wanted <= set(found["crossings"]) else None

    def unevaluated(self) -> list[Evaluation]:
        known = (self.entry() or {}).get("evaluations", {})
        return [
            evaluation
            for evaluation in self.training.evaluations
            if not asked.evaluation(self.experiment, self.training, evaluation).is_of(known.get(evaluation.name))
        ]

    def missing(self) -> int:
        evaluations = self.unevaluated()
        untrained = self.entry() is None or (evaluations and not self._is_on_disk())
        return 1 + len(self.training.evaluations) if untrained else len(evaluations)

    def _is_on_disk(self) -> bool:
        """Whether there is a trained policy to evaluate."""
        try:
            return self._is_done(self._run())
        except RunError:
            return False

    def measure(self, commands: Commands, progress: Progress) -> None:
        if not self.missing():
            return
        name = f"{self.experiment.name} {self.seed}" + ("" if self.training.name == "main" else f" ({self.training.name})")
        self._wait_for_others(commands, progress)
        run = self._run()
        done = self._is_done(run)
        if not done:
            with progress.piece(f"{name}: {'training' if run is None else 'going on with the training'}"):
                self._train(run, commands)
        if not done or self.entry() is None:
            records.put(self._record, self._collected(), *self._keys)
        for evaluation in self.unevaluated():
            with progress.piece(f"{name}: evaluating, {evaluation.name}"):
                entry = self._evaluated(evaluation, commands)
            records.put(self._record, entry, *self._keys, "evaluations", evaluation.name)

    def _wait_for_others(self, commands: Commands, progress: Progress) -> None:
        """Whoever is killed outright may leave a training at work."""
        told = False
        while self.folder.is_dir():
            try:
                with run_lock(self.folder):
                    return
            except UsageError:
                if not told:
                    progress.say(f"a training is at work in {self.folder}; waiting for it")
                told = True
                commands.pause(POLL_SECONDS)

    def _run(self) -> Run | None:
        """What there is of it on disk; a directory that a process was killed in while making it is none.

        Raises:
            RunError: It is damaged, or of another deepbots; nobody but its owner should throw hours of training away.
        """
        return Run.open(self.folder) if (self.folder / "run.json").exists() else None

    def _is_done(self, run: Run | None) -> bool:
        """Whether nothing is left to train. (One that is killed in its last moments does not know so itself.)"""
        last = None if run is None else latest(run)
        if run is None or last is None:
            return False
        return run.record.status == "finished" or read_state(last).statistics.steps >= run.record.total_timesteps

    def _train(self, run: Run | None, commands: Commands) -> None:
        ledger = self._ledger
        if run is None:
            self.folder.parent.mkdir(parents=True, exist_ok=True)
            shutil.rmtree(self.folder, ignore_errors=True)
            ledger.write_text("", encoding="utf-8")
            words = [self._scenario, "--seed", str(self.seed), *self.training.options, "--run", str(self.folder)]
        else:
            words = ["--resume", str(self.folder)]
        commands.deepbots("train", *words, ledger=ledger)

    @property
    def _ledger(self) -> Path:
        """CPU seconds, a line for each process."""
        return self.folder.with_suffix(".cpu")

    def _crossings(self) -> list[Crossed]:
        figures = [bar.figure for bar in self.experiment.bars]
        return [figure for figure in figures if isinstance(figure, Crossed) and figure.training == self.training.name]

    def _collected(self) -> dict[str, Any]:
        """The entry of a training that is done, from its run directory."""
        run = Run.open(self.folder)
        result = run.record.result
        if result is None:
            raise RunError(f"{run.path} was killed when it was done; go on with it")
        curve = curves.points(curves.episodes(run.monitor))
        last = run.program.curriculum[-1].name if run.program.curriculum else ""
        processes = [float(line) for line in self._ledger.read_text(encoding="utf-8").split()]
        ends = [asdict(end) | {"simulated_hours": round(end.steps * run.program.period / 3600, 4)} for end in result.stages]
        return {
            **vars(self.asked),
            **records.circumstances(),
            "steps": result.steps,
            "episodes": result.episodes,
            "simulated_hours": round(result.simulated_hours, 4),
            # A process that was killed outright is not in the ledger; its training counted up to its last checkpoint.
            "cpu_seconds": round(max(sum(processes), result.cpu_seconds), 1),
            "times_resumed": len(run.record.resumed_at),
            "solved_at": None if result.solved_at is None else asdict(result.solved_at),
            "stage": result.stage,
            "stages": ends,
            "crossings": {wanted.key: curves.crossing(curve, wanted, last) for wanted in self._crossings()},
            "curve": curves.thinned(curve),
            "evaluations": {},
        }

    def _evaluated(self, evaluation: Evaluation, commands: Commands) -> dict[str, Any]:
        words = [str(self.folder), *evaluation.options]
        if evaluation.scenario is None and not self.training.sets:
            words += ["--scenario", self._scenario]  # whose cases may have come after the training
        outcome = commands.deepbots("eval", *words)
        told = outcome.data
        return {
            **vars(asked.evaluation(self.experiment, self.training, evaluation)),
            **records.circumstances(),
            "cpu_seconds": round(outcome.cpu_seconds, 1),
            **{key: told[key] for key in KEPT},
            "cases": {case["case"]: {key: case[key] for key in KEPT} for case in told["cases"]},
        }


@dataclass(frozen=True)
class BaselineChain:
    """Episodes of a policy that learned nothing."""

    experiment: Experiment
    baseline: Baseline
    places: Places

    @property
    def _record(self) -> Path:
        return self.places.record(self.experiment.name)

    @property
    def asked(self) -> Asked:
        return asked.baseline(self.experiment, self.baseline)

    def missing(self) -> int:
        known = records.read(self._record).get("baselines", {}).get(self.baseline.name)
        return not self.asked.is_of(known)

    def measure(self, commands: Commands, progress: Progress) -> None:
        if not self.missing():
            return
        with progress.piece(f"{self.experiment.name}: {self.baseline.name}"):
            outcome = commands.deepbots("run", self.experiment.scenario, *self.baseline.all_options)
        entry = {
            **vars(self.asked),
            **records.circumstances(),
            "cpu_seconds": round(outcome.cpu_seconds, 1),
            **{key: outcome.data["summary"][key] for key in KEPT},
        }
        records.put(self._record, entry, "baselines", self.baseline.name)
