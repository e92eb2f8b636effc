"""Trainings that learn and then fall apart by a planted setting: is the fall named, and the setting that was planted?

python -m tests.insight.collapses 1                  # all, with this seed, in a temporary folder
python -m tests.insight.collapses 1 2 --runs DIR     # and keep the runs
python -m tests.insight.collapses 1 --only clip rate # these of the table

A planted training that does not learn first, or does not fall, is not applicable: it is printed and not counted. A training
has learned if an evaluation reaches 60 % of what `solved` asks for. It has fallen if its last two evaluations have at most
80 % of the best one. Healthy trainings (`planted` is empty) must not be named; they are the shipped scenarios.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import fmean
from tempfile import TemporaryDirectory
from typing import NamedTuple

import torch

from deepbots_cli import api
from deepbots_cli.errors import DeepbotsError
from deepbots_cli.insight.diagnosis import diagnose
from deepbots_cli.insight.training import read_training
from deepbots_cli.learning import train
from deepbots_cli.learning.episodes import read_evaluations
from deepbots_cli.learning.run import Run


class Case(NamedTuple):
    """A training, and the paths of which one explains its fall; none for a healthy one."""

    name: str
    scenario: str
    timesteps: int
    set: Sequence[str]
    planted: Sequence[str] = ()


CASES = (
    Case("rate", "cartpole", 60_000, ["train.learning_rate=2e-2"], ["train.learning_rate"]),
    Case("epochs", "cartpole", 60_000, ["train.n_epochs=100"], ["train.n_epochs"]),
    Case("entropy", "cartpole", 60_000, ["train.ent_coef=0.2"], ["train.ent_coef"]),
    Case("clip", "cartpole", 60_000, ["train.clip_range=0.9"], ["train.clip_range"]),
    Case("batch", "cartpole", 60_000, ["train.batch_size=8"], ["train.batch_size"]),
    Case("scale", "cartpole", 60_000, ["reward.alive=100", "solved=mean_return >= 19500 over 100 episodes"], ["train.normalize"]),
    Case("range_entropy", "cartpole_continuous", 60_000, ["train.ent_coef=0.2"], ["train.ent_coef"]),
    Case("range_clip", "cartpole_continuous", 60_000, ["train.clip_range=0.9"], ["train.clip_range"]),
    Case("range_rate", "cartpole_continuous", 60_000, ["train.learning_rate=2e-2"], ["train.learning_rate"]),
    Case("pit_rate", "pit_escape", 42_000, ["train.learning_rate=2e-2"], ["train.learning_rate"]),
    Case("healthy", "cartpole", 60_000, []),
    Case("healthy_range", "cartpole_continuous", 60_000, []),
    Case("healthy_pit", "pit_escape", 42_000, []),
)


def trained(case: Case, seed: int, run: Path) -> Run:
    """The training of a case, to its last step, made where it is not there."""
    if not run.exists():
        compiled = api.compile(api.load(case.scenario, overrides=case.set))
        try:
            train(compiled, total_timesteps=case.timesteps, seed=seed, run=run, stop_when_solved=False)
        except DeepbotsError as error:  # a diverged training has another cause
            print(f"{run.name}: {error}", flush=True)
    return Run.open(run)


def has_fallen(run: Run) -> bool:
    """Whether the training learned its task, and lost it again."""
    solved, evaluations = run.program.agent.solved, read_evaluations(run.path)
    if solved is None or len(evaluations) < 3:
        return False
    name, wanted = ("returns", solved.mean_return) if solved.success_rate is None else ("successes", solved.success_rate)
    means = [fmean(each[name]) for each in evaluations]
    return max(means) >= 0.6 * (wanted or 0.0) and fmean(means[-2:]) <= 0.8 * max(means)


def named(run: Run) -> tuple[bool, list[str]]:
    """Whether `diagnose` names the fall, and the settings that it names, in their order."""
    causes = [cause for cause in diagnose(read_training(run)) if cause.cause == "fell_apart"]
    return bool(causes), [suspect["path"] for cause in causes for suspect in cause.evidence["suspects"]]


def results(seed: int, folder: Path, only: Sequence[str] = ()) -> Iterator[tuple[Case, bool, bool, list[str]]]:
    """Each case with: has it fallen, is the fall named, and which settings are named."""
    for case in CASES:
        if only and case.name not in only:
            continue
        run = trained(case, seed, folder / f"{case.name}-{seed}")
        yield case, has_fallen(run), *named(run)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("seeds", type=int, nargs="+")
    parser.add_argument("--runs", type=Path)
    parser.add_argument("--only", nargs="*", default=())
    given = parser.parse_args(arguments)
    torch.set_num_threads(1)
    applicable = falls = causes = healthy = alarms = 0
    with TemporaryDirectory() as temporary:
        for seed in given.seeds:
            for case, fell, is_named, paths in results(seed, given.runs or Path(temporary), given.only):
                if not case.planted:
                    healthy, alarms = healthy + (not fell), alarms + (is_named and not fell)
                elif fell:
                    applicable, falls = applicable + 1, falls + is_named
                    causes += bool(set(paths[:2]) & set(case.planted))
                state = ("fell" if fell else "not applicable") if case.planted else ("fell" if fell else "healthy")
                print(f"{seed}  {case.name:14} {state:14} {'named' if is_named else '-':6} {', '.join(paths)}", flush=True)
    print(f"falls named: {falls} of {applicable}; planted setting among the first two: {causes} of {applicable}")
    print(f"false alarms: {alarms} of {healthy} healthy trainings; CPU time {time.process_time():.0f} s")


if __name__ == "__main__":
    main()
