"""Trainings with several seeds as jobs of Slurm, by submitit: python slurm_seeds.py find_ball 0 1 2 3 4

A job that Slurm stops continues its run: `checkpoint` puts the same call back into the queue, and the call
resumes a run that exists. To try it without Slurm, set EXECUTOR=local.
"""

import os
import sys
from pathlib import Path

import submitit

from deepbots_cli.learning import resume, train


class Training:
    """A training that continues where it was stopped."""

    def __call__(self, scenario: str, run: Path, seed: int) -> str:
        if (run / "run.json").exists():
            return resume(run).status
        return train(scenario, run=run, seed=seed).status

    def checkpoint(self, scenario: str, run: Path, seed: int) -> submitit.helpers.DelayedSubmission:
        return submitit.helpers.DelayedSubmission(self, scenario, run, seed)


if __name__ == "__main__":
    scenario, *seeds = sys.argv[1:]
    executor = submitit.AutoExecutor("runs/jobs", cluster=os.environ.get("EXECUTOR", "slurm"))
    executor.update_parameters(timeout_min=240, cpus_per_task=1, mem_gb=4, slurm_signal_delay_s=120)
    jobs = [
        executor.submit(Training(), scenario, Path(f"runs/{scenario}-{seed}").absolute(), int(seed))
        for seed in seeds
    ]
    for seed, job in zip(seeds, jobs, strict=True):
        print(f"seed {seed}: {job.result()}")
