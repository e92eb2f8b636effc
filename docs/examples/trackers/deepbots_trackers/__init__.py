"""Loggers for Weights & Biases and MLflow: `deepbots train cartpole --logger wandb --logger mlflow`.

Both libraries read where to write from the environment: `WANDB_MODE=offline`, `MLFLOW_TRACKING_URI=sqlite:///mlflow.db`.
A resumed training continues under the same name in W&B, and begins a new run in MLflow.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.logger import KVWriter


def record_of(run: Path) -> dict[str, Any]:
    """The record of the run."""
    record: dict[str, Any] = json.loads((run / "run.json").read_text(encoding="utf-8"))
    return record


def facts(record: dict[str, Any]) -> dict[str, Any]:
    """What the experiment is searched for later."""
    return {name: record[name] for name in ("scenario", "seed", "engine", "digest", "total_timesteps")}


def numbers(key_values: dict[str, Any]) -> dict[str, float]:
    """The scalars among what Stable-Baselines3 logs."""
    return {
        name: float(value) for name, value in key_values.items() if isinstance(value, int | float | np.number)
    }


class Wandb(KVWriter):
    """A run of Weights & Biases, in the folder of the run."""

    def __init__(self, run: Path) -> None:
        import wandb

        record = record_of(run)
        begun = "".join(filter(str.isalnum, record["started"]))  # two folders may have runs of one name
        self.run = wandb.init(
            project="deepbots",
            id=f"{run.name}-{begun}",
            name=run.name,
            dir=run,
            config=facts(record),
            resume="allow",
        )

    def write(
        self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0
    ) -> None:
        self.run.log(numbers(key_values), step=step)

    def close(self) -> None:
        self.run.finish()


class MLflow(KVWriter):
    """A run of MLflow."""

    def __init__(self, run: Path) -> None:
        import mlflow

        self.client = mlflow.MlflowClient()
        experiment = mlflow.set_experiment("deepbots")
        self.run = self.client.create_run(experiment.experiment_id, run_name=run.name).info.run_id
        for name, value in facts(record_of(run)).items():
            self.client.log_param(self.run, name, value)

    def write(
        self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0
    ) -> None:
        for name, value in numbers(key_values).items():
            self.client.log_metric(self.run, name, value, step=step)

    def close(self) -> None:
        self.client.set_terminated(self.run)
